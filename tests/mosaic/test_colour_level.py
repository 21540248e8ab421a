"""Brightness of a mosaic as a whole, and cameras whose response bends."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from colour_cases import chain, grid_flight

from georef_gis.mosaic.block_means import Samples
from georef_gis.mosaic.colour import ColourModel, ColourSettings, solve_colour
from georef_gis.mosaic.colour_level import common_level, with_level
from georef_gis.mosaic.colour_normals import Layout, chosen
from georef_gis.mosaic.colour_response import response_bends
from georef_gis.mosaic.colour_steps import residual_steps

TOP = 255.0
BENT = ColourSettings(knee=1.0 / TOP)


def model_of(gains: list[float], knee: float = 0.0) -> ColourModel:
    n = len(gains)
    return ColourModel(
        gain=np.repeat(np.array(gains)[:, None], 2, axis=1), offsets=np.zeros((n, 2)),
        surface=np.zeros((n, 5, 2)), vignetting={"c": np.zeros((3, 2))},
        trend={"f": np.zeros((15, 2))}, spots={}, camera_of=("c",) * n, flight_of=("f",) * n,
        knee=knee,
    )  # fmt: skip


def samples_of(values: np.ndarray, photos: int) -> Samples:
    """The same values, of both bands, in each of some photos."""
    count = values.size
    two = np.zeros((photos * count, 2), np.float32)
    value = np.tile(values, photos)[:, None] * np.array([1.0, 0.5])
    return Samples(
        photo=np.repeat(np.arange(photos), count), value=value.astype(np.float32), xy=two,
        view=two, place=two, nadir=two,
    )  # fmt: skip


def share_beyond(model: ColourModel, samples: Samples) -> float:
    out = [
        model.corrected(int(p), v, x, w)
        for p, v, x, w in zip(samples.photo, samples.value, samples.xy, samples.view, strict=True)
    ]
    beyond = (np.array(out) > 0.98 * TOP + 1e-6) & (samples.value <= 0.98 * TOP)
    return float(beyond.any(axis=1).mean())


def test_few_pixels_are_made_too_bright(rng: np.random.Generator) -> None:
    samples = samples_of(rng.uniform(20.0, 240.0, 1000), 3)
    model = model_of([-0.3, 0.0, 0.3])
    level = common_level(model, samples, TOP)
    assert share_beyond(model, samples) > 0.05
    assert level < -0.1
    after = with_level(model, level, np.array([True, True]))
    # not more than 0.5 %, and no darker than that asks for
    assert 0.004 < share_beyond(after, samples) <= 0.005
    np.testing.assert_allclose(after.gain - model.gain, level)


def test_what_has_room_is_left_alone(rng: np.random.Generator) -> None:
    samples = samples_of(rng.uniform(20.0, 150.0, 300), 3)
    assert common_level(model_of([-0.3, 0.0, 0.3]), samples, TOP) == 0.0


def test_the_photo_in_the_middle_is_not_made_brighter(rng: np.random.Generator) -> None:
    samples = samples_of(rng.uniform(20.0, 100.0, 300), 3)
    assert common_level(model_of([-0.5, 0.1, 0.2]), samples, TOP) == pytest.approx(-0.1)


def test_pixels_that_were_white_do_not_darken_all(rng: np.random.Generator) -> None:
    values = np.concatenate([rng.uniform(20.0, 150.0, 200), np.full(100, 255.0)])
    assert common_level(model_of([-0.3, 0.0, 0.3]), samples_of(values, 3), TOP) == 0.0


def test_no_samples_no_level() -> None:
    assert common_level(model_of([0.0]), Samples.joined([], 2), TOP) == 0.0


def test_a_bent_response_loses_no_white(rng: np.random.Generator) -> None:
    samples = samples_of(rng.uniform(20.0, 240.0, 1000), 3)
    model = model_of([-0.3, 0.0, 0.3], knee=1.0 / TOP)
    assert share_beyond(model, samples) == 0.0
    assert common_level(model, samples, TOP) == 0.0


def test_bands_without_information_keep_their_level() -> None:
    model = with_level(model_of([0.1]), -0.2, np.array([True, False]))
    np.testing.assert_allclose(model.gain, [[-0.1, 0.1]])


def test_gains_of_a_camera_whose_response_bends_are_found() -> None:
    flight = replace(grid_flight(vignetting=0.2, noise=0.01, spread=0.3), bent=True)
    block = flight.block()
    model, straight = (solve_colour(*block, settings) for settings in (BENT, ColourSettings()))
    error = model.gain - flight.gain
    design = np.column_stack([np.ones(20), flight.nadirs])
    error -= design @ np.linalg.lstsq(design, error, rcond=None)[0]
    # gains of 0.3 without the ramp that no overlap tells; what the priors shrink of them
    np.testing.assert_allclose(error, 0.0, atol=0.02)
    steps = [residual_steps(block[0], m).median.mean() for m in (model, straight)]
    # noise of 1 % at both ends of grey values about 100
    assert steps[0] < 1.3
    assert steps[1] > 1.5 * steps[0]


def test_the_hue_does_not_drift_along_a_chain() -> None:
    flight = replace(chain(300, noise=0.03, hot_spot=0.2, vignetting=0.2), bent=True)
    # exposures that are the same for all bands
    flight.gain[:] = flight.gain[:, :1]
    model = solve_colour(*flight.block(), BENT, flight.samples())
    error = model.gain - flight.gain
    # each band by itself drifts by 0.06
    assert np.abs(error - error.mean(axis=1, keepdims=True)).max() < 0.05


@pytest.mark.parametrize("spread", [0.05, 0.15])
@pytest.mark.parametrize("bent", [False, True])
def test_whether_a_response_bends_is_told_by_the_photos(bent: bool, spread: float) -> None:
    flight = grid_flight(vignetting=0.3, noise=0.02, outliers=0.1, spread=spread)
    overlaps, _, cameras, flights = replace(flight, bent=bent).block()
    layout = Layout.of(cameras, flights)
    assert response_bends(overlaps, layout, ColourSettings(), 1.0 / TOP) == bent


def test_photos_without_overlap_tell_nothing_of_their_response() -> None:
    overlaps, _, cameras, flights = grid_flight().block()
    none = chosen(overlaps, slice(0, 0))
    layout = Layout.of(cameras, flights)
    assert not response_bends(none, layout, ColourSettings(), 1.0 / TOP)
