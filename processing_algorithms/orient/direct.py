"""Tool `orient_direct`: poses from the tags alone."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from georef_gis.toolbox import Algorithm, Context, Feedback, Result
from georef_gis.toolbox import parameters as p

if TYPE_CHECKING:
    from georef_gis.geodesy import MapFrame
    from georef_gis.model.photo import Photo
    from georef_gis.model.pose import Mount
    from georef_gis.orient.direct import DirectPose, DirectSettings
    from georef_gis.orient.heights import GroundSetting, Heights
    from georef_gis.project import Project
    from processing_algorithms.dem import UnitChoice


LEVER_ARM_KEYS = {"lever_arm_camera_m", "lever_arm_antenna_m", "sigma_lever_arm_m"}
BORESIGHT_KEYS = {"boresight_deg", "sigma_boresight_deg"}


class OrientDirect(Algorithm[p.Parameters]):
    """Pose of every photo from its tags.

    Position, height above ground and angles as the maker's dialect means them, with a covariance
    that holds the receiver, the angles, the mount, the datum and the ground. A missing heading is
    taken from the course between neighbours, with a sigma to match. No matching is done.
    """

    id, name, group = "orient_direct", "Orient photos from their tags", "orient"
    needs, gives = ("photos",), ("poses",)
    in_run = True
    uses_settings = ("gnss", "attitude", "ground", "mount")
    # units of DEMs
    version = "3"

    def inputs(self, context: Context, parameters: p.Parameters) -> Sequence[Path]:
        """The DEM."""
        project = context.require_project()
        dem = project.settings.ground.dem
        return [project.path(dem)] if dem else []

    def run(self, context: Context, parameters: p.Parameters, feedback: Feedback) -> Result:
        """Orient them."""
        from dataclasses import replace

        from georef_gis.orient.direct import direct_poses
        from georef_gis.project.records import load_frame, photo_of

        project = context.require_project()
        frame = load_frame(project.database)
        photos = [_with_dialect(photo_of(row), project) for row in project.database.rows("photo")]
        photos = _in_time(photos)
        if all(photo.geotag is None for photo in photos):
            return _without_tags(context, frame, feedback)
        ground, dem_unit = _ground(project, frame, photos, feedback)
        placed = [photo for photo in photos if photo.geotag is not None]
        heights = _heights(placed, frame, ground, project)
        mount, settings = project_mount(project), _settings(project, frame)
        _check_names(settings, photos)
        poses = direct_poses(
            photos, frame.origin, heights, mount, settings, convergence_at=frame.convergence_at
        )
        if dem_unit is not None and dem_unit.doubt:
            heights = replace(heights, doubts=(dem_unit.doubt, *heights.doubts))
        doubts = _report(poses, heights, frame, feedback)
        _save(context, frame, photos, poses, _ground_facts(project, heights, dem_unit))
        oriented = [pose for pose in poses if pose.pose is not None]
        agl = sorted(h for p in oriented if math.isfinite(h := p.height_above_ground))
        summary = {
            "oriented": len(oriented),
            "left_out": len(poses) - len(oriented),
            "height_above_ground_m": round(agl[len(agl) // 2], 1) if agl else None,
            "ground": heights.source,
            "doubts": doubts,
        }
        return Result(summary=summary)


def _without_tags(context: Context, frame: MapFrame, feedback: Feedback) -> Result:
    """Settle the ground alone where no photo has a position: the logs give the poses."""
    import numpy as np

    from georef_gis.errors import MissingMetadataError
    from georef_gis.model.terrain import FlatTerrain, Terrain
    from georef_gis.orient.heights import SIGMA_FLAT_GROUND
    from processing_algorithms.dem import choose_unit, read_dem
    from processing_algorithms.site import ground_facts, stated_ground_height

    project = context.require_project()
    ground, database = project.settings.ground, project.database
    stated = stated_ground_height(project)
    facts, doubts = None, ["no photo has a position in its tags: poses come from the logs alone"]
    terrain: Terrain
    if ground.dem is not None:
        dem = read_dem(project, frame, np.zeros((1, 3)))
        choice = choose_unit(dem, [])
        doubts += [choice.doubt] if choice.doubt else []
        path, unit = project.path(ground.dem), choice.unit
        facts = {**ground_facts(dem.terrain(unit), "DEM", path), "dem_unit_m": unit}
    elif stated is not None:
        height = stated.ellipsoidal(frame.origin.lat, frame.origin.lon)
        sigma = ground.sigma_m or SIGMA_FLAT_GROUND
        terrain = FlatTerrain(origin=frame.origin, height_ellipsoidal=height, sigma=sigma)
        facts = ground_facts(terrain, "[ground] height_m", None)
    elif ground.height_above_ground_m is None:
        raise MissingMetadataError(
            "no photo has a position that would tell the height above the ground; set [ground] "
            "dem, height_m or height_above_ground_m",
            source="project.toml",
            field="ground",
        )
    for line in doubts:
        feedback.warn(line)
    with database.transaction():
        database.replace_rows("pose", [], where={"kind": "tags"})
        database.set_meta(ground=facts)
    return Result(summary={"oriented": 0, "doubts": doubts})


def _in_time(photos: list[Photo]) -> list[Photo]:
    """Photos by flight and time; by name where there is no time."""
    from datetime import datetime

    return sorted(
        photos,
        key=lambda photo: (
            photo.flight_id,
            photo.time_gps if photo.time_gps is not None else math.inf,
            photo.camera_clock or datetime.max,
            photo.id,
        ),
    )


def _with_dialect(photo: Photo, project: Project) -> Photo:
    """Photo whose angles are read as the dialect that project.toml names."""
    from dataclasses import replace

    from georef_gis.orient.direct import with_heading

    name = project.settings.attitude.dialect
    attitude = photo.attitude
    if attitude is None:
        return photo
    if name != "auto":
        attitude = replace(attitude, dialect=name)
    if project.settings.attitude.yaw_source == "flight" and attitude.vehicle_yaw is not None:
        attitude = with_heading(attitude, attitude.vehicle_yaw)
    return replace(photo, attitude=attitude)


def _ground(
    project: Project, frame: MapFrame, photos: list[Photo], feedback: Feedback
) -> tuple[GroundSetting, UnitChoice | None]:
    """What project.toml says of the ground, and the unit of its DEM."""
    import numpy as np

    from georef_gis.orient.heights import GroundSetting
    from processing_algorithms.dem import choose_unit, read_dem
    from processing_algorithms.site import stated_ground_height

    settings = project.settings.ground
    dem, choice = None, None
    if settings.dem is not None:
        tags = [photo.geotag for photo in photos if photo.geotag is not None]
        geo = np.array([[t.lat, t.lon, frame.origin.height_ellipsoidal] for t in tags])
        found = read_dem(project, frame, frame.origin.enu_from_geo(geo))
        choice = choose_unit(found, photos)
        if choice.told:
            feedback.info(choice.told)
        dem = found.terrain(choice.unit)
    setting = GroundSetting(
        height=stated_ground_height(project),
        height_above_ground=settings.height_above_ground_m,
        dem=dem,
        sigma=settings.sigma_m,
    )
    return setting, choice


def _heights(
    photos: list[Photo], frame: MapFrame, ground: GroundSetting, project: Project
) -> Heights:
    """Heights of the cameras; those of no stated kind are taken as EXIF defines them if need be.

    EXIF 2.32 calls GPSAltitude a height above sea level, though some makers write the ellipsoid's:
    the geoid's height goes into the sigma, and the user is told.
    """
    from dataclasses import replace

    from georef_gis.errors import InputError
    from georef_gis.geodesy import HeightKind, geoid_undulation
    from georef_gis.orient.heights import solve_heights, unknown_kind

    gnss = project.settings.gnss
    kind = None if gnss.height_kind == "auto" else HeightKind(gnss.height_kind)
    try:
        return solve_heights(
            photos, frame.origin, ground, kind=kind, geoid=gnss.geoid, sigma_v=gnss.sigma_v_m
        )
    except InputError as error:
        if kind is not None or "height_kind" not in error.field:
            raise
    heights = solve_heights(
        photos,
        frame.origin,
        ground,
        kind=HeightKind.ORTHOMETRIC,
        geoid=gnss.geoid,
        sigma_v=gnss.sigma_v_m,
    )
    geoid = float(geoid_undulation(frame.origin.lat, frame.origin.lon, geoid=gnss.geoid))
    doubt = (
        "the tags do not state the kind of their heights: taken as above sea level, as EXIF means "
        f"them; if they are ellipsoidal, all is {abs(geoid):.0f} m too "
        f"{'low' if geoid < 0 else 'high'}: set [gnss] height_kind"
    )
    return replace(
        heights,
        sigma={key: math.hypot(sigma, geoid / 2) for key, sigma in heights.sigma.items()},
        kinds=dict.fromkeys(heights.kinds, unknown_kind(gnss.geoid)),
        doubts=(*heights.doubts, doubt),
    )


def project_mount(project: Project) -> Mount:
    """Mount as project.toml states it."""
    import numpy as np

    from georef_gis.model.pose import Mount

    mount = project.settings.mount
    stated = mount.model_fields_set
    return Mount(
        lever_arm_body_camera=np.array(mount.lever_arm_camera_m),
        lever_arm_body_antenna=np.array(mount.lever_arm_antenna_m),
        boresight_body=np.radians(mount.boresight_deg),
        sigma_lever_arm=mount.sigma_lever_arm_m if stated & LEVER_ARM_KEYS else 0.0,
        # Where nothing is stated the dialect's own sigma holds the boresight already.
        sigma_boresight=math.radians(mount.sigma_boresight_deg) if stated & BORESIGHT_KEYS else 0.0,
    )


def _settings(project: Project, frame: MapFrame) -> DirectSettings:
    from georef_gis.orient.direct import DirectSettings

    gnss, attitude = project.settings.gnss, project.settings.attitude

    def angle(degrees: float | None) -> float | None:
        return None if degrees is None else math.radians(degrees)

    return DirectSettings(
        sigma_h=gnss.sigma_h_m,
        sigma_roll_pitch=angle(attitude.sigma_roll_pitch_deg),
        sigma_yaw=angle(attitude.sigma_yaw_deg),
        sigma_datum=frame.datum_sigma,
        yaw_source="course" if attitude.yaw_source == "course" else "auto",
        rotate_photos=dict(attitude.rotate_photos),
    )


def _check_names(settings: DirectSettings, photos: list[Photo]) -> None:
    from georef_gis.errors import InputError

    known = {photo.path.name for photo in photos} | {photo.id for photo in photos}
    for name in settings.rotate_photos:
        if name not in known:
            raise InputError(
                f"no photo is called '{name}'",
                source="project.toml",
                field="attitude.rotate_photos",
            )


def _report(
    poses: list[DirectPose], heights: Heights, frame: MapFrame, feedback: Feedback
) -> list[str]:
    """Tell what is doubtful; fail if nothing is left."""
    doubts = list(heights.doubts)
    for pose in poses:
        doubts += [f"{pose.photo_id}: {doubt}" for doubt in pose.doubts]
        if pose.refused is not None:
            doubts.append(str(pose.refused))
    if frame.datum_sigma > 0:
        feedback.info(
            f"datum of the positions ({frame.gnss_datum}) against the map's ({frame.crs_datum}): "
            f"{frame.datum_sigma:.0f} m of sigma added"
        )
    if not any(pose.pose is not None for pose in poses):
        first = next(pose.refused for pose in poses if pose.refused is not None)
        raise first
    for doubt in doubts:
        feedback.warn(doubt)
    return doubts


def _ground_facts(
    project: Project, heights: Heights, dem_unit: UnitChoice | None
) -> dict[str, Any]:
    """What the database says of the ground under the poses."""
    from processing_algorithms.site import ground_facts

    dem = project.settings.ground.dem
    facts = ground_facts(heights.terrain, heights.source, project.path(dem) if dem else None)
    facts["sigma_shared_m"] = heights.sigma_shared
    return facts if dem_unit is None else {**facts, "dem_unit_m": dem_unit.unit}


def _save(
    context: Context,
    frame: MapFrame,
    photos: list[Photo],
    poses: list[DirectPose],
    ground: dict[str, Any],
) -> None:
    from georef_gis.project.records import pose_row

    project = context.require_project()
    by_id = {photo.id: photo for photo in photos}
    rows = []
    for pose in poses:
        if pose.pose is None:
            continue
        photo = by_id[pose.photo_id]
        row = pose_row(
            pose.photo_id,
            pose.pose,
            frame,
            height_above_ground=pose.height_above_ground,
            dialect=photo.attitude.dialect if photo.attitude else "none",
            doubts=pose.doubts,
            turned_deg=pose.turned_deg,
        )
        rows.append({**row, "time_gps": photo.time_gps, "run_id": context.run_id})
    database = project.database
    with database.transaction():
        database.replace_rows("pose", rows, where={"kind": "tags"})
        database.set_meta(ground=ground)
