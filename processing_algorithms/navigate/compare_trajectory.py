"""Tool `compare_trajectory`: an estimated trajectory against a reference, with pictures."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from georef_gis.toolbox import Algorithm, Context, Feedback, Output, Result
from georef_gis.toolbox import parameters as p

if TYPE_CHECKING:
    from georef_gis.model.logs import FlightLogs, TrajectoryLog
    from georef_gis.navigate.compare import Comparison

# Its presence tells a folder of ours from one that must not be replaced.
SUMMARY = "comparison.json"


class CompareTrajectoryParameters(p.Parameters):
    """Parameters of `compare_trajectory`."""

    estimate: p.File = p.file(
        title="Trajectory to judge: a log, or the folder of a project for its own",
        or_folder=True, positional=True,
    )  # fmt: skip
    reference: p.File = p.file(
        title="Trajectory taken as the truth: a log, or the folder of a project for its own",
        or_folder=True, positional=True,
    )  # fmt: skip
    target: p.Folder | None = p.folder(
        None, title="Folder for pictures, table and summary", writes=True
    )
    raw: p.File | None = p.file(None, title="Log whose raw fixes are drawn behind the positions")
    time_shift: p.Number = p.number(
        0.0, title="Added to the estimate's times", unit="s", ge=-1e10, le=1e10
    )
    find_time_shift: p.Flag = p.flag(
        False, title="Find what is to be added to the estimate's times, within 2 s"
    )
    lever_arm: p.Text = p.text(
        "", title="From the estimate's place to the reference's: forward,right,down in m"
    )
    remove_rotation: p.Flag = p.flag(
        False, title="Take off the constant rotation between the two bodies"
    )
    remove_offset: p.Flag = p.flag(False, title="Take off the constant offset of position")
    turn_rate: p.Angle = p.angle(
        3.0, title="Turn of the course in one second that makes a turn", unit="deg", gt=0, le=180,
        advanced=True,
    )  # fmt: skip


class CompareTrajectory(Algorithm[CompareTrajectoryParameters]):
    """How far a trajectory is from a reference: table, pictures, and whether its sigmas hold.

    Reads SBET, .pos, NMEA, autopilot logs and tables of trajectories; fixes count as positions
    without attitude, attitudes as attitudes without positions. Differences are estimate minus
    reference, over all, on straights and in turns.
    """

    id, name, group = "compare_trajectory", "Compare trajectories", "navigate"
    needs_project = False
    outputs = (
        Output(name="folder", title="Pictures, table and summary", type="Folder"),
        Output(name="table", title="Statistics as CSV"),
        Output(name="summary", title="Account as JSON"),
    )

    def run(
        self, context: Context, parameters: CompareTrajectoryParameters, feedback: Feedback
    ) -> Result:
        """Compare, tell the table, and write the folder if one is named."""
        from dataclasses import asdict

        from georef_gis.navigate.compare import (
            compare_trajectories,
            statistics,
            summary,
            text_table,
        )
        from georef_gis.toolbox.context import check_cancelled

        _refuse_both(parameters)
        if parameters.target is not None:
            refuse_foreign(parameters.target)
        estimate = _load(parameters.estimate)
        feedback.progress(0.2, "estimate read")
        reference = _load(parameters.reference)
        feedback.progress(0.4, "reference read")
        shift = None if parameters.find_time_shift else parameters.time_shift
        comparison = compare_trajectories(
            estimate, reference, time_shift=shift, settings=_settings(parameters)
        )
        for doubt in comparison.doubts:
            feedback.warn(doubt)
        found = statistics(comparison)
        for line in (*_account(comparison), *text_table(found)):
            feedback.info(line)
        feedback.progress(0.6, "compared")
        check_cancelled(feedback)
        told = summary(comparison)
        # the table was told above; a face would tell it again, figure by figure
        brief = {key: value for key, value in told.items() if key != "statistics"}
        outputs: dict[str, Path] = {}
        if parameters.target is not None:
            files = _pictures(comparison, parameters)
            files["statistics.csv"] = _csv([asdict(row) for row in found])
            files[SUMMARY] = _json(told)
            check_cancelled(feedback)
            write_folder(parameters.target, files)
            outputs = {
                "folder": parameters.target,
                "table": parameters.target / "statistics.csv",
                "summary": parameters.target / SUMMARY,
            }
        feedback.progress(1.0, "written" if outputs else "done")
        return Result(outputs=outputs, summary=brief)


def _load(path: Path) -> TrajectoryLog:
    """Trajectory that a parameter names: a log, or that of a project."""
    from georef_gis.errors import InputError
    from georef_gis.ingest.logs.trajectory_table import (
        is_trajectory_table,
        read_trajectory_table,
    )

    if path.is_dir() or path.name == "project.toml":
        return _project_trajectory(path)
    try:
        with open(path, "rb") as stream:
            head = stream.read(65536)
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", source=str(path)) from error
    if is_trajectory_table(head):
        return read_trajectory_table(path)
    from georef_gis.ingest.logs.open_log import read_log

    return trajectory_of_logs(read_log(path))


def _project_trajectory(path: Path) -> TrajectoryLog:
    """Trajectory that `georef navigate` made of a project's logs."""
    from georef_gis.project import Project
    from processing_algorithms.navigate.flight import load_trajectory, trajectory_log

    return trajectory_log(load_trajectory(Project.open(path, read_only=True)))


def trajectory_of_logs(logs: FlightLogs) -> TrajectoryLog:
    """A log's trajectory: its own, else that of its fixes with its attitudes.

    Raises
    ------
    InputError
        If the log holds neither.
    """
    from georef_gis.errors import InputError
    from georef_gis.navigate.resample import (
        in_order,
        trajectory_of_attitude,
        trajectory_of_gnss,
        with_attitude,
    )

    if logs.trajectory is not None:
        return logs.trajectory
    attitude = logs.attitude
    if logs.gnss is None:
        if attitude is None:
            raise InputError(
                "holds neither a trajectory, nor fixes, nor attitudes; give another log",
                source=logs.source,
            )
        return trajectory_of_attitude(attitude)
    fixes = in_order(trajectory_of_gnss(logs.gnss))
    if attitude is None or attitude.scale != fixes.scale:
        return fixes
    angles = in_order(trajectory_of_attitude(attitude))
    return with_attitude(fixes, angles) if len(angles) > 1 else fixes


def _settings(parameters: CompareTrajectoryParameters) -> Any:
    from georef_gis.navigate.compare import CompareSettings

    return CompareSettings(
        lever_arm=_lever_arm(parameters.lever_arm),
        remove_rotation=parameters.remove_rotation,
        remove_offset=parameters.remove_offset,
        turn_rate=parameters.turn_rate,
    )


def _refuse_both(parameters: CompareTrajectoryParameters) -> None:
    from georef_gis.errors import InputError

    if parameters.find_time_shift and parameters.time_shift:
        raise InputError(
            f"{parameters.time_shift:g} s is given and is to be found; leave one out",
            source="tool compare_trajectory", field="time_shift",
        )  # fmt: skip


def _lever_arm(text: str) -> tuple[float, float, float]:
    import math

    from georef_gis.errors import InputError

    if not text.strip():
        return 0.0, 0.0, 0.0
    try:
        forward, right, down = (float(word) for word in text.split(","))
    except ValueError as error:
        raise InputError(
            f"'{text}' is not three numbers; give forward,right,down in m, as 0.1,0,-0.25",
            source="tool compare_trajectory", field="lever_arm",
        ) from error  # fmt: skip
    if not all(math.isfinite(v) and abs(v) < 1000.0 for v in (forward, right, down)):
        raise InputError(
            f"'{text}' is not within 1000 m; give forward,right,down in m",
            source="tool compare_trajectory", field="lever_arm",
        )  # fmt: skip
    return forward, right, down


def _account(comparison: Comparison) -> list[str]:
    """What was done before the differences were taken, in words."""
    import math

    import numpy as np

    one = comparison
    lines = [
        f"{len(one.time)} common times over {one.time[-1] - one.time[0]:.1f} s, "
        f"{np.mean(one.turning):.0%} in turns"
    ]
    if one.time_shift_from != "given":
        sigma = f" +- {one.sigma_time_shift:.4f}" if math.isfinite(one.sigma_time_shift) else ""
        lines.append(
            f"time shift found by {one.time_shift_from}: {one.time_shift:+.4f}{sigma} s "
            "added to the estimate's times"
        )
    elif one.time_shift:
        lines.append(f"time shift given: {one.time_shift:+.4f} s added to the estimate's times")
    if np.any(one.rotation):
        x, y, z = np.degrees(one.rotation)
        lines.append(f"rotation taken off, deg about forward, right, down: {x:.3f} {y:.3f} {z:.3f}")
    if np.any(one.offset):
        n, e, d = one.offset
        lines.append(f"offset taken off, m north, east, down: {n:.3f} {e:.3f} {d:.3f}")
    for name, nees in (("position", one.nees_position), ("attitude", one.nees_attitude)):
        known = nees[np.isfinite(nees)]
        if len(known):
            lines.append(f"NEES/3 of {name}: {np.mean(known) / 3.0:.2f} (1 is consistent)")
    return lines


def _pictures(comparison: Comparison, parameters: CompareTrajectoryParameters) -> dict[str, bytes]:
    from georef_gis.navigate.plots import comparison_pictures

    raw = None if parameters.raw is None else _load(parameters.raw)
    return comparison_pictures(comparison, raw=raw)


def _csv(rows: list[dict[str, Any]]) -> bytes:
    import csv
    import io
    import math

    def cell(value: Any) -> Any:
        if not isinstance(value, float):
            return value
        return f"{value:.6g}" if math.isfinite(value) else ""

    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, fieldnames=list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows({key: cell(value) for key, value in row.items()} for row in rows)
    return text.getvalue().encode()


def _json(told: dict[str, Any]) -> bytes:
    import json

    return (json.dumps(told, indent=2, allow_nan=False) + "\n").encode()


def refuse_foreign(target: Path) -> None:
    """Refuse a target that is there and holds what is not of ours.

    Raises
    ------
    ExportError
        If it is a file, or a folder with other files.
    """
    from georef_gis.errors import ExportError

    if target.exists() and not target.is_dir():
        raise ExportError(f"{target}: is a file; name a folder")
    if target.is_dir() and any(target.iterdir()) and not (target / SUMMARY).is_file():
        raise ExportError(f"{target}: holds other files; name an empty or a new folder")


def write_folder(target: Path, files: dict[str, bytes]) -> None:
    """Write files into a folder that appears whole or not at all, in place of an older one.

    Raises
    ------
    ExportError
        If the folder is there and not of ours, or the disk will not have it.
    """
    import os
    import shutil
    import tempfile

    from georef_gis.rasters.files import export_errors

    refuse_foreign(target)
    with export_errors(target, lambda: sum(map(len, files.values()))):
        target.parent.mkdir(parents=True, exist_ok=True)
        part = Path(tempfile.mkdtemp(prefix=f".{target.name}.", suffix=".part", dir=target.parent))
        try:
            # mkdtemp's folder is for its owner only.
            part.chmod(0o755)
            for name, content in files.items():
                (part / name).write_bytes(content)
            old = part.with_suffix(".old")
            if target.is_dir():
                os.replace(target, old)
            try:
                os.replace(part, target)
            except OSError:
                if old.is_dir():
                    os.replace(old, target)
                raise
            shutil.rmtree(old, ignore_errors=True)
        finally:
            shutil.rmtree(part, ignore_errors=True)
