"""Tiles as JPEG, PNG or WEBP."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import cv2
import numpy as np

from exports.tiles.raster_colour import Pixels, straight

Encode = Callable[[Pixels], bytes]


def encoder(kind: str, quality: int) -> Encode:
    """Encoder of premultiplied BGRA tiles; `kind` is auto, jpeg, webp or png."""
    if kind == "auto":
        return partial(_mixed, quality=quality)
    if kind == "jpeg":
        return partial(_jpeg, quality=quality)
    if kind == "webp":
        return partial(_packed, suffix=".webp", option=(cv2.IMWRITE_WEBP_QUALITY, quality))
    return partial(_packed, suffix=".png", option=(cv2.IMWRITE_PNG_COMPRESSION, 6))


def _mixed(tile: Pixels, *, quality: int) -> bytes:
    if _is_opaque(tile):
        return _encoded(".jpg", _colour(tile), (cv2.IMWRITE_JPEG_QUALITY, quality))
    # A tenth of the bytes of a PNG; one of 256 colours would show its border on even ground.
    return _encoded(".webp", _straight(tile), (cv2.IMWRITE_WEBP_QUALITY, quality))


def _jpeg(tile: Pixels, *, quality: int) -> bytes:
    """On white, which is what a map has under it more often than black."""
    colour = _colour(tile)
    if not _is_opaque(tile):
        colour += 255 - tile[..., 3:]
    return _encoded(".jpg", colour, (cv2.IMWRITE_JPEG_QUALITY, quality))


def _packed(tile: Pixels, *, suffix: str, option: tuple[int, int]) -> bytes:
    return _encoded(suffix, _colour(tile) if _is_opaque(tile) else _straight(tile), option)


def _straight(tile: Pixels) -> Pixels:
    out = tile.copy()
    # Few pixels are partly covered: those at the very rim.
    partly = (tile[..., 3] > 0) & (tile[..., 3] < 255)
    out[partly] = straight(tile[partly])
    return out


def _is_opaque(tile: Pixels) -> bool:
    return int(tile[..., 3].min()) == 255


def _colour(tile: Pixels) -> Pixels:
    return np.asarray(cv2.cvtColor(tile, cv2.COLOR_BGRA2BGR), dtype=np.uint8)


def _encoded(suffix: str, image: Pixels, option: tuple[int, int]) -> bytes:
    done, data = cv2.imencode(suffix, image, list(option))
    if not done:
        raise ValueError(f"OpenCV cannot encode a picture of shape {image.shape} as {suffix}")
    return data.tobytes()
