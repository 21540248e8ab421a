"""Tool `calibrate_mount`: boresight and lever arm from photos of targets and the logs' poses."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from georef_gis.toolbox import Algorithm, Context, Feedback, Output, Result
from georef_gis.toolbox import parameters as p

if TYPE_CHECKING:
    from georef_gis.frames import Array
    from georef_gis.model.camera import Camera
    from georef_gis.model.pose import Mount, Pose
    from georef_gis.orient.two_step import MountEstimate, NavigationPose

COLUMNS = ("photo", "x", "y", "z", "roll_deg", "pitch_deg", "yaw_deg")
MORE_COLUMNS = (
    "stand", "time_s", "sigma_xy_m", "sigma_z_m", "sigma_roll_pitch_deg", "sigma_yaw_deg",
)  # fmt: skip


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
        import json

        from georef_gis.toolbox.context import check_cancelled
        from processing_algorithms.orient.calibrate_camera import write_whole

        camera = _camera(parameters.camera)
        poses, doubts = _resected(camera, parameters)
        navigation, stands, times = _exposures(parameters)
        found = _estimate(parameters, poses, navigation, stands, times)
        feedback.progress(0.5, "compared")

        def again(other: Camera) -> MountEstimate:
            check_cancelled(feedback)
            moved, _ = _resected(other, parameters)
            kept = {key: pose for key, pose in moved.items() if key in poses}
            return _estimate(parameters, kept, navigation, stands, times)

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
        account = parameters.target.with_suffix(".json")
        write_whole(parameters.target, mount_section(mount, found).encode())
        told = json.dumps(_account(found, doubts), indent=2) + "\n"
        write_whole(account, told.encode())
        return Result(
            outputs={"section": parameters.target, "account": account},
            summary={
                "photos": len(found.samples),
                "left_out": len(found.left_out),
                "sigma_lever_arm_m": round(mount.sigma_lever_arm, 4),
                "sigma_boresight_deg": round(math.degrees(mount.sigma_boresight), 4),
                "doubts": doubts,
            },
        )


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
    from georef_gis.orient.resection import ControlMarks, resect
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


def _exposures(
    parameters: CalibrateMountParameters,
) -> tuple[list[NavigationPose], dict[str, str], Array]:
    """Poses of the navigation, stands by photo, and times, s."""
    import numpy as np

    from georef_gis.errors import InputError
    from georef_gis.frames import (
        R_ENU_FROM_NED_SAME_PLACE,
        R_ned_from_body,
        jacobian_theta_ned_from_rpy,
    )
    from georef_gis.orient.two_step import NavigationPose
    from processing_algorithms.orient.calibrate_camera import table_rows

    out: list[NavigationPose] = []
    stands: dict[str, str] = {}
    times: list[float | None] = []
    for row in table_rows(parameters.exposures, COLUMNS, MORE_COLUMNS):
        photo = row.text("photo")
        if any(one.photo_id == photo for one in out):
            raise InputError(f"photo '{photo}' stands twice", source=row.source, field="photo")
        roll, pitch, yaw = (
            math.radians(row.required(name)) for name in ("roll_deg", "pitch_deg", "yaw_deg")
        )
        xy = row.number("sigma_xy_m") or parameters.sigma_xy
        z = row.number("sigma_z_m") or parameters.sigma_z
        level, heading = row.number("sigma_roll_pitch_deg"), row.number("sigma_yaw_deg")
        s_level = math.radians(level) if level else parameters.sigma_roll_pitch
        s_yaw = math.radians(heading) if heading else parameters.sigma_yaw
        if min(xy, z, s_level, s_yaw) <= 0:
            raise InputError("sigmas must be > 0", source=row.source)
        # At one place: the field is small, its plumb lines differ by 0.009 deg per km.
        J = R_ENU_FROM_NED_SAME_PLACE @ jacobian_theta_ned_from_rpy(roll, pitch, yaw)
        C = np.zeros((6, 6))
        C[:3, :3] = np.diag([xy, xy, z]) ** 2
        C[3:, 3:] = J @ np.diag([s_level, s_level, s_yaw]) ** 2 @ J.T
        out.append(
            NavigationPose(
                photo_id=photo,
                p_enu=np.array([row.required(axis) for axis in "xyz"]),
                R_enu_from_body=R_ENU_FROM_NED_SAME_PLACE @ R_ned_from_body(roll, pitch, yaw),
                covariance=C,
            )
        )
        if row.text("stand"):
            stands[photo] = row.text("stand")
        times.append(row.number("time_s"))
    if parameters.way == "flight" and parameters.correlation > 0 and None in times:
        raise InputError(
            "a correlation time needs the column time_s in every row",
            source=str(parameters.exposures),
            field="time_s",
        )
    return out, stands, np.array([0.0 if t is None else t for t in times])


def _estimate(
    parameters: CalibrateMountParameters,
    poses: dict[str, Pose],
    navigation: list[NavigationPose],
    stands: dict[str, str],
    times: Array,
) -> MountEstimate:
    from dataclasses import replace

    import numpy as np

    from georef_gis.orient.calibration.static import StaticSettings, calibrate_static
    from georef_gis.orient.two_step import joint_of, two_step

    antenna = _antenna(parameters)
    if parameters.way == "static":
        level = parameters.sigma_level
        settings = StaticSettings(
            stands=stands,
            lever_arm_body_antenna=antenna,
            sigma_common=np.array([0.0, 0.0, 0.0, level, level, 0.0]),
        )
        return calibrate_static(poses, navigation, settings)
    joint = None
    if parameters.correlation > 0:
        joint = joint_of(navigation, times, tau=parameters.correlation)
    found = two_step(poses, navigation, joint_navigation=joint)
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


def table_lines(found: MountEstimate) -> list[str]:
    """Tables 4 and 5 of the paper as lines of text."""
    lines = ["axes right, forward, up   value   sd of one photo   sd of the value   photos"]
    for row in found.to_table():
        lines.append(
            f"{row.quantity:<6s} {row.unit:<4s} {row.value:12.4f} {row.sd:12.4f} "
            f"{row.sd_mean:12.4f} {row.photos:6d}"
        )
    return lines


def mount_section(mount: Mount, found: MountEstimate) -> str:
    """Section [mount] for project.toml."""
    import numpy as np

    def three(values: Array, digits: int) -> str:
        return "[" + ", ".join(f"{v:.{digits}f}" for v in values) + "]"

    lines = [
        f"# from {len(found.samples)} photos; body axes forward, right, down",
        "[mount]",
        f"lever_arm_camera_m = {three(mount.lever_arm_body_camera, 5)}",
    ]
    if np.any(mount.lever_arm_body_antenna):
        lines.append(f"lever_arm_antenna_m = {three(mount.lever_arm_body_antenna, 5)}")
    lines += [
        f"sigma_lever_arm_m = {max(mount.sigma_lever_arm, 1e-5):.5f}",
        f"boresight_deg = {three(np.degrees(mount.boresight_body), 5)}",
        f"sigma_boresight_deg = {max(math.degrees(mount.sigma_boresight), 1e-5):.5f}",
    ]
    return "\n".join(lines) + "\n"


def _account(found: MountEstimate, doubts: list[str]) -> dict[str, Any]:
    from dataclasses import asdict

    def number(value: Any) -> Any:
        return None if isinstance(value, float) and not math.isfinite(value) else value

    rows = [{key: number(v) for key, v in asdict(row).items()} for row in found.to_table()]
    return {
        "kind": "mount calibration",
        "axes": "body: forward, right, down; table: right, forward, up",
        "lever_arm_body_camera_m": found.lever_arm_body_camera.tolist(),
        "R_body_from_cam": found.R_body_from_cam.tolist(),
        "order": "lever arm (m), left rotation error in body axes (rad)",
        "covariance": found.covariance.tolist(),
        "covariance_if_independent": found.covariance_independent.tolist(),
        "sigma0": number(found.sigma0),
        "table": rows,
        "residuals": {
            sample.photo_id: residual.tolist()
            for sample, residual in zip(found.samples, found.residuals, strict=True)
        },
        "left_out": dict(found.left_out),
        "doubts": doubts,
    }
