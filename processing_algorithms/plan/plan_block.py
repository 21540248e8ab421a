"""What an adjustment will make of a planned flight: a part of it through the adjustment itself.

Observations without noise are laid over the planned photos and adjusted with the priors that a
flight with these sensors gets; the covariances are then those that the program would state.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from georef_gis.frames import R_BODY_FROM_CAM_NADIR, R_ENU_FROM_NED_SAME_PLACE, Array, exp_so3
from georef_gis.measure.budget.forecast import Sensors
from georef_gis.measure.preflight.layout import Plan, PlannedLine
from georef_gis.model.camera import Camera
from georef_gis.model.photo import OrientedPhoto, Photo
from georef_gis.model.pose import Pose
from georef_gis.model.tie_points import TiePoints
from georef_gis.orient.adjustment.adjust import Adjusted, adjust
from georef_gis.orient.adjustment.block import Block, ControlInput
from georef_gis.orient.adjustment.checks import observability
from georef_gis.orient.adjustment.distances import distance_sigmas
from georef_gis.orient.adjustment.priors import MountPrior, camera_prior, tag_prior

# Photos that stand for the block: so many lines of so many, the next to the middle of the plan.
LINES, PER_LINE = 5, 9
# lines across that stand for those that cross
CROSSING = 2
# observations that a photo has, share of the photos that find a point, px of a tie point
PER_PHOTO, FOUND, TIE_PX = 150, 0.8, 0.5
# s from a line to the next
TURN_S = 20.0
# rad and m, one sigma: how photos are off level, off the line's heading, and off their place
TILT, CRAB, WANDER = np.radians(2.0), np.radians(3.0), 0.7
# of the height, one sigma: relief that all sites have, against which heights are told
RELIEF = 0.02
# m and rad, one sigma: no place and no angle is known better
LEAST_SIGMA = np.repeat([1e-3, 1e-5], 3)
# px and m, one sigma: a mark on a control point, and its survey
MARK_PX, SURVEY = 0.5, 0.02


@dataclass(frozen=True, slots=True, kw_only=True)
class BlockPromise:
    """What the adjustment of the planned flight would state; one sigma, m.

    Parameters
    ----------
    photos, points, rays
        Adjusted; the rays are the median of a point.
    east, north, up
        Of points that three photos or more see, the median.
    distances
        Pairs of a length and the sigma of distances about as long.
    held
        Names of what the flight could not tell, so that what was known before holds it.
    control
        Surveyed points that were adjusted to.
    """

    photos: int
    points: int
    rays: float
    east: float
    north: float
    up: float
    distances: tuple[tuple[float, float], ...]
    held: tuple[str, ...]
    control: int

    @property
    def horizontal(self) -> float:
        """One sigma per axis, m."""
        return float(np.sqrt((self.east**2 + self.north**2) / 2.0))


def promise(
    plan: Plan, camera: Camera, sensors: Sensors, *, tie_px: float = TIE_PX, control: int = 0,
    tilt: float = TILT,
) -> BlockPromise | None:  # fmt: skip
    """Promise of a plan; None where its photos share no points.

    Parameters
    ----------
    tie_px
        One sigma of a tie point, px.
    control
        Surveyed points, spread over the block.
    tilt : rad
        Usual roll and pitch; level photos of one height hardly tell a focal length.
    """
    lines = representative(plan)
    speed = plan.layouts[0].speed
    photos = planned_photos(lines, camera, sensors, speed=speed, tilt=tilt)
    block, first = planned_block(photos, camera, sensors, tie_px=tie_px, control=control)
    if not block.ties.n_points:
        return None
    return _told(adjust(block, first), control)


def _told(adjusted: Adjusted, control: int) -> BlockPromise:
    points = adjusted.points
    sigma = np.sqrt(np.einsum("kii->ki", points.covariance))
    sound = np.all(np.isfinite(sigma), axis=1)
    good = sound & (points.rays >= 3) if np.any(sound & (points.rays >= 3)) else sound
    east, north, up = np.median(sigma[good], axis=0)
    distances = distance_sigmas(points, adjusted.covariances)
    return BlockPromise(
        photos=len(adjusted.poses), points=len(points), rays=float(np.median(points.rays)),
        east=float(east), north=float(north), up=float(up),
        distances=tuple((d.length_m, d.sigma_m) for d in distances),
        held=tuple(u.name for u in observability(adjusted).unknowns if u.held), control=control,
    )  # fmt: skip


def representative(plan: Plan) -> list[PlannedLine]:
    """Lines and photos next to the middle of a plan, few enough to be adjusted in seconds."""
    middle = np.vstack([line.photos for line in plan.lines]).mean(axis=0)
    heights = [line.height for line in plan.lines]
    # crossing lines are few, and at another height
    usual = heights[0]
    out = []
    for height, most in ((usual, LINES), *((h, CROSSING) for h in sorted({*heights} - {usual}))):
        same = [line for line in plan.lines if line.height == height]
        off = [float(np.min(np.hypot(*(line.photos - middle).T))) for line in same]
        chosen = sorted(np.argsort(off, kind="stable")[:most])
        out += [_shortened(same[k], middle) for k in chosen]
    return out


def _shortened(line: PlannedLine, middle: Array) -> PlannedLine:
    nearest = int(np.argmin(np.hypot(*(line.photos - middle).T)))
    start = int(np.clip(nearest - PER_LINE // 2, 0, max(len(line.photos) - PER_LINE, 0)))
    part = slice(start, start + PER_LINE)
    return PlannedLine(
        name=line.name, photos=line.photos[part], headings=line.headings[part], height=line.height
    )


def planned_photos(
    lines: Sequence[PlannedLine], camera: Camera, sensors: Sensors, *, speed: float,
    tilt: float = TILT,
) -> list[OrientedPhoto]:  # fmt: skip
    """Photos about where they are planned, with the covariance that the sensors give a pose."""
    s, rng = sensors, np.random.default_rng(2)
    sigmas = np.array([s.gnss, s.gnss, s.gnss_up, s.roll_pitch, s.roll_pitch, s.yaw])
    covariance = np.diag(np.maximum(sigmas, LEAST_SIGMA) ** 2)
    nadir = R_ENU_FROM_NED_SAME_PLACE @ R_BODY_FROM_CAM_NADIR
    out, clock = [], 0.0
    for line in lines:
        steps = np.hypot(*np.diff(line.photos, axis=0, prepend=line.photos[:1]).T)
        times = clock + np.cumsum(steps) / speed
        for k, (place, heading) in enumerate(zip(line.photos, line.headings, strict=True)):
            velocity = speed * np.array([np.sin(heading), np.cos(heading), 0.0])
            off = rng.standard_normal(6) * [WANDER, WANDER, WANDER, tilt, tilt, CRAB]
            pose = Pose(
                origin_enu=np.array([*place, line.height]) + off[:3],
                R_enu_from_cam=exp_so3(off[3:]) @ exp_so3([0.0, 0.0, -float(heading)]) @ nadir,
                covariance=covariance, velocity_enu=velocity, rate_enu=np.zeros(3),
            )  # fmt: skip
            name = f"{line.name}.{k + 1}"
            photo = Photo(
                id=name, path=Path(name), width=camera.width, height=camera.height,
                camera_id=camera.id, time_gps=float(times[k]), course=float(heading),
                ground_speed=speed,
            )  # fmt: skip
            out.append(OrientedPhoto(photo=photo, camera=camera, pose=pose))
        clock = float(times[-1]) + TURN_S
    return out


def planned_block(
    photos: Sequence[OrientedPhoto], camera: Camera, sensors: Sensors, *, tie_px: float,
    control: int,
) -> tuple[Block, Array]:  # fmt: skip
    """Block of planned photos with observations as they will be, and the places of its points."""
    ground = _points(photos, camera)
    seen = _seen(photos, ground)
    rng = np.random.default_rng(1)
    found = [rows[rng.random(len(rows)) < FOUND] for rows in seen]
    photo = np.concatenate([np.full(len(rows), i) for i, rows in enumerate(found)])
    point = np.concatenate(found)
    kept = np.bincount(point, minlength=len(ground)) >= 2
    photo, point = photo[kept[point]], (np.cumsum(kept) - 1)[point[kept[point]]]
    ground = ground[kept]
    order = np.lexsort((photo, point))
    photo, point = photo[order], point[order]
    ids = tuple(p.id for p in photos)
    ties = TiePoints(
        photo_ids=ids, photo=photo.astype(np.int32), point=point.astype(np.int32),
        uv=_pixels(photos, photo, ground[point]), sigma=np.full(len(photo), tie_px),
    )  # fmt: skip
    mount = MountPrior(
        sigma_lever=sensors.lever_arm, sigma_boresight=sensors.boresight, sigma_clock=sensors.time
    )
    marks = _control(photos, control)
    block = Block(
        photo_ids=ids, poses=tuple(p.pose for p in photos),
        camera_of=np.zeros(len(photos), dtype=np.int64),
        cameras=(camera_prior(camera),),
        flights=(tag_prior("flight", photos, np.arange(len(photos)), mount),),
        ties=ties, control=marks, sigma_level=max(sensors.gnss_up, 0.5) if marks else 0.0,
    )  # fmt: skip
    first = ground if marks is None else np.vstack([ground, marks.p_enu])
    return block, first


def _points(photos: Sequence[OrientedPhoto], camera: Camera) -> Array:
    """Places on the ground under the photos, with some relief; (k, 3), m."""
    places = np.array([photo.pose.origin_enu for photo in photos])
    reach = 0.5 * places[:, 2].max() * max(camera.width / camera.fx, camera.height / camera.fy)
    low, high = places[:, :2].min(axis=0) - reach, places[:, :2].max(axis=0) + reach
    footprint = float(np.median(places[:, 2]) ** 2) * camera.width * camera.height
    footprint /= camera.fx * camera.fy
    density = PER_PHOTO / (FOUND * footprint)
    rng = np.random.default_rng(0)
    xy = rng.uniform(low, high, (int(np.ceil(density * np.prod(high - low))), 2))
    z = RELIEF * float(np.median(places[:, 2])) * rng.standard_normal(len(xy))
    return np.column_stack([xy, z])


def _seen(photos: Sequence[OrientedPhoto], ground: Array) -> list[NDArray[np.intp]]:
    """Indices of the points in each photo."""
    return [np.flatnonzero(photo.contains(photo.project(ground))) for photo in photos]


def _pixels(photos: Sequence[OrientedPhoto], photo: Array, p_enu: Array) -> Array:
    uv = np.empty((len(photo), 2))
    for i, one in enumerate(photos):
        mine = photo == i
        uv[mine] = one.project(p_enu[mine])
    return uv


def _control(photos: Sequence[OrientedPhoto], count: int) -> ControlInput | None:
    """Surveyed points about the rim and the middle of the photos, marked wherever they show."""
    if count == 0:
        return None
    places = np.array([photo.pose.origin_enu for photo in photos])
    camera = photos[0].camera
    # beside a single line too: on a line they would not hold its tilt
    seen_half = 0.5 * places[:, 2].min() * min(
        camera.width / camera.fx, camera.height / camera.fy
    )  # fmt: skip
    middle = places[:, :2].mean(axis=0)
    half = np.maximum(np.ptp(places[:, :2], axis=0) / 2.0, 0.5 * seen_half)
    angle = 2.0 * np.pi * np.arange(max(count - 1, 1)) / max(count - 1, 1) + np.pi / 4.0
    rim = middle + 0.7 * half * np.column_stack([np.cos(angle), np.sin(angle)]) * np.sqrt(2.0)
    xy = np.vstack([middle, rim])[:count]
    p = np.column_stack([xy, np.zeros(len(xy))])
    seen = _seen(photos, p)
    photo = np.concatenate([np.full(len(rows), i) for i, rows in enumerate(seen)])
    point = np.concatenate(seen).astype(np.int64)
    marked = np.unique(point)
    p, point = p[marked], np.searchsorted(marked, point)
    return ControlInput(
        names=tuple(f"control {k + 1}" for k in range(len(p))), p_enu=p,
        sigma=np.full((len(p), 3), SURVEY), used=np.ones(len(p), dtype=np.bool_),
        photo=photo.astype(np.int64), point=point,
        uv=_pixels(photos, photo, p[point]), sigma_px=np.full(len(photo), MARK_PX),
    )  # fmt: skip
