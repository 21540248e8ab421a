"""Whether a match is one: what is not told apart from chance or from another place is refused."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from georef_gis.frames import Array
from georef_gis.measure.click_match.lsm import Strain, refine
from georef_gis.measure.click_match.patch import Shades, Template, mixed
from georef_gis.measure.click_match.search import (
    Level,
    Peak,
    Scores,
    evidence,
    near_level,
    peak_of,
)
from georef_gis.measure.click_match.ways import View

# px; sides of the template, tried in turn
SIZES = (15, 21, 31, 41)
# px; a template whose noise allows no better has no texture, or an edge alone
_BLUNT, _SHARP = 0.4, 0.15
# least correlation of a match found by the search, and after the last step
_LEAST_FOUND, _LEAST_QUALITY = 0.65, 0.75
# score of another place, or of another height, in that of the best, from which on both may be it
_ALIKE = 0.7
# sigmas of chance by which a correlation must exceed the best of as many places without the spot
_BEYOND_CHANCE = 2.0
# px; a match less sure than this is none
_LEAST_SURE = 0.5
# px; and share of the template's side: peaks nearer to each other are one
_ONE_PEAK, _ONE_PEAK_SHARE = 4.0, 0.3
# change of the affine map by the slope of what was clicked, at one rad between the rays; beside
_SLOPE, _SHAPE = 0.5, 0.03
# share of that, and sigmas of the poses' angles, from which on a patch is no piece of the ground
_MOST_SLOPE, _MOST_TURN = 0.6, 3.5
# px; and sigmas, from which on the middle of a patch, or its halves, move otherwise than all of it
_INNER, _APART, _STRAINED = 0.18, 0.22, 2.8
# px; a spot that its own middle fixes less is told by what is beside it only
_OWN_SURE = 0.2
# share of the photos in which that shows that a template is too large for the relief
_RELIEF_SHARE = 0.2
# px beside what is needed of the photo for the last step
_BESIDE = 12

NO_TEXTURE = "nothing to match there: no texture; click something with contrast"
EDGE = "only an edge there: nothing fixes the spot along it; click a corner or an end"
BORDER = "too near to the border of the photo to match"
ALIKE_HEIGHTS = (
    "a pattern that repeats itself: places at different heights look alike; click it in a second "
    "photo"
)
ALIKE = "several places there look alike: click it by hand"
UNLIKE = "does not show it alike (correlation {:.2f}): hidden there, or another look"
RELIEF = "what is beside the spot may lie higher or lower and drag it along: click it by hand"
CHANCE = "what looks alike there may be so by chance (correlation {:.2f}): too little texture"
UNSETTLED = "does not settle on one place there (correlation {:.2f}): click it by hand"
NOT_WHOLE = "does not show all of the patch"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Found:
    """A match in a view: pixel (2,) of the photo, covariance (2, 2) px^2, affine (2, 2).

    `relief` above 1: the patch sees more than one surface.
    """

    uv: Array
    covariance: Array
    affine: Array
    quality: float
    relief: float

    @property
    def sigma_px(self) -> float:
        """One sigma along the worst direction, px."""
        return math.sqrt(float(np.linalg.eigvalsh(self.covariance)[1]))


def judge_template(template: Template) -> str:
    """Why a template cannot be matched; empty if it can."""
    best, worst = template.sharpness()
    if worst <= _BLUNT:
        return ""
    return EDGE if best <= _SHARP else NO_TEXTURE


def word_of(template: Template) -> str:
    """Why a template that was not found may be unfit; empty if its texture is no reason."""
    best, worst = template.textured()
    if worst:
        return ""
    return EDGE if best else NO_TEXTURE


def judge_level(template: Template, scores: Sequence[Scores], level: Level) -> str:
    """Why the height is not sure; empty if it is."""
    if level.rival <= _ALIKE:
        return ""
    best = max(float(one.values.max()) for one in scores)
    looked = max(one.looked for one in scores)
    if best < max(_LEAST_FOUND, by_chance(template, looked)):
        return _too_low(best)
    return ALIKE_HEIGHTS


def _too_low(correlation: float) -> str:
    """What is said of a correlation that chance may make."""
    word = CHANCE if correlation >= _LEAST_QUALITY else UNLIKE
    return word.format(max(correlation, 0.0))


def one_peak(size: int) -> float:
    """Distance, px of the template, below which two peaks are one."""
    return max(_ONE_PEAK, _ONE_PEAK_SHARE * size)


def by_chance(template: Template, places: int) -> float:
    """Correlation that the best of many places without the spot hardly reaches.

    Fisher's z of n independent shades is normal with the variance 1 / (n - 3).
    """
    free = max(template.independent() - 3.0, 1.0)
    largest = math.sqrt(2.0 * math.log(max(places, 2)))
    return math.tanh((largest + _BEYOND_CHANCE) / math.sqrt(free))


def judge(
    template: Template, view: View, scores: Scores, level: Level, *, alone: bool = False
) -> Found | str:
    """Match in a view near the common height, or why there is none.

    `alone`: no other view tells that height, so chance had all of them to choose from.
    """
    at = near_level(view.way, level.index)
    near = Scores(values=scores.values[at], uv=scores.uv[at])
    if not near.looked:
        return NOT_WHOLE
    affine = view.way.affine[level.index]
    if not np.all(np.isfinite(affine)):
        return NOT_WHOLE
    scale = math.sqrt(abs(float(np.linalg.det(affine))))
    peak = peak_of(scores, at, one_peak(template.size) * scale)
    chance = by_chance(template, scores.looked if alone else near.looked)
    if peak.score < max(_LEAST_FOUND, chance):
        return _too_low(peak.score)
    if float(evidence(np.array(peak.second)) / evidence(np.array(peak.score))) > _ALIKE:
        return ALIKE
    return _refined(template, view, peak)


def _refined(template: Template, view: View, peak: Peak) -> Found | str:
    affine = view.way.affine[peak.level]
    slope = _SHAPE + _SLOPE * math.tan(view.angle)
    found = refine(template, _about(template, view, peak.uv, affine), peak.uv, affine,
                   sigma_affine=slope + view.turn)  # fmt: skip
    if found is None:
        return UNSETTLED.format(peak.score)
    if found.quality < _LEAST_QUALITY:
        return UNLIKE.format(max(found.quality, 0.0))
    change = np.linalg.solve(affine, found.affine) - np.eye(2)
    most = _MOST_SLOPE * slope + _MOST_TURN * view.turn
    out = Found(
        uv=found.uv + view.corner, covariance=found.covariance, affine=found.affine,
        quality=found.quality,
        relief=max(
            float(np.abs(change).max()) / most, found.inner.sigma / _OWN_SURE,
            _strain(found.inner, _INNER),
            _strain(found.apart, _APART),
        ),
    )  # fmt: skip
    if out.sigma_px > _LEAST_SURE * max(1.0, math.sqrt(abs(float(np.linalg.det(affine))))):
        best = math.sqrt(float(np.linalg.eigvalsh(found.covariance)[0]))
        return EDGE if best <= _SHARP else NO_TEXTURE
    return out


def _strain(strain: Strain, away: float) -> float:
    """Above 1 where parts of a patch move against each other by more than `away` px and noise."""
    return min(strain.away / away, math.sqrt(strain.chi2) / _STRAINED)


def without_relief(judged: dict[str, Found | str]) -> dict[str, Found | str]:
    """Matches by photo, without those whose patch sees more than one surface.

    Where several photos show that, the others are wrong by it too, though less than can be told.
    """
    found = {key: one for key, one in judged.items() if isinstance(one, Found)}
    steep = {key for key, one in found.items() if one.relief > 1.0}
    if len(steep) >= _RELIEF_SHARE * len(found):
        steep = set(found)
    return {key: RELIEF if key in steep else one for key, one in judged.items()}


def _about(template: Template, view: View, uv: Array, affine: Array) -> Shades:
    """Shades of the view about a pixel, as far as the last step may look."""
    reach = math.ceil(float(np.abs(affine).sum(axis=1).max()) * (template.half + 1)) + _BESIDE
    u, v = (round(float(x)) for x in uv)
    window = (u - reach, v - reach, u + reach + 1, v + reach + 1)
    return mixed(view.picture, template.mix, window)
