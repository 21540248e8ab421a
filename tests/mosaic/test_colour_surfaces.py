"""Surfaces of single photos, against simulated ones whose light is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from colour_cases import HALF, Flight, chain, grid_flight, views_and_places

from georef_gis.mosaic.block_means import Samples
from georef_gis.mosaic.colour import ColourModel, ColourSettings, solve_colour
from georef_gis.mosaic.colour_basis import surface_basis
from georef_gis.mosaic.colour_steps import residual_steps
from georef_gis.mosaic.colour_surfaces import solve_surfaces

FULL = ColourSettings()
NONE = replace(FULL, sigma_surface=0.0)


def clouded(size: float, **kwargs: float) -> Flight:
    flight = grid_flight(noise=0.01, **kwargs)
    flight.clouds = np.random.default_rng(21).normal(0.0, size, (len(flight.nadirs), 3))
    return flight


def left(flight: Flight, model: ColourModel) -> np.ndarray:
    """Logarithm of what is left of light and gain over the photos, apart from a plane of the site.

    Gains alone show it already, but a plane of the site no overlap tells.
    """
    offset = np.stack(np.meshgrid(*(np.linspace(-h, h, 9) for h in HALF)), axis=-1).reshape(-1, 2)
    xy, view = views_and_places(offset)
    logs, places = [], []
    for photo, nadir in enumerate(flight.nadirs):
        light = np.log(flight.light(xy, view)) + flight.cloud(photo, xy)
        own = np.log(model.factor(photo, xy, view)) + light[:, None] - flight.gain[photo]
        logs.append(own.mean(axis=1))
        places.append(offset + nadir)
    log = np.concatenate(logs)
    design = np.column_stack([np.ones(log.size), np.concatenate(places)])
    return np.asarray(log - design @ np.linalg.lstsq(design, log, rcond=None)[0])


def test_what_clouds_do_to_single_photos_is_taken_out() -> None:
    flight = clouded(0.08)
    block = flight.block()
    with_it, without = (solve_colour(*block, settings) for settings in (FULL, NONE))
    steps = [residual_steps(block[0], model).median.mean() for model in (with_it, without)]
    # noise of 1 % at both ends of grey values about 100: a median difference of 1
    assert steps[0] < 1.3
    assert steps[1] > 1.5 * steps[0]
    rms = [np.sqrt((left(flight, model) ** 2).mean()) for model in (with_it, without)]
    # rims of the block, which no other photo shows, are guessed
    assert rms[0] < 0.7 * rms[1]


def test_without_clouds_surfaces_are_nothing() -> None:
    block = grid_flight(vignetting=0.2, hot_spot=0.2, noise=0.01, outliers=0.1).block()
    model = solve_colour(*block, FULL)
    # 2 % are what a trend of order 4 misses of the hot spot
    assert np.abs(model.surface).max() < 0.03
    assert model.surface.std() < 0.01


def test_surfaces_change_neither_gains_nor_the_mean_of_a_photo() -> None:
    flight = chain(300, noise=0.03)
    # each photo brighter ahead: carried on from photo to photo a logarithm of 0.15 a photo
    flight.clouds = np.tile([0.25, 0.0, 0.1], (300, 1))
    block = flight.block()
    with_it, without = (solve_colour(*block, settings) for settings in (FULL, NONE))
    np.testing.assert_array_equal(with_it.gain, without.gain)
    offset = np.stack(np.meshgrid(*(np.linspace(-h, h, 21) for h in HALF)), axis=-1)
    xy, _ = views_and_places(offset.reshape(-1, 2))
    mean = np.einsum("kj,pjb->pb", surface_basis(xy), with_it.surface) / len(xy)
    # a photo of 5:4 for one of 4:3, by coefficients of 0.1
    assert np.abs(mean).max() < 0.003
    assert np.abs(with_it.gain - flight.gain).max() < 0.15


def test_a_photo_without_partners_has_none() -> None:
    flight = clouded(0.08)
    flight.links = [(i, j) for i, j in flight.pairs() if 19 not in (i, j)]
    model = solve_colour(*flight.block(), FULL)
    np.testing.assert_array_equal(model.surface[19], 0.0)
    assert np.abs(model.surface[:19]).max() > 0.02


def test_modes_and_bands_that_have_none() -> None:
    flight = clouded(0.08)
    overlaps, n, cameras, flights = flight.block()
    gain = solve_colour(overlaps, n, cameras, flights, replace(FULL, mode="gain"))
    assert not gain.surface.any()
    overlaps.weight[:, 1] = 0.0
    overlaps.value_a[:, 1] = overlaps.value_b[:, 1] = 255.0
    model = solve_colour(overlaps, n, cameras, flights, FULL)
    assert not model.surface[:, :, 1].any()
    np.testing.assert_array_equal(model.gain[:, 1], 0.0)
    assert np.abs(model.surface[:, :, 0]).max() > 0.02


def test_the_conjugate_gradients_give_the_least_squares(rng: np.random.Generator) -> None:
    overlaps, n, _, _ = clouded(0.08).block()
    k, bands = overlaps.value_a.shape
    residual, slope = rng.normal(0.0, 0.05, (k, bands)), rng.normal(0.5, 0.05, (k, bands))
    weights = rng.uniform(0.0, 400.0, (k, bands))
    found = solve_surfaces(overlaps, n, residual, slope, weights, 0.1)
    design = np.zeros((k, n, 5))
    design[np.arange(k), overlaps.a] += surface_basis(overlaps.xy_a)
    design[np.arange(k), overlaps.b] -= surface_basis(overlaps.xy_b)
    design = design.reshape(k, -1)
    normal, right = np.eye(5 * n) / 0.1**2, np.zeros(5 * n)
    for band in range(bands):
        scaled = design * (weights * slope)[:, band, None] / bands
        normal += scaled.T @ (design * slope[:, band, None])
        right -= scaled.T @ residual[:, band]
    want = np.linalg.solve(normal, right).reshape(n, 5)
    # they end at a residual of 1e-3
    np.testing.assert_allclose(found, want, atol=3e-3 * np.abs(want).max())


def lit_from_aside() -> Flight:
    """Seven strips in a light that brightens a side of every photo."""
    return grid_flight(4, 7, vignetting=0.3, hot_spot=0.3, noise=0.01, spread=0.05)


def ramp_of(flight: Flight, model: ColourModel, samples: Samples) -> float:
    """Change of the corrections over a deviation of the site, in logarithms, of what is shown."""
    shown = np.flatnonzero(samples.nearest())
    own = [
        np.log(model.factor(int(samples.photo[k]), samples.xy[k], samples.view[k])).mean()
        for k in shown
    ]
    place = samples.place[shown, 0].astype(float)
    place -= place.mean()
    return float(np.mean(np.array(own) * place) / place.std())


def test_a_light_from_aside_does_not_tilt_the_mosaic() -> None:
    flight = lit_from_aside()
    block, samples = flight.block(), flight.samples()
    free = solve_colour(*block, NONE)
    held = solve_colour(*block, NONE, samples)
    # a third of the brightness from end to end, which truth has not
    assert abs(ramp_of(flight, free, samples)) > 0.05
    # 5 % over the root of 28 photos is the sigma that ramps are given
    assert abs(ramp_of(flight, held, samples)) < 0.01
    # all but the same to the overlaps
    steps = [residual_steps(block[0], model).median.mean() for model in (held, free)]
    assert steps[0] < 1.05 * steps[1]


def test_a_few_photos_and_gains_alone_are_free_to_ramp() -> None:
    flight = grid_flight(2, 4, noise=0.01)
    block, samples = flight.block(), flight.samples()
    np.testing.assert_array_equal(
        solve_colour(*block, NONE, samples).gain, solve_colour(*block, NONE).gain
    )
    flight = lit_from_aside()
    block, samples = flight.block(), flight.samples()
    alone = replace(FULL, mode="gain")
    np.testing.assert_array_equal(
        solve_colour(*block, alone, samples).gain, solve_colour(*block, alone).gain
    )
