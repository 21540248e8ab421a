"""What each photo's own tagged place says of its exposure time, once there is a trajectory."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from georef_gis.frames import Array
from georef_gis.navigate.exposure_values import ExposureTimes

# s, one sigma: autopilots tag the last fix, which is up to a fix old, or one to come
TAG_AGE = 0.15
# m/s; slower, a place tells nothing of the time
SLOWEST = 2.0
# sigmas beyond which a place contradicts a time
CONTRADICTION = 4.0
# s; events nearer than this are one
TWICE = 0.02
# a place is an outlier of its own as often as this
STRAY = 1e-3

# times (k,) -> place (k, 2) east, north m and velocity (k, 2) m/s, NaN outside of the log
Track = Callable[[Array], tuple[Array, Array]]


def with_tagged_places(
    found: ExposureTimes, events: Array, places: Array, sigma: Array, track: Track
) -> ExposureTimes:
    """Exposure times with the evidence of the tagged places.

    A matched event whose place on the track is that of the tag, while those of the neighbouring
    events are not, becomes surer; one that contradicts its tag becomes doubtful. A time that only
    the camera's clock tells, to a second, moves along the track towards its tag.

    Parameters
    ----------
    events : shape (m,), s
        Times of the events; empty where there are none.
    places : shape (n, 2), m
        East and north of the tags; NaN where a photo has none.
    sigma : shape (n,), m
        One sigma of a place per axis.
    track
        Position and velocity of the vehicle.
    """
    p, v = track(found.time)
    speed = np.hypot(*v.T)
    time, spread, confidence = found.time.copy(), found.sigma.copy(), found.confidence.copy()
    for i in np.flatnonzero(np.isfinite(places[:, 0]) & (speed > SLOWEST)):
        late = float((places[i] - p[i]) @ v[i]) / speed[i] ** 2
        own = math.hypot(float(sigma[i]) / float(speed[i]), TAG_AGE)
        if found.event[i] >= 0:
            confidence[i] = _surer(confidence[i], late, own, events, int(found.event[i]))
        elif np.isfinite(spread[i]) and abs(late) < CONTRADICTION * math.hypot(own, spread[i]):
            weight = spread[i] ** 2 / (spread[i] ** 2 + own**2)
            time[i] += weight * late
            spread[i] *= math.sqrt(1.0 - weight)
    return replace(found, time=time, sigma=spread, confidence=confidence)


def _surer(confidence: float, late: float, own: float, events: Array, index: int) -> float:
    """Confidence after a tag that lies `late` s ahead of the event's place, with sigma `own`."""
    gaps = np.abs(events - events[index])
    # a line that is noted twice, or has no time, is no other event
    gaps = np.where(gaps > TWICE, gaps, math.inf)
    step = float(np.min(gaps)) if len(events) > 1 else 10.0
    here = math.exp(-0.5 * (late / own) ** 2)
    nearest = abs(late) - step
    there = math.exp(-0.5 * (min(nearest, 0.0) / own) ** 2) if nearest < 0.0 else 1.0
    here, there = here + STRAY, there + STRAY
    return confidence * here / (confidence * here + (1.0 - confidence) * there)
