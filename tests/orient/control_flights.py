"""Control of simulated flights as observations, beside direct poses, and blunders planted in it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from flight_photos import DirectFlight, fly_direct

from georef_gis.model.control import ControlObservations, Role
from georef_gis.model.photo import OrientedPhoto
from georef_gis.model.terrain import FlatTerrain
from georef_gis.simulate import FlightSettings, simulate_flight


def direct_flight(seed: int, **settings: object) -> DirectFlight:
    s = FlightSettings(**settings)  # type: ignore[arg-type]
    # of the tags' attitude as simulated: crab and turbulence are in the yaw
    sigmas = {
        "sigma_roll_pitch": np.radians(s.attitude_sigma_deg),
        "sigma_yaw": np.radians(s.tag_sigma_yaw_deg),
    }
    return fly_direct(simulate_flight(s, seed=seed), **sigmas)


def photos_by_id(direct: DirectFlight) -> dict[str, OrientedPhoto]:
    return {name: direct.oriented(i) for i, name in enumerate(direct.flight.names)}


def ground_of(direct: DirectFlight) -> FlatTerrain:
    return FlatTerrain(origin=direct.origin, height_ellipsoidal=277.6, sigma=1.5)


def observations(
    direct: DirectFlight, *, roles: Mapping[str, Role] | None = None, survey: float = 0.02
) -> ControlObservations:
    """True points with a survey's error, and the simulated marks."""
    flight = direct.flight
    rng = np.random.default_rng([flight.seed, 77])
    names = tuple(point.name for point in flight.control)
    p = np.array([direct.origin.enu_from_ecef(point.p_ecef) for point in flight.control])
    marks = flight.marks
    return ControlObservations(
        names=names,
        role=tuple((roles or {}).get(name, "control") for name in names),
        p_enu=p + survey * rng.normal(size=p.shape),
        sigma=np.full(p.shape, survey),
        photo_ids=tuple(flight.names[mark.photo] for mark in marks),
        point=np.array([names.index(mark.point) for mark in marks], dtype=np.int32),
        uv=np.array([mark.uv for mark in marks]),
        sigma_px=np.full(len(marks), flight.settings.mark_sigma),
        source=tuple(f"marks.csv, line {k + 2}" for k in range(len(marks))),
        sigma_shared=np.zeros(3),
    )


def mark_of(control: ControlObservations, photo: str, name: str) -> int:
    """Index of the first mark of a point in a photo."""
    j = control.names.index(name)
    return next(
        k for k, key in enumerate(control.photo_ids) if key == photo and control.point[k] == j
    )


def names_in(control: ControlObservations, photo: str) -> list[str]:
    return [
        control.names[j]
        for key, j in zip(control.photo_ids, control.point, strict=True)
        if key == photo
    ]


def relabelled(control: ControlObservations, labels: Mapping[int, str]) -> ControlObservations:
    """Marks by index under other points' names."""
    point = control.point.copy()
    for k, name in labels.items():
        point[k] = control.names.index(name)
    return replace(control, point=point)


def shifted(control: ControlObservations, k: int, by: Sequence[float]) -> ControlObservations:
    """One mark elsewhere, px."""
    uv = control.uv.copy()
    uv[k] += by
    return replace(control, uv=uv)
