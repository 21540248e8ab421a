"""Cameras before and after, what the flight could tell, mount, clock and bias."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from georef_gis.frames import Array
from georef_gis.measure.report.draw import (
    BLUE,
    GREY,
    ORANGE,
    RED,
    few,
    metres,
    new_figure,
    number,
    plural,
    png,
    with_grid,
)
from georef_gis.measure.report.facts import Facts
from georef_gis.measure.report.page import Item, Picture, Table, Text, Verdict, judged
from georef_gis.model.camera import PARAMETERS, Camera

# sigmas of its prior beyond which an unknown is named
FAR = 3.0
# names that still can be read beside a correlation matrix
MOST_NAMES = 60
MOST_CAMERAS = 4


def unknowns_of(facts: Facts) -> list[Mapping[str, Any]]:
    """Shared unknowns of the adjustment."""
    if facts.adjustment is None:
        return []
    return list((facts.adjustment.report.get("observability") or {}).get("unknowns") or ())


# -- cameras -----------------------------------------------------------------------------------


def camera_items(facts: Facts) -> list[Item]:
    """Interior orientations before and after, and the curve of the distortion."""
    items: list[Item] = []
    adjusted = {
        (row["extra"] or {})["adjusted_of"]: row
        for row in facts.camera_rows
        if (row["extra"] or {}).get("adjusted_of") and facts.adjustment is not None
    }
    before = [row for row in facts.camera_rows if not (row["extra"] or {}).get("adjusted_of")]
    for row in before[:MOST_CAMERAS]:
        key = row["camera_id"]
        after = adjusted.get(key)
        items.append(_parameters(facts, key, row, after))
        new = facts.cameras[after["camera_id"]] if after is not None else None
        plain = facts.cameras[key].model == "brown"
        if new is None and plain and not np.any(facts.cameras[key].parameters[4:9]):
            items.append(Text(lines=("Nothing is known of its distortion: none is applied.",)))
        else:
            items.append(distortion(facts.cameras[key], new))
    if len(before) > MOST_CAMERAS:
        items.append(Text(lines=(f"{len(before) - MOST_CAMERAS} more cameras are not shown.",)))
    return items


def _parameters(facts: Facts, key: str, row: Any, after: Any) -> Table:
    old = np.array(row["parameters"], dtype=np.float64)
    priors = {u["name"]: u for u in unknowns_of(facts)}
    new = np.array(after["parameters"], dtype=np.float64) if after is not None else None
    spread = _sigmas(after)
    rows, far = [], []
    for i, name in enumerate(PARAMETERS):
        own = priors.get(f"{key} {'f' if name == 'fx' else name}")
        prior = float(own["prior_sigma"]) if own else math.nan
        digits = 2 if name[0] in "fcb" else 6
        found = None if new is None else float(new[i])
        off = (float(own["value"]) / prior) if own and prior else math.nan
        if abs(off) > FAR:
            far.append(name)
        rows.append(
            (
                name, number(float(old[i]), digits), number(prior, digits), number(found, digits),
                number(spread.get(name), digits), number(off, 1, sign=True),
                "held by its prior" if own and own["held_by_prior"] else "",
            )
        )  # fmt: skip
    if new is None:
        told = f"not calibrated; from {row['source']}."
        return Table(
            title=f"Camera {key}", columns=("Parameter", "Value"),
            rows=[line[:2] for line in rows], verdict=Verdict(level="told", text=told),
        )  # fmt: skip
    rows.append(
        (
            "readout (s)", number(row["readout_s"], 4), "",
            number(after["readout_s"], 4), "", "", "",
        )
    )  # fmt: skip
    told = f"focal length {old[0]:.1f} to {new[0]:.1f} px ({new[0] / old[0] - 1:+.2%})"
    told += f"; beyond {FAR:g} prior sigmas: {', '.join(far)}" if far else ""
    verdict = judged(told + f"; before from {row['source']}.", fine=not far)
    return Table(
        title=f"Camera {key}", rows=rows, words=(0, 6),
        columns=("Parameter", "Before", "Prior σ", "Adjusted", "σ", "Prior σ moved", ""),
        look="px for fx to cy, b1, b2; each value should stay within 3 prior sigmas.",
        verdict=verdict,
    )  # fmt: skip


def _sigmas(row: Any) -> dict[str, float]:
    """Sigmas of an adjusted camera by parameter.

    Its covariance is of f cx cy k1 k2 k3 p1 p2 b1 b2 readout; fx and fy are both f.
    """
    if row is None or row["covariance"] is None:
        return {}
    c = np.array(row["covariance"], dtype=np.float64)
    if c.shape != (11, 11):
        return {}
    sd = np.sqrt(np.maximum(np.diag(c), 0.0))
    names = ("fx", *PARAMETERS[2:])
    out = {name: float(v) for name, v in zip(names, sd[:10], strict=True)}
    out["fy"] = out["fx"]
    return {name: value for name, value in out.items() if value > 0}


def displacement(camera: Camera, radius: Array) -> Array:
    """Outward displacement by distortion, px, at radii of the ideal picture, px; mean of 8 ways."""
    turn = np.arange(8) * math.pi / 4
    way = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    xy = radius[:, None, None] / camera.fx * way
    ideal = np.concatenate([xy, np.ones((*xy.shape[:-1], 1))], axis=-1)
    off = camera.project(ideal) - [camera.cx, camera.cy]
    with np.errstate(invalid="ignore"):
        return np.asarray(np.mean(np.linalg.norm(off, axis=-1), axis=1) - radius)


def _to_corner(camera: Camera, corner: float) -> tuple[Array, Array, bool]:
    """Ideal radii and displacements, px, out to a corner or to where the model turns back.

    The last value tells whether the corner, `corner` px from the principal point, was reached.
    """
    # A barrel's ideal picture is larger than what is seen, that of a fisheye by far.
    reach = 1.6 if camera.model == "brown" else 8.0
    radius = np.linspace(0.0, reach * corner, 481)[1:]
    found = displacement(camera, radius)
    seen = radius + found
    with np.errstate(invalid="ignore"):
        good = np.isfinite(seen) & (np.diff(seen, prepend=0.0) > 0)
        there = good & (seen >= corner)
    turned = len(good) if np.all(good) else int(np.argmin(good))
    first = int(np.argmax(there)) if np.any(there) else len(good)
    whole = first < turned
    stop = max(min(first + 1, turned), 1)
    return radius[:stop], found[:stop], whole


def distortion(before: Camera, after: Camera | None) -> Picture:
    """Displacement by distortion over the radius, before and after."""
    camera = after or before
    corner = float(np.max(np.linalg.norm(camera.corners_uv - [camera.cx, camera.cy], axis=1)))
    radius, found, whole = _to_corner(camera, corner)
    figure = new_figure(7.6, 3.2)
    axis = figure.subplots()
    axis.axhline(0.0, color=GREY, lw=0.8)
    axis.plot(radius, displacement(before, radius), "--", color=ORANGE, lw=1.6, label="before")
    if after is not None:
        axis.plot(radius, found, color=BLUE, lw=1.8, label="adjusted")
    half = min(camera.width, camera.height) / 2
    axis.axvline(half, color=GREY, lw=0.8, ls=":")
    axis.annotate("edge of the short side", (half, 0.02), xycoords=("data", "axes fraction"),
                  rotation=90, ha="right", fontsize=7.5, color=GREY)  # fmt: skip
    axis.set_xlabel("distance from the principal point (px)", fontsize=9)
    axis.set_ylabel("moved outward (px)", fontsize=9)
    axis.legend(fontsize=8.5, frameon=False)
    with_grid(axis)
    at = float(found[-1])
    old = displacement(before, radius)
    change = float(np.max(np.abs(found - old), where=np.isfinite(old), initial=0.0))
    told = f"{number(at, 1, sign=True)} px in the furthest corner ({at / corner:+.2%}), "
    told += f"up to {change:.1f} px from before." if after is not None else "not adjusted."
    if not whole:
        told = "the curve turns back inside the picture: the model does not hold in the corners."
    return Picture(
        title=f"Distortion of {before.id}",
        data=png(figure),
        alt="Curve of the displacement by lens distortion over the distance from the middle",
        look="The curve must be smooth and must not break off before its end at the right.",
        verdict=judged(told, fine=whole, bad=not whole),
        narrow=True,
    )


# -- what the flight could tell -------------------------------------------------------------------


def observability_items(facts: Facts) -> list[Item]:
    """Unknowns with what held them, and their correlations."""
    unknowns = unknowns_of(facts)
    if not unknowns or facts.adjustment is None:
        return []
    seen = facts.adjustment.report["observability"]
    short = short_names(unknowns)
    held = [short[u["name"]] for u in unknowns if u["held_by_prior"]]
    # Those of a camera are judged with it.
    far = [u["name"] for u in unknowns if _moved(u) > FAR and not _of_camera(u)]
    rows = [
        (
            short[u["name"]], *_with_unit(u), number(_moved(u), 1), "prior" if u["held_by_prior"]
            else "flight",
        )
        for u in unknowns
    ]  # fmt: skip
    told = f"{len(unknowns) - len(held)} of {plural(len(unknowns), 'unknown')} were told by this "
    told += f"flight; held by their priors: {few(held, 8)}" if held else "flight"
    told += f"; further than {FAR:g} sigmas from the prior: {few(far)}" if far else ""
    table = Table(
        title="Shared unknowns", rows=rows, words=(0, 5),
        columns=("Unknown", "Step from prior", "σ", "Prior σ", "Prior σ moved", "Told by"),
        look="What is held by its prior is as good as what was known before, no better.",
        verdict=judged(told + ".", fine=not far),
    )  # fmt: skip
    correlation = np.array(seen.get("correlation") or (), dtype=np.float64)
    items: list[Item] = [table]
    if correlation.shape == (len(unknowns), len(unknowns)) and len(unknowns) > 1:
        pairs = seen.get("badly_separated") or ()
        items.append(_correlations(correlation, short, pairs, float(seen["condition"])))
    return items


def _moved(u: Mapping[str, Any]) -> float:
    return abs(u["value"]) / u["prior_sigma"] if u["prior_sigma"] else 0.0


def _with_unit(u: Mapping[str, Any]) -> tuple[str, str, str]:
    """Step, sigma, prior sigma; angles in degrees."""
    factor, unit = (math.degrees(1.0), "deg") if u["unit"] == "rad" else (1.0, u["unit"])
    return tuple(  # type: ignore[return-value]
        f"{factor * u[name]:{sign}.3g} {unit}".strip()
        for name, sign in (("value", "+"), ("sigma", ""), ("prior_sigma", ""))
    )


def _correlations(
    correlation: Array,
    short: Mapping[str, str],
    pairs: Sequence[Sequence[Any]],
    condition: float,
) -> Picture:
    size = float(np.clip(2.6 + 0.2 * len(short), 4.5, 10.5))
    figure = new_figure(size + 0.8, size)
    axis = figure.subplots()
    image = axis.imshow(correlation, cmap="RdBu_r", vmin=-1, vmax=1, interpolation="nearest")
    names = list(short.values())
    at = range(len(names)) if len(names) <= MOST_NAMES else ()
    axis.set_xticks(list(at), [names[i] for i in at], rotation=90, fontsize=7.5)
    axis.set_yticks(list(at), [names[i] for i in at], fontsize=7.5)
    for i, row in enumerate(correlation):
        for j, value in enumerate(row):
            if i != j and abs(value) > 0.9:
                axis.plot(j, i, "s", mfc="none", mec=RED, ms=7, mew=1.4)
    bar = figure.colorbar(image, ax=axis, shrink=0.7)
    bar.set_label("correlation", fontsize=9)
    digits = math.log10(condition) if condition > 1 else 0.0
    told = f"{plural(len(pairs), 'pair')} beyond 0.9"
    named = [f"{short.get(a, a)} and {short.get(b, b)} ({r:+.2f})" for a, b, r in pairs]
    told += f": {few(named)}" if pairs else ""
    told += f"; condition 10^{digits:.0f} of the 10^16 that numbers hold."
    mixed = [p for p in pairs if _owner(str(p[0])) != _owner(str(p[1]))]
    return Picture(
        title="Correlations of the unknowns",
        data=png(figure),
        alt="Matrix of the correlations between the shared unknowns",
        look="Dark squares off the diagonal (red frames: beyond 0.9) are unknowns that this flight "
        "cannot tell apart; within one camera that does no harm, between camera, mount and clock "
        "it asks for two flying heights or crossed lines.",
        verdict=judged(told, fine=not mixed and digits < 13, bad=digits > 15),
        narrow=True,
    )


def short_names(unknowns: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """Names to show: cameras, whose own names are long, are called so and counted."""
    owners = dict.fromkeys(_owner(str(u["name"])) for u in unknowns if _of_camera(u))
    many = len(owners) > 1
    said = {owner: f"camera {i}" if many else "camera" for i, owner in enumerate(owners, 1)}
    out = {}
    for u in unknowns:
        name = str(u["name"])
        own = name.rpartition(" ")[2]
        out[name] = f"{said[_owner(name)]} {own}" if _of_camera(u) else name
    return out


def _of_camera(u: Mapping[str, Any]) -> bool:
    own = str(u["name"]).rpartition(" ")[2]
    return own in {"f", *PARAMETERS, "readout_s"}


def _owner(name: str) -> str:
    return name.rpartition(" ")[0]


# -- mount, clock and bias ------------------------------------------------------------------------


def flight_items(facts: Facts) -> list[Item]:
    """What each flight learned of its mount, clock and receiver."""
    if facts.adjustment is None or not facts.flights:
        return []
    prior = {u["name"]: u for u in unknowns_of(facts)}
    rows, far, held = [], [], []
    for flight in facts.flights:
        extra = flight["extra"] or {}
        label = extra.get("adjusted_of") or flight["flight_id"]
        c = np.array(extra.get("covariance") or (), dtype=np.float64)
        if c.shape != (10, 10) or flight["boresight"] is None:
            continue
        sd = np.sqrt(np.maximum(np.diag(c), 0.0))
        values = [
            *extra["lever_arm_step_m"], *flight["boresight"], *flight["bias_enu"],
            flight["clock_offset_s"],
        ]  # fmt: skip
        for name, value, sigma in zip(extra["names"], values, sd, strict=True):
            own = prior.get(f"{label} {name}")
            if own is None:
                continue
            if own["held_by_prior"]:
                held.append(name)
            if _moved(own) > FAR:
                far.append(f"{label} {name}")
            rows.append((f"{label} {name}", *_flight_value(name, value, sigma),
                         number(_moved(own), 1),
                         "prior" if own["held_by_prior"] else "flight"))  # fmt: skip
    if not rows:
        return []
    told = f"{len(rows) - len(held)} of {plural(len(rows), 'value')} were told by the flights"
    told += f"; further than {FAR:g} prior sigmas: {few(far)}" if far else ""
    return [
        Table(
            title="Mount, boresight, receiver and clock by flight",
            columns=("Value", "Step", "σ", "Prior σ moved", "Told by"), rows=rows,
            words=(0, 4),
            look="Steps from what project.toml states: lever arm and boresight in body axes "
            "(forward, right, down), bias of the receiver in east, north, up, clock of the camera.",
            verdict=judged(told + ".", fine=not far),
        )
    ]  # fmt: skip


def _flight_value(name: str, value: float, sigma: float) -> tuple[str, str]:
    if name.startswith("boresight"):
        return f"{math.degrees(value):+.3f} deg", f"{math.degrees(sigma):.3f} deg"
    if name == "clock":
        return f"{number(1000 * value, 1, sign=True)} ms", f"{number(1000 * sigma, 1)} ms"
    return metres(value, sign=True), metres(sigma)
