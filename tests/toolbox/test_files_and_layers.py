"""Files and layers among the parameters: names of targets, layers of a file, paths of a project."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from georef_gis.app.report import report_event
from georef_gis.errors import ExportError, InputError
from georef_gis.project import Project
from georef_gis.toolbox import Algorithm, CollectingFeedback, Context, Feedback, Output, Result
from georef_gis.toolbox import parameters as p
from georef_gis.toolbox.registry import Registry, Tool, load_registry
from georef_gis.toolbox.runner import run_pipeline, run_tool
from georef_gis.toolbox.specs import Spec
from georef_gis.toolbox.values import LayerFile
from processing_algorithms.drawn import layer_file

# files to write whose names may end in anything: folders of files, a log, the name of a device
ANY_NAME = {"export_shapefile", "export_dxf", "export_geoparquet", "export_flatgeobuf",
            "export_csv", "export_xyz_tiles", "export_colmap", "export_tagged_photos",
            "export_stac", "sync_board_record", "sync_board_simulate"}  # fmt: skip


class LookParameters(p.Parameters):
    line: p.VectorLayer | None = p.vector_layer(None, title="Line")
    ground: p.RasterLayer | None = p.raster_layer(None, title="Ground")
    target: p.File | None = p.file(None, title="Table", suffixes=(".csv", ".json"), writes=True)


class Look(Algorithm[LookParameters]):
    """Write a file, and tell what was given."""

    id, name, group = "look", "Look", "measure"
    outputs = (Output(name="table", title="Table"), Output(name="beside", title="Beside"))
    in_run = True

    def run(self, context: Context, parameters: LookParameters, feedback: Feedback) -> Result:
        project = context.require_project()
        project.products.mkdir(exist_ok=True)
        table, beside = project.products / "a.csv", project.folder.parent / "beside.txt"
        for path in (table, beside):
            path.write_text("x")
        told = {"line": parameters.line, "ground": parameters.ground}
        return Result(outputs={"table": table, "beside": beside}, summary=told)


@pytest.fixture
def look() -> Registry:
    registry = Registry()
    registry.add("toy", (Look,), "toy", "1")
    assert not registry.refused
    return registry


@pytest.fixture
def project(tmp_path: Path) -> Iterator[Project]:
    (tmp_path / "site").mkdir()
    (tmp_path / "site" / "project.toml").write_text("")
    found = Project.open(tmp_path / "site")
    yield found
    found.close()


def targets() -> list[tuple[Tool, Spec]]:
    return [(tool, spec) for tool in load_registry() if tool.provider == "georef"
            for spec in tool.algorithm.Parameters.specs()
            if spec.writes and spec.kind == "File"]  # fmt: skip


# -- files to write ----------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["IMG_0001.JPG", "table", "table.csv.gz", ".csv"])
def test_target_of_a_foreign_suffix_is_refused_with_those_that_fit(name: str) -> None:
    with pytest.raises(InputError) as caught:
        LookParameters(target=name)
    assert str(caught.value) == (
        f"tool look: target: {name} has the name of another kind of file; end it in .csv or .json"
    )


@pytest.mark.parametrize("name", ["table.csv", "T.JSON", Path("a.b/c.csv")])
def test_target_of_a_fitting_suffix_is_taken(name: str | Path) -> None:
    assert LookParameters(target=name).target == Path(name)


def test_folder_in_the_place_of_a_target_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ExportError, match=r"is a folder; give the name of a \.csv or \.json in it"):
        LookParameters(target=tmp_path)


def test_target_is_refused_before_any_work(look: Registry, project: Project) -> None:
    with pytest.raises(InputError, match="another kind of file"):
        run_tool(look, "look", {"target": "photo.tif"}, CollectingFeedback(), project=project)
    assert not (project.folder / "products").exists()


def test_every_file_to_write_names_its_suffixes_and_refuses_others() -> None:
    free = {tool.id for tool, spec in targets() if not any(spec.suffixes)}
    assert free == ANY_NAME
    for tool, spec in targets():
        if tool.id in free:
            continue
        for suffix in spec.suffixes:
            spec.check_target(f"some/name{suffix.upper()}")
        with pytest.raises(ValueError, match="another kind of file"):
            spec.check_target("some/name.strange")
        if spec.default is not None:
            spec.check_target(spec.default)


def test_file_in_whose_place_a_folder_is_read_says_so_in_the_manifest() -> None:
    told = {
        (tool.id, entry["name"])
        for tool in load_registry()
        for entry in tool.algorithm.manifest()["parameters"]
        if entry.get("or_folder")
    }
    assert told == {("compare_trajectory", "estimate"), ("compare_trajectory", "reference")}


def test_manifest_tells_what_messages_of_a_tool_are_about() -> None:
    about = {tool.id: tool.algorithm.manifest()["about"] for tool in load_registry()}
    assert {about[name] for name in ("locate", "intersect", "match_clicks")} == {"points"}
    assert {about[name] for name in ("mosaic", "adjust", "export_kmz")} == {"photos"}


# -- layers ------------------------------------------------------------------------------------


def test_maps_that_are_read_are_declared_as_layers() -> None:
    # so that a GIS offers its own layers for them
    found = {(tool.id, spec.name): spec.kind for tool in load_registry()
             for spec in tool.algorithm.Parameters.specs()}  # fmt: skip
    vectors = [("profile", "line"), ("volume", "area"), ("plan_flight", "area"),
               ("plan_flight", "line"), ("mosaic_sheets", "line")]  # fmt: skip
    rasters = [
        ("profile", "raster"),
        ("volume", "raster"),
        ("volume", "base_raster"),
        ("mosaic_sheets", "raster"),
        ("band_index", "raster"),
        ("band_index", "other"),
    ]
    assert {found[key] for key in vectors} == {"VectorLayer"}
    assert {found[key] for key in rasters} == {"RasterLayer"}


def test_layer_of_a_file_survives_as_text() -> None:
    one = LayerFile.parse("a b/roads.gpkg|layername=centre line")
    assert one == LayerFile(path=Path("a b/roads.gpkg"), layer="centre line")
    assert LayerFile.parse(str(one)) == one
    assert LayerFile.parse("roads.kml") == LayerFile(path=Path("roads.kml"))


@pytest.mark.parametrize(
    "rest", ["|subset=width > 3", "|layername=a|subset=b", "|layername=", "|x"]
)
def test_more_than_a_layer_is_refused_for_it_would_be_ignored(rest: str) -> None:
    with pytest.raises(InputError, match=r"line: .* is not of the form file\[\|layername=name\]"):
        layer_file(f"roads.gpkg{rest}", None, field="line")


def test_layer_is_named_in_the_text_or_beside_it_but_not_two() -> None:
    path = Path("roads.gpkg")
    assert layer_file("roads.gpkg|layername=a", None, field="line") == (path, "a")
    assert layer_file("roads.gpkg", "a", field="line") == (path, "a")
    assert layer_file("roads.gpkg|layername=a", "a", field="line") == (path, "a")
    with pytest.raises(InputError, match="names the layer 'a' and --layer 'b'; leave out one"):
        layer_file("roads.gpkg|layername=a", "b", field="line")


@pytest.mark.skipif(sys.platform == "win32", reason="paths are written with slashes here")
@pytest.mark.parametrize(
    ("stored", "read"),
    [("maps/r.gpkg|layername=a", "{}/maps/r.gpkg|layername=a"), ("../r.kml", "{}/../r.kml"),
     ("/abs/r.gpkg", "/abs/r.gpkg"), ("auto", "auto"), ("mosaic", "mosaic")],
)  # fmt: skip
def test_layers_of_project_toml_lie_beside_it(
    look: Registry, project: Project, stored: str, read: str
) -> None:
    (project.folder / "project.toml").write_text(
        f'[tools.look]\nline = "{stored}"\nground = "dem.tif"\n'
    )
    again = Project.open(project.folder)
    told = run_tool(look, "look", {}, CollectingFeedback(), project=again).result.summary
    again.close()
    wanted = read.format(project.folder).replace(f"{project.folder.name}/../", "")
    assert told["line"] == wanted
    assert told["ground"] == str(project.folder / "dem.tif")


def test_path_is_as_good_as_its_text() -> None:
    assert LookParameters(line=Path("a/b.gpkg")).line == str(Path("a/b.gpkg"))


# -- outputs of what is up to date --------------------------------------------------------------


def outputs_of(look: Registry, folder: Path) -> tuple[bool, dict[str, Any]]:
    project = Project.open(folder)
    (report,) = run_pipeline(look, project, CollectingFeedback())
    project.close()
    return report.skipped, report_event(report)


def test_step_that_is_up_to_date_tells_its_outputs_by_name(
    look: Registry, project: Project, tmp_path: Path
) -> None:
    _, first = outputs_of(look, project.folder)
    skipped, again = outputs_of(look, project.folder)
    assert skipped
    assert again["outputs"] == first["outputs"]
    assert set(again["outputs"]) == {"table", "beside"}
    assert again["summary"] == first["summary"]


def test_its_outputs_are_found_where_the_project_is_now(
    look: Registry, project: Project, tmp_path: Path
) -> None:
    outputs_of(look, project.folder)
    project.folder.rename(tmp_path / "moved")
    skipped, event = outputs_of(look, tmp_path / "moved")
    assert skipped
    assert event["outputs"] == {
        "table": str(tmp_path / "moved/products/a.csv"), "beside": str(tmp_path / "beside.txt"),
    }  # fmt: skip
