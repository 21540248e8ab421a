"""Directories of a Cloud Optimised GeoTIFF and where its tiles will lie."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from georef_gis.rasters import tiff
from georef_gis.rasters.codecs import predictor
from georef_gis.rasters.geokeys import nodata_tags
from georef_gis.rasters.profile import RasterProfile
from georef_gis.rasters.pyramid import Level
from georef_gis.rasters.spool import FRAME, LevelSpool
from georef_gis.rasters.tiff import LEADER, LONG, SHORT, Page, Tag, numbers, opaque, rationals

_COMPRESSION = {"jpeg": 7, "deflate": 8, "zstd": 50000, "webp": 50001}
_SAMPLE_FORMAT = {"uint8": 1, "uint16": 1, "int16": 2, "float32": 3}
_REDUCED, _MASK = 1, 4  # bits of NewSubfileType
_GREY, _RGB, _MASK_PHOTOMETRIC, _YCBCR = 1, 2, 4, 6
_UNSPECIFIED, _ALPHA = 0, 2
# bytes; offsets of classic TIFF end at 2^32, less some slack for other programs' edits
_CLASSIC_LIMIT = 2**32 - 2**20


def cog_head(
    profile: RasterProfile,
    spools: Sequence[LevelSpool],
    *,
    geo: list[Tag],
    jpeg_tables: bytes,
    masks: bool,
    bigtiff: bool | None,
) -> tuple[bytes, int]:
    """Bytes before the tiles, with `geo` in the first directory, and the size of the file."""
    pages = []
    for number, spool in enumerate(spools):
        tags = _image_tags(profile, spool.level, number, jpeg_tables)
        pages.append(_page(tags + geo if number == 0 else tags, spool.image_sizes))
        if masks:
            pages.append(_page(_mask_tags(spool.level, number), spool.mask_sizes))
    ghost = tiff.ghost_area(masks=masks)
    data = sum(int(spool.lengths(masks=masks).sum()) for spool in spools)
    big = bool(bigtiff)
    length = len(tiff.head(pages, ghost=ghost, big=big))
    if bigtiff is None and length + data > _CLASSIC_LIMIT:
        big = True
        length = len(tiff.head(pages, ghost=ghost, big=True))
    _place(pages, spools, start=length, masks=masks)
    return tiff.head(pages, ghost=ghost, big=big), length + data


def _place(pages: list[Page], spools: Sequence[LevelSpool], *, start: int, masks: bool) -> None:
    """Set the offsets of tiles: coarsest level first, rows of tiles, each with its mask."""
    step = 2 if masks else 1
    for number in range(len(spools) - 1, -1, -1):
        lengths = spools[number].lengths(masks=masks)
        at = start + LEADER + np.cumsum(lengths) - lengths
        image = pages[step * number]
        image.offsets = _where_present(at, image.sizes)
        if masks:
            mask = pages[step * number + 1]
            mask.offsets = _where_present(at + image.sizes + FRAME, mask.sizes)
        start += int(lengths.sum())


def _where_present(at: NDArray[np.int64], sizes: NDArray[np.uint32]) -> NDArray[np.uint64]:
    return np.where(sizes > 0, at, 0).astype(np.uint64)


def _page(tags: list[Tag], sizes: NDArray[np.uint32]) -> Page:
    return Page(tags=tags, offsets=np.zeros(sizes.size, np.uint64), sizes=sizes)


def _size_tags(level: Level, subfile: int) -> list[Tag]:
    return [
        numbers(254, LONG, [subfile]),
        numbers(256, LONG, [level.width]),
        numbers(257, LONG, [level.height]),
        numbers(284, SHORT, [1]),  # samples of a pixel together
        numbers(322, LONG, [level.tile_size]),
        numbers(323, LONG, [level.tile_size]),
    ]


def _mask_tags(level: Level, number: int) -> list[Tag]:
    return [
        *_size_tags(level, _MASK | (_REDUCED if number else 0)),
        numbers(258, SHORT, [1]),
        numbers(259, SHORT, [_COMPRESSION["deflate"]]),
        numbers(262, SHORT, [_MASK_PHOTOMETRIC]),
        numbers(277, SHORT, [1]),
    ]


def _image_tags(profile: RasterProfile, level: Level, number: int, jpeg_tables: bytes) -> list[Tag]:
    samples = profile.samples
    bits = 8 * np.dtype(profile.dtype).itemsize
    colour = profile.bands >= 3 and profile.dtype != "float32"
    extra = [_UNSPECIFIED] * (profile.bands - (3 if colour else 1)) + [_ALPHA] * profile.alpha
    jpeg = profile.compression == "jpeg"
    photometric = (_YCBCR if jpeg else _RGB) if colour else _GREY
    tags = [
        *_size_tags(level, _REDUCED if number else 0),
        numbers(258, SHORT, [bits] * samples),
        numbers(259, SHORT, [_COMPRESSION[profile.compression]]),
        numbers(262, SHORT, [photometric]),
        numbers(277, SHORT, [samples]),
        numbers(339, SHORT, [_SAMPLE_FORMAT[profile.dtype]] * samples),
        *nodata_tags(profile),
    ]
    if extra:
        tags.append(numbers(338, SHORT, extra))
    if profile.compression in ("deflate", "zstd"):
        tags.append(numbers(317, SHORT, [predictor(profile.dtype)]))
    if jpeg:
        tags.append(opaque(347, jpeg_tables))
    if photometric == _YCBCR:
        tags.append(numbers(530, SHORT, [2, 2]))
        tags.append(rationals(532, [0, 255, 128, 255, 128, 255]))
    return tags
