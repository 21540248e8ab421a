"""Samples as pictures for a screen: JPEG, WebP where parts are missing, PNG to the last bit."""

from __future__ import annotations

import io
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

# Of JPEG: what is seen at ten times its size shows no blocks.
_QUALITY = 90
# Of WebP, whose finer methods take three times as long for a tenth of the size.
_WEBP = {"quality": 85, "method": 1}
# Of PNG: the fastest; a browser on the same machine does not mind the size.
_DEFLATE = 1
# Share of the values that may be cut off at either end.
_CUT = 0.5
# 1 x 1 px, wholly transparent
_EMPTY_PNG = bytes.fromhex(
    "89504e470d0a1a0a0000000d4948445200000001000000010806000000" + "1f15c489"
    "0000000d49444154789c6360000200000500017a5eab3f" + "0000000049454e44ae426082"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class ScreenPicture:
    """Bytes of a picture and their media type."""

    content: bytes
    media_type: str


EMPTY_TILE = ScreenPicture(content=_EMPTY_PNG, media_type="image/png")


@dataclass(frozen=True, slots=True, kw_only=True)
class Stretch:
    """Black and white of each band; None = the samples are shades already."""

    low: tuple[float, ...] | None = None
    high: tuple[float, ...] | None = None

    def applied(self, samples: NDArray[Any]) -> NDArray[np.uint8]:
        """Shades (rows, cols, 1 or 3) of samples (rows, cols, bands)."""
        chosen = samples[..., :3] if samples.shape[2] >= 3 else samples[..., :1]
        if self.low is None or self.high is None:
            return np.ascontiguousarray(chosen, dtype=np.uint8)
        low, high = np.array(self.low), np.array(self.high)
        with np.errstate(invalid="ignore"):
            shades = (chosen.astype(np.float32) - low) * (255.0 / np.maximum(high - low, 1e-12))
        return np.asarray(np.clip(np.nan_to_num(shades), 0.0, 255.0), dtype=np.uint8)


def stretch_of(samples: NDArray[Any], valid: NDArray[np.bool_] | None = None) -> Stretch:
    """Stretch for samples (rows, cols, bands) that are no shades of 8 bits."""
    if samples.dtype == np.uint8:
        return Stretch()
    bands = range(3 if samples.shape[2] >= 3 else 1)
    low, high = [], []
    for band in bands:
        values = samples[..., band] if valid is None else samples[..., band][valid]
        values = values[np.isfinite(values)]
        ends = np.percentile(values, [_CUT, 100.0 - _CUT]) if values.size else (0.0, 1.0)
        low.append(float(ends[0]))
        high.append(float(max(ends[1], ends[0] + 1e-9)))
    return Stretch(low=tuple(low), high=tuple(high))


def encode(
    shades: NDArray[np.uint8],
    valid: NDArray[np.bool_] | None,
    size: tuple[int, int],
    *,
    exact: bool = False,
) -> ScreenPicture:
    """Picture of shades (rows, cols, 1 or 3), filled up with nothing to `size` (width, height).

    Parameters
    ----------
    exact
        Whether each pixel keeps its shades to the last bit.
    """
    rows, cols = shades.shape[:2]
    if valid is not None and not valid.any():
        return EMPTY_TILE
    if exact:
        return _png(shades, valid, size)
    if (valid is None or valid.all()) and (cols, rows) == size:
        colours = shades[..., ::-1] if shades.shape[2] == 3 else shades
        done, content = cv2.imencode(".jpg", colours, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
        if not done:
            raise ValueError(f"a picture of {shades.shape} cannot be encoded")
        return ScreenPicture(content=content.tobytes(), media_type="image/jpeg")
    from PIL import Image

    rgba = np.zeros((size[1], size[0], 4), dtype=np.uint8)
    rgba[:rows, :cols, :3] = shades
    rgba[:rows, :cols, 3] = 255 if valid is None else np.where(valid, 255, 0)
    stream = io.BytesIO()
    Image.fromarray(rgba).save(stream, "WEBP", **_WEBP)
    return ScreenPicture(content=stream.getvalue(), media_type="image/webp")


def _png(
    shades: NDArray[np.uint8], valid: NDArray[np.bool_] | None, size: tuple[int, int]
) -> ScreenPicture:
    rows, cols = shades.shape[:2]
    if valid is None and (cols, rows) == size:
        picture = shades[..., ::-1] if shades.shape[2] == 3 else shades
    else:
        picture = np.zeros((size[1], size[0], 4), dtype=np.uint8)
        picture[:rows, :cols, :3] = shades[..., ::-1]
        picture[:rows, :cols, 3] = 255 if valid is None else np.where(valid, 255, 0)
    done, content = cv2.imencode(".png", picture, [cv2.IMWRITE_PNG_COMPRESSION, _DEFLATE])
    if not done:
        raise ValueError(f"a picture of {shades.shape} cannot be encoded")
    return ScreenPicture(content=content.tobytes(), media_type="image/png")
