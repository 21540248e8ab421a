"""What an adjustment leaves in a project: poses, cameras, flights, points, ground, a report."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from georef_gis.errors import GeometryError
from georef_gis.frames import Array
from georef_gis.model.pose import Pose
from georef_gis.model.terrain import DemTerrain, Terrain
from georef_gis.model.tin import TinTerrain
from georef_gis.orient.adjustment.adjust import Adjusted
from georef_gis.orient.adjustment.block import FLIGHT_NAMES
from georef_gis.orient.adjustment.checks import Check, Observability, observability
from georef_gis.orient.adjustment.distances import distance_sigmas
from georef_gis.orient.adjustment.keep import BAND, COVARIANCE, save_adjusted
from georef_gis.orient.surface import Surface, fit_surface
from georef_gis.orient.surface_trust import trusted
from georef_gis.project import Project
from georef_gis.project.records import camera_row, pose_row
from georef_gis.project.surface_file import SURFACE, save_surface
from georef_gis.toolbox import Context
from processing_algorithms.orient.blocks import Prepared
from processing_algorithms.site import Site, ground_facts

REPORT = "report.json"
ADJUSTED = "adjusted"
# values that were weighed down and are told one by one
MOST_DOUBTED = 8
_COMPONENTS = ("east", "north", "height", "angle about east", "angle about north", "heading")


@dataclass(frozen=True, slots=True, kw_only=True)
class Kept:
    """Files and words of a kept adjustment."""

    files: dict[str, Path]
    summary: dict[str, Any]
    doubts: list[str]
    notes: list[str]


def forget(project: Project) -> None:
    """Drop an earlier adjustment: the direct result stays."""
    database = project.database
    with database.transaction():
        database.delete_rows("pose", {"kind": "adjusted"})
        for row in database.rows("camera"):
            if (row["extra"] or {}).get("adjusted_of"):
                database.delete_rows("camera", {"camera_id": row["camera_id"]})
        for row in database.rows("flight"):
            if (row["extra"] or {}).get("adjusted_of"):
                database.delete_rows("flight", {"flight_id": row["flight_id"]})
        database.set_meta(ground_adjusted=None, adjustment=None)
    for name in (REPORT, SURFACE, COVARIANCE, BAND, "points.npz", "residuals.npz"):
        (project.adjustment / name).unlink(missing_ok=True)


def save(
    context: Context,
    site: Site,
    prepared: Prepared,
    adjusted: Adjusted,
    checks: Sequence[Check],
    notes: Sequence[str],
    *,
    two_step: dict[str, Any] | None = None,
) -> Kept:
    """Keep an adjustment in the project."""
    project = context.require_project()
    forget(project)
    project.adjustment.mkdir(exist_ok=True)
    stored = [prepared.views.stored_pose(i, pose) for i, pose in enumerate(adjusted.poses)]
    ground = _surface(site, prepared, stored, adjusted)
    terrain = ground.terrain if ground is not None else site.terrain
    doubts = _doubts_by_photo(site, prepared, adjusted)
    files = save_adjusted(project.adjustment, adjusted)
    seen = observability(adjusted)
    rows = [
        _pose_row(project, site, prepared, stored[i], i, terrain, doubts[key], context.run_id)
        for i, key in enumerate(adjusted.block.photo_ids)
    ]
    _write_rows(project, prepared, adjusted, rows, ground)
    report = _report(prepared, adjusted, checks, seen, ground)
    report["two_step"] = two_step
    path = project.adjustment / REPORT
    part = path.with_name(path.name + ".part")
    part.write_text(json.dumps(report, indent=1), encoding="utf-8")
    part.replace(path)
    lines = [*notes, *_doubted_lines(adjusted), *_lone_lines(adjusted)]
    told = [check.told() for check in checks] + seen.told()
    told += list(ground.report.notes) if ground is not None else []
    summary = _summary(adjusted, seen, ground, lines)
    out = {name: path for name, path in files.items()} | {"report": path}
    if ground is not None and (project.adjustment / SURFACE).exists():
        out["surface"] = project.adjustment / SURFACE
    return Kept(files=out, summary=summary, doubts=lines, notes=told)


# -- ground ------------------------------------------------------------------------------------


def _surface(
    site: Site, prepared: Prepared, stored: Sequence[Pose], adjusted: Adjusted
) -> Surface | None:
    """Ground of the adjusted points, None where they carry none."""
    if not len(adjusted.points):
        return None
    dem = site.terrain if isinstance(site.terrain, DemTerrain) else None
    try:
        area = _area(prepared, stored, adjusted)
        return fit_surface(
            trusted(adjusted.points), site.frame.origin, area, dem=dem, block_tilt=_tilt(adjusted)
        )
    except GeometryError:
        return None


def _tilt(adjusted: Adjusted) -> float:
    """One sigma of the tilt of the block as a whole, rad: no less than that of its best photo."""
    covariance = np.array([pose.covariance for pose in adjusted.poses])
    return float(np.sqrt(np.median(covariance[:, 3, 3] + covariance[:, 4, 4]) / 2.0))


def _area(prepared: Prepared, stored: Sequence[Pose], adjusted: Adjusted) -> Array:
    """Places under the borders of the photos at the height of the points; (n, 2), m."""
    z = float(np.nanmedian(adjusted.points.p_enu[:, 2]))
    out = []
    for view, pose in zip(prepared.views.photos, adjusted.poses, strict=True):
        d = pose.enu_directions(view.camera.ray(view.camera.border_uv()))
        down = d[:, 2] < -0.1
        t = (z - pose.origin_enu[2]) / d[down, 2]
        out.append(pose.origin_enu[:2] + t[:, None] * d[down, :2])
    return np.vstack(out) if out else np.zeros((0, 2))


# -- rows --------------------------------------------------------------------------------------


def _pose_row(
    project: Project,
    site: Site,
    prepared: Prepared,
    pose: Pose,
    index: int,
    terrain: Terrain,
    doubts: list[str],
    run_id: int | None,
) -> dict[str, Any]:
    key = prepared.block.photo_ids[index]
    photo = site.photos[key].photo
    ground = float(terrain.z_at(pose.origin_enu[:2]))
    above = float(pose.origin_enu[2]) - ground
    row = pose_row(
        key, pose, site.frame, height_above_ground=above if math.isfinite(above) else math.nan,
        dialect=ADJUSTED, doubts=doubts, turned_deg=prepared.turned[key],
    )  # fmt: skip
    camera_id = photo.camera_id
    if camera_id not in prepared.views.held:
        row["extra"] = {**row["extra"], "camera_id": adjusted_id(camera_id)}
    return {**row, "time_gps": photo.time_gps, "run_id": run_id}


def adjusted_id(camera_id: str) -> str:
    """Id of a camera or flight as adjusted, beside the one that it came from."""
    return f"{camera_id} {ADJUSTED}"


def _write_rows(
    project: Project,
    prepared: Prepared,
    adjusted: Adjusted,
    poses: list[dict[str, Any]],
    ground: Surface | None,
) -> None:
    database = project.database
    spread = adjusted.covariances.shared()
    # before the rows that name it: a run that is killed leaves nothing that cannot be read
    if ground is not None and isinstance(ground.terrain, TinTerrain):
        save_surface(project.adjustment / SURFACE, ground.terrain)
    with database.transaction():
        database.replace_rows("pose", poses, where={"kind": "adjusted"})
        for k, camera in enumerate(adjusted.cameras):
            if camera.id in prepared.views.held:
                continue
            at = adjusted.block.camera_at(k)
            row = camera_row(replace(camera, id=adjusted_id(camera.id)), name=camera.id)
            row["covariance"] = spread[at : at + 11, at : at + 11].tolist()
            row["extra"] = {**row["extra"], "adjusted_of": camera.id}
            database.replace_rows("camera", [row], where={"camera_id": row["camera_id"]})
        for k, flight in enumerate(adjusted.block.flights):
            values, covariance = adjusted.flight(k)
            database.replace_rows(
                "flight", [_flight_row(flight.id, values, covariance)],
                where={"flight_id": adjusted_id(flight.id)},
            )  # fmt: skip
        facts = None
        if ground is not None:
            dem = project.settings.ground.dem
            facts = ground_facts(
                ground.terrain, f"adjusted points ({ground.report.kind})",
                project.path(dem) if dem else None, bias=ground.report.bias,
            )  # fmt: skip
            before = database.meta("ground") or {}
            if "dem_unit_m" in before:
                facts["dem_unit_m"] = before["dem_unit_m"]
        database.set_meta(ground_adjusted=facts, adjustment={"control_points": _used(prepared)})


def _used(prepared: Prepared) -> list[str]:
    """Names of the points that the block was adjusted to."""
    control, block = prepared.control, prepared.block.control
    if control is None or block is None:
        return []
    seen = sorted({int(i) for i in block.point})
    return [control.names[i] for i in seen if control.role[i] == "control"]


def _flight_row(flight_id: str, values: Array, covariance: Array) -> dict[str, Any]:
    return {
        "flight_id": adjusted_id(flight_id),
        "name": flight_id,
        "clock_offset_s": float(values[9]),
        "clock_sigma_s": float(np.sqrt(max(covariance[9, 9], 0.0))),
        "bias_enu": values[6:9].tolist(),
        "bias_covariance": covariance[6:9, 6:9].tolist(),
        "boresight": values[3:6].tolist(),
        "extra": {
            "adjusted_of": flight_id,
            "lever_arm_step_m": values[:3].tolist(),
            "names": list(FLIGHT_NAMES),
            "covariance": covariance.tolist(),
        },
    }


# -- words -------------------------------------------------------------------------------------


def _doubts_by_photo(site: Site, prepared: Prepared, adjusted: Adjusted) -> dict[str, list[str]]:
    """What is doubtful about each adjusted pose; the tags' own doubts are settled by the pixels."""
    _, count = adjusted.rms_by_photo()
    out: dict[str, list[str]] = {}
    for i, key in enumerate(adjusted.block.photo_ids):
        out[key] = []
        if count[i] == 0:
            pose_doubts = [d for d in site.doubts[key] if d not in site.photos[key].photo.doubts]
            out[key] = [
                "no tie point connects it: direct pose, corrected by what its flight learned",
                *pose_doubts,
            ]
    return out


def _lone_lines(adjusted: Adjusted) -> list[str]:
    _, count = adjusted.rms_by_photo()
    lone = [key for key, n in zip(adjusted.block.photo_ids, count, strict=True) if n == 0]
    if not lone:
        return []
    some = ", ".join(lone[:5]) + (" ..." if len(lone) > 5 else "")
    if len(lone) == 1:
        return [f"1 photo is not connected and keeps its direct pose: {some}"]
    return [f"{len(lone)} photos are not connected and keep their direct pose: {some}"]


def _doubted_lines(adjusted: Adjusted) -> list[str]:
    worst: dict[tuple[int, int], float] = {}
    for d in adjusted.doubted:
        worst[d.photo, d.component] = max(worst.get((d.photo, d.component), 0.0), d.sigmas)
    lines = [
        f"{adjusted.block.photo_ids[i]}: its {_COMPONENTS[c]} lies {s:.0f} sigma off the rest of "
        "its flight and was weighed down"
        for (i, c), s in sorted(worst.items(), key=lambda item: -item[1])
    ]
    more = len(lines) - MOST_DOUBTED
    if more > 0:
        words = "1 more value was" if more == 1 else f"{more} more values were"
        told = f"... and {words} weighed down: all are in adjustment/{REPORT}, weighed_down"
        lines = [*lines[:MOST_DOUBTED], told]
    return lines


def _summary(
    adjusted: Adjusted, seen: Observability, ground: Surface | None, doubts: list[str]
) -> dict[str, Any]:
    rms, count = adjusted.rms_by_photo()
    used = count > 0
    sigma = [np.sqrt(np.diag(pose.covariance)) for pose in adjusted.poses]
    return {
        "used": True,
        "photos": int(used.sum()),
        "points": len(adjusted.points),
        "observations": len(adjusted.problem.ties.photo),
        "wrong_matches": int(adjusted.removed.sum()),
        "rms_px": round(float(np.median(rms[used])), 3) if np.any(used) else None,
        "sigma0": round(adjusted.sigma0, 3),
        "sigma_position_m": [round(float(v), 3) for v in np.median(sigma, axis=0)[:3]],
        "sigma_angle_deg": [round(float(np.degrees(v)), 4) for v in np.median(sigma, axis=0)[3:]],
        "focal_px": [round(float(c.fx), 2) for c in adjusted.cameras],
        "ground": ground.report.kind if ground is not None else "as before",
        "held_by_prior": [u.name for u in seen.unknowns if u.held],
        "doubts": doubts,
    }


def _report(
    prepared: Prepared,
    adjusted: Adjusted,
    checks: Sequence[Check],
    seen: Observability,
    ground: Surface | None,
) -> dict[str, Any]:
    """Everything that the report page shows, as plain values."""
    rms, count = adjusted.rms_by_photo()
    photos = []
    for i, key in enumerate(adjusted.block.photo_ids):
        sigma = np.sqrt(np.diag(adjusted.poses[i].covariance))
        moved = adjusted.poses[i].origin_enu - prepared.block.poses[i].origin_enu
        photos.append(
            {
                "photo": key,
                "observations": int(count[i]),
                "rms_px": float(rms[i]) if count[i] else None,
                "wrong_matches": int(adjusted.removed[i]),
                "sigma_m": sigma[:3].tolist(),
                "sigma_deg": np.degrees(sigma[3:]).tolist(),
                "moved_m": moved.tolist(),
                "origin_enu": adjusted.poses[i].origin_enu.tolist(),
                "turned_deg": prepared.turned[key],
            }
        )
    return {
        "sigma0": adjusted.sigma0,
        "converged": adjusted.solution.converged,
        "points": len(adjusted.points),
        "observations": len(adjusted.problem.ties.photo),
        "wrong_matches": int(adjusted.removed.sum()),
        "photos": photos,
        "checks": [asdict(check) for check in checks],
        "observability": seen.as_json(),
        "control": _control_report(prepared, adjusted),
        "distances": [asdict(d) for d in distance_sigmas(adjusted.points, adjusted.covariances)],
        "ground": {"kind": ground.report.kind, **ground.report.facts()} if ground else None,
        "weighed_down": [
            {
                "photo": adjusted.block.photo_ids[d.photo],
                "what": _COMPONENTS[d.component],
                "sigmas": d.sigmas,
            }
            for d in adjusted.doubted
        ],
    }


def _control_report(prepared: Prepared, adjusted: Adjusted) -> list[dict[str, Any]]:
    """Surveyed against adjusted place of every marked point, and its pixels' residuals."""
    control, source = adjusted.block.control, prepared.control
    if control is None or source is None:
        return []
    out = []
    for row, index in enumerate(adjusted.problem.marked):
        known = np.isfinite(control.sigma[index])
        off = np.where(known, adjusted.control_places[row] - control.p_enu[index], np.nan)
        mine = adjusted.problem.mark_of >= 0
        marks = np.flatnonzero(mine)
        here = marks[control.point[adjusted.problem.mark_of[marks]] == index]
        r = adjusted.residuals[here]
        out.append(
            {
                "name": control.names[index],
                "role": source.role[index],
                "off_m": [float(v) if math.isfinite(v) else None for v in off],
                "sigma_m": np.sqrt(np.diag(adjusted.control_covariance[row])).tolist(),
                "survey_sigma_m": [
                    float(v) if math.isfinite(v) else None for v in control.sigma[index]
                ],
                "rays": len(here),
                "rms_px": float(np.sqrt(np.nanmean(r**2))) if len(here) else None,
            }
        )
    return out
