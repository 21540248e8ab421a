"""Camera: the interior orientation; from camera axes to pixels and back."""

from __future__ import annotations

import functools
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from georef_gis.errors import InputError
from georef_gis.frames import Array, skew

CameraModel = Literal["brown", "brown_inverse", "fisheye", "fisheye_pix4d"]
CAMERA_MODELS: tuple[CameraModel, ...] = ("brown", "brown_inverse", "fisheye", "fisheye_pix4d")
# Order of the parameters wherever they stand in one vector.
PARAMETERS = ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "p1", "p2", "b1", "b2")

# px; a rolling shutter's rows move a pixel by less: the next round would change nothing
ROWS_SETTLED = 1e-7


@dataclass(frozen=True, slots=True, kw_only=True)
class Camera:
    """Interior orientation of one camera, pixels; (0, 0) is the centre of the first pixel.

    Models, each but one from ideal to distorted as in OpenCV:

    - `brown`: x' = x (1 + k1 r^2 + k2 r^4 + k3 r^6) + 2 p1 x y + p2 (r^2 + 2 x^2), y' alike;
    - `brown_inverse`: the same polynomial from distorted to ideal, for a calibration of that
      direction that no `brown` fits (`photo_mm`);
    - `fisheye`: theta' = theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8);
    - `fisheye_pix4d`: rho = t + poly[0] t^2 + poly[1] t^3 with t = 2 theta / pi, and `fx`, `fy`
      pixels per unit of rho (Pix4D's C and F; D and E must be zero or in `b2`).

    Then u = cx + (fx + b1) x' + b2 y', v = cy + fy y'. `b1` and `b2` are the affinity and skew of
    Metashape; with fx and fy apart b1 is zero.

    Notes
    -----
    OpenCV documentation, "Camera calibration"; Pix4D, "How are the internal camera parameters
    defined".
    """

    id: str
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    model: CameraModel = "brown"
    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    b1: float = 0.0
    b2: float = 0.0
    # Pix4D's fisheye polynomial from its square on
    poly: tuple[float, ...] = ()
    # s; from first to last row, 0 for a mechanical shutter
    readout_s: float = 0.0
    # px, one sigma of the focal length and of the principal point
    sigma_f: float = 0.0
    sigma_c: float = 0.0
    # where the values come from, for people
    source: str = ""
    notes: tuple[str, ...] = field(default=())

    def __post_init__(self) -> None:
        """Check ranges once."""
        if self.model not in CAMERA_MODELS:
            raise InputError(
                f"camera model '{self.model}' is not known; use one of {', '.join(CAMERA_MODELS)}",
                source=f"camera {self.id}",
                field="model",
            )
        numbers = [getattr(self, name) for name in (*PARAMETERS, "k4", "readout_s")]
        if not np.all(np.isfinite(numbers)):
            raise ValueError(f"camera {self.id}: a parameter is not finite: {numbers}")
        if min(self.width, self.height) < 1 or min(self.fx, self.fy) <= 0:
            raise ValueError(f"camera {self.id}: size and focal length must be positive")

    @property
    def parameters(self) -> Array:
        """fx fy cx cy k1 k2 k3 p1 p2 b1 b2; shape (11,)."""
        return np.array([getattr(self, name) for name in PARAMETERS])

    @property
    def corners_uv(self) -> Array:
        """Outer corners of the image, clockwise from the top left; shape (4, 2), px."""
        w, h = self.width - 0.5, self.height - 0.5
        return np.array([[-0.5, -0.5], [w, -0.5], [w, h], [-0.5, h]])

    def border_uv(self, n: int = 8) -> Array:
        """Points along the image border, clockwise, n per side; shape (4 n, 2), px."""
        c = self.corners_uv
        t = np.arange(n)[:, None] / n
        return np.concatenate([c[i] + t * (c[(i + 1) % 4] - c[i]) for i in range(4)])

    def turned(self, degrees: int) -> Camera:
        """Camera of the same picture after its pixels were turned clockwise by an editor.

        Raises
        ------
        InputError
            If the angle is not a quarter turn, or a skew stands in the way of one.
        """
        if degrees % 90 or (degrees % 180 and self.b2 != 0.0):
            raise InputError(
                f"a photo cannot be turned by {degrees} deg; use 90, 180 or 270",
                source=f"camera {self.id}",
                field="attitude.rotate_photos",
            )
        camera = self
        if degrees % 360:
            # Upside down the rows are read the other way; lying, they stand in columns, which the
            # model cannot hold.
            readout = -self.readout_s if degrees % 180 == 0 else 0.0
            camera = replace(self, readout_s=readout)
        for _ in range(degrees // 90 % 4):
            # u' = height - 1 - v, v' = u
            camera = replace(
                camera,
                width=camera.height,
                height=camera.width,
                fx=camera.fy,
                fy=camera.fx + camera.b1,
                b1=0.0,
                cx=camera.height - 1 - camera.cy,
                cy=camera.cx,
                p1=camera.p2,
                p2=-camera.p1,
            )
        return camera

    # -- camera axes -> pixels ---------------------------------------------------------------

    def project(
        self,
        p_cam: ArrayLike,
        *,
        velocity_cam: ArrayLike | None = None,
        rate_cam: ArrayLike | None = None,
    ) -> Array:
        """Pixels of points in camera axes; shape (..., 3) -> (..., 2).

        Parameters
        ----------
        p_cam : shape (..., 3), m
            Points at the middle of the exposure; z forward.
        velocity_cam, rate_cam : shape (3,), m/s and rad/s
            Motion of the camera in camera axes; with a rolling shutter each row is exposed at
            its own time.

        Returns
        -------
        uv : shape (..., 2), px
            NaN behind the camera and where the distortion polynomial has turned back.
        """
        p = np.asarray(p_cam, dtype=np.float64)
        uv = self._project_static(p)
        if self.readout_s == 0.0 or (velocity_cam is None and rate_cam is None):
            return uv
        v = np.zeros(3) if velocity_cam is None else np.asarray(velocity_cam, float)
        w = np.zeros(3) if rate_cam is None else np.asarray(rate_cam, float)
        # The scene moves against the camera: to first order in the readout time.
        move = v + p @ skew(w).T
        row = uv[..., 1]
        time = self.row_time(row)
        uv = self._project_static(p - time[..., None] * move)
        slow = self._own_share(uv[..., 1] - row, time)
        for _ in range(6):
            apart = uv[..., 1] - row
            if not np.any(np.abs(apart) > ROWS_SETTLED):
                break
            row = row + slow * apart
            uv = self._project_static(p - self.row_time(row)[..., None] * move)
        return uv

    def _own_share(self, moved: Array, time: Array) -> Array:
        """How far to go from a row at whose time a point is seen in another one, to its own.

        A point's row moves evenly with time, here by `moved` px within `time` from the middle of
        the readout, while the row that is read moves too.
        """
        per_row = self.readout_s / max(self.height - 1, 1)
        with np.errstate(divide="ignore", invalid="ignore"):
            # near the middle it hardly moves, and the next round shows what is left
            drift = np.where(np.abs(time) > 1e-3 * abs(self.readout_s), moved / time, 0.0)
        return np.asarray(1.0 / (1.0 - drift * per_row))

    def row_time(self, v: ArrayLike) -> Array:
        """When rows are exposed, s from the middle of the readout; shape (...) px -> (...)."""
        rows = max(self.height - 1, 1)
        return np.asarray((np.asarray(v, dtype=np.float64) / rows - 0.5) * self.readout_s)

    def _project_static(self, p: Array) -> Array:
        with np.errstate(divide="ignore", invalid="ignore"):
            if self._has_plane:
                z = np.where(p[..., 2] > 0, p[..., 2], np.nan)
                xy = self.distort(p[..., :2] / z[..., None])
            else:
                r = np.hypot(p[..., 0], p[..., 1])
                rho = self._rho_from_theta(np.arctan2(r, p[..., 2]))
                scale = np.where(r > 1e-12, rho / np.where(r > 1e-12, r, 1.0), 0.0)
                xy = p[..., :2] * scale[..., None]
        return self._pixels_from_distorted(xy)

    def _pixels_from_distorted(self, xy: Array) -> Array:
        x, y = xy[..., 0], xy[..., 1]
        uv = np.empty(xy.shape)
        uv[..., 0] = self.cx + (self.fx + self.b1) * x + self.b2 * y
        uv[..., 1] = self.cy + self.fy * y
        return uv

    @property
    def _has_plane(self) -> bool:
        """Whether directions are points of the plane z = 1 (Brown) or angles (fisheye)."""
        return self.model in ("brown", "brown_inverse")

    def distort(self, xy: Array) -> Array:
        """Distorted from ideal normalised coordinates (Brown); NaN beyond the valid radius."""
        return self._solve(xy) if self.model == "brown_inverse" else self._polynomial(xy)

    def _polynomial(self, xy: Array) -> Array:
        x, y = xy[..., 0], xy[..., 1]
        r2 = x * x + y * y
        radial = 1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))
        limit = _turning_radius(self.k1, self.k2, self.k3)
        if np.isfinite(limit):
            radial = np.where(r2 < limit**2, radial, np.nan)
        out = np.empty(xy.shape)
        out[..., 0] = x * radial
        out[..., 1] = y * radial
        if self.p1 or self.p2:
            out[..., 0] += 2.0 * self.p1 * x * y + self.p2 * (r2 + 2.0 * x * x)
            out[..., 1] += self.p1 * (r2 + 2.0 * y * y) + 2.0 * self.p2 * x * y
        return out

    def _rho_from_theta(self, theta: Array) -> Array:
        if self.model == "fisheye":
            t2 = theta * theta
            return np.asarray(
                theta * (1.0 + t2 * (self.k1 + t2 * (self.k2 + t2 * (self.k3 + t2 * self.k4))))
            )
        t = theta * (2.0 / np.pi)
        rho = t.copy()
        for power, c in enumerate(self.poly, start=2):
            rho = rho + c * t**power
        return rho

    # -- pixels -> camera axes ---------------------------------------------------------------

    def ray(self, uv: ArrayLike) -> Array:
        """Unit directions in camera axes of pixels; shape (..., 2) -> (..., 3).

        NaN where no direction gives the pixel.
        """
        uv = np.asarray(uv, dtype=np.float64)
        y = (uv[..., 1] - self.cy) / self.fy
        x = (uv[..., 0] - self.cx - self.b2 * y) / (self.fx + self.b1)
        xy = np.stack([x, y], axis=-1)
        if self._has_plane:
            ideal = self.undistort(xy)
            d = np.concatenate([ideal, np.ones_like(x)[..., None]], axis=-1)
        else:
            rho = np.hypot(x, y)
            theta = self._theta_from_rho(rho)
            s = np.where(rho > 1e-12, np.sin(theta) / np.where(rho > 1e-12, rho, 1.0), 0.0)
            d = np.concatenate([xy * s[..., None], np.cos(theta)[..., None]], axis=-1)
        return np.asarray(d / np.linalg.norm(d, axis=-1, keepdims=True))

    def undistort(self, xy: Array) -> Array:
        """Ideal from distorted normalised coordinates (Brown); NaN beyond the valid radius."""
        return self._polynomial(xy) if self.model == "brown_inverse" else self._solve(xy)

    def _solve(self, xy: Array) -> Array:
        """Inverse of `_polynomial` by Newton's method to 1e-12."""
        ideal = np.array(xy, dtype=np.float64, copy=True)
        if not np.any([self.k1, self.k2, self.k3, self.p1, self.p2]):
            return ideal
        residual = np.zeros_like(ideal)
        for _ in range(20):
            x, y = ideal[..., 0], ideal[..., 1]
            r2 = x * x + y * y
            radial = 1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))
            slope = 2.0 * (self.k1 + r2 * (2.0 * self.k2 + 3.0 * r2 * self.k3))
            fx = x * radial + 2.0 * self.p1 * x * y + self.p2 * (r2 + 2.0 * x * x)
            fy = y * radial + self.p1 * (r2 + 2.0 * y * y) + 2.0 * self.p2 * x * y
            a = radial + x * x * slope + 2.0 * self.p1 * y + 6.0 * self.p2 * x
            b = x * y * slope + 2.0 * self.p1 * x + 2.0 * self.p2 * y
            d = radial + y * y * slope + 6.0 * self.p1 * y + 2.0 * self.p2 * x
            residual = np.stack([xy[..., 0] - fx, xy[..., 1] - fy], axis=-1)
            det = a * d - b * b
            det = np.where(np.abs(det) < 1e-9, np.nan, det)
            step = np.stack(
                [
                    (d * residual[..., 0] - b * residual[..., 1]) / det,
                    (a * residual[..., 1] - b * residual[..., 0]) / det,
                ],
                axis=-1,
            )
            ideal = ideal + step
            if np.max(np.abs(step), initial=0.0, where=np.isfinite(step)) <= 1e-13:
                break
        inside = np.sum(ideal**2, axis=-1) < _turning_radius(self.k1, self.k2, self.k3) ** 2
        good = inside & np.all(np.abs(residual) < 1e-9, axis=-1)
        return np.asarray(np.where(good[..., None], ideal, np.nan))

    def _theta_from_rho(self, rho: Array) -> Array:
        theta = np.array(rho if self.model == "fisheye" else rho * (np.pi / 2), copy=True)
        h = 1e-6
        for _ in range(20):
            f = self._rho_from_theta(theta) - rho
            slope = (self._rho_from_theta(theta + h) - self._rho_from_theta(theta - h)) / (2 * h)
            theta = theta - f / np.where(np.abs(slope) < 1e-9, np.nan, slope)
        good = (np.abs(self._rho_from_theta(theta) - rho) < 1e-9) & (theta >= -1e-12)
        return np.asarray(np.where(good & (theta < np.pi), theta, np.nan))


@functools.lru_cache(maxsize=256)
def _turning_radius(k1: float, k2: float, k3: float) -> float:
    """Ideal radius at which the radial polynomial stops to grow; inf if it never does.

    Beyond it the polynomial folds the outside world back into the image.
    """
    roots = np.roots([7.0 * k3, 5.0 * k2, 3.0 * k1, 1.0])
    real = roots[np.abs(roots.imag) < 1e-9].real if roots.size else roots
    positive = real[real > 0]
    return float(np.sqrt(positive.min())) if positive.size else float("inf")
