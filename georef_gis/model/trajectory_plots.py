"""Pictures of one trajectory over time: attitude and position, with sigmas and exposures.

Figures 13 to 15 of the 2009 report. Every function gives a `matplotlib.figure.Figure`, which
`plot_parts.png` turns into the bytes of a file.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from georef_gis.errors import NavigationError
from georef_gis.model.plot_parts import (
    BLACK,
    BY_NAME,
    ESTIMATE,
    FILTER,
    GREY,
    REFERENCE,
    SKY,
    SMOOTH,
    broken_at_wrap,
    draw_line,
    finish,
    fit_lines,
    stacked,
)
from georef_gis.model.trajectory_values import local_places, sigma_rpy_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from georef_gis.frames import Array
    from georef_gis.model.logs import TrajectoryLog

_ANGLES = ("Roll", "Pitch", "Yaw")
_CLOSER = "Height within the grey band; fixes may lie outside the view"
_PLACES = ("North (m)", "East (m)", "Height (m)", "Height (m)")
# least and most of the axis of sigmas, as shares of its middle half: a start that nothing tells
# would flatten the rest
_SIGMA_SPAN = (0.4, 8.0)


def attitude_over_time(
    log: TrajectoryLog, *, exposures: Array | None = None, label: str = "smoothed"
) -> Figure:
    """Roll, pitch and yaw of one trajectory with two sigmas, and the sigmas by themselves.

    Parameters
    ----------
    exposures : s
        Times to mark, on the scale of the log.
    """
    t = log.time - log.time[0]
    sigma = np.degrees(sigma_rpy_of(log))
    figure, axes = stacked(4, height=9.6, title="Attitude")
    for i, (axis, name) in enumerate(zip(axes, _ANGLES, strict=False)):
        _angle(axis, t, np.degrees(log.rpy[:, i]), sigma[:, i], label=label, whole_turn=i == 2)
        axis.set_ylabel(f"{name} (deg)")
    for i, style in enumerate((ESTIMATE, SMOOTH, REFERENCE)):
        draw_line(axes[3], t, sigma[:, i], {**style, "label": f"sigma {_ANGLES[i].lower()}"})
    _sigma_axis(axes[3], sigma)
    _mark(axes, exposures, log.time[0])
    finish(figure, axes)
    return figure


def _angle(
    axis: Axes, t: Array, angle: Array, sigma: Array, *, label: str, whole_turn: bool
) -> None:
    """Angle, deg, with a band of two sigmas; a heading from 0 to 360."""
    style = {**ESTIMATE, "label": label}
    if whole_turn:
        axis.set_ylim(0, 360)
        axis.set_yticks(range(0, 361, 90))
        t_band, middle = broken_at_wrap(t, angle)
        known = np.isfinite(sigma)
        width = np.interp(t_band, t[known], sigma[known]) if np.any(known) else None
    else:
        t_band, middle, width = t, angle, sigma
    if width is not None and np.any(np.isfinite(width)):
        axis.fill_between(
            t_band, middle - 2 * width, middle + 2 * width, color=SKY, alpha=0.5, linewidth=0,
            label="±2 sigma",
        )  # fmt: skip
    # the usual band is seen whole; that of a start that nothing tells may leave the picture
    if not whole_turn and np.any(np.isfinite(angle)):
        low, high = float(np.nanmin(angle)), float(np.nanmax(angle))
        usual = float(np.nanmedian(sigma)) if np.any(np.isfinite(sigma)) else 0.0
        margin = max(0.1 * (high - low) + 1.0, 2.2 * usual)
        axis.set_ylim(low - margin, high + margin)
    if whole_turn:
        axis.plot(t_band, middle, **style)
    else:
        draw_line(axis, t, angle, style)


def _sigma_axis(axis: Axes, sigma: Array) -> None:
    """Limits of sigmas: from zero to what most of them need."""
    axis.set_ylabel("One sigma (deg)")
    known = sigma[np.isfinite(sigma)]
    if not len(known):
        return
    middle = float(np.median(known))
    least, most = (share * middle for share in _SIGMA_SPAN)
    top = min(float(known.max()), max(most, 1.5 * float(np.quantile(known, 0.9))))
    axis.set_ylim(0.0, 1.08 * max(top, least, 1e-6))


def position_figure(
    series: Mapping[str, TrajectoryLog],
    *,
    zoom: tuple[float, float] | None = None,
    closer: bool = True,
    exposures: Array | None = None,
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
    closer
        Whether there is one.
    exposures : s
        Times to mark, on the scale of the trajectories.
    """
    logs = list(series.values())
    if not logs:
        raise NavigationError("nothing to draw; give one trajectory or more")
    begin = min(float(log.time[0]) for log in logs)
    end = max(float(log.time[-1]) for log in logs)
    middle = 0.5 * (end - begin)
    low, high = zoom or (max(0.0, middle - 10.0), min(end - begin, middle + 10.0))
    count = 4 if closer else 3
    figure, axes = stacked(count, height=2.6 * count, title="Position", shared=False)
    lines = _lines(axes, series, begin, (low, high))
    for axis, label in zip(axes, _PLACES, strict=False):
        axis.set_ylabel(label)
    for axis in axes[:3]:
        axis.set_xlim(0.0, (end - begin) or 1.0)
    if closer:
        for axis in axes[:3]:
            axis.axvspan(low, high, color=GREY, alpha=0.18, linewidth=0)
        axes[3].set_xlim(low, high)
        axes[3].set_title(_CLOSER, fontsize=9, loc="left")
        fit_lines(axes[3], lines)
    _mark(axes, exposures, begin)
    finish(figure, axes)
    return figure


def _lines(
    axes: list[Axes],
    series: Mapping[str, TrajectoryLog],
    begin: float,
    zoom: tuple[float, float],
) -> list[Array]:
    """Draw all trajectories; gives the heights of the lines within the closer part."""
    base = next(iter(series.values()))
    lines: list[Array] = []
    spare = iter((ESTIMATE, SMOOTH, FILTER, REFERENCE) * len(series))
    for name, log in series.items():
        style: dict[str, Any] = {**(BY_NAME.get(name) or next(spare)), "label": name}
        t, rows = log.time - begin, local_places(log, base)
        for axis, values in zip(axes[:3], rows, strict=True):
            draw_line(axis, t, values, style)
        near = (t >= zoom[0]) & (t <= zoom[1])
        larger = {"markersize": 6} if "markersize" in style else {}
        for axis in axes[3:]:
            draw_line(axis, t[near], rows[2][near], {**style, **larger})
        if not larger:
            lines.append(rows[2][near])
    return lines


def _mark(axes: list[Axes], exposures: Array | None, begin: float) -> None:
    """Strokes at the lower edge where photos were taken; the limits stay."""
    if exposures is None or not len(exposures):
        return
    for axis in axes:
        limits = axis.get_xlim()
        axis.plot(
            exposures - begin, np.full(len(exposures), 0.03), "|", color=BLACK, markersize=7,
            transform=axis.get_xaxis_transform(), label="exposure", zorder=6,
        )  # fmt: skip
        axis.set_xlim(limits)
