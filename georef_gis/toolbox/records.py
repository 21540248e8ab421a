"""What the record of a run keeps of its result, and the result that it gives again."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from georef_gis.project import Project
from georef_gis.project.fingerprint import portable_path
from georef_gis.toolbox.algorithm import Result

# Outputs by name, in the summary of a record: its own column of them is by file.
_NAMED = "outputs"


def recorded_summary(result: Result, project: Project) -> dict[str, Any]:
    """Summary for the record: its files are relative to the project, which may be moved."""

    def kept(path: Path | str) -> str:
        return portable_path(Path(path), project.folder)

    summary = dict(result.summary)
    if "products" in summary:
        summary["products"] = [kept(path) for path in summary["products"]]
    if result.outputs:
        summary[_NAMED] = {name: kept(path) for name, path in result.outputs.items()}
    return summary


def recorded_result(record: Mapping[str, Any], project: Project) -> Result:
    """Result of a run that still holds; its files are found where the project is now."""
    summary = dict(record["summary"] or {})
    if "products" in summary:
        summary["products"] = [str(project.path(name)) for name in summary["products"]]
    outputs = {name: project.path(path) for name, path in summary.pop(_NAMED, {}).items()}
    return Result(outputs=outputs, summary=summary, warnings=tuple(record["warnings"] or ()))
