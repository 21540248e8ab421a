"""The flight: path, height, attitude with its sigmas, and how the fixes agree with the filter."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from georef_gis.frames import Array
from georef_gis.measure.report.draw import (
    BLACK,
    GREEN,
    GREY,
    RED,
    extent_of,
    few,
    map_figure,
    metres,
    outlines,
    plural,
    png,
    robust_sigma,
    scale_and_north,
)
from georef_gis.measure.report.facts import Facts
from georef_gis.measure.report.flight_facts import FixDifferences, Flown, enu_of
from georef_gis.measure.report.page import Item, Lines, Picture, Table, Text, Verdict, judged
from georef_gis.model.plot_parts import MOST_POINTS, error_figure
from georef_gis.model.trajectory_plots import attitude_over_time, position_figure
from georef_gis.model.trajectory_values import (
    local_places,
    places_apart,
    sigma_position_of,
    sigma_rpy_of,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# of their median; heights above ground that vary more make the GSD do so
EVEN = 0.2
# times the median sigma at which an exposure is named
FAR = 3.0
# share of the fixes that must lie within what they state (normal: 95 %)
WITHIN = 0.85
# dots per inch of pictures over time
_DPI = 100
_RPY = ("roll", "pitch", "heading")


def path_items(facts: Facts, flown: Flown | None) -> list[Item]:
    """Key figures and pictures; or why there are none."""
    if flown is None:
        return [Text(lines=("No photo has a pose, so there is no flight to show.",))]
    items: list[Item] = [_key_figures(flown), _plan(facts, flown), _positions(flown)]
    if flown.fixes is not None and len(flown.fixes.time) > 1:
        items.append(_fixes(flown, flown.fixes))
    items.append(_attitude(facts, flown))
    if flown.notes:
        items.append(Lines(title="Not shown of the flight", lines=flown.notes))
    return items


def at_exposures(flown: Flown, values: Array) -> Array:
    """Values of the rows, (n, k), where photos were taken; NaN outside of the log and in gaps."""
    t, times = flown.log.time, flown.exposures
    inside = (times >= t[0]) & (times <= t[-1])
    for begin, end in flown.gaps:
        inside &= ~((times > begin) & (times < end))
    out = np.stack([np.interp(times, t, column) for column in values.T], axis=-1)
    return np.where(inside[:, None], out, np.nan)


# -- key figures -------------------------------------------------------------------------------


def _key_figures(flown: Flown) -> Table:
    log = flown.log
    steps = np.linalg.norm(np.diff(_local(flown), axis=0), axis=1)
    rows = [
        ("Source", "poses of the photos: no log" if flown.of_photos else log.source),
        ("Exposures", f"{len(flown.exposures)} on it, {len(flown.outside)} not"),
        ("Length of the path", metres(float(np.nansum(steps)))),
        ("Height above the ellipsoid", _span(log.height)),
    ]  # fmt: skip
    if not flown.of_photos:
        duration = float(log.time[-1] - log.time[0])
        speed = np.linalg.norm(at_exposures(flown, log.v_ned)[:, :2], axis=1)
        rows.insert(1, ("Duration", f"{duration:.0f} s"))
        if np.any(np.isfinite(speed)):
            rows.append(("Speed at the exposures", f"{np.nanmedian(speed):.1f} m/s (median)"))
    elif len(steps):
        rows.append(("Distance between photos", f"{metres(float(np.nanmedian(steps)))} (median)"))
    place = at_exposures(flown, sigma_position_of(log))
    angle = np.degrees(at_exposures(flown, sigma_rpy_of(log)))
    rows.append(("Sigma north / east / height at exposures", _spread(place, metres)))
    rows.append(
        ("Sigma roll / pitch / heading at exposures", _spread(angle, lambda v: f"{v:.2f} deg"))
    )
    return Table(
        title="Flight", columns=("What", "Value"), rows=rows, words=(0, 1),
        look="Every photo should have its place on the path, and the log no gaps.",
        verdict=_coverage(flown),
    )  # fmt: skip


def _span(values: Array) -> str:
    return f"{np.nanmin(values):.1f} to {np.nanmax(values):.1f} m"


def _coverage(flown: Flown) -> Verdict:
    told = f"{plural(len(flown.exposures), 'photo')} on the path"
    told += f", {len(flown.outside)} not: {few(flown.outside)}" if flown.outside else ""
    if flown.of_photos:
        told += "; there is no log, so nothing is known between the photos"
        return judged(told + ".", fine=not flown.outside)
    longest = max((end - begin for begin, end in flown.gaps), default=0.0)
    told += f"; {plural(len(flown.gaps), 'gap')} of the log" if flown.gaps else "; no gaps"
    told += f", the longest {longest:.1f} s" if flown.gaps else ""
    share = len(flown.outside) / max(len(flown.exposures) + len(flown.outside), 1)
    return judged(told + ".", fine=not flown.outside and not flown.gaps, bad=share > 0.3)


def _spread(values: Array, told: Callable[[float], str]) -> str:
    """Medians of three columns, and the largest."""
    if not np.any(np.isfinite(values)):
        return "not known"
    middle = " / ".join(
        told(float(np.nanmedian(c))) if np.any(np.isfinite(c)) else "-" for c in values.T
    )
    return f"{middle} (median), at most {told(float(np.nanmax(values)))}"


def _local(flown: Flown) -> Array:
    """Rows in m about the first, (n, 3); at the resolution at which a path has a length."""
    log = flown.log
    first = np.flatnonzero(np.isfinite(log.lat))[:1]
    keep = slice(None) if flown.of_photos else slice(None, None, 5)
    if not len(first):
        return np.zeros((0, 3))
    north, east, height = local_places(log, log)
    return np.stack([north[keep], east[keep], height[keep]], axis=-1)


# -- from above --------------------------------------------------------------------------------


def _plan(facts: Facts, flown: Flown) -> Picture:
    places = facts.local_of_enu(enu_of(flown.log, facts.frame.origin))
    rings = [facts.local(f.ring_map) for f in facts.footprints.values()]
    figure, axis = map_figure(extent_of([places, *rings]))
    outlines(axis, rings, color="#BBBBBB", width=0.5)
    every = max(1, len(places) // MOST_POINTS)
    path, height = places[::every], flown.log.height[::every]
    size = 26.0 if flown.of_photos else 4.0
    dots = axis.scatter(path[:, 0], path[:, 1], c=height, s=size, cmap="viridis", zorder=4)
    if flown.of_photos:
        axis.plot(*path.T, color=GREY, lw=0.8, zorder=3)
    else:
        _exposures_and_gaps(axis, flown, places)
    axis.plot(*path[0], "o", color=GREEN, ms=8, ls="none", label="start", zorder=6)
    axis.plot(*path[-1], "s", color=BLACK, ms=7, ls="none", label="end", zorder=6)
    handles, labels = axis.get_legend_handles_labels()
    found = dict(zip(labels, handles, strict=True))
    axis.legend(found.values(), found.keys(), loc="lower right", fontsize=8.5)
    bar = figure.colorbar(dots, ax=axis, shrink=0.7, pad=0.01)
    bar.set_label("height above the ellipsoid (m)", fontsize=9)
    bar.ax.ticklabel_format(useOffset=False, style="plain")
    scale_and_north(axis)
    return Picture(
        title="Flight from above",
        data=png(figure, dpi=_DPI),
        alt="Map of the path coloured by height, with the exposures and the outlines of the photos",
        look="Lines should be even and parallel, with turns outside of the outlines (grey); a jump "
        "is a wrong place.",
        verdict=_even(facts),
    )


def _exposures_and_gaps(axis: Axes, flown: Flown, places: Array) -> None:
    taken = at_exposures(flown, places)
    axis.plot(*taken.T, "o", color=BLACK, mfc="none", ms=7, ls="none", label="exposure", zorder=5)
    for gap in flown.gaps:
        ends = places[np.isin(flown.log.time, gap)]
        axis.plot(*ends.T, color=RED, lw=1.8, ls="--", label="gap of the log", zorder=6)


def _even(facts: Facts) -> Verdict:
    """Whether all photos were taken from about one height above the ground."""
    above = np.array([f.height_above_ground for f in facts.footprints.values()])
    above = above[np.isfinite(above)]
    if not len(above):
        return Verdict(level="told", text="the heights above the ground are not known.")
    low, middle, high = (float(v) for v in np.quantile(above, (0.05, 0.5, 0.95)))
    share = (high - low) / max(middle, 1e-9)
    told = (
        f"photos were taken {low:.0f} to {high:.0f} m above the ground (5 to 95 % of them), which "
    )
    told += f"varies the GSD by {share:.0%}."
    return judged(told, fine=share <= EVEN)


# -- over time ---------------------------------------------------------------------------------


def _positions(flown: Flown) -> Picture:
    photos = flown.of_photos
    figure = position_figure(
        flown.series or {"smoothed": flown.log}, closer=not photos,
        exposures=None if photos else flown.exposures,
    )  # fmt: skip
    _fit(figure, flown, 4.4 if photos else 6.2)
    alt = "North, east and height over time"
    look = (
        "The smoothed path should follow the fixes without their jumps; slow errors of the fixes "
        "may part the two by what the sigmas say. The last graph is the height in the grey band."
    )
    return Picture(
        title="Position over time",
        data=png(figure, dpi=_DPI),
        alt=f"{alt} of the photos" if photos else f"{alt}, with a part of the height closer",
        look="Neighbours should follow each other without jumps." if photos else look,
        verdict=_steps(flown),
    )


def _fit(figure: Figure, flown: Flown, height: float) -> None:
    """Make a picture over time fit a page beside others; it has a heading of its own there."""
    figure.suptitle("")
    figure.set_size_inches(9.0, height)
    figure.axes[-1].set_xlabel(flown.axis)


def _steps(flown: Flown) -> Verdict:
    """How far filter and smoother differ: what the later part of the log brought."""
    filtered = flown.series.get("filter")
    if filtered is None:
        what = "photos alone" if flown.of_photos else "the smoothed path alone"
        return Verdict(level="told", text=f"{what}: there is no filter to compare with.")
    log = flown.log
    lat, lon, height = (
        np.interp(filtered.time, log.time, v) for v in (log.lat, log.lon, log.height)
    )
    smooth = replace(filtered, lat=lat, lon=lon, height=height)
    apart = places_apart(filtered, smooth)
    known = np.isfinite(apart).all(axis=1)
    horizontal = np.linalg.norm(apart[known, :2], axis=1)
    told = f"the filter lies {metres(float(np.median(horizontal)))} from the smoother in plan and "
    told += f"{metres(float(np.median(np.abs(apart[known, 2]))))} in height (medians), at most "
    told += f"{metres(float(horizontal.max(initial=0.0)))} in plan."
    return Verdict(level="told", text=told)


def _fixes(flown: Flown, fixes: FixDifferences) -> Picture:
    names = ("North (m)", "East (m)", "Down (m)")
    figure = error_figure("", names, fixes.time, fixes.apart, fixes.sigma)
    _fit(figure, flown, 4.6)
    return Picture(
        title="GNSS fixes less smoothed path",
        data=png(figure, dpi=_DPI),
        alt="Three graphs of the differences north, east and down over time",
        look="The line should scatter about zero within the blue bands, which the receiver states; "
        "it may be quieter, as slow errors of the fixes move the path too.",
        verdict=_fix_verdict(fixes),
    )


def _fix_verdict(fixes: FixDifferences) -> Verdict:
    d = fixes.apart
    rms = [float(np.sqrt(np.nanmean(c**2))) for c in d.T]
    told = f"rms {metres(rms[0])} north, {metres(rms[1])} east, {metres(rms[2])} down"
    if fixes.delay:
        told += f", after a delay of the fixes of {1000 * fixes.delay:.0f} ms"
    wild = np.zeros(len(d), dtype=bool)
    for column in d.T:
        wild |= np.abs(column - np.nanmedian(column)) > 6.0 * max(robust_sigma(column), 1e-3)
    told += f"; {np.mean(wild):.1%} of {len(d)} fixes lie far off"
    known = np.isfinite(fixes.sigma) & np.isfinite(d)
    if not np.any(known):
        return judged(told + "; the receiver states no sigmas.", fine=bool(np.mean(wild) <= 0.05))
    inside = float(np.mean(np.abs(d[known]) <= 2.0 * fixes.sigma[known]))
    told += f"; {inside:.0%} of the differences lie within 2 stated sigmas (normal: 95 %)."
    return judged(told, fine=inside >= WITHIN and bool(np.mean(wild) <= 0.05), bad=inside < 0.5)


def _attitude(facts: Facts, flown: Flown) -> Picture:
    figure = attitude_over_time(
        flown.log, exposures=None if flown.of_photos else flown.exposures,
        label="photos" if flown.of_photos else "smoothed",
    )  # fmt: skip
    _fit(figure, flown, 5.8 if flown.of_photos else 6.4)
    if flown.of_photos:
        for axis in figure.axes:
            for line in axis.lines:
                line.set_marker(".")
    return Picture(
        title="Attitude over time",
        data=png(figure, dpi=_DPI),
        alt="Roll, pitch and heading over time with bands of two sigmas, and the sigmas themselves",
        look="The bands (two sigmas) should be thin and even where photos were taken; the last "
        "graph shows the sigmas alone. A start without turns has a wide heading.",
        verdict=_attitude_verdict(facts, flown),
    )


def _attitude_verdict(facts: Facts, flown: Flown) -> Verdict:
    sigma = at_exposures(flown, sigma_rpy_of(flown.log))
    angle = np.degrees(at_exposures(flown, flown.log.rpy))
    known = np.asarray(np.isfinite(sigma).all(axis=1))
    if not np.any(known):
        return Verdict(level="told", text="the sigmas of the angles are not known.")
    middle = np.median(sigma[known], axis=0)
    tilt = math.hypot(middle[0], middle[1]) / math.sqrt(2.0)
    above = [f.height_above_ground for f in facts.footprints.values()]
    height = float(np.nanmedian(above)) if above else math.nan
    level = np.nanmax(np.abs(angle[:, :2]))
    told = (
        f"median sigmas {_angles(middle)}: {metres(tilt * height)} on the ground by roll or pitch; "
    )
    told += f"at most {level:.0f} deg of roll or pitch at an exposure"
    far = [i for i in np.flatnonzero(known) if np.any(sigma[i] > FAR * middle)]
    told += f"; {plural(len(far), 'exposure')} beyond {FAR:g} times these" if far else ""
    return judged(told + ".", fine=not far and bool(np.all(known)), bad=len(far) > 0.3 * len(known))


def _angles(sigma: Sequence[float] | Array) -> str:
    return ", ".join(
        f"{name} {math.degrees(value):.2f} deg" for name, value in zip(_RPY, sigma, strict=True)
    )
