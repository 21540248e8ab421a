"""Search of a template along the guide of a click: correlation height by height, across the guide.

All photos are searched for one height together: a pattern that repeats itself, such as the dashes
of a lane, repeats at other heights in photos with another base (vertical line locus; Okutomi and
Kanade, A multiple-baseline stereo, 1993).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from georef_gis.frames import Array
from georef_gis.measure.click_match.patch import (
    SOFT,
    Picture,
    Template,
    blurred,
    footprint_blur,
    mixed,
)
from georef_gis.model.photo_stack import Ints

# a correlation of less says nothing
NOTHING = 0.4
# relative change of the affine map up to which one warped picture does for a stretch of guide
_AFFINE_ALIKE = 0.06
# numbers of one warped picture up to which a stretch may be as long as that
_MOST_PIXELS = 400_000
# stretches of one guide, at most
_MOST_STRETCHES = 24
# None, which OpenCV's type stubs do not allow
_NO_SECOND_MAP: Any = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Way:
    """Where the clicked spot may show in another photo, for m heights.

    Parameters
    ----------
    uv : shape (m, 2), px
        NaN where the photo does not show it.
    affine : shape (m, 2, 2)
        Of pixels of the clicked photo to those of the other, about the spot.
    sigma : px
        One sigma of the guide, across and along.
    band : px
        Half width that is searched.
    """

    uv: Array
    affine: Array
    sigma: float
    band: float

    def across(self) -> Array:
        """Unit vectors across the guide; (m, 2)."""
        good = np.isfinite(self.uv[:, 0])
        along = np.zeros_like(self.uv)
        if np.count_nonzero(good) > 1:
            along[good] = np.gradient(self.uv[good], axis=0)
        length = np.linalg.norm(along, axis=1, keepdims=True)
        unit = np.where(length > 1e-9, along / np.maximum(length, 1e-9), [1.0, 0.0])
        return np.stack([unit[:, 1], -unit[:, 0]], axis=1)

    def step(self) -> float:
        """Pixels from one height to the next."""
        good = self.uv[np.isfinite(self.uv[:, 0])]
        if len(good) < 2:
            return 0.0
        return float(np.median(np.linalg.norm(np.diff(good, axis=0), axis=1)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scores:
    """Correlations in one photo.

    Parameters
    ----------
    values : shape (m, t)
        Height by height and across; -1 where the photo does not show the whole patch.
    uv : shape (m, t, 2), px
    """

    values: Array
    uv: Array

    def by_height(self) -> Array:
        """Best one at each height; shape (m,)."""
        return np.asarray(self.values.max(axis=1))

    @property
    def looked(self) -> int:
        """Places that were looked at."""
        return int(np.count_nonzero(self.values > -1.0))


def search(template: Template, picture: Picture, way: Way) -> Scores:
    """Normalised correlation of a template along the way and across it."""
    steps = math.ceil(way.band)
    t = np.arange(-steps, steps + 1, dtype=np.float64)
    uv = way.uv[:, None] + t[:, None] * way.across()[:, None]
    values = np.full(uv.shape[:2], -1.0)
    for part in _stretches(way):
        _score(template, picture, way.affine[part[len(part) // 2]], uv, part, values)
    return Scores(values=values, uv=uv)


def _stretches(way: Way) -> list[Ints]:
    """Heights that are near enough to each other for one affine map and one small picture."""
    at = np.flatnonzero(np.isfinite(way.uv[:, 0]))
    if not len(at):
        return []
    first, last = way.affine[at[0]], way.affine[at[-1]]
    change = float(np.linalg.norm(np.linalg.solve(first, last) - np.eye(2)))
    scale = math.sqrt(abs(float(np.linalg.det(way.affine[at[len(at) // 2]]))))
    box = (np.ptp(way.uv[at], axis=0) + 2 * way.band) / max(scale, 1e-3)
    # n pieces of a slanted line have together the n-th part of its box
    pieces = max(change / (2 * _AFFINE_ALIKE), float(np.prod(box)) / _MOST_PIXELS)
    return list(np.array_split(at, min(max(1, math.ceil(pieces)), _MOST_STRETCHES, len(at))))


def _score(
    template: Template, picture: Picture, affine: Array, uv: Array, part: Ints, values: Array
) -> None:
    """Fill in the correlations of some heights, `part`, under one affine map."""
    rows, cols = picture.shape[:2]
    rim = np.abs(affine).sum(axis=1) * template.half
    with np.errstate(invalid="ignore"):
        inside = np.all((uv[part] >= rim) & (uv[part] <= [cols - 1, rows - 1] - rim), axis=-1)
    if not inside.any():
        return
    # pixels of the template, from its first to its last place
    middle = uv[part][inside].mean(axis=0)
    y = np.linalg.solve(affine, (uv[part] - middle)[..., None])[..., 0]
    low = np.floor(y[inside].min(axis=0)).astype(int) - template.half - 1
    high = np.ceil(y[inside].max(axis=0)).astype(int) + template.half + 2
    warped = _warped(template, picture, affine, middle, (low, high))
    scale = math.sqrt(abs(float(np.linalg.det(affine))))
    sought = template.blurred(math.hypot(footprint_blur(1.0 / max(scale, 1e-3)), SOFT))
    found = cv2.matchTemplate(warped, sought.astype(np.float32), cv2.TM_CCOEFF_NORMED)
    # the click lies beside the middle of the template's middle pixel
    own = template.offsets[template.half, template.half]
    at = (y + own - low - template.half).astype(np.float32)
    looked = cv2.remap(np.ascontiguousarray(found), at, _NO_SECOND_MAP, cv2.INTER_LINEAR,
                       borderMode=cv2.BORDER_REPLICATE)  # fmt: skip
    values[part] = np.where(inside & np.isfinite(looked), looked, values[part])


def _warped(
    template: Template, picture: Picture, affine: Array, middle: Array, box: tuple[Ints, Ints]
) -> Picture:
    """Photo in pixels of the template, from `low` to `high` about `middle`."""
    low, high = box
    x, y = np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1))
    uv = middle + np.stack([x, y], axis=-1) @ affine.T
    corners = uv[[0, 0, -1, -1], [0, -1, 0, -1]]
    left, top = np.floor(corners.min(axis=0)).astype(int) - 3
    right, bottom = np.ceil(corners.max(axis=0)).astype(int) + 4
    shades = mixed(picture, template.mix, (left, top, right, bottom))
    scale = math.sqrt(abs(float(np.linalg.det(affine))))
    values = blurred(shades.values, math.hypot(footprint_blur(scale), SOFT * scale))
    return np.asarray(
        cv2.remap(
            values,
            shades.at(uv).astype(np.float32),
            _NO_SECOND_MAP,
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )
    )


# -- one height for all photos -------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Level:
    """Height on which the photos agree.

    Parameters
    ----------
    index
        Of the height.
    rival
        Score of the best other height, in that of this one.
    """

    index: int
    rival: float


def common_level(ways: list[Way], scores: list[Scores], apart: float) -> Level:
    """Height at which most photos show the template.

    Parameters
    ----------
    apart : px
        Peaks that are nearer in the photo with the largest parallax are one.
    """
    total = np.zeros(len(ways[0].uv))
    for way, one in zip(ways, scores, strict=True):
        total += evidence(_widened(one.by_height(), _slack(way)))
    best = int(np.argmax(total))
    # the widened peak has a flat top
    top = np.flatnonzero(total >= total[best] - 1e-9)
    best = int(top[np.searchsorted(top, np.median(top))])
    if total[best] <= 0.0:
        return Level(index=best, rival=1.0)
    step = max((way.step() for way in ways), default=0.0)
    near = max(max(_slack(way) for way in ways), math.ceil(apart / step) if step > 0.0 else 1)
    others = np.r_[total[: max(best - 2 * near, 0)], total[best + 2 * near + 1 :]]
    return Level(index=best, rival=float(others.max(initial=0.0) / total[best]))


def evidence(correlation: Array) -> Array:
    """What correlations count for: nothing below `NOTHING`, and more than in proportion above."""
    return np.asarray(np.maximum(correlation - NOTHING, 0.0) ** 2)


def near_level(way: Way, index: int) -> slice:
    """Heights at which a photo may show what lies on the common one, its pose being unsure."""
    slack = _slack(way)
    return slice(max(index - slack, 0), index + slack + 1)


def _slack(way: Way) -> int:
    """Heights by which a photo's own peak may lie beside the common one."""
    step = way.step()
    return len(way.uv) if step <= 0.0 else min(math.ceil(way.band / step), len(way.uv))


def _widened(values: Array, slack: int) -> Array:
    """Largest value within some heights; (m,)."""
    n = min(2 * slack + 1, 2 * len(values) - 1)
    return np.asarray(
        cv2.dilate(
            values.astype(np.float32)[None],
            np.ones((1, n), np.uint8),
            borderType=cv2.BORDER_REPLICATE,
        )[0]
    ).astype(np.float64)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Peak:
    """Best place in a photo: its pixel, height, correlation; and that of the best one elsewhere."""

    uv: Array
    level: int
    score: float
    second: float


def peak_of(scores: Scores, at: slice, radius: float) -> Peak:
    """Best place among some heights; what lies within `radius` px of it is not elsewhere."""
    values, uv = scores.values[at], scores.uv[at]
    level, across = np.unravel_index(int(np.argmax(values)), values.shape)
    best = uv[level, across]
    with np.errstate(invalid="ignore"):
        elsewhere = np.linalg.norm(uv - best, axis=-1) > radius
    second = float(values[elsewhere].max(initial=-1.0))
    return Peak(
        uv=best, level=int(level) + at.start, score=float(values[level, across]), second=second
    )
