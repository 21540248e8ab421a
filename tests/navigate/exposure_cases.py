"""Simulated triggers of survey flights: what camera and logger note, and the truth.

Nothing here knows the matcher's model: legs are flown at constant distance between exposures in
wind, turns take their time, misses strike anywhere, also at the ends, and test shots are blocks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from georef_gis.model.logs import EventLog, unknown
from georef_gis.navigate.exposures import PhotoClock

START = 1.0e9


@dataclass(frozen=True, kw_only=True)
class Flight:
    photos: list[PhotoClock]
    events: EventLog
    # event of each photo or -1; true exposure times; clock minus GPS at `START`; drift
    event: NDArray[np.int64]
    time: NDArray[np.float64]
    offset: float
    drift: float


def event_log(time, *, sigma=0.01, sequence=None, names=None, kind="feedback") -> EventLog:
    m = len(time)
    return EventLog(
        time=np.asarray(time, float),
        kind=kind,
        sequence=np.full(m, -1) if sequence is None else np.asarray(sequence, np.int64),
        sigma=np.full(m, float(sigma)),
        lat=unknown(m),
        lon=unknown(m),
        height=unknown(m),
        covariance_ned=unknown(m, 3, 3),
        rpy=unknown(m, 3),
        names=("",) * m if names is None else tuple(names),
        flags=np.full(m, -1),
    )


def survey_triggers(rng: np.random.Generator, count: int) -> NDArray[np.float64]:
    """Exposure times, s, of legs flown to and fro in wind."""
    spacing = rng.uniform(1.5, 5.0)
    # with and against the wind, the ground speeds of opposite legs differ by up to 40 %
    wind = rng.uniform(0.0, 0.2)
    gust = rng.uniform(0.01, 0.03)
    leg = int(rng.integers(6, 20))
    through_turns = rng.random() < 0.2
    times, t, k = [], 0.0, 0
    while len(times) < count:
        direction = 1.0 if k % 2 == 0 else -1.0
        base = spacing / (1.0 + direction * wind)
        slow = np.cumsum(rng.normal(0, 0.005, leg))
        for i in range(leg):
            t += base * (1.0 + rng.normal(0, gust) + slow[i])
            times.append(t)
        turn = rng.uniform(8, 25)
        if through_turns:
            for _ in range(int(turn // base)):
                t += base * (1.0 + rng.normal(0, 0.1))
                times.append(t)
            t += rng.uniform(0, base)
        else:
            t += turn
        k += 1
    return np.array(times[:count])


def regular_triggers(rng: np.random.Generator, count: int, interval=1.0) -> NDArray[np.float64]:
    return np.arange(count) * interval + rng.random()


def ground_shots(rng: np.random.Generator, t: NDArray[np.float64]) -> tuple[NDArray, str, int]:
    """Times with a block of shots on the ground before or after, and what noted it."""
    k = int(rng.integers(1, 8))
    gaps = rng.uniform(2, 20, k)
    wait = rng.uniform(20, 300)
    if rng.random() < 0.7:
        block = t[0] - wait - np.cumsum(gaps)[::-1]
        t, first = np.r_[block, t], 0
    else:
        t, first = np.r_[t, t[-1] + wait + np.cumsum(gaps)], len(t)
    return t, rng.choice(["photos", "events"]), first


def flight(
    rng: np.random.Generator, *, count: int | None = None, resolution: float | None = None,
    triggers=survey_triggers, missed=0.05, spurious=0.02, shots: bool | None = None,
    zone: float | None = None, jitter=0.03,
) -> Flight:  # fmt: skip
    count = count or int(rng.integers(16, 201))
    resolution = resolution or float(rng.choice([1.0, 1.0, 0.1, 0.01]))
    t = triggers(rng, count)
    has_event = rng.random(len(t)) > missed
    has_photo = np.ones(len(t), bool)
    if shots if shots is not None else rng.random() < 1 / 3:
        k = len(t)
        t, seen_by, first = ground_shots(rng, t)
        new = np.zeros(len(t), bool)
        new[first : first + len(t) - k] = True
        # not every shot on the ground is lost by the other side
        other = rng.random(len(t)) < 0.1
        full_event, full_photo = np.ones(len(t), bool), np.ones(len(t), bool)
        full_event[~new], full_photo[~new] = has_event, has_photo
        (full_event if seen_by == "photos" else full_photo)[new] = other[new]
        has_event, has_photo = full_event, full_photo
    # events without photo: noise on the line, at any time
    extra = np.sort(rng.uniform(t[0] - 2, t[-1] + 2, rng.binomial(count, spurious)))
    sigma_event = float(10 ** rng.uniform(-3, -1.5))
    noted = np.r_[t[has_event] + rng.normal(0, sigma_event, has_event.sum()), extra]
    owner = np.r_[np.flatnonzero(has_event), np.full(len(extra), -1)]
    order = np.argsort(noted, kind="stable")
    noted, owner = noted[order], owner[order]
    hours = rng.integers(-11, 13) if rng.random() < 0.9 else rng.integers(-44, 49) / 4
    offset = (hours if zone is None else zone) * 3600.0 + rng.normal(0, 20)
    drift = rng.normal(0, 20e-6)
    latency = rng.normal(0, jitter, len(t))
    clock = START + t + offset + drift * t + latency
    reading = np.maximum.accumulate(np.floor(clock / resolution + 1e-9) * resolution)
    shown = np.flatnonzero(has_photo)
    event = np.full(len(t), -1)
    event[owner[owner >= 0]] = np.flatnonzero(owner >= 0)
    return Flight(
        photos=[
            PhotoClock(name=f"P{i}", clock=float(reading[i]), resolution=resolution) for i in shown
        ],
        events=event_log(START + noted, sigma=sigma_event),
        event=event[shown],
        time=START + t[shown],
        offset=float(offset),
        drift=float(drift),
    )
