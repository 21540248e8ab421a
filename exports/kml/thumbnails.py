"""Small pictures of photos: as stored, or without the lens' distortion."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from exports.kml.files import Spool
from georef_gis.frames import Array
from georef_gis.model.camera import Camera
from georef_gis.model.photo import Photo

WORKERS = 2
QUALITY = 75
_REDUCED = {2: cv2.IMREAD_REDUCED_COLOR_2, 4: cv2.IMREAD_REDUCED_COLOR_4,
            8: cv2.IMREAD_REDUCED_COLOR_8}  # fmt: skip

# Camera of the stored pixels, and of the same photo without distortion
Pair = tuple[Camera, Camera]
Job = tuple[Photo, Array | None]


def add_thumbnails(
    spool: Spool,
    photos: Sequence[Photo],
    pairs: Mapping[str, Pair],
    side: int,
    tick: Callable[[int], None],
) -> dict[str, str]:
    """Small pictures of photos; gives photo id -> path. A photo that cannot be read is left out.

    Parameters
    ----------
    pairs
        By photo id, for the photos that are undistorted; others stay as they are stored.
    side
        Of the longer side, px.
    tick
        Called with the number of photos done; may raise to stop.
    """
    paths: dict[str, str] = {}
    maps: dict[Camera, Array] = {}
    waiting: deque[tuple[int, Future[bytes | None]]] = deque()

    def take() -> None:
        number, future = waiting.popleft()
        data = future.result()
        if data is not None:
            # Numbered: a photo's own name may hold what a link cannot.
            path = f"thumbnails/{number:05d}.jpg"
            spool.add(path, data)
            paths[photos[number - 1].id] = path
        tick(number)

    with ThreadPoolExecutor(WORKERS) as pool:
        try:
            for number, photo in enumerate(photos, start=1):
                pair = pairs.get(photo.id)
                at = None if pair is None else _map(maps, pair, side)
                waiting.append((number, pool.submit(thumbnail, photo, side, at)))
                if len(waiting) > 4 * WORKERS:
                    take()
            while waiting:
                take()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return paths


def size_of(width: int, height: int, side: int) -> tuple[int, int]:
    """Width and height of a thumbnail, px; not larger than the photo."""
    scale = min(1.0, side / max(width, height))
    return max(1, round(width * scale)), max(1, round(height * scale))


def _map(maps: dict[Camera, Array], pair: Pair, side: int) -> Array:
    """Map of a camera, made once."""
    stored = pair[0]
    if stored not in maps:
        maps[stored] = undistorting_map(pair, size_of(stored.width, stored.height, side))
    return maps[stored]


def undistorting_map(pair: Pair, size: tuple[int, int]) -> Array:
    """Where each pixel of an undistorted thumbnail lies in a photo of any size.

    Returns
    -------
    shape (height, width, 2)
        Part of the photo's width and height, 0 to 1 from outer edge to outer edge; -1 where
        there is no content.
    """
    stored, pinhole = pair
    u, v = np.meshgrid(np.arange(size[0]) + 0.5, np.arange(size[1]) + 0.5)
    x = (u * pinhole.width / size[0] - 0.5 - pinhole.cx) / pinhole.fx
    y = (v * pinhole.height / size[1] - 0.5 - pinhole.cy) / pinhole.fy
    uv = stored.project(np.stack([x, y, np.ones_like(x)], axis=-1))
    return np.asarray(
        np.nan_to_num((uv + 0.5) / (stored.width, stored.height), nan=-1.0), dtype=np.float64
    )


def thumbnail(photo: Photo, side: int, at: Array | None = None) -> bytes | None:
    """JPEG of a photo, `side` px along its longer side; None if it cannot be read.

    Parameters
    ----------
    at
        As `undistorting_map` gives it; None = as stored.
    """
    size = size_of(photo.width, photo.height, side)
    longer = max(photo.width, photo.height)
    factor = max((f for f in _REDUCED if longer / f >= side), default=1)
    flags = _REDUCED.get(factor, cv2.IMREAD_COLOR) | cv2.IMREAD_IGNORE_ORIENTATION
    try:
        data = np.fromfile(photo.path, dtype=np.uint8)
        image = cv2.imdecode(data, flags) if data.size else None
        if image is None:
            return None
        if image.shape[1::-1] != size:
            image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        if at is not None:
            image = _sampled(image, at)
        done, jpeg = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    except (OSError, cv2.error):
        return None
    return jpeg.tobytes() if done else None


def _sampled(image: NDArray[Any], at: Array) -> NDArray[Any]:
    u = (at[..., 0] * image.shape[1] - 0.5).astype(np.float32)
    v = (at[..., 1] * image.shape[0] - 0.5).astype(np.float32)
    return np.asarray(cv2.remap(image, u, v, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE))
