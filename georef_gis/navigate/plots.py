"""Pictures of trajectories and of their differences, as the two source reports draw them.

Figures 13 to 15 of the 2009 report (attitude, height) and 16 to 18 of the 2012 paper (plan,
errors of position and attitude), and the innovations of a filter. Every function gives a
`matplotlib.figure.Figure`, which `png` turns into the bytes of a file.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from georef_gis.errors import NavigationError
from georef_gis.navigate.resample import metres_per_radian, sigma_rpy_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from georef_gis.frames import Array
    from georef_gis.model.logs import TrajectoryLog
    from georef_gis.navigate.compare import Comparison

# Okabe and Ito's colours, which the colour-blind tell apart.
BLACK, ORANGE, SKY, GREEN, BLUE, RED = (
    "#000000", "#E69F00", "#56B4E9", "#009E73", "#0072B2", "#D55E00",
)  # fmt: skip
GREY = "#7F7F7F"
# More points than this along an axis cannot be seen.
_POINTS = 6000


def png(figure: Figure, *, dpi: int = 130) -> bytes:
    """The figure as a PNG file."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    FigureCanvasAgg(figure)
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=dpi)
    return stream.getvalue()


def attitude_figure(comparison: Comparison) -> Figure:
    """Roll, pitch and yaw of estimate and reference over time (2009 report, Figs. 13 and 14)."""
    one = comparison
    t = one.time - one.time[0]
    figure, axes = _stack(3, height=8.0, title="Attitude")
    for i, (axis, name) in enumerate(zip(axes, ("Roll", "Pitch", "Yaw"), strict=True)):
        for log, style in ((one.reference, _REFERENCE), (one.estimate, _ESTIMATE)):
            if i == 2:
                axis.plot(*_broken_at_wrap(t, np.degrees(log.rpy[:, i])), **style)
            else:
                _line(axis, t, np.degrees(log.rpy[:, i]), style)
        axis.set_ylabel(f"{name} (deg)")
        if i == 2:
            axis.set_ylim(0, 360)
            axis.set_yticks(range(0, 361, 90))
    _finish(figure, axes)
    return figure


def position_figure(
    series: Mapping[str, TrajectoryLog], *, zoom: tuple[float, float] | None = None
) -> Figure:
    """North, east and height of several trajectories over time, and a part of the height closer.

    As the 2009 report's Fig. 15: the raw fixes jump, the filter's path may step at fixes, the
    smoother's does not.

    Parameters
    ----------
    series
        Trajectories by name, drawn in this order; "raw fixes" as dots.
    zoom
        s since the start of the closer part; None: 20 s around the middle.
    """
    logs = list(series.values())
    if not logs:
        raise NavigationError("nothing to draw; give one trajectory or more")
    begin = min(float(log.time[0]) for log in logs)
    end = max(float(log.time[-1]) for log in logs)
    middle = 0.5 * (end - begin)
    low, high = zoom or (max(0.0, middle - 10.0), min(end - begin, middle + 10.0))
    figure, axes = _stack(4, height=10.5, title="Position", shared=False)
    base = logs[0]
    lines: list[Array] = []
    spare = iter((_ESTIMATE, _SMOOTH, _FILTER, _REFERENCE) * len(series))
    for name, log in series.items():
        style: dict[str, Any] = {**(_BY_NAME.get(name) or next(spare)), "label": name}
        t, rows = log.time - begin, _local(log, base)
        for axis, values in zip(axes[:3], rows, strict=True):
            _line(axis, t, values, style)
        near = (t >= low) & (t <= high)
        larger = {"markersize": 6} if "markersize" in style else {}
        _line(axes[3], t[near], rows[2][near], {**style, **larger})
        if not larger:
            lines.append(rows[2][near])
    for axis, label in zip(
        axes, ("North (m)", "East (m)", "Height (m)", "Height (m)"), strict=True
    ):
        axis.set_ylabel(label)
    for axis in axes[:3]:
        axis.set_xlim(0.0, end - begin)
        axis.axvspan(low, high, color=GREY, alpha=0.18, linewidth=0)
    axes[3].set_xlim(low, high)
    axes[3].set_title(
        "Height within the grey band; fixes may lie outside the view", fontsize=9, loc="left"
    )
    _fit_lines(axes[3], lines)
    _finish(figure, axes)
    return figure


def plan_figure(comparison: Comparison) -> Figure:
    """Both trajectories from above (2012 paper, Fig. 16)."""
    from matplotlib.figure import Figure

    one = comparison
    north, east, _ = _local(one.reference, one.reference)
    shape = (np.nanmax(east) - np.nanmin(east)) / max(np.nanmax(north) - np.nanmin(north), 1.0)
    # So that the picture is as wide as the flight; the legend needs 5 inches.
    width = float(np.clip(6.4 * shape + 1.6, 5.0, 12.0))
    figure = Figure(figsize=(width, 7.2), layout="constrained")
    axis = figure.add_subplot()
    for log, style in ((one.reference, _REFERENCE), (one.estimate, _ESTIMATE)):
        north, east, _ = _local(log, one.reference)
        every = max(1, len(north) // _POINTS)
        axis.plot(east[::every], north[::every], **style)
    north, east, _ = _local(one.estimate, one.reference)
    known = np.flatnonzero(np.isfinite(north))
    if len(known):
        axis.plot(east[known[0]], north[known[0]], "o", color=GREEN, label="start", zorder=5)
        axis.plot(east[known[-1]], north[known[-1]], "s", color=BLACK, label="end", zorder=5)
    axis.set_aspect("equal", adjustable="box")
    axis.set(xlabel="East (m)", ylabel="North (m)")
    _grid(axis)
    _finish(figure, [axis], title="Plan view", time=False)
    return figure


def single_attitude_figure(log: TrajectoryLog) -> Figure:
    """Roll, pitch and yaw of one trajectory, with the largest sigma of each."""
    t = log.time - log.time[0]
    sigma = np.degrees(sigma_rpy_of(log))
    figure, axes = _stack(3, height=8.0, title="Attitude")
    for i, (axis, name) in enumerate(zip(axes, ("Roll", "Pitch", "Yaw"), strict=True)):
        angle = np.degrees(log.rpy[:, i])
        if i == 2:
            axis.plot(*_broken_at_wrap(t, angle), **{**_ESTIMATE, "label": "smoothed"})
            axis.set_ylim(0, 360)
            axis.set_yticks(range(0, 361, 90))
        else:
            _line(axis, t, angle, {**_ESTIMATE, "label": "smoothed"})
        worst = float(np.nanmax(sigma[:, i])) if np.isfinite(sigma[:, i]).any() else np.nan
        axis.set_ylabel(f"{name} (deg)")
        axis.set_title(f"largest sigma {worst:.2g} deg", loc="right", fontsize=9)
    _finish(figure, axes)
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
    figure, axes = _stack(2, height=6.0, title="How well the fixes agree with the IMU")
    for i, (axis, name) in enumerate(zip(axes, ("Position", "Velocity"), strict=True)):
        good, bad = nis[:, i] >= 0.0, nis[:, i] < 0.0
        axis.plot(t[good], nis[good, i] / 3.0, ".", color=BLUE, markersize=2, label="accepted")
        if bad.any():
            axis.plot(t[bad], -nis[bad, i] / 3.0, "x", color=ORANGE, label="counted less")
        axis.axhline(1.0, color=BLACK, linewidth=0.8, label="expected mean")
        axis.set_yscale("log")
        axis.set_ylabel(f"{name}: NIS / 3")
    _finish(figure, axes)
    return figure


def position_error_figure(comparison: Comparison) -> Figure:
    """Differences north, east, down with bands of one and two sigmas (2012 paper, Fig. 17)."""
    one = comparison
    names = ("North (m)", "East (m)", "Down (m)")
    return _errors("Position: estimate - reference", names, one.time, one.position,
                   one.sigma_position)  # fmt: skip


def attitude_error_figure(comparison: Comparison) -> Figure:
    """Differences of roll, pitch, yaw with bands of one and two sigmas (2012 paper, Fig. 18)."""
    one = comparison
    names = ("Roll (deg)", "Pitch (deg)", "Yaw (deg)")
    return _errors("Attitude: estimate - reference", names, one.time, np.degrees(one.rpy),
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
    figure, axes = _stack(count + 1, height=1.6 * (count + 1) + 0.8, title="Innovations")
    for i in range(count):
        _band(axes[i], t, sigma[:, i], doubled=True)
        axes[i].plot(t, innovation[:, i], ".", color=BLUE, markersize=2.5, label="innovation",
                     rasterized=True)  # fmt: skip
        _keep_in_view(axes[i], innovation[:, i], sigma[:, i])
        axes[i].set_ylabel(names[i])
    ratio = nis / dof
    positive = np.isfinite(ratio) & (ratio > 0.0)
    axes[-1].plot(t[positive], ratio[positive], ".", color=GREEN, markersize=2.5, label="NIS/dof")
    axes[-1].axhline(1.0, color=BLACK, linewidth=0.8, label="expected mean of NIS/dof")
    axes[-1].set_yscale("log")
    axes[-1].set_ylabel("NIS/dof (-)")
    _finish(figure, axes)
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


_REFERENCE: dict[str, Any] = {"color": ORANGE, "linewidth": 2.2, "label": "reference"}
_ESTIMATE: dict[str, Any] = {"color": BLUE, "linewidth": 0.9, "label": "estimate"}
_SMOOTH: dict[str, Any] = {"color": RED, "linewidth": 1.1, "linestyle": "--"}
_RAW: dict[str, Any] = {"color": GREY, "linestyle": "none", "marker": ".", "markersize": 2.5}
_FILTER: dict[str, Any] = {"color": SKY, "linewidth": 1.6}
_BY_NAME: dict[str, dict[str, Any]] = {
    "raw fixes": _RAW, "filter": _FILTER, "smoother": _SMOOTH,
    "estimate": _ESTIMATE, "reference": _REFERENCE,
}  # fmt: skip


def _stack(
    count: int, *, height: float, title: str, shared: bool = True
) -> tuple[Figure, list[Axes]]:
    """Figure of axes above each other."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, height), layout="constrained")
    figure.suptitle(title, fontsize=11)
    axes = list(figure.subplots(count, 1, sharex=shared, squeeze=False)[:, 0])
    for axis in axes:
        _grid(axis)
    return figure, axes


def _grid(axis: Axes) -> None:
    axis.grid(True, color="#D9D9D9", linewidth=0.6)
    axis.set_axisbelow(True)
    axis.spines[["top", "right"]].set_visible(False)
    # Offsets such as +1.2e6 hide what a reader looks for.
    axis.ticklabel_format(useOffset=False, style="plain")
    axis.tick_params(labelsize=9)


def _finish(figure: Figure, axes: list[Axes], *, title: str = "", time: bool = True) -> None:
    """One legend above the data, and the axis of time."""
    if title:
        figure.suptitle(title, fontsize=11)
    if time:
        axes[-1].set_xlabel("Time since start (s)")
    found: dict[str, Any] = {}
    for axis in axes:
        for handle, label in zip(*axis.get_legend_handles_labels(), strict=True):
            found.setdefault(label, handle)
    figure.legend(found.values(), found.keys(), loc="outside lower center", ncols=len(found),
                  frameon=False, fontsize=9)  # fmt: skip
    figure.align_ylabels(axes)


def _line(axis: Axes, x: Array, y: Array, style: Mapping[str, Any]) -> None:
    keep = _extremes(y)
    axis.plot(x[keep], y[keep], **style)


def _extremes(y: Array) -> NDArray[np.intp]:
    """Rows to draw: the least and the largest of every few, so that no spike is lost."""
    every = 2 * (len(y) // _POINTS)
    if every < 4:
        return np.arange(len(y))
    count = len(y) // every
    bins = y[: count * every].reshape(count, every)
    hidden = ~np.isfinite(bins)
    low = np.argmin(np.where(hidden, np.inf, bins), axis=1)
    high = np.argmax(np.where(hidden, -np.inf, bins), axis=1)
    start = np.arange(count) * every
    picked = np.sort(np.stack([start + low, start + high], axis=-1), axis=1).ravel()
    return np.concatenate([picked, np.arange(count * every, len(y))])


def _errors(title: str, names: Sequence[str], time: Array, error: Array, sigma: Array) -> Figure:
    t = time - time[0]
    figure, axes = _stack(3, height=8.0, title=title)
    for i, axis in enumerate(axes):
        _band(axis, t, sigma[:, i])
        _line(axis, t, error[:, i], {"color": BLUE, "linewidth": 0.8, "label": "difference"})
        axis.axhline(0.0, color=BLACK, linewidth=0.6)
        _keep_in_view(axis, error[:, i], sigma[:, i])
        known = error[np.isfinite(error[:, i]), i]
        unit = names[i].partition("(")[2].rstrip(")")
        if len(known):
            figures = (
                f"rms {np.sqrt(np.mean(known**2)):.3g} {unit}, mean {np.mean(known):.3g} {unit}"
            )
            axis.set_title(figures, fontsize=9, loc="right")
        axis.set_ylabel(names[i])
    _finish(figure, axes)
    return figure


def _band(axis: Axes, t: Array, sigma: Array, *, doubled: bool = False) -> None:
    """Bands of two sigmas and, unless `doubled`, of one."""
    if not np.any(np.isfinite(sigma)):
        return
    every = max(1, len(t) // _POINTS)
    t, s = t[::every], sigma[::every]
    axis.fill_between(t, -2 * s, 2 * s, color=SKY, alpha=0.25, linewidth=0, label="±2 sigma")
    if not doubled:
        axis.fill_between(t, -s, s, color=SKY, alpha=0.45, linewidth=0, label="±1 sigma")


def _fit_lines(axis: Axes, lines: Sequence[Array]) -> None:
    """Limits by the lines alone, 0.8 m around: steps at fixes would not be seen among dots."""
    values = np.concatenate([*lines, np.empty(0)])
    values = values[np.isfinite(values)]
    if len(values):
        axis.set_ylim(values.min() - 0.8, values.max() + 0.8)


def _keep_in_view(axis: Axes, error: Array, sigma: Array) -> None:
    """Limits by what lies there, so that a wide sigma at an end does not flatten the rest."""
    e = np.abs(error[np.isfinite(error)])
    s = sigma[np.isfinite(sigma)]
    if not len(e):
        return
    top = max(float(e.max()), 2.2 * float(np.median(s)) if len(s) else 0.0)
    if top > 0.0:
        axis.set_ylim(-1.08 * top, 1.08 * top)


def _broken_at_wrap(t: Array, angle: Array) -> tuple[Array, Array]:
    """Times and angles from 0 to 360 deg, a gap where a line would cross the whole picture."""
    every = max(1, len(t) // _POINTS)
    t, angle = t[::every], np.mod(angle[::every], 360.0)
    after = np.flatnonzero(np.abs(np.diff(angle)) > 180.0) + 1
    return np.insert(t, after, t[after]), np.insert(angle, after, np.nan)


def _local(log: TrajectoryLog, base: TrajectoryLog) -> tuple[Array, Array, Array]:
    """North, east from the first known place of `base`, and ellipsoidal height, m."""
    known = np.flatnonzero(np.isfinite(base.lat))
    if not len(known):
        return log.lat, log.lon, log.height
    lat, lon = base.lat[known[0]], base.lon[known[0]]
    north, east = metres_per_radian(base.lat[known[:1]], base.height[known[:1]])
    around = np.mod(log.lon - lon + np.pi, 2.0 * np.pi) - np.pi
    return (log.lat - lat) * north, around * east, log.height
