"""Poses of the camera at the exposures, from the trajectory, the mount and the clock."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from georef_gis.ellipsoid import Origin
from georef_gis.frames import (
    R_ENU_FROM_NED_SAME_PLACE,
    Array,
    R_enu_from_ned,
    log_so3,
    skew,
)
from georef_gis.model.pose import Mount, Pose
from georef_gis.model.trajectory import StateChain, Trajectory
from georef_gis.project.columns_file import write_columns

# s; a time less exact than this is not linear in what the vehicle does
COARSE = 0.02
# of its variance, in every direction
CROOKED = 0.1


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ExposurePoses:
    """Camera poses in order of time, and how their errors hang together.

    Parameters
    ----------
    ids
        Photos.
    poses
        In enu, kind "navigation".
    chain
        Errors of the trajectory at the exposures.
    to_pose : shape (n, 6, 6)
        Error of the camera's pose (dp_enu, dtheta_enu) by the trajectory's (dp_ned, dtheta_ned).
    mount : shape (n, 6, 9)
        By what all photos of a flight share: camera's lever arm (body, m), boresight (body, rad),
        datum (enu, m).
    mount_covariance : shape (9, 9)
    own : shape (n, 6, 6)
        Covariance of what is each photo's own: its time.
    """

    ids: tuple[str, ...]
    poses: tuple[Pose, ...]
    chain: StateChain
    to_pose: Array
    mount: Array
    mount_covariance: Array
    own: Array

    def joint(self, indices: Sequence[int] | None = None) -> Array:
        """Joint covariance of the poses of some or all photos, (6 k, 6 k)."""
        chosen = np.arange(len(self.ids)) if indices is None else np.asarray(indices, dtype=int)
        k = len(chosen)
        nav = self.chain.joint(chosen).reshape(k, 6, k, 6)
        L, M = self.to_pose[chosen], self.mount[chosen]
        out = np.einsum("aij,ajbk,blk->aibl", L, nav, L)
        out += np.einsum("aij,jk,blk->aibl", M, self.mount_covariance, M)
        for a, i in enumerate(chosen):
            out[a, :, a, :] += self.own[i]
        return np.asarray(out.reshape(6 * k, 6 * k))

    def save(self, path: Path) -> None:
        """Write all but the poses, which stand in the database, whole or not at all."""
        columns = {
            "ids": list(self.ids), "time": self.chain.time, "covariance": self.chain.covariance,
            "gain": self.chain.gain, "to_pose": self.to_pose, "mount": self.mount,
            "mount_covariance": self.mount_covariance, "own": self.own,
        }  # fmt: skip
        write_columns(path, "exposures", columns)


def exposure_poses(
    trajectory: Trajectory,
    ids: Sequence[str],
    times: Array,
    variance_of_time: Array,
    mount: Mount,
    origin: Origin,
    *,
    sigma_datum: float = 0.0,
    held: Sequence[Pose | None] | None = None,
) -> ExposurePoses:
    """Poses of the camera.

    Parameters
    ----------
    ids, times : s
        In order of time; all within the trajectory.
    variance_of_time : shape (n,), s^2
    sigma_datum : m
        Of east and north, the same for all.
    held
        Poses whose rotation is that of a camera in a gimbal; None = the mount's.

    Raises
    ------
    NavigationError
        If a time lies outside of the trajectory.
    """
    chain = trajectory.chain(times)
    states = trajectory.at(times)
    n = len(ids)
    L, M, own = np.zeros((n, 6, 6)), np.zeros((n, 6, 9)), np.zeros((n, 6, 6))
    poses = []
    shared = _shared_covariance(mount, sigma_datum)
    turned = _coarse_times(trajectory, times, variance_of_time, origin)
    p_imu = origin.enu_from_geo(states.p_geo)
    R_en = R_enu_from_ned(origin.lat, origin.lon, states.p_geo[:, 0], states.p_geo[:, 1])
    for i in range(n):
        R_eb = R_en[i] @ states.R_ned_from_body[i]
        tagged = None if held is None else held[i]
        a = R_eb @ mount.lever_arm_body_camera
        rate = R_eb @ states.rate_body[i]
        velocity = R_en[i] @ states.v_ned[i] + np.cross(rate, a)
        L[i], M[i] = _sensitivities(R_en[i], R_eb, a, held=tagged is not None)
        moved = np.concatenate([velocity, rate])
        own[i] = turned[i] if i in turned else variance_of_time[i] * np.outer(moved, moved)
        R_ec = R_eb @ mount.R_body_from_cam
        if tagged is not None:
            own[i, 3:, :] = own[i, :, 3:] = 0.0
            own[i, 3:, 3:] = tagged.covariance[3:, 3:]
            R_ec = tagged.R_enu_from_cam
        covariance = L[i] @ chain.covariance[i][:6, :6] @ L[i].T + M[i] @ shared @ M[i].T + own[i]
        poses.append(
            Pose(
                origin_enu=p_imu[i] + a,
                R_enu_from_cam=_orthonormal(R_ec),
                covariance=0.5 * (covariance + covariance.T),
                kind="navigation",
                velocity_enu=velocity,
                rate_enu=rate if tagged is None else None,
            )
        )
    return ExposurePoses(
        ids=tuple(ids), poses=tuple(poses), chain=chain, to_pose=L, mount=M,
        mount_covariance=shared, own=own,
    )  # fmt: skip


def _shared_covariance(mount: Mount, sigma_datum: float) -> Array:
    """Covariance of what all exposures share: lever arm, boresight, datum; (9, 9), m and rad."""
    return np.diag([
        *[mount.sigma_lever_arm**2] * 3, *[mount.sigma_boresight**2] * 3, *[sigma_datum**2] * 2, 0.0
    ])  # fmt: skip


def _sensitivities(R_en: Array, R_eb: Array, arm: Array, *, held: bool) -> tuple[Array, Array]:
    """Error of a camera's pose by that of the trajectory (6, 6) and of the mount (6, 9).

    `arm` is the camera's lever arm in enu, m; the angles of a camera that is `held` by a gimbal
    are neither the trajectory's nor the mount's.
    """
    L, M = np.zeros((6, 6)), np.zeros((6, 9))
    L[:3, :3] = R_en
    # an attitude error swings the camera round the IMU
    L[:3, 3:] = -skew(arm) @ R_en
    M[:3, :3] = R_eb
    M[:3, 6:9] = np.eye(3)
    if not held:
        L[3:, 3:] = R_en
        M[3:, 3:6] = R_eb
    return L, M


def _coarse_times(
    trajectory: Trajectory, times: Array, variance: Array, origin: Origin
) -> dict[int, Array]:
    """Covariance that a coarse exposure time gives a pose, (6, 6), by its place in the order.

    Over tenths of a second a vehicle in gusts does not turn at one rate: the trajectory itself,
    before and after, says how far the pose may be off (Gauss-Hermite quadrature over the time).
    """
    sigma = np.sqrt(variance)
    coarse = np.flatnonzero(sigma > COARSE)
    if len(coarse) == 0:
        return {}
    first, last = trajectory.span
    nodes, weights = np.polynomial.hermite_e.hermegauss(7)
    tried = np.clip(times[coarse] + np.outer(nodes, sigma[coarse]), first, last)
    for row in tried:
        bad = [bool(trajectory.why_not(float(t))) for t in row]
        row[bad] = times[coarse][bad]
    here = trajectory.at(times[coarse])
    p = origin.enu_from_geo(here.p_geo)
    moved = []
    for row in tried:
        there = trajectory.at(row)
        turn = log_so3(there.R_ned_from_body @ np.swapaxes(here.R_ned_from_body, -1, -2))
        R_en = R_ENU_FROM_NED_SAME_PLACE
        moved.append(np.hstack([origin.enu_from_geo(there.p_geo) - p, turn @ R_en.T]))
    share, off = weights / weights.sum(), np.stack(moved)
    each = np.einsum("q,qka,qkb->kab", share, off, off)
    for block in (slice(0, 3), slice(3, 6)):
        # a few points of a crooked path do not fill the space that it runs through
        own = np.trace(each[:, block, block], axis1=1, axis2=2) / 3.0
        each[:, block, block] += CROOKED * own[:, None, None] * np.eye(3)
    return {int(i): each[k] for k, i in enumerate(coarse)}


def _orthonormal(R: Array) -> Array:
    u, _, vt = np.linalg.svd(R)
    return np.asarray(u @ vt)
