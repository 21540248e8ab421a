"""Two trajectories side by side: differences, their statistics, and whether the sigmas hold.

The one with fewer rows a second sets the times; the other is interpolated to them. Differences
are estimate minus reference, and the reference is taken as the truth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from georef_gis.errors import InputError, NavigationError
from georef_gis.frames import Array, R_ned_from_body, exp_so3, log_so3, rpy_from_R_ned_from_body
from georef_gis.model.logs import TrajectoryLog, unknown
from georef_gis.model.trajectory_values import metres_per_radian, sigma_rpy_of
from georef_gis.navigate.clock_shift import find_shift
from georef_gis.navigate.resample import at_times, in_order, rows, transposed

# s over which the course is averaged before its rate is taken
_COURSE_WINDOW = 2.0
PARTS = ("all", "straight", "turns")


@dataclass(frozen=True, slots=True, kw_only=True)
class CompareSettings:
    """How to compare.

    Parameters
    ----------
    lever_arm
        From the place of the estimate to that of the reference, body axes, m.
    remove_rotation
        Whether to take off the constant rotation between the two bodies (a mount), and say it.
    remove_offset
        Whether to take off the constant offset of position in ned (a datum), and say it.
    turn_rate
        rad/s of the course from which a row belongs to a turn.
    shift_window
        s, largest time shift to look for.
    """

    lever_arm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    remove_rotation: bool = False
    remove_offset: bool = False
    turn_rate: float = math.radians(3.0)
    shift_window: float = 2.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Comparison:
    """Differences, estimate minus reference, at `n` common times; NaN where one has no value.

    Parameters
    ----------
    time : s, of the reference's clock
    position, velocity, rpy : shape (n, 3), ned m, ned m/s, and roll, pitch, yaw rad (wrapped)
    sigma_position, sigma_rpy : shape (n, 3), of the estimate, m and rad
    nees_position, nees_attitude : shape (n,), of three values each
    turning : shape (n,), whether the row belongs to a turn
    estimate, reference : both at the common times, as compared
    time_shift, sigma_time_shift
        s added to the estimate's times, and its sigma (NaN where given).
    time_shift_from
        "given", or the quantity by which it was estimated.
    rotation, offset
        What was removed: rotation vector of the reference's body in the estimate's, rad; ned, m.
    """

    time: Array
    position: Array
    velocity: Array
    rpy: Array
    sigma_position: Array
    sigma_rpy: Array
    nees_position: Array
    nees_attitude: Array
    turning: NDArray[np.bool_]
    estimate: TrajectoryLog
    reference: TrajectoryLog
    time_shift: float
    sigma_time_shift: float
    time_shift_from: str
    rotation: Array
    offset: Array
    doubts: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """Statistics of one quantity over one part of the flight; m, m/s or deg.

    `ratio` is the rms of error/sigma, NaN where the estimate states no sigma.
    """

    part: Literal["all", "straight", "turns"]
    quantity: str
    unit: str
    count: int
    rms: float
    mean: float
    sd: float
    largest: float
    ratio: float


def compare_trajectories(
    estimate: TrajectoryLog,
    reference: TrajectoryLog,
    *,
    time_shift: float | None = 0.0,
    settings: CompareSettings | None = None,
) -> Comparison:
    """Compare over the common span.

    Parameters
    ----------
    time_shift
        s to add to the estimate's times; None: estimated, within the settings' window.

    Raises
    ------
    InputError
        If the two are on different time scales, or one is too short.
    NavigationError
        If they have no time or no quantity in common.
    """
    settings = settings or CompareSettings()
    if estimate.scale != reference.scale and not time_shift:
        raise InputError(
            f"times are on the {estimate.scale} scale, those of the reference on the "
            f"{reference.scale} scale; give the time shift between them",
            source=estimate.source,
        )
    estimate, reference = _usable(estimate), _usable(reference)
    sigma_shift, source = math.nan, "given"
    if time_shift is None:
        time_shift, sigma_shift, source = find_shift(estimate, reference, settings.shift_window)
    moved = replace(estimate, time=estimate.time + time_shift, scale=reference.scale)
    first, second = _at_common_times(moved, reference)
    first = _moved_by_lever_arm(first, settings)
    first, rotation = _without_rotation(first, second, settings)
    position, velocity, rpy, dtheta = _differences(first, second)
    if not (np.any(np.isfinite(position)) or np.any(np.isfinite(rpy))):
        raise NavigationError(
            f"{estimate.source or 'estimate'} and {reference.source or 'reference'} have neither "
            "positions nor attitudes in common; compare logs of one kind"
        )
    offset = np.zeros(3)
    if settings.remove_offset and np.any(np.isfinite(position)):
        offset = np.nanmean(position, axis=0)
        position = position - offset
    doubts = list(dict.fromkeys([*estimate.doubts, *reference.doubts]))
    if source != "given" and abs(time_shift) > 0.98 * settings.shift_window:
        doubts.append(f"the time shift of {time_shift:.2f} s lies at the edge of what was searched")
    return Comparison(
        time=first.time, position=position, velocity=velocity, rpy=rpy,
        sigma_position=np.sqrt(np.diagonal(first.covariance, axis1=1, axis2=2)[:, :3]),
        sigma_rpy=sigma_rpy_of(first),
        nees_position=_nees(position, first.covariance[:, :3, :3]),
        nees_attitude=_nees(dtheta, first.covariance[:, 3:, 3:]),
        turning=_turning(second if np.any(np.isfinite(second.lat)) else first, settings.turn_rate),
        estimate=first, reference=second, time_shift=time_shift, sigma_time_shift=sigma_shift,
        time_shift_from=source, rotation=rotation, offset=offset, doubts=tuple(doubts),
    )  # fmt: skip


def statistics(comparison: Comparison) -> tuple[Row, ...]:
    """Rms, mean, standard deviation and largest of every quantity, over all and by parts."""
    found = []
    for part in PARTS:
        keep = {"all": np.full(len(comparison.time), True), "turns": comparison.turning}.get(
            part, ~comparison.turning
        )
        for name, unit, values, sigma in _quantities(comparison):
            row = _row((part, name, unit), values[keep], sigma[keep])
            if row is not None:
                found.append(row)
    return tuple(found)


def text_table(found: tuple[Row, ...]) -> tuple[str, ...]:
    """The statistics as lines of text."""
    head = f"{'part':9s}{'quantity':13s}{'unit':5s}{'rows':>8s}{'rms':>10s}{'mean':>10s}"
    lines = [f"{head}{'sd':>10s}{'largest':>10s}{'err/sigma':>11s}"]
    for row in found:
        ratio = f"{row.ratio:11.2f}" if math.isfinite(row.ratio) else f"{'-':>11s}"
        lines.append(
            f"{row.part:9s}{row.quantity:13s}{row.unit:5s}{row.count:8d}{row.rms:10.4f}"
            f"{row.mean:10.4f}{row.sd:10.4f}{row.largest:10.4f}{ratio}"
        )
    return tuple(lines)


def summary(comparison: Comparison) -> dict[str, Any]:
    """JSON-able account of the comparison, with the statistics; None stands for unknown."""
    table = [
        {key: _plain(getattr(row, key)) for key in Row.__dataclass_fields__}
        for row in statistics(comparison)
    ]
    return {
        "estimate": comparison.estimate.source,
        "reference": comparison.reference.source,
        "from_s": float(comparison.time[0]),
        "to_s": float(comparison.time[-1]),
        "rows": len(comparison.time),
        "rows_in_turns": int(np.sum(comparison.turning)),
        "time_shift_s": comparison.time_shift,
        "sigma_time_shift_s": _plain(comparison.sigma_time_shift),
        "time_shift_from": comparison.time_shift_from,
        "removed_rotation_deg": [float(v) for v in np.degrees(comparison.rotation)],
        "removed_offset_ned_m": [float(v) for v in comparison.offset],
        "nees_position_over_3": _mean_over_3(comparison.nees_position),
        "nees_attitude_over_3": _mean_over_3(comparison.nees_attitude),
        "statistics": table,
        "doubts": list(comparison.doubts),
    }


def _plain(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _mean_over_3(nees: Array) -> float | None:
    known = nees[np.isfinite(nees)]
    return float(np.mean(known)) / 3.0 if len(known) else None


def _usable(log: TrajectoryLog) -> TrajectoryLog:
    """Rows in order of time that hold a position or an attitude."""
    ordered = in_order(log)
    place = np.isfinite(ordered.lat) & np.isfinite(ordered.lon) & np.isfinite(ordered.height)
    ordered = rows(ordered, place | np.all(np.isfinite(ordered.rpy), axis=1))
    if len(ordered) < 2:
        raise InputError(
            f"{len(ordered)} of {len(log)} rows can be used; give a trajectory of two or more",
            source=log.source,
        )
    return ordered


def _at_common_times(
    first: TrajectoryLog, second: TrajectoryLog
) -> tuple[TrajectoryLog, TrajectoryLog]:
    begin = max(first.time[0], second.time[0])
    end = min(first.time[-1], second.time[-1])
    coarse = max(first, second, key=lambda log: float(np.median(np.diff(log.time))))
    time = coarse.time[(coarse.time >= begin) & (coarse.time <= end)]
    if len(time) < 2:
        raise NavigationError(
            f"{first.source or 'estimate'} ({first.time[0]:.1f} to {first.time[-1]:.1f} s) and "
            f"{second.source or 'reference'} ({second.time[0]:.1f} to {second.time[-1]:.1f} s) "
            "have no span in common; give logs of one flight or the time shift"
        )
    return at_times(first, time), at_times(second, time)


def _moved_by_lever_arm(log: TrajectoryLog, settings: CompareSettings) -> TrajectoryLog:
    """The estimate at the reference's place."""
    if not any(settings.lever_arm):
        return log
    if not np.any(np.isfinite(log.rpy)):
        raise NavigationError(
            f"{log.source or 'estimate'}: holds no attitude to turn the lever arm by; leave it out"
        )
    arm = R_ned_from_body(*log.rpy.T) @ np.asarray(settings.lever_arm, dtype=np.float64)
    north, east = metres_per_radian(log.lat, log.height)
    return replace(
        log,
        lat=log.lat + arm[:, 0] / north,
        lon=log.lon + arm[:, 1] / east,
        height=log.height - arm[:, 2],
        v_ned=log.v_ned + np.gradient(arm, log.time, axis=0),
    )


def _without_rotation(
    first: TrajectoryLog, second: TrajectoryLog, settings: CompareSettings
) -> tuple[TrajectoryLog, Array]:
    """The estimate in the reference's body axes, and the mean rotation between the two, rad."""
    known = np.all(np.isfinite(first.rpy) & np.isfinite(second.rpy), axis=1)
    if not (settings.remove_rotation and np.any(known)):
        return first, np.zeros(3)
    R, wanted = R_ned_from_body(*first.rpy.T), R_ned_from_body(*second.rpy[known].T)
    mount = np.eye(3)
    for _ in range(4):
        left = log_so3(transposed(R[known] @ mount) @ wanted)
        mount = mount @ exp_so3(left.mean(axis=0))
    return replace(first, rpy=rpy_from_R_ned_from_body(R @ mount)), log_so3(mount)


def _differences(first: TrajectoryLog, second: TrajectoryLog) -> tuple[Array, Array, Array, Array]:
    """Position, velocity, wrapped angles, and the rotation in ned; (n, 3) each."""
    north, east = metres_per_radian(second.lat, second.height)
    position = np.stack(
        [
            (first.lat - second.lat) * north,
            _wrapped(first.lon - second.lon) * east,
            second.height - first.height,
        ],
        axis=-1,
    )
    # A row of unknown attitude must not reach the quaternions.
    known = np.all(np.isfinite(first.rpy) & np.isfinite(second.rpy), axis=1)
    dtheta = unknown(len(first), 3)
    R = R_ned_from_body(*second.rpy[known].T)
    dtheta[known] = log_so3(R @ transposed(R_ned_from_body(*first.rpy[known].T)))
    return position, first.v_ned - second.v_ned, _wrapped(first.rpy - second.rpy), dtheta


def _wrapped(angle: Array) -> Array:
    return np.asarray(np.mod(angle + np.pi, 2.0 * np.pi) - np.pi)


def _nees(error: Array, covariance: Array) -> Array:
    """Normalised error squared, of three values; NaN where the covariance is unknown."""
    out = unknown(len(error))
    known = np.all(np.isfinite(covariance), axis=(1, 2)) & np.all(np.isfinite(error), axis=1)
    known[known] = np.linalg.det(covariance[known]) > 0.0
    e = error[known]
    out[known] = np.sum(e * np.linalg.solve(covariance[known], e[..., None])[..., 0], axis=1)
    return out


def _turning(log: TrajectoryLog, rate: float) -> NDArray[np.bool_]:
    """Whether the course turns faster than `rate`; the heading where there is no path."""
    v = log.v_ned[:, :2]
    if not np.any(np.isfinite(v)) and np.any(np.isfinite(log.lat)):
        north, east = metres_per_radian(log.lat, log.height)
        path = np.stack([log.lat, np.unwrap(_filled(log.lon, log.time))], axis=-1)
        v = np.gradient(path, log.time, axis=0) * np.stack([north, east], axis=-1)
    if np.any(np.isfinite(v)):
        v = _averaged(v, log.time)
        a = np.gradient(v, log.time, axis=0)
        turn = (v[:, 0] * a[:, 1] - v[:, 1] * a[:, 0]) / np.maximum(np.sum(v**2, axis=1), 1.0)
    else:
        yaw = np.unwrap(_filled(log.rpy[:, 2], log.time))
        turn = np.gradient(_averaged(yaw[:, None], log.time)[:, 0], log.time)
    return np.asarray(np.abs(turn) > rate)


def _filled(values: Array, time: Array) -> Array:
    known = np.isfinite(values)
    return np.interp(time, time[known], values[known])


def _averaged(values: Array, time: Array) -> Array:
    """Columns without holes, averaged over the window."""
    half = round(0.5 * _COURSE_WINDOW / float(np.median(np.diff(time))))
    half = min(half, (len(time) - 1) // 2)
    columns = []
    for column in values.T:
        padded = np.pad(_filled(column, time), half, mode="edge")
        columns.append(np.convolve(padded, np.full(2 * half + 1, 1 / (2 * half + 1)), "valid"))
    return np.stack(columns, axis=-1)


def _quantities(one: Comparison) -> list[tuple[str, str, Array, Array]]:
    """Name, unit, values and sigmas of what the table lists."""
    none = unknown(len(one.time))
    out = []
    for i, name in enumerate(("north", "east", "down")):
        out.append((name, "m", one.position[:, i], one.sigma_position[:, i]))
    out.append(("horizontal", "m", np.hypot(one.position[:, 0], one.position[:, 1]), none))
    out.append(("3d", "m", np.linalg.norm(one.position, axis=1), none))
    for i, name in enumerate(("v_north", "v_east", "v_down")):
        out.append((name, "m/s", one.velocity[:, i], none))
    for i, name in enumerate(("roll", "pitch", "yaw")):
        out.append((name, "deg", np.degrees(one.rpy[:, i]), np.degrees(one.sigma_rpy[:, i])))
    return out


def _row(names: tuple[Any, str, str], values: Array, sigma: Array) -> Row | None:
    known = np.isfinite(values)
    x = values[known]
    if not len(x):
        return None
    stated = np.isfinite(sigma[known]) & (sigma[known] > 0.0)
    ratio = math.nan
    if np.any(stated):
        ratio = float(np.sqrt(np.mean((x[stated] / sigma[known][stated]) ** 2)))
    return Row(
        part=names[0], quantity=names[1], unit=names[2], count=len(x),
        rms=float(np.sqrt(np.mean(x**2))), mean=float(np.mean(x)), sd=float(np.std(x)),
        largest=float(x[np.argmax(np.abs(x))]), ratio=ratio,
    )  # fmt: skip
