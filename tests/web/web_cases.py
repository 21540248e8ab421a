"""A finished copy of the sample project, its page's server, and a real Chromium to look at it."""

from __future__ import annotations

import contextlib
import csv
import os
import re
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
import tomlkit
from click.testing import CliRunner

from georef_gis.app import cli

SAMPLE = Path(__file__).parents[2] / "sample_project"
STEPS = (
    "read_photos,navigate,orient_direct,orient_navigation,match,adjust,footprints,mosaic,control"
)
# Debian's build has no sandbox for root, and must not speak with anybody
_FLAGS = (
    "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
)  # fmt: skip


def build_site(folder: Path) -> None:
    """All photos of the sample project, adjusted; products are coarse, which is fast."""
    if not SAMPLE.is_dir():
        pytest.skip("sample_project is not there")
    folder.mkdir(parents=True)
    for name in ("photos", "control", "logs"):
        shutil.copytree(SAMPLE / name, folder / name)
    for name in ("dem.asc", "dem.prj", "project.toml"):
        shutil.copy(SAMPLE / name, folder)
    settings: dict[str, Any] = tomlkit.parse((folder / "project.toml").read_text())
    settings["products"]["gsd_m"] = 0.3
    settings["tools"] = {"match": {"max_side": 650, "observations": 150}}
    (folder / "project.toml").write_text(tomlkit.dumps(settings))
    done = CliRunner().invoke(cli.georef, ["run", str(folder), "--only", STEPS])
    assert done.exit_code == 0, done.output
    report = "<!doctype html><title>r</title><script>document.title='ran'</script><p>The report"
    (folder / "products" / "report.html").write_text(report)


def shared_site(common: Path) -> Path:
    """The finished project, built by the first process that asks and waited for by the others."""
    ready, folder = common / "web-site.ready", common / "web-site"
    try:
        os.mkdir(common / "web-site.lock")
    except FileExistsError:
        until = time.monotonic() + 600.0
        while not ready.exists():
            if time.monotonic() > until:
                pytest.fail("the project that another process builds is not ready")
            time.sleep(0.2)
        return folder
    build_site(folder)
    ready.touch()
    return folder


def moved_site(source: Path, folder: Path) -> Path:
    """Copy of the finished project without what may be deleted."""
    shutil.copytree(source, folder, ignore=shutil.ignore_patterns("cache"))
    return folder


# -- truth ---------------------------------------------------------------------------------------


def true_objects(kind: str) -> list[dict[str, Any]]:
    """Objects of the sample project: name, easting and northing in US survey feet, height m."""
    with (SAMPLE / "truth" / "objects.csv").open(encoding="utf-8") as stream:
        return [
            {
                "name": row["name"],
                "x": float(row["easting_ftus"]),
                "y": float(row["northing_ftus"]),
                "height": float(row["height_ellipsoidal_m"]),
            }
            for row in csv.DictReader(stream)
            if row["kind"] == kind
        ]


def true_pixels(name: str) -> dict[str, tuple[float, float]]:
    """Photo id -> true pixel of a control point."""
    with (SAMPLE / "truth" / "marks.csv").open(encoding="utf-8") as stream:
        return {
            Path(row["photo"]).stem: (float(row["u"]), float(row["v"]))
            for row in csv.DictReader(stream)
            if row["name"] == name
        }


def true_control(name: str) -> dict[str, float]:
    """Easting and northing of a control point, US survey feet."""
    text = (SAMPLE / "truth" / "control.csv").read_text().splitlines()
    rows = [line.split(",") for line in text if line and not line.startswith("#")]
    columns = {column: k for k, column in enumerate(rows[0])}
    row = next(row for row in rows[1:] if row[0] == name)
    return {"x": float(row[columns["easting"]]), "y": float(row[columns["northing"]])}


# -- the server ----------------------------------------------------------------------------------


@dataclass
class Served:
    """`georef serve` in a process of its own."""

    address: str
    process: subprocess.Popen[str]

    @property
    def origin(self) -> str:
        return self.address.split("/?")[0]

    @property
    def port(self) -> int:
        return int(self.origin.rpartition(":")[2])


@contextlib.contextmanager
def served(folder: Path, *options: str) -> Iterator[Served]:
    words = [sys.executable, "-m", "georef_gis.app", "serve", str(folder), "--no-browser", *options]
    # Buffers would keep the address from a pipe.
    process = subprocess.Popen(
        words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env={**os.environ, "PYTHONUNBUFFERED": "1", "OMP_NUM_THREADS": "1"},
    )  # fmt: skip
    assert process.stdout is not None
    assert process.stderr is not None
    try:
        line = process.stdout.readline()
        found = re.search(r"http://\S+", line)
        assert found, line + process.stderr.read()
        yield Served(address=found[0], process=process)
    finally:
        process.terminate()
        process.wait(30)
        process.stdout.close()
        process.stderr.close()


@contextlib.contextmanager
def opened(folder: Path) -> Iterator[tuple[Any, Any]]:
    """The page's server in a thread: a client that has the page open, and the access to it."""
    import httpx
    import uvicorn

    from georef_gis.app.web.application import make_app
    from georef_gis.app.web.guard import Access
    from georef_gis.app.web.server import _config, _listen
    from georef_gis.project import Project
    from georef_gis.toolbox.registry import load_registry
    from georef_gis.toolbox.services import load_services

    project = Project.open(folder)
    services = load_services(project)
    assert services.refused == []
    with contextlib.closing(_listen(0, True)) as listening:
        access = Access(port=listening.getsockname()[1])
        server = uvicorn.Server(_config(make_app(project, services, load_registry(), access)))
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listening]})
        thread.start()
        origin = access.address.split("/?")[0]
        # no proxy may be asked on the way to this machine
        with httpx.Client(base_url=origin, timeout=60.0, trust_env=False) as client:
            client.headers["origin"] = origin
            client.cookies.set(access.cookie, access.token)
            try:
                yield client, access
            finally:
                server.should_exit = True
                thread.join(60.0)


# -- the browser ---------------------------------------------------------------------------------


def chromium() -> str:
    """Path of Chromium; skips with a clear word where there is none."""
    pytest.importorskip("playwright", reason="playwright is not installed: the page is not tested")
    found = next((path for name in ("chromium", "chromium-browser", "google-chrome")
                  if (path := shutil.which(name))), None)  # fmt: skip
    if found is None:
        pytest.skip("chromium is not installed: the page is not tested in a browser")
    return found


@contextlib.contextmanager
def browser() -> Iterator[Any]:
    path = chromium()
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        made = playwright.chromium.launch(executable_path=path, args=list(_FLAGS))
        try:
            yield made
        finally:
            made.close()


def waited(condition: Callable[[], Any], seconds: float = 15.0) -> Any:
    """What a condition gives once it holds."""
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        found = condition()
        if found:
            return found
        time.sleep(0.05)
    raise AssertionError("it did not come to be")


@dataclass
class Tab:
    """A tab that shows the page, with what it complained of and where it asked."""

    page: Any
    complaints: list[str] = field(default_factory=list)
    asked: set[str] = field(default_factory=set)

    @classmethod
    def open(cls, context: Any, address: str) -> Tab:
        tab = cls(page=context.new_page())
        tab.page.on("console", tab._note)
        tab.page.on("pageerror", lambda error: tab.complaints.append(str(error)))
        tab.page.on("request", lambda request: tab.asked.add(request.url.split("/")[2]))
        tab.page.goto(address)
        tab.page.wait_for_selector("body[data-ready=true]", timeout=30_000)
        return tab

    def _note(self, message: Any) -> None:
        if message.type in ("error", "warning"):
            self.complaints.append(message.text)

    def key(self, *keys: str) -> None:
        """Press keys that are not meant for a field."""
        self.page.evaluate("document.activeElement.blur()")
        for key in keys:
            self.page.keyboard.press(key)

    def open_photo(self, photo: str) -> None:
        self.page.select_option("#photo-choice", photo)
        # The bar names it when the viewer shows it.
        self.page.wait_for_function(
            "id => document.querySelector('#photo-facts').textContent.startsWith(id)", arg=photo
        )

    def click_photo(self, u: float, v: float) -> None:
        """Click a pixel of the open photo with the mouse, seen from close by."""
        self._click("photoview.js", "getViewer", "photo", u, -v)

    def click_map(self, x: float, y: float) -> None:
        """Click a place of the map with the mouse, seen from close by."""
        self._click("mapview.js", "getMap", "map", x, y)

    def _click(self, module: str, getter: str, target: str, x: float, y: float) -> None:
        place = self.page.evaluate(
            """async ([module, getter, target, x, y]) => {
                const viewer = (await import(`/static/${module}`))[getter]();
                viewer.getView().setCenter([x, y]);
                viewer.getView().setResolution(target === "photo" ? 0.25 : 0.1);
                viewer.renderSync();
                const [left, top] = viewer.getPixelFromCoordinate([x, y]);
                const box = document.getElementById(target).getBoundingClientRect();
                return [box.left + left, box.top + top];
            }""",
            [module, getter, target, x, y],
        )
        self.page.mouse.click(*place)

    def draft(self) -> dict[str, Any]:
        """What is being measured, as the page holds it, once the server has answered."""
        told: dict[str, Any] = self.page.evaluate(
            """async () => {
                const { draft } = await import("/static/draft.js");
                return JSON.parse(JSON.stringify(draft));
            }"""
        )
        return told

    def measured(self, vertices: int = 1, rays: int = 1) -> dict[str, Any]:
        """The first point, once so many vertices and rays of it were measured."""
        until = time.monotonic() + 20.0
        while time.monotonic() < until:
            draft = self.draft()
            points = (draft["result"] or {}).get("points", {})
            if len(points) == vertices == len(draft["vertices"]):
                first: dict[str, Any] = points["0"]
                if len(first["rays"]) == rays == len(draft["vertices"][0]["clicks"]):
                    return first
            self.page.wait_for_timeout(50)
        pytest.fail(f"was not measured: {self.draft()}, {self.page.inner_text('#message')}")
