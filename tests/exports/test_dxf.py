"""The drawing as ezdxf and QGIS's GDAL read it: places, layers, labels, heights, units."""

from __future__ import annotations

from pathlib import Path

import format_cases as cases
import numpy as np
import pytest
import shapely

from exports.tables.dxf_drawing import layer_name, text_value

ezdxf = pytest.importorskip("ezdxf", reason="ezdxf reads the drawings back; it is not installed")

# US survey foot, metre, international foot
CODES = {"EPSG:6549": 21, "EPSG:32617": 6, "EPSG:2223": 2}


def drawing(site, folder: Path, **values):
    report = cases.write("dxf", site, cases.layers_of(site), folder, **values)
    return ezdxf.readfile(folder / "drawing.dxf"), report


def handles(folder: Path, layer: str) -> list[str]:
    return [row["dxf_handle"] for row in cases.read_csv(folder / f"{layer}.csv")]


def vertices(entity) -> np.ndarray:
    if entity.dxftype() == "POINT":
        return np.array([entity.dxf.location])
    if entity.dxftype() == "LWPOLYLINE":
        return np.array([(x, y, 0.0) for x, y in entity.get_points("xy")])
    return np.array([v.dxf.location for v in entity.vertices])


def test_drawing_has_nothing_to_audit(tmp_path) -> None:
    doc, _ = drawing(cases.format_site(tmp_path), tmp_path / "out")
    auditor = doc.audit()
    assert [error.message for error in auditor.errors] == []
    assert [error.message for error in auditor.fixes] == []
    assert doc.dxfversion == "AC1021"


def test_every_feature_stands_where_it_is_by_its_handle(tmp_path) -> None:
    site = cases.format_site(tmp_path)
    doc, report = drawing(site, tmp_path / "out")
    foot = 1200 / 3937
    for layer in cases.layers_of(site, cameras=False):
        own = handles(tmp_path / "out", layer.name)
        assert len(set(own)) == len(layer)
        for handle, feature in zip(own, layer.features, strict=True):
            found = vertices(doc.entitydb[handle])
            points = feature.xy_map[:-1] if layer.geometry == "Polygon" else feature.xy_map
            assert np.abs(found[:, :2] - points).max() < 1e-4
            measured = layer.name != "footprints" and np.isfinite(feature.geo[:, 2]).all()
            z = feature.height_orthometric[: len(points)] / foot if measured else 0.0
            assert np.abs(found[:, 2] - z).max() < 1e-4
    assert report.height_kind == "orthometric (EGM96)"
    assert "1 features of asset_points have no height and lie at z = 0" in report.warnings


def test_layers_are_the_classes_and_labels_the_names(tmp_path) -> None:
    site = cases.format_site(tmp_path)
    doc, _ = drawing(site, tmp_path / "out")
    names = {layer.dxf.name for layer in doc.layers}
    assert {"cone", "cone_text", "cone_..___", "lane_edge", "work_area", "cone_ellipse",
            "photos", "footprints", "track"} <= names  # fmt: skip
    texts = [text.dxf.text for text in doc.modelspace().query("TEXT")]
    for name in cases.HOSTILE:
        assert text_value(name).replace("^ ", "^").strip() in [
            t.replace("^ ", "^").strip() for t in texts
        ]
    point = doc.entitydb[handles(tmp_path / "out", "asset_points")[1]]
    assert point.dxf.layer == "cone_..___"
    rows = cases.read_csv(tmp_path / "out" / "asset_points.csv")
    assert rows[1]["class"] == "cone/..:*?"


def test_codes_of_autocad_are_text_in_a_label() -> None:
    from ezdxf.tools.text import plain_text

    assert plain_text(text_value("50 %%d of 9 %")) == "50 %%d of 9 %"


@pytest.mark.parametrize("crs", list(CODES))
def test_drawing_says_its_unit(crs: str, tmp_path) -> None:
    site = cases.format_site(tmp_path, crs=crs, names=("a", "b"))
    doc, _ = drawing(site, tmp_path / "out")
    assert doc.header["$INSUNITS"] == CODES[crs]
    assert (tmp_path / "out" / "drawing.prj").read_text().startswith("PROJCS[")


@pytest.mark.parametrize("heights", ["ellipsoidal", "flat"])
def test_other_heights(heights: str, tmp_path) -> None:
    site = cases.format_site(tmp_path)
    doc, report = drawing(site, tmp_path / "out", heights=heights, labels=False)
    (line,) = [doc.entitydb[h] for h in handles(tmp_path / "out", "asset_lines")]
    geo = site.layers["asset_lines"].features[0].geo
    expected = 0.0 if heights == "flat" else geo[:, 2] / (1200 / 3937)
    assert vertices(line)[:, 2] == pytest.approx(expected, abs=1e-4)
    assert report.height_kind == ("none (2D)" if heights == "flat" else "ellipsoidal")
    assert not doc.modelspace().query("TEXT")


@pytest.mark.skipif(not cases.has_system_gdal(), reason="python3-gdal is not installed")
def test_gdal_reads_the_drawing(tmp_path) -> None:
    site = cases.format_site(tmp_path)
    drawing(site, tmp_path / "out")
    rows = cases.rows_of(cases.system_gdal(tmp_path / "out" / "drawing.dxf")["entities"])
    (edge,) = [shape for values, shape in rows if values["Layer"] == "lane_edge"]
    expected = site.layers["asset_lines"].features[0]
    assert shapely.get_coordinates(edge) == pytest.approx(expected.xy_map, abs=1e-4)
    features = {layer.name: len(layer) for layer in cases.layers_of(site, cameras=False)}
    labels = sum(features.values()) - features["asset_ellipses"]
    assert len(rows) == sum(features.values()) + labels


def test_drawing_alone_says_that_attributes_are_not_in_it(tmp_path) -> None:
    site = cases.format_site(tmp_path)
    report = cases.write("dxf", site, [site.layers["photos"]], tmp_path / "p.dxf")
    assert len(ezdxf.readfile(tmp_path / "p.dxf").modelspace().query("POINT")) == 3
    assert any("attributes are not in a drawing" in w for w in report.warnings)


@pytest.mark.parametrize("text", [*cases.HOSTILE, "", '<>/\\":;?*|=,`', "x" * 400])
def test_any_text_gives_a_name_of_a_layer(text: str) -> None:
    name = layer_name(text)
    assert 1 <= len(name) <= 255
    assert ezdxf.lldxf.validator.is_valid_layer_name(name)
