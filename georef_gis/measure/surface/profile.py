"""Heights of a surface along a line, with their sigma."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely

from georef_gis.errors import GeometryError, InputError
from georef_gis.frames import Array
from georef_gis.geodesy import MapFrame
from georef_gis.measure.report.draw import BLUE, ORANGE, SKY, new_figure, with_grid
from georef_gis.measure.surface.field import HeightField
from georef_gis.measure.surface.raster import HeightReference

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST_STATIONS = 200_000
# of a step; a station so near to a corner is the corner
_BESIDE = 0.01
# of the height of the shape: a band as wide as this hides it
_BEYOND = 0.6
# times the local sigma from which a linear scale would hide it
_CRUSHED = 10.0
# places per detail of the surface where no step is given
_PER_DETAIL = 2.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Profile:
    """Stations along a line; m but for the map's own units.

    Parameters
    ----------
    station : shape (n,)
        Distance from the start on the ground, level.
    xy_map : shape (n, 2), CRS units
    height : shape (n,)
        By the reference; NaN where there is none.
    sigma, sigma_local : shape (n,)
        One sigma of the height, and of it against its surroundings.
    sigma_rise : shape (n,)
        One sigma of the height against that of the first station that has one.
    corners : shape (k,)
        Stations of the line's own vertices.
    """

    station: Array
    xy_map: Array
    height: Array
    sigma: Array
    sigma_local: Array
    sigma_rise: Array
    corners: Array
    reference: HeightReference
    name: str

    @property
    def rows(self) -> list[dict[str, float | None]]:
        """Rows of a table, an empty height where there is none."""
        names = (
            "station_m", "easting", "northing", "height_m", "sigma_m", "sigma_local_m",
            "sigma_rise_m",
        )  # fmt: skip
        columns = (
            np.round(self.station, 3), *np.round(self.xy_map.T, 4), np.round(self.height, 4),
            np.round(self.sigma, 4), np.round(self.sigma_local, 4), np.round(self.sigma_rise, 4),
        )  # fmt: skip
        table = np.column_stack(columns)
        return [
            {n: None if np.isnan(v) else float(v) for n, v in zip(names, row, strict=True)}
            for row in table
        ]


def profile_along(
    field: HeightField, frame: MapFrame, line_map: Any, reference: HeightReference,
    *, step: float | None = None,
) -> Profile:  # fmt: skip
    """Profile of a surface along a line of the map.

    Parameters
    ----------
    line_map
        In CRS units.
    step : m
        Between stations; by default twice as fine as the surface. Corners are stations too.

    Raises
    ------
    InputError
        If the step makes too many stations.
    GeometryError
        If the surface has no height along the line.
    """
    vertices = shapely.get_coordinates(line_map)
    legs = np.diff(_on_plane(frame, vertices, field.on_map(frame, vertices).height), axis=0)
    corners = np.concatenate([[0.0], np.cumsum(np.hypot(*legs.T))])
    station = _stations(corners, step or field.detail / _PER_DETAIL)
    # between two corners the line is straight on the map, and as good as straight on the ground
    xy_map = np.column_stack([np.interp(station, corners, vertices[:, k]) for k in (0, 1)])
    found = field.on_map(frame, xy_map)
    known = np.flatnonzero(np.isfinite(found.height))
    if not len(known):
        raise GeometryError(f"{field.name}: has no height along the line; draw it on the surface")
    xy, start = _on_plane(frame, xy_map, found.height), known[0]
    rise = np.hypot(found.local, found.local[start])
    rise[start] = 0.0
    return Profile(
        station=station, xy_map=xy_map,
        height=reference.from_ellipsoidal(frame, xy_map, found.height),
        sigma=np.hypot(found.local, field.common.sigma_at(xy)), sigma_local=found.local,
        sigma_rise=np.hypot(rise, field.common.sigma_of_rise(xy, xy[start])), corners=corners,
        reference=reference, name=field.name,
    )  # fmt: skip


def _stations(corners: Array, step: float) -> Array:
    """Stations every `step` m and at the corners, whose stations (k,) are given."""
    if corners[-1] / step > MOST_STATIONS:
        raise InputError(
            f"{step:g} m along {corners[-1]:.0f} m makes more than {MOST_STATIONS} stations; "
            "take a longer step",
            field="step",
        )
    even = np.arange(int(corners[-1] / step) + 1) * step
    next_one = np.searchsorted(corners, even).clip(1, len(corners) - 1)
    apart = np.minimum(np.abs(even - corners[next_one]), np.abs(even - corners[next_one - 1]))
    # a corner stands for a station beside it
    return np.sort(np.concatenate([even[apart > _BESIDE * step], corners]))


def _on_plane(frame: MapFrame, xy_map: Array, heights: Array) -> Array:
    """East and north of places at their heights, at the origin's where there is none; (n, 2) m."""
    level = np.nan_to_num(heights, nan=float(frame.origin.height_ellipsoidal))
    return np.asarray(frame.enu_from_map(np.column_stack([xy_map, level]))[:, :2])


def profile_figure(profile: Profile, *, title: str) -> Figure:
    """Height over the station with its sigma, and below it the sigma alone."""
    figure = new_figure(10.0, 5.2)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=[3.0, 1.0])
    s, h = profile.station, profile.height
    upper.fill_between(
        s, h - profile.sigma, h + profile.sigma, color=SKY, alpha=0.35, lw=0,
        label="one sigma of the height",
    )  # fmt: skip
    upper.fill_between(
        s, h - profile.sigma_local, h + profile.sigma_local, color=BLUE, alpha=0.45, lw=0,
        label="against its surroundings",
    )  # fmt: skip
    upper.plot(s, h, color="#003A5D", lw=1.2, label=profile.name)
    _about_its_shape(upper, profile)
    for corner in profile.corners[1:-1]:
        upper.axvline(corner, color="#AAAAAA", lw=0.7, ls=":")
    upper.set_ylabel("height (m)", fontsize=9)
    upper.set_title(f"{title}: height {profile.reference.told}", fontsize=10)
    lower.plot(s, profile.sigma, color=SKY, lw=1.2)
    lower.plot(s, profile.sigma_local, color=BLUE, lw=1.2)
    lower.plot(s, profile.sigma_rise, color=ORANGE, lw=1.2, label="against the first station")
    lower.legend(fontsize=8, loc="best", framealpha=0.9)
    _scaled(lower, profile)
    lower.set_ylabel("sigma (m)", fontsize=9)
    lower.set_xlabel("station on the ground (m)", fontsize=9)
    lower.set_xlim(0.0, float(s[-1]))
    for axis in (upper, lower):
        with_grid(axis)
        if axis.get_yscale() == "linear":
            axis.ticklabel_format(useOffset=False, axis="y")
    gaps = np.isnan(h)
    if np.any(gaps):
        upper.plot(
            s[gaps], np.full(gaps.sum(), np.nanmin(h)), "|", color=ORANGE, ms=5, label="no height"
        )
    upper.legend(fontsize=8, loc="best", framealpha=0.9)
    return figure


def _scaled(axis: Axes, profile: Profile) -> None:
    """Logarithmic where a linear scale would hide the local sigma."""
    if np.nanmedian(profile.sigma) > _CRUSHED * np.nanmedian(profile.sigma_local):
        axis.set_yscale("log")
    else:
        axis.set_ylim(0.0, None)


def _about_its_shape(axis: Axes, profile: Profile) -> None:
    """Limits that show the shape where the band of all errors would make a line of it."""
    low = float(np.nanmin(profile.height - profile.sigma_local))
    high = float(np.nanmax(profile.height + profile.sigma_local))
    usual = float(np.nanmedian(profile.sigma))
    if usual > _BEYOND * (high - low):
        margin = 0.15 * (high - low)
        axis.set_ylim(low - margin, high + margin)
        axis.annotate(
            f"all heights together: one sigma {usual:.2g} m, beyond the picture", (0.99, 0.03),
            xycoords="axes fraction", ha="right", fontsize=8, color="#336688",
        )  # fmt: skip
