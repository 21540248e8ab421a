"""Tiles of a mosaic from photos to the file: threads, the order of reading, what is done."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import islice
from typing import TYPE_CHECKING, Any, Protocol

from georef_gis.toolbox import Feedback, check_cancelled

if TYPE_CHECKING:
    from georef_gis.model.plan import Plan, TileTask
    from georef_gis.rasters.warp import Image, ImageCache, Key, Mask
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


class Renderer(Protocol):
    """Makes tiles."""

    def sketch(self, task: TileTask) -> Any:
        """Geometry of a tile, a `Sketch`. Cheap, reads no photo."""
        ...

    def render(self, sketch: Any) -> tuple[Image, Mask | None] | None:
        """Pixels (rows, cols, bands) and mask of a sketched tile; None where no photo shows it."""
        ...


def render_tiles(
    mosaic: Renderer,
    plan: Plan,
    cache: ImageCache,
    writer: TiledWriter,
    workers: int,
    feedback: Feedback,
) -> int:
    """Render the tiles, a few ahead of the writer; number of valid pixels.

    The geometry of `LOOKAHEAD` tiles is known before their photos are read, so that the cache can
    tell which photo is needed last.
    """
    valid = done = 0
    sketches: deque[tuple[int, Sketch]] = deque()
    numbered = enumerate(plan.tiles)
    ahead: deque[tuple[int, Sketch, Future[Any]]] = deque()
    with ThreadPoolExecutor(max_workers=workers) as pool:
        try:
            while True:
                for number, task in islice(numbered, LOOKAHEAD - len(sketches)):
                    sketch = mosaic.sketch(task)
                    cache.announce(number, sketch.keys)
                    sketches.append((number, sketch))
                while sketches and len(ahead) <= workers:
                    number, sketch = sketches.popleft()
                    ahead.append((number, sketch, pool.submit(mosaic.render, sketch)))
                if not ahead:
                    return valid
                number, sketch, job = ahead.popleft()
                tile = job.result()
                cache.finished(number, sketch.keys)
                if tile is not None:
                    data, mask = tile
                    writer.write_tile(sketch.task.row, sketch.task.col, data, mask)
                    valid += data.shape[0] * data.shape[1] if mask is None else int(mask.sum())
                done += 1
                feedback.progress(done / len(plan.tiles), f"tile {done} of {len(plan.tiles)}")
                check_cancelled(feedback)
        finally:
            for _, _, job in ahead:
                job.cancel()
