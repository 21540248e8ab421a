"""The adjustment in figures: may it be believed, how well each photo is known, what moved."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from georef_gis.frames import Array, exp_so3, log_so3
from georef_gis.measure.report.draw import (
    BLUE,
    GREY,
    ORANGE,
    SKY,
    WIDE,
    few,
    metres,
    new_figure,
    number,
    plural,
    png,
    with_grid,
)
from georef_gis.measure.report.facts import Facts
from georef_gis.measure.report.flight_facts import in_flight_order
from georef_gis.measure.report.not_adjusted import not_adjusted_item
from georef_gis.measure.report.page import Item, Picture, Table, judged

# rows of the table of photos; the rest is in adjustment/report.json
MOST_PHOTOS = 400
# share of differences that must lie within 2 sigmas of the direct poses (normal: 95 %)
WITHIN = 0.85


def adjustment_items(facts: Facts) -> list[Item]:
    """Key figures, checks, photos; or why there are none."""
    if facts.adjustment is None:
        return [not_adjusted_item(facts)]
    report = facts.adjustment.report
    items: list[Item] = [_key_figures(report), _checks(report)]
    items.append(_photos(facts, report))
    weighed = report.get("weighed_down") or ()
    if weighed:
        rows = [(str(w["photo"]), str(w["what"]), f"{w['sigmas']:.1f}") for w in weighed[:60]]
        names = sorted({row[0] for row in rows})
        items.append(
            Table(
                title="Navigation that was weighed down", columns=("Photo", "Value", "Sigmas off"),
                rows=rows, words=(0, 1),
                look="These positions or angles contradict the rest of their flight.",
                verdict=judged(f"{plural(len(weighed), 'value')} of {few(names)}.", fine=False),
            )
        )  # fmt: skip
    return items


def _key_figures(report: Mapping[str, Any]) -> Table:
    photos = report.get("photos") or ()
    rms = [p["rms_px"] for p in photos if p["rms_px"] is not None]
    sigma = np.array([p["sigma_m"] for p in photos]).reshape(-1, 3)
    turn = np.array([p["sigma_deg"] for p in photos]).reshape(-1, 3)
    wrong, kept = int(report["wrong_matches"]), int(report["observations"])
    share = wrong / max(wrong + kept, 1)
    rows = [
        ("Photos with tie points", f"{len(rms)} of {len(photos)}"),
        ("Ground points", str(report["points"])),
        ("Observations kept", str(kept)),
        ("Wrong matches taken out", f"{wrong} ({share:.1%})"),
        ("Median rms residual of a photo", f"{number(float(np.median(rms)) if rms else None)} px"),
        ("sigma0 (scatter by what was claimed)", number(report["sigma0"])),
        ("Sigma of positions, east / north / up", _three(sigma, metres)),
        ("Sigma of angles about east / north / up", _three(turn, lambda v: f"{v:.3f} deg")),
        ("Converged", "yes" if report.get("converged") else "no"),
    ]
    sigma0 = float(report["sigma0"])
    told = f"sigma0 is {sigma0:.2f} and the search did {'' if report.get('converged') else 'not '}"
    told += f"end; {share:.1%} of the matches were wrong."
    fine = bool(report.get("converged")) and sigma0 <= 1.5 and share < 0.15
    return Table(
        title="Adjustment", columns=("What", "Value"), rows=rows, words=(0, 1),
        look="sigma0 near 1 means that the pixels scatter as was claimed; below, they are better, "
        "above, worse.",
        verdict=judged(told, fine=fine, bad=sigma0 > 5.0),
    )  # fmt: skip


def _three(values: Array, told: Any) -> str:
    if not len(values):
        return "-"
    return " / ".join(told(float(v)) for v in np.median(values, axis=0)) + " (median)"


def _checks(report: Mapping[str, Any]) -> Table:
    checks = report.get("checks") or ()
    rows, failed = [], []
    for c in checks:
        off = abs(c["value"] - c["expected"]) / c["sigma"] if c["sigma"] else math.nan
        unit = f" {c['unit']}" if c["unit"] else ""
        rows.append(
            (
                c["name"], f"{c['value']:.5g}{unit}", f"{c['expected']:.5g}{unit}",
                f"{c['sigma']:.2g}{unit}", number(off, 1), "passed" if c["passed"] else "FAILED",
            )
        )  # fmt: skip
        if not c["passed"]:
            failed.append(c["name"])
    far = [row[0] for row, c in zip(rows, checks, strict=True) if c["passed"] and _far(c)]
    told = f"{len(checks) - len(failed)} of {plural(len(checks), 'check')} passed"
    told += f"; beyond 2 sigmas, though passed: {few(far)}" if far else ""
    return Table(
        title="Checks against what was known before", rows=rows, words=(0, 5),
        columns=("Check", "Found", "Expected", "One sigma", "Sigmas off", "Verdict"),
        look="Small residuals alone prove nothing: size, height and angles must agree with tags, "
        "log and camera.",
        verdict=judged(told + ".", fine=not failed and not far, bad=bool(failed)),
    )  # fmt: skip


def _far(check: Mapping[str, Any]) -> bool:
    return bool(abs(check["value"] - check["expected"]) > 2.0 * check["sigma"])


def _photos(facts: Facts, report: Mapping[str, Any]) -> Table:
    turns = {key: math.degrees(float(np.linalg.norm(v))) for key, v in turns_of(facts).items()}
    photos = list(report.get("photos") or ())
    rows = []
    for p in photos[:MOST_PHOTOS]:
        moved = p["moved_m"]
        rows.append(
            (
                p["photo"], str(p["observations"]), number(p["rms_px"]), str(p["wrong_matches"]),
                *(metres(v) for v in p["sigma_m"]),
                number(max(p["sigma_deg"][:2]), 3), number(p["sigma_deg"][2], 3),
                metres(math.hypot(*moved[:2])), metres(moved[2], sign=True),
                number(turns.get(p["photo"]), 2),
                f"{p['turned_deg']}" if p["turned_deg"] else "",
            )
        )  # fmt: skip
    weak = [p["photo"] for p in photos if p["observations"] < 20]
    told = f"{len(photos) - len(weak)} of {plural(len(photos), 'photo')} have 20 tie points or more"
    told += f"; fewer: {few(weak)}" if weak else ""
    more = len(photos) - MOST_PHOTOS
    told += f"; {more} more photos are in adjustment/report.json" if more > 0 else ""
    return Table(
        title="Photos of the adjustment", rows=rows,
        columns=(
            "Photo", "Tie points", "rms (px)", "Wrong", "σ east", "σ north", "σ up",
            "σ tilt (°)", "σ heading (°)", "Moved", "Raised", "Turned (°)", "Picture (°)",
        ),
        look="Moved, raised and turned are against the direct pose, sigmas are one standard "
        "deviation; Picture is the quarter turn of its pixels.",
        verdict=judged(told + ".", fine=not weak),
    )  # fmt: skip


# -- direct against adjusted ---------------------------------------------------------------------


def turns_of(facts: Facts) -> dict[str, Array]:
    """Rotation vector, rad in enu, from the direct to the adjusted pose of each photo.

    Quarter turns of the pixels, which say nothing about the aircraft, are taken off.
    """
    out = {}
    before, after = facts.turned["direct"], facts.turned["adjusted"]
    for key, pose in facts.adjusted.items():
        if key not in facts.direct:
            continue
        R = pose.R_enu_from_cam
        steps = round((after.get(key, 0) - before.get(key, 0)) / 90) % 4
        choices = [
            log_so3(R @ exp_so3([0.0, 0.0, s * math.pi / 2]) @ facts.direct[key].R_enu_from_cam.T)
            for s in {steps, -steps % 4}
        ]
        out[key] = min(choices, key=lambda v: float(np.linalg.norm(v)))
    return out


def navigation_items(facts: Facts) -> list[Item]:
    """Differences of adjusted and direct poses, in the order of the flight."""
    turns = turns_of(facts)
    if len(turns) < 2:
        return []
    order, x, by_time = in_flight_order(facts, list(turns))
    label = "time since the first photo (s)" if by_time else "number of the photo"
    moved = np.array([facts.adjusted[k].origin_enu - facts.direct[k].origin_enu for k in order])
    turned = np.degrees([turns[k] for k in order])
    sigma = np.array([np.sqrt(np.diag(facts.direct[k].covariance)) for k in order])
    level = np.array([facts.direct[k].sigma_height_shared for k in order])
    sigma[:, 2] = np.hypot(sigma[:, 2], level)
    sigma[:, 3:] = np.degrees(sigma[:, 3:])
    figure = new_figure(WIDE, 5.0)
    panels = figure.subplots(2, 3, sharex=True)
    names = ("east (m)", "north (m)", "up (m)", "about east (deg)", "about north (deg)",
             "about up (deg)")  # fmt: skip
    both = np.hstack([moved, turned])
    for k, (axis, name) in enumerate(zip(panels.ravel(), names, strict=True)):
        axis.fill_between(x, -sigma[:, k], sigma[:, k], color=SKY, alpha=0.35, lw=0, label="±1σ")
        axis.axhline(0.0, color=GREY, lw=0.8)
        axis.plot(x, both[:, k], ".-", color=BLUE if k < 3 else ORANGE, ms=5, lw=0.8)
        axis.set_title(name, fontsize=9.5)
        with_grid(axis)
    for axis in panels[1]:
        axis.set_xlabel(label, fontsize=9)
    panels[0, 0].legend(fontsize=8, loc="upper right")
    inside = np.abs(both) <= 2.0 * sigma
    share = inside.mean(axis=0)
    worst = int(np.argmin(share))
    told = (
        f"{inside.mean():.0%} of the differences lie within 2 sigmas (normal: 95 %), fewest "
        f"{names[worst].split(' (')[0]} with {share[worst]:.0%}; median move "
        f"{metres(float(np.median(np.linalg.norm(moved, axis=1))))}, median turn "
        f"{float(np.median(np.linalg.norm(turned, axis=1))):.2f} deg."
    )
    bad = bool(inside.mean() < 0.5)
    return [
        Picture(
            title="Adjusted less direct poses",
            data=png(figure),
            alt="Six graphs of the differences of position and angle over the flight",
            look="The dots should stay about the blue band, which is one sigma of the direct "
            "poses; a steady offset is a mount, a clock or a datum, a jump is a doubtful photo.",
            verdict=judged(told, fine=bool(inside.mean() >= WITHIN), bad=bad),
        )
    ]
