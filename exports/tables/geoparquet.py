"""Exporter to GeoParquet 1.0."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from exports.tables.table_export import SpatialOptions, TableExporter, files_of, report_of
from georef_gis.errors import ExportError
from georef_gis.toolbox import ExportReport

if TYPE_CHECKING:
    from exports.site.columns import Layer
    from exports.site.site import SiteLayers
    from exports.tables.vector_file import Heights

VERSION = "1.0.0"
GEOMETRY = "geometry"


class GeoParquet(TableExporter[SpatialOptions]):
    """Layers as GeoParquet in the project CRS, a file each, for analysis at scale.

    A folder of files; a single file if the target ends in .parquet. Meaning and unit of a column
    stand in its metadata, what the file is in the metadata `georef_gis`. Cameras are a plain
    Parquet file. Needs pyarrow: `pip install georef-gis[parquet]`.
    """

    id = "geoparquet"
    name = "GeoParquet"
    suffix = ""
    target = "site_parquet"

    def write_layers(
        self, site: SiteLayers, layers: Sequence[Layer], target: Path, options: SpatialOptions
    ) -> ExportReport:
        """Write the file, or the folder of files."""
        from exports.tables.vector_file import flat_warnings

        try:
            from pyarrow import parquet
        except ImportError as error:
            raise ExportError(
                "GeoParquet needs pyarrow, which is not installed; run "
                "`pip install georef-gis[parquet]`, or export FlatGeobuf"
            ) from error
        for layer in layers:
            _check(layer)
        files = files_of(layers, target, ".parquet")
        for layer in layers:
            table = _table(site, layer, options.heights)
            parquet.write_table(table, files[layer.name], compression="zstd")
        return report_of(site, layers, options.heights, flat_warnings(layers, options.heights))


def _check(layer: Layer) -> None:
    """Refuse a field that would hide the geometry."""
    if any(field.name == GEOMETRY for field in layer.fields):
        raise ExportError(f"{layer.name}: a column is called {GEOMETRY!r}; use GeoPackage")


def _table(site: SiteLayers, layer: Layer, heights: Heights) -> Any:
    import pyarrow as pa

    from exports.tables.vector_file import geometry_type, wkb_batches

    types = {"text": pa.string(), "real": pa.float64(), "integer": pa.int64(), "flag": pa.bool_()}
    arrays, fields = [], []
    for field in layer.fields:
        column = layer.columns[field.name]
        arrays.append(pa.array(column.values, type=types[field.kind], mask=column.missing))
        words = {"description": field.doc, "unit": field.unit}
        fields.append(pa.field(field.name, types[field.kind], metadata=words))
    metadata = {"georef_gis": json.dumps(site.metadata(), ensure_ascii=False)}
    if layer.geometry != "None":
        parts = [pa.array(part, type=pa.binary()) for part in wkb_batches(layer, heights)]
        arrays.append(pa.chunked_array(parts))
        fields.append(pa.field(GEOMETRY, pa.binary()))
        metadata["geo"] = json.dumps(_geo(site, layer, geometry_type(layer, heights)))
    return pa.table(arrays, schema=pa.schema(fields, metadata=metadata))


def _geo(site: SiteLayers, layer: Layer, kind: str) -> dict[str, Any]:
    """The metadata that makes a Parquet file a GeoParquet file."""
    xy = layer.places.xy
    return {
        "version": VERSION,
        "primary_column": GEOMETRY,
        "columns": {
            GEOMETRY: {
                "encoding": "WKB",
                "geometry_types": [kind],
                "crs": site.crs.to_json_dict(),
                "edges": "planar",
                "bbox": [*xy.min(axis=0).tolist(), *xy.max(axis=0).tolist()],
            }
        },
    }
