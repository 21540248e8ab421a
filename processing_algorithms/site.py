"""What several tools share: a project's frame, ground and oriented photos as model values."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from georef_gis.errors import InputError
from georef_gis.geodesy import Height, HeightKind, MapFrame, metres_per_unit
from georef_gis.model.layers import Footprint
from georef_gis.model.photo import Geotag, OrientedPhoto
from georef_gis.model.pose import Pose
from georef_gis.model.terrain import DemTerrain, FlatTerrain, Terrain
from georef_gis.model.tin import TinTerrain
from georef_gis.project import Project
from georef_gis.project.records import camera_of, footprint_of, load_frame, photo_of, pose_of
from processing_algorithms.dem import read_dem

if TYPE_CHECKING:
    from georef_gis.orient.dem_bias import DemBias

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


def load_site(project: Project, *, quick: bool = False, direct: bool = False) -> Site:
    """Site with the best pose of every photo; with `quick` the tags' own.

    With `direct` the best that no matching has touched, over the ground that goes with them.

    Raises
    ------
    InputError
        If no photo has a pose.
    """
    database = project.database
    frame = load_frame(database)
    cameras = {row["camera_id"]: camera_of(row) for row in database.rows("camera")}
    poses: dict[str, Any] = {}
    used = POSE_KINDS[:1] if quick else POSE_KINDS[:2] if direct else POSE_KINDS
    for kind in used:
        poses |= {row["photo_id"]: row for row in database.rows("pose", {"kind": kind})}
    photos, kinds, doubts = {}, {}, {}
    for row in database.rows("photo"):
        pose = poses.get(row["photo_id"])
        if pose is None:
            continue
        photo = photo_of(row)
        extra = pose["extra"] or {}
        camera = cameras[extra.get("camera_id", photo.camera_id)]
        camera = camera.turned(extra.get("turned_deg", 0))
        oriented = OrientedPhoto(photo=photo, camera=camera, pose=pose_of(pose))
        photos[photo.id] = oriented
        kinds[photo.id] = pose["kind"]
        doubts[photo.id] = [*(row["doubts"] or ()), *(pose["doubts"] or ())]
    if not photos:
        raise InputError("no photo has a pose; run `georef run`", source=str(database.path))
    adjusted = not (quick or direct) and mostly_adjusted(kinds.values())
    ground = load_ground(project, frame, adjusted=adjusted)
    terrain = _ground_of([(kinds[k], p.pose) for k, p in photos.items()], ground, project)
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


def mostly_adjusted(kinds: Iterable[str]) -> bool:
    """Whether more than half of the poses, by their kinds, are adjusted."""
    adjusted = [kind == "adjusted" for kind in kinds]
    return 2 * sum(adjusted) > len(adjusted)


def ground_facts(
    terrain: Terrain, source: str, dem: Path | None, *, bias: DemBias | None = None
) -> dict[str, Any]:
    """JSON-able description of the ground for the project database.

    Of a `TinTerrain` the heights are in `adjustment/surface.npz` (`save_surface`); `bias` is what
    was taken off a DEM.
    """
    facts: dict[str, Any] = {"source": source, "sigma_m": terrain.sigma}
    if isinstance(terrain, FlatTerrain):
        return {**facts, "kind": "flat", "height_ellipsoidal_m": terrain.height_ellipsoidal}
    if isinstance(terrain, TinTerrain):
        return {**facts, "kind": terrain.kind, "sigma_shared_m": terrain.sigma_shared}
    facts |= {"kind": "dem", "path": str(dem)}
    return facts if bias is None else {**facts, "bias": bias.as_json()}


def _ground_of(poses: Sequence[tuple[str, Pose]], terrain: Terrain, project: Project) -> Terrain:
    """Ground with its sigma as poses of these kinds see it.

    Poses from tags share the height error of a ground that is made of the same tags, and adjusted
    ones that of a surface made of their own points, where they hold it apart; others do not.
    """
    if isinstance(terrain, TinTerrain):
        apart = [pose.sigma_height_shared > 0.0 for kind, pose in poses if kind == "adjusted"]
        return terrain.beside_photos() if apart and all(apart) else terrain
    shared = project.database.meta("ground", {}).get("sigma_shared_m", 0.0)
    if not shared or all(kind == "tags" or p.sigma_height_shared > 0.0 for kind, p in poses):
        return terrain
    if not isinstance(terrain, FlatTerrain | DemTerrain):
        return terrain
    return replace(terrain, sigma=float(np.hypot(terrain.sigma, shared)))


def _surface_file(project: Project) -> Path:
    from georef_gis.project.surface_file import SURFACE

    return project.adjustment / SURFACE


def load_ground(project: Project, frame: MapFrame, *, adjusted: bool = False) -> Terrain:
    """Ground that the orientation of the photos settled on.

    Parameters
    ----------
    adjusted
        That of the adjustment if it left one, else that of the direct result.

    Raises
    ------
    InputError
        If the photos were not oriented yet, or the adjusted ground's file cannot be read.
    """
    facts = project.database.meta("ground_adjusted") if adjusted else None
    if facts and facts["kind"] in ("tin", "plane") and not _surface_file(project).exists():
        # what a user cleared away is made anew by the next run; until then the direct ground does
        facts = None
    facts = facts or project.database.meta("ground")
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
    if facts["kind"] in ("tin", "plane"):
        from georef_gis.project.surface_file import load_surface

        return load_surface(_surface_file(project))
    positions = [
        [row["x_enu"], row["y_enu"], row["z_enu"]] for row in project.database.rows("pose")
    ]
    # before there is any pose the origin, which lies amid the flight, stands for them
    dem = read_dem(project, frame, np.array(positions or [[0.0, 0.0, 0.0]]))
    terrain = dem.terrain(facts.get("dem_unit_m", dem.unit or 1.0))
    if not facts.get("bias"):
        return terrain
    from georef_gis.orient.dem_bias import DemBias, unbiased

    return unbiased(terrain, DemBias.from_json(facts["bias"]))


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
