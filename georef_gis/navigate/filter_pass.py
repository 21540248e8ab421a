"""One forward pass of the inertial filter: which states it has, its nodes and its prior."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from georef_gis.errors import NavigationError
from georef_gis.frames import Array
from georef_gis.model.logs import AidLog, ImuLog
from georef_gis.navigate.alignment import (
    SIGMA_ANY,
    Alignment,
)
from georef_gis.navigate.gnss_noise import Fixes
from georef_gis.navigate.inertial import BASIC, SCALE, nav_of
from georef_gis.navigate.kalman import run_filter
from georef_gis.navigate.settings import NavigationSettings

# Times of the nodes, and the fix at each
Nodes = tuple[Array, NDArray[np.int64]]
# m/s2 and rad/s, one sigma of what a vehicle may do unseen in a gap of the IMU
GAP_FORCE = 3.0
GAP_RATE = 0.2
# s; steps of the IMU longer than this, and than three usual ones, are gaps
SHORT_GAP = 0.05
AID_COLUMNS = {"heading": 0, "baro_height": 1, "airspeed": 2}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Layout:
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


def make_layout(settings: NavigationSettings, slow: Array, aids: Sequence[AidLog]) -> Layout:
    """States that the settings, the slow GNSS error (3,) m and the aids at hand call for."""
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
    return Layout(prior=np.array(prior), density=np.array(density), tau=np.array(tau), **columns)


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


def _aid_table(nodes: Array, aids: Sequence[AidLog], fixes: Fixes) -> Array:
    """Values and sigmas of the aids at nodes, (m, 3, 2); at most two a second."""
    out = np.full((len(nodes), 3, 2), np.nan)
    for aid in aids:
        if aid.kind not in AID_COLUMNS or len(aid) == 0:
            continue
        column = AID_COLUMNS[aid.kind]
        default = {"heading": math.radians(10.0), "baro_height": 2.0, "airspeed": 2.0}[aid.kind]
        last = -math.inf
        near = _nearest(aid.time, nodes)
        zero = _zero_of(aid, fixes) if aid.kind == "baro_height" else 0.0
        for m, i in enumerate(near):
            if nodes[m] - last < 0.5 or abs(aid.time[i] - nodes[m]) > 0.15:
                continue
            value = float(aid.value[i]) + zero
            sigma = float(aid.sigma[i]) if np.isfinite(aid.sigma[i]) else default
            if math.isfinite(value):
                out[m, column] = value, sigma
                last = nodes[m]
    return out


def _nearest(times: Array, wanted: Array) -> NDArray[np.int64]:
    """Index of the time nearest to each wanted one."""
    after = np.clip(np.searchsorted(times, wanted), 1, max(len(times) - 1, 1))
    after = np.minimum(after, len(times) - 1)
    before = np.maximum(after - 1, 0)
    closer = np.abs(times[before] - wanted) < np.abs(times[after] - wanted)
    return np.where(closer, before, after).astype(np.int64)


def _zero_of(aid: AidLog, fixes: Fixes) -> float:
    """What brings a barometer's heights, of whatever zero, to those of the fixes, m."""
    good = np.isfinite(aid.value) & np.isfinite(aid.time)
    if not good.any():
        return 0.0
    height = np.interp(aid.time[good], fixes.time, fixes.p_geo[:, 2])
    return float(np.median(height - aid.value[good]))


def prior_state(layout: Layout, fixes: Fixes, start: float, aligned: Alignment, R: Array) -> tuple[
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
        if aligned.accel_bias is not None:
            x[3:6] = aligned.accel_bias
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


def filter_pass(
    imu: Array, fixes: Fixes, layout: Layout, settings: NavigationSettings,
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
        imu,
        (times, jump, fix),
        (
            np.array([layout.slow, layout.baro, layout.wind, 0]),
            np.stack([layout.density, layout.tau]),
        ),
        (
            np.stack([fixes.p_geo, fixes.v]),
            np.stack([fixes.R_p, fixes.R_v]),
            _aid_table(times, aids, fixes),
            np.asarray(settings.lever_arm_body_antenna, dtype=np.float64),
        ),
        gates,
        (prior[0].copy(), prior[1].copy(), prior[2].copy()),
        out,
        chi,
    )
    if reached < m:
        raise NavigationError(
            f"the filter lost the vehicle {times[reached] - times[0]:.1f} s after the start; check "
            "the axes and units of the IMU log and its clock against the GNSS log"
        )
    return out, chi, jump, gaps
