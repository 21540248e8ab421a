"""Space intersection of many points at once, each from its pixels in several photos.

Gauss-Newton on the collinearity equations with the full covariance of the pixels that marks, poses
and cameras give (generalised least squares), then data snooping: Foerstner and Wrobel,
Photogrammetric Computer Vision (2016), sections 4.4 and 13.4; Baarda, A testing procedure for use
in geodetic networks (1968).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from georef_gis.frames import Array
from georef_gis.model.intersection_rays import Bools, Marks, RayGroup, RaySolver
from georef_gis.model.joint_errors import JointErrors
from georef_gis.model.photo_stack import Ints

# normalised residual from which a mark is wrong: one of 16 000 good ones
BLUNDER = 4.4
# share of its weight that a residual must keep to be a test of its mark
_CONTROLLED = 1e-9
# numbers of one array up to which points are taken together: 32 MB
_MOST_NUMBERS = 4_000_000


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Intersections:
    """n points from m marks.

    Parameters
    ----------
    p_enu : shape (n, 3), m
        NaN where there is no solution.
    covariance : shape (n, 3, 3), m^2
        Poses, cameras and marks count; the level that photos and ground share does not.
    own : shape (n, 3, 3), m^2
        The marks' part of it, which no other point shares.
    by_pose, by_camera : shapes (m, 3, 6), (m, 3, 11)
        Derivatives of a mark's point by the error of its photo's pose and of its sensor; "true
        minus stated" on both sides; zero where a mark is not used. What photos share of a sensor
        stands at the first of them.
    normalised : shape (m,)
        Normalised residual of each mark, u and v together (Baarda's test in two dimensions), as
        it was when the mark was judged; inf where its point has no solution with it.
    used : shape (m,)
    residuals : shape (m, 2), px
        Marked minus projected, also of marks that are not used.
    chi2 : shape (n,)
        Of the marks used.
    rays : shape (n,)
        Marks used.
    failed
        Why points have no solution, by their index.
    """

    p_enu: Array
    covariance: Array
    own: Array
    by_pose: Array
    by_camera: Array
    normalised: Array
    used: Bools
    residuals: Array
    chi2: Array
    rays: Ints
    failed: dict[int, str] = field(default_factory=dict)


def intersect_many(errors: JointErrors, marks: Marks, *, robust: bool = True) -> Intersections:
    """Points that pixels of several photos show.

    Parameters
    ----------
    robust
        Leave out wrong marks of points with three or more, one after the other.
    """
    work = _Work(errors, marks)
    work.solve(np.arange(marks.n_points))
    if robust:
        work.without_failures()
        work.snoop()
    return work.result()


class _Work:
    """Points on their way: what is solved stands in arrays over all points and marks."""

    def __init__(self, errors: JointErrors, marks: Marks) -> None:
        n, m = marks.n_points, len(marks.photo)
        self.errors, self.marks = errors, marks
        self.solver = RaySolver(errors, marks)
        self.failed = self.solver.failed
        self.used = np.ones(m, dtype=bool)
        self.p, self.chi2 = np.full((n, 3), np.nan), np.full(n, np.nan)
        self.covariance, self.own = np.full((n, 3, 3), np.nan), np.full((n, 3, 3), np.nan)
        self.by_pose, self.by_camera = np.zeros((m, 3, 6)), np.zeros((m, 3, 11))
        self.normalised = np.zeros(m)

    @property
    def rays(self) -> Ints:
        """Marks in use of each point; shape (n,)."""
        return np.bincount(self.marks.point[self.used], minlength=self.marks.n_points)

    def solve(self, points: Ints) -> None:
        """Solve points by their marks in use."""
        for i in points:
            self.failed.pop(int(i), None)
        rays = self.rays
        for i in points[rays[points] < 2]:
            self.failed[int(i)] = f"{rays[i]} ray gives no point; mark it in two photos or more"
        for chosen, rows in self._groups(points, rays):
            self._keep(self.solver.solve(chosen, rows))

    def _groups(self, points: Ints, rays: Ints) -> Iterator[tuple[Ints, Ints]]:
        """Points with as many rays each, and their marks (n, r); in parts that fit."""
        at = np.flatnonzero(self.used)
        at = at[np.argsort(self.marks.point[at], kind="stable")]
        first = np.concatenate([[0], np.cumsum(rays)])
        for r in np.unique(rays[points]):
            if r < 2:
                continue
            chosen = points[rays[points] == r]
            size = (6 * int(r) + len(self.errors.cameras.covariance)) ** 2
            for part in np.array_split(chosen, int(np.ceil(len(chosen) * size / _MOST_NUMBERS))):
                yield part, at[first[part][:, None] + np.arange(r)]

    def _keep(self, group: RayGroup) -> None:
        n, r = group.rows.shape
        residuals = self.solver.residuals(group)
        weighted = np.einsum("nij,nj->ni", group.weight, residuals)
        self.p[group.points], self.covariance[group.points] = group.p_enu, group.covariance
        self.chi2[group.points] = np.einsum("ni,ni->n", residuals, weighted)
        self.own[group.points] = self.solver.by_clicks(group)
        # the place follows the stated poses: it errs the other way
        by_shared = -group.gain @ group.by_shared
        column = self.solver.camera_columns(group.rows)
        for i in range(r):
            self.by_pose[group.rows[:, i]] = by_shared[:, :, 6 * i : 6 * i + 6]
            taken = by_shared[np.arange(n)[:, None, None], np.arange(3)[:, None], column[:, i]]
            earlier = np.any(column[:, :i, 0, 0] == column[:, i : i + 1, 0, 0], axis=1)
            self.by_camera[group.rows[:, i]] = np.where(earlier[:, None, None], 0.0, taken)
        self.normalised[group.rows] = _normalised(group, weighted)

    # -- wrong marks -----------------------------------------------------------------------

    def without_failures(self) -> None:
        """Leave out the mark without which a point that has no solution has the best one."""
        rays = self.rays
        for i in [i for i in self.failed if rays[i] >= 3]:
            found = []
            for row in np.flatnonzero(self.used & (self.marks.point == i)):
                self.used[row] = False
                self.solve(np.array([i]))
                if i not in self.failed:
                    found.append((float(self.chi2[i]), int(row)))
                self.used[row] = True
            if found:
                self._leave_out(np.array([min(found)[1]]))
                self.normalised[min(found)[1]] = np.inf
            self.solve(np.array([i]))

    def snoop(self) -> None:
        """Leave out the mark that fits worst, point by point, as long as one does not fit."""
        lost = np.zeros(self.marks.n_points, dtype=bool)
        while True:
            lost[list(self.failed)] = True
            enough = (self.rays >= 3) & ~lost
            wrong = self.used & (self.normalised > BLUNDER) & enough[self.marks.point]
            suspect = np.flatnonzero(wrong)
            if not len(suspect):
                return
            suspect = suspect[np.lexsort((-self.normalised[suspect], self.marks.point[suspect]))]
            points, first = np.unique(self.marks.point[suspect], return_index=True)
            self._leave_out(suspect[first])
            self.solve(points)

    def _leave_out(self, rows: Ints) -> None:
        self.used[rows] = False
        self.by_pose[rows], self.by_camera[rows] = 0.0, 0.0

    def result(self) -> Intersections:
        """What was found."""
        lost = np.zeros(self.marks.n_points, dtype=bool)
        lost[list(self.failed)] = True
        for values in (self.p, self.covariance, self.own, self.chi2):
            values[lost] = np.nan
        self._leave_out(np.flatnonzero(lost[self.marks.point]))
        seen = self.errors.stack.project(self.marks.photo, self.p[self.marks.point])
        return Intersections(
            p_enu=self.p,
            covariance=self.covariance,
            own=self.own,
            by_pose=self.by_pose,
            by_camera=self.by_camera,
            normalised=self.normalised,
            used=self.used,
            residuals=self.marks.uv - seen,
            chi2=self.chi2,
            rays=self.rays,
            failed=dict(sorted(self.failed.items())),
        )


def _normalised(group: RayGroup, weighted: Array) -> Array:
    """Test value of each mark, both of its coordinates taken together; (n, r).

    Its square is by how much chi^2 falls without the mark.
    """
    n, r = group.rows.shape
    of_place = group.weight @ group.by_point
    left = group.weight - of_place @ group.covariance @ np.swapaxes(of_place, 1, 2)
    own = np.stack([left[:, 2 * i : 2 * i + 2, 2 * i : 2 * i + 2] for i in range(r)], axis=1)
    values, vectors = np.linalg.eigh(own)
    along = np.einsum("nrij,nri->nrj", vectors, weighted.reshape(n, r, 2))
    # A residual that nothing controls tells nothing.
    least = _CONTROLLED * np.einsum("nii->ni", group.weight).reshape(n, r, 2).max(axis=2)
    controlled = values > least[..., None]
    square = np.where(controlled, along**2 / np.where(controlled, values, 1.0), 0.0)
    return np.asarray(np.sqrt(square.sum(axis=2)))
