"""A raster written in pieces, and a process whose children are killed while they write it."""

from __future__ import annotations

import os
import random
import signal
import sys
import time
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np
from raster_cases import ellipse, make_profile, smooth

from georef_gis.rasters.profile import RasterProfile
from georef_gis.rasters.writer import TiledWriter

ROWS, COLS, SIZE = 1000, 900, 64
KEY = "photos-7"
_KILLS = 15
Tile = tuple[int, int, np.ndarray, np.ndarray]


@cache
def picture() -> tuple[np.ndarray, np.ndarray]:
    """Noise on waves, so that a wrong tile shows; corners without data, one band of tiles too."""
    data, mask = smooth(ROWS, COLS, 3), ellipse(ROWS, COLS)
    noise = np.random.default_rng(3).integers(0, 40, data.shape, np.uint8)
    mask[5 * SIZE : 6 * SIZE, : 9 * SIZE] = False
    return data // 2 + noise, mask


def profile_of(data: np.ndarray, **changes: object) -> RasterProfile:
    return make_profile(data, **{"compression": "jpeg", "tile_size": SIZE, **changes})


def tiles(order: int) -> Iterator[Tile]:
    """Tiles in an order of their own for each seed, by quarters for 0; some never come."""
    data, mask = picture()
    rows, cols = -(-ROWS // SIZE), -(-COLS // SIZE)
    places = [(row, col) for row in range(rows) for col in range(cols)]
    if order:
        mixed = np.random.default_rng(order).permutation(len(places))
        places = [places[index] for index in mixed]
    else:
        places.sort(key=lambda at: [(at[0] >> k & 1, at[1] >> k & 1) for k in (3, 2, 1, 0)])
    for row, col in places:
        if row < 13 or col > 2:
            at = np.s_[row * SIZE : (row + 1) * SIZE, col * SIZE : (col + 1) * SIZE]
            yield row, col, data[at], mask[at]


def open_writer(target: Path, work: Path, *, key: str = KEY, **options: object) -> TiledWriter:
    profile = profile_of(picture()[0])
    return TiledWriter(target, profile, resume=key, work=work, **options)  # type: ignore[arg-type]


def write_rest(writer: TiledWriter, order: int = 1, most: int | None = None) -> int:
    """Write what is not done, at most some tiles; how many were written."""
    written = 0
    for row, col, data, mask in tiles(order):
        if not writer.done[row, col] and (most is None or written < most):
            writer.write_tile(row, col, data, mask)
            written += 1
    return written


def interrupted(target: Path, work: Path, most: int, *, order: int = 1, workers: int = 1) -> None:
    """A run that is stopped after some tiles."""
    writer = open_writer(target, work, workers=workers)
    write_rest(writer, order, most)
    writer.abort()


def _run(target: Path, work: Path, order: int, workers: int, report: int) -> None:
    """Write what is not done; one byte to the pipe a tile."""
    with open_writer(target, work, workers=workers) as writer:
        os.write(1, f"{int(writer.done.sum())} {writer.resumption.note}\n".encode())
        for row, col, data, mask in tiles(order):
            if not writer.done[row, col]:
                os.write(report, b".")
                writer.write_tile(row, col, data, mask)
        os.write(report, b"." * 1000)


def main() -> None:
    """Target, work folder, workers: run after run, killed at moments of a fixed seed, to the end.

    Prints how many tiles each run found done, and what it was told about them.
    """
    target, work, workers = Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3])
    moments = random.Random(workers)
    picture()
    for order in range(99):
        ours, report = os.pipe()
        child = os.fork()
        if child == 0:
            _run(target, work, order, workers, report)
            os._exit(0)
        os.close(report)
        if order < _KILLS:
            # the last ones after all tiles were written
            wanted = moments.randint(1, 25) if order < _KILLS - 3 else 500
            while wanted > 0 and (came := os.read(ours, wanted)):
                wanted -= len(came)
            time.sleep(moments.uniform(0.0, 0.003))
            os.kill(child, signal.SIGKILL)
        ended = os.waitpid(child, 0)[1] == 0
        os.close(ours)
        # a kill may come when the file is in its place and the journal gone: nothing is left to do
        ended = ended or (target.exists() and not any(work.glob("*journal*")))
        if ended:
            return


if __name__ == "__main__":
    main()
