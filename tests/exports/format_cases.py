"""A site whose assets have hostile texts and places, and readers that share nothing with us."""

from __future__ import annotations

import csv
import json
import os
import subprocess
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from site_cases import make_site

from exports import EXPORTERS
from exports.site.columns import Layer
from exports.site.site import SiteLayers
from georef_gis.project.asset_layers import AssetTable

FORMATS = {exporter.id: exporter for exporter in EXPORTERS}
HOSTILE = (
    "a & <b> \"c\" 'd'",
    "cone 🚧 – ü 路",
    "x" * 299 + "ü",
    "'; DROP TABLE asset_points; --",
    "=cmd|'/c calc'!A0",
    "+1",
    "-1",
    "@sum(a1)",
    "\t=1",
    "'quoted",
    "back\\slash \\N",
    "two\r\nlines",
    "50 %%d ^J",
)
SYSTEM_PYTHON = "/usr/bin/python3"

AssetPoint = tuple[float, float, float]


def table(layer: str, parts: Sequence[Any], rows: Sequence[Mapping[str, Any]]) -> AssetTable:
    """Table of assets as their file gives it."""
    points = [np.asarray(part, float).reshape(-1, 3) for part in parts]
    whole = np.vstack(points)
    columns = {}
    for name in dict.fromkeys(name for row in rows for name in row):
        values = np.empty(len(rows), dtype=object)
        values[:] = [row.get(name) for row in rows]
        columns[name] = values
    return AssetTable(
        layer=layer,
        columns=columns,
        offsets=np.concatenate([[0], np.cumsum([len(p) for p in points])]),
        xy=whole[:, :2].copy(),
        height=whole[:, 2].copy(),
        holes=np.zeros(len(rows), np.int64),
    )


def asset(number: int, name: str, **values: Any) -> dict[str, Any]:
    """Row of an asset."""
    return {
        "asset_id": f"id-{number:03d}", "class": "cone", "name": name, "note": "",
        "sigma_e": 0.0123, "sigma_n": 0.02, "dof": 3, "n_rays": 2, "attributes": '{"a": "ü"}',
        "pixels": "[1]" * 200, "created": "2026-05-01T12:00:00.250Z", **values,
    }  # fmt: skip


def format_site(
    folder: Path, *, crs: str = "EPSG:6549", names: Sequence[str] = HOSTILE
) -> SiteLayers:
    """Points with hostile names, the last without a height; a line, an area, an ellipse."""
    site = make_site(folder, crs=crs)
    middle = site.frame.map_from_enu(np.zeros(3))
    places = middle + np.outer(np.arange(len(names)), [3.0, 2.0, 0.1])
    places[-1, 2] = np.nan
    ring = np.array([[0, 0, 0], [9, 0, 1], [9, 7, 2], [0, 7, 1], [0, 0, 0]]) + middle
    flat = ring * [1, 1, np.nan]
    nothing = {"sigma_e": float("nan"), "dof": None, "class": "cone/..:*?"}
    tables = (
        table("asset_points", places, [
            asset(i, name, **(nothing if i == 1 else {})) for i, name in enumerate(names)
        ]),
        table("asset_lines", [ring[:4]], [asset(50, "edge", **{"class": "lane_edge"})]),
        table("asset_polygons", [ring, flat], [
            asset(60, "area", **{"class": "work_area"}), asset(61, "low", **{"class": "work_area"})
        ]),
        table("asset_ellipses", [flat], [
            {"asset_id": "id-000", "class": "cone", "name": names[0], "semi_major": 0.03,
             "semi_minor": 0.02, "azimuth": 12.0, "conf": 0.95}
        ]),
    )  # fmt: skip
    return replace(site, assets=tables)


def layers_of(site: SiteLayers, *, cameras: bool = True) -> list[Layer]:
    """Layers with features."""
    found = [layer for layer in site.layers.values() if len(layer)]
    return [layer for layer in found if cameras or layer.geometry != "None"]


def write(name: str, site: SiteLayers, layers: Sequence[Layer], target: Path, **values: Any) -> Any:
    """Write layers by an exporter, without a project."""
    if name == "geopackage":
        from exports.tables.geopackage import write_geopackage

        return write_geopackage(site, target, tuple(layer.name for layer in layers))
    if name == "geojson":
        from exports.tables.geojson import write_geojson

        return write_geojson(site, target, tuple(layer.name for layer in layers))
    exporter = FORMATS[name]
    return exporter().write_layers(site, layers, target, exporter.Options(**values))


# -- readers -----------------------------------------------------------------------------------

Row = tuple[dict[str, Any], Any]


def wanted(layer: Layer, *, heights: bool = False) -> dict[str, Row]:
    """Features of a layer by their first column."""
    out = {}
    for feature in layer.features:
        values = dict(feature.values)
        points = feature.xy_map
        if heights:
            points = np.column_stack([points, feature.geo[:, 2]])
        shape = shape_of(layer.geometry, points)
        out[str(values[layer.fields[0].name])] = (values, shape)
    return out


def shape_of(kind: str, points: Any) -> Any:
    """Geometry of vertices."""
    if kind == "None":
        return None
    if kind == "Point":
        return shapely.Point(points[0])
    return shapely.LineString(points) if kind == "LineString" else shapely.Polygon(points)


def assert_same(found: Iterable[Row], layer: Layer, names: Mapping[str, str] | None = None,
                texts: Mapping[str, str] | None = None) -> None:  # fmt: skip
    """Attributes are equal, places within 0.2 mm.

    Parameters
    ----------
    names
        Field -> its name in the file.
    texts
        Text -> what the file is expected to hold for it.
    """
    names, texts, expected = names or {}, texts or {}, wanted(layer)
    key = names.get(layer.fields[0].name, layer.fields[0].name)
    rows = {str(values[key]): (values, shape) for values, shape in found}
    assert rows.keys() == expected.keys()
    for own, (values, shape) in expected.items():
        read, place = rows[own]
        for name, value in values.items():
            got = read[names.get(name, name)]
            _assert_equal(got, texts.get(value, value) if isinstance(value, str) else value, name)
        if shape is not None:
            # CRS units: feet
            assert shapely.hausdorff_distance(place, shape) < 6e-4, own
            # a geodatabase knows parts only
            assert place.geom_type.removeprefix("Multi") == shape.geom_type


def _assert_equal(got: Any, value: Any, name: str) -> None:
    if value is None or value == "":
        # neither a DBF nor a CSV can tell the two apart
        assert got is None or got != got or got == "", name
    elif isinstance(value, float):
        # a DBF has 15 decimals
        assert abs(float(got) - value) <= 1e-12 * max(1.0, abs(value)), name
    elif isinstance(value, bool):
        assert bool(got) is value, name
    else:
        assert got == value, name


_SYSTEM = """
import json, sys
from osgeo import ogr
ogr.UseExceptions()
source, out = ogr.Open(sys.argv[1]), {}
for i in range(source.GetLayerCount()):
    layer = source.GetLayer(i)
    srs = layer.GetSpatialRef()
    rows = []
    for feature in layer:
        shape = feature.GetGeometryRef()
        values = {}
        for k in range(feature.GetFieldCount()):
            values[feature.GetFieldDefnRef(k).GetName()] = (
                feature.GetField(k) if feature.IsFieldSetAndNotNull(k) else None)
        rows.append([values, None if shape is None else bytes(shape.ExportToIsoWkb()).hex()])
    out[layer.GetName()] = {"wkt": srs.ExportToWkt() if srs else None, "rows": rows}
print(json.dumps(out))
"""


def has_system_gdal() -> bool:
    """Whether Debian's GDAL is there, which is QGIS's."""
    done = subprocess.run(
        [SYSTEM_PYTHON, "-c", "import osgeo.ogr"], capture_output=True, env=_bare()
    )
    return done.returncode == 0


def system_gdal(path: Path) -> dict[str, dict[str, Any]]:
    """Layers as the system's GDAL 3.6 reads them."""
    done = subprocess.run(
        [SYSTEM_PYTHON, "-W", "ignore", "-c", _SYSTEM, str(path)],
        capture_output=True, text=True, check=True, env=_bare(),
    )  # fmt: skip
    return dict(json.loads(done.stdout))


def _bare() -> dict[str, str]:
    return {"PATH": "/usr/bin:/bin", "HOME": os.environ.get("HOME", "/tmp"), "LANG": "C.UTF-8"}


def rows_of(read: Mapping[str, Any]) -> list[Row]:
    """Rows of one layer of `system_gdal`."""
    return [(v, None if wkb is None else shapely.from_wkb(bytes.fromhex(wkb)))
            for v, wkb in read["rows"]]  # fmt: skip


def read_csv(path: Path) -> list[dict[str, str]]:
    """Rows of a CSV, without its byte order mark."""
    with path.open(encoding="utf-8-sig", newline="") as stream:
        return list(csv.DictReader(stream))
