"""Before the flight: lines over an area or along a road, and what the photos will be like."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import shapely
from numpy.typing import ArrayLike

from georef_gis.errors import GeometryError, InputError
from georef_gis.frames import Array
from georef_gis.model.camera import Camera

Across = Literal["width", "height"]

# of a footprint: how far lines and wind may be off before the rim of the area is missed
MARGIN = 0.1
# bases flown beyond each end of a line: the rim is then seen as often as the middle
RUN_IN = 1
# photos and lines beyond which a plan is a slip of a unit
MOST_PHOTOS = 100_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """How photos lie on level ground; m, s, px.

    Parameters
    ----------
    along, across
        Sides of a footprint along and across the line.
    base, spacing
        Between photos of a line, and between lines.
    interval
        Between exposures, s.
    """

    height: float
    speed: float
    gsd: float
    along: float
    across: float
    base: float
    spacing: float
    interval: float
    overlap: float
    sidelap: float

    def overlaps_over(self, relief: float) -> tuple[float, float]:
        """Overlap along and across lines over ground that stands `relief`, m, higher.

        Raises
        ------
        GeometryError
            If the ground reaches the flying height.
        """
        if relief >= self.height:
            raise GeometryError(
                f"ground {relief:.0f} m higher reaches the flying height of {self.height:.0f} m; "
                "fly higher, or correct the relief (m)"
            )
        scale = (self.height - relief) / self.height
        return 1.0 - self.base / (self.along * scale), 1.0 - self.spacing / (self.across * scale)

    def blur(self, exposure: float, *, rate: float = 0.0, focal: float = 0.0) -> float:
        """Pixels by which the picture moves during an exposure, s; rate in rad/s, focal in px."""
        return self.speed * exposure / self.gsd + rate * exposure * focal


def layout_of(
    camera: Camera, height: float, speed: float, *, overlap: float, sidelap: float,
    across: Across = "width",
) -> Layout:  # fmt: skip
    """Layout of a camera that looks straight down.

    Parameters
    ----------
    height, speed
        Above the ground, m; over the ground, m/s.
    overlap, sidelap
        Shares of a footprint, along and across lines.
    across
        Which side of the picture lies across the line.

    Raises
    ------
    InputError
        If a value is out of range.
    """
    for name, value in (("height", height), ("speed", speed)):
        if not (math.isfinite(value) and value > 0):
            raise InputError(f"{value} must be positive", field=name)
    for name, value in (("overlap", overlap), ("sidelap", sidelap)):
        if not 0.0 <= value < 1.0:
            raise InputError(f"{100 * value:.0f} % is not in 0 to 99", field=name)
    gsd = height / camera.fx
    width, depth = camera.width * gsd, camera.height * height / camera.fy
    if across == "height":
        width, depth = depth, width
    base, spacing = (1.0 - overlap) * depth, (1.0 - sidelap) * width
    return Layout(
        height=height, speed=speed, gsd=gsd, along=depth, across=width, base=base,
        spacing=spacing, interval=base / speed, overlap=overlap, sidelap=sidelap,
    )  # fmt: skip


# -- lines -------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlannedLine:
    """One line to fly.

    Parameters
    ----------
    name
        Number, for people.
    photos : shape (n, 2), m
        East and north of the exposures, in their order.
    headings : shape (n,), rad
        Clockwise from north.
    height : m
        Above the ground.
    """

    name: str
    photos: Array
    headings: Array
    height: float

    @property
    def length(self) -> float:
        """From the first to the last photo, m."""
        return float(np.sum(np.hypot(*np.diff(self.photos, axis=0).T)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Plan:
    """Lines in the order in which they are flown, and what the photos are like."""

    lines: tuple[PlannedLine, ...]
    layouts: tuple[Layout, ...]

    @property
    def photos(self) -> int:
        """Number of photos."""
        return sum(len(line.photos) for line in self.lines)

    @property
    def length(self) -> float:
        """Of all lines and the ways between them, m."""
        between = [
            float(np.hypot(*(after.photos[0] - before.photos[-1])))
            for before, after in zip(self.lines, self.lines[1:], strict=False)
        ]
        return sum(line.length for line in self.lines) + sum(between)


def plan_area(
    ring: ArrayLike, layout: Layout, *, heading: float | None = None, first: int = 1
) -> tuple[PlannedLine, ...]:
    """Parallel lines over an area.

    Parameters
    ----------
    ring : shape (n, 2), m
        Its corners, east and north.
    heading : rad
        Of the first line, clockwise from north; without one along the longer side of the area.
    first
        Number of the first line.

    Raises
    ------
    InputError
        If the corners enclose no area, or the plan has more than `MOST_PHOTOS` photos.
    """
    area = _polygon(ring)
    course = _longer_side(area) if heading is None else heading
    # in these axes lines run to the north
    turned = shapely.transform(area, lambda xy: xy @ _turn(course).T)
    left, _, right, _ = shapely.bounds(turned)
    count = _strips(right - left, layout)
    _refuse_too_many(area.area / (layout.base * layout.spacing) + count)
    lines: list[PlannedLine] = []
    for k in range(count):
        x = (left + right) / 2.0 + (k - (count - 1) / 2.0) * layout.spacing
        ends = _reach(turned, x, layout)
        if ends is None:
            continue
        y, way = _exposures(*ends, layout.base), course
        if len(lines) % 2:
            y, way = y[::-1], course + math.pi
        xy = np.column_stack([np.full(len(y), x), y]) @ _turn(course)
        lines.append(_straight(str(first + len(lines)), xy, way, layout))
    return tuple(lines)


def _straight(name: str, xy: Array, way: float, layout: Layout) -> PlannedLine:
    return PlannedLine(
        name=name, photos=xy, height=layout.height,
        headings=np.full(len(xy), way % (2.0 * math.pi)),
    )  # fmt: skip


def plan_corridor(
    centre: ArrayLike, width: float, layout: Layout, *, first: int = 1
) -> tuple[PlannedLine, ...]:
    """Lines along a road.

    Parameters
    ----------
    centre : shape (n, 2), m
        Its centre line, east and north.
    width : m
        To be covered, half on each side.

    Raises
    ------
    InputError
        If the line has no length, or the plan has more than `MOST_PHOTOS` photos.
    """
    xy = np.asarray(centre, dtype=np.float64).reshape(-1, 2)
    road = shapely.LineString(xy) if len(xy) > 1 else shapely.LineString()
    if not road.length > 0 or width <= 0:
        raise InputError("a corridor needs a centre line of some length and a width", field="line")
    count = _strips(width, layout)
    _refuse_too_many(count * (road.length / layout.base + 2))
    lines: list[PlannedLine] = []
    for k in range(count):
        off = (k - (count - 1) / 2.0) * layout.spacing
        path = _beside(road, off)
        if path is None:
            continue
        at = _exposures(0.0, path.length, layout.base, run_in=RUN_IN)
        photos, headings = _along(path, at)
        if len(lines) % 2:
            photos, headings = photos[::-1], headings[::-1] + math.pi
        lines.append(
            PlannedLine(
                name=str(first + len(lines)), photos=photos, height=layout.height,
                headings=headings % (2.0 * math.pi),
            )
        )  # fmt: skip
    return tuple(lines)


def crossing(ring: ArrayLike, layout: Layout, course: float, *, first: int) -> PlannedLine:
    """One line across an area at right angles to its lines, through the middle."""
    area = _polygon(ring)
    middle = shapely.get_coordinates(area.centroid)[0]
    turned = shapely.transform(area, lambda xy: (xy - middle) @ _turn(course + math.pi / 2).T)
    ends = _reach(turned, 0.0, layout) or (-layout.base, layout.base)
    y = _exposures(*ends, layout.base)
    way = course + math.pi / 2
    xy = np.column_stack([np.zeros(len(y)), y]) @ _turn(way) + middle
    return _straight(str(first), xy, way, layout)


def at_height(layout: Layout, height: float) -> Layout:
    """The same overlaps from another height, m."""
    scale = height / layout.height
    names = ("gsd", "along", "across", "base", "spacing", "interval")
    return replace(layout, height=height, **{n: getattr(layout, n) * scale for n in names})


def _strips(width: float, layout: Layout) -> int:
    """Number of lines that cover a width with the margin on both sides."""
    wanted = width + 2.0 * MARGIN * layout.across - layout.across
    count = 1 + math.ceil(max(wanted, 0.0) / layout.spacing - 1e-9)
    _refuse_too_many(count)
    return count


def _refuse_too_many(photos: float) -> None:
    if photos > MOST_PHOTOS:
        raise InputError(
            f"the plan would have some {photos:.0f} photos; check the units of area and height",
            field="height",
        )


def _reach(turned: Any, x: float, layout: Layout) -> tuple[float, float] | None:
    """South and north end of the part of an area that a line's strip covers; None if none."""
    half = layout.spacing / 2.0
    _, low, _, high = shapely.bounds(turned)
    strip = shapely.intersection(turned, shapely.box(x - half, low - 1.0, x + half, high + 1.0))
    if shapely.is_empty(strip):
        strip = shapely.intersection(
            turned,
            shapely.box(x - layout.across / 2, low - 1.0, x + layout.across / 2, high + 1.0),
        )
    if shapely.is_empty(strip):
        return None
    _, south, _, north = shapely.bounds(strip)
    return float(south) - RUN_IN * layout.base, float(north) + RUN_IN * layout.base


def _exposures(start: float, end: float, base: float, *, run_in: int = 0) -> Array:
    """Places of exposures from start to end at most a base apart, evenly."""
    steps = max(1, math.ceil((end - start) / base - 1e-9))
    at = np.linspace(start, end, steps + 1)
    step = at[1] - at[0]
    before = start - step * np.arange(run_in, 0, -1)
    after = end + step * np.arange(1, run_in + 1)
    return np.concatenate([before, at, after])


def _along(path: Any, at: Array) -> tuple[Array, Array]:
    """Places on a path and headings there; beyond its ends straight on."""
    inside = np.clip(at, 0.0, path.length)
    xy = shapely.get_coordinates(shapely.line_interpolate_point(path, inside))
    h = min(1.0, path.length / 2.0)
    low, high = np.clip(inside - h, 0.0, None), np.clip(inside + h, None, path.length)
    d = shapely.get_coordinates(shapely.line_interpolate_point(path, high))
    d = d - shapely.get_coordinates(shapely.line_interpolate_point(path, low))
    d = d / np.hypot(*d.T)[:, None]
    return xy + (at - inside)[:, None] * d, np.arctan2(d[:, 0], d[:, 1])


def _beside(road: Any, off: float) -> Any | None:
    """Line at a distance to the right of a road, in its direction; None where none is left."""
    if abs(off) < 1e-6:
        return road
    path = shapely.offset_curve(road, -off, join_style="round")
    parts = [part for part in shapely.get_parts(path) if part.length > 0]
    if not parts:
        return None
    longest = max(parts, key=lambda part: part.length)
    ends = shapely.get_coordinates(longest)
    start = shapely.get_coordinates(road)[0]
    # GEOS has turned offset curves round in some versions
    back = np.hypot(*(ends[0] - start)) > np.hypot(*(ends[-1] - start))
    return shapely.reverse(longest) if back else longest


def _polygon(ring: ArrayLike) -> Any:
    xy = np.asarray(ring, dtype=np.float64).reshape(-1, 2)
    if len(xy) < 3 or not np.all(np.isfinite(xy)):
        raise InputError("an area needs three corners or more", field="area")
    area = shapely.Polygon(xy)
    if not shapely.is_valid(area) or not area.area > 0.0:
        raise InputError(
            "the corners enclose no area, or the rim crosses itself; give them in order",
            field="area",
        )
    return area


def _longer_side(area: Any) -> float:
    """Azimuth of the longer side of the narrowest rectangle around an area, rad in [0, pi)."""
    box = shapely.get_coordinates(shapely.minimum_rotated_rectangle(area))
    sides = np.diff(box, axis=0)
    d = sides[int(np.argmax(np.hypot(*sides.T)))]
    return math.atan2(d[0], d[1]) % math.pi


def _turn(course: float) -> Array:
    """Rotation that takes a course, clockwise from north, to the north; on columns (2, 2)."""
    c, s = math.cos(course), math.sin(course)
    return np.array([[c, -s], [s, c]])


def headings_of(lines: Sequence[PlannedLine]) -> list[float]:
    """Usual heading of each line, rad."""
    return [float(np.median(line.headings)) for line in lines]
