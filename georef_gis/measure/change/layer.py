"""Changed areas as a layer: a GeoPackage with its style, and GeoJSON."""

from __future__ import annotations

import contextlib
import json
import os
import sqlite3
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from georef_gis.errors import ExportError
from georef_gis.geodesy import CRS
from georef_gis.measure.change.detect import Change
from georef_gis.measure.change.pair import Cells
from georef_gis.project import geopackage
from georef_gis.project.geometry import to_blob
from georef_gis.project.schema import Table
from georef_gis.rasters.files import export_errors, whole_file

LAYER = Table(
    name="changes",
    description="Areas that changed between two dates, with the confidence that they did",
    geometry="MULTIPOLYGON",
    columns={
        "kind": "TEXT", "confidence": "REAL", "area_m2": "REAL", "sigma_area_m2": "REAL",
        "difference_percent": "REAL", "score": "REAL", "moves_leave": "REAL",
        "evidence": "TEXT", "photos": "INTEGER", "earlier_date": "TEXT", "later_date": "TEXT",
    },
)  # fmt: skip
# as QGIS makes it
_STYLES = """CREATE TABLE layer_styles (
  id INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL, f_table_catalog TEXT(256),
  f_table_schema TEXT(256), f_table_name TEXT(256), f_geometry_column TEXT(256),
  styleName TEXT(30), styleQML TEXT, styleSLD TEXT, useAsDefault BOOLEAN, description TEXT,
  owner TEXT(30), ui TEXT(30),
  update_time DATETIME DEFAULT (strftime('%Y-%m-%dT%H:%M:%fZ','now')))"""
# readable by the colour-blind (Okabe and Ito)
_COLOURS = {
    "brighter": "230,159,0", "darker": "0,114,178", "other": "204,121,167",
    "shadow?": "120,120,120", "leans?": "0,158,115",
}  # fmt: skip
# degrees: a millimetre
_DIGITS = 8


@dataclass(frozen=True, slots=True, kw_only=True)
class ChangeRow:
    """A feature of the layer: its values by column, and its shape in the map's CRS."""

    values: Mapping[str, Any]
    shape: Any


def rows_of(changes: Sequence[Change], cells: Cells, dates: tuple[str, str]) -> list[ChangeRow]:
    """Features of changes.

    Parameters
    ----------
    dates
        Earlier and later, ISO 8601; empty if unknown.
    """
    import shapely

    a, _, left, _, e, top = cells.header.transform
    square = cells.metres**2
    rows = []
    for change in changes:
        one = change.judged
        values = {
            "kind": one.kind,
            "confidence": round(change.confidence, 3),
            "area_m2": round(one.outline.area * square, 3),
            "sigma_area_m2": round(one.outline.sigma * square, 3),
            "difference_percent": _rounded(100.0 * one.difference, 1),
            "score": round(one.score, 2),
            "moves_leave": round(one.moved, 3),
            "evidence": change.evidence.said if change.evidence else None,
            "photos": change.evidence.photos if change.evidence else None,
            "earlier_date": dates[0] or None,
            "later_date": dates[1] or None,
        }
        shape = shapely.transform(
            one.outline.shape, lambda xy: xy * np.array([a, e]) + np.array([left, top])
        )
        rows.append(ChangeRow(values=values, shape=shapely.orient_polygons(shape)))
    return rows


def _rounded(value: float, digits: int) -> float | None:
    return round(value, digits) if np.isfinite(value) else None


def write_geopackage(path: Path, rows: Sequence[ChangeRow], crs_wkt: str) -> None:
    """Write the layer, whole or not at all, in place of the one that is there.

    Raises
    ------
    ExportError
        If it cannot be written.
    """
    part = path.with_name(f".{path.name}.part")
    try:
        part.unlink(missing_ok=True)
        with contextlib.closing(sqlite3.connect(part, isolation_level=None)) as connection:
            connection.execute("BEGIN")
            _fill(connection, rows, crs_wkt)
            connection.execute("COMMIT")
        with geopackage.journals_aside(path):
            os.replace(part, path)
    except (sqlite3.Error, OSError) as error:
        raise ExportError(
            f"{path}: cannot be written ({error}); check the permission and the free space"
        ) from error
    finally:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)


def _fill(connection: sqlite3.Connection, rows: Sequence[ChangeRow], crs_wkt: str) -> None:
    import shapely

    geopackage.create(connection, (LAYER,))
    srs_id = -1
    if crs_wkt:
        crs = CRS.from_wkt(crs_wkt)
        srs_id = geopackage.add_srs(
            connection, crs.name, crs.to_wkt("WKT1_GDAL"), crs.to_epsg(), ""
        )
    geopackage.set_layer_srs(connection, srs_id)
    names = list(LAYER.columns)
    marks = ", ".join("?" * (len(names) + 1))
    sql = f"INSERT INTO changes (geom, {', '.join(names)}) VALUES ({marks})"
    for row in rows:
        blob = to_blob(shapely.to_wkb(row.shape, byte_order=1), srs_id)[0]
        connection.execute(sql, (blob, *(row.values[name] for name in names)))
    geopackage.touch(connection, LAYER)
    connection.execute(_STYLES)
    connection.execute(
        "INSERT INTO gpkg_contents (table_name, data_type, identifier, description) "
        "VALUES ('layer_styles', 'attributes', 'layer_styles', 'Styles for QGIS')"
    )
    connection.execute(
        "INSERT INTO layer_styles (f_table_catalog, f_table_schema, f_table_name, "
        "f_geometry_column, styleName, styleQML, styleSLD, useAsDefault, description, owner) "
        "VALUES ('', '', 'changes', 'geom', 'changes', ?, '', 1, 'Changes by kind', '')",
        (style().decode(),),
    )


def write_geojson(path: Path, rows: Sequence[ChangeRow], crs_wkt: str) -> None:
    """Write the layer as RFC 7946: WGS 84 longitude and latitude.

    Raises
    ------
    ExportError
        If it cannot be written, or the map has no CRS.
    """
    import shapely

    from georef_gis.geodesy.reference_systems import horizontal_crs, transformer_between

    if not crs_wkt:
        raise ExportError(f"{path}: the map has no CRS, which GeoJSON needs; give it one")
    there = transformer_between(horizontal_crs(CRS.from_wkt(crs_wkt)), CRS.from_epsg(4326))
    features = []
    for row in rows:
        shape = shapely.transform(
            row.shape, lambda xy: np.column_stack(there.transform(xy[:, 0], xy[:, 1]))
        )
        shape = shapely.set_precision(shape, 10.0**-_DIGITS, mode="pointwise")
        features.append(
            {"type": "Feature", "geometry": shapely.geometry.mapping(shape),
             "properties": dict(row.values)}
        )  # fmt: skip
    text = json.dumps({"type": "FeatureCollection", "features": features}, allow_nan=False)
    with export_errors(path, lambda: len(text)), whole_file(path) as stream:
        stream.write(text.encode("utf-8") + b"\n")


def write_style(path: Path) -> None:
    """Write the style that QGIS takes for the layer by itself.

    Raises
    ------
    ExportError
        If it cannot be written.
    """
    with export_errors(path, lambda: 0), whole_file(path) as stream:
        stream.write(style() + b"\n")


def style() -> bytes:
    """QML: a colour by kind, the fainter the less sure."""
    root = ET.Element("qgis", version="3.22.0", styleCategories="Symbology|MapTips")
    renderer = ET.SubElement(
        root, "renderer-v2", type="categorizedSymbol", attr="kind", symbollevels="0",
        enableorderby="0", forceraster="0",
    )  # fmt: skip
    categories = ET.SubElement(renderer, "categories")
    symbols = ET.SubElement(renderer, "symbols")
    for number, (kind, colour) in enumerate(_COLOURS.items()):
        ET.SubElement(
            categories, "category", value=kind, label=kind, symbol=str(number), render="true"
        )
        symbol = ET.SubElement(
            symbols, "symbol", type="fill", name=str(number), alpha="1", clip_to_extent="1",
            force_rhr="0",
        )  # fmt: skip
        layer = ET.SubElement(
            symbol, "layer", {"class": "SimpleFill", "enabled": "1", "locked": "0", "pass": "0"}
        )
        options = ET.SubElement(layer, "Option", type="Map")
        for name, value in {
            "style": "solid", "color": f"{colour},60", "outline_style": "solid",
            "outline_color": f"{colour},255", "outline_width": "0.5", "outline_width_unit": "MM",
        }.items():  # fmt: skip
            ET.SubElement(options, "Option", name=name, value=value, type="QString")
    tip = ET.SubElement(root, "mapTip")
    tip.text = (
        '<b>[% "kind" %]</b><br/>confidence [% round("confidence", 2) %]<br/>'
        '[% round("area_m2", 2) %] +- [% round("sigma_area_m2", 2) %] m2'
    )
    return bytes(ET.tostring(root, encoding="utf-8"))
