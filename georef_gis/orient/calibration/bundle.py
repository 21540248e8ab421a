"""Self-calibrating bundle over photos of targets: camera, poses and, where unsure, targets.

Own Gauss-Newton with the full covariance of the camera, which `cv2.calibrateCamera` does not give;
that serves the tests as an oracle.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from georef_gis.errors import AdjustmentError, InputError
from georef_gis.frames import Array, exp_so3, skew
from georef_gis.model.camera import Camera
from georef_gis.orient.pixel_derivatives import projection_jacobian
from georef_gis.orient.resection_starts import solve_pnp

BROWN = ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "p1", "p2")
FISHEYE = ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4")
# A lens has this about its coefficients, one sigma: holds what no photo shows, moves nothing else.
WIDE_PRIOR = {"k1": 1.0, "k2": 4.0, "k3": 16.0, "k4": 16.0, "p1": 0.1, "p2": 0.1}
# of the width: principal point and skew; of itself: focal length
_PRIOR_CENTRE, _PRIOR_FOCAL, _PRIOR_SKEW = 0.2, 1.0, 0.05
# focal lengths tried, of the longer side
_FOCALS = (0.5, 0.8, 1.2, 2.0, 3.5)
_ITERATIONS = 80
# photos that the focal length is first found from
_FIRST_VIEWS = 6

Index = NDArray[np.intp]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Targets:
    """Known points: xyz (t, 3) m in any frame, sigma (t, 3) m (0 = exact), names."""

    xyz: Array
    sigma: Array
    names: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class View:
    """What one photo shows: indices of targets (m,), their pixels (m, 2), sigma (m,) px."""

    id: str
    index: Index
    uv: Array
    sigma: Array

    def only(self, chosen: NDArray[np.bool_]) -> View:
        """Some of the targets."""
        return replace(self, index=self.index[chosen], uv=self.uv[chosen], sigma=self.sigma[chosen])


@dataclass(slots=True, kw_only=True)
class State:
    """Unknowns of the bundle; `R[i]` turns camera axes into those of the targets."""

    camera: Camera
    origins: list[Array]
    R: list[Array]
    xyz: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BundleFit:
    """Result of `adjust`.

    `covariance` is of the camera's parameters in the order of `parameters`, then six of each pose
    (dp m, dtheta rad, as everywhere), unscaled; `residuals` per view, measured minus computed, px.
    """

    state: State
    parameters: tuple[str, ...]
    covariance: Array
    residuals: tuple[Array, ...]
    chi2: float
    redundancy: int


def start(size: tuple[int, int], targets: Targets, views: Sequence[View], camera: Camera) -> State:
    """Start from a camera whose focal length is a guess: the best of several.

    Parameters
    ----------
    size : px
    targets, views
        What is seen.
    camera
        Gives model and centre; its focal length is tried too.

    Raises
    ------
    AdjustmentError
        If no focal length gives poses to the photos.
    """
    best: tuple[float, Camera] | None = None
    longest = max(size)
    first = ("f", "k1") if camera.model == "brown" else ("f",)
    few = [views[i] for i in np.unique(np.linspace(0, len(views) - 1, _FIRST_VIEWS).astype(int))]
    tried: list[tuple[float, int, State]] = []
    for focal in (camera.fx, *(share * longest for share in _FOCALS)):
        posed = _posed(replace(camera, fx=focal, fy=focal), targets, few)
        now = None if posed is None else _Problem(targets, few, first, posed).normal(posed)
        if posed is not None and now is not None:
            tried.append((now[2], len(tried), posed))
    for _, _, posed in sorted(tried)[:2]:
        fit = adjust(posed, targets, few, first, iterations=15)
        if best is None or fit.chi2 < best[0]:
            best = (fit.chi2, fit.state.camera)
    state = None if best is None else _posed(best[1], targets, views)
    if state is None:
        raise AdjustmentError(
            "no focal length puts the targets in front of the camera; check the size of the board "
            "or the coordinates of the field"
        )
    return state


def _posed(camera: Camera, targets: Targets, views: Sequence[View]) -> State | None:
    origins, turns = [], []
    for view in views:
        found = solve_pnp(targets.xyz[view.index], camera.ray(view.uv))
        if found is None:
            return None
        origins.append(found[0])
        turns.append(found[1])
    return State(camera=camera, origins=origins, R=turns, xyz=targets.xyz.copy())


def adjust(
    state: State,
    targets: Targets,
    views: Sequence[View],
    free: tuple[str, ...],
    *,
    iterations: int = _ITERATIONS,
) -> BundleFit:
    """Least squares by Levenberg-Marquardt from a state.

    Parameters
    ----------
    state
        Start; not changed.
    targets, views
        What is seen.
    free
        Parameters of the camera to estimate; "f" is fx and fy together.

    Raises
    ------
    AdjustmentError
        If the start is not usable.
    """
    problem = _Problem(targets, views, free, state)
    now = problem.normal(state)
    if now is None:
        raise AdjustmentError("a target lies behind the camera at the start of the calibration")
    damping = 1e-5
    for _ in range(iterations):
        N, b, cost = now
        scale = np.sqrt(np.diag(N))
        A = N / np.outer(scale, scale) + damping * np.eye(len(N))
        try:
            step = np.linalg.solve(A, b / scale) / scale
        except np.linalg.LinAlgError:
            break
        moved = problem.moved(state, step)
        then = None if moved is None else problem.normal(moved)
        if moved is None or then is None or then[2] > cost * (1.0 + 1e-12):
            damping *= 8.0
            if damping > 1e10:
                break
            continue
        drop = cost - then[2]
        state, now, damping = moved, then, max(damping / 8.0, 1e-14)
        if drop < 1e-10 * (1.0 + cost) and float(step @ now[0] @ step) < 1e-10 * problem.count:
            break
    return problem.fit(state, now)


class _Problem:
    """Normal equations: camera, poses, and the targets that have a sigma."""

    def __init__(
        self, targets: Targets, views: Sequence[View], free: tuple[str, ...], first: State
    ) -> None:
        self.targets, self.views, self.free = targets, views, free
        self.loose = np.flatnonzero(np.any(targets.sigma > 0, axis=1))
        if np.any(targets.sigma[self.loose] <= 0):
            raise InputError("a target has sigmas of zero and not of zero; give all three")
        seen = np.zeros(len(targets.xyz), dtype=bool)
        for view in views:
            seen[view.index] = True
        self.loose = self.loose[seen[self.loose]]
        self.place = np.full(len(targets.xyz), -1)
        self.n_fixed = len(free) + 6 * len(views)
        self.place[self.loose] = self.n_fixed + 3 * np.arange(len(self.loose))
        self.size = self.n_fixed + 3 * len(self.loose)
        ends = np.cumsum([0, *(len(view.index) for view in views)])
        self.rows = [slice(a, b) for a, b in pairwise(ends)]
        self.view_of = np.repeat(np.arange(len(views)), np.diff(ends))
        self.index = np.concatenate([view.index for view in views])
        self.uv = np.concatenate([view.uv for view in views])
        self.weight = 1.0 / np.concatenate([view.sigma for view in views])
        self.count = 2 * sum(len(view.index) for view in views)
        self.prior_mean = np.array([_get(first.camera, name) for name in free])
        self.prior_sd = np.array([_prior(first.camera, name) for name in free])

    def normal(self, state: State) -> tuple[Array, Array, float] | None:
        """Normal matrix, right side and sum of squares; None where a target is not seen."""
        k = len(self.free)
        N, b, cost = np.zeros((self.size, self.size)), np.zeros(self.size), 0.0
        every = self._rows(state)
        if not all(np.all(np.isfinite(part)) for part in every[:2]):
            return None
        for i, view in enumerate(self.views):
            r, J_cam, J_pose, J_xyz = (part[self.rows[i]] for part in every)
            cost += float(np.sum(r * r))
            cols = np.r_[np.arange(k), k + 6 * i + np.arange(6)]
            A = np.concatenate([J_cam, J_pose], axis=-1)
            loose = np.flatnonzero(self.place[view.index] >= 0)
            if len(loose):
                # Each mark moves with its own target only.
                own = np.zeros((len(r), 2, len(loose), 3))
                own[loose, :, np.arange(len(loose))] = J_xyz[loose]
                A = np.concatenate([A, own.reshape(len(r), 2, -1)], axis=-1)
                at = self.place[view.index[loose]][:, None] + np.arange(3)
                cols = np.r_[cols, at.ravel()]
            A = A.reshape(-1, len(cols))
            N[np.ix_(cols, cols)] += A.T @ A
            b[cols] += A.T @ r.ravel()
        cost += self._add_priors(state, N, b)
        return N, b, cost

    def _add_priors(self, state: State, N: Array, b: Array) -> float:
        x = (np.array([_get(state.camera, n) for n in self.free]) - self.prior_mean) / self.prior_sd
        k = np.arange(len(self.free))
        N[k, k] += 1.0 / self.prior_sd**2
        b[k] -= x / self.prior_sd
        cost = float(x @ x)
        for t in self.loose:
            at, sd = self.place[t] + np.arange(3), self.targets.sigma[t]
            d = (state.xyz[t] - self.targets.xyz[t]) / sd
            N[at, at] += 1.0 / sd**2
            b[at] -= d / sd
            cost += float(d @ d)
        return cost

    def _rows(self, state: State) -> tuple[Array, Array, Array, Array]:
        """Residuals and derivatives of all marks in units of sigma; shape (marks, 2, ..)."""
        R = np.array(state.R)[self.view_of]
        offset = state.xyz[self.index] - np.array(state.origins)[self.view_of]
        p_cam = np.einsum("nji,nj->ni", R, offset)
        r = self.uv - state.camera.project(p_cam)
        J_p = projection_jacobian(state.camera, p_cam)
        J_xyz = J_p @ np.swapaxes(R, 1, 2)
        J_pose = np.concatenate([-J_xyz, J_xyz @ skew(offset)], axis=-1)
        J_cam = camera_jacobian(state.camera, p_cam, self.free)
        w = self.weight[:, None, None]
        return r * w[:, 0], J_cam * w, J_pose * w, J_xyz * w

    def moved(self, state: State, step: Array) -> State | None:
        """State after a step; None where the camera is none any more."""
        k = len(self.free)
        camera = state.camera
        try:
            for name, d in zip(self.free, step[:k], strict=True):
                camera = _set(camera, name, _get(camera, name) + float(d))
        except ValueError:
            return None
        if min(camera.fx, camera.fy) < 1.0:
            return None
        poses = step[k : self.n_fixed].reshape(-1, 6)
        xyz = state.xyz.copy()
        xyz[self.loose] += step[self.n_fixed :].reshape(-1, 3)
        return State(
            camera=camera,
            origins=[o + d[:3] for o, d in zip(state.origins, poses, strict=True)],
            R=[exp_so3(d[3:]) @ R for R, d in zip(state.R, poses, strict=True)],
            xyz=xyz,
        )

    def fit(self, state: State, normal: tuple[Array, Array, float]) -> BundleFit:
        """Result with the covariance."""
        N, _, chi2 = normal
        scale = np.sqrt(np.diag(N))
        Q = np.linalg.inv(N / np.outer(scale, scale)) / np.outer(scale, scale)
        residuals = []
        for i, view in enumerate(self.views):
            p_cam = (state.xyz[view.index] - state.origins[i]) @ state.R[i]
            residuals.append(view.uv - state.camera.project(p_cam))
        return BundleFit(
            state=state,
            parameters=self.free,
            covariance=Q[: self.n_fixed, : self.n_fixed],
            residuals=tuple(residuals),
            chi2=chi2,
            redundancy=self.count + 3 * len(self.loose) - self.size,
        )


def camera_jacobian(camera: Camera, p_cam: Array, names: tuple[str, ...]) -> Array:
    """Derivatives of pixels by parameters of the camera; shape (n, 2, k)."""
    out = np.empty((*p_cam.shape[:-1], 2, len(names)))
    for i, name in enumerate(names):
        # Both models are linear in every one, so the step matters for rounding only.
        h = 1e-3 * camera.fx if name in ("f", "fx", "fy", "cx", "cy", "b2") else 1e-5
        value = _get(camera, name)
        ahead = _set(camera, name, value + h).project(p_cam)
        behind = _set(camera, name, value - h).project(p_cam)
        out[..., i] = (ahead - behind) / (2.0 * h)
    return out


def _get(camera: Camera, name: str) -> float:
    return float(getattr(camera, "fx" if name == "f" else name))


def _set(camera: Camera, name: str, value: float) -> Camera:
    if name == "f":
        return replace(camera, fx=value, fy=value)
    return replace(camera, **{name: value})  # type: ignore[arg-type]


def _prior(camera: Camera, name: str) -> float:
    if name in ("f", "fx", "fy"):
        return _PRIOR_FOCAL * camera.fx
    if name in ("cx", "cy"):
        return _PRIOR_CENTRE * camera.width
    return _PRIOR_SKEW * camera.width if name == "b2" else WIDE_PRIOR[name]


def corner_sigma(camera: Camera, covariance: Array, names: tuple[str, ...]) -> Array:
    """One sigma of the pixel of the rays through the image's corners, px; shape (4,).

    NaN where the camera sees no ray there.
    """
    rays = camera.ray(camera.corners_uv * 0.999)
    J = camera_jacobian(camera, rays, names)
    C = np.einsum("nij,jk,nlk->nil", J, covariance, J)
    return np.asarray([math.sqrt(t) if t >= 0 else math.nan for t in np.trace(C, axis1=1, axis2=2)])
