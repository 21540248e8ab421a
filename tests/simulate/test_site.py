"""The site keeps what the contract asks of it, so that signs cannot hide."""

import numpy as np
import pyproj
import pytest

from georef_gis import geodesy
from georef_gis.simulate import CameraTruth, ellipsoid, ground_height, site
from georef_gis.simulate.flight import BOUNDARY_GPS
from georef_gis.units import GPS_WEEK, utc_from_gps


def test_geoid_is_egm96_near_minus_33_metres():
    p_enu = np.array([[0.0, 0, 0], [200, 200, 0], [-200, 150, 0], [150, -200, 0]])
    lat, lon, _ = ellipsoid.geodetic_from_ecef(site.ecef_from_enu(p_enu))
    own = site.geoid_height(lat, lon)
    assert -34.0 < own[0] < -32.0
    # m: the site's plane against the package's bilinear table, which is rounded to 1 cm
    np.testing.assert_allclose(own, geodesy.geoid_undulation(lat, lon), atol=0.012)


def test_convergence_exceeds_half_a_degree_and_the_output_is_in_feet():
    crs = pyproj.CRS(site.OUTPUT_CRS)
    lat, lon = np.degrees(site.ORIGIN_LAT), np.degrees(site.ORIGIN_LON)
    assert abs(pyproj.Proj(crs).get_factors(lon, lat).meridian_convergence) > 0.5  # deg
    assert {axis.unit_name for axis in crs.axis_info} == {"US survey foot"}


def test_principal_point_is_off_centre():
    camera = CameraTruth()
    assert abs(camera.cx - (camera.width - 1) / 2) > 5.0  # px
    assert abs(camera.cy - (camera.height - 1) / 2) > 5.0


def test_distortion_grows_steadily_to_the_corner():
    r = np.linspace(0.0, 0.78, 200)  # tangent of the angle off the axis at the corner: 0.76
    c = CameraTruth()
    assert np.all(np.diff(r * (1 + c.k1 * r**2 + c.k2 * r**4 + c.k3 * r**6)) > 0)


def test_week_boundary_is_saturday_midnight_on_the_gps_scale(flight):
    assert BOUNDARY_GPS % GPS_WEEK == 0
    assert utc_from_gps(BOUNDARY_GPS).strftime("%a %H:%M:%S") == "Sat 23:59:45"  # 15 leap seconds
    times = flight.start_gps + flight.exposures
    assert np.sum(times < BOUNDARY_GPS) == 8
    assert np.sum(times > BOUNDARY_GPS) == 8


def test_ground_height_meets_the_terrain_in_the_site_frame():
    lat, lon = site.ORIGIN_LAT + np.array([0.0, 1e-5]), site.ORIGIN_LON + np.array([0.0, -1e-5])
    p = site.enu_from_ecef(ellipsoid.ecef_from_geodetic(lat, lon, ground_height(lat, lon)))
    np.testing.assert_allclose(p[:, 2], site.terrain_up(p[:, 0], p[:, 1]), atol=1e-6)  # m


def test_rays_end_on_the_terrain():
    rng = np.random.default_rng(7)
    d = np.column_stack([rng.uniform(-0.9, 0.9, (500, 2)), -np.ones(500)])
    p = site.intersect_ground(np.array([10.0, -20.0, 70.0]), d)
    np.testing.assert_allclose(p[:, 2], site.terrain_up(p[:, 0], p[:, 1]), atol=1e-6)  # m


def test_road_coordinates_and_their_inverse_agree():
    along, left = np.array([0.0, 50.0, -60.0]), np.array([3.0, -20.0, 40.0])
    p = site.enu_from_road(along, left)
    back = site.road_from_enu(p[:, 0], p[:, 1])
    np.testing.assert_allclose(np.stack(back), np.stack([along, left]), atol=1e-9)  # m
    assert np.abs(p[:, 2]).max() < 6.0  # m: gentle ground


def test_twelve_targets_half_of_them_checks_clear_of_objects():
    points = site.control_points()
    assert len(points) == 12
    assert sum(p.role == "check" for p in points) == 6
    for point in points:
        for item in site.objects():
            reach = np.hypot(item.length, item.width) / 2 + 1.0
            assert np.linalg.norm((item.enu - point.enu)[:2]) > reach, (point.name, item.name)


def test_taper_closes_the_lane_from_edge_to_centre():
    cones = [o for o in site.objects() if o.kind == "cone"]
    left = [o.left for o in cones]
    assert left == sorted(left)
    assert left[0] < -site.LANE
    assert left[-1] == pytest.approx(-0.25, abs=0.1)  # m
