"""CPU of the KMZ of a mosaic against its floor, and how well the superoverlay holds the mosaic.

    python benchmarks/kmz_cost.py PROJECT [--runs 3]

The floor decodes the mosaic, warps it once (one remap with one map for all blocks) and encodes the
pyramid: tiles of 256 px of all levels, JPEG where opaque, PNG at the rim. No geometry, no KML, no
file. Both run in this process, one after the other, on one thread; decoding is GDAL's for both.
"""

from __future__ import annotations

import argparse
import math
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import rasterio
from rasterio.windows import Window

from exports.kml.kml import write_kmz
from exports.kml.options import KmzOptions
from exports.site.site import SiteLayers
from georef_gis.project import Project
from georef_gis.toolbox import CollectingFeedback

TILE, BLOCK = 256, 1024
QUALITY = 85
# px of the patches that are compared, and how many
PATCH, PATCHES = 512, 60


def main() -> None:
    """Measure and tell."""
    parser = argparse.ArgumentParser()
    parser.add_argument("project", type=Path)
    parser.add_argument("--runs", type=int, default=3)
    given = parser.parse_args()
    cv2.setNumThreads(1)
    site = SiteLayers.from_project(Project.open(given.project, read_only=True))
    assert site.mosaic is not None
    # The mosaic alone: no photo is read.
    bare = replace(site, photos=(), footprints=(), control=(), assets=())
    options = KmzOptions(overlay="pyramid", thumbnails=False, quality=QUALITY)
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "site.kmz"
        floors, ours = [], []
        for _ in range(given.runs):
            floors.append(cpu_of(lambda: floor(site.mosaic)))
            ours.append(cpu_of(lambda: write_kmz(bare, target, options, CollectingFeedback())))
        a, b = float(np.median(floors)), float(np.median(ours))
        print(f"floor {a:.2f} s ({min(floors):.2f}-{max(floors):.2f})")
        print(f"KMZ   {b:.2f} s ({min(ours):.2f}-{max(ours):.2f}), {b / a:.2f} x the floor, "
              f"{target.stat().st_size / 1e6:.1f} MB")  # fmt: skip
        shift, psnr = compare(target, site)
        print(f"superoverlay read by GDAL: {np.median(shift):.3f} px median, {shift.max():.3f} px "
              f"largest shift of {len(shift)} patches; {psnr:.1f} dB PSNR")  # fmt: skip


def cpu_of(work: Callable[[], object]) -> float:
    """CPU of a piece of work, s."""
    start = time.process_time()
    work()
    return time.process_time() - start


def floor(path: Path) -> int:
    """Decode, warp and encode; gives the bytes of the pyramid."""
    with rasterio.Env(GDAL_CACHEMAX=64), rasterio.open(path) as ds:
        u, v = np.meshgrid(np.arange(BLOCK, dtype=np.float32), np.arange(BLOCK, dtype=np.float32))
        maps = np.dstack([u + 0.3 + 0.002 * v, v + 0.3 - 0.002 * u])
        coarse = np.zeros((math.ceil(ds.height / 4), math.ceil(ds.width / 4), 4), np.uint8)
        size = 0
        for row in range(0, ds.height, BLOCK):
            for col in range(0, ds.width, BLOCK):
                window = Window(col, row, min(BLOCK, ds.width - col), min(BLOCK, ds.height - row))
                mask = ds.dataset_mask(window=window)
                if not mask.any():
                    continue
                red, green, blue = ds.read((1, 2, 3), window=window)
                block = cv2.remap(cv2.merge([blue, green, red, mask]), maps, None, cv2.INTER_LINEAR)
                size += encode(block)
                half = cv2.resize(block, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
                size += encode(half)
                part = cv2.resize(half, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
                target = coarse[row // 4 : row // 4 + TILE, col // 4 : col // 4 + TILE]
                target[:] = part[: target.shape[0], : target.shape[1]]
        while True:
            size += encode(coarse)
            if max(coarse.shape[:2]) <= TILE:
                return size
            coarse = cv2.resize(coarse, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)


def encode(block: np.ndarray) -> int:
    """Bytes of the tiles of a block."""
    size = 0
    for row in range(0, block.shape[0], TILE):
        for col in range(0, block.shape[1], TILE):
            tile = block[row : row + TILE, col : col + TILE]
            least, most = int(tile[..., 3].min()), int(tile[..., 3].max())
            if most == 0:
                continue
            if least == 255:
                image, kind = np.ascontiguousarray(tile[..., :3]), ".jpg"
                options = [cv2.IMWRITE_JPEG_QUALITY, QUALITY]
            else:
                image, kind, options = tile, ".png", []
            size += len(cv2.imencode(kind, image, options)[1])
    return size


def compare(kmz: Path, site: SiteLayers) -> tuple[np.ndarray, float]:
    """Shifts, px of the mosaic, and PSNR, dB, of patches spread over the mosaic.

    The mosaic is resampled by cubic splines to the pixels of the superoverlay, as GDAL reads them,
    by the project's own way between map and degrees.
    """
    rng = np.random.default_rng(0)
    shifts, squares = [], []
    with rasterio.open(kmz) as overlay, rasterio.open(site.mosaic) as mosaic:
        while len(shifts) < PATCHES:
            col = int(rng.integers(0, overlay.width - PATCH))
            row = int(rng.integers(0, overlay.height - PATCH))
            window = Window(col, row, PATCH, PATCH)
            if overlay.read(4, window=window).min() < 255:
                continue
            got = overlay.read((1, 2, 3), window=window).astype(np.float32)
            wanted = resampled(mosaic, overlay, site, col, row)
            if wanted is None:
                continue
            squares.append(float(np.mean((got - wanted) ** 2)))
            taper = cv2.createHanningWindow((PATCH, PATCH), cv2.CV_32F)
            (dx, dy), _ = cv2.phaseCorrelate(got[1], wanted[1], taper)
            shifts.append(math.hypot(dx, dy))
    return np.array(shifts), 10.0 * math.log10(255.0**2 / float(np.mean(squares)))


def resampled(
    mosaic: rasterio.DatasetReader, overlay: rasterio.DatasetReader, site: SiteLayers,
    col: int, row: int,
) -> np.ndarray | None:  # fmt: skip
    """Mosaic at the pixel centres of a patch of the superoverlay; (3, n, n)."""
    u, v = np.meshgrid(col + np.arange(PATCH) + 0.5, row + np.arange(PATCH) + 0.5)
    t = overlay.transform
    lat, lon = np.radians(t.f + t.e * v), np.radians(t.c + t.a * u)
    h = np.full(lat.shape, site.frame.origin.height_ellipsoidal)
    p = site.frame.map_from_geo(np.stack([lat, lon, h], axis=-1))
    m = ~mosaic.transform
    x, y = m.a * p[..., 0] + m.c, m.e * p[..., 1] + m.f
    left, top = int(x.min()) - 4, int(y.min()) - 4
    window = Window(left, top, int(x.max()) + 5 - left, int(y.max()) + 5 - top)
    if left < 0 or top < 0 or mosaic.dataset_mask(window=window).min() < 255:
        return None
    source = np.moveaxis(mosaic.read((1, 2, 3), window=window), 0, -1).astype(np.float32)
    maps = [(a - b - 0.5).astype(np.float32) for a, b in ((x, left), (y, top))]
    return np.moveaxis(cv2.remap(source, maps[0], maps[1], cv2.INTER_CUBIC), -1, 0)


main()
