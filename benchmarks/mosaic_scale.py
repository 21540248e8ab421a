"""Does a photo of a large mosaic cost more than one of a small? CPU and memory by number of photos.

    python benchmarks/mosaic_scale.py PICTURE [--photos 18 167 1000] [--workers 1] [--runs 1]

Simulates flights over a flat site of any size: PICTURE, reflected at its borders, is the ground;
each photo is a window of it (60 % forward and 40 % side overlap, every second line turned by 180
degrees) with a gain, vignetting and noise of its own and a position that is wrong by a pixel. The
poses come from a pose file, so that nothing but the mosaic step is large: only that is measured,
with seams, colour and blend, in a process of its own.
"""

from __future__ import annotations

import argparse
import json
import math
import shutil
import sqlite3
import statistics
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from process_cost import Cost, apart, cost_of

WIDTH, HEIGHT = 2400, 1800
FOCAL_PX = 2000.0
GSD = 0.05
FORWARD, SIDE = 0.6, 0.4
# UTM on its central meridian, where grid north is north; scale of its lengths there
EPSG, EASTING, NORTHING, SCALE = 32615, 500_000.0, 5_180_000.0, 0.9996
SETTINGS = """
[project]
crs = "EPSG:{epsg}"
[photos]
folder = "photos"
[camera]
focal_px = {focal}
[gnss]
height_kind = "ellipsoidal"
[ground]
height_m = 0.0
height_kind = "ellipsoidal"
sigma_m = 0.01
[poses]
file = "geo.txt"
format = "odm"
[products]
orthos = false
"""


def reflected(start: int, count: int, length: int) -> NDArray[np.int64]:
    """Indices of a picture of `length` that goes on for ever, mirrored at its ends."""
    k = np.arange(start, start + count) % (2 * length)
    return np.where(k < length, k, 2 * length - 1 - k)


def grid_of(count: int) -> tuple[int, int]:
    """Lines of a flight, and photos of a line, of a site that is about square."""
    forward, side = HEIGHT * (1 - FORWARD), WIDTH * (1 - SIDE)
    lines = max(1, round(math.sqrt(count * forward / side)))
    return lines, math.ceil(count / lines)


def centres(count: int) -> Iterator[tuple[int, int, bool]]:
    """Column and row of the ground's picture under each camera, and whether it flies south."""
    _, each = grid_of(count)
    for k in range(count):
        line, place = divmod(k, each)
        yield (
            WIDTH + round(line * WIDTH * (1 - SIDE)),
            HEIGHT + round(place * HEIGHT * (1 - FORWARD)),
            bool(line % 2),
        )


def write_photos(folder: Path, picture: Path, count: int) -> None:
    """The photos, the pose file and project.toml of a flight."""
    ground = cv2.imread(str(picture))
    rng = np.random.default_rng(0)
    (folder / "photos").mkdir()
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(np.float32)
    squared = ((x - WIDTH / 2) ** 2 + (y - HEIGHT / 2) ** 2) / (WIDTH**2 + HEIGHT**2) * 4
    darker = (1 - 0.15 * squared)[:, :, None]
    noise = rng.normal(0, 2, (HEIGHT + 64, WIDTH + 64, 1)).astype(np.float32)
    rows = [f"EPSG:{EPSG}"]
    for k, (col, row, south) in enumerate(centres(count)):
        # a photo lies where the pose file says to a pixel only
        off_col, off_row = rng.integers(-1, 2, 2)
        take_row = reflected(row + off_row - HEIGHT // 2, HEIGHT, ground.shape[0])
        take_col = reflected(col + off_col - WIDTH // 2, WIDTH, ground.shape[1])
        a, b = rng.integers(0, 64, 2)
        pixels = ground[take_row][:, take_col] * (rng.uniform(0.9, 1.1) * darker)
        pixels += noise[a : a + HEIGHT, b : b + WIDTH]
        image = np.clip(pixels, 0, 255).astype(np.uint8)
        name = f"photo_{k:05d}.jpg"
        target = str(folder / "photos" / name)
        turned = image[::-1, ::-1] if south else image
        cv2.imwrite(target, turned, [cv2.IMWRITE_JPEG_QUALITY, 92])
        east = EASTING + col * GSD * SCALE
        north = NORTHING - row * GSD * SCALE
        height = FOCAL_PX * GSD
        yaw = 180 if south else 0
        rows.append(f"{name} {east:.4f} {north:.4f} {height:.3f} {yaw} 0 0 0.02 0.02")
    (folder / "geo.txt").write_text("\n".join(rows) + "\n")
    (folder / "project.toml").write_text(SETTINGS.format(epsg=EPSG, focal=FOCAL_PX))


def prepare(georef: list[str], folder: Path) -> None:
    """Read, orient and outline the photos: all before the mosaic."""
    for tool in ("read-photos", "orient-direct", "footprints"):
        cost = cost_of([*georef, tool, "--project", str(folder)])
        if cost.failure:
            raise SystemExit(f"georef {tool}: {cost.output[-2000:]}")


def measured(georef: list[str], folder: Path, workers: int) -> tuple[Cost, dict[str, object]]:
    """The mosaic made from nothing, and the summary of its run."""
    shutil.rmtree(folder / "cache", ignore_errors=True)
    (folder / "seams.gpkg").unlink(missing_ok=True)
    command = [*georef, "mosaic", "--force", "--seams", "optimised", "--project", str(folder)]
    cost = cost_of([*command, "--workers", str(workers)])
    if cost.failure:
        raise SystemExit(f"georef mosaic: {cost.output[-2000:]}")
    with sqlite3.connect(folder / "georef.gpkg") as db:
        last = db.execute(
            "SELECT summary FROM run WHERE tool LIKE '%mosaic' ORDER BY fid"
        ).fetchall()
    return cost, json.loads(last[-1][0])


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("picture", type=Path, help="picture of the ground, larger than 10 MP best")
    parser.add_argument("--photos", type=int, nargs="+", default=[18, 167, 1000])
    parser.add_argument("--workers", type=int, nargs="+", default=[1])
    parser.add_argument("--runs", type=int, default=1)
    parser.add_argument("--work", type=Path, help="folder for the photos; about 2 MB each")
    args = parser.parse_args()
    georef = [sys.executable, "-m", "georef_gis.app"]
    print("| photos | workers | mosaic MP | CPU s | CPU s a photo | CPU s per MP | wall s | "
          "peak MB | decodes a photo | colour step, median | load |")  # fmt: skip
    print("|---|---|---|---|---|---|---|---|---|---|---|")
    for count in args.photos:
        with tempfile.TemporaryDirectory(dir=args.work) as temp:
            folder = Path(temp)
            apart(write_photos, folder, args.picture, count)
            prepare(georef, folder)
            runs = [
                (workers, *measured(georef, folder, workers))
                for _ in range(args.runs)
                for workers in args.workers
            ]
            for workers in args.workers:
                print(row(count, workers, [r[1:] for r in runs if r[0] == workers]), flush=True)


def row(count: int, workers: int, runs: list[tuple[Cost, dict[str, object]]]) -> str:
    """Line of the table: medians over the runs, the largest memory."""
    cpu = statistics.median(r[0].cpu for r in runs)
    summary = runs[0][1]
    megapixels = summary["covered_m2"] / summary["gsd_m"] ** 2 / 1e6
    steps = summary["colour_step"]
    return (
        f"| {count} | {workers} | {megapixels:.0f} | {cpu:.1f} | {cpu / count:.3f} | "
        f"{cpu / megapixels:.4f} | {statistics.median(r[0].wall for r in runs):.1f} | "
        f"{max(r[0].peak for r in runs):.0f} | {summary['decodes_per_photo']} | "
        f"{steps['between_photos']['median']:.2f} | "
        f"{min(r[0].load for r in runs):.1f} to {max(r[0].load for r in runs):.1f} |"
    )


if __name__ == "__main__":
    main()
