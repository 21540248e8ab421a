"""Figures and doubts of a comparison."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np

from georef_gis.measure.change.detect import FEW_PHOTOS, LEANS, Change, Comparison
from georef_gis.measure.change.evidence import FEW
from georef_gis.measure.change.registration import LEAST_PART
from processing_algorithms.change.photos import SitePhotos
from processing_algorithms.change.sides import Side

# deviations beyond which a shift is more than both accuracies allow
_SIGNIFICANT = 3.0
# part of the windows that should agree, correlation of brightness that says the two compare,
# part of the compared ground that may have changed
_FEW_AGREE, _UNLIKE, _MUCH = 0.6, 0.3, 0.2
# part of the ground that both show, of the box about it
_CALM_PART = 0.3


def figures_of(
    found: Comparison, kept: Sequence[Change], earlier: Side, later: Side
) -> dict[str, Any]:
    """Figures of the summary."""
    one, side = found.registration, found.cells.metres
    shift_x, shift_y = one.shift
    return {
        "earlier": earlier.raster.name, "later": later.raster.name,
        "earlier_date": earlier.date, "later_date": later.date,
        "cell_m": round(side, 4),
        "compared_m2": round(found.compared * side**2, 1),
        "shift_east_m": round(shift_x * side, 4), "shift_north_m": round(-shift_y * side, 4),
        "shift_sigma_m": round(one.sigma * side, 4), "shift_model": one.model,
        "largest_shift_m": round(largest_shift(found), 3),
        "misregistration_m": round(one.rmse * side, 4),
        "misregistration_cells": round(one.rmse, 3),
        "shift_windows": f"{one.agreeing} of {one.peaked} agree, {one.tried} tried",
        "correlation": round(found.radiometry.correlation, 3),
        "changes": len(kept),
        "changed_m2": round(sum(k.judged.outline.area for k in kept) * side**2, 2),
        "expected_real": round(sum(k.confidence for k in kept), 1),
        "leaning": sum(c.judged.kind == LEANS for c in found.changes),
        "kinds": ", ".join(f"{n} {k}" for k, n in Counter(c.judged.kind for c in kept).items()),
        "looked_at": len(found.changes),
    }  # fmt: skip


def largest_shift(found: Comparison) -> float:
    """Largest shift in the corners of the common ground, m."""
    header, (a, b, c, d, e, f) = found.cells.header, found.registration.moved
    corners = np.array([(x, y) for x in (0, header.width) for y in (0, header.height)])
    moved = corners @ np.array([[a, d], [b, e]]) + np.array([c, f])
    return float(np.hypot(*(moved - corners).T).max()) * found.cells.metres


def doubts_of(found: Comparison, kept: Sequence[Change], earlier: Side, later: Side) -> list[str]:
    """What a user has to know of the result, a line each."""
    doubts = [*_shift_doubts(found, earlier, later)]
    if found.radiometry.correlation < _UNLIKE:
        doubts.append(
            f"the brightness of the two has little in common (correlation "
            f"{found.radiometry.correlation:.2f}): another season, other bands or another place; "
            "changes are not to be trusted"
        )
    if found.left_out:
        area = found.left_out * found.cells.metres**2
        doubts.append(
            f"{area:.0f} m2 more differ, less than what was looked at; so much of the site differs "
            "that unchanged ground may have been taken for the rule"
        )
    changed = sum(one.judged.outline.area for one in kept) / max(found.compared, 1)
    if changed > _MUCH:
        doubts.append(
            f"{changed:.0%} of the ground changed; the comparison takes most of it for unchanged"
        )
    shadows = sum(one.judged.kind == "shadow?" for one in found.changes)
    if shadows:
        doubts.append(f"{shadows} areas look like shadows of another sun and have low confidence")
    missing = [name for name, side in (("earlier", earlier), ("later", later)) if not side.date]
    if missing:
        flags = " and ".join(f"--{name}-date" for name in missing)
        doubts.append(
            f"the date of the {' and the '.join(missing)} mosaic is unknown; give {flags}"
        )
    return doubts


def photo_doubts(
    found: Comparison, photos: tuple[SitePhotos | None, SitePhotos | None]
) -> list[str]:
    """What a user has to know of what the photos say, a line each."""
    doubts = []
    leaning = sum(one.judged.kind == LEANS for one in found.changes)
    if leaning:
        doubts.append(
            f"{leaning} areas differ in the mosaics but not in all photos: what leans, or moved "
            "while it was photographed; they have low confidence"
        )
    few = sum(one.evidence is not None and one.evidence.said == FEW_PHOTOS for one in found.changes)
    if few:
        doubts.append(
            f"{few} areas are shown by fewer than {FEW} photos of a date, too few to tell what "
            "leans from what changed; their confidence is lower for it"
        )
    if photos == (None, None) and found.changes:
        doubts.append(
            "no photos were asked: trees, roofs and trucks that lean another way count as changes"
        )
    lost = [name for some in photos if some is not None for name in some.lost]
    if lost:
        doubts.append(f"{len(lost)} photos cannot be read and say nothing, {lost[0]} for one")
    return doubts


def _shift_doubts(found: Comparison, earlier: Side, later: Side) -> list[str]:
    doubts = []
    one, shift = found.registration, largest_shift(found)
    known = [side.sigma for side in (earlier, later)]
    if None not in known:
        # radial, of two coordinates
        allowed = _SIGNIFICANT * math.hypot(*(value or 0.0 for value in known))
        if shift > allowed:
            doubts.append(
                f"the two lie up to {shift:.2f} m off each other, more than their accuracies allow "
                f"({allowed:.2f} m); one of them is worse than it says"
            )
    elif shift > max(_SIGNIFICANT * one.sigma, 1.0) * found.cells.metres:
        doubts.append(
            f"the two lie up to {shift:.2f} m off each other ({one.model}); it is taken out of the "
            "comparison, not of the mosaics"
        )
    if one.agreeing < max(_FEW_AGREE, LEAST_PART) * one.peaked:
        doubts.append(
            f"only {one.agreeing} of {one.peaked} windows agree on how the two lie upon each other"
        )
    return doubts
