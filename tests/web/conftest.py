"""The finished sample project and the server of its page, once for all tests of a process."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from web_cases import Served, Tab, browser, moved_site, opened, served, shared_site


@pytest.fixture(scope="session")
def finished(tmp_path_factory: pytest.TempPathFactory, worker_id: str) -> Path:
    """The finished project; not to be changed."""
    base = tmp_path_factory.getbasetemp()
    return shared_site(base if worker_id == "master" else base.parent)


@pytest.fixture(scope="session")
def worker_id(request: pytest.FixtureRequest) -> str:
    """Name of the process of pytest-xdist; "master" without it."""
    return str(getattr(request.config, "workerinput", {}).get("workerid", "master"))


@pytest.fixture
def site(finished: Path, tmp_path: Path) -> Path:
    """A copy of the finished project that may be changed."""
    return moved_site(finished, tmp_path / "site")


@pytest.fixture(scope="module")
def module_site(finished: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy for the tests of one file, which do not disturb each other."""
    return moved_site(finished, tmp_path_factory.mktemp("page") / "site")


@pytest.fixture
def client(site: Path) -> Iterator[Any]:
    """The page of a project that may be changed."""
    with opened(site) as (made, _):
        yield made


@pytest.fixture(scope="module")
def page_of_site(module_site: Path) -> Iterator[tuple[Any, Any]]:
    """The page of a project that is only looked at, and the access to it."""
    with opened(module_site) as made:
        yield made


@pytest.fixture(scope="module")
def chrome() -> Iterator[Any]:
    """A Chromium; skipped where there is none."""
    with browser() as made:
        yield made


@pytest.fixture
def server(site: Path) -> Iterator[Served]:
    """The page of a project that may be changed, as `georef serve` serves it."""
    with served(site) as running:
        yield running


@pytest.fixture(scope="module")
def shown(
    chrome: Any, finished: Path, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[tuple[Path, Served, Any]]:
    """A served project and a browser's context; tests leave no assets behind that others count."""
    site = moved_site(finished, tmp_path_factory.mktemp("shown") / "site")
    with served(site) as running:
        context = chrome.new_context(viewport={"width": 1280, "height": 720})
        yield site, running, context
        context.close()


@pytest.fixture
def tab(shown: tuple[Path, Served, Any]) -> Iterator[Tab]:
    _, running, context = shown
    made = Tab.open(context, running.address)
    yield made
    complaints = made.complaints
    made.page.close()
    # nothing was refused by the page's own policy, and no script failed
    assert complaints == []
    assert made.asked == {f"127.0.0.1:{running.port}"}
