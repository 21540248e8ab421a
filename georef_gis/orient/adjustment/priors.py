"""What is known before an adjustment: of cameras, and of the poses of a flight by tags or logs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from georef_gis.frames import R_BODY_FROM_CAM_NADIR, Array
from georef_gis.model.camera import Camera
from georef_gis.model.photo import OrientedPhoto, Photo
from georef_gis.model.trajectory import StateChain
from georef_gis.orient.adjustment.block import LARGE, CameraPrior, FlightPrior

# How errors of tags hang together, as shares of their variance: the same over the flight, slow,
# and each photo's own. A consumer receiver's error is mostly slow (2012 paper: minutes); angles of
# an autopilot have a constant part, the mount, and crab is the same along a line.
POSITION_SHARES = (0.3, 0.55, 0.15)
TILT_SHARES = (0.3, 0.65, 0.05)
YAW_SHARES = (0.2, 0.7, 0.1)
SHARES = np.array([POSITION_SHARES] * 3 + [TILT_SHARES] * 2 + [YAW_SHARES])
# s, correlation times of the slow parts; tilt wanders with gusts and turns: told the longer, it is
# taken for a mount, which cancels between opposite headings and makes the block's tilt too sure
TAU_POSITION, TAU_TILT, TAU_YAW = 100.0, 15.0, 40.0
TAU = np.array([TAU_POSITION] * 3 + [TAU_TILT] * 2 + [TAU_YAW])
# m and s, one sigma where nothing is stated: antenna beside the camera, position older than photo
SIGMA_LEVER, SIGMA_TAG_CLOCK = 0.1, 0.3
# of a tagged position's sigma: the most that its being late makes of it
CLOCK_SHARE = 0.4
# s; between photos whose clocks tell nothing
USUAL_INTERVAL = 3.0
# s, one sigma of the shared part of the exposure times that a log's events give
SIGMA_EVENT_CLOCK = 0.01
# of the width, one sigma of a principal point nobody stated
SIGMA_CENTRE_SHARE = 0.005
SIGMA_FOCAL_SHARE = 0.03
# k1 k2 k3 p1 p2 of a lens nobody calibrated, and of one that is stated
SIGMA_DISTORTION = (0.05, 0.05, 0.02, 1e-3, 1e-3)
SIGMA_STATED = (0.01, 0.01, 0.01, 3e-4, 3e-4)
# of the focal length, one sigma of affinity and skew: sensors are square to this
SIGMA_AFFINITY = 2e-4
# s, one sigma of a readout time that nobody stated, and the share of a stated one
SIGMA_READOUT, SIGMA_READOUT_SHARE = 0.015, 0.15


def camera_prior(camera: Camera, *, calibrate: bool = True, moving: bool = True) -> CameraPrior:
    """How far each parameter of a camera may lie off.

    Parameters
    ----------
    calibrate
        Without, all are held, but for the distortion where none is stated.
    moving
        Whether velocities are known; without them a readout time means nothing.
    """
    sigma = np.zeros(11)
    stated = any((camera.k1, camera.k2, camera.k3, camera.p1, camera.p2))
    if calibrate or not stated:
        # a lens of which nobody said anything is not free of distortion
        sigma[3:8] = SIGMA_STATED if stated else SIGMA_DISTORTION
    if calibrate:
        sigma[0] = camera.sigma_f or SIGMA_FOCAL_SHARE * camera.fx
        sigma[1:3] = camera.sigma_c or SIGMA_CENTRE_SHARE * camera.width
        sigma[8:10] = SIGMA_AFFINITY * camera.fx
        if moving:
            sigma[10] = max(SIGMA_READOUT_SHARE * camera.readout_s, SIGMA_READOUT * (not stated))
    return CameraPrior(camera=camera, sigma=sigma)


@dataclass(frozen=True, slots=True, kw_only=True)
class MountPrior:
    """One sigma of what is known of the mount, where it is stated: m and rad."""

    sigma_lever: float = SIGMA_LEVER
    sigma_boresight: float | None = None
    sigma_clock: float = SIGMA_TAG_CLOCK


def times_of(photos: Sequence[Photo]) -> Array:
    """When photos were taken, s from the first; by their order where clocks tell nothing."""
    if all(photo.time_gps is not None for photo in photos):
        t = np.array([photo.time_gps for photo in photos], dtype=np.float64)
    elif all(photo.camera_clock is not None for photo in photos):
        clocks = [photo.camera_clock for photo in photos]
        first = min(c for c in clocks if c is not None)
        t = np.array([(c - first).total_seconds() for c in clocks if c is not None])
    else:
        t = np.asarray(USUAL_INTERVAL * np.arange(len(photos)))
    return np.asarray(t - t.min()) if len(t) else t


def velocities_of(photos: Sequence[Photo], origin: Array, times: Array) -> Array:
    """Velocities, m/s in enu: as tagged, or by the neighbours' places; zero where unknown; (n, 3).

    A turn between lines, or a place that is wrong, gives a wrong leg: where the legs to both
    neighbours disagree, the one that goes on straight counts, if only one does.
    """
    out = np.zeros((len(photos), 3))
    order = np.argsort(times, kind="stable")
    p, t = origin[order], times[order]
    n = len(order)

    def leg(k: int) -> Array | None:
        """Velocity from place k to the next; None where there is none."""
        if k < 0 or k + 1 >= n or t[k + 1] - t[k] <= 0.2:
            return None
        return np.asarray((p[k + 1] - p[k]) / (t[k + 1] - t[k]))

    for k, i in enumerate(int(i) for i in order):
        photo = photos[i]
        if photo.ground_speed is not None and photo.course is not None:
            level = np.array([np.sin(photo.course), np.cos(photo.course), 0.0])
            out[i] = photo.ground_speed * level
            continue
        before, after = leg(k - 1), leg(k)
        legs = [v for v in (before, after) if v is not None]
        if not _alike(before, after):
            further = (leg(k - 2), leg(k + 1))
            straight = [v for v, w in zip((before, after), further, strict=True) if _alike(v, w)]
            lonely = len(legs) == 1 and further[0] is None and further[1] is None
            one = [v for v in straight if v is not None]
            legs = one if len(one) == 1 else legs if lonely else []
        if legs:
            out[i] = np.asarray(np.mean(legs, axis=0))
            out[i, 2] = 0.0
    return out


def _alike(a: Array | None, b: Array | None) -> bool:
    """Whether two velocities are those of one straight line."""
    if a is None or b is None:
        return False
    # clocks of whole seconds make one of two equal legs twice as fast
    return bool(np.linalg.norm(a - b) <= 0.5 * max(np.linalg.norm(a), np.linalg.norm(b)))


def tag_prior(
    id: str,
    photos: Sequence[OrientedPhoto],
    indices: NDArray[np.int64],
    mount: MountPrior | None = None,
) -> FlightPrior:
    """Joint prior of photos whose poses come from tags.

    The pose's own covariance says how large errors are; the shares above say how they hang
    together.

    Parameters
    ----------
    photos
        Of the flight, in camera axes of the sensor (not turned by an editor).
    indices : shape (n,)
        Their indices in the block.
    """
    mount = mount or MountPrior()
    n = len(photos)
    times = times_of([p.photo for p in photos])
    R_eb = np.array([p.pose.R_enu_from_cam @ R_BODY_FROM_CAM_NADIR.T for p in photos])
    covariance = np.array([p.pose.covariance for p in photos])
    T = np.zeros((n, 6, 6))
    T[:, :3, :3], T[:, 3:, 3:] = np.eye(3), R_eb
    local = np.swapaxes(T, 1, 2) @ covariance @ T
    sigma = np.sqrt(np.einsum("aii->ai", local))
    origin = np.array([p.pose.origin_enu for p in photos])
    velocity = velocities_of([p.photo for p in photos], origin, times)
    clock = _lateness(mount, sigma, velocity)
    own = _own_variances(sigma, velocity, clock)
    # what all share is no larger than the best photo allows: some may have a fixed receiver
    typical = np.sqrt(np.min(sigma**2, axis=0) * SHARES[:, 0])
    slow = np.sqrt(np.maximum((1.0 - SHARES[:, 2]) * sigma**2 - typical**2, 0.0))
    joint = _joint_of_tags(times, T, own, slow)
    boresight = mount.sigma_boresight
    shared = np.concatenate([
        np.full(3, mount.sigma_lever), typical[3:] if boresight is None else np.full(3, boresight),
        typical[:3], [clock],
    ])  # fmt: skip
    return FlightPrior(
        id=id,
        photos=indices,
        covariance=joint(np.arange(n)) if n <= LARGE else None,
        white=np.einsum("aij,aj,akj->aik", T, own, T),
        R_enu_from_body=R_eb,
        velocity_enu=velocity,
        rate_enu=np.zeros((n, 3)),
        shared_covariance=np.diag(shared**2),
        times=times,
        joint=joint,
    )


def _lateness(mount: MountPrior, sigma: Array, velocity: Array) -> float:
    """One sigma, s, of how late positions were tagged, by their sigmas (n, 6) and velocities.

    It belongs to a tag's error along the track, and is no more than a part of it.
    """
    speed_known = velocity[np.any(velocity, axis=1)]
    usual = float(np.median(np.linalg.norm(speed_known, axis=1))) if len(speed_known) else 0.0
    along = CLOCK_SHARE * float(np.median(sigma[:, :2]))
    return min(mount.sigma_clock, along / usual) if usual > 0.0 else 0.0


def _own_variances(sigma: Array, velocity: Array, clock: float) -> Array:
    """Each photo's own part of the variances, (n, 6), m^2 and rad^2 in body axes.

    A photo whose speed is not known is off by any clock error, `clock` in s.
    """
    own = SHARES[:, 2] * sigma**2
    speed = np.linalg.norm(velocity, axis=1)
    if np.any(speed):
        own[speed == 0.0, :2] += (clock * np.median(speed[speed > 0.0])) ** 2
    return np.asarray(own)


def _joint_of_tags(
    times: Array, T: Array, own: Array, slow: Array
) -> Callable[[NDArray[np.int64]], Array]:
    """Covariance of any of the photos, what all share taken out.

    Parameters
    ----------
    times : shape (n,), s
    T : shape (n, 6, 6)
        To enu from the axes of the errors.
    own : shape (n, 6)
        Variances of each photo's own part, m^2 and rad^2.
    slow : shape (n, 6)
        Sigmas of the part that changes slowly, m and rad.
    """

    def joint(indices: NDArray[np.int64]) -> Array:
        k, t, spread = len(indices), times[indices], slow[indices]
        lag = np.abs(t[:, None] - t)
        out = np.zeros((k, 6, k, 6))
        for c in range(6):
            out[:, c, :, c] = np.outer(spread[:, c], spread[:, c]) * np.exp(-lag / TAU[c])
            out[np.arange(k), c, np.arange(k), c] += own[indices, c]
        turned = np.einsum("aij,ajbk,blk->aibl", T[indices], out, T[indices])
        flat = turned.reshape(6 * k, 6 * k)
        return np.asarray((flat + flat.T) / 2)

    return joint


def navigation_prior(
    id: str,
    photos: Sequence[OrientedPhoto],
    indices: NDArray[np.int64],
    exposures: dict[str, Array],
    *,
    sigma_clock: float = SIGMA_EVENT_CLOCK,
) -> FlightPrior:
    """Joint prior of photos whose poses come from a trajectory.

    Parameters
    ----------
    exposures
        Columns of `navigation/exposures.npz`, photos in its order: `time`, `covariance` and `gain`
        of the chain, `to_pose`, `mount`, `mount_covariance`, `own`.
    sigma_clock : s
        Of the part of the exposure times that all photos share.
    """
    n = len(photos)
    L, M, own = exposures["to_pose"], exposures["mount"], exposures["own"]
    chain = StateChain(
        time=exposures["time"], covariance=exposures["covariance"], gain=exposures["gain"]
    )

    def joint(indices: NDArray[np.int64]) -> Array:
        """Covariance of some of the photos, what all share taken out."""
        k = len(indices)
        out = chain.joint(indices).reshape(k, 6, k, 6)
        out = np.einsum("aij,ajbk,blk->aibl", L[indices], out, L[indices])
        out[np.arange(k), :, np.arange(k), :] += own[indices]
        flat = out.reshape(6 * k, 6 * k)
        return np.asarray((flat + flat.T) / 2)

    shared = np.zeros((10, 10))
    shared[:9, :9] = exposures["mount_covariance"]
    if not np.any(M[:, 3:, 3:6]):
        # a gimbal holds the camera: the vehicle's boresight turns nothing
        shared[3:6], shared[:, 3:6] = 0.0, 0.0
    still = np.zeros(3)
    velocity = [p.pose.velocity_enu if p.pose.velocity_enu is not None else still for p in photos]
    rate = [p.pose.rate_enu if p.pose.rate_enu is not None else still for p in photos]
    shared[9, 9] = sigma_clock**2
    return FlightPrior(
        id=id,
        photos=indices,
        covariance=joint(np.arange(n)) if n <= LARGE else None,
        white=own,
        R_enu_from_body=M[:, :3, :3],
        velocity_enu=np.array(velocity),
        rate_enu=np.array(rate),
        shared_covariance=shared,
        times=exposures["time"],
        joint=joint,
    )
