"""Simulated raw GPS: orbits against RTKLIB's, and measurements against what they must obey."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from georef_gis.simulate import ellipsoid
from georef_gis.simulate.gnss_orbits import (
    LIGHT,
    constellation,
    satellite_position,
    with_broadcast_error,
)
from georef_gis.simulate.gnss_raw import (
    FREQUENCIES,
    RawSettings,
    Slip,
    fixed_track,
    orbiting_track,
    simulate_raw,
)
from georef_gis.simulate.rinex import write_navigation, write_observations

START = 929541600.0  # 2009-06-20 14:00:00 on the GPS scale
PLACE = ellipsoid.ecef_from_geodetic(np.radians(39.65), np.radians(-79.95), np.array(280.0))
QUIET = RawSettings(
    code_noise=0.0, phase_noise=0.0, doppler_noise_hz=0.0, code_multipath=0.0,
    phase_multipath=0.0, bands=2,
)  # fmt: skip


def measure(settings: RawSettings, tags: np.ndarray, seed: int = 1):  # type: ignore[no-untyped-def,type-arg]
    rng = np.random.default_rng(seed)
    sats = constellation(START)
    return simulate_raw(fixed_track(PLACE), tags, sats, settings, rng, start_gps=START)


def test_orbits_and_clocks_are_those_rtklib_finds_in_the_file(tmp_path: Path) -> None:
    rtk = pytest.importorskip("pyrtklib")
    sats = constellation(START, seed=3)
    write_navigation(tmp_path / "x.nav", sats)
    nav = rtk.nav_t()
    assert rtk.readrnx(str(tmp_path / "x.nav"), 1, "", rtk.obs_t(), nav, rtk.sta_t()) == 1
    assert nav.n == len(sats)
    after = np.array([-3000.0, 0.0, 2718.25])
    for k in range(nav.n):
        eph = nav.eph[k]
        ours = next(s for s in sats if s.prn == eph.sat)
        p, clock = satellite_position(ours, after)
        for i, t in enumerate(after):
            rs, dts, var = rtk.Arr1Ddouble(3), rtk.Arr1Ddouble(1), rtk.Arr1Ddouble(1)
            rtk.eph2pos(rtk.timeadd(eph.toe, float(t)), eph, rs, dts, var)
            # 12 digits of the file: below a millimetre in place and in the clock
            assert [rs[j] for j in range(3)] == pytest.approx(p[i], abs=1e-3)
            assert dts[0] * LIGHT == pytest.approx(clock[i] * LIGHT, abs=1e-3)


def test_satellites_come_back_after_a_sidereal_day_and_enough_are_up() -> None:
    up = PLACE / np.linalg.norm(PLACE)
    seen = 0
    for eph in constellation(START):
        p, _ = satellite_position(eph, np.array([0.0, 86164.0]))
        # The node drifts by 0.04 deg a day and the drawn periods differ a little.
        assert np.linalg.norm(p[1] - p[0]) < 400e3
        assert 26.0e6 < np.linalg.norm(p[0]) < 27.2e6
        d = p[0] - PLACE
        seen += bool(d @ up / np.linalg.norm(d) > math.sin(math.radians(10.0)))
    assert 9 <= seen <= 13


def test_pseudorange_is_light_time_clock_and_air() -> None:
    """By a way of its own: emission time by bisection in an inertial frame."""
    log = measure(QUIET, np.array([10.0]))
    rate = 7.2921151467e-5
    sats = {s.prn: s for s in constellation(START)}
    for k in np.flatnonzero(np.isfinite(log.code[0, :, 0])):
        eph = sats[log.prns[k]]

        def miss(travel: float, eph=eph) -> float:  # type: ignore[no-untyped-def]
            emitted = START - eph.toe + log.time[0] - travel
            s = satellite_position(eph, np.array([emitted]))[0][0]
            # Axes of emission; the antenna has been turned back by the Earth's turn since.
            a = rate * travel
            turn = np.array([[math.cos(a), -math.sin(a), 0], [math.sin(a), math.cos(a), 0],
                             [0, 0, 1]])  # fmt: skip
            return float(np.linalg.norm(s - turn @ PLACE)) - LIGHT * travel

        low, high = 0.05, 0.1
        for _ in range(60):
            middle = (low + high) / 2.0
            low, high = (middle, high) if miss(middle) > 0.0 else (low, middle)
        emitted = np.array([START - eph.toe + log.time[0] - low])
        clock = satellite_position(eph, emitted)[1][0] - eph.tgd
        bare = LIGHT * (low - clock + QUIET.clock_offset + QUIET.clock_drift * 10.0)
        # What is left is 2.3 m of dry, 0.1 m of wet air and 3 m of ionosphere over sin(10 deg).
        assert 4.5 < log.code[0, k, 0] - bare < 25.0


def test_ambiguities_are_whole_numbers() -> None:
    """Two antennas at one place: double differences of the phase hold nothing else."""
    tags = np.arange(0.0, 5.0)
    a, b = measure(QUIET, tags, seed=1), measure(QUIET, tags, seed=2)
    up = np.flatnonzero(np.all(np.isfinite(a.code[:, :, 0]), axis=0))
    single = (a.phase - b.phase)[:, up]
    double = single - single[:, :1]
    assert np.max(np.abs(double - np.round(double))) < 1e-4
    assert np.ptp(double[0]) > 1000.0


def test_code_and_phase_part_by_twice_the_ionosphere() -> None:
    log = measure(QUIET, np.arange(0.0, 600.0, 100.0))
    wave = LIGHT / np.array(FREQUENCIES)
    apart = log.code - log.phase * wave
    change = apart[-1] - apart[0]
    k = np.isfinite(change[:, 0]) & np.isfinite(change[:, 1])
    # The delay grows with the inverse square of the frequency.
    assert change[k, 1] == pytest.approx(change[k, 0] * (FREQUENCIES[0] / FREQUENCIES[1]) ** 2,
                                         abs=1e-4)  # fmt: skip


def test_doppler_is_the_rate_of_the_phase_turned_round() -> None:
    rng = np.random.default_rng(4)
    track = orbiting_track(PLACE, wait=0.0)
    tags = np.arange(30.0, 31.0, 0.01)
    log = simulate_raw(track, tags, constellation(START), QUIET, rng, start_gps=START)
    rate = (log.phase[2:] - log.phase[:-2]) / 0.02
    k = np.all(np.isfinite(rate), axis=(0, 2))
    assert -rate[:, k] == pytest.approx(log.doppler[1:-1, k], abs=0.05)


def test_slip_moves_the_phase_and_is_flagged_only_where_noticed() -> None:
    tags = np.arange(0.0, 10.0)
    still = measure(QUIET, tags)
    prn = int(np.array(still.prns)[np.isfinite(still.code[0, :, 0])][2])
    k = still.prns.index(prn)
    for flagged in (True, False):
        slip = Slip(prn=prn, time=5.0, cycles=7, flagged=flagged)
        log = measure(replace(QUIET, slips=(slip,)), tags)
        moved = log.phase[:, k, 0] - still.phase[:, k, 0]
        assert moved == pytest.approx([0.0] * 5 + [7.0] * 5, abs=1e-6)
        assert log.lost[:, k, 0].tolist() == [i == 5 and flagged for i in range(10)]


def test_satellites_below_the_mask_are_not_measured() -> None:
    few = measure(replace(QUIET, elevation_mask_deg=40.0), np.array([0.0]))
    many = measure(replace(QUIET, elevation_mask_deg=5.0), np.array([0.0]))
    assert np.isfinite(few.code).sum() < np.isfinite(many.code).sum()


def test_broadcast_error_is_of_the_size_asked_for() -> None:
    rng = np.random.default_rng(5)
    off = []
    for eph in constellation(START):
        sent = with_broadcast_error(eph, rng, 1.0)
        p, _ = satellite_position(eph, np.zeros(1))
        q, _ = satellite_position(sent, np.zeros(1))
        off.append(float(np.linalg.norm(p - q)))
    assert 0.5 < np.sqrt(np.mean(np.square(off))) < 2.5


@pytest.mark.parametrize("version", ["3.03", "2.11"])
def test_observation_file_keeps_columns_and_values(tmp_path: Path, version: str) -> None:
    log = measure(RawSettings(bands=2), np.array([0.0, 59.9999999, 60.0]))
    file = tmp_path / "x.obs"
    write_observations(file, log, version=version, approximate=PLACE, events=[30.5])
    lines = file.read_text().splitlines()
    assert max(map(len, lines[:8])) <= 80
    assert lines[0][60:] == "RINEX VERSION / TYPE"
    body = lines[[line[60:] for line in lines].index("END OF HEADER") + 1 :]
    stamps = [line for line in body if "2009 06 20 14" in line or " 09  6 20 14" in line]
    # The marker's epoch stands between its neighbours, and no second reads 60.
    assert [line.split()[-2] for line in stamps][1] == "5"
    assert not any(" 60.0" in line for line in stamps)
    first = body[1]
    k = int(np.flatnonzero(np.isfinite(log.code[0, :, 0]))[0])
    shift = 3 if version == "3.03" else 0
    assert float(first[shift : shift + 14]) == pytest.approx(log.code[0, k, 0], abs=6e-4)
    assert float(first[shift + 16 : shift + 30]) == pytest.approx(log.phase[0, k, 0], abs=6e-4)
