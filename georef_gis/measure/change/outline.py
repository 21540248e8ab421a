"""Outline of a region at half of its contrast, finer than a cell, and its area with sigma."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry

Image = NDArray[Any]

# cells that an outline may lie beyond the cells of its region
_BEYOND = 4
_ITERATIONS = 8
# cells that a vertex may move in simplifying
_SIMPLER = 0.4
# cells: how well a rim is found where the contrast is high, all of a rim alike
_RIM = 0.35


@dataclass(frozen=True, slots=True, kw_only=True)
class Outline:
    """A region's shape.

    Parameters
    ----------
    shape
        Polygon or several, cells of the grid, (0, 0) = outer corner, y down.
    mask : shape (rows, cols)
        Its cells in the window it was found in.
    area, sigma
        Cells^2.
    """

    shape: BaseGeometry
    mask: NDArray[np.bool_]
    area: float
    sigma: float


def outline(magnitude: Image, cells: NDArray[np.bool_], corner: tuple[int, int]) -> Outline | None:
    """Outline of a region.

    Parameters
    ----------
    magnitude : shape (rows, cols)
        Of the difference, any unit.
    cells : shape (rows, cols)
        Cells of high score.
    corner
        Column and row of the window in the grid.

    Returns
    -------
    Outline or None
        None if nothing stands out.
    """
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * _BEYOND + 1,) * 2)
    allowed = cv2.dilate(cells.astype(np.uint8), kernel) > 0
    floor, top = _levels(magnitude, cells, np.asarray(allowed))
    level = (floor + top) / 2.0
    if not top > floor:
        return None
    count, labels = cv2.connectedComponents((allowed & (magnitude > level)).astype(np.uint8))
    touched = np.bincount(labels[cells & (labels > 0)], minlength=count)
    keep = touched > max(2, touched.max() // 20)
    keep[0] = False
    mask = np.asarray(keep[labels])
    if not mask.any():
        return None
    # parts of others near by must not join in
    field = np.where(mask | (magnitude <= level), magnitude, np.float32(0.9 * level))
    shape = _polygons(field, level, mask, corner)
    if shape is None or shape.is_empty:
        return None
    inside = magnitude[mask]
    noise = float(np.std(magnitude[~allowed])) if (~allowed).any() else 0.0
    softness = noise / max(float(np.median(inside)) - floor, 1e-6)
    sigma = shape.length * math.hypot(_RIM, min(softness, 1.0))
    return Outline(shape=shape, mask=mask, area=float(shape.area), sigma=float(sigma))


def _levels(
    magnitude: Image, cells: NDArray[np.bool_], allowed: NDArray[np.bool_]
) -> tuple[float, float]:
    """Magnitude of the ground about, and of the region: two means, from the extremes on."""
    around = magnitude[~allowed]
    floor = float(np.median(around)) if len(around) else 0.0
    inner = magnitude[allowed]
    top = float(np.quantile(magnitude[cells], 0.9))
    for _ in range(_ITERATIONS):
        high = inner[inner > (floor + top) / 2.0]
        if not len(high):
            break
        top = float(np.median(high))
    return floor, top


def _polygons(field: Image, level: float, mask: NDArray[np.bool_], corner: tuple[int, int]) -> Any:
    import contourpy
    import shapely

    padded = np.pad(field.astype(np.float64), 1, constant_values=0.5 * level)
    generator = contourpy.contour_generator(
        z=padded, fill_type=contourpy.FillType.OuterOffset, corner_mask=False
    )
    filled: Any = generator.filled(level, np.inf)
    points, offsets = filled
    shapes = []
    for ring, bounds in zip(points, offsets, strict=True):
        parts = [ring[i:j] for i, j in itertools.pairwise(bounds)]
        polygon = shapely.Polygon(parts[0], parts[1:])
        inner = polygon.representative_point() if polygon.area > 0 else None
        if inner is not None and _covers(mask, polygon, inner):
            shapes.append(polygon)
    if not shapes:
        return None
    whole = shapely.make_valid(shapely.union_all(shapes).simplify(_SIMPLER))
    parts = [p for p in shapely.get_parts(whole) if p.geom_type == "Polygon"]
    # padded by a cell, and values stand in the middle of cells
    offset = np.array([corner[0] - 0.5, corner[1] - 0.5])
    return shapely.transform(shapely.MultiPolygon(parts), lambda xy: xy + offset)


def _covers(mask: NDArray[np.bool_], polygon: Any, inner: Any) -> bool:
    """Whether a polygon, in the padded array, is about cells of the mask."""
    x0, y0, x1, y1 = polygon.bounds
    part = mask[max(0, int(y0) - 1) : int(y1) + 1, max(0, int(x0) - 1) : int(x1) + 1]
    row, col = round(inner.y) - 1, round(inner.x) - 1
    inside = 0 <= row < mask.shape[0] and 0 <= col < mask.shape[1] and bool(mask[row, col])
    return inside or bool(part.size and part.mean() > 0.2)
