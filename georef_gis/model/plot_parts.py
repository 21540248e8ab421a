"""What pictures over time are made of: colours, axes, bands, thinned lines."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from georef_gis.frames import Array

# Okabe and Ito's colours, which the colour-blind tell apart.
BLACK, ORANGE, SKY, GREEN, BLUE, RED = (
    "#000000", "#E69F00", "#56B4E9", "#009E73", "#0072B2", "#D55E00",
)  # fmt: skip
GREY = "#7F7F7F"
# More points than this along an axis cannot be seen.
MOST_POINTS = 6000


def png(figure: Figure, *, dpi: int = 130) -> bytes:
    """The figure as a PNG file."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    FigureCanvasAgg(figure)
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=dpi)
    return stream.getvalue()


REFERENCE: dict[str, Any] = {"color": ORANGE, "linewidth": 2.2, "label": "reference"}
ESTIMATE: dict[str, Any] = {"color": BLUE, "linewidth": 0.9, "label": "estimate"}
SMOOTH: dict[str, Any] = {"color": RED, "linewidth": 1.1, "linestyle": "--"}
RAW: dict[str, Any] = {"color": GREY, "linestyle": "none", "marker": ".", "markersize": 2.5}
FILTER: dict[str, Any] = {"color": SKY, "linewidth": 1.6}
BY_NAME: dict[str, dict[str, Any]] = {
    "raw fixes": RAW, "filter": FILTER, "smoother": SMOOTH, "smoothed": SMOOTH,
    "direct poses": {**ESTIMATE, "marker": "."}, "adjusted poses": {**SMOOTH, "marker": "."},
    "estimate": ESTIMATE, "reference": REFERENCE,
}  # fmt: skip


def stacked(
    count: int, *, height: float, title: str, shared: bool = True
) -> tuple[Figure, list[Axes]]:
    """Figure of axes above each other."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, height), layout="constrained")
    figure.suptitle(title, fontsize=11)
    axes = list(figure.subplots(count, 1, sharex=shared, squeeze=False)[:, 0])
    for axis in axes:
        with_grid(axis)
    return figure, axes


def with_grid(axis: Axes) -> None:
    """Give an axis its grid and plain numbers."""
    axis.grid(True, color="#D9D9D9", linewidth=0.6)
    axis.set_axisbelow(True)
    axis.spines[["top", "right"]].set_visible(False)
    # Offsets such as +1.2e6 hide what a reader looks for.
    axis.ticklabel_format(useOffset=False, style="plain")
    axis.tick_params(labelsize=9)


def finish(figure: Figure, axes: list[Axes], *, title: str = "", time: bool = True) -> None:
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


def draw_line(axis: Axes, x: Array, y: Array, style: Mapping[str, Any]) -> None:
    """Draw a line, thinned to what can be seen."""
    keep = extremes(y)
    axis.plot(x[keep], y[keep], **style)


def extremes(y: Array) -> NDArray[np.intp]:
    """Rows to draw: the least and the largest of every few, so that no spike is lost."""
    every = 2 * (len(y) // MOST_POINTS)
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


def error_figure(
    title: str, names: Sequence[str], time: Array, error: Array, sigma: Array
) -> Figure:
    """Three differences (n, 3) over time, s, with their bands of one and two sigmas."""
    t = time - time[0]
    figure, axes = stacked(3, height=8.0, title=title)
    for i, axis in enumerate(axes):
        draw_band(axis, t, sigma[:, i])
        draw_line(axis, t, error[:, i], {"color": BLUE, "linewidth": 0.8, "label": "difference"})
        axis.axhline(0.0, color=BLACK, linewidth=0.6)
        keep_in_view(axis, error[:, i], sigma[:, i])
        known = error[np.isfinite(error[:, i]), i]
        unit = names[i].partition("(")[2].rstrip(")")
        if len(known):
            figures = (
                f"rms {np.sqrt(np.mean(known**2)):.3g} {unit}, mean {np.mean(known):.3g} {unit}"
            )
            axis.set_title(figures, fontsize=9, loc="right")
        axis.set_ylabel(names[i])
    finish(figure, axes)
    return figure


def draw_band(axis: Axes, t: Array, sigma: Array, *, doubled: bool = False) -> None:
    """Bands of two sigmas and, unless `doubled`, of one."""
    if not np.any(np.isfinite(sigma)):
        return
    every = max(1, len(t) // MOST_POINTS)
    t, s = t[::every], sigma[::every]
    axis.fill_between(t, -2 * s, 2 * s, color=SKY, alpha=0.25, linewidth=0, label="±2 sigma")
    if not doubled:
        axis.fill_between(t, -s, s, color=SKY, alpha=0.45, linewidth=0, label="±1 sigma")


def fit_lines(axis: Axes, lines: Sequence[Array]) -> None:
    """Limits by the lines alone, 0.8 m around: steps at fixes would not be seen among dots."""
    values = np.concatenate([*lines, np.empty(0)])
    values = values[np.isfinite(values)]
    if len(values):
        axis.set_ylim(values.min() - 0.8, values.max() + 0.8)


def keep_in_view(axis: Axes, error: Array, sigma: Array) -> None:
    """Limits by what lies there, so that a wide sigma at an end does not flatten the rest."""
    e = np.abs(error[np.isfinite(error)])
    s = sigma[np.isfinite(sigma)]
    if not len(e):
        return
    top = max(float(e.max()), 2.2 * float(np.median(s)) if len(s) else 0.0)
    if top > 0.0:
        axis.set_ylim(-1.08 * top, 1.08 * top)


def broken_at_wrap(t: Array, angle: Array) -> tuple[Array, Array]:
    """Times and angles from 0 to 360 deg, a gap where a line would cross the whole picture."""
    every = max(1, len(t) // MOST_POINTS)
    t, angle = t[::every], np.mod(angle[::every], 360.0)
    after = np.flatnonzero(np.abs(np.diff(angle)) > 180.0) + 1
    return np.insert(t, after, t[after]), np.insert(angle, after, np.nan)
