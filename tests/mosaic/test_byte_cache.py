"""Values kept by their bytes: which, how many, and made how often."""

from __future__ import annotations

import threading
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import pytest

from georef_gis.model.grid import Window
from georef_gis.mosaic.byte_cache import ByteCache, array_bytes
from georef_gis.mosaic.coarse import Proxy


def sized(made: list[int]) -> ByteCache[int, np.ndarray]:
    """Arrays of as many bytes as their key, within 100."""

    def make(key: int) -> np.ndarray:
        made.append(key)
        return np.full(key, 7, np.uint8)

    return ByteCache(make, budget=100)


def test_what_was_used_last_is_kept_and_the_rest_made_again() -> None:
    made: list[int] = []
    cache = sized(made)
    for key in (30, 40, 30, 31):
        assert cache(key).nbytes == key
    # 30 was used after 40, so 40 gave way
    assert cache.total == 30 + 31
    assert made == [30, 40, 31]
    cache(30)
    cache(40)
    assert made == [30, 40, 31, 40]
    # 40 and 30 leave no room for 31
    assert cache.total == 70


def test_bytes_count_not_values() -> None:
    made: list[int] = []
    cache = sized(made)
    for key in range(1, 14):
        cache(key)
    assert cache.total == sum(range(1, 14)) == 91
    cache(90)
    assert cache.total == 90
    assert len(made) == 14


def test_one_value_is_kept_whatever_its_size() -> None:
    made: list[int] = []
    cache = sized(made)
    cache(30)
    first = cache(500)
    assert cache(500) is first
    assert cache.total == 500
    cache(20)
    assert cache.total == 20


def test_a_value_that_cannot_be_made_is_tried_again() -> None:
    calls: list[int] = []

    def make(key: int) -> np.ndarray:
        calls.append(key)
        if len(calls) == 1:
            raise OSError("not there")
        return np.zeros(key, np.uint8)

    cache = ByteCache(make, budget=100)
    with pytest.raises(OSError, match="not there"):
        cache(8)
    assert cache(8).nbytes == 8
    assert cache.total == 8


def test_threads_that_want_one_value_wait_for_one_that_makes_it() -> None:
    """All are asked for it while it is being made; the first waits until the last has asked."""
    count, started = [0], threading.Semaphore(0)

    def make(key: int) -> np.ndarray:
        count[0] += 1
        for _ in range(4):
            assert started.acquire(timeout=10.0)
        return np.zeros(key, np.uint8)

    cache = ByteCache(make, budget=100)

    def ask() -> np.ndarray:
        started.release()
        return cache(50)

    with ThreadPoolExecutor(4) as pool:
        found = [job.result() for job in [pool.submit(ask) for _ in range(4)]]
    assert count == [1]
    assert all(value is found[0] for value in found)


def test_values_are_made_at_the_same_time_by_several_threads() -> None:
    both = threading.Barrier(2, timeout=10.0)

    def make(key: int) -> np.ndarray:
        both.wait()
        return np.zeros(key, np.uint8)

    cache = ByteCache(make, budget=100)
    with ThreadPoolExecutor(2) as pool:
        assert [value.nbytes for value in pool.map(cache, (10, 20))] == [10, 20]


def test_the_total_stays_right_under_many_threads() -> None:
    made: Counter[int] = Counter()

    def make(key: int) -> np.ndarray:
        made[key] += 1
        return np.full(key, key, np.uint8)

    cache = ByteCache(make, budget=60)
    keys = np.random.default_rng(5).integers(1, 30, 4000).tolist()
    with ThreadPoolExecutor(8) as pool:
        for key, value in zip(keys, pool.map(cache, keys), strict=True):
            assert value.nbytes == key
    assert 30 < cache.total <= 60
    # what is left is what is counted
    assert cache.total == sum(size for _, size in cache._kept.values())
    # some were kept
    assert sum(made.values()) < len(keys)


@dataclass(frozen=True, slots=True)
class Deep:
    """A value with arrays at several depths."""

    name: str
    pair: tuple[np.ndarray, None]
    parts: list[np.ndarray]


def test_arrays_are_found_in_what_caches_hold() -> None:
    assert array_bytes(np.zeros((3, 4), np.float32)) == 48
    assert array_bytes((np.zeros(5, np.uint8), Window(col=0, row=0, width=9, height=9))) == 5
    assert array_bytes(Deep("a", (np.zeros(2), None), [np.zeros(1), np.zeros(3)])) == 48
    proxy = Proxy(
        photo_id="a",
        window=Window(col=0, row=0, width=4, height=2),
        data=np.zeros((2, 4, 3), np.float32),
        valid=np.zeros((2, 4), np.bool_),
        distance=np.zeros((2, 4), np.float32),
    )
    assert array_bytes(proxy) == 96 + 8 + 32
