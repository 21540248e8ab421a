"""From an IMU and a GNSS log to a smoothed trajectory."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from georef_gis.errors import NavigationError
from georef_gis.frames import Array, exp_so3
from georef_gis.model.logs import AidLog, ImuLog
from georef_gis.navigate.alignment import (
    BY_FORCE,
    FARTHEST_BACK,
    SIGMA_ANY,
    SIGMA_COURSE,
    Alignment,
    align,
    carried_back,
)
from georef_gis.navigate.gnss_noise import Fixes
from georef_gis.navigate.inertial import BASIC, SCALE, nav_of
from georef_gis.navigate.kalman import run_filter, unpack
from georef_gis.navigate.settings import NavigationSettings
from georef_gis.navigate.smoother import run_smoother
from georef_gis.navigate.trajectory import InertialTrajectory

# Times of the nodes, and the fix at each
Nodes = tuple[Array, NDArray[np.int64]]
# Attitude, gyro bias, its sigma and that of the heading at the start of a stretch
_First = tuple[Array, Array, float, float]
# share of its prior sigma that a heading must come down to, to be more than the prior again
WEAK_HEADING = 0.3
# rad/s and m/s2; no MEMS unit has a bias like this: axes or units are wrong
WILD_GYRO = math.radians(1.5)
WILD_ACCEL = 2.0
# m/s2
GRAVITY = 9.80665
# s; how much of the log the first attitude is refined on
FIRST_STRETCH = 60.0
# rad, one sigma at which a heading that nothing tells is held, see `smooth_flight`
HELD_HEADING = math.radians(2.0)
# rad, one sigma of a first heading: wide enough to count the first stretch only once
START_HEADING = math.radians(5.0)
# s of waiting before the aligned moment that need no bias of their own
SHORT_WAIT = 5.0
# sigmas of a bias found on the first stretch that make its prior: that counts the stretch once
BIAS_WIDTH = 3.0
LEAST_BIAS = math.radians(20.0) / 3600.0
# share of fixes that may disagree; with more, log and fixes are not of one flight
MOST_DISAGREE = 1.0 / 3.0
# times the first stretch is smoothed at most
ROUNDS = 3
# rad, one sigma of a level that a first stretch has found
START_LEVEL = math.radians(1.5)
# a probability that refuses only what is absurd, until the filter has settled
OPEN_GATE = 1e-12
# m/s2 and rad/s, one sigma of what a vehicle may do unseen in a gap of the IMU
GAP_FORCE = 3.0
GAP_RATE = 0.2
# s; steps of the IMU longer than this, and than three usual ones, are gaps
SHORT_GAP = 0.05
AID_COLUMNS = {"heading": 0, "baro_height": 1, "airspeed": 2}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Layout:
    """Where the states lie, their prior variances, noise densities and correlation times."""

    prior: Array
    density: Array
    tau: Array
    slow: int
    baro: int
    wind: int

    @property
    def kept(self) -> int:
        """States behind the nine that the mechanisation needs."""
        return SCALE + 6 if len(self.prior) >= BASIC + SCALE and self.scaled else 6

    @property
    def scaled(self) -> bool:
        """Whether scale and misalignment are among the states."""
        first = min(c for c in (self.slow, self.baro, self.wind, len(self.prior)) if c > 0)
        return first >= BASIC + SCALE


def _layout(settings: NavigationSettings, slow: Array, aids: Sequence[AidLog]) -> _Layout:
    noise = settings.imu
    kinds = {aid.kind for aid in aids}
    prior = [*[0.0] * 9, *[noise.gyro_bias**2] * 3, *[noise.accel_bias**2] * 3]
    density = [*[0.0] * 3, *[noise.accel_walk**2] * 3, *[noise.gyro_walk**2] * 3]
    density += [*[noise.gyro_bias_walk**2] * 3, *[noise.accel_bias_walk**2] * 3]
    tau = [0.0] * BASIC
    if noise.scaled:
        prior += [noise.scale**2 if i % 4 == 0 else noise.misalignment**2 for i in range(SCALE)]
        density += [0.0] * SCALE
        tau += [0.0] * SCALE
    columns = {}
    wanted = {
        "slow": (slow**2, settings.slow_tau, bool(np.any(slow > 0.0))),
        "baro": (np.full(1, settings.baro_sigma**2), settings.baro_tau, "baro_height" in kinds),
        "wind": (np.full(2, settings.wind_sigma**2), settings.wind_tau, "airspeed" in kinds),
    }
    for name, (variance, correlation, used) in wanted.items():
        columns[name] = len(prior) if used else 0
        if used:
            prior += list(variance)
            density += list(variance)
            tau += [correlation] * len(variance)
    return _Layout(prior=np.array(prior), density=np.array(density), tau=np.array(tau), **columns)


def imu_table(imu: ImuLog) -> Array:
    """Samples as the compiled code takes them, (n, 7)."""
    return np.ascontiguousarray(np.column_stack([imu.time, imu.gyro, imu.accel]))


def plan_nodes(imu: Array, fixes: Fixes, start: float, gap: float) -> Nodes:
    """Times of the nodes and the fix at each, -1 for none.

    Every fix within the IMU's span is a node; between, no step is longer than `gap`.
    """
    end = float(imu[-1, 0])
    chosen = np.flatnonzero((fixes.time >= start) & (fixes.time <= end))
    times = fixes.time[chosen]
    # two fixes at one instant would make a step of no length
    single = np.concatenate([[True], np.diff(times) > 1e-4]) if len(times) else np.array([], bool)
    chosen, times = chosen[single], times[single]
    edges = np.concatenate([[start], times, [end]])
    parts, fix = [], []
    for i in range(len(edges) - 1):
        count = max(1, math.ceil((edges[i + 1] - edges[i]) / gap - 1e-6))
        if edges[i + 1] - edges[i] < 1e-6:
            continue
        parts.append(edges[i] + (edges[i + 1] - edges[i]) * np.arange(count) / count)
        fix += [-1] * count
    nodes = np.concatenate([*parts, [end]])
    fix.append(-1)
    found = np.array(fix, dtype=np.int64)
    found[np.searchsorted(nodes, times - 1e-7)] = chosen
    return nodes, found


def _gaps(imu: Array, nodes: Array) -> tuple[Array, Array]:
    """Variance that gaps of the IMU let in at nodes (m, 3), and the gaps themselves (g, 2)."""
    step = np.diff(imu[:, 0])
    usual = float(np.median(step))
    long = np.flatnonzero(step > max(SHORT_GAP, 3.0 * usual))
    jump = np.zeros((len(nodes), 3))
    for i in long:
        start, end, width = imu[i, 0], imu[i + 1, 0], step[i] - usual
        # let in node by node, or the fixes within the gap would meet a state that is too sure
        first = int(np.searchsorted(nodes, start, side="right"))
        last = min(int(np.searchsorted(nodes, end)), len(nodes) - 1)
        before = start
        for m in range(first, last + 1):
            part = min(nodes[m], end) - before
            before = min(nodes[m], end)
            force, rate = GAP_FORCE**2 * width * part, GAP_RATE**2 * width * part
            jump[m] += [force * part**2 / 4.0, force, rate]
    return jump, np.column_stack([imu[long, 0], imu[long + 1, 0]])


def _aid_table(nodes: Array, aids: Sequence[AidLog]) -> Array:
    """Values and sigmas of the aids at nodes, (m, 3, 2); at most two a second."""
    out = np.full((len(nodes), 3, 2), np.nan)
    for aid in aids:
        if aid.kind not in AID_COLUMNS or len(aid) == 0:
            continue
        column = AID_COLUMNS[aid.kind]
        default = {"heading": math.radians(10.0), "baro_height": 2.0, "airspeed": 2.0}[aid.kind]
        last = -math.inf
        near = np.clip(np.searchsorted(aid.time, nodes), 0, len(aid) - 1)
        for m, i in enumerate(near):
            if nodes[m] - last < 0.5 or abs(aid.time[i] - nodes[m]) > 0.15:
                continue
            value = float(aid.value[i])
            sigma = float(aid.sigma[i]) if np.isfinite(aid.sigma[i]) else default
            if math.isfinite(value):
                out[m, column] = value, sigma
                last = nodes[m]
    return out


def _prior(layout: _Layout, fixes: Fixes, start: float, aligned: Alignment, R: Array) -> tuple[
    Array, Array, Array
]:  # fmt: skip
    """State and covariance at the start, before any fix is used."""
    i = int(np.argmin(np.abs(fixes.time - start)))
    away = abs(float(fixes.time[i]) - start)
    has_v = np.isfinite(fixes.v[i]).all() and away < 2.0
    v = fixes.v[i] if has_v else _difference_velocity(fixes, i)
    P = np.diag(layout.prior)
    spread = 10.0 + 3.0 * float(np.sqrt(np.max(fixes.R_p[i].diagonal()))) + 30.0 * away
    sigma_v = 2.0 + 3.0 * float(np.sqrt(np.max(fixes.R_v[i].diagonal()))) if has_v else 10.0
    x = np.zeros(len(layout.prior) - 9)
    if aligned.gyro_bias is not None:
        x[:3] = aligned.gyro_bias
        P[9:12, 9:12] = min(layout.prior[9], aligned.sigma_gyro_bias**2) * np.eye(3)
    drift = math.sqrt(P[9, 9]) * abs(aligned.time - start)
    P[:3, :3] = spread**2 * np.eye(3)
    P[3:6, 3:6] = min(sigma_v + 5.0 * away, 40.0) ** 2 * np.eye(3)
    P[6:8, 6:8] = (aligned.sigma_level + drift) ** 2 * np.eye(2)
    P[8, 8] = min(aligned.sigma_heading + drift, SIGMA_ANY) ** 2
    return nav_of(fixes.p_geo[i], v, R), x, P


def _difference_velocity(fixes: Fixes, i: int) -> Array:
    j, k = max(i - 1, 0), min(i + 1, len(fixes) - 1)
    dt = max(float(fixes.time[k] - fixes.time[j]), 0.1)
    lat, h = fixes.p_geo[i, 0], fixes.p_geo[i, 2]
    scale = np.array([6.371e6 + h, (6.371e6 + h) * math.cos(lat), -1.0])
    return np.asarray((fixes.p_geo[k] - fixes.p_geo[j]) * scale / dt)


def _pass(
    imu: Array, fixes: Fixes, layout: _Layout, settings: NavigationSettings,
    prior: tuple[Array, Array, Array], nodes: Nodes, aids: Sequence[AidLog],
) -> tuple[tuple[Array, ...], Array, Array, Array]:  # fmt: skip
    """One filter pass: what it left, innovations, jumps and gaps."""
    times, fix = nodes
    m, size = len(times), len(layout.prior) - 9
    jump, gaps = _gaps(imu, times)
    n = 9 + size
    out = (
        np.empty((m, 15)), np.empty((m, size)), np.empty((m, 15)), np.empty((m, size)),
        np.empty((m, n * (n + 1) // 2)), np.zeros((m, 9, 3 + layout.kept)),
    )  # fmt: skip
    chi = np.full((m, 4), np.nan)
    gates = np.array([
        chi2.ppf(1.0 - settings.gate, 3), chi2.ppf(1.0 - settings.gate, 1), settings.reacquire,
    ])  # fmt: skip
    reached = run_filter(
        imu, times, jump, fix, np.array([layout.slow, layout.baro, layout.wind, 0]),
        np.stack([layout.density, layout.tau]),
        (np.stack([fixes.p_geo, fixes.v]), np.stack([fixes.R_p, fixes.R_v])),
        _aid_table(times, aids), np.asarray(settings.lever_arm_body_antenna, dtype=np.float64),
        gates, prior[0].copy(), prior[1].copy(), prior[2].copy(), out, chi,
    )  # fmt: skip
    if reached < m:
        raise NavigationError(
            f"the filter lost the vehicle {times[reached] - times[0]:.1f} s after the start; check "
            "the axes and units of the IMU log and its clock against the GNSS log"
        )
    return out, chi, jump, gaps


def smooth_flight(
    imu: ImuLog,
    fixes: Fixes,
    settings: NavigationSettings | None = None,
    aids: Sequence[AidLog] = (),
    *,
    aligned: Alignment | None = None,
) -> InertialTrajectory:
    """Filter and smooth a flight.

    Parameters
    ----------
    imu
        Cleaned: increasing finite times.
    fixes
        See `gnss_noise.prepare_fixes`.
    aids
        Headings, barometric heights (of any zero), airspeeds.
    aligned
        First attitude where it is known; else it is found.

    Raises
    ------
    NavigationError
        If the logs do not overlap, or the filter diverges.

    Notes
    -----
    A flight without a turn or change of speed looks the same whatever its heading. A linear filter
    that is left free to turn it takes its own wandering for a turn of the vehicle, and from that
    claims to tell tilt from accelerometer bias. So there the heading is held, and what is not
    known of it and of the tilt is added to the result as one constant of the flight.
    """
    settings = NavigationSettings() if settings is None else settings
    table = imu_table(imu)
    _check_overlap(table, fixes, imu.source)
    layout = _layout(settings, fixes.slow, aids)
    aligned = align(table, fixes) if aligned is None else aligned
    blind = aligned.sigma_heading >= SIGMA_COURSE and not any(a.kind == "heading" for a in aids)
    held = replace(aligned, sigma_heading=HELD_HEADING) if blind else aligned
    refined = _refined(table, fixes, layout, settings, held)
    start = max(float(table[0, 0]), float(fixes.time[0]), refined.time)
    nodes = plan_nodes(table, fixes, start, settings.node_gap)
    nodes = _until_last_fix(nodes, fixes)
    prior = _prior(layout, fixes, start, refined, refined.R_ned_from_body)
    passed, chi, jump, gaps = _pass(table, fixes, layout, settings, prior, nodes, aids)
    _refuse_disagreement(chi, imu.source)
    model = np.stack([layout.density, layout.tau])
    m, size = len(nodes[0]), len(layout.prior) - 9
    nav, x = np.empty((m, 15)), np.empty((m, size))
    smoothed = np.empty_like(passed[4])
    run_smoother(nodes[0], jump, model, passed, nav, x, smoothed)
    _refuse_wild_biases(x, layout, imu.source)
    return InertialTrajectory(
        imu=table, nodes=nodes[0], nav=nav, x=x, post_nav=passed[2], post_x=passed[3],
        filtered=passed[4], smoothed=smoothed, transitions=passed[5], jump=jump, model=model,
        chi=chi, gaps=gaps[(gaps[:, 1] - gaps[:, 0]) > settings.imu_gap],
        notes=(f"first attitude: {aligned.method}",),
        doubts=_doubts(chi, nodes[0], aligned, start - float(table[0, 0])),
        sigma_constant=_untold(aligned, settings) if blind else np.zeros(3),
    )  # fmt: skip


def _refuse_disagreement(chi: Array, source: str) -> None:
    """Raise where so many fixes disagree with the IMU that no covariance would be true."""
    for column, name in ((0, "positions"), (1, "velocities")):
        seen = chi[np.isfinite(chi[:, column]), column]
        share = float(np.mean(seen < 0.0)) if len(seen) > 20 else 0.0
        if share > MOST_DISAGREE:
            raise NavigationError(
                f"{source or 'IMU log'}: {100 * share:.0f} % of the GNSS {name} disagree with the "
                "IMU; check its axes and units, whether it saturates, and the clocks of both logs"
            )


def _untold(aligned: Alignment, settings: NavigationSettings) -> Array:
    """Sigma of the attitude, NED, that a flight without a turn does not tell, rad; (3,)."""
    level = settings.imu.accel_bias / GRAVITY
    return np.array([level, level, aligned.sigma_heading])


def _refuse_wild_biases(x: Array, layout: _Layout, source: str) -> None:
    """Raise where the biases that make the fixes agree are none of an IMU's."""
    gyro = float(np.max(np.abs(np.median(x[:, :3], axis=0))))
    accel = float(np.max(np.abs(np.median(x[:, 3:6], axis=0))))
    if gyro > max(WILD_GYRO, 8.0 * layout.prior[9] ** 0.5):
        found = f"a gyro bias of {math.degrees(gyro):.1f} deg/s"
    elif accel > max(WILD_ACCEL, 8.0 * layout.prior[12] ** 0.5):
        found = f"an accelerometer bias of {accel:.1f} m/s2"
    else:
        return
    raise NavigationError(
        f"{source or 'IMU log'}: only {found} would make it agree with the fixes; check its axes, "
        "units and signs ([logs.columns] axes)"
    )


def _check_overlap(table: Array, fixes: Fixes, source: str) -> None:
    first, last = max(table[0, 0], fixes.time[0]), min(table[-1, 0], fixes.time[-1])
    if last - first < 2.0:
        raise NavigationError(
            f"{source}: the IMU log ({table[0, 0]:.1f} to {table[-1, 0]:.1f} s) and the GNSS log "
            f"({fixes.time[0]:.1f} to {fixes.time[-1]:.1f} s) do not overlap; check the weeks and "
            "time scales of both"
        )


def _until_last_fix(nodes: Nodes, fixes: Fixes) -> Nodes:
    """Nodes up to two seconds behind the last fix: then inertial navigation drifts unseen."""
    keep = nodes[0] <= fixes.time[-1] + 2.0
    return nodes[0][keep], nodes[1][keep]


def _refined(
    table: Array, fixes: Fixes, layout: _Layout, settings: NavigationSettings, aligned: Alignment
) -> Alignment:
    """Attitude at the start of the navigated part, as good as the first stretch allows.

    The stretch behind the alignment is smoothed, what it tells is carried back to the start by the
    gyro, and the stretch from there is smoothed until its first heading stays: minutes of waiting
    on the ground and the blow of a launch would else start the filter tens of degrees off.
    """
    settings = replace(settings, gate=OPEN_GATE)
    begin = max(float(table[0, 0]), float(fixes.time[0]), aligned.time - FARTHEST_BACK)
    end = aligned.time + FIRST_STRETCH
    held = aligned.sigma_heading <= HELD_HEADING and aligned.method != BY_FORCE
    wide = aligned.sigma_heading if held else max(aligned.sigma_heading, START_HEADING)
    start = max(aligned.time, float(fixes.time[0]))
    found = _first_state(table, fixes, layout, settings, aligned, (start, end))
    if found is None:
        return aligned
    if found[3] > WEAK_HEADING * wide:
        # what little the stretch says of the heading would be counted twice
        turn = _heading_between(found[0], aligned.R_ned_from_body)
        found = (np.asarray(exp_so3([0.0, 0.0, turn]) @ found[0]), *found[1:])
    # a narrow level: while it settles, a wide one would make a heading be seen that is not
    better = replace(
        aligned, time=start, R_ned_from_body=found[0], sigma_heading=wide,
        sigma_level=START_LEVEL,
    )  # fmt: skip
    if begin >= start - SHORT_WAIT:
        return better
    better = _with_bias(better, found, carried_back(table, better, found[1], begin), begin)
    for _ in range(ROUNDS):
        found = _first_state(table, fixes, layout, settings, better, (begin, end))
        if found is None:
            break
        turn = _heading_between(better.R_ned_from_body, found[0])
        better = _with_bias(better, found, found[0], begin)
        if abs(turn) < START_HEADING / 3.0:
            break
    return better


def _with_bias(aligned: Alignment, found: _First, R: Array, time: float) -> Alignment:
    """Alignment at another time with the gyro's bias as found, its sigma wide.

    Over minutes of waiting the sigma of an unknown bias would make the heading anything, and the
    first fixes of the flight would be linearised about a heading that is none.
    """
    return replace(
        aligned, time=time, R_ned_from_body=R, gyro_bias=found[1],
        sigma_gyro_bias=max(BIAS_WIDTH * found[2], LEAST_BIAS),
    )  # fmt: skip


def _first_state(
    table: Array, fixes: Fixes, layout: _Layout, settings: NavigationSettings,
    aligned: Alignment, stretch: tuple[float, float],
) -> _First | None:  # fmt: skip
    """Smoothed state at the start of a stretch; None where it is too short."""
    nodes, fix = plan_nodes(table, fixes, stretch[0], settings.node_gap)
    keep = nodes <= stretch[1]
    m, size = int(np.count_nonzero(keep)), len(layout.prior) - 9
    if m < 3:
        return None
    prior = _prior(layout, fixes, stretch[0], aligned, aligned.R_ned_from_body)
    passed, _, jump, _ = _pass(table, fixes, layout, settings, prior, (nodes[keep], fix[keep]), ())
    nav, x, packed = np.empty((m, 15)), np.empty((m, size)), np.empty_like(passed[4])
    run_smoother(nodes[keep], jump, np.stack([layout.density, layout.tau]), passed, nav, x, packed)
    P = unpack(packed[0], 9 + size)
    sigma = math.sqrt(float(np.max(np.diag(P)[9:12])))
    return nav[0, 6:].reshape(3, 3).copy(), x[0, :3].copy(), sigma, math.sqrt(float(P[8, 8]))


def _heading_between(R_one: Array, R_other: Array) -> float:
    D = R_other @ R_one.T
    return math.atan2(D[1, 0], D[0, 0])


def _doubts(chi: Array, nodes: Array, aligned: Alignment, unused: float) -> tuple[str, ...]:
    out = []
    for column, name in ((0, "positions"), (1, "velocities")):
        refused = int(np.count_nonzero(chi[:, column] < 0.0))
        total = int(np.count_nonzero(np.isfinite(chi[:, column])))
        if refused > max(3, 0.005 * total):
            worst = float(nodes[int(np.nanargmin(chi[:, column]))] - nodes[0])
            out.append(
                f"{refused} of {total} GNSS {name} disagree with the IMU and count less, the worst "
                f"{worst:.1f} s after the start"
            )
    if aligned.sigma_heading >= SIGMA_ANY:
        out.append("the heading is not known: the vehicle never sped up or turned")
    elif aligned.method == "course":
        out.append("the heading is that of the course: the vehicle never turned or changed speed")
    if unused > 1.0:
        out.append(f"the first {unused:.0f} s of the IMU log are not used")
    return tuple(out)


def innovation_score(trajectory: InertialTrajectory) -> Mapping[str, float]:
    """Mean normalised innovations squared per degree of freedom, and shares refused."""
    chi = trajectory.chi
    out: dict[str, float] = {}
    for column, name in ((0, "position"), (1, "velocity")):
        seen = chi[np.isfinite(chi[:, column]), column]
        if len(seen):
            out[f"nis_{name}"] = float(np.median(np.abs(seen))) / float(chi2.ppf(0.5, 3))
            out[f"refused_{name}"] = float(np.mean(seen < 0.0))
    return out


def likelihood(
    table: Array,
    fixes: Fixes,
    settings: NavigationSettings,
    aligned: Alignment,
    stretch: tuple[float, float],
) -> float:
    """Log-likelihood of the fixes of a stretch of the log under settings, of a filter pass.

    Parameters
    ----------
    table : shape (n, 7)
    stretch : s
        First and last time; the first twenty seconds settle the filter and do not count.
    """
    layout = _layout(settings, fixes.slow, ())
    times, fix = plan_nodes(table, fixes, stretch[0], settings.node_gap)
    keep = times <= stretch[1]
    R = carried_back(table, aligned, np.zeros(3), stretch[0])
    prior = _prior(layout, fixes, stretch[0], aligned, R)
    try:
        _, chi, _, _ = _pass(table, fixes, layout, settings, prior, (times[keep], fix[keep]), ())
    except NavigationError:
        return -math.inf
    counted = times[keep] > stretch[0] + 20.0
    return float(np.nansum(chi[counted, 2]))
