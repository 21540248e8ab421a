"""What `georef change` finds on simulated sites, how sure it is, and what it costs.

python benchmarks/change.py calibration 60     reliability of the confidence, over draws
python benchmarks/change.py sizes 30           part found, by size and contrast
python benchmarks/change.py cost 10000 FOLDER  CPU and memory for two maps of so many px a side
"""

from __future__ import annotations

import itertools
import resource
import sys
import tempfile
import time
from collections import defaultdict
from pathlib import Path
from typing import Any

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "change"))
from change_cases import FINE, Look, Thing, compared, ground, matches, render, truth_shapes

from georef_gis.measure.change.detect import Comparison
from georef_gis.rasters.gdal_cache import gdal_cache

# m
SIDE, CELL = 36.0, 0.12
BOUNDS = (0.0, 0.02, 0.1, 0.3, 0.5, 0.7, 0.9, 0.97, 1.01)


def random_thing(rng: np.random.Generator) -> Thing:
    """A thing or a shadow of any size and contrast, faint ones too."""
    width = float(np.exp(rng.uniform(np.log(0.35), np.log(5.0))))
    x, y = rng.uniform(5.0, SIDE - 5.0, 2)
    contrast = float(np.exp(rng.uniform(np.log(0.1), np.log(1.0)))) * rng.choice([-0.8, 1.0])
    tint = rng.normal(0, 0.25 * abs(contrast), 3)
    colour = np.clip(0.38 * np.exp(contrast + tint), 0.03, 0.97)
    return Thing(
        x, y, width, width * rng.uniform(0.5, 1.0), tuple(colour), turn=rng.uniform(0, 3),
        disc=bool(rng.integers(2)), rough=0.03,
    )  # fmt: skip


def draw(seed: int, folder: Path) -> tuple[list[Thing], Comparison]:
    """A site with up to nine changes, seen by two flights that differ in all else."""
    rng = np.random.default_rng(seed)
    site = ground(rng, SIDE)
    first = Look(gsd=0.05, jpeg=int(rng.integers(70, 95)), noise=rng.uniform(0.005, 0.02))
    second = Look(
        gsd=0.06, shift=tuple(rng.uniform(-0.8, 0.8, 2)), scale=1 + rng.normal(0, 1e-3),
        gain=tuple(rng.uniform(0.75, 1.1, 3)), shading=rng.uniform(-0.15, 0.15),
        noise=rng.uniform(0.005, 0.025), blur=rng.uniform(0.4, 1.0),
        jpeg=int(rng.integers(60, 95)), grey=bool(rng.random() < 0.2),
    )  # fmt: skip
    things = [random_thing(rng) for _ in range(int(rng.integers(0, 10)))]
    for number, thing in enumerate(things):
        (first if number % 2 else second).things.append(thing)
    for _ in range(int(rng.integers(0, 4))):
        x, y = rng.uniform(5.0, SIDE - 5.0, 2)
        shadow = Thing(x, y, 2.5, 1.0, (0.4, 0.45, 0.55), turn=rng.uniform(0, 3), shadow=True)
        second.things.append(shadow)
    later, earlier = folder / "later.tif", folder / "earlier.tif"
    render(later, site, first, rng)
    render(earlier, site, second, rng)
    return things, compared(later, earlier, CELL)


def calibration(draws: int) -> None:
    """Print the reliability table: shadows do not count as changes."""
    rows: list[tuple[float, bool]] = []
    hectares, missed = 0.0, 0
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(draws):
            things, found = draw(seed, Path(folder))
            shapes = truth_shapes(things, found.cells)
            hectares += found.compared * found.cells.metres**2 / 1e4
            hit = [matches(change, shapes) for change in found.changes]
            rows += [(c.confidence, bool(h)) for c, h in zip(found.changes, hit, strict=True)]
            sure = [h for c, h in zip(found.changes, hit, strict=True) if c.confidence >= 0.5]
            missed += len(things) - len(set().union(*sure) if sure else set())
    values = np.array(rows)
    print("confidence   n  mean   real")
    for low, high in itertools.pairwise(BOUNDS):
        some = values[(values[:, 0] >= low) & (values[:, 0] < high)]
        if len(some):
            mean, real = some.mean(axis=0)
            print(f"{low:.2f}-{high:.2f} {len(some):4d}  {mean:.3f}  {real:.3f}")
    false = int(((values[:, 0] >= 0.5) & (values[:, 1] == 0)).sum())
    print(f"false of confidence >= 0.5: {false} on {hectares:.2f} ha; missed {missed}")


def sizes(draws: int) -> None:
    """Print which part is found, by size and contrast."""
    found_by: dict[tuple[float, float], list[bool]] = defaultdict(list)
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(draws):
            things, found = draw(1000 + seed, Path(folder))
            shapes = truth_shapes(things, found.cells)
            hit = set().union(*[matches(c, shapes) for c in found.changes if c.confidence >= 0.5])
            for number, thing in enumerate(things):
                contrast = abs(float(np.log(np.mean(thing.colour) / 0.38)))
                size = min((s for s in (0.6, 1.2, 2.5, 9.0) if thing.width <= s), default=9.0)
                level = min(c for c in (0.2, 0.4, 9.0) if contrast <= c)
                found_by[size, level].append(number in hit)
    for (size, level), hits in sorted(found_by.items()):
        print(f"width <= {size:3g} m, contrast <= {level:3g}: {sum(hits)} of {len(hits)}")


def cost(side: int, folder: Path) -> None:
    """Print what two maps of some side cost; they are kept in the folder."""
    paths = [folder / f"map{number}_{side}.tif" for number in range(2)]
    if not all(path.exists() for path in paths):
        _large(paths, side)
    start = time.process_time()
    with gdal_cache(64):
        found = compared(*paths, 0.1)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    print(
        f"{side} x {side} px: {time.process_time() - start:.1f} s of CPU, {peak:.0f} MB, "
        f"{found.cells.header.width} x {found.cells.header.height} cells, "
        f"{len(found.changes)} regions"
    )


def _large(paths: list[Path], side: int) -> None:
    """Two large maps of one ground, tile by tile, in a child so that memory is not counted."""
    import multiprocessing

    child = multiprocessing.get_context("spawn").Process(target=_write_large, args=(paths, side))
    child.start()
    child.join()


def _write_large(paths: list[Path], side: int) -> None:
    import rasterio

    rng = np.random.default_rng(0)
    part = ground(rng, 1000 * FINE)
    coarse = rng.normal(1.0, 0.15, (side // 50 + 2, side // 50 + 2)).astype(np.float32)
    options: dict[str, Any] = {
        "driver": "GTiff", "width": side, "height": side, "count": 3, "dtype": "uint8",
        "crs": "EPSG:32617", "tiled": True, "blockxsize": 512, "blockysize": 512,
        "compress": "jpeg", "photometric": "ycbcr",
        "transform": rasterio.Affine(0.05, 0, 5e5, 0, -0.05, 44e5),
    }  # fmt: skip
    for number, path in enumerate(paths):
        with rasterio.open(path, "w", **options) as file:
            for row in range(0, side, 1024):
                for col in range(0, side, 1024):
                    height, width = min(1024, side - row), min(1024, side - col)
                    turned = np.rot90(part, ((row + 7 * col) // 1024) % 4)
                    tile = cv2.resize(turned, (1024, 1024))[:height, :width]
                    y, x = np.mgrid[row : row + height, col : col + width].astype(np.float32) / 50
                    tile = tile * cv2.remap(coarse, x, y, cv2.INTER_LINEAR)[..., None]
                    tile = tile * (1.0 - 0.1 * number) + rng.normal(0, 0.01, tile.shape)
                    if number and rng.random() < 0.3 and min(height, width) > 300:
                        tile[100:180, 100:200] = (0.8, 0.3, 0.1)
                    samples = np.round(np.clip(tile, 0, 1) * 255).astype(np.uint8)
                    file.write(
                        np.moveaxis(samples, 2, 0),
                        window=rasterio.windows.Window(col, row, width, height),
                    )


if __name__ == "__main__":
    if sys.argv[1] == "cost":
        cost(int(sys.argv[2]), Path(sys.argv[3]))
    else:
        {"calibration": calibration, "sizes": sizes}[sys.argv[1]](int(sys.argv[2]))
