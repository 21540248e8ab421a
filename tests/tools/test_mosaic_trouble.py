"""The mosaic along seams when it is killed, cancelled or out of space."""

from __future__ import annotations

import errno
import io
import os
import shutil
import signal
from collections import namedtuple
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from mosaic_flights import ROW, Flight, copied, make

from georef_gis.errors import Cancelled
from georef_gis.mosaic import prepare
from georef_gis.mosaic.proxies import ProxyStore
from georef_gis.project import Project
from georef_gis.rasters import files, quarters, spool
from georef_gis.rasters.writer import TiledWriter
from georef_gis.toolbox.registry import load_registry
from georef_gis.toolbox.runner import run_tool
from georef_gis.toolbox.steps import RunOptions
from processing_algorithms.mosaic import ready, seam_file

pytestmark = pytest.mark.slow

# m, and the tiles that it makes
FINE, TILES = 0.1, 10


@pytest.fixture(scope="module")
def fine(tmp_path_factory: pytest.TempPathFactory) -> Flight:
    """A mosaic of some tiles that is still to be made."""
    return make(tmp_path_factory.mktemp("fine") / "site", products={"gsd_m": FINE})


@pytest.fixture(scope="module")
def whole(fine: Flight, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The same, made without interruption."""
    flight = copied(fine, tmp_path_factory.mktemp("whole") / "site")
    flight.made()
    assert flight.summary()["tiles"] == TILES
    return flight.path.read_bytes()


@pytest.fixture
def flight(fine: Flight, tmp_path: Path) -> Flight:
    return copied(fine, tmp_path / "site")


# -- killed, cancelled, full ---------------------------------------------------------------------


def after(count: int, real: Callable[..., Any], act: Callable[[], None]) -> Callable[..., Any]:
    """A function that acts once it has been called so often."""
    calls = 0

    def wrapped(*args: Any, **options: Any) -> Any:
        nonlocal calls
        out = real(*args, **options)
        calls += 1
        if calls == count:
            act()
        return out

    return wrapped


def die() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


# what is done when it is killed: owner, function, calls, whether tiles are finished
MOMENTS = {
    "proxies": (ProxyStore, "make", 2, 0),
    "seams": (seam_file, "project_seams", 1, 0),
    "first tile": (TiledWriter, "write_tile", 1, 1),
    "last tile but one": (TiledWriter, "write_tile", TILES - 1, TILES - 1),
    "end": (TiledWriter, "_finish_rest", 1, TILES),
}


@pytest.mark.parametrize(("owner", "name", "count", "kept"), MOMENTS.values(), ids=MOMENTS)
def test_a_killed_mosaic_goes_on_to_the_same_bytes(
    flight: Flight, whole: bytes, owner: Any, name: str, count: int, kept: int
) -> None:
    pid = os.fork()
    if pid == 0:
        try:
            setattr(owner, name, after(count, getattr(owner, name), die))
            flight.run("--workers", "1")
        finally:
            os._exit(7)
    _, status = os.waitpid(pid, 0)
    assert os.WIFSIGNALED(status), f"{name} was not reached"
    assert not flight.path.exists()
    done = flight.made()
    assert ("finished by an earlier run" in done.text) == (kept > 0)
    if kept:
        assert done.line("finished by an earlier run").split()[0] == str(kept)
    assert flight.path.read_bytes() == whole
    assert {p.name for p in flight.path.parent.iterdir()} == {"mosaic.tif", "overlap.tif"}
    assert not any((flight.folder / "cache" / "mosaic" / "tiles").iterdir())
    assert "1 of 1 steps were unchanged" in flight.made().text


# what is done when it is stopped: owner, function, calls
LATE = {"sixth tile": (TiledWriter, "write_tile", 6), "end": (TiledWriter, "_finish_rest", 1)}


def stopped_without(flight: Flight, photo: Path, moment: tuple[Any, str, int]) -> None:
    """Make the mosaic up to a moment; a photo is lost as long as its tiles are made."""
    owner, name, count = moment
    away = photo.with_suffix(".away")
    make_ready = ready.made_ready

    def made_ready(*args: Any) -> Any:
        out = make_ready(*args)
        photo.rename(away)
        return out

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(ready, "made_ready", made_ready)
        patched.setattr(owner, name, after(count, getattr(owner, name), stop))
        assert flight.run("--workers", "1").code == 130
    away.rename(photo)


@pytest.fixture
def own(tmp_path: Path) -> Flight:
    """A mosaic still to be made, of photos of its own: those of a copy are the first project's."""
    return make(tmp_path / "own", products={"gsd_m": FINE})


@pytest.mark.parametrize("moment", LATE.values(), ids=LATE)
@pytest.mark.parametrize("seams", ["optimised", "none"])
def test_tiles_made_while_a_photo_was_away_are_made_again(
    own: Flight, seams: str, moment: tuple[Any, str, int]
) -> None:
    """A share that was away for a moment: what the last of four photos in a row shows with others
    is not theirs for ever, what it shows alone not empty."""
    own.wish(seams=seams)
    whole = copied(own, own.folder.parent / "whole")
    whole.made()
    stopped_without(own, own.photo(3), moment)
    done = own.made()
    assert "made again" in done.line("without all their photos")
    assert "doubt" not in done.text
    assert own.path.read_bytes() == whole.path.read_bytes()


@pytest.mark.parametrize("seams", ["optimised", "none"])
def test_a_photo_that_stays_lost_is_named_by_the_run_that_goes_on_too(
    own: Flight, seams: str
) -> None:
    own.wish(seams=seams)
    own.made()
    own.path.unlink()
    photo = own.photo(1)
    stopped_without(own, photo, LATE["end"])
    photo.write_bytes(b"nothing")
    done = own.made()
    assert done.line("doubt", "P001.tif")


def test_tiles_that_a_lost_photo_does_not_touch_are_kept(own: Flight) -> None:
    """The last of four photos in a row; an overview of four tiles goes with one of them."""
    stopped_without(own, own.photo(3), LATE["sixth tile"])
    done = own.made()
    assert done.line("without all their photos")
    assert 2 <= int(done.line("finished by an earlier run").split()[0]) < 6


def test_tiles_of_other_wishes_are_not_gone_on_with(
    flight: Flight, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = copied(flight, flight.folder.parent / "other")
    whole.wish(seams="optimised", colour="none")
    whole.made()
    with monkeypatch.context() as patched:
        patched.setattr(TiledWriter, "write_tile", after(5, TiledWriter.write_tile, stop))
        assert flight.run().code == 130
    flight.wish(seams="optimised", colour="none")
    done = flight.made()
    assert "begun anew" in done.line("other photos or settings")
    assert flight.path.read_bytes() == whole.path.read_bytes()


def stop() -> None:
    raise KeyboardInterrupt


@dataclass
class Impatient:
    """Feedback of a user who wants to stop once a message has come so often."""

    word: str
    count: int
    told: list[str] = field(default_factory=list)

    def progress(self, fraction: float, message: str = "") -> None:
        self.told.append(message)

    def warn(self, message: str) -> None: ...

    def info(self, message: str) -> None: ...

    def cancelled(self) -> bool:
        return sum(self.word in message for message in self.told) >= self.count


@pytest.mark.parametrize(("word", "count"), [("colour and seams", 2), ("tile ", 4)])
def test_a_wish_to_stop_is_heard_at_once_and_the_rest_made_later(
    flight: Flight, whole: bytes, word: str, count: int
) -> None:
    feedback = Impatient(word, count)
    with pytest.raises(Cancelled):
        run_tool(
            load_registry(), "mosaic", {}, feedback, project=Project.open(flight.folder),
            options=RunOptions(workers=1),
        )  # fmt: skip
    assert sum(word in message for message in feedback.told) == count
    assert not flight.path.exists()
    flight.made()
    assert flight.path.read_bytes() == whole


def test_a_wish_to_stop_is_heard_while_colours_are_compared(
    flight: Flight, monkeypatch: pytest.MonkeyPatch
) -> None:
    def solve(*args: Any) -> None:
        raise AssertionError("not stopped")

    monkeypatch.setattr(prepare, "solve_colour", solve)
    # the proxies of four photos
    feedback = Impatient("colour and seams", 4)
    with pytest.raises(Cancelled):
        run_tool(
            load_registry(), "mosaic", {}, feedback, project=Project.open(flight.folder),
            options=RunOptions(workers=1),
        )  # fmt: skip


class Full:
    """A disk with room for some more bytes."""

    def __init__(self, room: int) -> None:
        self.room = room

    def write_all(self, stream: Any, data: Any) -> None:
        self.room -= len(data)
        if self.room < 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        files.write_all(stream, data)


@pytest.mark.parametrize(("module", "room"), [(spool, 400_000), (quarters, 400_000)])
def test_a_full_disk_is_told_in_one_line_and_gone_on_from(
    flight: Flight, whole: bytes, monkeypatch: pytest.MonkeyPatch, module: Any, room: int
) -> None:
    with monkeypatch.context() as patched:
        patched.setattr(module, "write_all", Full(room).write_all)
        done = flight.run()
    assert done.code == 2, done.text
    assert "mosaic.tif" in done.line("the disk of", "is full", "finished tiles are kept")
    assert "Traceback" not in done.text
    done = flight.made()
    assert done.line("finished by an earlier run")
    assert flight.path.read_bytes() == whole


class FullFile(io.FileIO):
    """A file on a disk that takes a few bytes more."""

    def write(self, data: Any) -> int:
        super().write(memoryview(data).cast("B")[:9])
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_a_disk_that_is_full_of_proxies_is_told_in_one_line(
    flight: Flight, whole: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = Path.open

    def opened(self: Path, mode: str = "r", *args: Any, **options: Any) -> Any:
        full = "w" in mode and "proxies" in self.parts
        return FullFile(self, "wb") if full else real(self, mode, *args, **options)

    with monkeypatch.context() as patched:
        patched.setattr(Path, "open", opened)
        done = flight.run()
    assert done.code == 2, done.text
    assert "free space" in done.line("No space left on device")
    flight.made()
    assert flight.path.read_bytes() == whole


def test_proxies_that_a_power_cut_left_empty_are_made_again(flight: Flight, whole: bytes) -> None:
    flight.made()
    kept = sorted((flight.folder / "cache" / "mosaic" / "proxies").glob("*/*"))
    assert len(kept) == len(ROW)
    kept[0].write_bytes(b"")
    kept[1].write_bytes(kept[1].read_bytes()[:1000])
    flight.path.unlink()
    flight.made()
    assert flight.path.read_bytes() == whole


# -- too large -----------------------------------------------------------------------------------

Usage = namedtuple("Usage", "total used free")


def test_a_mosaic_larger_than_the_disk_is_refused_before_its_tiles(
    flight: Flight, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda path: Usage(10**6, 0, 10**6))
    done = flight.run()
    assert done.code == 2, done.text
    line = done.line("GB are needed", "GB are free")
    assert "mosaic.tif" in line
    assert not flight.path.exists()


def test_a_mosaic_of_10_to_the_12_pixels_is_refused_with_the_number(tmp_path: Path) -> None:
    flight = make(tmp_path / "site", places=((0.0, 0.0), (1500.0, 1000.0)))
    flight.wish(seams="optimised", gsd=0.001)
    done = flight.run()
    assert done.code == 2, done.text
    # 1620 x 1080 m
    assert "1.7e+12 px" in done.line("gsd", "coarser")


def test_the_cache_of_proxies_does_not_grow(flight: Flight) -> None:
    for gsd in (0.3, 0.5, 1.0, 2.0):
        flight.wish(seams="optimised", gsd=gsd)
        flight.made()
    folder = flight.folder / "cache" / "mosaic" / "proxies"
    assert len(list(folder.iterdir())) <= 2
    shutil.rmtree(flight.folder / "cache")
    assert "unchanged" in flight.made().text
