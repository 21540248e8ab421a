"""Interior orientation from pixels to millimetres, and there and back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from georef_gis.errors import InputError
from georef_gis.model.camera import Camera
from georef_gis.model.photo_mm import InteriorOrientationMm, camera_from_mm, mm_from_camera

TABLE_3 = InteriorOrientationMm(
    width=5616, height=3744, sensor_mm=(36.0, 24.0), c=20.6478, xp=-0.0819, yp=-0.0792,
    K1=2.38021e-4, K2=-4.75072e-7, K3=5.80760e-11, P1=1.0121e-5, P2=2.7671e-6,
)  # fmt: skip
PIXELS = Camera(
    id="p", width=4000, height=3000, fx=3012.0, fy=3009.0, cx=2011.0, cy=1487.0,
    k1=-0.02, k2=0.006, p1=2e-4, p2=-3e-4, b2=0.7,
)  # fmt: skip
PLACES = [(0, 0), (3999, 2999), (3999, 0), (0, 2999), (2000, 1500), (700, 2500), (3100, 400)]


def ideal_by_hand(m: InteriorOrientationMm, u: float, v: float) -> tuple[float, float]:
    """(x right, y down) / c of one pixel by the formulas of the paper, written out here."""
    x = (u - (m.width - 1) / 2) * m.sensor_mm[0] / m.width - m.xp
    y = ((m.height - 1) / 2 - v) * m.sensor_mm[1] / m.height - m.yp
    r2 = x * x + y * y
    k = m.K1 * r2 + m.K2 * r2**2 + m.K3 * r2**3
    X = x * (1 + k) + m.P1 * (r2 + 2 * x * x) + 2 * m.P2 * x * y + m.B1 * x + m.B2 * y
    Y = y * (1 + k) + m.P2 * (r2 + 2 * y * y) + 2 * m.P1 * x * y
    return X / m.c, -Y / m.c


@pytest.mark.parametrize("camera", [PIXELS, replace(PIXELS, k1=0.015, k2=0.0)], ids=["in", "out"])
def test_the_calibration_in_mm_sees_the_cameras_rays(camera: Camera) -> None:
    m = mm_from_camera(camera, (24.0, 18.0))
    for u, v in PLACES:
        ray = camera.ray([float(u), float(v)])
        x, y = ideal_by_hand(m, u, v)
        off = np.array([x - ray[0] / ray[2], y - ray[1] / ray[2]]) * camera.fx
        assert np.hypot(*off) < 0.05  # px


def test_table_3_goes_there_and_back() -> None:
    back = mm_from_camera(camera_from_mm("5d", TABLE_3), TABLE_3.sensor_mm)
    for name, tolerance in [
        ("c", 1e-6), ("xp", 1e-6), ("yp", 1e-6), ("K1", 1e-10), ("K2", 1e-13), ("K3", 1e-15),
        ("P1", 1e-9), ("P2", 1e-9), ("B1", 1e-8), ("B2", 1e-8),
    ]:  # fmt: skip
        assert getattr(back, name) == pytest.approx(getattr(TABLE_3, name), abs=tolerance), name


@pytest.mark.parametrize("change", [{"B1": 2e-4, "B2": -1e-4}, {"P1": -2e-5, "P2": 3e-5}, {}])
def test_round_trip_holds_to_a_twentieth_of_a_pixel(change: dict[str, float]) -> None:
    m = replace(TABLE_3, c=35.0, K1=4e-6, K2=-2e-9, K3=0.0, **change)
    back = mm_from_camera(camera_from_mm("c", m), m.sensor_mm)
    for u, v in [(0, 0), (5615, 3743), (5615, 0), (0, 3743), (2000, 900)]:
        off = np.subtract(ideal_by_hand(m, u, v), ideal_by_hand(back, u, v))
        # each way may take 0.05 px
        assert np.hypot(*off) * 35.0 / 36.0 * 5616 < 0.1


def test_what_has_no_form_in_mm_is_refused() -> None:
    with pytest.raises(InputError, match="fisheye"):
        mm_from_camera(replace(PIXELS, model="fisheye"), (24.0, 18.0))
    with pytest.raises(InputError, match="turns back"):
        mm_from_camera(replace(PIXELS, k1=-0.9, k2=0.0), (24.0, 18.0))
    with pytest.raises(InputError, match="off by"):
        # a sensor of another shape than the image
        mm_from_camera(PIXELS, (23.5, 15.6))
