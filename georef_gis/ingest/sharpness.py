"""How sharp a photo is, whatever it shows: fine against coarser detail."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np

from georef_gis.errors import InputError

# px; the photo is decoded at half or a quarter of its size, about this wide at least
WORKING_WIDTH = 1500
# times as coarse is the detail that the finest is compared with: no usual blur reaches it
COARSER = 8


def sharpness(path: Path, width: int) -> float:
    """Energy of the finest detail over that of detail `COARSER` times as coarse; 0.1 to 2.

    Blur takes the fine detail first, while bland ground lowers both alike. The worse of the two
    directions counts: motion smears along one only.

    Raises
    ------
    InputError
        If the file cannot be decoded.
    """
    flags = cv2.IMREAD_REDUCED_GRAYSCALE_4 if width >= 4 * WORKING_WIDTH else (
        cv2.IMREAD_REDUCED_GRAYSCALE_2 if width >= 2 * WORKING_WIDTH else cv2.IMREAD_GRAYSCALE
    )  # fmt: skip
    raw = np.fromfile(path, dtype=np.uint8)
    image = cv2.imdecode(raw, flags | cv2.IMREAD_IGNORE_ORIENTATION) if raw.size else None
    if image is None:
        raise InputError("cannot be decoded; is the file whole?", source=path.name)
    size = tuple(max(3, n // COARSER) for n in image.shape[1::-1])
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    return min(
        _energy(image, along) / max(_energy(small, along), 1e-6) for along in ((2, 0), (0, 2))
    )


def _energy(image: Any, along: tuple[int, int]) -> float:
    """Root mean square of the second derivative along columns or rows."""
    bend = cv2.Sobel(image, cv2.CV_16S, *along, ksize=3)
    return float(cv2.meanStdDev(bend)[1][0, 0])


def blurred(values: np.ndarray[tuple[int], np.dtype[np.float64]]) -> list[int]:
    """Which of a flight's values stand out as unsharp; robust against a few."""
    if len(values) < 4:
        return []
    log = np.log(np.maximum(values, 1e-6))
    middle = float(np.median(log))
    spread = 1.4826 * float(np.median(np.abs(log - middle)))
    # At least a quarter less than the others: scenes differ by more than the noise.
    limit = middle - max(5.0 * spread, 0.3)
    return [int(i) for i in np.flatnonzero(log < limit)]
