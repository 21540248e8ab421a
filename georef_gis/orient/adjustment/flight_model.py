"""The joint prior of a flight as quadratic form: residual, derivatives, who contradicts it."""

from __future__ import annotations

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from georef_gis.errors import AdjustmentError
from georef_gis.frames import Array, exp_so3, log_so3, skew
from georef_gis.orient.adjustment.block import FLIGHT_UNKNOWNS, FlightPrior

# m and rad, one sigma: what no navigation is better than, so that the prior can be inverted
FLOOR = np.array([1e-4, 1e-4, 1e-4, 1e-6, 1e-6, 1e-6])
# of its own sigma; a photo's pose further off what the others foretell is weighed down
DOUBTED = 4.0


def left_jacobian_inverse(rotvec: Array) -> Array:
    """Derivative of Log(Exp(d) R) by d at R = Exp(rotvec); (..., 3) -> (..., 3, 3).

    Notes
    -----
    Barfoot, "State Estimation for Robotics" (2017), eq. 7.76b.
    """
    angle = np.linalg.norm(rotvec, axis=-1)[..., None, None]
    small = angle < 1e-4
    a = np.where(small, 1.0, angle)
    factor = np.where(small, 1.0 / 12.0, 1.0 / a**2 - 0.5 / (a * np.tan(a / 2.0)))
    k = skew(rotvec)
    return np.asarray(np.eye(3) - 0.5 * k + factor * (k @ k))


class FlightModel:
    """Prior of one flight, ready for the solver."""

    information: Array

    def __init__(self, prior: FlightPrior, origin: Array, rotation: Array) -> None:
        """Take the navigation's poses of all photos of the block; (n, 3) m and (n, 3, 3)."""
        self.prior = prior
        self.origin, self.rotation = origin[prior.photos], rotation[prior.photos]
        n = len(prior.photos)
        self.extra = np.zeros((n, 6))
        self.renew()
        self.free = np.diag(prior.shared_covariance) > 0
        shared = prior.shared_covariance[np.ix_(self.free, self.free)]
        self.shared_information = np.zeros((FLIGHT_UNKNOWNS, FLIGHT_UNKNOWNS))
        self.shared_information[np.ix_(self.free, self.free)] = np.linalg.inv(shared)

    def adopt(self, known: FlightModel) -> None:
        """Take what an earlier model of the same flight found."""
        self.extra, self.information = known.extra, known.information

    def renew(self) -> None:
        """Make the information anew after `extra` changed."""
        n = len(self.prior.photos)
        own = np.tile(FLOOR**2, n) + self.extra.ravel()
        if self.prior.covariance is None:
            raise ValueError(f"flight {self.prior.id}: is too long for a whole covariance")
        covariance = self.prior.covariance + np.diag(own)
        # Metres and radians side by side: scaled to a unit diagonal before it is inverted.
        scale = 1.0 / np.sqrt(np.diag(covariance))
        try:
            factor = cho_factor(covariance * scale[:, None] * scale, lower=True)
        except np.linalg.LinAlgError as error:
            raise AdjustmentError(
                f"flight {self.prior.id}: the covariance of its poses is not positive definite"
            ) from error
        inverse = cho_solve(factor, np.eye(6 * n))
        self.information = inverse * scale[:, None] * scale

    def residual(self, origin: Array, rotation: Array, shared: Array) -> Array:
        """Pose errors that the present poses mean, shared part taken off; (n, 6), m and rad."""
        prior = self.prior
        lever, boresight, bias, clock = shared[:3], shared[3:6], shared[6:9], shared[9]
        p = self.origin + prior.R_enu_from_body @ lever + bias + prior.velocity_enu * clock
        turn = exp_so3(prior.rate_enu * clock) @ exp_so3(prior.R_enu_from_body @ boresight)
        R = turn @ self.rotation
        theta = log_so3(rotation[prior.photos] @ np.swapaxes(R, -1, -2))
        return np.hstack([origin[prior.photos] - p, theta])

    def cost(self, d: Array, shared: Array) -> float:
        """Half the squared normalised residuals of the poses and of what they share."""
        own = float(np.sum(d * self.times(d[:, :, None])[:, :, 0]))
        return 0.5 * (own + float(shared @ self.shared_information @ shared))

    def derivatives(self, d: Array, boresight: Array) -> tuple[Array, Array]:
        """Of the residual by pose steps (n, 6, 6) and, but for the sign, by shared ones (n, 6, 10).

        The residual moves by A step_pose - B step_shared.
        """
        prior = self.prior
        n = len(prior.photos)
        A, B = np.zeros((n, 6, 6)), np.zeros((n, 6, FLIGHT_UNKNOWNS))
        A[:, :3, :3] = np.eye(3)
        A[:, 3:, 3:] = left_jacobian_inverse(d[:, 3:])
        right = np.swapaxes(A[:, 3:, 3:], -1, -2)
        # a boresight that has grown turns on: Exp(b + db) = Exp(J db) Exp(b)
        grown = np.linalg.inv(left_jacobian_inverse(boresight))
        B[:, :3, 0:3] = prior.R_enu_from_body
        B[:, 3:, 3:6] = right @ prior.R_enu_from_body @ grown
        B[:, :3, 6:9] = np.eye(3)
        B[:, :3, 9] = prior.velocity_enu
        B[:, 3:, 9] = np.einsum("nij,nj->ni", right, prior.rate_enu)
        return A, B

    def times(self, x: Array) -> Array:
        """Information of the poses times columns; (n, 6, k) -> (n, 6, k)."""
        return np.asarray(self.information @ x.reshape(-1, x.shape[2])).reshape(x.shape)

    def own_blocks(self) -> Array:
        """Information of each pose when all others are known; (n, 6, 6)."""
        n = len(self.prior.photos)
        blocks = self.information.reshape(n, 6, n, 6)
        return np.asarray(blocks[np.arange(n), :, np.arange(n), :])

    def pose_normal(self, A: Array) -> Array:
        """A^T information A, (6 n, 6 n)."""
        n = len(self.prior.photos)
        L = self.information.reshape(n, 6, n, 6)
        LA = np.einsum("aibj,bjk->aibk", L, A)
        return np.asarray(np.einsum("aij,aibk->ajbk", A, LA).reshape(6 * n, 6 * n))

    def normal(self, d: Array, shared: Array) -> tuple[Array, Array, Array, Array, Array]:
        """Normal equations of the prior.

        Returns
        -------
        A : shape (n, 6, 6)
            For `pose_normal`.
        border : shape (6 n, 10)
        corner : shape (10, 10)
        rhs_pose, rhs_shared : shapes (6 n,), (10,)
        """
        n = len(self.prior.photos)
        A, B = self.derivatives(d, shared[3:6])
        flat = B.reshape(6 * n, FLIGHT_UNKNOWNS)
        LB = self.times(B)
        border = -np.einsum("aij,aik->ajk", A, LB).reshape(6 * n, -1)
        corner = flat.T @ LB.reshape(6 * n, -1) + self.shared_information
        Ld = self.times(d[:, :, None])[:, :, 0]
        rhs_pose = -np.einsum("aij,ai->aj", A, Ld).ravel()
        rhs_shared = flat.T @ Ld.ravel() - self.shared_information @ shared
        return A, border, corner, rhs_pose, rhs_shared

    def foretold(self, d: Array) -> tuple[Array, Array]:
        """How far each pose error lies off what those of the other photos foretell, and its sigma.

        Returns
        -------
        off, sigma : shape (n, 6), m and rad

        Notes
        -----
        Leave-one-out residuals of a Gaussian process: Rasmussen and Williams, "Gaussian Processes
        for Machine Learning" (2006), eq. 5.12, block by block.
        """
        own = np.linalg.inv(self.own_blocks())
        off = np.einsum("aij,aj->ai", own, self.times(d[:, :, None])[:, :, 0])
        return off, np.sqrt(np.einsum("aii->ai", own))
