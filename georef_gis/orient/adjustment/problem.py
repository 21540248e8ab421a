"""The state of an adjustment and its normal equations."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import bsr_matrix, csr_matrix

from georef_gis.frames import Array, exp_so3
from georef_gis.orient.adjustment.banded import BandedFactor, BandOrder, band_order
from georef_gis.orient.adjustment.block import (
    FLIGHT_UNKNOWNS,
    LARGE,
    Block,
    FlightPrior,
    GroundPrior,
    camera_vector,
    joined_observations,
    marked_points,
    moved_camera_vector,
)
from georef_gis.orient.adjustment.dense import DenseFactor
from georef_gis.orient.adjustment.flight_model import FlightModel
from georef_gis.orient.adjustment.kernels import (
    CAMERA_UNKNOWNS,
    LEVEL,
    SURFACE,
    reduce_points,
    residuals,
)
from georef_gis.orient.adjustment.long_flight import LongFlightModel
from georef_gis.orient.adjustment.photo_pairs import pairs_of, rows_and_columns, symmetric
from georef_gis.orient.adjustment.point_kernels import move_points, place_points
from georef_gis.orient.adjustment.whole_moves import WholeMove, whole_move

# how often points are placed anew after a step of the poses
POINT_ROUNDS = 1


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class State:
    """Values of all unknowns: poses, cameras (c, 12), points, shared ones of flights (f, 10).

    `shifts` are the offset of the surface that is known beforehand, and the level of the block, m.
    """

    origin: Array
    rotation: Array
    cameras: Array
    points: Array
    flights: Array
    shifts: Array

    @property
    def level(self) -> float:
        """What control adds to all heights, m."""
        return float(self.shifts[LEVEL])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Reduced:
    """Normal equations without the points: blocks of pairs of photos, border, corner."""

    blocks: Array
    border: Array
    corner: Array
    rhs_pose: Array
    rhs_shared: Array
    lost: int


def _by_parts(prior: FlightPrior) -> FlightPrior:
    """Prior whose joint covariance is asked for by parts."""
    whole = prior.covariance
    if prior.joint is not None and prior.times is not None:
        return prior
    if whole is None:
        raise ValueError(f"flight {prior.id}: has no covariance")
    view = whole.reshape(len(prior.photos), 6, len(prior.photos), 6)

    def joint(indices: NDArray[np.int64]) -> Array:
        k = len(indices)
        part = view[indices][:, :, indices]
        return np.asarray(part.reshape(6 * k, 6 * k))

    times = np.arange(len(prior.photos), dtype=np.float64) if prior.times is None else prior.times
    return replace(prior, joint=joint, times=times)


class Problem:
    """A block made ready for the compiled loops."""

    def __init__(self, block: Block, points: Array) -> None:
        """Take the block and first guesses of all points (tie points, then marked control)."""
        self.block = block
        self.ties, self.mark_of = joined_observations(block.ties, block.control)
        self.span = np.searchsorted(self.ties.point, np.arange(self.ties.n_points + 1))
        self.marked = marked_points(block.control)
        poses = block.poses
        origin = np.array([pose.origin_enu for pose in poses])
        rotation = np.array([pose.R_enu_from_cam for pose in poses])
        self.large = len(poses) > LARGE
        model = LongFlightModel if self.large else FlightModel
        priors = [_by_parts(p) for p in block.flights] if self.large else block.flights
        self.flights = [model(prior, origin, rotation) for prior in priors]
        self.motion = np.zeros((len(poses), 6))
        for flight in block.flights:
            self.motion[flight.photos, :3] = flight.velocity_enu
            self.motion[flight.photos, 3:] = flight.rate_enu
        self.nominal = np.array([camera_vector(p.camera) for p in block.cameras])
        self.heights = np.array([float(p.camera.height) for p in block.cameras])
        self.camera_information = self._camera_information()
        self.pattern = pairs_of(self.ties, len(poses))
        if self.large:
            self.order = self._band_order()
        self.sigma = self.ties.sigma.copy()
        self.know_ground(block.ground)
        start = block.start or poses
        self.start = State(
            origin=np.array([pose.origin_enu for pose in start]),
            rotation=np.array([pose.R_enu_from_cam for pose in start]),
            cameras=self.nominal.copy(),
            points=np.ascontiguousarray(points, dtype=np.float64),
            flights=np.zeros((len(block.flights), FLIGHT_UNKNOWNS)),
            shifts=np.zeros(2),
        )

    def _band_order(self) -> BandOrder:
        """Order that keeps photos that see the same points, or follow each other, close."""
        row, column = rows_and_columns(self.pattern)
        rows, columns = [row], [column]
        for flight in self.flights:
            if isinstance(flight, LongFlightModel):
                at, across, _ = flight.blocks(np.zeros((len(flight.prior.photos), 6, 6)))
                rows.append(at)
                columns.append(across)
        i, j = np.concatenate(rows), np.concatenate(columns)
        n = len(self.block.photo_ids)
        ones = np.ones(2 * len(i))
        both = np.concatenate([i, j]), np.concatenate([j, i])
        return band_order(csr_matrix((ones, both), shape=(n, n)))

    def _camera_information(self) -> Array:
        sigma = np.concatenate([p.sigma for p in self.block.cameras])
        return np.asarray(np.where(sigma > 0, 1.0 / np.where(sigma > 0, sigma, 1.0) ** 2, 0.0))

    def _free(self) -> NDArray[np.bool_]:
        cameras = self.camera_information > 0
        flights = [flight.free for flight in self.flights]
        return np.concatenate([cameras, *flights, self.sigma_shifts > 0])

    def know_ground(self, ground: GroundPrior | None) -> None:
        """Take the heights that the ground is expected at."""
        self.block = replace(self.block, ground=ground)
        self.sigma_shifts = np.array(self.block.sigma_shifts)
        self.free = self._free()
        self._know_points()

    def _know_points(self) -> None:
        """What is known of points beforehand: the ground's height, surveyed places."""
        n, block = self.ties.n_points, self.block
        self.target, self.information = np.zeros((n, 3)), np.zeros((n, 3))
        self.shift_of = np.full(n, -1, dtype=np.int64)
        ground, ties = block.ground, block.ties.n_points
        if ground is not None and ties:
            known = np.isfinite(ground.z_enu)
            spread = max(np.count_nonzero(known) / ground.independent, 1.0)
            weight = 1.0 / (np.square(ground.sigma) * spread)
            self.information[:ties, 2] = np.where(known, weight, 0.0)
            self.target[:ties, 2] = np.where(known, ground.z_enu, 0.0)
            self.shift_of[:ties] = SURFACE if ground.sigma_offset > 0.0 else -1
        if block.control is not None:
            for row, index in enumerate(self.marked, start=ties):
                if not block.control.used[index]:
                    continue
                sigma, place = block.control.sigma[index], block.control.p_enu[index]
                self.information[row] = np.where(np.isfinite(sigma), 1.0 / sigma**2, 0.0)
                self.target[row] = np.where(np.isfinite(sigma), place, 0.0)
                self.shift_of[row] = LEVEL

    # -- arguments of the compiled loops -------------------------------------------------------

    def observations(self) -> tuple[object, ...]:
        """Observations as the kernels take them."""
        block, ties = self.block, self.ties
        return (ties.photo, ties.point, ties.uv, self.sigma, block.camera_of, self.heights)

    def values(self, state: State) -> tuple[Array, ...]:
        """State as the kernels take it."""
        return (state.origin, state.rotation, self.motion, state.cameras, state.points)

    def place(self, state: State) -> tuple[object, ...]:
        """What is known of the points, as the kernels take it."""
        return (state.points, self.target, self.information, self.shift_of)

    # -- cost ----------------------------------------------------------------------------------

    def shared_vector(self, state: State) -> Array:
        """Steps of the shared unknowns from where their priors put them; shape (G,)."""
        moved = state.cameras - self.nominal
        cameras = np.concatenate([moved[:, :1], moved[:, 2:]], axis=1).ravel()
        return np.concatenate([cameras, state.flights.ravel(), state.shifts])

    def image_cost(self, state: State, scale2: float) -> tuple[float, Array, Array]:
        """Robust cost of the observations, residuals (m, 2) px and weights (m,)."""
        r, w = np.zeros((len(self.ties.photo), 2)), np.zeros(len(self.ties.photo))
        cost = residuals(self.observations(), self.values(state), scale2, r, w)
        return float(cost), r, w

    def prior_cost(self, state: State) -> float:
        """Cost of all that is known beforehand."""
        cost = 0.0
        for flight, shared in zip(self.flights, state.flights, strict=True):
            d = flight.residual(state.origin, state.rotation, shared)
            cost += flight.cost(d, shared)
        moved = self.shared_vector(state)[: len(self.camera_information)]
        cost += 0.5 * float(moved @ (self.camera_information * moved))
        known = self.sigma_shifts > 0
        cost += 0.5 * float(np.sum((state.shifts[known] / self.sigma_shifts[known]) ** 2))
        off = self.target - state.points
        off[:, 2] -= np.where(self.shift_of >= 0, state.shifts[self.shift_of], 0.0)
        return cost + 0.5 * float(np.sum(self.information * off**2))

    # -- normal equations ----------------------------------------------------------------------

    def reduced(self, state: State, scale2: float, damping: float) -> Reduced:
        """Normal equations of the observations with the points eliminated."""
        n, G = len(state.origin), self.block.n_shared
        start, column = self.pattern
        blocks = np.zeros((len(column), 6, 6))
        border, corner = np.zeros((n, 6, G)), np.zeros((G, G))
        rhs_pose, rhs_shared = np.zeros((n, 6)), np.zeros(G)
        lost = reduce_points(
            self.observations(), self.values(state), self.place(state), self.span,
            self.block.camera_of, (scale2, damping, state.shifts, G - 2), (start, column),
            (blocks, border, corner, rhs_pose, rhs_shared),
        )  # fmt: skip
        corner = np.triu(corner) + np.triu(corner, 1).T
        return Reduced(
            blocks=blocks, border=border, corner=corner, rhs_pose=rhs_pose, rhs_shared=rhs_shared,
            lost=int(lost),
        )  # fmt: skip

    def factor(
        self, state: State, reduced: Reduced, damping: float
    ) -> tuple[DenseFactor | BandedFactor, Array]:
        """Factor of the damped normal matrix of poses and shared unknowns, and right side (N,).

        Raises
        ------
        numpy.linalg.LinAlgError
            If the matrix is not positive definite.
        """
        if not self.large:
            H, rhs = self.dense_normal(state, reduced)
            return DenseFactor(H, damping), rhs
        poses, border, corner, rhs = self._band_normal(state, reduced)
        return BandedFactor(poses, border, corner, self.order, damping), rhs

    def dense_normal(self, state: State, reduced: Reduced) -> tuple[Array, Array]:
        """Whole normal matrix of poses and shared unknowns, and right side; (N, N), (N,)."""
        n, G = len(state.origin), self.block.n_shared
        N = 6 * n + G
        H = np.zeros((N, N))
        row, column = rows_and_columns(self.pattern)
        view = H[: 6 * n, : 6 * n].reshape(n, 6, n, 6)
        view[row, :, column, :] = reduced.blocks
        off = row != column
        view[column[off], :, row[off], :] = np.swapaxes(reduced.blocks[off], 1, 2)
        border, corner, rhs, turned = self._with_priors(state, reduced)
        for flight, A in zip(self.flights, turned, strict=True):
            where = (6 * flight.prior.photos[:, None] + np.arange(6)).ravel()
            if len(self.flights) == 1 and np.array_equal(where, np.arange(6 * n)):
                H[: 6 * n, : 6 * n] += flight.pose_normal(A)
            else:
                H[np.ix_(where, where)] += flight.pose_normal(A)
        H[: 6 * n, 6 * n :], H[6 * n :, : 6 * n] = border, border.T
        H[6 * n :, 6 * n :] = corner
        return H, rhs

    def _band_normal(
        self, state: State, reduced: Reduced
    ) -> tuple[bsr_matrix, Array, Array, Array]:
        """Normal matrix of a large block: that of the poses sparse, border, corner, right side."""
        n = len(state.origin)
        border, corner, rhs, turned = self._with_priors(state, reduced)
        row, column = rows_and_columns(self.pattern)
        total = symmetric(row, column, reduced.blocks, n)
        for flight, A in zip(self.flights, turned, strict=True):
            if not isinstance(flight, LongFlightModel):
                raise ValueError("a large block needs long flights")
            total = total + symmetric(*flight.blocks(A), n)
        return total, border, corner, rhs

    def _with_priors(
        self, state: State, reduced: Reduced
    ) -> tuple[Array, Array, Array, list[Array]]:
        """Border (6 n, G), corner and right side with all that is known; A of each flight."""
        n, G = 6 * len(state.origin), self.block.n_shared
        border, corner = reduced.border.reshape(n, G).copy(), reduced.corner.copy()
        rhs = np.concatenate([reduced.rhs_pose.ravel(), reduced.rhs_shared])
        turned = []
        for index, flight in enumerate(self.flights):
            shared = state.flights[index]
            d = flight.residual(state.origin, state.rotation, shared)
            A, own_border, own_corner, rhs_pose, rhs_shared = flight.normal(d, shared)
            turned.append(A)
            where = (6 * flight.prior.photos[:, None] + np.arange(6)).ravel()
            at = self.block.flight_at(index)
            columns = slice(at, at + FLIGHT_UNKNOWNS)
            border[where, columns] += own_border
            corner[columns, columns] += own_corner
            rhs[where] += rhs_pose
            rhs[n + at : n + at + FLIGHT_UNKNOWNS] += rhs_shared
        m = len(self.camera_information)
        cameras = np.arange(m)
        corner[cameras, cameras] += self.camera_information
        rhs[n : n + m] -= self.camera_information * self.shared_vector(state)[:m]
        for k, sigma in enumerate(self.sigma_shifts, start=len(corner) - 2):
            if sigma > 0:
                corner[k, k] += 1.0 / sigma**2
                rhs[n + k] -= state.shifts[k - len(corner) + 2] / sigma**2
        held = np.flatnonzero(~self.free)
        border[:, held], corner[held], corner[:, held] = 0.0, 0.0, 0.0
        corner[held, held], rhs[n + held] = 1.0, 0.0
        return border, corner, rhs, turned

    def moved(self, state: State, step: Array, scale2: float, damping: float) -> State:
        """State after a step of poses and shared unknowns, the points following; (N,)."""
        n = len(state.origin)
        pose, shared = step[: 6 * n].reshape(n, 6), np.ascontiguousarray(step[6 * n :])
        points = self._point_steps(state, pose, shared, scale2, damping)
        at = CAMERA_UNKNOWNS * len(state.cameras)
        steps = shared[:at].reshape(-1, CAMERA_UNKNOWNS)
        cameras = [moved_camera_vector(c, s) for c, s in zip(state.cameras, steps, strict=True)]
        # The block as a whole turns far more easily than it bends, and along a circle.
        whole: WholeMove = whole_move(state.origin, pose)
        origin, points = whole.places(state.origin, pose[:, :3]), whole.places(state.points, points)
        there = replace(
            state,
            origin=origin,
            rotation=exp_so3(pose[:, 3:] - whole.turn) @ exp_so3(whole.turn) @ state.rotation,
            cameras=np.array(cameras),
            points=points,
            flights=state.flights + shared[at:-2].reshape(state.flights.shape),
            shifts=state.shifts + shared[-2:],
        )
        # The rays of the new poses place the points better than the tangent of the old ones: far
        # fewer steps in the curved valleys of focal length, height and distortion.
        for _ in range(POINT_ROUNDS):
            there = self.with_placed_points(there, scale2)
        return there

    def with_placed_points(self, state: State, scale2: float) -> State:
        """State whose points lie better by the rays of its poses; none lies worse."""
        points = np.empty_like(state.points)
        place_points(
            self.observations(), self.values(state), self.place(state), self.span,
            (scale2, 0.0, state.shifts, self.block.n_shared - 2), points,
        )  # fmt: skip
        return replace(state, points=points)

    def _point_steps(
        self, state: State, pose: Array, shared: Array, scale2: float, damping: float
    ) -> Array:
        points = np.zeros_like(state.points)
        move_points(
            self.observations(), self.values(state), self.place(state), self.span,
            self.block.camera_of, (scale2, damping, state.shifts, self.block.n_shared - 2),
            (np.ascontiguousarray(pose), shared), points,
        )  # fmt: skip
        return points
