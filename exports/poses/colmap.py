"""Exporter of cameras, poses and points to COLMAP: a text model in a folder."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from exports.poses.block_export import block_report, export_block
from georef_gis.errors import ExportError, InputError
from georef_gis.toolbox import Exporter, ExportReport, Feedback, LayerSource
from georef_gis.toolbox import parameters as p

if TYPE_CHECKING:
    from exports.site.site import SiteLayers
    from georef_gis.model.tie_points import GroundPoints, TiePoints

# The frame's origin and the covariances, which COLMAP's files cannot hold.
FRAME_FILE = "georef_frame.json"
# For `colmap model_aligner --ref_images_path ... --ref_is_gps 1`.
REFERENCES_FILE = "ref_images.txt"


class ColmapOptions(p.Parameters):
    """Options of a COLMAP model."""


class Colmap(Exporter[ColmapOptions]):
    """Cameras, poses and points as a COLMAP text model: cameras.txt, images.txt, points3D.txt.

    The world is east, north, up in m at the origin that georef_frame.json states; heights are
    above the ellipsoid. Points and tracks are those of the adjustment, where there is one. The
    target is a folder of its own.
    """

    id = "colmap"
    name = "COLMAP text model"
    suffix = ""
    accepts = ("vector",)
    target = "colmap"
    needs = ("photos", "poses")

    def write(
        self, source: LayerSource, target: Path, options: ColmapOptions, feedback: Feedback
    ) -> ExportReport:
        """Write the model to the folder `target`."""
        return export_block(source, target, feedback, write_colmap)


def write_colmap(
    site: SiteLayers,
    target: Path,
    *,
    ties: TiePoints | None = None,
    points: GroundPoints | None = None,
) -> ExportReport:
    """A text model in the folder `target`; parameters as of `opensfm.write_opensfm`.

    Raises
    ------
    ExportError
        If there is no pose, or a camera that the format cannot hold.
    """
    from exports.site.block import site_block
    from georef_gis.model.interchange import colmap

    found = site_block(site, colmap.PROGRAM, ties=ties, points=points)
    block = found.block
    unfit = [shot.name for shot in block.shots if any(sign.isspace() for sign in shot.name)]
    if unfit:
        # Its readers take the name up to the first blank.
        raise ExportError(
            f"COLMAP cannot hold names with blanks such as {unfit[0]!r} ({len(unfit)} photos); "
            "rename the photos"
        )
    target.mkdir(parents=True, exist_ok=True)
    try:
        _write(target / "cameras.txt", colmap.cameras_lines(block))
        _write(target / "images.txt", colmap.images_lines(block))
        _write(target / "points3D.txt", colmap.points_lines(block))
        _write(target / REFERENCES_FILE, colmap.references_lines(block))
        text = json.dumps(found.facts, ensure_ascii=False, allow_nan=False, indent=1)
    except InputError as error:
        raise ExportError(str(error)) from error
    (target / FRAME_FILE).write_text(text + "\n", encoding="utf-8")
    return block_report(site, found)


def _write(path: Path, lines: Iterable[str]) -> None:
    with path.open("w", encoding="utf-8", newline="\n") as stream:
        stream.writelines(line + "\n" for line in lines)
