"""Small flights over a known, smooth scene as projects whose photos are placed and oriented."""

from __future__ import annotations

import json
import shutil
import sqlite3
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import rasterio
import tifffile
import tomlkit
from numpy.typing import NDArray
from tool_cases import Done, georef

from georef_gis.project import Project

# the middle of UTM zone 17: north on the map is north, so photos are upright in the mosaic
LAT, LON = 40.0, -81.0
# m of longitude and latitude per degree there, 200 m above the ellipsoid
EAST, NORTH = 85_397.0, 111_039.0
SIZE = (600, 400)
# m above the ground; px
HEIGHT, FOCAL = 100.0, 500.0
# photos 35 m apart, 85 m of ground in common
ROW = tuple((35.0 * k, 0.0) for k in range(4))
PREPARED = "read_photos,orient_direct,footprints"
PROJECT = {
    "project": {"crs": "EPSG:32617"},
    "camera": {"focal_px": FOCAL},
    "gnss": {"height_kind": "ellipsoidal"},
    "ground": {"height_m": 200.0, "height_kind": "ellipsoidal"},
    "poses": {"file": "geo.txt"},
}

Values = NDArray[np.float64]
Image = NDArray[Any]
# grey values (rows, cols, bands), 0 to 1, of photo k at places east and north, m
Paint = Callable[[int, Values, Values], Values]


def scene(k: int, east: Values, north: Values) -> Values:
    """Smooth ground of three bands: hills of 30 to 150 m, from 0.3 to 0.6."""
    base = 0.45 + 0.08 * np.sin(east / 17.0) * np.cos(north / 23.0) + 0.05 * np.sin(east / 5.0)
    return np.stack([base, 0.9 * base + 0.03, 0.8 * base + 0.02 * np.sin(north / 9.0)], axis=-1)


def flat(levels: Sequence[int]) -> Paint:
    """Every photo of one grey: the mosaic shows which photo it takes."""
    return lambda k, east, north: np.full((*east.shape, 3), levels[k] / 255.0)


def ground_of(place: tuple[float, float], size: tuple[int, int], height: float) -> tuple[Any, Any]:
    """East and north, m, of every pixel of a photo that looks straight down."""
    cols, rows = np.meshgrid(np.arange(size[0]), np.arange(size[1]))
    scale = height / FOCAL
    east = place[0] + (cols - (size[0] - 1) / 2.0) * scale
    north = place[1] - (rows - (size[1] - 1) / 2.0) * scale
    return east, north


@dataclass
class Flight:
    """A project folder."""

    folder: Path

    @property
    def path(self) -> Path:
        """The mosaic's file."""
        return self.folder / "products" / "mosaic.tif"

    @property
    def seams(self) -> Path:
        """Layer of the seams."""
        return self.folder / "seams.gpkg"

    def photo(self, k: int) -> Path:
        """File of a photo."""
        return sorted((self.folder / "photos").iterdir())[k]

    def set(self, section: str, **values: Any) -> None:
        """Set keys of project.toml."""
        path = self.folder / "project.toml"
        content: dict[str, Any] = tomlkit.parse(path.read_text())
        content.setdefault(section, tomlkit.table()).update(values)
        path.write_text(tomlkit.dumps(content))

    def wish(self, **values: Any) -> None:
        """Set parameters of the mosaic."""
        self.set("tools", mosaic=values)

    def run(self, *words: str) -> Done:
        """Make the mosaic."""
        return georef("run", self.folder, "--only", "mosaic", *words)

    def made(self, *words: str) -> Done:
        """Make the mosaic, which must succeed."""
        done = self.run(*words)
        assert done.code == 0, done.text
        return done

    def summary(self) -> dict[str, Any]:
        """What the last run told."""
        project = Project.open(self.folder, read_only=True)
        rows = {row["tool"]: row for row in project.database.last_rows("run", "tool")}
        return dict(next(row["summary"] for tool, row in rows.items() if tool.endswith("mosaic")))

    def execute(self, query: str, *values: Any) -> None:
        """Change the database."""
        with sqlite3.connect(self.folder / "georef.gpkg") as database:
            database.execute(query, values)

    def read(self) -> tuple[Image, NDArray[np.bool_]]:
        """Pixels (rows, cols, bands) and mask of the mosaic."""
        with rasterio.open(self.path) as dataset:
            bands = [i for i in dataset.indexes if dataset.colorinterp[i - 1].name != "alpha"]
            return np.moveaxis(dataset.read(bands), 0, -1), dataset.dataset_mask() > 0

    def places(self) -> tuple[Values, Values]:
        """East and north, m, of the mosaic's pixels."""
        from pyproj import Transformer

        with rasterio.open(self.path) as dataset:
            cols, rows = np.meshgrid(np.arange(dataset.width), np.arange(dataset.height))
            a, _, left, _, e, top = dataset.transform[:6]
            x, y = left + a * (cols + 0.5), top + e * (rows + 0.5)
            step = Transformer.from_crs(dataset.crs.to_wkt(), "EPSG:4326", always_xy=True)
        lon, lat = step.transform(x, y)
        return (np.asarray(lon) - LON) * EAST, (np.asarray(lat) - LAT) * NORTH


def write(path: Path, image: Image) -> None:
    if path.suffix == ".png":
        cv2.imwrite(str(path), image[..., ::-1])
    elif path.suffix == ".jpg":
        cv2.imwrite(str(path), image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 98])
    else:
        photometric = "rgb" if image.shape[2] == 3 else "minisblack"
        data = image[..., 0] if image.shape[2] == 1 else image
        tifffile.imwrite(path, data, photometric=photometric, planarconfig="contig")


def make(
    folder: Path,
    paint: Paint = scene,
    places: Sequence[tuple[float, float]] = ROW,
    *,
    dtypes: Mapping[int, str] | str = "uint8",
    sizes: Mapping[int, tuple[int, int]] | None = None,
    heights: Mapping[int, float] | None = None,
    ending: str = ".tif",
    products: Mapping[str, Any] | None = None,
) -> Flight:
    """Project of photos that look straight down on flat ground; ready for its mosaic.

    `dtypes`, `sizes` (px) and `heights` (m) are those of photos by number that are not like the
    others.
    """
    (folder / "photos").mkdir(parents=True)
    lines = ["EPSG:4326"]
    for k, place in enumerate(places):
        name = f"P{k:03d}{ending}"
        height = (heights or {}).get(k, HEIGHT)
        grey = paint(k, *ground_of(place, (sizes or {}).get(k, SIZE), height))
        dtype = dtypes if isinstance(dtypes, str) else dtypes.get(k, "uint8")
        top = np.iinfo(dtype).max
        write(folder / "photos" / name, np.clip(grey * top + 0.5, 0, top).astype(dtype))
        lon, lat = LON + place[0] / EAST, LAT + place[1] / NORTH
        lines.append(f"{name} {lon:.10f} {lat:.10f} {200.0 + height:.3f} 0 0 0")
    (folder / "geo.txt").write_text("\n".join(lines) + "\n")
    settings = PROJECT | {"products": {"gsd_m": 0.25, "compression": "deflate", **(products or {})}}
    (folder / "project.toml").write_text(tomlkit.dumps(json.loads(json.dumps(settings))))
    done = georef("run", folder, "--only", PREPARED)
    assert done.code == 0, done.text
    flight = Flight(folder)
    flight.wish(seams="optimised")
    return flight


def copied(flight: Flight, folder: Path) -> Flight:
    """Another project of the same content."""
    shutil.copytree(flight.folder, folder)
    return Flight(folder)


def taken(flight: Flight, levels: Sequence[int]) -> NDArray[np.int64]:
    """Number of the photo at each pixel of a mosaic of `flat` photos; -1 where there is none."""
    data, mask = flight.read()
    away = np.abs(data[..., :1].astype(int) - np.array(levels))
    return np.where(mask, np.argmin(away, axis=-1), -1)
