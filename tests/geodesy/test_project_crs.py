"""Projects whose map is a DOT's: photos read, or one line that tells what to write or to get."""

from __future__ import annotations

import math
import shutil
import sqlite3
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from grid_cases import grids_in, plane, write_tiff

from georef_gis.app import cli
from georef_gis.geodesy import CRS, Datum, HeightKind, MapFrame, Origin, map_crs
from georef_gis.ingest.control_places import Placed, place_control
from georef_gis.model.camera import Camera
from georef_gis.model.control import Control, ControlPoint
from georef_gis.model.photo import OrientedPhoto, Photo
from georef_gis.model.pose import Pose
from georef_gis.model.terrain import FlatTerrain

SAMPLE = Path(__file__).parents[2] / "sample_project"
GEOID18 = "us_noaa_g2018u0.tif"
# West Virginia; the sample's site
WV_NORTH = 6601


@pytest.fixture
def site(tmp_path: Path) -> Path:
    """Two photos of the sample project."""
    folder = tmp_path / "site"
    (folder / "photos").mkdir(parents=True)
    for path in sorted((SAMPLE / "photos").glob("*.JPG"))[:2]:
        shutil.copy2(path, folder / "photos")
    return folder


def read(site: Path, crs: str, more: str = "") -> tuple[int, str]:
    """Exit code and words of reading the photos into a map."""
    (site / "project.toml").write_text(f"[project]\ncrs = {crs!r}\n{more}")
    done = CliRunner().invoke(cli.georef, ["run", str(site), "--only", "read_photos"])
    return done.exit_code, done.output


def places(site: Path) -> np.ndarray:
    """Eastings and northings of the photos as the project keeps them."""
    with sqlite3.connect(site / "georef.gpkg") as database:
        blobs = [row[0] for row in database.execute("select geom from photo order by photo_id")]
    return np.array([np.frombuffer(blob[-24:], "<f8")[:2] for blob in blobs])


def test_a_map_with_navd88_heights_waits_for_its_grid(site: Path, tmp_path: Path) -> None:
    with grids_in(tmp_path / "grids") as grids:
        code, text = read(site, f"EPSG:{WV_NORTH}+6360")
        assert code == 2
        line = text.splitlines()[-1]
        assert f"georef grids download {GEOID18}" in line
        # a grid of another state does not do: the test's is of Ohio, the site east of it
        write_tiff(grids / GEOID18)
        code, text = read(site, f"EPSG:{WV_NORTH}+6360")
        assert (code, "does not cover 39.09" in text) == (2, True), text
        write_tiff(grids / GEOID18, east=2.0)
        code, text = read(site, f"EPSG:{WV_NORTH}+6360")
        assert code == 0, text


def test_the_folder_of_grids_may_be_the_projects(site: Path, tmp_path: Path) -> None:
    with grids_in(tmp_path / "grids"):
        (site / "geoids").mkdir()
        write_tiff(site / "geoids" / GEOID18, east=2.0)
        code, text = read(site, f"EPSG:{WV_NORTH}+6360", 'grids = "geoids"\n')
        assert code == 0, text


def test_a_ground_system_is_the_grid_times_the_factor_in_the_project(site: Path) -> None:
    assert read(site, f"EPSG:{WV_NORTH}")[0] == 0
    grid = places(site)
    code, text = read(site, f"EPSG:{WV_NORTH} ground 1.00008")
    assert code == 0, text
    # ft
    assert places(site) == pytest.approx(grid * 1.00008, abs=1e-5)


def test_a_prj_of_esri_is_the_map_that_it_names(site: Path) -> None:
    assert read(site, f"EPSG:{WV_NORTH}")[0] == 0
    wanted = places(site)
    (site / "county.prj").write_text(CRS.from_epsg(WV_NORTH).to_wkt("WKT1_ESRI"))
    code, text = read(site, "county.prj")
    assert code == 0, text
    assert places(site) == pytest.approx(wanted, abs=1e-6)
    with sqlite3.connect(site / "georef.gpkg") as database:
        (number,) = database.execute(
            "select srs_id from gpkg_geometry_columns where table_name = 'photo'"
        ).fetchone()
    assert number == WV_NORTH


@pytest.mark.parametrize(
    ("crs", "match"),
    [
        ("EPSG:4326", "not a projected CRS"),
        ("EPSG:6360", "height system"),
        (f"EPSG:6360+{WV_NORTH}", "the map stands first"),
        ("EPSG:2154", "does not fit the photos' place"),
        ("EPSG:6463", "does not fit the photos' place"),
        (f"EPSG:{WV_NORTH}+5702", "no geoid that is known"),
        ("lost.prj", "cannot be read"),
        ("empty.prj", "not a CRS that PROJ knows"),
    ],
)
def test_what_cannot_be_the_map_is_one_line(site: Path, crs: str, match: str) -> None:
    (site / "empty.prj").write_text("\n")
    code, text = read(site, crs)
    assert code == 2
    assert match in text.splitlines()[-1]
    assert "bug" not in text


# -- heights of control ------------------------------------------------------------------------

LAT, LON = 40.1, -82.9
GROUND = 240.0
US_FOOT = 1200.0 / 3937.0


def control_in_feet(frame: MapFrame, height_m: float) -> Placed:
    """A point amid the photos in EPSG:6549+6360, its height above the geoid in US survey feet."""
    e, n, _ = frame.map_from_enu(np.zeros(3))
    point = ControlPoint(name="P", easting=e, northing=n, height=height_m, source="c.csv, line 2")
    crs = map_crs("EPSG:6549+6360")
    control = Control(crs=crs, datum=Datum(), height_kind=HeightKind.ORTHOMETRIC,
                      geoid="geoid18", points=(point,))  # fmt: skip
    camera = Camera(id="c", width=600, height=400, fx=500.0, fy=500.0, cx=299.5, cy=199.5)
    pose = Pose(origin_enu=np.array([0.0, 0.0, 60.0]), R_enu_from_cam=np.diag([1.0, -1.0, -1.0]),
                covariance=np.eye(6) * 1e-2)  # fmt: skip
    photo = Photo(id="A", path=Path("A.JPG"), width=600, height=400)
    terrain = FlatTerrain(origin=frame.origin, height_ellipsoidal=GROUND, sigma=1.5)
    shown = OrientedPhoto(photo=photo, camera=camera, pose=pose)
    return place_control(control, frame, terrain, {"A": shown})


def test_control_above_a_geoid_without_a_grid_is_used_without_height_and_told(
    tmp_path: Path,
) -> None:
    origin = Origin(lat=math.radians(LAT), lon=math.radians(LON), height_ellipsoidal=GROUND)
    frame = MapFrame(origin, map_crs("EPSG:6549"))
    height = GROUND - float(plane(LAT, LON))
    with grids_in(tmp_path / "grids") as grids:
        found = control_in_feet(frame, height)
        assert np.isinf(found.observations.sigma[0, 2])
        assert np.isnan(found.geo[0, 2])
        (line,) = [line for line in found.doubts if GEOID18 in line]
        assert f"georef grids download {GEOID18}" in line
        assert "used without height" in line
        write_tiff(grids / GEOID18)
        found = control_in_feet(frame, height)
        # m
        assert found.geo[0, 2] == pytest.approx(GROUND, abs=1e-4)
        assert np.isfinite(found.observations.sigma[0, 2])
