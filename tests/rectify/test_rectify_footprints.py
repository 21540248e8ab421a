"""Footprints and GSD against hand-computed rectangles, own rays and shapely."""

import numpy as np
import pytest
import shapely
from rectify_cases import BENT, GROUND, ORIGIN, PLAIN, camera_at, map_frame, on_plane

from georef_gis.errors import GeometryError
from georef_gis.geodesy import metres_per_unit
from georef_gis.measure.single_photo import camera_field_of_view
from georef_gis.model.terrain import DemTerrain
from georef_gis.rectify.footprints import REACH_IN_HEIGHTS, footprint

FRAME = map_frame()


def test_footprint_of_nadir_photo_is_a_rectangle() -> None:
    found = footprint(camera_at(30.0, -20.0), GROUND, FRAME)
    # 600 x 400 px of 1/500 at 100 m: 120 x 80 m about the nadir.
    e, n = found.ring_enu[:, 0], found.ring_enu[:, 1]
    extent = [e.min(), e.max(), n.min(), n.max()]
    np.testing.assert_allclose(extent, [-30.0, 90.0, -60.0, 20.0], atol=2e-3)  # m: Earth bends
    assert found.area_m2 == pytest.approx(120.0 * 80.0, abs=1.0)
    assert found.gsd == pytest.approx(0.2, abs=1e-4)
    assert found.height_above_ground == pytest.approx(100.0, abs=1e-3)
    assert not found.clipped


def test_ring_is_closed_counter_clockwise_and_valid() -> None:
    found = footprint(camera_at(heading_deg=133.0, tilt_deg=20.0, camera=BENT), GROUND, FRAME)
    ring = shapely.LinearRing(found.ring_map)
    assert ring.is_valid
    assert ring.is_ccw
    np.testing.assert_array_equal(found.ring_map[0], found.ring_map[-1])


@pytest.mark.parametrize("heading", [0.0, 57.0, 180.0, 301.0])
@pytest.mark.parametrize("tilt", [0.0, 12.0, 35.0])
def test_footprint_is_where_own_rays_land(heading: float, tilt: float) -> None:
    photo = camera_at(10.0, 5.0, heading_deg=heading, tilt_deg=tilt)
    found = shapely.Polygon(footprint(photo, GROUND, FRAME).ring_enu[:, :2])
    own = shapely.Polygon(on_plane(photo, PLAIN.corners_uv))
    assert found.symmetric_difference(own).area < 1e-3 * own.area


@pytest.mark.parametrize("crs", ["EPSG:32617", "EPSG:6601", "EPSG:3857"])
def test_ring_on_the_map_is_that_of_enu(crs: str) -> None:
    frame = map_frame(crs)
    found = footprint(camera_at(tilt_deg=10.0), GROUND, frame)
    unit = metres_per_unit(frame.horizontal) / frame.scale_at(np.zeros(3))
    area = shapely.Polygon(found.ring_map).area * unit**2
    assert area == pytest.approx(found.area_m2, rel=1e-4)  # scale varies over 120 m


def test_gsd_agrees_with_the_field_of_view() -> None:
    photo = camera_at(height=52.1208)
    fov = camera_field_of_view(photo.camera, 52.1208)
    found = footprint(photo, GROUND, FRAME)
    assert found.gsd == pytest.approx(fov.gsd, rel=1e-4)
    assert found.area_m2 == pytest.approx(fov.width * fov.height, rel=1e-4)


def test_gsd_of_tilted_photo_grows_away_from_the_nadir() -> None:
    found = footprint(camera_at(tilt_deg=30.0), GROUND, FRAME)
    assert found.gsd_min < found.gsd < found.gsd_max
    # Area of a pixel: h^2 / (f^2 cos^3 of the angle off nadir); bottom -8 deg, top 52 deg off.
    expected = 0.2 / np.cos(np.radians(30.0) + np.arctan(197.5 / 500)) ** 1.5
    assert found.gsd_max == pytest.approx(expected, rel=0.15)  # its corner looks farther


@pytest.mark.parametrize("tilt", [65.0, 80.0, 89.0])
def test_frame_with_horizon_is_clipped(tilt: float) -> None:
    photo = camera_at(tilt_deg=tilt)
    found = footprint(photo, GROUND, FRAME)
    assert found.clipped
    far = np.hypot(*found.ring_enu[:, :2].T)
    assert far.max() <= REACH_IN_HEIGHTS * 100.0 * 1.01
    assert shapely.LinearRing(found.ring_map).is_simple


def test_frame_that_sees_only_sky_is_refused() -> None:
    with pytest.raises(GeometryError, match="P1"):
        footprint(camera_at(tilt_deg=130.0), GROUND, FRAME)


def test_photo_beside_the_dem_is_refused_with_its_name() -> None:
    dem = DemTerrain(
        frame=FRAME, heights=np.full((5, 5), 280.0), left=500.0, top=500.0, cell=(1.0, 1.0),
        step=0.5,
    )  # fmt: skip
    with pytest.raises(GeometryError, match=r"P1.*DEM too small"):
        footprint(camera_at(), dem, FRAME)


def test_footprint_on_a_slope_is_where_own_rays_meet_the_plane() -> None:
    slope = 0.2
    left, top = FRAME.map_from_enu([-150.0, 150.0, 0.0])[:2]
    x = left + np.arange(150) * 2.0 + 1.0
    east = x - FRAME.map_from_enu([0.0, 0.0, 0.0])[0]
    dem = DemTerrain(
        frame=FRAME, heights=np.tile(280.0 + slope * east, (150, 1)), left=float(left),
        top=float(top), cell=(2.0, 2.0), step=1.0,
    )  # fmt: skip
    found = footprint(camera_at(), dem, FRAME)
    # Left border: x = -0.6 t, ground -0.2 * 0.6 t below; right border alike: t = 100 / (1 +- .12)
    assert found.ring_enu[:, 0].max() == pytest.approx(60.0 / 1.12, abs=0.1)  # m: convergence
    assert found.ring_enu[:, 0].min() == pytest.approx(-60.0 / 0.88, abs=0.1)


def test_sigma_of_the_middle_holds_position_and_tilt() -> None:
    found = footprint(camera_at(), GROUND, FRAME)
    # 1 m of position, sqrt(3e-4) rad at 100 m; at the nadir the ground's height moves nothing.
    assert found.sigma_horizontal == pytest.approx(np.hypot(1.0, 1.732), rel=0.01)


def test_moving_the_flight_moves_the_footprint() -> None:
    a = footprint(camera_at(0.0, 0.0, tilt_deg=15.0), GROUND, FRAME)
    b = footprint(camera_at(40.0, -70.0, tilt_deg=15.0), GROUND, FRAME)
    moved = b.ring_enu[:, :2] - [40.0, -70.0]
    np.testing.assert_allclose(moved, a.ring_enu[:, :2], atol=5e-3)  # m: the Earth bends
    assert ORIGIN.height_ellipsoidal == 280.0
