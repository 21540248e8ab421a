"""Tiles of a mosaic from photos to the file: threads, the order of reading, what is kept."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import islice
from typing import TYPE_CHECKING, Any, Protocol

from georef_gis.toolbox import Feedback, check_cancelled

if TYPE_CHECKING:
    from georef_gis.model.plan import Plan, TileTask
    from georef_gis.mosaic.tile_maker import MadeTile
    from georef_gis.rasters.warp import ImageCache, Key
    from georef_gis.rasters.writer import TiledWriter

# tiles whose geometry is known before their photos are read
LOOKAHEAD = 256


class Sketch(Protocol):
    """A tile whose photos are known."""

    @property
    def task(self) -> TileTask:
        """The tile."""
        ...

    @property
    def keys(self) -> Sequence[Key]:
        """Photos to read for sure; others only fill what these leave open."""
        ...


class Maker(Protocol):
    """Makes tiles."""

    def sketch(self, task: TileTask) -> Any:
        """Geometry of a tile, a `Sketch`. Cheap, reads no photo."""
        ...

    def make(self, sketch: Any) -> MadeTile:
        """Make a sketched tile."""
        ...


class TileSink:
    """Takes tiles as they are made, and what an earlier run noted of those that it finished.

    Attributes
    ----------
    valid
        Pixels of the tiles taken.
    shifts
        How far photos lie apart, m, by the number of the place; of the earlier run's tiles too.
    """

    def __init__(self, writer: TiledWriter) -> None:
        self._writer = writer
        self.valid = 0
        self.shifts: dict[int, float | None] = {}
        for shifts in writer.notes.values():
            self.shifts.update(shifts)

    def take(self, task: TileTask, tile: MadeTile) -> None:
        """Write a tile. A run that goes on makes it again unless all its photos could be read."""
        self.shifts.update(tile.shifts)
        if tile.pixels is not None:
            data, mask = tile.pixels
            self._writer.write_tile(
                task.row, task.col, data, mask, note=tile.shifts or None,
                provisional=not tile.whole,
            )  # fmt: skip
            self.valid += data.shape[0] * data.shape[1] if mask is None else int(mask.sum())
        elif not tile.whole:
            self._writer.skip_tile(task.row, task.col, provisional=True)


def render_tiles(
    maker: Maker,
    plan: Plan,
    cache: ImageCache,
    sink: TileSink,
    workers: int,
    feedback: Feedback,
) -> None:
    """Render the tiles, a few ahead of the writer.

    The geometry of `LOOKAHEAD` tiles is known before their photos are read, so that the cache can
    tell which photo is needed last.
    """
    done = 0
    sketches: deque[tuple[int, Sketch]] = deque()
    numbered = enumerate(plan.tiles)
    ahead: deque[tuple[int, Sketch, Future[Any]]] = deque()
    with ThreadPoolExecutor(max_workers=workers) as pool:
        try:
            while True:
                for number, task in islice(numbered, LOOKAHEAD - len(sketches)):
                    sketch = maker.sketch(task)
                    cache.announce(number, sketch.keys)
                    sketches.append((number, sketch))
                while sketches and len(ahead) <= workers:
                    number, sketch = sketches.popleft()
                    ahead.append((number, sketch, pool.submit(maker.make, sketch)))
                if not ahead:
                    return
                number, sketch, job = ahead.popleft()
                tile = job.result()
                cache.finished(number, sketch.keys)
                sink.take(sketch.task, tile)
                done += 1
                feedback.progress(done / len(plan.tiles), f"tile {done} of {len(plan.tiles)}")
                check_cancelled(feedback)
        finally:
            for _, _, job in ahead:
                job.cancel()
