"""From fixes, and an attitude log where there is one, to a smoothed trajectory without an IMU."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from georef_gis.ellipsoid import Origin
from georef_gis.errors import NavigationError
from georef_gis.frames import R_ENU_FROM_NED_SAME_PLACE, Array
from georef_gis.model.logs import AttitudeLog
from georef_gis.navigate.attitude_track import AttitudeTrack, attitude_track, held_courses
from georef_gis.navigate.gnss_noise import Fixes
from georef_gis.navigate.kinematic import (
    KinematicSettings,
    KinematicTrajectory,
    states_from_ned,
)
from georef_gis.navigate.kinematic_smoother import PACKED, STATES, backward, forward

# s; closer fixes are one
_SAME = 1e-4
# m/s2 and s: accelerations and their correlation times among which the fixes choose
LADDER = tuple(
    (sigma, tau) for tau in (1.0, 4.0, 15.0, 40.0) for sigma in (0.1, 0.3, 1.0, 2.5, 6.0)
)
# for fewer fixes than these the choice is made for them, as for a small fixed wing in turns
FEWEST_FIXES = 20
USUAL_MOTION = (2.5, 4.0)
# fixes on which the choice is made, where the vehicle moves most
MOST_FIXES = 2000
# s, and a factor on the noise of the acceleration: gaps twice as long have all of it
LOOSE_FROM = 10.0
LOOSEST = 2.0
# m/s, one sigma of a velocity before the first fix
ANY_VELOCITY = 60.0
# m, the least sigma of a fix: receivers state zero
LEAST_SIGMA = 1e-3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Observations:
    """Fixes in the axes of the states: `time` (m,), `z` (2, m, 3), `R` (2, m, 3, 3)."""

    origin: Origin
    time: Array
    z: Array
    R: Array


def _observations(fixes: Fixes) -> _Observations:
    order = np.argsort(fixes.time, kind="stable")
    order = order[np.isfinite(fixes.time[order]) & np.isfinite(fixes.p_geo[order]).all(axis=-1)]
    if len(order):
        order = order[np.concatenate([[True], np.diff(fixes.time[order]) > _SAME])]
    if len(order) < 2:
        raise NavigationError(f"{len(order)} GNSS fixes at different times; a trajectory needs two")
    lat, lon, height = (float(value) for value in fixes.p_geo[order[len(order) // 2]])
    origin = Origin(lat=lat, lon=lon, height_ellipsoidal=height)
    p_geo = fixes.p_geo[order]
    turn = states_from_ned(origin, p_geo)
    p = origin.enu_from_geo(p_geo) @ R_ENU_FROM_NED_SAME_PLACE
    v = np.einsum("nij,nj->ni", turn, fixes.v[order])
    R = np.stack([turn @ c[order] @ np.swapaxes(turn, -1, -2) for c in (fixes.R_p, fixes.R_v)])
    R += LEAST_SIGMA**2 * np.eye(3)
    return _Observations(
        origin=origin, time=np.ascontiguousarray(fixes.time[order]),
        z=np.ascontiguousarray(np.stack([p, v])), R=np.ascontiguousarray(R),
    )  # fmt: skip


def _prior(seen: _Observations, motion: Array, slow: Array) -> tuple[Array, Array]:
    """State and covariance before the first fix: near the first few, for one of them may be off."""
    z, R = seen.z[:, :5], seen.R[:, :5]
    x = np.zeros(STATES)
    x[:3] = np.median(z[0], axis=0)
    away = np.linalg.norm(z[0] - x[:3], axis=1)
    sigma = math.sqrt(float(np.median(np.einsum("nii->ni", R[0]).max(axis=-1))))
    known = np.isfinite(z[1]).all(axis=-1)
    spread_v = ANY_VELOCITY
    if np.count_nonzero(known) >= 3:
        x[3:6] = np.median(z[1, known], axis=0)
        spread_v = 10.0 + 3.0 * float(np.median(np.linalg.norm(z[1, known] - x[3:6], axis=1)))
    spread = 10.0 + 3.0 * sigma + 3.0 * float(np.median(away))
    variances = np.concatenate(
        [np.full(3, spread**2), np.full(3, spread_v**2), motion[:, 0] ** 2, slow[:3] ** 2]
    )
    return x, np.diag(variances)


def _loose(time: Array) -> Array:
    """Jumps at nodes without variance, (m, 3): a vehicle is given more freedom in long gaps.

    A flight is rows and turns, and a gap long enough for a turn may hold one.
    """
    out = np.zeros((len(time), 3))
    out[1:, 2] = np.clip(np.diff(time) / LOOSE_FROM, 1.0, LOOSEST)
    return out


def _pass(
    seen: _Observations, motion: Array, slow: Array, settings: KinematicSettings
) -> tuple[tuple[Array, ...], Array]:
    """What a pass of the filter leaves, and its log-likelihoods of level and vertical."""
    m = len(seen.time)
    out = (np.empty((m, STATES)), np.empty((m, STATES)), np.empty((m, PACKED)), _loose(seen.time),
           np.empty((m, 2)))  # fmt: skip
    options = np.array([chi2.ppf(1.0 - settings.gate, 3), settings.reacquire])
    x, cov = _prior(seen, motion, slow)
    told = forward(seen.time, seen.z, seen.R, motion, slow, options, x, cov, out)
    return out, told


def _most_moving(seen: _Observations) -> _Observations:
    """The stretch of the log in which the vehicle moves most, of `MOST_FIXES`."""
    m = len(seen.time)
    if m <= MOST_FIXES:
        return seen
    speed = np.linalg.norm(np.diff(seen.z[0], axis=0), axis=1) / np.diff(seen.time)
    # a jump must not outweigh a flight
    sums = np.concatenate([[0.0], np.cumsum(np.minimum(speed, ANY_VELOCITY))])
    first = int(np.argmax(sums[MOST_FIXES - 1 :] - sums[: m - MOST_FIXES + 1]))
    part = slice(first, first + MOST_FIXES)
    return _Observations(
        origin=seen.origin, time=seen.time[part].copy(), z=seen.z[:, part].copy(),
        R=seen.R[:, part].copy(),
    )  # fmt: skip


def _motion(seen: _Observations, slow: Array, settings: KinematicSettings) -> Array:
    """Sigma and correlation time of the acceleration of each axis, by maximum likelihood; (3, 2).

    Level and vertical are chosen apart: their innovations do not touch each other.
    """
    if len(seen.time) < FEWEST_FIXES:
        return np.tile(USUAL_MOTION, (3, 1))
    part = _most_moving(seen)
    told = np.array([_pass(part, np.tile(rung, (3, 1)), slow, settings)[1] for rung in LADDER])
    level, vertical = (LADDER[int(np.argmax(told[:, k]))] for k in (0, 1))
    return np.array([level, level, vertical])


def smooth_fixes(
    fixes: Fixes, attitude: AttitudeLog | None = None, settings: KinematicSettings | None = None
) -> KinematicTrajectory:
    """Smooth a flight of fixes alone, or of fixes and an attitude that another filter logged.

    Parameters
    ----------
    fixes
        See `gnss_noise.prepare_fixes`; in any order.
    attitude
        None = heading by the course, bank by the turn, pitch by the path.

    Raises
    ------
    NavigationError
        If fewer than two fixes are left, or the two logs do not overlap.
    """
    settings = KinematicSettings() if settings is None else settings
    seen = _observations(fixes)
    track = None if attitude is None else attitude_track(attitude, settings.attitude)
    if track is not None:
        _check_overlap(seen.time, track)
    slow = np.append(fixes.slow, settings.slow_tau)
    motion = _motion(seen, slow, settings)
    (prior, post, filtered, jump, chi), _ = _pass(seen, motion, slow, settings)
    if not np.isfinite(post).all():
        raise NavigationError(
            "the fixes have covariances that no filter can use; check the GNSS log's sigmas"
        )
    smoothed, covariance = np.empty_like(post), np.empty_like(filtered)
    backward(seen.time, motion, slow, (prior, post, filtered, jump), smoothed, covariance)
    o = seen.origin
    notes = _notes(motion) + (track.notes if track is not None else ())
    return KinematicTrajectory(
        origin=np.array([o.lat, o.lon, o.height_ellipsoidal]), time=seen.time, prior=prior,
        post=post, filtered=filtered, jump=jump, smoothed=smoothed, covariance=covariance, chi=chi,
        motion=motion, slow=slow, held=held_courses(smoothed[:, 3:6], settings.attitude.slow),
        track=track, settings=settings, notes=notes,
        doubts=_doubts(seen.time, chi, track, settings),
    )  # fmt: skip


def _check_overlap(time: Array, track: AttitudeTrack) -> None:
    first, last = track.span
    if first > time[-1] or last < time[0]:
        away = first - time[-1] if first > time[-1] else time[0] - last
        raise NavigationError(
            f"the attitude log lies {away:.0f} s off the GNSS log; check the clocks of both"
        )


def _notes(motion: Array) -> tuple[str, ...]:
    (level, tau), (vertical, tau_v) = motion[0], motion[2]
    return (
        f"no IMU: fixes smoothed with accelerations of {level:g} m/s2 over {tau:g} s, "
        f"vertically {vertical:g} m/s2 over {tau_v:g} s",
    )


def _doubts(
    time: Array, chi: Array, track: AttitudeTrack | None, settings: KinematicSettings
) -> tuple[str, ...]:
    out = []
    for column, name in ((0, "positions"), (1, "velocities")):
        total = int(np.count_nonzero(np.isfinite(chi[:, column])))
        outliers = int(np.count_nonzero(chi[:, column] < 0.0))
        if outliers > max(3, 0.005 * total):
            worst = float(time[int(np.nanargmin(chi[:, column]))] - time[0])
            out.append(
                f"{outliers} of {total} GNSS {name} disagree with the others and count less, the "
                f"worst {worst:.1f} s after the start"
            )
    steps = np.diff(time)
    for least, most, what in (
        (settings.notable_gap, settings.longest_gap, "bridged at the sigma of a guess"),
        (settings.longest_gap, math.inf, "without a trajectory"),
    ):
        gaps = steps[(steps > least) & (steps <= most)]
        if len(gaps):
            out.append(f"{len(gaps)} gaps of the GNSS log, up to {gaps.max():.1f} s, are {what}")
    if track is None:
        out.append("no attitude in the logs: heading by the course, bank by the turn")
        return tuple(out)
    return (*out, *track.doubts)
