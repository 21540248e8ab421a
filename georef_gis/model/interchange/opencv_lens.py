"""What OpenSfM's and COLMAP's cameras share: OpenCV's polynomials, brown and fisheye."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from georef_gis.model.camera import Camera, CameraModel

DISTORTION = ("k1", "k2", "k3", "k4", "p1", "p2")


def distortion_of(camera: Camera) -> dict[str, float]:
    """Coefficients of a camera by their names of `DISTORTION`."""
    return {name: getattr(camera, name) for name in DISTORTION}


def camera_of(
    camera_id: str,
    size: tuple[int, int],
    values: Mapping[str, float],
    *,
    model: CameraModel,
    source: str,
) -> Camera:
    """Camera of another program as ours.

    Parameters
    ----------
    size : px
        Width and height.
    values
        fx, fy, cx, cy in our pixels and all of `DISTORTION`; others are passed over.
    source
        Where the values come from, for people.
    """
    lens: dict[str, Any] = {name: values[name] for name in ("fx", "fy", "cx", "cy", *DISTORTION)}
    return Camera(id=camera_id, width=size[0], height=size[1], model=model, source=source, **lens)
