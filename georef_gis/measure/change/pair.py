"""Two maps of one site, read on a common grid of cells."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from georef_gis.errors import CrsError, GeometryError, InputError
from georef_gis.geodesy import CRS, metres_per_unit
from georef_gis.rasters.profile import Transform
from georef_gis.rasters.reading import Window
from georef_gis.rasters.resampled import (
    UNMOVED,
    Bands,
    MapHeader,
    coarse_valid,
    open_bands,
    open_bands_on,
)

Image = NDArray[np.float32]

# cells that a site may have, and the fewest that a side must have for shifts to be found
MOST_CELLS, LEAST_SIDE = 400_000_000, 96
# m per degree of latitude
_DEGREE = 111_320.0
# windows from which the white of other types than bytes is learned, their side, and the part of
# their samples below it
_WHITE_WINDOWS, _WHITE_SIDE, _WHITE_PART = 5, 128, 0.995
# colours that a map of this many bands has in its first three
_COLOURS = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class Cells:
    """The common grid.

    Parameters
    ----------
    header
        Of the grid; its cells take the place of pixels.
    metres
        Side of a cell on the ground, m.
    unit
        Metres per unit of the map.
    shared
        Part of the grid that both maps show.
    """

    header: MapHeader
    metres: float
    unit: float
    shared: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Views:
    """The same window of both maps.

    Parameters
    ----------
    later, earlier : shape (rows, cols, channels)
        0 = black to about 1 = white.
    valid : shape (rows, cols)
        Where both show the ground.
    """

    later: Image
    earlier: Image
    valid: NDArray[np.bool_]


@dataclass(frozen=True, slots=True, kw_only=True)
class MapPair:
    """Both maps, open on the grid.

    Parameters
    ----------
    colour
        Whether both have colours to compare, in the order red, green, blue.
    whites
        Samples that count as 1, of the later and the earlier map.
    """

    later: Bands
    earlier: Bands
    header: MapHeader
    colour: bool
    whites: tuple[float, float]

    def read(self, window: Window) -> Views:
        """A window of the grid: column, row, width, height."""
        first, valid = self._one(self.later, window, self.whites[0])
        second, seen = self._one(self.earlier, window, self.whites[1])
        return Views(later=first, earlier=second, valid=valid & seen)

    def _one(self, bands: Bands, window: Window, white: float) -> tuple[Image, NDArray[np.bool_]]:
        numbers = band_numbers(bands.header)
        samples, valid = bands.read(window, numbers)
        values = samples.astype(np.float32) / np.float32(white)
        if not self.colour and len(numbers) > 1:
            values = values.mean(axis=2, keepdims=True)
        return np.nan_to_num(values, copy=False), np.asarray(valid.all(axis=2))


def band_numbers(header: MapHeader) -> list[int]:
    """Bands that are compared: three colours, or the first of fewer."""
    return [1, 2, 3] if len(header.bands) >= _COLOURS else [1]


def gsd_of(path: Path) -> float:
    """Ground sample distance of a map, m.

    Raises
    ------
    InputError
        If it cannot be read, or has no place.
    """
    with open_bands(path) as bands:
        a, b, _, d, e, _ = bands.header.transform
        side = math.sqrt(abs(a * e - b * d))
        wkt = bands.header.crs_wkt
    crs = CRS.from_wkt(wkt) if wkt else None
    if crs is None or crs.is_projected:
        return side * (metres_per_unit(crs) if crs is not None else 1.0)
    return side * _DEGREE


def common_cells(later: Path, earlier: Path, cell: float) -> Cells:
    """Grid over the ground that both maps show, in the CRS of the later one.

    Parameters
    ----------
    cell
        Side of a cell, m.

    Raises
    ------
    InputError
        If a map cannot be read, or so small a cell makes too many.
    CrsError
        If the CRS of the later map is not projected, or there is no way between the two.
    GeometryError
        If they share no ground, or too little.
    """
    with open_bands(later) as bands:
        header = bands.header
    a, b, left, d, e, top = header.transform
    if b != 0.0 or d != 0.0 or a <= 0.0 or e >= 0.0:
        raise InputError("is not a north-up map; give a GeoTIFF that is", source=later.name)
    unit = _unit(header)
    both = _shown(later, header) & _shown(earlier, header)
    rows, cols = np.nonzero(both)
    if not len(rows):
        raise GeometryError(
            f"{later.name} and {earlier.name} show no common ground; check their CRS and places"
        )
    across, down = header.width * a / both.shape[1], header.height * e / both.shape[0]
    x0, x1 = left + cols.min() * across, left + (cols.max() + 1) * across
    y1, y0 = top + rows.min() * down, top + (rows.max() + 1) * down
    side = cell / unit
    c0, r1 = math.floor(x0 / side), math.ceil(y1 / side)
    width, height = math.ceil(x1 / side) - c0, r1 - math.floor(y0 / side)
    if width * height > MOST_CELLS:
        raise InputError(
            f"{cell:g} m makes {width} x {height} cells, {MOST_CELLS:.0e} may be; give more",
            field="cell",
        )
    if min(width, height) < LEAST_SIDE:
        raise GeometryError(
            f"{later.name} and {earlier.name} share {width * cell:.1f} x {height * cell:.1f} m of "
            f"ground, {LEAST_SIDE * cell:.1f} m each way are needed; give a smaller --cell"
        )
    transform: Transform = (side, 0.0, c0 * side, 0.0, -side, r1 * side)
    grid = replace(header, width=width, height=height, transform=transform)
    shared = float(both[rows.min() : rows.max() + 1, cols.min() : cols.max() + 1].mean())
    return Cells(header=grid, metres=cell, unit=unit, shared=shared)


def _unit(header: MapHeader) -> float:
    crs = CRS.from_wkt(header.crs_wkt) if header.crs_wkt else None
    if crs is None:
        return 1.0
    if not crs.is_projected:
        raise CrsError(
            "is not in a projected CRS, so shifts and areas have no metres; warp it to one",
            source=header.name,
        )
    return float(metres_per_unit(crs))


def _shown(path: Path, header: MapHeader) -> NDArray[np.bool_]:
    return coarse_valid(path, header)


def coarser(header: MapHeader, factor: int) -> MapHeader:
    """The grid with cells a whole number of times longer."""
    a, b, left, d, e, top = header.transform
    return replace(
        header, width=max(1, header.width // factor), height=max(1, header.height // factor),
        transform=(a * factor, b, left, d, e * factor, top),
    )  # fmt: skip


@contextmanager
def open_pair(
    later: Path, earlier: Path, header: MapHeader, *, moved: Transform = UNMOVED
) -> Iterator[MapPair]:
    """Open both maps on a grid.

    Parameters
    ----------
    moved
        Cell of the grid -> cell where the earlier map shows the same.

    Raises
    ------
    InputError, CrsError
        If one of them cannot be read, or be brought to the grid.
    """
    with ExitStack() as stack:
        first = stack.enter_context(open_bands_on(later, header))
        second = stack.enter_context(open_bands_on(earlier, header, moved=moved))
        both = [len(band_numbers(one.header)) == _COLOURS for one in (first, second)]
        # of the files, so that grids of any cell have the same
        whites = (_white(later), _white(earlier))
        yield MapPair(later=first, earlier=second, header=header, colour=all(both), whites=whites)


def _white(path: Path) -> float:
    """Sample that counts as white: the largest of a byte, else what nearly all lie below."""
    with open_bands(path) as bands:
        header, found = bands.header, []
        if header.dtype == "uint8":
            return 255.0
        width, height = min(_WHITE_SIDE, header.width), min(_WHITE_SIDE, header.height)
        for part in np.linspace(0.05, 0.95, _WHITE_WINDOWS):
            for other in np.linspace(0.05, 0.95, _WHITE_WINDOWS):
                col, row = int(part * (header.width - width)), int(other * (header.height - height))
                samples, valid = bands.read((col, row, width, height), band_numbers(header))
                found.append(samples[valid])
    values = np.concatenate(found)
    white = float(np.quantile(values, _WHITE_PART)) if len(values) else 0.0
    return white if white > 0.0 else 1.0
