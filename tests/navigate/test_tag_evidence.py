"""Tagged places make matches surer or doubtful, and move coarse times along the track."""

from __future__ import annotations

import math

import numpy as np
import pytest

from georef_gis.frames import Array
from georef_gis.navigate.exposures import ExposureTimes
from georef_gis.navigate.tag_evidence import TAG_AGE, with_tagged_places

SPEED = 20.0
START = 1000.0


def track(times: Array) -> tuple[Array, Array]:
    """A vehicle flying east at 20 m/s; no log before or 100 s after the start."""
    t = times - START
    p = np.stack([SPEED * t, 0.0 * t], axis=-1)
    v = np.tile([SPEED, 0.0], (len(t), 1))
    outside = (t < 0.0) | (t > 100.0)
    p[outside] = v[outside] = np.nan
    return p, v


def found(
    time: list[float], event: list[int], sigma: float = 0.001, confidence: float = 0.9
) -> ExposureTimes:
    n = len(time)
    return ExposureTimes(
        time=np.array(time), sigma=np.full(n, sigma),
        source=tuple("event" if k >= 0 else "clock" for k in event), event=np.array(event),
        confidence=np.full(n, confidence), clock=None, jitter=0.0, missed=(), spurious=(),
        alternatives=(),
    )  # fmt: skip


def judged(times: ExposureTimes, events: Array, east: list[float], sigma: float = 2.0):  # type: ignore[no-untyped-def]
    places = np.stack([np.array(east), np.zeros(len(east))], axis=-1)
    return with_tagged_places(times, events, places, np.full(len(east), sigma), track)


EVENTS = START + np.array([10.0, 12.0, 14.0])


def test_tag_at_the_place_of_its_event_makes_the_match_surer() -> None:
    out = judged(found([START + 10.0], [0]), EVENTS, [200.0])
    assert 0.999 < out.confidence[0] <= 1.0
    assert out.time[0] == START + 10.0


def test_tag_at_the_place_of_another_event_makes_the_match_doubtful() -> None:
    # 2 s at 20 m/s are 40 m: the tag is that of the next event
    out = judged(found([START + 10.0], [0], confidence=0.9), EVENTS, [240.0])
    assert out.confidence[0] < 0.05


def test_tag_far_from_every_event_tells_nothing_for_sure() -> None:
    out = judged(found([START + 10.0], [0], confidence=0.9), EVENTS, [700.0])
    assert out.confidence[0] < 0.9


def test_confidence_is_bayes_rule_of_the_distances() -> None:
    """A tag 0.5 s of flight ahead; its sigma is that of place and age together."""
    own = math.hypot(2.0 / SPEED, TAG_AGE)
    out = judged(found([START + 10.0], [0], confidence=0.8), EVENTS, [210.0])
    here = math.exp(-0.5 * (0.5 / own) ** 2) + 1e-3
    there = math.exp(-0.5 * (1.5 / own) ** 2) + 1e-3
    assert out.confidence[0] == pytest.approx(0.8 * here / (0.8 * here + 0.2 * there), rel=1e-6)


@pytest.mark.parametrize("late", [-0.6, 0.4])
def test_coarse_time_moves_towards_its_tag_by_the_two_variances(late: float) -> None:
    own = math.hypot(2.0 / SPEED, TAG_AGE)
    sigma = 0.3
    out = judged(found([START + 20.0], [-1], sigma=sigma), EVENTS, [SPEED * (20.0 + late)])
    weight = sigma**2 / (sigma**2 + own**2)
    assert out.time[0] - START == pytest.approx(20.0 + weight * late)
    assert out.sigma[0] == pytest.approx(sigma * math.sqrt(1.0 - weight))
    assert out.sigma[0] < min(sigma, own)


def test_coarse_times_are_right_within_their_new_sigma() -> None:
    """Clock errors of 0.3 s, tags of 2 m whose age is 0.15 s (one sigma)."""
    rng = np.random.default_rng(7)
    n, sigma = 2000, 0.3
    true = START + rng.uniform(5.0, 95.0, n)
    east = SPEED * (true - START + TAG_AGE * rng.normal(size=n)) + 2.0 * rng.normal(size=n)
    out = judged(
        found(list(true + sigma * rng.normal(size=n)), [-1] * n, sigma=sigma), EVENTS, list(east)
    )
    ratio = (out.time - true) / out.sigma
    # 2000 draws tell a sigma to 1.6 %; outliers beyond 4 sigmas keep their time
    assert np.sqrt(np.mean(ratio**2)) == pytest.approx(1.0, abs=0.08)
    assert np.sqrt(np.mean((out.time - true) ** 2)) < 0.6 * sigma


def test_contradicting_tag_does_not_move_a_time() -> None:
    out = judged(found([START + 20.0], [-1], sigma=0.3), EVENTS, [SPEED * 35.0])
    assert out.time[0] == START + 20.0
    assert out.sigma[0] == 0.3


def test_no_tag_and_no_track_leave_all_as_it_is() -> None:
    given = found([START + 10.0, START - 5.0, START + 12.0], [0, -1, 1])
    places = np.array([[np.nan, np.nan], [0.0, 0.0], [240.0, 0.0]])
    out = with_tagged_places(given, EVENTS, places, np.full(3, 2.0), track)
    assert out.confidence[:2] == pytest.approx(given.confidence[:2])
    assert np.array_equal(out.time, given.time)
    assert out.confidence[2] > 0.999


def test_standing_vehicle_tells_nothing() -> None:
    def parked(times: Array) -> tuple[Array, Array]:
        return np.zeros((len(times), 2)), np.zeros((len(times), 2))

    given = found([START + 10.0], [0], confidence=0.7)
    out = with_tagged_places(given, EVENTS, np.array([[50.0, 0.0]]), np.array([2.0]), parked)
    assert out.confidence[0] == 0.7


@pytest.mark.parametrize(
    "extra", [[10.0], [10.0, 10.004], [math.nan]], ids=["twice", "thrice", "no time"]
)
def test_event_line_noted_twice_or_without_time_does_not_lower_a_confidence(
    extra: list[float],
) -> None:
    """Neither is another event that the photo might be of."""
    places = [200.0]
    plain = judged(found([START + 10.0], [0]), EVENTS, places)
    noted = np.concatenate([EVENTS, START + np.array(extra)])
    out = judged(found([START + 10.0], [0]), noted, places)
    assert out.confidence[0] == pytest.approx(plain.confidence[0], abs=1e-12)
    assert out.confidence[0] > 0.999


def test_events_a_tenth_of_a_second_apart_are_two() -> None:
    """A burst: 2 m between two places that are known to 3.6 m tell nothing apart."""
    noted = np.concatenate([EVENTS, [START + 10.1]])
    out = judged(found([START + 10.0], [0]), noted, [200.0])
    assert out.confidence[0] < 0.95
