"""An error budget as rows of a table and as plain values."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from typing import Any

from georef_gis.measure.budget.shares import COUPLED, SOURCES, PointBudget, Remedy

_AXES = ("e", "n", "u")
# What cures a source; the table says it beside what it brings.
ADVICE = {
    "gnss": "PPK or RTK positions, or control points",
    "datum": "state [gnss] datum and datum_output",
    "attitude": "a better IMU, or matching and adjustment",
    "boresight": "`georef calibrate-mount`, or crossed lines at two heights",
    "lever_arm": "measure the lever arm",
    "time": "exposure events (sync board, camera feedback) instead of a clock",
    "calibration": "`georef calibrate-camera`, or adjust with crossed lines at two heights",
    "matching": "more overlap, sharper photos, or more control points",
    "pose": "a smaller block, or more control points",
    "level": "state the height of the ground, a DEM, or control points",
    "ground": "a better DEM, or points from several photos",
    "click": "click at full size, or in several photos",
}


def budget_row(budget: PointBudget, *, sources: Iterable[str]) -> dict[str, Any]:
    """Row of a table: the whole, then one sigma of each source along each axis, m.

    A negative sigma is the root of a negative variance, which a coupling may have: the squares,
    with their signs, add to the square of the whole.
    """
    row: dict[str, Any] = {
        "name": budget.name,
        "photos": ";".join(budget.photo_ids),
        "pose": budget.pose_kind,
        "sigma_h_m": _rounded(budget.horizontal()),
    }
    row |= dict(zip((f"sigma_{a}_m" for a in _AXES), map(_rounded, budget.sigma()), strict=True))
    for source in sources:
        known = source in budget.by_source
        row[f"{source}_h_m"] = _rounded(budget.horizontal(source)) if known else 0.0
        sigma = budget.sigma(source) if known else (0.0, 0.0, 0.0)
        row |= {f"{source}_{a}_m": _rounded(v) for a, v in zip(_AXES, sigma, strict=True)}
    return row


def sources_of(budgets: Sequence[PointBudget]) -> list[str]:
    """Sources that any of some budgets has, in their order."""
    present = {source for budget in budgets for source in budget.by_source}
    return [source for source in SOURCES if source in present]


def remedy_rows(found: Sequence[Remedy]) -> list[dict[str, Any]]:
    """What to fix first, as plain values with words."""
    out = []
    for remedy in found:
        values = {k: _rounded(v) if isinstance(v, float) else v for k, v in asdict(remedy).items()}
        out.append({**values, "what": SOURCES[remedy.source], "cure": ADVICE[remedy.source]})
    return out


def remedy_line(remedy: Remedy) -> str:
    """What reducing one source brings, in one line."""
    return (
        f"{SOURCES[remedy.source]}, {remedy.share:.0%} of the variance; at {remedy.factor:.0%} of "
        f"it {remedy.now:.3g} m become {remedy.reduced_to:.3g} m: {ADVICE[remedy.source]}"
    )


def advice_line(found: Sequence[Remedy]) -> str:
    """The first thing to do, in one line; empty where nothing stands out."""
    return f"fix first: {remedy_line(found[0])}" if found and found[0].now > 0.0 else ""


def height_line(budget: PointBudget) -> str:
    """How far heights are to be trusted, and what makes them so; in one line."""
    sources = [source for source in budget.by_source if source not in COUPLED]
    most = max(sources, key=lambda source: float(budget.variance(source)[2]))
    up, own = float(budget.sigma()[2]), float(budget.sigma(most)[2])
    return f"heights: one sigma {up:.3g} m, {own:.3g} m of it by {SOURCES[most]}"


def _rounded(value: float) -> float:
    """To four significant figures and 0.01 mm: more is noise."""
    if value == 0.0 or not math.isfinite(value):
        return 0.0 if value == 0.0 else float(value)
    digits = max(5, 4 - 1 - math.floor(math.log10(abs(value))))
    return round(float(value), min(digits, 8))
