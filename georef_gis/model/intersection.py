"""Space intersection: one ground point from its pixels in several photos, with its covariance."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from georef_gis.errors import GeometryError
from georef_gis.frames import Array
from georef_gis.model.intersection_rays import (
    NO_RAY,
    PARALLEL,
    PARALLEL_RAYS,
    Marks,
    nearest_points,
)
from georef_gis.model.intersections import intersect_many
from georef_gis.model.joint_errors import JointErrors
from georef_gis.model.photo import OrientedPhoto
from georef_gis.model.photo_stack import PhotoStack

# ids of n photos -> covariance (6 n, 6 n) of their pose errors (dp_enu m, dtheta_enu rad)
JointCovariance = Callable[[Sequence[str]], Array]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Intersection:
    """A ground point from several photos.

    Parameters
    ----------
    p_enu : shape (3,), m
    covariance : shape (3, 3), m^2
        Poses, camera and marks count; the level that camera and ground share
        (`Pose.sigma_height_shared`) is in the height.
    residuals_uv : shape (n, 2), px
        Marked minus projected.
    normalised : shape (n,)
        Normalised residual of each mark (Baarda's test): above about 4, a blunder.
    sigma0
        Square root of chi^2 per degree of freedom; near 1 where the sigmas hold.
    independent
        Whether the errors of the poses were taken as independent of each other. Those of one
        flight are not: then the covariance is too small.
    """

    p_enu: Array
    covariance: Array
    residuals_uv: Array
    normalised: Array
    sigma0: float
    independent: bool

    @property
    def rays(self) -> int:
        """Number of photos."""
        return len(self.residuals_uv)


def nearest_point(origins_enu: ArrayLike, d_enu: ArrayLike) -> Array:
    """Point nearest to all rays by the sum of squared distances; (n, 3) each -> (3,) m.

    Raises
    ------
    GeometryError
        If there are fewer than two rays, or they run parallel.
    """
    o, d = np.asarray(origins_enu, float), np.asarray(d_enu, float)
    if len(o) < 2:
        raise GeometryError(f"{len(o)} ray gives no point; mark it in two photos or more")
    p, spread = nearest_points(o[None], d[None])
    if not np.all(np.isfinite(p)):
        raise GeometryError(NO_RAY)
    if spread[0] < PARALLEL:
        raise GeometryError(PARALLEL_RAYS)
    return np.asarray(p[0])


def intersect(
    photos: Sequence[OrientedPhoto],
    uv: ArrayLike,
    sigma_px: ArrayLike,
    *,
    joint: JointCovariance | None = None,
) -> Intersection:
    """Ground point that pixels of several photos show, all marks believed.

    Parameters
    ----------
    photos
        Each once.
    uv : shape (n, 2), px
        The point's pixel in each.
    sigma_px : shape (n,) or scalar, px
        One sigma of u and of v.
    joint
        Covariance of the poses together; without it they are taken as independent.

    Raises
    ------
    GeometryError
        If the rays run parallel, do not meet in front of the cameras, or the iteration fails.
    """
    uv = np.asarray(uv, dtype=np.float64).reshape(-1, 2)
    n = len(photos)
    if len({photo.id for photo in photos}) != n or len(uv) != n:
        raise ValueError("one pixel of each photo, and each photo once")
    marks = Marks(
        photo=np.arange(n),
        point=np.zeros(n, dtype=np.int64),
        uv=uv,
        sigma=np.broadcast_to(np.asarray(sigma_px, float), (n,)),
    )
    found = intersect_many(_errors(photos, joint), marks, robust=False)
    if found.failed:
        raise GeometryError(found.failed[0])
    lifted = found.covariance[0].copy()
    # One shift of all cameras with the ground: it moves no ray and is in no residual.
    lifted[2, 2] += max(photo.pose.sigma_height_shared for photo in photos) ** 2
    return Intersection(
        p_enu=found.p_enu[0],
        covariance=lifted,
        residuals_uv=found.residuals,
        normalised=found.normalised,
        sigma0=float(np.sqrt(found.chi2[0] / (2 * n - 3))),
        independent=joint is None,
    )


def _errors(photos: Sequence[OrientedPhoto], joint: JointCovariance | None) -> JointErrors:
    """Errors of photos, independent unless their joint covariance is given."""
    stack, n = PhotoStack.of(photos), len(photos)
    if joint is None:
        return JointErrors(stack)
    together = np.asarray(joint([photo.id for photo in photos]), float)
    if together.shape != (6 * n, 6 * n):
        raise ValueError(f"joint covariance of {n} poses has shape {together.shape}")
    return JointErrors.of_matrix(stack, together)
