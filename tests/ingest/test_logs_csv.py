"""Text logs with columns: times, layouts, what they hold, and planted mistakes."""

from __future__ import annotations

import math
import time as clock
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from georef_gis.errors import InputError
from georef_gis.geodesy import HeightKind
from georef_gis.ingest.logs.column_map import ColumnMap
from georef_gis.ingest.logs.csv_log import read_csv_log
from georef_gis.ingest.logs.text_times import resolve_week, unwrap_counter, unwrap_week
from georef_gis.model.logs import FIX_DGNSS, FIX_FIXED, FIX_FLOAT, FIX_NONE, FIX_SINGLE
from georef_gis.units import GPS_WEEK, gps_from_utc, gps_from_week

IMU = "gyro_x_rad_s,gyro_y_rad_s,gyro_z_rad_s,accel_x_m_s2,accel_y_m_s2,accel_z_m_s2"
SAMPLE = "0.1,0.2,0.3,0.4,0.5,-9.8"
PLACE = "lat_deg,lon_deg,height_ellipsoidal_m"
HERE = "39.6,-80.0,300.5"


@pytest.fixture
def read(tmp_path: Path):
    def of(text: str | bytes, *maps: str):
        path = tmp_path / "log.csv"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return read_csv_log(path, ColumnMap.from_strings(maps))

    return of


def _rows(head: str, row, count: int = 20) -> str:
    return head + "\n" + "".join(row(i) + "\n" for i in range(count))


# --- times -------------------------------------------------------------------------------------

GPS_2026 = gps_from_utc(datetime(2026, 6, 30, 12, tzinfo=UTC))
UNIX_2026 = datetime(2026, 6, 30, 12, tzinfo=UTC).timestamp()
WEEK, TOW = int(GPS_2026 // GPS_WEEK), GPS_2026 % GPS_WEEK
CLOCKS = {
    "gps_week,tow_s": lambda i: f"{WEEK},{TOW + i * 0.2:.3f}",
    "week,iTOW": lambda i: f"{WEEK},{TOW * 1e3 + i * 200:.0f}",
    "utc": lambda i: f"2026-06-30T12:00:{i * 0.2:06.3f}Z",
    "utc_time": lambda i: f"2026-06-30 14:00:{i * 0.2:06.3f}+02:00",
    "date,time": lambda i: f"2026-06-30,12:00:{i * 0.2:06.3f}",
    "unix_s": lambda i: f"{UNIX_2026 + i * 0.2:.3f}",
    "unix_time": lambda i: f"{(UNIX_2026 + i * 0.2) * 1e6:.0f}",
    "timestamp": lambda i: f"{(UNIX_2026 + i * 0.2) * 1e3:.0f}",
    "gps_time_s": lambda i: f"{GPS_2026 + i * 0.2:.3f}",
}


@pytest.mark.parametrize("head", CLOCKS, ids=lambda h: h.replace(",", "+"))
def test_every_absolute_clock_gives_the_same_gps_time(read, head: str) -> None:
    logs = read(_rows(f"{head},{PLACE}", lambda i: f"{CLOCKS[head](i)},{HERE}"))
    assert logs.gnss.scale == "gps"
    # s: text to a millisecond, double precision at 1.5e9 s
    assert logs.gnss.time == pytest.approx(GPS_2026 + 0.2 * np.arange(20), abs=1e-6)


@pytest.mark.parametrize(
    ("head", "step"),
    [("time_s", "0.01"), ("millis", "10"), ("boot_us", "10000"), ("time", "0.01"), ("time", "10"),
     ("t", "10000"), ("TimeUS", "10000")],
)  # fmt: skip
def test_boot_clock_is_read_in_its_unit(read, head: str, step: str) -> None:
    text = _rows(f"{head},{IMU}", lambda i: f"{float(step) * i:.2f},{SAMPLE}")
    imu = read(text).imu
    assert imu.scale == "boot"
    assert imu.time == pytest.approx(0.01 * np.arange(20), abs=1e-9)


def test_clock_whose_unit_cannot_be_told_is_an_error_that_says_how_to_map(read) -> None:
    text = _rows(f"time,{PLACE}", lambda i: f"{i * 100000000000},{HERE}")
    with pytest.raises(InputError, match=r"log\.csv: time: the unit .* --map 'time = time:ms'"):
        read(text)


@given(st.integers(1100, 2700), st.integers(0, 3_500_000))
def test_ten_bits_of_a_week_are_restored_by_a_date(week: int, seconds: int) -> None:
    date = datetime.fromtimestamp(UNIX_2026, UTC)
    near = WEEK - 400 + week % 800
    restored, turns = resolve_week(np.array([float(near % 1024)] * 3), date)
    assert restored[0] == near
    assert turns == near // 1024


def test_ten_bits_of_a_week_without_a_date_are_the_latest_past(read) -> None:
    old = WEEK - 1024
    logs = read(_rows(f"gps_week,tow_s,{PLACE}", lambda i: f"{WEEK % 1024},{i},{HERE}"))
    now = gps_from_utc(datetime.now(UTC))
    assert logs.gnss.time[0] % (1024 * GPS_WEEK) == gps_from_week(old, 0.0) % (1024 * GPS_WEEK)
    assert 0.0 <= now - logs.gnss.time[0] < 1024 * GPS_WEEK
    assert "rolled over" in " ".join(logs.doubts)


def test_whole_week_is_left_alone_without_a_date(read) -> None:
    logs = read(_rows(f"gps_week,tow_s,{PLACE}", lambda i: f"1536,{i},{HERE}"))
    assert logs.gnss.time[0] == gps_from_week(1536, 0.0)


@pytest.mark.parametrize("head", ["tow_s", "gps_week,tow_s"])
def test_turn_of_the_week_is_no_jump(read, head: str) -> None:
    stale = "2000," if "week" in head else ""
    logs = read(_rows(f"{head},{PLACE}", lambda i: f"{stale}{(604790 + i) % 604800},{HERE}"))
    assert np.all(np.diff(logs.gnss.time) == 1.0)


def test_turn_of_the_week_with_a_late_line() -> None:
    tow = np.array([604799.0, 0.0, 604799.5, 1.0, np.nan, 2.0])
    expected = [604799.0, 604800.0, 604799.5, 604801.0, np.nan, 604802.0]
    assert unwrap_week(tow) == pytest.approx(expected, nan_ok=True)


def test_time_of_week_finds_its_week_by_the_date(read) -> None:
    text = _rows(f"tow_s,{PLACE}", lambda i: f"{TOW + i:.3f},{HERE}")
    assert read(text, "date=2026-06-30").gnss.time[0] == pytest.approx(GPS_2026, abs=1e-3)
    without = read(text)
    assert without.gnss.time[0] == pytest.approx(TOW, abs=1e-3)
    assert "no week" in " ".join(without.doubts)


def test_zeros_before_the_first_week_do_not_move_the_rest(read) -> None:
    text = _rows(f"gps_week,tow_s,{PLACE}", lambda i: f"{2400 if i > 4 else 0},{i},{HERE}")
    logs = read(text)
    assert logs.gnss.time[0] == gps_from_week(2400, 5.0)
    assert "5 rows have week 0" in " ".join(logs.doubts)


def test_wrapped_microseconds_go_on() -> None:
    raw = np.array([2.0**32 - 20000, 2.0**32 - 10000, 0.0, 10000.0])
    assert np.all(np.diff(unwrap_counter(raw)) == 10000.0)


def test_time_of_day_runs_over_midnight_with_a_date(read) -> None:
    text = _rows(f"utc,{PLACE}", lambda i: f"{'23:59' if i < 10 else '00:00'}:{50 + i if i < 10 else i - 10},{HERE}")  # fmt: skip  # noqa: E501
    text = text.replace("00:00:", "00:00:0")
    logs = read(text, "date=2026-06-30")
    start = gps_from_utc(datetime(2026, 6, 30, 23, 59, 50, tzinfo=UTC))
    assert logs.gnss.time == pytest.approx(start + np.arange(20), abs=1e-6)
    with pytest.raises(InputError, match="has no date"):
        read(text)


# --- layouts -----------------------------------------------------------------------------------

PLAIN = _rows(f"time_s,{IMU}", lambda i: f"{i * 0.01:.2f},{SAMPLE}")
LAYOUTS = {
    "plain": PLAIN.encode(),
    "semicolon": PLAIN.replace(",", ";").encode(),
    "semicolon, decimal comma": PLAIN.replace(",", ";").replace(".", ",").encode(),
    "tab": PLAIN.replace(",", "\t").encode(),
    "tab, decimal comma": PLAIN.replace(",", "\t").replace(".", ",").encode(),
    "blanks": PLAIN.replace(",", "   ").encode(),
    "blanks, decimal comma": PLAIN.replace(",", " ").replace(".", ",").encode(),
    "comma and blank": PLAIN.replace(",", ", ").encode(),
    "BOM and CR LF": b"\xef\xbb\xbf" + PLAIN.replace("\n", "\r\n").encode(),
    "UTF-16": PLAIN.encode("utf-16"),
    "quoted": "\n".join(
        ",".join(f'"{c}"' for c in line.split(",")) for line in PLAIN.splitlines()
    ).encode(),
    "preamble": b"Logger 5, version 2\nserial,123\n\n" + PLAIN.encode(),
    "comments": b"# made by a logger\n# rate: 100\n" + PLAIN.encode(),
    "header as comment": b"# " + PLAIN.encode(),
    "comment amid": PLAIN.replace("0.05,", "# note\n0.05,", 1).encode(),
    "line of units": PLAIN.replace("_rad_s", "").replace("_m_s2", "").replace(
        "\n", "\ns,rad/s,rad/s,rad/s,m/s2,m/s2,m/s2\n", 1).encode(),
    "delimiter at the end": PLAIN.replace("\n", ",\n").encode(),
}  # fmt: skip


@pytest.mark.parametrize("layout", LAYOUTS)
def test_layout_does_not_change_the_values(read, layout: str) -> None:
    imu = read(LAYOUTS[layout]).imu
    assert imu.time == pytest.approx(0.01 * np.arange(20), abs=1e-12)
    assert imu.gyro == pytest.approx(np.tile([0.1, 0.2, 0.3], (20, 1)), abs=1e-12)
    assert imu.accel == pytest.approx(np.tile([0.4, 0.5, -9.8], (20, 1)), abs=1e-12)


def test_header_repeated_by_a_restarted_logger_is_passed(read) -> None:
    logs = read(PLAIN + PLAIN.splitlines()[0] + "\n" + f"0.20,{SAMPLE}\n")
    assert len(logs.imu) == 21
    assert logs.imu.gyro[-1] == pytest.approx([0.1, 0.2, 0.3])
    assert "not numbers" in " ".join(logs.doubts)


def test_cut_last_line_is_left_out(read) -> None:
    for cut in (3, 15):
        logs = read(PLAIN[:-cut])
        assert len(logs.imu) == 19
        assert "cut short" in " ".join(logs.doubts)
    assert len(read(PLAIN[:-1]).imu) == 20


def test_line_with_too_many_cells_is_counted(read) -> None:
    logs = read(PLAIN.replace("0.05,", "0.05,9,9,9,", 1))
    assert len(logs.imu) == 19
    assert "1 of 20 lines have too many cells" in " ".join(logs.doubts)


def test_nan_infinity_and_words_are_missing_values(read) -> None:
    lines = PLAIN.splitlines()
    lines[3] = lines[3].replace("0.1,", "NaN,")
    lines[4] = lines[4].replace("0.1,", "inf,")
    lines[5] = lines[5].replace("0.1,", "ERR,")
    lines[6] = "," + lines[6].partition(",")[2]
    logs = read("\n".join(lines) + "\n")
    assert len(logs.imu) == 19
    assert np.isnan(logs.imu.gyro[2:5, 0]).all()
    assert np.isfinite(logs.imu.gyro[:, 1:]).all()
    said = " ".join(logs.doubts)
    assert all(w in said for w in ("1 infinite", "not numbers, such as 'ERR'", "1 of 20 rows"))


# --- what a table holds --------------------------------------------------------------------------


def test_files_of_the_contract_need_no_mapping() -> None:
    folder = Path(__file__).parents[2] / "sample_project" / "logs"
    imu = read_csv_log(folder / "imu.csv")
    gnss = read_csv_log(folder / "gnss.csv")
    first = np.loadtxt(folder / "gnss.csv", delimiter=",", skiprows=1, max_rows=1)
    row = np.loadtxt(folder / "imu.csv", delimiter=",", skiprows=1, max_rows=1)
    assert imu.imu is not None and gnss.gnss is not None  # noqa: PT018
    assert imu.imu.time[0] == pytest.approx(row[0] * GPS_WEEK + row[1], abs=1e-6)
    assert [*imu.imu.gyro[0], *imu.imu.accel[0]] == pytest.approx(list(row[2:]))
    fix = gnss.gnss
    assert (math.degrees(fix.lat[0]), math.degrees(fix.lon[0])) == pytest.approx(tuple(first[2:4]))
    assert (fix.height[0], fix.height_kind) == (first[4], HeightKind.ELLIPSOIDAL)
    assert list(fix.v_ned[0]) == list(first[5:8])
    assert np.diag(fix.covariance_ned[0]) == pytest.approx(first[8:11] ** 2)
    assert np.diag(fix.covariance_v_ned[0]) == pytest.approx(first[11:14] ** 2)
    assert fix.fix[0] == FIX_SINGLE
    assert imu.doubts == () and gnss.doubts == ()  # noqa: PT018


def test_headerless_drive_is_read_by_column_numbers(data: Path) -> None:
    path = data / "flight_logs" / "drive_0708" / "imu_1934.csv"
    with pytest.raises(InputError, match=r"7 columns without a header .* --map"):
        read_csv_log(path)
    maps = [f"accel_{a}=#{i}:g" for i, a in enumerate("xyz", 1)]
    maps += [f"gyro_{a}=#{i}:deg/s" for i, a in enumerate("xyz", 4)]
    imu = read_csv_log(
        path, ColumnMap.from_strings([*maps, "time=#7:ms", "axes=back-right-up"])
    ).imu
    assert imu is not None
    assert len(imu) == 54860
    assert imu.time[0] == pytest.approx(261.906)
    # m/s2: a parked car stands on the Earth; 3 % of scale error of a cheap sensor
    assert np.median(np.linalg.norm(imu.accel, axis=1)) == pytest.approx(9.81, rel=0.03)
    assert np.median(imu.accel[:, 2]) < -9.0


def test_units_of_the_header_are_converted(read) -> None:
    head = "millis,gx[deg/s],gy[deg/s],gz[deg/s],ax[g],ay[g],az[g]"
    imu = read(_rows(head, lambda i: f"{i * 10},90,0,-90,0,0.5,-1")).imu
    assert imu.gyro[0] == pytest.approx([math.pi / 2, 0.0, -math.pi / 2])
    assert imu.accel[0] == pytest.approx([0.0, 4.903325, -9.80665])


def test_axes_turn_rates_and_forces_together(read) -> None:
    imu = read(PLAIN, "axes=forward-left-up").imu
    assert imu.gyro[0] == pytest.approx([0.1, -0.2, -0.3])
    assert imu.accel[0] == pytest.approx([0.4, -0.5, 9.8])


def test_rates_without_a_unit_are_refused_by_name(read) -> None:
    text = _rows("time_s,gx,gy,gz,ax,ay,az", lambda i: f"{i * 0.01:.2f},1,2,3,0,0,-1")
    with pytest.raises(InputError, match=r"gx, gy, gz: no unit .*--map 'gyro_x = gx:deg/s'"):
        read(text)
    maps = [f"gyro_{a}=g{a}:deg/s" for a in "xyz"]
    assert read(text, *maps).imu.accel[0] == pytest.approx([0.0, 0.0, -9.80665])


def test_swapped_latitude_and_longitude_are_named(read) -> None:
    text = _rows("time_s,lat,lon,height_ellipsoidal_m", lambda i: f"{i},-105.1,40.0,1600")
    with pytest.raises(InputError, match="swapped"):
        read(text)
    fixed = read(text, "lat=lon:deg", "lon=lat:deg").gnss
    assert math.degrees(fixed.lon[0]) == pytest.approx(-105.1)


def test_heights_keep_their_kind_and_the_separation(read) -> None:
    head = "time_s,lat_deg,lon_deg,height_ellipsoidal_m,alt_msl_ft"
    gnss = read(_rows(head, lambda i: f"{i},39.6,-80,270.0,1000")).gnss
    assert gnss.height_kind is HeightKind.ELLIPSOIDAL
    assert gnss.geoid_separation[0] == pytest.approx(270.0 - 304.8)
    gnss = read(_rows("time_s,lat_deg,lon_deg,alt_msl_ft", lambda i: f"{i},39.6,-80,1000")).gnss
    assert (gnss.height[0], gnss.height_kind) == (pytest.approx(304.8), HeightKind.ORTHOMETRIC)


def test_speed_without_a_unit_is_told_by_the_fixes(read) -> None:
    def row(i: int) -> str:
        lat = 39.6 + math.degrees(20.0 * i * 0.2 / 6371000.0)
        return f"{i * 0.2:.1f},{lat:.9f},-80.0,300,{20 / 0.44704:.3f},0.0,-1.5"

    logs = read(_rows("time_s,lat,lon,height_ellipsoidal_m,speed,course,climb_m_s", row, 60))
    # m/s: the sphere of the check and three decimals
    assert logs.gnss.v_ned[0] == pytest.approx([20.0, 0.0, 1.5], abs=1e-3)
    assert "mph by the distance" in " ".join(logs.doubts)


@pytest.mark.parametrize(
    ("head", "cells", "codes"),
    [
        ("fix", "0 3 7", [FIX_NONE, FIX_SINGLE, FIX_FIXED]),
        ("fix", "none 3D RTK_float", [FIX_NONE, FIX_SINGLE, FIX_FLOAT]),
        ("rtklib_quality", "5 1 2", [FIX_SINGLE, FIX_FIXED, FIX_FLOAT]),
        ("nmea_quality", "1 2 4", [FIX_SINGLE, FIX_DGNSS, FIX_FIXED]),
    ],
)
def test_codes_of_a_fix(read, head: str, cells: str, codes: list[int]) -> None:
    words = cells.split()
    gnss = read(_rows(f"time_s,{PLACE},{head}", lambda i: f"{i},{HERE},{words[i % 3]}", 9)).gnss
    assert gnss.fix[:3].tolist() == codes


def test_zero_sigmas_are_unknown(read) -> None:
    gnss = read(_rows(f"time_s,{PLACE},sigma_north_m,sigma_east_m,sigma_down_m",
                      lambda i: f"{i},{HERE},0,1,2")).gnss  # fmt: skip
    assert np.isnan(gnss.covariance_ned[0, 0, 0])
    assert gnss.covariance_ned[0, 2, 2] == 4.0


def test_samples_between_fixes_are_timed_by_the_loggers_clock(read) -> None:
    # 5 Hz fixes repeated beside 100 Hz samples, noted 60 ms late by a clock 20 ppm fast
    def row(i: int) -> str:
        now = 100.0 + i * 0.01
        epoch = math.floor((now - 0.06) / 0.2 + 1e-9) * 0.2
        lat = 39.6 + epoch * 1e-5
        return f"{now * 1e3 * (1 + 2e-5):.3f},2400,{epoch:.1f},{lat:.7f},-80,300,{SAMPLE}"

    logs = read(_rows(f"millis,gps_week,tow_s,{PLACE},{IMU}", row, 20000))
    assert (len(logs.imu), logs.imu.scale) == (20000, "gps")
    assert len(logs.gnss) == pytest.approx(1000, abs=2)
    late = gps_from_week(2400, 0.0) + 100.0 + 0.01 * np.arange(20000) - logs.imu.time
    # s: the delay of the fixes stays, one sample of rounding comes on top, the drift is gone
    assert late == pytest.approx(0.06, abs=0.012)
    assert "logger's clock" in " ".join(logs.doubts)


def test_attitude_and_aids_are_read(read) -> None:
    head = "time_s,roll_deg,pitch_deg,yaw_deg,sigma_yaw_deg,baro_alt_ft,airspeed_kn,mx,my,mz"
    logs = read(_rows(head, lambda i: f"{i * 0.1:.1f},10,-5,350,1,100,40,1,2,3"))
    assert np.degrees(logs.attitude.rpy[0]) == pytest.approx([10.0, -5.0, 350.0])
    assert math.degrees(logs.attitude.sigma_rpy[0, 2]) == pytest.approx(1.0)
    values = {a.kind: a.value[0] for a in logs.aids}
    assert values["baro_height"] == pytest.approx(30.48)
    assert values["airspeed"] == pytest.approx(40 * 1852 / 3600)
    assert list(values["magnetic_field"]) == [1.0, 2.0, 3.0]


def test_angles_too_small_for_degrees_are_refused(read) -> None:
    with pytest.raises(InputError, match="roll, pitch, yaw: no unit"):
        read(_rows("time_s,roll,pitch,yaw", lambda i: f"{i * 0.1:.1f},0.1,0.05,3.0"))


def test_events_with_names_and_counters(read) -> None:
    head = "gps_week,tow_s,event,photo,sigma_time_ms,flags"
    (events,) = read(_rows(head, lambda i: f"2400,{i},{i + 7},IMG_{i}.JPG,2,1", 5)).events
    assert (events.kind, events.scale) == ("feedback", "gps")
    assert events.sequence.tolist() == [7, 8, 9, 10, 11]
    assert events.names[2] == "IMG_2.JPG"
    assert (events.sigma[0], events.flags[0]) == (pytest.approx(0.002), 1)
    (events,) = read(
        _rows(head, lambda i: f"2400,{i},{i},A{i}.JPG,2,1", 5), "events=trigger"
    ).events
    assert events.kind == "trigger"


def test_row_without_time_of_an_event_is_kept(read) -> None:
    (events,) = read("time_s,event\n1.5,1\n,2\n4.5,3\n6,4\n").events
    assert events.sequence.tolist() == [1, 2, 3, 4]
    assert np.isnan(events.time[1])


# --- what is refused ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "maps", "words"),
    [
        ("", (), "is empty"),
        ("just words\nand more\n", (), "no rows of numbers"),
        ("\x00\x01\x02" * 500, (), "not a text file"),
        ("a,b,c\n1,2,3\n4,5,6\n", (), "hold no IMU"),
        (f"{IMU}\n{SAMPLE}\n{SAMPLE}\n", (), "no column of time"),
        (PLAIN, ("time=clock:s",), r"no column 'clock'; columns are time_s"),
        (PLAIN, ("time=#9:s",), r"no column '#9'"),
        (PLAIN.replace("gyro_x", "time2"), (), "accelerations but no rates|hold no IMU"),
        (PLAIN.replace("gyro_x_rad_s", "gps_lat").replace("gyro_y_rad_s", "latitude")
         .replace("gyro_z_rad_s", "lon"), ("time=time_s:s",), "hold no IMU"),
    ],
)  # fmt: skip
def test_unfit_text_is_refused_in_one_line(read, text: str, maps: tuple[str, ...], words) -> None:
    with pytest.raises(InputError, match=words) as caught:
        read(text, *maps)
    assert "log.csv" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_two_columns_that_may_both_be_the_time_are_named(read) -> None:
    text = _rows(f"stamp,clock,{IMU}", lambda i: f"{i},{i},{SAMPLE}")
    with pytest.raises(InputError, match=r"2 columns may be time: stamp, clock; .*--map"):
        read(text)


@pytest.mark.slow
def test_hour_of_samples_is_read_in_a_second_and_a_half(read) -> None:
    values = np.random.default_rng(3).normal(0.0, 1.0, (1000, 6)).round(6)
    cells = [",".join(f"{v:.6f}" for v in row) for row in values]
    lines = [f"2400,{400000 + i // 100}.{i % 100:02d},{cells[i % 1000]}" for i in range(360_000)]
    text = f"gps_week,tow_s,{IMU}\n" + "\n".join(lines) + "\n"
    read(PLAIN)
    start = clock.process_time()
    logs = read(text)
    assert clock.process_time() - start < 1.5
    assert len(logs.imu) == 360_000
    assert np.array_equal(logs.imu.gyro, np.tile(values[:, :3], (360, 1)))


def test_numbers_too_large_for_a_counter_are_missing(read) -> None:
    (events,) = read(_rows("time_s,event,flags", lambda i: f"{i},{'9' * 40},1e30", 5)).events
    assert set(events.sequence.tolist()) == set(events.flags.tolist()) == {-1}


def test_cells_beyond_the_header_are_doubted(read) -> None:
    text = PLAIN.splitlines()
    logs = read("\n".join([text[0], *(f"{row},7" for row in text[1:])]) + "\n")
    assert logs.imu.accel[0] == pytest.approx([0.4, 0.5, -9.8])
    logs = read("\n".join([text[0], *(f"{row},7,8" for row in text[1:])]) + "\n", *(
        f"{k}_{a}=#{i}:{u}" for k, n, u in (("gyro", 2, "rad/s"), ("accel", 5, "m/s2"))
        for i, a in enumerate("xyz", n)
    ), "time=#1:s")  # fmt: skip
    assert logs.imu.accel[0] == pytest.approx([0.4, 0.5, -9.8])
