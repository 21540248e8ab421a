"""Settings of project.toml do what their descriptions say."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
import rasterio
from click.testing import CliRunner, Result
from pyproj import CRS

from georef_gis.app import cli
from georef_gis.geodesy import MapFrame, Origin
from georef_gis.project import Project
from georef_gis.units import US_SURVEY_FOOT

SAMPLE = Path(__file__).parents[2] / "sample_project"
STEPS = "read_photos,orient_direct,footprints"


def make(folder: Path, text: str) -> Path:
    """Project of two photos of the sample with a project.toml of its own."""
    (folder / "photos").mkdir(parents=True)
    for name in ("IMG_0004.JPG", "IMG_0005.JPG"):
        shutil.copy(SAMPLE / "photos" / name, folder / "photos")
    (folder / "project.toml").write_text(text)
    return folder


def run(folder: Path) -> Result:
    return CliRunner().invoke(cli.georef, ["run", str(folder), "--only", STEPS])


def height_above_ground(folder: Path) -> float:
    with Project.open(folder).database as database:
        rows = database.rows("footprint")
    return float(np.mean([row["extra"]["height_above_ground_m"] for row in rows]))


@pytest.mark.slow
@pytest.mark.parametrize("code", ["EPSG:32617+5703", "EPSG:32617+6360"], ids=["m", "ftUS"])
def test_dem_with_a_vertical_crs_gives_the_same_ground_in_metres_and_feet(
    tmp_path: Path, code: str
) -> None:
    unit = US_SURVEY_FOOT if code.endswith("6360") else 1.0
    with rasterio.open(SAMPLE / "dem.asc") as source:
        values, transform = source.read(1), source.transform
    folder = make(
        tmp_path / "site",
        '[gnss]\nheight_kind = "orthometric"\ngeoid = "egm96"\n[ground]\ndem = "dem.tif"\n',
    )
    with rasterio.open(
        folder / "dem.tif", "w", driver="GTiff", width=values.shape[1], height=values.shape[0],
        count=1, dtype="float32", crs=CRS(code).to_wkt(), transform=transform,
    ) as target:  # fmt: skip
        target.write((values / unit).astype(np.float32), 1)
    assert run(folder).exit_code == 0
    assert 50.0 < height_above_ground(folder) < 95.0


@pytest.mark.slow
def test_sigma_of_the_boresight_counts_alone(tmp_path: Path) -> None:
    sigmas = []
    for i, mount in enumerate(("", "[mount]\nsigma_boresight_deg = 10.0\n")):
        folder = make(tmp_path / str(i), f"[ground]\nheight_above_ground_m = 65.0\n{mount}")
        assert run(folder).exit_code == 0
        with Project.open(folder).database as database:
            sigmas.append(database.rows("footprint")[0]["sigma_m"])
    assert sigmas[1] > 2 * sigmas[0]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('[ground]\nheight_m = 200\nheight_kind = "auto"\n', "height_kind"),
        ('[project]\ncrs = "none.wkt"\n', "none.wkt"),
    ],
)
def test_wrong_setting_is_a_user_error(tmp_path: Path, text: str, words: str) -> None:
    done = run(make(tmp_path / "site", text))
    assert done.exit_code == 2
    assert words in done.stderr


def test_wkt_with_a_datum_of_its_own_is_taken_as_wgs_84() -> None:
    wkt = CRS("EPSG:32617").to_wkt("WKT1_GDAL").replace("WGS_1984", "County_Datum")
    lines = wkt.replace('AUTHORITY["EPSG","4326"]', "").replace('"WGS 84"', '"County"')
    own = CRS.from_wkt(lines.replace(",,", ",").replace(",]", "]"))
    origin = Origin(lat=np.radians(39.1), lon=np.radians(-80.4), height_ellipsoidal=300.0)
    plain = MapFrame(origin, CRS("EPSG:32617"))
    frame = MapFrame(origin, own)
    p = np.array([[100.0, -50.0, 20.0]])
    assert np.allclose(frame.map_from_enu(p), plain.map_from_enu(p), atol=1e-6)
    assert frame.datum_sigma >= 2.0


@pytest.mark.slow
def test_only_may_be_given_more_than_once(tmp_path: Path) -> None:
    folder = make(tmp_path / "site", "[ground]\nheight_above_ground_m = 65.0\n")
    words = ["run", str(folder), "--only", "read_photos", "--only", "orient_direct"]
    assert CliRunner().invoke(cli.georef, words).exit_code == 0


def test_middle_of_positions_across_the_180th_meridian() -> None:
    from georef_gis.model.photo import Geotag
    from processing_algorithms.site import middle_of

    lons = np.radians([179.9, -179.9, -179.95])
    lat, lon = middle_of([Geotag(lat=0.1, lon=float(v)) for v in lons])
    assert lat == pytest.approx(0.1)
    assert np.degrees(lon) == pytest.approx(-179.95, abs=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("turned", [False, True], ids=["south-up", "rotated"])
def test_dem_that_is_not_north_up_is_refused(tmp_path: Path, turned: bool) -> None:
    with rasterio.open(SAMPLE / "dem.asc") as source:
        values, t = source.read(1), source.transform
    bottom = t.f + t.e * values.shape[0]
    other = (
        rasterio.Affine(t.a, 0.5, t.c, 0.5, t.e, t.f)
        if turned
        else rasterio.Affine(t.a, 0, t.c, 0, -t.e, bottom)
    )
    text = '[gnss]\nheight_kind = "orthometric"\n[ground]\ndem = "dem.tif"\n'
    folder = make(tmp_path / "site", text)
    with rasterio.open(
        folder / "dem.tif", "w", driver="GTiff", width=values.shape[1], height=values.shape[0],
        count=1, dtype="float32", crs="EPSG:32617", transform=other,
    ) as target:  # fmt: skip
        target.write(values.astype(np.float32), 1)
    done = run(folder)
    assert done.exit_code == 2
    assert "north-up" in done.stderr
