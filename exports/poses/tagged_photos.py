"""Copies of the photos with their poses in EXIF and XMP, for OpenDroneMap, Pix4D and others."""

from __future__ import annotations

import csv
import math
import os
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from exports.poses.poses import site_with_poses
from georef_gis.errors import ExportError, InputError
from georef_gis.toolbox import Exporter, ExportReport, Feedback, LayerSource, check_cancelled
from georef_gis.toolbox import parameters as p
from georef_gis.toolbox.export_folder import FOLDER_LIST

if TYPE_CHECKING:
    from exports.site.columns import Feature
    from exports.site.site import SiteLayers, SitePhoto
    from georef_gis.rasters.photo_tags import PoseTags

# The list of what was written; it also tells a folder of ours from anyone else's.
INDEX = "tagged_photos.csv"
INDEX_HEADER = (
    "file", "photo", "pose_kind", "latitude", "longitude", "gps_altitude", "yaw", "pitch", "roll",
    "accuracy_xy", "accuracy_z", "time_utc", "note",
)  # fmt: skip
# deg; a camera tilted more than this looks somewhere, one tilted less looks down
_LOOKS_DOWN = 45.0


class TaggedPhotosOptions(p.Parameters):
    """Options of tagged copies."""

    heights: p.Choice = p.choice(
        "orthometric",
        title="Height in GPSAltitude",
        help="orthometric (EGM96, what EXIF and Pix4D mean) or ellipsoidal (what orthority and "
        "OpenDroneMap take without further options). The tags cannot state the latter.",
        choices=("orthometric", "ellipsoidal"),
    )
    odm_corrections: p.Flag = p.flag(
        True,
        title="Undo OpenDroneMap's changes of DJI and senseFly angles",
        help="Writes the drone-dji tags that OpenDroneMap takes before Camera's, so that it gets "
        "these poses. Off: the copies have no drone-dji angles at all.",
        advanced=True,
    )


class TaggedPhotos(Exporter[TaggedPhotosOptions]):
    """Copies of the photos with yaw, pitch, roll, position, time and accuracies in their tags.

    For programs that read poses from photos alone: OpenDroneMap, Pix4D, orthority. The originals
    are never written to; pictures stay byte for byte. What the drone wrote about its attitude,
    position and heights is taken out of XMP. The target is a folder of its own.
    """

    id = "tagged_photos"
    name = "photos with poses in their tags"
    suffix = ""
    accepts = ("vector",)
    target = "tagged_photos"
    needs = ("photos", "poses")

    def write(
        self, source: LayerSource, target: Path, options: TaggedPhotosOptions, feedback: Feedback
    ) -> ExportReport:
        """Write the copies to the folder `target`."""
        return write_tagged_photos(site_with_poses(source), target, options, feedback)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Copy:
    photo: SitePhoto
    feature: Feature
    name: str


def write_tagged_photos(
    site: SiteLayers, target: Path, options: TaggedPhotosOptions, feedback: Feedback
) -> ExportReport:
    """Copies and their list in a folder that is made anew.

    `target` may be the toolbox's temporary neighbour of the folder that is asked for.

    Raises
    ------
    ExportError
        If the folder holds originals or files of others, or if not one copy could be made.
    """
    copies = _copies(site)
    check_target(final_folder(target), [one.photo.photo.path for one in copies])
    _check_space(copies, target)
    warnings = [
        f"{photo.photo.path.name}: has no pose, so there is no copy of it"
        for photo in site.photos
        if photo.pose is None
    ]
    if target.exists():
        shutil.rmtree(target)
    target.mkdir(parents=True)
    rows: list[Sequence[object]] = []
    for number, one in enumerate(copies):
        check_cancelled(feedback)
        feedback.progress(number / len(copies), one.name)
        pose = pose_tags(site, one.photo, one.feature, options)
        note = _copy(one, target, pose, warnings)
        if note is not None:
            rows.append(_index_row(one, pose, note))
    if not rows:
        raise ExportError(f"none of the {len(copies)} photos could be copied: {warnings[-1]}")
    with (target / INDEX).open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerows([INDEX_HEADER, *rows])
    for warning in warnings:
        feedback.warn(warning)
    kind = "orthometric (EGM96)" if options.heights == "orthometric" else "ellipsoidal"
    return ExportReport(
        crs="EPSG:4326", height_kind=kind, features=len(rows), warnings=tuple(warnings)
    )


def _copy(one: _Copy, target: Path, pose: PoseTags, warnings: list[str]) -> str | None:
    """Write one copy; what was doubtful about it, None if there is no copy."""
    from georef_gis.rasters.photo_tags import write_tagged_copy

    path = target / one.name
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        doubts = write_tagged_copy(one.photo.photo.path, path, pose)
    except InputError as error:
        warnings.append(f"{error}; there is no copy of it")
        return None
    warnings += [f"{one.name}: {doubt}" for doubt in doubts]
    return "; ".join(doubts)


def _copies(site: SiteLayers) -> list[_Copy]:
    features = {str(f.values["photo"]): f for f in site.layers["photos"].features}
    posed = [one for one in site.photos if one.pose is not None and one.photo.id in features]
    if not posed:
        raise ExportError("no photo has a pose yet; run `georef run` first")
    paths = [one.photo.path for one in posed]
    names = [path.name for path in paths]
    if len({name.casefold() for name in names}) < len(names):
        # Photos of the same name lie in different folders, which the copies keep.
        base = os.path.commonpath([path.parent for path in paths])
        names = [path.relative_to(base).as_posix() for path in paths]
    return [
        _Copy(photo=one, feature=features[one.photo.id], name=name)
        for one, name in zip(posed, names, strict=True)
    ]


def final_folder(target: Path) -> Path:
    """Folder that the toolbox's temporary neighbour will become; else `target` itself."""
    stem, mark, suffix = target.name[1:].rpartition(".part")
    if not target.name.startswith(".") or not mark:
        return target
    return target.with_name(stem + suffix)


def check_target(folder: Path, originals: Sequence[Path]) -> None:
    """Refuse a folder in which something would be lost.

    Raises
    ------
    ExportError
        If it holds a photo of the project, or files that are not of an earlier export.
    """
    real = folder.resolve()
    holders = {path.resolve().parent: path.name for path in originals}
    for holder, name in holders.items():
        above = (holder, *holder.parents)
        # Names that differ may be one folder: letter case, mounts.
        same = real.exists() and any(q.exists() and q.samefile(real) for q in above)
        if same or real in above:
            raise ExportError(
                f"{folder}: holds the original {name}, and originals are never written to; "
                "give another folder"
            )
    if not folder.exists() and not folder.is_symlink():
        return
    if folder.is_symlink() or not folder.is_dir():
        raise ExportError(f"{folder}: is there and is no folder; give another name")
    foreign = _foreign_file(folder)
    if foreign:
        raise ExportError(
            f"{folder}: holds {foreign}, which is not of an earlier export of tagged photos and "
            "would be lost; give an empty or a new folder"
        )


def _foreign_file(folder: Path) -> str:
    """A file in a folder that its list does not name; '' if there is none."""
    listed = {INDEX, FOLDER_LIST}
    if (folder / INDEX).is_file():
        with (folder / INDEX).open(encoding="utf-8", errors="replace", newline="") as stream:
            listed |= {str(row.get("file")) for row in csv.DictReader(stream)}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if name not in listed and (path.is_symlink() or not path.is_dir()):
            return name
    return ""


def _check_space(copies: Sequence[_Copy], target: Path) -> None:
    """Tell before the work that the disk is too small for it."""
    sizes = [path.stat().st_size for one in copies if (path := one.photo.photo.path).is_file()]
    folder = next(q for q in (target, *target.absolute().parents) if q.exists())
    free, needed = shutil.disk_usage(folder).free, sum(sizes)
    if needed > free:
        raise ExportError(
            f"{target.parent}: {needed / 1e9:.1f} GB are needed for copies of {len(sizes)} photos "
            f"and {free / 1e9:.1f} GB are free; give a target on another disk"
        )


# -- values -------------------------------------------------------------------------------------


def pose_tags(
    site: SiteLayers, one: SitePhoto, feature: Feature, options: TaggedPhotosOptions
) -> PoseTags:
    """What is written into the copy of a photo."""
    from georef_gis.rasters.photo_tags import PoseTags
    from georef_gis.units import utc_from_gps

    v, (lon, lat, ellipsoidal) = feature.values, (float(x) for x in feature.geo[0])
    orthometric = options.heights == "orthometric"
    sigma_e, sigma_n, sigma_u = (_number(v[f"sigma_{axis}_m"]) or 0.0 for axis in "enu")
    yaw, pitch, roll = (_number(v[f"{name}_deg"]) or 0.0 for name in ("yaw", "pitch", "roll"))
    time_gps = one.photo.time_gps
    nad83 = site.frame.gnss_datum.name == "NAD83(2011)"
    return PoseTags(
        lat_lon_deg=(lat, lon),
        altitude=float(feature.height_orthometric[0]) if orthometric else ellipsoidal,
        yaw_pitch_roll_deg=(yaw, pitch, roll),
        sigma_yaw_pitch_roll_deg=(
            _number(v["sigma_yaw_deg"]), _number(v["sigma_pitch_deg"]), _number(v["sigma_roll_deg"])
        ),
        direction_deg=image_direction(yaw, pitch, roll),
        sigma_h=math.sqrt((sigma_e**2 + sigma_n**2) / 2.0),
        sigma_v=sigma_u,
        utc=None if time_gps is None else utc_from_gps(site.epoch_gps + time_gps),
        height_above_ground=one.height_above_ground,
        horizontal_crs="EPSG:6318" if nad83 else "EPSG:4326",
        vertical_crs="EPSG:5773" if orthometric else "",
        map_datum="NAD83(2011)" if nad83 else "WGS-84",
        odm_corrections=options.odm_corrections,
    )  # fmt: skip


def image_direction(yaw_deg: float, pitch_deg: float, roll_deg: float) -> float:
    """Bearing of an image, deg from true north: of its top if it looks down, else of its view.

    Angles are zero at nadir, so the view axis is the body's down axis: R_ned_from_body [0, 0, 1].
    """
    y, q, r = (math.radians(a) for a in (yaw_deg, pitch_deg, roll_deg))
    north = math.cos(y) * math.sin(q) * math.cos(r) + math.sin(y) * math.sin(r)
    east = math.sin(y) * math.sin(q) * math.cos(r) - math.cos(y) * math.sin(r)
    down = math.cos(q) * math.cos(r)
    if math.degrees(math.atan2(math.hypot(north, east), down)) < _LOOKS_DOWN:
        return yaw_deg % 360.0
    return math.degrees(math.atan2(east, north)) % 360.0


def _number(value: object) -> float | None:
    return float(value) if isinstance(value, int | float) and math.isfinite(value) else None


def _index_row(one: _Copy, pose: PoseTags, note: str) -> Sequence[object]:
    yaw, pitch, roll = pose.yaw_pitch_roll_deg
    return (
        one.name,
        one.photo.photo.id,
        one.photo.pose.kind if one.photo.pose else "",
        *(f"{v:.10f}" for v in pose.lat_lon_deg),
        f"{pose.altitude:.4f}",
        *(f"{v:.6f}" for v in (yaw, pitch, roll)),
        f"{pose.sigma_h or 0.0:.4f}",
        f"{pose.sigma_v or 0.0:.4f}",
        pose.utc.isoformat() if pose.utc else "",
        note,
    )
