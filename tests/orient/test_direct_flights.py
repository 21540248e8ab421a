"""Direct georeferencing of simulated flights, against their truth and their sigmas.

The claim 0.7 <= rms(error / sigma) <= 1.4 is made over 40 flights (GEOREF_FLIGHTS=40, 640 photos,
every error source redrawn). CI flies 5, where the mean of five slow GNSS errors and five
boresights may lie outside that by chance: they are held to 0.45 and 1.75. One flight is not
judged: the errors of its photos are correlated.
"""

from __future__ import annotations

import math
import os
from functools import cache

import numpy as np
import pytest
from flight_photos import DirectFlight, fly_direct

from georef_gis.model.ground_point import ground_point_covariance, locate
from georef_gis.model.terrain import FlatTerrain
from georef_gis.simulate import FlightSettings, simulate_flight

FLIGHTS = int(os.environ.get("GEOREF_FLIGHTS", "5"))
LOW, HIGH = (0.7, 1.4) if FLIGHTS >= 40 else (0.45, 1.75)
pytestmark = pytest.mark.slow


def tag_sigmas(settings: FlightSettings) -> dict[str, float]:
    """One sigma of roll and pitch, and of yaw, that the settings imply, rad."""
    if settings.attitude_tag == "camera":
        return {
            "sigma_roll_pitch": math.radians(settings.attitude_sigma_deg),
            "sigma_yaw": math.radians(settings.tag_sigma_yaw_deg),
        }
    # Taken as level, north along the course: turbulence and trim about the two level axes, crab.
    tilt = [settings.roll_sigma_deg, settings.pitch_sigma_deg, settings.pitch_trim_deg]
    crab = math.degrees(math.atan2(settings.wind_sigma, settings.speed))
    # A course over 20 m at the ends of a line and over 40 m between, from two white fixes
    leg = math.degrees(math.sqrt(2) * settings.gnss_white / 30.0)
    return {
        "sigma_roll_pitch": math.radians(math.hypot(*tilt) / math.sqrt(2)),
        "sigma_yaw": math.radians(math.hypot(crab, settings.yaw_sigma_deg, leg)),
    }


@cache
def flown(**settings: str) -> tuple[DirectFlight, ...]:
    s = FlightSettings(**settings)  # type: ignore[arg-type]
    return tuple(
        fly_direct(simulate_flight(s, seed=seed), **tag_sigmas(s)) for seed in range(1, FLIGHTS + 1)
    )


def rms(normalised: np.ndarray) -> np.ndarray:
    return np.asarray(np.sqrt(np.mean(normalised**2, axis=0)))


def all_errors(flights: tuple[DirectFlight, ...]) -> np.ndarray:
    return np.concatenate([f.normalised for f in flights])


@pytest.mark.parametrize("gnss", ["coloured", "white"])
def test_errors_of_the_poses_are_what_their_sigmas_say(gnss: str) -> None:
    found = rms(all_errors(flown(gnss=gnss)))
    assert np.all((found > LOW) & (found < HIGH)), f"rms of error/sigma {found.round(2)}"


def test_without_attitude_level_and_course_are_as_good_as_their_sigmas() -> None:
    found = rms(all_errors(flown(attitude_tag="none")))
    assert np.all((found > LOW) & (found < HIGH)), f"rms of error/sigma {found.round(2)}"


def test_without_attitude_the_default_sigmas_are_not_too_small() -> None:
    """6 deg of tilt and 15 deg of crab are for any small aircraft; this one is gentler."""
    settings = FlightSettings(attitude_tag="none")
    flights = [fly_direct(simulate_flight(settings, seed=k)) for k in range(1, FLIGHTS + 1)]
    assert np.all(rms(np.concatenate([f.normalised for f in flights])) < HIGH)
    assert all("no attitude" in p.doubts[0] for f in flights for p in f.poses)


def ground_errors(direct: DirectFlight) -> np.ndarray:
    """(east, north) error over sigma of every marked target, on ground of its own height."""
    points = {p.name: p.p_ecef for p in direct.flight.control}
    out = []
    for mark in direct.flight.marks:
        p_ecef = points[mark.point]
        p_true = direct.origin.enu_from_ecef(p_ecef)
        height = float(direct.origin.geo_from_enu(p_true)[2])
        ground = FlatTerrain(origin=direct.origin, height_ellipsoidal=height)
        photo = direct.oriented(mark.photo)
        p = locate(photo, mark.uv, ground)
        sigma_uv = direct.flight.settings.mark_sigma
        C = ground_point_covariance(photo, p, ground, sigma_uv=sigma_uv)
        out.append((p_true - p)[:2] / np.sqrt(np.diag(C)[:2]))
    return np.array(out)


@pytest.mark.parametrize("gnss", ["coloured", "white"])
def test_ground_points_are_as_good_as_their_covariance_says(gnss: str) -> None:
    errors = np.concatenate([ground_errors(f) for f in flown(gnss=gnss)])
    found = rms(errors)
    assert np.all((found > LOW) & (found < HIGH)), f"rms of error/sigma {found.round(2)}"
