"""Distances, bearings and areas against PROJ's geodesic and hand cases."""

from __future__ import annotations

import math
import time
from dataclasses import replace

import measure_scenes as scenes
import numpy as np
import pytest
from pyproj import Geod
from scipy.sparse import csr_array

from georef_gis.errors import GeometryError
from georef_gis.geodesy import metres_per_unit
from georef_gis.measure.lengths import Quantity, distance, measure_lines
from georef_gis.measure.measured import MeasuredPoints
from georef_gis.measure.points import Mark, intersect_points, locate_points
from georef_gis.measure.spread import sigmas_of

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


def test_a_pole_is_told_along_the_slope(three: MeasuredPoints) -> None:
    lines = measure_lines(at(three, (0.0, 0.0, 0.0), (0.0, 0.0, 5.0)))
    assert lines.told()[1].startswith("length 5.0")
    assert lines.told()[1].endswith("m along the slope")
    # m; the verticals of both ends are one
    assert lines.ground.value == pytest.approx(0.0, abs=1e-5)
    assert lines.scale == pytest.approx(scenes.FRAME.scale_at(np.zeros(3)), rel=1e-6)
    level = measure_lines(at(three, (0.0, 0.0, 0.0), (30.0, 0.0, 0.5)))
    assert not [line for line in level.told() if "slope" in line]


def test_of_what_is_known_nothing_is_better_than_the_places() -> None:
    assert Quantity(value=5.0, sigma=0.0, sigma_apart=0.0).better == 1.0
    assert Quantity(value=5.0, sigma=0.0, sigma_apart=0.1).better == math.inf


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


def test_an_area_within_its_own_sigma_is_doubted(three: MeasuredPoints) -> None:
    p = three.p_enu[0]
    thin = at(three, tuple(p), (p[0] + 30.0, p[1], p[2]), (p[0] + 60.0, p[1] + 1e-3, p[2]))
    (line,) = [d for d in measure_lines(thin, closed=True).doubts if d.startswith("area")]
    assert "m2 is not told from none" in line


def test_no_bearing_is_less_sure_than_one_of_which_nothing_is_known(three: MeasuredPoints) -> None:
    """Of any direction as likely as any other: a sigma of 360 deg over the root of 12."""
    p = three.p_enu[0]
    leg = distance(at(three, tuple(p), (p[0] + 1e-3, p[1], p[2])))
    assert math.degrees(leg.bearing_grid.sigma) == pytest.approx(360.0 / math.sqrt(12.0))
    assert leg.bearing_true.sigma_apart == leg.bearing_true.sigma


def test_sigmas_need_no_joint_covariance_but_are_those_by_it() -> None:
    """More functions than are taken at once, of points located and intersected."""
    scene = scenes.scene()
    photos = scene.photos.photos
    clicks = [Mark(name="", photo=p, u=u, v=900.0) for p in "AB" for u in (500.0, 2500.0)]
    places = {"P": (np.array([1.0, 2.0, 0.0]), "AB"), "Q": (np.array([9.0, 2.0, 4.0]), "AC")}
    points = MeasuredPoints.joined(
        locate_points(scene, clicks), intersect_points(scene, scenes.marks_of(photos, places))
    )
    rows = np.random.default_rng(3).normal(size=(150, 3 * len(points)))
    together, apart = sigmas_of(points, csr_array(rows))
    joint = points.covariance()
    np.testing.assert_allclose(together**2, np.diag(rows @ joint @ rows.T), rtol=1e-9)
    blocks = np.kron(np.eye(len(points)), np.ones((3, 3)))
    np.testing.assert_allclose(apart**2, np.diag(rows @ (joint * blocks) @ rows.T), rtol=1e-9)


@pytest.mark.slow
def test_a_line_of_thousands_of_points_is_measured_in_seconds() -> None:
    """Not by the covariance of all of them together, which would take gigabytes."""
    rng = np.random.default_rng(5)
    scene, n = scenes.scene(), 3000
    marks = [
        Mark(name="", photo="A", u=float(u), v=float(v))
        for u, v in zip(rng.uniform(100, 3900, n), rng.uniform(100, 2900, n), strict=True)
    ]
    points = locate_points(scene, marks)
    begun = time.process_time()
    lines = measure_lines(points, closed=True)
    assert time.process_time() - begun < 20.0  # s; some 3 on a quiet machine, minutes before
    some = measure_lines(points.subset([1000, 1001])).legs[0]
    assert lines.legs[1000].ground.sigma == pytest.approx(some.ground.sigma, rel=1e-9)


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
    apart = replace(
        alone, shared=alone.shared * 0.0, by_height=alone.by_height * 0.0, each=alone.own
    )
    assert not [s for s in measure_lines(apart).told() if "times better" in s]


def test_points_of_poses_that_know_nothing_of_each_other_are_told_so() -> None:
    scene = scenes.scene()
    free = type(scene).of(scene.frame, scene.terrain, scene.photos.photos)
    places = {"P": (np.array([1.0, 2.0, 0.0]), "AB"), "Q": (np.array([9.0, 2.0, 0.0]), "AC")}
    points = intersect_points(free, scenes.marks_of(scene.photos.photos, places))
    assert "poses are taken as independent" in measure_lines(points).doubts[-1]
    marks = [Mark(name="", photo="A", u=u, v=1500.0) for u in (500.0, 3500.0)]
    assert measure_lines(locate_points(free, marks)).doubts == ()
