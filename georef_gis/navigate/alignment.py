"""First attitude without a magnetometer: what the force feels against what the velocity does.

Over any interval the change of velocity less gravity's is the felt force, turned into NED. The
attitude that turns one into the other over a window is Wahba's problem (SIAM Review 7, 1965; by
singular values: Markley 1988). Gravity levels it; heading is seen as soon as the vehicle speeds up
or turns, whatever way it points: no course is needed, so crab and multirotors do no harm. A flight
without any such moment has only its course, with a sigma that covers crab.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from georef_gis.errors import NavigationError
from georef_gis.frames import Array, R_ned_from_body, exp_so3
from georef_gis.navigate.dense import compiled, sample_before
from georef_gis.navigate.gnss_noise import Fixes
from georef_gis.navigate.inertial import gravity, rotate, sample_of, turned

# s; length of a window, and between two tries
WINDOW = 20.0
STRIDE = 5.0
# s; shortest interval whose change of velocity is taken
INTERVAL = 0.45
# rad; a heading this good needs no better window
GOOD_HEADING = math.radians(2.5)
# windows between two that share no time, and rad by which their headings may differ
APART = round(WINDOW / STRIDE)
AGREEMENT = math.radians(8.0)
# rad; a worse one is taken from the course
POOR_HEADING = math.radians(12.0)
# rad, one sigma of a course taken for a heading
SIGMA_COURSE = math.radians(20.0)
# rad, one sigma of a direction of which nothing is known
SIGMA_ANY = math.pi / math.sqrt(3.0)
# rad, one sigma of roll and pitch as levelled
SIGMA_LEVEL = math.radians(3.0)
# sigmas of chance by which a motion must exceed the noise of the velocities to be seen
SEEN = 5.0
# m/s; slower, the course says nothing
SLOWEST_COURSE = 5.0
# how a heading was found that the motion itself tells
BY_FORCE = "felt force against change of velocity"
# s; how far back from the aligned moment the log is used
FARTHEST_BACK = 300.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Alignment:
    """Attitude at an instant, with the sigmas (rad) of level and heading, and how it was found."""

    time: float
    R_ned_from_body: Array
    sigma_level: float
    sigma_heading: float
    method: str
    # rad/s and its one sigma, where a first look has found it
    gyro_bias: Array | None = None
    sigma_gyro_bias: float = math.inf
    accel_bias: Array | None = None


@compiled
def body_increments(imu: Array, edges: Array) -> tuple[Array, Array]:
    """Attitude at edges and felt change of velocity between them, in the body of the first edge.

    Parameters
    ----------
    imu : shape (n, 7); edges : shape (m,), s within it

    Returns
    -------
    R : shape (m, 3, 3); dv : shape (m - 1, 3), m/s
    """
    m = len(edges)
    R_out, dv = np.empty((m, 3, 3)), np.zeros((m - 1, 3))
    R, sample = np.zeros(9), np.empty(6)
    R[0] = R[4] = R[8] = 1.0
    i = sample_before(imu, edges[0])
    now = edges[0]
    last = len(imu) - 2
    for j in range(m):
        while now < edges[j]:
            stop = imu[i + 1, 0] if i < last else edges[j]
            to = min(max(stop, now), edges[j])
            sample_of(imu, i, 0.5 * (now + to), sample)
            half = 0.5 * (to - now)
            x, y, z = half * sample[0], half * sample[1], half * sample[2]
            rotate(R, x, y, z)
            felt = turned(R, sample[3], sample[4], sample[5])
            for k in range(3):
                dv[j - 1, k] += (to - now) * felt[k]
            rotate(R, x, y, z)
            now = to
            if i < last and now >= imu[i + 1, 0]:
                i += 1
        for k in range(9):
            R_out[j, k // 3, k % 3] = R[k]
    return R_out, dv


def velocities(fixes: Fixes) -> tuple[Array, Array, float]:
    """Times, velocities NED (n, 3) and their sigma, m/s: the receiver's, else from positions."""
    has = np.isfinite(fixes.v).all(axis=1)
    if np.count_nonzero(has) >= max(10, len(fixes) // 2):
        sigma = float(np.sqrt(np.median(fixes.R_v[has][:, 0, 0])))
        return fixes.time[has], fixes.v[has], sigma
    lat, h = fixes.p_geo[0, 0], fixes.p_geo[0, 2]
    scale = np.array([6.371e6 + h, (6.371e6 + h) * math.cos(lat), -1.0])
    p = (fixes.p_geo - fixes.p_geo[0]) * scale
    half = 2.5
    times, rows, sigmas = [], [], []
    white = float(np.sqrt(np.median(fixes.R_p[:, 0, 0])))
    for t in np.arange(fixes.time[0] + half, fixes.time[-1] - half, half):
        near = np.abs(fixes.time - t) <= half
        if np.count_nonzero(near) < 3:
            continue
        dt = fixes.time[near] - t
        fit = np.polyfit(dt, p[near], 2 if np.count_nonzero(near) > 4 else 1)
        times.append(t)
        rows.append(fit[-2])
        sigmas.append(white / math.sqrt(float(np.sum((dt - dt.mean()) ** 2))))
    if len(times) < 4:
        return np.empty(0), np.empty((0, 3)), math.inf
    return np.array(times), np.array(rows), float(np.median(sigmas))


def align(imu: Array, fixes: Fixes) -> Alignment:
    """First good attitude of a log.

    Parameters
    ----------
    imu : shape (n, 7)
        Time s, rate rad/s, force m/s2.

    Raises
    ------
    NavigationError
        If the two logs do not overlap.
    """
    t, v, sigma = velocities(fixes)
    inside = (t > imu[0, 0]) & (t < imu[-1, 0])
    t, v = t[inside], v[inside]
    if len(t) < 4:
        return _levelled(imu, fixes)
    edges, v_edges = _thinned(t, v)
    if len(edges) < 4:
        return _levelled(imu, fixes)
    R_start, felt = body_increments(imu, edges)
    found = _best_window(edges, v_edges, R_start, felt, sigma, fixes)
    if found is not None and found.sigma_heading <= POOR_HEADING:
        return found
    return _by_course(edges, v_edges, R_start, found, imu, fixes)


def _thinned(t: Array, v: Array) -> tuple[Array, Array]:
    keep = [0]
    for i in range(1, len(t)):
        if t[i] - t[keep[-1]] >= INTERVAL:
            keep.append(i)
    return t[keep], v[keep]


def _best_window(
    edges: Array, v: Array, R_start: Array, felt: Array, sigma: float, fixes: Fixes
) -> Alignment | None:
    """Attitude at the first window whose heading is good, else at the best of the log."""
    dt = np.diff(edges)
    g = gravity(float(fixes.p_geo[0, 0]), float(fixes.p_geo[0, 2]))
    seen = np.diff(v, axis=0) - np.array([0.0, 0.0, g]) * dt[:, None]
    whole = dt < 5.0
    found: list[tuple[float, int, Array]] = []
    for start in np.arange(edges[0], max(edges[-1] - WINDOW, edges[0]) + 1e-9, STRIDE):
        chosen = np.flatnonzero((edges[:-1] >= start) & (edges[1:] <= start + WINDOW) & whole)
        if len(chosen) < 3:
            continue
        C, heading = _wahba(seen[chosen], felt[chosen], sigma, dt[chosen])
        found.append((heading, int(chosen[0]), C))
        if len(found) > APART and _agree(found[-1 - APART], found[-1]):
            break
    if not found:
        return None
    # all are attitudes of one frame that the gyro carries along: two that agree are believed
    best = -1 - APART if len(found) > APART and _agree(found[-1 - APART], found[-1]) else None
    heading, first, C = found[best] if best is not None else min(found, key=lambda f: f[0])
    return Alignment(
        time=float(edges[first]),
        R_ned_from_body=C @ R_start[first],
        sigma_level=SIGMA_LEVEL,
        sigma_heading=heading,
        method=BY_FORCE,
    )


def _agree(one: tuple[float, int, Array], other: tuple[float, int, Array]) -> bool:
    """Whether two windows that share no time give good headings that agree."""
    if max(one[0], other[0]) > GOOD_HEADING:
        return False
    D = one[2] @ other[2].T
    return abs(math.atan2(D[1, 0], D[0, 0])) < AGREEMENT


def _wahba(seen: Array, felt: Array, sigma: float, dt: Array) -> tuple[Array, float]:
    """Rotation that turns what is felt into what is seen, and the sigma of its heading, rad."""
    u, _, vt = np.linalg.svd(seen.T @ felt)
    d = np.sign(np.linalg.det(u) * np.linalg.det(vt))
    C = u @ np.diag([1.0, 1.0, d]) @ vt
    # two velocities and an accelerometer's bias; neighbours share a velocity, hence the 2
    noise = 2.0 * (2.0 * sigma**2 + (0.1 * dt) ** 2)
    misfit = np.sum((seen - felt @ C.T) ** 2, axis=1) / noise
    # the horizontal part less its mean: a constant one cannot be told from a tilt
    moved = seen[:, :2] - seen[:, :2].mean(axis=0)
    level = float(np.sum((moved**2).sum(axis=1) / noise))
    # what the velocities' own noise puts there is no motion
    noisy = 4.0 * sigma**2 / noise
    expected, spread = float(np.sum(noisy)), float(np.sqrt(np.sum(noisy**2)))
    level = level - expected if level > expected + SEEN * spread else 0.0
    excess = max(1.0, float(np.mean(misfit)) / 3.0)
    return C, SIGMA_ANY if level <= 0.0 else min(math.sqrt(excess / level), SIGMA_ANY)


def _by_course(
    edges: Array, v: Array, R_start: Array, found: Alignment | None, imu: Array, fixes: Fixes
) -> Alignment:
    """Level of the best window, heading of the course at the first speed."""
    fast = np.flatnonzero(np.hypot(v[:, 0], v[:, 1]) > SLOWEST_COURSE)
    if len(fast) == 0:
        return _levelled(imu, fixes)
    first = int(fast[0])
    course = math.atan2(v[first, 1], v[first, 0])
    base = found.R_ned_from_body if found is not None else _level_at(imu, float(edges[first]))
    if found is not None:
        at = int(np.argmin(np.abs(edges - found.time)))
        base = base @ R_start[at].T @ R_start[first]
    return Alignment(
        time=float(edges[first]),
        R_ned_from_body=with_heading(base, course),
        sigma_level=SIGMA_LEVEL,
        sigma_heading=SIGMA_COURSE,
        method="course",
    )


def _levelled(imu: Array, fixes: Fixes) -> Alignment:
    """Level from the first seconds' force; heading unknown."""
    start = max(imu[0, 0], float(fixes.time[0]))
    if start >= imu[-1, 0]:
        raise NavigationError(
            f"the IMU log ({imu[0, 0]:.1f} to {imu[-1, 0]:.1f} s) and the GNSS log "
            f"({fixes.time[0]:.1f} to {fixes.time[-1]:.1f} s) do not overlap"
        )
    return Alignment(
        time=start,
        R_ned_from_body=_level_at(imu, start),
        sigma_level=SIGMA_LEVEL,
        sigma_heading=SIGMA_ANY,
        method="level only: the vehicle never moves enough to see its heading",
    )


def _level_at(imu: Array, time: float) -> Array:
    near = (imu[:, 0] >= time) & (imu[:, 0] <= time + 2.0)
    f = imu[near, 4:7].mean(axis=0) if near.any() else imu[0, 4:7]
    roll, pitch = math.atan2(-f[1], -f[2]), math.atan2(f[0], math.hypot(f[1], f[2]))
    return R_ned_from_body(roll, pitch, 0.0)


def with_heading(R: Array, heading: float) -> Array:
    """Attitude turned about the vertical until it has a heading, rad; (3, 3)."""
    turn = heading - math.atan2(R[1, 0], R[0, 0])
    return np.asarray(exp_so3([0.0, 0.0, turn]) @ R)


def carried_back(imu: Array, aligned: Alignment, gyro_bias: Array, to: float) -> Array:
    """Attitude at an earlier time by the gyro alone, (3, 3); the Earth's turn is left out."""
    if to >= aligned.time:
        return aligned.R_ned_from_body
    shifted = imu.copy()
    shifted[:, 1:4] -= gyro_bias
    R, _ = body_increments(shifted, np.array([to, aligned.time]))
    return np.asarray(aligned.R_ned_from_body @ R[1].T)
