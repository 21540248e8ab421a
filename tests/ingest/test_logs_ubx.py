"""UBX logs: frames packed here field by field, with a checksum of running sums."""

from __future__ import annotations

import struct
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from georef_gis.errors import InputError
from georef_gis.ingest.logs.ubx import looks_like_ubx, read_ubx
from georef_gis.model.logs import FIX_2D, FIX_DGNSS, FIX_FIXED, FIX_FLOAT, FIX_SINGLE
from georef_gis.units import gps_from_utc, week_from_gps

START = datetime(2025, 7, 8, 19, 34, 18, tzinfo=UTC)
LEAP = 18  # s, GPS - UTC in 2025


def frame(kind: tuple[int, int], payload: bytes) -> bytes:
    body = bytes(kind) + struct.pack("<H", len(payload)) + payload
    a = b = 0
    for byte in body:
        a = (a + byte) % 256
        b = (b + a) % 256
    return b"\xb5\x62" + body + bytes((a, b))


def pvt(
    utc: datetime = START,
    *,
    nano: int = 0,
    valid: int = 0b0111,
    fix_type: int = 3,
    flags: int = 0b1000_0001,
    flags3: int = 0,
    itow_ms: int | None = None,
    lat_e7: int = 400966268,
) -> bytes:
    if itow_ms is None:
        itow_ms = round(week_from_gps(gps_from_utc(utc) + nano * 1e-9)[1] * 1e3)
    return frame(
        (0x01, 0x07),
        struct.pack("<IHBBBBBBIi", itow_ms, utc.year, utc.month, utc.day, utc.hour, utc.minute,
                    utc.second, valid, 20, nano)
        + struct.pack("<BBBBiiiiII", fix_type, flags, 0, 21, -1051474483, lat_e7, 1601474, 1617974,
                      14, 10)
        + struct.pack("<iiiiiIIHH", 1500, -2500, 300, 2915, 0, 83, 1800000, 101, flags3)
        + bytes(14),
    )  # fmt: skip


def tm2(
    *,
    flags: int,
    count: int = 7,
    rising: tuple[int, int, int] = (2374, 243275_123, 456_789),
    falling: tuple[int, int, int] = (2374, 243275_223, 111_222),
    acc_ns: int = 25,
    channel: int = 0,
) -> bytes:
    (week_r, ms_r, ns_r), (week_f, ms_f, ns_f) = rising, falling
    return frame(
        (0x0D, 0x03),
        struct.pack("<BBHHHIIIII", channel, flags, count, week_r, week_f, ms_r, ns_r, ms_f, ns_f,
                    acc_ns),
    )  # fmt: skip


RISING = 0b1110_1000  # rising edge, time valid, UTC available, time base GNSS
FALLING = 0b0110_1100


@pytest.fixture
def write(tmp_path: Path):
    def put(data: bytes) -> Path:
        path = tmp_path / "rover.ubx"
        path.write_bytes(data)
        return path

    return put


def test_fix_holds_what_the_receiver_states(write) -> None:
    log = read_ubx(write(pvt())).gnss
    assert log is not None
    assert log.time[0] == gps_from_utc(START)
    assert np.degrees([log.lat[0], log.lon[0]]) == pytest.approx([40.0966268, -105.1474483])
    assert log.height[0] == pytest.approx(1601.474, abs=1e-9)
    assert log.geoid_separation[0] == pytest.approx(-16.5, abs=1e-9)
    assert log.height_kind == "ellipsoidal"
    assert log.v_ned[0] == pytest.approx([1.5, -2.5, 0.3])
    assert log.satellites[0] == 21
    assert log.fix[0] == FIX_FIXED
    assert log.doubts == ()


def test_horizontal_accuracy_is_that_of_the_distance(write) -> None:
    log = read_ubx(write(pvt())).gnss
    assert log is not None
    variances = np.diag(log.covariance_ned[0])
    assert np.sqrt(variances[0] + variances[1]) == pytest.approx(0.014, abs=1e-12)
    assert np.sqrt(variances[2]) == pytest.approx(0.010, abs=1e-12)


def test_split_is_that_of_a_converter_that_is_not_ours(write, data: Path) -> None:
    # The real .pos beside was made from NAV-PVT by other hands: 14 mm became 0.0098995 m.
    line = (data / "flight_logs/drive_0708/gnss_1934_sf.pos").read_text().splitlines()[1].split()
    log = read_ubx(write(pvt())).gnss
    assert log is not None
    # 1e-7 m: digits of the file
    assert np.sqrt(log.covariance_ned[0, 0, 0]) == pytest.approx(float(line[7]), abs=1e-7)
    assert np.sqrt(log.covariance_v_ned[0, 0, 0]) == pytest.approx(float(line[18]), abs=1e-7)


def test_negative_nano_belongs_to_the_second_before(write) -> None:
    log = read_ubx(write(pvt(nano=-1_234_567) + pvt(START + timedelta(seconds=1), nano=250))).gnss
    assert log is not None
    expected = gps_from_utc(START) + np.array([-1_234_567e-9, 1 + 250e-9])
    # 5e-7 s: a double holds seconds of 1980 to 2e-7
    assert log.time == pytest.approx(expected, abs=5e-7)


@pytest.mark.parametrize(
    ("fix_type", "flags", "fix"),
    [
        (3, 0b0000_0001, FIX_SINGLE),
        (3, 0b0000_0011, FIX_DGNSS),
        (3, 0b0100_0011, FIX_FLOAT),
        (3, 0b1000_0011, FIX_FIXED),
        (4, 0b0000_0001, FIX_SINGLE),
        (2, 0b0000_0001, FIX_2D),
    ],
)
def test_flags_become_a_fix(write, fix_type: int, flags: int, fix: int) -> None:
    log = read_ubx(write(pvt(fix_type=fix_type, flags=flags))).gnss
    assert log is not None
    assert log.fix.tolist() == [fix]


@pytest.mark.parametrize(
    "lost",
    [{"fix_type": 0}, {"fix_type": 1}, {"fix_type": 5}, {"flags": 0b1000_0000}, {"flags3": 1}],
    ids=["none", "dead-reckoning", "time-only", "rejected", "invalid-place"],
)
def test_epochs_without_a_fix_are_left_out_and_counted(write, lost: dict[str, int]) -> None:
    logs = read_ubx(write(pvt() + pvt(START + timedelta(seconds=1), **lost)))  # type: ignore[arg-type]
    assert logs.gnss is not None
    assert len(logs.gnss) == 1
    assert any("1 of 2 epochs have no fix" in d for d in logs.doubts)


def test_time_of_week_holds_where_leap_seconds_are_not_known_yet(write) -> None:
    # UTC 2 s off, as before the almanac has come; time of week is right
    itow = round(week_from_gps(gps_from_utc(START))[1] * 1e3)
    logs = read_ubx(write(pvt(START - timedelta(seconds=2), itow_ms=itow, valid=0b0011)))
    assert logs.gnss is not None
    assert logs.gnss.time[0] == pytest.approx(gps_from_utc(START), abs=1e-6)
    assert any("leap seconds" in d for d in logs.doubts)


def test_epochs_without_a_valid_date_take_the_week_of_the_others(write) -> None:
    saturday = datetime(2025, 7, 12, 23, 59, 41, tzinfo=UTC)  # one second before the week ends
    times = [saturday + timedelta(seconds=i) for i in range(4)]
    text = pvt(times[0], valid=0) + pvt(times[1], valid=0) + pvt(times[2]) + pvt(times[3], valid=0)
    log = read_ubx(write(text)).gnss
    assert log is not None
    assert log.time == pytest.approx([gps_from_utc(t) for t in times], abs=1e-6)


def test_without_any_date_times_are_of_the_week_and_that_is_said(write) -> None:
    logs = read_ubx(write(pvt(valid=0, itow_ms=604799_000) + pvt(valid=0, itow_ms=0)))
    assert logs.gnss is not None
    assert logs.gnss.scale == "boot"
    assert logs.gnss.time.tolist() == [604799.0, 604800.0]
    assert any("no epoch has a valid date" in d for d in logs.doubts)


def test_covariances_of_nav_cov_are_used_where_they_are_valid(write) -> None:
    rng = np.random.default_rng(3)
    a, b = rng.normal(size=(2, 3, 3))
    position, velocity = a @ a.T, b @ b.T
    itow = round(week_from_gps(gps_from_utc(START))[1] * 1e3)

    def cov(itow_ms: int, valid: int) -> bytes:
        terms = [c[i, j] for c in (position, velocity)
                 for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))]  # fmt: skip
        return frame(
            (0x01, 0x36), struct.pack("<IBBB9x12f", itow_ms, 0, valid, valid, *terms)
        )  # fmt: skip

    second = START + timedelta(seconds=1)
    log = read_ubx(write(cov(itow, 1) + pvt() + pvt(second) + cov(itow + 1000, 0))).gnss
    assert log is not None
    # single precision of the message
    assert log.covariance_ned[0] == pytest.approx(position, rel=1e-6)
    assert log.covariance_v_ned[0] == pytest.approx(velocity, rel=1e-6)
    assert log.covariance_ned[1, 2, 2] == pytest.approx(0.010**2)


def test_rising_edge_is_a_mark_to_the_nanosecond(write) -> None:
    (log,) = read_ubx(write(pvt() + tm2(flags=RISING))).events
    assert log.kind == "feedback"
    week, tow = week_from_gps(log.time[0])
    assert week == 2374
    # 3e-7 s: a double holds seconds of 1980 to 2e-7
    assert tow == pytest.approx(243275.123456789, abs=3e-7)
    assert log.sigma[0] == pytest.approx(25e-9)
    assert log.sequence.tolist() == [7]
    assert log.flags.tolist() == [RISING]
    assert np.isnan(log.lat[0])


def test_both_edges_are_read_and_the_rising_ones_come_first(write) -> None:
    both = RISING | FALLING
    logs = read_ubx(write(tm2(flags=both, count=1) + tm2(flags=FALLING, count=1)))
    rising, falling = logs.events
    assert "rising" in rising.source
    assert "falling" in falling.source
    assert (len(rising), len(falling)) == (1, 2)
    assert falling.time[0] - rising.time[0] == pytest.approx(0.099654433, abs=3e-7)
    assert any("use falling ones" in d for d in logs.doubts)


def test_utc_marks_become_gps_and_receiver_clock_is_doubted(write) -> None:
    utc, local = (RISING & ~0b1_1000) | 0b1_0000, RISING & ~0b1_1000
    (log,) = read_ubx(write(tm2(flags=RISING) + tm2(flags=utc) + tm2(flags=local))).events
    assert log.time - log.time[0] == pytest.approx([0.0, LEAP, 0.0], abs=1e-6)
    assert any("receiver's own clock" in d for d in log.doubts)


def test_marks_without_valid_time_are_left_out_and_counted(write) -> None:
    logs = read_ubx(write(tm2(flags=RISING & ~0x40) + tm2(flags=RISING, count=8)))
    assert logs.events[0].sequence.tolist() == [8]
    assert any("1 of 2 time marks have no valid time" in d for d in logs.doubts)


def test_counter_may_wrap_but_a_jump_is_said(write) -> None:
    def at(count: int, ms: int) -> bytes:
        return tm2(flags=RISING, count=count, rising=(2374, ms, 0))

    wrapped = read_ubx(write(at(65534, 1000) + at(65535, 2000) + at(0, 3000) + at(1, 4000)))
    assert wrapped.events[0].doubts == ()
    assert wrapped.events[0].sequence.tolist() == [65534, 65535, 0, 1]
    jumped = read_ubx(write(at(65535, 2000) + at(2, 5000)))
    assert any("jumps over 2 time marks" in d for d in jumped.doubts)


def test_weeks_modulo_1024_are_completed_from_the_fixes(write) -> None:
    mark = tm2(flags=RISING, rising=(2374 - 2048, 243275_000, 0))
    logs = read_ubx(write(pvt() + mark))
    assert week_from_gps(logs.events[0].time[0])[0] == 2374
    assert any("modulo 1024" in d for d in logs.doubts)
    assert any("below 1024" in d for d in read_ubx(write(mark)).doubts)


def test_marks_over_the_week_end_go_on(write) -> None:
    text = tm2(flags=RISING, count=1, rising=(2374, 604799_900, 0))
    text += tm2(flags=RISING, count=2, rising=(2375, 100, 0))
    assert np.diff(read_ubx(write(text)).events[0].time) == pytest.approx([0.2], abs=1e-6)


def test_raw_measurements_are_counted_for_ppk(write) -> None:
    logs = read_ubx(write(frame((0x02, 0x15), bytes(16)) * 3))
    assert "3 epochs of raw measurements" in logs.format
    assert logs.gnss is None


def test_reading_goes_on_behind_damage(write) -> None:
    frames = [pvt(START + timedelta(seconds=i)) for i in range(6)]
    frames[1] = frames[1][:40] + b"\xff" + frames[1][41:]
    # A damaged length that points past the end of the file.
    frames[3] = frames[3][:4] + b"\xff\xff" + frames[3][6:]
    text = b"\x00\xb5junk" + b"".join(frames) + b"$GNTXT,hello*00\r\n" + pvt()[:50]
    logs = read_ubx(write(text))
    assert logs.gnss is not None
    assert logs.gnss.time - gps_from_utc(START) == pytest.approx([0.0, 2.0, 4.0, 5.0], abs=1e-6)
    assert any(d.startswith("2 UBX frames are damaged") for d in logs.doubts)
    assert any("last frame is cut" in d for d in logs.doubts)


def test_damaged_length_does_not_swallow_the_frames_behind(write) -> None:
    frames = [pvt(START + timedelta(seconds=i)) for i in range(5)]
    frames[1] = frames[1][:4] + struct.pack("<H", 200) + frames[1][6:]
    logs = read_ubx(write(b"".join(frames)))
    assert logs.gnss is not None
    assert logs.gnss.time - gps_from_utc(START) == pytest.approx([0.0, 2.0, 3.0, 4.0], abs=1e-6)


def test_nmea_between_frames_is_no_damage(write) -> None:
    logs = read_ubx(write(pvt() + b"$GNGGA,1,2*00\r\n" + pvt(START + timedelta(seconds=1))))
    assert logs.doubts == ()


def test_placeholders_of_the_start_are_left_out(write) -> None:
    frames = pvt(lat_e7=2_000_000_000) + pvt(START + timedelta(seconds=1))
    logs = read_ubx(write(frames))
    assert logs.gnss is not None
    assert len(logs.gnss) == 1
    assert any("outside of the Earth" in d for d in logs.doubts)


@pytest.mark.parametrize(
    "data",
    [b"", b"\0" * 100, b"hello", b"\xb5\x62" * 50, pvt()[:60], frame((0x0A, 0x04), bytes(40))],
    ids=["empty", "zeros", "text", "syncs", "cut", "other-messages"],
)
def test_useless_files_are_refused_by_name(write, data: bytes) -> None:
    with pytest.raises(InputError, match=r"rover\.ubx"):
        read_ubx(write(data))


def test_log_without_any_fix_is_refused_unless_it_has_marks(write) -> None:
    with pytest.raises(InputError, match="none of its 1 epochs has a fix"):
        read_ubx(write(pvt(fix_type=0)))
    logs = read_ubx(write(pvt(fix_type=0) + tm2(flags=RISING)))
    assert logs.gnss is None
    assert len(logs.events) == 1
    assert any("none of its 1 epochs has a fix" in d for d in logs.doubts)


def test_only_whole_frames_look_like_ubx(tmp_path: Path) -> None:
    assert looks_like_ubx(b"\x01\x02" + pvt(), tmp_path)
    assert not looks_like_ubx(b"\xb5\x62\x01\x07\x00\x00\x00\x00", tmp_path)


@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_any_damage_is_a_clear_error_or_a_log(write, data: st.DataObject) -> None:
    text = pvt() + tm2(flags=RISING) + pvt(START + timedelta(seconds=1))
    at = data.draw(st.integers(0, len(text) - 1))
    junk = data.draw(st.binary(max_size=30))
    path = write(text[:at] + junk + text[at + len(junk) // 2 :])
    try:
        logs = read_ubx(path)
    except InputError:
        return
    # What is left is one of the two fixes: a checksum of 16 bits lets nothing else through here.
    if logs.gnss is not None:
        assert set(np.round(logs.gnss.time - gps_from_utc(START))) <= {0.0, 1.0}
