"""Which photos show a place: the predicted pixel in each, its ellipse, and the best first."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from georef_gis.errors import GeometryError
from georef_gis.frames import Array
from georef_gis.measure.ellipses import axis_azimuth
from georef_gis.measure.locating import locate_points
from georef_gis.measure.measured import MeasuredPoints
from georef_gis.measure.predicting import Predicted, predict, predict_measured
from georef_gis.measure.scene import Scene
from georef_gis.model.control import Mark
from georef_gis.model.intersection_rays import Bools
from georef_gis.model.photo_stack import Ints
from georef_gis.model.terrain import FlatTerrain

# px, one sigma of reading a place off a mosaic
_READ = 1.0
# m; no photo shows a place so far from all of them
_FAR = 100_000.0
# m, and share of the distance: ground nearer than a place by more than this hides it
_HIDES, _HIDES_SHARE = 2.0, 0.02


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sighting:
    """A place in one photo.

    Parameters
    ----------
    uv : shape (2,), px
        Predicted pixel.
    covariance : shape (2, 2), px^2
        By pose, camera and place; a click's own error is not in it.
    semi_major, semi_minor : px
        One sigma along the axes of the ellipse.
    azimuth : rad
        Of the longer axis, clockwise from the top of the image, in [0, pi).
    from_middle
        Distance of the pixel from the middle, in half diagonals.
    gsd : m
        Ground that a pixel there covers, across the view.
    score
        Distance from the middle plus the longer half axis, both in half diagonals: the less the
        better.
    hidden
        Whether the ground stands between, as far as it is known.
    """

    photo_id: str
    uv: Array
    covariance: Array
    semi_major: float
    semi_minor: float
    azimuth: float
    from_middle: float
    gsd: float
    score: float
    hidden: bool


def who_sees(
    scene: Scene,
    p_enu: ArrayLike,
    covariance: ArrayLike,
    *,
    best: int | None = None,
    hidden: bool = False,
) -> list[Sighting]:
    """Photos that show a place which knows nothing of their poses, best first.

    Parameters
    ----------
    p_enu : shape (3,), m
    covariance : shape (3, 3), m^2
    best
        At most so many.
    hidden
        Also photos for which the ground stands between.
    """
    p = np.asarray(p_enu, float)
    photo = _seeing(scene, p)
    place = np.broadcast_to(np.asarray(covariance, float), (len(photo), 3, 3))
    found = predict(scene, photo, np.broadcast_to(p, (len(photo), 3)), place)
    return _ranked(scene, p, found, best, hidden)


def who_sees_on_mosaic(
    scene: Scene, xy: ArrayLike, *, best: int | None = None, hidden: bool = False
) -> list[Sighting]:
    """Photos that show a place which was read off a mosaic of the same photos, best first.

    The mosaic shows it as the photo does that looks at it most steeply, of those that no ground
    hides it from, and errs with that photo.

    Parameters
    ----------
    xy : shape (2,)
        In units of the map.

    Raises
    ------
    GeometryError
        If the ground is not known there.
    """
    p, _ = place_on_map(scene, xy)
    photo = _seeing(scene, p)
    if not len(photo):
        return []
    uv = scene.photos.project(photo, np.broadcast_to(p, (len(photo), 3)))
    covered = _hidden(scene, p, photo, uv)
    away = np.linalg.norm((scene.photos.origin_enu[photo] - p)[:, :2], axis=1)
    first = np.lexsort((away, covered))[0]
    nearest, (u, v) = int(photo[first]), (float(x) for x in uv[first])
    mark = Mark(name="", photo=scene.photos.photos[nearest].id, u=u, v=v, sigma_px=_READ)
    return who_sees_point(locate_points(scene, [mark]), 0, best=best, hidden=hidden)


def who_sees_point(
    points: MeasuredPoints, i: int, *, best: int | None = None, hidden: bool = False
) -> list[Sighting]:
    """Photos that show a measured point, best first; its errors are partly those of the poses."""
    scene, p = points.scene, points.p_enu[i]
    found = predict_measured(points, i, _seeing(scene, p))
    return _ranked(scene, p, found, best, hidden)


def place_on_map(
    scene: Scene,
    xy: ArrayLike,
    *,
    height: float | None = None,
    sigma_h: float = 0.0,
    sigma_v: float = 0.0,
) -> tuple[Array, Array]:
    """Place of a position on the map and its covariance.

    Parameters
    ----------
    xy : shape (2,)
        In units of the map.
    height : m
        Above the ellipsoid; without it that of the ground, with the ground's sigma.
    sigma_h, sigma_v : m
        One sigma of each axis, and of a height that is given.

    Returns
    -------
    p_enu : shape (3,), m
    covariance : shape (3, 3), m^2

    Raises
    ------
    GeometryError
        If the ground is not known there.
    """
    p_enu = _enu_of(scene, np.asarray(xy, float), height)
    if height is None:
        sigma = math.sqrt(float(scene.ground.variance(p_enu[None, :2])[0]))
    else:
        # a surveyed height does not move with the level that photos and ground share
        every = np.arange(len(scene.photos))
        sigma = math.hypot(sigma_v, float(scene.errors.level_sigma(every).max(initial=0.0)))
    return p_enu, np.diag([sigma_h**2, sigma_h**2, sigma**2])


def _enu_of(scene: Scene, xy: Array, height: float | None) -> Array:
    """Place in enu, (3,) m, of a position of the map, (2,), and its height, else the ground's."""
    where = f"place {xy[0]:.2f}, {xy[1]:.2f}"
    if height is None:
        height = float(scene.terrain.height_on_map(scene.frame, xy[None])[0])
    known = math.isfinite(height)
    p_enu = scene.frame.enu_from_map([xy[0], xy[1], height if known else 0.0])
    if not np.all(np.isfinite(p_enu)):
        raise GeometryError(f"{where} lies outside of the map's CRS; check the order x, y")
    away = float(np.min(np.linalg.norm(scene.photos.origin_enu - p_enu, axis=1)))
    if away > _FAR:
        raise GeometryError(
            f"{where} lies {away / 1000.0:.0f} km from the nearest photo; check its CRS and the "
            "order x, y (longitude first)"
        )
    if not known:
        raise GeometryError(
            f"{where}: the ground is not known there; give its height, or a larger DEM"
        )
    return np.asarray(p_enu)


def _seeing(scene: Scene, p: Array) -> Ints:
    """Photos into whose image a place, (3,) m, falls."""
    stack = scene.photos
    every = np.arange(len(stack))
    uv = stack.project(every, np.broadcast_to(p, (len(stack), 3)))
    return np.flatnonzero(stack.contains(every, uv))


def _ranked(
    scene: Scene, p: Array, found: Predicted, best: int | None, hidden: bool
) -> list[Sighting]:
    stack = scene.photos
    covered = _hidden(scene, p, found.photo, found.uv)
    values, vectors = np.linalg.eigh(found.covariance)
    axes = np.sqrt(np.maximum(values, 0.0))
    out = []
    for i, k in enumerate(found.photo):
        photo = stack.photos[k]
        camera = photo.camera
        half = math.hypot(camera.width, camera.height) / 2
        middle = np.array([(camera.width - 1) / 2, (camera.height - 1) / 2])
        away = float(np.linalg.norm(found.uv[i] - middle)) / half
        right, down = vectors[i, :, 1]
        out.append(
            Sighting(
                photo_id=photo.id,
                uv=found.uv[i],
                covariance=found.covariance[i],
                semi_major=float(axes[i, 1]),
                semi_minor=float(axes[i, 0]),
                azimuth=axis_azimuth(right, -down),
                from_middle=away,
                gsd=float(np.linalg.norm(p - photo.pose.origin_enu)) / camera.fx,
                score=away + float(axes[i, 1]) / half,
                hidden=bool(covered[i]),
            )
        )
    out.sort(key=lambda one: (one.hidden, one.score))
    shown = [one for one in out if hidden or not one.hidden]
    return shown if best is None else shown[:best]


def _hidden(scene: Scene, p: Array, photo: Ints, uv: Array) -> Bools:
    """Whether the ground stands between photos and a place."""
    none = np.zeros(len(photo), dtype=bool)
    if isinstance(scene.terrain, FlatTerrain) or not math.isfinite(scene.terrain.detail):
        return none
    start, way = scene.photos.rays(photo, uv)
    above = start[:, 2] > np.nan_to_num(scene.terrain.z_at(start[:, :2]), nan=-np.inf)
    if not np.any(above):
        return none
    hit = scene.terrain.intersect(start[above], way[above])
    far = np.linalg.norm(p - start[above], axis=1)
    nearer = far - np.linalg.norm(hit - start[above], axis=1)
    # a slope seen along its fall: the height's error moves the meeting far along the ray
    steep = np.maximum(np.abs(way[above, 2]), 0.05)
    allowed = (_HIDES + 3.0 * scene.terrain.sigma) / steep + _HIDES_SHARE * far
    none[above] = np.nan_to_num(nearer, nan=-np.inf) > allowed
    return none
