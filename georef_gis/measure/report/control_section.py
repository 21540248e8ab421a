"""Control and check points, and the accuracy statement."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from georef_gis.frames import Array
from georef_gis.measure.report.draw import (
    BLACK,
    BLUE,
    RED,
    extent_of,
    few,
    map_figure,
    metres,
    number,
    outlines,
    plural,
    png,
    round_length,
    scale_and_north,
)
from georef_gis.measure.report.facts import Facts, place_of
from georef_gis.measure.report.page import Item, Letter, Picture, Table, Text, Verdict, judged

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# sigmas of survey and adjustment together beyond which a point is named
FAR = 3.0
_PICTURES = {
    "histogram": (
        "Errors at check points",
        "Histograms of the errors along each axis",
        "The columns should gather about zero, and the dashed mean should stay within a quarter "
        "of the RMSE.",
    ),
    "scatter": (
        "Horizontal errors",
        "Horizontal errors about the truth with the circle of RMSE_H",
        "The dots should lie around the middle, not to one side.",
    ),
    "vectors": (
        "Errors on the map",
        "Errors as arrows on the map, heights as coloured dots",
        "Arrows should point anywhere; one common direction is a datum or an offset, a ring is a "
        "wrong scale.",
    ),
}  # fmt: skip


# -- control -----------------------------------------------------------------------------------


def control_items(facts: Facts) -> list[Item]:
    """Surveyed points and how the photos agree with them."""
    if not facts.control:
        return [
            Text(
                lines=(
                    "No control or check points are used ([control] file in project.toml): how far "
                    "the products are off the ground is not tested here.",
                )
            )
        ]
    report = facts.adjustment.report if facts.adjustment is not None else {}
    rows = list(report.get("control") or ())
    items: list[Item] = [_points(facts, rows)]
    if rows:
        items.append(_vectors(facts, rows))
    summary = (facts.run_of("control") or {"summary": None})["summary"] or {}
    if summary.get("compared"):
        items.append(_on_ground(summary))
    return items


def normalised(row: Mapping[str, Any]) -> float:
    """Largest of a point's differences in sigmas of survey and adjustment; NaN where untold.

    Of a control point both sigmas hold the survey, so its difference is less than they allow.
    """
    out = []
    for off, sigma, survey in zip(row["off_m"], row["sigma_m"], row["survey_sigma_m"], strict=True):
        if off is not None and survey is not None:
            out.append(abs(off) / max(math.hypot(sigma, survey), 1e-9))
    return max(out, default=math.nan)


def _points(facts: Facts, rows: Sequence[Mapping[str, Any]]) -> Table:
    found = {row["name"]: row for row in rows}
    marks: dict[str, int] = {}
    for mark in facts.marks:
        marks[mark["name"]] = marks.get(mark["name"], 0) + 1
    table, far = [], []
    for point in facts.control:
        name, row = point["name"], found.get(point["name"])
        off = row["off_m"] if row else (None, None, None)
        ratio = normalised(row) if row else math.nan
        if ratio > FAR:
            far.append(name)
        table.append(
            (
                name, str(row["role"] if row else point["role"]), str(marks.get(name, 0)),
                *(metres(v, sign=True) for v in off),
                *(metres(v) for v in (row["sigma_m"] if row else (None, None, None))),
                metres(point["sigma_h_m"]), metres(point["sigma_v_m"]),
                number(ratio, 1), number(row["rms_px"]) if row else "-",
            )
        )  # fmt: skip
    told = f"{len(found)} of {plural(len(facts.control), 'point')} were seen by the adjustment; "
    told += f"beyond {FAR:g} sigmas: {few(far)}." if far else f"none beyond {FAR:g} sigmas."
    verdict = judged(told, fine=bool(found) and not far, bad=len(far) > 0.3 * len(table))
    if facts.adjustment is None:
        verdict = Verdict(level="told", text="no adjustment used them.")
    return Table(
        title="Points", rows=table, words=(0, 1),
        columns=(
            "Point", "Role", "Marks", "Off east", "Off north", "Off up", "σ east", "σ north",
            "σ up", "Survey σ h", "Survey σ v", "Sigmas", "rms (px)",
        ),
        look="Off is adjusted less surveyed; check points were not used and are the honest test, "
        "control points were pulled to fit.",
        verdict=verdict,
    )  # fmt: skip


def _vectors(facts: Facts, rows: Sequence[Mapping[str, Any]]) -> Picture:
    places = {p["name"]: place_of(p) for p in facts.control}
    known = [r for r in rows if places.get(r["name"]) is not None and r["off_m"][0] is not None]
    rings = [facts.local(f.ring_map) for f in facts.footprints.values()]
    xy = np.array([facts.local(np.asarray(places[r["name"]])) for r in known]).reshape(-1, 2)
    d = np.array([r["off_m"][:2] for r in known], dtype=np.float64).reshape(-1, 2)
    figure, axis = map_figure(extent_of([*rings, xy] if len(xy) else rings))
    outlines(axis, rings)
    check = np.array([r["role"] == "check" for r in known], dtype=bool)
    _arrows(axis, xy, d, check)
    for row, place in zip(known, xy, strict=True):
        axis.annotate(
            row["name"], (place[0], place[1]), xytext=(5, 5), textcoords="offset points", fontsize=7
        )
    scale_and_north(axis)
    told = []
    for mask, name in ((check, "check"), (~check, "control")):
        if np.any(mask):
            h = float(np.sqrt(np.mean(np.sum(d[mask] ** 2, axis=1))))
            up = [r["off_m"][2] for r, m in zip(known, mask, strict=True) if m]
            v = [x for x in up if x is not None]
            rms = metres(float(np.sqrt(np.mean(np.square(v))))) if v else "-"
            told.append(
                f"{name} points: {metres(h)} horizontal, {rms} vertical (rms, n = {mask.sum()})"
            )
    return Picture(
        title="Points: adjusted less surveyed",
        data=png(figure),
        alt="Map with an arrow for the difference at each control and check point",
        look="Arrows of check points (blue) should be as short as their sigmas and point anywhere; "
        "long ones all one way are a datum or an antenna height.",
        verdict=_arrow_verdict(known, d, check, "; ".join(told)),
    )


def _arrows(axis: Axes, xy: Array, d: Array, check: NDArray[np.bool_]) -> None:
    if not len(xy):
        return
    left, right = axis.get_xlim()
    longest = float(np.linalg.norm(d, axis=1).max())
    key = round_length(max(longest, 1e-4))
    scale = key / (0.09 * (right - left))
    for mask, colour, mark, name in (
        (check, BLUE, "o", "check"), (~check, BLACK, "^", "control"),
    ):  # fmt: skip
        if np.any(mask):
            axis.plot(*xy[mask].T, mark, color=colour, ms=6, ls="none", label=name)
            arrows = axis.quiver(
                *xy[mask].T, *d[mask].T, angles="xy", scale_units="xy", scale=scale,
                color=RED, width=0.003, zorder=5,
            )  # fmt: skip
    axis.quiverkey(
        arrows, 0.8, 1.025, key, metres(key), labelpos="E", coordinates="axes", color=RED
    )
    axis.legend(fontsize=8.5, loc="lower right")


def _arrow_verdict(rows: Sequence[Mapping[str, Any]], d: Array, check: Array, told: str) -> Verdict:
    if not np.any(check):
        return Verdict(level="told", text=told + "; no check point tests them.")
    ratios = np.array([normalised(r) for r in rows])
    far = [r["name"] for r, v in zip(rows, ratios, strict=True) if v > FAR]
    n = int(check.sum())
    mean = d[check].mean(axis=0)
    told += f"; mean of the checks {metres(mean[0], sign=True)} east, "
    told += f"{metres(mean[1], sign=True)} north"
    one_way = False
    if n >= 3:
        error = d[check].std(axis=0, ddof=1) / math.sqrt(n)
        # 5 % of a t test of so few points, by the normal quantile widened (Hald, 1952)
        limit = 1.96 * (1.0 + 1.21 / (n - 1) + 1.2 / (n - 1) ** 2)
        one_way = bool(np.any(np.abs(mean) > limit * np.maximum(error, 1e-9)))
        told += ", more than chance gives" if one_way else ", no more than chance gives"
    told += f"; beyond {FAR:g} sigmas: {few(far)}" if far else ""
    return judged(told + ".", fine=not far and not one_way, bad=len(far) > 0.3 * len(rows))


def _on_ground(summary: Mapping[str, Any]) -> Table:
    east, north = summary["rms_east_m"], summary["rms_north_m"]
    expected = summary["expected_sigma_m"]
    ratio = math.hypot(east, north) / math.sqrt(2.0) / max(expected, 1e-9)
    rows = [
        ("Marks compared", str(summary["compared"])),
        ("Rms east / north", f"{metres(east)} / {metres(north)}"),
        ("Expected of one photo, by its sigmas", metres(expected)),
        (
            "... of points that the photos were adjusted to",
            str(summary.get("marks_adjusted_to", 0)),
        ),
    ]
    return Table(
        title="Single marks laid on the ground", columns=("What", "Value"), rows=rows, words=(0, 1),
        look="Each mark was laid on the ground by its own photo; the scatter should be near what "
        "the sigmas let expect.",
        verdict=judged(
            f"{ratio:.1f} times what is expected.", fine=ratio <= 1.5, bad=ratio > 4.0
        ),
    )  # fmt: skip


# -- accuracy ----------------------------------------------------------------------------------


def accuracy_items(facts: Facts) -> list[Item]:
    """The statement, its figures, its pictures."""
    found = facts.accuracy
    if found is None:
        return [Text(lines=("There is no accuracy statement: no check points were tested.",))]
    # The sentences that the standard prescribes come first.
    items: list[Item] = [Text(lines=tuple(found.values.get("statement") or ()))]
    for kind, values in (found.values.get("assessments") or {}).items():
        if not values.get("components"):
            continue
        items.append(_figures(kind, values))
        for name in _PICTURES:
            data = found.pictures.get(f"accuracy_{name}_{kind}.png")
            if data is not None:
                items.append(_accuracy_picture(kind, name, values, data))
    items.append(Letter(title="Statement and account", text=found.text))
    return items


def _figures(kind: str, values: Mapping[str, Any]) -> Table:
    rows = [
        (
            f"RMSE_{c['name']}" + (" (vegetated)" if c.get("vegetated") else ""), str(c["n"]),
            metres(c["rmse"]), metres(c.get("fit")), metres(c.get("survey")),
            metres(c.get("target")),
            {True: "met", False: "NOT met", None: "none declared"}[c.get("meets")],
        )
        for c in values["components"]
    ]  # fmt: skip
    failed = [c["name"] for c in values["components"] if c.get("meets") is False]
    flags = [str(flag["text"]) for flag in values.get("flags") or ()]
    told = f"class not met: {', '.join(failed)}; " if failed else ""
    told += f"{plural(len(flags), 'remark')}" + (f", first: {flags[0]}" if flags else "")
    return Table(
        title=f"RMSE of the {kind}", rows=rows, words=(0, 6),
        columns=("Component", "Points", "RMSE", "Fit", "Survey", "Declared", "Class"),
        look="RMSE holds the error of the survey; 30 check points or more, spread over the site, "
        "are asked for.",
        verdict=judged(told + ("" if flags else "."), fine=not flags and not failed,
                       bad=bool(failed)),
    )  # fmt: skip


def _accuracy_picture(kind: str, name: str, values: Mapping[str, Any], data: bytes) -> Picture:
    title, alt, look = _PICTURES[name]
    axes = [a for key, a in (values.get("axes") or {}).items() if name == "histogram" or key != "z"]
    means = [f"{a['axis']} {metres(a['mean'], sign=True)} (rmse {metres(a['rmse'])})" for a in axes]
    biased = [a["axis"] for a in axes if a["rmse"] and abs(a["mean"]) > 0.25 * a["rmse"]]
    sure = [a["axis"] for a in axes if a.get("p") is not None and a["p"] < 0.05]
    told = "mean error " + ", ".join(means)
    told += f"; above a quarter of the RMSE in {', '.join(biased)}" if biased else ""
    told += (
        f", beyond chance (5 %) in {', '.join(sure)}" if sure
        else ", which chance alone may give" if biased else ""
    )  # fmt: skip
    return Picture(
        title=f"{title}: {kind}", data=data, alt=f"{alt} ({kind})", look=look,
        verdict=replace(judged(told + ".", fine=not sure), again=name != "histogram"),
        narrow=name != "histogram",
    )  # fmt: skip
