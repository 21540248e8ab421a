"""Times of the photos of a flight: events, clocks and tagged positions brought together."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from georef_gis.frames import Array
    from georef_gis.geodesy import MapFrame
    from georef_gis.model.logs import EventLog
    from georef_gis.model.photo import Photo
    from georef_gis.model.trajectory import Trajectory
    from georef_gis.navigate.clock_fit import ClockFit
    from georef_gis.navigate.exposures import ExposureTimes, MatchOptions, PhotoClock
    from georef_gis.project.sections import LogsSection

# s; the track is looked up on this grid
GRID = 0.25
# s; no time zone and no carelessness puts a clock that was set farther off
LONGEST_ZONE = 1.5 * 86400.0
# an offset less sure than this is a guess
GUESS = 0.5
# s; self-timers and slow autofocus included, no camera takes longer from trigger to exposure
LONGEST_LAG = 10.0
# m, one sigma of a tagged position where the tag states none
SIGMA_TAG = 3.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scene:
    """What photos are matched against.

    Parameters
    ----------
    epoch : s
        GPS time that the photos' times count from.
    events
        Noted exposures; None where there are none.
    """

    settings: LogsSection
    frame: MapFrame
    trajectory: Trajectory
    epoch: float
    events: EventLog | None


@dataclass(slots=True)
class Said:
    """What was found, and what is doubtful, in words."""

    notes: list[str] = field(default_factory=list)
    doubts: list[str] = field(default_factory=list)
    # columns of table `flight`
    flight: dict[str, Any] = field(default_factory=dict)


def match_flight(scene: Scene, photos: Sequence[Photo]) -> tuple[ExposureTimes, Said]:
    """Exposure times of a flight's photos.

    Raises
    ------
    InputError
        If neither events, nor tags, nor positions tell of the times, or a setting is out of range.
    """
    import numpy as np

    from georef_gis.navigate.exposures import match_exposures
    from georef_gis.navigate.tag_evidence import with_tagged_places

    said = Said()
    clocks = [_clock(photo, scene.epoch) for photo in photos]
    track = _track(scene)
    clock = _position_clock(scene, photos, clocks, track, said)
    found = match_exposures(clocks, scene.events, _options(scene), clock=clock)
    found = with_tagged_places(
        found,
        np.empty(0) if scene.events is None else scene.events.time,
        np.array([_tagged(scene, photo) for photo in photos]),
        np.array([_tag_sigma(photo) for photo in photos]),
        track,
    )
    found = _no_surer_than_the_clock(found)
    said.doubts += [*found.doubts, *found.alternatives]
    _tell(scene, photos, found, said)
    return found, said


def _no_surer_than_the_clock(found: ExposureTimes) -> ExposureTimes:
    """Times by the clock alone, with a confidence that is at most that of the clock's offset.

    The offset is as sure as the events that it was found by, which tagged places make surer.
    """
    import numpy as np

    if found.clock is None:
        return found
    by_clock = np.array([source == "clock" for source in found.source])
    matched = found.confidence[found.event >= 0]
    offset = max(found.clock.confidence, float(np.median(matched)) if len(matched) else 0.0)
    # what a photo without event is sure of is that it has none: that says nothing of its time
    most = np.where(by_clock & (offset < GUESS), offset, 1.0)
    return replace(found, confidence=np.minimum(found.confidence, most))


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


def _options(scene: Scene) -> MatchOptions:
    from georef_gis.errors import InputError
    from georef_gis.navigate.exposures import MatchOptions

    logs = scene.settings
    if not abs(logs.shutter_lag_s) <= LONGEST_LAG:
        raise InputError(
            f"{logs.shutter_lag_s:g} s is longer than any shutter takes ({LONGEST_LAG:g} s); give "
            "seconds from the noted event to the exposure",
            source="project.toml",
            field="logs.shutter_lag_s",
        )
    return MatchOptions(
        offset=logs.camera_clock_offset_s,
        offset_sigma=logs.sigma_camera_clock_s,
        lag=logs.shutter_lag_s,
    )


def _track(scene: Scene) -> Callable[[Array], tuple[Array, Array]]:
    """Position (east, north) and velocity of the vehicle at times; NaN outside of the log."""
    import numpy as np

    first, last = scene.trajectory.span
    grid = np.arange(first, last, GRID)
    grid = np.array([t for t in grid if not scene.trajectory.why_not(float(t))])
    p = scene.frame.origin.enu_from_geo(_positions(scene.trajectory, grid))[:, :2]
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
    scene: Scene,
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

    stated = scene.settings.camera_clock_offset_s is not None
    timed = sum(c.time_gps is not None for c in clocks)
    placed = any(photo.geotag is not None for photo in photos)
    if stated or not placed or timed >= max(3, len(clocks) // 2):
        return None
    readings = np.array([math.nan if c.clock is None else c.clock for c in clocks])
    resolution = np.array([c.resolution for c in clocks])
    place = np.array([_tagged(scene, photo) for photo in photos])
    sigma = np.array([_tag_sigma(photo) for photo in photos])
    first, last = scene.trajectory.span
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


def _tagged(scene: Scene, photo: Photo) -> list[float]:
    """East and north of a tag, m; NaN without one."""
    if photo.geotag is None:
        return [math.nan, math.nan]
    height = scene.frame.origin.height_ellipsoidal
    p = scene.frame.origin.enu_from_geo([photo.geotag.lat, photo.geotag.lon, height])
    return [float(p[0]), float(p[1])]


def _tag_sigma(photo: Photo) -> float:
    tag = photo.geotag
    return tag.sigma_h if tag is not None and tag.sigma_h else SIGMA_TAG


def _tell(scene: Scene, photos: Sequence[Photo], found: ExposureTimes, said: Said) -> None:
    """Notes for people, and the columns of table `flight`."""
    columns: dict[str, Any] = {"start_gps": scene.trajectory.span[0] - scene.epoch,
                               "end_gps": scene.trajectory.span[1] - scene.epoch}  # fmt: skip
    matched = sum(index >= 0 for index in found.event)
    if scene.events is not None:
        said.notes.append(
            f"{matched} of {len(photos)} photos matched to {len(scene.events)} {_kind(scene)} "
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
            f"camera clock less UTC: {clock.offset:.2f} +- {clock.sigma:.2f} s ({clock.source})"
        )
        if abs(clock.offset) > LONGEST_ZONE:
            said.doubts.append(
                f"the camera's clock is {abs(clock.offset) / 86400.0:.1f} days "
                f"{'ahead of' if clock.offset > 0 else 'behind'} the logs: it was never set, or "
                "the logs are of another flight over the same ground"
            )
    said.flight = columns


def _kind(scene: Scene) -> str:
    return "" if scene.events is None else scene.events.kind.replace("_", " ")
