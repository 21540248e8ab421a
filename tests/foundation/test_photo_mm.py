"""Interior orientation in mm, measured to ideal, y up: the 2012 paper's Table 3."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from georef_gis.errors import InputError
from georef_gis.model.camera import Camera
from georef_gis.model.photo_mm import InteriorOrientationMm, camera_from_mm

# EOS 5D Mark II, 36 x 24 mm
TABLE_3 = InteriorOrientationMm(
    width=5616,
    height=3744,
    sensor_mm=(36.0, 24.0),
    c=20.6478,
    xp=-0.0819,
    yp=-0.0792,
    K1=2.38021e-4,
    K2=-4.75072e-7,
    K3=5.80760e-11,
    P1=1.0121e-5,
    P2=2.7671e-6,
)
GENTLE = replace(TABLE_3, c=50.0, K1=1.5e-6, K2=-1e-9, K3=0.0, P1=2e-6, P2=-3e-6)


def by_hand(m: InteriorOrientationMm, u: float, v: float) -> tuple[float, float]:
    """Ideal (x right, y down) / c of one pixel, written out once more."""
    x = (u - (m.width - 1) / 2) * m.sensor_mm[0] / m.width - m.xp
    y = -(v - (m.height - 1) / 2) * m.sensor_mm[1] / m.height - m.yp
    r = float(np.hypot(x, y))
    dr = m.K1 * r**2 + m.K2 * r**4 + m.K3 * r**6
    X = x + x * dr + m.P1 * (r**2 + 2 * x**2) + 2 * m.P2 * x * y + m.B1 * x + m.B2 * y
    Y = y + y * dr + m.P2 * (r**2 + 2 * y**2) + 2 * m.P1 * x * y
    return X / m.c, -Y / m.c


def corner_shift(camera: Camera, corner: np.ndarray) -> float:
    """How far outward, px, a corner lies once corrected."""
    ideal = camera.ray(corner)[:2] / camera.ray(corner)[2] * [camera.fx, camera.fy]
    measured = corner - [camera.cx, camera.cy]
    return float(np.hypot(*ideal) - np.hypot(*measured))


def test_table_3_moves_the_corners_about_42_px_outward() -> None:
    camera = camera_from_mm("5d", TABLE_3)
    shifts = [corner_shift(camera, corner) for corner in camera.corners_uv]
    assert shifts == pytest.approx([42.0] * 4, abs=4.0)  # px; K1..K3 alone give 44.9


@pytest.mark.parametrize(
    "calibration",
    [TABLE_3, GENTLE, replace(GENTLE, B1=1e-4, B2=-5e-5)],
    ids=["table-3", "gentle", "affinity"],
)
def test_the_camera_sees_what_the_calibration_says(calibration: InteriorOrientationMm) -> None:
    camera = camera_from_mm("5d", calibration)
    for u, v in [(0, 0), (5615, 3743), (5615, 0), (2800, 1900), (700, 3000)]:
        x, y = by_hand(calibration, u, v)
        assert camera.project([x, y, 1.0]) == pytest.approx([u, v], abs=0.05)  # px
        ray = camera.ray([float(u), float(v)])
        assert ray[:2] / ray[2] == pytest.approx([x, y], abs=0.05 / camera.fx)


def test_table_3_keeps_its_own_direction_and_a_gentle_lens_is_fitted() -> None:
    # No Brown polynomial of OpenCV's direction comes nearer to Table 3 than 2.1 px.
    assert camera_from_mm("5d", TABLE_3).model == "brown_inverse"
    assert camera_from_mm("5d", GENTLE).model == "brown"


def test_y_is_up_and_the_principal_point_with_it() -> None:
    camera = camera_from_mm("5d", replace(TABLE_3, K1=0, K2=0, K3=0, P1=0, P2=0))
    # px: 0.0819 mm is 12.78 px to the left, 0.0792 mm is 12.36 px below the middle
    assert camera.cx - 2807.5 == pytest.approx(-12.776, abs=1e-3)
    assert camera.cy - 1871.5 == pytest.approx(+12.355, abs=1e-3)
    assert camera.fx == pytest.approx(20.6478 / 36 * 5616, abs=1e-6)


def test_positive_k1_corrects_outward_so_opencvs_is_negative() -> None:
    camera = camera_from_mm("5d", replace(GENTLE, K1=2e-6, K2=0.0))
    assert camera.model == "brown"
    assert camera.k1 < 0


@pytest.mark.parametrize("degrees", [90, 180, 270])
def test_the_inverse_model_can_be_turned(degrees: int) -> None:
    camera = camera_from_mm("5d", TABLE_3)
    uv = np.array([[100.0, 200.0]])
    turned_uv = uv
    for _ in range(degrees // 90):
        turned_uv = np.column_stack([turned_uv[:, 1] * 0 - turned_uv[:, 1], turned_uv[:, 0]])
    w, h = camera.width - 1, camera.height - 1
    turned_uv = turned_uv + {90: [h, 0], 180: [w, h], 270: [0, w]}[degrees]
    a, b = camera.ray(uv)[0], camera.turned(degrees).ray(turned_uv)[0]
    angle = np.arctan2(b[1], b[0]) - np.arctan2(a[1], a[0])
    assert a[2] == pytest.approx(b[2], abs=1e-9)
    assert np.degrees(angle) % 360 == pytest.approx(degrees, abs=1e-6)


def test_a_calibration_in_other_units_is_refused() -> None:
    # K1 for metres or for a wrong sign folds the sensor back.
    with pytest.raises(InputError, match="mm"):
        camera_from_mm("5d", replace(TABLE_3, K1=-2.4e-3))
    with pytest.raises(InputError, match="positive"):
        replace(TABLE_3, c=0.0)
