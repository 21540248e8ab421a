"""MapFrame against PROJ: UTM, State Plane in feet, convergence, scale; zones and refusals."""

from __future__ import annotations

import math
import pickle
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyproj import Proj, Transformer

from georef_gis.errors import CrsError
from georef_gis.geodesy import (
    CRS,
    Datum,
    MapFrame,
    Origin,
    horizontal_crs,
    map_crs,
    metres_per_unit,
    parse_crs,
    same_crs,
    utm_crs,
)

SITE = Origin(lat=math.radians(39.0975), lon=math.radians(-80.467), height_ellipsoidal=277.6)
CODES = ["EPSG:32617", "EPSG:6601", "EPSG:6346", "EPSG:2263", "EPSG:3857"]
PLACES = np.array([[39.0975, -80.467, 277.6], [39.12, -80.40, 300.0], [39.05, -80.55, 900.0]])


@pytest.mark.parametrize("code", CODES)
def test_map_coordinates_are_projs_in_the_units_of_the_crs(code: str) -> None:
    frame = MapFrame(SITE, parse_crs(code))
    p_geo = np.column_stack([np.radians(PLACES[:, :2]), PLACES[:, 2]])
    e, n = Transformer.from_crs("EPSG:4326", code, always_xy=True).transform(
        PLACES[:, 1], PLACES[:, 0]
    )
    ours = frame.map_from_enu(SITE.enu_from_geo(p_geo))
    assert ours == pytest.approx(np.column_stack([e, n, PLACES[:, 2]]), abs=1e-5)  # m or ft
    assert frame.enu_from_map(ours) == pytest.approx(SITE.enu_from_geo(p_geo), abs=1e-5)


@pytest.mark.parametrize("code", ["EPSG:32617", "EPSG:6601", "EPSG:6346"])
def test_convergence_and_scale_are_projs(code: str) -> None:
    crs = parse_crs(code)
    frame = MapFrame(SITE, crs)
    ours = math.degrees(frame.convergence_at(np.zeros(3)))
    factors = Proj(crs).get_factors(-80.467, 39.0975)
    assert abs(ours) == pytest.approx(abs(factors.meridian_convergence), abs=1e-4)
    height = 1.0 - SITE.height_ellipsoidal / 6.37e6
    assert frame.scale_at(np.zeros(3)) == pytest.approx(factors.meridional_scale * height, abs=3e-7)


def test_convergence_is_positive_east_of_the_central_meridian() -> None:
    """UTM 17 has 81 W: at 80.467 W true north leans left of grid north by dlon sin(lat)."""
    frame = MapFrame(SITE, parse_crs("EPSG:32617"))
    expected = math.radians(81.0 - 80.467) * math.sin(SITE.lat)
    assert frame.convergence_at(np.zeros(3)) == pytest.approx(expected, rel=1e-3)
    step = frame.map_from_enu([0, 100.0, 0]) - frame.map_from_enu([0, 0, 0])
    assert step[0] < 0  # true north runs west of grid north


def test_state_plane_in_us_survey_feet() -> None:
    crs = parse_crs("EPSG:6601")
    assert metres_per_unit(crs) == pytest.approx(1200 / 3937, abs=1e-15)
    p = MapFrame(SITE, crs).map_from_enu([[0, 0, 0], [100, 0, 0]])
    assert np.hypot(*(p[1] - p[0])[:2]) == pytest.approx(328.083, abs=0.05)  # ft of 100 m


def test_compound_crs_projects_by_its_horizontal_part() -> None:
    compound = parse_crs("EPSG:6601+6360")
    assert horizontal_crs(compound).to_epsg() == 6601
    plain = MapFrame(SITE, parse_crs("EPSG:6601")).map_from_enu(np.zeros(3))
    assert MapFrame(SITE, compound).map_from_enu(np.zeros(3)) == pytest.approx(plain, abs=1e-9)


@given(st.floats(-79.9, 83.9).filter(lambda v: abs(v) > 1e-9), st.floats(-180, 179.99))
def test_utm_zones_are_projs(lat: float, lon: float) -> None:
    crs = utm_crs(math.radians(lat), math.radians(lon))
    area = crs.area_of_use
    assert area is not None
    norway = 56 <= lat < 84 and 0 <= lon < 42
    if not norway:
        assert area.west - 1e-9 <= lon <= area.east + 1e-9
    assert ("N" in crs.name[-1]) == (lat >= 0)


@pytest.mark.parametrize(
    ("lat", "lon", "epsg"),
    [
        (39.1, -80.5, 32617),
        (60.4, 5.3, 32632),  # Bergen
        (78.2, 15.6, 32633),  # Longyearbyen
        (-33.9, 151.2, 32756),
        (0.0, -180.0, 32601),
        (10.0, 179.9999, 32660),
        (10.0, 180.0, 32601),
    ],
)
def test_utm_zones_by_hand(lat: float, lon: float, epsg: int) -> None:
    assert utm_crs(math.radians(lat), math.radians(lon)).to_epsg() == epsg


def test_the_wrong_zone_is_refused() -> None:
    far = MapFrame(SITE, parse_crs("EPSG:32611"))
    with pytest.raises(CrsError, match="does not fit"):
        far.check_inside(np.zeros(3))
    MapFrame(SITE, parse_crs("EPSG:32617")).check_inside(np.zeros(3))


@pytest.mark.parametrize("text", ["EPSG:999999", "UTM 17", ""])
def test_what_is_no_crs_is_refused(text: str) -> None:
    with pytest.raises(CrsError, match="not a CRS"):
        parse_crs(text)


def test_degrees_are_no_map() -> None:
    with pytest.raises(CrsError, match="not a projected CRS"):
        map_crs("EPSG:4326")


def test_order_of_axes_makes_no_other_crs() -> None:
    assert same_crs(CRS.from_epsg(2193).to_wkt(), CRS.from_epsg(2193).to_wkt("WKT2_2019"))
    assert not same_crs(CRS.from_epsg(32617).to_wkt(), CRS.from_epsg(32618).to_wkt())


@pytest.mark.parametrize("east_km", [-20.0, 20.0])
def test_convergence_far_from_the_origin_is_that_of_the_places_own_meridian(
    east_km: float,
) -> None:
    crs = parse_crs("EPSG:32617")
    frame = MapFrame(SITE, crs)
    p = np.array([east_km * 1e3, 0.0, 0.0])
    lat, lon, _ = np.degrees(SITE.geo_from_enu(p))
    expected = Proj(crs).get_factors(lon, lat).meridian_convergence
    here = Proj(crs).get_factors(-80.467, 39.0975).meridian_convergence
    sign = math.copysign(1.0, here * frame.convergence_at(np.zeros(3)))
    # deg; enu's own north would be off by 0.146
    assert math.degrees(frame.convergence_at(p)) == pytest.approx(sign * expected, abs=1e-3)


# -- threads -----------------------------------------------------------------------------------


def test_every_thread_has_a_proj_object_of_its_own() -> None:
    """PROJ's contexts are not for two threads at once (PROJ: "Threading and multi-threading")."""
    frame = MapFrame(SITE, parse_crs("EPSG:32617"))
    barrier = threading.Barrier(4)

    def own(_: int) -> int:
        frame.map_from_enu([1.0, 2.0, 3.0])
        # All at once, so that no number is given twice to objects that died.
        found = frame._project.own
        barrier.wait(timeout=30)
        return id(found)

    with ThreadPoolExecutor(4) as pool:
        assert len(set(pool.map(own, range(4)))) == 4


def test_places_of_eight_threads_are_those_of_one() -> None:
    rng = np.random.default_rng(8)
    parts = [rng.uniform(-500, 500, (200, 3)) for _ in range(64)]
    frame = MapFrame(SITE, parse_crs("EPSG:6601"), gnss_datum=Datum.parse("ITRF2020@2026.4"),
                     crs_datum=Datum.parse("NAD83(2011)@2010.0"))  # fmt: skip
    wanted = [frame.map_from_enu(part) for part in parts]
    with ThreadPoolExecutor(8) as pool:
        found = list(pool.map(frame.map_from_enu, parts))
    for a, b in zip(found, wanted, strict=True):
        assert np.array_equal(a, b)


def test_a_frame_travels_to_another_process() -> None:
    frame = MapFrame(SITE, parse_crs("EPSG:6601"))
    twin = pickle.loads(pickle.dumps(frame))
    p = np.array([[100.0, -50.0, 20.0]])
    assert np.array_equal(twin.map_from_enu(p), frame.map_from_enu(p))
    assert twin.datum_sigma == frame.datum_sigma
