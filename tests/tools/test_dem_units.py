"""The unit of a DEM's heights where its file does not state it, and what the run says of it."""

from __future__ import annotations

import csv
import json
import math
import shutil
from pathlib import Path

import numpy as np
import pytest
import rasterio
from pyproj import CRS
from tool_cases import SAMPLE, georef

from georef_gis.errors import CrsError, InputError
from georef_gis.geodesy import (
    Datum,
    Height,
    HeightKind,
    MapFrame,
    Origin,
    geoid_undulation,
    parse_crs,
)
from georef_gis.model.photo import Geotag, Photo
from georef_gis.project import Project
from georef_gis.units import INTERNATIONAL_FOOT, US_SURVEY_FOOT
from processing_algorithms.dem import choose_unit, read_dem

LAT, LON = math.radians(39.0975), math.radians(-80.467)
SITE = Origin(lat=LAT, lon=LON, height_ellipsoidal=280.0)
N = float(geoid_undulation(LAT, LON))
# West Virginia North in metres and in US survey feet
METRES, US_FEET = "EPSG:6600", "EPSG:6601"


def project_with_dem(
    folder: Path, stored: float, crs: str = US_FEET, *, text: str = "", band: str = "",
    stated_geoid: bool = True,
) -> Project:  # fmt: skip
    """Project whose DEM holds one number under the site."""
    frame = MapFrame(SITE, parse_crs(crs))
    left, top = frame.map_from_enu([-900.0, 900.0, 0.0])[:2]
    right = frame.map_from_enu([900.0, 900.0, 0.0])[0]
    step = float(right - left) / 40
    folder.mkdir(exist_ok=True)
    with rasterio.open(
        folder / "dem.tif", "w", driver="GTiff", width=40, height=40, count=1, dtype="float32",
        crs=CRS(crs).to_wkt(), transform=rasterio.Affine(step, 0, left, 0, -step, top),
    ) as target:  # fmt: skip
        target.write(np.full((40, 40), stored, np.float32), 1)
        if band:
            target.set_band_unit(1, band)
    # no grid is needed where the user states the geoid
    geoid = '[gnss]\ngeoid = "egm96"\n' if stated_geoid else ""
    (folder / "project.toml").write_text(f'{geoid}[ground]\ndem = "dem.tif"\n{text}')
    return Project.open(folder)


def photos(height: float, kind: str, above: float | None) -> list[Photo]:
    tag = Geotag(lat=LAT, lon=LON, height=Height(value=height, kind=HeightKind(kind)))
    return [
        Photo(id=f"P{i}", path=Path(f"P{i}.JPG"), width=9, height=9, geotag=tag,
              height_above_takeoff=above)
        for i in range(3)
    ]  # fmt: skip


def chosen(project: Project, taken: list[Photo]):
    frame = MapFrame(SITE, parse_crs("EPSG:32617"))
    dem = read_dem(project, frame, np.array([[0.0, 0.0, 60.0]]))
    choice = choose_unit(dem, taken)
    ground = dem.terrain(choice.unit).height_at_map(dem.frame.map_from_enu([0.0, 0.0, 0.0])[:2])
    return choice, float(ground) - N


@pytest.mark.parametrize(
    ("height", "kind", "above"),
    [
        (374.0, "orthometric", 60.0),
        (374.0 + N, "ellipsoidal", 60.0),
        (374.0, "unknown", 60.0),
        (374.0 + N, "unknown", 60.0),
    ],
)
@pytest.mark.parametrize(("stored", "unit"), [(314.0, 1.0), (314.0 / US_SURVEY_FOOT, 0.3048006)])
def test_heights_above_take_off_tell_metres_from_feet(
    tmp_path: Path, height: float, kind: str, above: float, stored: float, unit: float
) -> None:
    choice, ground = chosen(project_with_dem(tmp_path, stored), photos(height, kind, above))
    assert choice.unit == pytest.approx(unit, rel=1e-6)
    assert choice.doubt == ""
    assert "above the ground" in choice.told
    # m; the geoid's grid and float32
    assert ground == pytest.approx(314.0, abs=0.05)


def test_a_camera_below_the_ground_tells_feet_without_any_relative_height(tmp_path: Path) -> None:
    project = project_with_dem(tmp_path, 314.0 / US_SURVEY_FOOT)
    choice, ground = chosen(project, photos(374.0, "orthometric", None))
    assert choice.doubt == ""
    assert ground == pytest.approx(314.0, abs=0.05)


@pytest.mark.parametrize(
    ("stored", "taken"),
    [
        (314.0, photos(374.0, "orthometric", None)),
        (6.0, photos(66.0, "orthometric", 60.0)),
        (314.0, photos(60.01, "unknown", 60.0)),
        (314.0, photos(60.0, "above_ground", None)),
    ],
    ids=["no relative height", "by the sea", "relative as absolute", "above ground only"],
)
def test_what_the_tags_do_not_tell_is_a_doubt_that_names_the_setting(
    tmp_path: Path, stored: float, taken: list[Photo]
) -> None:
    choice, _ = chosen(project_with_dem(tmp_path, stored), taken)
    assert "[ground] dem_unit" in choice.doubt
    assert "dem.tif" in choice.doubt
    assert "\n" not in choice.doubt
    assert choice.unit == pytest.approx(US_SURVEY_FOOT, rel=1e-9)


@pytest.mark.parametrize(
    ("name", "unit"), [("m", 1.0), ("ft", INTERNATIONAL_FOOT), ("us-ft", US_SURVEY_FOOT)]
)
@pytest.mark.parametrize("crs", [US_FEET, METRES, "EPSG:32617+6360"])
def test_the_users_unit_goes_before_all_others(
    tmp_path: Path, name: str, unit: float, crs: str
) -> None:
    project = project_with_dem(
        tmp_path, 314.0 / unit, crs, text=f'dem_unit = "{name}"\n', band="metre"
    )
    choice, ground = chosen(project, photos(374.0, "orthometric", 60.0))
    assert (choice.told, choice.doubt) == ("", "")
    assert ground == pytest.approx(314.0, abs=0.05)


def test_a_dem_above_a_geoid_whose_grid_is_missing_is_refused_with_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "grids").mkdir()
    monkeypatch.setenv("GEOREF_GRIDS", str(tmp_path / "grids"))
    project = project_with_dem(tmp_path / "site", 314.0, f"{US_FEET}+5703", stated_geoid=False)
    with pytest.raises(InputError, match=r"us_noaa_g2018u0\.tif.*georef grids download") as refused:
        chosen(project, photos(374.0, "orthometric", 60.0))
    assert 'geoid = "egm96"' in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("crs", "band", "unit"),
    [
        (METRES, "", 1.0),
        ("EPSG:4326", "", 1.0),
        (US_FEET, "m", 1.0),
        (US_FEET, "US survey foot", US_SURVEY_FOOT),
        (METRES, "foot", INTERNATIONAL_FOOT),
        (f"{US_FEET}+6360", "", US_SURVEY_FOOT),
        (f"{US_FEET}+5703", "", 1.0),
    ],
)
def test_a_stated_unit_is_taken_without_a_word(
    tmp_path: Path, crs: str, band: str, unit: float
) -> None:
    project = project_with_dem(tmp_path, 314.0 / unit, crs, band=band)
    # The tags would say otherwise: they are not asked.
    choice, ground = chosen(project, photos(5000.0, "orthometric", 10.0))
    assert (choice.told, choice.doubt) == ("", "")
    assert ground == pytest.approx(314.0, abs=0.05)


@pytest.mark.parametrize("band", ["Feet", "foot_us", "U.S. Survey Feet", "Survey_Feet"])
def test_a_band_names_its_feet_in_many_ways(tmp_path: Path, band: str) -> None:
    project = project_with_dem(tmp_path, 314.0 / US_SURVEY_FOOT, METRES, band=band)
    choice, ground = chosen(project, photos(374.0, "orthometric", 60.0))
    assert (choice.told, choice.doubt) == ("", "")
    # m; the two feet differ by 0.6 mm here, the rest is the geoid's grid and float32
    assert ground == pytest.approx(314.0, abs=0.05)


@pytest.mark.parametrize(("stored", "is_found"), [(314.0, True), (20.0, True), (2.0, False)])
def test_feet_in_a_crs_of_metres_are_found_by_the_tags_and_told(
    tmp_path: Path, stored: float, is_found: bool
) -> None:
    """Read as metres the ground lay above the cameras, or the scale was wrong by a third."""
    project = project_with_dem(tmp_path, stored / US_SURVEY_FOOT, METRES)
    choice, ground = chosen(project, photos(stored + 120.0, "orthometric", 120.0))
    assert ("[ground] dem_unit" in choice.doubt) == is_found
    # m; beside the sea feet and metres cannot be told apart, and metres are usual
    assert ground == pytest.approx(stored if is_found else stored / US_SURVEY_FOOT, abs=0.05)


def in_nad83(project: Project) -> tuple[str, float]:
    """Doubt and height of the ground where positions are in NAD83(2011) and their DEM is older."""
    frame = MapFrame(SITE, parse_crs(METRES), gnss_datum=Datum.parse("NAD83(2011)@2010.0"))
    dem = read_dem(project, frame, np.array([[0.0, 0.0, 60.0]]))
    choice = choose_unit(dem, photos(374.0, "orthometric", 60.0))
    ground = dem.terrain(choice.unit).height_at_map(dem.frame.map_from_enu([0.0, 0.0, 0.0])[:2])
    return choice.doubt, float(ground) - N


def test_a_dem_that_says_nad83_and_no_realisation_needs_no_grids(tmp_path: Path) -> None:
    """USGS says EPSG:4269 or 26917 of all its DEMs; of NAD27 tens of metres are at stake."""
    for crs in ("EPSG:26917", "EPSG:4269"):
        doubt, ground = in_nad83(project_with_dem(tmp_path, 314.0, crs))
        assert "dem.tif: its datum NAD83 is taken as NAD83(2011)" in doubt
        assert ground == pytest.approx(314.0, abs=0.05)
    project = project_with_dem(tmp_path, 314.0, "EPSG:26917")
    with rasterio.open(tmp_path / "dem.tif", "r+") as raster:
        raster.crs = rasterio.CRS.from_epsg(26717)
    with pytest.raises(CrsError, match=r"dem\.tif: .*NAD27.*georef grids download"):
        in_nad83(project)


@pytest.mark.parametrize(
    ("crs", "stated", "is_told"),
    [(METRES, False, True), (METRES, True, False), (f"{METRES}+5773", False, False)],
)
def test_a_dem_above_no_stated_geoid_is_told_in_a_project_of_navd88(
    tmp_path: Path, crs: str, stated: bool, is_told: bool
) -> None:
    """EGM96 and GEOID18 lie decimetres apart: products would be off by them without a word."""
    project = project_with_dem(tmp_path, 314.0, crs, stated_geoid=stated)
    frame = MapFrame(SITE, parse_crs(f"{US_FEET}+6360"))
    dem = read_dem(project, frame, np.array([[0.0, 0.0, 60.0]]))
    assert ("promises NAVD88 height (ftUS)" in dem.doubt) == is_told
    assert ('[gnss] geoid, such as "geoid18"' in dem.doubt) == is_told


def test_heights_of_an_unknown_system_wait_for_the_user_to_say_what_they_are(
    tmp_path: Path,
) -> None:
    """NGVD29 in feet: refused with what to write, taken when it is written."""
    feet = 314.0 / US_SURVEY_FOOT
    with pytest.raises(CrsError, match=r"NGVD29.*dem_height_kind = .*\[gnss\] geoid"):
        chosen(project_with_dem(tmp_path, feet, f"{US_FEET}+5702"), photos(374.0, "unknown", 60.0))
    said = 'dem_height_kind = "orthometric"\n'
    project = project_with_dem(tmp_path, feet, f"{US_FEET}+5702", text=said)
    _, ground = chosen(project, photos(374.0, "unknown", 60.0))
    assert ground == pytest.approx(314.0, abs=0.05)
    project = project_with_dem(tmp_path, -feet, f"{US_FEET}+6358", text=said)
    with pytest.raises(CrsError, match="counts downwards"):
        chosen(project, photos(374.0, "unknown", 60.0))


# -- in a run ----------------------------------------------------------------------------------

STEPS = "read_photos,orient_direct,footprints"


def real_project(folder: Path, stored_unit: float, text: str) -> Path:
    """Two photos of the sample, its DEM in a CRS of feet without a vertical part."""
    (folder / "photos").mkdir(parents=True)
    for name in ("IMG_0004.JPG", "IMG_0005.JPG"):
        shutil.copy(SAMPLE / "photos" / name, folder / "photos")
    project_with_dem(folder, 280.0 / stored_unit)
    (folder / "project.toml").write_text(text)
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("unit", [1.0, US_SURVEY_FOOT], ids=["m", "us-ft"])
def test_the_unit_that_was_found_holds_for_later_steps(tmp_path: Path, unit: float) -> None:
    stated = "" if unit != 1.0 else 'dem_unit = "m"\n'
    text = f'[gnss]\nheight_kind = "orthometric"\n[ground]\ndem = "dem.tif"\n{stated}'
    folder = real_project(tmp_path / "site", unit, text)
    done = georef("run", folder, "--only", STEPS)
    assert done.code == 0, done.text
    with Project.open(folder).database as database:
        facts = database.meta("ground")
        above = {row["photo_id"]: row["height_above_ground_m"] for row in database.rows("pose")}
        prints = {
            row["photo_id"]: row["extra"]["height_above_ground_m"]
            for row in database.rows("footprint")
        }
    assert facts["dem_unit_m"] == pytest.approx(unit, rel=1e-6)
    assert prints == pytest.approx(above, abs=0.01)
    assert 70.0 < min(above.values()) < 130.0


@pytest.mark.slow
def test_a_dem_of_unknown_unit_is_told_in_the_run(tmp_path: Path) -> None:
    text = '[gnss]\nheight_kind = "orthometric"\n[ground]\ndem = "dem.tif"\n'
    done = georef("run", real_project(tmp_path / "site", 1.0, text), "--only", STEPS)
    assert done.code == 0, done.text
    done.line("dem.tif", "[ground] dem_unit")


@pytest.mark.slow
def test_layers_say_what_the_heights_rest_on(tmp_path: Path) -> None:
    """Tags of unknown kind: sure over the ground, to half of the geoid's height over the sea."""
    folder = real_project(tmp_path / "site", 1.0, "[ground]\nheight_above_ground_m = 65.0\n")
    done = georef("run", folder, "--only", STEPS)
    assert done.code == 0, done.text
    with Project.open(folder).database as database:
        runs = {row["tool"].rpartition(".")[2]: row["fid"] for row in database.rows("run")}
        poses = database.rows("pose")
    unknown = [row for row in poses if "unknown" in row["extra"]["height_kind"]]
    assert len(unknown) == 2
    assert all(row["sigma_v_m"] > abs(N) / 2 for row in poses)
    assert {row["run_id"] for row in poses} == {next(v for k, v in runs.items() if "orient" in k)}
    done.line("[gnss] height_kind")
    target = tmp_path / "photos.geojson"
    assert georef("export-geojson", "--project", folder, "--target", target).code == 0
    for feature in json.loads(target.read_text())["features"]:
        values = feature["properties"]
        assert "unknown" in values["height_kind"]
        assert values["sigma_u_m"] > abs(N) / 2
        # 5 % of the stated height, and of 2.12 m of the receiver what two photos do not share
        assert values["sigma_above_ground_m"] == pytest.approx(
            math.hypot(3.25, 2.12 * math.sqrt(0.5)), rel=1e-3
        )


@pytest.mark.slow
def test_places_measured_in_a_photo_have_the_sigma_of_the_level(tmp_path: Path) -> None:
    folder = real_project(tmp_path / "site", 1.0, "[ground]\nheight_above_ground_m = 65.0\n")
    assert georef("run", folder, "--only", STEPS).code == 0
    target = tmp_path / "points.csv"
    done = georef(
        "measure-photo", folder / "photos" / "IMG_0004.JPG", "--site", folder,
        "--pixel", "400,300", "--target", target,
    )  # fmt: skip
    assert done.code == 0, done.text
    (values,) = csv.DictReader(target.read_text().splitlines())
    assert float(values["sigma_u_m"]) > abs(N) / 2
    assert float(values["sigma_e_m"]) < 12.0
