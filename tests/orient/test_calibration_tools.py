"""The tools that calibrate and undistort, from files to files."""

from __future__ import annotations

import csv
import json
import tomllib
from pathlib import Path

import cv2
import numpy as np
import pytest

from georef_gis.errors import ExportError, InputError
from georef_gis.frames import exp_so3, log_so3
from georef_gis.model.camera import Camera
from georef_gis.toolbox import Context
from georef_gis.toolbox.context import CollectingFeedback
from processing_algorithms.orient.calibrate_camera import CalibrateCamera, CalibrateCameraParameters
from processing_algorithms.orient.calibrate_mount import CalibrateMount, CalibrateMountParameters
from processing_algorithms.orient.undistort import Undistort, UndistortParameters, read_camera

CAMERA = Camera(
    id="c", width=1000, height=750, fx=820.0, fy=818.0, cx=507.0, cy=369.0, k1=-0.05, k2=0.02,
    p1=3e-4,
)  # fmt: skip
ARM, BORESIGHT = np.array([0.12, -0.05, 0.2]), np.radians([1.0, -0.6, 0.4])


def table(path: Path, header: str, rows: list[list[object]]) -> None:
    with path.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(header.split(","))
        writer.writerows(rows)


def field(folder: Path, rng: np.random.Generator, *, flight: bool = False) -> None:
    """Targets, marks, photos and exposures of a camera that looks down on a field."""
    height = 40.0 if flight else 6.0
    span = height * 0.9
    xyz = np.column_stack([rng.uniform(-span, span, (70, 2)), rng.uniform(0, 0.15 * height, 70)])
    table(folder / "targets.csv", "name,x,y,z,sigma",
          [[f"T{i}", *np.round(p, 4), 0.001] for i, p in enumerate(xyz)])  # fmt: skip
    marks, exposures = [], []
    (folder / "photos").mkdir()
    for k in range(8):
        yaw, roll, pitch = k * np.pi / 4, rng.normal(0, 0.12), rng.normal(0, 0.12)
        ned = exp_so3([0, 0, yaw]) @ exp_so3([0, pitch, 0]) @ exp_so3([roll, 0, 0])
        R = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]) @ ned
        p = np.array([*rng.normal(0, 0.1 * height, 2), height])
        C = p + R @ ARM
        R_cam = R @ exp_so3(BORESIGHT) @ np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
        uv = CAMERA.project((xyz - C) @ R_cam)
        for i in np.flatnonzero(np.all((uv > 5) & (uv < [994, 744]), axis=1)):
            noisy = uv[i] + 0.2 * rng.standard_normal(2)
            marks.append([f"T{i}", f"P{k}.jpg", *np.round(noisy, 3), 0.2])
        place = p + rng.normal(0, 0.01, 3)
        angles = np.degrees([roll, pitch, yaw]) + rng.normal(0, 0.05, 3)
        exposures.append([f"P{k}.jpg", *np.round(place, 4), *np.round(angles, 5), f"S{k}", 3.0 * k])
        cv2.imwrite(str(folder / f"photos/P{k}.jpg"), np.full((750, 1000, 3), 90, np.uint8))
    table(folder / "marks.csv", "name,photo,u,v,sigma_px", marks)
    table(folder / "exposures.csv", "photo,x,y,z,roll_deg,pitch_deg,yaw_deg,stand,time_s",
          exposures)  # fmt: skip


def calibrate(folder: Path, **more: object) -> dict[str, object]:
    parameters = CalibrateCameraParameters(
        photos=folder / "photos", shows="field", targets=folder / "targets.csv",
        marks=folder / "marks.csv", target=folder / "camera.toml", **more,
    )  # fmt: skip
    done = CalibrateCamera().run(Context(), parameters, CollectingFeedback())
    return dict(done.summary)


@pytest.mark.slow
@pytest.mark.parametrize("way", ["static", "flight"])
def test_from_marks_to_camera_to_mount(tmp_path: Path, way: str) -> None:
    field(tmp_path, np.random.default_rng(1), flight=way == "flight")
    summary = calibrate(tmp_path)
    assert summary["photos"] == 8
    camera = read_camera(tmp_path / "camera.json", (1000, 750))
    told = json.loads((tmp_path / "camera.json").read_text())
    e = [getattr(CAMERA, n) - getattr(camera, n) for n in told["order"]]
    chi2 = e @ np.linalg.solve(np.array(told["covariance"]), e)
    assert chi2 < 27.9  # of 9, 99.9 %
    feedback = CollectingFeedback()
    done = CalibrateMount().run(
        Context(),
        CalibrateMountParameters(
            exposures=tmp_path / "exposures.csv", camera=tmp_path / "camera.json",
            targets=tmp_path / "targets.csv", marks=tmp_path / "marks.csv",
            target=tmp_path / "mount.toml", way=way, sigma_xy="1cm", sigma_z="1cm",
            sigma_roll_pitch="0.05deg", sigma_yaw="0.05deg", correlation=30.0,
        ),
        feedback,
    )  # fmt: skip
    mount = tomllib.loads((tmp_path / "mount.toml").read_text())["mount"]
    assert mount["lever_arm_camera_m"] == pytest.approx(ARM, abs=0.06)  # m
    assert mount["boresight_deg"] == pytest.approx(np.degrees(BORESIGHT), abs=0.15)
    assert 0 < mount["sigma_boresight_deg"] < 0.15
    assert done.summary["photos"] == 8
    account = json.loads((tmp_path / "mount.json").read_text())
    e = [*(ARM - account["lever_arm_body_camera_m"])]
    nominal = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    R = np.array(account["R_body_from_cam"])
    e += [*log_so3(exp_so3(BORESIGHT) @ nominal @ R.T)]
    # of 6, 99.9 %: the errors of the camera, shared by all photos, are counted in
    assert e @ np.linalg.solve(np.array(account["covariance"]), e) < 22.5
    assert [row["quantity"] for row in account["table"]] == ["X", "Y", "Z", "Omega", "Phi", "Kappa"]
    assert any(line.startswith("Omega") for line in feedback.infos)


def test_the_section_is_read_by_a_project(tmp_path: Path) -> None:
    from georef_gis.project.settings import Settings

    field(tmp_path, np.random.default_rng(2))
    calibrate(tmp_path, camera="MyCam 1000x750")
    settings = Settings.model_validate(tomllib.loads((tmp_path / "camera.toml").read_text()))
    assert settings.cameras["MyCam 1000x750"].fx == pytest.approx(820.0, abs=3.0)


@pytest.mark.slow
def test_a_board_from_photos_on_disk(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    photos = tmp_path / "photos"
    photos.mkdir()
    row, col = np.indices((7, 10))
    inner = np.kron(((row + col) % 2 * 215 + 20).astype(np.uint8), np.ones((60, 60), np.uint8))
    picture = np.pad(inner, 60, constant_values=235)
    K = np.array([[CAMERA.fx, 0, CAMERA.cx], [0, CAMERA.fx, CAMERA.cy], [0, 0, 1.0]])
    for k in range(7):
        R = exp_so3([rng.uniform(-0.5, 0.5), rng.uniform(-0.5, 0.5), k * 0.4])
        t = np.array([*rng.uniform(-0.03, 0.03, 2), 0.42])
        middle = np.array([-0.18, -0.135, 0.0])
        # board plane (m from its middle) to pixels; texture px to m: 2000 px per m
        board_from_px = np.array([[5e-4, 0, middle[0]], [0, 5e-4, middle[1]], [0, 0, 1.0]])
        H = K @ np.column_stack([R[:, 0], R[:, 1], t]) @ board_from_px
        photo = cv2.warpPerspective(picture, H, (1000, 750), borderValue=235)
        cv2.imwrite(str(photos / f"b{k}.png"), cv2.GaussianBlur(photo, (0, 0), 0.8))
    done = CalibrateCamera().run(
        Context(),
        CalibrateCameraParameters(photos=photos, target=tmp_path / "c.toml", square="30mm"),
        CollectingFeedback(),
    )
    camera = read_camera(tmp_path / "c.toml", (1000, 750))
    assert done.summary["photos"] >= 5
    assert camera.fx == pytest.approx(CAMERA.fx, rel=5e-3)


def test_undistorting_a_folder(tmp_path: Path) -> None:
    field(tmp_path, np.random.default_rng(4))
    calibrate(tmp_path)
    (tmp_path / "photos/other.jpg").write_bytes(
        cv2.imencode(".jpg", np.zeros((10, 10, 3), np.uint8))[1].tobytes()
    )
    feedback = CollectingFeedback()
    done = Undistort().run(
        Context(),
        UndistortParameters(
            photos=tmp_path / "photos", camera=tmp_path / "camera.toml", target=tmp_path / "flat"
        ),
        feedback,
    )
    assert done.summary["photos"] == 8
    assert any("other.jpg" in warning for warning in feedback.warnings)
    assert cv2.imread(str(tmp_path / "flat/overlay.png")) is not None
    flat = read_camera(tmp_path / "flat/camera.json", (1000, 750))
    assert flat.k1 == 0.0
    section = tomllib.loads((tmp_path / "flat/camera.toml").read_text())["camera"]
    assert section["fx"] == pytest.approx(flat.fx, abs=1e-3)


def test_unusable_files_are_refused_in_one_line(tmp_path: Path) -> None:
    field(tmp_path, np.random.default_rng(5))
    (tmp_path / "camera.json").write_text('{"width": 10}')
    with pytest.raises(InputError, match="calibrate-camera"):
        read_camera(tmp_path / "camera.json", (10, 10))
    with pytest.raises(InputError, match="is not a folder"):
        CalibrateCamera().run(
            Context(),
            CalibrateCameraParameters(photos=tmp_path / "none", target=tmp_path / "c.toml"),
            CollectingFeedback(),
        )
    with (tmp_path / "marks.csv").open("a") as stream:
        stream.write("T999,P0.jpg,1,2,0.5\n")
    with pytest.raises(InputError, match=r"line \d+: name: 'T999' is not among the targets"):
        calibrate(tmp_path)


def test_a_folder_that_is_missing_is_named(tmp_path: Path) -> None:
    field(tmp_path, np.random.default_rng(6))
    with pytest.raises(ExportError, match="does not exist"):
        CalibrateCamera().run(
            Context(),
            CalibrateCameraParameters(
                photos=tmp_path / "photos", shows="field", targets=tmp_path / "targets.csv",
                marks=tmp_path / "marks.csv", target=tmp_path / "no/camera.toml",
            ),
            CollectingFeedback(),
        )  # fmt: skip
