"""Exporter to GeoJSON as RFC 7946 has it."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from exports.schemas import ASSETS
from georef_gis.errors import ExportError
from georef_gis.toolbox import Exporter, ExportReport, Feedback, LayerSource, check_cancelled
from georef_gis.toolbox import parameters as p

if TYPE_CHECKING:
    from exports.schemas import Feature, Layer
    from exports.site import SiteLayers

# deg; 0.1 mm
DECIMALS = 9
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
    accepts = ("vector", "site")
    needs = ("photos", "poses", "footprints")

    def write(
        self, source: LayerSource, target: Path, options: GeoJsonOptions, feedback: Feedback
    ) -> ExportReport:
        """Write the layer, or the site, to `target`."""
        from exports.site import SiteLayers

        site = SiteLayers.from_project(source.project)
        names = VECTORS if source.kind == "site" else site.names_of(source.layer)
        if source.kind == "site" and options.tie_points:
            names = (*VECTORS, "tie_points")
        check_cancelled(feedback)
        for warning in site.warnings:
            feedback.warn(warning)
        return write_geojson(site, target, names)


def write_geojson(site: SiteLayers, target: Path, names: tuple[str, ...] = VECTORS) -> ExportReport:
    """FeatureCollection of layers of a site; with several, features carry `layer`.

    The accuracy statement stands under `metadata`, a foreign member (RFC 7946, 6.1).

    Raises
    ------
    ExportError
        If all that is asked for is what the project has not.
    """
    layers = [site.layer(name) for name in names]
    if set(names) <= OPTIONAL and not any(layer.features for layer in layers):
        raise ExportError(site.why_empty(names))
    features = [
        _feature(layer, feature, named=len(layers) > 1)
        for layer in layers
        for feature in layer.features
    ]
    collection: dict[str, Any] = {"type": "FeatureCollection"}
    boxes = [f["bbox"] for f in features if "bbox" in f]
    if boxes:
        collection["bbox"] = _around(boxes)
    if site.accuracy:
        collection["metadata"] = dict(site.accuracy)
    collection["features"] = features
    with target.open("w", encoding="utf-8") as stream:
        json.dump(collection, stream, ensure_ascii=False, allow_nan=False)
    return ExportReport(crs="EPSG:4326", height_kind="ellipsoidal", features=len(features))


def _feature(layer: Layer, feature: Feature, *, named: bool) -> dict[str, Any]:
    properties = {"layer": layer.name} if named else {}
    properties |= {f.name: feature.values.get(f.name) for f in layer.fields}  # type: ignore[misc]
    out: dict[str, Any] = {"type": "Feature"}
    if layer.geometry != "None":
        points = list(_positions(layer, feature))
        dimensions = min(map(len, points))
        points = [point[:dimensions] for point in points]
        axes = list(zip(*points, strict=True))
        out["bbox"] = [*map(min, axes), *map(max, axes)]
        shape: Any = {"Point": points[0], "Polygon": [points]}.get(layer.geometry, points)
        out["geometry"] = {"type": layer.geometry, "coordinates": shape}
    else:
        out["geometry"] = None
    return out | {"properties": properties}


def _positions(layer: Layer, feature: Feature) -> Iterator[list[float]]:
    for lon, lat, h in feature.geo.tolist():
        point = [round(lon, DECIMALS), round(lat, DECIMALS)]
        # A footprint's corners lie on the ground, whose height is not measured.
        if layer.geometry != "Polygon" and math.isfinite(h):
            point.append(round(h, 4))
        yield point


def _around(boxes: list[list[float]]) -> list[float]:
    """Bounds of bounds, in the plane where one of them is."""
    flat = [[*box[:2], *box[len(box) // 2 : len(box) // 2 + 2]] for box in boxes]
    west, south, east, north = zip(*flat, strict=True)
    return [min(west), min(south), max(east), max(north)]
