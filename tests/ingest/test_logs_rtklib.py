"""RTKLIB solutions: lines as `solution.c` prints them, covariances drawn and turned here."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pyproj import Transformer

from georef_gis.errors import InputError
from georef_gis.ingest.logs.rtklib import (
    looks_like_rtklib,
    looks_like_rtklib_events,
    looks_like_rtklib_pos,
    read_rtklib_events,
    read_rtklib_pos,
)
from georef_gis.model.logs import FIX_DGNSS, FIX_FIXED, FIX_FLOAT, FIX_PPP, FIX_SINGLE
from georef_gis.units import gps_from_utc, week_from_gps

NOTE = (
    "% (lat/lon/height=WGS84/{kind},Q=1:fix,2:float,3:sbas,4:dgps,5:single,6:ppp,"
    "ns=# of satellites)\n"
)
LLH = (
    "%  {scale}                  latitude(deg) longitude(deg)  height(m)   Q  ns   sdn(m)   sde(m)"
    "   sdu(m)  sdne(m)  sdeu(m)  sdun(m) age(s)  ratio"
)
VELOCITY = (
    "    vn(m/s)    ve(m/s)    vu(m/s)      sdvn     sdve     sdvu    sdvne    sdveu    sdvun"
)
HEAD = NOTE.format(kind="ellipsoidal") + LLH.format(scale="GPST") + "\n"
ROW = (
    "  40.096626800 -105.147448300  1601.4740   1  21   0.0051   0.0037   0.0083   0.0012  -0.0016"
)
ROW += "   0.0003  -0.00    5.8"
GPS = gps_from_utc(datetime(2025, 7, 8, 19, 34, 0, tzinfo=UTC))  # 19:34:18 GPST


@pytest.fixture
def write(tmp_path: Path):
    def put(text: str | bytes, name: str = "rover.pos") -> Path:
        path = tmp_path / name
        path.write_bytes(text.encode() if isinstance(text, str) else text)
        return path

    return put


def sqvar(c: float) -> float:
    return float(np.sign(c) * np.sqrt(abs(c)))


def test_line_holds_what_it_says(write) -> None:
    logs = read_rtklib_pos(write(HEAD + "2025/07/08 19:34:18.000" + ROW + "\n"))
    log = logs.gnss
    assert log is not None
    assert log.time[0] == pytest.approx(GPS, abs=1e-6)
    assert np.degrees([log.lat[0], log.lon[0]]) == pytest.approx([40.0966268, -105.1474483])
    assert (log.height[0], log.height_kind) == (1601.474, "ellipsoidal")
    assert (log.fix[0], log.satellites[0]) == (FIX_FIXED, 21)
    assert np.all(np.isnan(log.v_ned))
    assert logs.doubts == ()


@pytest.mark.parametrize(
    ("scale", "stamp"),
    [
        ("GPST", "2025/07/08 19:34:18.000"),
        ("UTC ", "2025/07/08 19:34:00.000"),
        ("JST ", "2025/07/09 04:34:00.000"),
        ("GPST", "2374 243258.000"),
        ("UTC ", "2374 243240.000"),
    ],
)
def test_header_decides_the_scale_of_times(write, scale: str, stamp: str) -> None:
    head = NOTE.format(kind="ellipsoidal") + LLH.format(scale=scale) + "\n"
    log = read_rtklib_pos(write(head + stamp + ROW + "\n")).gnss
    assert log is not None
    assert log.time[0] == pytest.approx(GPS, abs=1e-6)


def test_covariances_keep_their_signs_from_up_to_down(write) -> None:
    rng = np.random.default_rng(5)
    # north, east, up: position and velocity; errors of down are those of up with the other sign
    drawn = []
    rows = ""
    for i in range(20):
        p, v = (a @ a.T for a in rng.normal(size=(2, 3, 3)))
        drawn.append((p, v))
        terms = [
            x
            for c in (p, v)
            for x in (*np.sqrt(np.diag(c)), sqvar(c[0, 1]), sqvar(c[1, 2]), sqvar(c[2, 0]))
        ]
        cells = " ".join(f"{x:.9f}" for x in terms[:6])
        speeds = " ".join(f"{x:.9f}" for x in terms[6:])
        rows += (
            f"2025/07/08 19:34:{18 + i}.000 40.0 -105.0 1600.0 1 12 {cells} 0.0 3.0 1.0 2.0 3.0 "
        )
        rows += speeds + "\n"
    head = HEAD.rstrip("\n") + VELOCITY + "\n"
    log = read_rtklib_pos(write(head + rows)).gnss
    assert log is not None
    turn = np.diag([1.0, 1.0, -1.0])
    for i, (p, v) in enumerate(drawn):
        assert log.covariance_ned[i] == pytest.approx(turn @ p @ turn, abs=1e-7)
        assert log.covariance_v_ned[i] == pytest.approx(turn @ v @ turn, abs=1e-7)
    assert log.v_ned[0] == pytest.approx([1.0, 2.0, -3.0])


def test_ecef_solutions_become_geographic_with_their_covariances(write) -> None:
    rng = np.random.default_rng(6)
    lat, lon, height = 40.1, -105.1, 1601.5
    x, y, z = Transformer.from_crs("EPSG:4979", "EPSG:4978").transform(lat, lon, height)
    a = rng.normal(size=(3, 3))
    c = a @ a.T
    cells = [*np.sqrt(np.diag(c)), sqvar(c[0, 1]), sqvar(c[1, 2]), sqvar(c[2, 0])]
    # north, east, down at the place, written out
    s, k = np.sin(np.radians([lat, lon])), np.cos(np.radians([lat, lon]))
    north = [-s[0] * k[1], -s[0] * s[1], k[0]]
    east = [-s[1], k[1], 0.0]
    down = [-k[0] * k[1], -k[0] * s[1], -s[0]]
    R = np.array([north, east, down])
    v = R.T @ [3.0, -4.0, 0.5]
    head = (
        "% (x/y/z-ecef=WGS84,Q=1:fix,2:float,ns=# of satellites)\n%  GPST          x-ecef(m)"
        "      y-ecef(m)      z-ecef(m)   Q  ns   sdx(m)   sdy(m)   sdz(m)  sdxy(m)  sdyz(m)"
        "  sdzx(m) age(s)  ratio    vx(m/s)    vy(m/s)    vz(m/s)      sdvx     sdvy     sdvz"
        "    sdvxy    sdvyz    sdvzx\n"
    )
    numbers = " ".join(f"{n:.9f}" for n in cells)
    speeds = " ".join(f"{n:.9f}" for n in (*v, *cells))
    row = f"2374 243258.000 {x:.6f} {y:.6f} {z:.6f} 2 9 {numbers} 0.0 1.5 {speeds}\n"
    log = read_rtklib_pos(write(head + row)).gnss
    assert log is not None
    # 1e-11 rad = 0.06 mm
    assert [log.lat[0], log.lon[0]] == pytest.approx(np.radians([lat, lon]), abs=1e-11)
    assert log.height[0] == pytest.approx(height, abs=1e-5)
    assert log.height_kind == "ellipsoidal"
    assert log.covariance_ned[0] == pytest.approx(R @ c @ R.T, abs=1e-6)
    assert log.covariance_v_ned[0] == pytest.approx(R @ c @ R.T, abs=1e-6)
    assert log.v_ned[0] == pytest.approx([3.0, -4.0, 0.5], abs=1e-7)
    assert log.fix[0] == FIX_FLOAT


def test_rtklib_itself_reads_the_same(write) -> None:
    rtklib = pytest.importorskip("pyrtklib", reason="pyrtklib is not installed")
    head = NOTE.format(kind="ellipsoidal") + LLH.format(scale="UTC ") + "\n"
    # Its reader squares the last three, so their signs are plus here.
    cells = "0.0300 0.0200 0.0500 0.0120 0.0160 0.0130 0.0 5.8"
    row = f"2025/07/08 19:34:00.500 40.0966268 -105.1474483 1601.474 1 21 {cells}\n"
    path = write(head + row)
    log = read_rtklib_pos(path).gnss
    buffer = rtklib.solbuf_t()
    assert rtklib.readsol([str(path)], 1, buffer) == 1
    theirs = buffer.data[0]
    assert log is not None
    # its times count from 1970 on the GPS scale
    assert log.time[0] + 315_964_800 == pytest.approx(theirs.time.time + theirs.time.sec, abs=1e-6)
    ours = Transformer.from_crs("EPSG:4979", "EPSG:4978").transform(
        *np.degrees([log.lat[0], log.lon[0]]), log.height[0]
    )
    assert ours == pytest.approx([theirs.rr[i] for i in range(3)], abs=1e-5)
    s, k = np.sin([log.lat[0], log.lon[0]]), np.cos([log.lat[0], log.lon[0]])
    north, east = [-s[0] * k[1], -s[0] * s[1], k[0]], [-s[1], k[1], 0.0]
    R = np.array([north, east, [-k[0] * k[1], -k[0] * s[1], -s[0]]])
    xx, yy, zz, xy, yz, zx = (theirs.qr[i] for i in range(6))
    # single precision
    assert R.T @ log.covariance_ned[0] @ R == pytest.approx(
        np.array([[xx, xy, zx], [xy, yy, yz], [zx, yz, zz]]), abs=1e-9
    )


def test_degrees_minutes_seconds_keep_the_sign_of_zero(write) -> None:
    head = NOTE.format(kind="ellipsoidal") + (
        "%  GPST  latitude(d'\") longitude(d'\")  height(m)   Q  ns   sdn(m)   sde(m)   sdu(m)  "
        "sdne(m)  sdeu(m)  sdue(m) age(s)  ratio\n"
    )
    row = "2374 243258.000  40 05 47.85648  -0 30 36.00000 160.0 1 9 1 1 1 0.1 0.2 -0.3 0 0\n"
    log = read_rtklib_pos(write(head + row)).gnss
    assert log is not None
    assert np.degrees(log.lat[0]) == pytest.approx(40.0966268, abs=1e-12)
    assert np.degrees(log.lon[0]) == pytest.approx(-0.51, abs=1e-12)
    # "sdue" of this header is sdun: north against up
    assert log.covariance_ned[0, 0, 2] == pytest.approx(0.09)


@pytest.mark.parametrize("separator", ["\t", ",", ";"])
def test_other_separators_are_read(write, separator: str) -> None:
    line = separator.join(("2025/07/08 19:34:18.000" + ROW).split())
    head = HEAD.splitlines()[0] + "\n%  " + separator.join(LLH.format(scale="GPST").split()[1:])
    stamp = line.replace(f"2025/07/08{separator}", "2025/07/08 ")
    log = read_rtklib_pos(write(head + "\n" + stamp + "\n")).gnss
    assert log is not None
    assert log.time[0] == pytest.approx(GPS, abs=1e-6)
    assert log.height[0] == 1601.474


@pytest.mark.parametrize(
    ("q", "fix"),
    [(1, FIX_FIXED), (2, FIX_FLOAT), (3, FIX_DGNSS), (4, FIX_DGNSS), (5, FIX_SINGLE), (6, FIX_PPP)],
)
def test_q_becomes_a_fix(write, q: int, fix: int) -> None:
    row = ROW.replace("   1  21", f"   {q}  21")
    log = read_rtklib_pos(write(HEAD + "2025/07/08 19:34:18.000" + row)).gnss
    assert log is not None
    assert log.fix.tolist() == [fix]


def test_geodetic_heights_are_above_a_geoid_that_is_not_named(write) -> None:
    head = NOTE.format(kind="geodetic") + LLH.format(scale="GPST") + "\n"
    logs = read_rtklib_pos(write(head + "2025/07/08 19:34:18.000" + ROW))
    assert logs.gnss is not None
    assert logs.gnss.height_kind == "orthometric"
    assert any("geoid" in d for d in logs.doubts)


def test_moving_base_is_doubted(write) -> None:
    text = "% pos mode  : Moving-Base\n" + HEAD + "2025/07/08 19:34:18.000" + ROW
    assert any("base moved" in d for d in read_rtklib_pos(write(text)).doubts)


def test_baselines_are_refused_by_name(write) -> None:
    head = "%  GPST   e-baseline(m)  n-baseline(m)  u-baseline(m)   Q  ns  sde(m) sdn(m) sdu(m)\n"
    with pytest.raises(InputError, match="baselines"):
        read_rtklib_pos(write(head + "2374 243258.000 1 2 3 1 9 1 1 1\n"))


def test_damaged_lines_are_left_out_and_named(write) -> None:
    good = [f"2025/07/08 19:34:{s}.000{ROW}\n" for s in (18, 19, 20)]
    cut = good[1][:60] + "\n\x00\n"
    text = HEAD + good[0] + cut + "2025/13/41 00:00:00" + ROW + "\n" + good[2]
    logs = read_rtklib_pos(write(text))
    assert logs.gnss is not None
    assert logs.gnss.time - GPS == pytest.approx([0.0, 2.0], abs=1e-6)
    assert any(d.startswith("3 of 5 lines cannot be read (first: line 4)") for d in logs.doubts)


def test_nan_and_infinite_values_are_left_out_and_counted(write) -> None:
    rows = [f"2025/07/08 19:34:{s}.000{ROW}\n" for s in (18, 19, 20)]
    rows[1] = rows[1].replace("1601.4740", "inf")
    rows[2] = rows[2].replace("40.096626800", "nan")
    logs = read_rtklib_pos(write(HEAD + "".join(rows)))
    assert logs.gnss is not None
    assert len(logs.gnss) == 1
    assert any("2 of 3 fixes have no finite time or place" in d for d in logs.doubts)


def test_zero_sigmas_are_unknown_and_loose_covariances_lose_their_cross_terms(write) -> None:
    zero = "2025/07/08 19:34:18.000 40 -105 1600 1 9 0.0 0.0 0.0 0 0 0 0 0\n"
    loose = "2025/07/08 19:34:19.000 40 -105 1600 1 9 0.01 0.01 0.01 0.02 0 0 0 0\n"
    logs = read_rtklib_pos(write(HEAD + zero + loose))
    assert logs.gnss is not None
    assert np.all(np.isnan(logs.gnss.covariance_ned[0]))
    assert logs.gnss.covariance_ned[1] == pytest.approx(1e-4 * np.eye(3))
    assert any("zero or infinite" in d for d in logs.doubts)
    assert any("not positive" in d for d in logs.doubts)


def test_rows_out_of_order_are_sorted_and_repeated_ones_dropped(write) -> None:
    rows = "".join(f"2025/07/08 19:34:{s}.000{ROW}\n" for s in (20, 18, 18, 19))
    logs = read_rtklib_pos(write(HEAD + rows))
    assert logs.gnss is not None
    assert logs.gnss.time - GPS == pytest.approx([0.0, 1.0, 2.0], abs=1e-6)
    assert any("sorted" in d for d in logs.doubts)
    assert any("repeat" in d for d in logs.doubts)


def test_events_are_marks_at_the_antenna(write) -> None:
    rows = f"2025/07/08 19:34:18.623{ROW}\n2025/07/08 19:34:20.323{ROW}\n"
    (log,) = read_rtklib_events(write(HEAD + rows, "rover_events.pos")).events
    assert (log.kind, log.position_of, log.height_kind) == ("feedback", "antenna", "ellipsoidal")
    assert log.time - GPS == pytest.approx([0.623, 2.323], abs=1e-6)
    assert log.flags.tolist() == [1, 1]
    assert log.sequence.tolist() == [-1, -1]
    # RTKLIB states no sigma of the time: 1 ms of rounding is what is known
    assert log.sigma == pytest.approx(1e-3 / np.sqrt(12), abs=1e-9)
    assert log.covariance_ned[0, 0, 1] == pytest.approx(0.0012**2)
    assert log.covariance_ned[0, 1, 2] == pytest.approx(0.0016**2)


def test_event_without_a_place_keeps_its_time(write) -> None:
    row = ROW.replace("   1  21", "   0  21")
    (log,) = read_rtklib_events(write(HEAD + "2374 243258.5" + row, "a_events.pos")).events
    assert len(log) == 1
    assert np.isnan(log.lat[0])
    assert any("have no place" in d for d in log.doubts)


def test_real_drive_is_read_whole(data: Path) -> None:
    path = data / "flight_logs/drive_0708/gnss_1934_sf.pos"
    logs = read_rtklib_pos(path)
    log = logs.gnss
    assert log is not None
    lines = path.read_text().splitlines()
    assert len(log) == len(lines) - 1
    assert np.diff(log.time).max() == pytest.approx(0.25, abs=2e-3)
    assert week_from_gps(log.time[0]) == pytest.approx((2374, 243258.499), abs=1e-6)
    # Rates of the positions bear out the velocities: 5 cm/s from 1 cm over 0.5 s
    north = np.gradient(log.lat, log.time) * 6_362_000
    assert np.sqrt(np.mean((north - log.v_ned[:, 0]) ** 2)) < 0.1
    down = -np.gradient(log.height, log.time)
    assert np.corrcoef(down, log.v_ned[:, 2])[0, 1] > 0.5
    assert any("does not say what heights" in d for d in logs.doubts)


@pytest.mark.parametrize(
    "data",
    [b"", b"\0" * 400, b"hello\n", bytes(range(256)) * 9, HEAD.encode(), ROW.encode() * 3],
    ids=["empty", "zeros", "text", "binary", "no-rows", "no-header"],
)
def test_useless_files_are_refused_by_name(write, data: bytes) -> None:
    with pytest.raises(InputError, match=r"rover\.pos"):
        read_rtklib_pos(write(data))


def test_names_tell_events_from_tracks() -> None:
    head = HEAD.encode()
    assert looks_like_rtklib(head, Path("x.pos"))
    assert looks_like_rtklib_events(head, Path("x_events.pos"))
    assert not looks_like_rtklib_pos(head, Path("x_events.pos"))
    assert looks_like_rtklib_pos(head, Path("x.pos"))
    assert not looks_like_rtklib(b"time,lat,lon\n", Path("x.pos"))


@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_any_damage_is_a_clear_error_or_a_log(write, data: st.DataObject) -> None:
    text = (HEAD + "".join(f"2025/07/08 19:34:{s}.000{ROW}\n" for s in (18, 19, 20))).encode()
    at = data.draw(st.integers(0, len(text) - 1))
    junk = data.draw(st.binary(max_size=30))
    path = write(text[:at] + junk + text[at + len(junk) // 2 :])
    for reader in (read_rtklib_pos, read_rtklib_events):
        try:
            logs = reader(path)
        except InputError:
            continue
        assert logs.gnss is not None or logs.events
