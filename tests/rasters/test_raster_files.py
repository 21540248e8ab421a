from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from raster_cases import ellipse, make_profile, smooth, write, write_tiles

from georef_gis.errors import Cancelled, ExportError
from georef_gis.rasters import files, spool
from georef_gis.rasters.writer import TiledWriter

Leftovers = Callable[[], list[str]]


class FullDisk:
    """A file that takes some bytes and then no more."""

    def __init__(self, stream: Any, room: int, code: int) -> None:
        self._stream, self._room, self._code = stream, room, code

    def write(self, data: bytes) -> int:
        if self._stream.tell() + len(data) > self._room:
            raise OSError(self._code, os.strerror(self._code))
        return self._stream.write(data)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


@pytest.mark.parametrize("workers", [1, 2])
@pytest.mark.parametrize(
    ("code", "words"),
    [(errno.ENOSPC, ["disk is full", "MB more", "MB are free"]), (errno.EIO, ["check the disk"])],
    ids=["full", "broken"],
)
def test_a_disk_that_fails_while_tiles_come_is_named(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    leftovers: Leftovers,
    workers: int,
    code: int,
    words: list[str],
) -> None:
    real = files.scratch_file
    monkeypatch.setattr(spool, "scratch_file", lambda target: FullDisk(real(target), 9000, code))
    with pytest.raises(ExportError) as caught:
        write(tmp_path / "a.tif", smooth(600, 700, 3), workers=workers)
    message = str(caught.value)
    assert message.startswith(str(tmp_path / "a.tif"))
    assert "\n" not in message
    assert all(word in message for word in words)
    assert leftovers() == []


def test_a_disk_too_small_for_the_file_is_seen_before_writing_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, leftovers: Leftovers
) -> None:
    usage = files.shutil.disk_usage(tmp_path)._replace(free=1_000_000)
    monkeypatch.setattr(files.shutil, "disk_usage", lambda path: usage)
    noise = np.random.default_rng(7).integers(0, 256, (1000, 1000, 1), np.uint8)
    with pytest.raises(ExportError, match=r"at least 1\.\d MB more are needed, 1\.0 MB are free"):
        write(tmp_path / "a.tif", noise, compression="deflate")
    assert leftovers() == []


def test_a_disk_that_fills_up_at_the_end_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, leftovers: Leftovers
) -> None:
    def full(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(files.os, "fsync", full)
    with pytest.raises(ExportError, match="disk is full"):
        write(tmp_path / "a.tif", smooth(300, 300, 3))
    assert leftovers() == []


@pytest.mark.parametrize("error", [Cancelled("stopped"), KeyboardInterrupt(), RuntimeError("bug")])
@pytest.mark.parametrize("workers", [1, 2])
def test_an_exception_leaves_the_older_file(
    tmp_path: Path, leftovers: Leftovers, error: BaseException, workers: int
) -> None:
    path, data = tmp_path / "a.tif", smooth(300, 300, 3)
    write(path, data)
    before = path.read_bytes()

    def stopped() -> None:
        with TiledWriter(path, make_profile(data), workers=workers) as writer:
            writer.write_tile(0, 0, data[:64, :64] // 2)
            raise error

    with pytest.raises(type(error)):
        stopped()
    assert path.read_bytes() == before
    assert leftovers() == ["a.tif"]


def test_a_worker_that_fails_stops_the_writer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, leftovers: Leftovers
) -> None:
    def broken(*arguments: object) -> None:
        raise RuntimeError("codec")

    monkeypatch.setattr("georef_gis.rasters.codecs.cv2.imencode", broken, raising=True)
    data = smooth(600, 700, 3)
    with pytest.raises(RuntimeError, match="codec"):
        write(tmp_path / "a.tif", data, workers=2)
    assert leftovers() == []


def test_an_older_file_is_replaced_with_its_companions(
    tmp_path: Path, leftovers: Leftovers
) -> None:
    path = tmp_path / "a.tif"
    for name in ("a.tif", "a.tif.ovr", "a.tif.msk", "a.tif.aux.xml", "a.tfw"):
        (tmp_path / name).write_bytes(b"old")
    write(path, smooth(30, 30, 3))
    assert leftovers() == ["a.tfw", "a.tif"]
    with rasterio.open(path) as dataset:
        assert dataset.overviews(1) == []


def test_a_link_stays_a_link(tmp_path: Path) -> None:
    (tmp_path / "disk").mkdir()
    (tmp_path / "a.tif").symlink_to(tmp_path / "disk" / "b.tif")
    write(tmp_path / "a.tif", smooth(30, 30, 3))
    assert (tmp_path / "a.tif").is_symlink()
    assert (tmp_path / "disk" / "b.tif").stat().st_size > 0


def test_the_file_has_the_permissions_of_the_umask(tmp_path: Path) -> None:
    before = os.umask(0o027)
    try:
        write(tmp_path / "a.tif", smooth(30, 30, 3))
    finally:
        os.umask(before)
    assert (tmp_path / "a.tif").stat().st_mode & 0o777 == 0o640


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_what_a_killed_run_left_is_removed_by_the_next(
    tmp_path: Path, leftovers: Leftovers
) -> None:
    code = """
        import os, sys, time
        from pathlib import Path
        from georef_gis.rasters import files
        with files.whole_file(Path(sys.argv[1])) as stream:
            stream.write(b"half"); stream.flush()
            print("ready", flush=True)
            time.sleep(60)
    """
    path = tmp_path / "a.tif"
    command = [sys.executable, "-c", textwrap.dedent(code), str(path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        living = leftovers()
        assert len(living) == 1
        TiledWriter(path, make_profile(smooth(30, 30, 3))).abort()
        assert leftovers() == living  # the other run is alive: its file is left alone
        process.send_signal(signal.SIGKILL)
        process.wait()
    assert leftovers() == living
    TiledWriter(path, make_profile(smooth(30, 30, 3))).abort()
    assert leftovers() == []


def test_a_killed_writer_leaves_no_scratch(tmp_path: Path, leftovers: Leftovers) -> None:
    data, mask = smooth(600, 700, 3), ellipse(600, 700)
    writer = TiledWriter(tmp_path / "a.tif", make_profile(data))
    write_tiles(writer, data, mask)
    # nameless on Linux: nothing for a killed run to leave before the end
    assert leftovers() == []
    writer.abort()


def test_a_folder_that_does_not_exist_is_named(tmp_path: Path) -> None:
    with pytest.raises(ExportError, match=r"folder .*nowhere does not exist"):
        TiledWriter(tmp_path / "nowhere" / "a.tif", make_profile(smooth(30, 30, 3)))


def test_a_folder_as_target_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ExportError, match="is a folder"):
        TiledWriter(tmp_path, make_profile(smooth(30, 30, 3)))


def test_a_folder_without_permission_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def denied(**options: object) -> None:
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))

    # root may write anywhere, so the refusal is made here
    monkeypatch.setattr(files.tempfile, "TemporaryFile", denied)
    with pytest.raises(ExportError, match="cannot be written to; choose another"):
        TiledWriter(tmp_path / "a.tif", make_profile(smooth(30, 30, 3)))
