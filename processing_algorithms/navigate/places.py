"""Fixes of a flight: of its GNSS log, else of noted events, else of the photos' own tags."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from georef_gis.model.logs import EventLog, FlightLogs, GnssLog
    from georef_gis.project import Project

# fixes that make a trajectory
FEWEST = 3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Places:
    """Fixes, whether they are of the camera itself, and where they come from, in words."""

    gnss: GnssLog
    of_camera: bool
    note: str
    # whether each is that of an exposure, which no smoothing may move
    of_exposures: bool = False


def find_places(project: Project, logs: FlightLogs) -> Places | None:
    """Fixes to navigate by; None where nothing holds any."""
    if logs.gnss is not None and len(logs.gnss) > 0:
        return Places(gnss=logs.gnss, of_camera=False, note="")
    for events in logs.events:
        found = _of_events(events)
        if found is not None:
            return Places(
                gnss=found,
                of_camera=events.position_of == "camera",
                note=f"no GNSS log: the places of {len(found)} noted exposures are the fixes",
                of_exposures=True,
            )
    tags = _of_tags(project)
    if tags is None:
        return None
    note = f"no GNSS log: the tagged places of {len(tags)} photos are the fixes"
    return Places(gnss=tags, of_camera=False, note=note)


def _of_events(events: EventLog) -> GnssLog | None:
    """Places that a device noted beside its exposures, such as an RTK drone's."""
    import numpy as np

    from georef_gis.model.logs import FIX_FIXED, GnssLog, unknown

    good = np.isfinite(events.lat) & np.isfinite(events.height) & np.isfinite(events.time)
    order = np.flatnonzero(good)[np.argsort(events.time[good], kind="stable")]
    if len(order) < FEWEST:
        return None
    n = len(order)
    return GnssLog(
        time=events.time[order], scale=events.scale, source=events.source,
        lat=events.lat[order], lon=events.lon[order], height=events.height[order],
        height_kind=events.height_kind, geoid_separation=unknown(n), v_ned=unknown(n, 3),
        covariance_ned=events.covariance_ned[order], covariance_v_ned=unknown(n, 3, 3),
        fix=np.full(n, FIX_FIXED), satellites=np.full(n, -1),
    )  # fmt: skip


def _of_tags(project: Project) -> GnssLog | None:
    """Places of the photos whose time is known."""
    import numpy as np

    from georef_gis.geodesy import HeightKind
    from georef_gis.model.logs import FIX_SINGLE, GnssLog, covariance_of_sigmas, unknown

    rows = _timed_tags(project)
    if len(rows) < FEWEST:
        return None
    table = np.array(sorted(set(rows)))
    # two photos of one fix are one
    single = np.concatenate([[True], np.diff(table[:, 0]) > 0.01])
    table = table[single]
    n = len(table)
    covariance = unknown(n, 3, 3)
    gnss = project.settings.gnss
    if gnss.sigma_h_m is not None:
        sigma_v = gnss.sigma_v_m or 1.5 * gnss.sigma_h_m
        sigma = np.tile([gnss.sigma_h_m, gnss.sigma_h_m, sigma_v], (n, 1))
        covariance = covariance_of_sigmas(sigma)
    return GnssLog(
        time=table[:, 0], source="tags of the photos", lat=table[:, 1], lon=table[:, 2],
        height=table[:, 3], height_kind=HeightKind.ELLIPSOIDAL, geoid_separation=unknown(n),
        v_ned=unknown(n, 3), covariance_ned=covariance, covariance_v_ned=unknown(n, 3, 3),
        fix=np.full(n, FIX_SINGLE), satellites=np.full(n, -1),
    )  # fmt: skip


def _timed_tags(project: Project) -> list[tuple[float, float, float, float]]:
    """(GPS time s, lat, lon rad, ellipsoidal height m) of the photos that have them."""
    from georef_gis.geodesy import HeightKind, geoid_undulation
    from georef_gis.navigate.clock_fit import clock_seconds
    from georef_gis.project.records import load_frame, photo_of

    database, out = project.database, []
    epoch = database.meta("epoch") or 0.0
    offset = project.settings.logs.camera_clock_offset_s
    gnss = project.settings.gnss
    stated = gnss.height_kind
    frame = load_frame(database)
    for row in database.rows("photo"):
        photo = photo_of(row)
        before = (row["tags"] or {}).get("tag_time")
        time = before["time_gps"] if before is not None else photo.time_gps
        if time is not None:
            time += epoch
        elif offset is not None and photo.camera_clock is not None:
            time = clock_seconds(photo.camera_clock) - offset + 0.5 * photo.clock_resolution_s
        tag = photo.geotag
        if time is None or tag is None:
            continue
        height = frame.origin.height_ellipsoidal
        if tag.height is not None:
            kind = tag.height.kind if stated == "auto" else HeightKind(stated)
            height = tag.height.value
            if kind in (HeightKind.ORTHOMETRIC, HeightKind.UNKNOWN):
                height += float(
                    geoid_undulation(tag.lat, tag.lon, geoid=project.settings.gnss.geoid)
                )
        if math.isfinite(height):
            out.append((float(time), tag.lat, tag.lon, height))
    return out


def middle_of_logs(logs: FlightLogs) -> tuple[float, float, float] | None:
    """Median lat, lon (rad) and height (m, of whatever kind) of the logs; None where none is."""
    import numpy as np

    for log in (logs.gnss, logs.trajectory, *logs.events):
        if log is None:
            continue
        places = np.stack([log.lat, log.lon, log.height], axis=-1)
        places = places[np.isfinite(places).all(axis=1)]
        if len(places):
            lat, lon, height = np.median(places, axis=0)
            return float(lat), float(lon), float(height)
    return None
