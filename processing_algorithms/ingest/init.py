"""Tool `init`: look at a folder of photos and write a commented project.toml."""

from __future__ import annotations

import os
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

from georef_gis.toolbox import Algorithm, Context, Feedback, Output, Result
from georef_gis.toolbox import parameters as p

if TYPE_CHECKING:
    from georef_gis.ingest.photos import ReadResult

# Files that lie in the folder of the project, and the key of project.toml that takes them.
_FOUND = (
    ("ground", "dem", ("dem.tif", "dem.asc", "dsm.tif")),
    ("control", "file", ("control/control.csv", "control.csv", "gcp_list.txt")),
    ("control", "marks", ("control/marks.csv", "marks.csv")),
    ("poses", "file", ("geo.txt",)),
    ("logs", "imu", ("logs/imu.csv",)),
    ("logs", "gnss", ("logs/gnss.csv",)),
    ("logs", "sync", ("logs/sync_board.log",)),
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
    points and logs in the folder of the project are entered.
    """

    id, name, group = "init", "New project", "project"
    needs_project = False
    outputs = (Output(name="settings", title="project.toml"),)

    def run(self, context: Context, parameters: InitParameters, feedback: Feedback) -> Result:
        """Write it."""
        from georef_gis.geodesy import map_crs
        from georef_gis.ingest.photos import find_photos, read_photos
        from georef_gis.project import Project

        folder = parameters.photos
        nested = folder / "photos"
        if nested.is_dir() and not _has_photos(folder):
            folder = nested
        if parameters.crs != "auto" and not parameters.crs.endswith((".wkt", ".prj")):
            map_crs(parameters.crs)
        paths = find_photos(folder)
        result = read_photos(
            paths,
            workers=context.workers,
            progress=lambda done, n: feedback.progress(done / max(n, 1), f"{done} of {n} photos"),
        )
        into = parameters.into
        values = _values(folder, into, parameters)
        project = Project.create(into, values, _notes(result), overwrite=parameters.overwrite)
        settings = project.folder / "project.toml"
        doubts = [str(error) for _, error in result.refused]
        doubts += [*result.doubts, *(d for photo in result.photos for d in photo.doubts)]
        for doubt in doubts:
            feedback.warn(doubt)
        summary = {
            "products": [str(settings)],
            "photos": len(result.photos),
            "next": f"georef run {os.path.relpath(project.folder)}",
        }
        return Result(outputs={"settings": settings}, summary=summary)


def _has_photos(folder: Path) -> bool:
    endings = {".jpg", ".jpeg", ".tif", ".tiff"}
    other = {name for _, _, names in _FOUND for name in names}
    return any(f.suffix.lower() in endings and f.name not in other for f in folder.iterdir())


def _values(folder: Path, into: Path, parameters: InitParameters) -> dict[str, dict[str, Any]]:
    """What project.toml states: paths relative to it where they are near."""
    values: dict[str, dict[str, Any]] = {
        "project": {
            "name": parameters.name or folder.resolve().parent.name,
            "crs": parameters.crs,
        },
        "photos": {"folder": _relative(folder, into)},
    }
    for section, key, names in _FOUND:
        for name in names:
            file = into / name
            if file.is_file():
                values.setdefault(section, {})[key] = name
                break
    return values


def _relative(path: Path, base: Path) -> str:
    path, base = path.resolve(), base.resolve()
    return os.path.relpath(path, base) if path.is_relative_to(base.parent) else str(path)


def _notes(result: ReadResult) -> dict[str, str]:
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
    return notes
