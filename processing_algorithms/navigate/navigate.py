"""Tool `navigate`: from the logs of a flight to its trajectory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from georef_gis.errors import Cancelled, GeorefError
from georef_gis.toolbox import Algorithm, Context, Feedback, Output, Result
from georef_gis.toolbox import parameters as p

if TYPE_CHECKING:
    from georef_gis.frames import Array
    from georef_gis.model.logs import FlightLogs, TrajectoryLog
    from georef_gis.model.trajectory import Trajectory
    from georef_gis.navigate.alignment import Alignment
    from georef_gis.navigate.gnss_noise import Fixes
    from georef_gis.navigate.trajectory import InertialTrajectory
    from georef_gis.project import Project
    from processing_algorithms.navigate.places import Places


# deg, one sigma of an autopilot's heading
HEADING_OF_LOG = 10.0


class NavigateParameters(p.Parameters):
    """Parameters of `navigate`."""

    map: tuple[p.Text, ...] = p.text(
        (),
        title="Column of a text log, such as 'gyro_x=GyroX:deg/s'; give it once per column",
        help="see docs/logs.md",
    )
    strict: p.Flag = p.flag(
        False,
        title="Fail where a log cannot be used",
        help="otherwise the photos keep the poses of their tags, and a warning says why",
    )
    plots: p.Flag = p.flag(
        False, title="Write pictures of attitude, position and innovations to navigation/plots"
    )


class Navigate(Algorithm[NavigateParameters]):
    """Trajectory of the flight from its logs.

    IMU and GNSS go through an error-state Kalman filter and a smoother; noise of the IMU and delay
    of the fixes are found in the log itself. GNSS alone, GNSS with an autopilot's attitude, or a
    finished trajectory (SBET) give one too, with sigmas to match. Formats: docs/logs.md.
    """

    id, name, group = "navigate", "Trajectory from the logs", "navigate"
    needs, gives = ("photos",), ("trajectory",)
    outputs = (
        Output(name="trajectory", title="Trajectory (columns of numbers, .npz)"),
        Output(name="table", title="Trajectory at 10 Hz as CSV"),
        Output(name="plots", title="Pictures", type="Folder"),
    )
    in_run = True
    in_quick = False
    uses_settings = ("logs", "imu", "gnss", "mount", "attitude")

    def inputs(self, context: Context, parameters: NavigateParameters) -> Sequence[Path]:
        """The logs."""
        from processing_algorithms.navigate.flight import log_files

        return [path for path in log_files(context.require_project()) if path.exists()]

    def run(self, context: Context, parameters: NavigateParameters, feedback: Feedback) -> Result:
        """Read, filter, smooth."""
        from processing_algorithms.navigate.flight import log_files

        project = context.require_project()
        if not log_files(project):
            _forget(project)
            return Result(summary={})
        try:
            outputs, summary = _navigate(project, parameters, feedback)
        except Cancelled:
            raise
        except GeorefError as error:
            _forget(project)
            if parameters.strict:
                raise
            line = f"the logs are not used, poses come from the tags: {error}"
            feedback.warn(line)
            return Result(summary={"doubts": [line]})
        return Result(outputs=outputs, summary=summary)


def _forget(project: Project) -> None:
    """Drop what an earlier run made: its logs are gone or cannot be used."""
    from processing_algorithms.navigate.flight import PLOTS, TABLE, TRAJECTORY
    from processing_algorithms.navigate.pictures import forget_pictures

    for name in (TRAJECTORY, TABLE):
        (project.navigation / name).unlink(missing_ok=True)
    forget_pictures(project.navigation / PLOTS)


def _navigate(
    project: Project, parameters: NavigateParameters, feedback: Feedback
) -> tuple[dict[str, Path], dict[str, Any]]:
    from georef_gis.toolbox.context import check_cancelled
    from processing_algorithms.navigate.exposure_inputs import keep_events
    from processing_algorithms.navigate.flight import MAPS, TRAJECTORY, read_project_logs, words

    feedback.progress(0.05, "reading logs")
    logs = read_project_logs(project, parameters.map, strict=parameters.strict)
    keep_events(project, parameters.map, logs)
    check_cancelled(feedback)
    feedback.progress(0.3, "filtering")
    trajectory, notes = _trajectory(project, logs)
    check_cancelled(feedback)
    project.navigation.mkdir(parents=True, exist_ok=True)
    project.database.set_meta(**{MAPS: list(parameters.map)})
    outputs = {"trajectory": project.navigation / TRAJECTORY}
    trajectory.save(outputs["trajectory"])
    outputs |= _tell(project, trajectory, logs, plots=parameters.plots)
    doubts = words(logs.doubts, trajectory.doubts)
    for doubt in doubts:
        feedback.warn(doubt)
    for note in notes:
        feedback.info(note)
    first, last = trajectory.span
    return outputs, {
        "logs": logs.format,
        "duration_s": round(last - first, 1),
        "start_gps": round(first, 3),
        "notes": list(notes),
        "doubts": doubts,
    }


def _tell(
    project: Project, trajectory: Trajectory, logs: FlightLogs, *, plots: bool
) -> dict[str, Path]:
    """Table for people and other programs, and the pictures where they are asked for."""
    from georef_gis.ingest.logs.trajectory_table import write_trajectory_table
    from processing_algorithms.navigate.flight import PLOTS, TABLE, trajectory_log
    from processing_algorithms.navigate.pictures import forget_pictures, write_pictures

    log = trajectory_log(trajectory)
    table = project.navigation / TABLE
    part = table.with_name(table.name + ".part")
    with part.open("wb") as stream:
        write_trajectory_table(stream, log)
    part.replace(table)
    folder = project.navigation / PLOTS
    # pictures that are there are asked for, too: they would else be those of an older trajectory
    if not (forget_pictures(folder) or plots):
        return {"table": table}
    write_pictures(folder, log, logs, trajectory)
    return {"table": table, "plots": folder}


def _trajectory(project: Project, logs: FlightLogs) -> tuple[Any, tuple[str, ...]]:
    """Trajectory of what the logs hold, and how it was made."""
    from georef_gis.errors import NavigationError
    from processing_algorithms.navigate.places import find_places

    chosen = project.settings.logs.filter
    has_imu = logs.imu is not None and len(logs.imu) > 0
    has_gnss = logs.gnss is not None and len(logs.gnss) > 0
    if logs.trajectory is not None and chosen == "auto" and not (has_imu and has_gnss):
        return _finished(project, logs)
    places = find_places(project, logs)
    if places is None:
        raise NavigationError(
            "neither the logs nor the photos' tags hold fixes with a time; name a GNSS log or PPK "
            "positions in [logs] gnss"
        )
    logs = replace(logs, gnss=places.gnss)
    notes = (places.note,) if places.note else ()
    if chosen == "gnss" or (chosen == "auto" and not has_imu):
        trajectory, said = _kinematic(project, logs, places)
    elif not has_imu:
        raise NavigationError(f'the logs hold no IMU, which [logs] filter = "{chosen}" needs')
    else:
        run = _report_filter if chosen == "ekf9" else _inertial
        trajectory, said = run(project, logs)
    return trajectory, (*notes, *said)


def _finished(project: Project, logs: FlightLogs) -> tuple[Any, tuple[str, ...]]:
    assert logs.trajectory is not None
    return _table(project, logs.trajectory), (f"finished trajectory: {logs.format}",)


def _table(project: Project, log: TrajectoryLog) -> Any:
    """Rows of a trajectory, carried to the IMU."""
    import numpy as np

    from georef_gis.navigate.table_trajectory import TableTrajectory, of_imu

    mount = project.settings.mount
    arms = np.array(mount.lever_arm_antenna_m), np.array(mount.lever_arm_camera_m)
    return TableTrajectory(log=of_imu(log, *arms))


def _inertial(project: Project, logs: FlightLogs) -> tuple[Any, tuple[str, ...]]:
    from georef_gis.navigate.gnss_noise import prepare_fixes
    from georef_gis.navigate.inertial_solution import smooth_flight
    from georef_gis.navigate.tuning import tune
    from processing_algorithms.navigate.flight import navigation_settings

    assert logs.imu is not None
    assert logs.gnss is not None
    gnss, imu = project.settings.gnss, project.settings.imu
    settings = navigation_settings(project)
    fixes = prepare_fixes(
        logs.gnss, slow_sigma=gnss.slow_sigma_m, latency=gnss.latency_s or 0.0, geoid=gnss.geoid
    )
    tuned = tune(logs.imu, fixes, settings, noise=imu.tune, delay=gnss.latency_s is None)
    aids = _aids(project, logs)
    first = _first_attitude(logs, tuned.fixes)
    trajectory = smooth_flight(logs.imu, tuned.fixes, tuned.settings, aids, aligned=first)
    headings = _compass(project, logs, trajectory)
    if headings:
        trajectory = smooth_flight(
            logs.imu, tuned.fixes, tuned.settings, (*aids, *headings), aligned=first
        )
    notes = (*trajectory.notes, *tuned.notes, *_gnss_notes(fixes.slow))
    doubts = (*trajectory.doubts, *tuned.doubts)
    return replace(trajectory, notes=notes, doubts=doubts), notes


def _gnss_notes(slow: Any) -> tuple[str, ...]:
    """How much of the fixes' error no smoothing takes away."""
    if not slow.any():
        return ("the fixes scatter as much as they state: their error is taken as white",)
    return (f"slow error of the fixes that stays: {slow[0]:.2f} m east and north",)


def _aids(project: Project, logs: FlightLogs) -> tuple[Any, ...]:
    """Aids that [imu] use names, but for a magnetic field, which needs roll and pitch first."""
    wanted = set(project.settings.imu.use) - {"magnetic_field"}
    return tuple(aid for aid in logs.aids if aid.kind in wanted)


def _first_attitude(logs: FlightLogs, fixes: Fixes) -> Alignment:
    """Attitude to start from; an autopilot's heading where the flight itself tells none."""
    import math

    import numpy as np

    from georef_gis.navigate.alignment import BY_FORCE, align, with_heading
    from georef_gis.navigate.filter_pass import imu_table

    assert logs.imu is not None
    found = align(imu_table(logs.imu), fixes)
    attitude = logs.attitude
    if found.method == BY_FORCE or attitude is None or len(attitude) == 0:
        return found
    near = int(np.argmin(np.abs(attitude.time - found.time)))
    heading = float(attitude.rpy[near, 2])
    if attitude.scale != logs.imu.scale or abs(attitude.time[near] - found.time) > 1.0:
        return found
    if not math.isfinite(heading):
        return found
    return replace(
        found,
        R_ned_from_body=with_heading(found.R_ned_from_body, heading),
        sigma_heading=math.radians(HEADING_OF_LOG),
        method="heading of the autopilot's log",
    )


def _compass(project: Project, logs: FlightLogs, trajectory: InertialTrajectory) -> list[Any]:
    """Headings of a magnetometer, levelled by the trajectory as far as it is known."""
    import numpy as np

    from georef_gis.frames import rpy_from_R_ned_from_body
    from georef_gis.navigate.compass import headings_from_magnetometer
    from georef_gis.units import utc_from_gps

    fields = [aid for aid in logs.aids if aid.kind == "magnetic_field"]
    if "magnetic_field" not in project.settings.imu.use or not fields:
        return []

    def roll_pitch(times: Array) -> Array:
        out = np.full((len(times), 2), np.nan)
        inside = np.array([not trajectory.why_not(float(t)) for t in times], dtype=bool)
        nav, _ = trajectory.states(times[inside])
        out[inside] = rpy_from_R_ned_from_body(nav[:, 6:].reshape(-1, 3, 3))[:, :2]
        return out

    place = trajectory.nav[len(trajectory.nav) // 2, :3]
    day = utc_from_gps(trajectory.span[0]).date()
    return [headings_from_magnetometer(aid, roll_pitch, place, day) for aid in fields]


def _kinematic(project: Project, logs: FlightLogs, places: Places) -> tuple[Any, tuple[str, ...]]:
    import math

    import numpy as np

    from georef_gis.navigate.attitude_track import AttitudeSettings
    from georef_gis.navigate.gnss_noise import prepare_fixes
    from georef_gis.navigate.kinematic import KinematicSettings
    from georef_gis.navigate.kinematic_solution import smooth_fixes

    assert logs.gnss is not None
    gnss, stated = project.settings.gnss, project.settings.attitude
    fixes = prepare_fixes(
        logs.gnss, slow_sigma=gnss.slow_sigma_m, latency=gnss.latency_s or 0.0, geoid=gnss.geoid
    )
    attitude = AttitudeSettings()
    if stated.sigma_roll_pitch_deg is not None:
        attitude = replace(attitude, sigma_roll_pitch=math.radians(stated.sigma_roll_pitch_deg))
    if stated.sigma_yaw_deg is not None:
        attitude = replace(attitude, sigma_yaw=math.radians(stated.sigma_yaw_deg))
    mount = project.settings.mount
    arm = np.array(mount.lever_arm_camera_m if places.of_camera else mount.lever_arm_antenna_m)
    settings = KinematicSettings(
        attitude=attitude,
        lever_arm_body_antenna=arm,
        slow_tau=gnss.slow_tau_s,
        # what was noted at an exposure is its place, however sharp the turn
        gate=1e-12 if places.of_exposures else 0.001,
    )
    trajectory = smooth_fixes(fixes, logs.attitude, settings)
    return trajectory, trajectory.notes


def _report_filter(project: Project, logs: FlightLogs) -> tuple[Any, tuple[str, ...]]:
    import numpy as np

    from georef_gis.navigate.ekf9 import run_ekf9, trajectory_of_ekf9
    from georef_gis.navigate.gnss_noise import prepare_fixes

    assert logs.imu is not None
    assert logs.gnss is not None
    late = project.settings.gnss.latency_s or 0.0
    fixes = replace(logs.gnss, time=logs.gnss.time - late)
    log = trajectory_of_ekf9(run_ekf9(logs.imu, fixes))
    # the report's filter takes every error of the fixes for white; the slow part stays
    gnss = project.settings.gnss
    slow = prepare_fixes(logs.gnss, slow_sigma=gnss.slow_sigma_m, geoid=gnss.geoid).slow
    covariance = log.covariance + np.diag([*slow**2, 0.0, 0.0, 0.0])
    notes = ("the 9-state filter of the 2009 report, smoothed", *_gnss_notes(slow))
    return _table(project, replace(log, covariance=covariance)), notes
