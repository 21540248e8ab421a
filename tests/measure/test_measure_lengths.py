"""Distances, bearings and areas against PROJ's geodesic and hand cases."""

from __future__ import annotations

import math
from dataclasses import replace

import measure_scenes as scenes
import numpy as np
import pytest
from pyproj import Geod

from georef_gis.errors import GeometryError
from georef_gis.geodesy import metres_per_unit
from georef_gis.measure.lengths import distance, measure_lines
from georef_gis.measure.measured import MeasuredPoints
from georef_gis.measure.points import Mark, intersect_points, locate_points

GEOD = Geod(ellps="WGS84")


@pytest.fixture(scope="module")
def three() -> MeasuredPoints:
    return locate_points(
        scenes.scene(), [Mark(name="", photo="A", u=u, v=1500.0) for u in (500.0, 1500.0, 3500.0)]
    )


def at(points: MeasuredPoints, *places: tuple[float, float, float]) -> MeasuredPoints:
    """The same points elsewhere: sensitivities stay, which these tests do not ask for."""
    return replace(points.subset(range(len(places))), p_enu=np.array(places, float))


def test_ground_distance_and_bearing_are_those_of_the_geodesic(three: MeasuredPoints) -> None:
    """A kilometre at 300 m above the ellipsoid, both ends at one height."""
    geo = np.array([[0.68239, -1.40441, 300.0], [0.68251, -1.40429, 300.0]])
    ends = scenes.ORIGIN.enu_from_geo(geo)
    leg = distance(at(three, *ends))
    azimuth, _, length = GEOD.inv(*np.degrees(geo[0, 1::-1]), *np.degrees(geo[1, 1::-1]))
    # 300 m above the ellipsoid: longer by 300 m over the radius, which is good to 0.5 %
    assert leg.ground.value == pytest.approx(length * (1.0 + 300.0 / 6.37e6), rel=3e-7)
    assert math.degrees(leg.bearing_true.value) == pytest.approx(azimuth, abs=1e-4)
    assert leg.height_difference.value == pytest.approx(0.0, abs=1e-6)


def test_grid_distance_and_bearing_are_those_of_map_coordinates(three: MeasuredPoints) -> None:
    points = at(three, (-300.0, 100.0, 5.0), (400.0, 900.0, 25.0))
    leg = distance(points)
    p = scenes.FRAME.map_from_enu(points.p_enu)[:, :2] * metres_per_unit(scenes.FRAME.horizontal)
    assert leg.grid.value == pytest.approx(float(np.linalg.norm(p[1] - p[0])), abs=1e-9)
    d = p[1] - p[0]
    assert leg.bearing_grid.value == pytest.approx(math.atan2(d[0], d[1]))
    turn = leg.bearing_true.value - leg.bearing_grid.value
    # grid and true bearing differ by the convergence; the arc to the chord of 1 km by 1e-5 rad
    assert turn == pytest.approx(scenes.FRAME.convergence_at(points.p_enu[0]), abs=2e-5)


def test_slope_height_and_ground_make_a_right_triangle(three: MeasuredPoints) -> None:
    leg = distance(at(three, (0.0, 0.0, 0.0), (30.0, 0.0, 40.0)))
    assert leg.slope.value == pytest.approx(50.0)
    assert leg.height_difference.value == pytest.approx(40.0, abs=1e-4)
    assert leg.ground.value == pytest.approx(30.0, abs=1e-3)  # m; the bend over 30 m


def test_scale_of_the_map_tells_grid_from_ground(three: MeasuredPoints) -> None:
    lines = measure_lines(at(three, (0.0, 0.0, 0.0), (500.0, 0.0, 0.0)))
    scale = scenes.FRAME.scale_at(np.array([250.0, 0.0, 0.0]))
    # the ground is 277.6 m above the ellipsoid that the map is drawn on
    assert lines.scale == pytest.approx(scale, rel=2e-7)
    assert abs(lines.grid.value - lines.ground.value) > 0.01
    assert "on the ground" in lines.told()[0]
    assert "on the map" in lines.told()[0]


def test_area_and_perimeter_of_a_square(three: MeasuredPoints) -> None:
    points = MeasuredPoints.joined(three, three.subset([0]))
    square = at(points, (0, 0, 0), (20, 0, 0), (20, 10, 0), (0, 10, 0))
    lines = measure_lines(square, closed=True)
    assert lines.area_ground is not None
    assert lines.area_grid is not None
    assert lines.area_ground.value == pytest.approx(200.0, rel=1e-9)
    assert lines.ground.value == pytest.approx(60.0, rel=1e-9)
    assert len(lines.legs) == 4
    assert lines.area_grid.value == pytest.approx(200.0 * lines.scale**2, rel=1e-6)
    backwards = measure_lines(square.subset([3, 2, 1, 0]), closed=True)
    assert backwards.area_ground is not None
    assert backwards.area_ground.value == pytest.approx(200.0, rel=1e-9)


def test_sides_that_cross_are_told(three: MeasuredPoints) -> None:
    points = MeasuredPoints.joined(three, three.subset([0]))
    bow = at(points, (0, 0, 0), (20, 10, 0), (20, 0, 0), (0, 10, 0))
    (line,) = [d for d in measure_lines(bow, closed=True).doubts if "cross" in d]
    assert line.startswith("sides 1-2 and 3-1 cross")


def test_a_length_within_its_own_sigma_is_doubted(three: MeasuredPoints) -> None:
    p = three.p_enu[0]
    lines = measure_lines(at(three, tuple(p), (p[0] + 1e-3, p[1], p[2])))
    assert "is not told from no distance at all" in lines.doubts[0]


@pytest.mark.parametrize(
    ("n", "closed", "line"),
    [(1, False, "a distance needs two points or more; there are 1"),
     (2, True, "an area needs three points or more; there are 2")],
)  # fmt: skip
def test_too_few_points_are_refused(three: MeasuredPoints, n: int, closed: bool, line: str) -> None:
    with pytest.raises(GeometryError, match=line):
        measure_lines(three.subset(range(n)), closed=closed)


def test_it_is_said_how_much_better_a_distance_is_than_the_places(three: MeasuredPoints) -> None:
    lines = measure_lines(three.subset([0, 1]))
    (line,) = [s for s in lines.told() if "times better" in s]
    assert line.startswith(f"{lines.ground.better:.3g} times better than the places")
    # unless the points share nothing
    alone = three.subset([0, 1])
    apart = replace(alone, shared=alone.shared * 0.0, by_height=alone.by_height * 0.0)
    assert not [s for s in measure_lines(apart).told() if "times better" in s]


def test_points_of_poses_that_know_nothing_of_each_other_are_told_so() -> None:
    scene = scenes.scene()
    free = type(scene).of(scene.frame, scene.terrain, scene.photos.photos)
    places = {"P": (np.array([1.0, 2.0, 0.0]), "AB"), "Q": (np.array([9.0, 2.0, 0.0]), "AC")}
    points = intersect_points(free, scenes.marks_of(scene.photos.photos, places))
    assert "poses are taken as independent" in measure_lines(points).doubts[-1]
    marks = [Mark(name="", photo="A", u=u, v=1500.0) for u in (500.0, 3500.0)]
    assert measure_lines(locate_points(free, marks)).doubts == ()
