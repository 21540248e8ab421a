"""Points by their pixels in several photos; wrong marks are found, told and left out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from georef_gis.frames import Array
from georef_gis.measure.clicks import Clicks, OnFail, clicks_of, raise_first, where_of
from georef_gis.measure.measured import MeasuredPoints, Method, UsedMarks, shared_rows
from georef_gis.measure.on_ground import with_ground
from georef_gis.measure.scene import Scene
from georef_gis.measure.shared_click import with_common
from georef_gis.model.control import Mark
from georef_gis.model.intersection_rays import Bools, Marks
from georef_gis.model.intersections import BLUNDER, Intersections, intersect_many

METHOD: Method = "intersect"
# share of the worst normalised residual from which on another mark may as well be the wrong one
_ALIKE = 0.8


def intersect_points(
    scene: Scene, marks: Sequence[Mark], *, on_fail: OnFail = "raise"
) -> MeasuredPoints:
    """Points that marks of one name show in several photos.

    Parameters
    ----------
    marks
        `photo` is a photo's id; each point once in a photo. Where one of a point's marks is said to
        be `on_ground`, its height there counts too, unless it contradicts the rays.
    on_fail
        "skip" goes on without marks that cannot be used and points that have no solution, and
        says why in `refused`.

    Raises
    ------
    GeometryError
        If a mark cannot be used, a point is marked in one photo only, or its rays run parallel or
        do not meet.
    """
    clicks, unfit = clicks_of(scene, marks)
    clicks = _once(clicks, unfit)
    raise_first(unfit, on_fail)
    names = list(dict.fromkeys(mark.name for mark in marks))
    number = {name: i for i, name in enumerate(names)}
    point = np.array([number[mark.name] for mark in clicks.marks], dtype=np.int64)
    lost: dict[str, list[str]] = {}
    for i, line in unfit.items():
        lost.setdefault(marks[i].name, []).append(line)
    here, place = np.unique(point, return_inverse=True)
    rays = Marks(photo=clicks.photo, point=place, uv=clicks.uv, sigma=clicks.sigma)
    rays = with_common(scene, rays, clicks.shared)
    found = intersect_many(scene.errors, rays)
    refused = {name: lost[name][0] for name in names if name in lost and number[name] not in here}
    failed = {int(i): f"{names[here[i]]}: {why}" for i, why in found.failed.items()}
    raise_first(failed, on_fail)
    refused |= {names[here[i]]: line for i, line in failed.items()}
    title = tuple(names[i] for i in here)
    doubts = _doubts(scene, rays, found, [lost.get(name, []) for name in title])
    points = _measured(scene, rays, clicks.whole, found, title, doubts)
    solved = np.array([i for i in range(len(title)) if i not in failed], dtype=np.int64)
    said = {mark.name for mark in clicks.marks if mark.on_ground}
    points = points.subset(solved).with_refused(refused)
    return with_ground(points, np.array([name in said for name in points.names], dtype=bool))


def _once(clicks: Clicks, unfit: dict[int, str]) -> Clicks:
    """Marks without those of points that the photo shows marked already."""
    seen: dict[tuple[str, int], int] = {}
    good = np.ones(len(clicks), dtype=bool)
    for i, (mark, photo) in enumerate(zip(clicks.marks, clicks.photo, strict=True)):
        first = seen.setdefault((mark.name, int(photo)), i)
        if first != i:
            before = clicks.marks[first]
            good[i] = False
            unfit[int(clicks.number[i])] = (
                f"{where_of(mark)}marked in photo {mark.photo} twice, at ({before.u:.7g}, "
                f"{before.v:.7g}) and ({mark.u:.7g}, {mark.v:.7g}) px; remove the wrong one"
            )
    return clicks.where(good)


def _measured(
    scene: Scene,
    marks: Marks,
    sigma: Array,
    found: Intersections,
    names: tuple[str, ...],
    doubts: tuple[tuple[str, ...], ...],
) -> MeasuredPoints:
    n, errors = len(names), scene.errors
    of_level = np.zeros(n)
    of_marks = np.where(found.used, errors.level_sigma(marks.photo), 0.0)
    np.maximum.at(of_level, marks.point, of_marks)
    level = np.zeros((n, 3, 1))
    level[:, 2, 0] = of_level
    each = found.covariance.copy()
    each[:, 2, 2] += of_level**2
    parts = [
        (marks.point, 6 * marks.photo, found.by_pose),
        (marks.point, errors.camera_columns(marks.photo), found.by_camera),
        (np.arange(n), np.full(n, errors.size - 1), level),
    ]
    order = np.argsort(marks.point, kind="stable")
    return MeasuredPoints(
        scene=scene,
        names=names,
        methods=(METHOD,) * n,
        p_enu=found.p_enu,
        each=each,
        own=found.own,
        by_height=np.zeros((n, 3)),
        shared=shared_rows((3 * n, errors.size), parts),
        chi2=found.chi2,
        marks=UsedMarks(
            point=marks.point[order], photo=marks.photo[order], uv=marks.uv[order],
            sigma=sigma[order], used=found.used[order], residuals=found.residuals[order],
            normalised=found.normalised[order],
        ),
        doubts=doubts,
    )  # fmt: skip


def _doubts(
    scene: Scene, marks: Marks, found: Intersections, lost: Sequence[Sequence[str]]
) -> tuple[tuple[str, ...], ...]:
    """What is doubtful about each point, in words."""
    order = np.argsort(marks.point, kind="stable")
    first = np.searchsorted(marks.point[order], np.arange(len(lost) + 1))
    worst = np.zeros(len(lost))
    np.maximum.at(worst, marks.point, found.normalised)
    photos = scene.photos.photos
    out = []
    for i, lines in enumerate(lost):
        told = [f"left out: {line}" for line in lines]
        if worst[i] > BLUNDER:
            rows = order[first[i] : first[i + 1]]
            ids = [photos[k].id for k in marks.photo[rows]]
            told += _of_blunders(ids, found.used[rows], found.normalised[rows])
        out.append(tuple(told))
    return tuple(out)


def _of_blunders(ids: Sequence[str], used: Bools, w: Array) -> list[str]:
    """Marks that do not fit, in words; normalised residuals `w` (r,)."""
    out = []
    for i in (int(k) for k in np.flatnonzero(~used)):
        fit = "its ray meets no other" if np.isinf(w[i]) else f"w = {w[i]:.1f}"
        out.append(f"the mark in photo {ids[i]} does not fit ({fit}): left out")
    left = np.flatnonzero(used)
    if len(left) == 2 and len(out):
        out.append("two rays are left: which of the marks is wrong is not certain; mark it again")
    worst = float(w[left].max(initial=0.0))
    if worst > BLUNDER and not out:
        alike = [ids[int(i)] for i in left if w[i] >= _ALIKE * worst]
        out.append(
            f"the marks in photos {', '.join(alike)} do not fit together (w = {worst:.1f}): one "
            "is wrong; mark it in a third photo to tell which"
        )
    return out
