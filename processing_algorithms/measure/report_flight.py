"""The flight for the report page: trajectory, filter and fixes, else the poses of the photos."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from georef_gis.frames import Array
    from georef_gis.measure.report.facts import Facts
    from georef_gis.measure.report.flight_facts import FixDifferences, Flown
    from georef_gis.model.logs import FlightLogs, TrajectoryLog
    from georef_gis.project import Project
    from processing_algorithms.navigate.places import Places

# bytes of logs beyond which they are not read a second time for a picture
LARGEST_LOGS = 300_000_000
# s; a smaller delay cannot be told from none, a longer one is a wrong clock
LEAST_DELAY, LONGEST_DELAY = 0.005, 3.0


def flown(project: Project, facts: Facts, *, quick: bool = False) -> Flown | None:
    """Flight of a project; None where no photo has a pose."""
    from georef_gis.errors import GeorefError
    from georef_gis.ingest.logs.trajectory_table import read_trajectory_table
    from georef_gis.measure.report.flight_facts import flight_of_photos
    from processing_algorithms.navigate.flight import TABLE

    table = project.navigation / TABLE
    if quick or not table.is_file():
        return flight_of_photos(facts)
    try:
        log = read_trajectory_table(table)
    except GeorefError as error:
        return flight_of_photos(facts, [f"the trajectory cannot be read: {error}"])
    if len(log) < 2:
        return flight_of_photos(facts, ["the trajectory has no rows"])
    return _of_trajectory(project, facts, log)


def _of_trajectory(project: Project, facts: Facts, log: TrajectoryLog) -> Flown:
    from georef_gis.measure.report.flight_facts import Flown

    notes: list[str] = []
    filtered = _filtered(project, notes)
    raw, fixes = _fixes(project, log, notes)
    series = {"raw fixes": raw, "filter": filtered, "smoothed": log}
    on, times = _exposures(project, facts)
    run = facts.run_of("navigate")
    kind = str(((run or {}).get("summary") or {}).get("logs") or "navigation/trajectory.csv")
    return Flown(
        log=replace(log, source=f"trajectory from the logs ({kind})"),
        of_photos=False,
        exposures=times,
        outside=tuple(str(p["photo_id"]) for p in facts.photos if p["photo_id"] not in on),
        series={name: one for name, one in series.items() if one is not None},
        fixes=fixes,
        notes=tuple(notes),
    )


def _exposures(project: Project, facts: Facts) -> tuple[set[str], Array]:
    """Photos whose pose is the trajectory's, and their times, s on the GPS scale."""
    import numpy as np

    epoch = float(project.database.meta("epoch") or 0.0)
    rows = project.database.rows("pose", {"kind": "navigation"})
    timed = {
        row["photo_id"]: row["time_gps"] + epoch for row in rows if row["time_gps"] is not None
    }
    return set(timed), np.array(sorted(timed.values()), dtype=np.float64)


# -- filter ------------------------------------------------------------------------------------


def _filtered(project: Project, notes: list[str]) -> TrajectoryLog | None:
    """Path of the filter before it was smoothed; of the other kinds of trajectory none is kept."""
    from georef_gis.errors import GeorefError
    from georef_gis.frames import rpy_from_R_ned_from_body
    from georef_gis.model.logs import TrajectoryLog, unknown
    from georef_gis.navigate.trajectory import InertialTrajectory
    from processing_algorithms.navigate.flight import load_trajectory

    try:
        found = load_trajectory(project)
    except GeorefError as error:
        notes.append(f"the filter's path is not shown: {error}")
        return None
    if not isinstance(found, InertialTrajectory):
        return None
    nav = found.post_nav
    return TrajectoryLog(
        time=found.nodes, source="filter", lat=nav[:, 0], lon=nav[:, 1], height=nav[:, 2],
        v_ned=nav[:, 3:6], rpy=rpy_from_R_ned_from_body(nav[:, 6:].reshape(-1, 3, 3)),
        covariance=unknown(len(nav), 6, 6),
    )  # fmt: skip


# -- fixes -------------------------------------------------------------------------------------


def _fixes(
    project: Project, log: TrajectoryLog, notes: list[str]
) -> tuple[TrajectoryLog | None, FixDifferences | None]:
    """Raw fixes as rows of the IMU, and how they differ from the smoothed path."""
    from georef_gis.errors import GeorefError
    from georef_gis.navigate.resample import in_order, trajectory_of_gnss

    try:
        places = _places(project, notes)
        if places is None:
            return None, None
        raw = in_order(trajectory_of_gnss(places.gnss))
        return _apart(project, raw, log, of_camera=places.of_camera)
    except (GeorefError, OSError) as error:
        notes.append(f"the fixes are not shown: {error}")
        return None, None


def _places(project: Project, notes: list[str]) -> Places | None:
    from processing_algorithms.navigate.flight import MAPS, log_files, read_project_logs
    from processing_algorithms.navigate.places import find_places

    files = [path for path in log_files(project) if path.is_file()]
    size = sum(path.stat().st_size for path in files)
    if size > LARGEST_LOGS:
        notes.append(
            f"the logs have {size / 1e6:.0f} MB, too much to read them again for the fixes; "
            "`georef navigate --plots` draws them"
        )
        return None
    logs: FlightLogs = read_project_logs(project, project.database.meta(MAPS) or ())
    return find_places(project, logs)


def _apart(
    project: Project, raw: TrajectoryLog, log: TrajectoryLog, *, of_camera: bool
) -> tuple[TrajectoryLog, FixDifferences | None]:
    import numpy as np

    from georef_gis.measure.report.flight_facts import FixDifferences
    from georef_gis.model.trajectory_values import places_apart, sigma_position_of
    from georef_gis.navigate.resample import at_times, rows
    from georef_gis.navigate.table_trajectory import of_imu

    mount = project.settings.mount
    arms = np.array(mount.lever_arm_antenna_m), np.array(mount.lever_arm_camera_m)

    def carried(delay: float) -> tuple[TrajectoryLog, TrajectoryLog]:
        """Fixes at the IMU and the path there, if fixes are late by so much."""
        times = raw.time - delay
        inside = rows(raw, (times >= log.time[0]) & (times <= log.time[-1]))
        path = at_times(log, inside.time - delay)
        at = "camera" if of_camera else "antenna"
        return of_imu(replace(inside, rpy=path.rpy, position_of=at), *arms), path

    delay = 0.0
    fixes, path = carried(delay)
    if len(fixes) < 2:
        return raw, None
    apart = places_apart(fixes, path)
    delay = _delay(apart, path.v_ned)
    if delay:
        fixes, path = carried(delay)
        apart = places_apart(fixes, path)
    known = np.isfinite(apart).all(axis=1)
    sigma = sigma_position_of(fixes)
    return raw, FixDifferences(
        time=fixes.time[known], apart=apart[known], sigma=sigma[known], delay=delay
    )


def _delay(apart: Array, v_ned: Array) -> float:
    """By how much fixes are late, s: their lag along the way; 0 where none is sure."""
    import numpy as np

    speed = np.einsum("ij,ij->i", v_ned, v_ned)
    moving = (speed > 4.0) & np.isfinite(apart).all(axis=1)
    if np.count_nonzero(moving) < 20:
        return 0.0
    each = -np.einsum("ij,ij->i", apart[moving], v_ned[moving]) / speed[moving]
    middle = float(np.median(each))
    spread = 1.4826 * float(np.median(np.abs(each - middle)))
    # neighbouring fixes err alike: some twenty of them count as one
    sure = abs(middle) > 3.0 * spread / np.sqrt(max(len(each) / 20.0, 1.0))
    return middle if sure and LEAST_DELAY < abs(middle) < LONGEST_DELAY else 0.0
