"""Whether the report page is older than what it reports."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from georef_gis.project import Project

ASSETS_FILE, DONE = "assets.gpkg", "done"


def older_than(project: Project) -> list[str]:
    """What changed since the report was made, in words; empty if nothing did.

    By the records of runs: files that the report and the tool `control` read, and later runs of the
    tools whose results the report shows.
    """
    rows = project.database.last_rows("run", "tool")
    last = {row["tool"].rpartition(":")[2]: row for row in rows}
    report, control = last.get("report"), last.get("control")
    if report is None:
        return []
    if report["outcome"] != DONE:
        return ["its last run, which was not finished"]
    out = []
    if _has_new_assets(project, report):
        out.append("your last edits of assets")
    if control is not None and any(_changed(project, control, n) for n in control["inputs"] or {}):
        out.append("your last marks of control points")
    shown = {name.rpartition(":")[2]: fid for name, fid in (report["upstream"] or {}).items()}
    done = {tool: last[tool]["fid"] for tool in shown if last[tool]["outcome"] == DONE}
    later = [tool for tool, fid in done.items() if fid != shown[tool]]
    if later:
        out.append(f"the last run of {', '.join(later)}")
    return out


def _has_new_assets(project: Project, report: Mapping[str, Any]) -> bool:
    from georef_gis.measure.assets.store import AssetStore

    if ASSETS_FILE in (report["inputs"] or {}) or not (project.folder / ASSETS_FILE).is_file():
        return _changed(project, report, ASSETS_FILE)
    # Who only looks makes the file too.
    with AssetStore.of_project(project) as store:
        return bool(store.steps(1))


def _changed(project: Project, run: Mapping[str, Any], name: str) -> bool:
    """Whether a file is not the one that a run read."""
    from georef_gis.project.fingerprint import fingerprint

    path, before = project.path(name), (run["inputs"] or {}).get(name)
    if before is None or not path.is_file():
        return (before is None) == path.is_file()
    # Size and content: a copied project has other times.
    return str(before).split("-")[::2] != fingerprint(path).split("-")[::2]
