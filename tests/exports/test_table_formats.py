"""What is written is read back by another library: geometry, CRS, heights, attributes, times."""

from __future__ import annotations

import json
import warnings
from pathlib import Path

import format_cases as cases
import numpy as np
import pytest
import shapely
from site_cases import make_site

from exports.site import schemas
from exports.site.site import SiteLayers
from exports.tables.shapefile import SHORT_NAMES, TEXT_BYTES
from georef_gis.app.grouping import grouped
from georef_gis.errors import ExportError
from georef_gis.geodesy import CRS
from georef_gis.project.spreadsheet import GUARDED, guarded, unguarded

CUSTOM = CRS.from_user_input(
    "+proj=tmerc +lat_0=40 +lon_0=-83 +k=1 +x_0=1000 +y_0=2000 +datum=NAD83 +units=us-ft"
).to_wkt()
needs_gdal = pytest.mark.skipif(
    not cases.has_system_gdal(), reason="python3-gdal is not installed (apt install python3-gdal)"
)


@pytest.fixture(params=["EPSG:6549", CUSTOM], ids=["state plane feet", "own CRS"])
def site(request: pytest.FixtureRequest, tmp_path: Path) -> SiteLayers:
    return cases.format_site(tmp_path, crs=request.param)


def equal_crs(wkt: str, site: SiteLayers) -> bool:
    with warnings.catch_warnings():
        # of a WKT of Esri's kind
        warnings.simplefilter("ignore")
        found = CRS.from_wkt(wkt)
    if found.equals(site.crs, ignore_axis_order=True):
        return True
    # Esri's WKT 1 names things its own way: the numbers decide
    a, b = (make_xy(crs) for crs in (found, site.crs))
    return bool(np.allclose(a, b, rtol=0.0, atol=1e-4))


def make_xy(crs: CRS) -> np.ndarray:
    from pyproj import Transformer

    base = crs.geodetic_crs
    return np.array(
        Transformer.from_crs(base, crs, always_xy=True).transform([-83.0, -82.9], [40.0, 40.1])
    )


# -- GDAL's formats, read by another GDAL ----------------------------------------------------------


@needs_gdal
@pytest.mark.parametrize("name", ["geopackage", "filegdb", "flatgeobuf", "shapefile"])
def test_gdal_3_6_reads_what_was_written(name: str, site: SiteLayers, tmp_path: Path) -> None:
    layers = cases.layers_of(site, cameras=name != "flatgeobuf")
    target = tmp_path / {"geopackage": "s.gpkg", "filegdb": "s.gdb"}.get(name, "out")
    report = cases.write(name, site, layers, target)
    assert report.features == sum(map(len, layers))
    names = SHORT_NAMES if name == "shapefile" else {}
    whole = cases.system_gdal(target) if target.is_file() or target.suffix else {}
    for layer in layers:
        read = whole.get(layer.name)
        if read is None:
            suffix = ".fgb" if name == "flatgeobuf" else ".shp"
            path = target / f"{layer.name}{suffix if layer.geometry != 'None' else '.dbf'}"
            (read,) = cases.system_gdal(path).values()
        cases.assert_same(cases.rows_of(read), layer, names, short_texts(name, layer))
        if layer.geometry != "None":
            assert equal_crs(read["wkt"], site), layer.name


def short_texts(name: str, layer) -> dict[str, str]:
    """Texts that a shapefile cuts."""
    if name != "shapefile":
        return {}
    texts = [v for f in layer.features for v in f.values.values() if isinstance(v, str)]
    return {t: t.encode()[:TEXT_BYTES].decode(errors="ignore") for t in texts}


# -- Shapefile -------------------------------------------------------------------------------------


def test_pyshp_reads_the_shapefile_and_nothing_that_was_cut_is_lost(site, tmp_path) -> None:
    shapefile = pytest.importorskip("shapefile", reason="pyshp is not installed")
    layers = cases.layers_of(site)
    report = cases.write("shapefile", site, layers, tmp_path / "out")
    assert (tmp_path / "out" / "photos.cpg").read_text() == "UTF-8"
    for layer in layers:
        if layer.geometry == "None":
            continue
        with shapefile.Reader(str(tmp_path / "out" / layer.name), encoding="utf-8") as reader:
            rows = [(r.record.as_dict(), shapely.geometry.shape(r.shape.__geo_interface__))
                    for r in reader.iterShapeRecords()]  # fmt: skip
        cases.assert_same(rows, layer, SHORT_NAMES, short_texts("shapefile", layer))
    cut = cases.read_csv(tmp_path / "out" / "cut_texts.csv")
    whole = {(r["layer"], int(r["row"]), r["name"]): r["text"] for r in cut}
    assert whole["asset_points", 2, "name"] == cases.HOSTILE[2]
    assert len(whole) == 1 + len(cases.HOSTILE) + 1 + 2
    (told,) = [w for w in report.warnings if "cut at 254 bytes" in w]
    assert "asset_points.name" in told


def test_short_names_are_unique_and_short_in_every_layer() -> None:
    schemes = {name: value for name, value in vars(schemas).items() if name.endswith("_FIELDS")}
    assert len(schemes) == 8
    for name, fields in schemes.items():
        short = [SHORT_NAMES.get(f.name, f.name) for f in fields]
        assert max(map(len, short)) <= 10, name
        assert len({one.upper() for one in short}) == len(short), name
    long = {f.name for fields in schemes.values() for f in fields if len(f.name) > 10}
    assert long == SHORT_NAMES.keys()


def test_fields_csv_says_which_column_is_which(tmp_path) -> None:
    site = cases.format_site(tmp_path)
    cases.write("shapefile", site, cases.layers_of(site), tmp_path / "out")
    rows = cases.read_csv(tmp_path / "out" / "fields.csv")
    told = {(r["layer"], r["column"]): r["name"] for r in rows}
    assert told["photos", "h_ell_m"] == "height_ellipsoidal_m"
    assert told["asset_points", "semi_maj_m"] == "semi_major_m"


# -- the others ------------------------------------------------------------------------------------


def test_pyarrow_and_geopandas_read_the_geoparquet(site, tmp_path) -> None:
    pytest.importorskip("pyarrow", reason="pyarrow is not installed")
    import geopandas
    from pyarrow import parquet

    layers = cases.layers_of(site)
    cases.write("geoparquet", site, layers, tmp_path / "out")
    for layer in layers:
        path = tmp_path / "out" / f"{layer.name}.parquet"
        table = parquet.read_table(path)
        rows = table.to_pylist()
        shapes = [shapely.from_wkb(r.pop("geometry")) if "geometry" in r else None for r in rows]
        cases.assert_same(zip(rows, shapes, strict=True), layer)
        assert table.schema.field(0).metadata[b"description"].decode() == layer.fields[0].doc
        if layer.geometry != "None":
            frame = geopandas.read_parquet(path)
            assert frame.crs.equals(site.crs)
            assert json.loads(table.schema.metadata[b"geo"])["version"] == "1.0.0"


def test_csv_has_both_coordinates_and_every_text_comes_back(site, tmp_path) -> None:
    layers = cases.layers_of(site)
    cases.write("csv", site, layers, tmp_path / "out")
    for layer in layers:
        rows = cases.read_csv(tmp_path / "out" / f"{layer.name}.csv")
        found = []
        kinds = {f.name: f.kind for f in layer.fields}
        for row in rows:
            values = {name: unguarded(text) if kinds[name] == "text" else _value(kinds[name], text)
                      for name, text in row.items() if name in kinds}  # fmt: skip
            shape = shapely.Point(float(row["x"]), float(row["y"])) if "x" in row else (
                shapely.from_wkt(row["wkt"]) if "wkt" in row else None)  # fmt: skip
            found.append((values, shape))
        cases.assert_same(found, layer)
    points = cases.read_csv(tmp_path / "out" / "asset_points.csv")
    lonlat = np.array([[float(r["lon_deg"]), float(r["lat_deg"])] for r in points])
    # deg: 0.1 mm
    assert np.abs(lonlat - site.layers["asset_points"].places.lonlat).max() < 1e-9
    (line,) = cases.read_csv(tmp_path / "out" / "asset_lines.csv")
    geo = site.layers["asset_lines"].features[0].geo
    read = shapely.get_coordinates(shapely.from_wkt(line["wkt_lonlat"]), include_z=True)
    assert np.abs(read - geo).max() < 1e-4
    assert np.abs(read[:, :2] - geo[:, :2]).max() < 1e-9


def _value(kind: str, text: str) -> object:
    if text == "":
        return None
    return {"real": float, "integer": int, "flag": lambda t: t == "true"}[kind](text)


@pytest.mark.parametrize("text", [*cases.HOSTILE, "plain", "''x", "＝1"])
def test_no_cell_of_a_csv_is_a_formula_and_the_way_back_is_sure(text: str) -> None:
    cell = guarded(text)
    assert not cell.startswith(tuple(set(GUARDED) - {"'"}))
    assert unguarded(cell) == text


def test_byte_order_mark_is_there_unless_it_is_not_wanted(tmp_path) -> None:
    site = cases.format_site(tmp_path)
    photos = [site.layers["photos"]]
    for bom in (True, False):
        cases.write("csv", site, photos, tmp_path / f"{bom}.csv", bom=bom)
        assert (tmp_path / f"{bom}.csv").read_bytes().startswith(b"\xef\xbb\xbf") is bom


def test_geojson_of_assets_is_read_by_json_alone(site, tmp_path) -> None:
    cases.write("geojson", site, cases.layers_of(site), tmp_path / "s.geojson")
    features = json.loads((tmp_path / "s.geojson").read_text("utf-8"))["features"]
    for layer in cases.layers_of(site):
        own = [f for f in features if f["properties"].get("layer") == layer.name]
        assert len(own) == len(layer)
        for read, feature in zip(own, layer.features, strict=True):
            read["properties"].pop("layer")
            assert read["properties"] == feature.values
            if layer.geometry == "None":
                assert read["geometry"] is None
                continue
            points = shapely.get_coordinates(
                shapely.geometry.shape(read["geometry"]), include_z=True
            )
            assert np.abs(points[:, :2] - feature.geo[:, :2]).max() < 1e-9
            measured = layer.name != "footprints" and np.isfinite(feature.geo[:, 2]).all()
            assert np.isfinite(points[:, 2]).all() == measured
            if measured:
                assert np.abs(points[:, 2] - feature.geo[:, 2]).max() < 1e-4


# -- heights ---------------------------------------------------------------------------------------


@needs_gdal
@pytest.mark.parametrize("name", ["filegdb", "flatgeobuf", "shapefile"])
@pytest.mark.parametrize("kind", ["ellipsoidal", "orthometric"])
def test_heights_of_vertices_are_of_the_kind_asked_for(name, kind, tmp_path) -> None:
    site = cases.format_site(tmp_path)
    layers = [site.layers["asset_lines"], site.layers["asset_points"]]
    target = tmp_path / ("s.gdb" if name == "filegdb" else "out")
    report = cases.write(name, site, layers, target, heights=kind)
    suffix = {"flatgeobuf": ".fgb", "shapefile": ".shp"}.get(name, "")
    path = target / f"asset_lines{suffix}" if suffix else target
    ((_, line),) = cases.rows_of(cases.system_gdal(path)["asset_lines"])
    feature = layers[0].features[0]
    # m: a geodatabase keeps 0.1 mm
    expected = feature.geo[:, 2] if kind == "ellipsoidal" else feature.height_orthometric
    assert shapely.get_coordinates(line, include_z=True)[:, 2] == pytest.approx(expected, abs=1e-4)
    assert report.height_kind.startswith(kind)
    (told,) = [w for w in report.warnings if "stay 2D" in w]
    assert "asset_points (1 of 13)" in told
    # one line of many layers, which would not be taken for one of many photos
    assert grouped(report.warnings) == list(report.warnings)


# -- what does not fit -----------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "suffix"), [("flatgeobuf", ".fgb"), ("geoparquet", ".parquet"),
                                              ("csv", ".csv")])  # fmt: skip
def test_one_file_holds_one_layer(name, suffix, tmp_path) -> None:
    site = cases.format_site(tmp_path)
    photos, lines = site.layers["photos"], site.layers["asset_lines"]
    cases.write(name, site, [photos], tmp_path / f"one{suffix}")
    assert (tmp_path / f"one{suffix}").is_file()
    with pytest.raises(ExportError, match="holds one layer, not photos, asset_lines"):
        cases.write(name, site, [photos, lines], tmp_path / f"two{suffix}")


@pytest.mark.parametrize("name", ["flatgeobuf", "dxf"])
def test_cameras_alone_are_refused_where_every_thing_has_a_place(name, tmp_path) -> None:
    site = make_site(tmp_path)
    with pytest.raises(ExportError, match="cannot hold cameras"):
        cases.write(name, site, [site.layers["cameras"]], tmp_path / "out")


@pytest.mark.parametrize("number", [2**31, -(2**63)])
def test_numbers_larger_than_32_bits_are_refused_by_name_in_a_geodatabase(tmp_path, number) -> None:
    site = cases.format_site(tmp_path)
    layer = site.layers["asset_lines"]
    layer.columns["dof"].values[:] = number
    with pytest.raises(ExportError, match=rf"asset_lines.dof: {number} .*32 bits"):
        cases.write("filegdb", site, [layer], tmp_path / "s.gdb")


def test_without_pyarrow_it_is_said_what_to_install(tmp_path, monkeypatch) -> None:
    import sys

    monkeypatch.setitem(sys.modules, "pyarrow", None)
    site = make_site(tmp_path)
    with pytest.raises(ExportError, match=r"pip install georef-gis\[parquet\]"):
        cases.write("geoparquet", site, [site.layers["photos"]], tmp_path / "out")
