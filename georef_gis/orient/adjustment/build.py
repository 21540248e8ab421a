"""From oriented photos and tie points to a block: sensor axes, cameras, flights, first places."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from georef_gis.errors import AdjustmentError, GeometryError
from georef_gis.frames import Array
from georef_gis.model.camera import Camera
from georef_gis.model.photo import OrientedPhoto
from georef_gis.model.pose import Pose
from georef_gis.model.terrain import Terrain
from georef_gis.model.tie_points import TiePoints
from georef_gis.model.virtual_pinhole import virtual_pinhole, virtual_uv
from georef_gis.orient.adjustment.block import Block, marked_points


def R_turned_from_sensor(degrees: int) -> Array:
    """Camera axes of a picture after its pixels were turned clockwise, from those of the sensor."""
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    return np.linalg.matrix_power(quarter, degrees // 90 % 4)


def uv_in_sensor(uv: Array, width: int, height: int, degrees: int) -> Array:
    """Pixels of the sensor's array from those of the turned one, (m, 2).

    `width` and `height` are the sensor's, px. Turning clockwise by a quarter takes (u, v) to
    (height - 1 - v, u).
    """
    u, v = uv[:, 0], uv[:, 1]
    match degrees % 360:
        case 90:
            return np.stack([v, height - 1 - u], axis=1)
        case 180:
            return np.stack([width - 1 - u, height - 1 - v], axis=1)
        case 270:
            return np.stack([width - 1 - v, u], axis=1)
    return uv


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SensorViews:
    """Photos in the axes of the sensor that took them, whatever an editor did to the pixels.

    Photos of a lens model that the adjustment does not know get a pinhole of their own camera,
    whose parameters are held (`held`).
    """

    photos: tuple[OrientedPhoto, ...]
    turned_deg: tuple[int, ...]
    cameras: tuple[Camera, ...]
    camera_of: NDArray[np.int64]
    held: tuple[str, ...]

    def uv(self, index: int, uv: Array) -> Array:
        """Pixels of the camera of `cameras` from those of the stored photo; (m, 2).

        NaN where the lens looks further off its axis than a pinhole can.
        """
        own = self.photos[index].camera
        out = uv_in_sensor(uv, own.width, own.height, self.turned_deg[index])
        camera = self.cameras[self.camera_of[index]]
        if camera.model == own.model:
            return out
        return virtual_uv(own.ray(out))

    def scale(self, index: int, uv: Array) -> Array:
        """Pixels of the adjustment per pixel of the photo about places in it; (m, 2) -> (m,)."""
        own, camera = self.photos[index].camera, self.cameras[self.camera_of[index]]
        if camera.model == own.model:
            return np.ones(len(uv))
        along = [self.uv(index, uv + half) - self.uv(index, uv - half) for half in np.eye(2) / 2]
        return np.asarray(np.sqrt(np.abs(np.linalg.det(np.stack(along, axis=-1)))))

    def observations(self, ties: TiePoints) -> TiePoints:
        """Tie points in the pixels of the sensors; those that a pinhole cannot see fall away."""
        uv, sigma = ties.uv.copy(), ties.sigma.copy()
        for i in np.unique(ties.photo):
            mine = ties.photo == i
            uv[mine] = self.uv(int(i), ties.uv[mine])
            sigma[mine] *= self.scale(int(i), ties.uv[mine])
        seen = np.all(np.isfinite(uv), axis=1) & np.isfinite(sigma) & (sigma > 0)
        if np.all(seen):
            return replace(ties, uv=uv, sigma=sigma)
        whole = replace(ties, uv=np.where(seen[:, None], uv, 0.0), sigma=np.where(seen, sigma, 1.0))
        return whole.selected(seen)

    def stored_pose(self, index: int, pose: Pose) -> Pose:
        """Pose of the stored picture from that of the sensor."""
        T = R_turned_from_sensor(self.turned_deg[index])
        return replace(pose, R_enu_from_cam=pose.R_enu_from_cam @ T.T)


def sensor_views(
    photos: Sequence[OrientedPhoto], cameras: Mapping[str, Camera], turned: Mapping[str, int]
) -> SensorViews:
    """Views of photos by their sensors.

    Parameters
    ----------
    cameras
        By id, as the sensor took the pictures.
    turned
        Photo id -> degrees clockwise by which its pixels were turned after the exposure.
    """
    ids = list(dict.fromkeys(photo.photo.camera_id for photo in photos))
    views = []
    for photo in photos:
        degrees = turned.get(photo.id, 0)
        R = photo.pose.R_enu_from_cam @ R_turned_from_sensor(degrees)
        camera = cameras[photo.photo.camera_id]
        pose = replace(photo.pose, R_enu_from_cam=R)
        views.append(OrientedPhoto(photo=photo.photo, camera=camera, pose=pose))
    used, held = [], []
    for name in ids:
        camera = cameras[name]
        if camera.model != "brown":
            held.append(name)
            camera = virtual_pinhole(camera)
        used.append(camera)
    return SensorViews(
        photos=tuple(views),
        turned_deg=tuple(turned.get(photo.id, 0) for photo in photos),
        cameras=tuple(used),
        camera_of=np.array([ids.index(photo.photo.camera_id) for photo in photos], dtype=np.int64),
        held=tuple(held),
    )


def first_places(block: Block, terrain: Terrain) -> Array:
    """Where the rays of the start meet the ground, averaged over the photos; (k, 3), m.

    Tie points first, then the marked control points: those that are surveyed stand there.

    Raises
    ------
    AdjustmentError
        If no ray of any photo meets the ground.
    """
    ties = block.ties
    place, count = np.zeros((ties.n_points, 3)), np.zeros(ties.n_points)
    start = block.start or block.poses
    for i in np.unique(ties.photo):
        mine = np.flatnonzero(ties.photo == i)
        hit = _hits(block, int(i), start[i], ties.uv[mine], terrain)
        good = np.all(np.isfinite(hit), axis=1)
        np.add.at(place, ties.point[mine[good]], hit[good])
        np.add.at(count, ties.point[mine[good]], 1.0)
    if ties.n_points and not np.any(count):
        raise AdjustmentError("no photo looks at the ground: check heights and angles of the tags")
    place /= np.maximum(count, 1.0)[:, None]
    # a point that nobody saw on the ground starts amid the others
    place[count == 0] = place[count > 0].mean(axis=0) if np.any(count) else 0.0
    marked = _marked_places(block, terrain)
    return np.vstack([place, marked]) if len(marked) else place


def _hits(block: Block, i: int, pose: Pose, uv: Array, terrain: Terrain) -> Array:
    camera = block.cameras[block.camera_of[i]].camera
    d = pose.enu_directions(camera.ray(uv))
    try:
        hit = terrain.intersect(pose.origin_enu, d)
    except GeometryError:
        return np.full((len(uv), 3), np.nan)
    # a ray that grazes the ground says little of where its point lies
    far = np.linalg.norm(hit[:, :2] - pose.origin_enu[:2], axis=1)
    up = pose.origin_enu[2] - hit[:, 2]
    return np.asarray(np.where((far < 10.0 * up)[:, None], hit, np.nan))


def _marked_places(block: Block, terrain: Terrain) -> Array:
    control = block.control
    if control is None:
        return np.zeros((0, 3))
    out = []
    start = block.start or block.poses
    for index in marked_points(control):
        place = control.p_enu[index].copy()
        if not np.all(np.isfinite(place)) or not np.all(np.isfinite(control.sigma[index])):
            marks = np.flatnonzero(control.point == index)
            hits = np.vstack([
                _hits(block, int(i), start[i], control.uv[[m]], terrain)
                for m, i in zip(marks, control.photo[marks], strict=True)
            ])  # fmt: skip
            seen = hits[np.all(np.isfinite(hits), axis=1)]
            ground = seen.mean(axis=0) if len(seen) else np.zeros(3)
            known = np.isfinite(place) & np.isfinite(control.sigma[index])
            place = np.where(known, place, ground)
        out.append(place)
    return np.array(out).reshape(-1, 3)
