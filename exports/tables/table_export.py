"""What exporters of attribute tables share: their options, the layers asked for, the files beside.

A format that holds one layer a file is written as a folder of such files, with ``fields.csv`` and
``about.csv``; if the target has the format's suffix, as that one file.
"""

from __future__ import annotations

import csv
from abc import abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar

from georef_gis.errors import ExportError
from georef_gis.toolbox import Exporter, ExportReport, Feedback, LayerSource, check_cancelled
from georef_gis.toolbox import parameters as p

if TYPE_CHECKING:
    from exports.site.columns import Layer
    from exports.site.site import SiteLayers
    from exports.tables.vector_file import Heights

FIELDS_FILE, ABOUT_FILE = "fields.csv", "about.csv"
_NO_HEIGHTS = "none (2D; heights are attributes: ellipsoidal, orthometric EGM96, above ground)"
_HEIGHT_KINDS: Mapping[str, str] = {
    "attributes": _NO_HEIGHTS,
    "ellipsoidal": "ellipsoidal",
    "orthometric": "orthometric (EGM96)",
}


class TableOptions(p.Parameters):
    """Options of every table format."""

    tie_points: p.Flag = p.flag(
        True, title="Tie points", help="Of the site also the ground points of the adjustment."
    )


class SpatialOptions(TableOptions):
    """Options of those that hold geometries in three dimensions."""

    heights: Literal["attributes", "ellipsoidal", "orthometric"] = p.choice(
        "attributes",
        title="Heights of geometries",
        help="attributes = geometries are 2D, as the CRS has no vertical part, and heights stand "
        "in columns that name their kind; else each vertex has a z in m, of layers all of whose "
        "vertices have a height.",
    )


O = TypeVar("O", bound=TableOptions)  # noqa: E741


class TableExporter(Exporter[O]):
    """Base: finds the layers and says what is left out; `write_layers` writes them."""

    accepts = ("site", "vector")
    needs = ("photos", "poses", "footprints")
    wants = ("adjusted", "control", "accuracy")

    def write(
        self, source: LayerSource, target: Path, options: O, feedback: Feedback
    ) -> ExportReport:
        """Write the site, or one of its layers, to `target`."""
        site, layers = chosen_layers(source, options)
        check_cancelled(feedback)
        report = self.write_layers(site, layers, target, options)
        for warning in report.warnings:
            feedback.warn(warning)
        return report

    @abstractmethod
    def write_layers(
        self, site: SiteLayers, layers: Sequence[Layer], target: Path, options: O
    ) -> ExportReport:
        """Write layers, none of which is empty."""


def asked_layers(source: LayerSource, options: TableOptions) -> tuple[str, ...]:
    """Names of the layers that are asked for, with features or without."""
    from exports.site.site import LAYERS, SiteLayers

    if source.kind != "site":
        return SiteLayers.names_of(source.layer)
    return LAYERS if options.tie_points else tuple(x for x in LAYERS if x != "tie_points")


def chosen_layers(source: LayerSource, options: TableOptions) -> tuple[SiteLayers, list[Layer]]:
    """What is to be written; empty layers are left out.

    Raises
    ------
    ExportError
        If all are empty.
    """
    from exports.site.site import SiteLayers

    site, names = SiteLayers.from_project(source.project), asked_layers(source, options)
    layers = [layer for layer in map(site.layer, names) if len(layer)]
    if not layers:
        raise ExportError(site.why_empty(names))
    return site, layers


def report_of(
    site: SiteLayers,
    layers: Sequence[Layer],
    heights: Heights = "attributes",
    warnings: Iterable[str] = (),
) -> ExportReport:
    """Report on layers that were written in the project's CRS."""
    from exports.tables.vector_file import unplaced_warning

    shown = any(layer.name == "photos" for layer in layers)
    return ExportReport(
        crs=site.crs_name,
        height_kind=_HEIGHT_KINDS[heights],
        features=sum(map(len, layers)),
        warnings=(*site.warnings, *(unplaced_warning(site) if shown else ()), *warnings),
    )


def files_of(
    layers: Sequence[Layer], target: Path, suffix: str, *, site: SiteLayers | None = None
) -> dict[str, Path]:
    """File of each layer by name: the target itself if it has the suffix, else in that folder.

    Parameters
    ----------
    site
        To write what the files are beside them.

    Raises
    ------
    ExportError
        If one file would have to hold several layers.
    """
    if target.suffix.lower() == suffix:
        if len(layers) > 1:
            names = ", ".join(layer.name for layer in layers)
            raise ExportError(
                f"a {suffix} file holds one layer, not {names}; give the name of a folder, "
                "without a suffix"
            )
        return {layers[0].name: target}
    target.mkdir()
    if site is not None:
        write_about(site, target / ABOUT_FILE)
    return {layer.name: target / f"{layer.name}{suffix}" for layer in layers}


def write_about(site: SiteLayers, path: Path) -> None:
    """Write what someone who has only the files needs to know."""
    with path.open("w", encoding="utf-8-sig", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(("key", "value"))
        writer.writerows(site.metadata().items())


def write_fields(
    layers: Sequence[Layer], path: Path, names: Mapping[str, str] | None = None
) -> None:
    """Write the meaning of every column, and its name in the files where that is another."""
    with path.open("w", encoding="utf-8-sig", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(("layer", "column", "name", "kind", "unit", "meaning"))
        for layer in layers:
            writer.writerows(_field_rows(layer, names or {}))


def _field_rows(layer: Layer, names: Mapping[str, str]) -> Iterable[tuple[Any, ...]]:
    for f in layer.fields:
        yield layer.name, names.get(f.name, f.name), f.name, f.kind, f.unit, f.doc
