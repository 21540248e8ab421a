"""Undulations from grids: right where the grid is, an error that names it where it is not."""

from __future__ import annotations

import math
import multiprocessing
import os
import subprocess
import sys
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from grid_cases import grids_in, plane, write_gtx, write_tiff
from pyproj import datadir

from georef_gis.errors import CrsError
from georef_gis.geodesy import (
    CRS,
    Datum,
    Height,
    HeightKind,
    MapFrame,
    Origin,
    geoid_undulation,
    map_crs,
    use_grids,
    vertical_part,
)

GEOID18, GEOID12B = "us_noaa_g2018u0.tif", "us_noaa_g2012bu0.tif"
CURE = rf"{GEOID18}.*georef grids download {GEOID18}.*georef grids add"
LAT, LON = 40.1, -82.9
# m; a float32 of 33 m, and PROJ's radians
EXACT = 5e-6


def undulation(lat: float = LAT, lon: float = LON, **wishes: object) -> float:
    return float(geoid_undulation(math.radians(lat), math.radians(lon), **wishes))  # type: ignore


def origin() -> Origin:
    return Origin(lat=math.radians(LAT), lon=math.radians(LON), height_ellipsoidal=250.0)


def test_geoid18_is_what_its_grid_holds(grids: Path) -> None:
    write_tiff(grids / GEOID18)
    lat, lon = np.meshgrid([38.3, 40.1, 41.9], [-84.7, -82.9, -81.2])
    found = geoid_undulation(np.radians(lat), np.radians(lon), geoid="geoid18")
    assert found == pytest.approx(np.asarray(plane(lat, lon)), abs=EXACT)
    height = Height(value=300.0, kind=HeightKind.ORTHOMETRIC, geoid="geoid18")
    assert height.ellipsoidal(*np.radians([LAT, LON])) == pytest.approx(
        300.0 + plane(LAT, LON), abs=EXACT
    )


def test_any_grid_is_a_geoid_by_its_file(grids: Path) -> None:
    write_gtx(grids / "county.gtx", shift=2.0)
    assert undulation(geoid="county.gtx") == pytest.approx(plane(LAT, LON) + 2.0, abs=EXACT)


@pytest.mark.parametrize("geoid", ["geoid18", "geoid12b", "egm2008", "cgvd2013", "county.gtx"])
def test_a_missing_grid_is_an_error_with_its_name_and_cure(grids: Path, geoid: str) -> None:
    with pytest.raises(CrsError, match=r"\.(tif|gtx) .*georef grids download \S+\.(tif|gtx)"):
        undulation(geoid=geoid)


def test_geoid18_is_not_taken_from_the_grid_of_geoid12b(grids: Path) -> None:
    """PROJ by itself takes whichever it finds; they differ by decimetres."""
    write_tiff(grids / GEOID12B, shift=0.3)
    with pytest.raises(CrsError, match=CURE):
        undulation(geoid="geoid18")
    assert undulation(geoid="geoid12b") == pytest.approx(plane(LAT, LON) + 0.3, abs=EXACT)


def test_beyond_its_grid_a_geoid_is_an_error_not_a_number(grids: Path) -> None:
    write_tiff(grids / GEOID18)
    with pytest.raises(CrsError, match=r"does not cover 30\.0000, -90\.0000"):
        undulation(30.0, -90.0, geoid="geoid18")
    # one of many, none of which may be lost without a word
    lat, lon = np.radians([LAT, 30.0]), np.radians([LON, -90.0])
    with pytest.raises(CrsError, match="does not cover"):
        geoid_undulation(lat, lon, geoid="geoid18")


def test_the_grid_of_the_place_is_named(grids: Path) -> None:
    with pytest.raises(CrsError, match=r"us_noaa_g2018p0\.tif"):
        undulation(18.3, -66.1, geoid="geoid18")
    with pytest.raises(CrsError, match=r"us_noaa_g2012ba0\.tif"):
        undulation(61.2, -149.9, geoid="geoid12b")
    with pytest.raises(CrsError, match="geoid12b covers Alaska"):
        undulation(61.2, -149.9, geoid="geoid18")


def test_a_damaged_grid_is_an_error_with_a_cure(grids: Path) -> None:
    (grids / GEOID18).write_bytes(b"no grid at all")
    with pytest.raises(CrsError, match=rf"damaged.*georef grids remove {GEOID18}"):
        undulation(geoid="geoid18")


def test_what_is_put_into_the_folder_is_found_at_once(grids: Path) -> None:
    from georef_gis.geodesy.grid_files import add_grid

    with pytest.raises(CrsError):
        undulation(geoid="geoid18")
    add_grid(write_tiff(grids.parent / GEOID18))
    assert undulation(geoid="geoid18") == pytest.approx(plane(LAT, LON), abs=EXACT)


# -- the ellipsoid that a geoid is told above --------------------------------------------------


def test_a_height_above_the_geoid_is_one_whatever_the_datum_of_the_positions(grids: Path) -> None:
    """GEOID18 is told above NAD83's ellipsoid, ITRF2020's lies over a metre below it in Ohio."""
    write_tiff(grids / GEOID18)
    nad83, itrf = Datum.parse("NAD83(2011)@2010.0"), Datum.parse("ITRF2020@2026.4")
    frame = MapFrame(origin(), map_crs("EPSG:6549"), gnss_datum=itrf, crs_datum=nad83)
    in_itrf = np.array([math.radians(LAT), math.radians(LON), 250.0])
    in_nad83 = frame.map_from_geo(in_itrf)[2]
    assert 0.8 < in_nad83 - in_itrf[2] < 1.8  # m
    level = in_nad83 - undulation(geoid="geoid18", datum=nad83)
    assert in_itrf[2] - undulation(geoid="geoid18", datum=itrf) == pytest.approx(level, abs=1e-3)
    assert undulation(geoid="geoid18", datum=Datum()) == undulation(geoid="geoid18")


# -- compound CRS ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "unit"),
    [
        ("EPSG:6549+6360", 1200.0 / 3937.0),
        ("EPSG:6549+8228", 0.3048),
        ("EPSG:6549+5703", 1.0),
        ("EPSG:8769", 1200.0 / 3937.0),
        ("EPSG:6549+6360 ground 1.0000987", 1200.0 / 3937.0),
    ],
)
def test_the_vertical_part_tells_geoid_and_unit(text: str, unit: float) -> None:
    part = vertical_part(map_crs(text))
    assert part is not None
    assert part.geoid == "geoid18"
    assert part.unit == pytest.approx(unit, abs=1e-15)


def test_a_vertical_part_comes_back_from_the_wkt_that_a_project_keeps() -> None:
    crs = map_crs("EPSG:6527+6360")
    for version in ("WKT2_2019", "WKT1_GDAL"):
        part = vertical_part(map_crs(crs.to_wkt(version)))
        assert part is not None
        assert (part.code, part.geoid) == (6360, "geoid18")


def test_a_map_that_promises_navd88_is_refused_without_the_grid_and_taken_with_it(
    grids: Path,
) -> None:
    frame = MapFrame(origin(), map_crs("EPSG:6549+6360"))
    with pytest.raises(CrsError, match=CURE):
        frame.check_inside(np.zeros((1, 3)))
    write_tiff(grids / GEOID18)
    frame.check_inside(np.zeros((1, 3)))


@pytest.mark.parametrize(
    ("name", "datum", "unit", "geoid"),
    [
        ("NAVD_1988_Foot_US", "North_American_Vertical_Datum_1988", 1200 / 3937, "geoid18"),
        ("NAVD_1988", "North_American_Vertical_Datum_1988", 1.0, "geoid18"),
        ("NAVD88 (ft)", "North American Vertical Datum of 1988", 0.3048, "geoid18"),
        ("CGVD2013", "Canadian_Geodetic_Vertical_Datum_of_2013", 1.0, "cgvd2013"),
        ("EGM2008", "EGM2008_Geoid", 1.0, "egm2008"),
    ],
)
def test_heights_of_a_prj_of_esri_are_known_by_their_datum(
    name: str, datum: str, unit: float, geoid: str
) -> None:
    """It has no codes: ArcGIS writes a VERTCS behind the PROJCS."""
    across = CRS.from_epsg(6549).to_wkt("WKT1_ESRI")
    up = (
        f'VERTCS["{name}",VDATUM["{datum}"],PARAMETER["Vertical_Shift",0.0],'
        f'PARAMETER["Direction",1.0],UNIT["a unit",{unit!r}]]'
    )
    part = vertical_part(map_crs(f"{across},{up}"))
    assert part is not None
    assert (part.geoid, part.unit) == (geoid, pytest.approx(unit, rel=1e-12))


@pytest.mark.parametrize(
    ("text", "match"),
    [("EPSG:6549+5702", "no geoid that is known"), ("EPSG:6549+6358", "counts downwards")],
)
def test_heights_that_cannot_be_given_are_refused(text: str, match: str) -> None:
    with pytest.raises(CrsError, match=match):
        map_crs(text)


# -- every process and thread ------------------------------------------------------------------


def test_threads_find_the_grid(grids: Path) -> None:
    write_tiff(grids / GEOID18)
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda _: undulation(geoid="geoid18"), range(16)))
    assert found == pytest.approx([plane(LAT, LON)] * 16, abs=EXACT)


def in_a_child(_: int) -> float:
    return undulation(geoid="geoid18")


def test_worker_processes_find_the_grid(grids: Path) -> None:
    write_tiff(grids / GEOID18)
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=context) as pool:
        assert pool.submit(in_a_child, 0).result() == pytest.approx(plane(LAT, LON), abs=EXACT)


def test_other_programs_started_from_here_find_the_grid(grids: Path) -> None:
    """A PROJ that knows nothing of us, such as that of a GIS."""
    write_tiff(grids / GEOID18)
    code = (
        "from pyproj import Transformer\n"
        "t = Transformer.from_crs('EPSG:6318+5703', 'EPSG:6319', always_xy=True)\n"
        f"print(t.transform({LON}, {LAT}, 0.0)[2])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, env=os.environ
    )
    assert float(done.stdout) == pytest.approx(plane(LAT, LON), abs=EXACT)


def test_a_projects_setting_names_the_folder(grids: Path, tmp_path: Path) -> None:
    from georef_gis.project import Project

    (tmp_path / "site" / "stick").mkdir(parents=True)
    write_tiff(tmp_path / "site" / "stick" / GEOID18)
    (tmp_path / "site" / "project.toml").write_text('[project]\ngrids = "stick"\n')
    with pytest.raises(CrsError):
        undulation(geoid="geoid18")
    Project.open(tmp_path / "site")
    assert undulation(geoid="geoid18") == pytest.approx(plane(LAT, LON), abs=EXACT)


def test_a_project_seen_in_passing_leaves_its_folder_of_grids_to_none_that_follows(
    grids: Path, tmp_path: Path
) -> None:
    """As `georef batch` sees many: a file of one name need not be the same in two of them."""
    from georef_gis.project import Project
    from georef_gis.project.grids import grids_kept

    write_gtx(grids / "county.gtx")
    (tmp_path / "site" / "stick").mkdir(parents=True)
    write_gtx(tmp_path / "site" / "stick" / "county.gtx", shift=2.0)
    (tmp_path / "site" / "project.toml").write_text('[project]\ngrids = "stick"\n')
    before = dict(os.environ)
    with grids_kept():
        Project.open(tmp_path / "site")
        assert undulation(geoid="county.gtx") == pytest.approx(plane(LAT, LON) + 2.0, abs=EXACT)
    assert undulation(geoid="county.gtx") == pytest.approx(plane(LAT, LON), abs=EXACT)
    assert dict(os.environ) == before


@pytest.mark.parametrize("length", [5, 60, 61, 100])
def test_a_folder_of_before_is_not_taken_for_the_one_in_use(tmp_path: Path, length: int) -> None:
    """pyproj loses all names of PROJ's list but the last, at some lengths of them."""
    folders = [tmp_path / ("x" * length) / name for name in ("first", "site/second")]
    for shift, folder in enumerate(folders):
        folder.mkdir(parents=True)
        write_gtx(folder / "county.gtx", shift=shift)
    with grids_in(folders[0]):
        use_grids(folders[1])
        assert undulation(geoid="county.gtx") == pytest.approx(plane(LAT, LON) + 1.0, abs=EXACT)
        assert datadir.get_data_dir().split(os.pathsep)[1:] == [str(folders[1])]


def test_a_grid_in_the_users_folder_does_not_stand_for_one_of_the_folder_that_is_named(
    tmp_path: Path,
) -> None:
    home = tmp_path / "home" / ".local" / "share" / "proj"
    home.mkdir(parents=True)
    write_gtx(home / "county.gtx")
    code = (
        "from pathlib import Path\n"
        "from georef_gis.geodesy import geoid_undulation, use_grids\n"
        "geoid_undulation(0.7, -1.45, geoid='county.gtx')\n"
        "use_grids(Path('none'))\n"
        "geoid_undulation(0.7, -1.45, geoid='county.gtx')\n"
    )
    env = {name: value for name, value in os.environ.items() if "GRIDS" not in name}
    env = {**env, "HOME": str(tmp_path / "home"), "XDG_DATA_HOME": ""}
    env.pop("PROJ_USER_WRITABLE_DIRECTORY", None)
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env=env, check=False
    )
    assert "the grid county.gtx of geoid 'county.gtx' is not installed" in done.stderr


def test_proj_keeps_its_own_database(grids: Path) -> None:
    """A folder of grids from another PROJ may hold a proj.db, which must not be read."""
    (grids / "proj.db").write_bytes(b"of another version")
    assert map_crs("EPSG:6549").to_epsg() == 6549
    code = "from georef_gis.geodesy import map_crs; print(map_crs('EPSG:6549').to_epsg())"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "6549"


@pytest.mark.parametrize("name", ["PROJ_DATA", "PROJ_LIB"])
def test_the_database_that_a_gis_names_to_its_children_is_not_read(
    tmp_path: Path, name: str
) -> None:
    """Else rasterio knows no CRS at all; the wheels have databases of their own."""
    (tmp_path / "proj.db").write_bytes(b"of another version")
    code = (
        "from georef_gis.geodesy import map_crs\n"
        "from rasterio.crs import CRS\n"
        "print(CRS.from_epsg(6549).to_epsg(), map_crs('EPSG:6549').to_epsg())"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True,
        env={**os.environ, name: str(tmp_path)}, check=False,
    )  # fmt: skip
    assert (done.stdout.split(), done.returncode) == (["6549", "6549"], 0), done.stderr
