"""Units, axes and signs of the IMU, told by gravity, by turns and by an attitude log beside it.

At rest as in the mean of a flight the specific force is one g, upwards: that gives unit and
direction of the accelerometers. In turns the gyros have to say what the GNSS course says.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from georef_gis.frames import Array, R_ned_from_body, log_so3
from georef_gis.ingest.logs.turns import (
    FEWEST_WINDOWS,
    MOVING,
    TURNING,
    Turns,
    block_means,
    correlation,
    horizontal_velocity,
    turns_of,
)
from georef_gis.model.logs import AttitudeLog, FlightLogs, GnssLog, ImuLog

# m/s2; conventional value
STANDARD_GRAVITY = 9.80665
# Share of 1 g that the mean specific force of a flight has: turns add, bumpy samples too.
_LEAST, _MOST = 0.8, 1.35
# unit -> m/s2; mg and cm/s2 are told apart by the nearer one
_FORCE_UNITS = {"g": 9.80665, "mg": 9.80665e-3, "cm/s2": 0.01, "ft/s2": 0.3048}
# Correlation with the rate of course from which an axis is believed
_SURE, _SURE_OF_UNIT = 0.6, 0.8
# rad/s; no gyro of the trade measures more (2000 deg/s)
_FASTEST = 36.0
_AXES = "xyz"
# names of the directions of body axes, as the mapping of columns has them
_TOWARDS = (("forward", "back"), ("right", "left"), ("down", "up"))


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """What a check found: "error" = cannot be used, "doubt" = look at it."""

    severity: Literal["error", "doubt"]
    message: str


def check_sensors(logs: FlightLogs) -> tuple[Finding, ...]:
    """Everything that gravity, turns and attitude say about the IMU; () = nothing to say."""
    imu = logs.imu
    if imu is None or len(imu) < 10:
        return ()
    blocks = block_means(imu.time, imu.accel)
    gravity = np.median(blocks, axis=0)
    out = _force_unit(blocks)
    turns = None
    if logs.gnss is not None and logs.gnss.scale == imu.scale:
        turns = turns_of(imu, logs.gnss)
    down = _down_by_gravity(gravity)
    turned = None if turns is None else _axis_of_turns(turns)
    out += _gyro_unit(imu, turns, turned)
    right = None if turns is None else _right(turns, down)
    out += _axes(gravity, down, turned, right)
    if logs.attitude is not None and logs.attitude.scale == imu.scale and not out:
        out += _against_attitude(imu, logs.attitude)
    return tuple(out)


# --- accelerometers ---------------------------------------------------------------------------


def _force_unit(blocks: Array) -> list[Finding]:
    length = float(np.median(np.linalg.norm(blocks, axis=1)))
    share = length / STANDARD_GRAVITY
    if _LEAST <= share <= _MOST:
        return []
    shares = {unit: length * factor / STANDARD_GRAVITY for unit, factor in _FORCE_UNITS.items()}
    fitting = [unit for unit, s in shares.items() if _LEAST <= s <= _MOST]
    said = f"mean specific force is {length:.4g}, not 9.81 m/s2"
    # linear acceleration points everywhere, gravity keeps its direction in the body
    steady = float(np.linalg.norm(np.median(blocks, axis=0))) > 0.5 * length
    if fitting and steady:
        fitting.sort(key=lambda u: abs(math.log(shares[u])))
        return [
            Finding(
                severity="error",
                message=f"{said}: accelerometer in {' or '.join(fitting)}; state the unit, such as "
                f'accel_x = "ax:{fitting[0]}" in [logs.columns]',
            )
        ]
    if share < 0.1 or (not steady and share < _LEAST):
        return [
            Finding(
                severity="error",
                message=f"{said}: gravity was taken off (linear acceleration), or the column is "
                "none of an accelerometer; give the specific force",
            )
        ]
    return [
        Finding(
            severity="error" if share > 3.0 or share < 0.4 else "doubt",
            message=f"{said}: scale or unit of the accelerometer is doubtful; check it at rest",
        )
    ]


def _down_by_gravity(gravity: Array) -> tuple[int, int] | None:
    """Axis and sign that point down by the specific force, which points up; None if oblique."""
    length = float(np.linalg.norm(gravity))
    axis = int(np.argmax(np.abs(gravity)))
    if length == 0.0 or abs(gravity[axis]) < 0.8 * length:
        return None
    return axis, -1 if gravity[axis] > 0.0 else 1


# --- turns ------------------------------------------------------------------------------------


def _axis_of_turns(turns: Turns) -> tuple[int, int, float] | None:
    """Axis and sign of the gyro that turn with the course, and its scale; None if none does."""
    c = np.array([correlation(turns.gyro[:, k], turns.rate) for k in range(3)])
    axis = int(np.argmax(np.abs(c)))
    if abs(c[axis]) < _SURE:
        return None
    rate = turns.rate - np.mean(turns.rate)
    scale = float(np.sum(turns.gyro[:, axis] * rate) / np.sum(rate**2))
    # a vehicle that flies sideways turns its course without its body: no axis follows then
    plain = 0.3 < abs(scale) < 2.0
    if not plain and abs(c[axis]) < _SURE_OF_UNIT:
        return None
    return axis, 1 if scale > 0.0 else -1, abs(scale)


def _gyro_unit(
    imu: ImuLog, turns: Turns | None, turned: tuple[int, int, float] | None
) -> list[Finding]:
    """Degrees for radians and the other way, by the rate of course and by the largest rates."""
    cure = 'state the unit, such as gyro_x = "gx:{}" in [logs.columns]'
    if turns is not None and turned is not None:
        # a bank of 60 deg halves the rate about the body's down axis
        for unit, factor in (("deg/s", 180.0 / math.pi), ("rad/s", math.pi / 180.0)):
            if 0.4 < turned[2] / factor < 1.6:
                word = "degrees" if unit == "deg/s" else "radians read as degrees"
                return [
                    Finding(
                        severity="error",
                        message=f"gyro {_AXES[turned[0]]} turns {turned[2]:.3g} times as fast as "
                        f"the GNSS course: gyro in {word}; {cure.format(unit)}",
                    )
                ]
    high = float(np.quantile(np.abs(imu.gyro), 0.999))
    if high > _FASTEST:
        return [
            Finding(
                severity="error",
                message=f"gyro reaches {high:.4g} rad/s, no gyro measures that: in degrees; "
                f"{cure.format('deg/s')}",
            )
        ]
    return []


def _right(turns: Turns, down: tuple[int, int] | None) -> tuple[int, int] | None:
    """Axis and sign that point right: flat turns push there, banked turns pitch about it.

    A vehicle that turns flat feels v times the rate of course to the right. A banked one has
    q = rate of course times sin(bank), positive in turns to either side.
    """
    if down is None:
        return None
    level = [k for k in range(3) if k != down[0]]
    push = turns.speed * turns.rate
    force = turns.accel / max(1e-9, float(np.median(np.linalg.norm(turns.accel, axis=1))))
    c = {k: correlation(force[:, k], push) for k in level}
    axis = max(level, key=lambda k: abs(c[k]))
    other = next(k for k in level if k != axis)
    slope = float(np.sum(force[:, axis] * push) / np.sum(push**2)) * STANDARD_GRAVITY
    if abs(c[axis]) > 0.8 and abs(c[other]) < 0.5 and 0.5 < abs(slope) < 1.5:
        return axis, 1 if slope > 0.0 else -1
    strong = np.abs(turns.rate) > max(0.1, float(np.quantile(np.abs(turns.rate), 0.6)))
    if np.count_nonzero(strong) < 10:
        return None
    pitch = turns.gyro[strong]
    sure = np.abs(np.mean(pitch, axis=0)) / (np.std(pitch, axis=0) + 1e-12)
    share = np.mean(pitch, axis=0) / float(np.mean(np.abs(turns.gyro[strong, down[0]])) + 1e-12)
    axis = max(level, key=lambda k: abs(share[k]))
    other = next(k for k in level if k != axis)
    if abs(share[axis]) > 0.15 and sure[axis] > 0.7 and abs(share[other]) < abs(share[axis]) / 2:
        return axis, 1 if share[axis] > 0.0 else -1
    return None


# --- axes -------------------------------------------------------------------------------------


def _unit(axis: int, sign: int) -> Array:
    out = np.zeros(3)
    out[axis] = sign
    return out


def _axes(
    gravity: Array,
    down: tuple[int, int] | None,
    turned: tuple[int, int, float] | None,
    right: tuple[int, int] | None,
) -> list[Finding]:
    """Directions of the axes by gravity, by turns and by banks, against each other."""
    if down is None:
        away = math.degrees(math.acos(min(1.0, -gravity[2] / max(1e-9, np.linalg.norm(gravity)))))
        return [
            Finding(
                severity="doubt",
                message=f"mean specific force points {away:.0f} deg off the body's up axis and "
                "along none of the axes: state how the IMU is mounted",
            )
        ]
    by_turns = None if turned is None else (turned[0], turned[1])
    if by_turns is not None and by_turns != down:
        return [_disagree(down, by_turns)]
    if down == (2, 1):
        if right is None or right == (1, 1):
            return []
        words = _words(down, right)
        cause = "x and y are swapped or" if right[0] == 0 else "gyro y has the wrong sign, or"
        return [
            Finding(
                severity="doubt",
                message=f"turns say that {_signed(right)} points right: {cause} the IMU is turned "
                f"about its down axis; if so, axes = {words}",
            )
        ]
    words = _words(down, right)
    moving = by_turns is not None
    cause = "z points up" if down == (2, -1) else "axes are permuted or the IMU stands on its side"
    also = "" if moving else ", or if the gyros fit already, the signs of the accelerometers"
    return [
        Finding(
            severity="error" if moving or down == (2, -1) else "doubt",
            message=f"gravity lies along {_signed(down)}, not along +z (down): {cause}; set "
            f"axes = {words} in [logs.columns]{also}",
        )
    ]


def _disagree(down: tuple[int, int], turned: tuple[int, int]) -> Finding:
    """Accelerometers and gyros that do not have one set of axes."""
    if down == (2, 1):
        if turned[0] == 2:
            cause = "gyro z has the wrong sign"
            cure = 'gyro_z = "-gz"'
        else:
            cause = "gyro axes are permuted"
            cure = f'gyro_z = "{"-" if turned[1] < 0 else ""}g{_AXES[turned[0]]}"'
    elif turned == (2, 1):
        cause = "accelerometers have the wrong signs" if down[0] == 2 else "accelerometer axes are"
        cause += "" if down[0] == 2 else " permuted"
        cure = 'accel_x = "-ax", accel_y = "-ay", accel_z = "-az"'
        if down[0] != 2:
            cure = f'accel_z = "{"-" if down[1] < 0 else ""}a{_AXES[down[0]]}"'
    else:
        cause = "gyros and accelerometers have different axes"
        cure = "map each of the six columns to forward, right, down"
    return Finding(
        severity="error",
        message=f"gravity says that {_signed(down)} points down, turns against the GNSS course say "
        f"{_signed(turned)}: {cause}; set {cure} in [logs.columns]",
    )


def _signed(axis: tuple[int, int]) -> str:
    return f"{'+' if axis[1] > 0 else '-'}{_AXES[axis[0]]}"


def _words(down: tuple[int, int], right: tuple[int, int] | None) -> str:
    """Where x, y and z point, as the mapping has it; the likeliest where turns do not tell."""
    if right is not None and right[0] != down[0]:
        ways = [_unit(*right)]
    else:
        # most boards keep x forward when z is turned up, and y right when they stand
        level = [k for k in range(3) if k != down[0]]
        ways = [np.cross(_unit(*down), _unit(k, 1)) for k in level]
        ways = ways[:1] if level[0] == 0 else [_unit(1, 1)]
    d, r = _unit(*down), ways[0]
    R_body_from_sensor = np.stack([np.cross(r, d), r, d])
    names = []
    for column in R_body_from_sensor.T:
        k = int(np.argmax(np.abs(column)))
        names.append(_TOWARDS[k][0 if column[k] > 0 else 1])
    return f'"{"-".join(names)}"' + ("" if right is not None else " (or another turn about it)")


# --- attitude ---------------------------------------------------------------------------------


def _against_attitude(imu: ImuLog, attitude: AttitudeLog) -> list[Finding]:
    """Gyros against the rotation between rows of the attitude log, axis by axis."""
    at = attitude.time
    if len(at) < 20:
        return []
    step = np.diff(at)
    R = R_ned_from_body(*attitude.rpy.T)
    turn = log_so3(np.swapaxes(R[:-1], 1, 2) @ R[1:]) / np.maximum(step, 1e-6)[:, None]
    inside = (at[:-1] >= imu.time[0]) & (at[1:] <= imu.time[-1]) & (step > 1e-3) & (step < 0.5)
    if np.count_nonzero(inside) < 20:
        return []
    steps = np.diff(imu.time)[:, None] * (imu.gyro[1:] + imu.gyro[:-1]) / 2.0
    total = np.vstack([np.zeros(3), np.cumsum(steps, axis=0)])
    integral = np.column_stack([np.interp(at, imu.time, total[:, k]) for k in range(3)])
    gyro = (np.diff(integral, axis=0) / np.maximum(step, 1e-6)[:, None])[inside]
    turn = turn[inside]
    if np.max(np.std(turn, axis=0)) < TURNING:
        return []
    out = []
    for k in range(3):
        if float(np.std(turn[:, k])) < TURNING:
            continue
        c = np.array([correlation(gyro[:, j], turn[:, k]) for j in range(3)])
        best = int(np.argmax(np.abs(c)))
        if abs(c[best]) > 0.7 and (best != k or c[best] < 0.0) and c[k] < 0.3:
            found = _signed((best, 1 if c[best] > 0.0 else -1))
            out.append(
                Finding(
                    severity="doubt",
                    message=f"the attitude log turns about {_AXES[k]} as gyro {found} does: gyro "
                    "axes or signs differ from those of the attitude; check the mapping",
                )
            )
    return out


def unit_of_angles(log: AttitudeLog, gnss: GnssLog | None) -> tuple[float, str]:
    """Factor that makes the angles radians, and the doubt it goes with.

    Notes
    -----
    Pitch beyond 90 deg in over 1 % of the rows is no pitch in radians. Angles converted to
    radians twice keep yaw within 6.3 deg, which a course through all directions contradicts.
    """
    beyond = np.abs(log.rpy[:, 1]) > math.pi / 2 + 0.02
    if np.mean(beyond) > 0.01 and np.max(np.abs(log.rpy[:, 1])) <= 90.5:
        return math.pi / 180.0, "angles are degrees read as radians (pitch beyond 90): converted"
    narrow = float(np.max(np.abs(log.rpy[:, 2]))) < math.radians(360.0) * math.pi / 180.0
    if gnss is None or not narrow or gnss.scale != log.scale:
        return 1.0, ""
    time, velocity = horizontal_velocity(gnss)
    inside = (time > log.time[0]) & (time < log.time[-1])
    inside &= np.hypot(velocity[:, 0], velocity[:, 1]) > MOVING
    if np.count_nonzero(inside) < FEWEST_WINDOWS:
        return 1.0, ""
    course = np.arctan2(velocity[inside, 1], velocity[inside, 0])
    row = np.clip(np.searchsorted(log.time, time[inside]), 0, len(log) - 1)
    yaw = log.rpy[row, 2]
    as_is = abs(np.mean(np.exp(1j * (yaw - course))))
    turned = abs(np.mean(np.exp(1j * (yaw * 180.0 / math.pi - course))))
    if turned > 0.8 and as_is < 0.6:
        return 180.0 / math.pi, "angles are radians read as degrees (by the course): converted"
    return 1.0, ""
