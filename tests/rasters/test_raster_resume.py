from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from resume_cases import (
    KEY,
    interrupted,
    open_writer,
    picture,
    profile_of,
    tiles,
    write_rest,
)

from georef_gis.errors import Cancelled, ExportError
from georef_gis.rasters import files, journal, spool, work_folder
from georef_gis.rasters.writer import TiledWriter

CASES = Path(__file__).with_name("resume_cases.py")


def test_resume_needs_a_folder_and_a_folder_a_key(tmp_path: Path) -> None:
    profile = profile_of(picture()[0])
    for options in ({"resume": KEY}, {"work": tmp_path}):
        with pytest.raises(ValueError, match="go together"):
            TiledWriter(tmp_path / "a.tif", profile, **options)  # type: ignore[arg-type]


@pytest.mark.parametrize("workers", [1, 2])
def test_a_run_that_is_never_interrupted_gives_the_same_bytes(
    place: tuple[Path, Path], whole: bytes, workers: int
) -> None:
    with open_writer(*place, workers=workers) as writer:
        assert not writer.done.any()
        write_rest(writer)
    assert place[0].read_bytes() == whole
    assert os.listdir(place[1]) == []


@pytest.mark.parametrize("stops", [[1], [7, 60, 3], [200], [40] * 4])
@pytest.mark.parametrize("workers", [1, 2])
def test_stopped_runs_add_up_to_the_same_bytes(
    place: tuple[Path, Path], whole: bytes, stops: list[int], workers: int
) -> None:
    finished = 0
    for order, most in enumerate(stops):
        interrupted(*place, most, order=order, workers=workers)
        finished += most
    with open_writer(*place, workers=workers) as writer:
        if workers == 1:
            assert writer.done.sum() == finished
        assert writer.resumption.note == ""
        assert not place[0].exists()
        write_rest(writer, order=9)
    assert place[0].read_bytes() == whole
    assert os.listdir(place[1]) == []


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
@pytest.mark.parametrize("workers", [1, 2])
def test_kills_at_any_moment_lose_no_finished_tile(
    place: tuple[Path, Path], whole: bytes, workers: int
) -> None:
    command = [sys.executable, str(CASES), *map(str, place), str(workers)]
    lines = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()
    assert len(lines) > 10
    done = [int(line.partition(" ")[0]) for line in lines]
    assert done == sorted(done)
    assert done[0] == 0
    assert done[10] > 0
    # nothing was damaged or begun anew
    assert all(line.endswith(" ") for line in lines)
    assert place[0].read_bytes() == whole
    assert os.listdir(place[1]) == []


class Killed(BaseException):
    """Stands for a kill at a certain write."""


def test_a_kill_between_any_two_writes_leaves_what_can_be_resumed(
    place: tuple[Path, Path], whole: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = files.write_all
    left = [0]

    def stopping(stream: Any, data: bytes | memoryview) -> None:
        left[0] -= 1
        if left[0] == 0:
            # a part of it only, as a kill in the middle leaves it
            real(stream, memoryview(data)[: len(data) // 2])
            raise Killed
        real(stream, data)

    for module in (spool, journal, sys.modules["georef_gis.rasters.quarters"]):
        monkeypatch.setattr(module, "write_all", stopping)
    before = -1
    for count in range(1, 200):
        left[0] = 3 * count
        writer = open_writer(*place)
        assert writer.resumption.note == ""
        assert writer.done.sum() >= before
        before = int(writer.done.sum())
        try:
            write_rest(writer, order=count)
            writer.close()
            break
        except Killed:
            writer.abort()
    assert count > 20
    assert place[0].read_bytes() == whole


@pytest.mark.parametrize("error", [Cancelled("stopped"), KeyboardInterrupt(), RuntimeError("bug")])
def test_an_exception_keeps_the_tiles(
    place: tuple[Path, Path], whole: bytes, error: BaseException
) -> None:
    def stopped() -> None:
        with open_writer(*place, workers=2) as writer:
            write_rest(writer, most=50)
            raise error

    with pytest.raises(type(error)):
        stopped()
    writer = open_writer(*place)
    # those in the queue of two workers may be dropped
    assert writer.done.sum() >= 50 - 4
    write_rest(writer)
    writer.close()
    assert place[0].read_bytes() == whole


def test_abort_without_keep_leaves_nothing(place: tuple[Path, Path]) -> None:
    writer = open_writer(*place)
    write_rest(writer, most=50)
    assert len(os.listdir(place[1])) > 3
    writer.abort(keep=False)
    assert os.listdir(place[1]) == []
    assert not place[0].exists()


def test_another_file_in_the_same_folder_is_left_alone(place: tuple[Path, Path]) -> None:
    target, work = place
    interrupted(target, work, 10)
    (work / "proxies.npz").write_bytes(b"mine")
    kept = set(os.listdir(work))
    with open_writer(target.with_name("b.tif"), work) as writer:
        write_rest(writer)
    assert set(os.listdir(work)) == kept


@pytest.mark.parametrize("change", ["key", "quality", "overviews"])
def test_other_work_is_begun_anew_and_said(place: tuple[Path, Path], change: str) -> None:
    interrupted(*place, 30)
    options: dict[str, Any] = {"resume": KEY, "work": place[1]}
    profile = profile_of(picture()[0], **({"quality": 70} if change == "quality" else {}))
    options |= {"key": {"resume": "other"}, "overviews": {"overviews": False}}.get(change, {})
    writer = TiledWriter(place[0], profile, **options)
    assert not writer.done.any()
    assert "begun anew" in writer.resumption.note
    assert "other photos or settings" in writer.resumption.note
    writer.abort()


def _journal(work: Path) -> Path:
    return work / "a.tif.journal"


def test_a_torn_last_line_costs_that_tile_only(place: tuple[Path, Path], whole: bytes) -> None:
    interrupted(*place, 30)
    path = _journal(place[1])
    path.write_bytes(path.read_bytes()[:-7])
    writer = open_writer(*place)
    assert writer.done.sum() == 29
    assert writer.resumption.note == ""
    write_rest(writer)
    writer.close()
    assert place[0].read_bytes() == whole


@pytest.mark.parametrize("at", [0.3, 0.6, 0.97])
def test_a_damaged_journal_keeps_what_stands_before(
    place: tuple[Path, Path], whole: bytes, at: float
) -> None:
    interrupted(*place, 120)
    path = _journal(place[1])
    raw = bytearray(path.read_bytes())
    raw[int(at * len(raw))] ^= 1
    path.write_bytes(raw)
    writer = open_writer(*place)
    assert 0 < writer.done.sum() < 120
    assert "damaged" in writer.resumption.note
    write_rest(writer)
    writer.close()
    assert place[0].read_bytes() == whole


def test_a_journal_without_its_head_is_begun_anew(place: tuple[Path, Path], whole: bytes) -> None:
    interrupted(*place, 30)
    path = _journal(place[1])
    path.write_bytes(b"x" + path.read_bytes())
    writer = open_writer(*place)
    assert not writer.done.any()
    assert "is damaged" in writer.resumption.note
    write_rest(writer)
    writer.close()
    assert place[0].read_bytes() == whole


def _level_files(work: Path) -> list[Path]:
    return [*sorted(work.glob("a.tif.level-*")), work / "a.tif.halves"]


@pytest.mark.parametrize("number", range(6))
@pytest.mark.parametrize("damage", ["byte", "shorter", "gone", "zeros"])
def test_damaged_tiles_are_found_and_made_again(
    place: tuple[Path, Path], whole: bytes, number: int, damage: str
) -> None:
    interrupted(*place, 150, order=0)
    path = _level_files(place[1])[number]
    raw = bytearray(path.read_bytes())
    if number == 4:
        # 1000 x 900 px: the coarsest level of 63 px comes at the very end
        assert not raw
        return
    if damage == "gone":
        path.unlink()
    else:
        # in the file of halves any place may be free, so all of it is hit
        half = len(raw) // 2 if number < 5 else 100
        for at in range(half, len(raw), len(raw) if number < 5 else 500):
            raw[at] ^= 0x10
        new = {
            "byte": raw,
            "shorter": raw[: half + 1],
            "zeros": raw[:half] + bytes(len(raw) - half),
        }
        path.write_bytes(new[damage])
    writer = open_writer(*place)
    assert writer.resumption.lost > 0
    assert "damaged" in writer.resumption.note
    done = int(writer.done.sum())
    assert done < 150
    # a second interruption must not lose them again
    write_rest(writer, order=3, most=20)
    writer.abort()
    writer = open_writer(*place)
    assert writer.resumption.lost == 0
    assert writer.done.sum() == done + 20
    write_rest(writer, order=4)
    writer.close()
    assert place[0].read_bytes() == whole


@pytest.mark.parametrize("seed", range(16))
def test_a_failure_of_the_power_never_gives_a_wrong_file(
    place: tuple[Path, Path], whole: bytes, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    interrupted(*place, int(rng.integers(20, 230)), order=seed % 3)
    # any of the last writes may be missing, whatever came after them
    for path in [*_level_files(place[1]), _journal(place[1])]:
        raw = bytearray(path.read_bytes())
        if raw and rng.random() < 0.6:
            end = int(rng.integers(len(raw) // 2, len(raw)))
            raw[end:] = bytes(len(raw) - end) if rng.random() < 0.5 else b""
            path.write_bytes(raw)
    writer = open_writer(*place)
    write_rest(writer, order=5, most=30)
    writer.abort()
    writer = open_writer(*place)
    assert writer.resumption.lost == 0
    write_rest(writer, order=6)
    writer.close()
    assert place[0].read_bytes() == whole


@pytest.mark.parametrize(
    "changes",
    [
        {"compression": "deflate"},
        {"compression": "zstd", "dtype": "float32", "nodata": float("nan")},
        {"compression": "webp"},
        {"compression": "zstd", "dtype": "uint16", "bands": 1},
    ],
    ids=["alpha", "nodata", "webp", "grey"],
)
def test_every_kind_of_raster_can_be_resumed(
    tmp_path: Path, changes: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    # halves come from the disk even without an interruption
    monkeypatch.setattr("georef_gis.rasters.pyramid_builder._WAITING_LIMIT", 20_000)
    profile = profile_of(picture()[0], **changes)

    def write(writer: TiledWriter, most: int) -> None:
        for row, col, data, mask in tiles(1):
            if not writer.done[row, col] and most > 0:
                kind = data[..., : profile.bands].astype(profile.dtype)
                writer.write_tile(row, col, kind, mask)
                most -= 1

    with TiledWriter(tmp_path / "a.tif", profile) as writer:
        write(writer, 999)
    for most in (100, 60):
        writer = TiledWriter(tmp_path / "b.tif", profile, resume=KEY, work=tmp_path / "work")
        write(writer, most)
        writer.abort()
    with TiledWriter(
        tmp_path / "b.tif", profile, resume=KEY, work=tmp_path / "work", workers=2
    ) as writer:
        assert writer.done.sum() == 160
        write(writer, 999)
    assert (tmp_path / "a.tif").read_bytes() == (tmp_path / "b.tif").read_bytes()


def test_a_work_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / "work").write_bytes(b"a file")
    with pytest.raises(ExportError, match=r"a\.tif: cannot be written"):
        open_writer(tmp_path / "a.tif", tmp_path / "work")


def test_two_runs_cannot_write_the_same_raster(place: tuple[Path, Path]) -> None:
    first = open_writer(*place)
    with pytest.raises(ExportError, match="another run is writing"):
        open_writer(*place)
    first.abort()
    open_writer(*place).abort(keep=False)


def test_an_end_that_is_stopped_goes_on(
    place: tuple[Path, Path], whole: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = work_folder.WorkFolder.commit
    ending = [False]

    def stopping(self: work_folder.WorkFolder, records: Any) -> None:
        if ending[0]:
            raise Killed
        real(self, records)
        ending[0] = records[0][0] == "c"

    writer = open_writer(*place)
    write_rest(writer)
    with monkeypatch.context() as patched:
        patched.setattr(work_folder.WorkFolder, "commit", stopping)
        with pytest.raises(Killed):
            writer.close()
    # a tile of the full resolution that is damaged now is asked for again, but no other
    path = place[1] / "a.tif.level-0"
    raw = bytearray(path.read_bytes())
    raw[len(raw) // 2] ^= 1
    path.write_bytes(raw)
    writer = open_writer(*place)
    assert (~writer.done).sum() == 1
    write_rest(writer)
    writer.close()
    assert place[0].read_bytes() == whole
