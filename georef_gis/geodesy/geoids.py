"""Undulations of geoids: EGM96 from the package, others from PROJ's grids, each by its own name.

PROJ left to itself takes whichever grid is there for a height system, or none: the results would
depend on the machine.
"""

from __future__ import annotations

import functools
import lzma
import re
from dataclasses import dataclass, field
from importlib import resources

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pyproj import Transformer
from pyproj.exceptions import ProjError

from georef_gis.errors import CrsError, InputError
from georef_gis.frames import Array
from georef_gis.geodesy.grid_files import examine_grid
from georef_gis.geodesy.grids_folder import find_grid, how_to_get, made_with_grids
from georef_gis.geodesy.reference_systems import Datum, epoch_between, transformer_between

_FILE = re.compile(r"[\w.+-]+\.(tif|gtx)", re.ASCII)
# west, south, east, north of the whole Earth, deg
_WORLD = (-180.0, -90.0, 180.0, 90.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class GeoidGrid:
    """A file of PROJ and about where it holds: west, south, east, north, deg."""

    name: str
    area: tuple[float, float, float, float] = _WORLD

    def holds(self, lat: Array, lon: Array) -> NDArray[np.bool_]:
        """Which places (deg) may lie on it."""
        west, south, east, north = self.area
        turned = (lon - west) % 360.0
        return np.asarray((lat >= south) & (lat <= north) & (turned <= east - west))


@dataclass(frozen=True, slots=True, kw_only=True)
class Geoid:
    """Grids of a geoid, and the realisation above whose ellipsoid it is told."""

    grids: tuple[GeoidGrid, ...]
    datum: Datum = field(default_factory=Datum)


_NAD83 = Datum(name="NAD83(2011)", epoch=2010.0)
GEOIDS = {
    "geoid18": Geoid(
        grids=(
            GeoidGrid(name="us_noaa_g2018u0.tif", area=(-130.0, 24.0, -60.0, 58.0)),
            GeoidGrid(name="us_noaa_g2018p0.tif", area=(-69.0, 15.0, -64.0, 21.0)),
        ),
        datum=_NAD83,
    ),
    "geoid12b": Geoid(
        grids=(
            GeoidGrid(name="us_noaa_g2012bu0.tif", area=(-130.0, 24.0, -60.0, 58.0)),
            GeoidGrid(name="us_noaa_g2012ba0.tif", area=(-188.0, 49.0, -126.0, 72.0)),
            GeoidGrid(name="us_noaa_g2012bp0.tif", area=(-69.0, 15.0, -64.0, 21.0)),
        ),
        datum=_NAD83,
    ),
    "egm2008": Geoid(grids=(GeoidGrid(name="us_nga_egm08_25.tif"),)),
    "cgvd2013": Geoid(
        grids=(GeoidGrid(name="ca_nrc_CGG2013n83.tif", area=(-170.0, 10.0, -10.0, 90.0)),),
    ),
}


def geoid_undulation(
    lat: ArrayLike, lon: ArrayLike, *, geoid: str = "egm96", datum: Datum | None = None,
    partly: bool = False,
) -> Array:  # fmt: skip
    """Height of the geoid above the ellipsoid, m, at lat, lon in rad; shapes (...).

    Parameters
    ----------
    geoid
        "egm96", a name of `GEOIDS`, or the file of a grid.
    datum
        Realisation of the ellipsoidal heights it is to go with; None = that of the geoid. GEOID18
        is told above the ellipsoid of NAD83(2011), 1 to 2 m from that of ITRF2020.
    partly
        Give NaN where the geoid does not reach, or where its grid is not installed: for places of
        which some may be wrong, once it was found to be there for the others.

    Raises
    ------
    CrsError
        If the geoid is unknown, its grid is not installed, or it does not reach there: never a
        silent zero.
    """
    lat, lon = np.broadcast_arrays(np.asarray(lat, float), np.asarray(lon, float))
    if geoid == "egm96":
        return _egm96(lat, lon)
    if geoid in GEOIDS:
        told = GEOIDS[geoid]
    elif _FILE.fullmatch(geoid):
        told = Geoid(grids=(GeoidGrid(name=geoid),))
    else:
        known = ", ".join(["egm96", *GEOIDS])
        raise CrsError(
            f"'{geoid}' is not known; use one of {known}, or the file of a grid", field="geoid"
        )
    n = _of_grids(geoid, told, np.degrees(lat), np.degrees(lon), partly=partly)
    return n if datum is None else n - _rise(lat, lon, datum, told.datum)


def _rise(lat: Array, lon: Array, source: Datum, target: Datum) -> Array:
    """By how much heights above the ellipsoid grow from one realisation to another, m."""
    if not (source.is_known and target.is_known) or source.name == target.name:
        return np.zeros(lat.shape)
    step = transformer_between(source.geographic_3d(), target.geographic_3d())
    when = np.full(lat.shape, epoch_between(source, target))
    h = step.transform(np.degrees(lon), np.degrees(lat), np.zeros(lat.shape), when)[2]
    return np.asarray(h, dtype=np.float64)


def needed_grids(geoid: str, place: tuple[float, float] | None) -> tuple[str, ...]:
    """Grids that a geoid needs at a place, lat, lon in rad; the first if no place is known."""
    told = GEOIDS.get(geoid)
    if told is None:
        return (geoid,) if _FILE.fullmatch(geoid) else ()
    if place is None:
        return (told.grids[0].name,)
    at = np.degrees(place)
    return tuple(grid.name for grid in told.grids if grid.holds(at[0], at[1]))[:1]


def _of_grids(geoid: str, told: Geoid, lat: Array, lon: Array, *, partly: bool) -> Array:
    """Undulation at places (deg) from the grids that hold there, m."""
    out = np.full(lat.shape, np.nan)
    missing = None
    for grid in told.grids:
        here = grid.holds(lat, lon) & np.isnan(out)
        if not here.any():
            continue
        if find_grid(grid.name) is None:
            missing = missing or grid.name
        else:
            out[here] = _shifted(grid.name, lat[here], lon[here])
    lost = np.isnan(out)
    if partly or not lost.any():
        return out
    if missing is not None:
        raise CrsError(
            f"the grid {missing} of geoid '{geoid}' is not installed; {how_to_get(missing)}",
            field="geoid",
        )
    for grid in told.grids:
        _check_whole(geoid, grid.name)
    at = f"{lat[lost].flat[0]:.4f}, {lon[lost].flat[0]:.4f} deg"
    also = "; geoid12b covers Alaska" if geoid == "geoid18" else ""
    raise CrsError(f"'{geoid}' does not cover {at}; use a geoid that does{also}", field="geoid")


def _check_whole(geoid: str, grid: str) -> None:
    """Tell of a grid that is damaged; PROJ gives no height in such, as beyond its rim."""
    path = find_grid(grid)
    try:
        if path is not None:
            examine_grid(path)
    except InputError as error:
        raise CrsError(
            f"the grid {grid} of geoid '{geoid}' is damaged ({error}); `georef grids remove "
            f"{grid}`, then {how_to_get(grid)}",
            field="geoid",
        ) from error


def _shifted(grid: str, lat: Array, lon: Array) -> Array:
    """Values of a grid at places (n,), deg -> m; NaN beyond it."""
    path = find_grid(grid)
    stamp = (str(path), path.stat().st_mtime_ns) if path is not None else None
    try:
        h = _shift(grid, stamp).transform(lon, lat, np.zeros(lat.shape))[2]
    except ProjError:
        # It says of a file that is no grid what it says of none; the caller looks into it.
        return np.full(lat.shape, np.nan)
    return np.where(np.isfinite(h), h, np.nan)


@functools.lru_cache(maxsize=16)
def _shift(grid: str, stamp: object) -> Transformer:
    """PROJ's step of a grid; another file of its name, by the stamp, is opened anew."""
    return Transformer.from_pipeline(
        "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad "
        f"+step +proj=vgridshift +grids={grid} +multiplier=1 "
        "+step +proj=unitconvert +xy_in=rad +xy_out=deg"
    )


made_with_grids(_shift.cache_clear)


# -- EGM96 -------------------------------------------------------------------------------------


@functools.cache
def _egm96_cm() -> Array:
    """EGM96 undulation on its 15' grid from (-90, -180), cm; shape (721, 1441)."""
    raw = resources.files("georef_gis").joinpath("data/egm96_15.xz").read_bytes()
    d = np.frombuffer(lzma.decompress(raw), dtype="<i2").reshape(721, 1440).astype(np.int32)
    grid = np.cumsum(np.cumsum(d, axis=0), axis=1)
    return np.concatenate([grid, grid[:, :1]], axis=1).astype(np.float64)


def _egm96(lat: Array, lon: Array) -> Array:
    row = np.clip((np.degrees(lat) + 90.0) * 4.0, 0.0, 720.0)
    col = ((np.degrees(lon) + 180.0) % 360.0) * 4.0
    i = np.minimum(row.astype(int), 719)
    j = np.minimum(col.astype(int), 1439)
    v, u = row - i, col - j
    g = _egm96_cm()
    top = g[i, j] * (1 - u) + g[i, j + 1] * u
    bottom = g[i + 1, j] * (1 - u) + g[i + 1, j + 1] * u
    return np.asarray((top * (1 - v) + bottom * v) / 100.0)
