"""What several tools share: a project's frame, ground and oriented photos as model values."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from georef_gis.errors import InputError
from georef_gis.geodesy import Height, HeightKind, MapFrame, metres_per_unit
from georef_gis.model.layers import Footprint
from georef_gis.model.photo import Geotag, OrientedPhoto
from georef_gis.model.terrain import DemTerrain, FlatTerrain, Terrain
from georef_gis.project import Project
from georef_gis.project.records import camera_of, footprint_of, load_frame, photo_of, pose_of
from processing_algorithms.dem import read_dem

# later kinds stand for better poses
POSE_KINDS = ("tags", "navigation", "adjusted")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Site:
    """Oriented photos over the ground of a project, in the order of the database."""

    frame: MapFrame
    terrain: Terrain
    photos: dict[str, OrientedPhoto]
    pose_kinds: dict[str, str]
    doubts: dict[str, list[str]]

    @property
    def gsd_unit(self) -> float:
        """Metres per unit of the map."""
        return metres_per_unit(self.frame.horizontal)


def load_site(project: Project, *, quick: bool = False) -> Site:
    """Site with the best pose of every photo; with `quick` the tags' own.

    Raises
    ------
    InputError
        If no photo has a pose.
    """
    database = project.database
    frame = load_frame(database)
    cameras = {row["camera_id"]: camera_of(row) for row in database.rows("camera")}
    poses: dict[str, Any] = {}
    for kind in POSE_KINDS[:1] if quick else POSE_KINDS:
        poses |= {row["photo_id"]: row for row in database.rows("pose", {"kind": kind})}
    photos, kinds, doubts = {}, {}, {}
    for row in database.rows("photo"):
        pose = poses.get(row["photo_id"])
        if pose is None:
            continue
        photo = photo_of(row)
        camera = cameras[photo.camera_id].turned((pose["extra"] or {}).get("turned_deg", 0))
        oriented = OrientedPhoto(photo=photo, camera=camera, pose=pose_of(pose))
        photos[photo.id] = oriented
        kinds[photo.id] = pose["kind"]
        doubts[photo.id] = [*(row["doubts"] or ()), *(pose["doubts"] or ())]
    if not photos:
        raise InputError("no photo has a pose; run `georef run`", source=str(database.path))
    terrain = _ground_of(kinds.values(), load_ground(project, frame), project)
    return Site(frame=frame, terrain=terrain, photos=photos, pose_kinds=kinds, doubts=doubts)


def middle_of(tags: Sequence[Geotag]) -> tuple[float, float]:
    """Latitude and longitude, rad, amid positions: the median, across the 180th meridian too."""
    lat = float(np.median([tag.lat for tag in tags]))
    first = tags[0].lon
    turn = 2.0 * np.pi
    east = [(tag.lon - first + np.pi) % turn - np.pi for tag in tags]
    lon = (first + float(np.median(east)) + np.pi) % turn - np.pi
    return lat, float(lon)


def load_footprints(project: Project) -> dict[str, Footprint]:
    """Footprints of the project by photo.

    Raises
    ------
    InputError
        If there are none.
    """
    rows = project.database.rows("footprint")
    if not rows:
        raise InputError(
            "no footprints were made yet; run `georef run`", source=str(project.database.path)
        )
    return {row["photo_id"]: footprint_of(row) for row in rows}


# -- ground ------------------------------------------------------------------------------------


def ground_facts(terrain: Terrain, source: str, dem: Path | None) -> dict[str, Any]:
    """JSON-able description of the ground for the project database."""
    facts: dict[str, Any] = {"source": source, "sigma_m": terrain.sigma}
    if isinstance(terrain, FlatTerrain):
        return {**facts, "kind": "flat", "height_ellipsoidal_m": terrain.height_ellipsoidal}
    return {**facts, "kind": "dem", "path": str(dem)}


def _ground_of(kinds: Iterable[str], terrain: Terrain, project: Project) -> Terrain:
    """Ground with its sigma as poses of these kinds see it.

    Poses from tags share the height error of a ground that is made of the same tags; others do not.
    """
    shared = project.database.meta("ground", {}).get("sigma_shared_m", 0.0)
    if not shared or all(kind == "tags" for kind in kinds):
        return terrain
    if not isinstance(terrain, FlatTerrain | DemTerrain):
        return terrain
    return replace(terrain, sigma=float(np.hypot(terrain.sigma, shared)))


def load_ground(project: Project, frame: MapFrame) -> Terrain:
    """Ground that the orientation of the photos settled on.

    Raises
    ------
    InputError
        If the photos were not oriented yet.
    """
    facts = project.database.meta("ground")
    if facts is None:
        raise InputError(
            "the photos have no poses yet; run `georef run`", source=str(project.database.path)
        )
    if facts["kind"] == "flat":
        return FlatTerrain(
            origin=frame.origin,
            height_ellipsoidal=facts["height_ellipsoidal_m"],
            sigma=facts["sigma_m"],
        )
    positions = [
        [row["x_enu"], row["y_enu"], row["z_enu"]] for row in project.database.rows("pose")
    ]
    # before there is any pose the origin, which lies amid the flight, stands for them
    dem = read_dem(project, frame, np.array(positions or [[0.0, 0.0, 0.0]]))
    return dem.terrain(facts.get("dem_unit_m", dem.unit or 1.0))


def stated_ground_height(project: Project) -> Height | None:
    """Height of the ground that project.toml states."""
    ground = project.settings.ground
    if ground.height_m is None:
        return None
    return Height(
        value=ground.height_m,
        kind=HeightKind(ground.height_kind),
        geoid=project.settings.gnss.geoid,
    )
