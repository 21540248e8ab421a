"""Pictures of an error budget: shares by source, photo by photo, and the curve of Figure 9."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from georef_gis.measure.budget.forecast import tilt_displacements
from georef_gis.measure.budget.shares import COUPLED, SOURCES, PointBudget, Remedy
from georef_gis.measure.report.draw import BLACK, BLUE, GREY, RED, new_figure, with_grid

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# A colour for each source, told apart in grey and by the colour-blind as far as twelve can be.
_COLOURS = {
    "gnss": "#0072B2", "datum": "#56B4E9", "attitude": "#D55E00", "boresight": "#E69F00",
    "lever_arm": "#F0E442", "time": "#CC79A7", "calibration": "#009E73", "matching": "#332288",
    "pose": "#117733", "level": "#88CCEE", "ground": "#7A5C3E", "click": "#999999",
    "coupling": "#DDDDDD",
}  # fmt: skip
# of the variance; sources below are no bar of their own
_SEEN = 1e-4
# of the whole; a remedy that leaves more brings nothing
_USEFUL = 0.995
# bars beyond which photos are drawn without their names
_NAMED = 40


def budget_figure(
    whole: PointBudget, found: Sequence[Remedy], each: Sequence[PointBudget], *, title: str
) -> Figure:
    """Sources of the whole, what to fix first, and every photo or place, one below the other.

    Parameters
    ----------
    each
        Photos or places in the order to draw them; none = only the whole.
    """
    figure = new_figure(10.0, 8.4 if each else 4.2)
    figure.suptitle(title, fontsize=12)
    grid = figure.add_gridspec(2 if each else 1, 2, height_ratios=[1.0, 1.05][: 1 + bool(each)])
    source_bars(figure.add_subplot(grid[0, 0]), whole)
    remedy_bars(figure.add_subplot(grid[0, 1]), found)
    if each:
        places_bars(figure.add_subplot(grid[1, :]), each)
    return figure


def source_bars(axis: Axes, budget: PointBudget) -> None:
    """One sigma of each source, and of all together."""
    total = budget.variance()[:2].mean()
    shown = [
        source for source in budget.by_source
        if abs(budget.variance(source)[:2].mean()) > _SEEN * total
    ]  # fmt: skip
    shown = sorted(shown, key=lambda source: budget.horizontal(source))
    values = [budget.horizontal(source) for source in shown]
    rows = np.arange(len(shown))
    axis.barh(rows, values, color=[_COLOURS[source] for source in shown], height=0.72)
    whole = budget.horizontal()
    axis.barh([len(shown)], [whole], color=BLACK, height=0.72)
    for row, value in zip([*rows, len(shown)], [*values, whole], strict=True):
        axis.annotate(
            length_text(value), (max(value, 0.0), row), xytext=(4, 0),
            textcoords="offset points", va="center", fontsize=8,
        )  # fmt: skip
    axis.set_yticks([*rows, len(shown)], [*(SOURCES[source] for source in shown), "together"])
    axis.margins(x=0.18)
    axis.set_xlabel("one sigma, horizontal, per axis (m)", fontsize=9)
    axis.set_title("What the error is made of", fontsize=10)
    with_grid(axis)


def remedy_bars(axis: Axes, found: Sequence[Remedy]) -> None:
    """What is left once the best sources to work on are halved, and once they are gone."""
    # those that bring nothing are no advice
    useful = [remedy for remedy in found if remedy.reduced_to < _USEFUL * remedy.now]
    some = (useful or list(found[:1]))[:6][::-1]
    rows = np.arange(len(some))
    axis.barh(
        rows + 0.2, [r.reduced_to for r in some], height=0.36, color=BLUE,
        label=f"reduced to {some[0].factor:.0%}" if some else "",
    )  # fmt: skip
    axis.barh(rows - 0.2, [r.without for r in some], height=0.36, color=GREY, label="gone")
    for row, remedy in zip(rows, some, strict=True):
        for off, value in ((0.2, remedy.reduced_to), (-0.2, remedy.without)):
            axis.annotate(
                length_text(value), (value, row + off), xytext=(-4, 0),
                textcoords="offset points", va="center", ha="right", fontsize=7.5, color="white",
            )  # fmt: skip
    if some:
        axis.axvline(some[0].now, color=RED, lw=1.4, label=f"now {length_text(some[0].now)}")
    axis.set_yticks(rows, [SOURCES[remedy.source] for remedy in some])
    axis.margins(x=0.14)
    axis.set_xlabel("one sigma that is left (m)", fontsize=9)
    axis.set_title("What to fix first", fontsize=10)
    with_grid(axis)
    axis.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=3, fontsize=8, frameon=False)


def places_bars(axis: Axes, each: Sequence[PointBudget]) -> None:
    """Variance of every photo or place, a bar of its sources; the scale reads as sigma."""
    total = np.array([budget.variance()[:2].mean() for budget in each])
    at = np.arange(len(each))
    floor = np.zeros(len(each))
    for source in [s for s in SOURCES if s not in COUPLED]:
        own = np.array([_mean_variance(budget, source) for budget in each])
        if not np.any(own > _SEEN * total):
            continue
        # shares of what adds up, so that a bar ends at its sigma whatever is coupled
        share = own / _positive(each)
        height = share * np.sqrt(total)
        axis.bar(at, height, bottom=floor, width=0.9, color=_COLOURS[source], label=SOURCES[source])
        floor += height
    # a few that are far off would make all others a line
    usual = float(np.quantile(np.sqrt(total), 0.9))
    top = 1.08 * float(np.sqrt(total).max())
    if top > 4.0 * usual > 0.0:
        top = 2.0 * usual
        for i in np.flatnonzero(np.sqrt(total) > top):
            axis.annotate(
                length_text(float(np.sqrt(total[i]))), (i, top), xytext=(0, -4),
                textcoords="offset points", ha="center", va="top", fontsize=7.5, color="white",
                fontweight="bold",
            )  # fmt: skip
    axis.set_ylim(0.0, top)
    axis.set_xlim(-0.6, len(each) - 0.4)
    axis.set_ylabel("one sigma (m), in shares of the variance", fontsize=9)
    with_grid(axis)
    if len(each) <= _NAMED:
        axis.set_xticks(at, [budget.name for budget in each], rotation=60, ha="right", fontsize=7)
    else:
        axis.set_xlabel(f"{len(each)} photos, in order", fontsize=9)
    axis.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=6, fontsize=8, frameon=False)


def _mean_variance(budget: PointBudget, source: str) -> float:
    part = budget.by_source.get(source)
    return 0.0 if part is None else max(float((part[0, 0] + part[1, 1]) / 2.0), 0.0)


def _positive(each: Sequence[PointBudget]) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Sum of the variances of the sources of each, couplings left out."""
    sums = [sum(_mean_variance(b, s) for s in SOURCES if s not in COUPLED) for b in each]
    return np.asarray(np.maximum(np.array(sums), 1e-300))


def tilt_figure(height: float, *, sigma_deg: float | None = None) -> Figure:
    """Angle errors against position errors from a height, m: Figure 9 of the 2009 report.

    Parameters
    ----------
    sigma_deg
        One sigma of the tilt of this flight, to be marked.
    """
    figure = new_figure(6.4, 4.4)
    axis = figure.subplots()
    degrees = np.linspace(0.0, 10.0, 101)
    axis.plot(degrees, tilt_displacements(height, np.radians(degrees)), color=BLUE, lw=2.0)
    mark, what = (5.0, "5 deg") if sigma_deg is None else (sigma_deg, f"{sigma_deg:.2g} deg")
    (off,) = tilt_displacements(height, [np.radians(mark)])
    axis.plot([mark, mark, 0.0], [0.0, off, off], color=RED, lw=1.0, ls="--")
    axis.annotate(
        f"{what}: {off:.2f} m", (mark, off), xytext=(6, -12), textcoords="offset points",
        fontsize=9, color=RED,
    )  # fmt: skip
    axis.set_xlim(0.0, 10.0)
    axis.set_ylim(0.0, None)
    axis.set_xlabel("error of roll or pitch (deg)", fontsize=9)
    axis.set_ylabel("shift of the middle of the photo (m)", fontsize=9)
    axis.set_title(f"Angle and position errors from {height:.4g} m", fontsize=10)
    with_grid(axis)
    return figure


def length_text(value: float) -> str:
    """A length with a unit that reads well."""
    if abs(value) >= 0.995:
        return f"{value:.2f} m"
    return f"{100 * value:.1f} cm" if abs(value) >= 0.00995 else f"{1000 * value:.1f} mm"
