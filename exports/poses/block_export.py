"""What the exporters of a whole block share: cameras, poses and points to another program."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from georef_gis.toolbox import ExportReport, Feedback, LayerSource

if TYPE_CHECKING:
    from exports.site.block import SiteBlock
    from exports.site.site import SiteLayers
    from georef_gis.model.tie_points import GroundPoints, TiePoints

CRS_OF_FRAME = "topocentric (east, north, up) at an origin in EPSG:4979"


class BlockWriter(Protocol):
    """Writes a site in the format of one program."""

    def __call__(
        self,
        site: SiteLayers,
        target: Path,
        *,
        ties: TiePoints | None = None,
        points: GroundPoints | None = None,
    ) -> ExportReport:
        """Write it; parameters as of `opensfm.write_opensfm`."""
        ...


def export_block(
    source: LayerSource, target: Path, feedback: Feedback, writer: BlockWriter
) -> ExportReport:
    """Write the best poses of a project and what its adjustment left; warnings are told.

    Raises
    ------
    ExportError
        If another layer was chosen, or the format cannot hold the block.
    """
    from exports.poses.poses import site_with_poses

    site = site_with_poses(source)
    ties, points = site.tracks()
    report = writer(site, target, ties=ties, points=points)
    for warning in report.warnings:
        feedback.warn(warning)
    return report


def block_report(site: SiteLayers, found: SiteBlock) -> ExportReport:
    """Report of a block that was written."""
    return ExportReport(
        crs=CRS_OF_FRAME, height_kind="ellipsoidal", features=len(found.block.shots),
        warnings=(*site.warnings, *found.warnings),
    )  # fmt: skip
