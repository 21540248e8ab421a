"""Exporter to DXF for CAD programs."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from exports.site.schemas import ASSETS, ELLIPSES, GeometryKind
from exports.tables.table_export import (
    FIELDS_FILE,
    TableExporter,
    TableOptions,
    report_of,
    write_about,
    write_fields,
)
from georef_gis.errors import ExportError
from georef_gis.toolbox import ExportReport
from georef_gis.toolbox import parameters as p

if TYPE_CHECKING:
    from typing import TextIO

    import numpy as np
    from numpy.typing import NDArray

    from exports.site.columns import Layer
    from exports.site.site import SiteLayers
    from exports.tables.coordinate_text import Rows
    from exports.tables.dxf_drawing import Handles
    from georef_gis.frames import Array

DRAWING = "drawing.dxf"
# Which column labels a feature; the second where the first is empty
LABELS = {"photos": ("photo",), "control": ("name",), "footprints": ("photo",),
          "track": ("flight",), **dict.fromkeys(ASSETS[:-1], ("name", "class"))}  # fmt: skip
HANDLE = "dxf_handle"


class DxfOptions(TableOptions):
    """Options of the DXF."""

    heights: Literal["orthometric", "ellipsoidal", "flat"] = p.choice(
        "orthometric", title="Heights", help="z above the geoid of the CRS's vertical part; "
        "without one EGM96; or above the ellipsoid. In the unit of x and y. flat = all at 0.",
    )  # fmt: skip
    labels: p.Flag = p.flag(True, title="Labels", help="Names as texts, on layers of their own.")
    text_height: p.Length = p.length(0.5, title="Height of labels", unit="m", gt=0.0, advanced=True)


class Dxf(TableExporter[DxfOptions]):
    """Drawing for CAD in the project CRS: a layer for each class of assets, z where it is known.

    x, y and z are in the unit of the CRS, such as feet of a State Plane zone, which the drawing
    states. What a drawing cannot hold, the attributes, stands in a CSV for each layer beside it,
    by the handle of the entity. A folder; the drawing alone if the target ends in .dxf.
    """

    id = "dxf"
    name = "DXF (CAD)"
    suffix = ""
    target = "site_dxf"

    def write_layers(
        self, site: SiteLayers, layers: Sequence[Layer], target: Path, options: DxfOptions
    ) -> ExportReport:
        """Write the drawing and what it cannot hold."""
        from exports.tables.csv_layers import write_csv

        placed = [layer for layer in layers if layer.geometry != "None"]
        alone = target.suffix.lower() == ".dxf"
        if not placed:
            raise ExportError("DXF cannot hold cameras, which have no place; use CSV")
        if not alone:
            target.mkdir()
        drawing = _Drawing(site, placed, options)
        handles = drawing.write(target if alone else target / DRAWING)
        warnings = drawing.warnings()
        if alone:
            warnings.append("attributes are not in a drawing; a folder as target holds them too")
        else:
            for layer in layers:
                extra = (HANDLE, handles[layer.name]) if layer.name in handles else None
                write_csv(layer, target / f"{layer.name}.csv", bom=True, extra=extra)
            write_fields(layers, target / FIELDS_FILE)
            write_about(site, target / "about.csv")
            (target / DRAWING).with_suffix(".prj").write_text(site.crs.to_wkt("WKT1_ESRI"), "utf-8")
        report = report_of(site, placed, warnings=warnings)
        part = site.frame.vertical
        above = "EGM96" if part is None else f"{part.name}, geoid {part.geoid}"
        kind = {"orthometric": f"orthometric ({above})", "flat": "none (2D)"}
        return ExportReport(
            crs=report.crs, height_kind=kind.get(options.heights, options.heights),
            features=report.features, warnings=report.warnings,
        )  # fmt: skip


class _Drawing:
    """Entities of layers, and the handle of each feature."""

    def __init__(self, site: SiteLayers, layers: Sequence[Layer], options: DxfOptions) -> None:
        from georef_gis.geodesy import metres_per_unit

        self._site, self._layers, self._options = site, layers, options
        self._unit = metres_per_unit(site.crs)
        self._text = f"{options.text_height / self._unit:.4f}"

    def write(self, path: Path) -> dict[str, list[str]]:
        """Write the drawing; gives handles of features by layer."""
        from exports.tables import dxf_drawing as d

        handles, found = d.Handles(), {}
        names = {layer.name: self._cad_layers(layer) for layer in self._layers}
        listed = {name.casefold(): name for each in names.values() for name in each}
        texts = {f"{name}_text".casefold(): f"{name}_text" for name in listed.values()}
        low, high = self._box()
        with path.open("w", encoding="utf-8", newline="\r\n") as stream:
            about = f"{self._site.crs_name}, made by georef_gis; x, y, z in its unit"
            head = d.head(units=d.units_of(self._unit), low=low, high=high, handles=handles,
                          layers=(listed | texts).values(), comment=about)  # fmt: skip
            stream.write(head)
            for layer in self._layers:
                found[layer.name] = self._write_layer(stream, layer, names[layer.name], handles)
            stream.write(d.tail())
        return found

    def warnings(self) -> list[str]:
        """Features that lie at z = 0 because their height is not known."""
        if self._options.heights == "flat":
            return []
        low = {
            layer.name: int((~_solid(layer, self._heights(layer))).sum())
            for layer in self._layers
            if layer.measured_heights and layer.name != ELLIPSES
        }
        return [f"{count} features of {name} have no height and lie at z = 0"
                for name, count in low.items() if count]  # fmt: skip

    def _box(self) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        xy = [layer.places.xy for layer in self._layers]
        low = [min(float(part[:, axis].min()) for part in xy) for axis in (0, 1)]
        high = [max(float(part[:, axis].max()) for part in xy) for axis in (0, 1)]
        return (low[0], low[1], 0.0), (high[0], high[1], 0.0)

    def _cad_layers(self, layer: Layer) -> list[str]:
        """Layer of the drawing for each feature."""
        from exports.tables.dxf_drawing import layer_name

        if layer.name not in ASSETS:
            return [layer.name] * len(layer)
        suffix = "_ellipse" if layer.name == ELLIPSES else ""
        classes = layer.columns["class"].tolist()
        known = {text: layer_name(f"{text or 'no_class'}{suffix}") for text in set(classes)}
        return [known[text] for text in classes]

    def _heights(self, layer: Layer) -> Array:
        """Heights of the vertices in the drawing's unit, NaN where they are not known."""
        import numpy as np

        from exports.site.map_heights import heights_above

        at = layer.places
        if self._options.heights == "flat" or not layer.solid.any():
            return np.full(len(at.xy), np.nan)
        frame = self._site.frame
        if self._options.heights == "ellipsoidal":
            z = at.height
        elif frame.vertical is None:
            z = at.height_orthometric
        else:
            z = heights_above(frame.vertical, frame, at.lonlat, at.height)
        return np.asarray(z / self._unit)

    def _labels(self, layer: Layer) -> list[str]:
        if not self._options.labels or layer.name not in LABELS:
            return [""] * len(layer)
        columns = [layer.columns[name].tolist() for name in LABELS[layer.name]]
        return [str(next((x for x in row if x), "")) for row in zip(*columns, strict=True)]

    def _write_layer(
        self, stream: TextIO, layer: Layer, names: Sequence[str], handles: Handles
    ) -> list[str]:
        """Write the entities of a layer; gives the handle of each feature."""
        from exports.tables import dxf_drawing as d

        z, labels = self._heights(layer), self._labels(layer)
        known = _solid(layer, z)
        found: list[str] = []
        for start, stop in layer.batches():
            parts = []
            flat, solid = _vertices(layer, z, start, stop)
            ends = layer.places.offsets[start : stop + 1] - layer.places.offsets[start]
            for i, rows in enumerate(pairwise(ends.tolist()), start):
                found.append(handles.take())
                texts = (flat, solid if known[i] else None)
                if layer.geometry == "Point":
                    parts.append(d.point(f"{handles.last:X}", names[i], solid.between(*rows)))
                else:
                    parts.append(_line(layer.geometry, names[i], texts, rows, handles))
                if labels[i]:
                    at = solid.between(rows[0], rows[0] + 1)
                    parts.append(self._label(names[i], at, labels[i], handles))
            stream.write("".join(parts))
        return found

    def _label(self, name: str, at: str, text: str, handles: Handles) -> str:
        from exports.tables import dxf_drawing as d

        return d.label(handles.take(), f"{name}_text", at, text, self._text)


def _solid(layer: Layer, z: Array) -> NDArray[np.bool_]:
    """Which features have a height at every vertex that the drawing can have."""
    import numpy as np

    if not len(layer) or not len(z):
        return np.zeros(len(layer), bool)
    return np.asarray(layer.solid & np.logical_and.reduceat(np.isfinite(z), layer.places.firsts))


def _line(
    geometry: GeometryKind, name: str, texts: tuple[Rows, Rows | None], rows: tuple[int, int],
    handles: Handles,
) -> str:  # fmt: skip
    """Line or rim of the feature whose handle was taken last; `texts` flat, and in space if known.

    `rows` are its vertices.
    """
    from exports.tables import dxf_drawing as d

    (flat, solid), (first, last) = texts, rows
    closed = geometry == "Polygon"
    last -= closed
    if solid is None:
        body = flat.between(first, last)
        return d.flat_line(f"{handles.last:X}", name, body, count=last - first, closed=closed)
    vertices = [solid.between(k, k + 1) for k in range(first, last)]
    return d.solid_line(handles, name, vertices, closed=closed)


def _vertices(layer: Layer, z: Array, start: int, stop: int) -> tuple[Rows, Rows]:
    """Groups 10, 20 and 10, 20, 30 of the vertices of some features."""
    import numpy as np

    from exports.tables.coordinate_text import LENGTH_DECIMALS, rows_of

    rows = slice(layer.places.offsets[start], layer.places.offsets[stop])
    x, y = ((layer.places.xy[rows, axis], LENGTH_DECIMALS) for axis in (0, 1))
    # 0 where it is not known: an entity in space has one
    up = (np.nan_to_num(z[rows]), LENGTH_DECIMALS)
    # ends of lines are no ending that is left out: each group ends with one
    return rows_of("10\n", x, "\n20\n", y, "\n", ""), rows_of(
        "10\n", x, "\n20\n", y, "\n30\n", up, "\n", ""
    )
