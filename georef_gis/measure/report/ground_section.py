"""The ground: what it is made of, how well it is known, and its shades."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from georef_gis.frames import Array
from georef_gis.measure.report.draw import (
    area,
    jpeg,
    map_figure,
    metres,
    scale_and_north,
)
from georef_gis.measure.report.facts import Facts, Heights
from georef_gis.measure.report.page import Item, Picture, Table, Text, Verdict, judged

# held-out points may miss the surface by so many GSD before it asks for a look, and at least m
MISS_GSD, MISS_M = 5.0, 0.03
# share of the ground that may be steeper than 45 deg
STEEP = 0.01
# times the median sigma from which on a height is a guess
WEAK = 3.0
# light from the north-west, as on printed maps
AZIMUTH, ALTITUDE = 315.0, 45.0


def ground_items(facts: Facts, heights: Heights | None) -> list[Item]:
    """Table of the ground and its hillshade."""
    items: list[Item] = [_table(facts)]
    known = heights.z[heights.seen & np.isfinite(heights.z)] if heights is not None else None
    if heights is None or known is None or not len(known):
        items.append(Text(lines=("The ground has no relief to show.",)))
    elif float(np.ptp(known)) < 0.01:
        items.append(Text(lines=("The ground is taken as level: there is no relief to show.",)))
    else:
        items.append(_hillshade(facts, heights))
    return items


def _table(facts: Facts) -> Table:
    ground = facts.ground
    report: dict[str, Any] = {}
    if facts.adjustment is not None:
        report = facts.adjustment.report.get("ground") or {}
    rows = [
        ("What it is", str(ground.get("source", "of no known source"))),
        ("Kind", str(ground.get("kind", "-"))),
        ("One sigma of its heights", metres(ground.get("sigma_m"))),
    ]
    if ground.get("path"):
        rows.append(("File", Path(str(ground["path"])).name))
    if ground.get("sigma_shared_m"):
        rows.append(("... of it as a whole, with the photos", metres(ground["sigma_shared_m"])))
    if ground.get("height_ellipsoidal_m") is not None:
        rows.append(("Level, above the ellipsoid", metres(ground["height_ellipsoidal_m"])))
    if not report:
        told = "the ground is not made of this flight's points."
        return Table(
            title="Ground", columns=("What", "Value"), rows=rows, words=(0, 1),
            verdict=Verdict(level="told", text=told),
        )  # fmt: skip
    used, points = int(report["used"]), int(report["points"])
    rows += [
        ("Points used", f"{used} of {points}"),
        ("Left out as standing off their surroundings", str(report["blunders"])),
        ("Held-out points miss the surface by", f"{metres(report['rms_held_out_m'])} (rms)"),
        ("... a TIN", metres(report.get("rms_tin_m"))),
        ("... a plane", metres(report.get("rms_plane_m"))),
        *(("Note", str(note)) for note in report.get("notes") or ()),
    ]
    return Table(
        title="Ground", columns=("What", "Value"), rows=rows, words=(0, 1),
        look="Points that were kept out of the surface show how well it stands between its points; "
        "plants and vehicles stand off the ground and are left out.",
        verdict=_fit_verdict(facts, report, used, points),
    )  # fmt: skip


def _fit_verdict(facts: Facts, report: dict[str, Any], used: int, points: int) -> Verdict:
    miss = report["rms_held_out_m"]
    gsd = float(np.median([f.gsd for f in facts.footprints.values()]))
    if miss is None:
        told = "too few points to hold any out: how well the surface fits is not known."
        return judged(told, fine=False)
    out = 1.0 - used / max(points, 1)
    told = f"held-out points miss by {metres(miss)}, {miss / gsd:.1f} GSD; {out:.0%} left out."
    fine = miss <= max(MISS_GSD * gsd, MISS_M) and out <= 0.15
    return judged(told, fine=fine, bad=out > 0.5)


def _hillshade(facts: Facts, heights: Heights) -> Picture:
    left, right, bottom, top = heights.extent
    rows, cols = heights.z.shape
    cell = (right - left) / cols, (top - bottom) / rows
    z = np.where(heights.seen, heights.z, np.nan)
    low, high = float(np.nanmin(z)), float(np.nanmax(z))
    # relief of a few metres over hundreds would not be seen
    stretch = float(np.clip(0.15 * max(right - left, top - bottom) / max(high - low, 0.01), 1, 8))
    shade = np.where(heights.seen, hillshade(heights.z, cell, stretch), np.nan)
    figure, axis = map_figure(heights.extent)
    tint = axis.imshow(z, cmap="terrain", extent=heights.extent, vmin=low, vmax=high)
    axis.imshow(shade, cmap="gray", extent=heights.extent, vmin=0, vmax=1, alpha=0.55)
    x = left + (np.arange(cols) + 0.5) * cell[0]
    y = top - (np.arange(rows) + 0.5) * cell[1]
    step = _interval(high - low)
    levels = np.arange(math.ceil(low / step), math.floor(high / step) + 1) * step
    if 1 < len(levels) < 60:
        axis.contour(x, y, z, levels=levels, colors="#3a2a1a", linewidths=0.4)
    weak = _weak(heights)
    if weak is not None and np.any(weak):
        axis.contourf(x, y, weak, levels=[0.5, 1.5], colors="none", hatches=["////"])
    bar = figure.colorbar(tint, ax=axis, shrink=0.7, pad=0.01)
    bar.set_label("height above the ellipsoid (m)", fontsize=9)
    scale_and_north(axis)
    return Picture(
        title="Relief",
        data=jpeg(figure, dpi=110),
        alt="Shaded relief of the ground with contour lines",
        look=f"Contours every {step:g} m, shades of a relief {stretch:.1f} times as high, hatched "
        "far from any point; roads and fields should be smooth: needles and pits are trees, water "
        "or wrong points.",
        verdict=_relief_verdict(heights, cell, weak),
    )


def _weak(heights: Heights) -> NDArray[np.bool_] | None:
    """Where the ground is far less well known than in its middle."""
    if heights.sigma is None:
        return None
    middle = float(np.nanmedian(heights.sigma[heights.seen]))
    return np.asarray(heights.seen & (heights.sigma > WEAK * middle))


def _relief_verdict(
    heights: Heights, cell: tuple[float, float], weak: NDArray[np.bool_] | None
) -> Verdict:
    """Ground steeper than 45 deg is rare: trees and roofs in the surface, or wrong points."""
    south, east = np.gradient(heights.z, cell[1], cell[0])
    known = heights.seen & np.isfinite(south) & np.isfinite(east)
    steep = float(np.mean(np.hypot(south, east)[known] > 1.0)) if np.any(known) else 0.0
    z = heights.z[heights.seen & np.isfinite(heights.z)]
    told = (
        f"heights from {z.min():.2f} to {z.max():.2f} m over {area(len(z) * cell[0] * cell[1])}; "
    )
    told += f"{steep:.1%} of it is steeper than 45 deg"
    far = 0.0
    if heights.sigma is not None and weak is not None:
        far = float(np.mean(weak[heights.seen]))
        told += f"; {far:.0%} lies far from any point (hatched), the median sigma of a height is "
        told += metres(float(np.nanmedian(heights.sigma[heights.seen])))
    return judged(told + ".", fine=steep <= STEEP and far <= 0.3, bad=steep > 10 * STEEP)


def hillshade(z: Array, cell: tuple[float, float], stretch: float = 1.0) -> Array:
    """Brightness 0 to 1 of ground lit from the north-west; rows run from north to south.

    Horn's slopes are left to `numpy.gradient`; the cosine law of Lambert.
    """
    south, east = np.gradient(z * stretch)
    n = np.stack([-east / cell[0], south / cell[1], np.ones_like(z)], axis=-1)
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    a, h = math.radians(AZIMUTH), math.radians(ALTITUDE)
    light = np.array([math.sin(a) * math.cos(h), math.cos(a) * math.cos(h), math.sin(h)])
    return np.asarray(np.clip(n @ light, 0.0, 1.0))


def _interval(span: float) -> float:
    """Round interval that gives about ten contours, m."""
    wanted = max(span, 1e-3) / 10
    power = 10.0 ** math.floor(math.log10(wanted))
    return float(next(v * power for v in (1.0, 2.0, 5.0, 10.0) if v * power >= wanted))
