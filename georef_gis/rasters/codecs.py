"""Compression of one tile, its alpha or 1-bit mask included."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from georef_gis.rasters.profile import RasterProfile
from georef_gis.rasters.pyramid import Mask, Samples, Tile, extended

# px; side of the block that one set of 4:2:0 JPEG coefficients covers
_BLOCK = 16
_DEFLATE_LEVEL = 6
_ZSTD_LEVEL = 9
_MASK_LEVEL = 6
_TABLES = (0xDB, 0xC4)  # DQT, DHT
_FRAMES = (0xC0, 0xC1, 0xC2)
_SCAN = 0xDA


class Encoder:
    """Makes the bytes of tiles of one file; has no changing state, so threads may share it."""

    def __init__(self, profile: RasterProfile) -> None:
        self._profile = profile
        self._size = profile.tile_size
        self._full_mask = self._deflate_mask(np.ones((self._size, self._size), np.uint8))
        # DQT and DHT of all tiles, for the tag JPEGTables.
        self.jpeg_tables = b""
        self._jpeg_long = self._jpeg_short = b""
        if profile.compression == "jpeg":
            blank = np.zeros((self._size, self._size, profile.bands), np.uint8)
            parts = _split_jpeg(self._jpeg(blank))
            self.jpeg_tables, self._jpeg_long, self._jpeg_short = parts
        self._compress = self._compressor()

    def image(self, tile: Tile) -> bytes:
        """The image tile, padded to full size by repeating its edge."""
        data = tile.data if tile.mask is None else self._filled(tile.data, tile.mask)
        data = self._padded(data)
        if self._profile.alpha:
            data = self._with_alpha(data, tile.mask)
        return self._compress(data)

    def mask(self, tile: Tile) -> bytes:
        """The 1-bit mask tile, DEFLATE."""
        if tile.mask is None:
            return self._full_mask
        return self._deflate_mask(self._padded(tile.mask))

    def _compressor(self) -> Callable[[Samples], bytes]:
        if self._profile.compression == "jpeg":
            return self._jpeg
        if self._profile.compression == "webp":
            return self._webp
        if self._profile.compression == "zstd":
            return self._zstd
        return self._deflate

    def _jpeg(self, data: Samples) -> bytes:
        """JPEG stream without its tables if they are the common ones."""
        options = [cv2.IMWRITE_JPEG_QUALITY, self._profile.quality]
        if data.shape[2] == 3:
            data = cv2.cvtColor(data, cv2.COLOR_RGB2BGR)
            options += [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420]
        stream = _encode(".jpg", data, options)
        if self._jpeg_long and stream.startswith(self._jpeg_long):
            return self._jpeg_short + stream[len(self._jpeg_long) :]
        return stream

    def _webp(self, data: Samples) -> bytes:
        code = cv2.COLOR_RGBA2BGRA if data.shape[2] == 4 else cv2.COLOR_RGB2BGR
        options = [cv2.IMWRITE_WEBP_QUALITY, self._profile.quality]
        return _encode(".webp", cv2.cvtColor(data, code), options)

    def _deflate(self, data: Samples) -> bytes:
        return zlib.compress(_predicted(data), self._profile.level or _DEFLATE_LEVEL)

    def _zstd(self, data: Samples) -> bytes:
        import zstandard

        level = self._profile.level or _ZSTD_LEVEL
        return bytes(zstandard.ZstdCompressor(level=level).compress(_predicted(data)))

    def _filled(self, data: Samples, mask: Mask) -> Samples:
        """Copy with missing pixels set to the fill value, for lossy codecs smooth at the rim."""
        if data.dtype == np.uint8 and data.shape[2] <= 4 and self._profile.fill == 0:
            filled = cv2.bitwise_and(data, data, mask=mask).reshape(data.shape)
        else:
            filled = np.where(mask[:, :, None] != 0, data, data.dtype.type(self._profile.fill))
        if self._profile.compression in ("jpeg", "webp"):
            filled = self._padded(filled)
            _smooth_rim(filled, self._padded(mask))
        return filled

    def _with_alpha(self, data: Samples, mask: Mask | None) -> Samples:
        opaque = np.iinfo(data.dtype).max
        full = np.empty((self._size, self._size, data.shape[2] + 1), data.dtype)
        full[:, :, :-1] = data
        full[:, :, -1] = opaque
        if mask is not None:
            full[:, :, -1] *= self._padded(mask)
        return full

    def _padded(self, values: NDArray[Any]) -> NDArray[Any]:
        return extended(values, self._size, self._size)

    @staticmethod
    def _deflate_mask(mask: Mask) -> bytes:
        return zlib.compress(np.packbits(mask, axis=1).tobytes(), _MASK_LEVEL)


def _encode(kind: str, data: Samples, options: list[int]) -> bytes:
    done, stream = cv2.imencode(kind, data, options)
    if not done:
        raise RuntimeError(f"OpenCV could not encode a tile as {kind}")
    return stream.tobytes()


def _split_jpeg(stream: bytes) -> tuple[bytes, bytes, bytes]:
    """JPEGTables stream, the head up to the scan, and that head without tables and JFIF."""
    tables, frame, at = [], b"", 2
    while stream[at + 1] != _SCAN:
        end = at + 2 + int.from_bytes(stream[at + 2 : at + 4], "big")
        if stream[at + 1] in _TABLES:
            tables.append(stream[at:end])
        elif stream[at + 1] in _FRAMES:
            frame = stream[at:end]
        at = end
    start, stop = stream[:2], b"\xff\xd9"
    return start + b"".join(tables) + stop, stream[:at], start + frame


def _smooth_rim(data: Samples, mask: Mask) -> None:
    """Fill missing pixels of the rim's blocks and of the blocks beside them, in place.

    A hard step to black inside a block would ring into the valid pixels next to it, and one at its
    border would bleed in where the decoder interpolates colours.
    """
    size, bands = data.shape[0], data.shape[2]
    side = size // _BLOCK
    runs = np.packbits(mask, axis=1).view(np.uint16).reshape(side, _BLOCK, side)
    some = np.bitwise_or.reduce(runs, axis=1) != 0
    every = np.bitwise_and.reduce(runs, axis=1) == 0xFFFF
    blocks = data.reshape(side, _BLOCK, side, _BLOCK, bands)
    row, col = np.nonzero(some & ~every)
    if row.size:
        valid = mask.reshape(side, _BLOCK, side, _BLOCK)[row, :, col, :, None]
        pixels = blocks[row, :, col]
        mean = pixels.sum(axis=(1, 2), where=valid != 0) // valid.sum(axis=(1, 2), dtype=np.uint64)
        blocks[row, :, col] = np.where(valid, pixels, mean.astype(data.dtype)[:, None, None, :])
    present = some.astype(np.float32)
    near = cv2.boxFilter(present, -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT)
    row, col = np.nonzero((near > 0) & ~some)
    if row.size:
        small = cv2.resize(data, (side, side), interpolation=cv2.INTER_AREA)
        known = small.reshape(side, side, bands) * present[:, :, None]
        total = cv2.boxFilter(known, -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT)
        mean = total.reshape(side, side, bands)[row, col] / near[row, col, None]
        blocks[row, :, col] = mean.astype(data.dtype)[:, None, None, :]


def _predicted(data: Samples) -> bytes:
    """Samples as differences along the row: TIFF predictor 2, or 3 for floats."""
    if data.dtype == np.float32:
        return _float_predicted(data)
    values = np.ascontiguousarray(data).view(f"u{data.dtype.itemsize}")
    result = values.copy()
    result[:, 1:] -= values[:, :-1]
    return result.tobytes()


def _float_predicted(data: Samples) -> bytes:
    """Bytes of each row sorted by weight, then differences (Adobe TIFF technical note 3)."""
    rows, cols, bands = data.shape
    planes = data.astype(">f4").view(np.uint8).reshape(rows, cols * bands, 4)
    row = np.ascontiguousarray(planes.transpose(0, 2, 1)).reshape(rows, -1)
    result = row.copy()
    result[:, bands:] -= row[:, :-bands]
    return result.tobytes()


def predictor(dtype: str) -> int:
    """Value of the tag Predictor for samples of this type."""
    return 3 if dtype == "float32" else 2
