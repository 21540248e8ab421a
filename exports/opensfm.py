"""Exporter of cameras and poses to OpenSfM and OpenDroneMap: reconstruction.json."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from georef_gis.errors import ExportError, InputError
from georef_gis.toolbox import Exporter, ExportReport, Feedback, LayerSource
from georef_gis.toolbox import parameters as p

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np

    from exports.site import SiteLayers, SitePhoto
    from georef_gis.model.camera import Camera
    from georef_gis.model.interchange.block import Block, BlockPoints
    from georef_gis.model.pose import Pose
    from georef_gis.model.tie_points import GroundPoints, TiePoints
    from georef_gis.project import Project

CRS_OF_FRAME = "topocentric (east, north, up) at an origin in EPSG:4979"


class OpenSfmOptions(p.Parameters):
    """Options of reconstruction.json."""


class OpenSfm(Exporter[OpenSfmOptions]):
    """Cameras and poses as OpenSfM's reconstruction.json, which OpenDroneMap uses too.

    The frame is east, north, up at reference_lla; its altitude is above the ellipsoid. What the
    format cannot hold (covariances) stands under the key georef_gis, which OpenSfM passes over.
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
        site, turned = block_site(source)
        report = write_opensfm(site, target, turned=turned)
        for warning in report.warnings:
            feedback.warn(warning)
        return report


def write_opensfm(
    site: SiteLayers,
    target: Path,
    *,
    turned: Mapping[str, int] | None = None,
    ties: TiePoints | None = None,
    points: GroundPoints | None = None,
) -> ExportReport:
    """`reconstruction.json` of a site.

    Parameters
    ----------
    turned
        Degrees clockwise by which a photo's pixels were turned after exposure, by photo id.
    ties, points
        Of an adjustment, if there is one.

    Raises
    ------
    ExportError
        If there is no pose, or a camera that the format cannot hold.
    """
    from georef_gis.model.interchange.block import losses
    from georef_gis.model.interchange.opensfm import PROGRAM, block_to_opensfm

    block = block_of_site(site, turned=turned or {}, ties=ties, points=points)
    try:
        data = block_to_opensfm(block)
    except InputError as error:
        raise ExportError(str(error)) from error
    with target.open("w", encoding="utf-8") as stream:
        json.dump(data, stream, ensure_ascii=False, allow_nan=False, indent=1)
    warnings = tuple(w for camera in block.cameras.values() for w in losses(camera, PROGRAM))
    return ExportReport(
        crs=CRS_OF_FRAME, height_kind="ellipsoidal", features=len(block.shots), warnings=warnings
    )


# -- a site as a block -------------------------------------------------------------------------


def block_site(source: LayerSource) -> tuple[SiteLayers, dict[str, int]]:
    """Site with the best poses, and by how many degrees pixels were turned, by photo id.

    Raises
    ------
    ExportError
        If the layer has no poses.
    """
    from exports.site import SiteLayers
    from exports.tagged_photos import with_best_poses

    if source.layer not in ("photos", "poses"):
        raise ExportError(f"layer {source.layer} has no poses; use poses")
    site = with_best_poses(SiteLayers.from_project(source.project), source.project)
    return site, _turned(source.project)


def _turned(project: Project) -> dict[str, int]:
    """All poses of a photo are of the same pixels, so any of them tells."""
    return {
        row["photo_id"]: int((row["extra"] or {}).get("turned_deg", 0))
        for row in project.database.rows("pose")
        if row["status"] != "refused"
    }


def block_of_site(
    site: SiteLayers,
    *,
    turned: Mapping[str, int],
    ties: TiePoints | None = None,
    points: GroundPoints | None = None,
) -> Block:
    """A site's photos that have a pose, as a block in the project's enu.

    Raises
    ------
    ExportError
        If none has, or a photo's camera is not known.
    """
    from georef_gis.geodesy import HeightKind
    from georef_gis.model.interchange.block import Block, Shot

    posed = [one for one in site.photos if one.pose is not None]
    if not posed:
        raise ExportError("no photo has a pose yet; run `georef run` first")
    names = shot_names(posed)
    known = {camera.id: camera for camera in site.cameras}
    cameras: dict[str, Camera] = {}
    shots = []
    for one, name in zip(posed, names, strict=True):
        pose = _pose_of(one)
        camera = _camera_of(one, known, turned.get(one.photo.id, 0))
        cameras.setdefault(camera.id, camera)
        time = one.photo.time_gps
        shots.append(
            Shot(
                name=name,
                camera_id=camera.id,
                origin=pose.origin_enu,
                R_world_from_cam=pose.R_enu_from_cam,
                covariance=_absolute(pose),
                time_unix=None if time is None else _unix(site.epoch_gps + time),
            )
        )
    by_id = {one.photo.id: name for one, name in zip(posed, names, strict=True)}
    return Block(
        cameras=cameras,
        shots=tuple(shots),
        origin=site.frame.origin,
        height_kind=HeightKind.ELLIPSOIDAL,
        datum=str(site.frame.gnss_datum),
        points=None if ties is None or points is None else _points(ties, points, by_id),
        source=site.name,
    )


def shot_names(posed: Sequence[SitePhoto]) -> list[str]:
    """File names of photos; with their folders where two have the same."""
    paths = [one.photo.path for one in posed]
    names = [path.name for path in paths]
    if len({name.casefold() for name in names}) < len(names):
        base = os.path.commonpath([path.parent for path in paths])
        names = [path.relative_to(base).as_posix() for path in paths]
    return names


def _pose_of(one: SitePhoto) -> Pose:
    if one.pose is None:
        raise ExportError(f"{one.photo.id}: has no pose")
    return one.pose


def _camera_of(one: SitePhoto, known: Mapping[str, Camera], degrees: int) -> Camera:
    from dataclasses import replace

    camera = known.get(one.photo.camera_id)
    if camera is None:
        raise ExportError(f"{one.photo.id}: its camera {one.photo.camera_id!r} is not known")
    if not degrees:
        return camera
    try:
        # The stored pixels are what other programs see.
        return replace(camera.turned(degrees), id=f"{camera.id} turned {degrees}")
    except InputError as error:
        raise ExportError(str(error)) from error


def _absolute(pose: Pose) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Covariance with the height above the ellipsoid in place of that above the ground."""
    out = pose.covariance.copy()
    out[2, 2] += pose.sigma_height_shared**2
    return out


def _unix(gps: float) -> float:
    from georef_gis.units import utc_from_gps

    return utc_from_gps(gps).timestamp()


def _points(ties: TiePoints, points: GroundPoints, names: Mapping[str, str]) -> BlockPoints:
    """Adjusted points with the observations of the photos that are in the block."""
    from dataclasses import replace

    import numpy as np

    from georef_gis.model.interchange.block import BlockPoints

    if ties.n_points != len(points):
        raise ExportError(
            f"the tie points are of {ties.n_points} points and the adjustment of {len(points)}; "
            "adjust again"
        )
    inside = np.array([photo_id in names for photo_id in ties.photo_ids], dtype=np.bool_)
    seen = inside[ties.photo] if len(ties.photo) else np.zeros(0, dtype=np.bool_)
    kept = np.bincount(ties.point[seen], minlength=len(points)) >= 2
    renamed = replace(
        ties.selected(seen),
        photo_ids=tuple(names.get(photo_id, photo_id) for photo_id in ties.photo_ids),
    )
    return BlockPoints(p=points.p_enu[kept], error_px=points.residual_px[kept], ties=renamed)
