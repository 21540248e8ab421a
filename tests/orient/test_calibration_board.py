"""Cameras from rendered boards and fields, against the truth and against OpenCV's own solution."""

from __future__ import annotations

import functools
import json
import tomllib
from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from georef_gis.errors import AdjustmentError, InputError
from georef_gis.frames import Array, exp_so3
from georef_gis.ingest.cameras import CameraOverride, camera_for
from georef_gis.model.camera import Camera
from georef_gis.orient.calibration.account import json_account, toml_snippet
from georef_gis.orient.calibration.board import Board, BoardPhoto, calibrate_board, find_corners
from georef_gis.orient.calibration.bundle import BROWN, Targets, View
from georef_gis.orient.calibration.field import CalibrationSettings, calibrate_field
from georef_gis.orient.calibration.judgement import Calibration

TRUE = Camera(
    id="c", width=1200, height=900, fx=1010.0, fy=1006.0, cx=611.0, cy=439.0,
    k1=-0.12, k2=0.06, k3=-0.01, p1=6e-4, p2=-4e-4,
)  # fmt: skip
BOARD = Board(across=10, down=7, square_m=0.03)
CHARUCO = Board(kind="charuco", across=9, down=7, square_m=0.03, marker_m=0.021)

Pose = tuple[Array, Array]


def poses(rng: np.random.Generator, n: int, *, tilt: float = 0.6) -> list[Pose]:
    """Camera poses in the board's axes (x right, y down, z into the board): origin, R."""
    out = []
    for _ in range(n):
        R = exp_so3([0, 0, rng.choice([0.0, np.pi / 2, np.pi])]) @ exp_so3(
            [rng.uniform(-tilt, tilt), rng.uniform(-tilt, tilt), 0]
        )
        aim = np.array([0.135, 0.09, 0.0])
        aim[:2] += rng.uniform(-0.06, 0.06, 2)
        out.append((aim - R[:, 2] * rng.uniform(0.22, 0.34), R))
    return out


def whole(rng: np.random.Generator, n: int, board: Board, *, tilt: float) -> list[Pose]:
    """Poses from which all corners and their squares are in the image."""
    out: list[Pose] = []
    while len(out) < n:
        pose = poses(rng, 1, tilt=tilt)[0]
        uv = true_uv(board, pose)
        if np.all((uv > 60) & (uv < [TRUE.width - 60, TRUE.height - 60])):
            out.append(pose)
    return out


def ideal_grid(camera: Camera) -> Array:
    """Ideal (x, y) of all pixels, inverted here by fixed-point iteration; shape (h, w, 2)."""
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    xd, yd = (u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy
    x, y = xd.copy(), yd.copy()
    for _ in range(60):
        r2 = x * x + y * y
        k = 1 + camera.k1 * r2 + camera.k2 * r2**2 + camera.k3 * r2**3
        x, y = (
            (xd - 2 * camera.p1 * x * y - camera.p2 * (r2 + 2 * x * x)) / k,
            (yd - camera.p1 * (r2 + 2 * y * y) - 2 * camera.p2 * x * y) / k,
        )
    return np.stack([x, y], axis=-1)


def rendered(board: Board, pose: Pose, ideal: Array, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Photo of a board: each pixel's ray meets the board, whose picture is looked up there."""
    per_m = 5000.0
    origin, R = pose
    d = ideal[..., 0:1] * R[:, 0] + ideal[..., 1:2] * R[:, 1] + R[:, 2]
    xy = origin[:2] - d[..., :2] * (origin[2] / d[..., 2])[..., None]
    # The first inner corner is the origin, one square in from the picture's margin of one square.
    at = ((xy + 2 * board.square_m) * per_m - 0.5).astype(np.float32)
    picture = cv2.remap(
        texture(board, per_m), at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderValue=235
    )
    soft = cv2.GaussianBlur(picture, (0, 0), 0.7).astype(float)
    return np.clip(soft + rng.normal(0, 1.5, soft.shape), 0, 255).astype(np.uint8)


@functools.cache
def texture(board: Board, per_m: float) -> NDArray[np.uint8]:
    """Picture of a board with a white margin of one square."""
    side = round(board.square_m * per_m)
    if board.kind == "charuco":
        dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
        pattern = cv2.aruco.CharucoBoard(
            (board.across, board.down), board.square_m, board.marker_m, dictionary
        )
        inner = pattern.generateImage((board.across * side, board.down * side))
    else:
        row, col = np.indices((board.down, board.across))
        inner = np.kron(((row + col) % 2 * 215 + 20).astype(np.uint8), np.ones((side, side)))
    out = np.full((inner.shape[0] + 2 * side, inner.shape[1] + 2 * side), 235, np.uint8)
    out[side:-side, side:-side] = np.clip(inner, 20, 235)
    return cv2.blur(out, (5, 5)).astype(np.uint8)


def true_uv(board: Board, pose: Pose, camera: Camera = TRUE) -> Array:
    return camera.project((board.targets().xyz - pose[0]) @ pose[1])


def seen(
    rng: np.random.Generator, n: int, *, noise: float = 0.1, camera: Camera = TRUE,
    tilt: float = 0.6, targets: Targets | None = None,
) -> tuple[Targets, list[View], list[Pose]]:  # fmt: skip
    """Views of a board without pictures: projected corners with noise, px."""
    targets = targets or BOARD.targets()
    views, where = [], poses(rng, n, tilt=tilt)
    for i, (origin, R) in enumerate(where):
        uv = camera.project((targets.xyz - origin) @ R)
        inside = np.all((uv > 2) & (uv < [camera.width - 3, camera.height - 3]), axis=1)
        k = np.flatnonzero(inside)
        uv = uv[k] + noise * rng.standard_normal((len(k), 2))
        views.append(View(id=f"b{i}.jpg", index=k, uv=uv, sigma=np.full(len(k), 1.0)))
    return targets, views, where


def size_of(camera: Camera) -> tuple[int, int]:
    return camera.width, camera.height


def test_without_noise_the_camera_comes_back() -> None:
    targets, views, _ = seen(np.random.default_rng(0), 8, noise=0.0)
    found = calibrate_field("c", size_of(TRUE), targets, views)
    assert found.camera.parameters == pytest.approx(TRUE.parameters, abs=1e-4)
    assert found.left_out == {}
    assert found.marks_left_out == 0


def test_solution_agrees_with_opencv() -> None:
    targets, views, _ = seen(np.random.default_rng(1), 12)
    found = calibrate_field("c", size_of(TRUE), targets, views)
    rms, K, dist, _, _, sd, _, _ = cv2.calibrateCameraExtended(
        [targets.xyz[v.index].astype(np.float32) for v in views],
        [v.uv.astype(np.float32) for v in views],
        size_of(TRUE), None, None,
        criteria=(cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-14),
    )  # fmt: skip
    k1, k2, p1, p2, k3 = dist.ravel()[:5]
    theirs = [K[0, 0], K[1, 1], K[0, 2], K[1, 2], k1, k2, k3, p1, p2]
    ours = [getattr(found.camera, name) for name in BROWN]
    own_sd = np.array([found.sd[name] for name in BROWN])
    assert np.all(np.abs(np.array(ours) - theirs) < 0.02 * own_sd)
    # OpenCV orders fx fy cx cy k1 k2 p1 p2 k3
    their_sd = sd.ravel()[[0, 1, 2, 3, 4, 5, 8, 6, 7]]
    assert own_sd == pytest.approx(their_sd, rel=0.02)
    assert np.sqrt(2 * np.mean(np.square(list(found.rms_px.values())))) == pytest.approx(
        rms, rel=0.05
    )


@pytest.mark.slow
def test_errors_agree_with_the_full_covariance_over_40_calibrations() -> None:
    rng = np.random.default_rng(2)
    squares, single = [], []
    for _ in range(40):
        targets, views, _ = seen(rng, 5)
        found = calibrate_field("c", size_of(TRUE), targets, views)
        e = np.array([getattr(TRUE, n) - getattr(found.camera, n) for n in found.parameters])
        squares.append(e @ np.linalg.solve(found.covariance, e))
        single.append(e / np.sqrt(np.diag(found.covariance)))
    rms = np.sqrt(np.mean(np.square(single), axis=0))
    assert np.all((rms > 0.7) & (rms < 1.4)), rms
    # chi-square of 9 over 40: 9 +- 0.67 (one sigma)
    assert np.mean(squares) == pytest.approx(9.0, abs=2.5)


@pytest.mark.slow
@pytest.mark.parametrize("board", [BOARD, CHARUCO], ids=["chessboard", "charuco"])
def test_corners_of_rendered_photos_are_found_without_a_half_pixel(board: Board) -> None:
    rng = np.random.default_rng(3)
    ideal = ideal_grid(TRUE)
    off = []
    for pose in whole(rng, 3, board, tilt=0.4):
        found = find_corners(rendered(board, pose, ideal, rng), board)
        if found is None:
            continue
        truth = true_uv(board, pose)
        forward = found[1] - truth[found[0]]
        # A chessboard may be read from the other end: then all corners are in reverse order.
        backward = found[1] - truth[::-1][found[0]] if board.kind == "chessboard" else forward
        off.append(min(forward, backward, key=lambda e: float(np.abs(e).max())))
    assert len(off) >= 3
    every = np.concatenate(off)
    assert np.abs(every.mean(axis=0)).max() < 0.03  # px; half a pixel would be 0.5
    assert np.sqrt(np.mean(every**2)) < 0.12  # px


@pytest.mark.slow
@pytest.mark.parametrize("board", [BOARD, CHARUCO], ids=["chessboard", "charuco"])
def test_rendered_photos_give_the_camera(board: Board) -> None:
    rng = np.random.default_rng(4)
    ideal = ideal_grid(TRUE)
    pictures = [rendered(board, pose, ideal, rng) for pose in whole(rng, 8, board, tilt=0.55)]
    pictures.append(np.full_like(pictures[0], 90))
    photos = [BoardPhoto(id=f"{i}", read=lambda p=p: p) for i, p in enumerate(pictures)]
    found = calibrate_board("c", photos, board)
    assert found.left_out["8"] == "the board was not found"
    assert found.camera.fx == pytest.approx(TRUE.fx, rel=2e-3)
    assert found.camera.cx == pytest.approx(TRUE.cx, abs=1.5)  # px
    assert found.camera.cy == pytest.approx(TRUE.cy, abs=1.5)
    rays = TRUE.ray(TRUE.border_uv() * 0.95 + 20)
    # px; where the image is: interior orientation trades against the poses, so rays are compared
    assert np.abs(found.camera.project(rays) - TRUE.project(rays)).max() < 3.0


def outlying(views: list[View], i: int, rng: np.random.Generator) -> list[View]:
    v = views[i]
    bad = replace(v, uv=v.uv + 2.5 * rng.standard_normal(v.uv.shape))
    return [bad if k == i else one for k, one in enumerate(views)]


def test_a_bad_photo_is_left_out_with_its_reason() -> None:
    rng = np.random.default_rng(5)
    targets, views, _ = seen(rng, 10)
    found = calibrate_field("c", size_of(TRUE), targets, outlying(views, 4, rng))
    assert set(found.left_out) == {"b4.jpg"}
    assert "px against" in found.left_out["b4.jpg"]
    assert any("b4.jpg" in d for d in found.doubts)
    assert abs(found.camera.fx - TRUE.fx) < 4 * found.sd["fx"]


def test_single_wrong_marks_are_left_out() -> None:
    rng = np.random.default_rng(6)
    targets, views, _ = seen(rng, 10)
    for i in (1, 3, 8):
        views[i].uv[5] += [12.0, -9.0]
    found = calibrate_field("c", size_of(TRUE), targets, views)
    assert found.marks_left_out == 3
    assert found.left_out == {}
    assert abs(found.camera.fx - TRUE.fx) < 4 * found.sd["fx"]


def test_parallel_photos_leave_the_focal_length_unknown_and_say_so() -> None:
    targets, views, _ = seen(np.random.default_rng(7), 10, tilt=0.0)
    found = calibrate_field("c", size_of(TRUE), targets, views)
    assert any("one tilt" in d for d in found.doubts)
    assert any("focal length is weak" in d for d in found.doubts)
    assert found.sd["fx"] > 10 * 1.0  # px
    # and the sigma covers the error
    assert abs(found.camera.fx - TRUE.fx) < 4 * found.sd["fx"]
    tilted = calibrate_field("c", size_of(TRUE), *seen(np.random.default_rng(7), 10)[:2])
    assert not any("tilt" in d for d in tilted.doubts)


def test_marks_in_the_middle_only_are_reported() -> None:
    targets, views, _ = seen(np.random.default_rng(8), 10)
    middle = []
    for v in views:
        inside = np.all(np.abs(v.uv - [600, 450]) < [220, 170], axis=1)
        middle.append(v.only(inside))
    found = calibrate_field("c", size_of(TRUE), targets, middle)
    assert found.coverage < 0.4
    assert any("cover" in d for d in found.doubts)
    assert max(found.corner_sigma_px) > 1.0  # px


def test_a_bent_board_is_reported_and_freed_by_a_sigma() -> None:
    rng = np.random.default_rng(9)
    bent = BOARD.targets()
    x = bent.xyz[:, 0] / 0.27
    shape = replace(bent, xyz=bent.xyz + np.column_stack([0 * x, 0 * x, 0.002 * np.sin(np.pi * x)]))
    _, views, _ = seen(rng, 14, targets=shape)
    flat = calibrate_field("c", size_of(TRUE), bent, views)
    assert any("bent board" in d for d in flat.doubts)
    loose = replace(bent, sigma=np.full((len(x), 3), 0.001))
    freed = calibrate_field("c", size_of(TRUE), loose, views)
    assert freed.sigma0 < 0.13  # px, the noise is 0.1
    assert flat.sigma0 > 2 * freed.sigma0


def test_a_field_in_space_is_calibrated_with_unsure_targets() -> None:
    rng = np.random.default_rng(10)
    xyz = rng.uniform([-0.3, -0.25, -0.08], [0.57, 0.43, 0.12], (90, 3))
    sigma = 5e-5
    exact = Targets(xyz=xyz, sigma=np.zeros((90, 3)), names=tuple(map(str, range(90))))
    _, views, _ = seen(rng, 6, targets=exact)
    given = replace(
        exact, xyz=xyz + sigma * rng.standard_normal(xyz.shape), sigma=np.full((90, 3), sigma)
    )
    sharp = [replace(v, sigma=np.full(len(v.index), 0.1)) for v in views]
    settings = CalibrationSettings(sigma_px=0.1)
    found = calibrate_field("c", size_of(TRUE), given, sharp, settings)
    e = np.array([getattr(TRUE, n) - getattr(found.camera, n) for n in found.parameters])
    assert e @ np.linalg.solve(found.covariance, e) < 27.9  # chi-square of 9, 99.9 %
    assert found.sigma0 == pytest.approx(1.0, abs=0.15)
    one = calibrate_field("c", size_of(TRUE), exact, views[:1])
    assert abs(one.camera.fx - TRUE.fx) < 4 * one.sd["fx"]


def test_a_fisheye_is_calibrated() -> None:
    true = Camera(
        id="f", width=1200, height=900, fx=420.0, fy=421.0, cx=603.0, cy=447.0, model="fisheye",
        k1=0.03, k2=-0.01, k3=0.002, k4=0.0,
    )  # fmt: skip
    rng = np.random.default_rng(11)
    wide = Board(across=10, down=7, square_m=0.08).targets()
    views = []
    for i, (_, R) in enumerate(poses(rng, 12)):
        uv = true.project((wide.xyz - ([0.36, 0.24, 0] - R[:, 2] * rng.uniform(0.3, 0.5))) @ R)
        k = np.flatnonzero(np.all((uv > 2) & (uv < [1197, 897]), axis=1))
        uv = uv[k] + 0.1 * rng.standard_normal((len(k), 2))
        views.append(View(id=str(i), index=k, uv=uv, sigma=np.ones(len(k))))
    found = calibrate_field("f", (1200, 900), wide, views, CalibrationSettings(lens="fisheye"))
    for name, sd in found.sd.items():
        assert abs(getattr(found.camera, name) - getattr(true, name)) < 4 * sd, name
    assert found.sigma0 == pytest.approx(0.1, rel=0.1)


def calibrated() -> Calibration:
    targets, views, _ = seen(np.random.default_rng(12), 9)
    return calibrate_field("MyCam 12mm", size_of(TRUE), targets, views)


def test_the_snippet_pasted_into_project_toml_is_the_camera() -> None:
    found = calibrated()
    section = tomllib.loads(toml_snippet(found))["camera"]
    again = camera_for({}, size_of(TRUE), override=CameraOverride(**section)).camera
    rays = TRUE.ray(TRUE.border_uv() * 0.98)
    assert np.abs(again.project(rays) - found.camera.project(rays)).max() < 1e-3  # px
    assert again.sigma_f == pytest.approx(found.camera.sigma_f, rel=1e-3)
    assert again.sigma_c == pytest.approx(found.camera.sigma_c, rel=1e-3)


def test_the_json_holds_covariance_and_doubts() -> None:
    found = calibrated()
    told = json.loads(json.dumps(json_account(found), allow_nan=False))
    assert told["order"] == list(BROWN)
    assert np.array(told["covariance"]) == pytest.approx(found.covariance)
    assert set(told["rms_px"]) == {f"b{i}.jpg" for i in range(9)}


def test_unusable_input_is_refused_in_one_line() -> None:
    targets, views, _ = seen(np.random.default_rng(13), 4)
    with pytest.raises(AdjustmentError, match="3 are needed"):
        calibrate_field("c", size_of(TRUE), targets, views[:2])
    blank = BoardPhoto(id="x", read=lambda: np.zeros((400, 600), np.uint8))
    with pytest.raises(AdjustmentError, match="not inner corners"):
        calibrate_board("c", [blank], BOARD)
    other = BoardPhoto(id="y", read=lambda: np.zeros((300, 600), np.uint8))
    with pytest.raises(InputError, match="photo y"):
        calibrate_board("c", [blank, other], BOARD)
    with pytest.raises(InputError, match="smaller than the square"):
        Board(kind="charuco", across=9, down=7, square_m=0.03, marker_m=0.03)
