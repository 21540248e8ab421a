"""Photos of a folder: from files to `Photo` values; one bad photo never stops a batch."""

from __future__ import annotations

import math
import multiprocessing
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import dataclass, replace
from datetime import datetime
from fnmatch import fnmatch
from pathlib import Path

from georef_gis.errors import GeorefError, InputError
from georef_gis.ingest.bands import band_count
from georef_gis.ingest.cameras import CameraOverride, camera_for, camera_id_of
from georef_gis.ingest.checks import attitude_doubts, ground_doubts, pixel_doubts
from georef_gis.ingest.clocks import read_time
from georef_gis.ingest.containers import read_file_tags
from georef_gis.ingest.dialects import read_attitude
from georef_gis.ingest.geotags import read_place
from georef_gis.ingest.tags import Tags, number, text
from georef_gis.model.camera import Camera
from georef_gis.model.photo import Photo

PATTERNS = ("*.jpg", "*.jpeg", "*.tif", "*.tiff")
# photos; below, starting processes costs more than it saves
_ENOUGH_FOR_PROCESSES = 1500
_CHUNK = 64
# A camera with so small a share of the photos is a stranger in the folder.
_LONE_SHARE = 0.1

Overrides = Callable[[str, str], CameraOverride | None]
Progress = Callable[[int, int], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class ReadResult:
    """What a batch of files gave; photos in the order of their camera clocks.

    `doubts` are about the batch and its cameras, those about one photo stand in `Photo.doubts`.
    """

    photos: tuple[Photo, ...]
    cameras: Mapping[str, Camera]
    refused: tuple[tuple[Path, GeorefError], ...] = ()
    doubts: tuple[str, ...] = ()


def find_photos(
    folder: Path,
    patterns: Sequence[str] = PATTERNS,
    exclude: Sequence[str] = (),
    *,
    subfolders: bool = False,
) -> list[Path]:
    """Photo files of a folder, sorted by name as people count (DJI_2 before DJI_10).

    Parameters
    ----------
    folder
        Where to look.
    patterns, exclude
        File names to take and to leave out, either case of letters.
    subfolders
        Whether to look below the folder too; hidden folders are left out.

    Raises
    ------
    InputError
        If there is no such folder, or no photo in it.
    """
    if not folder.is_dir():
        what = "is a file, not a folder" if folder.exists() else "there is no such folder"
        raise InputError(f"{what}; give the folder with the photos", source=str(folder))
    found = [
        path
        for path in (folder.rglob("*") if subfolders else folder.iterdir())
        if _matches(path.name, patterns)
        and not _matches(path.name, exclude)
        and not any(part.startswith(".") for part in path.relative_to(folder).parts)
        and path.is_file()
    ]
    if not found:
        raise InputError(
            f"has no photos ({', '.join(patterns)}); give the folder with the photos",
            source=str(folder),
        )
    return sorted(found, key=lambda path: _natural(str(path.relative_to(folder))))


def _matches(name: str, patterns: Sequence[str]) -> bool:
    return any(fnmatch(name.lower(), pattern.lower()) for pattern in patterns)


def _natural(name: str) -> tuple[tuple[int, int, str], ...]:
    return tuple(
        (0, int(part), "") if part.isdigit() else (1, 0, part)
        for part in re.split(r"(\d+)", name.lower())
        if part
    )


def read_photo(path: Path, *, photo_id: str | None = None) -> Photo:
    """One photo from its file's header.

    `Photo.time_gps` is absolute: seconds on the GPS scale since 1980-01-06; the project's epoch
    is subtracted later.

    Raises
    ------
    InputError
        If the file cannot be read, is no JPEG or TIFF, or is cut off.
    """
    file = read_file_tags(path)
    return photo_from_tags(file.tags, path, photo_id=photo_id, doubts=file.doubts)


def photo_from_tags(
    tags: Tags, path: Path, *, photo_id: str | None = None, doubts: Iterable[str] = ()
) -> Photo:
    """Photo of normalised tags.

    Raises
    ------
    InputError
        If the tags have no image size.
    """
    width = number(tags, "File:ImageWidth", "EXIF:ImageWidth", "EXIF:ExifImageWidth")
    height = number(tags, "File:ImageHeight", "EXIF:ImageHeight", "EXIF:ExifImageHeight")
    if not width or not height:
        raise InputError("the image size is missing", source=str(path), field="File:ImageWidth")
    place, time, angles = read_place(tags), read_time(tags), read_attitude(tags)
    size = (int(width), int(height))
    every = [
        *doubts,
        *place.doubts,
        *angles.doubts,
        *attitude_doubts(tags, angles.attitude),
        *pixel_doubts(tags, angles.attitude, path.name),
        *ground_doubts(place.height_above_takeoff, place.height_above_ground),
    ]
    return Photo(
        id=photo_id or path.stem,
        path=path,
        width=size[0],
        height=size[1],
        camera_id=camera_id_of(tags, *size),
        bands=band_count(tags),
        camera_clock=time.camera_clock,
        clock_resolution_s=time.resolution_s,
        time_gps=time.time_gps,
        time_sigma=time.sigma,
        time_source=time.source,
        geotag=place.geotag,
        attitude=angles.attitude,
        height_above_takeoff=place.height_above_takeoff,
        height_above_ground=place.height_above_ground,
        course=place.course,
        ground_speed=place.ground_speed,
        make=text(tags, "EXIF:Make"),
        model=text(tags, "EXIF:Model"),
        software=text(tags, "EXIF:Software"),
        tags=tags,
        doubts=tuple(dict.fromkeys(f"{path.name}: {doubt}" for doubt in every)),
    )


def read_photos(
    paths: Sequence[Path],
    *,
    workers: int = 1,
    progress: Progress | None = None,
    override: Overrides | None = None,
) -> ReadResult:
    """Photos and cameras of many files.

    Parameters
    ----------
    paths
        Files, as `find_photos` gives them.
    workers
        Processes to share thousands of photos among; threads for fewer.
    progress
        Called with the number done and the number in all; may raise `Cancelled`.
    override
        Gives the user's interior orientation for (camera id, model), or None.

    Raises
    ------
    InputError
        If there are no paths, or every file was refused.
    """
    if not paths:
        raise InputError("no photos to read; give a folder with photos")
    jobs = list(zip(paths, _ids(paths), strict=True))
    photos: list[Photo] = []
    refused: list[tuple[Path, GeorefError]] = []
    for done, (path, outcome) in enumerate(_outcomes(jobs, workers), start=1):
        if isinstance(outcome, Photo):
            photos.append(outcome)
        else:
            refused.append((path, outcome))
        if progress is not None:
            progress(done, len(jobs))
    cameras, doubts = _cameras(photos, refused, override)
    unusable = {path for path, _ in refused}
    photos = sorted((p for p in photos if p.path not in unusable), key=_time_key)
    if not photos:
        raise InputError(
            f"none of {len(jobs)} photos can be used; the first: {refused[0][1]}",
            source=str(paths[0].parent),
        )
    return ReadResult(
        photos=tuple(_with_stranger_doubts(_with_name_doubts(photos))),
        cameras=cameras,
        refused=tuple(refused),
        doubts=tuple(doubts),
    )


Job = tuple[Path, str]
Outcome = tuple[Path, Photo | GeorefError]


def _read_one(job: Job) -> Outcome:
    path, photo_id = job
    try:
        return path, read_photo(path, photo_id=photo_id)
    except GeorefError as error:
        return path, error


def _outcomes(jobs: list[Job], workers: int) -> Iterator[Outcome]:
    if workers <= 1 or len(jobs) < 2 * workers:
        yield from map(_read_one, jobs)
        return
    pool: Executor
    if len(jobs) < _ENOUGH_FOR_PROCESSES:
        pool = ThreadPoolExecutor(workers)
    else:
        # Not fork: the caller may have threads, whose locks a fork would copy in any state.
        context = multiprocessing.get_context("spawn")
        pool = ProcessPoolExecutor(workers, mp_context=context)
    try:
        yield from pool.map(_read_one, jobs, chunksize=_CHUNK)
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _ids(paths: Sequence[Path]) -> list[str]:
    """File names without extension, or paths below the common folder where names repeat."""
    stems = Counter(path.stem.lower() for path in paths)
    if max(stems.values()) == 1:
        return [path.stem for path in paths]
    folders = [path.parent for path in paths]
    common = next(
        (f for f in (folders[0], *folders[0].parents) if all(p.is_relative_to(f) for p in folders)),
        None,
    )
    out = []
    for path in paths:
        unique = stems[path.stem.lower()] == 1
        below = path.relative_to(common) if common else path
        out.append(path.stem if unique else below.as_posix())
    return out


def _time_key(photo: Photo) -> tuple[bool, datetime, tuple[tuple[int, int, str], ...]]:
    return (
        photo.camera_clock is None,
        photo.camera_clock or datetime.min,
        _natural(photo.id),
    )


def _cameras(
    photos: list[Photo], refused: list[tuple[Path, GeorefError]], override: Overrides | None
) -> tuple[dict[str, Camera], list[str]]:
    """Camera of each id from its first photo; photos without one move to the refused."""
    cameras: dict[str, Camera] = {}
    doubts: list[str] = []
    for photo in photos:
        name, size = photo.camera_id, (photo.width, photo.height)
        if name in cameras:
            continue
        own = override(name, photo.model) if override else None
        try:
            found = camera_for(photo.tags, size, override=own, source=photo.path.name)
        except InputError as error:
            refused.append((photo.path, error))
            continue
        cameras[name] = found.camera
        doubts.extend(f"camera {name}: {doubt}" for doubt in found.doubts)
    return cameras, doubts


def _with_name_doubts(photos: list[Photo]) -> list[Photo]:
    names = Counter(photo.path.stem.lower() for photo in photos)
    return [
        replace(
            photo,
            doubts=(
                *photo.doubts,
                f"{photo.path.name}: {names[photo.path.stem.lower()]} photos have this name; it "
                f"is called {photo.id}; check that none is a copy",
            ),
        )
        if names[photo.path.stem.lower()] > 1
        else photo
        for photo in photos
    ]


def _with_stranger_doubts(photos: list[Photo]) -> list[Photo]:
    counts = Counter(photo.camera_id for photo in photos)
    main, most = counts.most_common(1)[0]
    limit = max(1, math.floor(_LONE_SHARE * len(photos)))
    strangers = {c for c, n in counts.items() if c != main and n <= limit and n < most}
    return [
        replace(
            photo,
            doubts=(
                *photo.doubts,
                f"{photo.path.name}: taken with another camera ({photo.camera_id}) than most "
                f"({main}); exclude it if it does not belong to the flight",
            ),
        )
        if photo.camera_id in strangers
        else photo
        for photo in photos
    ]
