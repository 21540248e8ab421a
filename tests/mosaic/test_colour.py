"""Colour of a mosaic, against simulated photos whose gains, lens and light are known."""

from __future__ import annotations

import json
from dataclasses import fields, replace

import numpy as np
import pytest
from colour_cases import Flight, chain, grid_flight, views_and_places

from georef_gis.mosaic.colour import ColourModel, ColourSettings, solve_colour
from georef_gis.mosaic.colour_steps import residual_steps
from georef_gis.mosaic.overlaps import Overlaps

FULL = ColourSettings()


def solved(flight: Flight, settings: ColourSettings = FULL) -> tuple[Overlaps, ColourModel]:
    block = flight.block()
    return block[0], solve_colour(*block, settings)


def ramp_free(flight: Flight, gain: np.ndarray) -> np.ndarray:
    """Errors of gains apart from a plane over the site.

    A plane of gains looks the same as a tilt of the trend of view: which of them it is, is left to
    the priors.
    """
    error = gain - flight.gain
    design = np.concatenate([np.ones((len(gain), 1)), flight.nadirs], axis=1)
    return np.asarray(error - design @ np.linalg.lstsq(design, error, rcond=None)[0])


def taken(overlaps: Overlaps, which: np.ndarray) -> Overlaps:
    return Overlaps(**{f.name: getattr(overlaps, f.name)[which] for f in fields(Overlaps)})


def test_gains_of_every_band_are_found() -> None:
    flight = grid_flight()
    _, model = solved(flight)
    # what the priors shrink of 0.15, in parts
    np.testing.assert_allclose(ramp_free(flight, model.gain), 0.0, atol=5e-3)


def test_an_infrared_band_has_gains_of_its_own() -> None:
    flight = grid_flight(bands=4)
    flight.gain[:, 3] = np.linspace(-0.4, 0.4, 20)[np.random.default_rng(2).permutation(20)]
    _, model = solved(flight)
    np.testing.assert_allclose(ramp_free(flight, model.gain), 0.0, atol=5e-3)


def test_offsets_of_hazy_photos_lessen_the_steps() -> None:
    flight = grid_flight(noise=0.01)
    flight.offset[:] = np.random.default_rng(5).normal(0.0, 4.0, flight.offset.shape)
    overlaps, with_offsets = solved(flight)
    steps = residual_steps(overlaps, with_offsets).median
    none = solve_colour(*flight.block(), replace(FULL, sigma_offset=0.0))
    # noise of 1 % at both ends of grey values about 100: a median difference of 1
    assert (steps < 1.3).all()
    assert (np.abs(none.offsets) < 1e-4).all()
    assert (steps < 0.7 * residual_steps(overlaps, none).median).all()


def test_lens_and_hot_spot_are_taken_out_together() -> None:
    flight = grid_flight(vignetting=0.3, hot_spot=0.35, noise=0.01)
    overlaps, model = solved(flight)
    before = residual_steps(overlaps, None)
    after = residual_steps(overlaps, model)
    assert (before.median > 10.0).all()
    assert (after.median < 1.3).all()
    rng = np.random.default_rng(8)
    xy, view = views_and_places(rng.uniform([-0.45, -0.36], [0.45, 0.36], (500, 2)))
    log = np.log(model.factor(7, xy, view) * flight.light(xy, view)[:, None]) - flight.gain[7]
    # A ramp of gains over the site and a tilt of the view trend look the same: it is left to the
    # priors. Apart from it, 2 % is what a polynomial of order 4 misses of the spot.
    design = np.concatenate([np.ones((500, 1)), xy], axis=1)
    rest = log - design @ np.linalg.lstsq(design, log, rcond=None)[0]
    assert np.sqrt((rest**2).mean()) < 0.02


def test_a_tenth_of_wrong_blocks_does_no_harm() -> None:
    flight = grid_flight(vignetting=0.2, noise=0.01, outliers=0.1)
    overlaps, model = solved(flight)
    np.testing.assert_allclose(ramp_free(flight, model.gain), 0.0, atol=0.01)
    assert (residual_steps(overlaps, model).median < 1.5).all()


def test_a_photo_of_twice_the_exposure_is_no_outlier() -> None:
    flight = grid_flight(noise=0.01, outliers=0.05)
    flight.gain[7] += np.log(2.0)
    flight.gain -= flight.gain.mean(axis=0)
    _, model = solved(flight)
    np.testing.assert_allclose(ramp_free(flight, model.gain), 0.0, atol=0.01)


def test_a_long_chain_does_not_drift() -> None:
    flight = chain(300, noise=0.03, hot_spot=0.2, vignetting=0.2)
    overlaps, model = solved(flight)
    error = model.gain - flight.gain
    # a random walk of 3 % noise over 60 blocks would be off by 0.1 at the ends, with the bias of
    # lens and light by several
    assert np.abs(error).max() < 0.08
    assert (residual_steps(overlaps, model).median < 4.5).all()


def test_gains_that_nothing_holds_end_somewhere() -> None:
    block = chain(300, noise=0.03, hot_spot=0.4).block()
    model = solve_colour(*block, replace(FULL, sigma_gain=50.0, sigma_trend=1e-3))
    assert np.isfinite(model.gain).all()


def test_groups_without_a_link_keep_their_own_brightness() -> None:
    flight = chain(20)
    flight.links = [(i, j) for i, j in flight.pairs() if (i < 10) == (j < 10)]
    _, model = solved(flight)
    for group in (slice(0, 10), slice(10, 20)):
        np.testing.assert_allclose(model.gain[group].mean(axis=0), 0.0, atol=1e-6)
        part = replace(flight, nadirs=flight.nadirs[group], gain=flight.gain[group])
        np.testing.assert_allclose(ramp_free(part, model.gain[group]), 0.0, atol=0.01)


def test_a_photo_alone_stays_as_it_is() -> None:
    flight = chain(1)
    flight.links = [(0, 0)]
    nothing = taken(flight.overlaps(), np.zeros(0, np.int64))
    model = solve_colour(nothing, 1, ["cam"], ["flight"], FULL)
    xy = view = np.array([[0.1, 0.9], [0.0, 0.0]])
    np.testing.assert_array_equal(model.factor(0, xy, view), np.ones((2, 3)))
    np.testing.assert_array_equal(model.offset(0), np.zeros(3))
    assert residual_steps(nothing, model).pairs.shape == (0, 2)


def test_a_photo_without_partners_gets_lens_and_light_only() -> None:
    flight = chain(12, vignetting=0.3)
    flight.links = [(i, j) for i, j in flight.pairs() if 11 not in (i, j)]
    _, model = solved(flight)
    np.testing.assert_allclose(model.gain[11], 0.0, atol=1e-9)
    centre, corner = model.factor(11, np.array([[0, 0], [0.7, 0.7]]), np.zeros((2, 2)))
    np.testing.assert_allclose(centre, 1.0)
    assert (corner > 1.05).all()


def test_two_cameras_have_two_vignettings() -> None:
    rows = [grid_flight(vignetting=v) for v in (0.4, 0.0)]
    rows[0].nadirs += np.array([100.0, 0.0])
    parts = [flight.overlaps() for flight in rows]
    shifted = replace(parts[1], a=parts[1].a + 20, b=parts[1].b + 20)
    both = Overlaps(
        **{
            f.name: np.concatenate([getattr(parts[0], f.name), getattr(shifted, f.name)])
            for f in fields(Overlaps)
        }
    )
    cameras, flights = ["old"] * 20 + ["new"] * 20, ["f1"] * 20 + ["f2"] * 20
    model = solve_colour(both, 40, cameras, flights, FULL)
    xy = np.array([[0.6, 0.0], [-0.6, 0.0], [0.0, 0.6], [0.0, -0.6]])
    xy, view = views_and_places(xy * 0.64)
    bright = [model.factor(p, xy, view).mean() / np.exp(model.gain[p]).mean() for p in (0, 20)]
    # exp(0.4 (0.6 0.36 + 0.4 0.13)) = 1.11 at this radius
    assert bright[0] == pytest.approx(1.11, abs=0.015)
    assert bright[1] == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize("full", [1.0, 65535.0])
def test_the_unit_of_the_data_does_not_matter(full: float) -> None:
    kinds = dict(vignetting=0.2, noise=0.01, outliers=0.05)
    _, small = solved(grid_flight(**kinds))
    _, large = solved(grid_flight(**kinds, full=full))
    # float32 of the values, and where the iteration ends
    np.testing.assert_allclose(large.gain, small.gain, atol=1e-4)
    np.testing.assert_allclose(large.offsets * 255.0 / full, small.offsets, atol=2e-2)


def test_the_order_of_blocks_does_not_matter_and_a_second_run_is_the_same() -> None:
    overlaps, n, cameras, flights = grid_flight(vignetting=0.2, noise=0.01).block()
    first = solve_colour(overlaps, n, cameras, flights, FULL)
    again = solve_colour(overlaps, n, cameras, flights, FULL)
    np.testing.assert_array_equal(first.gain, again.gain)
    mixed = taken(overlaps, np.random.default_rng(1).permutation(len(overlaps)))
    np.testing.assert_allclose(
        solve_colour(mixed, n, cameras, flights, FULL).gain, first.gain, atol=1e-8
    )


def test_modes_leave_out_what_they_say() -> None:
    flight = grid_flight(vignetting=0.3, hot_spot=0.2)
    xy = view = np.array([[0.6, 0.6]])
    block = flight.block()
    none, gain, full = (
        solve_colour(*block, ColourSettings(mode=mode)) for mode in ("none", "gain", "full")
    )
    np.testing.assert_array_equal(none.factor(3, xy, view), [[1.0, 1.0, 1.0]])
    np.testing.assert_allclose(gain.factor(3, xy, view)[0], np.exp(gain.gain[3]))
    assert (np.abs(full.factor(3, xy, view)[0] / np.exp(full.gain[3]) - 1.0) > 0.05).all()
    steps = [residual_steps(block[0], model).median.mean() for model in (none, gain, full)]
    assert steps[0] > 1.5 * steps[1] > 3.0 * steps[2]


def test_gains_alone_do_not_drift_for_what_they_cannot_say() -> None:
    block = chain(300, noise=0.03, hot_spot=0.2).block()
    model = solve_colour(*block, ColourSettings(mode="gain"))
    # the trend tilts neighbours by some 3 %: its sum over the chain would be 4.5 at either end
    assert np.abs(model.gain).max() < 0.35


def test_the_hot_spot_is_found_where_the_sun_is_and_taken_out() -> None:
    flight = grid_flight(vignetting=0.2, hot_spot=0.1, cone=0.1, noise=0.01)
    block = flight.block()
    model = solve_colour(*block, FULL)
    # a fraction of the cone's width of 0.08
    np.testing.assert_allclose(model.spots["flight"], flight.sun, atol=0.02)
    without = solve_colour(*block, replace(FULL, sigma_spot=0.0))
    assert without.spots == {}
    # the top of the cone and three places at its foot
    sun = np.array(flight.sun)
    view = sun + np.array([[0.0, 0.0], [0.0, 0.12], [0.1, 0.0], [-0.1, 0.0]])
    nadir = np.zeros((4, 2))
    left = np.log(model.factor(2, nadir, view)) + np.log(flight.light(nadir, view))[:, None]
    missed = np.log(without.factor(2, nadir, view)) + np.log(flight.light(nadir, view))[:, None]
    top_left, top_missed = (log[0] - log[1:].mean(axis=0) for log in (left, missed))
    # of a top of 0.075 over its foot; the place of the sun is known to a quarter of the width
    np.testing.assert_allclose(top_left, 0.0, atol=0.025)
    assert (top_missed > 2.0 * np.abs(top_left)).all()
    assert (residual_steps(block[0], model).p90 < residual_steps(block[0], without).p90).all()


@pytest.mark.parametrize("cone", [0.0, -0.1])
def test_where_nothing_shines_there_is_no_hot_spot(cone: float) -> None:
    _, model = solved(grid_flight(vignetting=0.2, hot_spot=0.05, cone=cone, noise=0.02))
    assert model.spots == {}


def test_dark_and_negative_values_do_no_harm() -> None:
    flight = grid_flight(noise=0.01)
    overlaps, n, cameras, flights = flight.block()
    dark = np.random.default_rng(4).random(len(overlaps)) < 0.05
    overlaps.value_a[dark] = -3.0
    model = solve_colour(overlaps, n, cameras, flights, FULL)
    np.testing.assert_allclose(ramp_free(flight, model.gain), 0.0, atol=0.01)


def test_a_model_survives_json() -> None:
    _, model = solved(grid_flight(vignetting=0.2, cone=0.1, noise=0.01))
    assert model.spots
    again = ColourModel.from_json(json.loads(json.dumps(model.to_json())))
    rng = np.random.default_rng(6)
    xy, view = rng.uniform(-0.7, 0.7, (2, 4, 5, 2))
    np.testing.assert_array_equal(again.factor(5, xy, view), model.factor(5, xy, view))
    np.testing.assert_array_equal(again.offset(5), model.offset(5))
    assert again.factor(5, xy, view).shape == (4, 5, 3)


def test_beyond_the_views_that_took_part_the_trend_goes_on_as_at_their_rim() -> None:
    _, model = solved(grid_flight(hot_spot=0.3), replace(FULL, sigma_spot=0.0))
    xy = np.zeros((2, 2))
    view = np.array([[model.reach, 0.0], [1.0, 0.0]])
    rim, beyond = model.factor(0, xy, view)
    np.testing.assert_allclose(beyond, rim)
