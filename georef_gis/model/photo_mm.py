"""Interior orientation in millimetres, from measured to ideal image coordinates, y up."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from georef_gis.errors import InputError
from georef_gis.frames import Array
from georef_gis.model.camera import Camera, CameraModel

# px; a converted camera may differ from the calibration by this much anywhere on the sensor
FIT_TOLERANCE = 0.05
# places along each side of the sensor at which the fit is made and checked
NODES = 25


@dataclass(frozen=True, slots=True, kw_only=True)
class InteriorOrientationMm:
    """Calibration as Australis and the 2012 paper write it: mm, x right, y up.

    With x = x_measured - xp, y = y_measured - yp, r^2 = x^2 + y^2:

    - ideal x = x + x (K1 r^2 + K2 r^4 + K3 r^6) + P1 (r^2 + 2 x^2) + 2 P2 x y + B1 x + B2 y,
    - ideal y = y + y (K1 r^2 + K2 r^4 + K3 r^6) + P2 (r^2 + 2 y^2) + 2 P1 x y,

    and the ray runs through (ideal x, ideal y, -c) in the axes of `photo`.

    Notes
    -----
    Chiang, Tsai, Chu (2012), "The Development of an UAV Borne Direct Georeferenced
    Photogrammetric Platform for GCP Free Applications", Table 3; Fraser (1997), "Digital camera
    self-calibration".
    """

    width: int
    height: int
    sensor_mm: tuple[float, float]
    c: float
    xp: float = 0.0
    yp: float = 0.0
    K1: float = 0.0
    K2: float = 0.0
    K3: float = 0.0
    P1: float = 0.0
    P2: float = 0.0
    B1: float = 0.0
    B2: float = 0.0

    def __post_init__(self) -> None:
        """Check ranges once."""
        if min(self.width, self.height) < 1 or min(*self.sensor_mm, self.c) <= 0:
            raise InputError(
                f"sensor {self.sensor_mm} mm, {self.width} x {self.height} px and principal "
                f"distance {self.c} mm must be positive",
                field="camera",
            )

    @property
    def pitch_mm(self) -> tuple[float, float]:
        """Width and height of a pixel, mm."""
        return self.sensor_mm[0] / self.width, self.sensor_mm[1] / self.height

    def measured_mm(self, uv: Array) -> Array:
        """Image coordinates from the middle of the sensor, mm, y up, of pixels; (..., 2)."""
        middle = np.array([(self.width - 1) / 2.0, (self.height - 1) / 2.0])
        return np.asarray((uv - middle) * np.array(self.pitch_mm) * [1.0, -1.0])

    def ideal_mm(self, xy_measured: Array) -> Array:
        """Ideal coordinates from the principal point, mm, y up, of measured ones; (..., 2)."""
        x, y = xy_measured[..., 0] - self.xp, xy_measured[..., 1] - self.yp
        r2 = x * x + y * y
        radial = r2 * (self.K1 + r2 * (self.K2 + r2 * self.K3))
        dx = x * radial + self.P1 * (r2 + 2.0 * x * x) + 2.0 * self.P2 * x * y
        dy = y * radial + self.P2 * (r2 + 2.0 * y * y) + 2.0 * self.P1 * x * y
        return np.stack([x + dx + self.B1 * x + self.B2 * y, y + dy], axis=-1)

    def ideal_normalised(self, uv: Array) -> Array:
        """Points of the plane z = 1 in camera axes (y down) that pixels see; (..., 2)."""
        return np.asarray(self.ideal_mm(self.measured_mm(uv)) / self.c * [1.0, -1.0])


def camera_from_mm(camera_id: str, calibration: InteriorOrientationMm) -> Camera:
    """Camera of a calibration in mm: fitted in OpenCV's direction, or kept in its own.

    A `brown` camera is fitted over the whole sensor; where it differs by more than
    `FIT_TOLERANCE` the calibration's own direction is kept (`brown_inverse`).

    Raises
    ------
    InputError
        If neither way reproduces it: its polynomial turns back within the sensor, or its
        affinity is no longer small.
    """
    uv = _sensor_places(calibration)
    ideal = calibration.ideal_normalised(uv)
    direct = _in_own_direction(camera_id, calibration)
    worst = _largest_error(direct, uv, ideal)
    fitted = _fit_brown(replace(direct, model="brown"), uv, ideal)
    error = _largest_error(fitted, uv, ideal)
    if error <= FIT_TOLERANCE:
        return replace(fitted, notes=(f"fitted to a calibration in mm to {error:.3f} px",))
    if worst <= FIT_TOLERANCE:
        return replace(direct, notes=("a calibration in mm, kept from measured to ideal",))
    raise InputError(
        f"the calibration in mm can be reproduced to {min(error, worst):.2f} px only; check the "
        "sensor's size and the signs and units of K1, K2, K3 (mm)",
        source=f"camera {camera_id}",
        field="K1",
    )


def mm_from_camera(camera: Camera, sensor_mm: tuple[float, float]) -> InteriorOrientationMm:
    """Calibration in mm of a camera: fitted from measured to ideal over the whole sensor.

    Parameters
    ----------
    camera
        Of a model with a plane (`brown`, `brown_inverse`).
    sensor_mm
        Width and height of the part of the sensor that the image shows, mm.

    Raises
    ------
    InputError
        If the camera is a fisheye, sees no ray in a part of the sensor, or no calibration in mm
        comes within `FIT_TOLERANCE` of it.

    Notes
    -----
    Least squares by Gauss-Newton: the offset of the principal point is not linear.
    """
    source = f"camera {camera.id}"
    if camera.model not in ("brown", "brown_inverse"):
        raise InputError(
            f"a {camera.model} lens has no calibration in mm of this form; keep it in pixels",
            source=source,
            field="model",
        )
    start = _as_mm(camera, sensor_mm)
    uv = _sensor_places(start)
    rays = camera.ray(uv)
    if not np.all(np.isfinite(rays)):
        raise InputError(
            "its distortion turns back within the image; check k1, k2, k3",
            source=source,
            field="k1",
        )
    ideal = rays[:, :2] / rays[:, 2:]
    fitted = _fit_mm(start, uv, ideal)
    # px of the photo, at the scale of the middle
    off = (fitted.ideal_normalised(uv) - ideal) * [camera.fx, camera.fy]
    error = float(np.hypot(*off.T).max())
    if not error <= FIT_TOLERANCE:
        raise InputError(
            f"the nearest calibration in mm is off by {error:.2f} px; keep the camera in pixels",
            source=source,
            field="k1",
        )
    return fitted


_MM_NAMES = ("c", "xp", "yp", "K1", "K2", "K3", "P1", "P2", "B1", "B2")


def _as_mm(camera: Camera, sensor_mm: tuple[float, float]) -> InteriorOrientationMm:
    """Calibration without distortion: where the fit starts."""
    pitch_u, pitch_v = sensor_mm[0] / camera.width, sensor_mm[1] / camera.height
    return InteriorOrientationMm(
        width=camera.width,
        height=camera.height,
        sensor_mm=sensor_mm,
        c=camera.fy * pitch_v,
        xp=(camera.cx - (camera.width - 1) / 2.0) * pitch_u,
        yp=-(camera.cy - (camera.height - 1) / 2.0) * pitch_v,
    )


def _fit_mm(start: InteriorOrientationMm, uv: Array, ideal: Array) -> InteriorOrientationMm:
    radius = float(np.hypot(*start.sensor_mm)) / 2.0
    # One step of each parameter moves the corner by about as much.
    size = np.array([1, 1, 1, *(radius ** -np.array([2.0, 4.0, 6.0, 1.0, 1.0])), 1, 1])
    x = np.array([getattr(start, name) for name in _MM_NAMES]) / size

    def calibration(values: Array) -> InteriorOrientationMm:
        named = dict(zip(_MM_NAMES, (float(v) for v in values * size), strict=True))
        return replace(start, **named)  # type: ignore[arg-type]

    def off(values: Array) -> Array:
        return np.asarray((calibration(values).ideal_normalised(uv) - ideal).ravel())

    for _ in range(30):
        h = 1e-6
        J = np.column_stack([(off(x + d) - off(x - d)) / (2 * h) for d in h * np.eye(len(x))])
        step = np.linalg.lstsq(J, -off(x), rcond=None)[0]
        x = x + step
        if x[0] <= 0:
            break
        if float(np.abs(step).max()) < 1e-12 * radius:
            break
    return calibration(np.where(x > 0, x, 1e-3) if x[0] <= 0 else x)


def _sensor_places(calibration: InteriorOrientationMm) -> Array:
    u, v = np.meshgrid(
        np.linspace(-0.5, calibration.width - 0.5, NODES),
        np.linspace(-0.5, calibration.height - 0.5, NODES),
    )
    return np.stack([u.ravel(), v.ravel()], axis=-1)


def _in_own_direction(camera_id: str, m: InteriorOrientationMm) -> Camera:
    """`brown_inverse` of a calibration; exact but for products of affinity and distortion.

    With y down P2 changes its sign, and so does B2; normalised coordinates scale K1 by c^2.
    """
    pitch_u, pitch_v = m.pitch_mm
    model: CameraModel = "brown_inverse"
    # u = cx + f / (1 + B1) (x - B2 y), y up, so b2 = +f B2 with y down.
    fx = m.c / pitch_u / (1.0 + m.B1)
    return Camera(
        id=camera_id,
        width=m.width,
        height=m.height,
        fx=fx,
        fy=m.c / pitch_v,
        cx=(m.width - 1) / 2.0 + m.xp / pitch_u,
        cy=(m.height - 1) / 2.0 - m.yp / pitch_v,
        model=model,
        k1=m.K1 * m.c**2,
        k2=m.K2 * m.c**4,
        k3=m.K3 * m.c**6,
        # Ours names p2 what makes r^2 + 2 x^2, the calibration P1.
        p1=-m.P2 * m.c,
        p2=m.P1 * m.c,
        b2=fx * m.B2,
        source="calibration in mm",
    )


def _fit_brown(start: Camera, uv: Array, ideal: Array) -> Camera:
    """Brown camera nearest to pixels `uv` of ideal places: linear in fx, b2, fx k1, fx p1 ...

    fx and fy multiply one set of coefficients, so the ratio fy / fx is kept from `start`.
    """
    aspect = start.fy / start.fx
    x, y = ideal[:, 0], ideal[:, 1]
    r2 = x * x + y * y
    zero, one = np.zeros_like(x), np.ones_like(x)
    radial = [r2, r2**2, r2**3]
    in_u = [one, zero, x, y, *(x * r for r in radial), 2 * x * y, r2 + 2 * x * x]
    in_v = [zero, one, y, zero, *(y * r for r in radial), r2 + 2 * y * y, 2 * x * y]
    A = np.vstack([np.column_stack(in_u), np.column_stack(in_v)])
    A[len(x) :, 2:] *= aspect
    b = np.concatenate([uv[:, 0], uv[:, 1]])
    cx, cy, fx, b2, k1, k2, k3, p1, p2 = (float(q) for q in np.linalg.lstsq(A, b, rcond=None)[0])
    return replace(
        start,
        fx=fx,
        fy=fx * aspect,
        cx=cx,
        cy=cy,
        b2=b2,
        k1=k1 / fx,
        k2=k2 / fx,
        k3=k3 / fx,
        p1=p1 / fx,
        p2=p2 / fx,
    )


def _largest_error(camera: Camera, uv: Array, ideal: Array) -> float:
    """Largest distance, px, between pixels and the camera's own of the same rays; inf for NaN."""
    again = camera.project(np.column_stack([ideal, np.ones(len(ideal))]))
    error = np.hypot(*(again - uv).T)
    return float(error.max()) if np.all(np.isfinite(error)) else float("inf")
