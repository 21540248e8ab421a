"""Exporter to GeoJSON as RFC 7946 has it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from exports.site.schemas import ASSETS
from georef_gis.errors import ExportError
from georef_gis.toolbox import Exporter, ExportReport, Feedback, LayerSource, check_cancelled
from georef_gis.toolbox import parameters as p

if TYPE_CHECKING:
    from exports.site.site import SiteLayers

VECTORS = ("photos", "footprints", "track", "control", *ASSETS)
# Layers that are there only after work that may not have been done: an empty one is refused.
OPTIONAL = {"control", "tie_points", *ASSETS}


class GeoJsonOptions(p.Parameters):
    """Options of the GeoJSON."""

    tie_points: p.Flag = p.flag(
        False, title="Tie points", help="Of the site also the ground points of the adjustment, "
        "about 300 bytes each.",
    )  # fmt: skip


class GeoJson(Exporter[GeoJsonOptions]):
    """One layer, or all of the site, as GeoJSON (RFC 7946) in WGS 84 longitude and latitude.

    Third coordinates are metres above the WGS 84 ellipsoid, as the RFC asks. Of the whole site
    every feature says its layer.
    """

    id = "geojson"
    name = "GeoJSON"
    suffix = ".geojson"
    further_suffixes = (".json",)
    accepts = ("vector", "site")
    needs = ("photos", "poses", "footprints")

    def write(
        self, source: LayerSource, target: Path, options: GeoJsonOptions, feedback: Feedback
    ) -> ExportReport:
        """Write the layer, or the site, to `target`."""
        from exports.site.site import SiteLayers

        site = SiteLayers.from_project(source.project)
        names = VECTORS if source.kind == "site" else site.names_of(source.layer)
        if source.kind == "site" and options.tie_points:
            names = (*VECTORS, "tie_points")
        check_cancelled(feedback)
        report = write_geojson(site, target, names)
        for warning in report.warnings:
            feedback.warn(warning)
        return report


def write_geojson(site: SiteLayers, target: Path, names: tuple[str, ...] = VECTORS) -> ExportReport:
    """FeatureCollection of layers of a site; with several, features carry `layer`.

    The accuracy statement stands under `metadata`, a foreign member (RFC 7946, 6.1).

    Raises
    ------
    ExportError
        If all that is asked for is what the project has not.
    """
    from exports.tables.geojson_features import bounds_of, feature_lines
    from exports.tables.vector_file import unplaced_warning

    layers = [site.layer(name) for name in names]
    if set(names) <= OPTIONAL and not any(len(layer) for layer in layers):
        raise ExportError(site.why_empty(names))
    head: dict[str, Any] = {"type": "FeatureCollection"}
    if box := bounds_of([layer.places.lonlat for layer in layers]):
        head["bbox"] = box
    if site.accuracy:
        head["metadata"] = dict(site.accuracy)
    mark = ""
    with target.open("w", encoding="utf-8", newline="\n") as stream:
        stream.write(json.dumps(head, ensure_ascii=False, allow_nan=False)[:-1])
        stream.write(', "features": [')
        for layer in layers:
            for lines in feature_lines(layer, named=len(layers) > 1):
                stream.write(f"{mark}\n" + ",\n".join(lines))
                mark = ","
        stream.write("\n]}\n")
    return ExportReport(
        crs="EPSG:4326", height_kind="ellipsoidal", features=sum(map(len, layers)),
        warnings=site.warnings + (unplaced_warning(site) if "photos" in names else ()),
    )  # fmt: skip
