"""Whether the ground that is known beforehand and the navigation agree, in height and in level."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from georef_gis.frames import Array
from georef_gis.orient.adjustment.covariance import Covariances
from georef_gis.orient.adjustment.ground_weight import FEWEST, about_a_plane
from georef_gis.orient.adjustment.problem import Problem
from georef_gis.orient.adjustment.solve import Solution

# sigmas from which a disagreement is told, and from which the surface is not believed
TOLD, REFUSED = 3.0, 5.0
# of the height above ground: relief under the photos
OF_HEIGHT = 0.05
# m, one sigma of a height of which nothing is believed
FREE = 1000.0


def free_contradicted_height(problem: Problem, solution: Solution) -> None:
    """Leave the height of the ground to the photos where the two contradict each other.

    How far cameras are above the ground follows from focal length and distances between positions
    too. A ground in another height datum would move the photos by the difference.
    """
    ground, state, block = problem.block.ground, solution.state, problem.block
    if ground is None or not block.ties.n_points:
        return
    ties, sigma, off = block.ties, [], []
    for i in np.unique(ties.photo):
        own = ties.point[ties.photo == i]
        z = ground.z_enu[own]
        if np.count_nonzero(np.isfinite(z)) < 3:
            continue
        pose = block.poses[i]
        expected = pose.origin_enu[2] - float(np.nanmedian(z))
        off.append(state.origin[i, 2] - float(np.median(state.points[own, 2])) - expected)
        sigma.append(float(np.hypot(np.sqrt(pose.covariance[2, 2]), OF_HEIGHT * expected)))
    if not off:
        return
    parts = [np.median(sigma), np.median(ground.sigma), ground.sigma_offset]
    whole = float(np.linalg.norm(parts))
    if abs(float(np.median(off))) > REFUSED * whole:
        problem.know_ground(replace(ground, sigma_offset=FREE, sigma_free=FREE))


def without_contradicting_surface(problem: Problem, solution: Solution) -> list[str]:
    """Take a surface out of the problem that is tilted beyond doubt; what there is to tell.

    The solution must be one that the surface had no part in. A surface that is stated to be too
    good would tilt the whole block after itself, and nothing in the pixels would object.
    """
    ground, state = problem.block.ground, solution.state
    n = problem.block.ties.n_points
    if ground is None or ground.surface is None or n < FEWEST:
        return []
    points = state.points[:n]
    off = ground.surface(points[:, :2]) - points[:, 2]
    on = np.isfinite(off)
    if np.count_nonzero(on) < FEWEST:
        return []
    xy = points[on, :2]
    fits, _, slope = about_a_plane(xy, off[on])
    extent = np.maximum(np.sqrt(12.0) * np.std(xy[fits], axis=0), 1.0)
    # a turn about east lifts the north, one about north lowers the east
    turn = np.array([[0.0, -1.0], [1.0, 0.0]])
    sigma = turn @ _tilt_covariance(problem, solution) @ turn.T
    sigma += np.diag((ground.sigma_surface / extent) ** 2)
    sigmas = float(np.sqrt(slope @ np.linalg.solve(sigma, slope)))
    if sigmas <= TOLD:
        return []
    degrees = float(np.degrees(np.arctan(np.linalg.norm(slope))))
    line = (
        f"the DEM and the photos' angles disagree on the level by {degrees:.1f} deg, "
        f"{sigmas:.0f} sigma"
    )
    if sigmas <= REFUSED:
        return [f"{line}; state [ground] sigma_m if the DEM is worse than it says"]
    problem.know_ground(replace(ground, surface=None))
    return [f"{line}: the DEM does not level the photos; check its source, or [ground] sigma_m"]


def _tilt_covariance(problem: Problem, solution: Solution) -> Array:
    """Covariance, rad^2, of the mean turn of the connected photos about east and north; (2, 2)."""
    covariances = Covariances(problem, solution.state, solution.loss.signed)
    seen = np.flatnonzero(np.bincount(problem.ties.photo, minlength=len(solution.state.origin)))
    rows = np.zeros((2, covariances.size))
    for axis in range(2):
        rows[axis, 6 * seen + 3 + axis] = 1.0 / len(seen)
    return covariances.of_rows(rows)
