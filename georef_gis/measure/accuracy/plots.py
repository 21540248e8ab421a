"""Pictures of residuals at check points: histograms (2012 paper, Fig. 15), plan, scatter.

Every function gives a `matplotlib.figure.Figure`, which `picture` turns into the bytes of a file.
"""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np

from georef_gis.frames import Array
from georef_gis.measure.accuracy.product import AXES, Assessment, CheckResidual

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from georef_gis.measure.accuracy.report import AccuracyReport
    from georef_gis.measure.accuracy.statistics import AxisStatistics

# Okabe and Ito's colours, which the colour-blind tell apart.
_BLACK, _ORANGE, _GREEN, _BLUE, _RED, _GREY = (
    "#000000", "#E69F00", "#009E73", "#0072B2", "#D55E00", "#7F7F7F",
)  # fmt: skip
_NAMES = {"x": "X (east)", "y": "Y (north)", "z": "Z (height)"}
_NICE = (1.0, 2.0, 2.5, 5.0, 10.0)
# Length of the longest arrow, as a share of the plan's width
_ARROW = 0.12


def picture(figure: Figure, kind: Literal["png", "svg"] = "png", *, dpi: int = 130) -> bytes:
    """The figure as a file."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    FigureCanvasAgg(figure)
    stream = io.BytesIO()
    # Without a date, equal residuals give equal files.
    figure.savefig(stream, format=kind, dpi=dpi, metadata={"Date": None} if kind == "svg" else None)
    return stream.getvalue()


def accuracy_pictures(report: AccuracyReport) -> dict[str, bytes]:
    """PNG files by name for all assessments that have residuals."""
    out: dict[str, bytes] = {}
    for a in report.assessments:
        if not a.axes:
            continue
        out[f"accuracy_histogram_{a.kind}.png"] = picture(histogram_figure(a))
        if "x" in a.axes:
            out[f"accuracy_scatter_{a.kind}.png"] = picture(scatter_figure(a))
        if any(math.isfinite(r.x) for r in a.residuals):
            figure = vector_figure(a, control_map=report.survey.control_map)
            out[f"accuracy_vectors_{a.kind}.png"] = picture(figure)
    return out


# -- histograms ----------------------------------------------------------------------------------


def histogram_figure(assessment: Assessment) -> Figure:
    """Errors along each axis in classes, with their mean and the normal curve of mean and spread.

    Classes are centred on zero and alike on all axes of one figure.
    """
    from matplotlib.figure import Figure

    names = [name for name in AXES if name in assessment.axes]
    figure = Figure(figsize=(3.9 * len(names), 3.9), layout="constrained")
    errors = {name: _errors(assessment.residuals, name) for name in names}
    width = _class_width(
        np.concatenate(list(errors.values())), max(len(e) for e in errors.values())
    )
    panels = figure.subplots(1, len(names), sharey=True, squeeze=False)[0]
    for panel, name in zip(panels, names, strict=True):
        _histogram(panel, errors[name], assessment.axes[name], width)
    panels[0].set_ylabel("check points")
    figure.suptitle("Errors at check points (product minus survey)", fontsize=11)
    return figure


def _histogram(panel: Axes, errors: Array, axis: AxisStatistics, width: float) -> None:
    from matplotlib.ticker import MaxNLocator

    unit, factor = _unit(width)
    edge = (math.ceil(np.abs(errors).max() / width - 0.5) + 0.5) * width
    edges = np.arange(-edge, edge + width / 2, width)
    panel.hist(errors * factor, bins=list(edges * factor), color=_BLUE, alpha=0.75, ec="white")
    if axis.n > 2 and axis.sd > 0:
        at = np.linspace(-edge, edge, 200)
        curve = np.exp(-0.5 * ((at - axis.mean) / axis.sd) ** 2) / (axis.sd * math.sqrt(2 * np.pi))
        panel.plot(at * factor, curve * axis.n * width, color=_BLACK, lw=1.2)
    panel.axvline(0.0, color=_GREY, lw=0.8)
    colour = _RED if axis.is_biased else _GREEN
    reference = "RMSE" if axis.target is None else "target"
    panel.axvline(axis.mean * factor, color=colour, lw=1.8, ls="--")
    panel.set_xlabel(f"error ({unit})")
    mean = f"mean {axis.mean * factor:+.2f} {unit}, {axis.mean_share:.0%} of {reference}"
    panel.set_title(
        f"{_NAMES[axis.axis]}: RMSE {axis.rmse * factor:.3g} {unit}\n{mean}, n = {axis.n}",
        fontsize=9.5,
        color=_RED if axis.is_biased else _BLACK,
    )
    panel.yaxis.set_major_locator(MaxNLocator(integer=True))


def _class_width(errors: Array, n: int) -> float:
    """Round width of the classes, m: about two thirds of a standard deviation for few points."""
    spread = float(np.sqrt(np.mean(errors**2))) or 1e-3
    return _round_up(1.6 * spread / max(1.0, n ** (1.0 / 3.0)) * 1.2)


def _round_up(value: float) -> float:
    power = 10.0 ** math.floor(math.log10(value))
    return next(nice * power for nice in _NICE if nice * power >= value * (1 - 1e-9))


# -- plan ----------------------------------------------------------------------------------------


def vector_figure(assessment: Assessment, *, control_map: Array | None = None) -> Figure:
    """Residuals as arrows on the map, enlarged; heights as coloured dots; control as crosses."""
    from matplotlib.figure import Figure

    rows = [r for r in assessment.residuals if math.isfinite(r.x)]
    control = np.zeros((0, 2)) if control_map is None else control_map
    xy = np.array([[r.x, r.y] for r in rows])
    d = np.nan_to_num(np.array([[r.dx, r.dy] for r in rows]))
    everything = np.vstack([xy, control])
    corner = everything.min(axis=0)
    extent = max(float(np.ptp(everything, axis=0).max()), 1.0)
    figure = Figure(figsize=(7.6, 6.6), layout="constrained")
    plan = figure.subplots()
    xy, control = xy - corner, control - corner
    _dots(figure, plan, rows, xy)
    if len(control):
        plan.plot(
            *control.T, "+", color=_GREY, ms=11, mew=2, ls="none", label="control (not a check)"
        )
    longest = float(np.linalg.norm(d, axis=1).max())
    if longest > 0:
        _arrows(plan, xy, d, _ARROW * extent / longest, longest)
    for row, place in zip(rows, xy, strict=True):
        plan.annotate(row.name, place, textcoords="offset points", xytext=(5, 5), fontsize=7.5)
    plan.set_aspect("equal")
    plan.margins(0.14)
    plan.set_xlabel(f"east of {corner[0]:.0f} m")
    plan.set_ylabel(f"north of {corner[1]:.0f} m")
    plan.ticklabel_format(useOffset=False, style="plain")
    plan.grid(True, lw=0.4, color="#DDDDDD")
    plan.set_axisbelow(True)
    plan.legend(loc="upper left", bbox_to_anchor=(0.0, -0.1), ncols=3, fontsize=8.5, frameon=False)
    plan.set_title("Residuals at check points (product minus survey)", fontsize=11)
    return figure


def _dots(figure: Figure, plan: Axes, rows: Sequence[CheckResidual], xy: Array) -> None:
    dz = np.array([r.dz for r in rows])
    known = np.isfinite(dz)
    if np.any(~known):
        plan.plot(*xy[~known].T, "o", ms=5, color=_BLACK, ls="none", label="check point")
    if not np.any(known):
        return
    limit = float(np.abs(dz[known]).max()) or 1e-3
    unit, factor = _unit(limit)
    dots = plan.scatter(
        xy[known, 0],
        xy[known, 1],
        c=dz[known] * factor,
        cmap="RdBu_r",
        vmin=-limit * factor,
        vmax=limit * factor,
        s=48,
        ec=_BLACK,
        lw=0.6,
        zorder=3,
        label="check point",
    )
    figure.colorbar(dots, ax=plan, shrink=0.75, label=f"error in height ({unit})")


def _arrows(plan: Axes, xy: Array, d: Array, scale: float, longest: float) -> None:
    """Arrows `scale` times as long as the residuals, and one of a round length as the key."""
    unit, factor = _unit(longest)
    arrows = plan.quiver(
        *xy.T, *(d * scale).T, angles="xy", scale_units="xy", scale=1.0, color=_ORANGE,
        units="inches", width=0.03, zorder=4,
    )  # fmt: skip
    # Ends count for the limits too.
    plan.update_datalim(xy + d * scale)
    key = _round_up(longest / 2.0)
    plan.quiverkey(
        arrows, 0.86, -0.12, key * scale, f"{key * factor:.3g} {unit}", labelpos="E",
        coordinates="axes",
    )  # fmt: skip


# -- scatter -------------------------------------------------------------------------------------


def scatter_figure(assessment: Assessment) -> Figure:
    """Horizontal residuals about the truth, with the circle of RMSE_H and the mean."""
    from matplotlib.figure import Figure
    from matplotlib.patches import Circle

    rows = [r for r in assessment.residuals if math.isfinite(r.dx) and math.isfinite(r.dy)]
    d = np.array([[r.dx, r.dy] for r in rows])
    h = assessment.component("H")
    reach = max(float(np.abs(d).max()), h.rmse, h.target or 0.0) * 1.15 or 1e-3
    unit, factor = _unit(reach)
    figure = Figure(figsize=(5.6, 5.6), layout="constrained")
    panel = figure.subplots()
    circle = {"fill": False, "lw": 1.5}
    panel.add_patch(
        Circle(
            (0, 0),
            h.rmse * factor,
            color=_BLUE,
            label=f"RMSE_H {h.rmse * factor:.3g} {unit}",
            **circle,
        )
    )
    if h.target is not None:
        panel.add_patch(
            Circle(
                (0, 0), h.target * factor, color=_GREEN, ls="--", label="declared class", **circle
            )
        )
    panel.plot(*(d * factor).T, "o", ms=5, color=_BLACK, ls="none")
    mean = d.mean(axis=0) * factor
    panel.plot(*mean, "X", ms=11, color=_RED, ls="none", label="mean")
    for row, place in zip(rows, d * factor, strict=True):
        panel.annotate(row.name, place, textcoords="offset points", xytext=(4, 4), fontsize=7)
    panel.axhline(0, color=_GREY, lw=0.7)
    panel.axvline(0, color=_GREY, lw=0.7)
    panel.set_xlim(-reach * factor, reach * factor)
    panel.set_ylim(-reach * factor, reach * factor)
    panel.set_aspect("equal")
    panel.set_xlabel(f"error in X, east ({unit})")
    panel.set_ylabel(f"error in Y, north ({unit})")
    panel.legend(
        loc="upper center", bbox_to_anchor=(0.5, -0.1), ncols=3, fontsize=8.5, frameon=False
    )
    panel.set_title(f"Horizontal errors at {len(rows)} check points", fontsize=11)
    return figure


def _errors(residuals: Sequence[CheckResidual], name: str) -> Array:
    """Errors along an axis, those of the axis' statistics: heights of open ground only."""
    rows = [r for r in residuals if name != "z" or r.cover == "open"]
    if name != "z":
        rows = [r for r in rows if math.isfinite(r.dx) and math.isfinite(r.dy)]
    errors = np.array([getattr(r, f"d{name}") for r in rows])
    return np.asarray(errors[np.isfinite(errors)])


def _unit(length: float) -> tuple[str, float]:
    """Unit in which a length reads well, and how many of it make a metre."""
    return ("m", 1.0) if length >= 0.5 else ("cm", 100.0)
