"""NMEA logs: sentences written here, checksums by hand, times against the calendar."""

from __future__ import annotations

import math
from datetime import UTC, datetime, timedelta
from functools import reduce
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from georef_gis.errors import InputError
from georef_gis.ingest.logs.nmea import looks_like_nmea, read_nmea
from georef_gis.model.logs import FIX_DGNSS, FIX_FIXED, FIX_FLOAT, FIX_SINGLE
from georef_gis.units import gps_from_utc

KNOT = 0.514444444444  # m/s


def sentence(body: str) -> str:
    check = reduce(lambda a, c: a ^ ord(c), body, 0)
    return f"${body}*{check:02X}\r\n"


def gga(clock: str, *, quality: int = 4, lat: str = "4000.00000,N", talker: str = "GN") -> str:
    lon = "08230.00000,W"
    return sentence(f"{talker}GGA,{clock},{lat},{lon},{quality},15,0.7,301.25,M,-33.50,M,1.0,0000")


def rmc(clock: str, date: str, *, speed: str = "10.00", course: str = "090.0") -> str:
    place = "4000.00000,N,08230.00000,W"
    return sentence(f"GNRMC,{clock},A,{place},{speed},{course},{date},,,R")


@pytest.fixture
def write(tmp_path: Path):
    def put(text: str | bytes, name: str = "flight.nmea") -> Path:
        path = tmp_path / name
        path.write_bytes(text.encode("latin-1") if isinstance(text, str) else text)
        return path

    return put


def test_one_epoch_holds_what_its_sentences_say(write) -> None:
    text = (
        rmc("123456.20", "040613")
        + gga("123456.20")
        + sentence("GNGST,123456.20,1.0,,,,0.011,0.022,0.033")
    )
    log = read_nmea(write(text)).gnss
    assert log is not None
    # Ohio, 4 June 2013: 16 leap seconds
    assert log.time[0] == pytest.approx(
        gps_from_utc(datetime(2013, 6, 4, 12, 34, 56, 200_000, tzinfo=UTC)), abs=1e-6
    )
    assert np.degrees([log.lat[0], log.lon[0]]) == pytest.approx([40.0, -82.5], abs=1e-12)
    assert (log.height[0], log.geoid_separation[0]) == (301.25, -33.5)
    assert log.height_kind == "orthometric"
    assert log.fix[0] == FIX_FIXED
    assert log.satellites[0] == 15
    assert log.v_ned[0, :2] == pytest.approx([0.0, 10 * KNOT], abs=1e-6)
    assert math.isnan(log.v_ned[0, 2])
    assert np.diag(log.covariance_ned[0]) == pytest.approx([0.011**2, 0.022**2, 0.033**2])
    assert log.doubts == ()


def test_error_ellipse_gives_the_term_north_east(write) -> None:
    # semi-major 0.4 m at azimuth 30 deg, semi-minor 0.1 m
    c, s = math.cos(math.radians(30)), math.sin(math.radians(30))
    axes = np.array([[c, -s], [s, c]])
    truth = axes @ np.diag([0.4**2, 0.1**2]) @ axes.T
    north, east = np.sqrt(np.diag(truth))
    gst = sentence(f"GPGST,120000,1,0.4,0.1,30.0,{north:.4f},{east:.4f},0.5")
    log = read_nmea(write(rmc("120000", "010120") + gga("120000") + gst)).gnss
    assert log is not None
    # 4 decimals of the sigmas
    assert log.covariance_ned[0, :2, :2] == pytest.approx(truth, abs=1e-4)
    assert log.covariance_ned[0, 1, 0] > 0.0


@pytest.mark.parametrize(
    ("quality", "fix"), [(1, FIX_SINGLE), (2, FIX_DGNSS), (4, FIX_FIXED), (5, FIX_FLOAT)]
)
def test_quality_becomes_a_fix(write, quality: int, fix: int) -> None:
    log = read_nmea(write(rmc("120000", "010120") + gga("120000", quality=quality))).gnss
    assert log is not None
    assert log.fix.tolist() == [fix]


@pytest.mark.parametrize("quality", [0, 6, 7])
def test_epochs_without_a_fix_are_left_out_and_counted(write, quality: int) -> None:
    text = rmc("120000", "010120") + gga("120000") + gga("120001", quality=quality)
    logs = read_nmea(write(text))
    assert logs.gnss is not None
    assert len(logs.gnss) == 1
    assert any("1 of 2 epochs have no fix" in d for d in logs.doubts)


def test_time_goes_on_over_midnight_and_before_the_first_date(write) -> None:
    start = datetime(2024, 2, 28, 23, 59, 55, tzinfo=UTC)
    text = ""
    for i in range(10):
        now = start + timedelta(seconds=i)
        # GGA comes first, so that the first epochs and the one at midnight have no date yet
        text += gga(f"{now:%H%M%S}.00")
        if i in (3, 7, 9):
            text += rmc(f"{now:%H%M%S}.00", f"{now:%d%m%y}")
    log = read_nmea(write(text)).gnss
    assert log is not None
    assert log.time == pytest.approx(gps_from_utc(start) + np.arange(10.0), abs=1e-6)


def test_zda_gives_the_date_too(write) -> None:
    text = gga("120000.00", talker="GP") + sentence("GPZDA,120000.00,01,07,2025,00,00")
    log = read_nmea(write(text)).gnss
    assert log is not None
    assert log.time[0] == gps_from_utc(datetime(2025, 7, 1, 12, tzinfo=UTC))


def test_two_flights_in_one_file_keep_their_days(write) -> None:
    text = ""
    for date in ("010724", "030724"):
        for second in range(3):
            text += gga(f"12000{second}") + rmc(f"12000{second}", date)
    log = read_nmea(write(text)).gnss
    assert log is not None
    expected = np.concatenate([np.arange(3.0), 2 * 86400 + np.arange(3.0)])
    assert log.time - log.time[0] == pytest.approx(expected, abs=1e-6)


def test_leap_second_is_a_second_of_its_own(write) -> None:
    text = "".join(
        rmc(clock, date) + gga(clock)
        for clock, date in (("235959", "311216"), ("235960", "311216"), ("000000", "010117"))
    )
    log = read_nmea(write(text)).gnss
    assert log is not None
    assert np.diff(log.time) == pytest.approx([1.0, 1.0], abs=1e-6)


def test_without_any_date_times_are_of_the_day_and_that_is_said(write) -> None:
    logs = read_nmea(write(gga("235959") + gga("000000")))
    assert logs.gnss is not None
    assert logs.gnss.scale == "boot"
    assert logs.gnss.time.tolist() == [86399.0, 86400.0]
    assert any("no sentence has a date" in d for d in logs.doubts)


def test_start_up_date_of_a_receiver_is_not_believed(write) -> None:
    text = rmc("000001", "060180") + gga("000001") + rmc("000002", "040625") + gga("000002")
    log = read_nmea(write(text)).gnss
    assert log is not None
    assert log.time[0] == gps_from_utc(datetime(2025, 6, 4, 0, 0, 1, tzinfo=UTC))


def test_date_of_the_week_roll_over_fault_is_doubted(write) -> None:
    # 2025-06-04 less 1024 weeks
    logs = read_nmea(write(rmc("120000", "191005") + gga("120000")))
    assert any("1024 weeks" in d for d in logs.doubts)


def test_damaged_sentences_are_left_out_and_named_by_line(write) -> None:
    bad = gga("120001").replace("4000.00000", "4100.00000")
    text = rmc("120000", "010120") + gga("120000") + bad + gga("120002") + gga("120003")[:40]
    logs = read_nmea(write(text))
    assert logs.gnss is not None
    assert len(logs.gnss) == 2
    assert np.degrees(logs.gnss.lat) == pytest.approx([40.0, 40.0], abs=1e-12)
    assert any(d.startswith("2 sentences are damaged or cut (first: line 3)") for d in logs.doubts)


def test_sentences_without_checksums_are_read_and_doubted(write) -> None:
    text = "\n".join(
        line.split("*")[0] for line in (rmc("120000", "010120") + gga("120000")).splitlines()
    )
    logs = read_nmea(write(text))
    assert logs.gnss is not None
    assert any("no checksums" in d for d in logs.doubts)


def test_vtg_serves_where_there_is_no_rmc(write) -> None:
    text = (
        gga("120000")
        + sentence("GPVTG,180.0,T,,M,,N,36.0,K,A")
        + sentence("GPZDA,120000,01,07,2025,00,00")
    )
    log = read_nmea(write(text)).gnss
    assert log is not None
    assert log.v_ned[0, :2] == pytest.approx([-10.0, 0.0], abs=1e-9)


def test_speed_without_a_course_is_unknown(write) -> None:
    text = rmc("120000", "010120", speed="0.02", course="") + gga("120000")
    text += rmc("120001", "010120", speed="0.00", course="") + gga("120001")
    log = read_nmea(write(text)).gnss
    assert log is not None
    assert np.all(np.isnan(log.v_ned[0]))
    assert log.v_ned[1, :2].tolist() == [0.0, 0.0]


def test_rmc_alone_is_a_track_without_heights(write) -> None:
    log = read_nmea(write(rmc("120000", "010120") + rmc("120001", "010120"))).gnss
    assert log is not None
    assert len(log) == 2
    assert np.all(np.isnan(log.height))


def test_southern_and_western_hemispheres_have_signs(write) -> None:
    text = rmc("120000", "010120") + gga("120000", lat="3330.00000,S")
    log = read_nmea(write(text)).gnss
    assert log is not None
    assert np.degrees(log.lat[0]) == pytest.approx(-33.5, abs=1e-12)


def test_geoid_separation_of_zero_is_doubted(write) -> None:
    body = "GNGGA,120000,4000.00000,N,08230.00000,W,4,15,0.7,268.25,M,0.0,M,1.0,0000"
    logs = read_nmea(write(rmc("120000", "010120") + sentence(body)))
    assert any("geoid separation is 0 m" in d for d in logs.doubts)


def test_placeholder_and_unfinished_numbers_are_left_out(write) -> None:
    body = "GNGGA,120001,0000.00000,N,00000.00000,E,1,15,0.7,0.0,M,0.0,M,1.0,0000"
    wild = "GNGGA,120002,4000.00000,N,08230.00000,W,1,15,0.7,nan,M,inf,M,1.0,0000"
    text = rmc("120000", "010120") + gga("120000") + sentence(body) + sentence(wild)
    logs = read_nmea(write(text))
    assert logs.gnss is not None
    assert len(logs.gnss) == 1
    assert any("placeholders" in d for d in logs.doubts)
    assert any("no finite time or place" in d for d in logs.doubts)


def test_text_around_sentences_is_skipped(write) -> None:
    text = "[12:00:00.123] " + rmc("120000", "010120") + "boot ok\n>" + gga("120000") + "\x00\xff\n"
    assert read_nmea(write(text)).gnss is not None


@pytest.mark.parametrize(
    "data",
    [b"", b"\0" * 500, b"hello\n", bytes(range(256)) * 20, b"$GNGGA,12", b"$GNGGA,,,,*00\r\n"],
    ids=["empty", "zeros", "text", "binary", "cut", "wrong-checksum"],
)
def test_useless_files_are_refused_by_name(write, data: bytes) -> None:
    with pytest.raises(InputError, match=r"flight\.nmea"):
        read_nmea(write(data))


def test_log_without_a_fix_is_refused(write) -> None:
    with pytest.raises(InputError, match="none of its 1 epochs has a fix"):
        read_nmea(write(sentence("GNGGA,120000,,,,,0,00,99.99,,M,,M,,")))


def test_only_whole_sentences_look_like_nmea(tmp_path: Path) -> None:
    good = gga("120000").encode()
    assert looks_like_nmea(b"noise" + good, tmp_path)
    assert not looks_like_nmea(good.replace(b"4000", b"4001"), tmp_path)
    assert not looks_like_nmea(b"$TSB,1,2300,1.0,100,0*11\r\n", tmp_path)


@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_any_damage_is_a_clear_error_or_a_log(write, data: st.DataObject) -> None:
    text = "".join(rmc(f"12000{i}", "010120") + gga(f"12000{i}") for i in range(4)).encode()
    at = data.draw(st.integers(0, len(text) - 1))
    junk = data.draw(st.binary(max_size=30))
    path = write(text[:at] + junk + text[at + len(junk) // 2 :])
    try:
        log = read_nmea(path).gnss
    except InputError:
        return
    assert log is not None
    assert np.all(np.isfinite(log.time))
