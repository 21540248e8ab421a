"""Sheets along a centre line: the line of a flight, the ground of each sheet, what a mosaic covers.

All lengths are in units of the map. Chainage is the distance along the line from its start, on
the map.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.spatial import cKDTree
from shapely.ops import substring

from georef_gis.errors import GeometryError, InputError
from georef_gis.frames import Array

MOST_SHEETS = 10_000
# of a length; ends and corners so near each other are one
_SAME = 1e-9
# rad; an arc round a corner of the line has a vertex at least every so often
_ARC = math.radians(5.0)
# of a photo's reach: positions are thinned to, the line is simplified by
_THIN, _SIMPLE = 0.25, 0.25
_ROUNDS = 3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sheet:
    """Ground of a sheet.

    Parameters
    ----------
    number
        Place along the line, from 1.
    start, end
        Chainage.
    area
        Polygon; all ground whose nearest place on the line has a chainage from `start` to `end`.
    """

    number: int
    start: float
    end: float
    area: Any


def spans(total: float, length: float, overlap: float) -> list[tuple[float, float]]:
    """Chainage from and to of sheets `length` long, the last one shorter, along a line.

    Raises
    ------
    InputError
        If sheets would not advance, or be too many.
    """
    step = length - overlap
    if step <= _SAME * length:
        raise InputError(
            "is not less than the length of a sheet; give a smaller one", field="overlap"
        )
    needed = (total - overlap) / step
    if needed > MOST_SHEETS:
        raise InputError(
            f"would make {needed:.0f} sheets, more than {MOST_SHEETS}; give longer ones",
            field="length",
        )
    count = max(1, math.ceil(needed - _SAME))
    found = [(k * step, min(k * step + length, total)) for k in range(count)]
    found[-1] = (found[-1][0], total)
    return found


def cut_sheets(line: Any, parts: Sequence[tuple[float, float]], width: float) -> Iterator[Sheet]:
    """Sheets of chainages along a line, `width` across; together without a gap, ends cut square."""
    xy = _vertices(line)
    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(xy, axis=0).T))])
    for number, (start, end) in enumerate(parts, start=1):
        area = _area(xy, s, (start, end), 0.5 * width)
        yield Sheet(number=number, start=start, end=end, area=area)


def _vertices(line: Any) -> Array:
    """Vertices (n, 2) of a line, none of which is the one before."""
    xy = shapely.get_coordinates(line)
    moved = np.hypot(*np.diff(xy, axis=0).T) > 0.0
    return np.asarray(xy[np.concatenate([[True], moved])], dtype=np.float64)


def _area(xy: Array, s: Array, span: tuple[float, float], half: float) -> Any:
    """Ground nearest to a part of a line: a rectangle along each side, a sector at each corner."""
    start, end = span
    first = max(int(np.searchsorted(s, start, side="right")) - 1, 0)
    last = min(int(np.searchsorted(s, end, side="left")), len(s) - 1)
    parts = []
    for k in range(first, last):
        side = (xy[k + 1] - xy[k]) / (s[k + 1] - s[k])
        a, b = max(start, s[k]) - s[k], min(end, s[k + 1]) - s[k]
        across = half * np.array([-side[1], side[0]])
        p, q = xy[k] + a * side, xy[k] + b * side
        parts.append(shapely.polygons([p + across, q + across, q - across, p - across]))
    # a corner where one sheet ends and the next begins belongs to both: else its sector to none
    near = _SAME * float(s[-1])
    corners = np.arange(1, len(s) - 1)
    inside = corners[(s[corners] >= start - near) & (s[corners] <= end + near)]
    parts += [_sector(xy[k - 1 : k + 2], half) for k in inside]
    return shapely.union_all(parts)


def _sector(corner: Array, half: float) -> Any:
    """Ground nearest to the middle one of three points of a line: on the outer side of the bend."""
    before, after = np.diff(corner, axis=0)
    turn = math.atan2(before[0] * after[1] - before[1] * after[0], float(before @ after))
    outer = np.array([before[1], -before[0]]) * (half / math.hypot(*before))
    if turn < 0.0:
        outer = -outer
    angles = np.linspace(0.0, turn, max(1, math.ceil(abs(turn) / _ARC)) + 1)
    c, n = np.cos(angles), np.sin(angles)
    arc = np.column_stack([c * outer[0] - n * outer[1], n * outer[0] + c * outer[1]])
    return shapely.polygons(np.vstack([corner[1:2], corner[1] + arc]))


def join_lines(lines: Sequence[Any]) -> Any:
    """One line of parts that meet end to end, in the direction of the first.

    Raises
    ------
    InputError
        If they do not make one line, or it has no length.
    """
    parts = [part for line in lines for part in getattr(line, "geoms", [line])]
    parts = [shapely.remove_repeated_points(part) for part in parts if part.length > 0.0]
    if not parts:
        raise InputError("the line has no length; draw one of two points at least")
    if len(parts) == 1:
        return parts[0]
    joined = shapely.line_merge(shapely.multilinestrings(parts))
    if joined.geom_type != "LineString":
        raise InputError(
            f"its {len(parts)} lines make {len(joined.geoms)} that do not meet; leave one in the "
            "file, or join them"
        )
    begin, end = (joined.project(shapely.Point(parts[0].coords[k])) for k in (0, 1))
    return joined if begin <= end else joined.reverse()


def centre_line(places: Array, reach: float, first: int) -> Any:
    """Middle of a flight, from the end where photo `first` lies; longer than the flight.

    A flight along a road, to and fro, straight or winding, has two ends: the photos that are
    farthest from each other by way of their neighbours. Between them the line is the mean of the
    positions across.

    Parameters
    ----------
    places : shape (n, 2)
        Positions of the photos on the map.
    reach
        From the middle of a photo to its farthest corner.

    Raises
    ------
    GeometryError
        If the photos lie apart, or all in one place.
    """
    cells = np.floor(places / (_THIN * reach)).astype(np.int64)
    owner = np.unique(cells, axis=0, return_inverse=True)[1].ravel()
    sums = np.column_stack([np.bincount(owner, weights=p) for p in places.T])
    nodes: Array = sums / np.bincount(owner)[:, None]
    along = _distance_along(nodes, 2.0 * reach)
    line, bin_length = None, 2.0 * reach
    for _ in range(_ROUNDS):
        line = _extended(_means(nodes, along, bin_length), 2.0 * bin_length)
        points = shapely.points(nodes)
        along = shapely.line_locate_point(line, points)
        # shorter bins than the flight is wide would make a zigzag
        bin_length = max(bin_length, 2.0 * float(shapely.distance(line, points).max()))
    line = shapely.simplify(line, _SIMPLE * reach)
    if line.project(shapely.Point(places[first])) > 0.5 * line.length:
        line = line.reverse()
    return line


def _distance_along(nodes: Array, link: float) -> Array:
    """Distance of each node from one end, by way of nodes not farther than `link` apart."""
    pairs = cKDTree(nodes).query_pairs(link, output_type="ndarray")
    lengths = np.hypot(*(nodes[pairs[:, 0]] - nodes[pairs[:, 1]]).T)
    n = len(nodes)
    graph = coo_array((lengths, (pairs[:, 0], pairs[:, 1])), shape=(n, n)).tocsr()
    groups = int(connected_components(graph, directed=False)[0])
    if groups > 1:
        raise GeometryError(
            f"the photos lie in {groups} groups that do not meet; give the centre line, --line FILE"
        )
    end = int(np.argmax(dijkstra(graph, directed=False, indices=0)))
    along: Array = dijkstra(graph, directed=False, indices=end)
    return along


def _means(nodes: Array, along: Array, length: float) -> Array:
    """Mean position in each bin of a distance, (n, 2)."""
    low, high = float(along.min()), float(along.max())
    bins = max(2, round((high - low) / length))
    number = np.minimum((along - low) * (bins / max(high - low, 1e-300)), bins - 1).astype(int)
    count = np.bincount(number, minlength=bins)
    sums = np.column_stack([np.bincount(number, weights=p, minlength=bins) for p in nodes.T])
    means: Array = sums[count > 0] / count[count > 0, None]
    if len(means) < 2:
        raise GeometryError(
            "the photos lie in one place, which has no main axis; give the line, --line FILE"
        )
    return means


def _extended(xy: Array, by: float) -> Any:
    """Line through points, longer by so much at both ends."""
    out = []
    for end, inner in ((xy[0], xy[1]), (xy[-1], xy[-2])):
        away = (end - inner) / np.hypot(*(end - inner))
        out.append(end + by * away)
    return shapely.linestrings(np.vstack([out[0], xy, out[1]]))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Cover:
    """Where a raster shows something, coarsely.

    Parameters
    ----------
    shown : shape (rows, cols)
        Whether a cell has a picture.
    left, top
        Corner of the first cell on the map.
    cell : (across, down)
        Size of a cell.
    """

    shown: NDArray[np.bool_]
    left: float
    top: float
    cell: tuple[float, float]

    @property
    def size(self) -> float:
        """Diagonal of a cell."""
        return math.hypot(*self.cell)

    def rim(self) -> Any:
        """Centres of the cells with a picture at its rim, as points; none if there is no cell."""
        grown = np.pad(self.shown, 1)
        inner = grown[:-2, 1:-1] & grown[2:, 1:-1] & grown[1:-1, :-2] & grown[1:-1, 2:]
        rows, cols = np.nonzero(self.shown & ~inner)
        return shapely.points(
            self.left + (cols + 0.5) * self.cell[0], self.top - (rows + 0.5) * self.cell[1]
        )

    def meets(self, line: Any) -> bool:
        """Whether a line runs over a cell with a picture."""
        rows, cols = self.shown.shape
        low = self.top - rows * self.cell[1]
        part = shapely.clip_by_rect(line, self.left, low, self.left + cols * self.cell[0], self.top)
        if part.is_empty:
            return False
        xy = shapely.get_coordinates(shapely.segmentize(part, 0.5 * min(self.cell)))
        col = np.clip(((xy[:, 0] - self.left) / self.cell[0]).astype(int), 0, cols - 1)
        row = np.clip(((self.top - xy[:, 1]) / self.cell[1]).astype(int), 0, rows - 1)
        return bool(self.shown[row, col].any())


def trimmed(line: Any, cover: Cover) -> Any:
    """The part of a line beside which there is a picture."""
    along = shapely.line_locate_point(line, cover.rim())
    if not along.size:
        return line
    low = max(float(along.min()) - cover.size, 0.0)
    return substring(line, low, min(float(along.max()) + cover.size, line.length))


def width_over(line: Any, cover: Cover) -> float:
    """Width of a strip, as much to the left as to the right of a line, that takes in the picture.

    Ground beyond the ends of the line does not count.
    """
    simple, rim = shapely.simplify(line, cover.size), cover.rim()
    along = shapely.line_locate_point(simple, rim)
    beside = (along > 0.0) & (along < simple.length)
    away = shapely.distance(simple, rim)[beside]
    # a cell for where its picture ends, one for what the line was simplified by
    return 2.0 * (float(away.max(initial=0.0)) + 2.0 * cover.size)


def gap_to(line: Any, cover: Cover) -> float:
    """Distance of a line from the nearest picture; 0 if it runs over it, inf if there is none."""
    if cover.meets(line):
        return 0.0
    away = shapely.distance(shapely.simplify(line, cover.size), cover.rim())
    return float(away.min(initial=math.inf))
