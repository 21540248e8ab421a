"""Disks that fill up while a raster is written which can be resumed."""

from __future__ import annotations

import errno
import os
import resource
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from resume_cases import SIZE, open_writer, tiles, write_rest

from georef_gis.errors import ExportError
from georef_gis.rasters import files


class Full:
    """A disk with room for some more bytes, over all files."""

    def __init__(self, room: int) -> None:
        self.room = room

    def write_all(self, stream: Any, data: bytes | memoryview) -> None:
        if len(data) > self.room:
            # the disk takes what it can
            files.write_all(stream, memoryview(data)[: self.room])
            self.room = 0
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        self.room -= len(data)
        files.write_all(stream, data)


@pytest.mark.parametrize("stage", ["spool", "quarters", "journal"])
@pytest.mark.parametrize("workers", [1, 2])
def test_a_full_disk_is_named_and_can_be_resumed(
    place: tuple[Path, Path],
    whole: bytes,
    monkeypatch: pytest.MonkeyPatch,
    stage: str,
    workers: int,
) -> None:
    module = sys.modules[f"georef_gis.rasters.{stage}"]
    with monkeypatch.context() as patched:
        room = {"spool": 60_000, "quarters": 90_000, "journal": 4_000}[stage]
        patched.setattr(module, "write_all", Full(room).write_all)

        def filling() -> None:
            with open_writer(*place, workers=workers) as writer:
                write_rest(writer)

        with pytest.raises(ExportError) as caught:
            filling()
    message = str(caught.value)
    assert "\n" not in message
    for words in (
        str(place[0]),
        str(place[1]),
        "is full",
        "MB are free",
        "finished tiles are kept",
    ):
        assert words in message
    writer = open_writer(*place)
    assert writer.done.sum() >= 10
    assert writer.resumption.note == ""
    write_rest(writer)
    writer.close()
    assert place[0].read_bytes() == whole


def test_a_disk_full_at_the_end_keeps_all_tiles(
    place: tuple[Path, Path], whole: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    writer = open_writer(*place)
    write_rest(writer)
    usage = files.shutil.disk_usage(place[1])._replace(free=1000)
    with monkeypatch.context() as patched:
        patched.setattr(files.shutil, "disk_usage", lambda path: usage)
        with pytest.raises(ExportError, match=r"0\.\d MB more .* finished tiles are kept"):
            writer.close()
    assert not place[0].exists()
    writer = open_writer(*place)
    # no tile may come after the end was declared, so none is asked for
    assert writer.done.all()
    writer.close()
    assert place[0].read_bytes() == whole


@pytest.mark.skipif(sys.platform == "win32", reason="limits of POSIX")
def test_a_file_that_may_not_grow_is_named(place: tuple[Path, Path], whole: bytes) -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    writer = open_writer(*place)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, hard))
    try:
        with pytest.raises(ExportError, match="grows larger than"):
            write_rest(writer)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    writer.abort()
    writer = open_writer(*place)
    assert writer.done.sum() > 5
    write_rest(writer)
    writer.close()
    assert place[0].read_bytes() == whole


@pytest.mark.parametrize("worst", [True, False], ids=["three-of-four", "rows"])
def test_halves_take_less_than_a_third_of_the_raw_raster(
    place: tuple[Path, Path], worst: bool
) -> None:
    writer = open_writer(*place)
    places = sorted(
        (tile for tile in tiles(0)),
        key=lambda tile: ((tile[0] % 2 and tile[1] % 2) if worst else 0, tile[0], tile[1]),
    )
    most = 0
    data = np.ones((SIZE, SIZE, 3), np.uint8)
    mask = np.ones((SIZE, SIZE), np.uint8)
    mask[0, 0] = 0
    raw = 0
    for row, col, _, _ in places:
        rows, cols = writer.tile_shape(row, col)
        writer.write_tile(row, col, data[:rows, :cols], mask[:rows, :cols])
        raw += rows * cols * 3
        most = max(most, (place[1] / "a.tif.halves").stat().st_size)
    writer.abort()
    assert most <= (0.30 if worst else 0.08) * raw
