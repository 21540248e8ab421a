"""How sharp a photo is, whatever it shows: fine against coarser detail."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from georef_gis.errors import InputError

# px; the photo is decoded at half or a quarter of its size, about this wide at least
WORKING_WIDTH = 1500


def sharpness(path: Path, width: int) -> float:
    """Energy of the finest detail over that of detail twice as coarse; about 0.1 to 2.

    Blur takes the fine detail first, while bland ground lowers both alike.

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
    half = cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    fine = float(cv2.meanStdDev(cv2.Laplacian(image, cv2.CV_16S))[1][0, 0])
    coarse = float(cv2.meanStdDev(cv2.Laplacian(half, cv2.CV_16S))[1][0, 0])
    return fine / max(coarse, 1e-6)


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
