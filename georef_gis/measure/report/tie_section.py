"""The tie map: which photos share points, and which stand alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from georef_gis.frames import Array
from georef_gis.measure.report.draw import (
    BLACK,
    RED,
    extent_of,
    few,
    map_figure,
    names_at,
    plural,
    png,
    scale_and_north,
)
from georef_gis.measure.report.facts import Facts
from georef_gis.measure.report.page import Item, Picture, Table, Text, Verdict, judged

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# photos that a photo must share points with, so that one wrong match cannot carry it off
ENOUGH_NEIGHBOURS = 2
# share of its picture that a pair must have in common for a match to be expected
EXPECTED_OVERLAP = 0.4


def tie_items(facts: Facts) -> list[Item]:
    """Tie map and what matching changed."""
    if facts.quick:
        return [Text(lines=("A quick run matches nothing: there is no tie map.",))]
    if facts.matches is None:
        return [Text(lines=("The photos were not matched with each other: there is no tie map.",))]
    pairs = [pair for pair in facts.matches.get("pairs") or () if len(pair.get("ids", ())) == 2]
    items: list[Item] = [_tie_map(facts, pairs)]
    turns = facts.matches.get("turns") or {}
    told = [
        (key, _turn_told(turn), str(turn.get("evidence", "")))
        for key, turn in turns.items()
        if turn.get("quarter_deg") or turn.get("correct")
    ]
    if told:
        columns = ("Photo", "Taken as", "Why")
        look = "Compare one of them with its neighbours; the tags of these photos are wrong."
        items.append(
            Table(
                title="Photos that the pixels turn against their tags", columns=columns,
                rows=told, words=(0, 1, 2), look=look,
                verdict=judged(f"{plural(len(told), 'photo')} turned.", fine=False),
            )
        )  # fmt: skip
    return items


def _turn_told(turn: Mapping[str, Any]) -> str:
    parts = []
    if turn.get("quarter_deg"):
        parts.append(f"picture turned by {turn['quarter_deg']} deg")
    if turn.get("correct"):
        parts.append(f"heading {np.degrees(float(turn['yaw'])):+.1f} deg")
    return ", ".join(parts)


def _tie_map(facts: Facts, pairs: Sequence[Mapping[str, Any]]) -> Picture:
    places = _places(facts)
    good = [p for p in pairs if p.get("inliers") and all(key in places for key in p["ids"])]
    neighbours = dict.fromkeys(places, 0)
    for pair in good:
        for key in pair["ids"]:
            neighbours[key] += 1
    figure, axis = map_figure(extent_of(places.values(), share=0.1))
    _lines(figure, axis, good, places)
    _dots(axis, places, neighbours)
    names_at(axis, places, most=40)
    scale_and_north(axis)
    return Picture(
        title="Tie map",
        data=png(figure),
        alt=f"Positions of {plural(len(places), 'photo')}, joined by lines where two share points",
        look="Lines join photos that share verified points, darker for more; strips must be joined "
        "across as well as along, and no photo may stand alone (red cross).",
        verdict=_verdict(facts, pairs, neighbours),
    )


def _places(facts: Facts) -> dict[str, Array]:
    poses = {**facts.direct, **facts.adjusted}
    if not poses:
        return {}
    xy = facts.local_of_enu(np.array([pose.origin_enu for pose in poses.values()]))
    return dict(zip(poses, xy, strict=True))


def _lines(
    figure: Figure, axis: Axes, pairs: Sequence[Mapping[str, Any]], places: Mapping[str, Array]
) -> None:
    """Lines of the pairs, the strongest on top."""
    if not pairs:
        return
    from matplotlib.collections import LineCollection
    from matplotlib.colors import LogNorm

    pairs = sorted(pairs, key=lambda pair: int(pair["inliers"]))
    count = np.array([int(pair["inliers"]) for pair in pairs], dtype=np.float64)
    low, high = float(max(count.min(), 1.0)), float(count.max())
    lines = LineCollection(
        [[tuple(places[key]) for key in pair["ids"]] for pair in pairs],
        cmap="viridis_r", norm=LogNorm(low, max(high, low * 1.01)), linewidths=1.3,
    )  # fmt: skip
    lines.set_array(count)
    axis.add_collection(lines)
    bar = figure.colorbar(lines, ax=axis, shrink=0.7, pad=0.01)
    bar.set_label("points that two photos share", fontsize=9)
    ticks = [t for t in (10, 20, 50, 100, 200, 500, 1000, 2000, 5000) if low <= t <= high]
    marks = [float(t) for t in ticks] or [low]
    bar.set_ticks(marks, labels=[f"{t:g}" for t in marks])
    bar.minorticks_off()


def _dots(axis: Axes, places: Mapping[str, Array], neighbours: Mapping[str, int]) -> None:
    tied = [key for key, n in neighbours.items() if n]
    alone = [key for key, n in neighbours.items() if not n]
    if tied:
        axis.plot(
            *np.array([places[k] for k in tied]).T, "o", color=BLACK, ms=5, ls="none", zorder=5,
            label=f"tied ({len(tied)})",
        )  # fmt: skip
    if alone:
        axis.plot(
            *np.array([places[k] for k in alone]).T, "X", color=RED, ms=10, ls="none", zorder=6,
            label=f"not tied ({len(alone)})",
        )  # fmt: skip
    axis.legend(loc="lower right", fontsize=8.5)


def _verdict(
    facts: Facts, pairs: Sequence[Mapping[str, Any]], neighbours: Mapping[str, int]
) -> Verdict:
    if not neighbours:
        return judged("no photo has a place.", fine=False, bad=True)
    alone = [key for key, n in neighbours.items() if n == 0]
    weak = [key for key, n in neighbours.items() if 0 < n < ENOUGH_NEIGHBOURS]
    groups = [g for g in (facts.matches or {}).get("components") or () if len(g) > 1]
    near = [p for p in pairs if float(p.get("overlap") or 0.0) >= EXPECTED_OVERLAP]
    met = sum(bool(p.get("inliers")) for p in near)
    told = f"{len(neighbours) - len(alone)} of {plural(len(neighbours), 'photo')} are tied, "
    told += f"in {plural(len(groups), 'group')}"
    if near:
        told += f"; {met} of {plural(len(near), 'pair')} that overlap by 40 % or more were matched"
    told += f"; not tied: {few(alone)}" if alone else ""
    told += f"; tied to one photo only: {few(weak)}" if weak else ""
    fine = not alone and not weak and len(groups) <= 1 and met >= 0.7 * len(near)
    return judged(told + ".", fine=fine, bad=len(alone) > 0.3 * len(neighbours))
