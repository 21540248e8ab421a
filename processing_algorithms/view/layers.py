"""Layers of a project as GeoJSON in its own CRS, which GeoJSON's rules leave to those who agree."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from georef_gis.errors import InputError

if TYPE_CHECKING:
    from pathlib import Path

    from georef_gis.project import Project

Json = dict[str, Any]
# vertices of a trajectory on the screen; a log has 200 a second
_MOST_VERTICES = 4000
POSE_KINDS = ("tags", "navigation", "adjusted")


def layer(project: Project, name: str) -> Json:
    """A layer by its name, as a FeatureCollection.

    Raises
    ------
    InputError
        If there is no such layer.
    """
    makers: Mapping[str, Callable[[Project], Iterable[Json]]] = {
        "photos": _photos,
        "footprints": _footprints,
        "trajectory": _trajectory,
        "control": _control,
        "seams": _seams,
    }
    if name not in makers:
        raise InputError(f"no layer {name[:40]!r}; layers are {', '.join(makers)}")
    return {"type": "FeatureCollection", "features": list(makers[name](project))}


def best_poses(project: Project) -> dict[str, Json]:
    """Photo id -> row of its best pose."""
    poses: dict[str, Json] = {}
    for kind in POSE_KINDS:
        poses |= {row["photo_id"]: row for row in project.database.rows("pose", {"kind": kind})}
    return poses


def _feature(wkb: bytes | None, id: str, properties: Json) -> Json | None:
    import shapely

    if wkb is None:
        return None
    geometry = shapely.from_wkb(wkb)
    if geometry.is_empty or not all(map(math.isfinite, geometry.bounds)):
        return None
    content = json.loads(shapely.to_geojson(shapely.force_2d(geometry)))
    return {"type": "Feature", "id": id, "geometry": content, "properties": properties}


def _photos(project: Project) -> Iterable[Json]:
    """Where the photos were taken: by their best pose, else by their tag."""
    poses = best_poses(project)
    gsd = {row["photo_id"]: row["gsd_m"] for row in project.database.rows("footprint")}
    for row in project.database.rows("photo"):
        id = row["photo_id"]
        pose = poses.get(id)
        properties = {
            "photo": id, "name": row["name"], "flight": row["flight_id"],
            "camera": row["camera_id"], "gsd_m": gsd.get(id),
            "pose": pose["kind"] if pose else None,
            "doubts": [*(row["doubts"] or ()), *((pose or {}).get("doubts") or ())],
        }  # fmt: skip
        if pose:
            properties |= {
                key: pose[key]
                for key in ("sigma_h_m", "sigma_v_m", "height_above_ground_m", "roll_deg",
                            "pitch_deg", "yaw_deg")
            }  # fmt: skip
        made = _feature((pose or row)["geom"], id, properties)
        if made is not None:
            yield made


def _footprints(project: Project) -> Iterable[Json]:
    for row in project.database.rows("footprint"):
        properties = {
            "photo": row["photo_id"], "gsd_m": row["gsd_m"], "area_m2": row["area_m2"],
            "tilt_deg": row["tilt_deg"], "sigma_m": row["sigma_m"],
        }  # fmt: skip
        made = _feature(row["geom"], row["photo_id"], properties)
        if made is not None:
            yield made


def _control(project: Project) -> Iterable[Json]:
    marks: dict[str, int] = {}
    for row in project.database.rows("mark"):
        marks[row["name"]] = marks.get(row["name"], 0) + 1
    for row in project.database.rows("control"):
        properties = {
            "name": row["name"], "role": row["role"], "marks": marks.get(row["name"], 0),
            "sigma_h_m": row["sigma_h_m"], "sigma_v_m": row["sigma_v_m"],
        }  # fmt: skip
        made = _feature(row["geom"], row["name"], properties)
        if made is not None:
            yield made


def _seams(project: Project) -> Iterable[Json]:
    import shapely

    from georef_gis.project.records import load_frame
    from georef_gis.project.seam_layer import SEAMS_FILE, read_seams

    path = project.folder / SEAMS_FILE
    if not path.is_file():
        return
    photos = [row["photo_id"] for row in project.database.rows("photo")]
    wkt = load_frame(project.database).crs.to_wkt()
    for photo, area in read_seams(path, photos=photos, crs_wkt=wkt).cells:
        made = _feature(shapely.to_wkb(area), photo, {"photo": photo})
        if made is not None:
            yield made


def _trajectory(project: Project) -> Iterable[Json]:
    """Where the vehicle flew, by its trajectory; else from photo to photo in order of time."""
    table = project.navigation / "trajectory.csv"
    lines = [_trajectory_line(project, table)] if table.is_file() else _photo_lines(project)
    for number, line in enumerate(lines):
        points = [list(point) for point in line if all(map(math.isfinite, point))]
        if len(points) > 1:
            source = "trajectory" if table.is_file() else "photos in order of time"
            yield {
                "type": "Feature", "id": str(number), "properties": {"source": source},
                "geometry": {"type": "LineString", "coordinates": points},
            }  # fmt: skip


def _trajectory_line(project: Project, table: Path) -> Sequence[tuple[float, float]]:
    import numpy as np

    from georef_gis.project.records import load_frame

    with table.open(encoding="utf-8", newline="") as stream:
        rows = csv.DictReader(line for line in stream if not line.startswith("#"))
        geo = [(float(r["lat_deg"]), float(r["lon_deg"]), 0.0) for r in rows]
    if not geo:
        return ()
    every = max(1, len(geo) // _MOST_VERTICES)
    chosen = np.array(geo[::every])
    chosen[:, :2] = np.radians(chosen[:, :2])
    xy = load_frame(project.database).map_from_geo(chosen)[:, :2]
    return [(float(x), float(y)) for x, y in xy]


def _photo_lines(project: Project) -> list[list[tuple[float, float]]]:
    import shapely

    poses = best_poses(project)
    flights: dict[str, list[tuple[str, float, float]]] = {}
    for row in project.database.rows("photo"):
        wkb = (poses.get(row["photo_id"]) or row)["geom"]
        if wkb is None or not row["camera_clock"]:
            continue
        point = shapely.from_wkb(wkb)
        flight = flights.setdefault(row["flight_id"] or "", [])
        flight.append((row["camera_clock"], point.x, point.y))
    return [[(x, y) for _, x, y in sorted(flight)] for _, flight in sorted(flights.items())]
