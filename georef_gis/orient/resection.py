"""Exterior orientation of one photo from surveyed points marked in it (space resection)."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from georef_gis.errors import GeometryError
from georef_gis.frames import Array, log_so3
from georef_gis.model.camera import Camera
from georef_gis.model.pose import Pose
from georef_gis.orient.resection_fit import Fit, Flags, Solver
from georef_gis.orient.resection_marks import FEWEST, FEWEST_TO_TEST, ControlMarks
from georef_gis.orient.resection_starts import consensus, starts

# sigmas; two poses of planar marks that differ by less (squared) both explain them
SAME_FIT = 9.2
# rms of the standardised residuals beyond which the marks belong to another scene
HOPELESS = 30.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Resection:
    """A photo's pose by resection.

    Parameters
    ----------
    pose
        Of kind "adjusted"; its covariance is scaled by `sigma0` only where that is > 1 with more
        than 30 degrees of freedom.
    residuals : shape (n, 2), px
        Measured minus computed, of all marks.
    used : shape (n,)
        False for marks found to be blunders.
    alternative
        Second pose that explains planar marks as well; None where there is but one.
    """

    pose: Pose
    residuals: Array
    used: Flags
    sigma0: float
    redundancy: int
    alternative: Pose | None = None
    doubts: tuple[str, ...] = field(default=())


def resect(
    camera: Camera, marks: ControlMarks, *, prior: Pose | None = None, photo_id: str = ""
) -> Resection:
    """Pose of one photo from at least four marks, or fewer with a prior pose.

    Parameters
    ----------
    camera
        Its interior orientation, taken as without error.
    prior
        Pose with covariance, used as an observation; its velocities serve a rolling shutter.
    photo_id
        For messages.

    Raises
    ------
    GeometryError
        If the marks are too few, lie in a line, or do not fit one another.

    Notes
    -----
    Start by SQPnP (Terzakis and Lourakis 2020) on subsets of the marks, and by IPPE (Collins and
    Bartoli 2014) for the two poses of planar ones; then weighted least squares with data snooping.
    """
    where = f"photo {photo_id}: " if photo_id else ""
    _check_geometry(marks, prior, where)
    solver = Solver(camera, marks, prior)
    first = [solver.pose_at(*start) for start in starts(camera, marks)]
    fits = solver.fits(([prior] if prior is not None else []) + first)
    if len(marks) >= FEWEST_TO_TEST and not (fits and fits[0].used.all()):
        fits = solver.fits([solver.pose_at(*one) for one in consensus(camera, marks)], fits)
    if not fits:
        raise GeometryError(
            f"{where}no pose puts the {len(marks)} marks in front of the camera; check their names "
            "and the order of their coordinates"
        )
    best = fits[0]
    _check_fit(best, marks, where)
    return _result(solver, best, _second(best, fits), where)


# -- judgement ----------------------------------------------------------------------------------


def _check_geometry(marks: ControlMarks, prior: Pose | None, where: str) -> None:
    n = len(marks)
    if n == 0 or (n < FEWEST and prior is None):
        raise GeometryError(
            f"{where}{n} marks do not give a pose; mark {FEWEST} points, or give a prior pose"
        )
    if n >= FEWEST and prior is None:
        size = np.linalg.svd(marks.p_enu - marks.p_enu.mean(axis=0), compute_uv=False)
        if size[1] < 0.01 * size[0]:
            raise GeometryError(
                f"{where}the {n} marked points lie in a line ({size[1] / math.sqrt(n):.3g} m "
                "across it): the turn about it cannot be told; mark a point beside the line"
            )


def _check_fit(best: Fit, marks: ControlMarks, where: str) -> None:
    n = int(np.count_nonzero(best.used))
    rms = math.sqrt(best.chi2 / max(2 * n - 6, 1))
    if (n > FEWEST or rms > 3 * HOPELESS) and rms > HOPELESS:
        raise GeometryError(
            f"{where}the {n} marks do not fit one another: rms of {rms:.0f} sigma; check names, "
            "the order east, north, height and the camera"
        )
    heights = marks.p_enu[best.used, 2]
    if best.pose.origin_enu[2] < heights.min() and best.pose.R_enu_from_cam[2, 2] > 0.5:
        raise GeometryError(
            f"{where}by the {n} marks the camera would lie under the ground and look up: are east "
            "and north swapped?"
        )
    if len(marks) >= FEWEST_TO_TEST and 5 * n < 3 * len(marks):
        raise GeometryError(
            f"{where}only {n} of {len(marks)} marks fit one pose; check names and coordinates"
        )


def _second(best: Fit, fits: list[Fit]) -> Pose | None:
    """Another pose that explains the marks as well as the best one."""
    for fit in fits[1:]:
        turn = log_so3(fit.pose.R_enu_from_cam @ best.pose.R_enu_from_cam.T)
        if np.linalg.norm(turn) > 1e-3 and fit.score - best.score < SAME_FIT:
            return fit.pose
    return None


def _result(solver: Solver, best: Fit, second: Pose | None, where: str) -> Resection:
    marks, prior = solver.marks, solver.prior
    used = int(np.count_nonzero(best.used))
    redundancy = 2 * used - (0 if prior is not None else 6)
    sigma0 = math.sqrt(best.chi2 / redundancy) if redundancy > 0 else math.nan
    scale = sigma0**2 if redundancy > 30 and sigma0 > 1.0 else 1.0
    pose = replace(best.pose, covariance=scale * best.pose.covariance)
    doubts = [
        f"{where}mark of {marks.name(int(i))} is off by "
        f"{np.hypot(*solver.residuals(pose)[i]):.1f} px: left out; check it"
        for i in np.flatnonzero(~best.used)
    ]
    if second is not None:
        turn = log_so3(second.R_enu_from_cam @ pose.R_enu_from_cam.T)
        doubts.append(
            f"{where}the marks lie near a plane and a second pose explains them as well "
            f"({math.degrees(np.linalg.norm(turn)):.1f} deg away); mark points at other heights"
        )
    distance = float(np.median(np.linalg.norm(marks.p_enu - pose.origin_enu, axis=1)))
    sd = float(np.sqrt(np.max(np.linalg.eigvalsh(pose.covariance[:3, :3]))))
    if sd > 0.05 * distance:
        doubts.append(
            f"{where}the position is weak: one sigma of {sd:.2f} m over {distance:.1f} m; mark "
            "points farther apart"
        )
    if math.isfinite(sigma0) and redundancy <= 30 and sigma0 > 3.0:
        doubts.append(f"{where}the marks fit to {sigma0:.1f} sigma only; check them")
    return Resection(
        pose=pose,
        residuals=solver.residuals(pose),
        used=best.used,
        sigma0=sigma0,
        redundancy=redundancy,
        alternative=second,
        doubts=tuple(doubts),
    )
