"""Exporter to GeoPackage 1.3 in the project CRS, with styles for QGIS and the meaning of fields."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from exports.tables.vector_file import crs_text, geometries, refusal, unplaced_warning, write_table
from georef_gis.errors import ExportError
from georef_gis.toolbox import Exporter, ExportReport, Feedback, LayerSource, check_cancelled
from georef_gis.toolbox import parameters as p

if TYPE_CHECKING:
    from exports.site.columns import Layer
    from exports.site.site import SiteLayers

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
    # assets are styled
    version = "2"
    needs = ("photos", "poses", "footprints", "mosaic")
    wants = ("adjusted", "control", "accuracy")

    def write(
        self, source: LayerSource, target: Path, options: GeoPackageOptions, feedback: Feedback
    ) -> ExportReport:
        """Write the site, or one of its layers, to `target`."""
        from exports.site.site import LAYERS, SiteLayers

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

    from exports.site.site import LAYERS
    from exports.tables.geopackage_tables import add_tables

    layers = [layer for layer in map(site.layer, names or LAYERS) if len(layer)]
    if not layers:
        raise ExportError(site.why_empty(names or LAYERS))
    target.unlink(missing_ok=True)
    for layer in layers:
        _write_layer(site, layer, target)
    try:
        add_tables(target, site.metadata(), layers, styles=styles)
    except sqlite3.Error as error:
        raise refusal(error, target) from error
    return ExportReport(
        crs=site.crs_name, height_kind=HEIGHT_KIND, features=sum(map(len, layers)),
        warnings=site.warnings + unplaced_warning(site),
    )  # fmt: skip


def _write_layer(site: SiteLayers, layer: Layer, target: Path) -> None:
    plain = layer.geometry == "None"
    options: dict[str, Any] = {"IDENTIFIER": layer.title, "DESCRIPTION": _description(site, layer)}
    write_table(
        target,
        [field.name for field in layer.fields],
        [layer.columns[field.name] for field in layer.fields],
        geometries(layer, "attributes")[0],
        layer=layer.name,
        driver="GPKG",
        geometry_type=None if plain else layer.geometry,
        crs=None if plain else crs_text(site),
        append=target.exists(),
        dataset_options=None if target.exists() else {"VERSION": VERSION},
        layer_options=options if plain else options | {"GEOMETRY_NAME": "geom"},
    )


def _description(site: SiteLayers, layer: Layer) -> str:
    if layer.geometry == "None":
        return "Interior orientations, px"
    return (
        f"{layer.title} in {site.crs_name}; 2D, heights are attributes in metres whose names say "
        "their kind; sigmas are one standard deviation"
    )
