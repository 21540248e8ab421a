"""Measured points with ONE linear model of their errors, so that any two know what they share."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array, vstack

from georef_gis.frames import Array
from georef_gis.measure.scene import Scene
from georef_gis.model.photo_stack import Ints

Method = Literal["locate", "intersect", "intersect_ground"]
# ("pose", photo id), ("camera", sensor id) or ("level", "")
Unknown = tuple[str, str]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class UsedMarks:
    """Clicks of measured points, point by point.

    Parameters
    ----------
    point, photo : shape (m,)
        Index of the point, in ascending order, and of the photo in the scene.
    uv : shape (m, 2), px
    sigma : shape (m,), px
    used : shape (m,)
        False where a mark was found wrong and left out.
    residuals : shape (m, 2), px
        Marked minus projected; zero for a point located in one photo.
    normalised : shape (m,)
        Baarda's test value: above 4.4, a blunder.
    """

    point: Ints
    photo: Ints
    uv: Array
    sigma: Array
    used: NDArray[np.bool_]
    residuals: Array
    normalised: Array

    def of_point(self, i: int) -> UsedMarks:
        """Those of one point, which is then the first."""
        first, last = np.searchsorted(self.point, [i, i + 1])
        at = slice(int(first), int(last))
        return UsedMarks(
            point=np.zeros(last - first, dtype=np.int64), photo=self.photo[at], uv=self.uv[at],
            sigma=self.sigma[at], used=self.used[at], residuals=self.residuals[at],
            normalised=self.normalised[at],
        )  # fmt: skip

    def of(self, points: Ints, n: int) -> UsedMarks:
        """Those of some of n points, which are counted anew in that order."""
        number = np.full(n, -1)
        number[points] = np.arange(len(points))
        at = np.flatnonzero(number[self.point] >= 0)
        at = at[np.argsort(number[self.point[at]], kind="stable")]
        return UsedMarks(
            point=number[self.point[at]], photo=self.photo[at], uv=self.uv[at],
            sigma=self.sigma[at], used=self.used[at], residuals=self.residuals[at],
            normalised=self.normalised[at],
        )  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MeasuredPoint:
    """One measured point.

    Parameters
    ----------
    p_enu : shape (3,), m
    covariance : shape (3, 3), m^2
        Of the place above the ellipsoid, level included.
    method
        "locate": one photo and the ground; "intersect": several photos; "intersect_ground": several
        photos and the ground.
    photo_ids, uv : shape (k, 2) px, used : shape (k,)
        Marks; those not used were found wrong.
    residuals : shape (k, 2), px
    normalised : shape (k,)
    sigma0
        Square root of chi^2 per degree of freedom, near 1 where the sigmas hold; NaN without any.
    dof
        Degrees of freedom: 2 for each ray, and 1 for the ground, less the 3 of the place.
    own : shape (3, 3), m^2
        What no other point shares: the clicks.
    by_height : shape (3,), m/m
        By the height of the ground there; zero where rays alone tell the place.
    scene, shared : shape (3, U)
        Where it was measured; its derivatives by the unknowns of the scene.
    doubts
        One line each.
    """

    name: str
    p_enu: Array
    covariance: Array
    method: Method
    photo_ids: tuple[str, ...]
    uv: Array
    sigma_px: Array
    used: NDArray[np.bool_]
    residuals: Array
    normalised: Array
    sigma0: float
    dof: int
    own: Array
    by_height: Array
    scene: Scene
    shared: csr_array
    doubts: tuple[str, ...] = ()

    @property
    def n_rays(self) -> int:
        """Marks that the place rests on."""
        return int(np.count_nonzero(self.used))

    @property
    def sensitivity(self) -> dict[Unknown, Array]:
        """Derivatives (3, k) by the errors that points share, by what errs.

        Poses in m and rad, cameras after `CAMERA_NAMES`, the level in its own sigmas.
        """
        rows = self.shared.tocsc()
        errors, n = self.scene.errors, 6 * len(self.scene.photos)
        out: dict[Unknown, Array] = {}
        for k in photos_in(rows, len(self.scene.photos)):
            key = ("pose", self.scene.photos.photos[k].id)
            out[key] = rows[:, 6 * k : 6 * k + 6].toarray()
        for c, name in enumerate(errors.cameras.ids):
            block = rows[:, n + 11 * c : n + 11 * c + 11].toarray()
            if np.any(block):
                out["camera", name] = block
        level = rows[:, -1:].toarray()
        if np.any(level):
            out["level", ""] = level
        return out


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MeasuredPoints:
    """Measured points of one scene and the covariance of all of them together.

    The error of point i is `shared_i x + by_height_i h_i + own_i`: x are the unknowns of
    `Scene.errors`, h_i the error of the ground's height there, own_i that of its clicks.

    Parameters
    ----------
    names, methods
        Of the n points.
    p_enu : shape (n, 3), m
    each : shape (n, 3, 3), m^2
        Covariance of each point alone.
    own : shape (n, 3, 3), m^2
    by_height : shape (n, 3), m/m
    shared : shape (3 n, U)
        By the unknowns of the scene.
    chi2 : shape (n,)
        Of the marks in use, and of the ground with them; NaN for a located point.
    marks
        All clicks.
    doubts
        Of each point, one line each.
    refused
        Names of points that could not be measured, and why; where they were to be skipped.
    """

    scene: Scene
    names: tuple[str, ...]
    methods: tuple[Method, ...]
    p_enu: Array
    each: Array
    own: Array
    by_height: Array
    shared: csr_array
    chi2: Array
    marks: UsedMarks
    doubts: tuple[tuple[str, ...], ...]
    refused: dict[str, str] = field(default_factory=dict)

    def __len__(self) -> int:
        """Number of points."""
        return len(self.names)

    @overload
    def __getitem__(self, i: int) -> MeasuredPoint: ...
    @overload
    def __getitem__(self, i: slice) -> MeasuredPoints: ...
    def __getitem__(self, i: int | slice) -> MeasuredPoint | MeasuredPoints:
        """One point, or some of them."""
        if isinstance(i, slice):
            return self.subset(np.arange(len(self))[i])
        if not -len(self) <= i < len(self):
            raise IndexError(f"point {i} of {len(self)}")
        return self._one(i % len(self))

    def __iter__(self) -> Iterator[MeasuredPoint]:
        """Point by point."""
        return (self._one(i) for i in range(len(self)))

    def _one(self, i: int) -> MeasuredPoint:
        marks = self.marks.of_point(i)
        by_ground = self.methods[i] == "intersect_ground"
        dof = max(2 * int(np.count_nonzero(marks.used)) - 3 + by_ground, 0)
        photos = self.scene.photos.photos
        return MeasuredPoint(
            name=self.names[i],
            p_enu=self.p_enu[i],
            covariance=self.each[i],
            method=self.methods[i],
            photo_ids=tuple(photos[k].id for k in marks.photo),
            uv=marks.uv,
            sigma_px=marks.sigma,
            used=marks.used,
            residuals=marks.residuals,
            normalised=marks.normalised,
            sigma0=float(np.sqrt(self.chi2[i] / dof)) if dof else float("nan"),
            dof=dof,
            own=self.own[i],
            by_height=self.by_height[i],
            scene=self.scene,
            shared=self.shared[3 * i : 3 * i + 3],
            doubts=self.doubts[i],
        )

    # -- covariance ------------------------------------------------------------------------

    def covariance_of(self, i: int) -> Array:
        """Covariance of one point alone; shape (3, 3), m^2."""
        return np.asarray(self.each[i])

    def covariances(self) -> Array:
        """Covariance of each point alone; shape (n, 3, 3), m^2."""
        return self.each

    def covariance(self, indices: ArrayLike | None = None) -> Array:
        """Joint covariance of points; shape (3 k, 3 k), m^2 in enu.

        Parameters
        ----------
        indices
            Of the k points; all by default.
        """
        at = np.arange(len(self)) if indices is None else np.asarray(indices, dtype=np.int64)
        rows = (3 * at[:, None] + np.arange(3)).ravel()
        chosen = self.shared[rows]
        photos = photos_in(chosen, len(self.scene.photos))
        dense = chosen[:, self.scene.errors.columns(photos)].toarray()
        out = dense @ self.scene.errors.joint(photos) @ dense.T
        out = out.reshape(len(at), 3, len(at), 3)
        heights = self.scene.ground.between(self.p_enu[at, :2], self.p_enu[at, :2])
        by_height = self.by_height[at]
        out += np.einsum("ai,ab,bj->aibj", by_height, heights, by_height)
        every = np.arange(len(at))
        out[every, :, every, :] += self.own[at]
        flat = out.reshape(3 * len(at), 3 * len(at))
        return np.asarray((flat + flat.T) / 2)

    def with_each(self, each: Array) -> MeasuredPoints:
        """The same with the covariance of each point alone, (n, 3, 3) m^2."""
        return replace(self, each=each)

    def with_doubts(self, doubts: tuple[tuple[str, ...], ...]) -> MeasuredPoints:
        """The same with these doubts of each point."""
        return replace(self, doubts=doubts)

    def with_refused(self, refused: dict[str, str]) -> MeasuredPoints:
        """The same, and why others could not be measured."""
        return replace(self, refused=refused)

    # -- other sets ------------------------------------------------------------------------

    def subset(self, indices: ArrayLike) -> MeasuredPoints:
        """Some of the points, in that order."""
        at = np.asarray(indices, dtype=np.int64)
        rows = (3 * at[:, None] + np.arange(3)).ravel()
        return replace(
            self,
            names=tuple(self.names[i] for i in at),
            methods=tuple(self.methods[i] for i in at),
            p_enu=self.p_enu[at],
            each=self.each[at],
            own=self.own[at],
            by_height=self.by_height[at],
            shared=self.shared[rows],
            chi2=self.chi2[at],
            marks=self.marks.of(at, len(self)),
            doubts=tuple(self.doubts[i] for i in at),
        )

    @classmethod
    def joined(cls, *parts: MeasuredPoints) -> MeasuredPoints:
        """Points of one scene, measured one way and the other, as one set."""
        first = parts[0]
        if any(part.scene is not first.scene for part in parts):
            raise ValueError("points of different scenes share no errors that are known")
        starts = np.cumsum([0, *(len(part) for part in parts)])
        arrays: dict[str, Any] = {
            name: np.concatenate([getattr(part, name) for part in parts])
            for name in ("p_enu", "each", "own", "by_height", "chi2")
        }
        marks: dict[str, Any] = {
            name: np.concatenate([getattr(part.marks, name) for part in parts])
            for name in ("photo", "uv", "sigma", "used", "residuals", "normalised")
        }
        numbers = [part.marks.point + start for part, start in zip(parts, starts, strict=False)]
        return cls(
            scene=first.scene,
            names=tuple(name for part in parts for name in part.names),
            methods=tuple(method for part in parts for method in part.methods),
            shared=csr_array(vstack([part.shared for part in parts])),
            marks=UsedMarks(point=np.concatenate(numbers), **marks),
            doubts=tuple(lines for part in parts for lines in part.doubts),
            refused={name: why for part in parts for name, why in part.refused.items()},
            **arrays,
        )


def _columns(rows: csr_array) -> Ints:
    """Columns of a matrix that hold anything, each once."""
    entries = rows.tocoo()
    return np.unique(entries.coords[1][entries.data != 0.0]).astype(np.int64)


def photos_in(shared: csr_array, n_photos: int) -> Ints:
    """Photos whose poses rows of `MeasuredPoints.shared` depend on."""
    columns = _columns(shared)
    return np.asarray(np.unique(columns[columns < 6 * n_photos] // 6))


def shared_rows(shape: tuple[int, int], parts: Sequence[tuple[Ints, Ints, Array]]) -> csr_array:
    """Matrix of blocks.

    Parameters
    ----------
    shape
        Of the matrix: three rows a point.
    parts
        Point (m,), first column (m,), blocks (m, 3, k); what stands at one place adds up.
    """
    rows, columns, values = [], [], []
    for point, first, blocks in parts:
        k = blocks.shape[2]
        rows.append(np.broadcast_to((3 * point[:, None] + np.arange(3))[..., None], blocks.shape))
        columns.append(np.broadcast_to((first[:, None] + np.arange(k))[:, None, :], blocks.shape))
        values.append(blocks)
    ij = tuple(np.concatenate([x.ravel() for x in part]) for part in (rows, columns))
    return csr_array((np.concatenate([x.ravel() for x in values]), ij), shape=shape)
