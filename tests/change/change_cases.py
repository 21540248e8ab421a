"""Sites with truth: a textured ground, rendered to two maps that differ in much, but known."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
import rasterio
import shapely
from numpy.typing import NDArray
from shapely import affinity
from shapely.geometry.base import BaseGeometry

from georef_gis.measure.change.detect import Change, Comparison, compare
from georef_gis.measure.change.pair import Cells, common_cells, open_pair
from georef_gis.measure.change.registration import Registration
from georef_gis.measure.change.windows import register

Image = NDArray[np.float32]

# m; the ground is finer than any map of it
FINE = 0.025
CRS = "EPSG:32617"
LEFT, TOP = 500_000.0, 4_400_000.0
# m; rim of the ground that no map shows
CUT = 2.0


@dataclass
class Thing:
    """Something on the ground: a disc, or a rectangle with a turn.

    x, y in m from the upper left; `colour` red, green, blue 0 to 1; `shadow` makes it a factor.
    """

    x: float
    y: float
    width: float
    height: float
    colour: tuple[float, float, float]
    turn: float = 0.0
    disc: bool = False
    shadow: bool = False
    rough: float = 0.02

    @property
    def area(self) -> float:
        return self.width * self.height * (np.pi / 4.0 if self.disc else 1.0)


@dataclass
class Look:
    """How a flight sees the ground."""

    gsd: float = 0.05
    shift: tuple[float, float] = (0.0, 0.0)
    scale: float = 1.0
    turn: float = 0.0
    noise: float = 0.012
    gain: tuple[float, float, float] = (1.0, 1.0, 1.0)
    shading: float = 0.0
    blur: float = 0.5
    jpeg: int | None = 85
    grey: bool = False
    dtype: str = "uint8"
    origin: tuple[float, float] = (0.0, 0.0)
    things: list[Thing] = field(default_factory=list)


def ground(rng: np.random.Generator, side: float = 40.0) -> Image:
    """Ground of a road with grass: shape (rows, cols, 3), 0 to 1, `FINE` m a pixel."""
    size = round(side / FINE)
    total = np.zeros((size, size), np.float32)
    for scale, weight in ((3.0, 0.05), (0.8, 0.05), (0.25, 0.05), (0.08, 0.05)):
        cells = max(4, round(side / scale))
        noise = rng.normal(0, 1, (cells, cells)).astype(np.float32)
        total += weight * cv2.resize(noise, (size, size), interpolation=cv2.INTER_CUBIC)
    image = np.stack([0.36 + total, 0.42 + total, 0.28 + 0.7 * total], axis=2)
    lane = slice(round(size * 0.3), round(size * 0.5))
    image[lane] = 0.38 + 0.25 * total[lane, :, None]
    for part in (0.31, 0.49):
        row = round(size * part)
        image[row : row + round(0.12 / FINE)] = 0.85
    for col in range(0, size, round(6.0 / FINE)):
        row = round(size * 0.4)
        image[row : row + round(0.12 / FINE), col : col + round(3.0 / FINE)] = 0.85
    for _ in range(round(side * side / 20)):
        x, y, r = rng.uniform(0, side), rng.uniform(0, side), rng.uniform(0.1, 0.5)
        if 0.28 < y / side < 0.52:
            continue
        colour = np.array([0.2, 0.3, 0.15]) * rng.uniform(0.6, 1.4)
        paint(image, Thing(x, y, 2 * r, 2 * r, tuple(colour), disc=True, rough=0.06), rng)
    return image


def paint(image: Image, thing: Thing, rng: np.random.Generator, *, soft: bool = True) -> None:
    """Put a thing on the ground, its rim soft by a pixel."""
    u = (np.arange(image.shape[1]) + 0.5) * FINE - thing.x
    v = (np.arange(image.shape[0]) + 0.5) * FINE - thing.y
    far = np.hypot(thing.width, thing.height) / 2 + 0.1
    cols, rows = np.nonzero(np.abs(u) < far)[0], np.nonzero(np.abs(v) < far)[0]
    if not len(cols) or not len(rows):
        return
    part = np.s_[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1]
    x, y = np.meshgrid(u[cols], v[rows])
    c, s = np.cos(thing.turn), np.sin(thing.turn)
    along, across = c * x + s * y, -s * x + c * y
    if thing.disc:
        inside = thing.width / 2 - np.hypot(x, y)
    else:
        inside = np.minimum(thing.width / 2 - np.abs(along), thing.height / 2 - np.abs(across))
    alpha = np.clip(inside / FINE + 0.5, 0, 1)[..., None] if soft else (inside > 0)[..., None]
    there = image[part]
    if thing.shadow:
        # sky light is left, which is bluer
        new = there * np.array(thing.colour)
    else:
        new = np.array(thing.colour) + rng.normal(0, thing.rough, there.shape[:2])[..., None]
    image[part] = (there * (1 - alpha) + new * alpha).astype(np.float32)


def render(
    path: Path, site: Image, look: Look, rng: np.random.Generator, *, cut: float = CUT
) -> Path:
    """A map of the site as one flight sees it, less a rim of `cut` m."""
    image = site.copy()
    for thing in look.things:
        paint(image, thing, rng)
    side = site.shape[0] * FINE - 2 * cut
    size = round(side / look.gsd)
    per = look.gsd / FINE
    image = cv2.GaussianBlur(image, (0, 0), max(0.42 * per, 0.5))
    # the map's pixel -> pixel of the ground; the map says it lies `shift` off
    middle = site.shape[0] / 2.0
    c, s = look.scale * np.cos(look.turn), look.scale * np.sin(look.turn)
    start = (cut + np.array(look.origin)) / FINE + 0.5 * per - 0.5
    offset = np.array(look.shift) / FINE
    linear = np.array([[c, -s], [s, c]])
    base = linear @ (start - offset - middle) + middle
    matrix = np.column_stack([linear * per, base])
    seen = cv2.warpAffine(
        image, matrix, (size, size), flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REFLECT,
    )  # fmt: skip
    ramp = np.linspace(-1, 1, size, dtype=np.float32)
    seen = seen * np.array(look.gain, np.float32) * (1 + look.shading * ramp[None, :, None])
    seen = cv2.GaussianBlur(seen, (0, 0), look.blur) if look.blur else seen
    seen = seen + rng.normal(0, look.noise, seen.shape)
    if look.grey:
        seen = seen.mean(axis=2, keepdims=True)
    write(path, np.clip(seen, 0, 1), look)
    return path


def write(path: Path, seen: Image, look: Look) -> None:
    """Write samples 0 to 1 as GeoTIFF."""
    top = 255 if look.dtype == "uint8" else 4095
    samples = np.round(seen * top).astype(look.dtype)
    if look.jpeg and look.dtype == "uint8":
        flags = [cv2.IMWRITE_JPEG_QUALITY, look.jpeg]
        coded = cv2.imencode(
            ".jpg", samples[..., ::-1] if samples.shape[2] == 3 else samples, flags
        )
        kind = cv2.IMREAD_COLOR if samples.shape[2] == 3 else cv2.IMREAD_GRAYSCALE
        samples = cv2.imdecode(coded[1], kind).reshape(samples.shape)
        samples = samples[..., ::-1] if samples.shape[2] == 3 else samples
    transform = rasterio.Affine(
        look.gsd, 0, LEFT + look.origin[0], 0, -look.gsd, TOP - look.origin[1]
    )
    with rasterio.open(
        path, "w", driver="GTiff", width=seen.shape[1], height=seen.shape[0],
        count=samples.shape[2], dtype=look.dtype, crs=CRS, transform=transform,
    ) as file:  # fmt: skip
        file.write(np.moveaxis(samples, 2, 0))


def compared(later: Path, earlier: Path, cell: float, *, most: float = 5.0) -> Comparison:
    """A comparison of two maps by cells of so many metres."""
    with open_pair(later, earlier, common_cells(later, earlier, cell), most=most) as pair:
        return compare(pair, most=most, least_area=0.1)


def registered(later: Path, earlier: Path, cell: float, *, most: float = 5.0) -> Registration:
    """Registration of two maps on cells of so many metres."""
    with open_pair(later, earlier, common_cells(later, earlier, cell), most=most) as pair:
        return register(pair, most=most)[0]


def truth_shapes(things: list[Thing], cells: Cells) -> list[BaseGeometry]:
    """Shapes of things in cells of a grid, where the later map shows no shift."""
    side, _, left, _, _, top = cells.header.transform
    shapes = []
    for thing in things:
        half = thing.width / 2, thing.height / 2
        shape = (
            shapely.Point(0, 0).buffer(half[0])
            if thing.disc
            else shapely.box(-half[0], -half[1], half[0], half[1])
        )
        shape = affinity.rotate(shape, np.degrees(thing.turn), origin=(0, 0))
        shape = affinity.scale(shape, 1 / side, 1 / side, origin=(0, 0))
        # the map begins `cut` m inside the ground, and its corner there is LEFT, TOP
        x, y = LEFT + thing.x - CUT - left, top - (TOP - (thing.y - CUT))
        shapes.append(affinity.translate(shape, x / side, y / side))
    return shapes


def matches(change: Change, shapes: list[BaseGeometry]) -> set[int]:
    """Which shapes a change is of: those within two cells of it."""
    own = change.judged.outline.shape
    return {i for i, shape in enumerate(shapes) if shape.buffer(2.0).intersects(own)}
