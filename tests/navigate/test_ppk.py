"""PPK by RTKLIB against the simulator's truth, and what unfit files are answered with."""

from __future__ import annotations

import gzip
import math
import os
import struct
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from georef_gis.ellipsoid import ecef_from_geo, geo_from_ecef
from georef_gis.errors import Cancelled, InputError
from georef_gis.frames import Array, R_ecef_from_enu, R_ecef_from_ned
from georef_gis.geodesy import Datum, Height, HeightKind, geoid_undulation
from georef_gis.ingest.logs.rtklib import read_rtklib_pos
from georef_gis.model.logs import FIX_FIXED, FIX_FLOAT, FIX_SINGLE, GnssLog
from georef_gis.navigate.ppk import (
    BasePosition,
    PpkOptions,
    PpkSolution,
    run_ppk,
    solve_ppk,
    write_pos,
)
from georef_gis.navigate.ppk_files import read_observations
from georef_gis.navigate.ppk_pos import covariance_ned, signed_roots
from georef_gis.simulate.gnss_orbits import Ephemeris, constellation, with_broadcast_error
from georef_gis.simulate.gnss_raw import (
    RawLog,
    RawSettings,
    Slip,
    fixed_track,
    orbiting_track,
    simulate_raw,
)
from georef_gis.simulate.rinex import write_navigation, write_observations
from georef_gis.toolbox.context import CollectingFeedback, Context
from processing_algorithms.navigate.ppk import Ppk

pytest.importorskip("pyrtklib")

START = 1403445600.0  # 2024-06-26 14:00:00 on the GPS scale
LAT, LON = math.radians(39.65), math.radians(-79.95)
MARKER = np.array([LAT, LON, 280.0])
ANTENNA_UP = 1.543  # m, of the base over its marker
R_ENU = R_ecef_from_enu(LAT, LON)
BASE = ecef_from_geo(MARKER) + R_ENU @ [0.0, 0.0, ANTENNA_UP]
EVENTS = (100.123, 131.75)


@dataclass
class Pair:
    """Files of a rover and a base, and the truth."""

    rover: Path
    base: Path
    nav: Path
    log: RawLog
    sent: list[Ephemeris]
    base_log: RawLog

    def errors(self, log: GnssLog) -> Array:
        """Antenna minus truth at the same instants, ned m, (n, 3)."""
        t = log.time - self.log.start_gps
        # Fixes are at the epochs but for microseconds of clock: 18 m/s make 0.02 mm of them.
        i = np.clip(np.searchsorted(self.log.time, t - 1e-3), 0, len(self.log.time) - 1)
        assert np.max(np.abs(t - self.log.time[i])) < 1e-6
        true = self.log.p_ecef[i]
        p = ecef_from_geo(np.stack([log.lat, log.lon, log.height], axis=-1))
        return np.asarray((p - true) @ R_ecef_from_ned(LAT, LON))


def make_pair(
    folder: Path, *, seed: int = 1, rate: float = 2.0, length: float = 200.0, version: str = "3.03",
    **settings: object,
) -> Pair:  # fmt: skip
    rng = np.random.default_rng(seed)
    start = START + 900.0 * seed
    sats = constellation(start, seed=7)
    errors = RawSettings(**settings)  # type: ignore[arg-type]
    track = orbiting_track(BASE + R_ENU @ [300.0, 200.0, 2.0], wait=40.0)
    tags = np.arange(0.0, length, 1.0 / rate)
    log = simulate_raw(track, tags, sats, errors, rng, start_gps=start)
    still = replace(errors, clock_offset=-3e-5, clock_drift=-1e-8, slips=())
    base_tags = np.arange(-5.0, length + 5.0)
    base_log = simulate_raw(fixed_track(BASE), base_tags, sats, still, rng, start_gps=start)
    pair = Pair(folder / "rover.obs", folder / "base.obs", folder / "x.nav", log,
                [with_broadcast_error(eph, rng, 1.0) for eph in sats], base_log)  # fmt: skip
    write_observations(pair.rover, log, version=version, events=EVENTS)
    write_observations(pair.base, base_log, version=version, approximate=ecef_from_geo(MARKER),
                       antenna_height=ANTENNA_UP)  # fmt: skip
    write_navigation(pair.nav, pair.sent)
    return pair


def slipping() -> Slip:
    return Slip(prn=high_satellite(), time=120.0, cycles=11)


def high_satellite() -> int:
    start, rng = START + 900.0, np.random.default_rng(0)
    sats = constellation(start, seed=7)
    log = simulate_raw(fixed_track(BASE), np.zeros(1), sats, RawSettings(), rng, start_gps=start)
    return log.prns[int(np.nanargmax(log.cn0[0, :, 0]))]


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> Pair:
    """L1 only, 200 s at 2 Hz, with a cycle slip of the highest satellite in the air."""
    return make_pair(tmp_path_factory.mktemp("pair"), slips=(slipping(),))


@pytest.fixture(scope="module")
def solution(pair: Pair) -> PpkSolution:
    return run_ppk(pair.rover, pair.base, [pair.nav])


@pytest.fixture(scope="module")
def solved(solution: PpkSolution) -> GnssLog:
    return solution.log


@pytest.fixture(scope="module")
def loose(pair: Pair) -> GnssLog:
    return solve_ppk(pair.rover, pair.base, [pair.nav], PpkOptions(fix=False))


def rms(errors: Array) -> Array:
    return np.asarray(np.sqrt(np.mean(errors**2, axis=0)))


def test_one_frequency_fixes_to_centimetres_through_a_cycle_slip(
    pair: Pair, solved: GnssLog
) -> None:
    error = pair.errors(solved)
    assert len(solved) == len(pair.log.tag)
    assert np.mean(solved.fix == FIX_FIXED) > 0.98
    # m; 3 mm white and 2 mm slow phase in four places, times the geometry, and 100 m of wet air
    assert np.all(rms(error) < [0.012, 0.012, 0.03])


def test_fix_beats_float_beats_single_points(pair: Pair, solved: GnssLog, loose: GnssLog) -> None:
    """The 2012 paper: about 5 m single, 1 m differential on L1."""
    alone = run_ppk(pair.rover, None, [pair.nav]).log
    assert set(loose.fix) == {FIX_FLOAT}
    assert set(alone.fix) == {FIX_SINGLE}
    fixed, floating, single = (np.linalg.norm(rms(pair.errors(g))) for g in (solved, loose, alone))
    assert fixed < 0.03
    assert 3.0 * fixed < floating < 1.0
    assert 1.0 < single < 10.0


def test_sigmas_of_float_cover_errors_that_last_minutes(pair: Pair, loose: GnssLog) -> None:
    error = pair.errors(loose)
    sigma = np.sqrt(np.diagonal(loose.covariance_ned, axis1=1, axis2=2))
    # One flight, slow errors: a chi-square of about three numbers.
    assert 0.1 < np.sqrt(np.mean((error / sigma) ** 2)) < 2.0


@pytest.mark.slow
def test_error_over_sigma_of_fixes_over_flights(tmp_path: Path) -> None:
    """Six flights, both frequencies, everything redrawn, satellites and hour included."""
    ratios, shares = [], []
    for seed in range(2, 8):
        one = make_pair(tmp_path, seed=7 * seed, rate=1.0, length=120.0, bands=2)
        log = solve_ppk(one.rover, one.base, [one.nav])
        error = one.errors(log)
        fixed = log.fix == FIX_FIXED
        shares.append(np.mean(fixed))
        solved = np.linalg.solve(log.covariance_ned[fixed], error[fixed][..., None])[..., 0]
        ratios.append(np.mean(np.sum(error[fixed] * solved, axis=1)) / 3.0)
    assert np.mean(shares) > 0.95
    assert 0.7 < math.sqrt(np.mean(ratios)) < 1.4


def test_sigma_scale_multiplies_sigmas_and_nothing_else(pair: Pair, solved: GnssLog) -> None:
    plain = solve_ppk(pair.rover, pair.base, [pair.nav], PpkOptions(sigma_scale=3.0))
    fixed = solved.fix == FIX_FIXED
    # 1.25 is the default
    assert plain.covariance_ned[fixed] == pytest.approx(
        (3.0 / 1.25) ** 2 * solved.covariance_ned[fixed]
    )
    assert np.array_equal(plain.lat, solved.lat)


def test_few_satellites_on_one_frequency_are_not_believed(pair: Pair, solved: GnssLog) -> None:
    most = int(solved.satellites.max()) + 1
    log = solve_ppk(pair.rover, pair.base, [pair.nav], PpkOptions(single_band_satellites=most))
    assert not np.any(log.fix == FIX_FIXED)
    assert np.min(log.covariance_ned[:, 0, 0]) > 0.25
    assert any(f"fewer than {most} satellites" in doubt for doubt in log.doubts)


@pytest.mark.parametrize(
    "options",
    [
        PpkOptions(direction="forward"),
        PpkOptions(direction="backward"),
        PpkOptions(dynamics=True),
        PpkOptions(hold=True),
    ],
    ids=["forward", "backward", "dynamics", "hold"],
)
def test_each_way_of_solving_reaches_centimetres_once_fixed(
    pair: Pair, options: PpkOptions
) -> None:
    log = solve_ppk(pair.rover, pair.base, [pair.nav], options)
    fixed = log.fix == FIX_FIXED
    # A single pass has yet to find its integers at its start.
    assert np.mean(fixed) > 0.7
    assert np.all(rms(pair.errors(log)[fixed]) < [0.012, 0.012, 0.03])


def test_velocity_and_time_are_those_of_the_antenna(pair: Pair, solved: GnssLog) -> None:
    # The receiver's clock is 0.15 ms off its tags: RTKLIB says the true time, to 1 us.
    offset = solved.time - pair.log.start_gps - pair.log.time
    assert np.max(np.abs(offset)) < 2e-6
    true = np.gradient(pair.log.p_ecef, pair.log.time, axis=0) @ R_ecef_from_ned(LAT, LON)
    # m/s; Doppler of 0.1 Hz is 2 cm/s on a line of sight
    assert np.all(rms(solved.v_ned - true)[:2] < 0.08)
    assert rms(solved.v_ned - true)[2] < 0.12


def test_a_moved_base_moves_every_position_alike(pair: Pair, solved: GnssLog) -> None:
    moved = ecef_from_geo(MARKER) + R_ENU @ [0.3, -0.2, 0.5]
    lat, lon, h = geo_from_ecef(moved)
    place = BasePosition(
        lat=lat, lon=lon, datum=Datum.parse("NAD83(2011)@2010.0"),
        height=Height(value=h - float(geoid_undulation(lat, lon)), kind=HeightKind.ORTHOMETRIC),
    )  # fmt: skip
    log = solve_ppk(pair.rover, pair.base, [pair.nav], PpkOptions(base=place))
    apart = np.median(pair.errors(log) - pair.errors(solved), axis=0)
    assert apart == pytest.approx([-0.2, 0.3, -0.5], abs=2e-3)


def test_height_of_the_base_antenna_counts_once(pair: Pair, solved: GnssLog) -> None:
    low = PpkOptions(base_antenna_up=0.0)
    log = solve_ppk(pair.rover, pair.base, [pair.nav], low)
    down = np.median(pair.errors(log) - pair.errors(solved), axis=0)[2]
    assert down == pytest.approx(ANTENNA_UP, abs=2e-3)
    lat, lon, h = MARKER
    top = BasePosition(
        lat=lat, lon=lon, of="antenna",
        height=Height(value=h + ANTENNA_UP, kind=HeightKind.ELLIPSOIDAL),
    )  # fmt: skip
    same = solve_ppk(pair.rover, pair.base, [pair.nav], PpkOptions(base=top))
    assert np.median(pair.errors(same) - pair.errors(solved), axis=0) == pytest.approx(0, abs=1e-3)


def test_averaged_base_is_metres_off_all_flight_long_and_says_so(pair: Pair) -> None:
    log = solve_ppk(pair.rover, pair.base, [pair.nav], PpkOptions(base="single"))
    error = pair.errors(log)
    off = np.linalg.norm(np.median(error, axis=0))
    assert 0.3 < off < 15.0
    # Within the flight the positions still agree to centimetres.
    assert np.all(np.std(error[log.fix == FIX_FIXED], axis=0) < 0.05)
    assert any("single point" in doubt for doubt in log.doubts)


def test_marks_of_the_rover_come_as_events(pair: Pair, solution: PpkSolution) -> None:
    events = solution.events
    assert events is not None
    assert events.time - pair.log.start_gps == pytest.approx(EVENTS, abs=1e-6)


@pytest.mark.parametrize("how", ["gzip", "rinex2"])
def test_other_dresses_of_the_same_data_give_the_same(
    pair: Pair, solved: GnssLog, tmp_path: Path, how: str
) -> None:
    rover, base = tmp_path / "r o'ver*.05o", tmp_path / "base.05o"
    if how == "gzip":
        rover, base = (file.with_name(file.name + ".gz") for file in (rover, base))
        rover.write_bytes(gzip.compress(pair.rover.read_bytes()))
        base.write_bytes(gzip.compress(pair.base.read_bytes()))
    else:
        write_observations(rover, pair.log, version="2.11", events=EVENTS)
        write_observations(base, pair.base_log, version="2.11", antenna_height=ANTENNA_UP,
                           approximate=ecef_from_geo(MARKER))  # fmt: skip
        assert read_observations(rover).events == read_observations(pair.rover).events
    log = solve_ppk(rover, base, [pair.nav])
    assert len(log) == len(solved)
    assert log.height == pytest.approx(solved.height, abs=1e-3)


def test_scan_tells_what_the_files_hold(pair: Pair) -> None:
    scan = read_observations(pair.rover)
    seen = {f"G{prn:02d}" for prn, code in zip(pair.log.prns, pair.log.code[0, :, 0], strict=True)
            if np.isfinite(code)}  # fmt: skip
    assert scan.epochs == len(pair.log.tag)
    assert seen <= scan.satellites
    assert scan.first == pytest.approx(pair.log.start_gps, abs=1e-6)
    assert scan.last - scan.first == pytest.approx(199.5, abs=1e-6)
    assert scan.bands == (True, False)
    assert scan.marker_ecef is None


# ---------------------------------------------------------------------------------------------
# UBX
# ---------------------------------------------------------------------------------------------


def ubx(kind: tuple[int, int], payload: bytes) -> bytes:
    """A frame with its Fletcher sum (u-blox M8 protocol description, 32.4)."""
    body = bytes(kind) + struct.pack("<H", len(payload)) + payload
    a = b = 0
    for byte in body:
        a = (a + byte) & 255
        b = (b + a) & 255
    return b"\xb5b" + body + bytes((a, b))


def ubx_of(log: RawLog, ephemerides: list[Ephemeris]) -> bytes:
    """RXM-RAWX of every epoch, and RXM-SFRBX of the satellites' subframes 1 to 3."""
    out = bytearray()
    week = math.floor(log.start_gps / 604800.0)
    seen = np.any(np.isfinite(log.code[:, :, 0]), axis=0)
    up = {prn for prn, is_up in zip(log.prns, seen, strict=True) if is_up}
    for eph in ephemerides:
        for words in subframes(eph) if eph.prn in up else []:
            head = struct.pack("<8B", 0, eph.prn, 0, 0, 10, 0, 2, 0)
            out += ubx((2, 0x13), head + struct.pack("<10I", *words))
    for i, tag in enumerate(log.tag):
        seen_now = np.flatnonzero(np.isfinite(log.code[i, :, 0]))
        tow = log.start_gps - week * 604800.0 + float(tag)
        payload = struct.pack("<dHbBBBH", tow, week, 18, len(seen_now), 1, 1, 0)
        for k in seen_now:
            lost = np.flatnonzero(log.lost[: i + 1, k, 0])
            lock = 0.5 * (i - lost[-1]) if len(lost) else 60.0
            payload += struct.pack(
                "<ddfBBBBHBBBBBB", log.code[i, k, 0], log.phase[i, k, 0], log.doppler[i, k, 0],
                0, log.prns[k], 0, 0, min(int(lock * 1000), 64500), int(log.cn0[i, k, 0]),
                5, 2, 5, 7, 0,
            )  # fmt: skip
        out += ubx((2, 0x15), payload)
    return bytes(out)


def subframes(eph: Ephemeris) -> list[list[int]]:
    """Words of subframes 1 to 3 without parity (IS-GPS-200, figure 20-1, tables 20-I, 20-III)."""
    pi = math.pi

    def s(value: float, bits: int, power: int) -> tuple[int, int]:
        return round(value / 2.0**power) & ((1 << bits) - 1), bits

    tow = round(eph.toe_tow)
    one = [(eph.week % 1024, 10), (1, 2), (0, 4), (0, 6), (0, 2), (0, 1), (0, 87),
           s(eph.tgd, 8, -31), (eph.iode, 8), (tow // 16, 16), s(eph.af2, 8, -55),
           s(eph.af1, 16, -43), s(eph.af0, 22, -31), (0, 2)]  # fmt: skip
    two = [(eph.iode, 8), s(eph.crs, 16, -5), s(eph.delta_n / pi, 16, -43), s(eph.m0 / pi, 32, -31),
           s(eph.cuc, 16, -29), s(eph.e, 32, -33), s(eph.cus, 16, -29), s(eph.sqrt_a, 32, -19),
           (tow // 16, 16), (0, 8)]  # fmt: skip
    three = [s(eph.cic, 16, -29), s(eph.omega0 / pi, 32, -31), s(eph.cis, 16, -29),
             s(eph.i0 / pi, 32, -31), s(eph.crc, 16, -5), s(eph.omega / pi, 32, -31),
             s(eph.omega_dot / pi, 24, -43), (eph.iode, 8), s(eph.idot / pi, 14, -43),
             (0, 2)]  # fmt: skip
    out = []
    for number, fields in enumerate((one, two, three), start=1):
        head = [(0x8B, 8), (0, 16), (tow // 6, 17), (0, 2), (number, 3), (0, 2)]
        bits = "".join(f"{value:0{width}b}" for value, width in [*head, *fields])
        assert len(bits) == 240
        out.append([int(bits[24 * w : 24 * w + 24], 2) << 6 for w in range(10)])
    return out


def test_ubx_with_raw_and_subframes_needs_no_other_rover_file(
    pair: Pair, solved: GnssLog, tmp_path: Path
) -> None:
    rover = tmp_path / "flight.ubx"
    rover.write_bytes(ubx_of(pair.log, pair.sent))
    log = solve_ppk(rover, pair.base, [])
    error = pair.errors(log)
    assert len(log) == len(solved)
    assert np.mean(log.fix == FIX_FIXED) > 0.98
    assert np.all(rms(error) < [0.012, 0.012, 0.03])


def test_ubx_without_raw_measurements_says_so(pair: Pair, tmp_path: Path) -> None:
    rover = tmp_path / "flight.ubx"
    rover.write_bytes(ubx((1, 7), bytes(92)) * 20)
    with pytest.raises(InputError, match=r"flight\.ubx: has no raw measurements \(RXM-RAWX\)"):
        solve_ppk(rover, pair.base, [pair.nav])


# ---------------------------------------------------------------------------------------------
# Unfit files
# ---------------------------------------------------------------------------------------------


def _later(pair: Pair, folder: Path) -> tuple[Path, Path, list[Path]]:
    log = replace(pair.base_log, start_gps=pair.base_log.start_gps + 86400.0)
    write_observations(folder / "later.obs", log, approximate=BASE)
    return pair.rover, folder / "later.obs", [pair.nav]


def _others(pair: Pair, folder: Path) -> tuple[Path, Path, list[Path]]:
    text = pair.base.read_text().replace("\nG", "\nE").replace("G    4 C1C", "E    4 C1C")
    (folder / "other.obs").write_text(text)
    return pair.rover, folder / "other.obs", [pair.nav]


def _old_nav(pair: Pair, folder: Path) -> tuple[Path, Path, list[Path]]:
    old = [replace(eph, toe=eph.toe - 2 * 86400.0) for eph in pair.sent]
    write_navigation(folder / "old.nav", old)
    return pair.rover, pair.base, [folder / "old.nav"]


def _written(name: str, content: bytes) -> Callable[[Pair, Path], tuple[Path, Path, list[Path]]]:
    def make(pair: Pair, folder: Path) -> tuple[Path, Path, list[Path]]:
        (folder / name).write_bytes(content)
        return folder / name, pair.base, [pair.nav]

    return make


def _without(*words: str) -> Callable[[Pair, Path], tuple[Path, Path, list[Path]]]:
    """Rover cut after the header, or with a word of its header replaced."""

    def make(pair: Pair, folder: Path) -> tuple[Path, Path, list[Path]]:
        text = pair.rover.read_text()
        head = text[: text.index("END OF HEADER") + 14]
        text = head if not words else text.replace(*words, 1)
        (folder / "cut.obs").write_text(text)
        return folder / "cut.obs", pair.base, [pair.nav]

    return make


CASES: dict[str, tuple[Callable[[Pair, Path], tuple[Path, Path, list[Path]]], str]] = {
    "other_day": (_later, r"rover\.obs: does not overlap later\.obs in time: 2024-06-26 .* UTC"),
    "no_common": (_others, r"rover\.obs: has no satellite in common with other\.obs"),
    "old_nav": (_old_nav, r"old\.nav: the navigation files have elements of 0 of \d+ satellites"),
    "no_nav": (lambda p, f: (p.rover, p.base, []), r"rover\.obs: no navigation file is given"),
    "swapped": (lambda p, f: (p.nav, p.base, [p.nav]), r"x\.nav: is a navigation file; an obs"),
    "obs_as_nav": (lambda p, f: (p.rover, p.base, [p.base]), r"base\.obs: is an observation file"),
    "same_file": (lambda p, f: (p.rover, p.rover, [p.nav]), r"rover\.obs: is given as rover and"),
    "base_unplaced": (
        lambda p, f: (p.base, p.rover, [p.nav]), r"APPROX POSITION XYZ: the header has no position",
    ),
    "missing": (lambda p, f: (f / "no.obs", p.base, [p.nav]), r"no\.obs: cannot be read"),
    "empty": (_written("e.obs", b""), r"e\.obs: is empty"),
    "garbage": (_written("g.obs", os.urandom(64) * 300), r"g\.obs: is neither RINEX"),
    "text": (_written("t.csv", b"time,lat,lon\n1,2,3\n"), r"t\.csv: is neither RINEX"),
    "compact": (
        _written("c.crx", b"3.0".ljust(20) + b"COMPACT RINEX FORMAT".ljust(40) + b"CRINEX VERS"),
        r"c\.crx: is Hatanaka-packed; unpack it with crx2rnx",
    ),
    "half_gzip": (_written("h.gz", gzip.compress(os.urandom(5000))[:3000]), r"h\.gz: gzip data"),
    "rinex4": (
        _written("v4.obs", b"     4.00           OBSERVATION DATA".ljust(60)
                 + b"RINEX VERSION / TYPE"),
        r"v4\.obs: RINEX 4\.00 is not read",
    ),
    "header_only": (_without(), r"cut\.obs: has no epochs"),
    "no_phase": (_without("L1C", "C1W"), r"cut\.obs: has no carrier phase on L1"),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_unfit_files_are_refused_in_one_line(pair: Pair, tmp_path: Path, case: str) -> None:
    make, expected = CASES[case]
    rover, base, nav = make(pair, tmp_path)
    with pytest.raises(InputError, match=expected) as caught:
        solve_ppk(rover, base, nav)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("options", "word"),
    [
        (PpkOptions(systems=("GPS", "XYZ")), "XYZ"),
        (PpkOptions(sigma_scale=0.0), "sigma_scale"),
        (PpkOptions(elevation_mask=15.0), "elevation_mask"),
        (PpkOptions(frequency="L1+L2"), "frequency"),
        (PpkOptions(systems=("GAL",)), "no satellite in common"),
    ],
)
def test_unfit_options_are_refused(pair: Pair, options: PpkOptions, word: str) -> None:
    with pytest.raises(InputError, match=word):
        solve_ppk(pair.rover, pair.base, [pair.nav], options)


def test_a_mask_above_all_satellites_finds_no_position(pair: Pair) -> None:
    with pytest.raises(InputError, match=r"rover\.obs: RTKLIB finds no position"):
        solve_ppk(pair.rover, pair.base, [pair.nav], PpkOptions(elevation_mask=1.04))


def test_a_crash_of_the_library_is_an_error_of_one_line_and_leaves_nothing(
    pair: Pair, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    broken, scratch = tmp_path / "broken", tmp_path / "scratch"
    for folder in (broken, scratch):
        folder.mkdir()
    (broken / "pyrtklib.py").write_text("import os, sys\nprint('heap gone')\nsys.stdout.flush()\n"
                                        "os.abort()\n")  # fmt: skip
    monkeypatch.syspath_prepend(str(broken))
    monkeypatch.setattr(tempfile, "tempdir", str(scratch))
    with pytest.raises(InputError, match=r"broke off \(signal 6\): heap gone"):
        solve_ppk(pair.rover, pair.base, [pair.nav])
    assert list(scratch.iterdir()) == []


def test_a_hung_library_is_ended_by_the_clock_or_by_the_user(
    pair: Pair, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "pyrtklib.py").write_text("import time\ntime.sleep(60)\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(InputError, match=r"not done after 0\.3 s"):
        solve_ppk(pair.rover, pair.base, [pair.nav], PpkOptions(timeout=0.3))

    def stop() -> None:
        raise Cancelled("stopped by the user")

    with pytest.raises(Cancelled):
        run_ppk(pair.rover, pair.base, [pair.nav], check=stop)


# ---------------------------------------------------------------------------------------------
# .pos, and the tool
# ---------------------------------------------------------------------------------------------


def test_signed_roots_are_rtklibs_columns() -> None:
    """Hand-made: cov(n, e) = -4, cov(e, u) = 1, cov(u, n) = 2 in units of cm^2."""
    sd = np.array([[0.03, 0.04, 0.05, -0.02, 0.01, math.sqrt(2.0) / 100.0]])
    c = covariance_ned(sd)[0] * 1e4
    assert c == pytest.approx(np.array([[9, -4, -2], [-4, 16, -1], [-2, -1, 25]], dtype=float))
    assert signed_roots(covariance_ned(sd)) == pytest.approx(sd)


def test_rounded_covariances_stay_positive_definite() -> None:
    sd = np.array([[0.0010, 0.0010, 0.0, 0.0011, 0.0, 0.0]])
    assert np.all(np.linalg.eigvalsh(covariance_ned(sd)) > 0.0)


def test_pos_file_reads_back_by_the_log_reader(solution: PpkSolution, tmp_path: Path) -> None:
    write_pos(tmp_path / "x.pos", solution)
    log, back = solution.log, read_rtklib_pos(tmp_path / "x.pos").gnss
    assert back is not None
    assert back.height_kind is HeightKind.ELLIPSOIDAL
    assert back.time == pytest.approx(log.time, abs=1.5e-6)
    # 1e-9 deg are 0.1 mm
    assert np.degrees(back.lat) == pytest.approx(np.degrees(log.lat), abs=1.1e-9)
    assert back.height == pytest.approx(log.height, abs=1e-4)
    assert back.v_ned == pytest.approx(log.v_ned, abs=1e-5)
    assert np.array_equal(back.fix, log.fix)
    assert np.array_equal(back.satellites, log.satellites)
    assert back.covariance_ned == pytest.approx(log.covariance_ned, abs=6e-6)
    assert not list(tmp_path.glob("*.part"))


@pytest.mark.parametrize("suffix", [".pos", ".csv"])
def test_tool_writes_what_it_sums_up(pair: Pair, tmp_path: Path, suffix: str) -> None:
    output, events = tmp_path / f"gnss{suffix}", tmp_path / "events.csv"
    parameters = Ppk.Parameters(
        rover=pair.rover, base=pair.base, nav=(pair.nav,), output=output, events=events,
        base_at="39.65,-79.95,280.0",
    )  # fmt: skip
    feedback = CollectingFeedback()
    result = Ppk().run(Context(), parameters, feedback)
    assert result.summary["positions"] == len(pair.log.tag)
    assert result.summary["fixed_percent"] > 98.0
    assert result.summary["events"] == len(events.read_text().splitlines()) - 1 == len(EVENTS)
    lines = [line for line in output.read_text().splitlines() if line[0] not in "%g"]
    assert len(lines) == len(pair.log.tag)
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted([output.name, events.name])


def test_tool_refuses_a_wrong_base_place_and_leaves_the_old_file(
    pair: Pair, tmp_path: Path
) -> None:
    output = tmp_path / "gnss.pos"
    output.write_text("old")
    parameters = Ppk.Parameters(
        rover=pair.rover, base=pair.base, nav=(pair.nav,), output=output, base_at="39.65;-79.95"
    )
    with pytest.raises(InputError, match=r"base_at: '39\.65;-79\.95' is no place"):
        Ppk().run(Context(), parameters, CollectingFeedback())
    assert output.read_text() == "old"


# ---------------------------------------------------------------------------------------------
# A real pair
# ---------------------------------------------------------------------------------------------


def test_real_pair_of_geonet_stations_fixes_to_centimetres() -> None:
    """RTKLIB's own test data: stations 3040 and 0759, 3.3 km, 30 s, treated as if one moved."""
    folder = Path(os.environ.get("GEOREF_DATA", "")) / "gnss_pair"
    if not (folder / "07590920.05o").is_file():
        pytest.skip("GEOREF_DATA/gnss_pair/07590920.05o is not there (RTKLIB test/data/rinex)")
    rover, base = folder / "07590920.05o", folder / "30400920.05o"
    log = solve_ppk(rover, base, [folder / "30400920.05n"])
    p = ecef_from_geo(np.stack([log.lat, log.lon, log.height], axis=-1))
    R = R_ecef_from_ned(log.lat[0], log.lon[0])
    spread = np.std((p - p[0]) @ R, axis=0)
    assert np.mean(log.fix == FIX_FIXED) > 0.98
    assert np.all(spread < [0.008, 0.008, 0.02])
    marker = read_observations(rover).marker_ecef
    assert marker is not None
    # The headers' places are approximate: decimetres.
    assert np.linalg.norm(np.mean(p, axis=0) - marker) < 0.5
