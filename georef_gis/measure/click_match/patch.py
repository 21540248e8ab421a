"""Patches of photos for matching: the shades that tell most, the template, and what it is worth."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from georef_gis.frames import Array

Picture = NDArray[Any]

# least noise of a stored photo, of its 255 grey levels: rounding and compression
_LEAST_NOISE = 1.0
# one sigma of the window that weighs a template, in its half sides
_WINDOW = 0.6
# px; blur of one pixel's own footprint
_PIXEL = 0.5
# px; blur of both photos in the search: one may be sharper
SOFT = 0.8
# px; blur under which noise is told from texture, and how much more than noise that is
_COARSE, _MORE_THAN_NOISE = 1.5, 4.0
# px of the template kept around it, which blurring needs
_RIM = 5


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Shades:
    """Part of a photo in one band: values (rows, cols), and the pixel (u, v) of the first one."""

    values: NDArray[np.float32]
    u: int
    v: int

    def at(self, uv: Array) -> Array:
        """Pixels of the photo as pixels of this part; (..., 2)."""
        return np.asarray(uv - np.array([self.u, self.v], dtype=np.float64))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Template:
    """What is looked for: a square patch about a click.

    Parameters
    ----------
    values, weight : shape (n, n)
        Shades, and how much each counts.
    wide : shape (n + 2 rim, n + 2 rim)
        Shades with a rim around.
    offsets : shape (n, n, 2), px
        From the click, which need not fall on the centre of a pixel.
    mix : shape (bands,)
        Shares of the photo's bands in a shade.
    noise
        One sigma of a shade.
    """

    values: Array
    wide: Array
    weight: Array
    offsets: Array
    mix: Array
    noise: float

    @property
    def half(self) -> int:
        """Half side without the middle, px."""
        return len(self.values) // 2

    @property
    def size(self) -> int:
        """Side, px."""
        return len(self.values)

    def sharpness(self) -> Array:
        """One sigma, px, along the axes of the best and the worst known direction; shape (2,).

        What noise alone allows, for a template that is compared with one like it.
        """
        down, right = np.gradient(self.values)
        slope = np.stack([right, down], axis=-1)
        normal = np.einsum("rc,rci,rcj->ij", self.weight, slope, slope)
        values = np.maximum(np.linalg.eigvalsh(normal), 1e-12)
        return np.asarray(math.sqrt(2.0) * self.noise / np.sqrt(values[::-1]))

    def textured(self) -> tuple[bool, bool]:
        """Whether more than noise fixes it along the best and the worst known direction."""
        down, right = np.gradient(self.blurred(_COARSE))
        slope = np.stack([right, down], axis=-1)
        energy = np.linalg.eigvalsh(np.einsum("rc,rci,rcj->ij", self.weight, slope, slope))
        # of the slope of white noise under a Gaussian blur
        noise = self.noise**2 / (8.0 * math.pi * _COARSE**4) * float(self.weight.sum())
        worst, best = (bool(value > _MORE_THAN_NOISE * noise) for value in energy)
        return best, worst

    def blurred(self, sigma: float) -> Array:
        """Shades under a blur of `sigma` px; (n, n)."""
        if sigma <= 0.0:
            return self.values
        soft = gaussian_filter(self.wide, sigma, mode="nearest")
        return np.asarray(soft[_RIM:-_RIM, _RIM:-_RIM])

    def independent(self) -> float:
        """How many independent shades the search has: smooth patches look alike by chance.

        The shades' autocorrelation counts (Bartlett 1946).
        """
        x = self.blurred(SOFT)
        x = x - x.mean()
        n = len(x)
        spectrum = np.fft.rfft2(x, s=(2 * n, 2 * n))
        lags = np.fft.irfft2(np.abs(spectrum) ** 2, s=(2 * n, 2 * n))
        if lags[0, 0] <= 0.0:
            return 1.0
        return float(x.size / np.sum((lags / lags[0, 0]) ** 2))


def mixed(picture: Picture, mix: Array, window: tuple[int, int, int, int]) -> Shades:
    """Shades of a window (left, top, right, bottom) of a photo, cut where the photo ends."""
    left, top = max(window[0], 0), max(window[1], 0)
    part = picture[top : max(window[3], top), left : max(window[2], left)]
    values = part.astype(np.float32) @ mix.astype(np.float32)
    return Shades(values=np.ascontiguousarray(values), u=left, v=top)


def telling_mix(picture: Picture, uv: Array, half: int) -> Array:
    """Shares of the bands in which a patch has the most contrast; shape (bands,).

    An orange cone on grey asphalt is as light as the asphalt. Bands beyond three do not count.
    """
    bands = picture.shape[2]
    if bands < 3:
        return np.asarray(np.eye(bands)[0])
    u, v = (round(float(x)) for x in uv)
    part = picture[max(v - half, 0) : v + half + 1, max(u - half, 0) : u + half + 1, :3]
    colours = part.reshape(-1, 3).astype(np.float64)
    _, vectors = np.linalg.eigh(np.cov(colours.T))
    axis = vectors[:, -1]
    mix = np.zeros(bands)
    mix[:3] = axis * (1.0 if axis.sum() >= 0.0 else -1.0)
    return mix


def template_of(picture: Picture, uv: Array, size: int) -> Template | None:
    """Template of `size` px about a click; None where the photo ends too near."""
    half = size // 2
    u, v = (round(float(x)) for x in uv)
    rows, cols = picture.shape[:2]
    if u - half < 0 or v - half < 0 or u + half >= cols or v + half >= rows:
        return None
    mix = telling_mix(picture, uv, half)
    reach = half + _RIM
    part = mixed(picture, mix, (u - reach, v - reach, u + reach + 1, v + reach + 1))
    # where the photo ends within the rim, its last pixel is repeated
    before = (reach - (v - part.v), reach - (u - part.u))
    after = (2 * reach + 1 - before[0] - part.values.shape[0],
             2 * reach + 1 - before[1] - part.values.shape[1])  # fmt: skip
    wide = np.pad(part.values.astype(np.float64),
                  ((before[0], after[0]), (before[1], after[1])), mode="edge")  # fmt: skip
    values = wide[_RIM:-_RIM, _RIM:-_RIM]
    y, x = np.mgrid[-half : half + 1, -half : half + 1].astype(np.float64)
    offsets = np.stack([x + u - uv[0], y + v - uv[1]], axis=-1)
    far = (x**2 + y**2) / (_WINDOW * (half + 0.5)) ** 2
    return Template(
        values=values,
        wide=wide,
        weight=np.exp(-0.5 * far),
        offsets=offsets,
        mix=mix,
        noise=max(_noise(values), _LEAST_NOISE * float(np.linalg.norm(mix))),
    )


def _noise(values: Array) -> float:
    """One sigma of noise by what a plane and an edge leave (Immerkaer 1996)."""
    mask = np.array([[1.0, -2.0, 1.0], [-2.0, 4.0, -2.0], [1.0, -2.0, 1.0]])
    left = cv2.filter2D(values, -1, mask)[1:-1, 1:-1]
    return float(np.median(np.abs(left)) / 0.6745 / 6.0)


def footprint_blur(scale: float) -> float:
    """Blur, px, that makes pixels look as if they were `scale` times as wide; 0 below 1."""
    return _PIXEL * math.sqrt(scale**2 - 1.0) if scale > 1.0 else 0.0


def blurred(values: Picture, sigma: float) -> NDArray[np.float32]:
    """Shades under a blur of `sigma` px."""
    if sigma <= 0.0:
        return np.asarray(values, dtype=np.float32)
    return np.asarray(gaussian_filter(values, sigma, mode="nearest"), dtype=np.float32)
