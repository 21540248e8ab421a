"""Times of the photos of a flight: events, clocks and tagged positions brought together."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from georef_gis.frames import Array
    from georef_gis.model.photo import Photo
    from georef_gis.model.trajectory import Trajectory
    from georef_gis.navigate.clock_fit import ClockFit
    from georef_gis.navigate.exposures import ExposureTimes, MatchOptions, PhotoClock
    from processing_algorithms.navigate.orient import _Work

# s; the track is looked up on this grid
GRID = 0.25
# m, one sigma of a tagged position where the tag states none
SIGMA_TAG = 3.0


@dataclass(slots=True)
class Said:
    """What was found, and what is doubtful, in words."""

    notes: list[str] = field(default_factory=list)
    doubts: list[str] = field(default_factory=list)


def match_flight(work: _Work, photos: Sequence[Photo]) -> tuple[ExposureTimes, Said]:
    """Exposure times of a flight's photos.

    Raises
    ------
    InputError
        If neither events, nor tags, nor positions tell of the times.
    """
    import numpy as np

    from georef_gis.navigate.exposures import match_exposures
    from georef_gis.navigate.tag_evidence import with_tagged_places

    said = Said()
    clocks = [_clock(photo, work.epoch) for photo in photos]
    track = _track(work)
    clock = _position_clock(work, photos, clocks, track, said)
    found = match_exposures(clocks, work.events, _options(work), clock=clock)
    found = with_tagged_places(
        found,
        np.empty(0) if work.events is None else work.events.time,
        np.array([_tagged(work, photo) for photo in photos]),
        np.array([_tag_sigma(photo) for photo in photos]),
        track,
    )
    said.doubts += [*found.doubts, *found.alternatives]
    _tell(work, photos, found, said)
    return found, said


def _clock(photo: Photo, epoch: float) -> PhotoClock:
    from georef_gis.navigate.clock_fit import clock_seconds
    from georef_gis.navigate.exposures import PhotoClock, file_number

    return PhotoClock(
        name=photo.path.name,
        clock=None if photo.camera_clock is None else clock_seconds(photo.camera_clock),
        resolution=photo.clock_resolution_s,
        time_gps=None if photo.time_gps is None else photo.time_gps + epoch,
        time_sigma=photo.time_sigma,
        number=file_number(photo.path.name),
    )


def _options(work: _Work) -> MatchOptions:
    from georef_gis.navigate.exposures import MatchOptions

    logs = work.project.settings.logs
    return MatchOptions(
        offset=logs.camera_clock_offset_s,
        offset_sigma=logs.sigma_camera_clock_s,
        lag=logs.shutter_lag_s,
    )


def _track(work: _Work) -> Callable[[Array], tuple[Array, Array]]:
    """Position (east, north) and velocity of the vehicle at times; NaN outside of the log."""
    import numpy as np

    first, last = work.trajectory.span
    grid = np.arange(first, last, GRID)
    grid = np.array([t for t in grid if not work.trajectory.why_not(float(t))])
    p = work.frame.origin.enu_from_geo(_positions(work.trajectory, grid))[:, :2]
    v = np.gradient(p, grid, axis=0)

    def track(times: Array) -> tuple[Array, Array]:
        near = np.clip(np.searchsorted(grid, times), 1, len(grid) - 1)
        outside = (times < first) | (times > last) | (grid[near] - grid[near - 1] > 4 * GRID)
        values = [np.interp(times, grid, column) for column in (*p.T, *v.T)]
        out = np.where(outside, np.nan, np.stack(values))
        return out[:2].T, out[2:].T

    return track


def _positions(trajectory: Trajectory, times: Array) -> Array:
    """(lat, lon, h) at times, without the covariance where that is dear; (n, 3)."""
    quick = getattr(trajectory, "states", None)
    if quick is not None:
        return quick(times)[0][:, :3]  # type: ignore[no-any-return]
    return trajectory.at(times).p_geo


def _position_clock(
    work: _Work,
    photos: Sequence[Photo],
    clocks: Sequence[PhotoClock],
    track: Callable[[Array], tuple[Array, Array]],
    said: Said,
) -> ClockFit | None:
    """Offset of the camera's clock by the tagged positions, where nothing better tells it."""
    import numpy as np

    from georef_gis.errors import NavigationError
    from georef_gis.navigate.position_clock import (
        TaggedPositions,
        clock_from_positions,
        middle_of_reading,
    )
    from georef_gis.navigate.tag_evidence import TAG_AGE

    stated = work.project.settings.logs.camera_clock_offset_s is not None
    timed = sum(c.time_gps is not None for c in clocks)
    if stated or timed >= max(3, len(clocks) // 2):
        return None
    readings = np.array([math.nan if c.clock is None else c.clock for c in clocks])
    resolution = np.array([c.resolution for c in clocks])
    place = np.array([_tagged(work, photo) for photo in photos])
    sigma = np.array([_tag_sigma(photo) for photo in photos])
    first, last = work.trajectory.span
    try:
        clock = clock_from_positions(
            TaggedPositions(
                clock=middle_of_reading(readings, resolution), resolution=resolution,
                position=place, sigma=sigma,
            ),
            track, first, last,
        )  # fmt: skip
        aged = clock.covariance + np.diag([TAG_AGE**2, 0.0])
        return replace(clock, covariance=aged)
    except NavigationError as error:
        said.doubts.append(f"the camera's clock cannot be found by the tagged positions: {error}")
        return None


def _tagged(work: _Work, photo: Photo) -> list[float]:
    """East and north of a tag, m; NaN without one."""
    if photo.geotag is None:
        return [math.nan, math.nan]
    height = work.frame.origin.height_ellipsoidal
    p = work.frame.origin.enu_from_geo([photo.geotag.lat, photo.geotag.lon, height])
    return [float(p[0]), float(p[1])]


def _tag_sigma(photo: Photo) -> float:
    tag = photo.geotag
    return tag.sigma_h if tag is not None and tag.sigma_h else SIGMA_TAG


def _tell(work: _Work, photos: Sequence[Photo], found: ExposureTimes, said: Said) -> None:
    """Notes for people, and the columns of table `flight`."""
    columns: dict[str, Any] = {"start_gps": work.trajectory.span[0] - work.epoch,
                               "end_gps": work.trajectory.span[1] - work.epoch}  # fmt: skip
    matched = sum(index >= 0 for index in found.event)
    if work.events is not None:
        said.notes.append(
            f"{matched} of {len(photos)} photos matched to {len(work.events)} {_kind(work)} "
            f"events; "
            f"{len(found.missed)} photos without event, {len(found.spurious)} events without photo"
        )
    if found.clock is not None:
        clock = found.clock
        columns |= {
            "clock_offset_s": clock.offset,
            "clock_drift": clock.drift,
            "clock_sigma_s": clock.sigma,
        }
        said.notes.append(
            f"camera clock less GPS time: {clock.offset:.2f} +- {clock.sigma:.2f} s "
            f"({clock.source})"
        )
    work.flights_found[photos[0].flight_id] = columns


def _kind(work: _Work) -> str:
    return "" if work.events is None else work.events.kind.replace("_", " ")
