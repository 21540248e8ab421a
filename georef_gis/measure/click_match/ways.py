"""Photos in which a clicked spot is looked for, and where in them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from georef_gis.frames import Array
from georef_gis.measure.click_match.patch import Picture
from georef_gis.measure.click_match.search import Way
from georef_gis.measure.epipolar import Guide, guide_lines
from georef_gis.measure.measured import MeasuredPoints
from georef_gis.measure.scene import Scene
from georef_gis.measure.who_sees import Sighting, who_sees_point
from georef_gis.model.control import Mark
from georef_gis.model.ground_point import ground_normal, ground_sensitivities

# sizes of pixels of two photos on the ground, one in the other, that are still compared
_COARSER = 2.5
# rad; from farther aside what stands on the ground looks different
_WIDEST = math.radians(55.0)
# sigmas of the guide, and px beside them, that are searched
_SIGMAS, _BESIDE = 3.5, 1.5
# px; a pose that is less sure is not searched for
MOST_BAND = 400.0
# px of the photo with the largest parallax from one height to the next
_STEP = 0.7
_MOST_HEIGHTS = 2500
# sigmas of the height of a spot that is clicked in several photos
_SURE_HEIGHT = 4.0
# m; no height is taken for surer
_LEAST_HEIGHT = 0.3
# photos decoded at a time
_AT_ONCE = 4
# px of a cut-out beside what is searched
RIM = 48

PictureOf = Callable[[str], Picture]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class View:
    """Part of another photo that may show the clicked spot.

    Parameters
    ----------
    photo_id
        The photo.
    way
        In pixels of the part.
    picture : shape (rows, cols, bands)
    corner : shape (2,), px
        Pixel (u, v) of the photo that is the part's first one.
    angle : rad
        Between the two photos' rays: what fixes the height, and makes them look different.
    turn : rad
        One sigma by which the two are turned against each other.
    """

    photo_id: str
    way: Way
    picture: Picture
    corner: Array
    angle: float
    turn: float


def neighbours(
    scene: Scene, points: MeasuredPoints, photo_id: str, *, most: int
) -> tuple[str, ...]:
    """Photos that show a clicked spot like the clicked photo does: near ones, and far apart ones.

    Near ones look alike, those that look from different sides fix the place.
    """
    sights = {one.photo_id: one for one in who_sees_point(points, 0)}
    own = sights.pop(photo_id, None)
    if own is None:
        return ()
    p = points.p_enu[0]
    rays = {key: _ray(scene, key, p) for key in (photo_id, *sights)}
    angle = {key: _between(rays[key], rays[photo_id]) for key in sights}
    fit = [
        key
        for key, one in sights.items()
        if angle[key] <= _WIDEST and 1.0 / _COARSER <= one.gsd / own.gsd <= _COARSER
    ]
    fit.sort(key=lambda key: angle[key] + abs(math.log(sights[key].gsd / own.gsd)))
    chosen = fit[: (most + 1) // 2]
    rest = fit[len(chosen) :]
    while rest and len(chosen) < most:
        taken = [photo_id, *chosen]
        far = max(rest, key=lambda key: min(_between(rays[key], rays[k]) for k in taken))
        chosen.append(far)
        rest.remove(far)
    return tuple(chosen)


def _ray(scene: Scene, photo_id: str, p: Array) -> Array:
    d = p - scene.photos.origin_enu[scene.number(photo_id)]
    return np.asarray(d / np.linalg.norm(d))


def _between(a: Array, b: Array) -> float:
    return float(np.arccos(np.clip(a @ b, -1.0, 1.0)))


def finest(points: MeasuredPoints, marks: Sequence[Mark]) -> Mark:
    """The mark whose photo shows most of a spot."""
    sights: dict[str, Sighting] = {one.photo_id: one for one in who_sees_point(points, 0)}
    shown = [mark for mark in marks if mark.photo in sights]
    return min(shown, key=lambda mark: sights[mark.photo].gsd) if shown else marks[0]


def heights_of(points: MeasuredPoints) -> tuple[float | None, float | None]:
    """Lowest and highest place above the ellipsoid, m; None where one photo tells no height."""
    if points.methods[0] == "locate":
        return None, None
    height = float(points.scene.frame.origin.geo_from_enu(points.p_enu[0])[2])
    unsure = _SURE_HEIGHT * math.sqrt(float(points.each[0][2, 2])) + _LEAST_HEIGHT
    return height - unsure, height + unsure


def views_of(
    scene: Scene,
    mark: Mark,
    photo_ids: Sequence[str],
    picture_of: PictureOf,
    heights: tuple[float | None, float | None],
) -> tuple[list[View], dict[str, str]]:
    """Parts of photos that may show a click, all for the same heights; and why others do not."""
    guides = guide_lines(scene, mark, photo_ids, low=heights[0], high=heights[1])
    refused = {key: "does not show it" for key in photo_ids}
    kept: list[Guide] = []
    for guide in guides:
        band = _band(guide)
        if band > MOST_BAND:
            refused[guide.photo_id] = (
                f"its pose is too unsure to search: {band:.0f} px beside the guide; adjust first"
            )
        else:
            del refused[guide.photo_id]
            kept.append(guide)
    ways = _ways(scene, mark, kept)
    with ThreadPoolExecutor(_AT_ONCE) as pool:
        views = pool.map(lambda one: _cut(scene, mark, one[0], one[1], picture_of),
                         zip(kept, ways, strict=True))  # fmt: skip
        return list(views), refused


def _band(guide: Guide) -> float:
    return _SIGMAS * float(guide.sigma_across.max()) + _BESIDE


def _ways(scene: Scene, mark: Mark, guides: Sequence[Guide]) -> list[Way]:
    """Guides at heights so near to each other that the search misses none."""
    if not guides:
        return []
    length = max(float(np.linalg.norm(np.diff(guide.uv, axis=0), axis=1).sum()) for guide in guides)
    every = np.concatenate([guide.height for guide in guides])
    count = int(np.clip(math.ceil(length / _STEP) + 1, 33, _MOST_HEIGHTS))
    heights = np.linspace(float(every.min()), float(every.max()), count)
    return [_way(scene, mark, guide, heights) for guide in guides]


def _way(scene: Scene, mark: Mark, guide: Guide, heights: Array) -> Way:
    order = np.argsort(guide.height)
    at, p = guide.height[order], guide.p_enu[order]
    affine = _affine(scene, mark, guide.photo_id, p).reshape(len(p), 4)

    def between(values: Array) -> Array:
        return np.stack(
            [np.interp(heights, at, column, left=np.nan, right=np.nan) for column in values.T],
            axis=1,
        )

    return Way(
        uv=between(guide.uv[order]),
        affine=between(affine).reshape(-1, 2, 2),
        sigma=float(guide.sigma_across.max()),
        band=_band(guide),
    )


def _affine(scene: Scene, mark: Mark, photo_id: str, p: Array) -> Array:
    """Pixels of the other photo by those of the clicked one, over the ground's slope; (m, 2, 2)."""
    m = len(p)
    own, other = (np.full(m, scene.number(key)) for key in (mark.photo, photo_id))
    uv = np.broadcast_to([mark.u, mark.v], (m, 2))
    normal = ground_normal(scene.terrain, p)
    by_uv = ground_sensitivities(scene.photos, own, uv, p, normal).by_uv
    return np.asarray(scene.photos.views(other, p).by_point @ by_uv)


def _cut(scene: Scene, mark: Mark, guide: Guide, way: Way, picture_of: PictureOf) -> View:
    """What is needed of a photo: the photo itself need not be kept."""
    picture = picture_of(guide.photo_id)
    scale = float(np.nanmax(np.abs(way.affine).sum(axis=2)))
    rim = way.band + RIM * max(scale, 1.0)
    low = np.maximum(np.floor(np.nanmin(way.uv, axis=0) - rim).astype(int), 0)
    high = np.maximum(np.ceil(np.nanmax(way.uv, axis=0) + rim).astype(int) + 1, low)
    part = picture[low[1] : high[1], low[0] : high[0]].copy()
    spot = guide.p_enu[len(guide.p_enu) // 2]
    return View(
        photo_id=guide.photo_id,
        way=replace(way, uv=way.uv - low),
        picture=part,
        corner=low.astype(np.float64),
        angle=_between(_ray(scene, guide.photo_id, spot), _ray(scene, mark.photo, spot)),
        turn=_turn(scene, mark.photo, guide.photo_id),
    )


def _turn(scene: Scene, one: str, other: str) -> float:
    """One sigma, rad, of the angles of two photos against each other; the largest axis counts."""
    blocks = [scene.photos.covariance[scene.number(key), 3:, 3:] for key in (one, other)]
    return math.sqrt(sum(float(np.linalg.eigvalsh(C)[-1]) for C in blocks))
