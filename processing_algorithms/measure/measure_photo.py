"""Tool `measure_photo`: the job of the 2009 report's script."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from georef_gis.toolbox import Algorithm, Context, Feedback, Output, Result
from georef_gis.toolbox import parameters as p

if TYPE_CHECKING:
    from georef_gis.geodesy import MapFrame
    from georef_gis.measure.single_photo import PhotoPoints
    from georef_gis.model.photo import OrientedPhoto
    from georef_gis.model.terrain import Terrain


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
    click: p.Number = p.number(1.0, title="One sigma of a click, px", ge=0, le=100)
    target: p.File | None = p.file(None, title="CSV of the points to write", writes=True)


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
        from georef_gis.measure.single_photo import (
            camera_field_of_view,
            lines_between,
            measure_pixels,
        )

        photo, frame, terrain = _oriented(parameters)
        agl = float(photo.pose.origin_enu[2] - terrain.z_at(photo.pose.origin_enu[:2]))
        if not math.isfinite(agl):
            raise GeometryError(f"photo {photo.id}: the project's DEM has no height below it")
        fov = camera_field_of_view(photo.camera, agl)
        summary: dict[str, Any] = {
            "field_of_view_m": [round(fov.width, 4), round(fov.height, 4)],
            "angle_of_view_deg": [
                round(math.degrees(fov.angle_width), 3),
                round(math.degrees(fov.angle_height), 3),
            ],
            "gsd_m": fov.gsd,
            "height_above_ground_m": round(agl, 3),
            "tilt_deg": round(math.degrees(photo.pose.tilt), 2),
            "image_top_azimuth_deg": round(math.degrees(photo.pose.image_up_azimuth) % 360, 2),
            "pose_kind": photo.pose.kind,
            "camera": photo.camera.id,
        }
        outputs: dict[str, Path] = {}
        if parameters.pixel:
            uv = [(one.u, one.v) for one in parameters.pixel]
            points = measure_pixels(photo, uv, terrain, sigma_uv=parameters.click)
            rows = _rows(points, frame, photo.pose.sigma_height_shared)
            summary["points"] = rows
            if len(uv) > 1:
                summary["lines"] = [
                    {
                        "distance_m": round(line.distance, 4),
                        "sigma_m": round(line.sigma_distance, 4),
                        "azimuth_deg": round(math.degrees(line.azimuth), 4),
                        "sigma_azimuth_deg": round(math.degrees(line.sigma_azimuth), 4),
                    }
                    for line in lines_between(points)
                ]
            if parameters.target is not None:
                _write(parameters.target, rows)
                outputs["points"] = parameters.target
        return Result(outputs=outputs, summary=summary)


def _oriented(
    parameters: MeasurePhotoParameters,
) -> tuple[OrientedPhoto, MapFrame, Terrain]:
    from georef_gis.errors import InputError

    if parameters.site is None:
        return _from_tags(parameters)
    from georef_gis.project import Project
    from processing_algorithms.site import load_site

    if parameters.height or parameters.heading is not None or parameters.level:
        raise InputError("height, heading and level are the project's own where a site is given")
    site = load_site(Project.open(parameters.site, read_only=True))
    given = parameters.photo
    named = [photo for photo in site.photos.values() if photo.photo.path.name == given.name]
    # Two cards may hold one name each: then the path tells them apart.
    same = [photo for photo in named if photo.photo.path == given.resolve()]
    if len(same or named) != 1:
        what = f"has {len(named)} photos called" if named else "has no photo with a pose called"
        raise InputError(f"{what} '{given.name}'; give its path", source=str(parameters.site))
    return (same or named)[0], site.frame, site.terrain


def _from_tags(
    parameters: MeasurePhotoParameters,
) -> tuple[OrientedPhoto, MapFrame, Terrain]:
    import numpy as np

    from georef_gis.errors import MissingMetadataError
    from georef_gis.geodesy import MapFrame, Origin, utm_crs
    from georef_gis.ingest.cameras import camera_for
    from georef_gis.ingest.photos import read_photo
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
    return OrientedPhoto(photo=photo, camera=camera, pose=pose.pose), frame, heights.terrain


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


def _rows(points: PhotoPoints, frame: MapFrame, sigma_shared: float) -> list[dict[str, float]]:
    """Places with their sigmas; `sigma_shared`, m, is that of the ground's own level."""
    import numpy as np

    rows = []
    for i, p_enu in enumerate(points.p_enu):
        lat, lon, h = frame.origin.geo_from_enu(p_enu)
        e, n, _ = frame.map_from_enu(p_enu)
        c = points.covariance_of(i)
        rows.append(
            {
                "u": float(points.uv[i, 0]),
                "v": float(points.uv[i, 1]),
                "lat_deg": round(math.degrees(lat), 9),
                "lon_deg": round(math.degrees(lon), 9),
                "easting": round(float(e), 4),
                "northing": round(float(n), 4),
                "height_ellipsoidal_m": round(float(h), 3),
                "sigma_e_m": round(float(np.sqrt(c[0, 0])), 3),
                "sigma_n_m": round(float(np.sqrt(c[1, 1])), 3),
                "sigma_u_m": round(float(np.hypot(np.sqrt(c[2, 2]), sigma_shared)), 3),
                "corr_en": round(float(c[0, 1] / np.sqrt(c[0, 0] * c[1, 1])), 4),
            }
        )
    return rows


def _write(target: Path, rows: list[dict[str, float]]) -> None:
    import csv
    import io

    from georef_gis.rasters.files import export_errors, resolve_target, whole_file

    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, fieldnames=list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    with export_errors(target, lambda: 0), whole_file(resolve_target(target)) as stream:
        stream.write(text.getvalue().encode())
