"""What `orient_navigation` starts from: photos in order, the events, the variance of a time."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any
from weakref import WeakKeyDictionary

if TYPE_CHECKING:
    from georef_gis.frames import Array
    from georef_gis.model.logs import EventLog, FlightLogs
    from georef_gis.model.photo import Photo
    from georef_gis.navigate.exposures import ExposureTimes
    from georef_gis.project import Project

# a photo whose event is less likely than this has a sigma that covers the neighbouring event
LIKELY = 0.95
# of several kinds of events the first that there is
EVENT_KINDS = ("sync_board", "feedback", "trigger")
# events of the last reading of a project's logs, and what it depended on
_KEPT: WeakKeyDictionary[Project, tuple[tuple[Any, ...], tuple[tuple[EventLog, ...], str]]] = (
    WeakKeyDictionary()
)


def with_tag_time(photo: Photo, row: Mapping[str, Any]) -> Photo:
    """Photo with the time of its own tags, whatever an earlier run found."""
    before = (row["tags"] or {}).get("tag_time")
    if before is None:
        return photo
    return replace(
        photo,
        time_gps=before["time_gps"],
        time_sigma=before["time_sigma_s"],
        time_source=before["time_source"] or "",
        match_confidence=None,
    )


def order_of_exposure(photo: Photo) -> tuple[Any, ...]:
    """Key to sort the photos of a flight by."""
    from datetime import datetime

    from georef_gis.navigate.exposures import file_number

    return (
        photo.camera_clock or datetime.max,
        photo.time_gps if photo.time_gps is not None else math.inf,
        file_number(photo.path.name) or 0,
        photo.id,
    )


def time_variance(found: ExposureTimes, order: Sequence[int]) -> Array:
    """Variance of the exposure times, s^2, in order of time; a doubtful match may be one off.

    A match that is nearly sure keeps its own sigma: a chance of one in a hundred of a gross error
    belongs into its confidence, not into a sigma that would hide how good the others are.
    """
    import numpy as np

    chosen = list(order)
    steps = np.diff(found.time[chosen])
    usual = float(np.median(steps)) if len(steps) else 1.0
    # an event may be its neighbour's, across a turn too; a clock is off by less than an interval
    widest = np.maximum(np.append(steps, usual), np.insert(steps, 0, usual))
    interval = np.where(found.event[chosen] >= 0, widest, usual)
    confidence = found.confidence[chosen]
    doubt = np.where(confidence < LIKELY, 1.0 - confidence, 0.0)
    return np.asarray(found.sigma[chosen] ** 2 + doubt * interval**2)


def events_to_match(project: Project, photos: int) -> EventLog | None:
    """The events to match: of the file that [logs] sync names, else the best kind there is."""
    noted, scale = _noted_events(project)
    # a device that counts from its own start cannot be laid on a trajectory of GPS time
    candidates = [e for e in noted if len(e) > 0 and e.scale == scale]
    named = project.settings.logs.sync
    if named is not None:
        path = str(project.path(named))
        own = [events for events in candidates if events.source.startswith(path)]
        candidates = own or candidates
    if not candidates:
        return None
    return min(
        candidates,
        key=lambda e: (
            EVENT_KINDS.index(e.kind) if e.kind in EVENT_KINDS else len(EVENT_KINDS),
            abs(len(e) - photos),
        ),
    )


def keep_events(project: Project, maps: Sequence[str], logs: FlightLogs) -> None:
    """Keep the events of a reading, which is long, for the next tool of the same run."""
    clocks = [log.scale for log in (logs.gnss, logs.imu, logs.trajectory) if log is not None]
    scale = clocks[0] if clocks else "gps"
    _KEPT[project] = (_state(project, maps), (logs.events, scale))


def _noted_events(project: Project) -> tuple[tuple[EventLog, ...], str]:
    """All events, and the time scale of the other logs."""
    from processing_algorithms.navigate.flight import MAPS, read_project_logs

    maps = project.database.meta(MAPS) or ()
    if project not in _KEPT or _KEPT[project][0] != _state(project, maps):
        keep_events(project, maps, read_project_logs(project, maps))
    return _KEPT[project][1]


def _state(project: Project, maps: Sequence[str]) -> tuple[Any, ...]:
    """What a reading of the logs depends on: settings, columns, and the files as they are."""
    from processing_algorithms.navigate.flight import log_files

    files = [(path, path.stat()) for path in log_files(project) if path.exists()]
    return (
        project.settings.logs.model_dump_json(),
        tuple(maps),
        tuple((path, stat.st_size, stat.st_mtime_ns) for path, stat in files),
    )
