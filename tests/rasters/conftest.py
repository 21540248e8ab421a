from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from resume_cases import picture, profile_of, tiles

from georef_gis.rasters.writer import TiledWriter


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(7)


@pytest.fixture
def leftovers(tmp_path: Path) -> Callable[[], list[str]]:
    return lambda: sorted(os.listdir(tmp_path))


@pytest.fixture(scope="session")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The file of a run without interruption and without a work folder."""
    path = tmp_path_factory.mktemp("whole") / "a.tif"
    with TiledWriter(path, profile_of(picture()[0])) as writer:
        for tile in tiles(0):
            writer.write_tile(*tile)
    return path.read_bytes()


@pytest.fixture
def place(tmp_path: Path) -> tuple[Path, Path]:
    return tmp_path / "a.tif", tmp_path / "work"
