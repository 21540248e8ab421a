"""Pictures of assets cut out of the photos they were clicked in, with a cross and a scale."""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from georef_gis.errors import InputError
from georef_gis.frames import Array

Image = NDArray[np.uint8]
# px of a picture, and of the photo the least that it shows
SIZE, LEAST = 320, 64
# m of ground around a point; a line or an area is shown whole, with a margin
SPAN, MARGIN = 5.0, 1.3
_INK, _PAPER = (255, 235, 0), (20, 20, 20)
_QUALITY = 88
# Ids that the store gives, and names made of others
_OURS = re.compile(r"[0-9a-f]{8}(-[0-9a-f]{4}){3}-[0-9a-f]{12}|[0-9a-f]{32}")
_SAFE = re.compile(r"[0-9A-Za-z-]{1,64}")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sight:
    """An asset in one photo.

    Parameters
    ----------
    uv : shape (n, 2), px
        Its vertices.
    gsd
        m per px at the asset; NaN = not known, then there is no scale.
    closed
        Whether the last vertex is joined to the first.
    """

    photo_id: str
    path: Path
    uv: Array
    gsd: float = math.nan
    closed: bool = False


def best_sight(sights: Sequence[Sight]) -> Sight:
    """The one that shows most vertices, and of those the sharpest."""
    return min(sights, key=lambda s: (-len(s.uv), s.gsd if math.isfinite(s.gsd) else math.inf))


def write_thumbnails(
    sights: Mapping[str, Sight],
    folder: Path,
    *,
    read: Callable[[Path], NDArray[Any]] | None = None,
) -> tuple[dict[str, Path], list[str]]:
    """Write a JPEG per asset; every photo is decoded once.

    Parameters
    ----------
    sights
        By asset id.
    read
        Gives a photo as it is stored; None = from its file.

    Returns
    -------
    files
        By asset id.
    notes
        Photos that could not be read, a line each.
    """
    import cv2

    from georef_gis.rasters.files import export_errors, whole_file
    from georef_gis.rasters.reading import read_image

    files: dict[str, Path] = {}
    notes: list[str] = []
    by_photo: dict[Path, list[str]] = {}
    for asset_id, sight in sights.items():
        by_photo.setdefault(sight.path, []).append(asset_id)
    with export_errors(folder, lambda: 0):
        folder.mkdir(parents=True, exist_ok=True)
    for path, asset_ids in by_photo.items():
        try:
            image = (read or read_image)(path)
        except InputError as error:
            notes.append(f"no picture of {len(asset_ids)} assets: {error}")
            continue
        for asset_id in asset_ids:
            picture = thumbnail(image, sights[asset_id])
            _, raw = cv2.imencode(".jpg", picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
            target = folder / thumbnail_name(asset_id)
            with export_errors(target, lambda: 0), whole_file(target) as stream:
                stream.write(raw.tobytes())
            files[asset_id] = target
    return files, notes


def thumbnail_name(asset_id: str) -> str:
    """File name of an asset's picture: its id, unless a GIS user made a path of that."""
    if _SAFE.fullmatch(asset_id):
        return f"{asset_id}.jpg"
    return hashlib.sha256(asset_id.encode("utf-8", "replace")).hexdigest()[:32] + ".jpg"


def remove_others(folder: Path, asset_ids: Iterable[str]) -> None:
    """Remove the pictures of assets that are no more; files of other names are left alone."""
    from georef_gis.rasters.files import export_errors

    kept = {thumbnail_name(asset_id) for asset_id in asset_ids}
    for path in folder.glob("*.jpg"):
        if _OURS.fullmatch(path.stem) and path.name not in kept:
            with export_errors(path, lambda: 0):
                path.unlink(missing_ok=True)


def thumbnail(image: NDArray[Any], sight: Sight, *, size: int = SIZE) -> Image:
    """Picture of an asset, square; what lies beyond the photo is dark.

    One vertex gets a cross, more are joined.

    Parameters
    ----------
    image : shape (rows, cols, bands)
        Photo as stored.
    """
    uv, gsd = sight.uv, sight.gsd
    centre = (uv.min(axis=0) + uv.max(axis=0)) / 2.0
    extent = MARGIN * float(np.ptp(uv, axis=0).max())
    around = SPAN / gsd if math.isfinite(gsd) and gsd > 0 else 4.0 * LEAST
    span = max(extent, LEAST) if extent > around else max(around, LEAST)
    scale = size / span
    picture = _cut(image, centre, scale, size)
    marks = (uv - centre) * scale + (size - 1) / 2.0
    if len(marks) == 1:
        _cross(picture, marks[0])
    else:
        _strokes(picture, [np.vstack([marks, marks[:1]]) if sight.closed else marks])
    if math.isfinite(gsd) and gsd > 0:
        _scale_bar(picture, gsd / scale)
    return picture


def _cut(image: NDArray[Any], centre: Array, scale: float, size: int) -> Image:
    """Square around a pixel, `scale` px of it per px of the photo; 8 bits, three bands."""
    import cv2

    half = size / (2.0 * scale) + 2.0
    rows, cols = image.shape[:2]
    low = np.floor(centre - half).astype(int)
    high = np.ceil(centre + half).astype(int) + 1
    c0, r0 = (int(x) for x in np.clip(low, 0, [cols, rows]))
    c1, r1 = (int(x) for x in np.clip(high, 0, [cols, rows]))
    if c1 <= c0 or r1 <= r0:
        return np.full((size, size, 3), _PAPER, np.uint8)
    part = _eight_bits(image[r0:r1, c0:c1])
    step = max(1, int(1.0 / scale))
    if step > 1:
        # Averaged first: the warp takes single pixels.
        shape = (max(1, (c1 - c0) // step), max(1, (r1 - r0) // step))
        part = part[: shape[1] * step, : shape[0] * step]
        part = np.ascontiguousarray(cv2.resize(part, shape, interpolation=cv2.INTER_AREA))
    # From the picture's pixels to the part's: uv' = (uv + 0.5) / step - 0.5.
    middle = (size - 1) / 2.0
    start = (centre - [c0, r0] - middle / scale + 0.5) / step - 0.5
    k = 1.0 / (scale * step)
    to_part = np.array([[k, 0.0, start[0]], [0.0, k, start[1]]])
    flags = (cv2.INTER_LINEAR if scale * step <= 1.0 else cv2.INTER_CUBIC) | cv2.WARP_INVERSE_MAP
    return np.ascontiguousarray(
        cv2.warpAffine(part, to_part, (size, size), flags=flags, borderValue=_PAPER), np.uint8
    )


def _eight_bits(part: NDArray[Any]) -> Image:
    """First three bands, or one thrice; more than 8 bits stretched over what the part holds."""
    bands = part[..., :3] if part.shape[2] >= 3 else np.repeat(part[..., :1], 3, axis=2)
    if bands.dtype == np.uint8:
        return np.ascontiguousarray(bands)
    values = bands.astype(np.float64)
    low, high = np.nanpercentile(values, [1, 99]) if np.isfinite(values).any() else (0.0, 1.0)
    stretched = (values - low) / max(high - low, 1e-9) * 255.0
    return np.ascontiguousarray(np.clip(np.nan_to_num(stretched), 0, 255).astype(np.uint8))


def _cross(picture: Image, at: Array) -> None:
    """Four strokes that leave the middle free."""
    near, far = 7.0, 22.0
    ways = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    _strokes(picture, [np.array([at + near * way, at + far * way]) for way in ways])


def _scale_bar(picture: Image, metres_per_pixel: float) -> None:
    """Bar of a round length in the lower left corner."""
    import cv2

    size = picture.shape[0]
    wanted = 0.3 * size * metres_per_pixel
    power = 10.0 ** math.floor(math.log10(wanted))
    length = next(n * power for n in (5.0, 2.0, 1.0) if n * power <= wanted * 1.001)
    y, left = size - 14.0, 12.0
    right = left + length / metres_per_pixel
    ends = [np.array([[x, y - 4], [x, y + 4]]) for x in (left, right)]
    _strokes(picture, [np.array([[left, y], [right, y]]), *ends])
    words = f"{length:g} m" if length >= 1 else f"{100 * length:g} cm"
    at = (int(left), int(y) - 9)
    for colour, width in ((_PAPER, 4), (_INK, 1)):
        cv2.putText(picture, words, at, cv2.FONT_HERSHEY_SIMPLEX, 0.5, colour, width, cv2.LINE_AA)


def _strokes(picture: Image, lines: Iterable[Array]) -> None:
    """Lines with a dark rim, which show on any ground; coordinates to 1/16 px."""
    import cv2

    fixed = [np.round(line * 16.0).astype(np.int32).reshape(-1, 1, 2) for line in lines]
    for colour, width in ((_PAPER, 4), (_INK, 2)):
        cv2.polylines(picture, fixed, False, colour, width, cv2.LINE_AA, 4)
