"""Geoid, kinds of heights, datums and epochs: never a silent null step."""

from __future__ import annotations

import math

import numpy as np
import pytest
from pyproj import Transformer
from pyproj.transformer import TransformerGroup

from georef_gis.errors import CrsError
from georef_gis.geodesy import (
    CRS,
    UNKNOWN_DATUM_SIGMA,
    Datum,
    Height,
    HeightKind,
    MapFrame,
    Origin,
    geoid_undulation,
    parse_crs,
)

# NGA, test values of EGM96 (input.dat and output.dat of its F477 program): lat, lon, m
NGA = [
    (38.6281550, 269.7791550, -31.628),
    (-14.6212170, 305.0211140, -2.969),
    (46.8743190, 102.4487290, -43.575),
    (-23.6174460, 133.8747120, 15.871),
    (38.6254730, 359.9995, 50.066),
    (-0.4667440, 0.0023, 17.329),
]
COMPOUND = {
    "geoid18": ("EPSG:6318+5703", "EPSG:6319"),
    "egm2008": ("EPSG:4326+3855", "EPSG:4979"),
    "cgvd2013": ("EPSG:4617+6647", "EPSG:4955"),
}
OHIO = Origin(lat=math.radians(39.95), lon=math.radians(-83.0), height_ellipsoidal=200.0)


@pytest.mark.parametrize(("lat", "lon", "undulation"), NGA)
def test_egm96_at_ngas_test_places(lat: float, lon: float, undulation: float) -> None:
    # m: bilinear between posts of 15'
    assert geoid_undulation(*np.radians([lat, lon])) == pytest.approx(undulation, abs=0.08)


def test_egm96_has_no_seam() -> None:
    lat = np.radians([-80.0, 0.0, 39.0, 89.9])
    west, east = (geoid_undulation(lat, np.radians(lon)) for lon in (-180.0, 180.0))
    assert west == pytest.approx(east, abs=1e-12)
    assert geoid_undulation(lat, 0.3) == pytest.approx(geoid_undulation(lat, 0.3 + 2 * math.pi))
    # At a pole longitude means nothing.
    assert np.ptp(geoid_undulation(math.pi / 2, np.linspace(-3, 3, 9))) < 1e-9


def test_heights_of_each_kind() -> None:
    place = np.radians([38.6281550, -90.220845])
    ellipsoidal = Height(value=100.0, kind=HeightKind.ELLIPSOIDAL)
    assert ellipsoidal.ellipsoidal(*place) == 100.0
    orthometric = Height(value=100.0, kind=HeightKind.ORTHOMETRIC)
    assert orthometric.ellipsoidal(*place) == pytest.approx(68.372, abs=0.08)


@pytest.mark.parametrize("kind", [HeightKind.UNKNOWN, HeightKind.ABOVE_GROUND])
def test_a_height_of_no_known_zero_is_refused(kind: HeightKind) -> None:
    with pytest.raises(CrsError, match="state its kind"):
        Height(value=100.0, kind=kind).ellipsoidal(0.7, -1.4)


@pytest.mark.parametrize(
    ("geoid", "lat", "lon", "low", "high"),
    [
        ("geoid18", 39.95, -83.0, -36.0, -32.0),
        ("egm2008", 39.95, -83.0, -36.0, -32.0),
        ("cgvd2013", 45.4, -75.7, -36.0, -29.0),
    ],
)
@pytest.mark.filterwarnings("ignore:Best transformation is not available")
def test_a_geoid_is_read_from_its_grid_or_refused_by_name(
    geoid: str, lat: float, lon: float, low: float, high: float
) -> None:
    """Never a silent zero: its grids do not come with the wheel of pyproj."""
    place = np.radians([lat, lon])
    installed = TransformerGroup(*COMPOUND[geoid], allow_ballpark=False).best_available
    if installed:
        assert low < geoid_undulation(*place, geoid=geoid) < high
    else:
        with pytest.raises(CrsError, match=f"'{geoid}' is not installed"):
            geoid_undulation(*place, geoid=geoid)


def test_an_unknown_geoid_is_refused_with_the_known_ones() -> None:
    with pytest.raises(CrsError, match="egm96"):
        geoid_undulation(0.7, -1.4, geoid="egm2020")


def shift(a: str, b: str, place: Origin) -> np.ndarray:
    """Metres, in enu, that the map of datum b lies from that of a at one place."""
    crs = parse_crs("EPSG:6346")  # NAD83(2011) / UTM 17 N
    with_step = MapFrame(place, crs, gnss_datum=Datum.parse(a), crs_datum=Datum.parse(b))
    without = MapFrame(place, crs, gnss_datum=Datum.parse(b), crs_datum=Datum.parse(b))
    return with_step.map_from_enu(np.zeros(3)) - without.map_from_enu(np.zeros(3))


@pytest.mark.parametrize("lat_lon", [(39.95, -83.0), (39.0975, -80.467)], ids=["Ohio", "WV"])
def test_itrf2020_lies_over_a_metre_from_nad83_2011(lat_lon: tuple[float, float]) -> None:
    lat, lon = np.radians(lat_lon)
    place = Origin(lat=lat, lon=lon, height_ellipsoidal=250.0)
    d = shift("ITRF2020@2026.4", "NAD83(2011)@2010.0", place)
    assert 1.0 < np.hypot(d[0], d[1]) < 2.0  # m
    assert 0.8 < d[2] < 1.8  # m: NAD83's ellipsoid lies above by about 1.2 m here
    # North America moves west against ITRF: 20 years are 0.3 m and more.
    later = shift("ITRF2020@2046.4", "NAD83(2011)@2010.0", place)
    assert 0.2 < np.hypot(*(later - d)[:2]) < 0.6


def test_the_datum_step_is_projs_and_goes_back() -> None:
    frame = MapFrame(
        OHIO,
        parse_crs("EPSG:6346"),
        gnss_datum=Datum.parse("ITRF2020@2026.4"),
        crs_datum=Datum.parse("NAD83(2011)@2010.0"),
    )
    itrf, nad83 = (Datum.parse(n).geographic_3d() for n in ("ITRF2020", "NAD83(2011)"))
    step = Transformer.from_crs(itrf, nad83, always_xy=True)
    lon, lat, h, _ = step.transform(-83.0, 39.95, 200.0, 2026.4)
    e, n = Transformer.from_crs("EPSG:6318", "EPSG:6346", always_xy=True).transform(lon, lat)
    ours = frame.map_from_enu(np.zeros(3))
    assert ours == pytest.approx([e, n, h], abs=1e-5)  # m
    assert frame.enu_from_map(ours) == pytest.approx(np.zeros(3), abs=1e-5)  # m
    assert frame.datum_sigma == 0.0


def test_4979_to_6319_is_a_null_step_in_proj_and_so_two_metres_of_sigma() -> None:
    theirs = Transformer.from_crs("EPSG:4979", "EPSG:6319", always_xy=True)
    assert theirs.transform(-83.0, 39.95, 200.0) == pytest.approx((-83.0, 39.95, 200.0), abs=1e-9)
    frame = MapFrame(OHIO, parse_crs("EPSG:6346"))
    assert not frame.gnss_datum.is_known
    assert str(frame.crs_datum) == "NAD83(2011)"
    assert frame.datum_sigma >= UNKNOWN_DATUM_SIGMA == 2.0


def test_unequal_realisations_without_an_epoch_are_refused() -> None:
    with pytest.raises(CrsError, match="epoch"):
        MapFrame(OHIO, parse_crs("EPSG:6346"), gnss_datum=Datum.parse("ITRF2020"))


def test_equal_realisations_need_no_epoch_and_shift_nothing() -> None:
    frame = MapFrame(OHIO, parse_crs("EPSG:6346"), gnss_datum=Datum.parse("NAD83(2011)"))
    e, n = Transformer.from_crs("EPSG:6318", "EPSG:6346", always_xy=True).transform(-83, 39.95)
    assert frame.map_from_enu(np.zeros(3)) == pytest.approx([e, n, 200.0], abs=1e-6)
    assert frame.datum_sigma == 0.0


@pytest.mark.parametrize(
    ("text", "name", "epoch"),
    [
        ("NAD83(2011)@2010.0", "NAD83(2011)", 2010.0),
        ("ITRF2020@2026.4", "ITRF2020", 2026.4),
        ("ITRF2014", "ITRF2014", None),
        ("unknown", "unknown", None),
        ("", "unknown", None),
    ],
)
def test_datums_are_read_and_written_alike(text: str, name: str, epoch: float | None) -> None:
    datum = Datum.parse(text)
    assert (datum.name, datum.epoch) == (name, epoch)
    assert Datum.parse(str(datum)) == datum


@pytest.mark.parametrize(("text", "match"), [("NAD84", "realisation"), ("ITRF2020@x", "epoch")])
def test_a_datum_that_is_none_is_refused(text: str, match: str) -> None:
    with pytest.raises(CrsError, match=match):
        Datum.parse(text)


def test_wgs84_is_an_ensemble_and_so_unknown() -> None:
    assert not MapFrame(OHIO, CRS.from_epsg(32617)).crs_datum.is_known
