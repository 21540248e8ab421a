"""Exporters to Google Earth: KMZ with photos, flight and the mosaic, and plain KML."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

from exports.site.schemas import ASSETS
from georef_gis.errors import ExportError
from georef_gis.toolbox import Exporter, ExportReport, Feedback, LayerSource
from georef_gis.toolbox import parameters as p

if TYPE_CHECKING:
    from collections.abc import Mapping

    from exports.site.columns import Layer
    from exports.site.site import SiteLayers
    from georef_gis.project import Project

VECTORS = ("photos", "footprints", "track", "control", *ASSETS)
CRS = "EPSG:4326"
HEIGHT_KIND = "orthometric (EGM96)"
# A single file with more features is slow to open.
MANY = 20_000


class KmzOptions(p.Parameters):
    """Options of the KMZ."""

    thumbnails: p.Flag = p.flag(
        True, title="Thumbnails", help="A small undistorted picture of every photo, in its balloon."
    )
    thumbnail_px: p.Integer = p.integer(
        512, title="Longer side of a thumbnail", unit="px", ge=64, le=2048, advanced=True
    )
    views: p.Flag = p.flag(
        True, title="Photo views", help="Photos to look through from where they were taken "
        "(PhotoOverlay, Google Earth Pro); they show the thumbnails.",
    )  # fmt: skip
    track_hz: p.Number = p.number(
        2.0, title="Samples of the flight a second", unit="Hz", gt=0, le=10, advanced=True
    )
    overlay: Literal["auto", "pyramid", "single", "none"] = p.choice(
        "auto",
        title="Mosaic",
        help="auto = one picture up to 2048 px, else a pyramid of tiles; a single picture is "
        "made smaller to 2048 px and is what phones and browsers show.",
    )
    max_mb: p.Number | None = p.number(
        None, title="Largest size", unit="MB", help="The mosaic is made coarser to fit.", gt=0
    )
    max_zoom: p.Integer | None = p.integer(
        None, title="Deepest level of the pyramid", help="0 is one tile of 256 px; each level "
        "halves the pixel.", ge=0, le=24, advanced=True,
    )  # fmt: skip
    quality: p.Integer = p.integer(
        85, title="JPEG quality of the mosaic", ge=1, le=100, advanced=True
    )


class KmlOptions(p.Parameters):
    """Options of the plain KML."""


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
    version = "2"

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
    warnings = [*site.warnings, *warnings_of(layers)]
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


def warnings_of(layers: Mapping[str, Layer]) -> list[str]:
    """What is to be said of texts that KML cannot hold as they are."""
    from exports.kml.placemarks import unfit_names

    unfit = unfit_names(layers)
    if not unfit:
        return []
    return [listed("control characters, which KML cannot hold, are written as \ufffd in", unfit)]


def listed(what: str, names: list[str] | tuple[str, ...]) -> str:
    """The first names of a list, and how many more there are."""
    more = f" and {len(names) - 5} more" if len(names) > 5 else ""
    return f"{what}: {', '.join(names[:5])}{more}"
