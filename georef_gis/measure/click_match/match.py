"""Refine a click by matching it into the photos beside it.

The patch about the click is looked for along its guide in all neighbours together, then matched to
a fraction of a pixel in each. What is not told apart is refused, not guessed: no texture, an edge
alone, a pattern that repeats itself, a photo that does not show the spot.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from georef_gis.errors import GeometryError
from georef_gis.frames import Array
from georef_gis.measure.click_match.judge import (
    BORDER,
    SIZES,
    Found,
    judge,
    judge_level,
    judge_template,
    one_peak,
    without_relief,
    word_of,
)
from georef_gis.measure.click_match.patch import Picture, Template, template_of
from georef_gis.measure.click_match.search import Scores, common_level, search
from georef_gis.measure.click_match.ways import (
    PictureOf,
    View,
    finest,
    heights_of,
    neighbours,
    views_of,
)
from georef_gis.measure.intersecting import intersect_points
from georef_gis.measure.locating import locate_points
from georef_gis.measure.measured import MeasuredPoints
from georef_gis.measure.scene import Scene
from georef_gis.model.control import Mark
from georef_gis.model.intersections import BLUNDER

# px; adjusted real photos leave 0.3 to 0.5, many times what a match is unsure by
MODEL_SIGMA = 0.4
# degrees of freedom for which that counts, beside those of a set's own residuals; most of these
_PRIOR_DOF, _WORST_MISFIT = 4.0, 3.0
# px; no click is surer of what it means
_LEAST_SIGMA = 0.01
# share of the photos that is enough not to try a larger template
_ENOUGH = 0.6
# sigmas of two clicks beyond which they do not mean one spot
_DISAGREE = 4.4
# sigmas of both clicks, and 1 px, about a click of the user in which its spot is looked for
_NEAR_CLICK = 5.0
# photos of which a single one that shows the spot has no other to confirm it
_MANY = 4
LONELY = "only this one of {} photos shows something alike: click it by hand"
DOES_NOT_FIT = "does not fit the guides of the other photos"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MatchedClick:
    """A spot found in another photo.

    Parameters
    ----------
    mark
        `sigma_px` holds the match and what the photo's model leaves, `shared_px` the click.
    covariance : shape (2, 2), px^2
        Of the match alone.
    quality
        Correlation with the clicked patch.
    """

    mark: Mark
    covariance: Array
    quality: float

    @property
    def sigma_px(self) -> float:
        """One sigma of the match alone along its worst direction, px."""
        return math.sqrt(float(np.linalg.eigvalsh(self.covariance)[1]))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Matched:
    """A click and where other photos show what it shows.

    Parameters
    ----------
    clicks
        The user's own marks, as they were.
    own
        What stands for them beside the matches, that of the template's photo first: where the spot
        was found again, at the pixel that all of them together mean.
    before
        Place by them alone.
    template
        The mark that was matched, and the side of its patch, px; 0 where none fitted.
    matches
        Best first.
    place
        With the matches; None where there are none.
    refused
        Photos in which it was not found, and why.
    why_not
        Why nothing was matched; empty if something was.
    """

    clicks: tuple[Mark, ...]
    before: MeasuredPoints
    template: Mark
    own: tuple[Mark, ...] = ()
    size: int = 0
    matches: tuple[MatchedClick, ...] = ()
    place: MeasuredPoints | None = None
    refused: dict[str, str]
    why_not: str = ""
    doubts: tuple[str, ...] = ()


def match_click(
    scene: Scene,
    clicks: Sequence[Mark],
    picture_of: PictureOf,
    *,
    photo_ids: Sequence[str] | None = None,
    most: int = 8,
    model_px: float = MODEL_SIGMA,
) -> Matched:
    """Find what was clicked in the photos beside it.

    Parameters
    ----------
    clicks
        Marks of one object, each in a photo of its own.
    picture_of
        Pixels of a photo by its id, (rows, cols, bands); asked by several threads.
    photo_ids
        Only into these photos.
    most
        Photos to look in.
    model_px
        One sigma of what camera, pose and readout leave between a photo and its model.

    Raises
    ------
    GeometryError
        If the clicks show no place.
    """
    own = [
        replace(mark, name=clicks[0].name, sigma_px=max(mark.sigma_px, _LEAST_SIGMA))
        for mark in clicks
    ]
    before = locate_points(scene, own) if len(own) == 1 else intersect_points(scene, own)
    template = finest(before, own)
    clicked = [mark.photo for mark in own if mark.photo != template.photo]
    if photo_ids is None:
        photo_ids = neighbours(scene, before, template.photo, most=most + len(clicked))
    others = [key for key in photo_ids if key not in clicked and key != template.photo][:most]
    views, refused = views_of(scene, template, [*clicked, *others], picture_of, heights_of(before))
    out = Matched(clicks=tuple(own), before=before, template=template, refused=refused)
    if not views:
        return replace(out, why_not=_why(refused))
    found = _Matching(picture_of(template.photo), own, template, views).best()
    if found.found:
        out = _placed(scene, out, found, model_px)
    else:
        out = replace(out, why_not=found.why_not or _why(found.refused))
    return _of_others(replace(out, refused=found.refused | out.refused))


def _of_others(out: Matched) -> Matched:
    """What was refused in photos that the user clicked himself is a doubt, not a refusal."""
    clicked = {mark.photo for mark in out.clicks}
    doubts = tuple(
        f"the click in photo {key} was not found again: {why}"
        for key, why in out.refused.items()
        if key in clicked
    )
    refused = {key: why for key, why in out.refused.items() if key not in clicked}
    return replace(out, refused=refused, doubts=out.doubts + doubts)


def _why(refused: dict[str, str]) -> str:
    """What most photos were refused for."""
    lines = list(refused.values())
    return max(lines, key=lines.count) if lines else "no other photo shows it"


# -- templates of several sizes ------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Round:
    """What one template found: by photo; or why it was not looked for at all."""

    size: int = 0
    found: dict[str, Found]
    refused: dict[str, str]
    why_not: str = ""


@dataclass(frozen=True, slots=True)
class _Matching:
    """A clicked photo and the parts of others that may show the spot."""

    picture: Picture
    own: Sequence[Mark]
    template: Mark
    views: Sequence[View]

    def best(self) -> _Round:
        """Smallest template that most photos show; a small one sees least of what is beside."""
        best = _Round(found={}, refused={}, why_not=BORDER)
        for size in SIZES:
            template = template_of(self.picture, self._uv, size)
            if template is None:
                break
            found = self._round(template)
            if not found.found:
                found = replace(found, why_not=word_of(template) or found.why_not)
            if len(found.found) > len(best.found) or not best.found:
                best = found
            if len(best.found) >= _ENOUGH * len(self.views):
                break
        return best

    @property
    def _uv(self) -> Array:
        return np.array([self.template.u, self.template.v])

    def _round(self, template: Template) -> _Round:
        why = judge_template(template)
        if why:
            return _Round(found={}, refused={}, why_not=why)
        scores = [self._near_click(v, search(template, v.picture, v.way)) for v in self.views]
        level = common_level([v.way for v in self.views], scores, one_peak(template.size))
        why = judge_level(template, scores, level)
        if why:
            return _Round(found={}, refused={}, why_not=why)
        judged = {v.photo_id: judge(template, v, one, level)
                  for v, one in zip(self.views, scores, strict=True)}  # fmt: skip
        judged = without_relief(judged)
        found = {key: one for key, one in judged.items() if isinstance(one, Found)}
        if len(found) == 1:
            (i,) = (i for i, view in enumerate(self.views) if view.photo_id in found)
            judged[self.views[i].photo_id] = (
                LONELY.format(len(self.views))
                if len(self.views) >= _MANY
                else judge(template, self.views[i], scores[i], level, alone=True)
            )
        return _Round(
            size=template.size,
            found={key: one for key, one in judged.items() if isinstance(one, Found)},
            refused={key: one for key, one in judged.items() if isinstance(one, str)},
        )

    def _near_click(self, view: View, scores: Scores) -> Scores:
        """In a photo that the user clicked himself, only places about that click."""
        mark = next((one for one in self.own if one.photo == view.photo_id), None)
        if mark is None:
            return scores
        with np.errstate(invalid="ignore"):
            away = np.linalg.norm(scores.uv + view.corner - [mark.u, mark.v], axis=-1)
        unsure = float(np.hypot(mark.whole_px, self.template.whole_px))
        return replace(
            scores, values=np.where(away > _NEAR_CLICK * unsure + 1.0, -1.0, scores.values)
        )


# -- the place -----------------------------------------------------------------------------------


def _placed(scene: Scene, out: Matched, found: _Round, model_px: float) -> Matched:
    """Matches that fit each other, and the place by them."""
    at, doubts = _agreed(out, found.found)
    out = replace(out, size=found.size, doubts=doubts)
    try:
        place = intersect_points(scene, list(_marks(out, found.found, at, model_px).values()))
        model_px *= _misfit(place)
        marks = _marks(out, found.found, at, model_px)
        place = intersect_points(scene, list(marks.values()))
    except GeometryError as error:
        return replace(out, why_not=str(error))
    return _told(out, found, marks, place)


def _misfit(place: MeasuredPoints) -> float:
    """How far photos miss their models, in what was taken for it: by that and the residuals."""
    point = place[0]
    if not point.dof:
        return 1.0
    said = _PRIOR_DOF + point.dof * min(point.sigma0, _WORST_MISFIT) ** 2
    return math.sqrt(said / (_PRIOR_DOF + point.dof))


def _marks(out: Matched, found: dict[str, Found], at: Mark, model_px: float) -> dict[str, Mark]:
    """Marks of the one spot by photo, that of the template first; what they share is the click."""
    moved = np.array([at.u - out.template.u, at.v - out.template.v])
    marks = {at.photo: replace(at, sigma_px=math.hypot(at.sigma_px, model_px))}
    for key, one in found.items():
        u, v = (float(x) for x in one.uv + one.affine @ moved)
        marks[key] = replace(
            at, photo=key, u=u, v=v, sigma_px=math.hypot(one.sigma_px, model_px),
            shared_px=at.shared_px * _scale(one),
        )  # fmt: skip
    for mark in out.clicks:
        marks.setdefault(mark.photo, mark)
    return marks


def _scale(one: Found) -> float:
    """Pixels of a photo by those of the template's, the mean of both directions."""
    return math.sqrt(abs(float(np.linalg.det(one.affine))))


def _agreed(out: Matched, found: dict[str, Found]) -> tuple[Mark, tuple[str, ...]]:
    """Spot that all of the user's clicks mean, in the template's photo.

    Its `sigma_px` is the noise of the template, its `shared_px` how sure the clicks are.
    """
    template = out.template
    moves, alone, shared = [[0.0, 0.0]], [template.sigma_px], [template.shared_px]
    doubts = []
    for mark in out.clicks:
        one = found.get(mark.photo)
        if one is None:
            continue
        move = np.linalg.solve(one.affine, np.array([mark.u, mark.v]) - one.uv)
        sigma = mark.whole_px / _scale(one)
        if np.linalg.norm(move) > _DISAGREE * np.hypot(sigma, template.whole_px):
            doubts.append(
                f"the clicks in photos {template.photo} and {mark.photo} do not show one spot: "
                f"{np.linalg.norm(move):.1f} px between them; the first one counts"
            )
            continue
        moves.append(move.tolist())
        alone.append(mark.sigma_px / _scale(one))
        shared.append(mark.shared_px / _scale(one))
    weight = 1.0 / (np.square(alone) + np.square(shared))
    weight /= weight.sum()
    moved = weight @ np.array(moves)
    # clicks that were matched from one another err alike by what they share
    unsure = math.hypot(float(np.linalg.norm(weight * alone)), float(weight @ np.array(shared)))
    mark = replace(
        template,
        u=template.u + float(moved[0]),
        v=template.v + float(moved[1]),
        # noise of the template itself, which each match compares with
        sigma_px=float(np.median([one.sigma_px for one in found.values()])) / math.sqrt(2.0),
        shared_px=unsure,
    )
    return mark, tuple(doubts)


def _told(out: Matched, found: _Round, marks: dict[str, Mark], place: MeasuredPoints) -> Matched:
    """Result without the matches that do not fit."""
    point = place[0]
    used = dict(zip(point.photo_ids, point.used, strict=True))
    misfit = dict(zip(point.photo_ids, point.normalised, strict=True))
    wrong = {key for key in found.found if not used[key]}
    refused = out.refused | {key: f"{DOES_NOT_FIT} (w = {misfit[key]:.1f})" for key in wrong}
    out = replace(out, refused=refused)
    fits = [key for key in found.found if key not in wrong]
    left = max((misfit[key] for key, is_used in used.items() if is_used), default=0.0)
    if not used[out.template.photo] or left > BLUNDER or not fits:
        return replace(out, why_not=f"what was found {DOES_NOT_FIT} (w = {left:.1f})")
    clicked = {mark.photo for mark in out.clicks}
    matches = [
        MatchedClick(
            mark=marks[key],
            covariance=found.found[key].covariance,
            quality=found.found[key].quality,
        )
        for key in fits
        if key not in clicked
    ]
    if not matches:
        return replace(out, why_not=_why(found.refused | out.refused))
    matches.sort(key=lambda one: -one.quality)
    own = tuple(mark for key, mark in marks.items() if key in clicked)
    return replace(out, own=own, matches=tuple(matches), place=place)
