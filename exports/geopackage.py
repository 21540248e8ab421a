"""Exporter to GeoPackage 1.3 in the project CRS, with styles for QGIS and the meaning of fields."""

from __future__ import annotations

import errno
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from georef_gis.errors import ExportError
from georef_gis.toolbox import Exporter, ExportReport, Feedback, LayerSource, check_cancelled
from georef_gis.toolbox import parameters as p

if TYPE_CHECKING:
    from exports.schemas import Field, Layer
    from exports.site import SiteLayers

HEIGHT_KIND = "none (2D; heights are attributes: ellipsoidal, orthometric EGM96, above ground)"
# pyogrio's GDAL would write 1.4, of which QGIS 3.22 warns.
VERSION = "1.3"


class GeoPackageOptions(p.Parameters):
    """Options of the GeoPackage."""

    styles: p.Flag = p.flag(True, title="Styles", help="Default styles for QGIS in the file.")
    tie_points: p.Flag = p.flag(
        True, title="Tie points", help="The ground points of the adjustment, all of them."
    )


class GeoPackage(Exporter[GeoPackageOptions]):
    """Site for a GIS: photos, footprints, track, cameras, control, tie points in the project CRS.

    Places are 2D, because a height belongs to no vertical CRS here: heights stand as attributes
    that name their kind and metres. `site_metadata` says what the file is.
    """

    id = "geopackage"
    name = "GeoPackage"
    suffix = ".gpkg"
    accepts = ("site", "vector")
    target = "site.gpkg"
    in_run = True
    needs = ("photos", "poses", "footprints", "mosaic")
    wants = ("adjusted", "control", "accuracy")

    def write(
        self, source: LayerSource, target: Path, options: GeoPackageOptions, feedback: Feedback
    ) -> ExportReport:
        """Write the site, or one of its layers, to `target`."""
        from exports.site import LAYERS, SiteLayers

        site = SiteLayers.from_project(source.project)
        names = LAYERS if source.kind == "site" else site.names_of(source.layer)
        if source.kind == "site" and not options.tie_points:
            names = tuple(name for name in LAYERS if name != "tie_points")
        check_cancelled(feedback)
        report = write_geopackage(site, target, names, styles=options.styles)
        for warning in report.warnings:
            feedback.warn(warning)
        return report


def write_geopackage(
    site: SiteLayers, target: Path, names: tuple[str, ...] = (), *, styles: bool = True
) -> ExportReport:
    """GeoPackage of layers of a site; all of them if none is named. Empty ones are left out.

    Raises
    ------
    ExportError
        If there is nothing to write.
    OSError
        If the target cannot be written.
    """
    import sqlite3

    from exports.geopackage_tables import add_tables
    from exports.site import LAYERS

    layers = [layer for layer in map(site.layer, names or LAYERS) if layer.features]
    if not layers:
        raise ExportError(site.why_empty(names or LAYERS))
    target.unlink(missing_ok=True)
    for layer in layers:
        _write_layer(site, layer, target)
    try:
        add_tables(target, site.metadata(), layers, styles=styles)
    except sqlite3.Error as error:
        raise _refusal(error, target) from error
    warnings = site.warnings
    if site.unplaced:
        left = ", ".join(site.unplaced[:5])
        warnings += (f"photos left out, as they have no position: {left}",)
    features = sum(len(layer.features) for layer in layers)
    return ExportReport(
        crs=site.crs_name, height_kind=HEIGHT_KIND, features=features, warnings=warnings
    )


def _write_layer(site: SiteLayers, layer: Layer, target: Path) -> None:
    import numpy as np
    import pyogrio
    from pyogrio.errors import DataLayerError, DataSourceError, FeatureError, GeometryError

    values = [_column(field, layer) for field in layer.fields]
    plain = layer.geometry == "None"
    options: dict[str, Any] = {"IDENTIFIER": layer.title, "DESCRIPTION": _description(site, layer)}
    try:
        pyogrio.raw.write(
            target,
            geometry=None if plain else np.array(_geometries(layer), dtype=object),
            field_data=[value for value, _ in values],
            field_mask=[mask for _, mask in values],
            fields=[field.name for field in layer.fields],
            layer=layer.name,
            driver="GPKG",
            geometry_type=None if plain else layer.geometry,
            crs=None if plain else _crs_text(site),
            append=target.exists(),
            dataset_options=None if target.exists() else {"VERSION": VERSION},
            layer_options=options if plain else options | {"GEOMETRY_NAME": "geom"},
        )
    except (DataSourceError, DataLayerError, FeatureError, GeometryError, RuntimeError) as error:
        raise _refusal(error, target) from error


def _refusal(error: Exception, target: Path) -> OSError:
    """Error of the system's kind for one of a library: the toolbox says what to do."""
    text = str(error).splitlines()[0] if str(error) else type(error).__name__
    full = "full" in text or "No space" in text
    return OSError(errno.ENOSPC if full else errno.EIO, text, os.fspath(target))


def _crs_text(site: SiteLayers) -> str:
    authority = site.crs.to_authority(min_confidence=100)
    return ":".join(authority) if authority else site.crs.to_wkt()


def _geometries(layer: Layer) -> list[bytes]:
    import shapely

    make: Any = {
        "Point": lambda xy: shapely.Point(xy[0]),
        "LineString": shapely.LineString,
        "Polygon": shapely.Polygon,
    }[layer.geometry]
    return [bytes(shapely.to_wkb(make(feature.xy_map))) for feature in layer.features]


def _column(field: Field, layer: Layer) -> tuple[Any, Any]:
    """Values of a field, and which of them are missing."""
    import numpy as np

    values = [feature.values.get(field.name) for feature in layer.features]
    mask = np.array([value is None for value in values], dtype=bool)
    dtype: Any = {"text": object, "real": np.float64, "integer": np.int64, "flag": np.bool_}
    empty = {"text": None, "real": np.nan, "integer": 0, "flag": False}[field.kind]
    filled = [empty if value is None else value for value in values]
    return np.array(filled, dtype=dtype[field.kind]), mask


def _description(site: SiteLayers, layer: Layer) -> str:
    if layer.geometry == "None":
        return "Interior orientations, px"
    return (
        f"{layer.title} in {site.crs_name}; 2D, heights are attributes in metres whose names say "
        "their kind; sigmas are one standard deviation"
    )
