"""Error budget: how much of a measured point's covariance each source of error gives.

A covariance is a sum over independent sources, so the budget is that sum before it is drawn up:
the squares of its entries add to the square of the whole. Where two sources are correlated, as
place and angles of a smoothed trajectory are, their cross terms are an entry of their own, which
may be negative.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from georef_gis.errors import GeometryError
from georef_gis.frames import Array
from georef_gis.measure.locating import locate_points
from georef_gis.measure.measured import MeasuredPoints, photos_in
from georef_gis.measure.scene import Scene
from georef_gis.measure.tied_ground import tied_heights
from georef_gis.model.control import Mark
from georef_gis.model.ground_point import ground_normal
from georef_gis.model.photo_stack import Ints
from georef_gis.model.tin import TinTerrain

# Names of the sources, in the order of tables and plots, and what they are for people.
SOURCES: Mapping[str, str] = MappingProxyType({
    "gnss": "GNSS position",
    "datum": "datum not stated",
    "attitude": "roll, pitch, yaw",
    "boresight": "boresight",
    "lever_arm": "lever arm",
    "time": "time of exposure",
    "calibration": "camera calibration",
    "matching": "tie points and control",
    "pose": "adjusted pose, not taken apart",
    "level": "level of the ground and the cameras",
    "ground": "height of the ground",
    "click": "click",
    "coupling": "position with angles",
})  # fmt: skip
# Entries that are correlations of two others.
COUPLED = {"coupling": ("gnss", "attitude")}


class ErrorParts(Protocol):
    """Errors that measurements share, by source; together they are `Scene.errors`."""

    def parts(self, photos: Ints) -> Mapping[str, Array]:
        """Source -> joint covariance as `JointErrors.joint` of these photos lays it out."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PointBudget:
    """Covariance of one place by source, m^2 in enu.

    Parameters
    ----------
    name
        Of the place: a photo, a pixel, an asset.
    by_source
        Source -> (3, 3). For a photo as a whole the mean over its pixels.
    p_enu : shape (3,), m
    """

    name: str
    by_source: Mapping[str, Array]
    p_enu: Array = field(default_factory=lambda: np.full(3, np.nan))
    pose_kind: str = ""
    photo_ids: tuple[str, ...] = ()

    @property
    def covariance(self) -> Array:
        """By all sources together, (3, 3)."""
        return np.asarray(np.sum([np.zeros((3, 3)), *self.by_source.values()], axis=0))

    def variance(self, source: str | None = None) -> Array:
        """East, north, up, m^2, of one source or of all; shape (3,)."""
        matrix = self.covariance if source is None else self.by_source[source]
        return np.diag(matrix).copy()

    def sigma(self, source: str | None = None) -> Array:
        """One sigma east, north, up, m; with the sign of a negative variance; shape (3,)."""
        return signed_root(self.variance(source))

    def horizontal(self, source: str | None = None) -> float:
        """One sigma per axis of the horizontal place, m: the mean of east and north."""
        return float(signed_root(self.variance(source)[:2].mean()))


def signed_root(variance: ArrayLike) -> Array:
    """Square root that keeps the sign of a negative variance, which only a coupling has."""
    v = np.asarray(variance, dtype=np.float64)
    return np.asarray(np.sign(v) * np.sqrt(np.abs(v)))


# -- measured points ---------------------------------------------------------------------------


def point_budgets(points: MeasuredPoints, errors: ErrorParts) -> list[PointBudget]:
    """Budgets of measured points; the parts of each add to its covariance."""
    scene, known = points.scene, {}
    heights = scene.ground.variance(points.p_enu[:, :2])
    ground = _outer(points.by_height) * heights[:, None, None]
    untied = _untied(points)
    out = []
    for i, name in enumerate(points.names):
        rows = points.shared[3 * i : 3 * i + 3]
        photos = photos_in(rows, len(scene.photos))
        key = tuple(int(k) for k in photos)
        if key not in known:
            known[key] = (scene.errors.columns(photos), errors.parts(photos))
        columns, joint = known[key]
        J = rows[:, columns].toarray()
        parts = {source: J @ covariance @ J.T for source, covariance in joint.items()}
        parts["ground"] = parts.get("ground", 0.0) + ground[i] + untied[i]
        parts["click"] = points.own[i] - untied[i]
        parts = {source: part for source, part in parts.items() if np.any(part)}
        own = points.marks.photo[points.marks.point == i]
        ids = tuple(scene.photos.photos[k].id for k in own)
        kinds = sorted({scene.photos.photos[k].pose.kind for k in own})
        out.append(
            PointBudget(
                name=name, by_source={s: parts[s] for s in _in_order(parts)},
                p_enu=points.p_enu[i], pose_kind=", ".join(kinds), photo_ids=ids,
            )
        )  # fmt: skip
    return out


def _outer(vectors: Array) -> Array:
    return vectors[:, :, None] * vectors[:, None, :]


def _untied(points: MeasuredPoints) -> Array:
    """What the ground gives to the points' own errors: where no two photos tell its height."""
    scene = points.scene
    out = np.zeros((len(points), 3, 3))
    located = np.array([method != "intersect" for method in points.methods], dtype=bool)
    terrain = scene.terrain
    if not (scene.tied and isinstance(terrain, TinTerrain) and np.any(located)):
        return out
    p = points.p_enu[located]
    tied = tied_heights(scene, p, ground_normal(terrain, p)).tied
    share = np.where(tied, 0.0, terrain.sigma_shared**2)
    out[located] = _outer(points.by_height[located]) * share[:, None, None]
    return out


def photo_budgets(
    scene: Scene, photo_ids: Iterable[str], errors: ErrorParts, *, click: float = 1.0,
    grid: int = 3,
) -> tuple[list[PointBudget], dict[str, str]]:  # fmt: skip
    """Budgets of photos: of each the mean over a grid of its pixels that look at the ground.

    Parameters
    ----------
    click
        One sigma of a click, px.

    Returns
    -------
    budgets
        Of the photos that look at the ground.
    refused
        Photo id -> why it has none.
    """
    found: list[PointBudget] = []
    refused: dict[str, str] = {}
    for photo_id in photo_ids:
        camera = scene.photo(photo_id).camera
        steps = (np.arange(grid) + 0.5) / grid
        marks = [
            Mark(
                name=f"{photo_id} {k}", photo=photo_id, u=u * camera.width - 0.5,
                v=v * camera.height - 0.5, sigma_px=click,
            )
            for k, (v, u) in enumerate((v, u) for v in steps for u in steps)
        ]  # fmt: skip
        points = locate_points(scene, marks, on_fail="skip")
        if not len(points):
            refused[photo_id] = next(iter(points.refused.values()), "sees no ground")
            continue
        mean = mean_budget(point_budgets(points, errors), photo_id)
        middle = np.asarray(points.p_enu.mean(axis=0))
        found.append(replace(mean, photo_ids=(photo_id,), p_enu=middle))
    return found, refused


# -- several together --------------------------------------------------------------------------


def usual_budget(budgets: Sequence[PointBudget], name: str, *, share: float = 0.8) -> PointBudget:
    """Mean over those in the middle by their sigma: one that is far off says nothing of the rest.

    Parameters
    ----------
    share
        Of the budgets that count.

    Raises
    ------
    GeometryError
        If there are none.
    """
    if not budgets:
        raise GeometryError("no photo looks at the ground: there is no error budget")
    order = sorted(budgets, key=lambda budget: budget.horizontal())
    out = int(len(order) * (1.0 - share) / 2.0 + 1e-9)
    return mean_budget(order[out : len(order) - out], name)


def mean_budget(budgets: Sequence[PointBudget], name: str) -> PointBudget:
    """Mean of the covariances of several budgets; a source that one lacks counts as nothing."""
    if not budgets:
        raise ValueError("the mean of no budgets")
    present = {source for budget in budgets for source in budget.by_source}
    none = np.zeros((3, 3))
    mean = {s: np.mean([b.by_source.get(s, none) for b in budgets], axis=0) for s in present}
    kinds = sorted({budget.pose_kind for budget in budgets})
    by_source = {source: mean[source] for source in _in_order(mean)}
    return PointBudget(name=name, by_source=by_source, pose_kind=", ".join(kinds))


def _in_order(names: Iterable[str]) -> list[str]:
    present = set(names)
    return [source for source in SOURCES if source in present]


# -- what to fix first -------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class Remedy:
    """What making one source smaller brings; horizontal, per axis, m.

    Parameters
    ----------
    sigma, share
        What the source gives now, and its share of the variance.
    reduced_to, without
        The whole once the source is `factor` of what it is, and once it is gone.
    """

    source: str
    factor: float
    sigma: float
    share: float
    now: float
    reduced_to: float
    without: float


def remedies(budget: PointBudget, *, factor: float = 0.5) -> list[Remedy]:
    """Sources by what reducing each to a share of its sigma brings, the best first.

    Of an adjustment it is what is sure: weighed anew, it would gain no less.
    """
    now = budget.variance()[:2].mean()
    out = []
    for source in budget.by_source:
        if source in COUPLED:
            continue
        own = budget.variance(source)[:2].mean()
        bound = sum(
            budget.variance(pair)[:2].mean()
            for pair, ends in COUPLED.items()
            if source in ends and pair in budget.by_source
        )
        left = [
            float(np.sqrt(max(now - (1.0 - x**2) * own - (1.0 - x) * bound, 0.0)))
            for x in (factor, 0.0)
        ]
        out.append(
            Remedy(
                source=source, factor=factor, sigma=float(np.sqrt(max(own, 0.0))),
                share=float(own / now) if now > 0 else 0.0, now=float(np.sqrt(max(now, 0.0))),
                reduced_to=left[0], without=left[1],
            )
        )  # fmt: skip
    return sorted(out, key=lambda remedy: (remedy.reduced_to, remedy.source))
