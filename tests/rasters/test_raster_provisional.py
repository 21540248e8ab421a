"""Tiles that are good for one file only, and notes of tiles, when a run goes on."""

from __future__ import annotations

import os
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from resume_cases import open_writer, tiles

from georef_gis.rasters import journal
from georef_gis.rasters.writer import TiledWriter

At = tuple[int, int]
# tiles that are made otherwise as long as something is missing: amid, at a corner, one that is
# empty in the picture, one that never comes
MAKESHIFT: list[At] = [(6, 7), (7, 7), (0, 0), (5, 2), (14, 1)]


def write(writer: TiledWriter, order: int, makeshift: Collection[At] = (), most: int = 999) -> None:
    """Write what is not done, at most some tiles, each with a note; some of them black."""
    rest = [tile for tile in tiles(order) if not writer.done[tile[:2]]][:most]
    for row, col, data, mask in rest:
        if (row, col) in makeshift:
            writer.write_tile(row, col, 0 * data, mask, note=-1, provisional=True)
        else:
            writer.write_tile(row, col, data, mask, note=[row, col])
    for at in sorted(set(makeshift) - {tile[:2] for tile in rest}):
        writer.skip_tile(*at, provisional=True)


def stopped_at_the_end(writer: TiledWriter, monkeypatch: pytest.MonkeyPatch) -> None:
    """Close a writer, but for its last step: all overviews are made and declared."""

    def stop() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(writer, "_assemble", stop)
    with pytest.raises(KeyboardInterrupt):
        writer.close()


@pytest.mark.parametrize("workers", [1, 2])
@pytest.mark.parametrize("order", [0, 1, 2])
@pytest.mark.parametrize("most", [60, 150, 999])
def test_provisional_tiles_are_made_again_by_a_later_run(
    place: tuple[Path, Path], whole: bytes, order: int, most: int, workers: int
) -> None:
    writer = open_writer(*place, workers=workers)
    write(writer, order, MAKESHIFT, most)
    writer.abort()
    with open_writer(*place, workers=workers) as writer:
        assert not any(writer.done[at] for at in MAKESHIFT)
        assert "without all their photos and are made again" in writer.resumption.note
        write(writer, 7)
    assert place[0].read_bytes() == whole
    assert os.listdir(place[1]) == []


def test_a_run_that_made_all_overviews_goes_on_to_whole_ones(
    place: tuple[Path, Path], whole: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    writer = open_writer(*place)
    write(writer, 0, MAKESHIFT)
    stopped_at_the_end(writer, monkeypatch)
    # stopped again before it comes to the tiles: what was dropped stays dropped
    open_writer(*place).abort()
    with open_writer(*place) as writer:
        assert not any(writer.done[at] for at in MAKESHIFT)
        write(writer, 0)
    assert place[0].read_bytes() == whole


def test_a_tile_made_again_is_kept(place: tuple[Path, Path]) -> None:
    writer = open_writer(*place)
    write(writer, 0, MAKESHIFT[:1])
    writer.abort()
    writer = open_writer(*place)
    assert "made again" in writer.resumption.note
    write(writer, 0)
    writer.abort()
    writer = open_writer(*place)
    assert all(writer.done[tile[:2]] for tile in tiles(0))
    assert writer.resumption.note == ""
    writer.abort()


def test_only_what_a_provisional_tile_went_into_is_made_again(place: tuple[Path, Path]) -> None:
    """13 of 16 tiles amid the picture: the overview of 4 was made, that of all was not."""
    writer = open_writer(*place)
    square = [tile for tile in tiles(0) if tile[0] // 4 == 2 and tile[1] // 4 == 1]
    for row, col, data, mask in square[:13]:
        assert mask.any()
        writer.write_tile(row, col, data, mask, provisional=(row, col) == (8, 5))
    writer.abort()
    writer = open_writer(*place)
    done = {(int(row), int(col)) for row, col in np.argwhere(writer.done)}
    writer.abort()
    assert done == {tile[:2] for tile in square[4:13]}


def test_a_file_that_is_finished_holds_its_provisional_tiles(place: tuple[Path, Path]) -> None:
    with open_writer(*place) as writer:
        write(writer, 0, MAKESHIFT)
    first = place[0].read_bytes()
    with open_writer(*place) as writer:
        assert not writer.done.any()
        write(writer, 1, MAKESHIFT)
    assert place[0].read_bytes() == first


def test_notes_of_done_tiles_are_told_to_a_later_run(place: tuple[Path, Path]) -> None:
    writer = open_writer(*place)
    assert writer.notes == {}
    write(writer, 0, MAKESHIFT[:1], most=40)
    writer.abort()
    writer = open_writer(*place)
    done = {(int(row), int(col)) for row, col in np.argwhere(writer.done)}
    assert len(done) > 10
    assert writer.notes == {at: [*at] for at in done}
    writer.abort()


def test_the_note_of_a_damaged_tile_goes_with_it(place: tuple[Path, Path]) -> None:
    writer = open_writer(*place)
    row, col, data, mask = next(tile for tile in tiles(0) if tile[3].all())
    writer.write_tile(row, col, data, mask, note="seen")
    writer.abort()
    path = place[1] / "a.tif.level-0"
    raw = bytearray(path.read_bytes())
    raw[len(raw) // 2] ^= 1
    path.write_bytes(raw)
    for _ in range(2):
        writer = open_writer(*place)
        assert not writer.done.any()
        assert writer.notes == {}
        writer.abort()


def test_a_tile_is_never_declared_without_what_makes_it_provisional(
    place: tuple[Path, Path], whole: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A kill within the journal's line leaves neither."""
    real = journal.write_all

    class Killed(BaseException):
        pass

    def half(stream: Any, data: bytes) -> None:
        real(stream, data[: len(data) // 2])
        raise Killed

    writer = open_writer(*place)
    row, col, data, mask = next(tiles(0))
    with monkeypatch.context() as patched:
        patched.setattr(journal, "write_all", half)
        with pytest.raises(Killed):
            writer.write_tile(row, col, 0 * data, mask, note=1, provisional=True)
    writer.abort()
    with open_writer(*place) as writer:
        assert not writer.done.any()
        assert writer.notes == {}
        write(writer, 0)
    assert place[0].read_bytes() == whole
