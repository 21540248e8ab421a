"""Camera poses of whole flights agree with the truth within their sigmas, and beat the tags."""

from __future__ import annotations

import math

import numpy as np
import pytest
from exposure_flights import FlightErrors, flown

from georef_gis.simulate import FlightSettings

pytestmark = pytest.mark.slow

FLIGHTS = 5


@pytest.fixture(scope="module", params=["white", "coloured"])
def flights(request: pytest.FixtureRequest) -> tuple[str, list[FlightErrors]]:
    settings = FlightSettings(gnss=request.param)
    return request.param, [flown(settings, seed) for seed in range(FLIGHTS)]


def test_errors_agree_with_their_sigmas(flights: tuple[str, list[FlightErrors]]) -> None:
    ratio = np.concatenate([(f.error / f.sigma).ravel() for f in flights[1]])
    # three sigmas of the mean square: photos of a flight share boresight and slow error
    chance = 3.0 * math.sqrt(sum(f.scatter for f in flights[1])) / len(ratio)
    assert chance < 1.0, "too few flights to tell anything"
    assert max(0.7**2, 1.0 - chance) < np.mean(ratio**2) < min(1.4**2, 1.0 + chance)
    assert np.abs(ratio).max() < 5.0


def test_joint_covariance_agrees_with_the_errors(flights: tuple[str, list[FlightErrors]]) -> None:
    # 96 degrees of freedom a flight: three sigmas of their mean over 5 flights are 0.19; the
    # doubtful time of the photo without event is not normal, and adds to the spread
    assert 0.7 < np.mean([f.nees for f in flights[1]]) < 1.3


def size(
    flights: list[FlightErrors], which: str, columns: slice, *, matched: bool = False
) -> float:
    """Root mean square of the length of a vector over all photos, or over those with an event."""
    rows = [getattr(f, which)[f.matched if matched else slice(None), columns] for f in flights]
    return math.sqrt(float(np.mean(np.sum(np.concatenate(rows) ** 2, axis=1))))


def test_poses_beat_the_tags(flights: tuple[str, list[FlightErrors]]) -> None:
    gnss, group = flights
    place, turn = slice(0, 3), slice(3, 6)
    gain = size(group, "tag_error", place) / size(group, "error", place)
    # Of 40 flights 5.6: a photo in 16 has no event, and its time is known to 0.2 s, or 3 m. With
    # correlated GNSS error what goes is its white part and the age of the last fix.
    assert gain > {"white": 5.0, "coloured": 1.3}[gnss]
    gain = size(group, "tag_error", place, matched=True) / size(group, "error", place, matched=True)
    assert gain > {"white": 12.0, "coloured": 1.3}[gnss]
    # the boresight of 1 deg per axis stays
    assert size(group, "tag_error", turn) > 1.8 * size(group, "error", turn)


def test_sure_matches_are_right_and_most_are_sure(
    flights: tuple[str, list[FlightErrors]],
) -> None:
    confidence = np.concatenate([f.confidence for f in flights[1]])
    # one photo of 16 has no event, so 15/16 can be told by one
    assert np.mean(confidence > 0.99) > 0.93
    assert sum(f.wrong for f in flights[1]) == 0
