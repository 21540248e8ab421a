"""The virtual pinhole: its pixels are those of its camera, and lead back to the same rays."""

from __future__ import annotations

import numpy as np
import pytest

from georef_gis.frames import Array
from georef_gis.model.camera import Camera
from georef_gis.model.virtual_pinhole import virtual_pinhole, virtual_rays, virtual_uv

FISHEYE = Camera(
    id="cam", width=4000, height=3000, fx=1500.0, fy=1500.0, cx=1999.5, cy=1499.5,
    model="fisheye", k1=0.01,
)  # fmt: skip


def rays_at(degrees: float) -> Array:
    """Unit directions all around the axis, at one angle off it; shape (8, 3)."""
    way, off = np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False), np.radians(degrees)
    flat = np.sin(off) * np.column_stack([np.cos(way), np.sin(way)])
    return np.column_stack([flat, np.full(8, np.cos(off))])


@pytest.mark.parametrize("degrees", [0.0, 30.0, 75.0])
def test_its_pixels_are_those_of_its_camera(degrees: float) -> None:
    rays, pinhole = rays_at(degrees), virtual_pinhole(FISHEYE)
    assert (pinhole.id, pinhole.width, pinhole.model) == ("cam", 4000, "brown")
    # px; rounding of pixels up to 3732
    np.testing.assert_allclose(virtual_uv(rays), pinhole.project(rays), atol=1e-9)


@pytest.mark.parametrize("degrees", [0.0, 30.0, 75.0])
def test_pixels_lead_back_to_the_photo(degrees: float) -> None:
    uv = FISHEYE.project(rays_at(degrees))
    back = FISHEYE.project(virtual_rays(virtual_uv(FISHEYE.ray(uv))))
    # px; where the inverse of the lens stops to iterate
    np.testing.assert_allclose(back, uv, atol=1e-6)


def test_further_off_the_axis_than_80_deg_there_is_no_pixel() -> None:
    assert np.all(np.isfinite(virtual_uv(rays_at(79.0))))
    assert np.all(np.isnan(virtual_uv(rays_at(81.0))))
    assert np.all(np.isnan(virtual_uv(rays_at(170.0))))
