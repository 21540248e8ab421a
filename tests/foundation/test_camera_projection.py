"""Camera against OpenCV, by hand, and against turning the picture itself."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from georef_gis.errors import InputError
from georef_gis.frames import exp_so3
from georef_gis.model.camera import Camera

BROWN = Camera(
    id="rebel",
    width=1296,
    height=864,
    fx=1043.4,
    fy=1041.0,
    cx=657.1,
    cy=424.3,
    k1=-0.162,
    k2=0.108,
    k3=-0.021,
    p1=0.0006,
    p2=-0.0004,
)
FISHEYE = Camera(
    id="fish", model="fisheye", width=4000, height=3000, fx=1780.0, fy=1779.0, cx=1990.0,
    cy=1510.0, k1=0.041, k2=-0.012, k3=0.006, k4=-0.002,
)  # fmt: skip
# Parrot Sequoia, NIR: FisheyePolynomial, FisheyeAffineMatrix and PrincipalPoint of its XMP; px/mm
SEQUOIA = Camera(
    id="sequoia",
    model="fisheye_pix4d",
    width=1280,
    height=960,
    fx=1671.556624069,
    fy=1671.556624069,
    cx=2.544297 * 266.6666559 - 0.5,
    cy=1.797905 * 266.6666559 - 0.5,
    poly=(0.010754389, -0.147354298),
)
CAMERAS = [BROWN, FISHEYE, SEQUOIA]


def by_id(camera: object) -> str:
    return camera.id if isinstance(camera, Camera) else str(camera)


def matrix(camera: Camera) -> np.ndarray:
    return np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1.0]])


def picture(camera: Camera, n: int = 400) -> np.ndarray:
    rng = np.random.default_rng(7)
    return rng.uniform([-0.5, -0.5], [camera.width - 0.5, camera.height - 0.5], size=(n, 2))


def points_ahead(n: int = 300) -> np.ndarray:
    rng = np.random.default_rng(8)
    return rng.uniform([-40, -28, 60], [40, 28, 90], size=(n, 3))


def test_brown_is_opencvs_project_points() -> None:
    p = points_ahead()
    d = np.array([BROWN.k1, BROWN.k2, BROWN.p1, BROWN.p2, BROWN.k3])
    theirs = cv2.projectPoints(p, np.zeros(3), np.zeros(3), matrix(BROWN), d)[0].reshape(-1, 2)
    assert BROWN.project(p) == pytest.approx(theirs, abs=1e-8)  # px


def test_rays_are_opencvs_undistort_points() -> None:
    uv = picture(BROWN)
    d = np.array([BROWN.k1, BROWN.k2, BROWN.p1, BROWN.p2, BROWN.k3])
    stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-14)
    if hasattr(cv2, "undistortPointsIter"):  # OpenCV 4
        theirs = cv2.undistortPointsIter(uv[:, None], matrix(BROWN), d, None, None, stop)
    else:
        theirs = cv2.undistortPoints(uv[:, None], matrix(BROWN), d, criteria=stop)
    theirs = theirs.reshape(-1, 2)
    ray = BROWN.ray(uv)
    assert ray[:, :2] / ray[:, 2:] == pytest.approx(theirs, abs=1e-9)


def test_fisheye_is_opencvs() -> None:
    p = points_ahead() * [2.5, 2.5, 1.0]
    d = np.array([FISHEYE.k1, FISHEYE.k2, FISHEYE.k3, FISHEYE.k4])
    theirs = cv2.fisheye.projectPoints(p[:, None], np.zeros(3), np.zeros(3), matrix(FISHEYE), d)
    assert FISHEYE.project(p) == pytest.approx(theirs[0].reshape(-1, 2), abs=1e-7)  # px


@pytest.mark.parametrize("camera", CAMERAS, ids=by_id)
def test_rays_and_pixels_are_inverse(camera: Camera) -> None:
    uv = picture(camera)
    ray = camera.ray(uv)
    assert np.linalg.norm(ray, axis=-1) == pytest.approx(np.ones(len(uv)), abs=1e-12)
    assert camera.project(37.0 * ray) == pytest.approx(uv, abs=1e-6)  # px


@pytest.mark.parametrize("camera", CAMERAS, ids=by_id)
def test_the_axis_meets_the_principal_point(camera: Camera) -> None:
    assert camera.project([0, 0, 50.0]) == pytest.approx([camera.cx, camera.cy], abs=1e-9)
    assert camera.ray([camera.cx, camera.cy]) == pytest.approx([0, 0, 1], abs=1e-12)


def test_pinhole_by_hand() -> None:
    camera = Camera(id="p", width=100, height=80, fx=100, fy=50, cx=49.5, cy=39.5)
    # 1 m right, 2 m down, 10 m ahead
    assert camera.project([1, 2, 10]) == pytest.approx([59.5, 49.5], abs=1e-12)


def test_sequoia_by_hand() -> None:
    """45 deg: t = 0.5, rho = 0.5 + 0.010754389 / 4 - 0.147354298 / 8 = 0.48426931."""
    u, v = SEQUOIA.project([1.0, 0.0, 1.0])
    assert u - SEQUOIA.cx == pytest.approx(1671.556624069 * 0.484269310, abs=1e-5)
    assert v == pytest.approx(SEQUOIA.cy, abs=1e-9)
    # C * 2 / pi is the focal length on the axis: 1064 px, 3.98 mm at 3.75 um
    slope = (SEQUOIA.project([1e-4, 0, 1.0])[0] - SEQUOIA.cx) / 1e-4
    assert slope == pytest.approx(1064.15, abs=0.1)


def test_affinity_and_skew_of_metashape() -> None:
    camera = Camera(id="b", width=100, height=80, fx=100, fy=100, cx=50, cy=40, b1=2.0, b2=3.0)
    assert camera.project([0.1, 0.2, 1.0]) == pytest.approx([50 + 10.2 + 0.6, 60], abs=1e-12)
    assert camera.ray([60.8, 60.0])[:2] / camera.ray([60.8, 60.0])[2] == pytest.approx([0.1, 0.2])


@pytest.mark.parametrize("p", [[0, 0, -5.0], [1, 1, 0.0]], ids=["behind", "beside"])
def test_brown_sees_nothing_behind(p: list) -> None:
    assert np.all(np.isnan(BROWN.project(p)))


def test_the_polynomial_does_not_fold_the_outside_back() -> None:
    camera = Camera(id="f", width=1000, height=800, fx=800, fy=800, cx=500, cy=400, k1=-0.3)
    # Grows up to r = 1 / sqrt(0.9) = 1.054; beyond it would come back into the picture.
    assert np.all(np.isfinite(camera.project([1.05, 0, 1])))
    assert np.all(np.isnan(camera.project([1.06, 0, 1])))
    # px 500 + 800 * 1.054 * (2 / 3) = 1062 is the outermost: nothing maps further out
    assert np.all(np.isnan(camera.ray([1100.0, 400.0])))


def test_fisheye_sees_beyond_a_right_angle() -> None:
    direction = [math.sin(1.8), 0, math.cos(1.8)]
    assert FISHEYE.ray(FISHEYE.project(direction)) == pytest.approx(direction, abs=1e-9)


@given(st.sampled_from([90, 180, 270, 360, -90]), st.sampled_from([BROWN, SEQUOIA, FISHEYE]))
def test_turned_camera_is_the_turned_picture(degrees: int, camera: Camera) -> None:
    """Turning the pixels clockwise is the same as turning the camera the other way about its axis.

    Image up of the scene then points to the right: new axes x' = -y, y' = x at 90 deg.
    """
    p = points_ahead(40) * [0.4, 0.4, 1.0]
    turned = camera.turned(degrees)
    uv = camera.project(p)
    w, h = camera.width, camera.height
    for _ in range(degrees // 90 % 4):
        uv = np.column_stack([h - 1 - uv[:, 1], uv[:, 0]])
        w, h = h, w
    assert (turned.width, turned.height) == (w, h)
    R_turned_from_cam = exp_so3([0, 0, math.radians(degrees)])
    assert turned.project(p @ R_turned_from_cam.T) == pytest.approx(uv, abs=1e-8)  # px


def test_turned_camera_is_numpys_rot90() -> None:
    """The pixel of a lit point moves as `rot90` moves it."""
    image = np.zeros((BROWN.height, BROWN.width), bool)
    image[100, 300] = True
    (v,), (u,) = np.nonzero(np.rot90(image, -1))  # clockwise
    ray = BROWN.ray([300.0, 100.0])
    assert BROWN.turned(90).project(exp_so3([0, 0, math.pi / 2]) @ ray) == pytest.approx(
        [u, v], abs=1e-8
    )


def test_half_a_turn_keeps_the_skew_and_a_quarter_refuses_it() -> None:
    camera = Camera(id="s", width=100, height=80, fx=100, fy=90, cx=48, cy=41, b1=2.0, b2=0.5)
    uv = camera.project([0.1, -0.2, 1.0])
    assert camera.turned(180).project([-0.1, 0.2, 1.0]) == pytest.approx([99, 79] - uv, abs=1e-9)
    with pytest.raises(InputError, match="90 deg"):
        camera.turned(90)
    with pytest.raises(InputError, match="45 deg"):
        BROWN.turned(45)


def test_corners_and_border_go_round_clockwise() -> None:
    corners = BROWN.corners_uv
    assert np.array_equal(corners[0], [-0.5, -0.5])
    assert np.array_equal(corners[2], [1295.5, 863.5])
    border = BROWN.border_uv(4)
    assert border.shape == (16, 2)
    assert np.array_equal(border[::4], corners)


def test_parameters_stand_in_the_agreed_order() -> None:
    assert BROWN.parameters == pytest.approx(
        [1043.4, 1041.0, 657.1, 424.3, -0.162, 0.108, -0.021, 0.0006, -0.0004, 0, 0]
    )


def test_an_unknown_model_is_refused_by_name() -> None:
    with pytest.raises(InputError, match="'kannala'"):
        Camera(id="k", width=10, height=10, fx=5, fy=5, cx=5, cy=5, model="kannala")  # type: ignore[arg-type]


@pytest.mark.parametrize("bad", [{"fx": 0.0}, {"fx": float("nan")}, {"width": 0}])
def test_impossible_values_are_refused(bad: dict) -> None:
    good = {"id": "c", "width": 10, "height": 10, "fx": 5.0, "fy": 5.0, "cx": 5.0, "cy": 5.0}
    with pytest.raises(ValueError):
        Camera(**{**good, **bad})
