"""Many photos at once see what each of them sees alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import geometry_cases as cases
import numpy as np
import pytest

from georef_gis.frames import exp_so3
from georef_gis.model.camera import Camera
from georef_gis.model.photo import OrientedPhoto
from georef_gis.model.photo_stack import PhotoStack
from georef_gis.model.pixel_derivatives import (
    CAMERA_NAMES,
    camera_jacobian,
    turned_camera_jacobian,
)

FISHEYE = Camera(
    id="fish", width=1000, height=1000, fx=420.0, fy=420.0, cx=499.5, cy=499.5, model="fisheye",
    k1=0.02, k2=-0.004,
)  # fmt: skip
MOTION = {"velocity_enu": np.array([14.0, 5.0, 0.5]), "rate_enu": np.array([0.02, -0.05, 0.1])}


def named(photo: OrientedPhoto, name: str) -> OrientedPhoto:
    return replace(photo, photo=replace(photo.photo, id=name, path=Path(name)))


@pytest.fixture
def photos() -> list[OrientedPhoto]:
    """Three cameras, one of them with a rolling shutter."""
    return [
        named(cases.oriented((3.0, -5.0, 70.0)), "a"),
        named(cases.oriented((1.0, 4.0, -20.0), (15.0, 4.0, 58.0), cases.rolling(0.06), **MOTION),
              "b"),
        named(cases.oriented((-2.0, 1.0, 200.0), (-9.0, 12.0, 61.0), FISHEYE), "c"),
    ]  # fmt: skip


@pytest.fixture
def pairs(photos: list[OrientedPhoto]) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(4)
    k = rng.integers(0, len(photos), 60)
    p = np.column_stack([rng.uniform(-15, 15, (60, 2)), rng.uniform(-2, 5, 60)])
    return k, p


def test_pixels_and_rays_are_those_of_each_photo(
    photos: list[OrientedPhoto], pairs: tuple[np.ndarray, np.ndarray]
) -> None:
    k, p = pairs
    stack = PhotoStack.of(photos)
    uv = stack.project(k, p)
    alone = np.array([photos[i].project(one) for i, one in zip(k, p, strict=True)])
    # px; where the rows of a rolling shutter have settled
    np.testing.assert_allclose(uv, alone, atol=1e-6)
    start, way = stack.rays(k, uv)
    for i, one in enumerate(k):
        o, d = photos[one].rays(uv[i])
        np.testing.assert_allclose(start[i], o, atol=1e-9)
        np.testing.assert_allclose(way[i], d, atol=1e-12)
    inside = [bool(photos[i].contains(one)) for i, one in zip(k, uv, strict=True)]
    np.testing.assert_array_equal(stack.contains(k, uv), inside)


def test_derivatives_are_those_of_the_pixels(
    photos: list[OrientedPhoto], pairs: tuple[np.ndarray, np.ndarray]
) -> None:
    k, p = pairs
    views = PhotoStack.of(photos).views(k, p)
    for column, h in enumerate([1e-3, 1e-3, 1e-3, 1e-5, 1e-5, 1e-5]):
        ends = []
        for sign in (1.0, -1.0):
            step = sign * h * np.eye(6)[column]
            moved = [
                replace(
                    one,
                    pose=replace(
                        one.pose,
                        origin_enu=one.pose.origin_enu + step[:3],
                        R_enu_from_cam=exp_so3(step[3:]) @ one.pose.R_enu_from_cam,
                    ),
                )
                for one in photos
            ]
            ends.append(PhotoStack.of(moved).project(k, p))
        slope = (ends[0] - ends[1]) / (2 * h)
        # of the largest: 1e-6 by the steps, 3 % where rows move while they are read
        share = np.where(k == 1, 0.03, 1e-5) * np.abs(slope).max()
        assert np.all(np.abs(views.by_pose[:, :, column] - slope).max(axis=1) < share)
    np.testing.assert_allclose(views.by_point, -views.by_pose[:, :, :3], atol=1e-12)


@pytest.mark.parametrize("name", CAMERA_NAMES)
def test_derivatives_by_the_camera_are_those_of_the_pixels(
    photos: list[OrientedPhoto], pairs: tuple[np.ndarray, np.ndarray], name: str
) -> None:
    k, p = pairs
    views = PhotoStack.of(photos).views(k, p)
    h = {"f": 0.1, "cx": 0.1, "cy": 0.1, "b1": 0.1, "b2": 0.1}.get(name, 1e-5)

    def moved(one: OrientedPhoto, d: float) -> OrientedPhoto:
        c = one.camera
        if name == "f":
            return replace(one, camera=replace(c, fx=c.fx + d, fy=c.fy + d))
        return replace(one, camera=replace(c, **{name: getattr(c, name) + d}))

    # a shutter that is read for no time has no rows of its own: that camera is known to have none
    seen = k == 1 if name == "readout_s" else np.ones(len(k), dtype=bool)
    ends = [PhotoStack.of([moved(one, d) for one in photos]).project(k, p) for d in (h, -h)]
    slope = ((ends[0] - ends[1]) / (2 * h))[seen]
    found = views.by_camera[seen][:, :, CAMERA_NAMES.index(name)]
    if name in ("p1", "p2"):
        slope[k[seen] == 2] = 0.0  # no term of a fisheye
    largest = max(np.abs(slope).max(), 1e-9)
    np.testing.assert_allclose(found, slope, atol=0.03 * largest)


@pytest.mark.parametrize("quarters", [0, 1, 2, 3])
def test_a_turned_picture_hangs_on_its_sensor(quarters: int) -> None:
    """Moving the sensor's parameters moves those of the turned camera as the matrix says."""
    sensor = replace(cases.CAMERA, b1=1.5)
    p = np.array([[10.0, -7.0, 60.0], [-20.0, 12.0, 55.0]])
    # camera axes of the turned picture: its right was up, down ...
    turn = np.linalg.matrix_power(np.array([[0.0, 1.0, 0], [-1.0, 0, 0], [0, 0, 1.0]]), quarters)
    turned = sensor.turned(90 * quarters)
    by_sensor = camera_jacobian(turned, p) @ turned_camera_jacobian(quarters)
    for name in ("f", "cx", "cy", "k1", "k2", "p1", "p2", "b1"):
        h = 1e-6 if name[0] in "kp" else 1e-3
        change = {"fx": sensor.fx + h, "fy": sensor.fy + h} if name == "f" else {}
        change = change or {name: getattr(sensor, name) + h}
        moved = replace(sensor, **change).turned(90 * quarters)
        slope = (moved.project(p) - turned.project(p)) / h
        found = by_sensor[:, :, CAMERA_NAMES.index(name)]
        np.testing.assert_allclose(found, slope, atol=1e-3 * max(1.0, np.abs(slope).max()))
    # and the turned camera is the sensor's: the same point, its pixel turned
    seen, once = turned.project(p), sensor.project(p @ turn.T)
    for i in range(quarters):
        size = sensor.height if i % 2 == 0 else sensor.width
        once = np.stack([size - 1 - once[:, 1], once[:, 0]], axis=1)
    np.testing.assert_allclose(seen, once, atol=1e-6)
