"""`georef change`: files that are read back, what it tells, and what it refuses in one line."""

import json
import sqlite3
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import geopandas
import numpy as np
import pytest
import rasterio
from change_cases import CRS, LEFT, TOP, Image, Look, Thing, compared, render

from georef_gis.errors import InputError
from georef_gis.project import Project
from processing_algorithms.change.photos import SitePhotos

sys.path.insert(0, str(Path(__file__).parents[1] / "tools"))
from tool_cases import Done, georef

CAR = Thing(15.0, 11.5, 4.2, 1.8, (0.85, 0.85, 0.9), turn=0.2)
PATCH = Thing(8.0, 10.5, 4.0, 2.5, (0.14, 0.14, 0.15))
Run = Callable[..., Done]


@pytest.fixture(scope="module")
def made(site: Image, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with two projects, `now` and `then`, that have a mosaic each."""
    folder = tmp_path_factory.mktemp("dates")
    rng = np.random.default_rng(0)
    looks = {
        "now": Look(things=[CAR]),
        "then": Look(gsd=0.06, shift=(0.4, -0.2), gain=(0.8, 0.9, 0.9), things=[PATCH]),
    }
    for name, look in looks.items():
        Project.create(folder / name, {"project": {"name": name}})
        (folder / name / "products").mkdir()
        render(folder / name / "products" / "mosaic.tif", site, look, rng)
    return folder


@pytest.fixture
def run(made: Path) -> Run:
    def _run(*words: Any) -> Done:
        return georef("change", *words, "--project", made / "now")

    return _run


@pytest.fixture(scope="module")
def done(made: Path) -> tuple[Path, dict[str, Any]]:
    """Products of a run, and its summary."""
    result = georef(
        "change", "--earlier-project", made / "then", "--earlier-date", "2023-05-01",
        "--later-date", "2024-06-02", "--geojson", "--json", "--project", made / "now",
    )  # fmt: skip
    assert result.code == 0, result.text
    events = [json.loads(line) for line in result.text.splitlines() if line.startswith("{")]
    summary = next(event["summary"] for event in events if "summary" in event)
    return made / "now" / "products", summary


def test_layer_is_read_by_a_gis_as_written(done: tuple[Path, dict[str, Any]]) -> None:
    folder, summary = done
    layer = geopandas.read_file(folder / "changes.gpkg", layer="changes")
    assert layer.crs == CRS
    assert len(layer) == summary["changes"] == 2
    assert set(layer["kind"]) == {"brighter"}
    assert layer["confidence"].between(0.5, 0.99).all()
    # m2; the layer says what its polygons have
    np.testing.assert_allclose(layer["area_m2"], layer.area, atol=0.01)
    assert set(layer["earlier_date"]) == {"2023-05-01"}
    assert set(layer["later_date"]) == {"2024-06-02"}
    assert layer.is_valid.all()
    middles = np.column_stack([layer.centroid.x, layer.centroid.y])
    for thing in (CAR, PATCH):
        place = LEFT + thing.x - 2.0, TOP - (thing.y - 2.0)
        # m; the earlier thing lies where the later map has its ground
        assert np.hypot(*(middles - place).T).min() < 0.15


def test_geojson_is_the_same_in_degrees(done: tuple[Path, dict[str, Any]]) -> None:
    folder, _ = done
    layer = geopandas.read_file(folder / "changes.gpkg", layer="changes")
    degrees = geopandas.read_file(folder / "changes.geojson").to_crs(CRS)
    # m; eight digits of a degree are a millimetre
    apart = layer.geometry.hausdorff_distance(degrees.geometry)
    assert apart.max() < 0.005
    assert list(degrees["kind"]) == list(layer["kind"])


def test_raster_says_the_confidence_where_the_areas_are(
    done: tuple[Path, dict[str, Any]],
) -> None:
    folder, _ = done
    layer = geopandas.read_file(folder / "changes.gpkg", layer="changes")
    with rasterio.open(folder / "changes_probability.tif") as file:
        values, places = file.read(1), layer.representative_point()
        found = [value[0] for value in file.sample(zip(places.x, places.y, strict=True))]
        assert (file.crs, file.nodata) == (CRS, 255.0)
    np.testing.assert_allclose(np.array(found) / 100.0, layer["confidence"], atol=0.006)
    # most of the ground did not change
    assert (values == 0).mean() > 0.8


def test_style_is_in_the_layer_and_beside_it(done: tuple[Path, dict[str, Any]]) -> None:
    folder, _ = done
    with sqlite3.connect(folder / "changes.gpkg") as connection:
        inside = connection.execute("SELECT styleQML FROM layer_styles").fetchone()[0]
    for text in (inside, (folder / "changes.qml").read_text()):
        root = ET.fromstring(text)
        values = {one.get("value") for one in root.iter("category")}
        assert values == {"brighter", "darker", "other", "shadow?", "leans?"}


def test_summary_tells_the_shift_and_that_mosaics_stay(
    done: tuple[Path, dict[str, Any]],
) -> None:
    _, summary = done
    # m; east and north
    assert abs(summary["shift_east_m"] - 0.4) < 0.01
    assert abs(summary["shift_north_m"] - 0.2) < 0.01
    assert summary["shift_model"] == "shift"
    assert any("not of the mosaics" in line for line in summary["doubts"])


def test_shift_beyond_both_accuracies_is_told(made: Path) -> None:
    from processing_algorithms.change.sides import Side
    from processing_algorithms.change.told import doubts_of

    paths = [made / name / "products" / "mosaic.tif" for name in ("now", "then")]
    found = compared(*paths, 0.12)

    def told(sigma: float) -> bool:
        sides = [Side(raster=path, date="2024-01-01", sigma=sigma) for path in paths]
        return any("accuracies" in line for line in doubts_of(found, [], *sides))

    # the shift is 0.45 m
    assert told(0.05)
    assert not told(0.2)


class _Blind:
    """Photos of a project that show nothing, and one of which is gone."""

    def __init__(self, asked: list[str], name: str) -> None:
        self.asked, self.name = asked, name
        self.lost = {"IMG_1.jpg": "no such file"}

    def meet(self, _: str) -> str:
        return ""

    def looks(self, *_: object) -> list[object]:
        self.asked.append(self.name)
        return []


def test_photos_of_both_projects_are_asked(
    run: Run, made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []
    monkeypatch.setattr(SitePhotos, "of", lambda project: _Blind(asked, project.folder.name))
    target = tmp_path / "asked.gpkg"
    result = run("--earlier-project", made / "then", "--target", target)
    assert set(asked) == {"now", "then"}
    layer = geopandas.read_file(target, layer="changes")
    assert list(layer["evidence"]) == ["few photos"] * 2
    assert list(layer["photos"]) == [0, 0]
    # sure areas, of 0.99, that no photo shows
    np.testing.assert_allclose(layer["confidence"], 0.594, atol=0.03)
    assert "too few to tell" in result.line("2 areas")
    assert "IMG_1.jpg" in result.line("cannot be read")


def test_photos_of_maps_given_as_files_are_not_asked(
    run: Run, made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []
    monkeypatch.setattr(SitePhotos, "of", lambda project: _Blind(asked, project.folder.name))
    paths = [made / name / "products" / "mosaic.tif" for name in ("then", "now")]
    copy = tmp_path / "later.tif"
    copy.write_bytes(paths[1].read_bytes())
    result = run(paths[0], "--later", copy, "--target", tmp_path / "files.gpkg")
    assert asked == []
    assert "lean another way" in result.line("no photos were asked")


def test_photos_of_a_date_that_cannot_be_had_are_told_with_the_reason(
    run: Run, made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def of(project: Project) -> _Blind:
        if project.folder.name == "then":
            raise InputError("no such file", source="dem.tif")
        return _Blind([], "now")

    monkeypatch.setattr(SitePhotos, "of", of)
    result = run("--earlier-project", made / "then", "--target", tmp_path / "told.gpkg")
    assert result.code == 0
    assert "dem.tif: no such file" in result.line("photos of the earlier date")


def test_files_of_the_comparison_are_gone_in_the_end(
    done: tuple[Path, dict[str, Any]], made: Path
) -> None:
    assert done[1]["changes"]
    assert not list((made / "now" / "cache").glob("change_*"))


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ((), "--earlier-project"),
        (("--earlier-project", "nowhere"), "nowhere"),
        (("no_such.tif",), "no_such.tif"),
    ],
)
def test_missing_earlier_date_is_one_line(run: Run, words: tuple[str, ...], said: str) -> None:
    result = run(*words)
    assert result.code != 0
    assert said in result.line("georef:")


def test_map_with_itself_is_refused(run: Run, made: Path) -> None:
    result = run(made / "now" / "products" / "mosaic.tif")
    assert result.code != 0
    assert "itself" in result.line("georef:")


def test_failure_leaves_what_was_there(run: Run, made: Path, tmp_path: Path) -> None:
    target = tmp_path / "old.gpkg"
    target.write_text("of before")
    broken = tmp_path / "broken.tif"
    broken.write_bytes((made / "then" / "products" / "mosaic.tif").read_bytes()[:3000])
    result = run(broken, "--target", target)
    assert result.code != 0
    assert "broken.tif" in result.line("georef:")
    assert target.read_text() == "of before"
    assert [path.name for path in tmp_path.iterdir() if path.name.endswith(".part")] == []


def test_folder_that_cannot_be_written_is_one_line(run: Run, made: Path) -> None:
    result = run("--earlier-project", made / "then", "--target", made / "none" / "x.gpkg")
    assert result.code != 0
    assert "create it first" in result.line("georef:")
