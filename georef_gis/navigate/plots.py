"""Pictures of two trajectories and their differences, as the two source reports draw them.

Figures 13 and 14 of the 2009 report (attitude) and 16 to 18 of the 2012 paper (plan, errors of
position and attitude), and the innovations of a filter. Every function gives a
`matplotlib.figure.Figure`, which `model.plot_parts.png` turns into the bytes of a file; those of
one trajectory are in `model.trajectory_plots`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from georef_gis.model.plot_parts import (
    BLACK,
    BLUE,
    ESTIMATE,
    GREEN,
    MOST_POINTS,
    ORANGE,
    REFERENCE,
    broken_at_wrap,
    draw_band,
    draw_line,
    error_figure,
    finish,
    keep_in_view,
    png,
    stacked,
    with_grid,
)
from georef_gis.model.trajectory_plots import position_figure
from georef_gis.model.trajectory_values import local_places

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from georef_gis.frames import Array
    from georef_gis.model.logs import TrajectoryLog
    from georef_gis.navigate.compare import Comparison


def attitude_figure(comparison: Comparison) -> Figure:
    """Roll, pitch and yaw of estimate and reference over time (2009 report, Figs. 13 and 14)."""
    one = comparison
    t = one.time - one.time[0]
    figure, axes = stacked(3, height=8.0, title="Attitude")
    for i, (axis, name) in enumerate(zip(axes, ("Roll", "Pitch", "Yaw"), strict=True)):
        for log, style in ((one.reference, REFERENCE), (one.estimate, ESTIMATE)):
            if i == 2:
                axis.plot(*broken_at_wrap(t, np.degrees(log.rpy[:, i])), **style)
            else:
                draw_line(axis, t, np.degrees(log.rpy[:, i]), style)
        axis.set_ylabel(f"{name} (deg)")
        if i == 2:
            axis.set_ylim(0, 360)
            axis.set_yticks(range(0, 361, 90))
    finish(figure, axes)
    return figure


def plan_figure(comparison: Comparison) -> Figure:
    """Both trajectories from above (2012 paper, Fig. 16)."""
    from matplotlib.figure import Figure

    one = comparison
    north, east, _ = local_places(one.reference, one.reference)
    shape = (np.nanmax(east) - np.nanmin(east)) / max(np.nanmax(north) - np.nanmin(north), 1.0)
    # So that the picture is as wide as the flight; the legend needs 5 inches.
    width = float(np.clip(6.4 * shape + 1.6, 5.0, 12.0))
    figure = Figure(figsize=(width, 7.2), layout="constrained")
    axis = figure.add_subplot()
    for log, style in ((one.reference, REFERENCE), (one.estimate, ESTIMATE)):
        north, east, _ = local_places(log, one.reference)
        every = max(1, len(north) // MOST_POINTS)
        axis.plot(east[::every], north[::every], **style)
    north, east, _ = local_places(one.estimate, one.reference)
    known = np.flatnonzero(np.isfinite(north))
    if len(known):
        axis.plot(east[known[0]], north[known[0]], "o", color=GREEN, label="start", zorder=5)
        axis.plot(east[known[-1]], north[known[-1]], "s", color=BLACK, label="end", zorder=5)
    axis.set_aspect("equal", adjustable="box")
    axis.set(xlabel="East (m)", ylabel="North (m)")
    with_grid(axis)
    finish(figure, [axis], title="Plan view", time=False)
    return figure


def nis_figure(time: Array, nis: Array) -> Figure:
    """Normalised innovations squared of GNSS positions and velocities over three.

    Parameters
    ----------
    time : shape (n,), s
    nis : shape (n, 2)
        Negative for a fix that disagreed and counted less; NaN where there is none.
    """
    t = time - time[0]
    figure, axes = stacked(2, height=6.0, title="How well the fixes agree with the IMU")
    for i, (axis, name) in enumerate(zip(axes, ("Position", "Velocity"), strict=True)):
        good, bad = nis[:, i] >= 0.0, nis[:, i] < 0.0
        axis.plot(t[good], nis[good, i] / 3.0, ".", color=BLUE, markersize=2, label="accepted")
        if bad.any():
            axis.plot(t[bad], -nis[bad, i] / 3.0, "x", color=ORANGE, label="counted less")
        axis.axhline(1.0, color=BLACK, linewidth=0.8, label="expected mean")
        axis.set_yscale("log")
        axis.set_ylabel(f"{name}: NIS / 3")
    finish(figure, axes)
    return figure


def position_error_figure(comparison: Comparison) -> Figure:
    """Differences north, east, down with bands of one and two sigmas (2012 paper, Fig. 17)."""
    one = comparison
    names = ("North (m)", "East (m)", "Down (m)")
    return error_figure("Position: estimate - reference", names, one.time, one.position,
                   one.sigma_position)  # fmt: skip


def attitude_error_figure(comparison: Comparison) -> Figure:
    """Differences of roll, pitch, yaw with bands of one and two sigmas (2012 paper, Fig. 18)."""
    one = comparison
    names = ("Roll (deg)", "Pitch (deg)", "Yaw (deg)")
    return error_figure("Attitude: estimate - reference", names, one.time, np.degrees(one.rpy),
                   np.degrees(one.sigma_rpy))  # fmt: skip


def innovation_figure(
    time: Array,
    innovation: Array,
    sigma: Array,
    nis: Array,
    *,
    names: Sequence[str],
    dof: Array | int,
) -> Figure:
    """Innovations with two-sigma bands, and their normalised square over its degrees of freedom.

    Parameters
    ----------
    time : shape (n,), s
    innovation, sigma : shape (n, k), NaN where there is none
    nis : shape (n,)
    names
        One label with unit per column.
    dof
        Degrees of freedom of `nis`, one for all or (n,).
    """
    t = time - time[0]
    count = innovation.shape[1]
    figure, axes = stacked(count + 1, height=1.6 * (count + 1) + 0.8, title="Innovations")
    for i in range(count):
        draw_band(axes[i], t, sigma[:, i], doubled=True)
        axes[i].plot(t, innovation[:, i], ".", color=BLUE, markersize=2.5, label="innovation",
                     rasterized=True)  # fmt: skip
        keep_in_view(axes[i], innovation[:, i], sigma[:, i])
        axes[i].set_ylabel(names[i])
    ratio = nis / dof
    positive = np.isfinite(ratio) & (ratio > 0.0)
    axes[-1].plot(t[positive], ratio[positive], ".", color=GREEN, markersize=2.5, label="NIS/dof")
    axes[-1].axhline(1.0, color=BLACK, linewidth=0.8, label="expected mean of NIS/dof")
    axes[-1].set_yscale("log")
    axes[-1].set_ylabel("NIS/dof (-)")
    finish(figure, axes)
    return figure


def comparison_pictures(
    comparison: Comparison, *, raw: TrajectoryLog | None = None
) -> dict[str, bytes]:
    """PNG files by name; those that the two have nothing for are left out.

    Parameters
    ----------
    raw
        Raw fixes to draw behind the positions.
    """
    one = comparison
    pictures = {}
    if np.any(np.isfinite(one.position)):
        series = {"raw fixes": raw} if raw is not None else {}
        series |= {"reference": one.reference, "estimate": one.estimate}
        pictures["plan.png"] = png(plan_figure(one))
        pictures["position.png"] = png(position_figure(series))
        pictures["position_error.png"] = png(position_error_figure(one))
    if np.any(np.isfinite(one.rpy)):
        pictures["attitude.png"] = png(attitude_figure(one))
        pictures["attitude_error.png"] = png(attitude_error_figure(one))
    return pictures
