"""From an IMU and a GNSS log to a smoothed trajectory."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from georef_gis.errors import NavigationError
from georef_gis.frames import Array
from georef_gis.model.logs import AidLog, ImuLog
from georef_gis.navigate.alignment import (
    BY_FORCE,
    SIGMA_ANY,
    Alignment,
    align,
    carried_back,
)
from georef_gis.navigate.filter_pass import (
    Layout,
    Nodes,
    filter_pass,
    imu_table,
    make_layout,
    plan_nodes,
    prior_state,
)
from georef_gis.navigate.first_state import HELD_HEADING, refined_start
from georef_gis.navigate.gnss_noise import Fixes
from georef_gis.navigate.settings import NavigationSettings
from georef_gis.navigate.smoother import run_smoother
from georef_gis.navigate.trajectory import InertialTrajectory

# rad/s and m/s2; no MEMS unit has a bias like this: axes or units are wrong
WILD_GYRO = math.radians(1.5)
WILD_ACCEL = 2.0
# m/s2
GRAVITY = 9.80665
# s without a fix from which on a flight is solved a second time
LONG_OUTAGE = 8.0
# share of fixes that may disagree; with more, log and fixes are not of one flight
MOST_DISAGREE = 1.0 / 3.0


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
    layout = make_layout(settings, fixes.slow, aids)
    aligned = align(table, fixes) if aligned is None else aligned
    blind = aligned.method != BY_FORCE and not any(aid.kind == "heading" for aid in aids)
    held = replace(aligned, sigma_heading=HELD_HEADING) if blind else aligned
    refined = refined_start(table, fixes, layout, settings, held)
    start = max(float(table[0, 0]), float(fixes.time[0]), refined.time)
    nodes = plan_nodes(table, fixes, start, settings.node_gap)
    nodes = _until_last_fix(nodes, fixes)
    found = _solved(table, fixes, layout, settings, refined, nodes, aids)
    _refuse_disagreement(found.chi, imu.source)
    _refuse_wild_biases(found.x, layout, imu.source)
    if _longest_gap(fixes, nodes[0]) > LONG_OUTAGE:
        found = _solved(table, fixes, layout, settings, _again(refined, found), nodes, aids)
    return InertialTrajectory(
        imu=table, nodes=nodes[0], nav=found.nav, x=found.x, post_nav=found.passed[2],
        post_x=found.passed[3], filtered=found.passed[4], smoothed=found.smoothed,
        transitions=found.passed[5], jump=found.jump,
        model=np.stack([layout.density, layout.tau]), chi=found.chi,
        gaps=found.gaps[(found.gaps[:, 1] - found.gaps[:, 0]) > settings.imu_gap],
        notes=(f"first attitude: {aligned.method}",),
        doubts=_doubts(found.chi, nodes[0], aligned, start - float(table[0, 0])),
        sigma_constant=_untold(aligned, settings) if blind else np.zeros(3),
    )  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Solved:
    """What a forward and a backward pass leave."""

    passed: tuple[Array, ...]
    chi: Array
    jump: Array
    gaps: Array
    nav: Array
    x: Array
    smoothed: Array


def _solved(
    table: Array, fixes: Fixes, layout: Layout, settings: NavigationSettings, first: Alignment,
    nodes: Nodes, aids: Sequence[AidLog],
) -> _Solved:  # fmt: skip
    prior = prior_state(layout, fixes, float(nodes[0][0]), first, first.R_ned_from_body)
    passed, chi, jump, gaps = filter_pass(table, fixes, layout, settings, prior, nodes, aids)
    m, size = len(nodes[0]), len(layout.prior) - 9
    nav, x, smoothed = np.empty((m, 15)), np.empty((m, size)), np.empty_like(passed[4])
    model = np.stack([layout.density, layout.tau])
    run_smoother(nodes[0], jump, model, passed, nav, x, smoothed)
    return _Solved(
        passed=passed, chi=chi, jump=jump, gaps=gaps, nav=nav, x=x, smoothed=smoothed
    )  # fmt: skip


def _longest_gap(fixes: Fixes, nodes: Array) -> float:
    """Longest time without a fix within the nodes, s."""
    inside = fixes.time[(fixes.time >= nodes[0]) & (fixes.time <= nodes[-1])]
    return float(np.max(np.diff(np.concatenate([nodes[:1], inside, nodes[-1:]]))))


def _again(first: Alignment, found: _Solved) -> Alignment:
    """Where to start from once more: as wide as before, but about what the flight has told.

    Through an outage the filter runs on its own biases. About those of the beginning it goes
    astray, and what brings it back is linearised about a path that was not flown.
    """
    return replace(
        first,
        R_ned_from_body=found.nav[0, 6:].reshape(3, 3).copy(),
        gyro_bias=found.x[0, :3].copy(),
        accel_bias=found.x[0, 3:6].copy(),
    )


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


def _refuse_wild_biases(x: Array, layout: Layout, source: str) -> None:
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
    layout = make_layout(settings, fixes.slow, ())
    times, fix = plan_nodes(table, fixes, stretch[0], settings.node_gap)
    keep = times <= stretch[1]
    R = carried_back(table, aligned, np.zeros(3), stretch[0])
    prior = prior_state(layout, fixes, stretch[0], aligned, R)
    try:
        _, chi, _, _ = filter_pass(
            table, fixes, layout, settings, prior, (times[keep], fix[keep]), ()
        )
    except NavigationError:
        return -math.inf
    counted = times[keep] > stretch[0] + 20.0
    return float(np.nansum(chi[counted, 2]))
