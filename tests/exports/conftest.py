"""Fixture of the site of three photos."""

from __future__ import annotations

from pathlib import Path

import pytest
from site_cases import make_site, write_photos

from exports.site.site import SiteLayers


@pytest.fixture
def site(tmp_path: Path) -> SiteLayers:
    write_photos(tmp_path)
    return make_site(tmp_path)
