"""A folder of grids of its own for every test that asks for it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from grid_cases import grids_in


@pytest.fixture
def grids(tmp_path: Path) -> Iterator[Path]:
    with grids_in(tmp_path / "grids") as folder:
        yield folder
