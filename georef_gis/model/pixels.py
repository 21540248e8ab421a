"""Pixel coordinates of other programs; ours count from the centre of the first pixel."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from georef_gis.frames import Array

# px; COLMAP (`camera models`: "the upper left image corner has coordinate (0, 0)") and Metashape
# (User Manual, appendix "Camera models") count from the outer corner of the first pixel.
CORNER_TO_CENTRE = 0.5


def uv_from_corner(xy: ArrayLike) -> Array:
    """Our pixels of those counted from the outer corner (COLMAP, Metashape); shape (..., 2)."""
    return np.asarray(np.asarray(xy, dtype=np.float64) - CORNER_TO_CENTRE)


def corner_from_uv(uv: ArrayLike) -> Array:
    """Pixels counted from the outer corner (COLMAP, Metashape) of ours; shape (..., 2)."""
    return np.asarray(np.asarray(uv, dtype=np.float64) + CORNER_TO_CENTRE)


def uv_from_opensfm(xy: ArrayLike, *, width: int, height: int) -> Array:
    """Our pixels of OpenSfM's normalised image coordinates; shape (..., 2).

    Notes
    -----
    OpenSfM `features.denormalized_image_coordinates`: u = x max(w, h) - 0.5 + w / 2.
    """
    middle = np.array([(width - 1) / 2.0, (height - 1) / 2.0])
    return np.asarray(np.asarray(xy, dtype=np.float64) * max(width, height) + middle)


def opensfm_from_uv(uv: ArrayLike, *, width: int, height: int) -> Array:
    """OpenSfM's normalised image coordinates of our pixels; shape (..., 2)."""
    middle = np.array([(width - 1) / 2.0, (height - 1) / 2.0])
    return np.asarray((np.asarray(uv, dtype=np.float64) - middle) / max(width, height))


def uv_after_resize(uv: ArrayLike, scale: ArrayLike) -> Array:
    """Pixels in the picture resized by `scale` (one, or one per axis); shape (..., 2).

    The outer corners stay corners, so the centre of the first pixel moves.
    """
    return np.asarray(np.asarray(scale, float) * (np.asarray(uv, dtype=np.float64) + 0.5) - 0.5)
