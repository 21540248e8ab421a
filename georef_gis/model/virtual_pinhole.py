"""The pinhole in which photos are adjusted whose lens model the adjustment does not know."""

from __future__ import annotations

import numpy as np

from georef_gis.frames import Array
from georef_gis.model.camera import Camera

# px; what projects keep of an adjustment is in these pixels: another value would misread them
VIRTUAL_FOCAL = 1000.0
# cosine of the angle off the axis from which on a pinhole stretches too much: 80 deg
LEAST_AHEAD = 0.17


def virtual_pinhole(camera: Camera) -> Camera:
    """Pinhole in the place of a camera; its principal point is (0, 0)."""
    return Camera(
        id=camera.id, width=camera.width, height=camera.height, fx=VIRTUAL_FOCAL,
        fy=VIRTUAL_FOCAL, cx=0.0, cy=0.0,
    )  # fmt: skip


def virtual_uv(rays: Array) -> Array:
    """Pixels of the virtual pinhole, (m, 2), from unit directions in camera axes, (m, 3).

    NaN where a direction lies further off the axis than a pinhole can see.
    """
    ahead = np.where(rays[:, 2:] > LEAST_AHEAD, rays[:, 2:], np.nan)
    return np.asarray(VIRTUAL_FOCAL * rays[:, :2] / ahead)


def virtual_rays(uv: Array) -> Array:
    """Directions in camera axes, z = 1, (m, 3), from pixels of the virtual pinhole, (m, 2)."""
    return np.column_stack([uv / VIRTUAL_FOCAL, np.ones(len(uv))])
