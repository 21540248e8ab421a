"""Picture of a planned flight: lines, photos, area, and what a point from one photo is worth."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from georef_gis.frames import Array
from georef_gis.measure.budget.plots import source_bars
from georef_gis.measure.budget.shares import PointBudget
from georef_gis.measure.preflight.layout import Plan, PlannedLine
from georef_gis.measure.report.draw import BLACK, BLUE, GREEN, ORANGE, new_figure, scale_and_north

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def plan_figure(plan: Plan, budget: PointBudget, *, ring: Array | None, title: str) -> Figure:
    """Map of a plan beside the budget of its photos.

    Parameters
    ----------
    ring : shape (n, 2), m
        Rim of the area.
    """
    figure = new_figure(11.0, 5.6)
    figure.suptitle(title, fontsize=11)
    left, right = figure.subplots(1, 2, width_ratios=[1.35, 1.0])
    _map(left, plan, ring)
    source_bars(right, budget)
    right.set_title("A point from one photo", fontsize=10)
    return figure


def _map(axis: Axes, plan: Plan, ring: Array | None) -> None:
    usual = plan.lines[0].height
    for line in plan.lines:
        colour = BLUE if line.height == usual else ORANGE
        axis.plot(*line.photos.T, "-", color=colour, lw=1.2, marker="o", ms=2.2, mec="none")
        axis.annotate(
            line.name, line.photos[0], xytext=(4, 4), textcoords="offset points", fontsize=8,
            color=colour,
        )  # fmt: skip
    for line, layout in ((plan.lines[0], plan.layouts[0]),):
        corners = _footprint(line, layout.along, layout.across)
        axis.fill(*corners.T, color=BLUE, alpha=0.14, lw=0.8, ec=BLACK)
    if ring is not None:
        axis.plot(*np.vstack([ring, ring[:1]]).T, color=GREEN, lw=1.8)
    axis.set_aspect("equal", adjustable="datalim")
    axis.margins(0.08)
    axis.set_xlabel("east (m)", fontsize=9)
    axis.set_ylabel("north (m)", fontsize=9)
    axis.tick_params(labelsize=8)
    axis.grid(True, color="#DDDDDD", linewidth=0.6)
    axis.set_axisbelow(True)
    axis.autoscale_view()
    scale_and_north(axis)


def _footprint(line: PlannedLine, along: float, across: float) -> Array:
    """Corners on the ground of the first photo of a line, (4, 2) m."""
    a = line.headings[0]
    ahead, right = np.array([np.sin(a), np.cos(a)]), np.array([np.cos(a), -np.sin(a)])
    signs = ((1, 1), (1, -1), (-1, -1), (-1, 1))
    return np.array(
        [line.photos[0] + 0.5 * (i * along * ahead + j * across * right) for i, j in signs]
    )
