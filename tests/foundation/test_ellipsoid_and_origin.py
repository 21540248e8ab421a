"""Ellipsoid and topocentric frame against PROJ and the degree lengths of the textbooks."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyproj import Transformer

from georef_gis import geodesy
from georef_gis.geodesy import Origin

PLACES = st.tuples(st.floats(-90, 90), st.floats(-180, 180), st.floats(-400, 9000))


@pytest.mark.parametrize(
    ("geo", "ecef"),
    [
        ((0, 0, 0), (6378137.0, 0, 0)),
        ((0, 90, 100), (0, 6378237.0, 0)),
        ((90, 0, 0), (0, 0, 6356752.314245)),
        ((-90, 0, 50), (0, 0, -6356802.314245)),
    ],
)
def test_equator_and_poles(geo: tuple, ecef: tuple) -> None:
    p_geo = np.array([*np.radians(geo[:2]), geo[2]])
    assert geodesy.ecef_from_geo(p_geo) == pytest.approx(np.array(ecef), abs=1e-6)  # m
    back = geodesy.geo_from_ecef(np.array(ecef))
    assert (math.degrees(back[0]), back[2]) == pytest.approx((geo[0], geo[2]), abs=1e-6)


@given(PLACES)
def test_ecef_is_projs(place: tuple[float, float, float]) -> None:
    lat, lon, h = place
    theirs = Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True).transform(lon, lat, h)
    ours = geodesy.ecef_from_geo([math.radians(lat), math.radians(lon), h])
    assert ours == pytest.approx(np.array(theirs), abs=1e-6)  # m
    again = geodesy.ecef_from_geo(geodesy.geo_from_ecef(ours))
    assert again == pytest.approx(ours, abs=1e-7)  # m


@pytest.mark.parametrize(
    ("lat_deg", "of_latitude", "of_longitude"),
    # m; one degree at 0, 39 and 60 deg: NGA, "Length of a degree of latitude and longitude"
    [(0, 110574.3, 111319.5), (39, 111015.4, 86626.4), (60, 111412.3, 55800.2)],
)
def test_length_of_a_degree(lat_deg: float, of_latitude: float, of_longitude: float) -> None:
    lat, one = math.radians(lat_deg), math.radians(1)
    assert geodesy.meridian_radius(lat) * one == pytest.approx(of_latitude, abs=30)
    across = geodesy.prime_vertical_radius(lat) * math.cos(lat) * one
    assert across == pytest.approx(of_longitude, abs=30)


def test_enu_is_projs_topocentric() -> None:
    lat, lon, h = 39.0975, -80.467, 277.6
    pipeline = (
        "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad +step +proj=cart "
        f"+ellps=WGS84 +step +proj=topocentric +ellps=WGS84 +lon_0={lon} +lat_0={lat} +h_0={h}"
    )
    places = np.array([[39.1, -80.46, 300.0], [39.2, -80.2, 0.0], [38.9, -80.7, 2500.0]])
    theirs = np.column_stack(
        Transformer.from_pipeline(pipeline).transform(places[:, 1], places[:, 0], places[:, 2])
    )
    origin = Origin(lat=math.radians(lat), lon=math.radians(lon), height_ellipsoidal=h)
    p_geo = np.column_stack([np.radians(places[:, :2]), places[:, 2]])
    ours = origin.enu_from_geo(p_geo)
    assert ours == pytest.approx(theirs, abs=1e-6)  # m
    assert origin.geo_from_enu(ours)[:, 2] == pytest.approx(places[:, 2], abs=1e-7)
    assert origin.geo_from_enu(ours)[:, :2] == pytest.approx(p_geo[:, :2], abs=1e-14)


def test_the_origin_is_zero_and_up_is_height() -> None:
    origin = Origin(lat=0.7, lon=-1.4, height_ellipsoidal=200.0)
    assert origin.enu_from_geo([0.7, -1.4, 210.0]) == pytest.approx([0, 0, 10], abs=1e-8)
    assert origin.ecef_from_enu([0, 0, 0]) == pytest.approx(origin.p_ecef, abs=1e-9)


def test_degrees_given_for_radians_are_refused() -> None:
    with pytest.raises(ValueError, match="radians"):
        Origin(lat=39.1, lon=-80.5, height_ellipsoidal=0.0)
