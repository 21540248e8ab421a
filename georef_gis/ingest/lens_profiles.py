"""Lens profiles of the lensfun database as cameras of our own models."""

from __future__ import annotations

import functools
import math
import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from georef_gis.frames import Array
from georef_gis.ingest.sensors import (
    FULL_FRAME_DIAGONAL,
    SIGMA_35MM,
    CameraReading,
    Size,
    kind_of_reduction,
    native_frame,
    simple_camera,
    taken_scale,
)
from georef_gis.ingest.tags import TagValue, number, text
from georef_gis.model.camera import Camera

Reading = Mapping[str, TagValue]

# px of the picture as taken; to this our model is the profile, and beyond that it is said
_FIT_TOLERANCE = 0.1
# px; a worse fit is refused. Between the two it still removes tens of pixels of distortion.
_FIT_LIMIT = 2.0
# Steps across the longer side at which the profile is asked
_STEPS = 65


@functools.cache
def _database() -> Any:
    import lensfunpy

    return lensfunpy.Database()


@functools.cache
def _find_camera(make: str, model: str) -> Any | None:
    found = _database().find_cameras(make, model) if model else []
    return found[0] if found else None


def profile_of(tags: Reading, camera_id: str, size: Size, full: Size) -> CameraReading | str | None:
    """Camera of a lens profile; a note if there is one that cannot be used, else None.

    Notes
    -----
    Profiles are measured on raw pictures. The firmware of compact cameras and drones corrects the
    distortion of its JPEGs (a Phantom 4 Pro by 290 px in the corners), so a profile of a fixed
    lens is not applied to a JPEG; those of interchangeable lenses are.
    """
    body = _find_camera(text(tags, "EXIF:Make"), text(tags, "EXIF:Model"))
    focal_mm = number(tags, "EXIF:FocalLength")
    if body is None or not focal_mm:
        return None
    fixed = body.mount[:1].islower()
    if fixed and text(tags, "File:FileType") != "TIFF":
        return "no lens profile applied: the firmware of fixed-lens cameras corrects its JPEGs"
    lens = _find_lens(body, text(tags, "EXIF:LensModel"), focal_mm, fixed=fixed)
    if lens is None:
        return None
    if lens.type.name != "RECTILINEAR":
        return f"the lens profile of {lens.model} is a {lens.type.name.lower()} and was not applied"
    if kind_of_reduction(size, full) == "cropped":
        return "the lens profile was not applied: the picture is cropped"
    return _camera_of(
        body, lens, focal_mm, number(tags, "EXIF:FNumber") or 8.0, camera_id, size, full
    )


def crop_factor_camera(
    tags: Reading, camera_id: str, size: Size, full: Size
) -> CameraReading | str | None:
    """Camera of nothing but the crop factor that lensfun knows of the model."""
    body = _find_camera(text(tags, "EXIF:Make"), text(tags, "EXIF:Model"))
    focal_mm = number(tags, "EXIF:FocalLength")
    if body is None or not focal_mm:
        return None
    camera = simple_camera(
        camera_id,
        size,
        _focal(body, focal_mm, full) * taken_scale(size, full),
        sigma_share=SIGMA_35MM,
        source="lens profile",
    )
    return CameraReading(camera=camera)


def _find_lens(body: Any, lens_model: str, focal_mm: float, *, fixed: bool) -> Any | None:
    """Lens of a fixed-lens camera, or the one of just this name."""
    if not fixed and not lens_model:
        return None
    lenses = _database().find_lenses(body, "", "" if fixed else lens_model)
    for lens in lenses:
        in_range = lens.min_focal * 0.97 <= focal_mm <= lens.max_focal * 1.03
        names = {_plain(lens.model), _plain(lens.model.removeprefix(lens.maker))}
        if in_range and (fixed or _plain(lens_model) in names):
            return lens
    return None


def _plain(name: str) -> str:
    return re.sub(r"[^a-z0-9]", "", name.lower())


def _focal(body: Any, focal_mm: float, full: Size) -> float:
    """Focal length, px of the picture as taken."""
    diagonal_mm = FULL_FRAME_DIAGONAL / body.crop_factor
    return float(focal_mm / diagonal_mm * math.hypot(*native_frame(full, body.crop_factor)))


def _camera_of(
    body: Any, lens: Any, focal_mm: float, f_number: float, camera_id: str, size: Size, full: Size
) -> CameraReading | str:
    import lensfunpy

    width, height = (round(v) for v in native_frame(full, body.crop_factor))
    modifier = lensfunpy.Modifier(lens, body.crop_factor, width, height)
    modifier.initialize(
        focal_mm, f_number, 1000.0, scale=1.0, flags=lensfunpy.ModifyFlags.DISTORTION
    )
    ideal, distorted = _samples(modifier, width, height, full)
    if ideal is None or distorted is None:
        return f"the lens profile of {lens.model} has no distortion at {focal_mm:g} mm"
    focal = _focal(body, focal_mm, full)
    fitted, k, error = fit_radial(ideal / focal, distorted)
    if error > _FIT_LIMIT:
        return f"the lens profile of {lens.model} does not fit our model: {error:.2f} px off"
    scale = taken_scale(size, full)
    camera = simple_camera(
        camera_id, size, fitted * scale, sigma_share=SIGMA_35MM, source="lens profile"
    )
    values = {name: getattr(camera, name) for name in camera.__slots__}
    values |= {"k1": k[0], "k2": k[1], "k3": k[2], "notes": (f"{lens.model}, to {error:.2f} px",)}
    doubts = (
        (f"the lens profile of {lens.model} is followed to {error:.1f} px only",)
        if error > _FIT_TOLERANCE
        else ()
    )
    return CameraReading(camera=Camera(**values), doubts=doubts)


def _samples(
    modifier: Any, width: int, height: int, full: Size
) -> tuple[Array | None, Array | None]:
    """Radii, px, of ideal and distorted points from the middle to the corner of the picture."""
    corner = math.hypot(*full) / 2.0
    ideal, distorted = [], []
    for t in np.linspace(0.02, 1.0, _STEPS):
        x, y = full[0] / 2.0 * t, full[1] / 2.0 * t
        u, v = (width - 1) / 2.0 + x, (height - 1) / 2.0 + y
        moved = modifier.apply_geometry_distortion(u, v, 1, 1)
        if moved is None:
            return None, None
        du, dv = (
            float(moved[0, 0, i]) - c for i, c in enumerate(((width - 1) / 2, (height - 1) / 2))
        )
        ideal.append(corner * t)
        distorted.append(math.copysign(math.hypot(du, dv), du))
    return np.array(ideal), np.array(distorted)


def fit_radial(ideal: Array, distorted: Array) -> tuple[float, tuple[float, float, float], float]:
    """Focal length and k1, k2, k3 by which distorted = f r (1 + k1 r^2 + k2 r^4 + k3 r^6).

    Parameters
    ----------
    ideal : shape (n,)
        Tangents of the angles off the axis, r.
    distorted : shape (n,), px

    Returns
    -------
    focal, k, error
        px; without unit; px, the largest residual.
    """
    powers = ideal[:, None] ** np.array([1, 3, 5, 7])
    scale = np.max(np.abs(powers), axis=0)
    solution, *_ = np.linalg.lstsq(powers / scale, distorted, rcond=None)
    coefficients = solution / scale
    error = float(np.max(np.abs(powers @ coefficients - distorted)))
    f = float(coefficients[0])
    k = tuple(float(c) / f for c in coefficients[1:])
    return f, (k[0], k[1], k[2]), error
