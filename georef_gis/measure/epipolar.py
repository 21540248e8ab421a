"""Where to look in another photo for what was clicked in one: the line that its ray draws there."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from georef_gis.errors import GeometryError
from georef_gis.frames import Array
from georef_gis.measure.clicks import clicks_of, told
from georef_gis.measure.scene import Scene
from georef_gis.model.control import Mark
from georef_gis.model.ground_point import GroundSensitivities, ground_sensitivities
from georef_gis.model.photo_stack import Ints
from georef_gis.model.terrain import FlatTerrain

# m; what stands on the ground is no higher, what lies in it no deeper, beside what it is unsure of
TALLEST, DEEPEST = 10.0, 2.0
# places along the ray
_PLACES = 33
# rad; a ray that comes down less has no place over a height
_FLATTEST = math.radians(0.5)
# share of the way down to the lowest place that is always looked at: no place is in the lens
_NEAREST = 0.05


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Guide:
    """The ray of a click in another photo, from the lowest to the highest place.

    Parameters
    ----------
    photo_id
        The other photo.
    uv : shape (k, 2), px
        Line of pixels.
    sigma_across : shape (k,), px
        One sigma across the line, by both poses and cameras and the click.
    height : shape (k,), m
        Above the ellipsoid of the places.
    p_enu : shape (k, 3), m
    ground_uv : shape (2,), px
        Pixel of the place on the ground; NaN where it is not known or not in the photo.
    """

    photo_id: str
    uv: Array
    sigma_across: Array
    height: Array
    p_enu: Array
    ground_uv: Array

    def width(self, sigmas: float = 3.0) -> Array:
        """Half width of the band to search, px; shape (k,)."""
        return np.asarray(sigmas * self.sigma_across)


def guide_line(
    scene: Scene,
    mark: Mark,
    photo_id: str,
    *,
    low: float | None = None,
    high: float | None = None,
) -> Guide:
    """Line in another photo on which what was clicked lies.

    Parameters
    ----------
    low, high : m
        Heights above the ellipsoid between which it is; by default those of the ground there and
        of what may stand on it.

    Raises
    ------
    GeometryError
        If the mark cannot be used, its ray does not come down, or the photo does not show it.
    """
    found = guide_lines(scene, mark, [photo_id], low=low, high=high)
    if not found:
        raise GeometryError(
            told(mark, f"shows nothing that photo {photo_id} sees; take one that overlaps")
        )
    return found[0]


def guide_lines(
    scene: Scene,
    mark: Mark,
    photo_ids: Sequence[str] | None = None,
    *,
    low: float | None = None,
    high: float | None = None,
) -> list[Guide]:
    """Lines in other photos on which what was clicked lies; photos that do not show it have none.

    Parameters
    ----------
    photo_ids
        By default all others.
    low, high : m
        As in `guide_line`.

    Raises
    ------
    GeometryError
        If the mark cannot be used, or its ray does not come down.
    """
    clicks, refused = clicks_of(scene, [mark])
    if refused:
        raise GeometryError(refused[0])
    ray = _Ray.of(scene, mark, int(clicks.photo[0]), low, high)
    every = [photo.id for photo in scene.photos.photos] if photo_ids is None else photo_ids
    others = np.array([scene.number(key) for key in every if key != mark.photo], dtype=np.int64)
    return _guides(scene, ray, others)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Ray:
    """Places along the ray of a click: `p_enu` (n, 3) m, their derivatives at given heights.

    `ground` (3,) is where it meets the ground, NaN where that is not known.
    """

    photo: int
    p_enu: Array
    by_click: GroundSensitivities
    sigma_px: float
    ground: Array

    @classmethod
    def of(
        cls, scene: Scene, mark: Mark, photo: int, low: float | None, high: float | None
    ) -> _Ray:
        k, uv = np.array([photo]), np.array([[mark.u, mark.v]])
        start, way = (x[0] for x in scene.photos.rays(k, uv))
        if not way[2] < -math.sin(_FLATTEST):
            why = "does not look down: it has no line; click on the ground"
            raise GeometryError(told(mark, why))
        ground = _on_ground(scene, start, way)
        ends = _heights(scene, mark, ground, low, high)
        p = _between(scene, start, way, ends)
        if not np.all(np.isfinite(p)):
            raise GeometryError(told(mark, f"has no place {ends[0]:g} m high; click nearer"))
        n = len(p)
        level = np.broadcast_to([0.0, 0.0, 1.0], (n, 3))
        by_click = ground_sensitivities(
            scene.photos, np.full(n, photo), np.broadcast_to(uv, (n, 2)), p, level
        )
        return cls(
            photo=photo, p_enu=p, by_click=by_click, sigma_px=mark.whole_px, ground=ground
        )  # fmt: skip


def _on_ground(scene: Scene, start: Array, way: Array) -> Array:
    """Where a ray meets the ground, (3,) m; NaN where that is not known."""
    if not start[2] > float(np.nan_to_num(scene.terrain.z_at(start[:2]), nan=-np.inf)):
        return np.full(3, np.nan)
    return np.asarray(scene.terrain.intersect(start[None], way[None])[0])


def _heights(
    scene: Scene, mark: Mark, ground: Array, low: float | None, high: float | None
) -> tuple[float, float]:
    """Lowest and highest place, m above the ellipsoid."""
    if low is None or high is None:
        if not np.all(np.isfinite(ground)):
            why = "does not look at the ground that is known: give the heights low and high"
            raise GeometryError(told(mark, why))
        unsure = 3.0 * math.sqrt(float(scene.ground.variance(ground[None, :2])[0]))
        height = float(scene.frame.origin.geo_from_enu(ground)[2])
        low = height - DEEPEST - unsure if low is None else low
        high = height + TALLEST + unsure if high is None else high
    if not low < high:
        raise GeometryError(told(mark, f"from {low:g} to {high:g} m there is no height between"))
    return low, high


def _between(scene: Scene, start: Array, way: Array, heights: tuple[float, float]) -> Array:
    """Places on a ray from one height to another, the Earth being curved; (n, 3) m."""
    far = []
    for height in heights:
        surface = FlatTerrain(origin=scene.frame.origin, height_ellipsoidal=height)
        if float(surface.z_at(start[:2])) >= start[2]:
            far.append(0.0)
            continue
        far.append(float(np.linalg.norm(surface.intersect(start[None], way[None])[0] - start)))
    share = np.linspace(0.0, 1.0, _PLACES)[:, None]
    nearest = max(far[1], _NEAREST * far[0])
    return np.asarray(start + (far[0] + share * (nearest - far[0])) * way)


def _guides(scene: Scene, ray: _Ray, others: Ints) -> list[Guide]:
    """Lines in those of the photos that show a part of the ray."""
    stack, n = scene.photos, len(ray.p_enu)
    photo, place = np.repeat(others, n), np.tile(np.arange(n), len(others))
    uv = stack.project(photo, ray.p_enu[place]).reshape(len(others), n, 2)
    inside = stack.contains(photo, uv.reshape(-1, 2)).reshape(len(others), n)
    # one place more at each end: the line reaches the border of the picture
    wide = inside.copy()
    wide[:, 1:] |= inside[:, :-1]
    wide[:, :-1] |= inside[:, 1:]
    wide &= np.isfinite(uv[:, :, 0])
    shown = np.flatnonzero(inside.any(axis=1) & (wide.sum(axis=1) >= 2))
    which, at = np.nonzero(wide[shown])
    C = _covariances(scene, ray, others[shown], which, at)
    ground = stack.project(others[shown], np.broadcast_to(ray.ground, (len(shown), 3)))
    ground[~stack.contains(others[shown], ground)] = np.nan
    heights = scene.frame.origin.geo_from_enu(ray.p_enu)[:, 2]
    out = []
    for i, row in enumerate(shown):
        mine = which == i
        own = at[mine]
        out.append(
            Guide(
                photo_id=stack.photos[others[row]].id,
                uv=uv[row, own],
                sigma_across=_across(uv[row, own], C[mine]),
                height=heights[own],
                p_enu=ray.p_enu[own],
                ground_uv=ground[i],
            )
        )
    return out


def _across(uv: Array, C: Array) -> Array:
    """One sigma across a line of pixels (k, 2) by their covariances (k, 2, 2); shape (k,), px."""
    along = np.gradient(uv, axis=0)
    length = np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
    across = np.stack([along[:, 1], -along[:, 0]], axis=1) / length
    return np.asarray(np.sqrt(np.maximum(np.einsum("mi,mij,mj->m", across, C, across), 0.0)))


def _covariances(scene: Scene, ray: _Ray, others: Ints, which: Ints, at: Ints) -> Array:
    """Covariance of pixels at given heights; (m, 2, 2), px^2.

    Parameters
    ----------
    others : shape (g,)
        Photos.
    which, at : shape (m,)
        Photo, by its number among them, and place of each pixel.
    """
    m, errors = len(at), scene.errors
    photo = others[which]
    views = scene.photos.views(photo, ray.p_enu[at])
    J_point = views.by_point
    blocks = errors.blocks(np.column_stack([np.full(len(others), ray.photo), others]))
    J = np.zeros((m, 2, blocks.shape[1]))
    J[:, :, :6] = J_point @ ray.by_click.by_pose[at]
    J[:, :, 6:12] = views.by_pose
    every, rows = np.arange(m)[:, None, None], np.arange(2)[:, None]
    own = np.full(m, ray.photo)
    for k, by_camera in ((own, J_point @ ray.by_click.by_camera[at]), (photo, views.by_camera)):
        first = errors.camera_columns(k) - 6 * len(scene.photos) + 12
        J[every, rows, first[:, None, None] + np.arange(11)] += errors.by_sensor(k, by_camera)
    by_uv = J_point @ ray.by_click.by_uv[at] * ray.sigma_px
    out = J @ blocks[which] @ np.swapaxes(J, 1, 2) + by_uv @ np.swapaxes(by_uv, 1, 2)
    return np.asarray(out)
