"""Weighted least squares of one photo's pose, with data snooping."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from georef_gis.frames import Array, exp_so3, log_so3
from georef_gis.model.camera import Camera
from georef_gis.model.pose import Pose
from georef_gis.orient.pixel_derivatives import pose_jacobian, projection_jacobian
from georef_gis.orient.resection_marks import FEWEST, FEWEST_TO_TEST, ControlMarks

Flags = NDArray[np.bool_]

# a standardised residual beyond this is a blunder (Baarda: 3.29 at 0.1 %; estimated weights: 4)
BLUNDER = 4.0
_ITERATIONS = 60


@dataclass(slots=True, kw_only=True)
class Fit:
    """A pose adjusted to those of the marks that are used.

    Parameters
    ----------
    N : shape (6, 6)
        Normal matrix of (dp_enu m, dtheta_enu rad).
    white : shape (n, 2)
        Whitened residuals of all marks.
    spread : shape (n, 2)
        Their own sigma from the redundancy.
    used : shape (n,)
    """

    pose: Pose
    N: Array
    white: Array
    spread: Array
    chi2: float
    used: Flags

    @property
    def score(self) -> float:
        """Sum of squares in which a blunder counts like the test's limit, and then some."""
        return self.chi2 + 3.0 * BLUNDER**2 * float(np.count_nonzero(~self.used))


class Solver:
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

    def pose_at(self, origin: Array, R: Array) -> Pose:
        """Pose at a place (3,), m, with a turn (3, 3), that moves as the prior does."""
        # Products of many turns drift off the rotations.
        u, _, vt = np.linalg.svd(R)
        return Pose(
            origin_enu=np.asarray(origin),
            R_enu_from_cam=np.asarray(u @ vt),
            covariance=np.zeros((6, 6)),
            kind="adjusted",
            velocity_enu=None if self.prior is None else self.prior.velocity_enu,
            rate_enu=None if self.prior is None else self.prior.rate_enu,
        )

    def residuals(self, pose: Pose) -> Array:
        """Measured minus computed, px; shape (n, 2), NaN where a point is not seen."""
        R = pose.R_enu_from_cam
        v = None if pose.velocity_enu is None else pose.velocity_enu @ R
        w = None if pose.rate_enu is None else pose.rate_enu @ R
        seen = self.camera.project(pose.cam_from_enu(self.marks.p_enu), velocity_cam=v, rate_cam=w)
        return np.asarray(self.marks.uv - seen)

    def fits(self, starts: list[Pose], known: list[Fit] | None = None) -> list[Fit]:
        """Fits from starts, the best first, together with others."""
        found = [fit for fit in map(self.with_snooping, starts) if fit is not None]
        return sorted([*(known or ()), *found], key=lambda fit: fit.score)

    def with_snooping(self, start: Pose) -> Fit | None:
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

    def solve(self, start: Pose, used: Flags) -> Fit | None:
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
        return self.pose_at(pose.origin_enu + step[:3], exp_so3(step[3:]) @ pose.R_enu_from_cam)

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

    def _fit(self, pose: Pose, N: Array, used: Flags) -> Fit | None:
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
        return Fit(pose=fitted, N=N, white=white, spread=spread, chi2=chi2, used=used)
