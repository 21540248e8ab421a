"""Tools `accuracy` and `accuracy_table`: a project's products and any table of residuals."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from tool_cases import Site

from georef_gis.errors import InputError
from georef_gis.project import Project
from georef_gis.rasters.reading import read_grid
from georef_gis.toolbox import Result
from georef_gis.toolbox.context import CollectingFeedback, Context
from georef_gis.units import US_SURVEY_FOOT
from processing_algorithms.measure.accuracy import Accuracy
from processing_algorithms.measure.accuracy_table import AccuracyTable, read_residuals

TABLE = "name,dx,dy,dz\nA,0.01,-0.02,0.03\nB,-0.01,0.02,\nC,,,0.02\n"


def table(folder: Path, text: str = TABLE) -> Path:
    path = folder / "residuals.csv"
    path.write_text(text)
    return path


def judge(path: Path, target: Path | None = None, **values: Any) -> tuple[Result, list[str]]:
    feedback = CollectingFeedback()
    parameters = AccuracyTable.Parameters(table=path, target=target, **values)
    result = AccuracyTable().run(Context(), parameters, feedback)
    return result, feedback.infos


# -- tables --------------------------------------------------------------------------------------


def test_a_table_gets_its_statement_without_a_project(tmp_path: Path) -> None:
    result, told = judge(table(tmp_path), tmp_path / "out", target_rmse_h="5cm")
    text = (tmp_path / "out/accuracy.txt").read_text()
    assert told == text.splitlines()
    assert "using ONLY 2 checkpoints. This data set was produced to meet a 5 (cm) RMSE_H" in text
    found = json.loads(result.outputs["json"].read_text())["assessments"]["table"]
    assert found["axes"]["x"]["rmse"] == pytest.approx(0.01)
    assert found["axes"]["z"]["n"] == 2
    assert (tmp_path / "out/accuracy_histogram_table.png").stat().st_size > 1000


def test_nothing_is_written_where_no_folder_is_named(tmp_path: Path) -> None:
    result, told = judge(table(tmp_path))
    assert result.outputs == {}
    assert any("RMSE_H" in line for line in told)
    assert [p.name for p in tmp_path.iterdir()] == ["residuals.csv"]


def test_header_and_further_columns_of_a_table_are_read(tmp_path: Path) -> None:
    text = (
        "# datum: NAD83(2011)@2010.0\nName;dX;dY;dZ;sigma_h_m;sigma_v_m;x;y;cover\n"
        "A;0.01;0.02;0.03;0.004;0.006;100;200;vegetated\n"
    )
    path = table(tmp_path, text)
    (one,) = read_residuals(path)
    assert (one.dx, one.sigma_h, one.sigma_v, one.x, one.y) == (0.01, 0.004, 0.006, 100.0, 200.0)
    assert one.cover == "vegetated"
    assert any("NAD83(2011)@2010.0" in line for line in judge(path)[1])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name,dx,dy\nA,1,2\n", "no column dz"),
        ("name,dx,dy,dz\n", "holds no residuals"),
        ("name,dx,dy,dz\nA,1,x,0\n", "line 2: dy: 'x' is not a number"),
        ("name,dx,dy,dz\nA,1,,0\n", "line 2: dx, dy: one of the two is missing"),
        ("name,dx,dy,dz\nA,,,\n", "line 2: dx, dy, dz: are all missing"),
        ("name,dx,dy,dz\n,1,1,1\n", "line 2: name: is missing"),
        ("name,dx,dy,dz\nA,1,1,1\nA,2,2,2\n", "line 3: name: point 'A' stands twice"),
        ("name,dx,dy,dz,cover\nA,1,1,1,trees\n", "cover: 'trees' is not open or vegetated"),
        ("name,dx,dy,dz,sigma_h_m\nA,1,1,1,-1\n", "is negative"),
    ],
)
def test_a_table_that_cannot_be_used_is_refused_in_one_line(
    tmp_path: Path, text: str, message: str
) -> None:
    with pytest.raises(InputError) as error:
        read_residuals(table(tmp_path, text))
    assert message in str(error.value)
    assert "residuals.csv" in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("target", ["0cm", "-1cm"])
def test_a_class_that_is_no_length_is_refused(tmp_path: Path, target: str) -> None:
    with pytest.raises(InputError, match="target_rmse_h"):
        AccuracyTable.Parameters(table=table(tmp_path), target_rmse_h=target)


# -- a project -----------------------------------------------------------------------------------

# m
GSD = 0.06
STEPS = "read_photos,orient_direct,footprints,mosaic,control"


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Site:
    """Five photos of the sample project with a mosaic of 6 cm, from tags alone."""
    from tool_cases import SAMPLE, copy_site

    if not SAMPLE.is_dir():
        pytest.skip("sample_project is not there")
    site = copy_site(tmp_path_factory.mktemp("accuracy") / "site", 5, gsd_m=GSD, orthos=False)
    done = site.run("--only", STEPS)
    assert done.code == 0, done.text
    return site


@pytest.fixture
def copied(finished: Site, tmp_path: Path) -> Site:
    """A copy without its mosaic, whose reading takes the time."""
    shutil.copytree(finished.folder, tmp_path / "site")
    (tmp_path / "site/products/mosaic.tif").unlink()
    return Site(tmp_path / "site")


@pytest.fixture(scope="module")
def judged(finished: Site) -> tuple[dict[str, Any], Result]:
    """JSON and result of the finished project, judged by classes of 5 cm."""
    told, result, _ = run(finished, target_rmse_h="5cm", target_rmse_v="5cm")
    return told, result


def run(site: Site, **values: Any) -> tuple[dict[str, Any], Result, CollectingFeedback]:
    feedback = CollectingFeedback()
    context = Context(project=Project.open(site.folder))
    result = Accuracy().run(context, Accuracy.Parameters(**values), feedback)
    return json.loads((site.products / "accuracy.json").read_text()), result, feedback


@pytest.mark.slow
def test_points_are_read_where_the_mosaic_shows_their_targets(
    finished: Site, judged: tuple[dict[str, Any], Result]
) -> None:
    told, _ = judged
    rows = [r for r in told["assessments"]["products"]["residuals"] if r["dx"] is not None]
    assert len(rows) >= 5
    ratios = []
    for row in rows:
        place = np.array([row["x"] + row["dx"], row["y"] + row["dy"]]) / US_SURVEY_FOOT
        # the corner of the painted target, found by another method in the mosaic itself
        off = _corner_beside(finished.products / "mosaic.tif", place)
        assert np.linalg.norm(off) < 1.0
        ratios.extend(off * GSD / row["read_h"])
    # Marks of 0.3 px are most of it; a dozen figures scatter more than 0.7 to 1.4.
    assert 0.5 < np.sqrt(np.mean(np.square(ratios))) < 1.6


def _corner_beside(path: Path, place: np.ndarray) -> np.ndarray:
    """From a place, CRS units, to the corner of a chequered target next to it, px."""
    header = read_grid(path, window=(0, 0, 1, 1)).header
    a, _, left, _, e, top = header.transform
    at = np.array([(place[0] - left) / a, (place[1] - top) / e]) - 0.5
    first = np.floor(at).astype(int) - 20
    grey = read_grid(path, window=(int(first[0]), int(first[1]), 41, 41), band=2).values
    start = (at - first).astype(np.float32).reshape(1, 1, 2)
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 50, 1e-3)
    found = cv2.cornerSubPix(grey.astype(np.float32), start.copy(), (4, 4), (-1, -1), criteria)
    return np.asarray(found - start).reshape(2)


@pytest.mark.slow
def test_control_points_are_never_counted_as_checks(
    finished: Site, judged: tuple[dict[str, Any], Result]
) -> None:
    told, result = judged
    names = {r["name"] for a in told["assessments"].values() for r in a["residuals"]}
    control = set(told["survey"]["control_points"])
    assert control
    assert names
    assert not names & control
    assert names == {
        name for (name,) in finished.row("SELECT name FROM control WHERE role='check'")
    }
    assert result.summary["check_points_v"] == len(names)


@pytest.mark.slow
def test_a_check_point_that_the_adjustment_used_is_not_counted(copied: Site) -> None:
    (name,) = copied.row("SELECT name FROM control WHERE role='check' LIMIT 1")[0]
    with Project.open(copied.folder).database as database:
        database.set_meta(adjustment={"control_points": [name]})
    told, _, _ = run(copied)
    assert name not in {r["name"] for r in told["assessments"]["products"]["residuals"]}
    assert name in told["survey"]["control_points"]
    assert any(name in note for note in told["notes"])


@pytest.mark.slow
def test_poses_of_tags_err_as_the_statement_says_and_intersections_stand_apart(
    finished: Site, judged: tuple[dict[str, Any], Result]
) -> None:
    told, result = judged
    h = told["assessments"]["products"]["components"][0]
    # m: tags of 2.1 m per axis cannot meet 5 cm
    assert h["meets"] is False
    assert "does NOT meet" in h["statement"]
    assert 0.3 < h["rmse"] < 20.0
    assert "intersections" in told["assessments"]
    assert "does NOT meet" in result.summary["statement"]
    pictures = {p.name for p in finished.products.glob("accuracy_*.png")}
    assert {"accuracy_histogram_products.png", "accuracy_vectors_intersections.png"} <= pictures


@pytest.mark.slow
def test_without_check_points_the_tool_says_so(copied: Site) -> None:
    with Project.open(copied.folder).database as database, database.transaction():
        rows = [{**row, "role": "control"} for row in database.rows("control")]
        database.replace_rows("control", [{k: row[k] for k in row if k != "fid"} for row in rows])
    told, result, _ = run(copied)
    assert told["assessments"]["products"]["residuals"] == []
    assert "doubts" not in result.summary
    text = (copied.products / "accuracy.txt").read_text()
    assert "No horizontal accuracy statement: there are no check points" in text
    assert list(copied.products.glob("accuracy_*.png")) == []


@pytest.mark.slow
def test_without_a_mosaic_only_the_surface_is_tested(copied: Site) -> None:
    told, _, _ = run(copied)
    products = told["assessments"]["products"]
    assert set(products["axes"]) == {"z"}
    assert "no_checks_H" in {flag["code"] for flag in products["flags"]}


@pytest.mark.slow
def test_a_table_replaces_what_is_measured_in_a_project(copied: Site, tmp_path: Path) -> None:
    told, _, _ = run(copied, table=table(tmp_path))
    assert set(told["assessments"]) == {"table"}
    assert told["survey"]["control_points"]


def test_the_tool_runs_behind_the_mosaic_and_the_control() -> None:
    assert Accuracy.manifest()["in_run"]
    assert {"mosaic", "control"} <= set(Accuracy.needs)
    assert Accuracy.summary().startswith("Accuracy statement by check points")
