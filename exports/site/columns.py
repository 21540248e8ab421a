"""Layers that are exported, column by column: what is written does not go through features."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, overload

import numpy as np

from exports.site.schemas import Field, FieldKind, GeometryKind, Value

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from georef_gis.frames import Array

_DTYPES: Mapping[FieldKind, Any] = {
    "text": object, "real": np.float64, "integer": np.int64, "flag": np.bool_,
}  # fmt: skip
_BLANKS: Mapping[FieldKind, Value] = {
    "text": None, "real": float("nan"), "integer": 0, "flag": False,
}  # fmt: skip
# Features that a view makes at once
_BATCH = 4096


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Column:
    """Values of a field for all features of a layer.

    Parameters
    ----------
    values : shape (n,)
        str or None, float64, int64 or bool; where missing None, NaN, 0 or False.
    missing : shape (n,)
        Where a value is not known.
    """

    values: NDArray[Any]
    missing: NDArray[np.bool_]

    @classmethod
    def of(cls, kind: FieldKind, values: Sequence[Value] | NDArray[Any]) -> Column:
        """Column of values, None or NaN where one is missing."""
        if isinstance(values, np.ndarray) and values.dtype != object:
            real = values.dtype.kind == "f"
            missing = ~np.isfinite(values) if real else np.zeros(len(values), bool)
            known = np.where(missing, _BLANKS[kind] or 0, values) if real else values
            return cls(values=known.astype(_DTYPES[kind]), missing=missing)
        absent = np.fromiter((value is None for value in values), bool, len(values))
        blank = _BLANKS[kind]
        filled = [blank if value is None else value for value in values]
        array = np.empty(len(filled), dtype=_DTYPES[kind])
        array[:] = filled
        if kind == "real":
            absent |= ~np.isfinite(array)
            array[absent] = np.nan
        return cls(values=array, missing=absent)

    def tolist(self, start: int = 0, stop: int | None = None) -> list[Value]:
        """Plain values, None where missing."""
        values: list[Value] = self.values[start:stop].tolist()
        missing = self.missing[start:stop]
        for i in np.flatnonzero(missing).tolist():
            values[i] = None
        return values


class Places:
    """Vertices of all features of a layer, one feature after the other.

    Parameters
    ----------
    offsets : shape (n + 1,)
        Vertices of feature i are ``offsets[i]:offsets[i + 1]``; a ring is closed.
    xy : shape (v, 2)
        In CRS units.
    height : shape (v,)
        Above the ellipsoid, m; NaN if not known.
    geographic
        Gives lon and lat in degrees of the positions' datum, shape (v, 2), and the heights above
        EGM96 in m, shape (v,); called when first asked for, as not every format needs them.
    """

    def __init__(
        self,
        offsets: NDArray[np.int64],
        xy: Array,
        height: Array,
        geographic: Callable[[], tuple[Array, Array]],
    ) -> None:
        self.offsets = offsets
        self.xy = xy
        self.height = height
        self._make = geographic

    @classmethod
    def of_points(cls, points: Array, offsets: NDArray[np.int64] | None = None) -> Places:
        """Places of the columns that `place` gives; without offsets a point per feature."""
        if offsets is None:
            offsets = np.arange(len(points) + 1)
        return cls(offsets, points[:, 4:6], points[:, 2], lambda: (points[:, :2], points[:, 3]))

    @classmethod
    def none(cls, count: int) -> Places:
        """Features without a place."""
        return cls.of_points(np.zeros((0, 6)), np.zeros(count + 1, np.int64))

    @cached_property
    def _geographic(self) -> tuple[Array, Array]:
        return self._make()

    @property
    def lonlat(self) -> Array:
        """Longitude and latitude of the vertices, deg; shape (v, 2)."""
        return self._geographic[0]

    @property
    def height_orthometric(self) -> Array:
        """Heights of the vertices above EGM96, m, NaN if not known; shape (v,)."""
        return self._geographic[1]

    @property
    def firsts(self) -> NDArray[np.int64]:
        """Index of the first vertex of every feature; shape (n,)."""
        return self.offsets[:-1]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Feature:
    """One thing of a layer, in three frames at once.

    Parameters
    ----------
    values
        By field name; None = not known.
    geo : shape (n, 3)
        lon, lat in degrees of the positions' datum, height above the ellipsoid in m (NaN if not
        known); a polygon is closed.
    xy_map : shape (n, 2)
        In CRS units.
    height_orthometric : shape (n,)
        Above EGM96, m; NaN if not known.
    """

    values: Mapping[str, Value]
    geo: Array
    xy_map: Array
    height_orthometric: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Layer:
    """Features of one kind with their fields.

    Parameters
    ----------
    columns
        By field name, as many values each as there are features.
    measured_heights
        False where heights of vertices are only those of the ground that was assumed.
    """

    name: str
    title: str
    geometry: GeometryKind
    fields: tuple[Field, ...]
    columns: Mapping[str, Column] = field(default_factory=dict)
    places: Places = field(default_factory=lambda: Places.none(0))
    measured_heights: bool = True

    @classmethod
    def of_rows(
        cls,
        name: str,
        title: str,
        geometry: GeometryKind,
        fields: tuple[Field, ...],
        rows: Sequence[Mapping[str, Value]],
        places: Places | None = None,
    ) -> Layer:
        """Layer of rows by field name, each of which may lack some fields."""
        columns = {f.name: Column.of(f.kind, [row.get(f.name) for row in rows]) for f in fields}
        return cls(
            name=name, title=title, geometry=geometry, fields=fields, columns=columns,
            places=Places.none(len(rows)) if places is None else places,
        )  # fmt: skip

    def __len__(self) -> int:
        """Number of features."""
        return len(self.places.offsets) - 1

    def batches(self, vertices: int = 50_000) -> Iterator[tuple[int, int]]:
        """Ranges of features with about so many vertices together, which bounds the memory."""
        offsets, start = self.places.offsets, 0
        while start < len(self):
            end = int(np.searchsorted(offsets, offsets[start] + vertices, side="right")) - 1
            stop = min(max(end, start + 1), start + _BATCH, len(self))
            yield start, stop
            start = stop

    @cached_property
    def solid(self) -> NDArray[np.bool_]:
        """Which features have a measured height at every vertex; shape (n,)."""
        at = self.places
        if not self.measured_heights or not len(self) or not len(at.height):
            return np.zeros(len(self), bool)
        return np.asarray(np.logical_and.reduceat(np.isfinite(at.height), at.firsts))

    @property
    def features(self) -> Features:
        """The same feature by feature, made when asked for."""
        return Features(self)


class Features(Sequence[Feature]):
    """View of a layer as features; slow against its columns."""

    def __init__(self, layer: Layer) -> None:
        self._layer = layer

    def __len__(self) -> int:
        """Number of features."""
        return len(self._layer)

    @overload
    def __getitem__(self, index: int) -> Feature: ...
    @overload
    def __getitem__(self, index: slice) -> list[Feature]: ...
    def __getitem__(self, index: int | slice) -> Feature | list[Feature]:
        """One feature, or several."""
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        i = range(len(self))[index]
        return next(self._batch(i, i + 1))

    def __iter__(self) -> Iterator[Feature]:
        """All features in order."""
        for start in range(0, len(self), _BATCH):
            yield from self._batch(start, min(start + _BATCH, len(self)))

    def _batch(self, start: int, stop: int) -> Iterator[Feature]:
        layer, at = self._layer, self._layer.places
        names = [f.name for f in layer.fields]
        columns = [layer.columns[name].tolist(start, stop) for name in names]
        bounds = at.offsets[start : stop + 1].tolist()
        first, last = bounds[0], bounds[-1]
        geo = np.column_stack([at.lonlat[first:last], at.height[first:last]])
        big_h = at.height_orthometric
        for i, row in enumerate(zip(*columns, strict=True)):
            a, b = bounds[i], bounds[i + 1]
            yield Feature(
                values=dict(zip(names, row, strict=True)),
                geo=geo[a - first : b - first],
                xy_map=at.xy[a:b],
                height_orthometric=big_h[a:b],
            )
