"""Exporter to CSV: a folder with one table for each layer."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from exports.site.schemas import ELLIPSES
from exports.tables.table_export import (
    FIELDS_FILE,
    TableExporter,
    TableOptions,
    files_of,
    report_of,
    write_fields,
)
from georef_gis.project.spreadsheet import guarded
from georef_gis.toolbox import ExportReport
from georef_gis.toolbox import parameters as p

if TYPE_CHECKING:
    from exports.site.columns import Column, Layer
    from exports.site.site import SiteLayers

_LONLAT = ("lon_deg", "lat_deg")
_QUOTE = '"'
_QUOTED = re.compile('[",\r\n]')


class CsvOptions(TableOptions):
    """Options of the CSV."""

    bom: p.Flag = p.flag(
        True, title="Byte order mark", help="Without it Excel takes UTF-8 for another encoding; "
        "programs that stumble over it are rare.",
    )  # fmt: skip


class Csv(TableExporter[CsvOptions]):
    """Layers as tables for spreadsheets, a CSV file each.

    Points have x, y in the project CRS and lon_deg, lat_deg; lines and areas have wkt in the CRS
    and, but for ellipses, wkt_lonlat. A text that a spreadsheet would run as a formula gets an
    apostrophe in front. A folder of files; a single file if the target ends in .csv.
    """

    id = "csv"
    name = "CSV"
    suffix = ""
    target = "site_csv"

    def write_layers(
        self, site: SiteLayers, layers: Sequence[Layer], target: Path, options: CsvOptions
    ) -> ExportReport:
        """Write the file, or the folder of files."""
        files = files_of(layers, target, ".csv", site=site)
        if target.is_dir():
            write_fields(layers, target / FIELDS_FILE)
        for layer in layers:
            write_csv(layer, files[layer.name], bom=options.bom)
        return report_of(site, layers)


def write_csv(
    layer: Layer, path: Path, *, bom: bool, extra: tuple[str, Sequence[str]] | None = None
) -> None:
    """Table of a layer.

    Parameters
    ----------
    extra
        Name and texts of one more column, which comes first.
    """
    with path.open("w", encoding="utf-8-sig" if bom else "utf-8", newline="") as stream:
        names = [*([extra[0]] if extra else []), *(f.name for f in layer.fields)]
        stream.write(",".join([*names, *_place_names(layer)]) + "\r\n")
        for start, stop in layer.batches():
            columns = [_cells(layer.columns[field.name], start, stop) for field in layer.fields]
            if extra:
                columns.insert(0, extra[1][start:stop])
            columns += _places(layer, start, stop)
            stream.write("".join(",".join(row) + "\r\n" for row in zip(*columns, strict=True)))


def _cells(column: Column, start: int, stop: int) -> Sequence[str]:
    """Cells of a column, quoted where they must be; empty where a value is missing."""
    values = column.tolist(start, stop)
    if column.values.dtype == object:
        return [_cell(value) if isinstance(value, str) else "" for value in values]
    if column.values.dtype == bool:
        return ["" if value is None else ("true" if value else "false") for value in values]
    return ["" if value is None else repr(value) for value in values]


def _cell(text: str) -> str:
    text = guarded(text)
    return f'"{text.replace(_QUOTE, _QUOTE * 2)}"' if _QUOTED.search(text) else text


def _place_names(layer: Layer) -> list[str]:
    if layer.geometry == "None":
        return []
    if layer.geometry != "Point":
        # of ellipses the place is that of their asset, and so many numbers more would be idle
        return ["wkt"] if layer.name == ELLIPSES else ["wkt", "wkt_lonlat"]
    return ["x", "y", *(name for name in _LONLAT if name not in layer.columns)]


def _places(layer: Layer, start: int, stop: int) -> Iterator[Sequence[str]]:
    """Columns of `_place_names`."""
    import numpy as np

    from exports.tables.coordinate_text import DEGREE_DECIMALS, LENGTH_DECIMALS, numbers, wkt_of

    at = layer.places
    if layer.geometry == "Point":
        for axis in (0, 1):
            yield numbers(at.xy[start:stop, axis], LENGTH_DECIMALS)
        for axis, name in enumerate(_LONLAT):
            if name not in layer.columns:
                yield numbers(at.lonlat[start:stop, axis], DEGREE_DECIMALS)
    elif layer.geometry != "None":
        rows = slice(at.offsets[start], at.offsets[stop])
        flat, solid = np.zeros(stop - start, bool), layer.solid[start:stop]
        shapes = wkt_of(
            layer, start, stop, points=at.xy[rows], decimals=LENGTH_DECIMALS, solid=flat
        )
        yield [f'"{wkt}"' for wkt in shapes]
        if "wkt_lonlat" in _place_names(layer):
            geo = np.column_stack([at.lonlat[rows], at.height[rows]])
            shapes = wkt_of(layer, start, stop, points=geo, decimals=DEGREE_DECIMALS, solid=solid)
            yield [f'"{wkt}"' for wkt in shapes]
