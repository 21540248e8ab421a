"""Small grids of known values, as the formats of PROJ."""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import tifffile
from pyproj import datadir

from georef_gis.geodesy.grids_folder import forget_grids, use_grids

# west, south (deg), step (deg), nodes along each side: Ohio and around
WEST, SOUTH, STEP, NODES = -85.0, 38.0, 0.5, 9
AREA = (WEST, SOUTH, WEST + STEP * (NODES - 1), SOUTH + STEP * (NODES - 1))
_ENVIRONMENT = ("GEOREF_GRIDS", "PROJ_USER_WRITABLE_DIRECTORY")


def plane(lat: np.ndarray | float, lon: np.ndarray | float) -> np.ndarray | float:
    """Undulation of the test's geoid, m; bilinear interpolation gives it as it is."""
    return -33.0 + 0.25 * (lat - 40.0) - 0.125 * (lon + 83.0)


def nodes() -> tuple[np.ndarray, np.ndarray]:
    """Latitudes (from the south) and longitudes of the nodes, deg; (NODES, NODES)."""
    lat, lon = SOUTH + STEP * np.arange(NODES), WEST + STEP * np.arange(NODES)
    return np.meshgrid(lat, lon, indexing="ij")


def write_gtx(path: Path, *, shift: float = 0.0) -> Path:
    values = (plane(*nodes()) + shift).astype(">f4")
    path.write_bytes(struct.pack(">4d2i", SOUTH, WEST, STEP, STEP, NODES, NODES) + values.tobytes())
    return path


def write_tiff(path: Path, *, shift: float = 0.0, east: float = 0.0) -> Path:
    """GeoTIFF of EPSG:4326 whose pixels are points, north first; `east` deg farther east."""
    values = (plane(*nodes()) + shift).astype(np.float32)[::-1]
    keys = [1, 1, 0, 3, 1024, 0, 1, 2, 1025, 0, 1, 2, 2048, 0, 1, 4326]
    north = SOUTH + STEP * (NODES - 1)
    told = (
        '<GDALMetadata><Item name="DESCRIPTION" sample="0" role="description">'
        "geoid_undulation</Item></GDALMetadata>"
    )
    tags = [
        (33550, "d", 3, (STEP, STEP, 0.0), True),
        (33922, "d", 6, (0.0, 0.0, 0.0, WEST + east, north, 0.0), True),
        (34735, "H", len(keys), tuple(keys), True),
        (42112, "s", 0, told, True),
    ]
    tifffile.imwrite(path, values, extratags=tags, metadata=None, compression="zlib")
    return path


def write_ntv2(path: Path, *, lat_shift: float = 0.5, lon_shift: float = -0.25) -> Path:
    """Shifts of places, seconds of arc, all over; longitudes count to the west."""
    record = struct.Struct("<8s8s")
    integer, number = (lambda v: struct.pack("<i4x", v)), (lambda v: struct.pack("<d", v))

    def line(name: str, value: bytes) -> bytes:
        return record.pack(name.encode().ljust(8), value.ljust(8))

    head = [
        line("NUM_OREC", integer(11)), line("NUM_SREC", integer(11)), line("NUM_FILE", integer(1)),
        line("GS_TYPE", b"SECONDS "), line("VERSION", b"TEST    "), line("SYSTEM_F", b"A       "),
        line("SYSTEM_T", b"B       "), line("MAJOR_F", number(6378137.0)),
        line("MINOR_F", number(6356752.314140)), line("MAJOR_T", number(6378137.0)),
        line("MINOR_T", number(6356752.314140)),
    ]  # fmt: skip
    west, south, east, north = AREA
    head += [
        line("SUB_NAME", b"TEST    "), line("PARENT", b"NONE    "), line("CREATED", b"20260101"),
        line("UPDATED", b"20260101"), line("S_LAT", number(south * 3600)),
        line("N_LAT", number(north * 3600)), line("E_LONG", number(-east * 3600)),
        line("W_LONG", number(-west * 3600)), line("LAT_INC", number(STEP * 3600)),
        line("LONG_INC", number(STEP * 3600)), line("GS_COUNT", integer(NODES * NODES)),
    ]  # fmt: skip
    node = struct.pack("<4f", lat_shift, lon_shift, 0.0, 0.0)
    end = b"END     " + bytes(8)
    path.write_bytes(b"".join(head) + node * NODES * NODES + end)
    return path


@contextmanager
def grids_in(folder: Path) -> Iterator[Path]:
    """Have the grids of a folder only, and all as it was afterwards."""
    folders, kept = datadir.get_data_dir(), {name: os.environ.get(name) for name in _ENVIRONMENT}
    folder.mkdir(exist_ok=True)
    use_grids(folder)
    try:
        yield folder
    finally:
        for name, value in kept.items():
            os.environ.pop(name, None)
            if value is not None:
                os.environ[name] = value
        datadir.set_data_dir(folders)
        forget_grids()
