"""Where places show in photos by what is known, and how far off that may be."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from georef_gis.frames import Array
from georef_gis.measure.measured import MeasuredPoints, photos_in
from georef_gis.measure.scene import Scene
from georef_gis.model.photo_stack import Ints, Views


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Predicted:
    """Pixels of m pairs of a photo and a place.

    `photo` (m,), `uv` (m, 2) px, `covariance` (m, 2, 2) px^2 by pose, camera and place; a click's
    own error is not in it.
    """

    photo: Ints
    uv: Array
    covariance: Array


def predict(scene: Scene, photo: Ints, p_enu: Array, place: Array) -> Predicted:
    """Pixels of places that know nothing of the poses.

    Parameters
    ----------
    photo : shape (m,)
    p_enu : shape (m, 3), m
    place : shape (m, 3, 3), m^2
        Covariance of each place.
    """
    views = scene.photos.views(photo, p_enu)
    J = _by_unknowns(scene, photo, views)
    covariance = J @ scene.errors.blocks(photo[:, None]) @ np.swapaxes(J, 1, 2)
    covariance += views.by_point @ place @ np.swapaxes(views.by_point, 1, 2)
    return Predicted(photo=photo, uv=views.uv, covariance=covariance)


def predict_measured(points: MeasuredPoints, i: int, photo: Ints) -> Predicted:
    """Pixels of measured point `i` in photos, (m,): its errors are partly those of the poses."""
    scene = points.scene
    n, size = len(scene.photos), len(scene.errors.cameras.covariance)
    m = len(photo)
    views = scene.photos.views(photo, np.broadcast_to(points.p_enu[i], (m, 3)))
    rows = points.shared[3 * i : 3 * i + 3]
    used = np.union1d(photos_in(rows, n), photo)
    columns = scene.errors.columns(used)
    by_point = views.by_point.reshape(2 * m, 3)
    J = by_point @ rows[:, columns].toarray()
    own = _by_unknowns(scene, photo, views)
    for a, k in enumerate(np.searchsorted(used, photo)):
        at = slice(2 * a, 2 * a + 2)
        J[at, 6 * k : 6 * k + 6] += own[a, :, :6]
        J[at, 6 * len(used) : 6 * len(used) + size] += own[a, :, 6:]
    J[:, -1] = 0.0  # the level lifts place and photos alike
    place = points.own[i] + np.outer(points.by_height[i], points.by_height[i]) * float(
        scene.ground.variance(points.p_enu[i : i + 1, :2])[0]
    )
    C = np.einsum("aij,jk,alk->ail", J.reshape(m, 2, -1), scene.errors.joint(used),
                  J.reshape(m, 2, -1))  # fmt: skip
    C = C + views.by_point @ place @ np.swapaxes(views.by_point, 1, 2)
    return Predicted(photo=photo, uv=views.uv, covariance=C)


def _by_unknowns(scene: Scene, photo: Ints, views: Views) -> Array:
    """Derivatives of pixels by the pose of their photo and by all cameras; (m, 2, 6 + 11 C)."""
    m, size = len(photo), len(scene.errors.cameras.covariance)
    J = np.zeros((m, 2, 6 + size))
    J[:, :, :6] = views.by_pose
    first = scene.errors.camera_columns(photo) - 6 * len(scene.photos) + 6
    columns = first[:, None, None] + np.arange(11)
    by_sensor = scene.errors.by_sensor(photo, views.by_camera)
    J[np.arange(m)[:, None, None], np.arange(2)[:, None], columns] = by_sensor
    return J
