"""Tool `read_photos`: files to photos and cameras in the project database."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence, Set
from pathlib import Path
from typing import TYPE_CHECKING, Any

from georef_gis.toolbox import Algorithm, Context, Feedback, Result, check_cancelled
from georef_gis.toolbox import parameters as p

if TYPE_CHECKING:
    from georef_gis.geodesy import MapFrame
    from georef_gis.model.camera import Camera
    from georef_gis.model.interchange.block import Block
    from georef_gis.model.photo import Photo
    from georef_gis.project import Project


class ReadPhotos(Algorithm[p.Parameters]):
    """Read the photos' tags into the project.

    Positions, angles, times and cameras from EXIF, XMP and MakerNote of DJI, senseFly, Parrot,
    Pix4D, Skydio and plain cameras; positions and angles from the file of [poses] where it has
    them. Fixes the project's CRS and origin. A photo that cannot be used is named and left out.
    """

    id, name, group = "read_photos", "Read photos", "ingest"
    gives = ("photos",)
    in_run = True
    uses_settings = ("project", "photos", "camera", "cameras", "gnss", "mount", "poses")

    def inputs(self, context: Context, parameters: p.Parameters) -> Sequence[Path]:
        """Photos and the file of poses."""
        project = context.require_project()
        poses = project.settings.poses.file
        own = [project.path(poses) if poses else None, _crs_file(project)]
        return [*project.photo_files(), *(file for file in own if file is not None)]

    def run(self, context: Context, parameters: p.Parameters, feedback: Feedback) -> Result:
        """Read them."""
        from georef_gis.ingest.cameras import CameraOverride
        from georef_gis.ingest.photos import read_photos
        from processing_algorithms.assets.asset_photos import lost_doubts
        from processing_algorithms.ingest.outliers import without_strays

        project = context.require_project()
        settings = project.settings

        def override(camera_id: str, model: str) -> CameraOverride:
            own = settings.camera_of(camera_id, model)
            return CameraOverride(**own.model_dump(exclude_none=True))

        def progress(done: int, count: int) -> None:
            check_cancelled(feedback)
            feedback.progress(0.9 * done / max(count, 1), f"{done} of {count} photos read")

        result = read_photos(
            project.photo_files(), workers=context.workers, progress=progress, override=override
        )
        photos, doubts = _with_pose_file(project, list(result.photos))
        kept, strays = without_strays(photos)
        refused = len(result.refused) + len(photos) - len(kept)
        photos = [_as_set(photo, project) for photo in kept]
        frame = _frame(project, photos)
        doubts = [*(str(error) for _, error in result.refused), *strays, *doubts, *result.doubts]
        doubts += frame.doubts()
        doubts += [doubt for photo in photos for doubt in photo.doubts]
        known = {photo.id for photo in photos}
        gone = _gone(project, known)
        _save(project, frame, photos, result.cameras)
        # First: an end that is cut off must not hide them.
        doubts = [*_gone_doubts(gone), *lost_doubts(project, known), *doubts]
        for doubt in doubts:
            feedback.warn(doubt)
        summary = {
            "photos": len(photos),
            "refused": refused,
            "gone": len(gone),
            "cameras": {c.id: f"f = {c.fx:.0f} px ({c.source})" for c in result.cameras.values()},
            "crs": frame.crs.name,
            "doubts": doubts,
        }
        return Result(summary=summary)


def _gone(project: Project, known: Set[str]) -> list[str]:
    """Names of the photos of the last run, not among those of now, whose files are not there."""
    missing = [row for row in project.database.rows("photo") if row["photo_id"] not in known]
    if not missing:
        return []
    folder = project.path(project.settings.photos.folder)
    # Excluded ones too.
    names = {file.name for file in folder.rglob("*")}

    def is_there(path: Path) -> bool:
        # Where the project was copied or moved, the path is that of another file.
        return path.is_file() if path.is_relative_to(folder) else path.name in names

    return sorted(str(row["name"]) for row in missing if not is_there(Path(row["path"])))


def _gone_doubts(names: Sequence[str]) -> list[str]:
    from processing_algorithms.assets.asset_photos import named

    if not names:
        return []
    count = "1 photo is" if len(names) == 1 else f"{len(names)} photos are"
    return [
        f"{count} gone from the folder since the last run: {named(names)}; all is made without "
        f"{'it' if len(names) == 1 else 'them'}; put back what was not meant to go"
    ]


def _with_pose_file(project: Project, photos: list[Photo]) -> tuple[list[Photo], list[str]]:
    """Photos with positions and angles of the pose file where it names them, and doubts."""
    from dataclasses import replace

    settings = project.settings.poses
    if settings.file is None:
        return photos, []
    from georef_gis.ingest.poses import match_poses, read_poses

    doubts: list[str] = []

    def placing(block: Block) -> Block:
        """Lay a block of another program on the positions of the tags."""
        from georef_gis.orient.placing import place_block

        placed = place_block(block, photos)
        doubts.extend(placed.doubts)
        return placed.block

    tags = sorted((t.lat, t.lon) for photo in photos if (t := photo.geotag) is not None)
    poses = read_poses(
        project.path(settings.file),
        format=settings.format,
        crs=settings.crs,
        near=tags[len(tags) // 2] if tags else None,
        placing=placing,
    )
    names = Counter(photo.path.name for photo in photos)
    found, unknown = match_poses(poses, [name for name, count in names.items() if count == 1])
    if len(found) < len(photos) or unknown:
        doubts.append(
            f"{settings.file}: has poses of {len(found)} of {len(photos)} photos"
            + (f", and of {len(unknown)} that are not there" if unknown else "")
        )
    out = []
    for photo in photos:
        geotag, attitude = found.get(photo.path.name, (photo.geotag, None))
        out.append(replace(photo, geotag=geotag, attitude=attitude or photo.attitude))
    return out, doubts


def _as_set(photo: Photo, project: Project) -> Photo:
    """Photo with what project.toml says of all its positions."""
    from dataclasses import replace

    position_of = project.settings.gnss.position_of
    if photo.geotag is None or position_of == "auto":
        return photo
    return replace(photo, geotag=replace(photo.geotag, of=position_of))


def _frame(project: Project, photos: list[Photo]) -> MapFrame:
    """Map CRS of the project and an origin amid the photos."""
    import numpy as np

    from georef_gis.geodesy import Datum, MapFrame, Origin, geoid_undulation, map_crs, utm_crs
    from processing_algorithms.site import middle_of

    tags = [photo.geotag for photo in photos if photo.geotag is not None]
    if tags:
        # The median: one position on another continent must not move the origin there.
        lat, lon = middle_of(tags)
        heights = [tag.height for tag in tags if tag.height is not None]
        level = float(np.median([h.value for h in heights])) if heights else 0.0
    else:
        lat, lon, level = _place_of_logs(project)
    # The height of the origin only sets where enu's zero lies.
    origin = Origin(lat=lat, lon=lon, height_ellipsoidal=round(level, 1))
    settings = project.settings
    text = settings.project.crs
    file = _crs_file(project)
    crs = utm_crs(lat, lon) if text == "auto" else map_crs(_text(file) if file else text)
    output = settings.project.datum_output
    frame = MapFrame(
        origin,
        crs,
        gnss_datum=Datum.parse(settings.gnss.datum),
        crs_datum=None if output == "auto" else Datum.parse(output),
    )
    frame.check_inside(np.zeros((1, 3)))
    geoid_undulation(lat, lon, geoid=settings.gnss.geoid)
    return frame


def _place_of_logs(project: Project) -> tuple[float, float, float]:
    """Lat, lon (rad) and height (m) amid the logs, for photos that have no position."""
    from georef_gis.errors import MissingMetadataError
    from processing_algorithms.navigate.flight import log_files, read_project_logs
    from processing_algorithms.navigate.places import middle_of_logs

    place = middle_of_logs(read_project_logs(project)) if log_files(project) else None
    if place is None:
        raise MissingMetadataError(
            "no photo has a GPS position; give the positions in a file ([poses] file), or the logs "
            "of the flight ([logs])",
            source=str(project.settings.photos.folder),
            field="GPS",
        )
    return place


def _crs_file(project: Project) -> Path | None:
    """File with the CRS that project.toml names, if it names one."""
    text = project.settings.project.crs
    return project.path(text) if text.lower().endswith((".wkt", ".prj")) else None


def _text(file: Path) -> str:
    from georef_gis.errors import InputError

    try:
        return file.read_text("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is no UTF-8 text"
        raise InputError(f"cannot be read ({reason})", source=str(file), field="crs") from error


def _save(
    project: Project, frame: MapFrame, photos: list[Photo], cameras: Mapping[str, Camera]
) -> None:
    from dataclasses import replace

    from georef_gis.project.fingerprint import fingerprint
    from georef_gis.project.records import camera_row, photo_row, save_frame

    database = project.database
    times = [photo.time_gps for photo in photos if photo.time_gps is not None]
    epoch = float(int(min(times))) if times else None
    rows = []
    for photo in photos:
        if photo.time_gps is not None and epoch is not None:
            photo = replace(photo, time_gps=photo.time_gps - epoch)
        status = "doubtful" if photo.doubts else "ok"
        rows.append(photo_row(photo, frame, status=status, fingerprint=fingerprint(photo.path)))
    with database.transaction():
        save_frame(database, frame)
        database.set_meta(epoch=epoch)
        database.replace_rows("photo", rows)
        flights = sorted({photo.flight_id for photo in photos})
        kept = _adjusted(database.rows("camera"), set(cameras))
        database.replace_rows("camera", [*map(camera_row, cameras.values()), *kept])
        kept = _adjusted(database.rows("flight"), set(flights))
        database.replace_rows("flight", [*({"flight_id": f, "name": f} for f in flights), *kept])
        database.replace_rows("mount", [_mount_row(project)])


def _adjusted(rows: Sequence[Mapping[str, Any]], of: Set[str]) -> list[dict[str, Any]]:
    """Rows that an adjustment added for what is still there.

    Adjusted poses stand until the next adjustment, and need them: a run that is stopped before it
    must leave a project that can be read.
    """
    return [
        {name: value for name, value in row.items() if name != "fid"}
        for row in rows
        if (row["extra"] or {}).get("adjusted_of") in of
    ]


def _mount_row(project: Project) -> dict[str, object]:
    from math import radians

    mount = project.settings.mount
    return {
        "mount_id": "mount",
        "lever_arm_camera": list(mount.lever_arm_camera_m),
        "lever_arm_antenna": list(mount.lever_arm_antenna_m),
        "boresight": [radians(v) for v in mount.boresight_deg],
        "rotation_nominal": None,
        "covariance": None,
        "source": "project.toml",
        "extra": {
            "sigma_lever_arm_m": mount.sigma_lever_arm_m,
            "sigma_boresight_deg": mount.sigma_boresight_deg,
        },
    }
