"""The camera clock without events: GPS times in tags, positions on a track, the user's word."""

from __future__ import annotations

import math
import os
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest

from georef_gis.errors import NavigationError
from georef_gis.navigate.clock_fit import clock_of_tag_times, clock_seconds
from georef_gis.navigate.exposures import MatchOptions, PhotoClock, match_exposures
from georef_gis.navigate.position_clock import TaggedPositions, clock_from_positions

START = 1.0e9


def test_seneca_is_four_hours_and_34_seconds_behind() -> None:
    folder = os.environ.get("GEOREF_DATA")
    if not folder:
        pytest.skip("GEOREF_DATA is not set: no real data")
    from georef_gis.ingest.photos import find_photos, read_photos

    photos = read_photos(find_photos(Path(folder) / "seneca16", subfolders=True)).photos
    clocks = [
        PhotoClock(name=p.id, clock=clock_seconds(p.camera_clock), time_gps=p.time_gps,
                   time_sigma=p.time_sigma)
        for p in photos if p.camera_clock is not None
    ]  # fmt: skip
    found = match_exposures(clocks)
    # 1 s: both clocks show whole seconds
    assert found.clock.offset == pytest.approx(-(4 * 3600 + 34), abs=1.0)
    assert 0.1 < found.clock.sigma < 0.5
    tags = np.array([c.time_gps for c in clocks])
    # a stamp of a whole second is up to 1 s old; 0.5 s for the clock
    assert np.all(np.abs(found.time - tags - 0.5) < 1.5)


def test_tag_times_give_offset_and_drift_within_their_sigmas() -> None:
    z = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        t = START + np.sort(rng.uniform(0, 1800, 60))
        offset, drift = rng.uniform(-4e4, 4e4), rng.normal(0, 20e-6)
        clock = np.floor(t + offset + drift * (t - START))
        common = rng.normal(0, 0.1)
        tag = t + common + rng.normal(0, 0.2 * math.sqrt(0.75), 60)
        tag[:6] = tag[0] - 500.0
        fit = clock_of_tag_times(clock, np.ones(60), tag, np.full(60, 0.2))
        truth = offset + drift * (fit.epoch - START)
        assert fit.doubts != ()
        z.append(
            ((fit.offset - truth) / fit.sigma, (fit.drift - drift) / fit.covariance[1, 1] ** 0.5)
        )
    rms = np.sqrt(np.mean(np.square(z), axis=0))
    assert np.all((rms > 0.7) & (rms < 1.4)), rms


def test_whole_seconds_on_both_sides_are_understood() -> None:
    """Cut like the clock's, the tags leave no half second; the common sigma covers rounding."""
    for seed in range(20):
        rng = np.random.default_rng(seed)
        t = START + np.sort(rng.uniform(0, 900, 100))
        offset = rng.uniform(-100, 100)
        fit = clock_of_tag_times(np.floor(t + offset), np.ones(100), np.floor(t), np.full(100, 0.3))
        assert fit.offset == pytest.approx(offset, abs=0.2)


def test_the_users_offset_goes_before_everything() -> None:
    photos = [PhotoClock(name=str(i), clock=START + 3600.0 + 3 * i) for i in range(5)]
    found = match_exposures(photos, None, MatchOptions(offset=3600.0, offset_sigma=2.0))
    assert found.time == pytest.approx(START + 0.5 + 3.0 * np.arange(5), abs=1e-6)
    assert found.sigma == pytest.approx(math.hypot(2.0, 1 / math.sqrt(12)), rel=1e-3)
    assert set(found.source) == {"clock"}


def test_the_users_offset_is_against_utc_not_gps() -> None:
    """A clock that shows UTC to the second has the offset 0, though GPS was 16 s ahead in 2013."""
    utc = datetime(2013, 6, 4, 12, 0, 5)
    photos = [PhotoClock(name="A", clock=clock_seconds(utc))]
    found = match_exposures(photos, None, MatchOptions(offset=0.0, offset_sigma=0.1))
    # seconds since 1980-01-06 without leap seconds, and the 16 inserted by then; the half second
    # is the middle of a reading that is cut to whole ones
    passed = (utc - datetime(1980, 1, 6)).total_seconds()
    assert found.time[0] == pytest.approx(passed + 16.0 + 0.5, abs=1e-6)


def test_an_exact_tag_is_better_than_the_clock() -> None:
    photos = [
        PhotoClock(name=str(i), clock=START + 7200 + 4 * i, time_gps=START + 4.3 * i,
                   time_sigma=0.01)
        for i in range(5)
    ]  # fmt: skip
    found = match_exposures(photos)
    assert set(found.source) == {"tag"}
    assert found.time == pytest.approx(START + 4.3 * np.arange(5))


def test_clock_seconds_are_on_the_gps_scale() -> None:
    # 16 leap seconds by 2013 (IERS Bulletin C)
    assert clock_seconds(datetime(1980, 1, 7)) == 86400.0
    assert clock_seconds(datetime(2013, 6, 4)) % 86400.0 == 16.0


def survey(t):
    """Legs of 400 m to and fro, 40 m apart, at 20 m/s; turns of 10 s."""
    t = np.asarray(t, float) - START
    leg, within = np.divmod(t, 30.0)
    sign = np.where(leg % 2 == 0, 1.0, -1.0)
    turning = np.clip(within - 20.0, 0.0, 10.0) / 10.0
    x = -200.0 + 20.0 * np.clip(within, 0, 20)
    p = np.stack([sign * (x + 30 * np.sin(np.pi * turning)), 40.0 * (leg + turning)], axis=-1)
    p[(t < 0) | (t > 600)] = np.nan
    return p


def track(t):
    return survey(t), (survey(t + 0.05) - survey(t - 0.05)) / 0.1


def tagged(seed: int, offset: float, *, noise=1.0, resolution=1.0, path=survey):
    rng = np.random.default_rng(seed)
    t = START + np.sort(rng.uniform(20, 580, 80))
    clock = np.floor((t + offset) / resolution) * resolution + 0.5 * resolution
    alike = np.exp(-np.abs(t[:, None] - t) / 30.0) + 1e-9 * np.eye(80)
    slow = np.linalg.cholesky(alike) @ rng.normal(0, noise / math.sqrt(2), (80, 2))
    bias = rng.normal(0, 1.0, 2)
    p = path(t) + bias + slow + rng.normal(0, noise / math.sqrt(2), (80, 2))
    return TaggedPositions(
        clock=clock, resolution=np.full(80, resolution), position=p, sigma=np.full(80, noise)
    )


def test_positions_find_hours_and_fractions_within_their_sigma() -> None:
    z = []
    for seed in range(40):
        offset = -14434.0 + np.random.default_rng(seed + 1000).uniform(-50, 50)
        fit = clock_from_positions(tagged(seed, offset), track, START, START + 600)
        z.append((fit.offset - offset) / fit.sigma)
        assert fit.alternatives == ()
    assert 0.7 < np.sqrt(np.mean(np.square(z))) < 1.4


def test_a_track_flown_twice_is_named() -> None:
    def circle(t):
        a = 2 * np.pi * (np.asarray(t) - START) / 60.0
        p = 100.0 * np.stack([np.cos(a), np.sin(a)], axis=-1)
        return np.where(((t >= START) & (t <= START + 600))[:, None], p, np.nan)

    def round_and_round(t):
        return circle(t), (circle(t + 0.05) - circle(t - 0.05)) / 0.1

    one = tagged(1, 3600.0, path=circle)
    some = slice(20, 50)
    part = TaggedPositions(
        clock=one.clock[some], resolution=one.resolution[some], position=one.position[some],
        sigma=one.sigma[some],
    )  # fmt: skip
    fit = clock_from_positions(part, round_and_round, START, START + 600)
    assert fit.confidence < 0.9
    assert any("flown twice" in words for words in fit.alternatives)
    rest = (fit.offset - 3600.0) % 60.0
    assert min(rest, 60.0 - rest) < 5 * fit.sigma


def test_stray_positions_are_left_out_and_counted() -> None:
    one = tagged(3, 77.0)
    one.position[[4, 9, 30]] += 500.0
    fit = clock_from_positions(one, track, START, START + 600)
    assert fit.offset == pytest.approx(77.0, abs=4 * fit.sigma)
    assert fit.doubts == ("3 of 80 tagged positions do not lie on the track",)


def test_positions_elsewhere_are_refused() -> None:
    one = tagged(4, 0.0)
    one.position[:] += 5000.0
    with pytest.raises(NavigationError, match="nowhere on the track"):
        clock_from_positions(one, track, START, START + 600)


def test_two_positions_are_too_few() -> None:
    one = tagged(5, 0.0)
    one.position[2:] = np.nan
    with pytest.raises(NavigationError, match="only 2 photos"):
        clock_from_positions(one, track, START, START + 600)
