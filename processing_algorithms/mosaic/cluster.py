"""Tiles of a mosaic on a dask cluster: who makes which, what is under way, what is done."""

from __future__ import annotations

import logging
import pkgutil
import time
from collections import Counter, deque
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any
from uuid import uuid4

import georef_gis
from georef_gis.errors import InputError
from georef_gis.toolbox import Feedback, check_cancelled

if TYPE_CHECKING:
    from distributed import Client, Future

    from georef_gis.model.plan import Plan
    from georef_gis.mosaic.job import MosaicJob, PhotoRoot
    from georef_gis.mosaic.job_worker import RenderedTile
    from georef_gis.rasters.warp import ImageCache
    from processing_algorithms.mosaic.tiles import TileSink

# s; a scheduler answers within, and its first worker appears
REACHED = 10.0
# s; a cluster that lost its last worker may take so long to start another
WITHOUT_WORKERS = 60.0
# s between two looks at who works, and at whether the user wants to stop
LOOK, POLL = 1.0, 0.2
# tiles under way for each thread of a worker: one is made while the one before travels
UNDER_WAY = 2
# tiles that a worker knows of in advance, so that it keeps the right photos
AHEAD = 32
# times that a tile is tried again where it fails
RETRIES = 2
LOCAL = "local"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Cluster:
    """A cluster that answers, with workers that fit.

    Parameters
    ----------
    name
        As the user called it.
    folder
        Where jobs are put for workers to read.
    photos
        Where workers find the photos.
    """

    name: str
    client: Client
    folder: Path
    photos: PhotoRoot


@contextmanager
def reached(name: str, *, workers: int, folder: Path, photos: PhotoRoot) -> Iterator[Cluster]:
    """Cluster at an address, or of `workers` processes of this machine for `local`.

    Raises
    ------
    InputError
        If there is none, it has no workers, or one of another version.
    """
    try:
        import dask
        from distributed import Client
    except ImportError as error:
        raise InputError(
            "needs dask; pip install georef-gis[cluster]", source=name, field="cluster"
        ) from error
    with ExitStack() as open_:
        open_.enter_context(dask.config.set({"distributed.comm.timeouts.connect": REACHED}))
        open_.enter_context(_quiet())
        address: Any = name
        if name.partition(":")[0] == LOCAL:
            address = open_.enter_context(_local(name, workers))
        elif "://" not in name:
            raise _refused(
                name, "is no cluster; give tcp://HOST:PORT of a dask scheduler, local or local:N"
            )
        try:
            client = open_.enter_context(Client(address, timeout=REACHED, set_as_default=False))
            client.wait_for_workers(1, timeout=REACHED)
        except (OSError, ValueError) as error:
            raise _refused(
                name,
                f"no cluster with a worker answers within {REACHED:.0f} s; start `dask scheduler` "
                f"there and `dask worker {name}` on each machine",
            ) from error
        _check_versions(client, name)
        yield Cluster(name=name, client=client, folder=folder, photos=photos)


def _refused(name: str, message: str) -> InputError:
    return InputError(message, source=name, field="cluster")


def _lost(name: str) -> InputError:
    return _refused(name, "the connection is lost; start the cluster again and repeat the run")


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep dask's own messages on workers that come and go from the user."""
    # each has a level of its own
    names = [name for name in logging.root.manager.loggerDict if name.startswith("distributed")]
    before = {name: logging.getLogger(name).level for name in names}
    for name in names:
        logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for name, level in before.items():
            logging.getLogger(name).setLevel(level)


@contextmanager
def _local(name: str, workers: int) -> Iterator[Any]:
    """Cluster of processes of this machine."""
    from distributed import LocalCluster

    given = name.partition(":")[2]
    if given and not (given.isdecimal() and int(given) > 0):
        raise _refused(name, f"{given!r} is no number of processes; give for example local:2")
    with LocalCluster(
        n_workers=int(given or workers), threads_per_worker=1, dashboard_address="127.0.0.1:0",
        silence_logs=logging.CRITICAL,
    ) as cluster:  # fmt: skip
        yield cluster


def _check_versions(client: Client, name: str) -> None:
    """Refuse workers of another version before any of our code runs there."""
    own = georef_gis.__version__
    found = client.run(pkgutil.resolve_name, "georef_gis:__version__", on_error="return")
    for worker, theirs in found.items():
        if isinstance(theirs, ImportError):
            raise _refused(name, f"worker {worker} has no georef_gis; install {own} there")
        if theirs != own:
            raise _refused(
                name, f"worker {worker} has georef_gis {theirs}, not {own}; install {own} there"
            )


def render_on_cluster(
    cluster: Cluster,
    job: MosaicJob,
    plan: Plan,
    cache: ImageCache,
    sink: TileSink,
    feedback: Feedback,
    broken: list[str],
) -> None:
    """Render the tiles by workers, to the pixels of `render_tiles`.

    This process writes them as they come. A tile whose worker dies is made by another.

    Parameters
    ----------
    cache
        Gains the number of photos that workers decoded.
    broken
        Takes the messages of photos that workers could not read.

    Raises
    ------
    InputError
        If workers do not see the job or the photos, or all of them are gone.
    """
    from concurrent.futures import CancelledError

    from distributed import KilledWorker
    from distributed.comm.core import CommClosedError

    from georef_gis.mosaic.job_worker import prepare_worker, write_job

    path = cluster.folder / f"job-{uuid4().hex}"
    write_job(path, job, plan.tiles, cluster.photos)
    try:
        # one that dies over it is replaced, and its successor opens the job with its first tile
        opened = cluster.client.run(prepare_worker, path, on_error="return")
        for worker, refusal in opened.items():
            if isinstance(refusal, InputError):
                raise _refused(cluster.name, f"{worker}: {refusal}")
        _Run(cluster, path, plan, sink, feedback).all(cache, broken)
    except KilledWorker as error:
        raise _refused(
            cluster.name,
            "a tile cost several workers their lives; give each more memory, or see their logs",
        ) from error
    except (CommClosedError, CancelledError) as error:
        raise _lost(cluster.name) from error
    finally:
        path.unlink(missing_ok=True)


class Shares:
    """Numbers of the tiles that are still to be given out: a run of neighbours to each worker.

    Neighbours share photos. Who has none left takes the far half of the longest run.
    """

    def __init__(self, numbers: Iterable[int]) -> None:
        self._runs: dict[str, deque[int]] = {"": deque(numbers)}

    @property
    def left(self) -> int:
        """Tiles not given out yet."""
        return sum(map(len, self._runs.values()))

    def next(self, worker: str) -> tuple[int, tuple[int, ...]] | None:
        """Tile for a worker, and what it will as a rule get after it; None = nothing is left."""
        own = self._runs.setdefault(worker, deque())
        if not own:
            longest = max(self._runs, key=lambda name: len(self._runs[name]))
            run = self._runs[longest]
            # a run that nobody has goes as a whole
            count = len(run) if longest == "" else (len(run) + 1) // 2
            for _ in range(count):
                own.appendleft(run.pop())
        if not own:
            return None
        number = own.popleft()
        return number, tuple(own[k] for k in range(min(AHEAD, len(own))))

    def keep(self, workers: Iterable[str]) -> None:
        """Take back the runs of workers that are gone."""
        for name in set(self._runs) - {"", *workers}:
            self._runs[""].extend(self._runs.pop(name))


class _Run:
    """Tiles of one job under way on a cluster."""

    def __init__(
        self, cluster: Cluster, path: Path, plan: Plan, sink: TileSink, feedback: Feedback
    ) -> None:
        self._cluster, self._client, self._path = cluster, cluster.client, path
        self._plan, self._sink, self._feedback = plan, sink, feedback
        self._shares = Shares(range(len(plan.tiles)))
        self._under_way: dict[Future[RenderedTile], str] = {}
        self._finished: SimpleQueue[Future[RenderedTile]] = SimpleQueue()
        self._threads: Mapping[str, int] = {}
        self._looked = self._working = time.monotonic()

    def all(self, cache: ImageCache, broken: list[str]) -> None:
        """Make all tiles."""
        total = len(self._plan.tiles)
        decodes: dict[str, int] = {}
        try:
            self._look()
            while self._give_out() or self._under_way:
                for tile in self._come_back():
                    self._sink.take(self._plan.tiles[tile.number], tile)
                    broken += [message for message in tile.broken if message not in broken]
                    decodes[tile.worker] = max(tile.decodes, decodes.get(tile.worker, 0))
                done = total - self._shares.left - len(self._under_way)
                self._feedback.progress(done / total, f"tile {done} of {total}")
                check_cancelled(self._feedback)
        finally:
            if self._under_way:
                self._client.cancel(list(self._under_way), force=True)
        cache.decodes += sum(decodes.values())

    def _look(self) -> None:
        """See who works; workers come and go."""
        self._looked = time.monotonic()
        try:
            self._threads = dict(self._client.nthreads())
        except OSError as error:
            raise _lost(self._cluster.name) from error
        self._shares.keep(self._threads)
        if self._threads:
            self._working = self._looked
        elif self._looked - self._working > WITHOUT_WORKERS:
            raise _refused(
                self._cluster.name,
                f"has had no worker for {WITHOUT_WORKERS:.0f} s; start some and repeat the run",
            )

    def _give_out(self) -> bool:
        """Keep all threads busy; whether there are tiles left."""
        from georef_gis.mosaic.job_worker import tile_of

        if time.monotonic() - self._looked > LOOK:
            self._look()
        busy = Counter(self._under_way.values())
        free = {
            worker: UNDER_WAY * threads - busy[worker] for worker, threads in self._threads.items()
        }
        for turn in range(max(free.values(), default=0)):
            for worker in [name for name, count in free.items() if count > turn]:
                found = self._shares.next(worker)
                if found is None:
                    return False
                future = self._client.submit(
                    tile_of, self._path, *found, workers=[worker], allow_other_workers=True,
                    pure=False, retries=RETRIES,
                )  # fmt: skip
                self._under_way[future] = worker
                future.add_done_callback(self._finished.put)
        return self._shares.left > 0

    def _come_back(self) -> list[RenderedTile]:
        """Tiles that are ready, after a short wait for the first."""
        ready: list[Future[RenderedTile]] = []
        try:
            ready.append(self._finished.get(timeout=POLL))
            while True:
                ready.append(self._finished.get_nowait())
        except Empty:
            pass
        tiles = self._client.gather(ready)
        for future in ready:
            del self._under_way[future]
        return list(tiles)
