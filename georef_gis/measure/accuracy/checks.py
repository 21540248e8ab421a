"""What stands against an accuracy statement: bias, few or ill-placed points, a poor survey."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from georef_gis.frames import Array
from georef_gis.measure.accuracy.product import (
    CAP,
    MINIMUM,
    Assessment,
    CheckResidual,
    Component,
)
from georef_gis.measure.accuracy.statistics import LEVEL, MEAN_SHARE, AxisStatistics

# Share of the points that each quadrant should hold, and least spacing as a share of the diagonal
# (NSSDA, FGDC-STD-007.3-1998, 3.2.2)
QUADRANT_SHARE, SPACING_SHARE = 0.20, 0.10
# Share of the site's diagonal within which a check point is said to lie at a control point. The
# standard says "away from" only.
CONTROL_SHARE = 0.02
_QUADRANTS = ("north-east", "north-west", "south-west", "south-east")
_AXIS = {"x": ("X", "east"), "y": ("Y", "north"), "z": ("Z", "height")}

# (left, bottom, right, top), m on the map
Extent = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Flag:
    """Something to investigate or to know; `code` is for programs, `text` one line for people."""

    code: str
    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Distribution:
    """How check points lie over a site.

    Parameters
    ----------
    quadrants
        Points in the north-east, north-west, south-west and south-east.
    spacing
        Least distance between two of them, as a share of the site's diagonal; NaN for one.
    outside
        Points that lie outside of the site.
    of_site
        Whether the extent is the site's; else it is that of the points themselves, and tells
        nothing of what they leave out.
    """

    n: int
    quadrants: tuple[int, int, int, int]
    spacing: float
    diagonal: float
    outside: int
    of_site: bool

    @property
    def is_even(self) -> bool:
        """Whether every quadrant holds its share."""
        return self.n > 0 and min(self.quadrants) / self.n >= QUADRANT_SHARE

    @property
    def is_spaced(self) -> bool:
        """Whether no two points lie closer than a tenth of the diagonal."""
        return not self.spacing < SPACING_SHARE


def distribution(xy_map: ArrayLike, extent: Extent | None = None) -> Distribution | None:
    """Distribution of places over an extent, by default their own; (n, 2) m; None without places.

    Places that are not known (NaN) are left out.
    """
    xy = np.asarray(xy_map, float).reshape(-1, 2)
    xy = xy[np.all(np.isfinite(xy), axis=1)]
    if not len(xy):
        return None
    box = extent or (*xy.min(axis=0), *xy.max(axis=0))
    left, bottom, right, top = (float(value) for value in box)
    east, north = xy[:, 0] >= (left + right) / 2, xy[:, 1] >= (bottom + top) / 2
    inside = (xy[:, 0] >= left) & (xy[:, 0] <= right) & (xy[:, 1] >= bottom) & (xy[:, 1] <= top)
    kinds = (east & north, ~east & north, ~east & ~north, east & ~north)
    diagonal = math.hypot(right - left, top - bottom)
    return Distribution(
        n=len(xy),
        quadrants=tuple(int(np.sum(kind & inside)) for kind in kinds),  # type: ignore[arg-type]
        spacing=_least_distance(xy) / diagonal if len(xy) > 1 and diagonal > 0 else math.nan,
        diagonal=diagonal,
        outside=int(np.sum(~inside)),
        of_site=extent is not None,
    )


def _least_distance(xy: Array) -> float:
    off = np.linalg.norm(xy[:, None] - xy[None], axis=-1)
    return float(off[~np.eye(len(xy), dtype=bool)].min())


def distance_to_control(xy_map: ArrayLike, control_map: ArrayLike) -> Array:
    """Distance of places from the nearest control point, m; (n, 2) -> (n,), inf for none."""
    xy = np.asarray(xy_map, float).reshape(-1, 2)
    control = np.asarray(control_map, float).reshape(-1, 2)
    if not len(control):
        return np.full(len(xy), math.inf)
    return np.asarray(np.linalg.norm(xy[:, None] - control[None], axis=-1).min(axis=1))


def flags_of(assessment: Assessment) -> list[Flag]:
    """What the residuals themselves give cause to say."""
    out: list[Flag] = []
    for axis in assessment.axes.values():
        out += _axis_flags(axis)
    for component in assessment.components:
        if component.name != "3D" and not component.vegetated:
            out += _component_flags(component)
    return [*out, *_reading_flags(assessment)]


def _axis_flags(axis: AxisStatistics) -> Iterator[Flag]:
    letter, word = _AXIS[axis.axis]
    yield from _mean_flags(axis, letter, word)
    if axis.blunders:
        names = ", ".join(axis.blunders)
        yield Flag(
            code=f"blunder_{axis.axis}",
            text=f"error in {letter} above 3 x target RMSE at {names}; investigate, do not "
            "just leave out (7.2)",
        )
    if axis.outliers:
        names = ", ".join(axis.outliers)
        yield Flag(code=f"outlier_{axis.axis}", text=f"outlier in {letter} (robust z) at {names}")
    if axis.normality_p < LEVEL:
        yield Flag(
            code=f"not_normal_{axis.axis}",
            text=f"errors in {letter} do not look normally distributed (Shapiro-Wilk p = "
            f"{axis.normality_p:.2g}, skewness {axis.skewness:+.2f}); the standard assumes it",
        )


def _mean_flags(axis: AxisStatistics, letter: str, word: str) -> Iterator[Flag]:
    reference = "RMSE found" if axis.target is None else "target RMSE"
    told = f"mean error in {letter} ({word}) {axis.mean:+.3f} m is {axis.mean_share:.0%} of the "
    tested = f"t = {axis.t:.2f}, p = {axis.p:.2g}, n = {axis.n}" if axis.n > 1 else "n = 1"
    if axis.is_biased:
        kind = "a systematic error" if axis.is_significant else "chance alone may give it"
        yield Flag(
            code=f"bias_{axis.axis}",
            text=f"{told}{reference}, more than {MEAN_SHARE:.0%} ({tested}, {kind}); "
            "investigate the cause and report it (7.2)",
        )
    elif axis.is_significant:
        yield Flag(code=f"mean_{axis.axis}", text=f"{told}{reference} but not by chance ({tested})")


def _component_flags(c: Component) -> Iterator[Flag]:
    word = "horizontal" if c.name == "H" else "vertical"
    if c.n == 0:
        yield Flag(code=f"no_checks_{c.name}", text=f"no check point tests the {word} accuracy")
        return
    if c.n < MINIMUM:
        yield Flag(code=f"few_{c.name}", text=f"{c.n} {word} check points, fewer than {MINIMUM}")
    if c.n > CAP:
        yield Flag(
            code=f"many_{c.name}",
            text=f"{c.n} check points, while the standard asks for {CAP} at most",
        )
    yield from _class_flags(c, word)
    yield from _survey_flags(c, word)


def _class_flags(c: Component, word: str) -> Iterator[Flag]:
    if c.target is None:
        yield Flag(
            code=f"class_afterwards_{c.name}",
            text=f"no {word} class was declared before the test; the class named is derived from "
            "the result",
        )
    elif not c.meets:
        yield Flag(
            code=f"class_not_met_{c.name}",
            text=f"RMSE_{c.name} {c.rmse:.3f} m exceeds the declared class of {c.target:.3f} m",
        )


def _survey_flags(c: Component, word: str) -> Iterator[Flag]:
    if c.survey is None:
        yield Flag(
            code=f"survey_unknown_{c.name}",
            text=f"the {word} accuracy of the survey is not stated for every point, so its error "
            "is not counted in (7.11)",
        )
    elif 2.0 * c.survey > (c.target or c.rmse):
        yield Flag(
            code=f"survey_coarse_{c.name}",
            text=f"the {word} survey ({c.survey:.3f} m) is not twice as accurate as the product "
            f"({c.target or c.rmse:.3f} m) (7.12)",
        )


def _reading_flags(assessment: Assessment) -> Iterator[Flag]:
    """Points whose error of reading is not small against what is judged."""
    if assessment.kind == "intersections":
        return
    h = assessment.component("H")
    limit = (h.target or h.fit) / math.sqrt(2.0) / 2.0
    coarse = [r.name for r in assessment.residuals if math.isfinite(r.dx) and r.read_h > limit]
    if coarse:
        yield Flag(
            code="reading_coarse",
            text=f"the place in the product could be read no better than half of the accuracy "
            f"judged at {', '.join(coarse)}; the RMSE contains that error",
        )


def placement_flags(
    residuals: Sequence[CheckResidual], control_map: ArrayLike, extent: Extent | None
) -> list[Flag]:
    """What stands against the places of the check points (7.12, 7.13); control (k, 2) m."""
    xy = np.array([[r.x, r.y] for r in residuals]).reshape(-1, 2)
    spread = distribution(xy, extent)
    if not len(xy):
        return []
    if spread is None:
        return [
            Flag(
                code="distribution_unknown",
                text="the places of the check points are not known, so "
                "their distribution and distance from control cannot be told",
            )
        ]
    out = list(_spread_flags(spread))
    near = distance_to_control(xy, control_map) < CONTROL_SHARE * spread.diagonal
    if np.any(near):
        names = ", ".join(r.name for r, is_near in zip(residuals, near, strict=True) if is_near)
        out.append(
            Flag(
                code="near_control",
                text=f"check point {names} lies within "
                f"{CONTROL_SHARE * spread.diagonal:.1f} m of a control point (7.12)",
            )
        )
    return out


def _spread_flags(spread: Distribution) -> Iterator[Flag]:
    if not spread.of_site:
        yield Flag(
            code="extent_unknown",
            text="the extent of the site is not known, so the distribution is that within the "
            "check points' own extent",
        )
    if spread.outside:
        yield Flag(code="outside", text=f"{spread.outside} check points lie off the site")
    if not spread.is_even:
        pairs = zip(spread.quadrants, _QUADRANTS, strict=True)
        counts = ", ".join(f"{n} {name}" for n, name in pairs)
        yield Flag(
            code="uneven",
            text=f"check points are not well distributed ({counts}); each quadrant should hold "
            f"{QUADRANT_SHARE:.0%}",
        )
    if not spread.is_spaced:
        yield Flag(
            code="crowded",
            text=f"two check points lie within {spread.spacing:.1%} of the site's diagonal of each "
            f"other; {SPACING_SHARE:.0%} is asked for",
        )
