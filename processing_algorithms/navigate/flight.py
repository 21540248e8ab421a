"""What the tools of the navigation share: the project's logs, settings and trajectory."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from georef_gis.model.logs import FlightLogs

if TYPE_CHECKING:
    from datetime import datetime

    from georef_gis.model.logs import TrajectoryLog
    from georef_gis.model.pose import Mount
    from georef_gis.model.trajectory import Trajectory
    from georef_gis.navigate.settings import NavigationSettings
    from georef_gis.project import Project

# The trajectory in the project's folder `navigation`.
TRAJECTORY = "trajectory.npz"
TABLE = "trajectory.csv"
PLOTS = "plots"
EXPOSURES = "exposures.npz"
# Key of the database's table `meta`: columns that --map told `navigate`, for the events
MAPS = "log_maps"
# Parts of [logs] that name one file each, and what is taken from it
PARTS = {"imu": "imu", "gnss": "gnss", "attitude": "attitude", "trajectory": "trajectory"}


def log_files(project: Project) -> list[Path]:
    """Every file that [logs] names, each once."""
    logs = project.settings.logs
    named = [getattr(logs, key) for key in (*PARTS, "sync")]
    files = [project.path(path) for path in (*named, *logs.files) if path is not None]
    return list(dict.fromkeys(files))


def read_project_logs(
    project: Project, maps: Iterable[str] = (), *, strict: bool = False
) -> FlightLogs:
    """All logs of a project, cleaned.

    Parameters
    ----------
    maps
        Columns as `--map` gives them; they go before those of project.toml.
    strict
        Whether a sync-board log that cannot be read is an error; else it is a doubt, and the
        trajectory is made without events.

    Raises
    ------
    InputError
        As the readers and the cleaning say.
    """
    from georef_gis.errors import InputError
    from georef_gis.ingest.logs.cleaning import clean_logs
    from georef_gis.ingest.logs.column_map import ColumnMap
    from georef_gis.ingest.logs.open_log import read_logs

    settings = project.settings.logs
    columns = ColumnMap.from_mapping(settings.columns).merged(ColumnMap.from_strings(maps))
    take: dict[Any, Path] = {
        part: project.path(path)
        for key, part in PARTS.items()
        if (path := getattr(settings, key)) is not None
    }
    files = log_files(project)
    table = _trajectory_table(take.get("trajectory"))
    if table is not None:
        path = take.pop("trajectory")
        files = [file for file in files if file != path]
    sync = None if settings.sync is None else project.path(settings.sync)
    try:
        logs = read_logs(files, columns, take=take) if files else FlightLogs()
    except InputError as error:
        rest = [file for file in files if file != sync]
        if strict or error.source != str(sync) or not rest or sync in take.values():
            raise
        logs = read_logs(rest, columns, take=take)
        logs = replace(logs, doubts=(*logs.doubts, f"the exposure events are not used: {error}"))
    if table is not None:
        words = (*logs.doubts, *table.doubts)
        named = ", ".join(filter(None, ("trajectory table", logs.format)))
        logs = replace(logs, trajectory=table, format=named, doubts=words)
    return clean_logs(_with_week(project, logs, columns.date))


def _trajectory_table(path: Path | None) -> TrajectoryLog | None:
    """Trajectory in the project's own form of CSV; None if a file is something else."""
    from georef_gis.ingest.logs.trajectory_table import (
        is_trajectory_table,
        read_trajectory_table,
    )

    if path is None or not path.is_file():
        return None
    with path.open("rb") as stream:
        head = stream.read(65536)
    return read_trajectory_table(path) if is_trajectory_table(head) else None


def _with_week(project: Project, logs: FlightLogs, date: datetime | None) -> FlightLogs:
    """Logs whose finished trajectory has seconds of the week only, with the week.

    It is that of the other logs, of the stated date, or of the photos' clocks, whose time zone
    is not known but shorter than half a week.
    """
    import numpy as np

    from georef_gis.navigate.clock_fit import clock_seconds
    from georef_gis.project.records import photo_of
    from georef_gis.units import GPS_WEEK, gps_from_utc, week_from_gps

    finished = logs.trajectory
    if finished is None or finished.scale == "gps" or not len(finished):
        return logs
    middle = float(np.median(finished.time))
    others = [log for log in (logs.imu, logs.gnss, logs.attitude, *logs.events) if log is not None]
    near = [float(np.nanmedian(log.time)) for log in others if log.scale == "gps" and len(log)]
    origin = "the other logs"
    if not near and date is not None:
        near, origin = [gps_from_utc(date)], "the stated date"
    if not near:
        clocks = [photo_of(row).camera_clock for row in project.database.rows("photo")]
        near = [clock_seconds(clock) for clock in clocks if clock is not None]
        origin = "the photos"
    if not near or not -GPS_WEEK < middle < 2 * GPS_WEEK:
        return logs
    weeks = round((float(np.median(near)) - middle) / GPS_WEEK)
    time = finished.time + weeks * GPS_WEEK
    doubt = (
        f"its times are seconds of the week: week {week_from_gps(time[0])[0]} of {origin} is taken"
    )
    doubts = (*(line for line in logs.doubts if "has no GPS week" not in line), doubt)
    return replace(logs, trajectory=replace(finished, time=time, scale="gps"), doubts=doubts)


def navigation_settings(project: Project) -> NavigationSettings:
    """What project.toml says of the sensors."""
    import numpy as np

    from georef_gis.navigate.settings import ImuNoise, NavigationSettings

    imu, gnss = project.settings.imu, project.settings.gnss
    hour = 3600.0
    return NavigationSettings(
        imu=ImuNoise(
            gyro_walk=math.radians(imu.gyro_noise_deg_rt_h) / math.sqrt(hour),
            accel_walk=imu.accel_noise_m_s_rt_h / math.sqrt(hour),
            gyro_bias=math.radians(imu.gyro_bias_deg_h) / hour,
            accel_bias=imu.accel_bias_m_s2,
            scale=imu.gyro_scale_percent / 100.0,
            misalignment=math.radians(imu.gyro_misalignment_deg),
        ),
        lever_arm_body_antenna=np.array(project.settings.mount.lever_arm_antenna_m),
        slow_sigma=gnss.slow_sigma_m,
        slow_tau=gnss.slow_tau_s,
    )


def project_mount(project: Project) -> Mount:
    """The mount of project.toml, with the axes of the camera as it is fixed."""
    import numpy as np

    from georef_gis.frames import R_BODY_FROM_CAM_HORIZON, R_BODY_FROM_CAM_NADIR, exp_so3
    from georef_gis.model.pose import Mount

    mount = project.settings.mount
    nominal = R_BODY_FROM_CAM_NADIR if mount.looks == "down" else R_BODY_FROM_CAM_HORIZON
    quarters = ("forward", "right", "back", "left").index(mount.image_top)
    # about the view axis: down in body axes for a camera that looks down
    axis = [0.0, 0.0, 1.0] if mount.looks == "down" else [1.0, 0.0, 0.0]
    turn = exp_so3(np.array(axis) * quarters * math.pi / 2.0)
    return Mount(
        lever_arm_body_camera=np.array(mount.lever_arm_camera_m),
        lever_arm_body_antenna=np.array(mount.lever_arm_antenna_m),
        boresight_body=np.radians(mount.boresight_deg),
        R_body_from_cam_nominal=np.round(turn @ nominal),
        sigma_lever_arm=mount.sigma_lever_arm_m,
        sigma_boresight=math.radians(mount.sigma_boresight_deg),
    )


def load_trajectory(project: Project) -> Trajectory:
    """Trajectory that `georef navigate` wrote.

    Raises
    ------
    InputError
        If there is none, or it cannot be read.
    """
    from georef_gis.errors import InputError
    from georef_gis.project.columns_file import kind_of

    path = project.navigation / TRAJECTORY
    if not path.exists():
        raise InputError(
            "has no trajectory: no log is named in [logs], or none could be used; "
            f"`georef navigate --strict --project {project.folder}` says why",
            source=str(project.folder),
        )
    kind = kind_of(path)
    if kind == "inertial":
        from georef_gis.navigate.trajectory import InertialTrajectory

        return InertialTrajectory.load(path)
    if kind == "kinematic":
        from georef_gis.navigate.kinematic import KinematicTrajectory

        return KinematicTrajectory.load(path)
    from georef_gis.navigate.table_trajectory import TableTrajectory

    return TableTrajectory.load(path)


def trajectory_log(trajectory: Trajectory, rate: float = 10.0) -> TrajectoryLog:
    """Trajectory as rows at a rate (Hz) with covariances, of the IMU; gaps are left out."""
    import numpy as np

    from georef_gis.frames import rpy_from_R_ned_from_body
    from georef_gis.model.logs import TrajectoryLog

    first, last = trajectory.span
    times = np.arange(math.ceil(first * rate), math.floor(last * rate) + 1) / rate
    times = np.array([t for t in times if not trajectory.why_not(float(t))])
    states = trajectory.at(times)
    return TrajectoryLog(
        time=times,
        source=TRAJECTORY,
        lat=states.p_geo[:, 0],
        lon=states.p_geo[:, 1],
        height=states.p_geo[:, 2],
        v_ned=states.v_ned,
        rpy=rpy_from_R_ned_from_body(states.R_ned_from_body),
        covariance=states.covariance,
    )


def words(*groups: Sequence[str]) -> list[str]:
    """Lines of several groups, each once, in order."""
    return list(dict.fromkeys(line for group in groups for line in group))
