"""Accuracy of a product by check points: residuals, their statistics, RMSE with survey error.

ASPRS Positional Accuracy Standards for Digital Geospatial Data, Edition 2, Version 2 (2024);
sections are cited as in that standard, see `docs/accuracy_statement.md` for what was confirmed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from georef_gis.errors import InputError
from georef_gis.measure.accuracy.statistics import AxisStatistics, axis_statistics, rms

Kind = Literal["products", "intersections", "table"]
Cover = Literal["open", "vegetated"]
Case = Literal["tested", "reduced", "produced", "none"]
AXES = ("x", "y", "z")

# Check points below which the reduced statement is due, and above which no more are asked for.
MINIMUM, CAP = 30, 120


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckResidual:
    """Product minus survey at one check point, m; NaN where an axis was not tested.

    Parameters
    ----------
    dx, dy, dz
        East, north and up on the map, m.
    sigma_h, sigma_v
        One sigma of the survey, per axis, m; NaN if it is not stated.
    read_h, read_v
        One sigma of reading the product at the point, per axis, m; NaN if not known.
    x, y
        Surveyed place on the map, m; NaN if not known.
    cover
        What grows there: heights in vegetation are reported apart (VVA).
    """

    name: str
    dx: float = math.nan
    dy: float = math.nan
    dz: float = math.nan
    sigma_h: float = math.nan
    sigma_v: float = math.nan
    read_h: float = math.nan
    read_v: float = math.nan
    x: float = math.nan
    y: float = math.nan
    cover: Cover = "open"
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Targets:
    """Accuracy classes declared before the test, m; None = none was declared."""

    horizontal: float | None = None
    vertical: float | None = None

    def __post_init__(self) -> None:
        """Check ranges."""
        for name in ("horizontal", "vertical"):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value > 0):
                raise InputError(
                    f"{value} m is no accuracy class; give a positive length", field=f"{name} class"
                )

    @property
    def three_d(self) -> float | None:
        """Class in space that the two classes give, as RMSE_3D is made of RMSE_H and RMSE_V."""
        if self.horizontal is None or self.vertical is None:
            return None
        return math.hypot(self.horizontal, self.vertical)

    def of_axis(self, axis: str) -> float | None:
        """Target RMSE of one axis: the horizontal class is shared evenly by x and y."""
        if axis == "z":
            return self.vertical
        return None if self.horizontal is None else self.horizontal / math.sqrt(2.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Component:
    """Horizontal, vertical or three-dimensional accuracy, m.

    Parameters
    ----------
    fit
        RMSE of the product against the check points (index 1 of 7.11).
    survey
        RMSE of the survey (index 2); None if it was not stated for every point.
    target
        Class declared before the test, or None.
    vegetated
        Of heights in vegetation: reported as found, not judged.
    """

    name: Literal["H", "V", "3D"]
    n: int
    fit: float
    survey: float | None
    target: float | None
    vegetated: bool = False

    @property
    def rmse(self) -> float:
        """Accuracy with the survey's error counted in (7.11); NaN without a check point."""
        return math.hypot(self.fit, self.survey or 0.0)

    @property
    def case(self) -> Case:
        """Which statement the number of check points allows."""
        if self.n >= MINIMUM:
            return "tested"
        if self.n > 0:
            return "reduced"
        return "produced" if self.target is not None and self.name != "3D" else "none"

    @property
    def class_m(self) -> float | None:
        """Class: the declared one, else the RMSE found, rounded up to three digits."""
        if self.target is not None:
            return self.target
        return _rounded_up(self.rmse) if self.n else None

    @property
    def meets(self) -> bool | None:
        """Whether the declared class is met; None if none was declared or nothing was tested."""
        if self.target is None or self.n == 0 or self.vegetated:
            return None
        return self.rmse <= self.target


@dataclass(frozen=True, slots=True, kw_only=True)
class Assessment:
    """What the check points say of one product, or of one way of measuring.

    `axes` has an entry per tested axis; z is that of open ground, `vegetated` the other.
    """

    kind: Kind
    residuals: tuple[CheckResidual, ...]
    targets: Targets
    axes: dict[str, AxisStatistics]
    vegetated: AxisStatistics | None
    components: tuple[Component, ...]
    # what residuals were measured on, in words: "mosaic.tif", "dem.asc"
    measured_on: dict[str, str] = field(default_factory=dict)

    def component(self, name: str, *, vegetated: bool = False) -> Component:
        """Component H, V or 3D."""
        return next(c for c in self.components if c.name == name and c.vegetated == vegetated)


def assess(
    residuals: Sequence[CheckResidual],
    targets: Targets | None = None,
    *,
    kind: Kind = "table",
    measured_on: dict[str, str] | None = None,
) -> Assessment:
    """Statistics and accuracy of residuals.

    Parameters
    ----------
    residuals
        Of independent check points; a point in which x and y are not both known does not count
        horizontally.
    targets
        Classes declared before the test.

    Raises
    ------
    InputError
        If a name stands twice.
    """
    targets = targets or Targets()
    residuals = tuple(residuals)
    _refuse_twice(residuals)
    flat = [r for r in residuals if _known(r.dx, r.dy)]
    high = {
        cover: [r for r in residuals if _known(r.dz) and r.cover == cover]
        for cover in ("open", "vegetated")
    }
    axes = {}
    for axis, rows in (("x", flat), ("y", flat), ("z", high["open"])):
        if rows:
            axes[axis] = _along(rows, axis, targets.of_axis(axis))
    grown = high["vegetated"]
    vegetated = _along(grown, "z", None) if grown else None
    components = [_horizontal(flat, targets.horizontal), _vertical(high["open"], targets.vertical)]
    if grown:
        components.append(_vertical(grown, targets.vertical, vegetated=True))
    h = components[0]
    components += [_in_space(h, v, targets.three_d) for v in components[1:]]
    return Assessment(
        kind=kind,
        residuals=residuals,
        targets=targets,
        axes=axes,
        vegetated=vegetated,
        components=tuple(components),
        measured_on=measured_on or {},
    )


def _along(rows: Sequence[CheckResidual], axis: str, target: float | None) -> AxisStatistics:
    errors = np.array([getattr(row, f"d{axis}") for row in rows])
    return axis_statistics([row.name for row in rows], errors, axis, target=target)


def _known(*values: float) -> bool:
    return all(math.isfinite(value) for value in values)


def _refuse_twice(residuals: Sequence[CheckResidual]) -> None:
    seen: set[str] = set()
    for row in residuals:
        if row.name in seen:
            raise InputError(
                f"check point '{row.name}' stands twice; keep one of the two", field="name"
            )
        seen.add(row.name)


def _survey(sigmas: Sequence[float], axes: int) -> float | None:
    """RMSE of the survey over so many axes; None unless every point states its own."""
    if not sigmas or not _known(*sigmas):
        return None
    return math.sqrt(axes) * rms(np.array(sigmas))


def _horizontal(rows: Sequence[CheckResidual], target: float | None) -> Component:
    errors = np.array([[row.dx, row.dy] for row in rows]).reshape(-1, 2)
    fit = math.hypot(rms(errors[:, 0]), rms(errors[:, 1]))
    survey = _survey([row.sigma_h for row in rows], 2)
    return Component(name="H", n=len(rows), fit=fit, survey=survey, target=target)


def _vertical(
    rows: Sequence[CheckResidual], target: float | None, *, vegetated: bool = False
) -> Component:
    return Component(
        name="V",
        n=len(rows),
        fit=rms(np.array([row.dz for row in rows])),
        survey=_survey([row.sigma_v for row in rows], 1),
        target=target,
        vegetated=vegetated,
    )


def _in_space(h: Component, v: Component, target: float | None) -> Component:
    """RMSE_3D of the two (7.5); its number of points is the smaller of theirs."""
    known = h.survey is not None and v.survey is not None
    return Component(
        name="3D",
        n=min(h.n, v.n),
        fit=math.hypot(h.fit, v.fit),
        survey=math.hypot(h.survey or 0.0, v.survey or 0.0) if known else None,
        target=target,
        vegetated=v.vegetated,
    )


def _rounded_up(value: float) -> float:
    """Three significant digits, never less than the value."""
    if value <= 0:
        return 0.0
    step = 10.0 ** (math.floor(math.log10(value)) - 2)
    # Of a value that is a whole number of steps, rounding must not make one more.
    return math.ceil(value / step - 1e-9) * step
