"""What it takes to cut a raster: the items of its metadata, and which pixels lie in an area."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from georef_gis.errors import InputError
from georef_gis.rasters.profile import Transform
from georef_gis.rasters.reading import _dataset


def dataset_items(path: Path) -> dict[str, str]:
    """Items of a raster's metadata, those in the file beside it included, as GDAL shows them.

    Raises
    ------
    InputError
        If it cannot be read as a raster.
    """
    with _dataset(path) as dataset:
        return {key: text for key, text in dataset.tags().items() if key != "AREA_OR_POINT"}


def items_or_none(path: Path) -> dict[str, str] | None:
    """As `dataset_items`; None of a file that is no raster."""
    try:
        return dataset_items(path)
    except InputError:
        return None


def pixels_inside(area: Any, transform: Transform, *, rows: int, cols: int) -> NDArray[np.bool_]:
    """Which pixels have their middle in a polygon, shape (rows, cols).

    Parameters
    ----------
    area
        Polygon or polygons of shapely, on the map.
    transform
        Grid to map, (0, 0) = outer corner.
    """
    from rasterio import Affine
    from rasterio.features import rasterize

    burnt = rasterize(
        [area], out_shape=(rows, cols), transform=Affine(*transform), dtype=np.uint8
    )  # fmt: skip
    return np.asarray(burnt > 0)
