"""Places and distances by tags, with correlations by the stated law, against simulated flights.

Their receiver errs slowly, as real ones do; a law for it is no law for white noise, which the
simulator can make too. 0.7 <= rms(error / sigma) <= 1.4 is claimed over 40 flights
(GEOREF_FLIGHTS=40); CI flies 5.
"""

from __future__ import annotations

import math
import os
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "orient"))

from flight_photos import DirectFlight, fly_direct

from georef_gis.frames import Array
from georef_gis.geodesy import MapFrame, map_crs
from georef_gis.measure.lengths import measure_lines
from georef_gis.measure.points import Mark, intersect_points, locate_points
from georef_gis.measure.scene import Scene
from georef_gis.model.ground_errors import GroundErrors
from georef_gis.model.joint_errors import JointErrors, PoseSource
from georef_gis.model.photo_stack import PhotoStack
from georef_gis.model.pose_errors import TagErrors
from georef_gis.model.terrain import FlatTerrain
from georef_gis.simulate import FlightSettings, simulate_flight

FLIGHTS = int(os.environ.get("GEOREF_FLIGHTS", "5"))
LOW, HIGH = (0.7, 1.4) if FLIGHTS >= 40 else (0.35, 2.0)
PAIRS = 6
pytestmark = pytest.mark.slow


def scene_of(direct: DirectFlight, truth: dict[str, Array]) -> Scene:
    """Level ground at the mean height of the targets, unsure by their spread."""
    heights = direct.origin.geo_from_enu(np.array(list(truth.values())))[:, 2]
    ground = FlatTerrain(
        origin=direct.origin, height_ellipsoidal=float(heights.mean()),
        sigma=max(float(heights.std()), 0.3),
    )  # fmt: skip
    stack = PhotoStack.of([direct.oriented(i) for i in range(len(direct.photos))])
    every = np.arange(len(stack))
    source = PoseSource(photos=every, errors=TagErrors(stack, every))
    return Scene(
        frame=MapFrame(direct.origin, map_crs("EPSG:32617")), terrain=ground,
        errors=JointErrors(stack, [source]), ground=GroundErrors.of(ground),
    )  # fmt: skip


@cache
def ratios() -> dict[str, Array]:
    """Errors over sigma of all flights: places of intersections, distances."""
    places, between_points, between_photos = [], [], []
    s = FlightSettings()
    tilt, yaw = math.radians(s.attitude_sigma_deg), math.radians(s.tag_sigma_yaw_deg)
    for seed in range(1, FLIGHTS + 1):
        direct = fly_direct(simulate_flight(s, seed=seed), sigma_roll_pitch=tilt, sigma_yaw=yaw)
        flight = direct.flight
        truth = {p.name: direct.origin.enu_from_ecef(p.p_ecef) for p in flight.control}
        scene = scene_of(direct, truth)
        marks = [
            Mark(name=m.point, photo=flight.names[m.photo], u=float(m.uv[0]), v=float(m.uv[1]),
                 sigma_px=s.mark_sigma)
            for m in flight.marks
        ]  # fmt: skip
        points = intersect_points(scene, marks, on_fail="skip")
        true = np.array([truth[name] for name in points.names])
        places.append((true - points.p_enu) / np.sqrt(np.einsum("nii->ni", points.each)))
        slopes = np.linalg.norm(np.diff(true, axis=0), axis=1)
        legs = measure_lines(points).legs
        between_points += [
            (d - leg.slope.value) / leg.slope.sigma for d, leg in zip(slopes, legs, strict=True)
        ]
        rng = np.random.default_rng(seed)
        for a, b in rng.integers(0, len(marks), (PAIRS, 2)):
            if marks[a].name == marks[b].name or marks[a].photo == marks[b].photo:
                continue
            leg = measure_lines(locate_points(scene, [marks[a], marks[b]])).legs[0]
            d = float(np.hypot(*(truth[marks[b].name] - truth[marks[a].name])[:2]))
            between_photos.append((d - leg.ground.value) / leg.ground.sigma)
    return {
        "places": np.concatenate(places),
        "distances between points": np.array(between_points)[:, None],
        "distances between photos": np.array(between_photos)[:, None],
    }


@pytest.mark.parametrize("what", ["places", "distances between points", "distances between photos"])
def test_errors_by_tags_are_as_large_as_the_law_says(what: str) -> None:
    found = np.sqrt(np.mean(ratios()[what] ** 2, axis=0))
    assert np.all((found > LOW) & (found < HIGH)), found.round(2)
