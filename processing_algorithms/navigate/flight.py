"""What the tools of the navigation share: the project's logs, settings and trajectory."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from georef_gis.model.logs import FlightLogs, TrajectoryLog
    from georef_gis.model.pose import Mount
    from georef_gis.model.trajectory import Trajectory
    from georef_gis.navigate.settings import NavigationSettings
    from georef_gis.project import Project

# The trajectory in the project's folder `navigation`.
TRAJECTORY = "trajectory.npz"
TABLE = "trajectory.csv"
PLOTS = "plots"
EXPOSURES = "exposures.npz"
# Parts of [logs] that name one file each, and what is taken from it
PARTS = {"imu": "imu", "gnss": "gnss", "attitude": "attitude", "trajectory": "trajectory"}


def log_files(project: Project) -> list[Path]:
    """Every file that [logs] names, each once."""
    logs = project.settings.logs
    named = [getattr(logs, key) for key in (*PARTS, "sync")]
    files = [project.path(path) for path in (*named, *logs.files) if path is not None]
    return list(dict.fromkeys(files))


def read_project_logs(project: Project, maps: Iterable[str] = ()) -> FlightLogs:
    """All logs of a project, cleaned.

    Parameters
    ----------
    maps
        Columns as `--map` gives them; they go before those of project.toml.

    Raises
    ------
    InputError
        As the readers and the cleaning say.
    """
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
    return clean_logs(read_logs(log_files(project), columns, take=take))


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
        If there is none.
    """
    from georef_gis.navigate.columns_file import kind_of

    path = project.navigation / TRAJECTORY
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
