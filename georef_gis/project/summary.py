"""What a project has come to, in one row: for tables of many sites."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from georef_gis.frames import Array
    from georef_gis.project.project import Project

DONE = "done"
# Figures of a site and the keys under which the tools of `georef run` tell them; a later run goes
# before an earlier one.
_FIGURES = (
    "gsd_m", "covered_m2", "sigma_horizontal_m", "rmse_h_m", "rmse_v_m",
    "check_points_h", "check_points_v",
)  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SiteSummary:
    """Figures of a project as its records tell them; None = not known.

    Parameters
    ----------
    photos, posed
        Photos that were read, and those of them that have a footprint.
    sigma_horizontal_m
        One sigma per axis of a photo's place, median.
    rmse_h_m, rmse_v_m
        At check points, radial and vertical, with their number.
    doubts
        What the last runs of its tools doubt, each once.
    finished
        When the last of those runs ended, UTC, ISO 8601.
    outline_deg : shape (n, 2)
        Convex hull of the footprints, closed; longitude and latitude in degrees.
    """

    photos: int | None = None
    posed: int | None = None
    crs: str = ""
    gsd_m: float | None = None
    covered_m2: float | None = None
    sigma_horizontal_m: float | None = None
    rmse_h_m: float | None = None
    rmse_v_m: float | None = None
    check_points_h: int | None = None
    check_points_v: int | None = None
    doubts: tuple[str, ...] = ()
    finished: str = ""
    outline_deg: Array | None = None

    @property
    def accuracy(self) -> str:
        """Tested accuracy if there is one, else the expected one, in words."""
        tested = [
            f"RMSE {axis} {value:.3f} m at {count} check points"
            for axis, value, count in (
                ("H", self.rmse_h_m, self.check_points_h),
                ("V", self.rmse_v_m, self.check_points_v),
            )
            if value is not None and count
        ]
        if tested:
            return "tested: " + ", ".join(tested)
        if self.sigma_horizontal_m is None:
            return ""
        return f"expected: {self.sigma_horizontal_m:.3f} m (one sigma per axis), not tested"


def summarise(project: Project, tools: Iterable[str] = ()) -> SiteSummary:
    """Figures of a project.

    Parameters
    ----------
    tools
        Full ids of the tools whose doubts count; those of all where none is named.

    Raises
    ------
    InputError
        If its database cannot be read.
    """
    database = project.database
    runs = sorted(database.last_rows("run", "tool"), key=lambda row: int(row["fid"]))
    wanted = set(tools)
    counted = [row for row in runs if not wanted or row["tool"] in wanted]
    done = [row for row in counted if row["outcome"] == DONE]
    figures: dict[str, Any] = {}
    for row in done:
        summary = row["summary"] or {}
        figures |= {key: summary[key] for key in _FIGURES if summary.get(key) is not None}
    photos = database.count("photo")
    prints = [row for row in database.rows("footprint") if row["geom"] is not None]
    return SiteSummary(
        photos=photos or None,
        posed=len(prints) if photos else None,
        crs=next((str(s["crs"]) for row in done if (s := row["summary"] or {}).get("crs")), ""),
        doubts=tuple(dict.fromkeys(_doubts(done))),
        finished=max((_end(row) for row in done), default=""),
        outline_deg=_outline(project, prints),
        **figures,
    )


def _doubts(runs: Iterable[Mapping[str, Any]]) -> Iterable[str]:
    for row in runs:
        yield from (row["summary"] or {}).get("doubts", ())


def _end(row: Mapping[str, Any]) -> str:
    try:
        begun = datetime.fromisoformat(row["started"])
    except (TypeError, ValueError):
        return ""
    ended = begun + timedelta(seconds=float(row["duration_s"] or 0.0))
    return ended.isoformat(" ", "seconds")


def _outline(project: Project, prints: Iterable[Mapping[str, Any]]) -> Array | None:
    """Convex hull of the footprints; None without any, or without a frame to place them."""
    import numpy as np
    import shapely

    from georef_gis.errors import GeorefError
    from georef_gis.project.records import load_frame

    shapes = shapely.from_wkb([row["geom"] for row in prints])
    hull = shapely.convex_hull(shapely.union_all(shapely.convex_hull(shapes)))
    if hull.geom_type != "Polygon" or hull.is_empty:
        return None
    try:
        frame = load_frame(project.database)
    except (GeorefError, json.JSONDecodeError):
        return None
    ring = shapely.get_coordinates(hull)
    lat, lon, _ = frame.geo_from_map(np.column_stack([ring, np.zeros(len(ring))])).T
    outline: Array = np.degrees(np.column_stack([lon, lat]))
    return outline if np.isfinite(outline).all() else None
