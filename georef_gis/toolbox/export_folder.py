"""Folders that exporters write: known again, and replaced without losing what others put in."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

from georef_gis.errors import ExportError

# In a folder that an exporter wrote: which one, and the files it holds.
FOLDER_LIST = ".georef_export.json"


def check_folder(target: Path, exporter: str) -> None:
    """Refuse a folder in which something would be lost.

    Raises
    ------
    ExportError
        If it holds files that no earlier export by the same exporter wrote.
    """
    if not target.is_dir():
        return
    foreign = "is a link to a folder" if target.is_symlink() else _foreign(target, exporter)
    if foreign:
        raise ExportError(
            f"{target}: {foreign}; give the name of a file, or of a new or an empty folder"
        )


def _foreign(folder: Path, exporter: str) -> str:
    """What of a folder is not of an earlier export by the same exporter; empty if all is."""
    listed: set[str] = {FOLDER_LIST}
    try:
        made = json.loads((folder / FOLDER_LIST).read_text(encoding="utf-8"))
        if made["exporter"] == exporter:
            listed |= set(made["files"])
    except (OSError, ValueError, KeyError, TypeError):
        listed = set()
    names = (path.relative_to(folder).as_posix() for path in sorted(_leaves(folder)))
    other = next((name for name in names if name not in listed), "")
    if other.endswith(".lock"):
        # ArcGIS keeps one in a geodatabase, and beside a shapefile, as long as it is open
        return f"holds {other}, by which another program has it open: close it there"
    return (
        f"holds {other}, which is not of an earlier export here and would be lost" if other else ""
    )


def _leaves(folder: Path) -> list[Path]:
    """Files and links below a folder; links are not followed."""
    found: list[Path] = []
    for parent, folders, names in os.walk(folder):
        found += [Path(parent, name) for name in names]
        found += [path for name in folders if (path := Path(parent, name)).is_symlink()]
    return found


def replace_folder(part: Path, target: Path, exporter: str) -> None:
    """Put a folder in the place of an earlier one, with the list by which it is known again."""
    if target.exists() and not target.is_dir():
        raise ExportError(f"{target}: is there and is no folder; give another name")
    check_folder(target, exporter)
    names = [path.relative_to(part).as_posix() for path in sorted(_leaves(part))]
    text = json.dumps({"exporter": exporter, "files": names}, ensure_ascii=False, indent=0)
    (part / FOLDER_LIST).write_text(text, encoding="utf-8")
    # A neighbour that the caller clears away: the old folder goes only when the new one is there.
    old = part.with_name(f"{part.name}.old")
    if target.exists():
        os.replace(target, old)
    try:
        os.replace(part, target)
    except OSError:
        if old.exists():
            os.replace(old, target)
        raise


def remove(path: Path) -> None:
    """Remove a file, or a folder with all in it."""
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
