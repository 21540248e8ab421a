"""Tiles of photos to their own pixels, at several zooms; decoded photos are kept for a while."""

from __future__ import annotations

import os
import threading
from collections import OrderedDict
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from georef_gis.errors import InputError
from georef_gis.rasters.reading import read_image
from georef_gis.rasters.screen import EMPTY_TILE, ScreenPicture, Stretch, encode, stretch_of

TILE = 512
# What the decoder makes smaller by itself, at less than half the time.
_DECODED = (1, 2, 4, 8)
# bytes; six photos of 20 megapixels
_KEPT = 400_000_000

_Key = tuple[str, int, int]


def zoom_levels(width: int, height: int) -> int:
    """Number of levels of a photo: level k has pixels of 2^k, the last one fits into a tile."""
    return max(1, int(np.ceil(np.log2(max(width, height) / TILE))) + 1)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Level:
    """Shades of a photo at one level."""

    shades: NDArray[np.uint8]


class PhotoTiles:
    """Tiles of photos, decoded once; may be asked by several threads.

    Parameters
    ----------
    most
        Bytes of decoded photos kept.
    """

    def __init__(self, most: int = _KEPT) -> None:
        self._most = most
        self._kept: OrderedDict[_Key, Future[_Level]] = OrderedDict()
        self._stretches: dict[str, Stretch] = {}
        self._lock = threading.Lock()
        # One at a time: what was asked for goes before what may be.
        self._ahead = ThreadPoolExecutor(1, thread_name_prefix="georef-photo")

    def close(self) -> None:
        """Forget everything and decode no more ahead."""
        self._ahead.shutdown(wait=False, cancel_futures=True)
        with self._lock:
            self._kept.clear()

    def tile(self, path: Path, level: int, col: int, row: int) -> ScreenPicture:
        """Picture of a tile of a photo as stored; empty outside.

        Level 0 has the photo's own pixels. The first tile of a coarse level has the whole photo
        decoded meanwhile: it is what a user looks at next.

        Raises
        ------
        InputError
            If the file cannot be read, or there is no such level.
        """
        shades = self.level(path, level).shades
        rows, cols = shades.shape[:2]
        left, top = col * TILE, row * TILE
        if level > 0:
            self._decode_ahead(path)
        if col < 0 or row < 0 or left >= cols or top >= rows:
            return EMPTY_TILE
        part = np.ascontiguousarray(shades[top : top + TILE, left : left + TILE])
        # Pixels are clicked: at their own size they are what the camera stored.
        return encode(part, None, (TILE, TILE), exact=level == 0)

    def level(self, path: Path, level: int) -> _Level:
        """A level of a photo, decoded by the first thread that asks."""
        if not 0 <= level <= 12:
            raise InputError(f"no level {level}; levels are 0 to 12", source=path.name)
        key = (os.fspath(path), _changed(path), level)
        with self._lock:
            waiting = self._kept.get(key)
            mine: Future[_Level] | None = None
            if waiting is None:
                waiting = mine = Future()
                self._kept[key] = mine
            self._kept.move_to_end(key)
        if mine is not None:
            self._fill(key, mine, path, level)
        return waiting.result()

    def _fill(self, key: _Key, mine: Future[_Level], path: Path, level: int) -> None:
        try:
            mine.set_result(_Level(shades=self._made(path, level)))
        except BaseException as error:
            with self._lock:
                self._kept.pop(key, None)
            mine.set_exception(error)
        self._forget_oldest()

    def _made(self, path: Path, level: int) -> NDArray[np.uint8]:
        factor = 2**level
        if factor > _DECODED[-1]:
            finer = self.level(path, level - 1).shades
            return _halved(finer)
        samples = read_image(path, reduce=factor, alpha=False)
        # Black and white are the same at every zoom, or the photo would flicker.
        stretch = self._stretches.get(os.fspath(path))
        if stretch is None:
            stretch = self._stretches[os.fspath(path)] = stretch_of(samples)
        return stretch.applied(samples)

    def _decode_ahead(self, path: Path) -> None:
        key = (os.fspath(path), _changed(path), 0)
        with self._lock:
            if key in self._kept:
                return

        def decode() -> None:
            try:
                self.level(path, 0)
            except InputError:
                # Whoever asks for the tile is told.
                return

        try:
            self._ahead.submit(decode)
        except RuntimeError:
            # closed meanwhile
            return

    def _forget_oldest(self) -> None:
        with self._lock:
            size = sum(_size(future) for future in self._kept.values())
            for key in list(self._kept):
                if size <= self._most or len(self._kept) == 1:
                    return
                if self._kept[key].done():
                    size -= _size(self._kept.pop(key))


def _size(future: Future[_Level]) -> int:
    if not future.done() or future.exception() is not None:
        return 0
    return int(future.result().shades.nbytes)


def _halved(image: NDArray[Any]) -> NDArray[np.uint8]:
    rows, cols, bands = image.shape
    size = (max(1, -(-cols // 2)), max(1, -(-rows // 2)))
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    return np.asarray(small.reshape(size[1], size[0], bands), dtype=np.uint8)


def _changed(path: Path) -> int:
    try:
        return path.stat().st_mtime_ns
    except OSError as error:
        raise InputError(
            f"cannot be read ({error.strerror}); check the path", source=path.name
        ) from error
