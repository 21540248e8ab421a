"""Exporter of a light KMZ: small enough for phones, browsers and mail, whatever the site."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from exports.kml.options import LightKmzOptions
from georef_gis.toolbox import Exporter, ExportReport, Feedback, LayerSource

if TYPE_CHECKING:
    from exports.site.site import SiteLayers
    from georef_gis.project import Project


class LightKmz(Exporter[LightKmzOptions]):
    """The site in one small KMZ without links: for Google Earth in a browser or on a phone.

    The mosaic is made coarser, photos keep small thumbnails or none, and of many features some
    are left out, until the file is smaller than its limit. What was left out is told in the file.
    """

    id = "light_kmz"
    name = "Light KMZ (phones, browsers)"
    suffix = ".kmz"
    accepts = ("site",)
    target = "site_light.kmz"
    in_run = True
    needs = ("photos", "poses", "footprints", "mosaic")
    wants = ("adjusted", "control", "accuracy", "trajectory")
    version = "2"

    def write(
        self, source: LayerSource, target: Path, options: LightKmzOptions, feedback: Feedback
    ) -> ExportReport:
        """Write the site to `target`."""
        from exports.site.site import SiteLayers

        site = SiteLayers.from_project(source.project)
        return write_light_kmz(site, target, options, feedback, source.project)


def write_light_kmz(
    site: SiteLayers,
    target: Path,
    options: LightKmzOptions,
    feedback: Feedback,
    project: Project | None = None,
) -> ExportReport:
    """Light KMZ of a site.

    Raises
    ------
    ExportError
        If not even a few features fit into `max_mb`.
    """
    from exports.kml.light import write_light

    return write_light(site, target, options, feedback, project)
