"""Values made ahead of their use by threads."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

Value = TypeVar("Value")
Item = TypeVar("Item")


def made_ahead(
    make: Callable[[Item], Value], items: Iterable[Item], workers: int
) -> Iterator[Value]:
    """What `make` gives for the items, in their order; made ahead by threads if there are several.

    As nothing but the time depends on `workers`, `make` must not depend on what is done with
    earlier values. At most two values a worker are ready and not yet taken.
    """
    if workers < 2:
        yield from map(make, items)
        return
    with ThreadPoolExecutor(max_workers=workers) as pool:
        waiting: deque[Future[Value]] = deque()
        try:
            for item in items:
                waiting.append(pool.submit(make, item))
                if len(waiting) > 2 * workers:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            for job in waiting:
                job.cancel()
