"""Texts by which those who show a project see that something of it has changed."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from georef_gis.project import Project


def runs_done(project: Project) -> str:
    """State of the runs of tools; empty before the first."""
    if not (project.folder / "georef.gpkg").is_file():
        return ""
    return str(project.database.count("run", {"outcome": "done"}))


def file_state(path: Path) -> str:
    """State of a file; empty if it is not there."""
    try:
        status = path.stat()
    except OSError:
        return ""
    return f"{status.st_mtime_ns:x}-{status.st_size:x}"
