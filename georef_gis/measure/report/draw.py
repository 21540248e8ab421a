"""What the pictures of the report page share: colours, axes, bytes, numbers in words."""

from __future__ import annotations

import io
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from georef_gis.frames import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Okabe and Ito's colours, which the colour-blind tell apart.
BLACK, ORANGE, SKY, GREEN, BLUE, RED = (
    "#000000", "#E69F00", "#56B4E9", "#009E73", "#0072B2", "#D55E00",
)  # fmt: skip
GREY = "#7F7F7F"
WIDE = 9.6
_NICE = (1.0, 2.0, 2.5, 5.0, 10.0)
# px of the median absolute deviation of a normal distribution per standard deviation
MAD = 1.4826


def new_figure(width: float, height: float) -> Figure:
    """An empty figure of inches."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def png(figure: Figure, *, dpi: int = 110) -> bytes:
    """The figure as a PNG file; equal figures give equal bytes."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=dpi, metadata={"Software": None})
    return stream.getvalue()


def jpeg(figure: Figure, *, dpi: int = 130) -> bytes:
    """The figure as a JPEG file, for those that hold photos or shades."""
    stream = io.BytesIO()
    figure.savefig(stream, format="jpeg", dpi=dpi, pil_kwargs={"quality": 84})
    return stream.getvalue()


def with_grid(axis: Axes) -> None:
    """Give an axis its grid and plain numbers."""
    axis.grid(True, color="#DDDDDD", linewidth=0.6)
    axis.set_axisbelow(True)
    axis.spines[["top", "right"]].set_visible(False)
    axis.tick_params(labelsize=9)


def map_figure(extent: tuple[float, float, float, float]) -> tuple[Figure, Axes]:
    """Figure with an axis of metres, north up, of the proportions of what it shows.

    Parameters
    ----------
    extent
        Left, right, bottom, top, m.
    """
    left, right, bottom, top = extent
    # A single strip would be a line: its map is a third as high as wide, or as wide as high.
    more = np.maximum(
        0.0, [(top - bottom) / 3 - (right - left), (right - left) / 3 - (top - bottom)]
    )
    left, right = left - more[0] / 2, right + more[0] / 2
    bottom, top = bottom - more[1] / 2, top + more[1] / 2
    shape = (top - bottom) / max(right - left, 1e-6)
    height = float(np.clip(WIDE * 0.86 * shape + 0.6, 3.4, 10.0))
    figure = new_figure(WIDE, height)
    axis = figure.subplots()
    axis.set_aspect("equal")
    axis.set_xlim(left, right)
    axis.set_ylim(bottom, top)
    axis.set_xlabel("east (m from the south-west corner)", fontsize=9)
    axis.set_ylabel("north (m)", fontsize=9)
    axis.tick_params(labelsize=9)
    return figure, axis


def extent_of(places: Iterable[Array], *, share: float = 0.04) -> tuple[float, float, float, float]:
    """Left, right, bottom, top around places (..., 2), with a margin of a share of the size."""
    xy = np.vstack([np.asarray(p).reshape(-1, 2) for p in places])
    low, high = np.nanmin(xy, axis=0), np.nanmax(xy, axis=0)
    margin = share * max(float(np.max(high - low)), 1.0)
    return (
        float(low[0] - margin), float(high[0] + margin),
        float(low[1] - margin), float(high[1] + margin),
    )  # fmt: skip


def outlines(
    axis: Axes, rings: Iterable[Array], *, color: str = ORANGE, width: float = 0.3, line: str = "-"
) -> None:
    """Rings (n, 2) m in one drawing: thousands of single lines take minutes."""
    from matplotlib.collections import LineCollection

    axis.add_collection(
        LineCollection(list(rings), colors=color, linewidths=width, linestyles=line), autolim=False
    )


def scale_and_north(axis: Axes) -> None:
    """A scale bar of a round length and an arrow to grid north, on white."""
    left, right = axis.get_xlim()
    bottom, top = axis.get_ylim()
    length = round_length(0.2 * (right - left))
    x, y = left + 0.03 * (right - left), bottom + 0.05 * (top - bottom)
    box = {"facecolor": "white", "alpha": 0.85, "edgecolor": "none", "pad": 2.5}
    axis.plot([x, x + length], [y, y], color="white", lw=7, solid_capstyle="butt", zorder=8)
    axis.plot([x, x + length], [y, y], color=BLACK, lw=3.5, solid_capstyle="butt", zorder=9)
    axis.annotate(
        f"{length:g} m", (x + length / 2, y), xytext=(0, 8), textcoords="offset points",
        ha="center", fontsize=9, zorder=9, bbox=box,
    )  # fmt: skip
    axis.annotate(
        "N", (0.965, 0.965), xytext=(0.965, 0.87), xycoords="axes fraction", ha="center",
        va="center", fontsize=11, fontweight="bold", bbox=box, zorder=9,
        arrowprops={"arrowstyle": "-|>", "lw": 2.0, "color": BLACK},
    )  # fmt: skip


def round_length(value: float) -> float:
    """The largest of 1, 2, 2.5, 5 times a power of ten that is not above a value."""
    if not value > 0:
        return 1.0
    power = 10.0 ** math.floor(math.log10(value))
    return max(nice * power for nice in (0.5, *_NICE) if nice * power <= value * (1 + 1e-9))


def names_at(axis: Axes, places: Mapping[str, Array], *, most: int = 60) -> None:
    """Names beside places, unless they are too many to read."""
    if len(places) > most:
        return
    from matplotlib.patheffects import withStroke

    halo = [withStroke(linewidth=2.0, foreground="white")]
    for name, place in places.items():
        axis.annotate(
            name, (place[0], place[1]), xytext=(4, 4), textcoords="offset points", fontsize=7,
            color="#222222", path_effects=halo, zorder=7,
        )  # fmt: skip


# -- numbers in words --------------------------------------------------------------------------


def metres(value: float | None, *, sign: bool = False) -> str:
    """A length with a unit that reads well."""
    if value is None or not math.isfinite(value):
        return "-"
    plus = "+" if sign else ""
    if abs(value) >= 0.995:
        return f"{value:{plus}.{0 if abs(value) >= 1000 else 2}f} m"
    # + 0.0 takes the sign off a zero
    return f"{round(100 * value, 1) + 0.0:{plus}.1f} cm"


def area(value: float) -> str:
    """An area in m2 or hectares, and acres."""
    acres = value / 4046.8564224
    metric = f"{value / 1e4:.2f} ha" if value >= 1e4 else f"{value:.0f} m²"
    return f"{metric} ({acres:.2f} acres)"


def number(value: float | None, digits: int = 2, *, sign: bool = False) -> str:
    """A number with so many decimals, "-" where there is none."""
    if value is None or not math.isfinite(value):
        return "-"
    # + 0.0 takes the sign off a zero
    return f"{round(value, digits) + 0.0:{'+' if sign else ''}.{digits}f}"


def few(names: Sequence[str], most: int = 5) -> str:
    """The first names, and how many more there are."""
    more = len(names) - most
    return ", ".join(names[:most]) + (f" and {more} more" if more > 0 else "")


def robust_sigma(values: Array) -> float:
    """Standard deviation that a few outliers do not raise."""
    at = np.asarray(values)[np.isfinite(values)]
    return float(MAD * np.median(np.abs(at - np.median(at)))) if len(at) else math.nan


def plural(count: int, word: str) -> str:
    """A count with its word."""
    return f"{count} {word}{'' if count == 1 else 's'}"
