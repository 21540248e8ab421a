"""Tool `measure_photo`: the job of the 2009 report's script."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from georef_gis.toolbox import Algorithm, Context, Feedback, Output, Result
from georef_gis.toolbox import parameters as p
from processing_algorithms.measure.marks import CLICK
from processing_algorithms.measure.point_table import TABLE_SUFFIXES

if TYPE_CHECKING:
    from georef_gis.measure.measured import MeasuredPoints
    from georef_gis.measure.scene import Scene
    from georef_gis.model.photo import OrientedPhoto
    from georef_gis.toolbox.values import PhotoPixel


class MeasurePhotoParameters(p.Parameters):
    """Parameters of `measure_photo`."""

    photo: p.File = p.file(title="Photo", positional=True)
    pixel: tuple[p.PhotoPixel, ...] = p.photo_pixel(
        (), title="Pixel u,v to measure; give it once per point"
    )
    site: p.Folder | None = p.folder(None, title="Project whose poses and ground to use")
    height: p.Length | None = p.length(
        None, title="Height above ground, instead of the tags'", unit="m", ge=0.1, le=20000
    )
    heading: p.Angle | None = p.angle(
        None, title="Heading of the image top, clockwise from north", unit="deg", ge=-360, le=360
    )
    level: p.Flag = p.flag(False, title="Take the camera as looking straight down")
    click: p.Number = p.number(CLICK, title="One sigma of a click, px", ge=0, le=100)
    target: p.File | None = p.file(
        None, title="CSV or JSON of the points to write", suffixes=TABLE_SUFFIXES, writes=True
    )


class MeasurePhoto(Algorithm[MeasurePhotoParameters]):
    """Field of view, GSD, and places, distances and azimuths of pixels of one photo.

    From the tags alone, or with the poses and the ground of a project. Each place comes with its
    sigma; a distance within one photo is far better than the places, as they share their errors.
    """

    id, name, group = "measure_photo", "Measure in one photo", "measure"
    needs_project = False
    outputs = (Output(name="points", title="Points as CSV"),)

    def run(
        self, context: Context, parameters: MeasurePhotoParameters, feedback: Feedback
    ) -> Result:
        """Measure."""
        from georef_gis.errors import GeometryError
        from georef_gis.measure.points import Mark, locate_points
        from processing_algorithms.measure.point_table import COLUMNS, point_rows, write_rows

        photo, scene = _oriented(parameters)
        _check_pixels(parameters.pixel, photo)
        place = photo.pose.origin_enu
        agl = float(place[2] - scene.terrain.z_at(place[:2]))
        if not math.isfinite(agl):
            raise GeometryError(f"photo {photo.id}: the project's DEM has no height below it")
        summary = _shown(photo, agl)
        outputs: dict[str, Path] = {}
        if parameters.pixel:
            marks = [
                Mark(name="", photo=photo.id, u=one.u, v=one.v, sigma_px=parameters.click)
                for one in parameters.pixel
            ]
            points = locate_points(scene, marks)
            for line in dict.fromkeys(line for lines in points.doubts for line in lines):
                feedback.warn(line)
            rows = point_rows(points)
            summary["points"] = rows
            if len(points) > 1:
                summary["lines"] = _lines(points)
            if parameters.target is not None:
                write_rows(parameters.target, rows, COLUMNS)
                outputs["points"] = parameters.target
        return Result(outputs=outputs, summary=summary)


def _check_pixels(pixels: Sequence[PhotoPixel], photo: OrientedPhoto) -> None:
    """Refuse pixels that name another photo than the one that is measured in.

    Raises
    ------
    InputError
        If there is one.
    """
    from georef_gis.errors import InputError
    from georef_gis.ingest.control_photos import photo_finder

    find = photo_finder({photo.id: photo})
    for one in pixels:
        if one.photo and not find(one.photo):
            why = f"{one} is of another photo than {photo.photo.path.name}; use `georef locate`"
            raise InputError(why, field="pixel")


def _shown(photo: OrientedPhoto, height: float) -> dict[str, Any]:
    """What a photo shows from a height above ground, m, and how it lies."""
    from georef_gis.measure.single_photo import camera_field_of_view

    fov, pose = camera_field_of_view(photo.camera, height), photo.pose
    angles = (fov.angle_width, fov.angle_height)
    return {
        "field_of_view_m": [round(fov.width, 4), round(fov.height, 4)],
        "angle_of_view_deg": [round(math.degrees(angle), 3) for angle in angles],
        "gsd_m": fov.gsd,
        "height_above_ground_m": round(height, 3),
        "tilt_deg": round(math.degrees(pose.tilt), 2),
        "image_top_azimuth_deg": round(math.degrees(pose.image_up_azimuth) % 360, 2),
        "pose_kind": pose.kind,
        "camera": photo.camera.id,
    }


def _lines(points: MeasuredPoints) -> list[dict[str, float]]:
    """From each point to the next: distance on the ground and true azimuth."""
    from georef_gis.measure.lengths import measure_lines

    return [
        {
            "distance_m": round(leg.ground.value, 4),
            "sigma_m": round(leg.ground.sigma, 4),
            "sigma_by_places_m": round(leg.ground.sigma_apart, 4),
            "azimuth_deg": round(math.degrees(leg.bearing_true.value), 4),
            "sigma_azimuth_deg": round(math.degrees(leg.bearing_true.sigma), 4),
        }
        for leg in measure_lines(points).legs
    ]


def _oriented(parameters: MeasurePhotoParameters) -> tuple[OrientedPhoto, Scene]:
    from georef_gis.errors import InputError

    if parameters.site is None:
        return _from_tags(parameters)
    from georef_gis.project import Project
    from processing_algorithms.measure.session import MeasureSession

    if parameters.height or parameters.heading is not None or parameters.level:
        raise InputError("height, heading and level are the project's own where a site is given")
    session = MeasureSession.open(Project.open(parameters.site, read_only=True))
    given = parameters.photo
    named = [p for p in session.site.photos.values() if p.photo.path.name == given.name]
    # Two cards may hold one name each: then the path tells them apart.
    same = [photo for photo in named if photo.photo.path == given.resolve()]
    if len(same or named) != 1:
        what = f"has {len(named)} photos called" if named else "has no photo with a pose called"
        raise InputError(f"{what} '{given.name}'; give its path", source=str(parameters.site))
    return (same or named)[0], session.scene


def _from_tags(parameters: MeasurePhotoParameters) -> tuple[OrientedPhoto, Scene]:
    import numpy as np

    from georef_gis.errors import MissingMetadataError
    from georef_gis.geodesy import MapFrame, Origin, utm_crs
    from georef_gis.ingest.cameras import camera_for
    from georef_gis.ingest.photos import read_photo
    from georef_gis.measure.scene import Scene
    from georef_gis.model.photo import OrientedPhoto
    from georef_gis.model.pose import Mount
    from georef_gis.orient.direct import DirectSettings, direct_poses
    from georef_gis.orient.heights import GroundSetting, solve_heights

    photo = _with_given(read_photo(parameters.photo), parameters)
    camera = camera_for(photo.tags, (photo.width, photo.height), source=photo.path.name).camera
    tag = photo.geotag
    if tag is None:
        raise MissingMetadataError("no GPS position", source=photo.id, field="GPS")
    level = tag.height.value if tag.height else 0.0
    origin = Origin(lat=tag.lat, lon=tag.lon, height_ellipsoidal=level)
    frame = MapFrame(origin, utm_crs(tag.lat, tag.lon))
    if parameters.height is None and not (photo.height_above_ground or photo.height_above_takeoff):
        raise MissingMetadataError(
            "the tags state no height above ground; give --height, or --site with a project",
            source=photo.path.name,
            field="height",
        )
    ground = GroundSetting(height_above_ground=parameters.height)
    heights = solve_heights([photo], origin, ground)
    (pose,) = direct_poses(
        [photo],
        origin,
        heights,
        Mount(),
        DirectSettings(sigma_datum=frame.datum_sigma),
        convergence_at=lambda p_enu: frame.convergence_at(np.asarray(p_enu)),
    )
    if pose.pose is None:
        raise pose.refused or MissingMetadataError("no pose", source=photo.id)
    oriented = OrientedPhoto(photo=photo, camera=camera, pose=pose.pose)
    return oriented, Scene.of(frame, heights.terrain, [oriented])


def _with_given(photo: Any, parameters: MeasurePhotoParameters) -> Any:
    """Photo with the heading and the level attitude that the user gives."""
    from dataclasses import replace

    from georef_gis.model.photo import AttitudeTag

    if parameters.heading is None and not parameters.level:
        return photo
    old = photo.attitude
    heading = parameters.heading
    if parameters.level:
        # The azimuth of the image top, whatever the dialect's zero.
        yaw = heading if heading is not None else (old.yaw if old else photo.course)
        return replace(photo, attitude=AttitudeTag(dialect="ypr", roll=0.0, pitch=0.0, yaw=yaw))
    old = old or AttitudeTag(dialect="ypr", roll=0.0, pitch=0.0, yaw=None)
    return replace(photo, attitude=replace(old, yaw=heading))
