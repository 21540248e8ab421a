"""Residuals of the tie points: over the image, as a distribution, by photo, by place."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from georef_gis.frames import Array
from georef_gis.measure.report.draw import (
    BLACK,
    BLUE,
    GREY,
    RED,
    WIDE,
    extent_of,
    few,
    map_figure,
    new_figure,
    number,
    outlines,
    plural,
    png,
    robust_sigma,
    round_length,
    scale_and_north,
    with_grid,
)
from georef_gis.measure.report.facts import Adjustment, Facts, Residuals
from georef_gis.measure.report.page import Item, Picture, Verdict, judged

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# cells along the longer side of the image, and observations that a cell must have
CELLS, FEWEST = 12, 5
# a systematic part above this share of the scatter asks for another model of the lens
SYSTEMATIC = 1.0 / 3.0
MOST_CAMERAS = 4
# spreads, and the share of residuals that may lie beyond: real matches have heavier tails than a
# bell (0.9 to 2.9 % over the two real flights and the simulated one)
BEYOND, MOST_BEYOND = 5.0, 0.04


def residual_items(facts: Facts) -> list[Item]:
    """Pictures of the residuals, as far as there are any."""
    adjustment = facts.adjustment
    if adjustment is None or adjustment.residuals is None or not len(adjustment.residuals.photo):
        return []
    r = adjustment.residuals
    items: list[Item] = []
    by_camera = _by_camera(facts, r)
    for camera_id, mine in list(by_camera.items())[:MOST_CAMERAS]:
        size = _size(facts, camera_id)
        items.append(image_grid(r.uv[mine], r.residual[mine], size, camera_id))
    items += [histogram(r), by_photo(adjustment)]
    if len(adjustment.points_px) >= FEWEST:
        items.append(by_place(facts, adjustment))
    return items


def _by_camera(facts: Facts, r: Residuals) -> dict[str, NDArray[np.bool_]]:
    """Observations of each camera; the one with most first."""
    camera = {str(row["photo_id"]): str(row["camera_id"]) for row in facts.photos}
    names = np.array([camera.get(key, "unknown camera") for key in r.photo_ids])
    mine = names[r.photo]
    order = sorted(set(mine.tolist()), key=lambda name: -int(np.sum(mine == name)))
    return {name: mine == name for name in order}


def _size(facts: Facts, camera_id: str) -> tuple[float, float]:
    camera = facts.cameras.get(f"{camera_id} adjusted") or facts.cameras.get(camera_id)
    return (4000.0, 3000.0) if camera is None else (float(camera.width), float(camera.height))


# -- over the image ----------------------------------------------------------------------------


def image_grid(uv: Array, residual: Array, size: tuple[float, float], camera: str) -> Picture:
    """Mean residual of each cell of the image: what the model of the lens leaves."""
    mean, error, count, centre = cell_means(uv, residual, size)
    shown = count >= FEWEST
    systematic = systematic_part(mean[shown], error[shown])
    scatter = float(np.sqrt(np.mean(residual**2)))
    width, height = size
    figure = new_figure(7.6, float(np.clip(7.0 * height / width + 0.9, 3.0, 9.0)))
    axis = figure.subplots()
    longest = float(np.linalg.norm(mean[shown], axis=1).max()) if np.any(shown) else 0.0
    reach = width / CELLS
    loud = np.linalg.norm(mean, axis=1) > 3.0 * np.linalg.norm(error, axis=1)
    key = round_length(max(longest, 1e-3))
    for mask, colour, name in (
        (shown & ~loud, GREY, "within 3 of its own sigmas"), (shown & loud, RED, "beyond"),
    ):  # fmt: skip
        if np.any(mask):
            arrows = axis.quiver(
                *centre[mask].T, *mean[mask].T, angles="xy", scale_units="xy",
                scale=key / reach, color=colour, width=0.0035, label=f"{name} ({mask.sum()})",
            )  # fmt: skip
    if np.any(shown):
        axis.quiverkey(
            arrows, 0.9, 1.03, key, f"{key:g} px", labelpos="E", coordinates="axes", color=BLACK
        )
    axis.set_xlim(-0.5, width - 0.5)
    axis.set_ylim(height - 0.5, -0.5)
    axis.set_aspect("equal")
    axis.set_xlabel("u (px)", fontsize=9)
    axis.set_ylabel("v (px)", fontsize=9)
    axis.tick_params(labelsize=8.5)
    axis.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, fontsize=8.5, frameon=False)
    told = (
        f"the systematic part is {systematic:.2f} px of {scatter:.2f} px rms per axis "
        f"(longest mean {longest:.2f} px in {plural(int(shown.sum()), 'cell')})."
    )
    share = systematic / max(scatter, 1e-9)
    return Picture(
        title=f"Residuals over the image: {camera}",
        data=png(figure),
        alt="Arrows of the mean residual in each cell of the image",
        look="The arrows should be short and point anywhere; rings, whirls or one common direction "
        "mean that the lens or the shutter is not described well.",
        verdict=judged(told, fine=share <= SYSTEMATIC, bad=share > 2 * SYSTEMATIC),
        narrow=True,
    )


def cell_means(
    uv: Array, residual: Array, size: tuple[float, float]
) -> tuple[Array, Array, NDArray[np.int64], Array]:
    """Mean residual, its sigma, count and centre of each cell of an image.

    Means are of residuals clipped at 4 robust sigmas, so that one match does not make an arrow.

    Returns
    -------
    mean, error : shape (k, 2), px
        NaN where a cell is empty.
    count : shape (k,)
    centre : shape (k, 2), px
    """
    width, height = size
    cell = max(width, height) / CELLS
    cols, rows = max(1, math.ceil(width / cell)), max(1, math.ceil(height / cell))
    c = np.clip(((uv[:, 0] + 0.5) / width * cols).astype(int), 0, cols - 1)
    r = np.clip(((uv[:, 1] + 0.5) / height * rows).astype(int), 0, rows - 1)
    at = r * cols + c
    limit = 4.0 * np.array([robust_sigma(residual[:, k]) for k in (0, 1)])
    clipped = np.clip(residual, -limit, limit)
    count = np.bincount(at, minlength=rows * cols)
    some = np.maximum(count, 1)
    mean = np.stack([np.bincount(at, clipped[:, k], rows * cols) / some for k in (0, 1)], axis=1)
    square = np.stack(
        [np.bincount(at, clipped[:, k] ** 2, rows * cols) / some for k in (0, 1)], axis=1
    )
    error = np.sqrt(np.maximum(square - mean**2, 0.0) / np.maximum(some - 1, 1)[:, None])
    mean[count == 0] = error[count == 0] = np.nan
    i, j = np.meshgrid(np.arange(cols), np.arange(rows))
    centre = np.stack(
        [(i.ravel() + 0.5) * width / cols - 0.5, (j.ravel() + 0.5) * height / rows - 0.5], axis=1
    )
    return mean, error, count, centre


def systematic_part(mean: Array, error: Array) -> float:
    """Rms per axis, px, of cell means beyond what their own scatter makes of nothing."""
    if not len(mean):
        return 0.0
    return float(np.sqrt(max(float(np.mean(mean**2) - np.mean(error**2)), 0.0)))


# -- as a distribution -------------------------------------------------------------------------


def histogram(r: Residuals) -> Picture:
    """Both axes with the normal curve of their robust spread."""
    spread = [robust_sigma(r.residual[:, k]) for k in (0, 1)]
    reach = 5.0 * max(*spread, 1e-6)
    edges = np.linspace(-reach, reach, 61)
    figure = new_figure(WIDE, 3.4)
    panels = figure.subplots(1, 2, sharey=True)
    for k, (axis, name) in enumerate(zip(panels, "uv", strict=True)):
        axis.hist(
            np.clip(r.residual[:, k], -reach, reach), bins=list(edges), color=BLUE, alpha=0.75
        )
        x = (edges[1:] + edges[:-1]) / 2
        middle, sd = float(np.median(r.residual[:, k])), max(spread[k], 1e-9)
        curve = np.exp(-0.5 * ((x - middle) / sd) ** 2) / (sd * math.sqrt(2 * math.pi))
        axis.plot(x, curve * len(r.residual) * (edges[1] - edges[0]), color=BLACK, lw=1.3)
        axis.set_xlabel(f"residual along {name} (px)", fontsize=9)
        axis.set_title(
            f"{name}: median {number(middle, 3, sign=True)}, spread {sd:.2f} px", fontsize=9.5
        )
        with_grid(axis)
    panels[0].set_ylabel("observations", fontsize=9)
    z = np.abs(r.residual) / np.array([max(s, 1e-9) for s in spread])
    beyond = float(np.mean(z > BEYOND))
    shift = float(np.max(np.abs(np.median(r.residual, axis=0))))
    told = (
        f"{beyond:.1%} of the residuals lie beyond {BEYOND:g} times the spread of the middle (a "
        f"bell alone: none; robust weights bear some), the medians within {shift:.2f} px of zero."
    )
    fine = beyond <= MOST_BEYOND and shift <= 0.25 * max(spread)
    return Picture(
        title="Distribution of the residuals",
        data=png(figure),
        alt="Histograms of the residuals along u and v with a normal curve",
        look="A bell around zero; the columns at both ends gather what lies further out.",
        verdict=judged(told, fine=fine, bad=beyond > 3 * MOST_BEYOND),
    )


# -- by photo, by place ------------------------------------------------------------------------


def by_photo(adjustment: Adjustment) -> Picture:
    """Root mean square of each photo as a bar."""
    rows = list(adjustment.report.get("photos") or ())
    names = [str(row["photo"]) for row in rows]
    rms = np.array([row["rms_px"] if row["rms_px"] is not None else np.nan for row in rows], float)
    known = rms[np.isfinite(rms)]
    middle, highest = (float(np.median(known)), float(known.max())) if len(known) else (0.0, 0.0)
    high = [n for n, v in zip(names, rms, strict=True) if v > 2.0 * middle]
    lone = [n for n, v in zip(names, rms, strict=True) if not math.isfinite(v)]
    figure = new_figure(WIDE, 3.2)
    axis = figure.subplots()
    colours = [RED if v > 2.0 * middle else BLUE for v in rms]
    # lines instead of bars: thousands of bars take minutes
    width = max(0.5, 430.0 / max(len(rms), 12))
    axis.vlines(np.arange(len(rms)), 0.0, np.nan_to_num(rms), color=colours, lw=width)
    axis.set_ylim(bottom=0.0)
    axis.axhline(middle, color=BLACK, lw=1.0, ls="--", label=f"median {number(middle)} px")
    _name_ticks(axis, names)
    axis.set_ylabel("rms residual (px)", fontsize=9)
    axis.legend(fontsize=8.5, frameon=False, loc="upper right")
    with_grid(axis)
    told = f"median {number(middle)} px, highest {number(highest)} px"
    told += (
        f"; more than twice the median: {few(high)}" if high else "; none above twice the median"
    )
    told += f"; without any tie point: {few(lone)}" if lone else ""
    return Picture(
        title="Residuals by photo",
        data=png(figure),
        alt="Bars of the root mean square residual of each photo",
        look="All bars should be of one height; a high one is a photo that is blurred, wrongly "
        "matched or of another camera.",
        verdict=judged(told + ".", fine=not high and not lone),
    )


def _name_ticks(axis: Axes, names: list[str]) -> None:
    step = max(1, math.ceil(len(names) / 45))
    at = np.arange(0, len(names), step)
    axis.set_xticks(at, [names[i] for i in at], rotation=90, fontsize=7)
    axis.set_xlim(-0.8, len(names) - 0.2)


def by_place(facts: Facts, adjustment: Adjustment) -> Picture:
    """Median residual of the points on the ground, by place."""
    xy = facts.local_of_enu(adjustment.points_enu)
    rings = [facts.local(f.ring_map) for f in facts.footprints.values()]
    extent = extent_of(rings)
    inside = (
        (xy[:, 0] > extent[0]) & (xy[:, 0] < extent[1])
        & (xy[:, 1] > extent[2]) & (xy[:, 1] < extent[3])
    )  # fmt: skip
    xy, px = xy[inside], adjustment.points_px[inside]
    figure, axis = map_figure(extent)
    cells = axis.hexbin(
        xy[:, 0], xy[:, 1], C=px, reduce_C_function=np.median, gridsize=36, mincnt=3,
        cmap="cividis_r", extent=extent, linewidths=0.1,
    )  # fmt: skip
    values = np.asarray(cells.get_array(), dtype=np.float64)
    outlines(axis, rings)
    bar = figure.colorbar(cells, ax=axis, shrink=0.7, pad=0.01)
    bar.set_label("median residual of the points (px)", fontsize=9)
    scale_and_north(axis)
    return Picture(
        title="Residuals by place",
        data=png(figure),
        alt="Map of the median residual of the ground points",
        look="The colour should be even; one dark part of the site means water, trees in the wind, "
        "moving things, or photos that do not fit there.",
        verdict=_place_verdict(values, plural(len(px), "point")),
    )


def _place_verdict(values: Array, points: str) -> Verdict:
    if len(values) < 5:
        return Verdict(level="told", text=f"{points} are too few to compare places.")
    middle, high = np.percentile(values, (50, 95))
    told = f"{points}; 95 % of the cells lie below {high:.2f} px, the median is {middle:.2f} px."
    return judged(told, fine=bool(high <= 2.0 * middle), bad=bool(high > 4.0 * middle))
