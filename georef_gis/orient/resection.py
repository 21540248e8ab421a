"""Exterior orientation of one photo from surveyed points marked in it (space resection)."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from georef_gis.errors import GeometryError, InputError
from georef_gis.frames import Array, exp_so3, log_so3, skew
from georef_gis.model.camera import Camera
from georef_gis.model.pose import Pose

Flags = NDArray[np.bool_]

# marks without which a pose needs a prior: 3 leave up to four poses, and nothing to test them by
FEWEST = 4
# marks from which a wrong one can be told from the others
FEWEST_TO_TEST = 6
# a standardised residual beyond this is a blunder (Baarda: 3.29 at 0.1 %; estimated weights: 4)
BLUNDER = 4.0
# sigmas; two poses of planar marks that differ by less (squared) both explain them
SAME_FIT = 9.2
# rms of the standardised residuals beyond which the marks belong to another scene
HOPELESS = 30.0
# relief over extent below which a second pose is looked for
PLANAR = 0.2
# subsets of four marks tried where there are blunders
_SUBSETS = 150
_ITERATIONS = 60


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ControlMarks:
    """Known points and their pixels in one photo.

    Parameters
    ----------
    p_enu : shape (n, 3), m
    uv : shape (n, 2), px
    sigma_px : px, one sigma per axis; shape (n,) or one number
    sigma_enu : m, one sigma per axis of the points; shape (n, 3), (3,) or one number
    names : of the points, for messages
    """

    p_enu: Array
    uv: Array
    sigma_px: ArrayLike = 0.5
    sigma_enu: ArrayLike = 0.0
    names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Check shapes, finiteness and signs."""
        n = len(self.p_enu)
        if self.p_enu.shape != (n, 3) or self.uv.shape != (n, 2):
            raise ValueError("p_enu must have shape (n, 3) and uv (n, 2)")
        if not (np.all(np.isfinite(self.p_enu)) and np.all(np.isfinite(self.uv))):
            raise InputError("a coordinate of a mark is not a finite number", field="marks")
        if np.any(np.asarray(self.sigma_px) <= 0) or np.any(np.asarray(self.sigma_enu) < 0):
            raise InputError("sigmas of marks must be > 0 px, of points >= 0 m", field="marks")

    def __len__(self) -> int:
        """Number of marks."""
        return len(self.p_enu)

    def name(self, i: int) -> str:
        """Name of a mark's point."""
        return self.names[i] if i < len(self.names) else f"mark {i + 1}"

    def only(self, chosen: ArrayLike) -> ControlMarks:
        """Some of the marks."""
        k = np.flatnonzero(np.asarray(chosen, dtype=bool))
        n = len(self)
        return ControlMarks(
            p_enu=self.p_enu[k],
            uv=self.uv[k],
            sigma_px=np.broadcast_to(self.sigma_px, (n,))[k],
            sigma_enu=np.broadcast_to(self.sigma_enu, (n, 3))[k],
            names=tuple(self.name(int(i)) for i in k),
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Resection:
    """A photo's pose by resection.

    Parameters
    ----------
    pose
        Of kind "adjusted"; its covariance is scaled by `sigma0` only where that is > 1 with more
        than 30 degrees of freedom.
    residuals : shape (n, 2), px
        Measured minus computed, of all marks.
    used : shape (n,)
        False for marks found to be blunders.
    alternative
        Second pose that explains planar marks as well; None where there is but one.
    """

    pose: Pose
    residuals: Array
    used: Flags
    sigma0: float
    redundancy: int
    alternative: Pose | None = None
    doubts: tuple[str, ...] = field(default=())


def resect(
    camera: Camera, marks: ControlMarks, *, prior: Pose | None = None, photo_id: str = ""
) -> Resection:
    """Pose of one photo from at least four marks, or fewer with a prior pose.

    Parameters
    ----------
    camera
        Its interior orientation, taken as without error.
    prior
        Pose with covariance, used as an observation; its velocities serve a rolling shutter.
    photo_id
        For messages.

    Raises
    ------
    GeometryError
        If the marks are too few, lie in a line, or do not fit one another.

    Notes
    -----
    Start by SQPnP (Terzakis and Lourakis 2020) on subsets of the marks, and by IPPE (Collins and
    Bartoli 2014) for the two poses of planar ones; then weighted least squares with data snooping.
    """
    where = f"photo {photo_id}: " if photo_id else ""
    _check_geometry(marks, prior, where)
    solver = _Solver(camera, marks, prior)
    fits = solver.fits(([prior] if prior is not None else []) + _starts(camera, marks, prior))
    if len(marks) >= FEWEST_TO_TEST and not (fits and fits[0].used.all()):
        fits = solver.fits(_consensus(camera, marks, prior), fits)
    if not fits:
        raise GeometryError(
            f"{where}no pose puts the {len(marks)} marks in front of the camera; check their names "
            "and the order of their coordinates"
        )
    best = fits[0]
    _check_fit(best, marks, where)
    return _result(solver, best, _second(best, fits), where)


def projection_jacobian(camera: Camera, p_cam: Array) -> Array:
    """Derivatives of pixels by points in camera axes; shape (n, 3) m -> (n, 2, 3) px/m."""
    h = 1e-5 * np.linalg.norm(p_cam, axis=1)
    steps = h[:, None, None] * np.eye(3)
    ahead = camera.project(p_cam[:, None, :] + steps)
    behind = camera.project(p_cam[:, None, :] - steps)
    return np.asarray(np.swapaxes(ahead - behind, 1, 2) / (2.0 * h)[:, None, None])


def pose_jacobian(J_cam: Array, R_enu_from_cam: Array, offset_enu: Array) -> Array:
    """Derivatives of pixels by the pose error (dp_enu m, dtheta_enu rad); shape (n, 2, 6).

    Parameters
    ----------
    J_cam : shape (n, 2, 3)
        By the point in camera axes.
    offset_enu : shape (n, 3)
        From the projection centre to the points, m.

    Notes
    -----
    p_cam = R^T (P - C) with R_true = Exp(dtheta) R: dp_cam = -R^T dC + R^T [P - C] dtheta.
    """
    by_position = -(J_cam @ R_enu_from_cam.T)
    return np.concatenate([by_position, -by_position @ skew(offset_enu)], axis=-1)


# -- starts -------------------------------------------------------------------------------------


def _check_geometry(marks: ControlMarks, prior: Pose | None, where: str) -> None:
    n = len(marks)
    if n == 0 or (n < FEWEST and prior is None):
        raise GeometryError(
            f"{where}{n} marks do not give a pose; mark {FEWEST} points, or give a prior pose"
        )
    if n >= FEWEST and prior is None:
        size = np.linalg.svd(marks.p_enu - marks.p_enu.mean(axis=0), compute_uv=False)
        if size[1] < 0.01 * size[0]:
            raise GeometryError(
                f"{where}the {n} marked points lie in a line ({size[1] / math.sqrt(n):.3g} m "
                "across it): the turn about it cannot be told; mark a point beside the line"
            )


def solve_pnp(p: Array, d_cam: Array) -> tuple[Array, Array] | None:
    """Origin (3,) and R_from_cam (3, 3) by SQPnP from directions in camera axes; None if none.

    Parameters
    ----------
    p : shape (n, 3), m
    d_cam : shape (n, 3)
        Unit directions; those more than 84 deg off the axis are left out.
    """
    ahead = d_cam[:, 2] > 0.1
    if np.count_nonzero(ahead) < 3:
        return None
    middle = p[ahead].mean(axis=0)
    q, xy = p[ahead] - middle, d_cam[ahead, :2] / d_cam[ahead, 2:]
    try:
        found, rvec, t = cv2.solvePnP(q, xy, np.eye(3), None, flags=cv2.SOLVEPNP_SQPNP)
    except cv2.error:
        # It asserts on points without extent.
        return None
    if not found or not (np.all(np.isfinite(rvec)) and np.all(np.isfinite(t))):
        return None
    R = exp_so3(rvec.ravel()).T
    return np.asarray(middle - R @ t.ravel()), R


def _planar_poses(p: Array, d_cam: Array) -> list[tuple[Array, Array]]:
    """The two poses of marks near a plane, by IPPE; [] where they are not near one."""
    ahead = d_cam[:, 2] > 0.1
    middle = p[ahead].mean(axis=0)
    q = p[ahead] - middle
    _, size, axes = np.linalg.svd(q, full_matrices=False)
    if len(q) < FEWEST or size[2] > PLANAR * size[1]:
        return []
    axes[2] = np.cross(axes[0], axes[1])
    flat = q @ axes.T
    flat[:, 2] = 0.0
    xy = d_cam[ahead, :2] / d_cam[ahead, 2:]
    n, rvecs, ts, _ = cv2.solvePnPGeneric(flat, xy, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
    out = []
    for rvec, t in zip(rvecs[:n], ts[:n], strict=True):
        R = axes.T @ exp_so3(rvec.ravel()).T
        if np.all(np.isfinite(R)) and np.all(np.isfinite(t)):
            out.append((middle - R @ t.ravel(), R))
    return out


def _starts(camera: Camera, marks: ControlMarks, prior: Pose | None) -> list[Pose]:
    """Poses that all marks give."""
    d = camera.ray(marks.uv)
    seen = np.all(np.isfinite(d), axis=1)
    p, d = marks.p_enu[seen], d[seen]
    if len(p) < FEWEST:
        return []
    found = solve_pnp(p, d)
    poses = ([found] if found is not None else []) + _planar_poses(p, d)
    return [_pose(origin, R, prior) for origin, R in poses]


def _consensus(camera: Camera, marks: ControlMarks, prior: Pose | None) -> list[Pose]:
    """The two poses of four marks each that most others agree with, for marks with blunders."""
    d = camera.ray(marks.uv)
    seen = np.all(np.isfinite(d), axis=1)
    p, uv, d = marks.p_enu[seen], marks.uv[seen], d[seen]
    n = len(p)
    if n < FEWEST_TO_TEST:
        return []
    if math.comb(n, FEWEST) <= _SUBSETS:
        subsets = np.array(list(itertools.combinations(range(n), FEWEST)))
    else:
        rng = np.random.default_rng(0)
        subsets = np.array([rng.choice(n, FEWEST, replace=False) for _ in range(_SUBSETS)])
    sigma = np.broadcast_to(np.asarray(marks.sigma_px, float), (len(marks),))[seen]
    consensus: list[tuple[float, tuple[Array, Array]]] = []
    for k in subsets:
        found = solve_pnp(p[k], d[k])
        if found is not None:
            off = camera.project((p - found[0]) @ found[1]) - uv
            # Points behind the camera count as misses.
            miss = np.nan_to_num(np.hypot(*off.T) / sigma, nan=np.inf)
            consensus.append((float(np.minimum(miss, 20.0).sum()), found))
    consensus.sort(key=lambda one: one[0])
    return [_pose(origin, R, prior) for _, (origin, R) in consensus[:2]]


def _pose(origin: Array, R: Array, prior: Pose | None, covariance: Array | None = None) -> Pose:
    # Products of many turns drift off the rotations.
    u, _, vt = np.linalg.svd(R)
    return Pose(
        origin_enu=np.asarray(origin),
        R_enu_from_cam=np.asarray(u @ vt),
        covariance=np.zeros((6, 6)) if covariance is None else covariance,
        kind="adjusted",
        velocity_enu=None if prior is None else prior.velocity_enu,
        rate_enu=None if prior is None else prior.rate_enu,
    )


# -- least squares ------------------------------------------------------------------------------


@dataclass(slots=True, kw_only=True)
class _Fit:
    pose: Pose
    N: Array
    # whitened residuals (n, 2) of all marks, and their own sigma from the redundancy
    white: Array
    spread: Array
    chi2: float
    used: Flags

    @property
    def score(self) -> float:
        """Sum of squares in which a blunder counts like the test's limit, and then some."""
        return self.chi2 + 3.0 * BLUNDER**2 * float(np.count_nonzero(~self.used))


class _Solver:
    """Weighted least squares of one pose."""

    def __init__(self, camera: Camera, marks: ControlMarks, prior: Pose | None) -> None:
        self.camera, self.marks, self.prior = camera, marks, prior
        n = len(marks)
        self._sigma_px = np.broadcast_to(np.asarray(marks.sigma_px, float), (n,))
        self._var_enu = np.broadcast_to(np.asarray(marks.sigma_enu, float), (n, 3)) ** 2
        self._weight = None
        if prior is not None:
            scaled = prior.covariance + 1e-18 * np.eye(6)
            self._weight = np.linalg.inv(scaled)

    def residuals(self, pose: Pose) -> Array:
        """Measured minus computed, px; shape (n, 2), NaN where a point is not seen."""
        R = pose.R_enu_from_cam
        v = None if pose.velocity_enu is None else pose.velocity_enu @ R
        w = None if pose.rate_enu is None else pose.rate_enu @ R
        seen = self.camera.project(pose.cam_from_enu(self.marks.p_enu), velocity_cam=v, rate_cam=w)
        return np.asarray(self.marks.uv - seen)

    def fits(self, starts: list[Pose], known: list[_Fit] | None = None) -> list[_Fit]:
        """Fits from starts, the best first, together with others."""
        found = [fit for fit in map(self.with_snooping, starts) if fit is not None]
        return sorted([*(known or ()), *found], key=lambda fit: fit.score)

    def with_snooping(self, start: Pose) -> _Fit | None:
        """Fit in which the worst mark is left out as long as it is a blunder."""
        used = np.all(np.isfinite(self.residuals(start)), axis=1)
        if np.count_nonzero(used) < min(FEWEST, len(self.marks)):
            return None
        if len(self.marks) >= FEWEST_TO_TEST:
            r = self.residuals(start)
            size = np.hypot(*np.nan_to_num(r, nan=1e9).T) / self._sigma_px
            limit = max(10.0, 5.0 * float(np.median(size)))
            if np.count_nonzero(size < limit) >= FEWEST:
                used = size < limit
        fit = self.solve(start, used)
        for _ in range(2 * len(self.marks)):
            if fit is None or len(self.marks) < FEWEST_TO_TEST:
                break
            test = np.max(np.abs(fit.white) / fit.spread, axis=1)
            back = ~fit.used & (test < BLUNDER)
            if back.any():
                fit = self.solve(fit.pose, fit.used | back)
                continue
            worst = int(np.argmax(np.where(fit.used, test, 0.0)))
            if not test[worst] > BLUNDER or np.count_nonzero(fit.used) <= FEWEST + 1:
                break
            used = fit.used.copy()
            used[worst] = False
            fit = self.solve(fit.pose, used)
        return fit

    def solve(self, start: Pose, used: Flags) -> _Fit | None:
        """Levenberg-Marquardt from a start; None where it does not converge."""
        pose, damping = start, 1e-7
        now = self._linear(pose, used)
        for _ in range(_ITERATIONS):
            if now is None:
                return None
            N, b, cost = now
            scale = np.sqrt(np.diag(N))
            A = N / np.outer(scale, scale) + damping * np.eye(6)
            step = np.linalg.solve(A, b / scale) / scale
            moved = self._moved(pose, step)
            then = self._linear(moved, used)
            if then is None or then[2] > cost + 1e-12 * (1.0 + cost):
                damping *= 10.0
                if damping > 1e12:
                    break
                continue
            pose, now, damping = moved, then, max(damping / 10.0, 1e-12)
            if float(step @ N @ step) < 1e-9:
                break
        return None if now is None else self._fit(pose, now[0], used)

    def _moved(self, pose: Pose, step: Array) -> Pose:
        R = exp_so3(step[3:]) @ pose.R_enu_from_cam
        return _pose(pose.origin_enu + step[:3], R, self.prior)

    def _rows(self, pose: Pose) -> tuple[Array, Array]:
        """Whitened residuals (n, 2) and derivatives (n, 2, 6)."""
        R = pose.R_enu_from_cam
        offset = self.marks.p_enu - pose.origin_enu
        J_cam = projection_jacobian(self.camera, offset @ R)
        J_enu = J_cam @ R.T
        var = self._sigma_px[:, None, None] ** 2 * np.eye(2)
        var = var + np.einsum("nij,nj,nkj->nik", J_enu, self._var_enu, J_enu)
        bad = ~np.all(np.isfinite(var), axis=(1, 2))
        var[bad] = np.eye(2)
        root = np.linalg.cholesky(var)
        r = np.linalg.solve(root, self.residuals(pose)[..., None])[..., 0]
        return np.asarray(r), np.asarray(np.linalg.solve(root, pose_jacobian(J_cam, R, offset)))

    def _linear(self, pose: Pose, used: Flags) -> tuple[Array, Array, float] | None:
        r, J = self._rows(pose)
        r, J = r[used], J[used]
        if not (np.all(np.isfinite(r)) and np.all(np.isfinite(J))):
            return None
        N = np.einsum("nij,nik->jk", J, J)
        b, cost = np.einsum("nij,ni->j", J, r), float(np.sum(r * r))
        if self.prior is not None and self._weight is not None:
            x = self._from_prior(pose)
            N, b, cost = N + self._weight, b - self._weight @ x, cost + float(x @ self._weight @ x)
        return (N, b, cost) if np.all(np.diag(N) > 0) else None

    def _from_prior(self, pose: Pose) -> Array:
        assert self.prior is not None
        turn = log_so3(pose.R_enu_from_cam @ self.prior.R_enu_from_cam.T)
        return np.concatenate([pose.origin_enu - self.prior.origin_enu, turn])

    def _fit(self, pose: Pose, N: Array, used: Flags) -> _Fit | None:
        scale = np.sqrt(np.diag(N))
        relative = N / np.outer(scale, scale)
        if np.linalg.cond(relative) > 1e14:
            return None
        Q = np.linalg.inv(relative) / np.outer(scale, scale)
        white, J = self._rows(pose)
        taken = np.einsum("nij,jk,nik->ni", J, Q, J)
        # A used mark takes part in the pose, one left out adds the pose's error to its own.
        spread = np.sqrt(np.maximum(np.where(used[:, None], 1.0 - taken, 1.0 + taken), 1e-6))
        white = np.nan_to_num(white, nan=1e6)
        chi2 = float(np.sum(white[used] ** 2))
        if self.prior is not None and self._weight is not None:
            x = self._from_prior(pose)
            chi2 += float(x @ self._weight @ x)
        fitted = replace(pose, covariance=0.5 * (Q + Q.T))
        return _Fit(pose=fitted, N=N, white=white, spread=spread, chi2=chi2, used=used)


# -- judgement ----------------------------------------------------------------------------------


def _check_fit(best: _Fit, marks: ControlMarks, where: str) -> None:
    n = int(np.count_nonzero(best.used))
    rms = math.sqrt(best.chi2 / max(2 * n - 6, 1))
    if (n > FEWEST or rms > 3 * HOPELESS) and rms > HOPELESS:
        raise GeometryError(
            f"{where}the {n} marks do not fit one another: rms of {rms:.0f} sigma; check names, "
            "the order east, north, height and the camera"
        )
    heights = marks.p_enu[best.used, 2]
    if best.pose.origin_enu[2] < heights.min() and best.pose.R_enu_from_cam[2, 2] > 0.5:
        raise GeometryError(
            f"{where}by the {n} marks the camera would lie under the ground and look up: are east "
            "and north swapped?"
        )
    if len(marks) >= FEWEST_TO_TEST and 5 * n < 3 * len(marks):
        raise GeometryError(
            f"{where}only {n} of {len(marks)} marks fit one pose; check names and coordinates"
        )


def _second(best: _Fit, fits: list[_Fit]) -> Pose | None:
    """Another pose that explains the marks as well as the best one."""
    for fit in fits[1:]:
        turn = log_so3(fit.pose.R_enu_from_cam @ best.pose.R_enu_from_cam.T)
        if np.linalg.norm(turn) > 1e-3 and fit.score - best.score < SAME_FIT:
            return fit.pose
    return None


def _result(solver: _Solver, best: _Fit, second: Pose | None, where: str) -> Resection:
    marks, prior = solver.marks, solver.prior
    used = int(np.count_nonzero(best.used))
    redundancy = 2 * used - (0 if prior is not None else 6)
    sigma0 = math.sqrt(best.chi2 / redundancy) if redundancy > 0 else math.nan
    scale = sigma0**2 if redundancy > 30 and sigma0 > 1.0 else 1.0
    pose = replace(best.pose, covariance=scale * best.pose.covariance)
    doubts = [
        f"{where}mark of {marks.name(int(i))} is off by "
        f"{np.hypot(*solver.residuals(pose)[i]):.1f} px: left out; check it"
        for i in np.flatnonzero(~best.used)
    ]
    if second is not None:
        turn = log_so3(second.R_enu_from_cam @ pose.R_enu_from_cam.T)
        doubts.append(
            f"{where}the marks lie near a plane and a second pose explains them as well "
            f"({math.degrees(np.linalg.norm(turn)):.1f} deg away); mark points at other heights"
        )
    distance = float(np.median(np.linalg.norm(marks.p_enu - pose.origin_enu, axis=1)))
    sd = float(np.sqrt(np.max(np.linalg.eigvalsh(pose.covariance[:3, :3]))))
    if sd > 0.05 * distance:
        doubts.append(
            f"{where}the position is weak: one sigma of {sd:.2f} m over {distance:.1f} m; mark "
            "points farther apart"
        )
    if math.isfinite(sigma0) and redundancy <= 30 and sigma0 > 3.0:
        doubts.append(f"{where}the marks fit to {sigma0:.1f} sigma only; check them")
    return Resection(
        pose=pose,
        residuals=solver.residuals(pose),
        used=best.used,
        sigma0=sigma0,
        redundancy=redundancy,
        alternative=second,
        doubts=tuple(doubts),
    )
