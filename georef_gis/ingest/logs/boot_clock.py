"""From the clock of an autopilot (s since boot) to the GPS scale, by the fixes in its own log."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from georef_gis.frames import Array
from georef_gis.model.logs import FlightLogs, GnssLog, TimedLog
from georef_gis.units import GPS_ZERO, LEAP_SECONDS

BoolArray = NDArray[np.bool_]
Log = TypeVar("Log", bound=TimedLog)

# s since 1970-01-01 of the start of the GPS scale
_UNIX_OF_GPS_ZERO = GPS_ZERO.timestamp()
# s of GPS: February 1990. A receiver that states less has not found its time; a rolled-over week
# (19.6 years early) is left for the cleaning to name
EARLIEST_GPS = 320_000_000.0
# s: fixes this far from the common line have a wrong GPS time
_STEP = 0.5
# s/s: crystals of autopilots keep within this
_MOST_DRIFT = 5e-5
# s: shorter logs do not show a drift above the jitter of the stamps
_SPAN_FOR_DRIFT = 120.0
# s: jitter of the arrival that is worth a word
_JITTER_NAMED = 0.05
# of the fixes arrive later than the envelope
_ENVELOPE = 0.95


@dataclass(frozen=True, slots=True, kw_only=True)
class BootClock:
    """Line from boot time to GPS time.

    Parameters
    ----------
    boot, gps : s
        One instant on both scales.
    drift : s/s
        Rate of GPS time over boot time, less one.
    lag : s
        Median of the delay of a fix's stamp behind the earliest stamps.
    jitter : s
        1-sigma scatter of that delay, robust.
    usable
        Which fixes agree with the line.
    doubts
        Steps, drift and jitter in words.
    """

    boot: float
    gps: float
    drift: float
    lag: float
    jitter: float
    usable: tuple[bool, ...]
    doubts: tuple[str, ...] = ()

    def gps_of(self, boot: Array) -> Array:
        """GPS time, s, of boot times, s."""
        return self.gps + (boot - self.boot) * (1.0 + self.drift)


def gps_of_unix(unix: Array) -> Array:
    """Seconds on the GPS scale of UTC seconds since 1970 (without leap seconds), NaN kept."""
    steps = np.array([step.timestamp() for step in LEAP_SECONDS])
    leaps = np.searchsorted(steps, np.nan_to_num(unix), side="right")
    return np.asarray(unix - _UNIX_OF_GPS_ZERO + leaps)


def fit_boot_clock(arrival: Array, gps: Array) -> BootClock | None:
    """Line through pairs of boot stamp and GPS time; None below three usable pairs.

    Parameters
    ----------
    arrival : shape (n,), s
        When the autopilot noted the fix, on its own clock.
    gps : shape (n,), s
        Epoch that the fix states; NaN where it states none.

    Notes
    -----
    A stamp is never early: it follows its epoch by the receiver's computation, the serial line and
    the logger. So the line is the envelope of the earliest stamps (95 % of all lie later), which
    logger delays cannot move. What is left is the shortest delay of the receiver, one constant
    for IMU and events alike: the latency that the navigation finds by its innovation scan.
    A wrong GPS time (leap seconds not yet known, a clock not yet set) makes a group off the line.
    """
    known = np.isfinite(gps) & np.isfinite(arrival) & (gps > EARLIEST_GPS)
    if np.count_nonzero(known) < 3:
        return None
    middle = float(np.median(arrival[known]))
    ahead = gps - arrival
    base = float(np.median(ahead[known]))
    ahead = np.where(known, ahead - base, np.nan)
    span = float(np.ptp(arrival[known]))
    usable = _main_group(ahead, _STEP + _MOST_DRIFT * span)
    drift = 0.0
    for _ in range(3):
        drift = _drift(arrival[usable] - middle, ahead[usable])
        flat = ahead - drift * (arrival - middle)
        nearer = np.abs(flat - np.median(flat[usable])) < _STEP
        usable = nearer if np.count_nonzero(nearer) >= 3 else usable
    flat = ahead - drift * (arrival - middle)
    envelope = float(np.quantile(flat[usable], _ENVELOPE))
    lag = envelope - flat[usable]
    typical = float(np.median(lag))
    jitter = 1.4826 * float(np.median(np.abs(lag - typical)))
    doubts = (
        *_steps(arrival, flat - envelope + typical, known & ~usable),
        *_quality(drift, jitter, float(np.max(lag))),
    )
    return BootClock(
        boot=middle,
        gps=middle + base + envelope,
        drift=drift,
        lag=typical,
        jitter=jitter,
        usable=tuple(bool(u) for u in usable),
        doubts=doubts,
    )


def _main_group(ahead: Array, width: float) -> BoolArray:
    """Rows within the window of a width, s, that holds the most."""
    order = np.sort(ahead[np.isfinite(ahead)])
    last = np.searchsorted(order, order + width, side="right")
    first = int(np.argmax(last - np.arange(len(order))))
    with np.errstate(invalid="ignore"):
        return np.asarray((ahead >= order[first]) & (ahead <= order[first] + width))


def _drift(at: Array, ahead: Array) -> float:
    """Slope of the envelope: a robust line through the 90 % quantiles of bins."""
    span = float(np.ptp(at))
    if span < _SPAN_FOR_DRIFT:
        return 0.0
    edges = np.linspace(at.min(), at.max(), min(60, max(6, int(span / 20.0))) + 1)
    which = np.clip(np.searchsorted(edges, at, side="right") - 1, 0, len(edges) - 2)
    bins = [ahead[which == k] for k in range(len(edges) - 1)]
    centres = [float(np.mean(at[which == k])) for k, held in enumerate(bins) if len(held) >= 3]
    levels = [float(np.quantile(held, 0.9)) for held in bins if len(held) >= 3]
    if len(levels) < 4:
        return 0.0
    x, y = np.array(centres), np.array(levels)
    # Theil-Sen: the median of all slopes bears a quarter of bad bins (Sen 1968).
    i, j = np.triu_indices(len(x), 1)
    return float(np.median((y[j] - y[i]) / (x[j] - x[i])))


def _steps(arrival: Array, off: Array, wrong: BoolArray) -> tuple[str, ...]:
    rows = np.flatnonzero(wrong)
    if not len(rows):
        return ()
    groups = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)
    largest = max(groups, key=len)
    return (
        f"GPS time of {len(rows)} fixes is off the autopilot's clock in {len(groups)} place(s), "
        f"first {arrival[rows[0]]:.1f} s after boot, by {np.median(off[largest]):+.3f} s in the "
        "longest: their time is taken from the autopilot's clock",
    )


def _quality(drift: float, jitter: float, worst: float) -> tuple[str, ...]:
    out = []
    if abs(drift) > _MOST_DRIFT:
        out.append(
            f"the autopilot's clock drifts by {drift * 1e6:+.0f} ppm against GPS: more than a "
            "crystal should; it is followed"
        )
    if jitter > _JITTER_NAMED or worst > _STEP:
        out.append(
            f"stamps of fixes scatter by {jitter * 1e3:.0f} ms (worst {worst * 1e3:.0f} ms) behind "
            "their epochs: the clock is fitted to the earliest stamps"
        )
    return tuple(out)


def on_gps_scale(logs: FlightLogs, gps: Array) -> FlightLogs:
    """Logs of one boot clock brought to the GPS scale, by the epochs that the fixes state.

    Parameters
    ----------
    logs
        All parts on scale "boot"; fixes stamped at their arrival.
    gps : shape (fixes,), s
        Epochs that the fixes state, NaN where none.

    Returns
    -------
    logs
        Still on scale "boot", and said so, where no three fixes state a time.
    """
    gnss = logs.gnss
    clock = None if gnss is None else fit_boot_clock(gnss.time, gps)
    if gnss is None or clock is None:
        doubt = "no fix states a GPS time: all times are seconds since the boot of the logger"
        return replace(logs, doubts=(*logs.doubts, doubt))
    return replace(
        logs,
        imu=None if logs.imu is None else _mapped(logs.imu, clock),
        gnss=_gnss_on_gps_scale(gnss, gps, clock),
        attitude=None if logs.attitude is None else _mapped(logs.attitude, clock),
        events=tuple(_mapped(log, clock) for log in logs.events),
        aids=tuple(_mapped(log, clock) for log in logs.aids),
        doubts=(*logs.doubts, *clock.doubts),
    )


def _mapped(log: Log, clock: BootClock) -> Log:
    return replace(log, time=clock.gps_of(log.time), scale="gps")


def _gnss_on_gps_scale(gnss: GnssLog, gps: Array, clock: BootClock) -> GnssLog:
    """Epochs where the receiver states them, else the arrival less its usual lag."""
    arrived = clock.gps_of(gnss.time) - clock.lag
    return replace(gnss, time=np.where(np.array(clock.usable), gps, arrived), scale="gps")
