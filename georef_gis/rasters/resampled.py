"""Bands of a map by window, as stored or resampled to the grid of another map."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from georef_gis.errors import CrsError, InputError
from georef_gis.rasters.profile import Transform
from georef_gis.rasters.reading import Window, _dataset, _one_line

# px of the target; GDAL's own 1/8 px would show as noise along edges
_TOLERANCE = 0.01
# px; an affine map is met at once, and 0 is not taken
_EXACT = 1e-6
UNMOVED: Transform = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class MapHeader:
    """What a map says of itself.

    Parameters
    ----------
    name
        Of the file.
    width, height
        px.
    transform
        Grid to map, (0, 0) = outer corner, CRS units per px.
    crs_wkt
        Empty if the file does not tell.
    epsg
        Code of the CRS when it has one.
    dtype
        Of the samples.
    bands
        Name of every band of values, without alpha; empty where the file gives none.
    scales
        Factor and offset of every band from samples to values.
    """

    name: str
    width: int
    height: int
    transform: Transform
    crs_wkt: str
    epsg: int | None
    dtype: str
    bands: tuple[str, ...]
    scales: tuple[tuple[float, float], ...]


class Bands:
    """An open map.

    Attributes
    ----------
    header
        Of the file, with the size and place of the grid it is read on.
    """

    def __init__(self, dataset: Any, header: MapHeader) -> None:
        self._dataset = dataset
        self._alpha = _alpha(dataset)
        self.header = header

    def read(self, window: Window, bands: Sequence[int]) -> tuple[NDArray[Any], NDArray[np.bool_]]:
        """Samples of some bands over a window inside the grid.

        Parameters
        ----------
        window
            Column and row of the upper left pixel, width, height, px.
        bands
            Counted from 1.

        Returns
        -------
        samples : shape (rows, cols, bands)
            As the file has them.
        valid : shape (rows, cols, bands)
            Where they have a value.

        Raises
        ------
        InputError
            If the file is damaged there.
        """
        from rasterio.errors import RasterioError
        from rasterio.windows import Window as GdalWindow

        part, wanted = GdalWindow(*window), list(bands)
        try:
            samples = self._dataset.read(wanted, window=part)
            valid = self._dataset.read_masks(wanted, window=part) > 0
            # GDAL takes alpha for a mask in files of two or four bands only
            if self._alpha:
                valid &= self._dataset.read(self._alpha, window=part) > 0
        except RasterioError as error:
            raise InputError(
                f"cannot be read at {window} px ({_one_line(error)}); check that it is whole",
                source=self.header.name,
            ) from error
        if samples.dtype.kind == "f":
            valid &= np.isfinite(samples)
        return np.ascontiguousarray(np.moveaxis(samples, 0, 2)), np.moveaxis(valid, 0, 2)


@contextmanager
def open_bands(path: str | os.PathLike[str]) -> Iterator[Bands]:
    """Open a map as stored.

    Raises
    ------
    InputError
        If it cannot be read, or has no place.
    """
    with _dataset(path) as dataset:
        yield Bands(dataset, _header(dataset, path))


@contextmanager
def open_bands_on(
    path: str | os.PathLike[str], grid: MapHeader, *, moved: Transform = UNMOVED
) -> Iterator[Bands]:
    """Open a map as if it lay on the grid of another one: bilinear, or averaged where finer.

    Parameters
    ----------
    grid
        Of the other map.
    moved
        Pixel of the grid, (0, 0) = outer corner -> pixel where this map, placed as it says,
        shows the same: ``(a, b, c, d, e, f)`` as in a transform.

    Raises
    ------
    InputError
        If it cannot be read, or has no place.
    CrsError
        If only one of the two has a CRS, or there is no way between them.
    """
    with _dataset(path) as dataset:
        header = _header(dataset, path)
        transform = _composed(grid.transform, moved)
        with _warped(dataset, header, grid, transform, (grid.width, grid.height)) as warped:
            yield Bands(warped, _on(header, grid))


def coarse_valid(
    path: str | os.PathLike[str], grid: MapHeader, *, most: int = 512
) -> NDArray[np.bool_]:
    """Where a map has a picture, over the grid of another one, no side longer than `most` px.

    Raises
    ------
    InputError, CrsError
        As `open_bands_on`.
    """
    import rasterio

    step = max(1.0, max(grid.width, grid.height) / most)
    cols, rows = (max(1, round(side / step)) for side in (grid.width, grid.height))
    transform = _composed(
        grid.transform, (grid.width / cols, 0.0, 0.0, 0.0, grid.height / rows, 0.0)
    )
    with _dataset(path) as whole, rasterio.open(path, **_overview(whole, step)) as dataset:
        header = _header(whole, path)
        with _warped(dataset, header, grid, transform, (cols, rows), nearest=True) as warped:
            every = range(1, len(header.bands) + 1)
            valid = Bands(warped, header).read((0, 0, cols, rows), every)[1]
    return np.asarray(valid.any(axis=2))


def _overview(dataset: Any, step: float) -> dict[str, int]:
    """Option of GDAL for the coarsest overview that is fine enough for every `step` px."""
    factors = dataset.overviews(1)
    fine = [level for level, factor in enumerate(factors) if factor <= step / 2]
    return {"overview_level": fine[-1]} if fine else {}


@contextmanager
def _warped(
    dataset: Any,
    header: MapHeader,
    grid: MapHeader,
    transform: Transform,
    size: tuple[int, int],
    *,
    nearest: bool = False,
) -> Iterator[Any]:
    from rasterio import Affine
    from rasterio.enums import Resampling
    from rasterio.errors import CRSError, RasterioError
    from rasterio.vrt import WarpedVRT

    if bool(header.crs_wkt) != bool(grid.crs_wkt):
        without, other = (grid, header) if header.crs_wkt else (header, grid)
        raise CrsError(f"has no CRS, {other.name} has one; give it one", source=without.name)
    crs = grid.crs_wkt or None
    try:
        warped = WarpedVRT(
            dataset,
            **({"crs": crs} if crs else {"src_crs": "EPSG:3857", "crs": "EPSG:3857"}),
            transform=Affine(*transform), width=size[0], height=size[1],
            resampling=Resampling.nearest if nearest else Resampling.bilinear,
            tolerance=_EXACT if crs == header.crs_wkt else _TOLERANCE,
            **_missing(dataset, header),
        )  # fmt: skip
    except (CRSError, RasterioError) as error:
        raise CrsError(
            f"cannot be brought to the grid of {grid.name} ({_one_line(error)}); check both CRS",
            source=header.name,
        ) from error
    with warped:
        yield warped


def _missing(dataset: Any, header: MapHeader) -> dict[str, Any]:
    """How a warped map tells missing pixels: as its file does, else by an alpha of its own."""
    if _alpha(dataset):
        return {}
    nodata = dataset.nodata
    if nodata is None and header.dtype.startswith("float"):
        nodata = np.nan
    masked = "per_dataset" in {flag.name for flag in dataset.mask_flag_enums[0]}
    if nodata is None or masked:
        return {"add_alpha": True}
    return {"src_nodata": nodata, "nodata": nodata}


def _alpha(dataset: Any) -> int | None:
    """Number of the alpha band, if there is one."""
    from rasterio.enums import ColorInterp

    kinds = list(dataset.colorinterp)
    return kinds.index(ColorInterp.alpha) + 1 if ColorInterp.alpha in kinds else None


def _header(dataset: Any, path: str | os.PathLike[str]) -> MapHeader:
    from rasterio.enums import ColorInterp

    name = Path(path).name
    if dataset.transform.is_identity:
        raise InputError(
            "has no geotransform, so its place is unknown; give a georeferenced file", source=name
        )
    kept = [i for i, kind in enumerate(dataset.colorinterp) if kind != ColorInterp.alpha]
    return MapHeader(
        name=name,
        width=dataset.width,
        height=dataset.height,
        transform=tuple(dataset.transform)[:6],
        crs_wkt=dataset.crs.to_wkt() if dataset.crs else "",
        epsg=dataset.crs.to_epsg() if dataset.crs else None,
        dtype=str(np.result_type(*(dataset.dtypes[i] for i in kept))),
        bands=tuple(dataset.descriptions[i] or "" for i in kept),
        scales=tuple((dataset.scales[i], dataset.offsets[i]) for i in kept),
    )


def _on(header: MapHeader, grid: MapHeader) -> MapHeader:
    return replace(
        header, width=grid.width, height=grid.height, transform=grid.transform,
        crs_wkt=grid.crs_wkt, epsg=grid.epsg,
    )  # fmt: skip


def _composed(outer: Transform, inner: Transform) -> Transform:
    """The transform that does `inner` first."""
    matrix = np.vstack([np.reshape(outer, (2, 3)), [0.0, 0.0, 1.0]])
    matrix = matrix @ np.vstack([np.reshape(inner, (2, 3)), [0.0, 0.0, 1.0]])
    a, b, c, d, e, f = matrix[:2].ravel().tolist()
    return a, b, c, d, e, f
