"""A large raster made small for pages and thumbnails; only as much of it is read as is shown."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from georef_gis.errors import InputError
from georef_gis.rasters.profile import Transform
from georef_gis.rasters.reading import _dataset


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Preview:
    """A reduced raster.

    Parameters
    ----------
    values : shape (rows, cols, bands)
        As the file has them.
    valid : shape (rows, cols), bool
        Where there is a picture.
    transform
        Grid of the preview to the map, (0, 0) = outer corner, CRS units per px.
    """

    values: NDArray[Any]
    valid: NDArray[np.bool_]
    transform: Transform

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Left, right, bottom, top on the map, CRS units."""
        a, _, c, _, e, f = self.transform
        rows, cols = self.valid.shape
        return c, c + a * cols, f + e * rows, f


def read_preview(
    path: str | os.PathLike[str], *, most: int = 1400, average: bool = True
) -> Preview:
    """Raster with no side longer than `most` px, from its overviews where it has some.

    Parameters
    ----------
    average
        Whether pixels are averaged; else the nearest counts, as for numbers of photos.

    Raises
    ------
    InputError
        If the file cannot be read as a raster, or is not north up.
    """
    from rasterio.enums import Resampling

    with _dataset(path) as dataset:
        step = max(1.0, max(dataset.width, dataset.height) / most)
        rows, cols = (max(1, round(side / step)) for side in (dataset.height, dataset.width))
        a, b, c, d, e, f = tuple(dataset.transform)[:6]
        if dataset.transform.is_identity or b != 0.0 or d != 0.0:
            raise InputError("is not a north-up map; give a GeoTIFF", source=os.fspath(path))
        how = Resampling.average if average else Resampling.nearest
        values = dataset.read(out_shape=(dataset.count, rows, cols), resampling=how)
        mask = dataset.dataset_mask(out_shape=(rows, cols), resampling=Resampling.nearest)
        size = dataset.width / cols, dataset.height / rows
    return Preview(
        values=np.ascontiguousarray(np.moveaxis(values, 0, 2)),
        valid=np.asarray(mask > 0),
        transform=(a * size[0], b, c, d, e * size[1], f),
    )
