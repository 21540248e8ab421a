"""Flights with truth and observations, without pictures: what an adjustment is judged by.

Projection, distortion, frames and time are own lines on numpy and scipy and share nothing with
the estimators; `oriented_photos` and `ties` at the end put the measured values into the
package's classes.

Model
-----
All positions are in enu, m; body is forward, right, down; camera x right, y down, z forward;
(0, 0) is the centre of the first pixel. At the exposure time t of a photo

- p_cam = p_imu + R_enu_from_body @ lever;
- R_enu_from_cam = R_enu_from_body @ Exp(boresight) @ R_BODY_FROM_CAM;
- the navigation is read at t + clock:
  p_nav = p_imu + clock * velocity + bias - e_p,
  R_nav = Exp(-e_theta) @ Exp(clock * rate) @ R_enu_from_body,

with rotation vectors in body (boresight) or enu (all others). The errors (e_p, e_theta) are
"true - measured", white plus Gauss-Markov per component. `velocity` and `rate` are those of the
IMU, constant over readout and clock offset; a row is exposed at (v / (height - 1) - 0.5) *
readout from the exposure time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from georef_gis.model.camera import Camera
from georef_gis.model.photo import OrientedPhoto, Photo
from georef_gis.model.pose import Pose
from georef_gis.model.tie_points import TiePoints

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

# Top of the image forward, looking down.
R_BODY_FROM_CAM = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
R_ENU_FROM_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
# px; a feature at the very border is not found
BORDER = 4.0
# s; from the end of a line to the start of the next
TURN_S = 12.0


def turn(rotvec: ArrayLike) -> Array:
    """Rotation matrices of rotation vectors, rad; shape (..., 3) -> (..., 3, 3)."""
    v = np.asarray(rotvec, dtype=np.float64)
    return np.asarray(Rotation.from_rotvec(v.reshape(-1, 3)).as_matrix()).reshape(*v.shape, 3)


def rotvec(R: ArrayLike) -> Array:
    """Rotation vectors, rad, of rotation matrices; shape (..., 3, 3) -> (..., 3)."""
    m = np.asarray(R, dtype=np.float64)
    return np.asarray(Rotation.from_matrix(m.reshape(-1, 3, 3)).as_rotvec()).reshape(m.shape[:-1])


@dataclass(frozen=True, slots=True, kw_only=True)
class SimCamera:
    """Brown camera; `values` are fx fy cx cy k1 k2 k3 p1 p2 b1 b2, shape (11,), px."""

    width: int
    height: int
    values: Array
    readout_s: float = 0.0

    def pixels(self, p_cam: Array) -> Array:
        """Pixels of points in camera axes, shape (..., 3) -> (..., 2); NaN 60 deg off the axis."""
        fx, fy, cx, cy, k1, k2, k3, p1, p2, b1, b2 = self.values
        ahead = p_cam[..., 2] > 0.5 * np.sqrt((p_cam**2).sum(axis=-1))
        z = np.where(ahead, p_cam[..., 2], np.nan)
        x, y = p_cam[..., 0] / z, p_cam[..., 1] / z
        rr = x**2 + y**2
        grow = 1 + k1 * rr + k2 * rr**2 + k3 * rr**3
        xd = grow * x + 2 * p1 * x * y + p2 * (rr + 2 * x**2)
        yd = grow * y + 2 * p2 * x * y + p1 * (rr + 2 * y**2)
        return np.stack([cx + (fx + b1) * xd + b2 * yd, cy + fy * yd], axis=-1)

    def inside(self, uv: Array) -> NDArray[np.bool_]:
        """Whether pixels lie in the image, clear of its border; shape (..., 2) -> (...)."""
        size = np.array([self.width - 1, self.height - 1])
        with np.errstate(invalid="ignore"):
            return np.asarray(np.all((uv > BORDER) & (uv < size - BORDER), axis=-1))


@dataclass(frozen=True, slots=True, kw_only=True)
class NavigationModel:
    """Errors of position (enu, m) and attitude (rotation vector in enu, rad), each shape (6,).

    Component i of exposures at t1 and t2 has the covariance
    white_i^2 [t1 = t2] + slow_i^2 exp(-|t1 - t2| / tau_i); components are independent.
    """

    white: Array
    slow: Array
    tau: Array

    def covariance(self, times: Array) -> Array:
        """Joint covariance of each component; shape (n,) s -> (6, n, n)."""
        lag = np.abs(times[:, None] - times)
        white = self.white[:, None, None] ** 2 * np.eye(len(times))
        return np.asarray(
            white + self.slow[:, None, None] ** 2 * np.exp(-lag / self.tau[:, None, None])
        )

    def draw(self, rng: np.random.Generator, times: Array) -> Array:
        """Errors at times that do not fall; shape (n,) -> (n, 6)."""
        state = self.slow * rng.standard_normal(6)
        out = np.empty((len(times), 6))
        for i in range(len(times)):
            if i:
                keep = np.exp(-(times[i] - times[i - 1]) / self.tau)
                fresh = self.slow * np.sqrt(1 - keep**2)
                state = keep * state + fresh * rng.standard_normal(6)
            out[i] = state
        return out + self.white * rng.standard_normal(out.shape)


def navigation_model(
    position: tuple[float, float],
    tilt_deg: tuple[float, float],
    yaw_deg: tuple[float, float],
    *,
    tau_position: float = 100.0,
    tau_attitude: float = 60.0,
    vertical: float = 1.0,
) -> NavigationModel:
    """Model of (white, slow) sigmas, m and deg; heights are `vertical` times worse."""

    def six(k: int) -> Array:
        angles = np.radians([tilt_deg[k], tilt_deg[k], yaw_deg[k]])
        return np.concatenate([position[k] * np.array([1.0, 1.0, vertical]), angles])

    return NavigationModel(
        white=six(0), slow=six(1), tau=np.repeat([tau_position, tau_attitude], 3).astype(float)
    )


# GNSS and attitude as independent errors of 5 cm and 0.1/0.1/0.2 deg
TIGHT = navigation_model((0.05, 0.0), (0.1, 0.0), (0.2, 0.0))
# the same sigmas, most of it slow, as a smoothed trajectory has them
TIGHT_SLOW = navigation_model(
    (0.02, 0.046), (0.03, 0.095), (0.05, 0.19), tau_position=30.0, tau_attitude=30.0
)
GPS_TAGS = navigation_model((0.7, 2.0), (1.0, 3.0), (1.0, 3.0), vertical=1.5)
RTK = navigation_model((0.01, 0.017), (0.1, 0.3), (0.2, 0.6), vertical=1.5)


@dataclass(frozen=True, slots=True, kw_only=True)
class Shared:
    """What the photos of a flight share: values, or their prior sigmas.

    `boresight` is in body axes, rad; `lever` from IMU to camera in body axes, m; `bias` of the
    GNSS in enu, m; `clock`, s, how late the navigation was read. Shapes (3,), (3,), (3,), ().
    """

    boresight: Array
    lever: Array
    bias: Array
    clock: float


def shared_sigmas(
    boresight_deg: float, lever: float, bias: float, clock: float, *, bias_up: float | None = None
) -> Shared:
    """Prior sigmas, deg, m, m and s, alike on each axis unless `bias_up` is given."""
    up = bias if bias_up is None else bias_up
    return Shared(
        boresight=np.full(3, math.radians(boresight_deg)),
        lever=np.full(3, lever),
        bias=np.array([bias, bias, up]),
        clock=clock,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Relief:
    """Ground: a slope and waves; amplitudes in m, wave vectors in rad/m."""

    slope: Array
    amplitudes: Array
    waves: Array
    phases: Array

    def z_at(self, xy: ArrayLike) -> Array:
        """Height of the ground, m in enu; shape (..., 2) -> (...)."""
        xy = np.asarray(xy, dtype=np.float64)
        angles = xy @ self.waves.T + self.phases
        return np.asarray(xy @ self.slope + np.sin(angles) @ self.amplitudes)


@dataclass(frozen=True, slots=True, kw_only=True)
class Line:
    """A straight line of exposures; `course` clockwise from north, rad; `height` over z = 0."""

    start: tuple[float, float]
    course: float
    height: float
    speed: float
    spacing: float
    n: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Conditions:
    """What a flight is made with; every default may be replaced."""

    # fx fy cx cy k1 k2 k3 p1 p2 b1 b2 and one sigma of the truth about them
    width: int = 4000
    height: int = 3000
    focal: float = 2500.0
    principal_off: tuple[float, float] = (21.0, -14.0)
    distortion: tuple[float, ...] = (-0.03, 0.01, -0.002, 5e-4, -3e-4)
    sigma_focal: float = 15.0
    sigma_principal: float = 8.0
    sigma_distortion: tuple[float, ...] = (0.01, 0.01, 0.003, 3e-4, 3e-4)
    sigma_affinity: float = 0.0
    readout_s: float = 0.0
    sigma_readout_s: float = 0.0
    navigation: NavigationModel = TIGHT
    sigmas: Shared = field(default_factory=lambda: shared_sigmas(1.0, 0.05, 0.02, 0.01))
    lever: tuple[float, float, float] = (0.12, -0.05, 0.08)
    # rms of roll and pitch, deg, and of the angular rates, deg/s
    tilt_deg: float = 3.0
    rate_deg_s: float = 3.0
    relief: float = 4.0
    obs_per_photo: float = 400.0
    # share of the visible points that a photo's matches give
    found: float = 0.9
    noise_px: float = 0.5
    outliers: float = 0.0
    control: int = 0
    check: int = 0
    sigma_survey: tuple[float, float] = (0.01, 0.01)
    mark_px: float = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class Surveyed:
    """Control or check points and their marks.

    `p_true` and `p` (as surveyed) have shape (k, 3), m; `sigma` (3,), m. Marks: `photo`,
    `point` (m,), `uv` (m, 2), px, each with `sigma_px`.
    """

    p_true: Array
    p: Array
    sigma: Array
    photo: Ints
    point: Ints
    uv: Array
    sigma_px: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Truth:
    """How the vehicle flew; n exposures.

    `times` (n,), s; `p_imu`, `p_cam`, `velocity` (of the IMU), `rate` (n, 3), enu;
    `R_enu_from_body`, `R_enu_from_cam` (n, 3, 3).
    """

    times: Array
    p_imu: Array
    R_enu_from_body: Array
    velocity: Array
    rate: Array
    p_cam: Array
    R_enu_from_cam: Array


@dataclass(frozen=True, slots=True, kw_only=True)
class SimFlight:
    """A flight: truth, what was measured, and the model both were drawn from.

    `camera_sigma` (11,) and `sigma_readout_s` are the sigmas of `camera_true` about `camera`;
    `shared_true` was drawn about `shared` (zeros and the nominal lever arm) with `sigmas`.
    `errors` (n, 6) is (e_p, e_theta). `photo`, `point` (m,), `uv` (m, 2) are the observations in
    order of the points; `outlier` (m,) tells the wrong ones; `points` (k, 3) the true places.
    """

    seed: int
    conditions: Conditions
    camera_true: SimCamera
    camera: SimCamera
    camera_sigma: Array
    sigma_readout_s: float
    truth: Truth
    navigation: NavigationModel
    p_nav: Array
    R_nav: Array
    errors: Array
    shared_true: Shared
    shared: Shared
    sigmas: Shared
    relief: Relief
    points: Array
    photo: Ints
    point: Ints
    uv: Array
    outlier: NDArray[np.bool_]
    noise_px: float
    control: Surveyed
    check: Surveyed

    @property
    def n_photos(self) -> int:
        """Number of exposures."""
        return len(self.truth.times)

    def true_pixels(self, photo: int, p_enu: Array) -> Array:
        """Pixels of ground points without noise; shape (..., 3) m -> (..., 2) px."""
        return _pixels(self.camera_true, self.truth, self.shared_true, photo, p_enu)


def _pixels(camera: SimCamera, truth: Truth, shared: Shared, i: int, p_enu: Array) -> Array:
    """Pixels of points in photo i; a rolling shutter's rows have their own poses."""
    uv = camera.pixels((p_enu - truth.p_cam[i]) @ truth.R_enu_from_cam[i])
    if camera.readout_s == 0.0:
        return uv
    R_body_from_cam = turn(shared.boresight) @ R_BODY_FROM_CAM
    for _ in range(8):
        t = (uv[..., 1:] / (camera.height - 1) - 0.5) * camera.readout_s
        R_body = turn(np.nan_to_num(t) * truth.rate[i]) @ truth.R_enu_from_body[i]
        arm = p_enu - truth.p_imu[i] - t * truth.velocity[i]
        in_body = np.einsum("...ji,...j->...i", R_body, arm) - shared.lever
        uv = camera.pixels(in_body @ R_body_from_cam)
    return uv


# ---------------------------------------------------------------------------------------------
# Making a flight
# ---------------------------------------------------------------------------------------------


def fly(seed: int, lines: list[Line], conditions: Conditions) -> SimFlight:
    """One flight with every source of error drawn from its sigma."""
    rng = np.random.default_rng(seed)
    c = conditions
    camera, camera_true, camera_sigma = _cameras(rng, c)
    relief = _relief(rng, c.relief)
    shared = Shared(boresight=np.zeros(3), lever=np.array(c.lever), bias=np.zeros(3), clock=0.0)
    shared_true = Shared(
        boresight=c.sigmas.boresight * rng.standard_normal(3),
        lever=shared.lever + c.sigmas.lever * rng.standard_normal(3),
        bias=c.sigmas.bias * rng.standard_normal(3),
        clock=float(c.sigmas.clock * rng.standard_normal()),
    )
    truth = _trajectory(rng, lines, c, shared_true)
    errors = c.navigation.draw(rng, truth.times)
    late = turn(shared_true.clock * truth.rate)
    p_nav = truth.p_imu + shared_true.clock * truth.velocity + shared_true.bias - errors[:, :3]
    R_nav = turn(-errors[:, 3:]) @ late @ truth.R_enu_from_body
    points, seen = _ground(rng, c, relief, lines, (camera_true, truth, shared_true))
    photo, point, uv, outlier = seen
    surveyed = [
        _survey(rng, c, n, relief, lines, (camera_true, truth, shared_true))
        for n in (c.control, c.check)
    ]
    return SimFlight(
        seed=seed,
        conditions=c,
        camera_true=camera_true,
        camera=camera,
        camera_sigma=camera_sigma,
        sigma_readout_s=c.sigma_readout_s,
        truth=truth,
        navigation=c.navigation,
        p_nav=p_nav,
        R_nav=R_nav,
        errors=errors,
        shared_true=shared_true,
        shared=shared,
        sigmas=c.sigmas,
        relief=relief,
        points=points,
        photo=photo,
        point=point,
        uv=uv,
        outlier=outlier,
        noise_px=c.noise_px,
        control=surveyed[0],
        check=surveyed[1],
    )


_Scene = tuple[SimCamera, Truth, Shared]
_Seen = tuple[Ints, Ints, Array, NDArray[np.bool_]]


def _cameras(rng: np.random.Generator, c: Conditions) -> tuple[SimCamera, SimCamera, Array]:
    middle = np.array([(c.width - 1) / 2, (c.height - 1) / 2]) + c.principal_off
    nominal = np.array([c.focal, c.focal, *middle, *c.distortion, 0.0, 0.0])
    draw = rng.standard_normal(11)
    # One focal length: the affinity b1, b2 is what tells fx from fy.
    draw[1] = draw[0]
    sigma = np.array(
        [c.sigma_focal] * 2
        + [c.sigma_principal] * 2
        + [*c.sigma_distortion]
        + [c.sigma_affinity] * 2
    )
    readout = c.readout_s + c.sigma_readout_s * float(rng.standard_normal())
    size = {"width": c.width, "height": c.height}
    return (
        SimCamera(**size, values=nominal, readout_s=c.readout_s),
        SimCamera(**size, values=nominal + sigma * draw, readout_s=readout),
        sigma,
    )


def _relief(rng: np.random.Generator, size: float) -> Relief:
    k = 6
    lengths = rng.uniform(60.0, 400.0, k)
    ways = rng.uniform(0.0, 2 * np.pi, k)
    waves = 2 * np.pi / lengths[:, None] * np.stack([np.cos(ways), np.sin(ways)], axis=1)
    # Short waves are low: slopes stay below some 15 deg.
    amplitudes = size * lengths / 400.0 * rng.uniform(0.3, 1.0, k)
    return Relief(
        slope=size / 4.0 * rng.normal(0.0, 0.03, 2),
        amplitudes=amplitudes,
        waves=waves,
        phases=rng.uniform(0.0, 2 * np.pi, k),
    )


def _trajectory(
    rng: np.random.Generator, lines: list[Line], c: Conditions, shared: Shared
) -> Truth:
    times, courses, speeds, places = [], [], [], []
    t = 100.0
    for line in lines:
        along = np.arange(line.n) * line.spacing
        way = np.array([math.sin(line.course), math.cos(line.course)])
        xy = np.array(line.start) + along[:, None] * way
        places.append(np.column_stack([xy, np.full(line.n, line.height)]))
        times.append(t + along / line.speed)
        courses.append(np.full(line.n, line.course))
        speeds.append(np.full(line.n, line.speed))
        t = times[-1][-1] + TURN_S
    course, speed = np.concatenate(courses), np.concatenate(speeds)
    n = len(course)
    crab = np.repeat(rng.normal(0.0, math.radians(4.0), len(lines)), [line.n for line in lines])
    yaw = course + crab + rng.normal(0.0, math.radians(1.5), n)
    tilt = rng.normal(0.0, math.radians(c.tilt_deg), (n, 2))
    angles = np.column_stack([yaw, tilt])
    R_body = R_ENU_FROM_NED @ Rotation.from_euler("ZYX", angles).as_matrix()
    velocity = np.column_stack([speed * np.sin(course), speed * np.cos(course), np.zeros(n)])
    velocity = velocity + rng.normal(0.0, 0.3, (n, 3))
    p_imu = np.concatenate(places) + rng.normal(0.0, [1.0, 1.0, 0.7], (n, 3))
    R_body_from_cam = turn(shared.boresight) @ R_BODY_FROM_CAM
    return Truth(
        times=np.concatenate(times),
        p_imu=p_imu,
        R_enu_from_body=R_body,
        velocity=velocity,
        rate=rng.normal(0.0, math.radians(c.rate_deg_s), (n, 3)),
        p_cam=p_imu + R_body @ shared.lever,
        R_enu_from_cam=R_body @ R_body_from_cam,
    )


def _area(lines: list[Line], c: Conditions, margin: float) -> tuple[Array, Array]:
    """Corners of the box of all lines, widened by `margin` of half the image's shorter side, m."""
    ends = []
    for line in lines:
        way = np.array([math.sin(line.course), math.cos(line.course)])
        ends += [np.array(line.start), line.start + (line.n - 1) * line.spacing * way]
    reach = margin * max(line.height for line in lines) * min(c.width, c.height) / 2 / c.focal
    return np.min(ends, axis=0) - reach, np.max(ends, axis=0) + reach


def _look(
    rng: np.random.Generator, scene: _Scene, p: Array, noise: float, found: float
) -> tuple[Ints, Ints, Array]:
    """What every photo sees of points: photo, point, uv with noise, in order of the points."""
    camera, truth, shared = scene
    photos, points, pixels = [], [], []
    for i, centre in enumerate(truth.p_cam):
        # Beyond 65 deg from the vertical nothing is seen: 45 deg to the corner, and the tilt.
        near = np.hypot(*(p[:, :2] - centre[:2]).T) < 2.2 * (centre[2] - p[:, 2])
        candidates = np.flatnonzero(near & (rng.random(len(p)) < found))
        uv = _pixels(camera, truth, shared, i, p[candidates])
        inside = camera.inside(uv)
        n = np.count_nonzero(inside)
        photos.append(np.full(n, i))
        points.append(candidates[inside])
        pixels.append(uv[inside] + noise * rng.standard_normal((n, 2)))
    photo, point, uv = (np.concatenate(x) for x in (photos, points, pixels))
    order = np.lexsort((photo, point))
    return photo[order], point[order], uv[order]


def _ground(
    rng: np.random.Generator, c: Conditions, relief: Relief, lines: list[Line], scene: _Scene
) -> tuple[Array, _Seen]:
    low, high = _area(lines, c, 1.6)
    heights = np.repeat([line.height for line in lines], [line.n for line in lines])
    footprint = float(np.mean(heights**2)) * c.width * c.height / c.focal**2
    k = int(np.ceil(np.prod(high - low) * c.obs_per_photo / (c.found * footprint)))
    xy = rng.uniform(low, high, (k, 2))
    p = np.column_stack([xy, relief.z_at(xy)])
    # Grass, stones, roofs: no surface of a formula is the ground itself.
    p[:, 2] += rng.normal(0.0, 0.1, k)
    photo, point, uv = _look(rng, scene, p, c.noise_px, c.found)
    rays = np.bincount(point, minlength=k)
    keep = rays[point] >= 2
    number = np.cumsum(rays >= 2) - 1
    photo, point, uv = photo[keep], number[point[keep]], uv[keep]
    outlier = rng.random(len(uv)) < c.outliers
    way = rng.uniform(0.0, 2 * np.pi, len(uv))
    off = rng.uniform(5.0, 200.0, len(uv)) * outlier
    uv = uv + off[:, None] * np.stack([np.cos(way), np.sin(way)], axis=1)
    return p[rays >= 2], (photo, point, uv, outlier)


def _survey(
    rng: np.random.Generator,
    c: Conditions,
    n: int,
    relief: Relief,
    lines: list[Line],
    scene: _Scene,
) -> Surveyed:
    low, high = _area(lines, c, 0.5)
    # Stratified: corners and middle first, so that few points still span the site.
    share = np.array([[0.08, 0.08], [0.92, 0.92], [0.5, 0.5], [0.08, 0.92], [0.92, 0.08]])
    spread = np.concatenate([share, rng.uniform(0.03, 0.97, (max(n - 5, 0), 2))])[:n]
    xy = low + (high - low) * np.clip(spread + rng.normal(0.0, 0.02, (n, 2)), 0.0, 1.0)
    p = np.column_stack([xy, relief.z_at(xy)])
    sigma = np.array([c.sigma_survey[0], c.sigma_survey[0], c.sigma_survey[1]])
    surveyed = p + sigma * rng.standard_normal((n, 3))
    photo, point, uv = _look(rng, scene, p, c.mark_px, 1.0)
    return Surveyed(
        p_true=p,
        p=surveyed,
        sigma=sigma,
        photo=photo,
        point=point,
        uv=uv,
        sigma_px=c.mark_px,
    )


# ---------------------------------------------------------------------------------------------
# Flights
# ---------------------------------------------------------------------------------------------


def serpentine(
    lines: int,
    photos_per_line: int,
    *,
    height: float = 90.0,
    speeds: tuple[float, float] = (15.0, 15.0),
    forward: float = 0.75,
    side: float = 0.6,
    course: float = math.radians(90.0),
    conditions: Conditions | None = None,
) -> list[Line]:
    """Parallel lines about (0, 0), there and back; speeds of odd and even lines, m/s.

    `forward` and `side` are the overlaps of neighbouring photos and lines over z = 0.
    """
    c = conditions or Conditions()
    spacing = (1 - forward) * height * c.height / c.focal
    apart = (1 - side) * height * c.width / c.focal
    way = np.array([math.sin(course), math.cos(course)])
    right = np.array([math.cos(course), -math.sin(course)])
    out = []
    for i in range(lines):
        back = i % 2 == 1
        half = (photos_per_line - 1) / 2 * spacing
        start = (i - (lines - 1) / 2) * apart * right + (half if back else -half) * way
        out.append(
            Line(
                start=(float(start[0]), float(start[1])),
                course=course + (math.pi if back else 0.0),
                height=height,
                speed=speeds[i % 2],
                spacing=spacing,
                n=photos_per_line,
            )
        )
    return out


# A narrow view over nearly flat ground and a smooth flight: what the reference does not state,
# chosen so that its standard deviations come out. Fast turns alone would tell the clock.
REFERENCE = {
    "width": 2700,
    "height": 1800,
    "relief": 1.5,
    "rate_deg_s": 0.5,
    "obs_per_photo": 382.0,
}


def calibration_flight(seed: int, *, slow: bool = False, **changes: object) -> SimFlight:
    """96 photos, crossed lines at 70 and 110 m, with and against a wind (15 and 22 m/s).

    The flight of the reference "One-step adjustment with Ceres": some 3 200 points, 37 000
    observations; navigation 0.05 m and 0.1/0.1/0.2 deg, independent from photo to photo, or with
    `slow` mostly slow with a correlation time of 30 s.
    """
    base = Conditions(
        navigation=TIGHT_SLOW if slow else TIGHT,
        sigmas=shared_sigmas(2.0, 0.5, 0.1, 0.05),
        **REFERENCE,  # type: ignore[arg-type]
    )
    c = replace(base, **changes)  # type: ignore[arg-type]
    lines: list[Line] = []
    for height in (70.0, 110.0):
        for course in (90.0, 0.0):
            # Both heights cover one square: spacings in m are those of 90 m.
            block = serpentine(4, 6, height=90.0, speeds=(15.0, 22.0), forward=0.57, side=0.57,
                               course=math.radians(course), conditions=c)  # fmt: skip
            lines += [replace(line, height=height) for line in block]
    return fly(seed, lines, c)


def one_height(seed: int, **changes: object) -> SimFlight:
    """The lower half of the calibration flight: 48 photos, one height."""
    base = Conditions(
        sigmas=shared_sigmas(2.0, 0.5, 0.1, 0.05),
        **REFERENCE,  # type: ignore[arg-type]
    )
    c = replace(base, **changes)  # type: ignore[arg-type]
    lines: list[Line] = []
    for course in (90.0, 0.0):
        lines += serpentine(4, 6, height=70.0, speeds=(15.0, 22.0), forward=0.64, side=0.64,
                            course=math.radians(course), conditions=c)  # fmt: skip
    return fly(seed, lines, c)


def survey(
    seed: int,
    lines: int = 4,
    photos_per_line: int = 8,
    *,
    height: float = 90.0,
    speeds: tuple[float, float] = (15.0, 15.0),
    forward: float = 0.75,
    side: float = 0.6,
    **changes: object,
) -> SimFlight:
    """Parallel lines at one height; `changes` are fields of `Conditions`."""
    c = Conditions(**changes)  # type: ignore[arg-type]
    plan = serpentine(
        lines, photos_per_line, height=height, speeds=speeds, forward=forward, side=side,
        conditions=c,
    )  # fmt: skip
    return fly(seed, plan, c)


def strip(seed: int, n: int = 8, *, forward: float = 0.75, **changes: object) -> SimFlight:
    """One straight line."""
    return survey(seed, 1, n, forward=forward, **changes)  # type: ignore[arg-type]


def two_photos(seed: int, **changes: object) -> SimFlight:
    """Two overlapping photos."""
    return strip(seed, 2, **changes)


def gps_only(seed: int, lines: int = 4, photos_per_line: int = 8, **changes: object) -> SimFlight:
    """Navigation as tags give it: 0.7 m white and 2 m slow, 1 deg white and 3 deg slow."""
    base: dict[str, object] = {
        "navigation": GPS_TAGS,
        "sigmas": shared_sigmas(2.0, 0.1, 0.5, 0.05),
    }
    return survey(seed, lines, photos_per_line, **(base | changes))  # type: ignore[arg-type]


def rtk(seed: int, lines: int = 4, photos_per_line: int = 8, **changes: object) -> SimFlight:
    """RTK positions of 2 cm (3 cm in height) with an autopilot's attitude."""
    base: dict[str, object] = {
        "navigation": RTK,
        "sigmas": shared_sigmas(2.0, 0.02, 0.005, 0.005),
    }
    return survey(seed, lines, photos_per_line, **(base | changes))  # type: ignore[arg-type]


def many(
    seed: int, n_photos: int = 167, obs_per_photo: float = 3000.0, **changes: object
) -> SimFlight:
    """A large flight by tags, for timing; lines of some 17 photos."""
    per_line = min(n_photos, 17)
    c = Conditions(
        **({"navigation": GPS_TAGS, "obs_per_photo": obs_per_photo} | changes)  # type: ignore[arg-type]
    )
    plan = serpentine(-(-n_photos // per_line), per_line, conditions=c)
    plan[-1] = replace(plan[-1], n=n_photos - per_line * (len(plan) - 1))
    return fly(seed, plan, c)


# ---------------------------------------------------------------------------------------------
# Into the package's classes
# ---------------------------------------------------------------------------------------------


def cross(v: Array) -> Array:
    """Matrix of v x; shape (3,) -> (3, 3)."""
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def pose_jacobian(flight: SimFlight, i: int) -> Array:
    """Camera pose error (dp, dtheta) by (e_p, e_theta, boresight, lever, bias, clock); (6, 16).

    To first order, for errors of lever arm, boresight, bias and clock about `flight.shared`.
    """
    R, t = flight.R_nav[i], flight.truth
    arm = R @ flight.shared.lever
    J = np.zeros((6, 16))
    J[:3, 0:3], J[3:, 3:6], J[3:, 6:9] = np.eye(3), np.eye(3), R
    J[:3, 9:12], J[:3, 12:15] = R, -np.eye(3)
    J[3:, 15] = -t.rate[i]
    J[:3, 15] = -t.velocity[i]
    # The arm turns with the body, not with the boresight.
    for col in (3, 4, 5, 15):
        J[:3, col] += cross(J[3:, col]) @ arm
    return J


def marginal_covariance(flight: SimFlight, i: int) -> Array:
    """Covariance of the direct pose of photo i, mount, bias and clock included; (6, 6)."""
    m, s = flight.navigation, flight.sigmas
    variances = np.concatenate(
        [m.white**2 + m.slow**2, s.boresight**2, s.lever**2, s.bias**2, [s.clock**2]]
    )
    J = pose_jacobian(flight, i)
    out = J @ np.diag(variances) @ J.T
    return np.asarray((out + out.T) / 2)


def camera_of(flight: SimFlight, *, true: bool = False) -> Camera:
    """Nominal (or true) camera, with the sigmas of focal length and principal point."""
    c = flight.camera_true if true else flight.camera
    names = ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "p1", "p2", "b1", "b2")
    return Camera(
        id="sim",
        width=c.width,
        height=c.height,
        **{name: float(v) for name, v in zip(names, c.values, strict=True)},
        readout_s=c.readout_s,
        sigma_f=0.0 if true else float(flight.camera_sigma[0]),
        sigma_c=0.0 if true else float(flight.camera_sigma[2]),
    )


def photo_ids(flight: SimFlight) -> tuple[str, ...]:
    """Names of the photos in order of time."""
    return tuple(f"sim_{i:04d}" for i in range(flight.n_photos))


def oriented_photos(flight: SimFlight, *, true: bool = False) -> list[OrientedPhoto]:
    """Photos with nominal camera and navigation pose; with `true`, the truth."""
    camera, t = camera_of(flight, true=true), flight.truth
    shared = flight.shared_true if true else flight.shared
    R_body = t.R_enu_from_body if true else flight.R_nav
    p_imu = t.p_imu if true else flight.p_nav
    R_cam = R_body @ turn(shared.boresight) @ R_BODY_FROM_CAM
    arm = R_body @ shared.lever
    out = []
    for i, name in enumerate(photo_ids(flight)):
        pose = Pose(
            origin_enu=p_imu[i] + arm[i],
            R_enu_from_cam=R_cam[i],
            covariance=np.zeros((6, 6)) if true else marginal_covariance(flight, i),
            kind="navigation",
            velocity_enu=t.velocity[i] + np.cross(t.rate[i], arm[i]),
            rate_enu=t.rate[i],
        )
        photo = Photo(
            id=name,
            path=Path(name),
            width=camera.width,
            height=camera.height,
            camera_id=camera.id,
            time_gps=float(t.times[i]),
        )
        out.append(OrientedPhoto(photo=photo, camera=camera, pose=pose))
    return out


def ties(flight: SimFlight) -> TiePoints:
    """The observations, outliers among them."""
    return TiePoints(
        photo_ids=photo_ids(flight),
        photo=flight.photo.astype(np.int32),
        point=flight.point.astype(np.int32),
        uv=flight.uv,
        sigma=np.full(len(flight.uv), flight.noise_px),
    )
