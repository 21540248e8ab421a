"""DJI time marks: a real file, and lines as other drones and damage make them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from georef_gis.errors import InputError
from georef_gis.ingest.logs.mrk import (
    fix_of_status,
    looks_like_mrk,
    read_mrk,
    read_mrk_offsets,
)
from georef_gis.model.logs import FIX_DGNSS, FIX_FIXED, FIX_FLOAT, FIX_NONE, FIX_SINGLE
from georef_gis.units import GPS_WEEK

NAME = "100_0001_Timestamp.MRK"


def line(
    sequence: int = 2,
    tow: float = 296288.242869,
    week: str = "[2211]",
    place: str = "47.6436873208,Lat\t16.4759271684,Lon",
    status: int = 50,
) -> str:
    return (
        f"{sequence}\t{tow:.6f}\t{week}\t     3,N\t    -1,E\t    75,V\t{place}\t512.998,Ellh\t"
        f"0.014391, 0.013698, 0.029694\t{status},Q\r\n"
    )


@pytest.fixture
def write(tmp_path: Path):
    def put(text: str | bytes, name: str = NAME) -> Path:
        path = tmp_path / name
        path.write_bytes(text.encode() if isinstance(text, str) else text)
        return path

    return put


def test_line_holds_what_it_says(write) -> None:
    (log,) = read_mrk(write(line())).events
    assert (log.kind, log.position_of, log.height_kind) == ("feedback", "camera", "ellipsoidal")
    assert log.time[0] == pytest.approx(2211 * GPS_WEEK + 296288.242869, abs=1e-6)
    assert np.degrees([log.lat[0], log.lon[0]]) == pytest.approx(
        [47.6436873208, 16.4759271684], abs=1e-11
    )
    assert log.height[0] == 512.998
    assert np.sqrt(np.diag(log.covariance_ned[0])) == pytest.approx([0.014391, 0.013698, 0.029694])
    assert (log.sequence[0], log.flags[0]) == (2, 50)
    assert log.doubts == ()


def test_letters_decide_what_is_latitude(write) -> None:
    (log,) = read_mrk(write(line(place="16.4759271684,Lon\t47.6436873208,Lat"))).events
    assert np.degrees(log.lat[0]) == pytest.approx(47.6436873208, abs=1e-11)


def test_without_letters_the_file_is_refused(write) -> None:
    with pytest.raises(InputError, match="cannot be told apart"):
        read_mrk(write(line(place="47.6436873208,\t16.4759271684,")))


def test_offsets_run_from_the_antenna_down_to_the_sensor(write) -> None:
    offsets = read_mrk_offsets(write(line() + line(4, 296290.0)))
    assert offsets.offset_ned == pytest.approx(np.array([[0.003, -0.001, 0.075]] * 2), abs=1e-12)
    assert offsets.sequence.tolist() == [2, 4]
    # offsets and marks belong together by time
    assert (
        offsets.time.tolist() == read_mrk(write(line() + line(4, 296290.0))).events[0].time.tolist()
    )


def test_offsets_of_a_yuneec_file_are_turned_round(write) -> None:
    path = write(line().replace("75,V", "-75,V"), "PPKTimestamp.txt")
    assert read_mrk_offsets(path).offset_ned[0, 2] == pytest.approx(0.075)
    assert any("Yuneec" in d for d in read_mrk(path).doubts)


def test_places_may_be_read_as_the_antennas(write) -> None:
    (log,) = read_mrk(write(line()), position_of="antenna").events
    assert log.position_of == "antenna"


def test_gaps_of_the_counter_stay(write) -> None:
    text = "".join(line(n, 296288.0 + n) for n in (2, 3, 7, 8))
    assert read_mrk(write(text)).events[0].sequence.tolist() == [2, 3, 7, 8]


@pytest.mark.parametrize("week", ["2211", "[ 2211 ]"])
def test_week_is_read_in_other_forms(write, week: str) -> None:
    (log,) = read_mrk(write(line(week=week))).events
    assert log.scale == "gps"
    assert log.time[0] // GPS_WEEK == 2211


def test_missing_week_is_asked_for(write) -> None:
    text = line(1, 604799.0, week="") + line(2, 1.5, week="")
    (log,) = read_mrk(write(text)).events
    assert log.scale == "boot"
    assert log.time == pytest.approx([604799.0, 604801.5])
    assert any("no GPS week" in d for d in log.doubts)
    (given_week,) = read_mrk(write(text), week=2211).events
    assert given_week.scale == "gps"
    assert given_week.time - 2211 * GPS_WEEK == pytest.approx([604799.0, 604801.5])


@pytest.mark.parametrize(
    ("status", "fix"),
    [
        (0, FIX_NONE), (16, FIX_SINGLE), (17, FIX_DGNSS), (34, FIX_FLOAT), (49, FIX_FLOAT),
        (50, FIX_FIXED), (52, FIX_FIXED), (-1, FIX_NONE),
    ],
)  # fmt: skip
def test_status_becomes_a_fix(status: int, fix: int) -> None:
    assert fix_of_status(status) == fix


def test_exposures_that_are_not_fixed_are_counted(write) -> None:
    text = line(1, 10.0) + line(2, 11.0, status=34) + line(3, 12.0, status=16)
    logs = read_mrk(write(text))
    assert logs.events[0].flags.tolist() == [50, 34, 16]
    assert any(
        "2 of 3 exposures have no fixed solution (status 16: 1, status 34: 1)" in d
        for d in logs.doubts
    )


def test_exposure_without_a_place_keeps_its_time(write) -> None:
    text = (
        line(1, 10.0)
        + line(2, 11.0, place="0.0,Lat\t0.0,Lon")
        + line(3, 12.0, place="nan,Lat\t1,Lon")
    )
    (log,) = read_mrk(write(text)).events
    assert len(log) == 3
    assert np.isnan(log.lat).tolist() == [False, True, True]
    assert np.isnan(log.covariance_ned[1, 0, 0])
    assert any("2 of 3 exposures have no place" in d for d in log.doubts)


def test_lines_never_filled_and_cut_ones_are_left_out_and_named(write) -> None:
    text = line(1, 10.0) + line(2, 0.0) + line(3, 12.0) + line(4, 13.0)[:40]
    (log,) = read_mrk(write(text)).events
    assert log.sequence.tolist() == [1, 3]
    assert any("2 of 4 lines cannot be read (first: line 2)" in d for d in log.doubts)


def test_time_that_goes_back_is_said(write) -> None:
    logs = read_mrk(write(line(1, 100.0) + line(2, 90.0)))
    assert logs.events[0].sequence.tolist() == [1, 2]
    assert any("two flights" in d for d in logs.doubts)


def test_real_file_is_read_whole(data: Path) -> None:
    path = data / "numbers/rtk_mrk/101FTASK_Timestamp.mrk"
    logs = read_mrk(path)
    (log,) = logs.events
    assert looks_like_mrk(path.read_bytes()[:4096], path)
    assert log.sequence.tolist() == list(range(2, 178))
    assert logs.doubts == ()
    assert np.all(np.diff(log.time) > 1.0)
    # 176 photos over a field of some 100 m, the control points beside it at 460 m
    assert np.ptp(log.lat) * 6.37e6 < 300.0
    assert 40.0 < np.median(log.height) - 461.0 < 60.0
    offsets = read_mrk_offsets(path).offset_ned
    # the antenna of the Phantom 4 RTK is 7 to 8 cm above the sensor
    assert np.all((offsets[:, 2] > 0.06) & (offsets[:, 2] < 0.09))


@pytest.mark.parametrize(
    "data",
    [b"", b"\0" * 300, b"hello\n", bytes(range(256)) * 4, line(2, 0.0).encode()],
    ids=["empty", "zeros", "text", "binary", "never-filled"],
)
def test_useless_files_are_refused_by_name(write, data: bytes) -> None:
    with pytest.raises(InputError, match=r"Timestamp\.MRK"):
        read_mrk(write(data))
    assert not looks_like_mrk(data[:20], Path(NAME))


@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_any_damage_is_a_clear_error_or_a_log(write, data: st.DataObject) -> None:
    text = "".join(line(n, 296288.0 + n) for n in range(3)).encode()
    at = data.draw(st.integers(0, len(text) - 1))
    junk = data.draw(st.binary(max_size=30))
    path = write(text[:at] + junk + text[at + len(junk) // 2 :])
    try:
        (log,) = read_mrk(path).events
    except InputError:
        return
    assert np.all(np.isfinite(log.time))
