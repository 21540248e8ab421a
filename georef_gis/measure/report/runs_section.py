"""How the result came about: every tool's last run."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from georef_gis.measure.report.draw import few, plural
from georef_gis.measure.report.facts import Facts
from georef_gis.measure.report.page import Item, Table, judged


def runs_items(facts: Facts, without: str) -> list[Item]:
    """Table of the last runs, but for the tool that writes this."""
    runs = [run for run in facts.runs if run["tool"].rpartition(":")[2] != without]
    rows = [
        (
            run["tool"].removeprefix("georef:"), str(run["started"])[:19] + " UTC",
            f"{run['duration_s'] or 0.0:.1f}", str(run["outcome"]), _plain(run["parameters"]),
            ", ".join(f"{k} {v}" for k, v in (run["versions"] or {}).items()),
        )
        for run in runs
    ]  # fmt: skip
    bad = [row[0] for row in rows if row[3] != "done"]
    total = sum(float(run["duration_s"] or 0.0) for run in runs)
    told = f"{plural(len(rows), 'tool')} in {total:.0f} s of working time"
    told += f"; not done: {few(bad)}" if bad else "; all done"
    return [
        Table(
            title="Last runs", rows=rows, words=(0, 1, 3, 4, 5),
            columns=("Tool", "Started", "Seconds", "Outcome", "Parameters", "Versions"),
            look="Settings of each run and fingerprints of its inputs stand in the table `run` of "
            "georef.gpkg.",
            verdict=judged(told + ".", fine=not bad),
        )
    ]  # fmt: skip


def _plain(parameters: Mapping[str, Any] | None) -> str:
    """Parameters that are set."""
    kept = {k: v for k, v in (parameters or {}).items() if v not in (None, [], "")}
    return ", ".join(f"{k} = {v if isinstance(v, str) else json.dumps(v)}" for k, v in kept.items())
