"""Polygons of the things that stand on the site, and their shadows."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from georef_gis.simulate import site
from georef_gis.simulate.site import SiteObject

Array = NDArray[np.float64]
Colour = tuple[float, float, float]

SUN_ELEVATION = math.radians(42.0)
SUN_AZIMUTH = math.radians(205.0)
# Unit vector to the sun in the site's frame. A pleasant light, not the almanac's.
SUN = np.array(
    [
        math.cos(SUN_ELEVATION) * math.sin(SUN_AZIMUTH),
        math.cos(SUN_ELEVATION) * math.cos(SUN_AZIMUTH),
        math.sin(SUN_ELEVATION),
    ]
)
GLASS: Colour = (44.0, 50.0, 58.0)
BLACK: Colour = (38.0, 38.0, 38.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Face:
    """A flat polygon, shape (k, 3), m, in the site's frame, with its colour in full light."""

    points: Array
    colour: Colour


def lit(face: Face, inside: Array) -> Colour:
    """Colour under the sun; `inside` is any point behind the face."""
    normal = np.cross(face.points[1] - face.points[0], face.points[2] - face.points[0])
    normal = normal / max(float(np.linalg.norm(normal)), 1e-12)
    if normal @ (face.points.mean(axis=0) - inside) < 0.0:
        normal = -normal
    light = 0.52 + 0.60 * max(float(normal @ SUN), 0.0) + 0.10 * max(float(normal[2]), 0.0)
    r, g, b = face.colour
    return (r * light, g * light, b * light)


def _prism(low: Array, high: Array, side: Colour, top: Colour) -> list[Face]:
    k = len(low)
    sides = [
        Face(points=np.array([low[i], low[(i + 1) % k], high[(i + 1) % k], high[i]]), colour=side)
        for i in range(k)
    ]
    return [*sides, Face(points=high, colour=top)]


def _ring(item: SiteObject, height: float, radius: float, count: int = 12) -> Array:
    angle = np.arange(count) * 2 * np.pi / count
    offset = np.stack(
        [radius * np.cos(angle), radius * np.sin(angle), np.full(count, height)], axis=-1
    )
    return np.asarray(item.enu + offset)


def _banded(item: SiteObject, levels: tuple[tuple[float, float, Colour], ...]) -> list[list[Face]]:
    """Stacked rings: (height share, radius share, colour of the band above it)."""
    out = []
    for (h0, r0, colour), (h1, r1, _) in pairwise(levels):
        low = _ring(item, h0 * item.height, r0 * item.width / 2)
        high = _ring(item, h1 * item.height, r1 * item.width / 2)
        out.append(_prism(low, high, colour, colour))
    return out


def _colour(item: SiteObject) -> Colour:
    r, g, b = item.colour
    return (float(r), float(g), float(b))


def parts(item: SiteObject) -> Iterator[list[Face]]:
    """Convex parts of an object, from the ground up."""
    paint = _colour(item)
    if item.kind == "cone":
        white: Colour = (255.0, 255.0, 250.0)
        glow: Colour = (255.0, 128.0, 48.0)  # fluorescent
        yield _prism(item.corners(0.0), item.corners(0.05), BLACK, BLACK)
        yield from _banded(
            item, ((0.05, 0.9, glow), (0.5, 0.62, white), (0.75, 0.45, glow), (1.0, 0.25, glow))
        )
    elif item.kind == "drum":
        white = (240.0, 240.0, 236.0)
        yield _prism(_ring(item, 0.0, 0.42), _ring(item, 0.08, 0.42), BLACK, BLACK)
        yield from _banded(
            item,
            ((0.08, 1, paint), (0.4, 1, white), (0.55, 1, paint), (0.7, 1, white), (0.85, 1, paint),
             (1.0, 0.8, paint)),
        )  # fmt: skip
    elif item.kind in ("car", "pickup"):
        yield from _car(item, paint)
    elif item.kind == "truck":
        yield from _truck(item, paint)
    elif item.kind == "roller":
        yield from _roller(item, paint)
    elif item.kind in ("sign", "arrow_board"):
        yield from _panel(item, paint)
    elif item.kind == "building":
        yield from _house(item, paint)


def _box(
    item: SiteObject,
    span: tuple[float, float],
    levels: tuple[float, float],
    widths: tuple[float, float],
) -> tuple[Array, Array]:
    """Bottom and top outlines of a box between two shares of the length, two heights and widths."""
    out = []
    for level, width in zip(levels, widths, strict=True):
        full = item.corners(level)
        rear_r, front_r, front_l, rear_l = full[3], full[0], full[1], full[2]
        right = [rear_r + s * (front_r - rear_r) for s in span]
        left = [rear_l + s * (front_l - rear_l) for s in span]
        centre = [(a + b) / 2 for a, b in zip(right, left, strict=True)]
        out.append(
            np.array(
                [
                    centre[1] + width * (right[1] - centre[1]),
                    centre[1] + width * (left[1] - centre[1]),
                    centre[0] + width * (left[0] - centre[0]),
                    centre[0] + width * (right[0] - centre[0]),
                ]
            )
        )
    return out[0], out[1]


def _car(item: SiteObject, paint: Colour) -> Iterator[list[Face]]:
    h = item.height
    low, high = _box(item, (0.0, 1.0), (0.2, 0.58 * h), (1.0, 0.96))
    yield _prism(low, high, paint, paint)
    span, roof = (
        ((0.12, 0.74), (0.24, 0.60)) if item.kind == "car" else ((0.42, 0.80), (0.46, 0.68))
    )
    foot, _ = _box(item, span, (0.58 * h, h), (0.92, 0.92))
    _, top = _box(item, roof, (0.58 * h, h), (0.80, 0.76))
    yield _prism(foot, top, GLASS, paint)
    if item.kind == "pickup":
        bed, rim = _box(item, (0.03, 0.40), (0.59 * h, 0.6 * h), (0.84, 0.84))
        yield _prism(bed, rim, BLACK, (72.0, 72.0, 74.0))


def _truck(item: SiteObject, paint: Colour) -> Iterator[list[Face]]:
    h = item.height
    yield _prism(*_box(item, (0.0, 0.95), (0.4, 0.9), (0.8, 0.8)), BLACK, BLACK)
    yield _prism(*_box(item, (0.0, 0.66), (0.9, 0.85 * h), (0.96, 1.0)), paint, paint)
    yield _prism(
        *_box(item, (0.03, 0.63), (0.85 * h, 0.86 * h), (0.86, 0.86)), BLACK, (92.0, 80.0, 66.0)
    )
    cab: Colour = (226.0, 226.0, 222.0)
    yield _prism(*_box(item, (0.70, 1.0), (0.5, 0.55 * h), (0.94, 0.94)), cab, cab)
    foot, _ = _box(item, (0.70, 0.94), (0.55 * h, 0.9 * h), (0.92, 0.92))
    _, top = _box(item, (0.71, 0.88), (0.55 * h, 0.9 * h), (0.9, 0.86))
    yield _prism(foot, top, GLASS, cab)


def _roller(item: SiteObject, paint: Colour) -> Iterator[list[Face]]:
    h = item.height
    steel: Colour = (84.0, 84.0, 86.0)
    for span in ((0.0, 0.27), (0.73, 1.0)):
        yield _prism(*_box(item, span, (0.0, 0.46 * h), (1.0, 1.0)), steel, steel)
    yield _prism(*_box(item, (0.2, 0.8), (0.35, 0.56 * h), (0.8, 0.8)), paint, paint)
    yield _prism(*_box(item, (0.38, 0.64), (0.56 * h, 0.95 * h), (0.66, 0.66)), GLASS, GLASS)
    yield _prism(*_box(item, (0.34, 0.68), (0.95 * h, h), (0.86, 0.86)), paint, paint)


def _panel(item: SiteObject, paint: Colour) -> Iterator[list[Face]]:
    """A board across the road on a post or a trailer."""
    board = item.height - item.width if item.kind == "sign" else 1.4
    if item.kind == "arrow_board":
        yield _prism(
            *_box(item, (-1.2, 2.2), (0.3, 0.7), (0.6, 0.6)),
            (216.0, 120.0, 40.0),
            (216.0, 120.0, 40.0),
        )
    yield _prism(*_box(item, (0.4, 0.6), (0.0, board), (0.06, 0.06)), BLACK, BLACK)
    yield _prism(*_box(item, (0.0, 1.0), (board, item.height), (1.0, 1.0)), paint, paint)


def _house(item: SiteObject, paint: Colour) -> Iterator[list[Face]]:
    """Walls under a gable roof whose ridge follows the length; the eaves stand out a little."""
    eaves = 0.6 * item.height
    yield _prism(item.corners(-1.5), item.corners(eaves), paint, paint)
    rim = item.corners(eaves, shrink=1.07)
    top = item.corners(item.height, shrink=1.07)
    ridge = (top[0] + top[1]) / 2, (top[2] + top[3]) / 2
    tint: Colour = (122.0, 84.0, 72.0) if item.length > 8 else (132.0, 134.0, 138.0)
    yield [
        Face(points=np.array([rim[0], ridge[0], rim[1]]), colour=paint),
        Face(points=np.array([rim[2], ridge[1], rim[3]]), colour=paint),
        Face(points=np.array([rim[3], rim[0], ridge[0], ridge[1]]), colour=tint),
        Face(points=np.array([rim[1], rim[2], ridge[1], ridge[0]]), colour=tint),
    ]


def tree_blobs(item: SiteObject) -> tuple[Array, Array, Array]:
    """Centres (n, 3), radii (n,) and shades (n,) of the leaf clusters of a tree, low ones first."""
    rng = np.random.default_rng([31, int(item.name[1:])])
    count = 220
    d = rng.normal(size=(count, 3))
    d /= np.linalg.norm(d, axis=-1, keepdims=True)
    d *= rng.uniform(0.55, 1.0, size=(count, 1)) ** 0.5
    crown = np.array([item.width / 2, item.width / 2, item.height * 0.40])
    centre = item.enu + np.array([0.0, 0.0, item.height * 0.58])
    order = np.argsort(d[:, 2])
    d = d[order]
    shade = 0.62 + 0.36 * np.clip(d @ SUN, -0.6, 1.0) + rng.normal(0.0, 0.07, count)
    return centre + d * crown, item.width * rng.uniform(0.05, 0.11, count), shade


def shadow_points(item: SiteObject) -> Array:
    """Ground points whose hull is the shadow of a tree, shape (n, 3), m."""
    centres, radii, _ = tree_blobs(item)
    return _on_ground(centres + np.array([1.0, 0.0, 0.0]) * radii[:, None])


def part_shadow(part: list[Face]) -> Array:
    """Ground points whose hull is the shadow of a convex part, shape (n, 3), m."""
    return _on_ground(np.concatenate([f.points for f in part]))


def _on_ground(p: Array) -> Array:
    """Where sun rays through points meet the ground."""
    fall = np.zeros(len(p))
    for _ in range(4):
        q = p - fall[:, None] * SUN
        fall = fall + (q[:, 2] - site.terrain_up(q[:, 0], q[:, 1])) / SUN[2]
    return np.asarray(p - np.maximum(fall, 0.0)[:, None] * SUN)
