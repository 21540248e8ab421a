"""The one place where loops of the mosaic are compiled."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile at first use and keep beside the source."""
    made: Callable[..., Any] = numba.njit(cache=True, nogil=True)(function)
    return made
