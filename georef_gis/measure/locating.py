"""Points by one photo and the ground, with all that makes them unsure."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from georef_gis.frames import Array
from georef_gis.measure.clicks import Clicks, OnFail, clicks_of, raise_first, told, where_of
from georef_gis.measure.measured import MeasuredPoints, Method, UsedMarks, shared_rows
from georef_gis.measure.scene import Scene
from georef_gis.measure.tied_ground import tied_heights, tied_parts, untied_variance
from georef_gis.model.control import Mark
from georef_gis.model.ground_point import (
    GRAZING,
    GroundSensitivities,
    ground_normal,
    ground_sensitivities,
)
from georef_gis.model.intersection_rays import Bools

METHOD: Method = "locate"
# rad; under a smaller angle the ground says little of how far off a place is
FLAT_VIEW = math.radians(10.0)
# share of the distance from the camera from which on an ellipse is a rough guide only
ROUGH = 0.25
# m; the ground's slope is taken over the place's sigma, between these
_LEAST_BASE, _MOST_BASE = 1.0, 50.0
# points whose covariance is laid out together
_PART = 64


def locate_points(
    scene: Scene, marks: Sequence[Mark], *, on_fail: OnFail = "raise"
) -> MeasuredPoints:
    """Ground points that clicks show, each in its photo, by the ground below it.

    Parameters
    ----------
    marks
        One point each; one without a name is numbered. `photo` is a photo's id.
    on_fail
        "skip" leaves out what cannot be located and says why in `refused`.

    Raises
    ------
    GeometryError
        If a photo has no pose, or a pixel lies outside of it, at the sky or beyond the terrain.
    """
    clicks, refused = clicks_of(scene, marks)
    clicks, p = _on_ground(scene, clicks, refused)
    found = _sensitivities(scene, clicks, p)
    steep = np.abs(found.grazing) >= GRAZING
    for i in np.flatnonzero(~steep):
        why = "is seen along the ground: no place can be told; click nearer to the camera"
        refused[int(clicks.number[i])] = told(clicks.marks[i], why)
    raise_first(refused, on_fail)
    if not steep.all():
        clicks, p = clicks.where(steep), p[steep]
        found = _sensitivities(scene, clicks, p)
    return _measured(scene, clicks, p, found, _by_name(marks, refused))


def _by_name(marks: Sequence[Mark], refused: dict[int, str]) -> dict[str, str]:
    """Lines by the names of their marks; a name that comes again has its number with it."""
    out: dict[str, str] = {}
    for i in sorted(refused):
        name = marks[i].name or str(i + 1)
        out[name if name not in out else f"{name} ({i + 1})"] = refused[i]
    return out


# -- where rays meet the ground --------------------------------------------------------------


def _on_ground(scene: Scene, clicks: Clicks, refused: dict[int, str]) -> tuple[Clicks, Array]:
    """Clicks whose rays meet the ground, and where; `refused` learns of the others."""
    above = _above_ground(scene, clicks, refused)
    clicks = clicks.where(above)
    start, way = scene.photos.rays(clicks.photo, clicks.uv)
    p = scene.terrain.intersect(start, way) if len(clicks) else np.zeros((0, 3))
    hit: Bools = np.isfinite(p[:, 0])
    for i in np.flatnonzero(~hit):
        refused[int(clicks.number[i])] = told(clicks.marks[i], _missed(way[i]))
    return clicks.where(hit), p[hit]


def _above_ground(scene: Scene, clicks: Clicks, refused: dict[int, str]) -> Bools:
    """Whether the camera of each click is above the ground."""
    at = scene.photos.origin_enu[clicks.photo]
    depth = scene.terrain.z_at(at[:, :2]) - at[:, 2]
    # where the ground is not known, below a camera beside the DEM, nothing is said
    below = depth >= 0.0
    for i in np.flatnonzero(below):
        refused[int(clicks.number[i])] = (
            f"{where_of(clicks.marks[i])}photo {clicks.marks[i].photo}: its projection centre lies "
            f"{depth[i]:.1f} m below the ground; check the kinds of the heights (ellipsoidal or "
            "orthometric)"
        )
    return np.asarray(~below)


def _missed(way: Array) -> str:
    """Why a ray does not meet the ground, and what to do."""
    if not np.all(np.isfinite(way)):
        return "has no ray by the camera's lens model; click nearer to the middle"
    elevation = math.degrees(math.asin(float(np.clip(way[2], -1.0, 1.0))))
    if elevation > -0.1:
        what = "at" if elevation < 0.1 else f"{elevation:.1f} deg above"
        return f"does not look at the ground but {what} the horizon; click on the ground"
    return (
        "does not look at the ground that is known: its ray leaves the terrain before it comes "
        "down, or comes down in a hole of it; take a photo that looks there more steeply, or a "
        "larger DEM"
    )


# -- what their errors are --------------------------------------------------------------------


def _sensitivities(scene: Scene, clicks: Clicks, p: Array) -> GroundSensitivities:
    """Derivatives on a slope of the ground that is taken over the place's own sigma."""
    photos, terrain = scene.photos, scene.terrain
    normal = ground_normal(terrain, p, base=_LEAST_BASE)
    found = ground_sensitivities(photos, clicks.photo, clicks.uv, p, normal)
    if not len(clicks) or not math.isfinite(terrain.detail):
        return found
    J = found.by_pose[:, :2]
    spread = np.einsum("mij,mjk,mik->m", J, photos.covariance[clicks.photo], J)
    base = np.clip(np.sqrt(spread / 2.0), _LEAST_BASE, _MOST_BASE)
    normal = ground_normal(terrain, p, base=base)
    return ground_sensitivities(photos, clicks.photo, clicks.uv, p, normal)


def _measured(
    scene: Scene, clicks: Clicks, p: Array, found: GroundSensitivities, refused: dict[str, str]
) -> MeasuredPoints:
    n, errors = len(clicks), scene.errors
    every = np.arange(n)
    by_sensor = errors.by_sensor(clicks.photo, found.by_camera)
    level = np.zeros((n, 3, 1))
    level[:, 2, 0] = errors.level_sigma(clicks.photo)
    parts = [
        (every, 6 * clicks.photo, found.by_pose),
        (every, errors.camera_columns(clicks.photo), by_sensor),
        (every, np.full(n, errors.size - 1), level),
    ]
    own = found.by_uv @ np.swapaxes(found.by_uv, 1, 2) * clicks.whole[:, None, None] ** 2
    if scene.tied:
        tied = tied_heights(scene, p, ground_normal(scene.terrain, p))
        parts += tied_parts(scene, tied, found.by_height)
        up = found.by_height
        own = own + up[:, :, None] * up[:, None, :] * untied_variance(scene, tied)[:, None, None]
    points = MeasuredPoints(
        scene=scene,
        names=clicks.names,
        methods=(METHOD,) * n,
        p_enu=p,
        each=np.zeros((n, 3, 3)),
        own=own,
        by_height=found.by_height,
        shared=shared_rows((3 * n, errors.size), parts),
        chi2=np.full(n, np.nan),
        marks=_marks(clicks),
        doubts=((),) * n,
        refused=refused,
    )
    points = points.with_each(_each_alone(points))
    return points.with_doubts(_doubts(scene, clicks, points, found.grazing))


def _marks(clicks: Clicks) -> UsedMarks:
    n = len(clicks)
    return UsedMarks(
        point=np.arange(n), photo=clicks.photo, uv=clicks.uv, sigma=clicks.whole,
        used=np.ones(n, dtype=bool), residuals=np.zeros((n, 2)), normalised=np.zeros(n),
    )  # fmt: skip


def _each_alone(points: MeasuredPoints) -> Array:
    """Covariance of each point alone; shape (n, 3, 3).

    Points of one photo are taken together: they depend on few photos, all near to each other.
    """
    out = np.zeros((len(points), 3, 3))
    order = np.argsort(points.marks.photo, kind="stable")
    ends = np.flatnonzero(np.diff(points.marks.photo[order])) + 1
    for mine in np.split(order, ends):
        for first in range(0, len(mine), _PART):
            at = mine[first : first + _PART]
            joint = points.covariance(at).reshape(len(at), 3, len(at), 3)
            out[at] = joint[np.arange(len(at)), :, np.arange(len(at)), :]
    return out


def _doubts(
    scene: Scene, clicks: Clicks, points: MeasuredPoints, grazing: Array
) -> tuple[tuple[str, ...], ...]:
    """What is doubtful about each place, in words."""
    largest = np.sqrt(np.linalg.eigvalsh(points.each[:, :2, :2])[:, 1])
    away = np.linalg.norm(points.p_enu - scene.photos.origin_enu[clicks.photo], axis=1)
    out = []
    for i, mark in enumerate(clicks.marks):
        lines = [f"photo {mark.photo}: {line}" for line in scene.doubts.get(mark.photo, ())]
        angle = math.asin(min(abs(float(grazing[i])), 1.0))
        if angle < FLAT_VIEW:
            lines.append(
                f"seen under {math.degrees(angle):.1f} deg over the ground: how far off it lies is "
                f"known to {largest[i]:.2g} m; click it in a second photo"
            )
        elif largest[i] > ROUGH * away[i]:
            lines.append(
                f"one sigma is {largest[i]:.3g} m at {away[i]:.3g} m from the camera: the ellipse "
                "is a rough guide"
            )
        out.append(tuple(lines))
    return tuple(out)
