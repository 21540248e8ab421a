"""Work in the page that goes wrong or is helped: near things, found clicks, a server that stops."""

from __future__ import annotations

import contextlib
import io
import shutil
import sqlite3
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image
from web_cases import SAMPLE, Served, Tab, opened, served, true_control, true_pixels, waited

from georef_gis.app import cli

pytestmark = pytest.mark.slow
# m
FOOT = 1200.0 / 3937.0


def place_on_screen(tab: Tab, photo: str) -> tuple[float, float]:
    """Where the map shows the place that a photo was taken from."""
    at: list[float] = tab.page.evaluate(
        """async (id) => {
            const map = (await import("/static/mapview.js")).getMap();
            const point = map.getLayers().getArray()
                .map((layer) => layer.getSource()?.getFeatureById?.(id))
                .find((one) => one?.getGeometry().getType() === "Point");
            const [x, y] = map.getPixelFromCoordinate(point.getGeometry().getCoordinates());
            const box = document.getElementById("map").getBoundingClientRect();
            return [box.left + x, box.top + y];
        }""",
        photo,
    )
    return at[0], at[1]


def test_the_name_of_one_thing_does_not_hide_another(tab: Tab) -> None:
    """The photo point of IMG_0004 lies below the name of control point P08."""
    tab.page.mouse.click(*place_on_screen(tab, "IMG_0004"))
    waited(lambda: tab.page.inner_text("#photo-facts").startswith("IMG_0004"))


# -- found clicks --------------------------------------------------------------------------------


def test_a_click_is_found_in_other_photos_and_taken_where_it_is_accepted(
    shown: tuple[Path, Served, Any], tab: Tab
) -> None:
    pixels = true_pixels("P04")
    photo = sorted(pixels)[0]
    tab.open_photo(photo)
    tab.key("p")
    tab.click_photo(*pixels[photo])
    alone = tab.measured()
    tab.key("g")
    tab.page.wait_for_selector(".proposal input", timeout=60_000)
    found = tab.page.locator(".proposal input").count()
    assert found >= 3
    # nothing is taken before somebody has looked at it
    assert len(tab.draft()["vertices"][0]["clicks"]) == 1
    rejected = tab.page.locator(".proposal .name").last.inner_text()
    tab.page.locator(".proposal input").last.uncheck()
    tab.page.get_by_role("button", name=f"Take {found - 1} click").click()
    better = tab.measured(rays=found)
    point = true_control("P04")
    off = np.hypot(better["easting"] - point["x"], better["northing"] - point["y"]) * FOOT
    # m; the photos have 6 cm to the pixel
    assert off < 0.1
    assert better["sigma_u_m"] < alone["sigma_u_m"]
    clicks = tab.draft()["vertices"][0]["clicks"]
    assert rejected not in [click["photo"] for click in clicks]
    for click in clicks[1:]:
        u, v = pixels[click["photo"]]
        # px: they hold the user's own click, which is half a pixel of the screen off
        assert np.hypot(click["u"] - u, click["v"] - v) < 1.5
        assert click["sigma_px"] > 0.0
    tab.key("Backspace")
    assert len(tab.draft()["vertices"][0]["clicks"]) == 1


def test_a_click_that_is_found_nowhere_is_told_in_words(tab: Tab) -> None:
    tab.page.route("**/api/measure/match", nothing_found)
    tab.open_photo("IMG_0004")
    tab.key("p")
    tab.click_photo(600.0, 400.0)
    tab.measured()
    tab.page.get_by_role("button", name="Find it in the other photos").click()
    waited(lambda: tab.page.locator(".proposal").count())
    text = tab.page.inner_text(".proposal")
    assert "no texture <b>here</b>" in text
    tab.page.locator(".proposal summary").click()
    assert "IMG_0005: it is hidden" in tab.page.inner_text(".proposal")
    tab.page.locator(".proposal").get_by_role("button", name="Close").click()
    assert tab.page.locator(".proposal").count() == 0


def nothing_found(route: Any) -> None:
    own = {**route.request.post_data_json["clicks"][0], "sigma_px": 0.5, "matched": False,
           "sigma_match_px": None, "quality": None}  # fmt: skip
    route.fulfill(json={
        "template": None, "clicks": [own], "place": None, "before": None, "doubts": [],
        "refused": [{"photo": "IMG_0005", "why": "it is hidden"}],
        "why_not": "no texture <b>here</b>",
    })  # fmt: skip


# -- what is seen --------------------------------------------------------------------------------


def test_at_one_to_one_each_pixel_is_the_photos_own(tab: Tab) -> None:
    tab.open_photo("IMG_0004")
    tab.page.click("#photo-native")
    tab.page.wait_for_load_state("networkidle")
    left, top, u, v = tab.page.evaluate(
        """async () => {
            const viewer = (await import("/static/photoview.js")).getViewer();
            viewer.getLayers().getArray().slice(1).forEach((layer) => layer.setVisible(false));
            viewer.renderSync();
            const box = document.getElementById("photo").getBoundingClientRect();
            const [x, y] = viewer.getCoordinateFromPixel([80, 120]);
            return [box.left + 80, box.top + 120, x, -y];
        }"""
    )
    clip = {"x": left, "y": top, "width": 300, "height": 200}
    with Image.open(SAMPLE / "photos" / "IMG_0004.JPG") as image:
        photo = np.asarray(image.convert("RGB")).astype(int)
    # The corner of a pixel of the screen may lie on the border of two of the photo.
    starts = [(int(np.round(u)) + i, int(np.round(v)) + k) for i in (-1, 0, 1) for k in (-1, 0, 1)]

    def worst() -> int:
        picture = Image.open(io.BytesIO(tab.page.screenshot(clip=clip))).convert("RGB")
        seen = np.asarray(picture).astype(int)
        return min(int(np.abs(photo[k : k + 200, i : i + 300] - seen).max()) for i, k in starts)

    # tiles may still be on their way
    waited(lambda: worst() == 0)


# -- a server that stops, a project without anything ---------------------------------------------


def test_a_server_that_is_started_anew_goes_on_with_what_was_clicked(
    site: Path, chrome: Any
) -> None:
    context = chrome.new_context(viewport={"width": 1280, "height": 720})
    try:
        with served(site) as first:
            tab = Tab.open(context, first.address)
            tab.open_photo("IMG_0004")
            tab.key("p")
            tab.click_photo(600.0, 400.0)
            tab.measured()
            tab.page.select_option("#panel-measure select.kind", "cone")
        tab.page.keyboard.press("Control+Enter")
        waited(lambda: "does not answer" in tab.page.inner_text("#message"))
        with served(site, "--port", str(first.port)) as second:
            assert second.address != first.address
            tab.page.keyboard.press("Control+Enter")
            waited(lambda: "started anew" in tab.page.inner_text("#message"))
            Tab.open(context, second.address)
            tab.page.keyboard.press("Control+Enter")
            waited(lambda: "stored" in tab.page.inner_text("#message"))
        with sqlite3.connect(site / "assets.gpkg") as file:
            assert file.execute("SELECT count(*) FROM asset_points").fetchone() == (1,)
    finally:
        context.close()


def test_a_project_of_photos_alone_says_what_to_do(tmp_path: Path, chrome: Any) -> None:
    folder = tmp_path / "new"
    for name in ("photos", "control", "logs"):
        shutil.copytree(SAMPLE / name, folder / name)
    for name in ("dem.asc", "dem.prj", "project.toml"):
        shutil.copy(SAMPLE / name, folder)
    context = chrome.new_context(viewport={"width": 1280, "height": 720})
    try:
        with served(folder) as running:
            tab = Tab.open(context, running.address)
            assert tab.page.get_by_role("button", name="Make the products …").is_visible()
            tab.key("p")
            assert "no photo has a pose yet" in tab.page.inner_text("#message")
            for key in ("1", "2", "3", "4", "5", "t", "]", "f", "g", "n"):
                tab.key(key)
                tab.page.wait_for_timeout(150)
            assert tab.page.inner_text("#scale") == ""
            tab.page.click("#report-button")
            assert "no report yet" in tab.page.inner_text("#report")
            assert tab.complaints == []
    finally:
        context.close()


# -- a run that was stopped half-way ---------------------------------------------------------------


def test_poses_that_a_stopped_run_left_without_their_camera_are_not_used(site: Path) -> None:
    click = {"photo": "IMG_0004", "u": 600.0, "v": 400.0}
    with opened(site) as (client, _):
        before = client.post("/api/measure/place", json=click).json()
        photo = client.post("/api/view/photo", json={"photo": "IMG_0004"}).json()
        with contextlib.closing(sqlite3.connect(site / "georef.gpkg")) as file:
            file.execute("DELETE FROM camera WHERE camera_id LIKE '% adjusted'")
            file.execute("INSERT INTO run (tool, outcome) VALUES ('georef:read_photos', 'done')")
            file.commit()
        assert client.post("/api/measure/place", json=click).json() == before
        assert client.post("/api/view/photo", json={"photo": "IMG_0004"}).json() == photo
    with opened(site) as (client, _):
        answer = client.post("/api/measure/place", json=click)
        assert answer.status_code == 400, answer.text
        assert "run `georef run`" in answer.json()["error"]


def test_a_run_that_ends_after_the_photos_were_read_leaves_adjusted_poses_usable(
    site: Path,
) -> None:
    click = {"photo": "IMG_0004", "u": 600.0, "v": 400.0}
    with opened(site) as (client, _):
        before = client.post("/api/measure/place", json=click).json()
    done = CliRunner().invoke(cli.georef, ["run", str(site), "--only", "read_photos", "--force"])
    assert done.exit_code == 0, done.output
    with opened(site) as (client, _):
        answer = client.post("/api/measure/place", json=click)
        assert answer.status_code == 200, answer.text
        assert answer.json() == before
