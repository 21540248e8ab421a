"""A copy of the sample project with a few photos, and calls of the command line on it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from tool_cases import SAMPLE, Site, copy_site


@pytest.fixture
def make_site(tmp_path: Path) -> Callable[..., Site]:
    if not SAMPLE.is_dir():
        pytest.skip("sample_project is not there")

    def make(photos: int = 5, **settings: object) -> Site:
        return copy_site(tmp_path / "site", photos, **settings)

    return make


@pytest.fixture
def site(make_site: Callable[..., Site]) -> Site:
    """Five neighbouring photos, products at 0.3 m to be fast."""
    return make_site()
