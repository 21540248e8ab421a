"""Rasters whose colour tells the place, and what a map program makes of their tiles."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import rasterio
import rasterio.shutil
from rasterio.transform import Affine
from rasterio.warp import transform

from exports import EXPORTERS
from georef_gis.project import Project
from georef_gis.toolbox import CollectingFeedback, Context
from georef_gis.toolbox.algorithm import Result
from georef_gis.toolbox.exporter import tool_of

TOOLS = {exporter.id: tool_of(exporter) for exporter in EXPORTERS}
SIZE = (900, 700)
# px; so steep that 0.1 px of misplacement is about 1 grey level
WAVE = 60.0
LEFT_TOP = {"EPSG:32617": (330000.0, 4430000.0), "EPSG:6549": (1800000.0, 700000.0),
            "EPSG:4326": (-83.0, 40.0)}  # fmt: skip
PIXEL = {"EPSG:32617": 0.05, "EPSG:6549": 0.164, "EPSG:4326": 5e-7}


def colours(col: np.ndarray, row: np.ndarray) -> np.ndarray:
    """Red, green, blue at outer-corner pixel coordinates; (..., 3), 48 to 208."""
    phase = np.stack([col, row, col + row], axis=-1) * (2 * math.pi / WAVE)
    return 128.0 + 80.0 * np.sin(phase)


def slopes(col: np.ndarray, row: np.ndarray) -> np.ndarray:
    """Grey levels per px along columns and rows; (..., 3, 2)."""
    step = 0.01
    across = (colours(col + step, row) - colours(col - step, row)) / (2 * step)
    down = (colours(col, row + step) - colours(col, row - step)) / (2 * step)
    return np.stack([across, down], axis=-1)


def diamond(col: np.ndarray, row: np.ndarray) -> np.ndarray:
    """Where the raster has pixels: by how many px a place is inside, along rows or columns."""
    away = np.abs(col / SIZE[0] - 0.5) + np.abs(row / SIZE[1] - 0.5)
    return (0.45 - away) * min(SIZE)


def placed(
    pixels: np.ndarray, mask: np.ndarray | None, path: Path, *, crs: str = "EPSG:32617",
    corner: tuple[float, float] | None = None, step: float | None = None, cog: bool = True,
) -> Path:  # fmt: skip
    """COG, or plain TIFF, of (bands, rows, cols); its place by default that of `LEFT_TOP`."""
    plain, (left, top) = path.with_suffix(".plain.tif"), corner or LEFT_TOP[crs]
    step = step or PIXEL[crs]
    bands, rows, cols = pixels.shape
    with (
        rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True),
        rasterio.open(
            plain, "w", driver="GTiff", width=cols, height=rows, count=bands, dtype=pixels.dtype,
            crs=crs, transform=Affine(step, 0, left, 0, -step, top), tiled=True, blockxsize=256,
            blockysize=256,
        ) as ds,
    ):  # fmt: skip
        ds.write(pixels)
        if mask is not None:
            ds.write_mask(mask)
    if not cog:
        plain.rename(path)
        return path
    rasterio.shutil.copy(
        plain, path, driver="COG", compress="deflate", blocksize=256, overview_resampling="average"
    )
    plain.unlink()
    return path


def wave_raster(path: Path, crs: str = "EPSG:32617", *, masked: bool = True) -> Path:
    """The colours by place, in a diamond if masked."""
    col, row = np.meshgrid(np.arange(SIZE[0]) + 0.5, np.arange(SIZE[1]) + 0.5)
    pixels = np.rint(colours(col, row)).astype(np.uint8).transpose(2, 0, 1)
    mask = np.where(diamond(col, row) > 0, 255, 0).astype(np.uint8)
    if not masked:
        return placed(pixels, None, path, crs=crs)
    return placed(pixels * (mask > 0), mask, path, crs=crs)


def make_project(folder: Path) -> Project:
    """A project without photos, whose products are written by the test."""
    project = Project.create(folder, {"project": {"name": "Straße & <road>"}})
    project.prepare()
    # makes the database, as any tool does
    assert project.database.count("photo") == 0
    return project


def run_export(
    project: Project, name: str, feedback: CollectingFeedback | None = None, **values: object
) -> Result:
    tool = TOOLS[name]
    feedback = feedback or CollectingFeedback()
    return tool().run(Context(project=project), tool.Parameters(**values), feedback)


def export(project: Project, name: str, **values: object) -> Path:
    target = Path(run_export(project, name, **values).outputs["target"])
    assert [p.name for p in target.parent.iterdir() if ".part" in p.name] == []
    return target


def folder_tiles(folder: Path) -> dict[tuple[int, int, int], bytes]:
    """Tiles of a folder by zoom, column and row from the north."""
    ending = json.loads((folder / "metadata.json").read_text("utf-8"))["format"]
    return {
        (int(path.parts[-3]), int(path.parts[-2]), int(path.stem)): path.read_bytes()
        for path in folder.glob(f"*/*/*.{ending}")
    }


def decoded(data: bytes) -> np.ndarray:
    """RGBA of a tile, by its first bytes as map programs do."""
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if image.shape[2] == 3:
        image = np.dstack([image, np.full(image.shape[:2], 255, np.uint8)])
    return cv2.cvtColor(image, cv2.COLOR_BGRA2RGBA)


def lonlat_of(zoom: int, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Degrees of places in tiles from the north-west corner, by the formula of OpenStreetMap."""
    lon = x / 2**zoom * 360.0 - 180.0
    lat = np.degrees(np.arctan(np.sinh(np.pi * (1 - 2 * y / 2**zoom))))
    return lon, lat


def colrow_of(path: Path, lon: np.ndarray, lat: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Outer-corner pixel coordinates of degrees by GDAL."""
    with rasterio.open(path) as ds:
        x, y = transform("EPSG:4326", ds.crs, lon.ravel(), lat.ravel())
        t = ~ds.transform
    x, y = np.array(x), np.array(y)
    col, row = t.a * x + t.c, t.e * y + t.f
    return col.reshape(lon.shape), row.reshape(lon.shape)


def seen(
    path: Path, tiles: dict[tuple[int, int, int], bytes], zoom: int
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Of each tile of a zoom: columns and rows of its pixel centres in the raster, and RGBA."""
    for (z, x, y), data in tiles.items():
        if z == zoom:
            rgba = decoded(data)
            along = (np.arange(len(rgba)) + 0.5) / len(rgba)
            lon, lat = lonlat_of(z, *np.meshgrid(x + along, y + along))
            yield *colrow_of(path, lon, lat), rgba


def misplacement(col: np.ndarray, row: np.ndarray, rgb: np.ndarray) -> np.ndarray:
    """Least-squares shift of pixels against the raster, px of the raster (2,)."""
    left = slopes(col, row).reshape(-1, 2)
    right = (rgb.astype(float) - colours(col, row)).ravel()
    return np.linalg.lstsq(left, right, rcond=None)[0]
