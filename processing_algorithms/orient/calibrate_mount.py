"""Tool `calibrate_mount`: boresight and lever arm from photos of targets and the logs' poses."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from georef_gis.toolbox import Algorithm, Context, Feedback, Output, Result
from georef_gis.toolbox import parameters as p

if TYPE_CHECKING:
    from georef_gis.frames import Array
    from georef_gis.model.camera import Camera
    from georef_gis.model.pose import Mount, Pose
    from georef_gis.orient.two_step import MountEstimate
    from processing_algorithms.orient.mount_exposures import Exposures


class CalibrateMountParameters(p.Parameters):
    """Parameters of `calibrate_mount`."""

    exposures: p.File = p.file(
        title="Poses of the navigation: CSV with photo, x, y, z, roll_deg, pitch_deg, yaw_deg",
        help="x east, y north, z up, m, as the targets; also stand, time_s and sigma columns",
        suffixes=(".csv",),
        positional=True,
    )
    camera: p.File = p.file(title="Camera: the .json of calibrate-camera", suffixes=(".json",))
    targets: p.File = p.file(
        title="Targets: CSV with name, x (east), y (north), z (up) and maybe sigma, m",
        suffixes=(".csv",),
    )
    marks: p.File = p.file(
        title="Their marks: CSV with name, photo, u, v, sigma_px", suffixes=(".csv",)
    )
    target: p.File = p.file(
        title="File for the section of project.toml; a .json comes beside it",
        suffixes=(".toml",),
        writes=True,
    )
    way: Literal["static", "flight"] = p.choice(
        "static", title="Standing on a field of targets, or a flight over one (two-step)"
    )
    position_of: Literal["imu", "antenna"] = p.choice("imu", title="What the positions are of")
    antenna: p.Text = p.text("", title="From the IMU to the antenna: forward,right,down in m")
    looks: Literal["down", "forward"] = p.choice("down", title="Where the camera looks")
    sigma_xy: p.Length = p.length(0.02, title="One sigma of x, y where none is stated", gt=0)
    sigma_z: p.Length = p.length(0.03, title="One sigma of z where none is stated", gt=0)
    sigma_roll_pitch: p.Angle = p.angle(
        0.2, title="One sigma of roll and pitch where none is stated", unit="deg", gt=0, le=90
    )
    sigma_yaw: p.Angle = p.angle(
        0.5, title="One sigma of yaw where none is stated", unit="deg", gt=0, le=180
    )
    sigma_level: p.Angle = p.angle(
        0.0,
        title="One sigma of the tilt that the accelerometers' biases make at every stand",
        unit="deg",
        ge=0,
        le=20,
    )
    correlation: p.Number = p.number(
        0.0, title="Correlation time of the navigation's errors in flight", unit="s", ge=0, le=1e5
    )


class CalibrateMount(Algorithm[CalibrateMountParameters]):
    """Calibrate boresight and lever arm on a field of known targets.

    Each photo is resected from its marks and compared with the navigation's pose. Standing, the
    photos of a stand share the navigation's error; in flight it is the two-step procedure of the
    2012 paper, weighted mean over photos, whose sigmas are honest only with the correlation time
    of the navigation's errors. Writes the section [mount] and a JSON with covariance and table.
    """

    id, name, group = "calibrate_mount", "Calibrate the mount", "orient"
    needs_project = False
    outputs = (
        Output(name="section", title="Section for project.toml"),
        Output(name="account", title="Mount with covariance and table as JSON"),
    )

    def run(
        self, context: Context, parameters: CalibrateMountParameters, feedback: Feedback
    ) -> Result:
        """Resect, compare, write."""
        from georef_gis.toolbox.context import check_cancelled
        from processing_algorithms.orient.mount_account import table_lines

        camera = _camera(parameters.camera)
        poses, doubts = _resected(camera, parameters)
        exposures = _exposures(parameters)
        found = _estimate(parameters, poses, exposures)
        feedback.progress(0.5, "compared")

        def again(other: Camera) -> MountEstimate:
            check_cancelled(feedback)
            moved, _ = _resected(other, parameters)
            kept = {key: pose for key, pose in moved.items() if key in poses}
            return _estimate(parameters, kept, exposures)

        found = with_camera_errors(found, camera, parameters.camera, again)
        doubts += list(found.doubts)
        if parameters.way == "flight" and parameters.correlation == 0.0:
            doubts.append(
                "the photos' errors are taken as independent: the slow errors of GNSS and "
                "attitude make the sigmas up to 5 times too small; give the correlation time"
            )
        for doubt in doubts:
            feedback.warn(doubt)
        for line in table_lines(found):
            feedback.info(line)
        mount = found.mount(_nominal(parameters))
        return Result(
            outputs=_written(parameters.target, mount, found, doubts),
            summary={
                "photos": len(found.samples),
                "left_out": len(found.left_out),
                "sigma_lever_arm_m": round(mount.sigma_lever_arm, 4),
                "sigma_boresight_deg": round(math.degrees(mount.sigma_boresight), 4),
                "doubts": doubts,
            },
        )


def _written(
    target: Path, mount: Mount, found: MountEstimate, doubts: list[str]
) -> dict[str, Path]:
    """Write the section and, beside it, the account; both by the name of the output."""
    import json

    from processing_algorithms.orient.calibrate_camera import write_whole
    from processing_algorithms.orient.mount_account import json_account, mount_section

    account = target.with_suffix(".json")
    write_whole(target, mount_section(mount, found).encode())
    write_whole(account, (json.dumps(json_account(found, doubts), indent=2) + "\n").encode())
    return {"section": target, "account": account}


def _camera(path: Path) -> Camera:
    import json

    from georef_gis.errors import InputError
    from processing_algorithms.orient.undistort import read_camera

    try:
        told = json.loads(path.read_text("utf-8"))
        size = (int(told["width"]), int(told["height"]))
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", source=str(path)) from error
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(
            "is no camera; give the .json that calibrate-camera wrote", source=str(path)
        ) from error
    return read_camera(path, size)


def _resected(
    camera: Camera, parameters: CalibrateMountParameters
) -> tuple[dict[str, Pose], list[str]]:
    """Poses of the photos by resection, and why some have none."""
    import numpy as np

    from georef_gis.errors import GeometryError
    from georef_gis.orient.resection import resect
    from georef_gis.orient.resection_marks import ControlMarks
    from processing_algorithms.orient.calibrate_camera import read_target_marks, read_targets

    targets = read_targets(parameters.targets)
    place = {name: i for i, name in enumerate(targets.names)}
    by_photo: dict[str, list[tuple[str, float, float, float]]] = {}
    for photo, name, u, v, sigma in read_target_marks(parameters.marks, targets):
        by_photo.setdefault(photo, []).append((name, u, v, sigma))
    poses: dict[str, Pose] = {}
    doubts: list[str] = []
    for photo, marks in by_photo.items():
        index = np.array([place[name] for name, *_ in marks])
        control = ControlMarks(
            p_enu=targets.xyz[index],
            uv=np.array([[u, v] for _, u, v, _ in marks]),
            sigma_px=np.array([sigma for *_, sigma in marks]),
            sigma_enu=targets.sigma[index],
            names=tuple(name for name, *_ in marks),
        )
        try:
            found = resect(camera, control, photo_id=photo)
        except GeometryError as error:
            doubts.append(f"left out: {error}")
            continue
        doubts += found.doubts
        if found.alternative is None:
            poses[photo] = found.pose
        else:
            doubts.append(f"photo {photo} is left out: it has two poses")
    return poses, doubts


def _exposures(parameters: CalibrateMountParameters) -> Exposures:
    """Poses of the navigation, with times where a correlation time asks for them."""
    import numpy as np

    from georef_gis.errors import InputError
    from processing_algorithms.orient.mount_exposures import PoseSigmas, read_exposures

    otherwise = PoseSigmas(
        xy=parameters.sigma_xy,
        z=parameters.sigma_z,
        roll_pitch=parameters.sigma_roll_pitch,
        yaw=parameters.sigma_yaw,
    )
    found = read_exposures(parameters.exposures, otherwise)
    needed = parameters.way == "flight" and parameters.correlation > 0
    if needed and np.isnan(found.times).any():
        raise InputError(
            "a correlation time needs the column time_s in every row",
            source=str(parameters.exposures),
            field="time_s",
        )
    return found


def _estimate(
    parameters: CalibrateMountParameters, poses: dict[str, Pose], exposures: Exposures
) -> MountEstimate:
    from dataclasses import replace

    import numpy as np

    from georef_gis.orient.calibration.static import StaticSettings, calibrate_static
    from georef_gis.orient.two_step import joint_of, two_step

    antenna = _antenna(parameters)
    if parameters.way == "static":
        level = parameters.sigma_level
        settings = StaticSettings(
            stands=exposures.stands,
            lever_arm_body_antenna=antenna,
            sigma_common=np.array([0.0, 0.0, 0.0, level, level, 0.0]),
        )
        return calibrate_static(poses, exposures.poses, settings)
    joint = None
    if parameters.correlation > 0:
        joint = joint_of(exposures.poses, exposures.times, tau=parameters.correlation)
    found = two_step(poses, exposures.poses, joint_navigation=joint)
    if antenna is None:
        return found
    return replace(found, lever_arm_body_camera=found.lever_arm_body_camera + antenna)


def with_camera_errors(
    found: MountEstimate,
    camera: Camera,
    path: Path,
    again: Callable[[Camera], MountEstimate],
) -> MountEstimate:
    """Estimate with what the camera's own covariance adds, which all photos share.

    A focal length that is wrong by 0.1 % puts every resection over 40 m off by 4 cm. Each column of
    the root of the covariance is put into the camera once, and the change squared.
    """
    import json
    from dataclasses import replace

    import numpy as np

    from georef_gis.frames import log_so3

    told = json.loads(path.read_text("utf-8"))
    if "covariance" not in told:
        doubt = "the camera states no covariance: its errors are not in the sigmas of the mount"
        return replace(found, doubts=(*found.doubts, doubt))
    values, vectors = np.linalg.eigh(np.array(told["covariance"], dtype=float))
    added = np.zeros((6, 6))
    for column in (vectors * np.sqrt(np.maximum(values, 0.0))).T:
        named = {
            name: getattr(camera, name) + float(d)
            for name, d in zip(told["order"], column, strict=True)
        }
        other = again(replace(camera, **named))
        turn = log_so3(other.R_body_from_cam @ found.R_body_from_cam.T)
        arm = other.lever_arm_body_camera - found.lever_arm_body_camera
        d = np.concatenate([arm, turn])
        added += np.outer(d, d)
    return replace(found, covariance=found.covariance + added)


def _antenna(parameters: CalibrateMountParameters) -> Array | None:
    import numpy as np

    from georef_gis.errors import InputError

    if parameters.position_of == "imu":
        return None
    try:
        values = np.array([float(word) for word in parameters.antenna.split(",")])
    except ValueError:
        values = np.array([])
    if values.shape != (3,) or not np.all(np.isfinite(values)):
        raise InputError(
            f"'{parameters.antenna}' is not three numbers; give forward,right,down in m from the "
            "IMU to the antenna, as 0.1,0,-0.25",
            source="tool calibrate_mount",
            field="antenna",
        )
    return values


def _nominal(parameters: CalibrateMountParameters) -> Mount:
    import numpy as np

    from georef_gis.frames import R_BODY_FROM_CAM_HORIZON, R_BODY_FROM_CAM_NADIR
    from georef_gis.model.pose import Mount

    nominal = R_BODY_FROM_CAM_NADIR if parameters.looks == "down" else R_BODY_FROM_CAM_HORIZON
    antenna = _antenna(parameters)
    return Mount(
        R_body_from_cam_nominal=nominal.copy(),
        lever_arm_body_antenna=np.zeros(3) if antenna is None else antenna,
    )
