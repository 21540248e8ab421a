"""Lines and areas are taken from the layer that is named, as QGIS names it or beside the file."""

from __future__ import annotations

from pathlib import Path

import geopandas
import pytest
import shapely

from georef_gis.errors import InputError
from georef_gis.geodesy import parse_crs
from processing_algorithms.drawn import drawn

UTM = "EPSG:32617"


@pytest.fixture
def roads(tmp_path: Path) -> Path:
    """Two layers of one line each, as long as its name says."""
    path = tmp_path / "roads.gpkg"
    for layer, length in (("ten", 10.0), ("twenty", 20.0)):
        line = shapely.LineString([(5e5, 4.4e6), (5e5 + length, 4.4e6)])
        geopandas.GeoDataFrame(geometry=[line], crs=UTM).to_file(path, layer=layer, driver="GPKG")
    return path


@pytest.mark.parametrize("spelt", ["in the text", "beside"])
@pytest.mark.parametrize(("layer", "length"), [("ten", 10.0), ("twenty", 20.0)])
def test_named_layer_is_read(roads: Path, layer: str, length: float, spelt: str) -> None:
    inside = spelt == "in the text"
    text = f"{roads}|layername={layer}" if inside else str(roads)
    (line,) = drawn("line", text, (), parse_crs(UTM), layer=None if inside else layer)
    assert line.shape.length == pytest.approx(length, abs=1e-6)  # m; GeoPackage keeps doubles


def test_layer_that_is_not_there_is_refused_with_those_that_are(roads: Path) -> None:
    with pytest.raises(
        InputError, match=r"roads\.gpkg: layer: has no layer 'one'; use ten, twenty"
    ):
        drawn("line", f"{roads}|layername=one", (), parse_crs(UTM))


def test_without_a_name_two_layers_are_refused(roads: Path) -> None:
    with pytest.raises(InputError, match=r"lines in 2 layers \(ten, twenty\)"):
        drawn("line", str(roads), (), parse_crs(UTM))
