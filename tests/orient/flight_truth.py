"""What a simulated flight without pictures is: camera, errors, ground, path and their laws.

Projection, distortion, frames and time are own lines on numpy and scipy and share nothing with
the estimators.

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
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

# Top of the image forward, looking down.
R_BODY_FROM_CAM = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
R_ENU_FROM_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
# px; a feature at the very border is not found
BORDER = 4.0


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
        return pixels_in_photo(self.camera_true, self.truth, self.shared_true, photo, p_enu)


def pixels_in_photo(camera: SimCamera, truth: Truth, shared: Shared, i: int, p_enu: Array) -> Array:
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
