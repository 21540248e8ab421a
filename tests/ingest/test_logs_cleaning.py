"""Cleaning of logs: each planted fault is named, and sound logs pass without a word."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import log_cases
import numpy as np
import pytest

from georef_gis.errors import GeorefError, InputError, NavigationError
from georef_gis.frames import R_ned_from_body, log_so3
from georef_gis.ingest.logs.cleaning import clean_logs
from georef_gis.ingest.logs.gnss_values import take
from georef_gis.ingest.logs.sensor_checks import check_sensors
from georef_gis.model.logs import AidLog, AttitudeLog, EventLog, FlightLogs, ImuLog, unknown
from georef_gis.units import GPS_WEEK, gps_from_week


@pytest.fixture(scope="session")
def flight() -> FlightLogs:
    return log_cases.simulated()


def words(logs: FlightLogs) -> str:
    parts = [logs.imu, logs.gnss, logs.attitude, *logs.events, *logs.aids]
    return " | ".join([*logs.doubts, *(d for p in parts if p is not None for d in p.doubts)])


def with_imu(logs: FlightLogs, **changes: object) -> FlightLogs:
    assert logs.imu is not None
    return replace(logs, imu=replace(logs.imu, **changes))


def with_gnss(logs: FlightLogs, **changes: object) -> FlightLogs:
    assert logs.gnss is not None
    return replace(logs, gnss=replace(logs.gnss, **changes))


# --- sound logs -------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(4))
def test_simulated_flights_pass_without_a_word(seed: int) -> None:
    logs = log_cases.simulated(seed)
    cleaned = clean_logs(logs)
    assert words(cleaned) == ""
    for before, after in ((logs.imu, cleaned.imu), (logs.gnss, cleaned.gnss)):
        assert before is not None
        assert after is not None
        assert np.array_equal(before.time, after.time)


def test_real_fixed_wing_passes_but_for_its_placeholders(data: Path) -> None:
    cleaned = clean_logs(log_cases.thor75(data))
    assert words(cleaned) == (
        "1 row(s) left out: all six IMU values are exactly zero, first row 1 | "
        "1 row(s) left out: constant position before the first fix, first row 1"
    )
    assert cleaned.gnss is not None
    assert np.degrees(cleaned.gnss.lat).min() > 45.1
    assert cleaned.attitude is not None
    assert np.abs(cleaned.attitude.rpy[:, 2]).max() <= math.pi  # psi of the log is unwrapped


def test_real_car_passes_without_a_word(data: Path) -> None:
    assert words(clean_logs(log_cases.drive_0708(data))) == ""


def test_real_car_without_its_mount_is_told_how_the_imu_lies(data: Path) -> None:
    # README of the set: mount roll 180, yaw 185 deg, so x points back, y right, z up
    with pytest.raises(InputError, match="back-right-up"):
        clean_logs(log_cases.drive_0708(data, mounted=False))


# --- axes and units, planted on simulated and real logs ---------------------------------------

Change = Callable[[ImuLog], ImuLog]


def turned(*rows: tuple[int, int, int]) -> Change:
    """IMU whose axes point elsewhere: rows are sensor axes in body axes."""
    R = np.array(rows, dtype=float)
    return lambda imu: replace(imu, gyro=imu.gyro @ R.T, accel=imu.accel @ R.T)


def scaled(gyro: float = 1.0, accel: float = 1.0) -> Change:
    return lambda imu: replace(imu, gyro=imu.gyro * gyro, accel=imu.accel * accel)


def signs(gyro: tuple[int, int, int], accel: tuple[int, int, int] = (1, 1, 1)) -> Change:
    return lambda imu: replace(imu, gyro=imu.gyro * gyro, accel=imu.accel * accel)


PLANTED: dict[str, tuple[Change, str]] = {
    "g": (scaled(accel=1 / 9.80665), r"accelerometer in g;.*accel_x = \"ax:g\""),
    "cm/s2": (scaled(accel=100.0), r"accelerometer in (mg or )?cm/s2"),
    "ft/s2": (scaled(accel=1 / 0.3048), "accelerometer in ft/s2"),
    "degrees": (scaled(gyro=180 / math.pi), "gyro in degrees"),
    "degrees twice": (scaled(gyro=math.pi / 180), "radians read as degrees"),
    "z up": (turned((1, 0, 0), (0, -1, 0), (0, 0, -1)), '"forward-left-up"'),
    "enu-like": (turned((0, 1, 0), (1, 0, 0), (0, 0, -1)), '"right-forward-up"'),
    "cyclic": (turned((0, 1, 0), (0, 0, 1), (1, 0, 0)), '"right-down-forward"'),
    "x is down": (turned((0, 0, 1), (0, 1, 0), (-1, 0, 0)), '"down-right-back"'),
    "turned by 180": (turned((-1, 0, 0), (0, -1, 0), (0, 0, 1)), '"back-left-down"'),
    "turned by 90": (turned((0, 1, 0), (-1, 0, 0), (0, 0, 1)), '"right-back-down"'),
    "gyro z sign": (signs((1, 1, -1)), 'gyro z has the wrong sign; set gyro_z = "-gz"'),
    "force sign": (signs((1, 1, 1), (-1, -1, -1)), "accelerometers have the wrong signs"),
    "linear": (lambda i: replace(i, accel=i.accel - np.median(i.accel, 0)), "gravity was taken"),
}


def found(logs: FlightLogs, change: Change) -> str:
    assert logs.imu is not None
    try:
        return words(clean_logs(replace(logs, imu=change(logs.imu))))
    except GeorefError as error:
        return str(error)


@pytest.mark.parametrize("name", PLANTED)
def test_planted_axes_and_units_are_named_on_a_simulated_flight(
    name: str, flight: FlightLogs
) -> None:
    change, expected = PLANTED[name]
    assert re.search(expected, found(flight, change)), found(flight, change)


@pytest.mark.parametrize("name", PLANTED)
@pytest.mark.parametrize("log", ["thor75", "drive_0708"])
def test_planted_axes_and_units_are_named_on_real_logs(name: str, log: str, data: Path) -> None:
    logs = getattr(log_cases, log)(data)
    change, expected = PLANTED[name]
    assert re.search(expected, found(logs, change)), found(logs, change)


def test_swapped_gyros_are_named_by_the_attitude_log(data: Path) -> None:
    logs = log_cases.thor75(data)
    assert check_sensors(clean_logs(logs)) == ()
    said = found(logs, signs((-1, 1, 1)))
    assert "gyro -x" in said


def multirotor(seed: int, *, nose: str) -> FlightLogs:
    """Curves flown with the nose fixed, or free of the course; tilt makes the acceleration."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, 240.0, 0.01)
    parts = [
        a * np.sin(w * time + p)
        for a, w, p in zip(
            rng.uniform(20, 60, 6), rng.uniform(0.05, 0.35, 6), rng.uniform(0, 6, 6), strict=True
        )
    ]
    north, east = sum(parts[:3]), sum(parts[3:])
    velocity = np.column_stack([np.gradient(north, time), np.gradient(east, time)])
    push = np.column_stack([np.gradient(v, time) for v in velocity.T])
    yaw = np.full(len(time), rng.uniform(0, 6.0))
    if nose == "wandering":
        yaw = yaw + np.cumsum(rng.normal(0.0, 0.02, len(time))) * 0.1
    forward = push[:, 0] * np.cos(yaw) + push[:, 1] * np.sin(yaw)
    right = -push[:, 0] * np.sin(yaw) + push[:, 1] * np.cos(yaw)
    roll, pitch = np.arctan2(right, 9.81), -np.arctan2(forward, 9.81)
    R = R_ned_from_body(roll, pitch, yaw)
    turn = log_so3(np.swapaxes(R[:-1], 1, 2) @ R[1:]) / 0.01
    force = np.einsum("nji,nj->ni", R, np.column_stack([push, np.full(len(time), -9.81)]))
    n, fixes = len(time), np.arange(0, len(time), 20)
    noise = rng.normal(size=(n, 6))
    imu = ImuLog(
        time=1.3e9 + time,
        gyro=np.vstack([turn, turn[-1:]]) + 0.005 * noise[:, :3],
        accel=force + 0.1 * noise[:, 3:],
    )
    gnss = log_cases.gnss_log(
        1.3e9 + time[fixes],
        0.7 + north[fixes] / 6.37e6,
        0.2 + east[fixes] / 4.87e6,
        np.full(len(fixes), 100.0),
        np.column_stack([velocity[fixes], np.zeros(len(fixes))]),
    )
    return FlightLogs(imu=imu, gnss=gnss)


@pytest.mark.parametrize("nose", ["fixed", "wandering"])
def test_multirotors_that_fly_sideways_pass_without_a_word(nose: str) -> None:
    for seed in range(12):
        assert words(clean_logs(multirotor(seed, nose=nose))) == "", seed


def test_degrees_are_named_without_gnss_too(data: Path) -> None:
    logs = replace(log_cases.thor75(data), gnss=None, attitude=None)
    assert "no gyro measures that: in degrees" in found(logs, scaled(gyro=180 / math.pi))


def test_stationary_log_passes(flight: FlightLogs) -> None:
    rng = np.random.default_rng(7)
    n = 6000
    imu = ImuLog(
        time=1.3e9 + np.arange(n) / 100,
        gyro=0.002 * rng.normal(size=(n, 3)),
        accel=np.array([0.3, -0.1, -9.8]) + 0.05 * rng.normal(size=(n, 3)),
    )
    m = 60
    gnss = log_cases.gnss_log(
        1.3e9 + np.arange(m) * 1.0,
        np.full(m, 0.7),
        np.full(m, 0.2),
        np.full(m, 100.0),
        np.zeros((m, 3)),
    )
    cleaned = clean_logs(FlightLogs(imu=imu, gnss=gnss))
    assert words(cleaned) == ""
    assert cleaned.gnss is not None
    assert len(cleaned.gnss) == m  # equal fixes at rest are no repeats


# --- stamps -----------------------------------------------------------------------------------


def test_logger_jitter_is_taken_out_of_the_stamps(flight: FlightLogs) -> None:
    rng = np.random.default_rng(7)
    assert flight.imu is not None
    true = flight.imu.time
    late = true + rng.exponential(0.004, len(true))
    cleaned = clean_logs(with_imu(flight, time=late))
    assert cleaned.imu is not None
    assert "stamps jitter by" in words(cleaned)
    assert len(cleaned.imu) == len(true)
    off = cleaned.imu.time - true
    # s: 100 samples on either side leave 0.004 / sqrt(200); the mean delay of 4 ms stays
    assert np.std(off) < 0.0006
    assert np.mean(off) == pytest.approx(0.004, abs=0.0015)


def test_late_stamps_do_not_swap_samples(flight: FlightLogs) -> None:
    rng = np.random.default_rng(7)
    assert flight.imu is not None
    late = flight.imu.time + rng.exponential(0.006, len(flight.imu))
    assert np.any(np.diff(late) < 0.0)
    cleaned = clean_logs(with_imu(flight, time=late)).imu
    assert cleaned is not None
    assert np.array_equal(cleaned.gyro, flight.imu.gyro)
    assert np.std(cleaned.time - flight.imu.time) < 0.001  # s; 6 ms before


def test_stamps_of_whole_milliseconds_are_made_regular() -> None:
    rng = np.random.default_rng(7)
    true = 1.3e9 + np.arange(8000) / 400.0
    imu = ImuLog(
        time=1.3e9 + np.floor((true - 1.3e9) * 1e3) * 1e-3,
        gyro=0.01 * rng.normal(size=(8000, 3)),
        accel=np.array([0, 0, -9.8]) + 0.01 * rng.normal(size=(8000, 3)),
    )
    cleaned = clean_logs(FlightLogs(imu=imu)).imu
    assert cleaned is not None
    assert len(cleaned) == 8000
    assert np.ptp(cleaned.time - true) < 0.0002  # s; half of a millisecond before


def test_bursts_of_a_buffering_logger_are_made_regular() -> None:
    rng = np.random.default_rng(7)
    true = 1.3e9 + np.arange(6000) / 200.0
    imu = ImuLog(
        time=true[np.minimum((np.arange(6000) // 4) * 4 + 3, 5999)],
        gyro=0.01 * rng.normal(size=(6000, 3)),
        accel=np.array([0, 0, -9.8]) + 0.01 * rng.normal(size=(6000, 3)),
    )
    cleaned = clean_logs(FlightLogs(imu=imu)).imu
    assert cleaned is not None
    assert len(cleaned) == 6000
    off = cleaned.time - true
    assert np.std(off) < 0.0005  # s; 5.6 ms before


def test_real_gaps_and_lost_samples_survive_the_regularising(flight: FlightLogs) -> None:
    rng = np.random.default_rng(7)
    assert flight.imu is not None
    n = len(flight.imu)
    rows = np.ones(n, dtype=bool)
    rows[3000:3150] = False  # a gap of 1.5 s
    rows[6000:6003] = False  # three lost samples
    true = flight.imu.time[rows]
    late = true + rng.normal(0.0, 0.0015, len(true))
    imu = ImuLog(time=late, gyro=flight.imu.gyro[rows], accel=flight.imu.accel[rows])
    cleaned = clean_logs(replace(flight, imu=imu)).imu
    assert cleaned is not None
    assert any("1 gap(s) over 0.1 s, 1.51" in d for d in cleaned.doubts), cleaned.doubts
    # s: a stamp moved across a lost sample would be off by 10 ms
    assert np.max(np.abs(cleaned.time - true)) < 0.006


def test_uneven_sampling_that_is_no_jitter_is_left_alone() -> None:
    # rates that wander: the intervals themselves are true, neighbours do not make up for it
    rng = np.random.default_rng(7)
    time = 1.3e9 + np.cumsum(rng.uniform(0.006, 0.014, 5000))
    imu = ImuLog(
        time=time,
        gyro=0.01 * rng.normal(size=(5000, 3)),
        accel=np.array([0, 0, -9.8]) + 0.01 * rng.normal(size=(5000, 3)),
    )
    cleaned = clean_logs(FlightLogs(imu=imu)).imu
    assert cleaned is not None
    assert np.array_equal(cleaned.time, time)


def test_duplicates_disorder_and_garbled_stamps_are_named(flight: FlightLogs) -> None:
    assert flight.imu is not None
    order = np.arange(len(flight.imu))
    order = np.insert(order, 100, 99)  # a row twice
    order[[500, 501]] = order[[501, 500]]
    time = flight.imu.time[order]
    time[2000] += 86400.0 * 40
    imu = ImuLog(time=time, gyro=flight.imu.gyro[order], accel=flight.imu.accel[order])
    cleaned = clean_logs(replace(flight, imu=imu))
    said = words(cleaned)
    assert "garbled stamp, first row 2001" in said
    # rows are counted in what the steps before left
    assert "1 stamp(s) out of order by up to 10.0 ms, first at row 501" in said
    assert "time and values of the row before, first row 101" in said
    assert cleaned.imu is not None
    assert np.all(np.diff(cleaned.imu.time) > 0.0)
    assert len(cleaned.imu) == len(flight.imu) - 1


def test_clock_that_starts_anew_is_named_and_one_run_kept(flight: FlightLogs) -> None:
    assert flight.imu is not None
    time = flight.imu.time.copy()
    time[:3000] += 20.0
    cleaned = clean_logs(with_imu(flight, time=time))
    assert "clock reset: time falls by 20.0 s at row 3001" in words(cleaned)
    assert cleaned.imu is not None
    assert np.all(np.diff(cleaned.imu.time) > 0.0)
    assert len(cleaned.imu) == len(time) - 3000


def test_values_that_are_no_numbers_are_left_out_and_counted(flight: FlightLogs) -> None:
    assert flight.imu is not None
    gyro, accel = flight.imu.gyro.copy(), flight.imu.accel.copy()
    gyro[10], accel[11, 2], gyro[12, 0] = np.nan, np.inf, -np.inf
    cleaned = clean_logs(with_imu(flight, gyro=gyro, accel=accel))
    assert "3 row(s) left out: NaN or infinite IMU values, first row 11" in words(cleaned)
    assert cleaned.imu is not None
    assert np.isfinite(cleaned.imu.gyro).all()
    assert np.isfinite(cleaned.imu.accel).all()


def test_log_without_a_usable_row_is_an_error(flight: FlightLogs) -> None:
    assert flight.imu is not None
    with pytest.raises(InputError, match=r"none of the .* rows can be used"):
        clean_logs(with_imu(flight, gyro=np.full_like(flight.imu.gyro, np.nan)))


# --- GNSS -------------------------------------------------------------------------------------


def test_placeholder_fixes_are_left_out(flight: FlightLogs) -> None:
    assert flight.gnss is not None
    lat, lon, fix = flight.gnss.lat.copy(), flight.gnss.lon.copy(), flight.gnss.fix.copy()
    lat[:12], lon[:12] = math.radians(45.0), math.radians(-93.0)
    lat[100], lon[100] = 0.0, 0.0
    fix[200:203] = 0
    lat[300] = math.radians(91.0)
    lon[301] = np.nan
    cleaned = clean_logs(with_gnss(flight, lat=lat, lon=lon, fix=fix))
    said = words(cleaned)
    for expected in (
        "12 row(s) left out: constant position before the first fix",
        "1 row(s) left out: position 0, 0",
        "3 row(s) left out: no fix",
        "1 row(s) left out: impossible position",
        "1 row(s) left out: no position",
    ):
        assert expected in said
    assert cleaned.gnss is not None
    assert len(cleaned.gnss) == len(lat) - 18


def test_fixes_repeated_by_a_faster_logger_are_left_out(flight: FlightLogs) -> None:
    assert flight.gnss is not None
    n = len(flight.gnss)
    rows = np.repeat(np.arange(n), 3)
    g = flight.gnss
    time = g.time[rows] + np.tile([0.0, 0.05, 0.1], n)
    gnss = log_cases.gnss_log(time, g.lat[rows], g.lon[rows], g.height[rows], g.v_ned[rows])
    cleaned = clean_logs(replace(flight, gnss=gnss))
    assert "repeated while moving" in words(cleaned)
    assert cleaned.gnss is not None
    assert np.allclose(cleaned.gnss.time, g.time)


def test_sigmas_of_zero_are_no_sigmas(flight: FlightLogs) -> None:
    assert flight.gnss is not None
    cleaned = clean_logs(with_gnss(flight, covariance_ned=np.zeros((len(flight.gnss), 3, 3))))
    assert cleaned.gnss is not None
    assert np.isnan(cleaned.gnss.covariance_ned).all()


def test_outage_of_60_s_is_named_with_its_place(flight: FlightLogs) -> None:
    assert flight.gnss is not None
    g = flight.gnss
    keep = (g.time < g.time[0] + 20.0) | (g.time > g.time[0] + 80.0)
    gnss = log_cases.gnss_log(g.time[keep], g.lat[keep], g.lon[keep], g.height[keep], g.v_ned[keep])
    assert "1 gap(s) over 3 s, 60." in words(clean_logs(replace(flight, gnss=gnss)))


@pytest.mark.parametrize("weeks", [0, -1024], ids=["no week", "rolled over"])
def test_calendar_of_receivers_without_it_is_set_right(flight: FlightLogs, weeks: int) -> None:
    assert flight.gnss is not None
    assert flight.imu is not None
    week = int(flight.gnss.time[0] // GPS_WEEK)
    shift = weeks * GPS_WEEK if weeks else -week * GPS_WEEK
    cleaned = clean_logs(with_gnss(flight, time=flight.gnss.time + shift))
    assert cleaned.gnss is not None
    assert np.allclose(cleaned.gnss.time, flight.gnss.time, atol=1e-6)
    assert ("week is missing" if weeks == 0 else "roll-over") in words(cleaned)


def test_log_without_a_week_lies_by_the_others_across_the_turn_of_the_week() -> None:
    turn = gps_from_week(1701, 0.0)
    aid = AidLog(kind="airspeed", time=turn + np.arange(2.0, 40.0), value=np.full(38, 20.0),
                 sigma=unknown(38))  # fmt: skip
    # most of this one lies before the turn, and its stamps count from there without a week
    tow = np.arange(-60.0, 5.0) % GPS_WEEK
    time = np.unwrap(tow, period=GPS_WEEK)
    late = AidLog(kind="baro_height", time=time, value=np.full(65, 100.0), sigma=unknown(65))
    cleaned = clean_logs(FlightLogs(aids=(aid, late)))
    assert cleaned.aids[1].time[0] == pytest.approx(turn - 60.0, abs=1e-3)  # s


def test_no_week_anywhere_is_named() -> None:
    imu = ImuLog(
        time=2000.0 + np.arange(1000) / 100,
        gyro=np.full((1000, 3), 0.001),
        accel=np.tile([0.0, 0.0, -9.8], (1000, 1)),
    )
    assert "unknown week" in words(clean_logs(FlightLogs(imu=imu)))


# --- together ---------------------------------------------------------------------------------


def test_logs_without_common_time_are_an_error_with_both_spans(flight: FlightLogs) -> None:
    assert flight.gnss is not None
    with pytest.raises(NavigationError, match=r"2009-06-\d\d .* no time in common") as caught:
        clean_logs(with_gnss(flight, time=flight.gnss.time + 86400.0))
    assert str(caught.value).count("UTC") == 2


def test_saturation_is_named_with_its_times(flight: FlightLogs) -> None:
    assert flight.imu is not None
    accel, gyro = flight.imu.accel.copy(), flight.imu.gyro.copy()
    accel[4000:4030, 2] = np.clip(accel[4000:4030, 2] * 3.0, -19.6133, 0)
    gyro[5000:5020, 0] = 4.3633
    said = words(clean_logs(with_imu(flight, accel=accel, gyro=gyro)))
    assert "accel z saturates at 19.61 m/s2: 30 samples, first 40.00 s" in said
    assert "gyro x saturates at 4.36 rad/s: 20 samples, first 50.00 s" in said


def attitude_of(flight: FlightLogs, factor: float) -> AttitudeLog:
    assert flight.gnss is not None
    v = flight.gnss.v_ned
    yaw = np.unwrap(np.arctan2(v[:, 1], v[:, 0]))
    rng = np.random.default_rng(7)
    level = 0.05 * rng.normal(size=(len(v), 2)) + [0.0, 0.05]
    return AttitudeLog(
        time=flight.gnss.time,
        rpy=np.column_stack([level, yaw]) * factor,
        sigma_rpy=unknown(len(v), 3),
    )


@pytest.mark.parametrize(
    ("factor", "expected"),
    [(1.0, ""), (180 / math.pi, "degrees read as radians"), (math.pi / 180, "radians read as")],
    ids=["radians", "degrees", "radians twice"],
)
def test_units_of_an_attitude_log_are_told(
    flight: FlightLogs, factor: float, expected: str
) -> None:
    def wrapped(log: AttitudeLog, by: float) -> AttitudeLog:
        rpy = (log.rpy / by + math.pi) % (2 * math.pi) - math.pi
        return replace(log, rpy=rpy * by)

    log = wrapped(attitude_of(flight, factor), factor)
    cleaned = clean_logs(FlightLogs(gnss=flight.gnss, attitude=log))
    assert cleaned.attitude is not None
    assert np.allclose(cleaned.attitude.rpy, log.rpy / factor, atol=1e-9)
    assert expected in words(cleaned)
    assert bool(words(cleaned)) == bool(expected)


def test_events_keep_their_order_and_aids_lose_their_holes() -> None:
    n = 5
    start = gps_from_week(1700, 0.0)
    events = EventLog(
        time=start + np.array([0.0, 2.0, 1.0, 3.0, np.nan]),
        kind="feedback",
        sequence=np.arange(n),
        sigma=np.full(n, 0.001),
        lat=unknown(n),
        lon=unknown(n),
        height=unknown(n),
        covariance_ned=unknown(n, 3, 3),
        rpy=unknown(n, 3),
        names=tuple("abcde"),
        flags=np.full(n, -1),
    )
    aid = AidLog(
        time=start + np.arange(n),
        kind="airspeed",
        value=np.array([1.0, np.nan, 3.0, 4.0, 5.0]),
        sigma=unknown(n),
    )
    cleaned = clean_logs(FlightLogs(events=(events,), aids=(aid,)))
    assert cleaned.events[0].names == ("a", "b", "c", "d")
    assert list(cleaned.events[0].sequence) == [0, 1, 2, 3]
    assert "1 exposure(s) are noted after later ones, first at row 3" in words(cleaned)
    assert len(cleaned.aids[0]) == 4


def test_cleaning_twice_changes_nothing(flight: FlightLogs) -> None:
    rng = np.random.default_rng(7)
    assert flight.imu is not None
    late = flight.imu.time + rng.exponential(0.004, len(flight.imu))
    once = clean_logs(with_imu(flight, time=late))
    twice = clean_logs(once)
    assert once.imu is not None
    assert twice.imu is not None
    assert np.array_equal(once.imu.time, twice.imu.time)
    assert words(once) == words(twice)


# --- anything at all --------------------------------------------------------------------------


@pytest.mark.parametrize("rows", [0, 1, 2, 3, 5, 9, 25])
def test_logs_of_a_few_rows_pass(flight: FlightLogs, rows: int) -> None:
    assert flight.imu is not None
    assert flight.gnss is not None
    for fixes in (0, 1, 2, 3, 6):
        imu = take(flight.imu, np.arange(rows))
        cleaned = clean_logs(replace(flight, imu=imu, gnss=take(flight.gnss, np.arange(fixes))))
        assert cleaned.imu is not None
        assert len(cleaned.imu) == rows


def test_wild_values_leave_sound_logs_or_one_clear_error(flight: FlightLogs) -> None:
    rng = np.random.default_rng(7)
    assert flight.imu is not None
    assert flight.gnss is not None
    wild = [np.nan, np.inf, -np.inf, 0.0, 1e18, -1e9, 1e30]
    for _ in range(60):
        imu = take(flight.imu, np.sort(rng.choice(len(flight.imu), 300)))
        gnss = take(flight.gnss, np.sort(rng.choice(len(flight.gnss), 40)))
        arrays = [a.copy() for a in (imu.time, imu.gyro, imu.accel, gnss.time, gnss.lat,
                                     gnss.height, gnss.v_ned)]  # fmt: skip
        for array in arrays:
            for _ in range(rng.integers(0, 4)):
                array.flat[rng.integers(array.size)] = rng.choice(wild)
        time, gyro, accel, gnss_time, lat, height, v_ned = arrays
        logs = replace(
            flight,
            imu=replace(imu, time=time, gyro=gyro, accel=accel),
            gnss=replace(gnss, time=gnss_time, lat=lat, height=height, v_ned=v_ned),
        )
        try:
            cleaned = clean_logs(logs)
        except GeorefError:
            continue
        for log in (cleaned.imu, cleaned.gnss):
            assert log is not None
            assert np.isfinite(log.time).all()
            assert np.all(np.diff(log.time) > 0.0)
