"""Photos of the site through the true camera: ground by ray casting, objects by painter's order."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from georef_gis.simulate import optics, site, solids
from georef_gis.simulate.flight import SimulatedFlight
from georef_gis.simulate.ground_paint import Image, paint_ground
from georef_gis.simulate.settings import CameraTruth
from georef_gis.simulate.site import SiteObject
from georef_gis.simulate.solids import Face

Array = NDArray[np.float64]
Uint8Image = NDArray[np.uint8]

STEP = 8  # px between exact rays; linear in between is good to 0.01 px
FINE = 4  # subpixels per side for objects
SHIFT = 4  # fractional bits of cv2.fillPoly


def render_photo(flight: SimulatedFlight, index: int) -> Uint8Image:
    """One photo, shape (rows, cols, 3), RGB."""
    camera = flight.settings.camera
    view = _View(flight, index)
    e, n, gsd = view.ground()
    image = paint_ground(e, n, gsd)
    image *= _relief(e, n)[..., None]
    _draw_shadows(image, view)
    for item in sorted(site.objects(), key=view.distance, reverse=True):
        if item.kind == "tree":
            _draw_tree(image, view, item)
        else:
            for part in solids.parts(item):
                _draw_part(image, view, part)
    return _develop(image, camera, np.random.default_rng([flight.seed, 100 + index]))


class _View:
    """One photo's true camera in the site's frame."""

    def __init__(self, flight: SimulatedFlight, index: int) -> None:
        self.camera = flight.settings.camera
        self.origin = site.enu_from_ecef(flight.p_ecef[index])
        self.R_enu_from_cam = site.rotation_ecef_from_site_enu().T @ flight.R_ecef_from_cam[index]

    def distance(self, item: SiteObject) -> float:
        """Metres from the camera to an object's base."""
        return float(np.linalg.norm(item.enu - self.origin))

    def project(self, p_enu: Array) -> Array:
        """Pixels of points, shape (..., 2); NaN behind the camera."""
        return optics.pixels_from_cam((p_enu - self.origin) @ self.R_enu_from_cam, self.camera)

    def ground(self) -> tuple[Image, Image, Image]:
        """East, north and pixel side on the ground of every pixel, m."""
        width, height = self.camera.width, self.camera.height
        u = np.arange(-STEP, width + 2 * STEP, STEP, dtype=np.float64)
        v = np.arange(-STEP, height + 2 * STEP, STEP, dtype=np.float64)
        uv = np.stack(np.meshgrid(u, v), axis=-1)
        d = optics.rays_of_pixels(uv, self.camera) @ self.R_enu_from_cam.T
        p = site.intersect_ground(self.origin, d)
        side = np.linalg.norm(p - self.origin, axis=-1) / self.camera.fx
        col = (np.arange(width, dtype=np.float32) + STEP) / STEP
        row = (np.arange(height, dtype=np.float32) + STEP) / STEP
        x, y = np.meshgrid(col, row)
        e, n, gsd = (_between(c, x, y) for c in (p[..., 0], p[..., 1], side))
        return e, n, gsd


def _between(grid: Array, x: Image, y: Image) -> Image:
    """Bilinear values of a grid at fractional columns and rows; cv2.remap would round to 1/32."""
    j, i = x.astype(np.int64), y.astype(np.int64)
    a, b = x - j, y - i
    top = (1 - a) * grid[i, j] + a * grid[i, j + 1]
    low = (1 - a) * grid[i + 1, j] + a * grid[i + 1, j + 1]
    return np.asarray((1 - b) * top + b * low, dtype=np.float32)


def _relief(e: Image, n: Image) -> Image:
    """Light on the slope of the ground."""
    de = (site.terrain_up(e + 0.5, n) - site.terrain_up(e - 0.5, n)).astype(np.float32)
    dn = (site.terrain_up(e, n + 0.5) - site.terrain_up(e, n - 0.5)).astype(np.float32)
    sun = solids.SUN.astype(np.float32)
    facing = (sun[2] - de * sun[0] - dn * sun[1]) / np.sqrt(1 + de**2 + dn**2)
    return np.asarray(0.55 + 0.45 * facing / sun[2], dtype=np.float32)


def _draw_shadows(image: Image, view: _View) -> None:
    rows, cols = image.shape[:2]
    mask = np.zeros((2 * rows, 2 * cols), dtype=np.uint8)
    for item in site.objects():
        groups = (
            [solids.shadow_points(item)]
            if item.kind == "tree"
            else [solids.part_shadow(part) for part in solids.parts(item)]
        )
        for ground in groups:
            uv = view.project(ground)
            if np.isfinite(uv).all():
                hull = cv2.convexHull(_fixed(uv, 2).reshape(-1, 1, 2))
                cv2.fillPoly(mask, [hull], 255, lineType=cv2.LINE_8, shift=SHIFT)
    soft = cv2.resize(mask, (cols, rows), interpolation=cv2.INTER_AREA)
    soft = cv2.GaussianBlur(soft, (0, 0), 0.7).astype(np.float32) / 255.0
    image *= 1.0 - soft[..., None] * np.array([0.52, 0.49, 0.43], dtype=np.float32)


def _fixed(uv: Array, scale: int) -> NDArray[np.int32]:
    """Pixels of a `scale` times finer image in cv2's fixed point, shape (n, 2)."""
    fine = scale * (uv + 0.5) - 0.5
    return np.round(fine * (1 << SHIFT)).astype(np.int32)


def _window(uv: Array, shape: tuple[int, ...], rim: float) -> tuple[slice, slice] | None:
    if not np.isfinite(uv).all():
        return None
    low = np.floor(uv.min(axis=0) - rim).astype(int)
    high = np.ceil(uv.max(axis=0) + rim).astype(int) + 1
    rows = slice(max(low[1], 0), min(high[1], shape[0]))
    cols = slice(max(low[0], 0), min(high[0], shape[1]))
    if rows.start >= rows.stop or cols.start >= cols.stop:
        return None
    return rows, cols


def _subdivided(points: Array) -> Array:
    """Outline with three points per edge, so that it bends with the lens."""
    following = np.roll(points, -1, axis=0)
    share = np.arange(3)[None, :, None] / 3
    return np.asarray((points[:, None] * (1 - share) + following[:, None] * share).reshape(-1, 3))


def _draw_part(image: Image, view: _View, part: list[Face]) -> None:
    """A convex part: faces that look at the camera, on a finer canvas."""
    everything = np.concatenate([f.points for f in part])
    window = _window(view.project(everything), image.shape, 1.0)
    if window is None:
        return
    rows, cols = window
    crop = image[rows, cols]
    canvas = np.repeat(np.repeat(crop, FINE, axis=0), FINE, axis=1)
    canvas = np.clip(canvas, 0, 255).astype(np.uint8)
    inside = everything.mean(axis=0)
    shift = np.array([cols.start, rows.start])
    cover = np.zeros(canvas.shape[:2], dtype=np.uint8)
    for face in part:
        if not _faces(face, inside, view.origin):
            continue
        uv = view.project(_subdivided(face.points))
        outline = [_fixed(uv - shift, FINE).reshape(-1, 1, 2)]
        cv2.fillPoly(canvas, outline, solids.lit(face, inside), shift=SHIFT)
        cv2.fillPoly(cover, outline, 255, shift=SHIFT)
    size = (crop.shape[1], crop.shape[0])
    small = cv2.resize(canvas, size, interpolation=cv2.INTER_AREA).astype(np.float32)
    touched = cv2.resize(cover, size, interpolation=cv2.INTER_AREA) > 0
    crop[touched] = small[touched]


def _faces(face: Face, inside: Array, eye: Array) -> bool:
    normal = np.cross(face.points[1] - face.points[0], face.points[2] - face.points[0])
    middle = face.points.mean(axis=0)
    if normal @ (middle - inside) < 0.0:
        normal = -normal
    return bool(normal @ (eye - middle) > 0.0)


def _draw_tree(image: Image, view: _View, item: SiteObject) -> None:
    centres, radii, shades = solids.tree_blobs(item)
    uv = view.project(centres)
    near = np.linalg.norm(centres - view.origin, axis=-1)
    window = _window(uv, image.shape, 0.2 * item.width / near.min() * view.camera.fx)
    if window is None:
        return
    rows, cols = window
    crop = np.clip(image[rows, cols], 0, 255).astype(np.uint8)
    canvas = cv2.resize(crop, None, fx=2, fy=2, interpolation=cv2.INTER_NEAREST)
    centre = _fixed(uv - np.array([cols.start, rows.start]), 2)
    size = np.round(2 * radii / near * view.camera.fx * (1 << SHIFT)).astype(int)
    for i in np.argsort(-near):
        colour = tuple(float(c * shades[i]) for c in item.colour)
        cv2.circle(canvas, tuple(int(c) for c in centre[i]), int(size[i]), colour, -1, shift=SHIFT)
    small = cv2.resize(canvas, (crop.shape[1], crop.shape[0]), interpolation=cv2.INTER_AREA)
    image[rows, cols] = small


def _develop(image: Image, camera: CameraTruth, rng: np.random.Generator) -> Uint8Image:
    """Lens blur, vignetting, exposure, noise."""
    soft = cv2.GaussianBlur(image, (0, 0), 0.55)
    v, u = np.mgrid[: camera.height, : camera.width].astype(np.float32)
    r2 = ((u - camera.cx) ** 2 + (v - camera.cy) ** 2) / camera.fx**2
    gain = (1.0 - 0.30 * r2 / (1 + 0.4 * r2)) * (1.16 + 0.02 * rng.normal())
    soft *= gain[..., None].astype(np.float32)
    noise = rng.standard_normal(soft.shape, dtype=np.float32)
    noisy = soft + noise * (1.0 + 0.10 * np.sqrt(np.clip(soft, 0, None)))
    return np.asarray(np.clip(noisy + 0.5, 0, 255), dtype=np.uint8)
