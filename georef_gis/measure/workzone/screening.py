"""Screening of a work zone's measured devices: lengths of tapers, spacings, widths of lanes, signs.

Screening, not a statement of compliance: it says what positions with their errors can say.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from georef_gis.errors import InputError
from georef_gis.frames import Array
from georef_gis.measure.workzone.geometry import (
    Measured,
    along_and_offset,
    distances_to_line,
    spacings,
)
from georef_gis.measure.workzone.rules import Requirement, Rules
from georef_gis.measure.workzone.verdicts import (
    Finding,
    Verdict,
    probability_of_all,
    probability_within,
    sigma_needed,
    verdict_of,
    verdict_of_all,
)
from georef_gis.units import INTERNATIONAL_FOOT as FOOT

# A distance of fewer sigmas does not tell which of two devices comes first.
_FEWEST_SIGMAS = 3.0
# sigmas by which a device must lie beyond an edge to be told that it does
_BEYOND = 3.0


@dataclass(frozen=True, slots=True, kw_only=True)
class TaperCheck:
    """A taper to screen.

    Parameters
    ----------
    devices
        Indices of its devices, in the order of the row.
    offset
        Lateral shift W, m; None = measured against `edge`.
    edge
        Indices of the vertices of a line that runs with the road.
    """

    name: str
    kind: str
    devices: tuple[int, ...]
    offset: float | None = None
    edge: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class TangentCheck:
    """A row of devices along a lane; indices in the order of the row."""

    name: str
    devices: tuple[int, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class LaneCheck:
    """A lane between a row of devices and a line.

    Parameters
    ----------
    half_widths
        Of the devices, m; NaN = not known.
    least
        Width it must have, m; None = the manual's.
    """

    name: str
    devices: tuple[int, ...]
    edge: tuple[int, ...]
    half_widths: tuple[float, ...] = ()
    least: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class SignCheck:
    """Advance warning signs, the nearest to the work first, and the first device behind them."""

    name: str
    signs: tuple[int, ...]
    start: int


@dataclass(frozen=True, slots=True, kw_only=True)
class ZoneChecks:
    """What is to be screened."""

    speed_mph: float
    road_type: str = ""
    tapers: tuple[TaperCheck, ...] = ()
    tangents: tuple[TangentCheck, ...] = ()
    lanes: tuple[LaneCheck, ...] = ()
    signs: tuple[SignCheck, ...] = field(default_factory=tuple)


def screen(zone: ZoneChecks, measured: Measured, rules: Rules) -> list[Finding]:
    """Findings on all that a zone asks for.

    Parameters
    ----------
    measured
        All positions, with what they share in error.

    Raises
    ------
    InputError
        If a check names too few devices, or the manual has no figure for it.
    """
    out: list[Finding] = []
    for taper in zone.tapers:
        _enough(taper.name, taper.devices, 2, "devices")
        out.append(_taper_length(taper, measured, rules, zone.speed_mph))
        required = rules.taper_spacing(taper.kind, zone.speed_mph)
        out += _spacings(taper.name, taper.devices, measured, required)
    for tangent in zone.tangents:
        _enough(tangent.name, tangent.devices, 2, "devices")
        required = rules.tangent_spacing(zone.speed_mph)
        out += _spacings(tangent.name, tangent.devices, measured, required)
    for lane in zone.lanes:
        _enough(lane.name, lane.devices, 1, "devices")
        _enough(lane.name, lane.edge, 2, "vertices of its edge")
        out += _lane(lane, measured, rules)
    for row in zone.signs:
        _enough(row.name, row.signs, 1, "signs")
        out += _signs(row, measured, rules.sign_spacing(zone.road_type))
    return out


def _enough(name: str, indices: tuple[int, ...], least: int, what: str) -> None:
    if len(indices) < least:
        raise InputError(f"has {len(indices)} {what}, {least} or more are needed; measure them",
                         source=name)  # fmt: skip


def _finding(
    check: str, subject: str, value: float, sigma: float, required: Requirement, note: str = ""
) -> Finding:
    p = probability_within(value, sigma, required.low, required.high)
    return Finding(
        check=check,
        subject=subject,
        value=value,
        sigma=sigma,
        low=required.low,
        high=required.high,
        probability=p,
        verdict=verdict_of(value, sigma, required.low, required.high),
        sigma_needed=sigma_needed(value, required.low, required.high),
        source=required.source,
        note=note,
    )


# -- tapers and rows -----------------------------------------------------------------------------


def _taper_length(taper: TaperCheck, measured: Measured, rules: Rules, speed: float) -> Finding:
    """Length along the road; where the offset is measured too, its error counts with it."""
    required = rules.taper_length(taper.kind, speed)
    if required.per_offset and taper.offset is None and len(taper.edge) < 2:
        raise InputError("needs its offset: give offset_ft, or an edge line that runs with the "
                         "road", source=taper.name)  # fmt: skip
    ends = measured.subset([taper.devices[0], taper.devices[-1], *taper.edge])
    _check_offset(taper, float(np.linalg.norm(ends.xy[1] - ends.xy[0])))

    def length_and_offset(xy: Array) -> Array:
        if len(taper.edge) >= 2:
            along, offset = along_and_offset(xy[0], xy[1], xy[-1] - xy[2])
            return np.array([abs(along), abs(offset)])
        distance = float(np.linalg.norm(xy[1] - xy[0]))
        # From the slope of the taper to the way along the road.
        offset = taper.offset or 0.0
        along = math.sqrt(distance**2 - offset**2) if distance > offset else distance
        return np.array([along, offset])

    def against_limit(xy: Array) -> Array:
        along, offset = length_and_offset(xy)
        return np.array([along - required.per_offset * _offset(taper, offset)])

    length, offset = length_and_offset(ends.xy)
    offset = _offset(taper, offset)
    _, covariance = ends.propagate(against_limit)
    low = required.low + required.per_offset * offset
    note = f"offset {offset:.2f} m, " + ("measured" if taper.offset is None else "as given")
    return _finding(
        "taper length",
        taper.name,
        float(length),
        math.sqrt(max(covariance[0, 0], 0.0)),
        replace(required, low=low),
        note if required.per_offset else "",
    )


def _check_offset(taper: TaperCheck, distance: float) -> None:
    """Refuse an offset across the road, m, that the ends of the taper do not lie apart."""
    if taper.offset is not None and taper.offset >= distance:
        raise InputError(
            f"{taper.offset / FOOT:g} ft is no offset of a taper whose ends lie "
            f"{distance / FOOT:.1f} ft apart; give the feet that it leads to the side",
            source=f"taper {taper.name}",
            field="offset_ft",
        )


def _offset(taper: TaperCheck, measured: float) -> float:
    return measured if taper.offset is None else taper.offset


def _spacings(
    name: str, devices: tuple[int, ...], measured: Measured, required: Requirement
) -> list[Finding]:
    """All spacings of a row as one finding, then each of them."""
    row = measured.subset(list(devices))
    values, covariance = row.propagate(spacings)
    sigmas = np.sqrt(np.clip(np.diag(covariance), 0.0, None))
    single = []
    for k, (value, sigma) in enumerate(zip(values, sigmas, strict=True)):
        one = _finding("device spacing", f"{name}: {row.names[k]} to {row.names[k + 1]}",
                       float(value), float(sigma), required)  # fmt: skip
        single.append(_if_ordered(replace(one, part=True)))
    return [_all_of("device spacing", name, values, covariance, single), *single]


def _if_ordered(finding: Finding) -> Finding:
    """Without an answer where the error does not even tell the order of the two devices."""
    if finding.value >= _FEWEST_SIGMAS * finding.sigma:
        return finding
    return replace(
        finding,
        verdict="cannot tell",
        sigma_needed=min(finding.sigma_needed, finding.value / _FEWEST_SIGMAS),
        note="too close together to tell which comes first at this accuracy",
    )


def _verdict(one: Finding) -> Verdict:
    return verdict_of(one.value, one.sigma, one.low, one.high)


def _all_of(
    check: str, name: str, values: Array, covariance: Array, single: list[Finding]
) -> Finding:
    """One finding on several of a kind: its value is the worst of them."""
    low, high = single[0].low, single[0].high
    n = len(values)
    p = probability_of_all(values, covariance, np.full(n, low), np.full(n, high))
    worst = min(single, key=lambda one: one.probability)
    unordered = any(one.verdict != _verdict(one) for one in single)
    return replace(
        worst,
        check=f"{check}, all",
        subject=f"{name} ({n})",
        probability=p,
        verdict="cannot tell"
        if unordered
        else verdict_of_all(p, [one.probability for one in single]),
        sigma_needed=min(one.sigma_needed for one in single),
        note="; ".join(part for part in (f"worst: {worst.subject}", worst.note) if part),
        part=False,
    )


# -- lanes and signs -----------------------------------------------------------------------------


def _lane(lane: LaneCheck, measured: Measured, rules: Rules) -> list[Finding]:
    """Width at every device, from the line to the near face of the device."""
    n = len(lane.devices)
    part = measured.subset([*lane.devices, *lane.edge])
    half = np.array(lane.half_widths or [math.nan] * n)
    side = math.copysign(1.0, float(np.median(distances_to_line(part.xy[:n], part.xy[n:]))))

    def widths(xy: Array) -> Array:
        out: Array = side * distances_to_line(xy[:n], xy[n:]) - np.nan_to_num(half)
        return out

    values, covariance = part.propagate(widths)
    _check_one_side(lane, part, values + np.nan_to_num(half), covariance)
    required = rules.lane
    if lane.least is not None:
        required = Requirement(low=lane.least, source="as given")
    single = []
    for k, (value, sigma) in enumerate(zip(values, np.sqrt(np.diag(covariance)), strict=True)):
        unknown = math.isnan(half[k])
        note = "to the middle of the device, whose width is not known" if unknown else ""
        one = _finding("lane width", f"{lane.name}: at {part.names[k]}", float(value),
                       float(sigma), required, note)  # fmt: skip
        single.append(replace(one, part=True))
    return [_all_of("lane width", lane.name, values, covariance, single), *single]


def _check_one_side(lane: LaneCheck, part: Measured, distances: Array, covariance: Array) -> None:
    """Refuse devices that stand beyond the edge: there is no lane between, and no width of it."""
    sigma = np.sqrt(np.clip(np.diag(covariance), 0.0, None))
    beyond = np.flatnonzero(distances < -_BEYOND * sigma)
    if len(beyond):
        names = ", ".join(part.names[k] for k in beyond[:3])
        names += f" and {len(beyond) - 3} more" if len(beyond) > 3 else ""
        raise InputError(
            f"{names} of lane '{lane.name}' stand beyond its edge, by {-distances.min():.2f} m at "
            "most: the line of devices crosses it; give a line, or a part of it, on one side",
            field="lane",
        )


def _signs(row: SignCheck, measured: Measured, required: list[Requirement]) -> list[Finding]:
    """Distances A, B and C, of as many signs as there are."""
    count = min(len(row.signs), len(required))
    part = measured.subset([row.start, *row.signs[:count]])
    values, covariance = part.propagate(spacings)
    sigmas = np.sqrt(np.clip(np.diag(covariance), 0.0, None))
    return [
        _finding(f"sign spacing {'ABC'[k]}", f"{row.name}: {part.names[k]} to {part.names[k + 1]}",
                 float(values[k]), float(sigmas[k]), required[k])
        for k in range(count)
    ]  # fmt: skip
