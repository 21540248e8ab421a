"""All that was doubtful, in one list: of photos, assets, points and tools."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from georef_gis.measure.report.assets_section import AssetFacts, called, far_assets
from georef_gis.measure.report.control_section import FAR, normalised
from georef_gis.measure.report.draw import few, plural
from georef_gis.measure.report.facts import DONE, Facts
from georef_gis.measure.report.page import Item, Table, judged

# rows of the list; more are counted
MOST = 300
# names that stand in one row
MOST_NAMES = 12
KINDS = ("tool", "photo", "point", "asset")
# Outcomes as the runner records them: what went wrong with a part of the project, and a question
# that could not be answered, which says nothing about the project.
FAILED, REFUSED = "failed", "refused"
_WORD = re.compile(r"[\w.-]*\w")


@dataclass(frozen=True, slots=True, kw_only=True)
class Doubt:
    """What is doubtful about one thing; `kind` is one of `KINDS`."""

    kind: str
    name: str
    text: str


def all_doubts(facts: Facts, assets: AssetFacts | None) -> list[Doubt]:
    """Every doubt once; what a tool says of a photo that is listed itself is left out."""
    photos = [
        Doubt(kind="photo", name=name, text=text)
        for name, texts in facts.doubtful.items()
        for text in dict.fromkeys(str(t) for t in texts)
    ]
    tools = [
        Doubt(kind="tool", name=_tool(run), text=line)
        for run in facts.runs
        if _tool(run) != "report" and run["outcome"] != REFUSED
        for line in _lines(run)
        if not any(d.text in line and d.name in line for d in photos)
    ]
    return [*tools, *photos, *_points(facts), *_assets(assets)]


def doubt_items(facts: Facts, assets: AssetFacts | None) -> list[Item]:
    """The list, alike doubts in one row."""
    found = all_doubts(facts, assets)
    rows = alike(found, _names_of(facts))
    count = Counter(kind for kind, _, _ in rows)
    told = ", ".join(f"{count[kind]} of {kind}s" for kind in KINDS if count[kind])
    told = f"{plural(len(rows), 'doubt')}: {told}" if told else "nothing was doubtful"
    more = len(rows) - MOST
    told += f"; {more} more stand in the tables of georef.gpkg" if more > 0 else ""
    failed = any(run["outcome"] == FAILED for run in facts.runs)
    return [
        Table(
            title="All doubts", columns=("Of", "Which", "Doubt"), rows=rows[:MOST], words=(0, 1, 2),
            look="What tools, photos, points and assets said against themselves; alike ones share "
            "a row.",
            verdict=judged(told + ".", fine=not rows, bad=failed),
        )
    ]  # fmt: skip


def alike(doubts: Iterable[Doubt], names: frozenset[str]) -> list[tuple[str, str, str]]:
    """Rows of kind, names and text; texts that differ by the name of a photo only share one.

    Parameters
    ----------
    names
        Of the photos, as texts may write them.
    """
    together: dict[tuple[str, str, str], list[Doubt]] = {}
    for doubt in sorted(doubts, key=lambda d: KINDS.index(d.kind)):
        text = _WORD.sub(lambda m: "*" if m.group() in names else m.group(), doubt.text)
        # a tool stands for itself, its text for the photos
        of = doubt.name if doubt.kind == "tool" else ""
        together.setdefault((doubt.kind, of, text), []).append(doubt)
    rows = []
    for (kind, of, _), same in together.items():
        text, which = same[0].text, of or few([d.name for d in same], MOST_NAMES)
        if of and len(same) > 1:
            others = [m.group() for d in same[1:] for m in _WORD.finditer(d.text)]
            listed = [name for name in dict.fromkeys(others) if name in names]
            text += f" (the same of {few(listed, MOST_NAMES)})"
        rows.append((kind, which, text))
    return rows


def _names_of(facts: Facts) -> frozenset[str]:
    return frozenset(
        str(row[key]) for row in facts.photos for key in ("photo_id", "name") if row.get(key)
    )


def _tool(run: Mapping[str, object]) -> str:
    return str(run["tool"]).rpartition(":")[2]


def _lines(run: Mapping[str, object]) -> Iterable[str]:
    summary, warnings = run["summary"], run["warnings"]
    doubts = summary.get("doubts", ()) if isinstance(summary, Mapping) else ()
    lines = [str(line) for line in (*doubts, *(warnings if isinstance(warnings, list) else ()))]
    if run["outcome"] not in (DONE, "started"):
        lines.insert(0, f"{run['outcome']}: {run['message']}")
    return dict.fromkeys(lines)


def _points(facts: Facts) -> list[Doubt]:
    if facts.adjustment is None:
        return []
    out = []
    for row in facts.adjustment.report.get("control") or ():
        ratio = normalised(row)
        if ratio > FAR:
            text = "differs from the adjustment by more than survey and adjustment let expect"
            out.append(Doubt(kind="point", name=f"{row['name']} ({ratio:.1f} sigmas)", text=text))
    return out


def _assets(found: AssetFacts | None) -> list[Doubt]:
    if found is None:
        return []
    out = []
    for asset in found.assets:
        name, quality = called(asset, found.titles), asset.quality
        lines = list(asset.problems)
        if quality is None or quality.sigma_e is None:
            lines.append("has no sigmas: its place was drawn or moved by hand")
        elif found.photos and (gone := [p for p in quality.photo_ids if p not in found.photos]):
            lines.append(f"was clicked in {few(gone)}, no longer in the project: it stays as "
                         "stored")  # fmt: skip
        out += [Doubt(kind="asset", name=name, text=line) for line in lines]
    far = "is far less certain than others of its class"
    return out + [
        Doubt(kind="asset", name=called(a, found.titles), text=far)
        for a in far_assets(found.assets)
    ]
