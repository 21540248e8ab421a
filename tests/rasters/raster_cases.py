"""Small rasters and the ways to write and read them back."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import rasterio

from georef_gis.rasters.profile import RasterProfile
from georef_gis.rasters.writer import TiledWriter

UTM_17N = rasterio.CRS.from_epsg(26917).to_wkt()


def make_profile(data: np.ndarray, **changes: Any) -> RasterProfile:
    """Profile for an array of (rows, cols, bands), 64 px tiles unless told."""
    values: dict[str, Any] = {
        "width": data.shape[1],
        "height": data.shape[0],
        "bands": data.shape[2],
        "dtype": str(data.dtype),
        "transform": (0.25, 0.0, 500_000.0, 0.0, -0.25, 4_400_000.0),
        "crs_wkt": UTM_17N,
        "tile_size": 64,
    }
    return RasterProfile(**{**values, **changes})


def write_tiles(
    writer: TiledWriter,
    data: np.ndarray,
    mask: np.ndarray | None,
    order: Iterable[tuple[int, int]] | None = None,
) -> None:
    """Give a writer all tiles of an array."""
    size = writer.profile.tile_size
    every = [(row, col) for row in range(writer.tile_rows) for col in range(writer.tile_cols)]
    for row, col in order or every:
        at = np.s_[row * size : (row + 1) * size, col * size : (col + 1) * size]
        writer.write_tile(row, col, data[at], None if mask is None else mask[at])


def write(
    path: Path, data: np.ndarray, mask: np.ndarray | None = None, **changes: Any
) -> RasterProfile:
    """Write an array as one file; `workers` and `bigtiff` go to the writer."""
    options = {key: changes.pop(key) for key in ("workers", "bigtiff") if key in changes}
    profile = make_profile(data, **changes)
    with TiledWriter(path, profile, **options) as writer:
        write_tiles(writer, data, mask)
    return profile


def read(path: Path, **options: Any) -> tuple[np.ndarray, np.ndarray]:
    """Samples (rows, cols, bands with alpha) and validity (rows, cols) as GDAL sees them."""
    with rasterio.open(path, **options) as dataset:
        return np.moveaxis(dataset.read(), 0, 2), dataset.dataset_mask() != 0


def smooth(rows: int, cols: int, bands: int, dtype: str = "uint8") -> np.ndarray:
    """A picture JPEG keeps well: gradients and waves."""
    y, x = np.mgrid[:rows, :cols].astype(np.float64)
    waves = [120 + 60 * np.sin(x / (23 + 7 * k) + k) + 50 * np.cos(y / 31) for k in range(bands)]
    values = np.stack(waves, axis=2)
    return (values if dtype == "float32" else values * (100 if "16" in dtype else 1)).astype(dtype)


def ellipse(rows: int, cols: int) -> np.ndarray:
    """A mask whose corners are empty and whose rim cuts through tiles."""
    y, x = np.mgrid[:rows, :cols]
    return ((x / cols - 0.5) ** 2 + (y / rows - 0.5) ** 2) < 0.2
