"""Kills, locks and many hands at once: whatever happens, no edit is lost or half there."""

from __future__ import annotations

import os
import signal
import sqlite3
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest
from asset_cases import cone, sql, store_at

from georef_gis.errors import InputError
from georef_gis.measure.assets.asset import StaleAssetError
from georef_gis.measure.assets.file import ASSETS_FILE
from georef_gis.measure.assets.store import Change

HERE = Path(__file__).parent

# Steps of three assets until it is killed; tells of each when it is written.
EDITOR = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[2])
from asset_cases import cone, store_at
store = store_at(Path(sys.argv[1]))
k = 0
while True:
    with store.step(f"step {k}"):
        for j in range(3):
            store.add(cone(k, j, name=f"{k}-{j}"))
    print(k, flush=True)
    k += 1
"""
# Adds its own assets, and counts on one that all share: as often as told.
COUNTER = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[2])
from asset_cases import cone, store_at
from georef_gis.measure.assets.asset import StaleAssetError
from georef_gis.measure.assets.store import Change
store = store_at(Path(sys.argv[1]), wait=30.0)
shared = sys.argv[3]
for k in range(int(sys.argv[4])):
    store.add(cone(k, name=sys.argv[5]))
    while True:
        old = store.get(shared)
        try:
            store.change(shared, old.revision, Change(note=str(int(old.note) + 1)))
            break
        except StaleAssetError:
            pass
"""


@contextmanager
def held(folder: Path, *, mode: str = "IMMEDIATE") -> Iterator[sqlite3.Connection]:
    """The file as a GIS holds it that is editing in a transaction."""
    connection = sqlite3.connect(folder / ASSETS_FILE, isolation_level=None)
    with closing(connection):
        connection.execute(f"BEGIN {mode}")
        yield connection
        if connection.in_transaction:
            connection.execute("ROLLBACK")


def test_file_held_by_a_gis_is_refused_in_one_line_with_the_cure(tmp_path: Path) -> None:
    asset = store_at(tmp_path).add(cone(name="C1"))
    store = store_at(tmp_path, wait=0.2)
    with held(tmp_path):
        start = time.monotonic()
        with pytest.raises(InputError) as refused:
            store.change(asset.id, 1, Change(name="C2"))
        # it waited, and not for ever
        assert 0.2 <= time.monotonic() - start < 5.0
        assert "QGIS" in str(refused.value)
        assert "save or end the editing there" in str(refused.value)
        assert "\n" not in str(refused.value)
    assert store.change(asset.id, 1, Change(name="C2")).name == "C2"


def test_reading_goes_on_while_a_gis_holds_the_file(tmp_path: Path) -> None:
    asset = store_at(tmp_path).add(cone(name="C1"))
    with held(tmp_path):
        store = store_at(tmp_path, wait=0.1)
        assert store.get(asset.id).name == "C1"
        assert len(store.assets()) == 1
        assert len(store.steps()) == 1


def test_edit_waits_for_a_gis_that_is_saving(tmp_path: Path) -> None:
    store = store_at(tmp_path, wait=10.0)
    asset = store.add(cone(name="C1"))
    with held(tmp_path) as gis:
        gis.execute("UPDATE asset_points SET note = 'saved by the GIS'")
        done: list[object] = []

        def edit() -> None:
            try:
                done.append(store.change(asset.id, 1, Change(name="C2")))
            except StaleAssetError as error:
                done.append(error.current)

        thread = threading.Thread(target=edit)
        thread.start()
        time.sleep(0.3)
        assert not done
        gis.execute("COMMIT")
        thread.join(10.0)
    # the GIS came first, so the edit from before it is stale, and told what is there now
    assert getattr(done[0], "note", "") == "saved by the GIS"


@pytest.mark.parametrize("after", [1, 4, 9])
def test_killed_editor_leaves_whole_steps_only(tmp_path: Path, after: int) -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", EDITOR, str(tmp_path), str(HERE)],
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    with process.stdout:
        told = -1
        while told < after:
            told = int(process.stdout.readline())
        # somewhere in the middle of a later step
        time.sleep(0.003 * after)
        os.kill(process.pid, signal.SIGKILL)
        told = max([told, *map(int, process.stdout.read().split())])
        process.wait()
    with store_at(tmp_path) as store:
        steps, assets = store.steps(), store.assets()
        assert len(steps) >= told + 1
        assert len(assets) == 3 * len(steps)
        assert all(len(step.asset_ids) == 3 for step in steps)
        for k in range(len(steps) - 1, -1, -1):
            store.undo()
            assert len(store.assets()) == 3 * k
    assert sql(tmp_path, "PRAGMA integrity_check") == [("ok",)]


def test_killed_while_the_file_was_made_it_is_made_next_time(tmp_path: Path) -> None:
    (tmp_path / ASSETS_FILE).touch()
    assert len([store_at(tmp_path).add(cone())]) == 1
    assert len(store_at(tmp_path).assets()) == 1


def test_processes_editing_at_once_lose_nothing(tmp_path: Path) -> None:
    rounds, names = 12, ("left", "right")
    shared = store_at(tmp_path).add(cone(name="shared", note="0"))
    processes = [
        subprocess.Popen(
            [sys.executable, "-c", COUNTER, str(tmp_path), str(HERE), shared.id, str(rounds), name],
            stderr=subprocess.PIPE,
            text=True,
        )
        for name in names
    ]
    for process in processes:
        _, errors = process.communicate(timeout=120)
        assert process.returncode == 0, errors
    store = store_at(tmp_path)
    assert store.get(shared.id).note == str(2 * rounds)
    assert store.get(shared.id).revision == 1 + 2 * rounds
    for name in names:
        assert sum(a.name == name for a in store.assets()) == rounds
    assert len(store.steps(1000)) == 1 + 4 * rounds


def test_processes_making_the_file_at_once_make_one(tmp_path: Path) -> None:
    code = EDITOR.replace("while True:", "for k in range(2):").replace("k += 1", "pass")
    processes = [
        subprocess.Popen([sys.executable, "-c", code, str(tmp_path), str(HERE)],
                         stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        for _ in range(3)
    ]  # fmt: skip
    for process in processes:
        _, errors = process.communicate(timeout=120)
        assert process.returncode == 0, errors
    assert len(store_at(tmp_path).assets()) == 3 * 2 * 3


def test_threads_share_a_store(tmp_path: Path) -> None:
    store = store_at(tmp_path)
    failed: list[BaseException] = []

    def work(number: int) -> None:
        try:
            for k in range(10):
                with store.step(f"{number}"):
                    store.add(cone(k, name=f"{number}"))
                    store.add(cone(k, 1, name=f"{number}"))
                store.assets()
        except BaseException as error:
            failed.append(error)

    threads = [threading.Thread(target=work, args=(n,)) for n in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert failed == []
    assert len(store.assets()) == 80
    assert all(len(step.asset_ids) == 2 for step in store.steps())


@pytest.mark.skipif(os.name == "nt" or os.geteuid() == 0, reason="root may write anywhere")
def test_folder_that_cannot_be_written_is_told(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    try:
        with pytest.raises(InputError, match="permission"):
            store_at(tmp_path).add(cone())
    finally:
        tmp_path.chmod(0o700)
