"""The 9-state GPS/INS filter of the 2009 WVU report (section 4), and a smoother behind it.

State: position and velocity in a local level plane (north, east, down; m, m/s) and roll, pitch,
yaw (rad). Input: specific force and angular rate of the body (forward, right, down). Forward
Euler steps, no biases, no Earth rate, no lever arm, no delay, no gate: as published.

Where the code differs from the print (equation numbers of the report):

- (20), (22), (24): printed with z up (`V_z + g`); here z is down, so gravity enters with `+ g`.
- (28), row 9, column 7: the printed entry lacks `sec(theta)`.
- (31): printed `V = H` (6 x 9) cannot multiply a 6 x 6 R in (34); it is the identity.
- (29): `W = I` puts Q on the states; the noise of the sensors is mapped to them here.

Besides, a fix between two samples splits the step, and (36) is kept symmetric.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from georef_gis.errors import InputError, NavigationError
from georef_gis.frames import Array, covariance_theta_ned_from_rpy
from georef_gis.model.logs import GnssLog, ImuLog, IntArray, TrajectoryLog
from georef_gis.navigate.ekf9_inputs import (
    Ekf9Settings,
    Fixes,
    Plane,
    first_moving,
    first_state,
    usable_fixes,
    usable_samples,
)
from georef_gis.navigate.ekf9_model import filter_grid, jacobian, smooth_nodes, transition
from georef_gis.navigate.inertial import gravity as normal_gravity

__all__ = [
    "Ekf9Result",
    "Ekf9Settings",
    "Ekf9States",
    "jacobian",
    "run_ekf9",
    "trajectory_of_ekf9",
    "transition",
]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ekf9States:
    """States at the times of the IMU; `n` rows.

    Parameters
    ----------
    time : s, of the logs' scale
    lat, lon, height : rad, rad, ellipsoidal m
    v_ned, rpy : shape (n, 3), m/s and rad, yaw within [-pi, pi)
    variance : shape (n, 9), of north, east, down, v_ned, roll, pitch, yaw; m, m/s, rad squared
    """

    time: Array
    lat: Array
    lon: Array
    height: Array
    v_ned: Array
    rpy: Array
    variance: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ekf9Result:
    """What the filter found.

    Parameters
    ----------
    filtered, smoothed
        States; `smoothed` is None where it was not asked for.
    fix_time, innovation, innovation_sigma, nis
        Of the fixes used: s, (f, 6) m and m/s (NaN without velocity), the same, (f,).
    fix_dof
        Number of values of each fix, 3 or 6: the expected `nis`.
    doubts
        What is doubtful, in words.
    """

    filtered: Ekf9States
    smoothed: Ekf9States | None
    fix_time: Array
    innovation: Array
    innovation_sigma: Array
    nis: Array
    fix_dof: IntArray
    scale: Literal["gps", "boot"]
    source: str
    doubts: tuple[str, ...]


def run_ekf9(imu: ImuLog, gnss: GnssLog, settings: Ekf9Settings | None = None) -> Ekf9Result:
    """Run the report's filter, and the smoother if asked for, from the first fix in motion.

    The position is that of the antenna: the filter knows no lever arm.

    Raises
    ------
    InputError
        If a log cannot be what it claims: units, axes, time scales, unknown kind of height.
    NavigationError
        If the logs do not overlap, nothing moves, samples are missing or pitch gets vertical.
    """
    settings = settings or Ekf9Settings()
    if imu.scale != gnss.scale:
        raise InputError(
            f"times are on the {imu.scale} scale, those of the fixes on {gnss.scale}; "
            "give both logs one clock",
            source=imu.source,
        )
    doubts = [*imu.doubts, *gnss.doubts]
    time, u = usable_samples(imu, doubts)
    fixes = usable_fixes(gnss, settings, (time[0], time[-1]), doubts)
    first = first_moving(fixes, settings, gnss.source)
    fixes = fixes.since(first)
    plane = Plane.at(float(fixes.lat[0]), float(fixes.lon[0]), float(fixes.height[0]))
    gravity = settings.gravity
    if gravity is None:
        gravity = float(normal_gravity(plane.lat, plane.height))
    z = np.hstack([plane.ned(fixes.lat, fixes.lon, fixes.height), fixes.v_ned])
    x0, P0 = first_state(time, u, fixes, (settings, gravity))
    x0[:6] = z[0]
    grid = _Grid.over(time, fixes.time, settings)
    _refuse_gaps(grid.time[grid.is_sample], settings, imu.source)
    q = np.array([settings.position_noise, settings.velocity_noise, settings.attitude_noise, 1.0])
    q = np.square(q)
    q[3] = float(settings.noise == "sensors")
    steps = (grid.time - grid.time[0], grid.held, grid.fix, grid.node)
    filtered = filter_grid(
        steps, u, (z, fixes.R, fixes.dof), (x0, P0), (q, gravity), int(grid.node.max()) + 1
    )
    stop, states, variance, node_x, node_P, node_A, innovation, sigma, nis = filtered
    if stop >= 0:
        raise NavigationError(
            f"{imu.source or 'imu'}: pitch passed 89 deg at {grid.time[stop]:.2f} s, where the "
            "Euler angles of the 9-state filter end; use the 15-state filter"
        )
    _doubt_fixes(fixes, nis, doubts)
    keep = grid.is_sample
    smoothed = None
    if settings.smooth:
        smooth = _between_nodes(grid, states, node_x, smooth_nodes(node_x, node_P, node_A))
        smoothed = _states(grid.time[keep], smooth[0][keep], smooth[1][keep], plane)
    return Ekf9Result(
        filtered=_states(grid.time[keep], states[keep], variance[keep], plane),
        smoothed=smoothed, fix_time=fixes.time, innovation=innovation, innovation_sigma=sigma,
        nis=nis, fix_dof=fixes.dof, scale=imu.scale, source=imu.source, doubts=tuple(doubts),
    )  # fmt: skip


def trajectory_of_ekf9(result: Ekf9Result, *, smoothed: bool | None = None) -> TrajectoryLog:
    """Trajectory of the antenna; smoothed where that is there and not declined.

    Its covariance holds the variances of position and of the Euler angles, turned into those of a
    rotation in ned; what couples them is left out.
    """
    states = result.filtered
    if smoothed or (smoothed is None and result.smoothed is not None):
        if result.smoothed is None:
            raise NavigationError("the 9-state filter ran without its smoother; set smooth = true")
        states = result.smoothed
    covariance = np.zeros((len(states.time), 6, 6))
    covariance[:, range(3), range(3)] = states.variance[:, :3]
    covariance[:, 3:, 3:] = covariance_theta_ned_from_rpy(
        states.rpy, np.sqrt(states.variance[:, 6:])
    )
    return TrajectoryLog(
        time=states.time, scale=result.scale, source=result.source, doubts=result.doubts,
        lat=states.lat, lon=states.lon, height=states.height, v_ned=states.v_ned,
        rpy=states.rpy, covariance=covariance, position_of="antenna",
    )  # fmt: skip


class _Grid(NamedTuple):
    """Times of samples and fixes together."""

    time: Array
    is_sample: NDArray[np.bool_]
    # row of the input held until each time; fix and node at each time, else -1
    held: IntArray
    fix: IntArray
    node: IntArray

    @classmethod
    def over(cls, samples: Array, fixes: Array, settings: Ekf9Settings) -> _Grid:
        """Grid from the first fix to the last sample; the first state stands at the first fix."""
        after = samples[samples >= fixes[0]]
        time = np.union1d(after, fixes)
        held = np.maximum(np.searchsorted(samples, time, side="left") - 1, 0)
        fix = np.full(len(time), -1, dtype=np.int64)
        # The first fix is the start itself: to use it twice would halve its variance.
        fix[np.searchsorted(time, fixes[1:])] = np.arange(1, len(fixes))
        is_sample = np.isin(time, after)
        slot = np.floor((time - time[0]) / settings.node_step + 1e-6)
        is_node = (fix >= 0) | (np.diff(slot, prepend=-1.0) > 0)
        is_node[-1] = True
        node = np.where(is_node, np.cumsum(is_node) - 1, -1)
        return cls(time, is_sample, held, fix, node)


def _refuse_gaps(time: Array, settings: Ekf9Settings, source: str) -> None:
    gap = np.diff(time)
    if len(gap) and gap.max() > settings.max_gap:
        raise NavigationError(
            f"{source or 'imu'}: no samples for {gap.max():.2f} s after {time[gap.argmax()]:.2f} "
            f"s (at most {settings.max_gap:g} s); give a log without gaps or one per part"
        )


def _doubt_fixes(fixes: Fixes, nis: Array, doubts: list[str]) -> None:
    """Name fixes that the filter took though they are far from it: it has no gate."""
    # A chi-square of 6 exceeds 40 once in 2 million.
    far = np.flatnonzero(nis > 40.0)
    if len(far):
        worst = far[np.argmax(nis[far])]
        doubts.append(
            f"{len(far)} of {len(nis)} fixes disagree with the filter (worst at "
            f"{fixes.time[worst]:.1f} s, NIS {nis[worst]:.0f}); the 9-state filter has no gate and "
            "took them: raise its noise or use the 15-state filter"
        )


def _between_nodes(
    grid: _Grid, states: Array, node_x: Array, smoothed: tuple[Array, Array]
) -> tuple[Array, Array]:
    """Smoothed states and variances at every time of the grid.

    The correction of the filter runs straight from one node after its update to the next before
    its own: so nothing jumps at a fix.
    """
    xs, variance = smoothed
    at = np.flatnonzero(grid.node >= 0)
    left = np.clip(np.searchsorted(at, np.arange(len(grid.time)), side="right") - 1, 0, None)
    right = np.minimum(left + 1, len(at) - 1)
    span = grid.time[at[right]] - grid.time[at[left]]
    part = (grid.time - grid.time[at[left]]) / np.where(span > 0.0, span, 1.0)
    part = part[:, None]
    begin, end = xs[left] - node_x[left, 1], xs[right] - node_x[right, 0]
    corrected = states + (1.0 - part) * begin + part * end
    return corrected, (1.0 - part) * variance[left] + part * variance[right]


def _states(time: Array, x: Array, variance: Array, plane: Plane) -> Ekf9States:
    lat, lon, height = plane.geo(x[:, :3])
    rpy = np.mod(x[:, 6:] + np.pi, 2.0 * np.pi) - np.pi
    return Ekf9States(
        time=time, lat=lat, lon=lon, height=height, v_ned=x[:, 3:6], rpy=rpy, variance=variance
    )
