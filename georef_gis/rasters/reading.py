"""Photos as stored, and grids such as terrain models by window.

OpenCV decodes photos except TIFFs: it turns those by their Orientation whatever its flags say, and
silently merges the bands of multispectral ones. GDAL does neither, so TIFFs go through rasterio.
"""

from __future__ import annotations

import io
import os
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from georef_gis.errors import InputError
from georef_gis.rasters.profile import Transform
from georef_gis.rasters.pyramid import extended

# col, row of the upper left pixel, width, height, px
Window = tuple[int, int, int, int]

_REDUCED = {1: 0, 2: 16, 4: 32, 8: 64}  # OpenCV's IMREAD_REDUCED_GRAYSCALE_*, 0 = whole
_GREY, _RGB = 0, 256  # IMREAD_GRAYSCALE, IMREAD_COLOR_RGB
_HAS_RGB = hasattr(cv2, "IMREAD_COLOR_RGB")
_TIFF_MAGIC = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_JPEG_MAGIC = b"\xff\xd8\xff"
_END = b"\xff\xd9"
_SCAN = 0xDA
# Start of frame markers: C0 to CF without DHT, JPG and DAC.
_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
# Filters of warnings are the process's, not the thread's.
_OPENING = threading.Lock()


@dataclass(frozen=True, slots=True, kw_only=True)
class GridHeader:
    """What a raster says of itself.

    Parameters
    ----------
    width, height
        px.
    transform
        Grid to map, (0, 0) = outer corner, CRS units per px.
    crs_wkt
        Empty if the file does not tell.
    nodata
        Value of missing pixels in the file, if it has one.
    unit
        Unit of the values as the file tells it, often empty.
    """

    width: int
    height: int
    transform: Transform
    crs_wkt: str
    nodata: float | None
    unit: str


@dataclass(frozen=True, slots=True, kw_only=True)
class RasterGrid:
    """Values of one band over a window.

    Parameters
    ----------
    values : shape (rows, cols), float32 or float64
        In the unit of the header, scale and offset applied; NaN where missing.
    transform
        Grid of this window to map.
    header
        Of the whole file.
    """

    values: NDArray[np.floating[Any]]
    transform: Transform
    header: GridHeader


def read_grid_header(path: str | os.PathLike[str], *, band: int = 1) -> GridHeader:
    """Size, place and CRS of a raster, without its values.

    Raises
    ------
    InputError
        If the file cannot be read as a raster, lacks the band or a geotransform.
    """
    with _dataset(path) as dataset:
        return _header(dataset, path, band)


def read_grid(
    path: str | os.PathLike[str], *, window: Window | None = None, band: int = 1
) -> RasterGrid:
    """Values of one band, all or of a window.

    Parameters
    ----------
    path
        Any raster GDAL reads.
    window
        Column and row of the upper left pixel, width, height, px; inside the raster.
    band
        Counted from 1.

    Raises
    ------
    InputError
        If the file cannot be read as a raster, lacks the band or a geotransform.
    ValueError
        If the window is empty or leaves the raster.
    """
    from rasterio.windows import Window as GdalWindow

    with _dataset(path) as dataset:
        header = _header(dataset, path, band)
        col, row, width, height = window or (0, 0, header.width, header.height)
        inside = col + width <= header.width and row + height <= header.height
        if min(col, row) < 0 or min(width, height) < 1 or not inside:
            raise ValueError(f"window {window} leaves {header.width} x {header.height} px")
        # allow for 32-bit integers, which float32 would round
        kind = np.result_type(dataset.dtypes[band - 1], np.float32)
        read = dataset.read(band, window=GdalWindow(col, row, width, height), masked=True)
        values = read.astype(kind).filled(np.nan)
        scale, offset = dataset.scales[band - 1], dataset.offsets[band - 1]
    if (scale, offset) != (1.0, 0.0):
        values = values * kind.type(scale) + kind.type(offset)
    a, b, c, d, e, f = header.transform
    shifted = (a, b, a * col + b * row + c, d, e, d * col + e * row + f)
    return RasterGrid(values=values, transform=shifted, header=header)


def read_image(
    path: str | os.PathLike[str], *, reduce: int = 1, alpha: bool = True
) -> NDArray[Any]:
    """Photo as stored: EXIF Orientation is not applied.

    Parameters
    ----------
    path
        JPEG, TIFF, PNG or another format OpenCV reads.
    reduce
        1, 2, 4 or 8: side of the square of pixels averaged into one, the last ones
        maybe cut by the edge; ``uv' = (uv + 0.5) / reduce - 0.5``.
    alpha
        Whether an alpha channel counts as a band; else it is left out.

    Returns
    -------
    image : shape (rows, cols, bands), uint8 or as the TIFF has it
        Bands in the order red, green, blue (alpha), or as stored in a multispectral TIFF.

    Raises
    ------
    InputError
        If the file is missing, not an image, or truncated.
    """
    _check_reduce(reduce)
    try:
        raw = Path(path).read_bytes()
    except OSError as error:
        raise InputError(
            f"cannot be read ({error.strerror}); check the path", source=_name(path)
        ) from error
    if raw[:4] in _TIFF_MAGIC:
        return _reduced(_tiff(path, alpha=alpha), reduce)
    return decode_image(raw, _name(path), reduce=reduce, alpha=alpha)


def decode_image(raw: bytes, name: str, *, reduce: int = 1, alpha: bool = True) -> NDArray[Any]:
    """Photo from the bytes of its file, as `read_image` gives it; `name` is for messages.

    Raises
    ------
    InputError
        If they are not an image, or truncated.
    """
    _check_reduce(reduce)
    if raw[:4] in _TIFF_MAGIC:
        return _reduced(_tiff(io.BytesIO(raw), name, alpha=alpha), reduce)
    if raw.startswith(_JPEG_MAGIC):
        return _jpeg(raw, name, reduce)
    # such as PNG; UNCHANGED keeps alpha and 16 bits
    image = _decoded(raw, cv2.IMREAD_UNCHANGED, name)
    if not alpha and image.shape[2] == 4:
        image = np.ascontiguousarray(image[..., :3])
    return _reduced(image, reduce)


def _check_reduce(reduce: int) -> None:
    if reduce not in _REDUCED:
        raise ValueError(f"reduce {reduce}: must be 1, 2, 4 or 8")


def _jpeg(raw: bytes, name: str, reduce: int) -> NDArray[Any]:
    """Decode a JPEG found whole; OpenCV would give grey for what is missing."""
    height, width, bands = _check_jpeg(raw, name)
    flags = cv2.IMREAD_IGNORE_ORIENTATION | _REDUCED[reduce]
    if bands == 1:
        image = _decoded(raw, flags | _GREY, name)
    elif _HAS_RGB:
        image = _decoded(raw, flags | _RGB, name)
    else:
        image = _decoded(raw, flags | cv2.IMREAD_COLOR, name, swap=True)
    if image.shape[:2] != (-(-height // reduce), -(-width // reduce)):
        raise InputError(
            f"JPEG says {width} x {height} px but holds {image.shape[1]} x {image.shape[0]}; "
            "copy it from the card again",
            source=name,
        )
    return image


def _check_jpeg(raw: bytes, name: str) -> tuple[int, int, int]:
    """Rows, columns and bands of a JPEG whose image has its end marker.

    The marker is sought behind the start of the scan, as the preview inside the EXIF segment
    has one too; further pictures and other bytes may follow it.
    """
    at, size = 2, (0, 0, 0)
    while raw[at : at + 1] == b"\xff" and at + 4 <= len(raw):
        marker = raw[at + 1]
        if marker == 0xFF:  # fill byte
            at += 1
            continue
        if marker in _FRAMES and at + 10 <= len(raw):
            rows, cols = raw[at + 5 : at + 7], raw[at + 7 : at + 9]
            size = (int.from_bytes(rows, "big"), int.from_bytes(cols, "big"), raw[at + 9])
        if marker == _SCAN:
            if raw.endswith(_END) or raw.find(_END, at) >= 0:
                return size
            break
        at += 2 + int.from_bytes(raw[at + 2 : at + 4], "big")
    raise InputError(
        f"JPEG is truncated: no end of image in its {len(raw)} bytes; "
        "copy it from the card again or leave the photo out",
        source=name,
    )


def _decoded(raw: bytes, flags: int, name: str, *, swap: bool = False) -> NDArray[Any]:
    """Decode by OpenCV, three axes; with `swap` or UNCHANGED colours come as BGR and turn."""
    try:
        image = cv2.imdecode(np.frombuffer(raw, np.uint8), flags) if raw else None
    except cv2.error as error:
        raise InputError(f"cannot be decoded ({error.err}); leave it out", source=name) from error
    if image is None:
        raise InputError("is not an image or is damaged; leave it out", source=name)
    if image.ndim == 2:
        return image[:, :, None]
    if swap or flags == cv2.IMREAD_UNCHANGED:
        code = cv2.COLOR_BGRA2RGBA if image.shape[2] == 4 else cv2.COLOR_BGR2RGB
        return cv2.cvtColor(image, code)
    return image


def _tiff(
    source: str | os.PathLike[str] | io.BytesIO, name: str = "", *, alpha: bool
) -> NDArray[Any]:
    with _dataset(source, name) as dataset:
        kinds = zip(dataset.indexes, dataset.colorinterp, strict=True)
        bands = [index for index, kind in kinds if alpha or kind.name != "alpha"]
        return np.ascontiguousarray(np.moveaxis(dataset.read(bands), 0, 2))


def _reduced(image: NDArray[Any], reduce: int) -> NDArray[Any]:
    """Mean of squares, those at the edge filled up by its repetition."""
    if reduce == 1:
        return image
    rows, cols, bands = image.shape
    image = extended(image, rows + -rows % reduce, cols + -cols % reduce)
    size = (image.shape[1] // reduce, image.shape[0] // reduce)
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    return small.reshape(size[1], size[0], bands)


@contextmanager
def _dataset(source: str | os.PathLike[str] | io.BytesIO, name: str = "") -> Iterator[Any]:
    """An open rasterio dataset; what it cannot read is the fault of the file, called `name`."""
    import rasterio
    from rasterio.errors import NotGeoreferencedWarning, RasterioError

    try:
        with _OPENING, warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            dataset = rasterio.open(source)
        with dataset:
            yield dataset
    except RasterioError as error:
        raise InputError(
            f"cannot be read as a raster ({_one_line(error)}); check that the file is whole",
            source=_named(source, name),
        ) from error


def _header(dataset: Any, path: str | os.PathLike[str], band: int) -> GridHeader:
    if not 1 <= band <= dataset.count:
        raise InputError(f"has {dataset.count} bands, no band {band}", source=_name(path))
    if dataset.transform.is_identity:
        raise InputError(
            "has no geotransform, so its place is unknown; give a georeferenced file",
            source=_name(path),
        )
    return GridHeader(
        width=dataset.width,
        height=dataset.height,
        transform=tuple(dataset.transform)[:6],
        crs_wkt=dataset.crs.to_wkt() if dataset.crs else "",
        nodata=dataset.nodatavals[band - 1],
        unit=dataset.units[band - 1] or "",
    )


def count_valid(path: str | os.PathLike[str]) -> int:
    """Pixels of a raster that its mask, alpha or nodata value calls valid, tile by tile."""
    with _dataset(path) as dataset:
        windows = [window for _, window in dataset.block_windows(1)]
        return sum(int(np.count_nonzero(dataset.dataset_mask(window=w))) for w in windows)


def _name(path: str | os.PathLike[str]) -> str:
    return Path(path).name


def _named(source: str | os.PathLike[str] | io.BytesIO, name: str) -> str:
    return name if isinstance(source, io.BytesIO) else _name(source)


def _one_line(error: Exception) -> str:
    return " ".join(str(error.__cause__ or error).split())
