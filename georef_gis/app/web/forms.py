"""What a tool may be started with from the page."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from georef_gis.app.web.worker import PIPELINE
from georef_gis.errors import InputError
from georef_gis.project import Project
from georef_gis.toolbox.algorithm import manifest
from georef_gis.toolbox.registry import Registry, Tool
from georef_gis.toolbox.specs import Spec

_PIPELINE_VALUES = ("quick", "force")


def tools_for_page(registry: Registry, project: Project) -> dict[str, Any]:
    """Manifest of the tools, and what project.toml sets for them."""
    content = manifest((tool.provider, tool.algorithm) for tool in registry)
    tables = project.settings.tools
    for entry in content["tools"]:
        entry["command"] = registry.command(registry.find(entry["full_id"]))
        entry["stored"] = {**tables.get(entry["id"], {}), **tables.get(entry["full_id"], {})}
        # Its content is told by the parameters.
        del entry["schema"]
    return content


def check_order(registry: Registry, project: Project, tool: str, values: dict[str, Any]) -> str:
    """Full id of the tool to run, after looking at the values.

    Raises
    ------
    InputError
        If there is no such tool, a value does not fit, or it would write where the page may not.
    """
    if tool == PIPELINE:
        strange = [name for name in values if name not in _PIPELINE_VALUES]
        if strange:
            raise InputError(f"no such parameter; use one of {', '.join(_PIPELINE_VALUES)}",
                             source="run", field=strange[0][:40])  # fmt: skip
        return PIPELINE
    found = registry.find(tool)
    for spec in found.algorithm.Parameters.specs():
        given = values.get(spec.name)
        if spec.kind in ("File", "Folder") and spec.writes and given:
            _check_target(found, spec, project, given)
    _read(found, project, values)
    return found.full_id


def _read(tool: Tool, project: Project, values: dict[str, Any]) -> None:
    """Read the values as the run will: what does not fit is told before it starts."""
    stored = {**project.settings.tools.get(tool.id, {})}
    stored |= project.settings.tools.get(tool.full_id, {})
    tool.algorithm.Parameters(**(stored | values))


def _check_target(tool: Tool, spec: Spec, project: Project, given: Any) -> None:
    """Refuse to write outside the project, and over what is no product.

    Who has the page open may be tricked; who types a command knows the path.
    """
    folder = project.folder.resolve()
    target = Path(folder, str(given)).resolve()
    name = f"tool {tool.id}"
    if folder not in target.parents:
        cure = f"name a file such as products/{target.name or 'result'}"
        raise InputError(f"the page writes inside the project only; {cure}", source=name,
                         field=spec.name)  # fmt: skip
    if target.exists() and (folder / "products") not in target.parents:
        raise InputError("is there already, and the page writes over products only; name a file "
                         "in products/", source=name, field=spec.name)  # fmt: skip
