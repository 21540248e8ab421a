"""The same adjustment by Ceres: COLMAP's reprojection and manifolds, own priors through pyceres.

An oracle for tests: it shares no line with the adjustment it judges. Residuals of COLMAP are
unweighted pixels, so every prior is scaled by the noise of the pixels, and covariances by its
square. COLMAP has neither skew nor a rolling shutter: flights with them are refused.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import adjustment_flights as sim
import numpy as np
import pyceres
import pycolmap
import pycolmap.cost_functions
from numpy.typing import NDArray

Array = NDArray[np.float64]

# FULL_OPENCV's order of the parameters in that of the flights: fx fy cx cy k1 k2 k3 p1 p2
COLMAP_ORDER = [0, 1, 2, 3, 4, 5, 8, 6, 7]
# m, rad or s; a sigma of zero holds a value to less than matters here
LEAST = 1e-7
# px; one focal length for both axes
SIGMA_FX_FY = 1e-3


@dataclass(frozen=True, slots=True, kw_only=True)
class OracleResult:
    """What Ceres found.

    `origins` (n, 3) and `R_enu_from_cam` (n, 3, 3); `pose_covariance` (n, 6, 6) of
    (dp_enu, dtheta_enu), R_true = Exp(dtheta) R; `camera` fx fy cx cy k1 k2 k3 p1 p2 (9,);
    `shared_covariance` (19, 19) of boresight, lever, bias, clock and those nine;
    `points` (k, 3), NaN where outliers leave less than two rays; `control` the adjusted control
    points; `point_covariance` by index of the point. `sigma0` is 1 where the sigmas hold.
    """

    origins: Array
    R_enu_from_cam: Array
    pose_covariance: Array
    shared: sim.Shared
    camera: Array
    shared_covariance: Array
    points: Array
    control: Array
    point_covariance: dict[int, Array]
    sigma0: float
    iterations: int
    quaternion_norm_error: float
    solve_s: float
    covariance_s: float

    @property
    def sigma_boresight_deg(self) -> Array:
        """One sigma of the boresight, deg; shape (3,)."""
        return np.degrees(np.sqrt(np.diag(self.shared_covariance)[:3]))

    @property
    def sigma_lever(self) -> Array:
        """One sigma of the lever arm, m; shape (3,)."""
        return np.sqrt(np.diag(self.shared_covariance)[3:6])

    @property
    def sigma_clock(self) -> float:
        """One sigma of the clock, s."""
        return float(np.sqrt(self.shared_covariance[9, 9]))

    @property
    def sigma_focal(self) -> float:
        """One sigma of fx, px."""
        return float(np.sqrt(self.shared_covariance[10, 10]))


def _rotation(q: Array) -> Array:
    """Rotation matrix of a quaternion x y z w of any length; shape (4,) -> (3, 3)."""
    x, y, z, w = q / np.sqrt(q @ q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def _camera_pose(pose: Array) -> tuple[Array, Array]:
    """Projection centre and R_enu_from_cam of COLMAP's qx qy qz qw tx ty tz."""
    R = _rotation(pose[:4]).T
    return -R @ pose[4:], R


def _differences(function: Any, blocks: list[Array], step: float = 1e-6) -> list[Array]:
    """Jacobians of a function of blocks by central differences."""
    out = []
    for k, block in enumerate(blocks):
        columns = []
        for j in range(len(block)):
            ends = []
            for sign in (1.0, -1.0):
                moved = [b.copy() if i == k else b for i, b in enumerate(blocks)]
                moved[k][j] += sign * step
                ends.append(function(*moved))
            columns.append((ends[0] - ends[1]) / (2 * step))
        out.append(np.column_stack(columns))
    return out


class _Numeric(pyceres.CostFunction):
    """A residual of blocks, differentiated numerically."""

    def __init__(self, function: Any, sizes: list[int], n: int) -> None:
        super().__init__()
        self.function = function
        self.set_num_residuals(n)
        self.set_parameter_block_sizes(sizes)

    def Evaluate(self, parameters: Any, residuals: Any, jacobians: Any) -> bool:
        """Ceres' interface."""
        blocks = [np.array(p) for p in parameters]
        residuals[:] = self.function(*blocks)
        if jacobians is not None:
            for k, J in enumerate(_differences(self.function, blocks)):
                if jacobians[k] is not None:
                    jacobians[k][:] = J.ravel()
        return True


class _Linear(pyceres.CostFunction):
    """sum A_k x_k - b."""

    def __init__(self, matrices: list[Array], b: Array) -> None:
        super().__init__()
        self.matrices, self.b = matrices, b
        self.set_num_residuals(len(b))
        self.set_parameter_block_sizes([A.shape[1] for A in matrices])

    def Evaluate(self, parameters: Any, residuals: Any, jacobians: Any) -> bool:
        """Ceres' interface."""
        total = -self.b
        for A, p in zip(self.matrices, parameters, strict=True):
            total = total + A @ np.array(p)
        residuals[:] = total
        if jacobians is not None:
            for k, A in enumerate(self.matrices):
                if jacobians[k] is not None:
                    jacobians[k][:] = A.ravel()
        return True


class _Problem:
    """COLMAP's problem and the blocks beside it; keeps every object that Ceres points to."""

    def __init__(self, flight: sim.SimFlight) -> None:
        refuse(flight)
        self.flight = flight
        self.keep: list[Any] = []
        self.block = _block(flight)
        options = pycolmap.BundleAdjustmentOptions()
        options.refine_principal_point = True
        options.print_summary = False
        config = pycolmap.BundleAdjustmentConfig()
        for i in range(flight.n_photos):
            config.add_image(i + 1)
        self.adjuster = pycolmap.create_default_ceres_bundle_adjuster(options, config, self.block)
        self.problem = self.adjuster.problem
        shared = flight.shared
        self.boresight, self.lever = shared.boresight.copy(), shared.lever.copy()
        self.bias, self.clock = shared.bias.copy(), np.array([shared.clock])
        self.camera = self.block.camera(1).params
        self.poses = [self.block.frame(i + 1).rig_from_world.params for i in range(flight.n_photos)]
        self.slow: list[Array] = []
        self.control: list[Array] = []

    def add(self, cost: pyceres.CostFunction, blocks: list[Array]) -> None:
        """A residual block without loss."""
        self.keep += [cost, *blocks]
        self.problem.add_residual_block(cost, None, blocks)

    def priors(self, *, independent: bool) -> None:
        """Of camera, mount, bias, clock, control and navigation."""
        self._camera_prior()
        f, s = self.flight, self.flight.noise_px
        given = ((self.boresight, f.shared.boresight, f.sigmas.boresight),
                 (self.lever, f.shared.lever, f.sigmas.lever),
                 (self.bias, f.shared.bias, f.sigmas.bias),
                 (self.clock, np.array([f.shared.clock]), np.array([f.sigmas.clock])))  # fmt: skip
        for block, mean, sigma in given:
            weight = s / np.maximum(sigma, LEAST)
            self.add(_Linear([np.diag(weight)], weight * mean), [block])
        self._control()
        self._navigation(independent=independent)

    def _control(self) -> None:
        """Surveyed points with their marks, also those of a single mark."""
        c, s = self.flight.control, self.flight.noise_px
        self.control = [p.copy() for p in c.p]
        for p, point in zip(c.p, self.control, strict=True):
            self.add(_Linear([np.diag(s / c.sigma)], s / c.sigma * p), [point])
        model, spread = pycolmap.CameraModelId.FULL_OPENCV, np.eye(2) * (c.sigma_px / s) ** 2
        for i, k, uv in zip(c.photo, c.point, c.uv, strict=True):
            cost = pycolmap.cost_functions.ReprojErrorCost(model, spread, uv + 0.5)
            self.add(cost, [self.control[k], self.poses[i], self.camera])

    def _camera_prior(self) -> None:
        f = self.flight
        A = np.zeros((9, 12))
        b = np.zeros(9)
        for row, (column, sigma) in enumerate(zip(COLMAP_ORDER, f.camera_sigma[:9], strict=True)):
            A[row, column] = f.noise_px / max(float(sigma), 1e-9)
            b[row] = A[row, column] * self.camera[column]
        A[1], b[1] = 0.0, 0.0
        A[1, 0], A[1, 1] = f.noise_px / SIGMA_FX_FY, -f.noise_px / SIGMA_FX_FY
        self.add(_Linear([A], b), [self.camera])
        # k4 k5 k6 of the rational model
        self.problem.set_manifold(self.camera, pyceres.SubsetManifold(12, [9, 10, 11]))

    def _navigation(self, *, independent: bool) -> None:
        f, m = self.flight, self.flight.navigation
        total = np.sqrt(m.white**2 + m.slow**2)
        joint = bool(np.any(m.slow > 0)) and not independent
        weight = f.noise_px / np.maximum(m.white if joint else total, LEAST)
        shared = [self.boresight, self.lever, self.bias, self.clock]
        for i, pose in enumerate(self.poses):
            function = _navigation_residual(f, i, weight)
            sizes = [7, 3, 3, 3, 1]
            blocks = [pose, *shared]
            if joint:
                self.slow.append(np.zeros(6))
                blocks.append(self.slow[-1])
                sizes.append(6)
            self.add(_Numeric(function, sizes, 6), blocks)
        if joint:
            self._gauss_markov()

    def _gauss_markov(self) -> None:
        """The slow errors as unknowns of their own, chained in time: the joint prior exactly."""
        f, m = self.flight, self.flight.navigation
        first = f.noise_px / np.maximum(m.slow, LEAST)
        self.add(_Linear([np.diag(first)], np.zeros(6)), [self.slow[0]])
        for i, step in enumerate(np.diff(f.truth.times)):
            keep = np.exp(-step / m.tau)
            weight = first / np.sqrt(1 - keep**2)
            A = [np.diag(-weight * keep), np.diag(weight)]
            self.add(_Linear(A, np.zeros(6)), [self.slow[i], self.slow[i + 1]])


def refuse(flight: sim.SimFlight) -> None:
    """Tell what COLMAP's model cannot express."""
    if flight.camera.readout_s or flight.camera_true.readout_s:
        raise ValueError("COLMAP knows no rolling shutter")
    if np.any(flight.camera_sigma[9:]) or np.any(flight.camera.values[9:]):
        raise ValueError("COLMAP knows no skew")


def _navigation_residual(flight: sim.SimFlight, i: int, weight: Array) -> Any:
    """(e_p, e_theta) of photo i, less its slow part if there is one, times the weights."""
    velocity, rate = flight.truth.velocity[i], flight.truth.rate[i]
    p_nav, R_nav = flight.p_nav[i], flight.R_nav[i]

    def residual(
        pose: Array, boresight: Array, lever: Array, bias: Array, clock: Array, *slow: Array
    ) -> Array:
        centre, R = _camera_pose(pose)
        R_body = R @ (_exp(boresight) @ sim.R_BODY_FROM_CAM).T
        e_p = centre - R_body @ lever + clock[0] * velocity + bias - p_nav
        e_theta = _log(_exp(clock[0] * rate) @ R_body @ R_nav.T)
        e = np.concatenate([e_p, e_theta])
        return np.asarray(weight * (e - slow[0] if slow else e))

    return residual


def _exp(v: Array) -> Array:
    a = float(np.sqrt(v @ v))
    K = sim.cross(v)
    if a < 1e-8:
        return np.asarray(np.eye(3) + K)
    return np.asarray(np.eye(3) + np.sin(a) / a * K + (1 - np.cos(a)) / a**2 * (K @ K))


def _log(R: Array) -> Array:
    """Rotation vector of a turn by less than 90 deg."""
    w = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    s = float(np.sqrt(w @ w))
    return np.asarray(w if s < 1e-8 else w * (np.arcsin(min(s, 1.0)) / s))


def _block(flight: sim.SimFlight) -> pycolmap.Reconstruction:
    """Reconstruction with the nominal camera, the direct poses and triangulated points."""
    block = pycolmap.Reconstruction()
    v = flight.camera.values
    # COLMAP puts (0.5, 0.5) at the centre of the first pixel.
    params = [v[0], v[1], v[2] + 0.5, v[3] + 0.5, v[4], v[5], v[7], v[8], v[6], 0.0, 0.0, 0.0]
    camera = pycolmap.Camera(
        camera_id=1, model="FULL_OPENCV", width=flight.camera.width, height=flight.camera.height,
        params=params,
    )  # fmt: skip
    block.add_camera_with_trivial_rig(camera)
    good = ~flight.outlier
    photo, point, uv = flight.photo[good], flight.point[good], flight.uv[good]
    number = np.zeros(len(uv), dtype=int)
    R = flight.R_nav @ sim.turn(flight.shared.boresight) @ sim.R_BODY_FROM_CAM
    centres = flight.p_nav + flight.R_nav @ flight.shared.lever
    rays = np.zeros((len(uv), 3))
    for i in range(flight.n_photos):
        mine = np.flatnonzero(photo == i)
        number[mine] = np.arange(len(mine))
        flat = np.asarray(camera.cam_from_img(uv[mine] + 0.5)) if len(mine) else np.zeros((0, 2))
        rays[mine] = np.column_stack([flat, np.ones(len(mine))]) @ R[i].T
        image = pycolmap.Image(
            image_id=i + 1, name=f"{i:05d}", camera_id=1,
            points2D=[pycolmap.Point2D(p) for p in uv[mine] + 0.5],
        )  # fmt: skip
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(R[i].T), -R[i].T @ centres[i])
        block.add_image_with_trivial_frame(image, pose)
    places = _intersections(centres[photo], rays, point)
    starts = np.searchsorted(point, np.arange(len(places) + 1))
    for k, p in enumerate(places):
        # Its other rays may be outliers.
        if starts[k + 1] - starts[k] < 2:
            continue
        track = pycolmap.Track()
        for o in range(starts[k], starts[k + 1]):
            track.add_element(int(photo[o]) + 1, int(number[o]))
        block.add_point3D_with_id(k + 1, pycolmap.Point3D(xyz=p, track=track))
    return block


def _intersections(starts: Array, rays: Array, point: NDArray[np.int64]) -> Array:
    """Points nearest to their rays, m; rays that are nearly parallel are cut at a prior."""
    d = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    across = np.eye(3) - d[:, :, None] * d[:, None, :]
    n = int(point.max()) + 1
    A, b = np.zeros((n, 3, 3)), np.zeros((n, 3))
    np.add.at(A, point, across)
    np.add.at(b, point, np.einsum("nij,nj->ni", across, starts))
    return np.linalg.solve(A + 1e-9 * np.eye(3), b[..., None])[..., 0]


def solve_with_ceres(
    flight: sim.SimFlight, *, independent: bool = False, points: tuple[int, ...] = ()
) -> OracleResult:
    """Adjust a flight.

    Parameters
    ----------
    flight
        Without rolling shutter and skew; its outliers are left out.
    independent
        Take the navigation's errors as independent from photo to photo although they are not.
    points
        Indices of tie points whose covariance is wanted.
    """
    begin = time.perf_counter()
    p = _Problem(flight)
    p.priors(independent=independent)
    options = pyceres.SolverOptions()
    options.linear_solver_type = pyceres.LinearSolverType.SPARSE_SCHUR
    options.function_tolerance, options.parameter_tolerance = 1e-12, 1e-12
    options.gradient_tolerance = 1e-10
    options.max_num_iterations = 300
    options.num_threads = 1
    summary = pyceres.SolverSummary()
    pyceres.solve(options, p.problem, summary)
    if summary.termination_type != pyceres.TerminationType.CONVERGENCE:
        raise RuntimeError(summary.BriefReport())
    solved = time.perf_counter()
    covariance = _covariances(p, points)
    return _result(p, summary, covariance, (solved - begin, time.perf_counter() - solved))


def _covariances(p: _Problem, points: tuple[int, ...]) -> tuple[Array, Array, dict[int, Array]]:
    shared = [p.boresight, p.lever, p.bias, p.clock, p.camera]
    places = {k: p.block.point3D(k + 1).xyz for k in points}
    wanted = [(a, b) for i, a in enumerate(shared) for b in shared[i:]]
    wanted += [(a, a) for a in [*p.poses, *places.values()]]
    options = pyceres.CovarianceOptions()
    options.num_threads = 1
    covariance = pyceres.Covariance(options)
    if not covariance.compute(wanted, p.problem):
        raise RuntimeError("Ceres found the normal matrix singular")
    variance = p.flight.noise_px**2
    poses = [
        _pose_covariance(pose, variance * np.asarray(covariance.get_covariance_block(pose, pose)))
        for pose in p.poses
    ]
    rows = [[np.asarray(covariance.get_covariance_block(a, b)) for b in shared] for a in shared]
    order = [*range(10), *(10 + k for k in COLMAP_ORDER)]
    whole = variance * np.block(rows)[np.ix_(order, order)]
    found = {
        k: variance * np.asarray(covariance.get_covariance_block(b, b)) for k, b in places.items()
    }
    return np.array(poses), whole, found


def _pose_covariance(pose: Array, ambient: Array) -> Array:
    """Covariance of (dp_enu, dtheta_enu) from that of quaternion and translation; (6, 6)."""
    pose = np.array(pose)
    R0 = _camera_pose(pose)[1]

    def place(moved: Array) -> Array:
        centre, R = _camera_pose(moved)
        return np.concatenate([centre, _log(R @ R0.T)])

    J = _differences(place, [pose])[0]
    return np.asarray(J @ ambient @ J.T)


def _result(
    p: _Problem,
    summary: pyceres.SolverSummary,
    covariance: tuple[Array, Array, dict[int, Array]],
    seconds: tuple[float, float],
) -> OracleResult:
    f = p.flight
    cameras = [_camera_pose(np.array(pose)) for pose in p.poses]
    values = np.array(p.camera)[COLMAP_ORDER]
    values[2:4] -= 0.5
    xyz = [
        p.block.point3D(k + 1).xyz if p.block.exists_point3D(k + 1) else np.full(3, np.nan)
        for k in range(len(f.points))
    ]
    free = summary.num_residuals - summary.num_effective_parameters
    norms = [np.linalg.norm(pose[:4]) for pose in p.poses]
    return OracleResult(
        origins=np.array([c for c, _ in cameras]),
        R_enu_from_cam=np.array([R for _, R in cameras]),
        pose_covariance=covariance[0],
        shared=sim.Shared(
            boresight=p.boresight, lever=p.lever, bias=p.bias, clock=float(p.clock[0])
        ),
        camera=values,
        shared_covariance=covariance[1],
        points=np.array(xyz),
        control=np.array(p.control).reshape(-1, 3),
        point_covariance=covariance[2],
        sigma0=float(np.sqrt(2 * summary.final_cost / free)) / f.noise_px,
        iterations=summary.num_successful_steps,
        quaternion_norm_error=float(np.max(np.abs(np.array(norms) - 1))),
        solve_s=seconds[0],
        covariance_s=seconds[1],
    )
