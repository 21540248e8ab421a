"""Exporter of cameras, poses and points to OpenSfM and OpenDroneMap: reconstruction.json."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

from exports.poses.block_export import block_report, export_block
from georef_gis.errors import ExportError, InputError
from georef_gis.toolbox import Exporter, ExportReport, Feedback, LayerSource
from georef_gis.toolbox import parameters as p

if TYPE_CHECKING:
    from exports.site.site import SiteLayers
    from georef_gis.model.tie_points import GroundPoints, TiePoints


class OpenSfmOptions(p.Parameters):
    """Options of reconstruction.json."""


class OpenSfm(Exporter[OpenSfmOptions]):
    """Cameras, poses and points as OpenSfM's reconstruction.json, which OpenDroneMap uses too.

    The frame is east, north, up at reference_lla; its altitude is above the ellipsoid. What the
    format cannot hold (covariances, a skew) stands under the key georef_gis, which OpenSfM passes
    over. Points are those of the adjustment, where there is one.
    """

    id = "opensfm"
    name = "OpenSfM reconstruction"
    suffix = ".json"
    accepts = ("vector",)
    target = "reconstruction.json"
    needs = ("photos", "poses")

    def write(
        self, source: LayerSource, target: Path, options: OpenSfmOptions, feedback: Feedback
    ) -> ExportReport:
        """Write the block to `target`."""
        return export_block(source, target, feedback, write_opensfm)


def write_opensfm(
    site: SiteLayers,
    target: Path,
    *,
    ties: TiePoints | None = None,
    points: GroundPoints | None = None,
) -> ExportReport:
    """`reconstruction.json` of a site.

    Parameters
    ----------
    ties, points
        Of an adjustment, if there is one.

    Raises
    ------
    ExportError
        If there is no pose, or a camera that the format cannot hold.
    """
    from exports.site.block import site_block
    from georef_gis.model.interchange.block import OWN_KEY
    from georef_gis.model.interchange.opensfm import PROGRAM, block_to_opensfm

    found = site_block(site, PROGRAM, ties=ties, points=points)
    try:
        data = block_to_opensfm(found.block)
    except InputError as error:
        raise ExportError(str(error)) from error
    data[0][OWN_KEY] = found.facts
    with target.open("w", encoding="utf-8") as stream:
        json.dump(data, stream, ensure_ascii=False, allow_nan=False, indent=1)
    return block_report(site, found)
