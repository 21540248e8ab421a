"""What the photos themselves say of a region: whether a photo has the other date's look of it.

Mosaics are no true orthophotos: what stands up leans away from the camera, and another flight has
other cameras. A photo of one date that shows what the other date's mosaic shows has seen the same
thing from the same side: then the difference is one of view. What has changed differs in all.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from georef_gis.measure.change.detect import (
    AGREE,
    DIFFER,
    FEW_PHOTOS,
    LEANS,
    Change,
    Comparison,
    Evidence,
    confidence_of,
)
from georef_gis.measure.change.judge import Judged, left_by_moves, move_of, window_about
from georef_gis.measure.change.pair import Views
from georef_gis.measure.change.score import Differ, scores_of
from georef_gis.rasters.profile import Transform
from georef_gis.rasters.reading import Window
from georef_gis.rasters.resampled import UNMOVED, MapHeader

Image = NDArray[Any]

# confidence from which on photos are looked at
LEAST = 0.05
# cells about a region that are not the ground about it; the fewest that tell a photo's tone
_OWN, _LEAST_AROUND = 4, 200
# part of a region that a photo must show
_LEAST_SEEN = 0.95
# part of the score that a photo must take away to count: less of a real change is taken by chance
_EXPLAINED = 0.4
# photos of each date that is asked below which they may all have looked from another side, and what
# a region that they do not explain keeps of its confidence: of those that more photos could judge
# about half were no changes
FEW, _UNJUDGED = 3, 0.6


@dataclass(frozen=True, slots=True, kw_only=True)
class Look:
    """A window of the grid as one photo sees it.

    Parameters
    ----------
    samples : shape (rows, cols, bands)
        As the photo has them.
    valid : shape (rows, cols)
        Where the photo shows the ground.
    """

    samples: Image
    valid: NDArray[np.bool_]


class Photos(Protocol):
    """Photos of one date, laid on the ground where it is asked for."""

    def looks(self, header: MapHeader, window: Window, moved: Transform) -> Iterable[Look]:
        """A window as the photos see it that do so most from above.

        Parameters
        ----------
        header
            Of the grid.
        moved
            Cell of the grid -> cell where the photos' date shows the same.
        """
        ...


def weigh(
    found: Comparison, photos: tuple[Photos | None, Photos | None], *,
    step: Callable[[float], None] = lambda _: None,
) -> Comparison:  # fmt: skip
    """The comparison with confidences lowered where photos explain the difference.

    Parameters
    ----------
    found
        A comparison whose maps are open.
    photos
        Of the later and the earlier map: those that it is made of; None if they are not known.
    step
        Called with the part done; may raise to cancel.
    """
    if photos == (None, None):
        return found
    asked = [one for one in found.changes if one.confidence >= LEAST]
    kept: list[Change] = [one for one in found.changes if one.confidence < LEAST]
    # in the order of their places, since photos read last are read again fast
    asked.sort(key=lambda one: _place(one.judged.region.window))
    differ = Differ(
        pair=found.pair, radiometry=found.radiometry, reach=found.reach,
        metres=found.cells.metres,
    )  # fmt: skip
    for number, change in enumerate(asked):
        kept.append(_weighed(found, change, _evidence(differ, found, change, photos)))
        step((number + 1) / len(asked))
    return replace(found, changes=sorted(kept, key=lambda one: -one.confidence))


def _place(window: Window) -> tuple[int, int]:
    return window[1] // 1024, window[0]


def _weighed(found: Comparison, change: Change, evidence: Evidence | None) -> Change:
    """A change whose confidence is what the photos leave of it; it never rises."""
    if evidence is None:
        return change
    judged = change.judged
    if evidence.said == DIFFER:
        return replace(change, evidence=evidence)
    if evidence.said == FEW_PHOTOS:
        return replace(change, confidence=_UNJUDGED * change.confidence, evidence=evidence)
    # what is left of it is in part how far the photo's place lies from the other date's
    part = evidence.score / judged.score
    confidence = min(part * change.confidence, confidence_of(found, judged, evidence.score))
    return replace(
        change, judged=replace(judged, kind=LEANS), confidence=confidence, evidence=evidence
    )


def _said(judged: Judged, counts: Sequence[int], least: float) -> Evidence:
    """What photos say that leave so much of a score; `counts` of each date that is asked."""
    photos = sum(counts)
    if least < (1.0 - _EXPLAINED) * judged.score:
        return Evidence(said=AGREE, photos=photos, score=least)
    said = FEW_PHOTOS if min(counts) < FEW else DIFFER
    return Evidence(said=said, photos=photos, score=least)


def _evidence(
    differ: Differ, found: Comparison, change: Change, photos: Sequence[Photos | None]
) -> Evidence | None:
    """What the photos say; None if the region is too large to be looked at."""
    judged = change.judged
    window = window_about(differ, judged.region)
    if window is None:
        return None
    views = differ.pair.read(window)
    mask = judged.outline.mask
    kernel = np.ones((2 * _OWN + 1,) * 2, np.uint8)
    around = (cv2.dilate(mask.astype(np.uint8), kernel) == 0) & views.valid
    counts, least = [], float("inf")
    for side, some in enumerate(photos):
        if some is None:
            continue
        counts.append(0)
        moved = found.registration.moved if side else UNMOVED
        for look in some.looks(differ.pair.header, window, moved):
            pair = _with_look(differ, views, look, side, (mask, around))
            if pair is None:
                continue
            counts[-1] += 1
            least = min(least, _score(differ, found, change, pair, window))
            if least < found.deviations.threshold:
                return _said(judged, counts, least)
    return _said(judged, counts, least)


def _with_look(
    differ: Differ, views: Views, look: Look, side: int, masks: tuple[Image, Image]
) -> Views | None:
    """The views with one date's replaced by a photo's, made like it in tone by the ground about."""
    mask, around = masks
    around = around & look.valid
    if look.valid[mask].mean() < _LEAST_SEEN or around.sum() < _LEAST_AROUND:
        return None
    mine = views.earlier if side else views.later
    samples = look.samples.astype(np.float32)
    if not differ.pair.colour:
        samples = samples[..., :3].mean(axis=2, keepdims=True)
    elif samples.shape[2] < mine.shape[2]:
        return None
    samples = samples[..., : mine.shape[2]]
    dark = np.maximum(np.median(samples[around], axis=0), 1e-6)
    toned = samples * (np.median(mine[around], axis=0) / dark)
    valid = views.valid & look.valid
    if side:
        return replace(views, earlier=np.asarray(toned, np.float32), valid=valid)
    return replace(views, later=np.asarray(toned, np.float32), valid=valid)


def _score(differ: Differ, found: Comparison, change: Change, pair: Views, window: Window) -> float:
    """Score of a region between a photo and the other date's mosaic, as it is judged."""
    judged = change.judged
    region = judged.region
    later, earlier = differ.made_alike(pair, window)
    scores = scores_of(differ, later, earlier, found.deviations)
    peak = float(scores[region.rows - window[1], region.cols - window[0]].max())
    misfit, left = _misfit(differ, found, judged, (later, earlier))
    # in a photo that a crown hides the place from nothing stands out, yet nothing agrees
    before = _misfit(differ, found, judged, differ.alike(window)[:2])[0]
    return max(peak * left**2 / judged.unrest, judged.score * misfit / max(before, 1e-9))


def _misfit(
    differ: Differ, found: Comparison, judged: Judged, both: tuple[Image, Image]
) -> tuple[float, float]:
    """Mean squared difference in a region that moves leave, in deviations, and its part."""
    usual = np.median(found.deviations.sigma[0], axis=1).astype(np.float32)
    later, earlier = (one / usual for one in both)
    mask = judged.outline.mask
    left = left_by_moves(later, earlier, mask, move_of(differ))
    return left * float(((later - earlier)[mask] ** 2).sum(axis=1).mean()), left
