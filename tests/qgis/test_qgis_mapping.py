"""The manifest becomes parameters of QGIS; what the user gives becomes a command line."""

from __future__ import annotations

from pathlib import PurePath, PurePosixPath, PureWindowsPath
from typing import Any

import pytest
from qgis_cases import ROOT  # noqa: F401 (puts the plug-in's folder on the path)

from georef_qgis import help_page, products, telling, tools  # isort: skip
from georef_gis.app.cli import georef as command
from georef_gis.toolbox.algorithm import manifest
from georef_gis.toolbox.registry import load_registry
from georef_gis.toolbox.specs import KINDS


def entry(**more: Any) -> dict[str, Any]:
    return {"name": "x", "type": "Text", "title": "X", "required": False, "default": "", **more}


def tool(*fields: dict[str, Any], project: bool = False, **more: Any) -> tools.Tool:
    return tools.read_tool({
        "provider": "georef", "full_id": "georef:one", "id": "one", "name": "one",
        "group": "mosaic", "help": "One.", "needs_project": project, "in_run": False,
        "parameters": list(fields),
        "outputs": [], **more,
    })  # fmt: skip


def field(project: bool = False, **more: Any) -> tools.Field:
    return tools.read_field(entry(**more), project)


@pytest.fixture(scope="module")
def all_tools() -> list[tools.Tool]:
    registry = load_registry()
    return tools.read_tools(manifest((t.provider, t.algorithm) for t in registry))


def test_every_type_of_the_manifest_has_a_widget() -> None:
    assert set(tools.WIDGETS) == set(KINDS)


def test_all_tools_and_run_itself_are_read(all_tools: list[tools.Tool]) -> None:
    assert all_tools[0].is_run
    assert len(all_tools) == len(list(load_registry())) + 1
    names = [tool.name for tool in all_tools]
    assert len({name.lower() for name in names}) == len(names)


def test_no_tool_has_two_parameters_of_a_name_for_qgis(all_tools: list[tools.Tool]) -> None:
    # QGIS does not tell A from a
    own = ["project", "show_layers", "force", "workers", "project_folder"]
    for one in all_tools:
        heights = [f"{f.name}_height" for f in one.fields if f.widget == "point"]
        names = [f.name.lower() for f in one.fields] + heights + own
        assert len(set(names)) == len(names), one.name


def test_options_of_run_are_those_of_the_command() -> None:
    known = {name for p in command.commands["run"].params for name in p.opts}
    for one in tools.read_tool(tools.RUN).fields:
        assert f"--{one.name}" in known
    assert {"--force", "--workers", "--json"} <= known


def test_file_to_write_names_its_end_wherever_the_manifest_does(
    all_tools: list[tools.Tool],
) -> None:
    ends = {(one.name, f.name): f.suffixes for one in all_tools for f in one.fields if f.writes}
    assert ends["locate", "target"] == (".csv", ".json")
    assert ends["check", "target"] == (".kml",)
    assert ends["export_geopackage", "target"] == (".gpkg",)


def test_manifest_of_another_version_is_refused_with_a_cure() -> None:
    with pytest.raises(tools.ManifestError, match=r"manifest 2.*georef qgis install"):
        tools.read_tools({"manifest": 2, "tools": []})


def test_third_partys_tool_keeps_the_name_of_its_provider() -> None:
    made = tool(provider="toy", full_id="toy:one")
    assert made.name == "toy-one"
    assert made.words == ("toy:one",)


def test_unknown_type_becomes_a_text() -> None:
    assert field(type="Colour").widget == "string"
    assert field(type="Colour", multiple=True).widget == "lines"


def test_target_without_project_must_be_named_for_it_would_be_where_qgis_was_started() -> None:
    target = {"type": "File", "writes": True, "default": "fly_again.kml"}
    assert field(**target).required
    assert field(**target).widget == "file_out"
    assert field(**target).suffixes == (".kml",)
    assert not field(project=True, **target).required


def test_folder_of_a_new_project_is_none_that_qgis_throws_away() -> None:
    made = field(type="Folder", writes=True, default=".")
    assert (made.widget, made.required) == ("folder", True)


def test_what_is_left_alone_gives_way_to_project_toml() -> None:
    one = tool(
        entry(name="gsd", type="Length", default=0.05, unit="m"),
        entry(name="plots", type="Flag", default=False),
        entry(name="way", type="Choice", default="auto", choices=["auto", "b"]),
        project=True,
    )
    same = {"gsd": 0.05, "plots": False, "way": "auto"}
    assert tools.arguments(one, same, project="/p") == [
        "georef:one", "--project=/p", "--json",
    ]  # fmt: skip
    other = {"gsd": 0.1, "plots": True, "way": "b"}
    assert tools.arguments(one, other, project="/p") == [
        "georef:one", "--project=/p", "--gsd=0.1", "--plots", "--way=b", "--json",
    ]  # fmt: skip


def test_flag_that_is_on_by_default_can_be_put_off() -> None:
    one = tool(entry(name="tie_points", type="Flag", default=True))
    assert tools.arguments(one, {"tie_points": False}) == [
        "georef:one",
        "--no-tie-points",
        "--json",
    ]


@pytest.mark.parametrize(
    "value",
    ["-5", "--help", "'; DROP TABLE x", "=cmd|'/c calc'!A0", "a b", "é😀", "&<>\"'", "x" * 300],
)
def test_hostile_text_is_one_word_of_the_command_line(value: str) -> None:
    one = tool(entry(name="name"), entry(name="photo", type="File", positional=True))
    words = tools.arguments(one, {"name": value, "photo": value})
    assert words == ["georef:one", f"--name={value}", "--json", "--", value]


def test_run_takes_the_project_as_its_place() -> None:
    run = tools.read_tool(tools.RUN)
    words = tools.arguments(run, {"quick": True, "set": ["a.b=1", "c.d=2"]}, ["--force"], "/p q")
    assert words == [
        "run",
        "--quick",
        "--set=a.b=1",
        "--set=c.d=2",
        "--force",
        "--json",
        "--",
        "/p q",
    ]


@pytest.mark.parametrize(
    ("kind", "given", "values"),
    [
        ("PhotoPixel", "a.JPG:1,2; b.JPG:3.5,-4", ["a.JPG:1,2", "b.JPG:3.5,-4"]),
        ("PhotoPixel", "a;b.JPG:1,2\nc.JPG:3,4\n", ["a;b.JPG:1,2", "c.JPG:3,4"]),
        ("PhotoPixel", ["a.JPG:1,2", "b.JPG:3,4"], ["a.JPG:1,2", "b.JPG:3,4"]),
        ("MapPoint", "1,2@EPSG:6601;3,4,5@EPSG:6601", ["1,2@EPSG:6601", "3,4,5@EPSG:6601"]),
        # what is no pixel is left as it is, for georef to name it
        ("PhotoPixel", "nonsense; a.JPG:1,2", ["nonsense; a.JPG:1,2"]),
        ("Text", "gyro_x=GyroX:deg/s; odd\nb=c", ["gyro_x=GyroX:deg/s; odd", "b=c"]),
        ("PhotoSet", "IMG_00*\n\n IMG_0013.JPG ", ["IMG_00*", "IMG_0013.JPG"]),
        ("PhotoPixel", "", []),
    ],
)
def test_several_values_are_taken_apart(kind: str, given: Any, values: list[str]) -> None:
    assert tools.split_lines(field(type=kind, multiple=True), given) == values


def test_help_page_tells_types_units_and_limits_in_words() -> None:
    text = help_page.page(tool(
        entry(name="step", title="Step", type="Length", unit="m", above=0.0, maximum=5.0),
        entry(name="on", title="On", type="Flag", default=True),
        entry(name="line", title="Line", type="VectorLayer"),
    ))  # fmt: skip
    assert "<td>length in m<td><td>Step; above 0 m, at most 5 m" in text
    assert "<td>yes or no<td>yes<td>On" in text
    assert "<td>vector layer<td><td>Line" in text


def test_help_page_escapes_what_a_manifest_says(all_tools: list[tools.Tool]) -> None:
    text = help_page.page(tool(entry(title="<b>&", help="\"'<script>"), help="a < b\n\nc"))
    assert "<script>" not in text
    assert "a &lt; b" in text
    for one in all_tools:
        assert one.title in help_page.page(one).replace("&#x27;", "'")


def test_outputs_of_a_run_that_was_up_to_date_are_found_by_their_names() -> None:
    results = [
        {"outputs": {}, "summary": {"products": ["/p/products/mosaic.tif"]}},
        {"outputs": {}, "summary": {"products": ["/p/products/site.kmz", "/p/products/site.gpkg"]}},
        {"outputs": {"overlap": "/p/products/overlap.tif"}, "summary": {}},
    ]
    found = products.outputs_by_name(("mosaic", "site", "overlap", "report"), results)
    assert found == {
        "mosaic": "/p/products/mosaic.tif", "site": "/p/products/site.gpkg",
        "overlap": "/p/products/overlap.tif",
    }  # fmt: skip


def test_all_that_a_tool_answers_is_told() -> None:
    summary = {
        "photos": 2, "none": None, "of": "DEM",
        "sightings": [{"photo": "A", "u": 1.5, "note": ""}, {"photo": "B", "u": 0, "note": None}],
        "told": ["length 7.172 m"], "sources": {"gnss": 0.1, "rows": [1, 2]}, "empty": [],
        "many": list(range(60)),
    }  # fmt: skip
    lines = telling.figures(summary)
    assert lines[:7] == [
        "photos: 2", "of: DEM", "sightings: photo A, u 1.5", "sightings: photo B, u 0",
        "told: length 7.172 m", "sources, gnss: 0.1", "sources, rows: 1, 2",
    ]  # fmt: skip
    assert lines[-2:] == ["many: 49", "many: and 10 more"]


def test_number_of_points_is_no_measured_place() -> None:
    place = {"name": "1", "easting": 1.0, "northing": 2.0}
    results = [{"summary": {"points": 12}}, {"summary": {"points": [place, {"name": "2"}]}}, {}]
    assert products.measured_places(results) == [place]


def test_table_without_a_crs_is_no_layer(tmp_path: Any) -> None:
    table = tmp_path / "a#b?.csv"
    products.write_places(table, [{"easting": 1.0, "northing": 2.0, "semi_major_m": 0.1}])
    assert products.layers_in(table, tmp_path) == []
    table.write_text("name,lon_deg,lat_deg\nx,1,2\n", encoding="utf-8")
    (layer,) = products.layers_in(table, tmp_path)
    assert layer.crs == "EPSG:4326"
    assert "a%23b%3F.csv?" in layer.source


@pytest.mark.parametrize(
    ("path", "address"),
    [
        (PurePosixPath("/a b/é#?.gpkg"), "file:///a%20b/%C3%A9%23%3F.gpkg?mode=ro"),
        (PureWindowsPath(r"C:\a b\x.gpkg"), "file:///C:/a%20b/x.gpkg?mode=ro"),
        # two slashes more, or SQLite takes the server for a host and refuses
        (PureWindowsPath(r"\\server\share\x.gpkg"), "file:////server/share/x.gpkg?mode=ro"),
    ],
)
def test_database_is_read_from_drives_and_shares(path: PurePath, address: str) -> None:
    assert products.database_address(path) == address


def test_drawing_gets_the_crs_that_lies_beside_it(tmp_path: Any) -> None:
    (tmp_path / "drawing.dxf").write_text("x")
    assert products.layers_in(tmp_path / "drawing.dxf")[0].crs == ""
    (tmp_path / "drawing.prj").write_text('PROJCS["own"]', encoding="utf-8")
    assert products.layers_in(tmp_path)[0].crs == 'WKT:PROJCS["own"]'


@pytest.mark.parametrize("content", [b"", b"no database", b"SQLite format 3\0rubbish"])
def test_broken_geopackage_shows_no_layer(tmp_path: Any, content: bytes) -> None:
    path = tmp_path / "half.gpkg"
    path.write_bytes(content)
    assert products.layers_in(path) == []
    (tmp_path / "georef.gpkg").write_bytes(content)
    assert products.project_crs(tmp_path) == ""


def test_texts_that_are_offered_are_told() -> None:
    assert field(help="A layer.", suggestions=["photos", "poses"]).hint() == (
        "A layer; such as photos, poses"
    )
    assert field(help="One of photos, poses.", suggestions=["photos", "poses"]).hint() == (
        "One of photos, poses"
    )


def test_folder_of_layers_shows_them_all(tmp_path: Any) -> None:
    for name in ("photos.fgb", "footprints.fgb", "notes.txt", "mosaic.tif"):
        (tmp_path / name).write_bytes(b"x")
    found = products.layers_in(tmp_path)
    assert [(layer.title, layer.style) for layer in found] == [
        ("footprints", "footprints"), ("photos", "photos"),
    ]  # fmt: skip
    (tmp_path / "site.gdb").mkdir()
    assert len(products.layers_in(tmp_path / "site.gdb")) == 1


def test_maps_of_a_step_that_was_up_to_date_are_found_by_name(tmp_path: Any) -> None:
    (tmp_path / "products").mkdir()
    (tmp_path / "products/overlap.tif").write_bytes(b"x")
    done = [{"outputs": {}, "summary": {}, "skipped": True}]
    found = products.outputs_by_name(("overlap", "mosaic"), done, tmp_path)
    assert found == {"overlap": str(tmp_path / "products/overlap.tif")}
    assert products.outputs_by_name(("overlap",), [{**done[0], "skipped": False}], tmp_path) == {}
