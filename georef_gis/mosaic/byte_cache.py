"""Values last used, as many as fit a number of bytes."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import fields, is_dataclass
from typing import Any, Generic, TypeVar

import numpy as np

Key = TypeVar("Key", bound=Hashable)
Value = TypeVar("Value")


def array_bytes(value: Any) -> int:
    """Bytes of the arrays in a value: an array, a tuple or list of such, or a dataclass."""
    if isinstance(value, np.ndarray):
        return value.nbytes
    if isinstance(value, tuple | list):
        return sum(map(array_bytes, value))
    if is_dataclass(value) and not isinstance(value, type):
        return sum(array_bytes(getattr(value, field.name)) for field in fields(value))
    return 0


class ByteCache(Generic[Key, Value]):
    """Values made when they are not there; those used last are kept. Safe for threads.

    A value that several threads want at once is made by one of them; making one may ask other
    caches, not this one for the same value.

    Parameters
    ----------
    make
        Value of a key.
    budget
        Bytes to keep; the value asked for last is kept whatever its size. While values are made
        they come on top of it, one for each thread.
    size
        Bytes of a value.
    """

    def __init__(
        self,
        make: Callable[[Key], Value],
        *,
        budget: int,
        size: Callable[[Value], int] = array_bytes,
    ) -> None:
        self._make, self._size, self._budget = make, size, budget
        self._kept: OrderedDict[Key, tuple[Value, int]] = OrderedDict()
        self._total = 0
        self._lock = threading.Lock()
        self._making: dict[Key, threading.Lock] = {}

    @property
    def total(self) -> int:
        """Bytes kept."""
        return self._total

    def __call__(self, key: Key) -> Value:
        """Value of a key; raises what making it does, and tries again the next time."""
        with self._lock:
            if key in self._kept:
                return self._used(key)
            own = self._making.setdefault(key, threading.Lock())
        with own:
            with self._lock:
                if key in self._kept:
                    return self._used(key)
            value = self._make(key)
            with self._lock:
                self._keep(key, value)
                self._making.pop(key, None)
        return value

    def _used(self, key: Key) -> Value:
        self._kept.move_to_end(key)
        return self._kept[key][0]

    def _keep(self, key: Key, value: Value) -> None:
        # it may be there: dropped and made again by another thread while this one waited
        _, before = self._kept.pop(key, (value, 0))
        size = self._size(value)
        self._kept[key] = value, size
        self._total += size - before
        while self._total > self._budget and len(self._kept) > 1:
            _, (_, dropped) = self._kept.popitem(last=False)
            self._total -= dropped
