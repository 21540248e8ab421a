"""What users write for a map CRS: taken, or refused in one line that tells what to write."""

from __future__ import annotations

import math

import numpy as np
import pytest
from plane_oracle import FOOT, US_FOOT, Ellipsoid, Lambert, dms

from georef_gis.errors import CrsError
from georef_gis.geodesy import (
    CRS,
    Datum,
    MapFrame,
    Origin,
    differ_only_in_foot,
    ecef_from_geo,
    map_crs,
    metres_per_unit,
    parse_crs,
)

SITE = (41.08, -81.52)


def at(text: str, place: tuple[float, float] = SITE, **datums: Datum) -> MapFrame:
    lat, lon = np.radians(place)
    return MapFrame(Origin(lat=lat, lon=lon, height_ellipsoidal=250.0), map_crs(text), **datums)


NSRS2011 = "NAD83_National_Spatial_Reference_System_2011"


def wkt(
    *,
    datum: str = NSRS2011,
    unit: str = "US survey foot",
    length: float = US_FOOT,
    easting: float = 1968500.0,
) -> str:
    """WKT without a code: Ohio North or what is made of it."""
    return (
        f'PROJCS["Own system",GEOGCS["{datum}",DATUM["{datum}",'
        'SPHEROID["GRS 1980",6378137,298.257222101]],PRIMEM["Greenwich",0],'
        'UNIT["degree",0.0174532925199433]],PROJECTION["Lambert_Conformal_Conic_2SP"],'
        'PARAMETER["latitude_of_origin",39.6666666666667],PARAMETER["central_meridian",-82.5],'
        'PARAMETER["standard_parallel_1",41.7],PARAMETER["standard_parallel_2",40.4333333333333],'
        f'PARAMETER["false_easting",{easting}],PARAMETER["false_northing",0],'
        f'UNIT["{unit}",{length!r}],AXIS["X",EAST],AXIS["Y",NORTH]]'
    )


ENGINEERING = 'ENGCRS["Site",EDATUM["Peg"],CS[Cartesian,2],AXIS["x",east],AXIS["y",north],LENGTHUNIT["metre",1]]'  # noqa: E501


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("EPSG:999999", "not a CRS that PROJ knows"),
        ("EPSG:", "not a CRS"),
        ("State Plane Ohio North", "not a CRS"),
        ("EPSG:4326", "not a projected CRS"),
        ("EPSG:6318+5703", "not a projected CRS"),
        ("EPSG:4978", "not a projected CRS"),
        (ENGINEERING, "not a projected CRS"),
        ("EPSG:6360", r"is a height system and no map; .*EPSG:6549\+6360"),
        ("EPSG:6360+6549", r"the map stands first: EPSG:6549\+6360"),
        ("EPSG:6549+6549", "not a CRS"),
        ("EPSG:2053", "axes of .* run (west and south|south and west)"),
        (wkt(length=FOOT), "is the other foot"),
        (wkt(unit="Foot", length=US_FOOT), "is the other foot"),
        ('PROJCS["cut off",GEOGCS["', "not a CRS"),
    ],
)
def test_what_is_no_map_is_refused_in_one_line(text: str, match: str) -> None:
    with pytest.raises(CrsError, match=match) as caught:
        map_crs(text)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 260


def test_a_derived_crs_is_refused_with_what_to_write_in_its_place() -> None:
    base = CRS.from_epsg(6549).to_wkt().replace("PROJCRS[", "BASEPROJCRS[", 1)
    base = base[: base.index(",CS[")] + "]"
    derived = (
        f'DERIVEDPROJCRS["Ground",{base},DERIVINGCONVERSION["scale",METHOD["Affine parametric '
        'transformation",ID["EPSG",9624]],PARAMETER["A0",0,LENGTHUNIT["metre",1]],'
        'PARAMETER["A1",1.0001,SCALEUNIT["unity",1]]],CS[Cartesian,2],'
        'AXIS["x",east],AXIS["y",north],LENGTHUNIT["metre",1]]'
    )
    with pytest.raises(CrsError, match=r"derived CRS.*ground 1\.0000987"):
        map_crs(derived)


@pytest.mark.parametrize("code", [6549, 6499, 6527, 6405, 7540, 26917, 32617])
def test_an_esri_prj_without_authority_is_known_as_what_it_is(code: int) -> None:
    text = CRS.from_epsg(code).to_wkt("WKT1_ESRI")
    assert "EPSG" not in text
    assert map_crs(text).to_epsg() == code
    assert map_crs("\ufeff" + text).to_epsg() == code


def test_a_wkt_that_is_nearly_a_state_plane_stays_as_it_is() -> None:
    """By a false easting of a metre; by the other foot."""
    assert map_crs(wkt()).to_epsg() == 6549
    for text in (
        wkt(easting=1968503.281),
        wkt(unit="foot", length=FOOT, easting=600_000.0 / FOOT),
    ):
        crs = map_crs(text)
        assert crs.name == "Own system"
        assert "id" not in crs.to_json_dict()


def test_a_wkt_with_shifts_to_wgs_84_is_taken() -> None:
    text = CRS.from_epsg(26917).to_wkt("WKT1_GDAL")
    text = text.replace("SPHEROID[", "TOWGS84[0,0,0,0,0,0,0],SPHEROID[", 1)
    frame = at(text)
    plain = at("EPSG:26917")
    assert frame.map_from_enu(np.zeros(3)) == pytest.approx(
        plain.map_from_enu(np.zeros(3)), abs=1e-4
    )


# -- the place ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "text", ["EPSG:2154", "EPSG:28356", "EPSG:6405", "EPSG:32717", "EPSG:6578"]
)
def test_a_map_of_another_part_of_the_earth_is_refused(text: str) -> None:
    with pytest.raises(CrsError, match="does not fit the photos' place"):
        at(text).check_inside(np.zeros((1, 3)))


def test_lambert_of_the_same_latitudes_is_told_by_its_area() -> None:
    """Iowa's scale in Ohio is a map's; only the area of use tells."""
    frame = at("EPSG:6463")
    assert abs(frame.scale_at(np.zeros(3)) - 1.0) < 0.01
    with pytest.raises(CrsError, match=r"made for lat .*lon -9\d.* km away"):
        frame.check_inside(np.zeros((1, 3)))


def test_the_neighbours_zone_is_taken_with_a_doubt() -> None:
    frame = at("EPSG:6551")  # Ohio South, 100 km south of Akron
    frame.check_inside(np.zeros((1, 3)))
    (line,) = frame.doubts()
    assert "km outside of the area" in line
    assert "Ohio South" in line
    assert at("EPSG:6549").doubts() == []


def test_an_area_across_the_antimeridian_holds_on_both_sides() -> None:
    """EPSG:3338, Alaska Albers: 172 E to 130 W."""
    for lon in (175.0, -179.9, -150.0, -131.0):
        assert at("EPSG:3338", (60.0, lon)).doubts() == []


# -- the foot ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("first", "second", "only"),
    [
        (wkt(), wkt(unit="foot", length=FOOT, easting=600_000.0 / FOOT), True),
        (wkt(), wkt(unit="foot", length=FOOT), True),
        ("EPSG:2222", "EPSG:2222", False),
        ("EPSG:6549", "EPSG:6548", False),
        ("EPSG:6549", "EPSG:6551", False),
        ("EPSG:6549", "EPSG:4326", False),
        ("EPSG:6549+6360", "EPSG:6549+8228", False),
    ],
)
def test_maps_that_differ_in_the_foot_only_are_told(first: str, second: str, only: bool) -> None:
    assert differ_only_in_foot(parse_crs(first), parse_crs(second)) is only
    assert differ_only_in_foot(parse_crs(second), parse_crs(first)) is only


def test_utahs_two_feet_are_told() -> None:
    """EPSG has both: legislated are US survey feet, EPSG:3566 and 2281."""
    assert differ_only_in_foot(parse_crs("EPSG:2281"), parse_crs("EPSG:3566"))
    assert metres_per_unit(parse_crs("EPSG:2281")) == FOOT


# -- datums that need grids --------------------------------------------------------------------

NAD83 = Datum.parse("NAD83(2011)@2010.0")


@pytest.mark.parametrize(
    ("text", "datum", "grid"),
    [
        ("EPSG:3728", None, "nadcon5_nad83_2007_nad83_2011_conus.tif"),  # NSRS2007
        ("EPSG:3753", None, "nadcon5_nad83_harn"),  # HARN
        ("EPSG:6549", Datum.parse("NAD83(HARN)"), "nadcon5"),
    ],
)
def test_realisations_that_a_grid_parts_need_it_and_it_is_named(
    text: str, datum: Datum | None, grid: str
) -> None:
    """PROJ by itself takes NAD83(NSRS2007) for NAD83(2011), 0.00 m apart."""
    with pytest.raises(
        CrsError, match=rf"needs .*PROJ grid.*georef grids download .*us_noaa_{grid}"
    ):
        at(text, gnss_datum=NAD83, crs_datum=datum)


def test_a_map_of_an_older_name_may_be_said_to_be_in_the_datum_of_the_positions() -> None:
    """EPSG:2276, Texas: what offices still write, and mean EPSG:6584 by."""
    place = (32.78, -96.8)
    with pytest.raises(CrsError, match=r'datum_output = "NAD83\(2011\)@2010\.0"'):
        at("EPSG:2276", place, gnss_datum=NAD83)
    said = at("EPSG:2276", place, gnss_datum=NAD83, crs_datum=NAD83)
    new = at("EPSG:6584", place, gnss_datum=NAD83)
    # ft
    assert said.map_from_enu(np.zeros(3)) == pytest.approx(new.map_from_enu(np.zeros(3)), abs=1e-6)


@pytest.mark.parametrize(
    ("igs", "itrf"), [("IGS20", "ITRF2020"), ("IGb14", "ITRF2014"), ("IGS08", "ITRF2008")]
)
def test_positions_in_a_frame_of_the_igs_are_those_of_its_itrf(igs: str, itrf: str) -> None:
    """As OPUS and PPP name them; PROJ knows the names and no way from them."""
    a, b = (
        at("EPSG:6549", gnss_datum=Datum.parse(f"{name}@2026.4")).map_from_enu(np.zeros(3))
        for name in (igs, itrf)
    )
    # ft
    assert a == pytest.approx(b, abs=1e-9)


@pytest.mark.parametrize("name", ["EPSG:6549", "EPSG:5703", "6549"])
def test_a_map_or_a_height_system_is_no_datum(name: str) -> None:
    """An easting would go on as a longitude."""
    with pytest.raises(CrsError, match=r"no datum of positions.*write e\.g\. NAD83"):
        Datum.parse(name)


def test_itrf2014_at_an_epoch_is_nad83_by_the_parameters_of_ngs() -> None:
    """Pearson and Snay 2013, at 2010.0 with rates: m, mas, ppb; written down here without PROJ."""
    frame = at("EPSG:6549", gnss_datum=Datum.parse("ITRF2014@2024.5"))
    same = at("EPSG:6549", gnss_datum=NAD83)
    years = 14.5
    shift = np.array([1.00530, -1.90921, -0.54157]) + years * np.array([79e-5, -60e-5, -144e-5])
    mas = np.array([26.78138, -0.42027, 10.93206])
    mas += years * np.array([0.06667, -0.75744, -0.05133])
    scale = 1.0 + (0.36891 - 0.07201 * years) * 1e-9
    p = np.asarray(ecef_from_geo([*np.radians(SITE), 250.0]))
    turned = np.cross(p, np.radians(mas / 3.6e6))
    wanted = shift + scale * p + turned
    there = same.geo_from_map(frame.map_from_geo([*np.radians(SITE), 250.0]))
    # m; the ellipsoids of WGS 84 and GRS 80 differ by 0.1 mm in the axis
    assert np.asarray(ecef_from_geo(there)) == pytest.approx(wanted, abs=2e-4)


def test_the_epoch_is_that_of_the_frame_that_moves_whichever_end_it_stands_at() -> None:
    """Control of OPUS in ITRF2014@2024.5 beside positions in NAD83(2011)@2010.0: 0.25 m in Ohio."""
    itrf = Datum.parse("ITRF2014@2024.5")
    place = np.array([*np.radians(SITE), 250.0])
    there = at("EPSG:6549", gnss_datum=itrf, crs_datum=NAD83).map_from_geo(place)
    back = at("EPSG:32617", gnss_datum=NAD83, crs_datum=itrf)
    in_nad83 = at("EPSG:6549", gnss_datum=NAD83).geo_from_map(there)
    wanted = at("EPSG:32617", gnss_datum=itrf, crs_datum=itrf).map_from_geo(place)
    # m
    assert back.map_from_geo(in_nad83) == pytest.approx(wanted, abs=1e-4)


@pytest.mark.parametrize(
    ("gnss", "crs", "match"),
    [
        ("NAD83(2011)@2010.0", "ITRF2014", "state the epoch of ITRF2014"),
        ("ITRF2020", "NAD83(2011)@2010.0", "state the epoch of ITRF2020"),
        ("ITRF2020@2026.4", "ITRF2014@2010.0", "bring both to one epoch"),
        ("ITRF2014@2026.4", "ITRF2014@2010.0", "bring both to one epoch"),
    ],
)
def test_an_epoch_that_is_missing_or_years_away_is_no_silent_shift(
    gnss: str, crs: str, match: str
) -> None:
    with pytest.raises(CrsError, match=match):
        at("EPSG:6549", gnss_datum=Datum.parse(gnss), crs_datum=Datum.parse(crs))


@pytest.mark.parametrize("gnss", ["NAD83(2011)@2010.0", "ITRF2020@2026.4"])
def test_a_prj_of_wgs_84_has_no_realisation_and_needs_no_epoch(gnss: str) -> None:
    """ESRI's has no ensemble; a DEM in it lies where it lay, 2 m unsure."""
    text = CRS.from_epsg(32617).to_wkt("WKT1_ESRI").replace("WGS_1984_UTM", "Own_UTM")
    frame = at(text, gnss_datum=Datum.parse(gnss))
    assert frame.datum_sigma >= 2.0


def test_an_old_map_of_which_only_ten_metres_are_known_needs_its_grid() -> None:
    with pytest.raises(CrsError, match=r"good to 10 m only.*us_noaa_conus\.tif"):
        at("EPSG:26717")  # NAD27


def test_the_sigma_of_a_datum_without_a_grid_is_what_proj_says() -> None:
    """NAD83 of 1986: 4 m to WGS 84, 2 m with a grid: within what unknown datums hide anyway."""
    assert at("EPSG:26917").datum_sigma == pytest.approx(4.0)
    assert at("EPSG:6549", gnss_datum=NAD83).datum_sigma == 0.0


def test_spcs2022_is_no_code_of_this_proj_but_its_wkt_is_taken() -> None:
    """As long as the database of the PROJ in use has none; see docs/crs.md."""
    text = wkt(datum="North American Terrestrial Reference Frame of 2022", unit="foot", length=FOOT)
    frame = at(text, gnss_datum=Datum.parse("ITRF2020@2026.4"))
    assert frame.datum_sigma >= 2.0
    assert any("is not known to this PROJ" in line for line in frame.doubts())
    as_json = CRS.from_wkt(text).to_json()
    assert at(as_json).map_from_enu(np.zeros(3)) == pytest.approx(
        frame.map_from_enu(np.zeros(3)), abs=1e-6
    )
    assert math.isclose(metres_per_unit(frame.horizontal), FOOT)


def test_a_county_whose_ellipsoid_is_grown_is_projected_from_the_same_latitude_and_longitude() -> (
    None
):
    """Hennepin County, Minnesota: GRS 80 grown by 281.941 m, else Lambert as on GRS 80."""
    place = (44.98, -93.27)
    grown = Lambert(
        dms(44, 53), dms(45, 8), dms(44, 47, 28), dms(-93, 23), 152_400.3048, 30_480.06096,
        Ellipsoid(6_378_418.941, 298.257222101),
    )  # fmt: skip
    wanted = grown.forward(*np.radians(place))
    frame = at("ESRI:103634", place)
    assert frame.map_from_enu(np.zeros(3))[:2] == pytest.approx(wanted, abs=1e-3)
    assert not frame.crs_datum.is_known
    assert frame.datum_sigma >= 2.0
    stated = at("ESRI:103634", place, gnss_datum=NAD83, crs_datum=NAD83)
    assert stated.map_from_enu(np.zeros(3))[:2] == pytest.approx(wanted, abs=1e-3)
    assert (stated.datum_sigma, stated.doubts()) == (0.0, [])
