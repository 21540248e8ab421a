from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(7)


@pytest.fixture
def leftovers(tmp_path: Path) -> Callable[[], list[str]]:
    return lambda: sorted(os.listdir(tmp_path))
