"""Parameter types: units, limits, and what is said of an unfit value."""

import math
from typing import Any, Literal

import pytest

from georef_gis.errors import InputError
from georef_gis.toolbox import Algorithm, Context, Feedback, Result, manifest
from georef_gis.toolbox import parameters as p
from georef_gis.toolbox.registry import load_registry
from georef_gis.toolbox.values import Extent, MapPoint, PhotoPixel


class AllParameters(p.Parameters):
    gsd: p.Length = p.length(0.02, title="GSD", ge=0.001, le=100)
    height: p.Length | None = p.length(None, title="Height", unit="ft", gt=0)
    tilt: p.Angle = p.angle(30.0, title="Tilt", unit="deg", ge=0, le=80, advanced=True)
    shares: tuple[p.Number, ...] = p.number((0.5,), title="Shares", ge=0, le=1)
    count: p.Integer = p.integer(3, title="Count", ge=0)
    photos: p.PhotoSet = p.photo_set()
    extent: p.Extent | None = p.extent()
    point: p.MapPoint | None = p.map_point(None, title="Point")
    pixel: p.PhotoPixel | None = p.photo_pixel(None, title="Pixel")
    crs: p.Crs = p.crs("auto", title="CRS")
    mode: Literal["near", "smooth"] = p.choice("near", title="Mode")
    flag: p.Flag = p.flag(True, title="Flag")
    dem: p.RasterLayer | None = p.raster_layer(None, title="DEM")
    points: p.VectorLayer | None = p.vector_layer(None, title="Points")
    name_field: p.TableField = p.table_field("name", title="Name", of="points")
    note: p.File | None = p.file(None, title="Note", suffixes=(".txt",))
    into: p.Folder | None = p.folder(None, title="Into", writes=True)
    title: p.Text = p.text("", title="Title")


class Every(Algorithm[AllParameters]):
    """Take every type."""

    id, name, group = "every", "Every", "measure"

    def run(self, context: Context, parameters: AllParameters, feedback: Feedback) -> Result:
        return Result()


@pytest.mark.parametrize(
    ("field", "given", "si"),
    [
        ("gsd", 0.05, 0.05),
        ("gsd", "2.5cm", 0.025),
        ("gsd", "3 ft", 0.9144),
        ("gsd", "1.2usft", 1.2 * 1200 / 3937),
        ("height", 100, 30.48),
        ("height", "30.48 m", 30.48),
        ("tilt", "5", math.radians(5)),
        ("tilt", "0.1rad", 0.1),
        ("tilt", "5°", math.radians(5)),
        ("shares", ["0.1", 0.2], (0.1, 0.2)),
        ("photos", "A*.JPG", ("A*.JPG",)),
        (
            "extent",
            "1,2,3,4@EPSG:32617",
            Extent(west=1, south=2, east=3, north=4, crs="EPSG:32617"),
        ),
        ("point", "-82.5,39.25,250", MapPoint(x=-82.5, y=39.25, height=250.0)),
        ("pixel", "A.JPG:12.5,-0.5", PhotoPixel(photo="A.JPG", u=12.5, v=-0.5)),
    ],
)
def test_value_arrives_in_si(field: str, given: Any, si: Any) -> None:
    value = getattr(AllParameters(**{field: given}), field)
    assert value == (pytest.approx(si, rel=1e-14) if isinstance(si, float) else si)


def test_declared_values_give_the_same_parameters_again() -> None:
    first = AllParameters(gsd="1in", height="9m", tilt="0.3rad", extent="1,2,3,4", pixel="A:1,2")
    again = AllParameters(**first.declared())
    assert again.declared() == first.declared()
    assert again.tilt == pytest.approx(0.3, abs=1e-13)  # rad: 14 digits are kept


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"gsd": 500}, "gsd: 500 m is not allowed; give 0.001 to 100 m"),
        ({"height": 0}, "height: 0 ft is not allowed; give above 0 ft"),
        ({"tilt": "3 ft"}, "tilt: no angle unit 'ft'; use one of rad,"),
        ({"tilt": "steep"}, "tilt: 'steep' is no number with an optional unit"),
        ({"shares": [0.5, 1.5]}, "shares: 1.5 is not allowed; give 0 to 1"),
        ({"count": "x"}, "count: 'x': input should be a valid integer"),
        ({"mode": "far"}, "mode: 'far' is no choice; use one of near, smooth"),
        ({"gds": 1}, "gds: no such parameter; use gsd"),
        ({"extent": "3,2,1,4"}, "extent: an extent is west,south,east,north"),
        ({"gsd": float("nan")}, "gsd: nan m is not allowed"),
        ({"pixel": "A.JPG:1"}, "pixel: 'A.JPG:1' is not of the form [photo:]u,v"),
    ],
    ids=lambda given: str(next(iter(given))) if isinstance(given, dict) else "",
)
def test_unfit_value_gives_one_line(given: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError) as caught:
        AllParameters(**given)
    assert str(caught.value).startswith(f"tool every: {words}")
    assert "\n" not in str(caught.value)


def test_manifest_knows_every_type() -> None:
    (tool,) = manifest([("toy", Every)])["tools"]
    types = {entry["name"]: entry["type"] for entry in tool["parameters"]}
    assert types["mode"] == "Choice"
    assert set(types.values()) == set(p.KINDS)
    assert tool["schema"]["properties"]["gsd"]["minimum"] == 0.001
    assert tool["parameters"][2]["default"] == 30.0
    assert tool["parameters"][2]["advanced"] is True


def test_helper_of_another_type_is_refused() -> None:
    class Wrong(p.Parameters):
        gsd: p.Length = p.angle(1.0, title="GSD", unit="deg")

    with pytest.raises(TypeError, match="its helper is not the one of its type Length"):
        Wrong.specs()


def test_suggestions_are_offered_and_other_texts_are_allowed() -> None:
    class Layered(p.Parameters):
        layer: p.Text = p.text("photos", title="Layer", suggestions=("photos", "assets"))

    (spec,) = Layered.specs()
    assert spec.manifest()["suggestions"] == ["photos", "assets"]
    assert spec.schema()["examples"] == ["photos", "assets"]
    assert "enum" not in spec.schema()
    assert Layered(layer="mine.gpkg").layer == "mine.gpkg"


def test_exporters_suggest_the_layers_that_they_accept() -> None:
    tool = load_registry().find("export_geojson").algorithm
    (layer,) = [spec for spec in tool.Parameters.specs() if spec.name == "layer"]
    assert {"photos", "footprints", "assets"} <= set(layer.suggestions)
    assert layer.suggestions[0] == layer.default
    raster = load_registry().find("export_cog").algorithm
    (layer,) = [spec for spec in raster.Parameters.specs() if spec.name == "layer"]
    assert layer.suggestions == ("mosaic", "orthos")
