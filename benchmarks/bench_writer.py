"""CPU seconds to write an orthophoto with overviews: ours, GDAL's GTiff, GDAL's COG driver.

Usage: ``python benchmarks/bench_writer.py [--profile]``. With GEOREF_DATA naming a folder, the
first JPEG found below it is the content, tiled to the size; else noise at a photo's scales.
"""

from __future__ import annotations

import argparse
import cProfile
import os
import pstats
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

SIDE = 4400  # px
TRANSFORM = (0.03, 0.0, 500_000.0, 0.0, -0.03, 4_400_000.0)


def content() -> np.ndarray:
    """Picture of SIDE x SIDE px, RGB."""
    folder = os.environ.get("GEOREF_DATA")
    photos = (
        sorted(p for p in Path(folder).rglob("*") if p.suffix.lower() == ".jpg") if folder else []
    )
    if photos:
        from georef_gis.rasters.reading import read_image

        photo = read_image(photos[0])
        times = [-(-SIDE // n) for n in photo.shape[:2]]
        return np.ascontiguousarray(np.tile(photo, (*times, 1))[:SIDE, :SIDE])
    rng = np.random.default_rng(7)
    image = np.zeros((SIDE, SIDE, 3), np.float32)
    for step, weight in ((4, 14.0), (16, 20.0), (64, 25.0), (512, 30.0)):
        coarse = rng.normal(0, weight, (SIDE // step + 2, SIDE // step + 2, 3)).astype(np.float32)
        image += cv2.resize(coarse, (SIDE, SIDE), interpolation=cv2.INTER_CUBIC)
    return np.clip(image + 115, 0, 255).astype(np.uint8)


def turned_mask() -> np.ndarray:
    """Valid pixels of a square photo turned by 45 degrees in its north-up ortho."""
    mask = np.zeros((SIDE, SIDE), np.uint8)
    corners = np.array([[SIDE // 2, 0], [SIDE, SIDE // 2], [SIDE // 2, SIDE], [0, SIDE // 2]])
    return np.asarray(cv2.fillConvexPoly(mask, corners.astype(np.int32), 1))


def ours(
    path: Path,
    image: np.ndarray,
    mask: np.ndarray,
    wkt: str,
    workers: int = 1,
    *,
    resumable: bool = False,
) -> None:
    from georef_gis.rasters.profile import RasterProfile
    from georef_gis.rasters.writer import TiledWriter

    profile = RasterProfile(width=SIDE, height=SIDE, transform=TRANSFORM, crs_wkt=wkt)
    kept = {"resume": "bench", "work": path.parent / "work"} if resumable else {}
    with TiledWriter(path, profile, workers=workers, **kept) as writer:
        for row in range(writer.tile_rows):
            for col in range(writer.tile_cols):
                at = np.s_[row * 512 : row * 512 + 512, col * 512 : col * 512 + 512]
                writer.write_tile(row, col, image[at], mask[at])


def _gdal(path: Path, image: np.ndarray, mask: np.ndarray, wkt: str, **options: object) -> None:
    import rasterio

    shape = {"width": SIDE, "height": SIDE, "count": 3, "dtype": "uint8"}
    place = {"crs": wkt, "transform": rasterio.Affine(*TRANSFORM)}
    with (
        rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True, GDAL_NUM_THREADS=1),
        rasterio.open(path, "w", **shape, **place, **options) as dataset,
    ):
        dataset.write(np.moveaxis(image, 2, 0))
        dataset.write_mask(mask * 255)


def gdal_gtiff(path: Path, image: np.ndarray, mask: np.ndarray, wkt: str) -> None:
    import rasterio
    from rasterio.enums import Resampling

    tiles = {"tiled": True, "blockxsize": 512, "blockysize": 512}
    jpeg = {"compress": "JPEG", "photometric": "YCBCR", "jpeg_quality": 85}
    _gdal(path, image, mask, wkt, driver="GTiff", **tiles, **jpeg)
    with rasterio.open(path, "r+") as dataset:
        dataset.build_overviews([2, 4, 8, 16], Resampling.average)


def gdal_cog(path: Path, image: np.ndarray, mask: np.ndarray, wkt: str) -> None:
    options = {"compress": "JPEG", "quality": 85, "overview_resampling": "average"}
    _gdal(path, image, mask, wkt, driver="COG", **options)


def measure(name: str, write: Callable[[Path], None], repeats: int = 3) -> str:
    """Least CPU and wall seconds of some runs, and the size written."""
    cpu, wall = [], []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.tif"
        for _ in range(repeats):
            path.unlink(missing_ok=True)
            start = time.process_time(), time.perf_counter()
            write(path)
            cpu.append(time.process_time() - start[0])
            wall.append(time.perf_counter() - start[1])
        size = path.stat().st_size / 1e6
    return f"{name:34s} {min(cpu):6.3f} CPU s {min(wall):6.3f} s {size:6.2f} MB"


def imports() -> str:
    """CPU seconds that imports take above those of numpy and cv2, least of some runs."""
    base = "numpy, cv2"
    used: dict[str, list[float]] = {"": [], "georef_gis.rasters.writer": [], "rasterio": []}
    for _ in range(8):
        for name, times in used.items():
            before = resource.getrusage(resource.RUSAGE_CHILDREN)
            line = f"import {base}, {name}".rstrip(", ")
            subprocess.run([sys.executable, "-c", line], check=True)
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            times.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    least = {name: min(times) for name, times in used.items()}
    more = [f"{name} +{time_s - least['']:.3f} CPU s" for name, time_s in least.items() if name]
    return f"imports above {base}: {', '.join(more)}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--profile", action="store_true", help="show where our time goes")
    options = parser.parse_args()
    import rasterio

    wkt = rasterio.CRS.from_epsg(26917).to_wkt()
    image = content()
    every, turned = np.ones((SIDE, SIDE), np.uint8), turned_mask()
    if options.profile:
        with tempfile.TemporaryDirectory() as folder, cProfile.Profile() as profile:
            ours(Path(folder) / "a.tif", image, turned, wkt)
        pstats.Stats(profile).sort_stats("tottime").print_stats(18)
        return
    print(imports())
    for kind, mask in (("whole", every), ("turned", turned)):
        picture = image * mask[:, :, None]
        print(measure(f"ours, {kind}", lambda p: ours(p, picture, mask, wkt)))  # noqa: B023
        print(measure(f"ours, 2 threads, {kind}", lambda p: ours(p, picture, mask, wkt, 2)))  # noqa: B023
        print(
            measure(
                f"ours, resumable, {kind}",
                lambda p: ours(p, picture, mask, wkt, resumable=True),  # noqa: B023
            )
        )
        print(measure(f"GTiff + average, {kind}", lambda p: gdal_gtiff(p, picture, mask, wkt)))  # noqa: B023
        print(measure(f"COG driver, {kind}", lambda p: gdal_cog(p, picture, mask, wkt)))  # noqa: B023


if __name__ == "__main__":
    main()
