"""How the result came about: every tool's last run, versions, and project.toml as it is."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from georef_gis.measure.report.draw import few, plural
from georef_gis.measure.report.facts import Facts
from georef_gis.measure.report.page import Item, Letter, Table, Text, judged

# a space at which no line ends
_KEPT = "\u00a0"
# characters of project.toml that are shown
LONGEST_SETTINGS = 40_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Made:
    """By what and with which settings the result was made.

    Parameters
    ----------
    versions
        Libraries and programs with their versions.
    settings
        Text of project.toml.
    changed
        Tool -> sections of project.toml that are not what its last run had.
    """

    versions: Sequence[tuple[str, str]] = ()
    settings: str = ""
    changed: Mapping[str, Sequence[str]] = field(default_factory=dict)


def runs_items(facts: Facts, without: str, made: Made | None = None) -> list[Item]:
    """Tables of the last runs, but for the tool that writes this, and of versions; settings."""
    items: list[Item] = [_runs(facts, without)]
    if made is None:
        return items
    if made.versions:
        items.append(
            Table(title="Versions", columns=("What", "Version"), rows=made.versions, words=(0, 1))
        )
    if made.settings:
        items += [_settings(made), Letter(title="project.toml", text=_stated(made.settings))]
    return items


def _runs(facts: Facts, without: str) -> Table:
    runs = [run for run in facts.runs if run["tool"].rpartition(":")[2] != without]
    rows = [
        (
            run["tool"].removeprefix("georef:"), str(run["fid"]),
            str(run["started"])[:19].replace(" ", _KEPT), f"{run['duration_s'] or 0.0:.1f}",
            str(run["outcome"]), _plain(run["parameters"]),
            _version(run["versions"] or {}),
        )
        for run in runs
    ]  # fmt: skip
    bad = [row[0] for row in rows if row[4] not in ("done", "refused")]
    total = sum(float(run["duration_s"] or 0.0) for run in runs)
    told = f"{plural(len(rows), 'tool')} in {total:.0f} s of working time"
    told += f"; not done: {few(bad)}" if bad else "; all done"
    return Table(
        title="Last runs", rows=rows, words=(0, 2, 4, 5, 6),
        columns=("Tool", "Run", "Started (UTC)", "Seconds", "Outcome", "Parameters", "Version"),
        look="Run is the number in the table `run` of georef.gpkg, where fingerprints of settings "
        "and inputs stand too.",
        verdict=judged(told + ".", fine=not bad),
    )  # fmt: skip


def _settings(made: Made) -> Text:
    told = "every tool's last run had the settings that stand below."
    if made.changed:
        each = [f"{tool} ({', '.join(parts)})" for tool, parts in made.changed.items()]
        told = f"settings changed after the last run of {few(each)}: `georef run` renews them."
    return Text(
        title="Settings",
        lines=("What project.toml states, without its comments; all else is at its default.",),
        verdict=judged(told, fine=not made.changed),
    )  # fmt: skip


def _version(versions: Mapping[str, Any]) -> str:
    """Version of the tool, and of the package that it comes from."""
    packages = [
        str(v) if k == "georef-gis" else f"{k} {v}" for k, v in versions.items() if k != "tool"
    ]
    return f"{', '.join(packages)} (tool {versions.get('tool', '-')})".replace(" ", _KEPT)


def _stated(text: str) -> str:
    """Lines that state something: the defaults stand in project.toml as comments."""
    kept: list[str] = []
    for line in text.splitlines():
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        # a section that states nothing
        if line.startswith("[") and kept and _is_head(kept[-1]):
            kept.pop()
        kept.append(line.rstrip())
    if kept and _is_head(kept[-1]):
        kept.pop()
    out = "\n".join(kept)
    more = len(out) - LONGEST_SETTINGS
    return out if more <= 0 else f"{out[:LONGEST_SETTINGS]}\n... and {more} characters more"


def _is_head(line: str) -> bool:
    return line.startswith("[") and line.split("#")[0].rstrip().endswith("]")


def _plain(parameters: Mapping[str, Any] | None) -> str:
    """Parameters that are set."""
    kept = {k: v for k, v in (parameters or {}).items() if v not in (None, [], "")}
    return ", ".join(f"{k} = {v if isinstance(v, str) else json.dumps(v)}" for k, v in kept.items())
