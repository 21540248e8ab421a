"""Reads what is to be exported from the project database."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from exports.site_values import SitePhoto
from georef_gis.errors import ExportError
from georef_gis.project.records import camera_of, footprint_of, load_frame, photo_of, pose_of

if TYPE_CHECKING:
    from georef_gis.model.pose import Pose
    from georef_gis.project import Project

Row = Mapping[str, Any]
# The best pose of a photo is the last of these that it has.
POSE_KINDS = ("tags", "navigation", "adjusted")


def read_site(project: Project) -> dict[str, Any]:
    """What a project's database and products hold: the fields of `SiteValues`.

    Raises
    ------
    ExportError
        If it has no photos yet.
    """
    database = project.database
    if not database.count("photo"):
        raise ExportError(f"{project.folder}: has no photos yet; run `georef run` first")
    prints = [row for row in database.rows("footprint") if row["geom"] is not None]
    used = {row["photo_id"]: row["pose_kind"] for row in prints}
    poses = _poses(database.rows("pose"), used)
    ground = database.meta("ground") or {}
    mosaic = project.products / "mosaic.tif"
    shown = project.settings.products.mosaic and mosaic.is_file()
    return dict(
        name=project.settings.project.name or project.folder.name,
        frame=load_frame(database),
        photos=tuple(
            _site_photo(project, row, poses.get(row["photo_id"]), ground)
            for row in database.rows("photo")
            if row["status"] != "refused"
        ),
        footprints=tuple(footprint_of(row) for row in prints),
        cameras=tuple(camera_of(row) for row in database.rows("camera")),
        mosaic=mosaic if shown else None,
        epoch_gps=float(database.meta("epoch") or 0.0),
        facts=_facts(database.rows("run")),
    )


def _poses(rows: Sequence[Row], used: Mapping[str, str]) -> dict[str, Row]:
    """Pose of every photo: that of its footprint, so that the two agree, else the best."""
    best: dict[str, Row] = {}
    for row in sorted(rows, key=_rank):
        if row["status"] != "refused":
            chosen = best.get(row["photo_id"])
            if chosen is None or chosen["kind"] != used.get(row["photo_id"]):
                best[row["photo_id"]] = row
    return best


def _rank(row: Row) -> int:
    return POSE_KINDS.index(row["kind"]) if row["kind"] in POSE_KINDS else -1


def _site_photo(project: Project, row: Row, pose: Row | None, ground: Row) -> SitePhoto:
    photo = replace(photo_of(row), path=project.path(row["path"]))
    if pose is None:
        return SitePhoto(photo=photo)
    # A doubt that the photo has already is not told twice.
    doubts = tuple(d for d in pose["doubts"] or () if d not in photo.doubts)
    found = pose_of(pose)
    return SitePhoto(
        photo=photo,
        pose=found,
        height_above_ground=pose["height_above_ground_m"],
        sigma_above_ground=_sigma_above_ground(found, ground),
        doubts=doubts,
    )


def _sigma_above_ground(pose: Pose, ground: Row) -> float | None:
    """One sigma of a camera's height above the ground, m; None where the ground's is not known."""
    if "sigma_m" not in ground:
        return None
    # Only poses from tags share the error of a ground that is made of the same tags.
    apart = 0.0 if pose.kind == "tags" else ground.get("sigma_shared_m", 0.0)
    return math.sqrt(float(pose.covariance[2, 2]) + ground["sigma_m"] ** 2 + apart**2)


def _facts(runs: Sequence[Row]) -> dict[str, str]:
    """Figures of the last runs, such as the GSD and the covered area of the mosaic."""
    facts: dict[str, str] = {}
    for row in runs:
        summary = row["summary"]
        if row["outcome"] != "done" or not isinstance(summary, Mapping):
            continue
        for key in ("gsd_m", "covered_m2"):
            if isinstance(summary.get(key), int | float):
                facts[f"{row['tool']}_{key}"] = f"{summary[key]:.6g}"
    return facts
