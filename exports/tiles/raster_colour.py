"""Bands of a raster as colour on a screen: 8 bits, with opacity."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Pixels = NDArray[np.uint8]
# Values of a band that become black and white.
Stretch = tuple[float, float]

# px of a decimated reading from which brightness is judged
SAMPLE = 512
# %; what becomes black and white of pixels that are not 8-bit
DARK, BRIGHT = 1.0, 99.0


def colour_bands(ds: Any) -> list[int]:
    """Numbers of the bands to show as red, green, blue; one band is shown in grey."""
    from rasterio.enums import ColorInterp

    kinds = list(ds.colorinterp)
    wanted = (ColorInterp.red, ColorInterp.green, ColorInterp.blue)
    if all(kind in kinds for kind in wanted):
        return [kinds.index(kind) + 1 for kind in wanted]
    plain = [i + 1 for i, kind in enumerate(kinds) if kind is not ColorInterp.alpha]
    return plain[:3] if len(plain) >= 3 else plain[:1]


def stretches(ds: Any, bands: list[int]) -> list[Stretch]:
    """Per band the percentiles that become black and white, of a raster that is not 8-bit."""
    scale = max(1.0, max(ds.width, ds.height) / SAMPLE)
    size = (max(1, int(ds.height / scale)), max(1, int(ds.width / scale)))
    valid = ds.dataset_mask(out_shape=size) > 0
    out = []
    for band in ds.read(bands, out_shape=(len(bands), *size)):
        values = band[valid & np.isfinite(band)]
        low, high = np.percentile(values, [DARK, BRIGHT]) if values.size else (0.0, 1.0)
        out.append((float(low), float(high)))
    return out


def premultiplied(bands: NDArray[Any], mask: Pixels, stretch: Sequence[Stretch] | None) -> Pixels:
    """BGRA with colour multiplied by opacity.

    Parameters
    ----------
    bands : shape (1 or 3, rows, cols)
        Grey, or red, green and blue, as `colour_bands` names them.
    mask : shape (rows, cols)
        Opacity.
    stretch
        Of each band; None where they are 8-bit.
    """
    colours = [
        to_byte(band, stretch[i] if stretch is not None else None) for i, band in enumerate(bands)
    ]
    blue_green_red = colours[::-1] if len(colours) == 3 else colours * 3
    out = np.asarray(cv2.merge([*blue_green_red, mask]), dtype=np.uint8)
    partly = (mask > 0) & (mask < 255)
    if partly.any():
        share = mask[partly, None].astype(np.uint16)
        out[partly, :3] = (out[partly, :3] * share + 127) // 255
    # Colour under no opacity must not bleed in.
    return np.asarray(cv2.bitwise_and(out, out, mask=mask), dtype=np.uint8)


def straight(premultiplied: Pixels) -> Pixels:
    """BGRA with colour as it is seen, from colour premultiplied by alpha."""
    alpha = premultiplied[..., 3:].astype(np.uint16)
    colour = premultiplied[..., :3].astype(np.uint16)
    out = premultiplied.copy()
    out[..., :3] = np.minimum((colour * 255 + alpha // 2) // np.maximum(alpha, 1), 255)
    return out


def to_byte(band: NDArray[Any], stretch: Stretch | None) -> Pixels:
    """Values of a band as 0 to 255; as they are without a stretch."""
    if stretch is None:
        return np.asarray(band, dtype=np.uint8)
    low, high = stretch
    value = (np.nan_to_num(band.astype(np.float32)) - low) * (255.0 / max(high - low, 1e-9))
    return np.asarray(np.clip(np.rint(value), 0, 255), dtype=np.uint8)
