"""Exporter of the mosaic as a cloud-optimised GeoTIFF."""

from __future__ import annotations

import errno
import os
import shutil
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from exports.tiles.raster_source import raster_of
from georef_gis.errors import ExportError
from georef_gis.toolbox import Exporter, ExportReport, Feedback, LayerSource, check_cancelled
from georef_gis.toolbox import parameters as p

if TYPE_CHECKING:
    from collections.abc import Mapping

LOSSY = ("jpeg", "webp")


class CogOptions(p.Parameters):
    """Options of the COG."""

    compression: Literal["keep", "jpeg", "webp", "deflate", "zstd", "lzw"] = p.choice(
        "keep", title="Compression", help="keep = the pixels as they are, byte by byte; jpeg and "
        "webp lose a little, the others nothing.",
    )  # fmt: skip
    quality: p.Integer = p.integer(85, title="Quality of jpeg and webp", ge=1, le=100)


class Cog(Exporter[CogOptions]):
    """The mosaic, or another GeoTIFF, as cloud-optimised GeoTIFF; CRS and pixels stay in place.

    The mosaic's accuracy statement, if one was made, goes into its metadata.
    """

    id = "cog"
    name = "COG (GeoTIFF)"
    suffix = ".tif"
    further_suffixes = (".tiff",)
    accepts = ("raster",)
    target = "mosaic_cog.tif"
    needs = ("mosaic",)
    wants = ("adjusted", "control", "accuracy")

    def write(
        self, source: LayerSource, target: Path, options: CogOptions, feedback: Feedback
    ) -> ExportReport:
        """Write the raster to `target`."""
        path = raster_of(source)
        check_cancelled(feedback)
        report = write_cog(path, target, options.compression, options.quality)
        if source.layer != "mosaic":
            return report
        from exports.site.reader import read_accuracy

        items, warnings = read_accuracy(source.project)
        warnings += add_accuracy(target, items)
        for warning in warnings:
            feedback.warn(warning)
        return replace(report, warnings=(*report.warnings, *warnings))


def add_accuracy(target: Path, items: Mapping[str, str]) -> tuple[str, ...]:
    """Put the items of an accuracy statement in the place of older ones; warnings."""
    from georef_gis.rasters.aux_metadata import add_tiff_items

    if not items or add_tiff_items(target, items, family="ACCURACY_"):
        return ()
    return ("the accuracy statement is left out: the file has no metadata to add it to",)


def write_cog(
    path: Path, target: Path, compression: str = "keep", quality: int = 85
) -> ExportReport:
    """Copy a COG as it is, or write it anew with another compression.

    Raises
    ------
    ExportError
        If the compression cannot hold the bands.
    OSError
        If the target cannot be written.
    """
    import rasterio

    with rasterio.open(path) as ds:
        tags, pixels = ds.tags(ns="IMAGE_STRUCTURE"), (ds.width, ds.height, ds.count)
        crs = _crs_text(ds.crs)
        is_cog = tags.get("LAYOUT") == "COG"
        _check_fit(compression, ds.dtypes[0], ds.count, path)
        same = is_cog and compression in ("keep", _own_compression(tags))
        # A lossy file is packed anew when asked for, as its quality is not known.
        same = same and compression not in LOSSY
    if same:
        shutil.copyfile(path, target)
    else:
        own = _own_compression(tags)
        _transcode(path, target, own if compression == "keep" else compression, quality)
        _check_written(target, pixels)
    return ExportReport(crs=crs, height_kind="none")


def _own_compression(tags: Mapping[str, str]) -> str:
    name = tags.get("COMPRESSION", "deflate").lower()
    return "jpeg" if "jpeg" in name else name


def _crs_text(crs: Any) -> str:
    if crs is None:
        return "unknown"
    code = crs.to_epsg()
    return f"EPSG:{code}" if code else str(crs.to_wkt()).split('"')[1]


def _check_fit(compression: str, dtype: str, bands: int, path: Path) -> None:
    if compression in LOSSY and dtype != "uint8":
        raise ExportError(
            f"{path.name}: {compression} holds 8-bit pixels, not {dtype}; use deflate or zstd"
        )
    if compression == "jpeg" and bands not in (1, 3, 4):
        raise ExportError(f"{path.name}: jpeg cannot hold {bands} bands; use deflate or zstd")
    if compression == "webp" and bands not in (3, 4):
        raise ExportError(f"{path.name}: webp holds 3 or 4 bands, not {bands}; use deflate or zstd")


def _transcode(path: Path, target: Path, compression: str, quality: int) -> None:
    import rasterio.shutil
    from rasterio.env import Env
    from rasterio.errors import RasterioError

    options: dict[str, Any] = {"COMPRESS": compression, "BIGTIFF": "IF_SAFER", "BLOCKSIZE": 512}
    if compression in LOSSY:
        options["QUALITY"] = quality
    elif compression in ("deflate", "zstd", "lzw"):
        options["PREDICTOR"] = "YES"
    try:
        with Env(GDAL_NUM_THREADS="2", GDAL_CACHEMAX=128):
            rasterio.shutil.copy(path, target, driver="COG", **options)
    except RasterioError as error:
        raise OSError(errno.EIO, str(error).splitlines()[0], os.fspath(target)) from error


def _check_written(target: Path, pixels: tuple[int, int, int]) -> None:
    """Read the file back: GDAL may notice a full disk when it closes a file, and say little."""
    import rasterio
    from rasterio.errors import RasterioError

    try:
        with rasterio.open(target) as ds:
            _, last = list(ds.block_windows(1))[-1]
            ds.read(1, window=last)
            ds.read(1, out_shape=(1, min(64, ds.height), min(64, ds.width)))
            whole = (ds.width, ds.height) == pixels[:2]
    except RasterioError as error:
        raise OSError(errno.EIO, "is not whole after writing", os.fspath(target)) from error
    if not whole:
        raise OSError(errno.EIO, "is not whole after writing", os.fspath(target))
