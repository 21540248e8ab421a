"""Which tools `georef run` runs, and in which order."""

from __future__ import annotations

from collections.abc import Sequence

from georef_gis.errors import InputError, PluginError
from georef_gis.toolbox.registry import Registry, Tool


def plan_steps(
    registry: Registry, only: Sequence[str] = (), start: str = "", *, quick: bool = False
) -> list[Tool]:
    """Steps of a run: every tool after those that give what it needs, else as declared.

    Raises
    ------
    InputError
        If `only` or `start` names no step of the run.
    PluginError
        If tools need each other in a circle.
    """
    steps = in_order([tool for tool in registry if tool.algorithm.in_run])
    wanted = {_step(registry, steps, name).full_id for name in only}
    first = steps.index(_step(registry, steps, start)) if start else 0
    return [
        tool
        for number, tool in enumerate(steps)
        if number >= first
        and (tool.full_id in wanted or not wanted)
        and (tool.algorithm.in_quick or not quick or tool.full_id in wanted)
    ]


def upstream_tools(registry: Registry, tool: Tool) -> dict[str, list[Tool]]:
    """Steps of the run that give each thing a tool needs, without itself."""
    return {
        need: [
            other
            for other in registry
            if other.algorithm.in_run and need in other.algorithm.gives and other is not tool
        ]
        for need in (*tool.algorithm.needs, *tool.algorithm.wants)
    }


def in_order(tools: Sequence[Tool]) -> list[Tool]:
    """Tools such that each comes after those it needs; stable."""
    left, ordered = list(tools), []
    while left:
        ready = next((tool for tool in left if not _waits(tool, left)), None)
        if ready is None:
            names = ", ".join(tool.full_id for tool in left)
            raise PluginError(f"tools need each other in a circle: {names}")
        left.remove(ready)
        ordered.append(ready)
    return ordered


def _waits(tool: Tool, left: Sequence[Tool]) -> bool:
    needs = {*tool.algorithm.needs, *tool.algorithm.wants}
    return any(other is not tool and needs & set(other.algorithm.gives) for other in left)


def _step(registry: Registry, steps: Sequence[Tool], name: str) -> Tool:
    tool = registry.find(name)
    if tool not in steps:
        names = ", ".join(step.id for step in steps)
        raise InputError(f"tool {tool.id} is no step of the run; the steps are {names}")
    return tool
