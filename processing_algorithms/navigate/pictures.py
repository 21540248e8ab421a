"""Pictures of a trajectory: attitude, position against the raw fixes, innovations."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from georef_gis.model.logs import FlightLogs, TrajectoryLog
    from georef_gis.model.trajectory import Trajectory


def write_pictures(
    folder: Path, log: TrajectoryLog, logs: FlightLogs, trajectory: Trajectory
) -> list[Path]:
    """Write the pictures of a flight into a folder and give their paths."""
    from georef_gis.navigate.plots import png, position_figure, single_attitude_figure
    from georef_gis.navigate.resample import in_order, trajectory_of_gnss

    series = {"smoothed": log}
    if logs.gnss is not None:
        series = {"raw fixes": in_order(trajectory_of_gnss(logs.gnss)), **series}
    pictures = {
        "attitude.png": png(single_attitude_figure(log)),
        "position.png": png(position_figure(series)),
    }
    score = _innovations(trajectory)
    if score is not None:
        pictures["innovations.png"] = score
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for name, data in pictures.items():
        part = folder / f"{name}.part"
        part.write_bytes(data)
        part.replace(folder / name)
        paths.append(folder / name)
    return paths


def _innovations(trajectory: Any) -> bytes | None:
    """Normalised innovations of an inertial trajectory; None for the other kinds."""
    from georef_gis.navigate.plots import nis_figure, png
    from georef_gis.navigate.trajectory import InertialTrajectory

    if not isinstance(trajectory, InertialTrajectory):
        return None
    return png(nis_figure(trajectory.nodes, trajectory.chi[:, :2]))
