"""Pictures of a trajectory: attitude, position against the raw fixes, innovations."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from georef_gis.model.logs import FlightLogs, TrajectoryLog
    from georef_gis.model.trajectory import Trajectory

# names of all pictures, in the order in which they are written
NAMES = ("attitude.png", "position.png", "innovations.png")


def forget_pictures(folder: Path) -> bool:
    """Remove the pictures of an earlier trajectory, and the folder where nothing else is in it.

    Returns
    -------
    bool
        Whether there were any.
    """
    old = [folder / name for name in NAMES if (folder / name).exists()]
    for path in old:
        path.unlink()
    if folder.is_dir() and not any(folder.iterdir()):
        folder.rmdir()
    return bool(old)


def write_pictures(
    folder: Path, log: TrajectoryLog, logs: FlightLogs, trajectory: Trajectory
) -> list[Path]:
    """Write the pictures of a flight into a folder and give their paths."""
    from georef_gis.model.plot_parts import png
    from georef_gis.model.trajectory_plots import attitude_over_time, position_figure
    from georef_gis.navigate.resample import in_order, trajectory_of_gnss

    series = {"smoothed": log}
    if logs.gnss is not None:
        series = {"raw fixes": in_order(trajectory_of_gnss(logs.gnss)), **series}
    drawn = (
        png(attitude_over_time(log)), png(position_figure(series)), _innovations(trajectory),
    )  # fmt: skip
    pictures = {name: data for name, data in zip(NAMES, drawn, strict=True) if data is not None}
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
    from georef_gis.model.plot_parts import png
    from georef_gis.navigate.plots import nis_figure
    from georef_gis.navigate.trajectory import InertialTrajectory

    if not isinstance(trajectory, InertialTrajectory):
        return None
    return png(nis_figure(trajectory.nodes, trajectory.chi[:, :2]))
