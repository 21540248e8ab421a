"""Exporter to an Esri file geodatabase."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from exports.tables.table_export import SpatialOptions, TableExporter, report_of
from georef_gis.errors import ExportError
from georef_gis.toolbox import ExportReport

if TYPE_CHECKING:
    from exports.site.columns import Column, Layer
    from exports.site.site import SiteLayers

_LARGEST = 2**31 - 1


class FileGdb(TableExporter[SpatialOptions]):
    """Layers as feature classes of one Esri file geodatabase, in the project CRS.

    Read by ArcGIS 10 and later, ArcGIS Pro and QGIS. Whole numbers are of 32 bits. The meaning of
    every column stands in the table `fields`, what the file is in the table `about`.
    """

    id = "filegdb"
    name = "File geodatabase"
    suffix = ".gdb"
    target = "site.gdb"

    def write_layers(
        self, site: SiteLayers, layers: Sequence[Layer], target: Path, options: SpatialOptions
    ) -> ExportReport:
        """Write the geodatabase."""
        from exports.tables.vector_file import crs_text, flat_warnings, geometries

        for layer in layers:
            wkb, kind = geometries(layer, options.heights)
            columns = [_short(layer, name, column) for name, column in layer.columns.items()]
            how: dict[str, Any] = {
                "geometry_type": kind,
                "layer_options": {"LAYER_ALIAS": layer.title},
            }
            if wkb is not None:
                how["crs"] = crs_text(site)
            _write(target, layer.name, list(layer.columns), columns, wkb, **how)
        _write_words(site, layers, target)
        return report_of(site, layers, options.heights, flat_warnings(layers, options.heights))


def _write(target: Path, name: str, names: Sequence[str], columns: Sequence[Column], wkb: Any,
           **how: Any) -> None:  # fmt: skip
    from exports.tables.vector_file import write_table

    write_table(
        target, names, columns, wkb, layer=name, driver="OpenFileGDB", append=target.exists(), **how
    )


def _short(layer: Layer, name: str, column: Column) -> Column:
    """Column with whole numbers of 32 bits, which ArcGIS before 3.2 is limited to."""
    import numpy as np

    from exports.site.columns import Column

    if column.values.dtype != np.int64:
        return column
    # not by their absolute values: that of the smallest of 64 bits is negative
    large = column.values[(column.values > _LARGEST) | (column.values < -_LARGEST)]
    if len(large):
        raise ExportError(
            f"{layer.name}.{name}: {int(large[0])} is larger than the 32 bits of a geodatabase; "
            "use GeoPackage"
        )
    return Column(values=column.values.astype(np.int32), missing=column.missing)


def _write_words(site: SiteLayers, layers: Sequence[Layer], target: Path) -> None:
    """Tables of what the columns mean and what the file is."""
    from exports.site.columns import Column

    rows: list[tuple[str | None, ...]] = [
        (a.name, f.name, f.kind, f.unit or None, f.doc) for a in layers for f in a.fields
    ]
    tables: dict[str, tuple[tuple[str, ...], list[tuple[str | None, ...]]]] = {
        "fields": (("layer", "name", "kind", "unit", "meaning"), rows),
        "about": (("key", "value"), [*site.metadata().items()]),
    }
    for table, (names, cells) in tables.items():
        columns = [Column.of("text", list(values)) for values in zip(*cells, strict=True)]
        _write(target, table, names, columns, None, geometry_type=None)
