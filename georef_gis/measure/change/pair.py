"""Two maps of one site, read on a common grid of cells."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from georef_gis.errors import CrsError, GeometryError, InputError
from georef_gis.geodesy import CRS, metres_per_unit
from georef_gis.measure.change.cell_map import CellMap, average_map, band_numbers, work_folder
from georef_gis.measure.change.extent import cells_of
from georef_gis.rasters.profile import Transform
from georef_gis.rasters.reading import Window
from georef_gis.rasters.resampled import UNMOVED, MapHeader, coarse_valid, open_bands

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
# cells about a window that moving it may need, part of a cell that must be shown
_RIM, _WHOLE = 4, 0.98
# cells of a move that are none
_NEAR = 0.1


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
    """Both maps on the cells of a grid, or on cells a whole number of times longer.

    Parameters
    ----------
    cells
        The grid that both maps were averaged on.
    colour
        Whether both have colours to compare, in the order red, green, blue.
    whites
        Samples that count as 1, of the later and the earlier map.
    earlier_path
        File of the earlier map.
    factor
        Cells of the grid along a cell that is read.
    moved
        Cell that is read, (0, 0) = outer corner -> such a cell where the earlier map shows the
        same.
    """

    later: CellMap
    earlier: CellMap
    earlier_path: Path
    cells: Cells
    colour: bool
    whites: tuple[float, float]
    factor: int = 1
    moved: Transform = UNMOVED

    @property
    def header(self) -> MapHeader:
        """Of the grid whose cells are read."""
        return coarser(self.cells.header, self.factor)

    @property
    def names(self) -> str:
        """Both maps, for messages."""
        return f"{self.later.name} and {self.earlier.name}"

    def seen(self, *, moved: Transform, factor: int = 1) -> MapPair:
        """The pair with the earlier map moved, and by cells so many times longer."""
        return replace(self, moved=moved, factor=factor)

    def read(self, window: Window) -> Views:
        """A window of the grid: column, row, width, height."""
        later, valid = self._one(self.later, window, self.whites[0])
        left = self._left()
        if self._farthest(left) < _NEAR:
            earlier, seen = self._one(self.earlier, window, self.whites[1])
        else:
            earlier, seen = self._moved(window, left)
        return Views(later=later, earlier=earlier, valid=valid & seen)

    def _one(self, one: CellMap, window: Window, white: float) -> tuple[Image, NDArray[np.bool_]]:
        by = self.factor
        col, row, width, height = (by * part for part in window)
        samples, valid = one.read((col, row, width, height))
        values = samples.astype(np.float32) / np.float32(white)
        if not self.colour and values.shape[2] > 1:
            values = values.mean(axis=2, keepdims=True)
        values = np.nan_to_num(values, copy=False)
        if by == 1:
            return values, valid
        shape = window[2], window[3]
        shown = cv2.resize(valid.astype(np.float32), shape, interpolation=cv2.INTER_AREA)
        values = cv2.resize(values, shape, interpolation=cv2.INTER_AREA)
        return np.asarray(values.reshape(window[3], window[2], -1), np.float32), shown > _WHOLE

    def _left(self) -> Transform:
        """What of the move is left to do, in cells that are read, as the earlier map is placed."""
        placed, moved = matrix_of(self.earlier.placed), matrix_of(self.moved)
        placed[:2, 2] /= self.factor
        a, b, c, d, e, f = np.linalg.solve(placed, moved)[:2].ravel().tolist()
        return a, b, c, d, e, f

    def _farthest(self, moved: Transform) -> float:
        """Cells by which a move takes a corner of the grid off, at most."""
        corners = np.array(
            [(x, y) for x in (0, self.header.width) for y in (0, self.header.height)]
        )
        off = corners @ (matrix_of(moved)[:2, :2] - np.eye(2)).T + matrix_of(moved)[:2, 2]
        return float(np.hypot(*off.T).max())

    def placed_anew(self) -> MapPair:
        """The pair with the earlier map averaged where it was moved to.

        Cells that lie between those of an average are made of several, and differ from an average
        by what is finer than they are.
        """
        if self._farthest(self._left()) < _NEAR:
            return self
        old = self.earlier
        new = average_map(
            self.earlier_path, self.cells.header, old.samples.with_name(f"{old.samples.stem}_anew"),
            placed=self.moved,
        )  # fmt: skip
        for path in (old.samples, old.shown):
            path.unlink(missing_ok=True)
        return replace(self, earlier=new)

    def _moved(self, window: Window, left: Transform) -> tuple[Image, NDArray[np.bool_]]:
        """The earlier map where it shows what the later one shows in a window."""
        a, b, c, d, e, f = left
        col, row, width, height = window
        x, y = (np.array([start, start + size]) for start, size in ((col, width), (row, height)))
        corners = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        there = corners @ np.array([[a, d], [b, e]]) + np.array([c, f])
        low = np.floor(there.min(axis=0)).astype(int) - _RIM
        high = np.ceil(there.max(axis=0)).astype(int) + _RIM
        part = (int(low[0]), int(low[1]), int(high[0] - low[0]), int(high[1] - low[1]))
        values, valid = self._one(self.earlier, part, self.whites[1])
        # of middles of cells in the window to middles of cells in the part
        linear = np.array([[a, b], [d, e]])
        offset = linear @ [col + 0.5, row + 0.5] + np.array([c, f]) - low - 0.5
        matrix = np.column_stack([linear, offset])
        flags = cv2.WARP_INVERSE_MAP
        moved = cv2.warpAffine(
            values, matrix, (width, height), flags=flags | cv2.INTER_CUBIC,
            borderMode=cv2.BORDER_REPLICATE,
        )  # fmt: skip
        shown = cv2.warpAffine(
            valid.astype(np.float32), matrix, (width, height), flags=flags | cv2.INTER_LINEAR
        )
        return np.asarray(moved.reshape(height, width, -1), np.float32), shown > _WHOLE


def matrix_of(moved: Transform) -> NDArray[np.float64]:
    """A transform as a matrix, shape (3, 3)."""
    return np.vstack([np.reshape(moved, (2, 3)), [0.0, 0.0, 1.0]])


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
    later: Path, earlier: Path, cells: Cells, *, most: float, work: Path | None = None,
    step: Callable[[float], None] = lambda _: None,
) -> Iterator[MapPair]:  # fmt: skip
    """Average both maps onto the cells, in files that are gone in the end.

    Parameters
    ----------
    most
        Largest shift that the earlier map is looked for at, m.
    work
        Folder for the files; by default the system's own.
    step
        Called with the part done; may raise to cancel.

    Raises
    ------
    InputError, CrsError
        If one of them cannot be read, or be brought to the grid.
    ExportError
        If the files cannot be written.
    """
    area = cells_of(earlier, cells.header, margin=math.ceil(most / cells.metres) + _RIM)
    with work_folder(work) as folder:
        first = average_map(later, cells.header, folder / "later", step=lambda part: step(part / 2))
        second = average_map(
            earlier, cells.header, folder / "earlier", area=area,
            step=lambda part: step(0.5 + part / 2),
        )  # fmt: skip
        # of the files, so that grids of any cell have the same
        whites = (_white(later), _white(earlier))
        colour = first.shape[2] == second.shape[2] == _COLOURS
        yield MapPair(
            later=first, earlier=second, earlier_path=earlier, cells=cells, colour=colour,
            whites=whites,
        )  # fmt: skip


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
