"""One least-squares solution of many points with equally many rays each."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from georef_gis.frames import Array
from georef_gis.model.joint_errors import JointErrors
from georef_gis.model.photo_stack import Ints, Views

Bools = NDArray[np.bool_]

# Smallest eigenvalue of the mean of I - d d^T: two rays 0.01 deg apart have 7.6e-9.
PARALLEL = 7.6e-9
# condition of a point's normal matrix from which on it says nothing but rounding
_SINGULAR = 1e14
# px; a mark is no surer: of known poses the weights would be infinite
_LEAST_SIGMA = 1e-6
# m; the iteration stops here
_STEP_TOLERANCE = 1e-7
# m; a step beyond this is one of a search that fails
_FAR = 1e5
_STEPS = 30

PARALLEL_RAYS = "the rays run parallel: no point can be told; mark it in photos from other places"
BEHIND = "the rays do not meet in front of the cameras; check the marks"
NO_SOLUTION = "the intersection has no solution; check marks and sigmas"
NO_RAY = "a mark has no ray; check that it lies in its photo"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Marks:
    """Pixels of points: photo (m,) index, point (m,) index, uv (m, 2) px, sigma (m,) px.

    `common` (m, 2, 2), px, are the derivatives of a mark by two errors of sigma 1 that all marks
    of its point share, and no other point; None where there are none.
    """

    photo: Ints
    point: Ints
    uv: Array
    sigma: Array
    common: Array | None = None

    @property
    def n_points(self) -> int:
        """Number of points: one more than the highest index."""
        return int(self.point.max()) + 1 if len(self.point) else 0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RayGroup:
    """n points with r rays each, on the way to their places.

    Parameters
    ----------
    points : shape (n,)
    rows : shape (n, r)
        Their marks.
    p_enu : shape (n, 3), m
    by_point : shape (n, 2 r, 3), px/m
        Derivatives of the pixels by the place.
    by_shared : shape (n, 2 r, 6 r + 11 C)
        By the errors of the r poses and of all cameras.
    weight : shape (n, 2 r, 2 r), px^-2
        Inverse covariance of the pixels.
    covariance : shape (n, 3, 3), m^2
    gain : shape (n, 3, 2 r), m/px
        Of the place by the pixels.
    """

    points: Ints
    rows: Ints
    p_enu: Array
    by_point: Array
    by_shared: Array
    weight: Array
    covariance: Array
    gain: Array

    @classmethod
    def begun(cls, points: Ints, rows: Ints, p_enu: Array) -> RayGroup:
        """Points at a first place."""
        n, r = rows.shape
        none = np.zeros((n, 0))
        return cls(
            points=points, rows=rows, p_enu=p_enu, by_point=none, by_shared=none, weight=none,
            covariance=none, gain=np.zeros((n, 3, 2 * r)),
        )  # fmt: skip

    def where(self, good: Bools) -> RayGroup:
        """Some of the points."""
        if good.all():
            return self
        kept: dict[str, Any] = {f.name: getattr(self, f.name)[good] for f in fields(self)}
        return replace(self, **kept)


def nearest_points(start: Array, way: Array) -> tuple[Array, Array]:
    """Points nearest to bundles of rays by the sum of squared distances.

    Parameters
    ----------
    start, way : shape (n, r, 3), m
        In enu.

    Returns
    -------
    p_enu : shape (n, 3), m
        NaN where a ray is not finite.
    spread : shape (n,)
        Smallest eigenvalue of the mean of I - d d^T: near 0 the rays run parallel.
    """
    finite: Bools = np.asarray(np.all(np.isfinite(start) & np.isfinite(way), axis=(1, 2)))
    d = np.where(finite[:, None, None], way, [0.0, 0.0, 1.0])
    d = d / np.linalg.norm(d, axis=2, keepdims=True)
    across = np.eye(3) - d[..., :, None] * d[..., None, :]
    spread = np.linalg.eigvalsh(across.mean(axis=1))[:, 0]
    total = across.sum(axis=1)
    total[spread < PARALLEL] = np.eye(3)
    o = np.where(finite[:, None, None], start, 0.0)
    p = np.linalg.solve(total, np.einsum("nrij,nrj->ni", across, o)[..., None])[..., 0]
    return np.where(finite[:, None], p, np.nan), spread


class RaySolver:
    """Solves groups of points; `failed` learns why one has no solution, by its index."""

    def __init__(self, errors: JointErrors, marks: Marks) -> None:
        self.errors, self.marks = errors, marks
        self.failed: dict[int, str] = {}
        self._stack = errors.stack
        self._start, self._way = self._stack.rays(marks.photo, marks.uv)

    def solve(self, points: Ints, rows: Ints) -> RayGroup:
        """Places of points by their marks, those that have a solution.

        Parameters
        ----------
        points : shape (n,)
        rows : shape (n, r)
        """
        group = self._begun(points, rows)
        # twice: the weights are those of the place that was found
        for _ in range(2):
            group = self._converged(self._weighed(group))
        return group

    def residuals(self, group: RayGroup) -> Array:
        """Marked minus projected; (n, 2 r) px, NaN where a point is not seen."""
        n, r = group.rows.shape
        at = group.rows.ravel()
        seen = self._stack.project(self.marks.photo[at], np.repeat(group.p_enu, r, axis=0))
        return np.asarray((self.marks.uv[at] - seen).reshape(n, 2 * r))

    def _good(self, group: RayGroup, good: Bools, why: str) -> RayGroup:
        """Those of the points that are good; the others fail."""
        self.failed |= {int(i): why for i in group.points[~good]}
        return group.where(good)

    def _begun(self, points: Ints, rows: Ints) -> RayGroup:
        p, spread = nearest_points(self._start[rows], self._way[rows])
        finite: Bools = np.isfinite(p[:, 0])
        group = self._good(RayGroup.begun(points, rows, p), finite, NO_RAY)
        return self._good(group, spread[finite] >= PARALLEL, PARALLEL_RAYS)

    def _weighed(self, group: RayGroup) -> RayGroup:
        """Derivatives, weights and covariance at the places as they are."""
        seen = np.asarray(np.all(np.isfinite(self.residuals(group)), axis=1))
        group = self._good(group, seen, BEHIND)
        n, r = group.rows.shape
        photo = self.marks.photo[group.rows.ravel()]
        views = self._stack.views(photo, np.repeat(group.p_enu, r, axis=0))
        J = views.by_point.reshape(n, 2 * r, 3)
        by_shared, spread = self._spread(group.rows, views)
        weight = np.asarray(np.linalg.inv(spread))
        normal = np.swapaxes(J, 1, 2) @ weight @ J
        group = replace(
            group, by_point=J, by_shared=by_shared, weight=weight, covariance=normal
        )  # fmt: skip
        group = self._good(group, np.linalg.cond(normal) < _SINGULAR, NO_SOLUTION)
        covariance = np.asarray(np.linalg.inv(group.covariance))
        gain = covariance @ np.swapaxes(group.by_point, 1, 2) @ group.weight
        return replace(group, covariance=covariance, gain=gain)

    def _spread(self, rows: Ints, views: Views) -> tuple[Array, Array]:
        """Derivatives of the pixels by poses and cameras, and the pixels' covariance."""
        n, r = rows.shape
        photos = self.marks.photo[rows]
        blocks = self.errors.blocks(photos)
        by_camera = self.errors.by_sensor(photos.ravel(), views.by_camera).reshape(n, r, 2, 11)
        by_pose = views.by_pose.reshape(n, r, 2, 6)
        column = self.camera_columns(rows)
        J = np.zeros((n, 2 * r, blocks.shape[1]))
        every = np.arange(n)[:, None, None]
        for i in range(r):
            lines = np.arange(2 * i, 2 * i + 2)
            J[:, lines, 6 * i : 6 * i + 6] = by_pose[:, i]
            J[every, lines[None, :, None], column[:, i]] = by_camera[:, i]
        spread = J @ blocks @ np.swapaxes(J, 1, 2)
        at = np.arange(2 * r)
        sigma = np.maximum(self.marks.sigma[rows], _LEAST_SIGMA)
        spread[:, at, at] += np.repeat(sigma**2, 2, axis=1)
        if self.marks.common is not None:
            common = self.marks.common[rows].reshape(n, 2 * r, 2)
            spread += common @ np.swapaxes(common, 1, 2)
        return J, spread

    def by_clicks(self, group: RayGroup) -> Array:
        """Covariance of places by their own marks alone; (n, 3, 3) m^2."""
        n, r = group.rows.shape
        alone = group.gain * np.repeat(self.marks.sigma[group.rows], 2, axis=1)[:, None, :]
        out = alone @ np.swapaxes(alone, 1, 2)
        if self.marks.common is not None:
            common = group.gain @ self.marks.common[group.rows].reshape(n, 2 * r, 2)
            out += common @ np.swapaxes(common, 1, 2)
        return np.asarray(out)

    def camera_columns(self, rows: Ints) -> Ints:
        """Columns of `by_shared` that are those of each mark's camera; (n, r) -> (n, r, 1, 11)."""
        photos = self.marks.photo[rows]
        first = self.errors.camera_columns(photos) - 6 * len(self._stack) + 6 * rows.shape[1]
        return np.asarray(first[..., None, None] + np.arange(11))

    def _converged(self, group: RayGroup) -> RayGroup:
        """Places that no step moves any more, at the derivatives and weights as they are."""
        p, moving = group.p_enu.copy(), np.arange(len(group.points))
        for _ in range(_STEPS):
            some = RayGroup.begun(group.points[moving], group.rows[moving], p[moving])
            step = np.einsum("nij,nj->ni", group.gain[moving], self.residuals(some))
            p[moving] += step
            length = np.linalg.norm(step, axis=1)
            # what is behind a camera or runs away stops here, and is told below
            moving = moving[(length > _STEP_TOLERANCE) & (length < _FAR)]
            if not len(moving):
                break
        still = np.ones(len(p), dtype=bool)
        still[moving] = False
        group = replace(group, p_enu=p)
        seen = np.asarray(np.all(np.isfinite(self.residuals(group)), axis=1))
        group = self._good(group, seen, BEHIND)
        why = f"the intersection of {group.rows.shape[1]} rays does not converge; check the marks"
        return self._good(group, still[seen], why)
