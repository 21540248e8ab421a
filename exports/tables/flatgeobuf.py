"""Exporter to FlatGeobuf."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from exports.tables.table_export import (
    FIELDS_FILE,
    SpatialOptions,
    TableExporter,
    files_of,
    report_of,
    write_fields,
)
from georef_gis.errors import ExportError
from georef_gis.toolbox import ExportReport

if TYPE_CHECKING:
    from exports.site.columns import Layer
    from exports.site.site import SiteLayers


class FlatGeobuf(TableExporter[SpatialOptions]):
    """Layers as FlatGeobuf in the project CRS, a file each, with a spatial index.

    A folder of files; a single file if the target ends in .fgb. Features are in the order of the
    index. Cameras, which have no place, are left out.
    """

    id = "flatgeobuf"
    name = "FlatGeobuf"
    suffix = ""
    target = "site_fgb"

    def write_layers(
        self, site: SiteLayers, layers: Sequence[Layer], target: Path, options: SpatialOptions
    ) -> ExportReport:
        """Write the file, or the folder of files."""
        from exports.tables.vector_file import crs_text, flat_warnings, geometries, write_table

        placed = [layer for layer in layers if layer.geometry != "None"]
        warnings = flat_warnings(placed, options.heights)
        if not placed:
            raise ExportError("FlatGeobuf cannot hold cameras, which have no place; use GeoPackage")
        if len(placed) < len(layers):
            warnings.append("cameras are left out, as they have no place; GeoPackage holds them")
        files = files_of(placed, target, ".fgb", site=site)
        if target.is_dir():
            write_fields(placed, target / FIELDS_FILE)
        for layer in placed:
            wkb, kind = geometries(layer, options.heights)
            write_table(
                files[layer.name],
                list(layer.columns),
                list(layer.columns.values()),
                wkb,
                driver="FlatGeobuf",
                geometry_type=kind,
                crs=crs_text(site),
                # GDAL's own is the name of the file, which is another while it is written
                layer=layer.name,
                layer_options={"SPATIAL_INDEX": "YES", "TITLE": layer.title},
            )
        return report_of(site, placed, options.heights, warnings)
