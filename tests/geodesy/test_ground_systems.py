"""Ground systems: grid coordinates times the factor, as ordinary projected CRSs."""

from __future__ import annotations

import math

import numpy as np
import pytest
from plane_oracle import US_FOOT, ZONES, Lambert
from pyproj import Transformer
from rasterio import Affine
from rasterio.crs import CRS as RasterioCrs
from rasterio.io import MemoryFile

from georef_gis.errors import CrsError
from georef_gis.geodesy import CRS, Datum, MapFrame, Origin, horizontal_crs, map_crs
from georef_gis.geodesy.ground_systems import ground_factor

# text before "ground", place (lat, lon deg)
GRIDS = [
    ("EPSG:6549", 41.08, -81.52),  # Lambert, US survey feet
    ("EPSG:6499", 42.96, -85.67),  # Lambert, international feet
    ("EPSG:6578", 30.27, -97.74),  # Lambert with a false northing
    ("EPSG:6527", 40.22, -74.76),  # Mercator, US survey feet
    ("EPSG:6405", 33.45, -112.07),  # Mercator, international feet
    ("EPSG:6394", 57.50, -134.50),  # oblique Mercator, m
    ("EPSG:7540", 43.07, -89.40),  # Lambert of one parallel: Wisconsin's Dane County, m
]
# what is written behind; factor, point that stays, shift
WORDS = [
    ("ground 1.0000987", 1.0000987, (0.0, 0.0), (0.0, 0.0)),
    ("ground 1.00012 about 2000000,500000", 1.00012, (2e6, 5e5), (0.0, 0.0)),
    ("ground 0.99995 about 1e6, 0 shift -1000000,-2.5", 0.99995, (1e6, 0.0), (-1e6, -2.5)),
]
# m; no one can set it out
EXACT = 1e-6


def at(text: str, lat: float, lon: float, height: float = 200.0) -> MapFrame:
    origin = Origin(lat=math.radians(lat), lon=math.radians(lon), height_ellipsoidal=height)
    return MapFrame(origin, map_crs(text), gnss_datum=Datum.parse("NAD83(2011)"))


@pytest.mark.parametrize(("grid", "lat", "lon"), GRIDS, ids=[g[0] for g in GRIDS])
@pytest.mark.parametrize(
    ("words", "factor", "about", "shift"), WORDS, ids=["origin", "point", "all"]
)
def test_ground_coordinates_are_the_grids_times_the_factor(
    grid: str, lat: float, lon: float, words: str, factor: float,
    about: tuple[float, float], shift: tuple[float, float],
) -> None:  # fmt: skip
    p_geo = np.radians([[lat, lon], [lat + 0.1, lon - 0.2], [lat - 0.3, lon + 0.1]])
    p_geo = np.column_stack([p_geo, np.full(3, 200.0)])
    on_grid = at(grid, lat, lon).map_from_geo(p_geo)[:, :2]
    frame = at(f"{grid} {words}", lat, lon)
    wanted = np.array(about) + factor * (on_grid - about) + shift
    assert frame.map_from_geo(p_geo)[:, :2] == pytest.approx(wanted, abs=EXACT)
    assert frame.geo_from_map(frame.map_from_geo(p_geo)) == pytest.approx(p_geo, abs=1e-12)
    assert str(frame.crs_datum) == "NAD83(2011)"


def test_ohio_north_on_the_ground_is_the_closed_formula_times_the_factor() -> None:
    """Without PROJ on the other side; 1 mm."""
    lat, lon, caf = 41.08, -81.52, 1.0000987
    e, n = ZONES["Ohio North"].forward(math.radians(lat), math.radians(lon))
    found = at(f"EPSG:6549 ground {caf}", lat, lon).map_from_geo(
        [math.radians(lat), math.radians(lon), 0.0]
    )
    assert found[:2] * US_FOOT == pytest.approx((e * caf, n * caf), abs=1e-3)


def test_the_combined_factor_of_a_place_makes_lengths_those_of_the_ground() -> None:
    """NGS manual 5, section 4.2: combined factor = grid scale factor x elevation factor."""
    lat, lon, h = 41.08, -81.52, 320.0
    plane = ZONES["Ohio North"]
    assert isinstance(plane, Lambert)
    # mean radius of GRS 80; the elevation factor is good to 0.1 ppm by it
    combined = plane.scale(math.radians(lat)) * 6_371_000.0 / (6_371_000.0 + h)
    frame = at(f"EPSG:6549 ground {1.0 / combined:.9f}", lat, lon, h)
    assert frame.scale_at(np.zeros(3)) == pytest.approx(1.0, abs=3e-7)
    assert abs(at("EPSG:6549", lat, lon, h).scale_at(np.zeros(3)) - 1.0) > 5e-5
    assert frame.doubts() == []


def test_a_factor_upside_down_is_doubted_with_the_right_one() -> None:
    lat, lon, h = 41.08, -81.52, 320.0
    scale = at("EPSG:6549", lat, lon, h).scale_at(np.zeros(3))
    (line,) = at(f"EPSG:6549 ground {scale:.7f}", lat, lon, h).doubts()
    assert "ppm off those on the ground" in line
    assert f"{1.0 / scale:.6f}" in line
    assert "ground over grid" in line


@pytest.mark.parametrize(("grid", "lat", "lon"), GRIDS, ids=[g[0] for g in GRIDS])
@pytest.mark.parametrize("version", ["WKT1_GDAL", "WKT1_ESRI", "WKT2_2019"])
def test_other_programs_read_a_ground_system(
    grid: str, lat: float, lon: float, version: str
) -> None:
    """GDAL of another build, by each dialect of WKT, and by the keys of a GeoTIFF."""
    crs = map_crs(f"{grid} ground 1.0000987")
    wanted = at(f"{grid} ground 1.0000987", lat, lon).map_from_enu(np.zeros(3))[:2]
    read = RasterioCrs.from_wkt(crs.to_wkt(version))
    made = {"driver": "GTiff", "width": 1, "height": 1, "count": 1, "dtype": "uint8"}
    with MemoryFile(ext=".tif") as memory:
        with memory.open(**made, crs=read, transform=Affine(2, 0, 9, 0, -2, 9)):
            pass
        with memory.open() as tiny:
            back = CRS.from_wkt(tiny.crs.to_wkt())
    found = Transformer.from_crs(back.geodetic_crs, back, always_xy=True).transform(lon, lat)
    # m; ESRI's text holds 13 digits of the parameters
    assert found == pytest.approx(wanted, abs=1e-5)
    assert back.axis_info[0].unit_conversion_factor == pytest.approx(
        crs.axis_info[0].unit_conversion_factor, rel=1e-12
    )


def test_heights_of_a_compound_stay() -> None:
    crs = map_crs("EPSG:6527+6360 ground 1.0001")
    assert crs.is_compound
    assert crs.sub_crs_list[1].to_epsg() == 6360
    assert ground_factor(horizontal_crs(crs)) == 1.0001
    assert ground_factor(CRS.from_wkt(horizontal_crs(crs).to_wkt("WKT1_GDAL"))) == 1.0001
    assert ground_factor(CRS.from_epsg(6549)) is None


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("EPSG:6549 ground 98.7", "ground over grid"),
        ("EPSG:6549 ground 1", "ground over grid"),
        ("EPSG:6549 ground 0", "ground over grid"),
        ("EPSG:6549 ground", "not understood"),
        ("EPSG:6549 ground 1.0001 about 5", "not understood"),
        ("EPSG:6549 ground 1.0001 around 5,5", "not understood"),
        ("EPSG:4326 ground 1.0001", "not a projected CRS"),
        ("EPSG:6360 ground 1.0001", "not a projected CRS"),
        ("EPSG:3857 ground 1.0001", "only a Lambert"),
        ("EPSG:5070 ground 1.0001", "only a Lambert"),
        ("EPSG:999999 ground 1.0001", "not a CRS that PROJ knows"),
    ],
)
def test_what_is_no_ground_system_is_refused(text: str, match: str) -> None:
    with pytest.raises(CrsError, match=match) as caught:
        map_crs(text)
    assert "\n" not in str(caught.value)
