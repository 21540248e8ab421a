"""Whether a step has to run: what it depends on, against the record of its last run."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import georef_gis
from georef_gis.project import Project
from georef_gis.project.fingerprint import (
    Known,
    digest,
    fingerprint,
    fingerprints,
    is_same,
    portable_path,
)
from georef_gis.project.settings import SECTIONS
from georef_gis.toolbox.algorithm import Algorithm
from georef_gis.toolbox.context import Context
from georef_gis.toolbox.parameters import Parameters
from georef_gis.toolbox.registry import Tool

# Outcomes of a run. "refused" is that of a question which could not be answered: of a tool that
# makes no part of the project, which stays as it was.
DONE, FAILED, CANCELLED, REFUSED = "done", "failed", "cancelled", "refused"
# What is said of a run that was not done. One that was killed is still "started".
ENDINGS = {
    "started": "was not finished", FAILED: "failed", CANCELLED: "was cancelled",
    REFUSED: "was refused",
}  # fmt: skip


def dependencies(
    tool: Tool,
    algorithm: Algorithm[Any],
    context: Context,
    parameters: Parameters,
    upstream: Mapping[str, int],
    *,
    verify: bool = False,
    known: Known | None = None,
) -> dict[str, Any]:
    """Everything a step's result depends on, as columns of its run record."""
    project = context.require_project()
    paths = [*parameter_files(parameters), *algorithm.inputs(context, parameters)]
    return {
        "tool": tool.full_id,
        "parameters": parameters.declared(),
        "settings": _settings(tool, project),
        "versions": {
            "tool": tool.algorithm.version,
            tool.distribution: tool.version,
            "georef-gis": georef_gis.__version__,
        },
        "quick": int(context.quick and tool.algorithm.uses_quick),
        "upstream": dict(upstream),
        "inputs": fingerprints(paths, project.folder, whole=verify, known=known),
    }


def parameter_files(parameters: Parameters) -> list[Path]:
    """Files that the parameters name and the tool reads; a folder stands for its files."""
    found: list[Path] = []
    for spec in parameters.specs():
        if spec.writes or spec.kind not in ("File", "Folder", "RasterLayer", "VectorLayer"):
            continue
        value = getattr(parameters, spec.name)
        for item in value if isinstance(value, tuple) else (value,):
            path = Path(str(item).partition("|")[0]) if item else None
            # The text of a layer may be the name of one in the project.
            if path and (spec.kind in ("File", "Folder") or path.is_file()):
                found.append(path)
    return found


def _settings(tool: Tool, project: Project) -> dict[str, str]:
    wanted = tool.algorithm.uses_settings
    names = SECTIONS if wanted is None else wanted
    return {name: digest(project.settings.section(name)) for name in names}


def why_stale(
    last: Mapping[str, Any] | None, now: Mapping[str, Any], project: Project, *, verify: bool
) -> str:
    """Reason, in words, why a step must run; empty if its last run still holds."""
    if last is None:
        return "it never ran"
    if last["outcome"] != DONE:
        return f"its last run {ENDINGS.get(last['outcome'], 'ended badly')}"
    for column in ("parameters", "settings", "versions", "upstream"):
        changed = _changed(last[column] or {}, now[column])
        if changed:
            return f"{column} changed: {', '.join(changed[:3])}"
    if last["quick"] != now["quick"]:
        return "--quick changed"
    return _why_inputs(last["inputs"] or {}, now["inputs"]) or _why_outputs(
        last["outputs"] or {}, project, verify=verify
    )


def _changed(before: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    same = {key for key in before.keys() & now.keys() if before[key] == now[key]}
    return sorted((before.keys() | now.keys()) - same)


def _why_inputs(before: Mapping[str, str], now: Mapping[str, str]) -> str:
    for kind, names in (("new", now.keys() - before.keys()), ("gone", before.keys() - now.keys())):
        if names:
            return f"{len(names)} input{'s' * (len(names) > 1)} {kind}: {min(names)}"
    changed = sorted(name for name in now if not is_same(before[name], now[name]))
    return f"input changed: {', '.join(changed[:3])}" if changed else ""


def _why_outputs(outputs: Mapping[str, str], project: Project, *, verify: bool) -> str:
    # A product that a user edited or another program touched is left alone, unless told to verify.
    for name, before in outputs.items():
        path = project.path(name)
        if not path.exists() or (path.is_file() and path.stat().st_size == 0):
            return f"output missing: {name}"
        if verify and path.is_file() and not is_same(before, fingerprint(path, whole=True)):
            return f"output changed: {name}"
    return ""


def output_fingerprints(
    outputs: Iterable[Path], project: Project, *, verify: bool = False
) -> dict[str, str]:
    """Fingerprints of the files written; a folder stands for the files in it."""
    paths: Sequence[Path] = [path for path in outputs if path.exists()]
    prints = fingerprints(paths, project.folder, whole=verify)
    folders = {portable_path(p, project.folder): "" for p in paths if p.is_dir()}
    return {**folders, **prints}
