"""The mosaic on a real cluster of two processes: same pixels, whatever happens to a worker."""

from __future__ import annotations

import os
import shutil
import signal
import socket
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result
from test_mosaic_tool import STEPS, make

from georef_gis.app import cli
from georef_gis.errors import Cancelled, InputError
from georef_gis.mosaic.job import PhotoRoot
from georef_gis.project import Project
from georef_gis.rasters.writer import TiledWriter
from georef_gis.toolbox.context import CollectingFeedback, Context
from processing_algorithms.mosaic import cluster as cluster_module
from processing_algorithms.mosaic.cluster import Shares, reached
from processing_algorithms.mosaic.mosaic import MosaicTool
from processing_algorithms.mosaic.parameters import MosaicParameters

distributed = pytest.importorskip("distributed")

Tiles = dict[tuple[int, int], tuple[bytes, bytes]]
NO_PHOTOS = PhotoRoot(here=Path("photos"))


def flight(folder: Path) -> Path:
    """Six photos, 28 tiles; the proxies of their seams are there."""
    folder = make(folder, 6, gsd=0.06)
    words = ["run", str(folder), "--only", STEPS]
    assert CliRunner().invoke(cli.georef, words).exit_code == 0
    assert mosaic(folder, "--seams", "nearest").exit_code == 0
    return folder


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Project whose photos stay as they are."""
    return flight(tmp_path_factory.mktemp("cluster") / "site")


@pytest.fixture
def own(tmp_path: Path) -> Path:
    """Project whose photos a test may damage."""
    return flight(tmp_path / "own")


@pytest.fixture(scope="module")
def workers() -> Iterator[Any]:
    """Two processes that come back when they are killed."""
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address="127.0.0.1:0", silence_logs=50
    ) as started:
        yield started


def mosaic(folder: Path, *words: str) -> Result:
    words = ("mosaic", "--project", str(folder), "--force", *words)
    return CliRunner().invoke(cli.georef, words)


class _Killer(dict[Any, Any]):
    """Tiles; with the fifth a process dies at once, without a word."""

    def __init__(self, pid: int) -> None:
        super().__init__()
        self.pid = pid

    def __setitem__(self, key: Any, value: Any) -> None:
        super().__setitem__(key, value)
        if len(self) == 5:
            os.kill(self.pid, signal.SIGKILL)


@pytest.mark.slow
@pytest.mark.parametrize("seams", ["nearest", "none"])
def test_a_killed_worker_changes_no_pixel(
    site: Path, workers: Any, seams: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    pid = next(nanny.pid for nanny in workers.workers.values() if nanny.pid)
    local: Tiles = {}
    many: Tiles = _Killer(pid)
    write = TiledWriter.write_tile
    for tiles, words in ((local, ()), (many, ("--cluster", workers.scheduler_address))):

        def kept(
            self: Any,
            row: int,
            col: int,
            data: Any,
            mask: Any,
            *,
            tiles: Tiles = tiles,
            **more: Any,
        ) -> None:
            tiles[row, col] = data.tobytes(), b"" if mask is None else np.packbits(mask).tobytes()
            write(self, row, col, data, mask, **more)

        monkeypatch.setattr(TiledWriter, "write_tile", kept)
        done = mosaic(site, "--seams", seams, *words)
        assert done.exit_code == 0, done.output
        assert "doubt" not in done.output
    assert len(local) >= 20
    assert many == local
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)
    assert not list((site / "cache" / "mosaic").glob("job-*"))


@pytest.mark.slow
@pytest.mark.parametrize("seams", ["nearest", "none"])
def test_a_photo_broken_after_the_preparation_leaves_its_place_as_it_does_locally(
    own: Path, workers: Any, seams: str
) -> None:
    path = own / "photos" / "P002.jpg"
    raw = path.read_bytes()
    path.write_bytes(raw[: raw.index(b"\xff\xda") + 40])
    results = []
    for words in ((), ("--cluster", workers.scheduler_address)):
        done = mosaic(own, "--seams", seams, *words)
        assert done.exit_code == 0, done.output
        doubts = [x for x in done.output.splitlines() if "P002.jpg" in x]
        assert len(doubts) == 1
        assert "truncated" in doubts[0]
        results.append((doubts, (own / "products" / "mosaic.tif").read_bytes()))
    assert results[0] == results[1]


@pytest.mark.slow
def test_tiles_that_workers_made_without_a_photo_are_made_again(
    own: Path, workers: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    product, path = own / "products" / "mosaic.tif", own / "photos" / "P002.jpg"
    assert mosaic(own, "--seams", "nearest").exit_code == 0
    before, raw = product.read_bytes(), path.read_bytes()
    product.unlink()
    path.write_bytes(raw[: raw.index(b"\xff\xda") + 40])

    def stop(self: TiledWriter) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(TiledWriter, "_finish_rest", stop)
        done = mosaic(own, "--seams", "nearest", "--cluster", workers.scheduler_address)
        assert done.exit_code == 130, done.output
    path.write_bytes(raw)
    done = mosaic(own, "--seams", "nearest")
    assert "made without all their photos" in done.output
    assert product.read_bytes() == before


@pytest.mark.slow
def test_photos_may_lie_elsewhere_for_the_workers(own: Path, tmp_path: Path, workers: Any) -> None:
    assert mosaic(own, "--seams", "none").exit_code == 0
    product = own / "products" / "mosaic.tif"
    before = product.read_bytes()
    (tmp_path / "shared").mkdir()
    for path in (own / "photos").iterdir():
        shutil.copy(path, tmp_path / "shared")
    for root in (str(tmp_path / "shared"), f"file://{tmp_path}/shared"):
        product.unlink()
        words = ("--cluster", workers.scheduler_address, "--photos-root", root)
        assert mosaic(own, "--seams", "none", *words).exit_code == 0
        assert product.read_bytes() == before
    words = ("--cluster", workers.scheduler_address, "--photos-root", str(tmp_path / "gone"))
    done = mosaic(own, "--seams", "none", *words)
    assert done.exit_code == 2
    assert "does not see the photos' folder" in done.output


@pytest.mark.slow
def test_cancelling_leaves_the_cluster_idle(site: Path, workers: Any) -> None:
    project = Project.open(site)
    feedback = CollectingFeedback(stop_at=0.3)
    parameters = MosaicParameters(seams="none", cluster=workers.scheduler_address)
    with pytest.raises(Cancelled):
        MosaicTool().run(Context(project=project, workers=2), parameters, feedback)
    assert feedback.fractions[-1] < 0.6
    with distributed.Client(workers.scheduler_address, set_as_default=False) as client:
        assert not client.run_on_scheduler(lambda dask_scheduler: list(dask_scheduler.tasks))


@pytest.mark.slow
def test_processes_of_this_machine_make_the_same_file(site: Path) -> None:
    product = site / "products" / "mosaic.tif"
    assert mosaic(site, "--seams", "nearest").exit_code == 0
    before = product.read_bytes()
    product.unlink()
    done = mosaic(site, "--seams", "nearest", "--cluster", "local:2")
    assert done.exit_code == 0, done.output
    assert product.read_bytes() == before


@pytest.mark.slow
def test_workers_of_another_version_are_refused(
    workers: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    address = workers.scheduler_address
    monkeypatch.setattr("georef_gis.__version__", "9.9.9")
    with (
        pytest.raises(InputError, match=r"worker tcp.* has georef_gis .*, not 9\.9\.9; install"),
        reached(address, workers=1, folder=tmp_path, photos=NO_PHOTOS),
    ):
        pass


@pytest.mark.slow
def test_no_cluster_at_an_address_is_told_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cluster_module, "REACHED", 1.0)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
    with (
        pytest.raises(InputError, match=r"no cluster with a worker answers within 1 s; start") as e,
        reached(address, workers=1, folder=tmp_path, photos=NO_PHOTOS),
    ):
        pass
    assert "\n" not in str(e.value)


@pytest.mark.parametrize("name", ["local:none", "local:0", "here", "10.0.0.1:8786"])
def test_what_is_no_cluster_is_refused(tmp_path: Path, name: str) -> None:
    with (
        pytest.raises(InputError, match=r"cluster: .*; give "),
        reached(name, workers=1, folder=tmp_path, photos=NO_PHOTOS),
    ):
        pass


def test_without_dask_the_package_to_install_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "dask", None)
    with (
        pytest.raises(InputError, match=r"cluster: needs dask; pip install georef-gis\[cluster\]"),
        reached("local", workers=1, folder=tmp_path, photos=NO_PHOTOS),
    ):
        pass


def test_each_worker_gets_a_run_of_neighbours_and_helps_when_it_has_none_left() -> None:
    shares = Shares(range(100))
    first = [shares.next(name) for name in ("a", "b", "c")]
    assert [found[0] for found in first if found] == [0, 50, 25]
    assert first[0] == (0, tuple(range(1, 33)))
    order = []
    while (found := shares.next("c")) is not None:
        order.append(found[0])
    assert order[:24] == list(range(26, 50))
    assert sorted([0, 50, 25, *order]) == list(range(100))


def test_tiles_of_a_worker_that_is_gone_are_given_out_again() -> None:
    shares = Shares(range(10))
    assert shares.next("a") is not None
    shares.keep(["b"])
    assert shares.left == 9
    order = [found[0] for _ in range(9) if (found := shares.next("b"))]
    assert order == list(range(1, 10))
    assert shares.next("b") is None
