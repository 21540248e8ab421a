"""Exporters to Google Earth: KMZ with photos, flight and the mosaic, and plain KML."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from exports.kml.options import CRS, HEIGHT_KIND, VECTORS, KmlOptions, KmzOptions, told_of
from exports.site.schemas import ASSETS
from georef_gis.errors import ExportError
from georef_gis.toolbox import Exporter, ExportReport, Feedback, LayerSource

if TYPE_CHECKING:
    from exports.site.site import SiteLayers
    from georef_gis.project import Project

# A single file with more features is slow to open.
MANY = 20_000


class Kmz(Exporter[KmzOptions]):
    """Site for Google Earth: photos, footprints, flight, control, assets and mosaic in one KMZ.

    Photo points and the flight stand at their height above sea level (EGM96), footprints and
    assets lie on the ground. The mosaic is a pyramid of tiles that load as one comes closer, and
    so are assets, where there are thousands. What each folder shows: docs/google_earth.md.
    """

    id = "kmz"
    name = "KMZ (Google Earth)"
    suffix = ".kmz"
    accepts = ("site",)
    target = "site.kmz"
    in_run = True
    needs = ("photos", "poses", "footprints", "mosaic")
    wants = ("adjusted", "control", "accuracy", "trajectory")
    version = "3"

    def write(
        self, source: LayerSource, target: Path, options: KmzOptions, feedback: Feedback
    ) -> ExportReport:
        """Write the site to `target`."""
        from exports.site.site import SiteLayers

        site = SiteLayers.from_project(source.project)
        return write_kmz(site, target, options, feedback, source.project)


class Kml(Exporter[KmlOptions]):
    """Photos, footprints, flight, control and assets as one plain KML, without pictures."""

    id = "kml"
    name = "KML (vectors)"
    suffix = ".kml"
    accepts = ("site", "vector")
    target = "site.kml"
    needs = ("photos", "poses", "footprints")
    wants = ("adjusted", "control", "accuracy", "trajectory")
    version = "2"

    def write(
        self, source: LayerSource, target: Path, options: KmlOptions, feedback: Feedback
    ) -> ExportReport:
        """Write the site, or one of its layers, to `target`."""
        from exports.site.site import SiteLayers

        site = SiteLayers.from_project(source.project)
        names = VECTORS if source.kind == "site" else site.names_of(source.layer)
        report = write_kml(site, target, names, source.project)
        for warning in report.warnings:
            feedback.warn(warning)
        return report


def write_kml(
    site: SiteLayers,
    target: Path,
    names: tuple[str, ...] = VECTORS,
    project: Project | None = None,
) -> ExportReport:
    """Plain KML of layers of a site.

    Raises
    ------
    ExportError
        If a layer cannot be shown in KML.
    """
    from exports.kml.icons import class_looks
    from exports.kml.site_kml import Shown, write_document
    from exports.kml.track import flight_placemarks, flights

    layers = {layer.name: layer for layer in map(site.layer, names)}
    if "cameras" in layers:
        raise ExportError("KML cannot hold cameras, which have no place; use GeoPackage")
    if "tie_points" in layers:
        raise ExportError("tie points are too many for KML; use GeoPackage")
    if set(names) <= {"control", *ASSETS} and not any(len(x) for x in layers.values()):
        raise ExportError(site.why_empty(names))
    layers, told_layers = told_of(layers)
    warnings = [*site.warnings, *told_layers]
    flown: list[str] = []
    if "track" in layers:
        found, told = flights(project, site.layers["photos"])
        flown, warnings = flight_placemarks(found, KmzOptions().track_hz, None), [*warnings, *told]
    features = sum(len(layer) for layer in layers.values())
    if features > MANY:
        warnings.append(
            f"{features} features in one KML are slow to open; use kmz, which parts them"
        )
    with target.open("wb") as stream:
        looks = class_looks(layers)
        write_document(stream, site, Shown(layers=layers, looks=looks, flights=flown))
    return ExportReport(
        crs=CRS, height_kind=HEIGHT_KIND, features=features, warnings=tuple(warnings)
    )


def write_kmz(
    site: SiteLayers,
    target: Path,
    options: KmzOptions,
    feedback: Feedback,
    project: Project | None = None,
) -> ExportReport:
    """KMZ of a site; memory is bounded, the parts wait on disk beside the target.

    Parameters
    ----------
    project
        Where the trajectory of its logs is looked for.

    Raises
    ------
    ExportError
        If even without mosaic it is larger than `max_mb`.
    """
    from exports.kml.package import write_package

    return write_package(site, target, options, feedback, project)
