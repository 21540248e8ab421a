# SPDX-License-Identifier: GPL-2.0-or-later
"""What georef tells while it runs and at its end, as lines for the log of QGIS."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from .tools import RUN

# Lines of one table that are shown; all are in the file that a tool writes.
MOST_ROWS = 50


def tell(event: Mapping[str, Any], feedback: Any, warned: set[str]) -> None:
    """Hand an event of georef on to the log and the progress bar of QGIS; remember warnings."""
    message = str(event.get("message", ""))
    if event["event"] == "progress":
        feedback.setProgress(100.0 * float(event.get("fraction", 0.0)))
        if message:
            feedback.setProgressText(message)
    elif event["event"] == "warning":
        warned.add(message)
        feedback.pushWarning(message)
    elif event["event"] == "info":
        feedback.pushInfo(message)
    else:
        feedback.pushConsoleInfo(message)


def tell_result(result: Mapping[str, Any], feedback: Any, warned: set[str]) -> None:
    """Say what a step gave: figures, files, and the warnings and doubts that were not told yet."""
    tool = str(result.get("tool", "")).rpartition(":")[2]
    if result.get("skipped"):
        feedback.pushInfo(f"{tool}: up to date")
        return
    summary = dict(result.get("summary", {}))
    doubts, files = summary.pop("doubts", ()) or (), summary.pop("products", ()) or ()
    # a line for a terminal in the folder where georef was started
    if str(summary.get("next", "")).startswith("georef run "):
        summary["next"] = RUN["name"]
    feedback.pushInfo(f"{tool}: done in {result.get('duration_s', 0.0)} s")
    for path in dict.fromkeys([*files, *result.get("outputs", {}).values()]):
        feedback.pushInfo(f"  wrote {path}")
    for line in figures(summary):
        feedback.pushInfo(f"  {line}")
    for line in [*result.get("warnings", ()), *doubts]:
        if line not in warned:
            feedback.pushWarning(f"{tool}: {line}")


def figures(summary: Mapping[str, Any]) -> list[str]:
    """Lines of all that a summary holds: a value, a row of a table, or a sentence on each."""
    lines = []
    for name, value in summary.items():
        if isinstance(value, Mapping):
            lines += [f"{name}, {key}: {_text(item)}" for key, item in value.items()]
        elif isinstance(value, (list, tuple)):
            lines += [f"{name}: {_text(item)}" for item in value[:MOST_ROWS]]
            if len(value) > MOST_ROWS:
                lines.append(f"{name}: and {len(value) - MOST_ROWS} more")
        elif value is not None:
            lines.append(f"{name}: {value}")
    return lines


def _text(value: Any) -> str:
    """Value in one line; a row of a table as its names and values, without what is empty."""
    if isinstance(value, Mapping):
        return ", ".join(f"{k} {v}" for k, v in value.items() if v not in (None, "", [], {}))
    return ", ".join(map(str, value)) if isinstance(value, (list, tuple)) else str(value)
