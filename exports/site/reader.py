"""Reads what is to be exported from the project database."""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from exports.site.values import SiteControl, SitePhoto
from georef_gis.errors import ExportError, InputError
from georef_gis.project.asset_layers import ASSETS_FILE, AssetTable, read_asset_tables
from georef_gis.project.records import camera_of, footprint_of, load_frame, photo_of, pose_of

if TYPE_CHECKING:
    from pathlib import Path

    from georef_gis.geodesy import MapFrame
    from georef_gis.model.pose import Pose
    from georef_gis.project import Project

Row = Mapping[str, Any]
# The best pose of a photo is the last of these that it has.
POSE_KINDS = ("tags", "navigation", "adjusted")
POINTS, REPORT = "points.npz", "report.json"


def read_site(project: Project, *, best: bool = False) -> dict[str, Any]:
    """What a project's database and products hold: the fields of `SiteValues`.

    Parameters
    ----------
    best
        The best pose of every photo, also where its footprint was made from another.

    Raises
    ------
    ExportError
        If it has no photos yet.
    """
    database = project.database
    if not database.count("photo"):
        raise ExportError(f"{project.folder}: has no photos yet; run `georef run` first")
    prints = [row for row in database.rows("footprint") if row["geom"] is not None]
    used = {} if best else {row["photo_id"]: row["pose_kind"] for row in prints}
    poses = _poses(database.rows("pose"), used)
    kinds = [row["kind"] for row in poses.values()]
    adjusted = 2 * kinds.count("adjusted") > len(kinds)
    report = _report(project.adjustment / REPORT) if adjusted else {}
    grounds = _Grounds(
        direct=database.meta("ground") or {},
        adjusted=database.meta("ground_adjusted") or {},
        told={row["photo"]: row for row in report.get("photos", ())},
    )
    mosaic = project.products / "mosaic.tif"
    shown = project.settings.products.mosaic and mosaic.is_file()
    accuracy, warnings = read_accuracy(project)
    kept = (project.adjustment / POINTS).is_file()
    if adjusted and not kept:
        warnings += (
            f"{project.adjustment / POINTS} is not there: no tie points are written; run "
            "`georef adjust --force`",
        )
    frame = load_frame(database)
    return dict(
        name=project.settings.project.name or project.folder.name,
        frame=frame,
        photos=tuple(
            _site_photo(project, row, poses.get(row["photo_id"]), grounds)
            for row in database.rows("photo")
            if row["status"] != "refused"
        ),
        footprints=tuple(footprint_of(row) for row in prints),
        cameras=tuple(camera_of(row) for row in database.rows("camera")),
        mosaic=mosaic if shown else None,
        epoch_gps=float(database.meta("epoch") or 0.0),
        facts=_facts(database.rows("run")) | grounds.facts(kinds) | _adjustment_facts(report),
        control=_control(database.rows("control"), database.rows("mark"), report),
        assets=_assets(project, frame),
        adjustment=project.adjustment if (adjusted and kept) else None,
        accuracy=accuracy,
        warnings=warnings,
    )


def _assets(project: Project, frame: MapFrame) -> tuple[AssetTable, ...]:
    """Mapped assets.

    Raises
    ------
    ExportError
        If their file cannot be read.
    """
    try:
        return read_asset_tables(project.folder / ASSETS_FILE, frame.horizontal.to_wkt())
    except InputError as error:
        raise ExportError(str(error)) from error


def _report(path: Path) -> dict[str, Any]:
    """Report of the adjustment; empty where there is none.

    Raises
    ------
    ExportError
        If it cannot be read.
    """
    if not path.exists():
        return {}
    try:
        return dict(json.loads(path.read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError) as error:
        raise ExportError(
            f"{path}: cannot be read ({error}); run `georef adjust --force`"
        ) from error


def _adjustment_facts(report: Row) -> dict[str, str]:
    """Figures of the adjustment for people."""
    names = ("points", "observations", "wrong_matches", "sigma0")
    return {
        f"adjustment_{name}": f"{report[name]:.6g}"
        for name in names
        if isinstance(report.get(name), int | float)
    }


# -- photos ------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class _Grounds:
    """Facts of the direct and of the adjusted ground, and what the adjustment told by photo."""

    direct: Row
    adjusted: Row
    told: Mapping[str, Row]

    def facts(self, kinds: Sequence[str]) -> dict[str, str]:
        """What the ground is made of that most poses of these kinds go with."""
        mostly = 2 * kinds.count("adjusted") > len(kinds)
        ground = self.adjusted if mostly and self.adjusted else self.direct
        if "source" not in ground:
            return {}
        return {"ground": f"{ground['source']}, one sigma {ground['sigma_m']:.2f} m"}


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


def _site_photo(project: Project, row: Row, pose: Row | None, grounds: _Grounds) -> SitePhoto:
    photo = replace(photo_of(row), path=project.path(row["path"]))
    if pose is None:
        return SitePhoto(photo=photo)
    # A doubt that the photo has already is not told twice.
    doubts = tuple(d for d in pose["doubts"] or () if d not in photo.doubts)
    found, extra = pose_of(pose), pose["extra"] or {}
    told = grounds.told.get(photo.id, {}) if found.kind == "adjusted" else {}
    return SitePhoto(
        photo=photo,
        pose=found,
        height_above_ground=pose["height_above_ground_m"],
        sigma_above_ground=sigma_above_ground(found, grounds.direct, grounds.adjusted),
        doubts=doubts,
        posed_camera_id=extra.get("camera_id", ""),
        turned_deg=int(extra.get("turned_deg", 0)) % 360,
        tie_points=told.get("observations"),
        residual_px=told.get("rms_px"),
    )


def sigma_above_ground(pose: Pose, direct: Row, adjusted: Row) -> float | None:
    """One sigma of a camera's height above the ground that its pose goes with, m.

    None where the ground's is not known. An error of the level that camera and ground share is
    no part of it: that of a flat ground made of the same tags, or of the adjusted surface where
    the pose holds it apart (`Pose.sigma_height_shared`).
    """
    held = pose.kind == "adjusted" and pose.sigma_height_shared > 0.0
    if pose.kind == "adjusted" and adjusted:
        # `sigma_m` of an adjusted surface has the shared part in it
        shared = adjusted.get("sigma_shared_m", 0.0) if held else 0.0
        ground = max(adjusted["sigma_m"] ** 2 - shared**2, 0.0)
        return math.sqrt(float(pose.covariance[2, 2]) + ground)
    if "sigma_m" not in direct:
        return None
    apart = 0.0 if pose.kind == "tags" or held else direct.get("sigma_shared_m", 0.0)
    return math.sqrt(float(pose.covariance[2, 2]) + direct["sigma_m"] ** 2 + apart**2)


# -- control -----------------------------------------------------------------------------------


def _control(rows: Sequence[Row], marks: Sequence[Row], report: Row) -> tuple[SiteControl, ...]:
    """Surveyed points that have a place, with what the adjustment tells of them."""
    import numpy as np

    count: dict[str, int] = {}
    for mark in marks:
        count[mark["name"]] = count.get(mark["name"], 0) + 1
    told = {row["name"]: row for row in report.get("control") or ()}
    return tuple(
        SiteControl(
            name=row["name"],
            role=row["role"],
            p_map=np.array(struct.unpack_from("<ddd", row["geom"], 5)),
            sigma_h=row["sigma_h_m"],
            sigma_v=row["sigma_v_m"],
            marks=count.get(row["name"], 0),
            datum=row["datum"] or "",
            adjusted=told.get(row["name"]),
        )
        for row in rows
        if row["geom"] is not None
    )


# -- facts and accuracy ------------------------------------------------------------------------


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


def read_accuracy(project: Project) -> tuple[dict[str, str], tuple[str, ...]]:
    """Items of the accuracy statement of the products, and a warning if it is of older ones."""
    from exports.site.accuracy import STATEMENT, items_of_file

    path = project.products / STATEMENT
    if not path.is_file():
        return {}, ()
    last = _last_done(project.database.rows("run"), ("accuracy", "mosaic"))
    if last.get("mosaic", -1) > last.get("accuracy", math.inf):
        return {}, (
            f"{path.name} is of an older mosaic and left out; run `georef accuracy` and export "
            "again",
        )
    return items_of_file(path), ()


def _last_done(runs: Iterable[Row], tools: Sequence[str]) -> dict[str, int]:
    """Number of the last run of each tool that was done."""
    out: dict[str, int] = {}
    for row in runs:
        name = str(row["tool"]).rpartition(":")[2]
        if name in tools and row["outcome"] == "done":
            out[name] = max(out.get(name, -1), int(row["fid"]))
    return out
