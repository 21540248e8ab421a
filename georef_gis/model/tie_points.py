"""Tie points: ground points that several photos see, and what an adjustment makes of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from georef_gis.frames import Array

Indices = NDArray[np.int32]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TiePoints:
    """Observations of ground points in photos, in order of the points.

    Parameters
    ----------
    photo_ids
        Photos that `photo` counts; also those without any observation.
    photo, point : shape (m,)
        Indices of the photo and of the ground point of each observation; `point` does not fall
        and runs from 0 without a gap. A photo sees a point at most once.
    uv : shape (m, 2), px
        In the stored pixel array at full size; (0, 0) is the centre of the first pixel.
    sigma : shape (m,), px
        One standard deviation of u and of v.
    """

    photo_ids: tuple[str, ...]
    photo: Indices
    point: Indices
    uv: Array
    sigma: Array

    def __post_init__(self) -> None:
        """Check shapes and order."""
        m = len(self.photo)
        if self.point.shape != (m,) or self.uv.shape != (m, 2) or self.sigma.shape != (m,):
            raise ValueError("photo, point, uv and sigma must tell of as many observations")
        if m and (self.photo.min() < 0 or self.photo.max() >= len(self.photo_ids)):
            raise ValueError("photo counts photos that are not there")
        steps = np.diff(self.point, prepend=np.int32(-1))
        if m and not np.all((steps == 0) | (steps == 1)):
            raise ValueError("point must run from 0 in order, without a gap")
        if not (np.all(np.isfinite(self.uv)) and np.all(self.sigma > 0)):
            raise ValueError("uv must be finite and sigma positive")

    @property
    def n_points(self) -> int:
        """Number of ground points."""
        return int(self.point[-1]) + 1 if len(self.point) else 0

    def selected(self, keep: NDArray[np.bool_]) -> TiePoints:
        """Those observations, without points that fewer than two photos are left to see."""
        rays = np.bincount(self.point[keep], minlength=self.n_points)
        keep = keep & (rays >= 2)[self.point]
        number = np.cumsum(rays >= 2) - 1
        return TiePoints(
            photo_ids=self.photo_ids,
            photo=self.photo[keep],
            point=number[self.point[keep]].astype(np.int32),
            uv=self.uv[keep],
            sigma=self.sigma[keep],
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GroundPoints:
    """Adjusted ground points.

    Parameters
    ----------
    p_enu : shape (n, 3), m
    covariance : shape (n, 3, 3), m^2
        Of each point alone, the poses' share included.
    rays : shape (n,)
        How many photos see it.
    residual_px : shape (n,), px
        Root mean square of its pixels' residuals.
    """

    p_enu: Array
    covariance: Array
    rays: Indices
    residual_px: Array

    def __post_init__(self) -> None:
        """Check shapes."""
        n = len(self.p_enu)
        if self.p_enu.shape != (n, 3) or self.covariance.shape != (n, 3, 3):
            raise ValueError("p_enu must be (n, 3) and covariance (n, 3, 3)")
        if self.rays.shape != (n,) or self.residual_px.shape != (n,):
            raise ValueError("rays and residual_px must tell of as many points")

    def __len__(self) -> int:
        """Number of points."""
        return len(self.p_enu)
