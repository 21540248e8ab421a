"""What is doubtful about tie points, in words for people."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from georef_gis.orient.ties.results import TieResult

# predicted overlap from which two photos are expected to match
EXPECTED_OVERLAP = 0.3
# photos named before the rest are counted
NAMED = 6


def doubts_of(result: TieResult, unread: Mapping[str, str]) -> tuple[str, ...]:
    """One line for each thing the user should know of."""
    out = [f"{photo}: no features: {why}" for photo, why in sorted(unread.items())]
    joined = {photo for group in result.components for photo in group}
    lone = [p for p in result.ties.photo_ids if p not in joined and p not in unread]
    if not joined:
        return (*out, _nothing(result))
    out += _lone(lone, result)
    if len(result.components) > 1:
        sizes = " + ".join(str(len(group)) for group in result.components)
        out.append(
            f"the photos fall into {len(result.components)} groups ({sizes} photos) that share no "
            "tie points: only their positions hold them together"
        )
    return (*out, *_turns(result))


def _nothing(result: TieResult) -> str:
    n = len(result.ties.photo_ids)
    expected = [p for p in result.pairs if p.overlap >= EXPECTED_OVERLAP]
    if expected:
        return (
            f"no two of the {n} photos match, though {len(expected)} pairs should overlap: are "
            "the positions right, are the pictures sharp? The poses stay as they are"
        )
    return (
        f"no two of the {n} photos overlap enough to match: the poses stay as they are; fly with "
        "60 % of overlap or more"
    )


def _lone(lone: Sequence[str], result: TieResult) -> list[str]:
    """Photos that connect to nothing, parted by whether they ought to."""
    best: dict[str, float] = {}
    for pair in result.pairs:
        for photo in pair.ids:
            best[photo] = max(best.get(photo, 0.0), pair.overlap)
    strange = [p for p in lone if best.get(p, 0.0) >= EXPECTED_OVERLAP]
    apart = [p for p in lone if best.get(p, 0.0) < EXPECTED_OVERLAP]
    out = []
    if strange:
        out.append(
            f"{names(strange)}: no tie points, though the poses predict an overlap: bland, "
            "blurred, or of something else; the pose stays as it is"
        )
    if apart:
        out.append(f"{names(apart)}: no tie points: no overlap; the pose stays as it is")
    return out


def _turns(result: TieResult) -> list[str]:
    out = []
    for quarter in (90, 180, 270):
        turned = [p for p, t in result.turns.items() if t.quarter_deg == quarter]
        if turned:
            evidence = result.turns[turned[0]].evidence
            out.append(
                f"{names(turned)}: the picture is turned by {quarter} deg against the tags' "
                f"heading ({evidence})"
            )
    changed = [p for p, t in result.turns.items() if t.correct]
    if changed:
        angles = [math.degrees(result.turns[p].yaw) for p in changed]
        out.append(
            f"{names(changed)}: heading corrected from the pictures by {min(angles):+.0f} to "
            f"{max(angles):+.0f} deg"
        )
    return out


def names(photos: Sequence[str]) -> str:
    """Names of photos, the rest counted."""
    if len(photos) <= NAMED:
        return ", ".join(photos)
    return f"{', '.join(photos[: NAMED - 1])} and {len(photos) - NAMED + 1} more"
