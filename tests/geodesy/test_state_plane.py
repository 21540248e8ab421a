"""State Plane and county systems in metres and both feet against closed formulas, to 1 mm."""

from __future__ import annotations

import math

import numpy as np
import pytest
from plane_oracle import (
    AIRY,
    CLARKE,
    FOOT,
    US_FOOT,
    ZONES,
    Lambert,
    Mercator,
    dms,
)

from georef_gis.geodesy import Datum, MapFrame, Origin, map_crs, metres_per_unit

MM = 1e-3
# EPSG code, zone of NGS, metres per unit, and three places of the zone (lat, lon, deg)
CASES = [
    ("EPSG:6548", "Ohio North", 1.0, [(41.4993, -81.6944), (40.80, -84.10), (41.08, -81.52)]),
    ("EPSG:6549", "Ohio North", US_FOOT, [(41.4993, -81.6944), (40.80, -84.10), (41.08, -81.52)]),
    ("EPSG:6551", "Ohio South", US_FOOT, [(39.9612, -82.9988), (39.10, -84.51), (39.33, -82.10)]),
    ("EPSG:6463", "Iowa North", US_FOOT, [(42.03, -93.62), (43.15, -93.20), (42.50, -90.66)]),
    ("EPSG:6578", "Texas Central", US_FOOT, [(30.2672, -97.7431), (31.5493, -97.1467)]),
    ("EPSG:6570", "South Carolina", FOOT, [(34.0007, -81.0348), (32.7765, -79.9311)]),
    ("EPSG:6499", "Michigan South", FOOT, [(42.3314, -83.0458), (42.9634, -85.6681)]),
    ("EPSG:6527", "New Jersey", US_FOOT, [(40.2206, -74.7597), (39.3643, -74.4229)]),
    ("EPSG:6455", "Illinois East", US_FOOT, [(41.8781, -87.6298), (40.1164, -88.2434)]),
    ("EPSG:6405", "Arizona Central", FOOT, [(33.4484, -112.0740), (35.1983, -111.6513)]),
]
NAD83 = Datum.parse("NAD83(2011)@2010.0")


def frame_at(text: str, lat: float, lon: float, *, datum: Datum = NAD83) -> MapFrame:
    """Frame whose positions are of NAD83(2011), as the maps: only the projection is left."""
    origin = Origin(lat=math.radians(lat), lon=math.radians(lon), height_ellipsoidal=200.0)
    return MapFrame(origin, map_crs(text), gnss_datum=datum)


@pytest.mark.parametrize(
    ("plane", "lat", "lon", "easting", "northing", "unit"),
    [
        # Snyder (1987), pp. 296 and 269; IOGP Guidance Note 7-2, sections 3.1.1.1 and 3.5.3.1
        (Lambert(dms(33), dms(45), dms(23), dms(-96), 0.0, 0.0, CLARKE), dms(35), dms(-75),
         1_894_410.9, 1_564_649.5, 1.0),
        (Mercator(0.9996, 0.0, dms(-75), 0.0, 0.0, CLARKE), dms(40, 30), dms(-73, 30),
         127_106.5, 4_484_124.4, 1.0),
        (Lambert(dms(28, 23), dms(30, 17), dms(27, 50), dms(-99), 2e6 * US_FOOT, 0.0, CLARKE),
         dms(28, 30), dms(-96), 2_963_503.91, 254_759.80, US_FOOT),
        (Mercator(0.9996012717, dms(49), dms(-2), 400_000.0, -100_000.0, AIRY),
         dms(50, 30), dms(0, 30), 577_274.99, 69_740.50, 1.0),
    ],
    ids=["Snyder Lambert", "Snyder Mercator", "IOGP Texas South Central", "IOGP British grid"],
)  # fmt: skip
def test_the_oracle_gives_the_numbers_of_the_textbooks(
    plane: Lambert | Mercator, lat: float, lon: float, easting: float, northing: float, unit: float
) -> None:
    e, n = plane.forward(lat, lon)
    # half of the last digit in print, and its rounding of the ellipsoid
    digit = 0.06 if unit == 1.0 and plane.ellipsoid is CLARKE else 0.011
    assert (e / unit, n / unit) == pytest.approx((easting, northing), abs=digit)


@pytest.mark.parametrize(("code", "zone", "unit", "places"), CASES, ids=[c[0] for c in CASES])
def test_state_plane_is_that_of_ngs_manual_5(
    code: str, zone: str, unit: float, places: list[tuple[float, float]]
) -> None:
    assert metres_per_unit(map_crs(code)) == pytest.approx(unit, abs=1e-15)
    for lat, lon in places:
        frame = frame_at(code, lat, lon)
        wanted = np.array(ZONES[zone].forward(math.radians(lat), math.radians(lon))) / unit
        found = frame.map_from_geo([math.radians(lat), math.radians(lon), 200.0])
        assert found[:2] * unit == pytest.approx(wanted * unit, abs=MM)
        back = frame.geo_from_map(found)
        # rad of 1 mm on the ground
        assert back[:2] == pytest.approx(np.radians([lat, lon]), abs=MM / 6.4e6)
        assert frame.datum_sigma == 0.0


def test_the_two_feet_are_metres_apart_on_a_state_plane_map() -> None:
    """2 ppm of what stands on the axes: 8 m at the 4 000 000 m of Michigan South."""
    plane = ZONES["Michigan South"]
    e, _ = plane.forward(dms(42, 20), dms(-84))
    assert e * (1 - FOOT / US_FOOT) == pytest.approx(8.06, abs=0.05)


@pytest.mark.parametrize("code", ["EPSG:6549+6360", "EPSG:6549+8228", "EPSG:6549+5703"])
def test_a_vertical_part_does_not_move_the_map(code: str) -> None:
    lat, lon = 41.08, -81.52
    here = [math.radians(lat), math.radians(lon), 300.0]
    plain = frame_at("EPSG:6549", lat, lon).map_from_geo(here)
    assert frame_at(code, lat, lon).map_from_geo(here) == pytest.approx(plain, abs=1e-9)


# -- county systems by WKT ---------------------------------------------------------------------


def wkt_of_county(*, unit: str = "US survey foot", factor: str = "0.304800609601219") -> str:
    """A low distortion Mercator as a county would write it, with no code of any authority."""
    return (
        'PROJCS["Harding County LDP (ftUS)",GEOGCS["NAD83(2011)",'
        'DATUM["NAD83_National_Spatial_Reference_System_2011",'
        'SPHEROID["GRS 1980",6378137,298.257222101]],PRIMEM["Greenwich",0],'
        'UNIT["degree",0.0174532925199433]],PROJECTION["Transverse_Mercator"],'
        'PARAMETER["latitude_of_origin",40.5],PARAMETER["central_meridian",-83.5],'
        'PARAMETER["scale_factor",1.00004],PARAMETER["false_easting",164041.6667],'
        f'PARAMETER["false_northing",0],UNIT["{unit}",{factor}],'
        'AXIS["Easting",EAST],AXIS["Northing",NORTH]]'
    )


def test_a_county_system_by_wkt_is_as_its_parameters_say() -> None:
    lat, lon = 40.66, -83.61
    plane = Mercator(1.00004, dms(40, 30), dms(-83, 30), 164_041.6667 * US_FOOT)
    e, n = plane.forward(math.radians(lat), math.radians(lon))
    found = frame_at(wkt_of_county(), lat, lon).map_from_geo(
        [math.radians(lat), math.radians(lon), 0.0]
    )
    assert found[:2] * US_FOOT == pytest.approx((e, n), abs=MM)


def test_the_datum_of_a_county_system_by_wkt_is_known_by_its_name() -> None:
    frame = frame_at(wkt_of_county(), 40.66, -83.61)
    assert str(frame.crs_datum) == "NAD83(2011)"
    assert frame.datum_sigma == 0.0
