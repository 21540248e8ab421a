"""Real data where GEOREF_DATA says, and small photos written with given tags."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping
from pathlib import Path

import photo_writer
import pytest


@pytest.fixture(scope="session")
def data() -> Path:
    folder = os.environ.get("GEOREF_DATA")
    if not folder:
        pytest.skip("GEOREF_DATA is not set: no real data")
    return Path(folder)


@pytest.fixture(scope="session")
def metadata(data: Path) -> Mapping[str, dict[str, object]]:
    records = {}
    for path in sorted((data / "metadata").glob("*.json")):
        record = json.loads(path.read_text())
        records[path.stem] = record[0] if isinstance(record, list) else record
    return records


@pytest.fixture
def photo_file(tmp_path: Path) -> Callable[..., Path]:
    """Writes a small photo: photo_file("A.jpg", tags={...}, size=(64, 48), ...)."""

    def write(name: str = "A.jpg", **options: object) -> Path:
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        photo_writer.write_photo(path, **options)  # type: ignore[arg-type]
        return path

    return write
