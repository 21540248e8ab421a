"""PX4 logs: real samples, and files written by the test in old and new field names."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from ulog_writer import write_ulog

from georef_gis.errors import InputError
from georef_gis.geodesy import HeightKind, geoid_undulation
from georef_gis.ingest.logs.boot_clock import fit_boot_clock, gps_of_unix
from georef_gis.ingest.logs.cleaning import clean_logs
from georef_gis.ingest.logs.ulog import looks_like_ulog, read_ulog
from georef_gis.model.logs import FIX_FIXED
from georef_gis.units import gps_from_utc, utc_from_gps

LAT, LON, MSL = 39.6, -79.95, 350.25
N = float(geoid_undulation(math.radians(LAT), math.radians(LON)))
# s since 1970 of boot
BOOT = datetime(2023, 5, 4, 12, 0, tzinfo=UTC).timestamp()

COMBINED = "uint64_t timestamp;float[3] gyro_rad;float[3] accelerometer_m_s2"
OLD_GPS = (
    "uint64_t timestamp;uint64_t time_utc_usec;int32_t lat;int32_t lon;int32_t alt;"
    "int32_t alt_ellipsoid;float s_variance_m_s;float eph;float epv;float vel_n_m_s;"
    "float vel_e_m_s;float vel_d_m_s;int32_t timestamp_time_relative;uint8_t fix_type;"
    "bool vel_ned_valid;uint8_t satellites_used"
)
NEW_GPS = (
    OLD_GPS.replace("int32_t lat;", "double latitude_deg;")
    .replace("int32_t lon;", "double longitude_deg;")
    .replace("int32_t alt;", "double altitude_msl_m;")
    .replace("int32_t alt_ellipsoid;", "double altitude_ellipsoid_m;")
)
CAPTURE = (
    "uint64_t timestamp;uint64_t timestamp_utc;uint32_t seq;double lat;double lon;float alt;"
    "float ground_distance;float[4] q;int8_t result"
)
TRIGGER = "uint64_t timestamp;uint64_t timestamp_utc;uint32_t seq;bool feedback"
FORMATS = {
    "sensor_combined": COMBINED,
    "vehicle_gps_position": OLD_GPS,
    "sensor_gps": NEW_GPS,
    "vehicle_attitude": "uint64_t timestamp;float[4] q",
    "vehicle_imu": "uint64_t timestamp;float[3] delta_angle;float[3] delta_velocity;"
    "uint32_t delta_angle_dt;uint32_t delta_velocity_dt",
    "camera_capture": CAPTURE,
    "camera_trigger": TRIGGER,
}


def fix(boot: float, *, new: bool = False, time: bool = True, delay: float = 0.1):
    """A fix whose message came `delay` after its epoch; boot is s of the epoch."""
    utc = round((BOOT + boot) * 1e6) if time else 0
    place = (
        (LAT, LON, MSL, MSL + N)
        if new
        else (round(LAT * 1e7), round(LON * 1e7), round(MSL * 1e3), round((MSL + N) * 1e3))
    )
    values = (round((boot + delay) * 1e6), utc, *place, 0.25, 0.5, 0.75, 3.0, -4.0, 0.5, 0, 6,
              True, 17)  # fmt: skip
    return ("sensor_gps" if new else "vehicle_gps_position", 0, values)


def imu(seconds: float = 10.0, instance: int = 0, rate: int = 100):
    return [
        ("sensor_combined", instance,
         (20_000_000 + k * 1_000_000 // rate, 0.1, 0.2, 0.3 + instance, 0.5, 0.6, -9.8))
        for k in range(int(seconds * rate))
    ]  # fmt: skip


@pytest.fixture
def read(tmp_path: Path):
    def run(rows, **options):
        path = write_ulog(tmp_path / "log.ulg", FORMATS, rows, **options)
        assert looks_like_ulog(path.read_bytes()[:16], path)
        return read_ulog(path)

    return run


@pytest.mark.parametrize("new", [False, True], ids=["integers of 2021", "doubles of 2023"])
def test_fixes_of_old_and_new_field_names_are_the_same(read, new: bool) -> None:
    gnss = read([*imu(), *(fix(20 + k / 5, new=new) for k in range(50))]).gnss
    assert gnss is not None
    assert np.degrees([gnss.lat[0], gnss.lon[0]]) == pytest.approx([LAT, LON], abs=1e-7)
    assert gnss.height_kind is HeightKind.ELLIPSOIDAL
    assert gnss.height[0] == pytest.approx(MSL + N, abs=1e-3)
    assert gnss.geoid_separation[0] == pytest.approx(N, abs=2e-3)
    assert list(gnss.v_ned[0]) == [3.0, -4.0, 0.5]
    assert np.sqrt(np.diagonal(gnss.covariance_ned[0])) == pytest.approx(
        [0.5 / math.sqrt(2)] * 2 + [0.75]
    )
    assert (gnss.fix[0], gnss.satellites[0]) == (FIX_FIXED, 17)
    # GPS was 18 s ahead of UTC in 2023
    assert gnss.time[0] == pytest.approx(
        gps_from_utc(datetime(2023, 5, 4, 12, 0, 20, tzinfo=UTC)), abs=1e-6
    )


def test_imu_is_brought_to_gps_time_by_the_fixes(read) -> None:
    logs = read([*imu(), *(fix(20 + k / 5) for k in range(50))])
    assert logs.imu is not None
    assert logs.imu.scale == "gps"
    # 0.1 s: the delay of the receiver cannot be seen here; it is left to the scan of the latency
    stamp = gps_from_utc(datetime(2023, 5, 4, 12, 0, 20, tzinfo=UTC)) - 0.1
    assert logs.imu.time[0] == pytest.approx(stamp, abs=1e-5)
    assert logs.imu.gyro[0] == pytest.approx([0.1, 0.2, 0.3], abs=1e-7)
    assert logs.imu.accel[0] == pytest.approx([0.5, 0.6, -9.8], abs=1e-6)


def test_relative_time_of_the_utc_stamp_is_believed(read) -> None:
    # PX4: timestamp + timestamp_time_relative is the instant of time_utc_usec
    rows = []
    for k in range(50):
        name, instance, values = fix(20 + k / 5)
        rows.append((name, instance, (*values[:12], -100_000, *values[13:])))
    logs = read([*imu(), *rows])
    assert logs.imu is not None
    stamp = gps_from_utc(datetime(2023, 5, 4, 12, 0, 20, tzinfo=UTC))
    assert logs.imu.time[0] == pytest.approx(stamp, abs=1e-5)


def test_without_utc_the_whole_file_is_on_the_boot_scale(read) -> None:
    logs = read([*imu(), *(fix(20 + k / 5, time=False) for k in range(50))])
    assert logs.imu is not None
    assert logs.gnss is not None
    assert (logs.imu.scale, logs.gnss.scale) == ("boot", "boot")
    assert logs.imu.time[0] == pytest.approx(20.0)
    assert any("since the boot" in d for d in logs.doubts)


def test_longest_imu_instance_is_used_and_named(read) -> None:
    logs = read([*imu(5.0, 0), *imu(10.0, 1), *(fix(20 + k) for k in range(9))])
    assert logs.imu is not None
    assert logs.imu.gyro[0, 2] == pytest.approx(1.3)
    assert any("sensor_combined[1] of 2 instances is used" in d for d in logs.doubts)


def test_increments_of_vehicle_imu_stand_in_for_missing_samples(read) -> None:
    rows = [
        (
            "vehicle_imu",
            0,
            (20_000_000 + 5000 * k, 0.0005, 0.001, -0.0015, 0, 0, -0.049, 5000, 5000),
        )
        for k in range(500)
    ]
    logs = read([*rows, *(fix(20 + k) for k in range(3))])
    assert logs.imu is not None
    assert logs.imu.gyro[0] == pytest.approx([0.1, 0.2, -0.3], abs=1e-6)
    assert logs.imu.accel[0] == pytest.approx([0.0, 0.0, -9.8], abs=1e-5)


def test_attitude_quaternion_becomes_roll_pitch_yaw(read) -> None:
    half = math.radians(30.0) / 2
    q = (math.cos(half), 0.0, 0.0, math.sin(half))
    rows = [("vehicle_attitude", 0, (20_000_000 + 4000 * k, *q)) for k in range(10)]
    attitude = read([*imu(), *rows]).attitude
    assert attitude is not None
    assert np.degrees(attitude.rpy[0]) == pytest.approx([0.0, 0.0, 30.0], abs=1e-5)


def test_captures_answered_failed_and_unanswered_are_told_apart(read) -> None:
    rows = [
        ("camera_capture", 0,
         (21_000_000 + 2_000_000 * k, 0, 40 + k, LAT, LON, 400.0, -1.0, 1, 0, 0, 0, result))
        for k, result in enumerate((1, 1, 0, 1, -1))
    ]  # fmt: skip
    logs = read([*imu(), *rows, *(fix(20 + k) for k in range(9))])
    events = {log.kind: log for log in logs.events}
    assert list(events["feedback"].sequence) == [40, 41, 43]
    assert list(events["trigger"].sequence) == [44]
    assert any("1 captures failed" in d for d in logs.doubts)
    assert any("meaning of q differs" in d for d in logs.doubts)
    assert np.isnan(events["feedback"].rpy).all()
    assert np.degrees(events["feedback"].lat[0]) == pytest.approx(LAT)
    assert np.diff(events["feedback"].time) == pytest.approx([2.0, 4.0], abs=1e-5)


def test_triggers_are_commands_unless_the_camera_answered(read) -> None:
    rows = [("camera_trigger", 0, (21_000_000 + k * 10**6, 0, k, k % 2 == 1)) for k in range(6)]
    logs = read([*imu(), *rows])
    events = {log.kind: log for log in logs.events}
    assert list(events["feedback"].sequence) == [1, 3, 5]
    assert list(events["trigger"].sequence) == [0, 2, 4]


def test_dropouts_are_named(read) -> None:
    logs = read(imu(), dropouts={500: 250, 700: 40})
    assert any(
        "2 dropout(s) of the logger, 0.29 s in all, longest 0.25 s" in d for d in logs.doubts
    )


@pytest.mark.parametrize(
    "content",
    [b"", b"ULog\x01\x12\x35", b"\x00\xff" * 5000, b"ULog\x01\x12\x35\x01" + b"\x7f" * 3000],
    ids=["empty", "stump", "garbage", "garbage behind a header"],
)
def test_garbage_is_one_clear_error(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "bad.ulg"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"bad\.ulg") as caught:
        read_ulog(path)
    assert "\n" not in str(caught.value)


def test_missing_package_is_named_with_its_cure(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "pyulog", None)
    path = write_ulog(tmp_path / "a.ulg", FORMATS, imu(1.0))
    with pytest.raises(InputError, match=r"pip install georef-gis\[logs\]"):
        read_ulog(path)


# --- real samples -----------------------------------------------------------------------------


def test_real_flight_controller_log(data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    logs = read_ulog(data / "flight_logs" / "px4_ulg" / "sample_log_small.ulg")
    assert capsys.readouterr().out == ""
    assert logs.imu is not None
    assert logs.gnss is not None
    assert len(logs.imu) == 1298
    assert len(logs.gnss) == 32
    at = utc_from_gps(float(logs.gnss.time[0]))
    assert at.isoformat()[:22] == "2021-04-21T06:30:58.60"
    assert np.degrees(logs.gnss.lat[0]) == pytest.approx(63.4170622, abs=1e-7)
    assert logs.gnss.height_kind is HeightKind.ELLIPSOIDAL
    # m: geoid over Trondheim by EGM96, against the receiver's own
    model = geoid_undulation(logs.gnss.lat[0], logs.gnss.lon[0])
    assert logs.gnss.geoid_separation[0] == pytest.approx(float(model), abs=1.0)
    assert np.linalg.norm(logs.imu.accel, axis=1).mean() == pytest.approx(9.8, abs=0.3)
    assert {aid.kind for aid in logs.aids} == {"baro_height", "airspeed", "magnetic_field"}
    cleaned = clean_logs(logs)
    assert cleaned.gnss is not None
    assert len(cleaned.gnss) == 32


def test_simulator_log_whose_heights_have_no_geoid_is_named(data: Path) -> None:
    logs = read_ulog(data / "flight_logs" / "px4_ulg" / "sample_px4_events.ulg")
    assert logs.gnss is not None
    assert logs.gnss.height_kind is HeightKind.ORTHOMETRIC
    assert any("EGM96 has 47.3 m" in d for d in logs.gnss.doubts)
    assert logs.attitude is not None
    assert np.abs(logs.attitude.rpy[:, :2]).max() < math.radians(5.0)  # stands on the ground


@pytest.mark.parametrize("share", [0.3, 0.6, 0.95])
def test_truncated_real_log_is_read_up_to_the_cut(data: Path, tmp_path: Path, share: float) -> None:
    whole = (data / "flight_logs" / "px4_ulg" / "sample_px4_events.ulg").read_bytes()
    path = tmp_path / "cut.ulg"
    path.write_bytes(whole[: int(share * len(whole))])
    logs = read_ulog(path)
    assert logs.imu is not None
    assert 100 < len(logs.imu) < 7783


# --- the clock --------------------------------------------------------------------------------


def test_leap_seconds_of_unix_stamps() -> None:
    for year, leap in ((2012, 15), (2013, 16), (2016, 17), (2023, 18)):
        at = datetime(year, 3, 1, tzinfo=UTC)
        assert gps_of_unix(np.array([at.timestamp()]))[0] == pytest.approx(gps_from_utc(at))
        plain = (at - datetime(1980, 1, 6, tzinfo=UTC)).total_seconds()
        assert gps_of_unix(np.array([at.timestamp()]))[0] - plain == leap


@pytest.mark.parametrize("seed", range(10))
def test_clock_follows_drift_behind_one_sided_delays(seed: int) -> None:
    rng = np.random.default_rng(seed)
    epoch = 1.36e9 + np.arange(0.0, 1200.0, 0.2)
    drift = rng.uniform(-40e-6, 40e-6)
    boot = (epoch - epoch[0]) * (1.0 - drift) + 30.0
    arrival = boot + 0.06 + rng.exponential(0.03, len(boot))
    arrival[rng.choice(len(boot), 60)] += rng.uniform(0.2, 2.0, 60)
    clock = fit_boot_clock(arrival, epoch)
    assert clock is not None
    off = clock.gps_of(boot) - epoch
    assert np.ptp(off) < 0.004  # s over 20 min; the drift alone makes up to 48 ms
    # s: behind the shortest delay by what 5 % of exponential delays of 30 ms lie below: 1.5 ms
    assert np.mean(off) == pytest.approx(-0.0615, abs=0.003)


def test_clock_needs_three_fixes() -> None:
    assert fit_boot_clock(np.array([1.0, 2.0]), np.array([1.36e9, 1.36e9 + 1])) is None
