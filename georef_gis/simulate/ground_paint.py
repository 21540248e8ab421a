"""Colour of bare ground as a function of place: grass, asphalt, paint, gravel, soil, targets."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from georef_gis.simulate import site

Image = NDArray[np.floating[Any]]
TARGET_SIDE = 0.9  # m; a painted target is this wide
TILE = 1024  # pixels of a noise tile


@lru_cache(maxsize=4)
def _noise_tile(index: int) -> Image:
    """Seamless noise of unit standard deviation."""
    rng = np.random.default_rng([4711, index])
    white = rng.normal(size=(TILE, TILE)).astype(np.float32)
    soft = np.fft.rfft2(white)
    f = np.hypot(np.fft.fftfreq(TILE)[:, None], np.fft.rfftfreq(TILE)[None, :])
    tile = np.fft.irfft2(soft * np.exp(-((f / 0.22) ** 2)), s=(TILE, TILE))
    return np.asarray(tile / tile.std(), dtype=np.float32)


def noise(e: Image, n: Image, cell: float, index: int) -> Image:
    """Smooth noise of unit standard deviation with grains of about `cell` metres."""
    turn = 0.6 + 0.9 * index
    c, s = np.cos(turn) / cell, np.sin(turn) / cell
    x = np.mod(e * c - n * s + 137.0 * index, TILE).astype(np.float32)
    y = np.mod(e * s + n * c + 71.0 * index, TILE).astype(np.float32)
    return np.asarray(
        cv2.remap(_noise_tile(index % 4), x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
    )


def _inside(distance: Image, gsd: Image) -> Image:
    """Cover of a pixel by a region, from the signed distance into it, m."""
    return np.asarray(np.clip(distance / gsd + 0.5, 0.0, 1.0), dtype=np.float32)


def _blend(image: Image, colour: Image | tuple[float, float, float], cover: Image) -> None:
    image += (np.asarray(colour, dtype=np.float32) - image) * cover[..., None]


def paint_ground(e: Image, n: Image, gsd: Image) -> Image:
    """Colours of ground points.

    Parameters
    ----------
    e, n : shape (rows, cols), m
        East and north in the site's frame.
    gsd : shape (rows, cols), m
        Side of a pixel on the ground.

    Returns
    -------
    rgb : shape (rows, cols, 3)
        0 to 255, before light and lens.
    """
    along, left = (c.astype(np.float32) for c in site.road_from_enu(e, n))
    fine = noise(e, n, 0.045, 0)
    middle = noise(e, n, 0.14, 1)
    coarse = noise(e, n, 0.6, 2)
    large = noise(e, n, 3.0, 3)
    huge = noise(e, n, 11.0, 4)
    image = _grass(fine, middle, coarse, large, huge)
    _bare_soil(image, along, left, (fine, middle, coarse, large), gsd)
    _gravel(image, along, left, (fine, middle, coarse), gsd)
    _asphalt(image, along, left, (fine, middle, coarse, large), gsd)
    _paint(image, along, left, middle, gsd)
    _targets(image, e, n, gsd)
    return image


def _grass(fine: Image, middle: Image, coarse: Image, large: Image, huge: Image) -> Image:
    light = 1.0 + 0.12 * fine + 0.11 * middle + 0.07 * coarse + 0.05 * large
    dry = np.clip(0.35 + 0.16 * huge + 0.14 * large + 0.10 * coarse, 0.0, 1.0)[..., None]
    green = np.array([84.0, 104.0, 56.0], dtype=np.float32)
    straw = np.array([138.0, 130.0, 86.0], dtype=np.float32)
    image = green + (straw - green) * dry
    weeds = np.clip(coarse * 0.8 + middle * 0.7 - 1.5, 0.0, 1.0)[..., None]
    image = image * (1.0 - 0.42 * weeds)
    return np.asarray(image * light[..., None], dtype=np.float32)


def _bare_soil(
    image: Image, along: Image, left: Image, grains: tuple[Image, ...], gsd: Image
) -> None:
    fine, middle, coarse, large = grains
    half = 16.0 + 1.2 * large + 0.5 * coarse
    ragged = np.minimum(half - np.abs(along - 26.0), 5.5 + coarse * 0.6 - np.abs(left + 10.2))
    ruts = 0.10 * np.exp(-((np.abs(left + 9.6 + 0.4 * large) - 0.9) ** 2) / 0.06)
    light = 1.0 + 0.07 * fine + 0.08 * middle + 0.07 * coarse - ruts
    colour = np.array([140.0, 118.0, 92.0], dtype=np.float32) * light[..., None]
    _blend(image, colour, np.asarray(np.clip(ragged / 0.8 + 0.5, 0, 1), dtype=np.float32))


def _gravel(image: Image, along: Image, left: Image, grains: tuple[Image, ...], gsd: Image) -> None:
    fine, middle, coarse = grains
    edge = 0.25 * coarse + 0.15 * middle
    shoulder = 1.1 + edge - np.abs(np.abs(left) - site.HALF_PAVED - 0.6)
    drive = np.minimum(1.9 + edge - np.abs(along + 18.0 - 0.02 * left), 24.0 - left)
    yard = np.minimum(4.6 + edge - np.abs(along + 16.0), 3.2 + edge - np.abs(left - 20.0))
    cover = np.maximum.reduce([shoulder, np.minimum(drive, left - 3.0), yard])
    light = 1.0 + 0.11 * fine + 0.06 * middle + 0.03 * coarse
    colour = np.array([158.0, 150.0, 136.0], dtype=np.float32) * light[..., None]
    _blend(image, colour, np.asarray(np.clip(cover / 0.3 + 0.5, 0, 1), dtype=np.float32))


def _asphalt(
    image: Image, along: Image, left: Image, grains: tuple[Image, ...], gsd: Image
) -> None:
    fine, middle, coarse, large = grains
    cover = _inside(site.HALF_PAVED + 0.05 * coarse - np.abs(left), gsd)
    tracks = np.exp(-((np.abs(np.abs(left) - 1.8) - 0.85) ** 2) / 0.10)
    light = 1.0 + 0.045 * fine + 0.035 * middle + 0.03 * coarse + 0.04 * large - 0.09 * tracks
    colour = np.array([104.0, 103.0, 101.0], dtype=np.float32) * light[..., None]
    _blend(image, colour, cover)
    wander = along + 0.35 * coarse + 0.8 * large
    for i, at in enumerate((-88.0, -63.0, -47.0, -21.5, 55.5, 64.0, 83.0, 101.0)):
        crack = _inside(0.035 - np.abs(wander - at), gsd) * cover
        _blend(image, (58.0, 57.0, 56.0), 0.7 * crack * (np.abs(left) < 3.5 + 0.2 * i))
    _repairs(image, along, left, grains, gsd)


def _repairs(
    image: Image, along: Image, left: Image, grains: tuple[Image, ...], gsd: Image
) -> None:
    """The milled lane of the work space and its fresh overlay, and two old patches."""
    fine, middle, coarse, large = grains
    lane = np.minimum(left + 3.55, -0.12 - left)
    milled = np.minimum(lane, np.minimum(along + 1.0, 48.0 - along))
    stripes = np.sin(left * 2 * np.pi / 0.45)
    light = 1.0 + 0.06 * fine + 0.05 * middle + 0.05 * stripes + 0.04 * coarse
    rough = np.array([136.0, 131.0, 124.0], dtype=np.float32) * light[..., None]
    _blend(image, rough, _inside(milled, gsd))
    fresh = np.minimum(lane, np.minimum(along + 1.0, 15.0 - along))
    black = (
        np.array([52.0, 52.0, 54.0], dtype=np.float32) * (1 + 0.05 * fine + 0.03 * large)[..., None]
    )
    _blend(image, black, _inside(fresh, gsd))
    for at, side, length, width in ((-36.0, -1.7, 3.2, 2.1), (-26.0, 2.1, 2.2, 1.6)):
        patch = np.minimum(length / 2 - np.abs(along - at), width / 2 - np.abs(left - side))
        old = np.array([74.0, 74.0, 74.0], dtype=np.float32) * (1 + 0.05 * fine)[..., None]
        _blend(image, old, _inside(patch, gsd))


def _paint(image: Image, along: Image, left: Image, middle: Image, gsd: Image) -> None:
    wear = np.clip(0.90 - 0.07 * middle, 0.0, 1.0)
    in_work = (along > -1.0) & (along < 48.0) & (left < -0.1)
    edge = _inside(0.06 - np.abs(np.abs(left) - site.LANE), gsd)
    _blend(image, (226.0, 226.0, 220.0), edge * wear * ~(in_work & (left < 0)))
    solid = _inside(0.055 - np.abs(left - 0.13), gsd)
    dash = np.minimum(1.5 - np.abs(np.mod(along, 12.0) - 6.0), 0.055 - np.abs(left + 0.13))
    yellow = (214.0, 172.0, 52.0)
    _blend(image, yellow, solid * wear)
    _blend(image, yellow, _inside(dash, gsd) * wear * ~in_work)
    stop = np.minimum(0.3 - np.abs(along + 60.0), np.minimum(-0.3 - left, left + 3.4))
    _blend(image, (228.0, 228.0, 224.0), _inside(stop, gsd) * wear)


def _targets(image: Image, e: Image, n: Image, gsd: Image) -> None:
    """Black and white quarters on a white square, each pixel by its covered area."""
    for point in site.control_points():
        x0, y0 = point.enu[:2]
        near = (np.abs(e - x0) < 2.0) & (np.abs(n - y0) < 2.0)
        if not near.any():
            continue
        rows, cols = np.flatnonzero(near.any(axis=1)), np.flatnonzero(near.any(axis=0))
        box = (slice(rows[0], rows[-1] + 1), slice(cols[0], cols[-1] + 1))
        x, y, g = e[box] - x0, n[box] - y0, gsd[box]
        half = TARGET_SIDE / 2
        cover = _inside(half - np.abs(x), g) * _inside(half - np.abs(y), g)
        quarter = np.clip(2 * x / g, -1, 1) * np.clip(2 * y / g, -1, 1)
        tone = (132.0 + 108.0 * quarter)[..., None] * np.ones(3)
        part = image[box]
        _blend(part, tone.astype(np.float32), cover)
