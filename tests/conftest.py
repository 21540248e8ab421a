"""What holds for all tests."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import TYPE_CHECKING, BinaryIO

import pytest
from hypothesis import settings

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# a time limit for each example would fail on a busy machine; nothing here is a timed test
settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")


@contextmanager
def _undrawn() -> Iterator[None]:
    import cv2
    import numpy as np
    from matplotlib.figure import Figure

    def save(figure: Figure, stream: BinaryIO, *, format: str, **_: object) -> None:
        stream.write(cv2.imencode(f".{format}", np.zeros((1, 1, 3), np.uint8))[1].tobytes())

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, "savefig", save)
        yield


@pytest.fixture(scope="session")
def undrawn() -> Callable[[], AbstractContextManager[None]]:
    """Context in which figures are put together but not drawn; one pixel stands for each.

    Drawing is three quarters of what a report costs. For tests that look at no picture.
    """
    return _undrawn


@pytest.fixture
def pictures_undrawn() -> Iterator[None]:
    """No figure is drawn during the test, see `undrawn`."""
    with _undrawn():
        yield
