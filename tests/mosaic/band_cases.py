"""Pictures of one ground in two bands, with a shift that is known."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray


def ground(
    rng: np.random.Generator, size: int, shift: tuple[float, float] = (0.0, 0.0)
) -> NDArray[np.float64]:
    """Patches and lines, 0 to 1; what stands at p without a shift stands at p + shift with it.

    Drawn four times as large, in whole parts of a pixel, and averaged: nothing is interpolated.
    """
    times = 4
    big = np.full((size * times, size * times), 0.4)
    margin = 40 * times
    for _ in range(size * size // 500):
        x, y = rng.uniform(-margin, size * times + margin, 2)
        half = rng.uniform(3, 14, 2) * times
        angle, value = rng.uniform(0, 180), rng.uniform(0.05, 0.95)
        corners = cv2.boxPoints(
            ((x + shift[0] * times, y + shift[1] * times), tuple(half.tolist()), angle)
        )
        # 1/16 of the fine pixel
        cv2.fillPoly(big, [np.round(corners * 16).astype(np.int32)], value, shift=4)
    return np.asarray(cv2.resize(big, (size, size), interpolation=cv2.INTER_AREA))


def pair(
    shift: tuple[float, float], *, size: int = 256, contrast: str = "same", noise: float = 0.01
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Two bands of a ground, shape (size, size, 1), the second shifted and of other contrast."""
    first = ground(np.random.default_rng(3), size)
    second = ground(np.random.default_rng(3), size, shift)
    if contrast == "brighter":
        second = 0.3 + 0.5 * second
    elif contrast == "inverted":
        second = 0.9 - 0.8 * second
    elif contrast == "folded":
        # bright and dark alike: grey of the middle is darkest
        second = np.abs(second - 0.4) * 1.5
    rng = np.random.default_rng(4)
    return tuple(  # type: ignore[return-value]
        (image + rng.normal(0.0, noise, image.shape))[:, :, None] for image in (first, second)
    )
