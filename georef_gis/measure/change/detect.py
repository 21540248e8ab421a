"""All of a comparison: registration, brightness, scores, regions, confidence."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from georef_gis.measure.change.candidates import MOST_PART, Region, join
from georef_gis.measure.change.confidence import Mixture, fit_mixture
from georef_gis.measure.change.judge import Judged, judge
from georef_gis.measure.change.pair import Cells, MapPair
from georef_gis.measure.change.radiometry import Radiometry, learn_radiometry
from georef_gis.measure.change.registration import Registration
from georef_gis.measure.change.score import (
    Deviations,
    Differ,
    inside,
    learn_deviations,
    score,
    tiles_of,
)
from georef_gis.measure.change.shown import Shown
from georef_gis.measure.change.unrest import Unrest
from georef_gis.measure.change.windows import register

# deviations of the misfit that a cell may lie off, cells that it may at most
_REACH, _MOST_REACH = 2.0, 6
# regions that are judged, those of the highest scores
MOST_REGIONS = 4000
# a shadow's confidence as a change of what is there
SHADOW = 0.3
SHADOW_KIND = "shadow?"
# kind of what photos explain, and what they say of a region
LEANS = "leans?"
AGREE, DIFFER, FEW_PHOTOS = "photos agree", "photos differ", "few photos"
# unrest beyond which ground is restless, as woods and water are
_RESTLESS = 1.5
Step = Callable[[str, float], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class Evidence:
    """What the photos say of a region.

    Parameters
    ----------
    said
        ``photos agree``: a photo of one date shows what the other date's mosaic shows;
        ``photos differ``: none does; ``few photos``: none does, but so few cannot tell.
    photos
        How many were compared; of those that agree the last one is the first that does.
    score
        The least that one of them leaves of the score; inf if there is none.
    """

    said: str
    photos: int
    score: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Change:
    """A place that has changed.

    Parameters
    ----------
    confidence
        Probability that it is a change.
    evidence
        What photos say of it; None if none were looked at.
    """

    judged: Judged
    confidence: float
    evidence: Evidence | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """What was found.

    Parameters
    ----------
    mixtures
        What regions of calm and of restless ground are a mixture of.
    changes
        All regions, by falling confidence.
    pair
        The maps as they lie upon each other, while they are open.
    compared
        Cells that both maps show.
    left_out
        Cells of high score that were too many to be looked at.
    reach
        Cells that the two may lie off each other without a difference.
    shown
        Cells that both maps show.
    """

    cells: Cells
    registration: Registration
    radiometry: Radiometry
    deviations: Deviations
    mixtures: tuple[Mixture, Mixture]
    changes: Sequence[Change]
    pair: MapPair
    compared: int
    left_out: int
    reach: int
    shown: Shown


def compare(
    pair: MapPair, *, most: float, least_area: float, step: Step = lambda _, __: None
) -> Comparison:
    """Compare two maps.

    Parameters
    ----------
    most
        Largest shift that is believed, m.
    least_area
        Regions smaller than a quarter of this are dropped at once, m^2.
    step
        Called with what is done and the part of it; may raise to cancel.

    Raises
    ------
    InputError, CrsError
        If a map cannot be read or brought to the grid.
    GeometryError
        If they share no ground, or no shift is found that most of it agrees on.
    """
    cells = pair.cells
    registration, pair = register(pair, most=most, step=lambda part: step("registration", part))
    moved = registration.moved
    radiometry = learn_radiometry(pair, moved, step=lambda part: step("brightness", part))
    reach = min(_MOST_REACH, max(1, math.ceil(_REACH * registration.rmse)))
    differ = Differ(pair=pair, radiometry=radiometry, reach=reach, metres=cells.metres)
    deviations = learn_deviations(differ)
    notes = Unrest.over(cells.header), Shown.over(cells.header)
    regions, compared, left_out = _regions(differ, deviations, notes, step)
    least = max(3.0, 0.25 * least_area / cells.metres**2)
    regions = [one for one in regions if len(one.rows) >= least]
    regions = sorted(regions, key=lambda one: -one.peak)[:MOST_REGIONS]
    judged = _judged(differ, regions, deviations, notes[0], step)
    mixtures, changes = _with_confidence(judged, deviations.threshold)
    return Comparison(
        cells=cells, registration=registration, radiometry=radiometry, deviations=deviations,
        mixtures=mixtures, changes=sorted(changes, key=lambda one: -one.confidence),
        pair=pair, compared=compared, left_out=left_out, reach=reach, shown=notes[1],
    )  # fmt: skip


def _regions(
    differ: Differ, deviations: Deviations, notes: tuple[Unrest, Shown], step: Step
) -> tuple[list[Region], int, int]:
    """Regions of high score, cells compared, and cells left out."""
    tiles = list(tiles_of(differ.pair.header))
    found: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    compared = 0
    for number, (tile, outer) in enumerate(tiles):
        scores = inside(score(differ, outer, deviations), outer, tile)
        notes[0].note(scores, tile)
        notes[1].note(tile, np.isfinite(scores))
        compared += int(np.isfinite(scores).sum())
        rows, cols = np.nonzero(scores >= deviations.threshold)
        values = scores[rows, cols]
        # no tile alone may fill the memory
        if len(values) > 0.5 * scores.size:
            few = np.argsort(values)[-scores.size // 2 :]
            rows, cols, values = rows[few], cols[few], values[few]
        found.append((rows + tile[1], cols + tile[0], values))
        step("scores", (number + 1) / len(tiles))
    rows, cols, values = (np.concatenate([one[i] for one in found]) for i in range(3))
    left_out = max(0, len(values) - int(max(MOST_PART * compared, 50_000)))
    if left_out:
        kept = np.argsort(values)[left_out:]
        rows, cols, values = rows[kept], cols[kept], values[kept]
    return join(rows, cols, values, differ.pair.header.width), compared, left_out


def _judged(
    differ: Differ, regions: Sequence[Region], deviations: Deviations, unrest: Unrest, step: Step
) -> list[Judged]:
    """Judged in the order of their places, since what is read last is read again fast."""
    order = sorted(regions, key=lambda one: (one.window[1] // 512, one.window[0]))
    judged = []
    for number, region in enumerate(order):
        one = judge(differ, region, deviations, unrest.about(region.rows, region.cols))
        if one is not None:
            judged.append(one)
        step("regions", (number + 1) / len(order))
    return judged


def confidence_of(found: Comparison, judged: Judged, score: float) -> float:
    """Confidence that a region would have with another score."""
    mixture = found.mixtures[judged.unrest > _RESTLESS]
    factor = SHADOW if judged.kind == SHADOW_KIND else 1.0
    return float(mixture.confidence(np.array([score]))[0]) * factor


def _with_confidence(
    judged: Sequence[Judged], threshold: float
) -> tuple[tuple[Mixture, Mixture], list[Change]]:
    """Changes, each seen against its like: a wood must not hide what is new on a lawn."""
    mixtures, changes = [], []
    for restless in (False, True):
        some = [one for one in judged if (one.unrest > _RESTLESS) is restless]
        scores = np.array([one.score for one in some])
        mixture = fit_mixture(scores, threshold)
        mixtures.append(mixture)
        for one, part in zip(some, mixture.confidence(scores), strict=True):
            factor = SHADOW if one.kind == SHADOW_KIND else 1.0
            changes.append(Change(judged=one, confidence=float(part) * factor))
    return (mixtures[0], mixtures[1]), changes
