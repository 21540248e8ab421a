"""A process that runs one tool, or the pipeline, for the page.

A process of its own keeps clicks fast while a tool works, and a crash away from the page. It reads
one line of JSON on standard input, ``{"project", "tool", "values"}``, and writes events as
``georef --json`` does. A second line, or the end of the input, stops it.
"""

from __future__ import annotations

import _thread
import json
import sys
import threading
from typing import Any

from georef_gis.app.feedback import JsonFeedback, Stop
from georef_gis.app.report import report_event
from georef_gis.errors import Cancelled, GeorefError
from georef_gis.project import Project
from georef_gis.toolbox.registry import load_registry
from georef_gis.toolbox.runner import run_pipeline, run_tool
from georef_gis.toolbox.steps import RunOptions

DONE, BUG, USER_ERROR, CANCELLED = 0, 1, 2, 130
# Stands for all steps of `georef run`.
PIPELINE = "run"


def main() -> int:
    """Run what the first line of the input asks for."""
    stop = Stop()
    feedback = JsonFeedback(stop)
    order = json.loads(sys.stdin.readline())
    finished = threading.Event()
    threading.Thread(target=_listen, args=(stop, finished), daemon=True).start()
    try:
        with stop.listening(), feedback:
            for event in _run(order, feedback):
                feedback.event("result", **event)
        return DONE
    except (Cancelled, KeyboardInterrupt):
        feedback.event("error", message="cancelled", exit_code=CANCELLED)
        return CANCELLED
    except GeorefError as error:
        feedback.event("error", message=" ".join(str(error).split()), exit_code=USER_ERROR)
        return USER_ERROR
    except Exception as error:
        what = " ".join(f"{type(error).__name__}: {error}".split())
        feedback.event("error", message=f"this is a bug in georef: {what}", exit_code=BUG)
        return BUG
    finally:
        finished.set()


def _listen(stop: Stop, finished: threading.Event) -> None:
    """Stop the work when a line comes or the page is gone."""
    sys.stdin.readline()
    if not finished.is_set():
        stop.wanted = True
        _thread.interrupt_main()


def _run(order: dict[str, Any], feedback: JsonFeedback) -> list[dict[str, Any]]:
    project = Project.open(order["project"])
    registry, values = load_registry(), dict(order["values"])
    if order["tool"] == PIPELINE:
        options = RunOptions(quick=bool(values.get("quick")), force=bool(values.get("force")))
        reports = run_pipeline(registry, project, feedback, options=options)
        return [report_event(report) for report in reports]
    tool = registry.find(order["tool"])
    needs = tool.algorithm.needs_project
    report = run_tool(
        registry, tool.full_id, values, feedback, project=project if needs else None,
        options=RunOptions(force=True),
    )  # fmt: skip
    return [report_event(report)]


if __name__ == "__main__":
    sys.exit(main())
