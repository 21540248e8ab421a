"""ArduPilot logs: fields, units, clocks and instances, from frames written by the test itself."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from dataflash_writer import OLD, write_binary, write_text

from georef_gis.errors import InputError
from georef_gis.geodesy import HeightKind, geoid_undulation
from georef_gis.ingest.logs.dataflash import looks_like_dataflash, read_dataflash

WEEK, TOW = 2200, 300_000.0
LAT, LON, ALT = 39.6, -79.95, 350.25
N = float(geoid_undulation(math.radians(LAT), math.radians(LON)))
# s: GPS time less boot time, and the shortest delay of a fix's message
OFFSET = WEEK * 604800.0 + TOW - 40.0
SHORTEST = 0.08


@dataclass
class Flight:
    """Truth behind the messages."""

    drift: float = 0.0
    duration: float = 60.0
    imu_rate: float = 50.0
    # s: exponential delay of the logger
    logger: float = 0.02
    instances: int = 2
    gpa: bool = True
    camera: bool = True

    def gps_of(self, boot: float) -> float:
        return OFFSET + boot * (1.0 + self.drift)

    def messages(self, rng: np.random.Generator):
        out = []
        for k in range(int(self.duration * self.imu_rate)):
            boot = 40.0 + k / self.imu_rate
            for i in range(self.instances):
                imu = (i, 0.01 * (i + 1), 0.02, 0.03, 0.1, 0.2, -9.8 - i, 0, 0, 40.0, 1, 1, 0, 0)
                out.append((boot, "IMU", imu))
            if k % 5 == 0:
                out.append((boot, "ATT", (0, -3.25, 0, 12.5, 0, 271.5, 0, 0, 3)))
                out.append((boot, "BARO", (0, 12.5, 97000.0, 25.0, 0, 0, 0, 0, 1)))
                out.append((boot, "MAG", (0, 210, -11, 430, 0, 0, 0, 0, 0, 0, 1, 0)))
                out.append((boot, "ARSP", (0, 21.5, 0, 0, 0, 0, 1, 1, 0, 0, 0, 1)))
        for k in range(int(self.duration * 5)):
            out += self.fix(TOW + 1.0 + k / 5, rng)
        for k in range(5 if self.camera else 0):
            boot = 50.0 + 4 * k
            gps = self.gps_of(boot)
            row = (0, 7 + k, round((gps % 604800) * 1e3), WEEK, LAT, LON, ALT, 80.0, ALT, 1.5, -2.5,
                   271.25)  # fmt: skip
            out += [(boot, "TRIG", row), (boot + 0.12, "CAM", row)]
        out.sort(key=lambda item: item[0])
        return [(name, (round(boot * 1e6), *values)) for boot, name, values in out]

    def fix(self, tow: float, rng: np.random.Generator):
        came = (WEEK * 604800.0 + tow - OFFSET) / (1.0 + self.drift) + SHORTEST
        came += rng.exponential(0.004)
        noted = came + (rng.exponential(self.logger) if self.logger else 0.0)
        gps = (0, 4, round(tow * 1e3), WEEK, 14, 0.8, LAT, LON, ALT, 20.0, 90.0, -0.5, 0, 1)
        accuracy = (0, 1.2, 0.5, 0.75, 0.25, 0, 1, round(came * 1e3), 200, -N)
        out = [(noted, "GPS", gps)]
        return [*out, (noted, "GPA", accuracy)] if self.gpa else out


@pytest.fixture
def read(tmp_path: Path):
    def run(flight: Flight, writer=write_binary, extra=()):
        messages = [*extra, *flight.messages(np.random.default_rng(3))]
        path = writer(tmp_path / "00000012.BIN", messages)
        assert looks_like_dataflash(path.read_bytes()[:256], path)
        return read_dataflash(path)

    return run


@pytest.mark.parametrize("writer", [write_binary, write_text], ids=["binary", "text"])
def test_fields_come_in_si_units_and_body_axes(read, writer) -> None:
    logs = read(Flight(duration=20.0), writer)
    assert logs.imu is not None
    assert logs.imu.gyro[3] == pytest.approx([0.01, 0.02, 0.03], abs=1e-8)  # float32
    assert logs.imu.accel[3] == pytest.approx([0.1, 0.2, -9.8], abs=1e-6)
    gnss = logs.gnss
    assert gnss is not None
    assert np.degrees([gnss.lat[0], gnss.lon[0]]) == pytest.approx([LAT, LON], abs=1e-9)
    assert (gnss.height[0], gnss.height_kind) == (pytest.approx(ALT), HeightKind.ORTHOMETRIC)
    assert gnss.v_ned[0] == pytest.approx([0.0, 20.0, -0.5], abs=1e-6)
    # HAcc 0.5 m and SAcc 0.25 m/s are of the distance, north and east share them
    assert np.sqrt(np.diagonal(gnss.covariance_ned[0])) == pytest.approx(
        [0.5 / math.sqrt(2)] * 2 + [0.75]
    )
    assert gnss.covariance_v_ned[0, 0, 0] == pytest.approx(0.25**2 / 2)
    assert (gnss.fix[0], gnss.satellites[0]) == (4, 14)
    assert logs.attitude is not None
    assert np.degrees(logs.attitude.rpy[0]) == pytest.approx([-3.25, 12.5, 271.5], abs=1e-6)
    aids = {aid.kind: aid.value[0] for aid in logs.aids}
    assert aids["baro_height"] == pytest.approx(12.5)
    assert aids["airspeed"] == pytest.approx(21.5)
    assert list(aids["magnetic_field"]) == [210.0, -11.0, 430.0]


def test_undulation_has_the_sign_of_geodesy(read) -> None:
    # ArduPilot stores height above the geoid less ellipsoidal height: -N
    logs = read(Flight(duration=20.0))
    assert logs.gnss is not None
    assert N < -25.0  # m; West Virginia lies well below the ellipsoid's zero
    assert logs.gnss.geoid_separation == pytest.approx(N, abs=1e-3)


def test_commands_and_answers_of_the_shutter_are_kept_apart(read) -> None:
    events = {log.kind: log for log in read(Flight()).events}
    assert set(events) == {"feedback", "trigger"}
    assert list(events["feedback"].sequence) == [7, 8, 9, 10, 11]
    late = events["feedback"].time - events["trigger"].time
    assert late == pytest.approx(0.12, abs=1e-6)  # s: the stamps are those of the messages
    assert np.degrees(events["feedback"].rpy[0]) == pytest.approx([1.5, -2.5, 271.25])
    assert np.degrees(events["feedback"].lat[0]) == pytest.approx(LAT)


@pytest.mark.parametrize("gpa", [True, False], ids=["with GPA", "without GPA"])
@pytest.mark.parametrize("drift", [0.0, 30e-6, -45e-6], ids=["no drift", "+30 ppm", "-45 ppm"])
def test_boot_clock_is_found_to_10_ms_behind_logger_delays(read, gpa: bool, drift: float) -> None:
    flight = Flight(duration=600.0, imu_rate=10.0, drift=drift, logger=0.03, gpa=gpa)
    logs = read(flight)
    assert logs.imu is not None
    boot = 40.0 + np.arange(len(logs.imu)) / 10.0
    off = logs.imu.time - np.array([flight.gps_of(b) for b in boot])
    # Stamps are never early, so what cannot be seen is the shortest delay: one constant, the
    # latency that navigation scans for. Its variation over the flight is what matters.
    assert np.ptp(off) < 0.010
    assert np.median(off) == pytest.approx(-SHORTEST, abs=0.012)
    assert logs.gnss is not None
    # fixes keep the epochs they state (a delay over 0.2 s puts two in the other order)
    assert np.sort(logs.gnss.time % 604800 - TOW - 1.0) == pytest.approx(
        np.arange(len(logs.gnss)) / 5, abs=1e-6
    )


def test_leap_seconds_learnt_in_flight_do_not_bend_the_clock(read, tmp_path: Path) -> None:
    flight = Flight(duration=200.0, imu_rate=10.0)
    rows = flight.messages(np.random.default_rng(3))
    wrong = [
        (name, (*v[:3], v[3] + 2000, *v[4:])) if name == "GPS" and v[0] < 60e6 else (name, v)
        for name, v in rows
    ]
    logs = read_dataflash(write_binary(tmp_path / "leap.bin", wrong))
    assert logs.gnss is not None
    assert any("off the autopilot's clock" in d and "+2.000" in d for d in logs.doubts)
    epochs = logs.gnss.time % 604800 - TOW - 1.0 - np.arange(len(logs.gnss)) / 5
    assert np.max(np.abs(epochs)) < 0.1  # s: arrival less the usual lag, scatter of the logger


def test_without_gps_time_all_is_on_the_boot_scale_and_said_so(read, tmp_path: Path) -> None:
    rows = [
        (name, (*v[:3], 0, 0, *v[5:]) if name == "GPS" else v)
        for name, v in Flight(duration=10.0).messages(np.random.default_rng(3))
    ]
    logs = read_dataflash(write_binary(tmp_path / "boot.bin", rows))
    parts = [logs.imu, logs.gnss, logs.attitude, *logs.events, *logs.aids]
    assert {part.scale for part in parts if part is not None} == {"boot"}
    assert any("since the boot" in d for d in logs.doubts)
    assert logs.imu is not None
    assert logs.imu.time[0] == pytest.approx(40.0)


def test_first_imu_is_used_and_the_others_named(read) -> None:
    logs = read(Flight(duration=10.0, instances=3))
    assert logs.imu is not None
    assert len(logs.imu) == 500
    assert np.all(logs.imu.gyro[:, 0] == np.float32(0.01))
    assert "IMU: instance 0 of 3 is used" in logs.doubts


def test_imu_of_few_rows_gives_way_to_the_full_one(tmp_path: Path) -> None:
    rows = Flight(duration=10.0).messages(np.random.default_rng(3))
    thin = [m for m in rows if not (m[0] == "IMU" and m[1][1] == 0 and m[1][0] % 100_000)]
    logs = read_dataflash(write_binary(tmp_path / "thin.bin", thin))
    assert logs.imu is not None
    assert np.all(logs.imu.gyro[:, 0] == np.float32(0.02))


def test_stamps_of_2014_without_timeus_are_read(tmp_path: Path) -> None:
    rows = []
    for k in range(400):
        ms = 40_000 + 20 * k
        rows.append(("IMU", (ms, 0.1, 0.2, 0.3, 0.0, 0.0, -9.8)))
        if k % 10 == 0:
            tow = round(TOW * 1e3) + 20 * k
            fix = (3, tow, WEEK, 9, 1.2, LAT, LON, 80.0, ALT, 15.0, 180.0, 0.25, ms + 90)
            rows += [("GPS", fix), ("ATT", (ms, 0, 5.0, 0, -2.0, 0, 90.0))]
    logs = read_dataflash(write_binary(tmp_path / "old.bin", rows, OLD))
    assert logs.imu is not None
    assert logs.gnss is not None
    assert logs.gnss.time[0] % 604800 == pytest.approx(TOW)
    assert logs.gnss.v_ned[0] == pytest.approx([-15.0, 0.0, 0.25], abs=1e-6)
    # boot 40.09 s is the epoch TOW, as the log has it
    assert logs.imu.time[0] % 604800 == pytest.approx(TOW - 0.09, abs=1e-3)


def test_feedback_stamp_of_32_bits_is_unwrapped_by_its_gps_time(tmp_path: Path) -> None:
    # after 2**32 us = 71.6 min of boot the interrupt's stamp starts anew
    wrap = 2.0**32 * 1e-6
    rows = []
    for k in range(50):
        boot, tow = 5000.0 + k / 5, TOW + k / 5
        fix = (0, 3, round(tow * 1e3), WEEK, 14, 0.8, LAT, LON, ALT, 20.0, 90.0, 0, 0, 1)
        rows.append(("GPS", (round((boot + SHORTEST) * 1e6), *fix)))
    row = (0, 7, round((TOW + 4.0) * 1e3), WEEK, LAT, LON, ALT, 80.0, ALT, 0, 0, 0)
    rows.append(("CAM", (round((5004.0 - wrap) * 1e6), *row)))
    logs = read_dataflash(write_binary(tmp_path / "wrap.bin", rows))
    (event,) = logs.events
    assert event.time[0] % 604800 == pytest.approx(TOW + 4.0 - SHORTEST, abs=1e-3)
    assert any("wrapped" in d for d in logs.doubts)


@pytest.mark.parametrize(("pin", "kind"), [(-1, "trigger"), (54, "feedback")])
def test_cam_without_feedback_pin_is_a_command(tmp_path: Path, pin: int, kind: str) -> None:
    rows = [m for m in Flight(duration=30.0).messages(np.random.default_rng(3)) if m[0] != "TRIG"]
    path = write_binary(tmp_path / "pin.bin", [("PARM", (1, "CAM1_FEEDBAK_PIN", pin)), *rows])
    (event,) = read_dataflash(path).events
    assert event.kind == kind


def test_second_boot_in_one_file_is_named_and_the_longest_kept(tmp_path: Path) -> None:
    short = Flight(duration=20.0, camera=False).messages(np.random.default_rng(3))
    long = Flight(duration=50.0, camera=False).messages(np.random.default_rng(4))
    logs = read_dataflash(write_binary(tmp_path / "two.bin", [*short, *long]))
    assert logs.imu is not None
    assert len(logs.imu) == 2500
    assert any("starts anew 1 time" in d for d in logs.doubts)


def test_cut_off_log_is_read_up_to_the_cut(tmp_path: Path) -> None:
    path = write_binary(tmp_path / "cut.bin", Flight().messages(np.random.default_rng(3)))
    whole = read_dataflash(path)
    path.write_bytes(path.read_bytes()[:-100_007])
    logs = read_dataflash(path)
    assert logs.imu is not None
    assert whole.imu is not None
    assert 1000 < len(logs.imu) < len(whole.imu)


@pytest.mark.parametrize(
    "content",
    [b"", b"\xa3\x95\x80", b"\xa3\x95" + bytes(range(256)) * 40, b"FMT, 128, 89, FMT, BBnNZ\n"],
    ids=["empty", "header only", "garbage", "text stump"],
)
def test_garbage_is_one_clear_error(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "bad.bin"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"bad\.bin") as caught:
        read_dataflash(path)
    assert "\n" not in str(caught.value)


def test_missing_package_is_named_with_its_cure(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "pymavlink", None)
    path = write_binary(tmp_path / "a.bin", [])
    with pytest.raises(InputError, match=r"pip install georef-gis\[logs\]"):
        read_dataflash(path)


@pytest.mark.slow
def test_twenty_minutes_are_read_in_seconds(tmp_path: Path) -> None:
    rows = Flight(duration=1200.0, imu_rate=50.0, instances=2).messages(np.random.default_rng(3))
    path = write_binary(tmp_path / "long.bin", rows)
    start = time.process_time()
    logs = read_dataflash(path)
    # CPU s; 0.3 measured, so that only a message-by-message reader fails
    assert time.process_time() - start < 5.0
    assert logs.imu is not None
    assert len(logs.imu) == 60_000
