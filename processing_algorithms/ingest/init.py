"""Tool `init`: look at a folder of photos and write a commented project.toml."""

from __future__ import annotations

import glob
import os
import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from georef_gis.toolbox import Algorithm, Context, Feedback, Output, Result
from georef_gis.toolbox import parameters as p
from processing_algorithms.ingest.beside import NAMED, Beside, find_beside

if TYPE_CHECKING:
    from georef_gis.ingest.photos import ReadResult
    from georef_gis.model.photo import Photo

# Names of cameras that take near infrared in place of a colour, or bands of their own.
_INFRARED = re.compile(
    r"nir\b|ndvi|\brgn\b|\bngb\b|\bnrg\b|\bcir\b|multispec|sequoia|rededge|altum|survey ?3"
    r"|agrocam",
    re.IGNORECASE,
)


class InitParameters(p.Parameters):
    """Parameters of `init`."""

    photos: p.Folder = p.folder(title="Folder of the photos", positional=True)
    into: p.Folder = p.folder(Path("."), title="Folder of the project", writes=True)
    crs: p.Crs = p.crs("auto", title="Map CRS: auto (UTM) or e.g. EPSG:6549")
    name: p.Text = p.text("", title="Name of the site")
    overwrite: p.Flag = p.flag(False, title="Replace a project.toml that is there")


class Init(Algorithm[InitParameters]):
    """Look at a folder of photos and write project.toml.

    Says what was found: cameras, positions, angles, heights, and what is doubtful. A DEM, control
    points and logs are entered that lie in the folder of the project, that of the photos or the
    one above it, or in their subfolders such as logs and control.
    """

    id, name, group = "init", "New project", "project"
    needs_project = False
    outputs = (Output(name="settings", title="project.toml"),)

    def run(self, context: Context, parameters: InitParameters, feedback: Feedback) -> Result:
        """Write it."""
        from georef_gis.geodesy import map_crs
        from georef_gis.ingest.photos import find_photos, read_photos
        from georef_gis.project import Project
        from processing_algorithms.ingest.outliers import without_strays

        folder = parameters.photos
        nested = folder / "photos"
        if nested.is_dir() and not _has_photos(folder):
            folder = nested
        if parameters.crs != "auto" and not parameters.crs.endswith((".wkt", ".prj")):
            map_crs(parameters.crs)
        into = parameters.into
        beside = find_beside(folder, into)
        exclude = sorted(beside.names_in(folder))
        paths = find_photos(folder, exclude=[glob.escape(name) for name in exclude])
        result = read_photos(
            paths,
            workers=context.workers,
            progress=lambda done, n: feedback.progress(done / max(n, 1), f"{done} of {n} photos"),
        )
        values = _values(folder, parameters, beside)
        notes = _notes(result, beside)
        project = Project.create(into, values, notes, overwrite=parameters.overwrite)
        settings = project.folder / "project.toml"
        doubts = [str(error) for _, error in result.refused]
        doubts += [
            *without_strays(result.photos)[1],
            *result.doubts,
            *(d for photo in result.photos for d in photo.doubts),
        ]
        for doubt in doubts:
            feedback.warn(doubt)
        summary: dict[str, Any] = {
            "products": [str(settings)],
            "photos": len(result.photos),
            "next": f"georef run {os.path.relpath(project.folder)}",
        }
        return Result(outputs={"settings": settings}, summary=summary)


def _has_photos(folder: Path) -> bool:
    endings = {".jpg", ".jpeg", ".tif", ".tiff"}
    other = {name for _, _, names in NAMED for name in names}
    return any(
        f.suffix.lower() in endings and f.name.lower() not in other for f in folder.iterdir()
    )


def _values(folder: Path, parameters: InitParameters, beside: Beside) -> dict[str, dict[str, Any]]:
    """What project.toml states: paths relative to it where they are near."""
    into = parameters.into
    values: dict[str, dict[str, Any]] = {
        "project": {
            "name": parameters.name or folder.resolve().parent.name,
            "crs": parameters.crs,
        },
        "photos": {"folder": _relative(folder, into)},
    }
    rasters = [name for name in beside.names_in(folder) if name.lower().endswith((".tif", ".tiff"))]
    if rasters:
        values["photos"]["exclude"] = sorted(rasters)
    for (section, key), file in beside.files.items():
        values.setdefault(section, {})[key] = _relative(file, into)
    if beside.logs:
        files = [_relative(file, into) for file in beside.logs]
        values.setdefault("logs", {})["files"] = files
    return values


def _relative(path: Path, base: Path) -> str:
    path, base = path.resolve(), base.resolve()
    return os.path.relpath(path, base) if path.is_relative_to(base.parent) else str(path)


def _notes(result: ReadResult, beside: Beside) -> dict[str, str]:
    """What was found, as comments at the heads of the sections."""
    photos = result.photos
    notes = {"photos": f"Found: {len(photos)} photos"}
    if result.refused:
        notes["photos"] += f", and {len(result.refused)} files that cannot be used"
    cameras = [
        f"{c.id}: {c.width} x {c.height} px, f = {c.fx:.0f} px ({c.source})"
        for c in result.cameras.values()
    ]
    notes["camera"] = "Found: " + "\n".join(cameras)
    placed = [photo.geotag for photo in photos if photo.geotag is not None]
    kinds = Counter(str(t.height.kind) if t.height else "none" for t in placed)
    heights = ", ".join(f"{n} {kind}" for kind, n in kinds.most_common())
    notes["gnss"] = f"Found: positions in {len(placed)} of {len(photos)} photos; heights: {heights}"
    dialects = Counter(photo.attitude.dialect if photo.attitude else "none" for photo in photos)
    angles = ", ".join(f"{n} {name}" for name, n in dialects.most_common())
    notes["attitude"] = f"Found: angles: {angles}"
    above = [photo.height_above_takeoff for photo in photos if photo.height_above_takeoff]
    if above:
        notes["ground"] = f"Found: flown {min(above):.0f} to {max(above):.0f} m above take-off"
    elif not any(photo.height_above_ground for photo in photos):
        notes["ground"] = (
            "The photos state no height above ground: give a DEM, height_m or height_above_ground_m"
        )
    bands = _bands_note(photos)
    if bands:
        notes["products"] = bands
    for section, words in beside.notes.items():
        notes[section] = "\n".join([*filter(None, [notes.get(section)]), *words])
    return notes


def _bands_note(photos: Sequence[Photo]) -> str:
    """Hint for photos whose bands are not red, green and blue."""
    infrared = {
        name
        for photo in photos
        for name in (photo.model, photo.camera_id, photo.path.stem)
        if _INFRARED.search(name)
    }
    odd = sorted({photo.bands for photo in photos} - {1, 3, 4})
    if not infrared and not odd:
        return ""
    what = f"{min(infrared)} takes near infrared" if infrared else f"Photos of {odd[0]} bands"
    return f'{what}: name the bands in order, such as band_names = ["NIR", "green", "blue"]'
