"""The page in a real Chromium: clicks against the truth, two tabs, a locked file, runs of tools."""

from __future__ import annotations

import json
import sqlite3
from pathlib import Path
from typing import Any

import pytest
from web_cases import Served, Tab, true_control, true_objects, true_pixels, waited

pytestmark = pytest.mark.slow
# m
FOOT = 1200.0 / 3937.0
NAME = "<img src=x onerror=\"document.title='owned'\"><b>bold</b>"


def off_by_sigma(point: dict[str, Any], truth: dict[str, float]) -> tuple[float, float]:
    """Error over sigma along east and north."""
    off_e = (point["easting"] - truth["x"]) * FOOT / point["sigma_e_m"]
    off_n = (point["northing"] - truth["y"]) * FOOT / point["sigma_n_m"]
    return off_e, off_n


# -- measuring -----------------------------------------------------------------------------------


def test_a_click_on_an_object_finds_its_true_place(tab: Tab) -> None:
    point = true_control("P04")
    pixels = true_pixels("P04")
    photo = sorted(pixels)[0]
    tab.open_photo(photo)
    tab.key("p")
    tab.click_photo(*pixels[photo])
    found = tab.measured()
    assert found["method"] == "locate"
    # 3.3 sigma: one true place in a thousand lies farther off on an axis
    assert max(map(abs, off_by_sigma(found, point))) < 3.3
    assert 0.005 < found["sigma_e_m"] < 0.5


def test_clicks_in_several_photos_are_intersected_and_a_wrong_one_is_left_out(tab: Tab) -> None:
    point, pixels = true_control("P04"), true_pixels("P04")
    photos = sorted(pixels)[:4]
    tab.key("p")
    for number, photo in enumerate(photos):
        u, v = pixels[photo]
        tab.open_photo(photo)
        # 12 px, far beyond the half pixel of a click
        tab.click_photo(u + 12.0 * (number == 2), v)
        found = tab.measured(rays=number + 1)
    assert found["method"] == "intersect"
    assert [ray["photo"] for ray in found["rays"] if not ray["used"]] == [photos[2]]
    assert max(map(abs, off_by_sigma(found, point))) < 3.3
    assert "left out" in tab.page.inner_text("#panel-measure")
    assert "does not fit" in tab.page.inner_text("#panel-measure")


def test_a_guide_line_shows_where_to_click_in_another_photo(tab: Tab) -> None:
    pixels = true_pixels("P04")
    first, second = sorted(pixels)[:2]
    tab.open_photo(first)
    tab.key("p")
    tab.click_photo(*pixels[first])
    tab.measured()
    tab.open_photo(second)
    off = waited(lambda: tab.page.evaluate(
        """async ([u, v]) => {
            const viewer = (await import("/static/photoview.js")).getViewer();
            const lines = viewer.getLayers().getArray()
                .flatMap((layer) => layer.getSource()?.getFeatures?.() ?? [])
                .map((feature) => feature.getGeometry())
                .filter((geometry) => geometry.getType() === "LineString");
            if (!lines.length) return null;
            const [x, y] = lines[0].getClosestPoint([u, -v]);
            return [Math.hypot(x - u, y + v)];
        }""",
        list(pixels[second]),
    ))  # fmt: skip
    # px: half a pixel of pose and camera, and what is left of the straight pieces of the line
    assert off[0] < 2.0


def test_a_click_on_the_mosaic_finds_the_object_there(tab: Tab) -> None:
    cone = true_objects("cone")[4]
    tab.key("p")
    tab.click_map(cone["x"], cone["y"])
    found = tab.measured()
    # 0.1 CRS units per pixel of the screen, half of which a click may be off; m
    assert abs(found["easting"] - cone["x"]) * FOOT < 0.03
    assert abs(found["northing"] - cone["y"]) * FOOT < 0.03
    assert found["sigma_e_m"] > 0.005


def test_the_width_between_two_true_points_comes_with_a_sigma_that_holds(tab: Tab) -> None:
    photo = next(p for p in sorted(true_pixels("P07")) if p in true_pixels("P08"))
    tab.open_photo(photo)
    tab.key("l")
    tab.click_photo(*true_pixels("P07")[photo])
    tab.click_photo(*true_pixels("P08")[photo])
    tab.measured(vertices=2)
    lengths = waited(lambda: tab.draft()["result"]["lengths"])
    a, b = (true_control(name) for name in ("P07", "P08"))
    true = (((a["x"] - b["x"]) ** 2 + (a["y"] - b["y"]) ** 2) ** 0.5) * FOOT
    grid = lengths["grid"]
    assert abs(grid["value"] - true) / grid["sigma"] < 3.3
    assert "±" in tab.page.inner_text(".result .value")


def test_the_sky_is_told_in_words(tab: Tab) -> None:
    tab.key("p")
    extent = tab.page.evaluate("async () => (await import('/static/store.js')).state.facts.extent")
    # 30 m beside the photos
    tab.click_map(extent[0] - 100.0, extent[1] - 100.0)
    message = waited(lambda: tab.page.inner_text("#message"))
    assert "no photo shows" in message or "not known there" in message
    # told by a status of 400, which the console notes
    tab.complaints.clear()


def test_a_point_is_measured_without_a_mouse(tab: Tab) -> None:
    tab.open_photo("IMG_0004")
    tab.key("p")
    tab.page.focus("#photo")
    tab.page.keyboard.press("ArrowRight")
    tab.page.keyboard.press("Enter")
    assert tab.measured()["rays"][0]["photo"] == "IMG_0004"
    tab.page.focus("#map")
    tab.key("n")
    tab.page.focus("#map")
    tab.page.keyboard.press("Enter")
    assert tab.measured()["method"] == "locate"


# -- assets --------------------------------------------------------------------------------------


def store_point(tab: Tab, name: str, at: tuple[float, float] = (600.0, 400.0)) -> None:
    tab.open_photo("IMG_0004")
    tab.key("p")
    tab.click_photo(*at)
    tab.measured()
    tab.page.select_option("#panel-measure select.kind", "cone")
    tab.page.fill("#panel-measure input[type=text] >> nth=0", name)
    tab.page.keyboard.press("Control+Enter")
    waited(lambda: tab.page.inner_text("#message").endswith("stored"))


def test_script_in_a_name_shows_as_text(tab: Tab) -> None:
    store_point(tab, NAME)
    assert tab.page.inner_text("#panel-assets h2 >> nth=0") == NAME
    tab.key("t")
    cell = tab.page.locator("#tableside td", has_text="onerror").first
    assert cell.inner_text() == NAME
    tab.key("t")
    assert "owned" not in tab.page.title()
    assert tab.page.locator("img[src=x]").count() == 0


def test_two_tabs_that_edit_one_asset_lose_nothing(
    shown: tuple[Path, Served, Any], tab: Tab
) -> None:
    _, running, context = shown
    store_point(tab, "shared", (500.0, 300.0))
    other = Tab.open(context, running.address)
    try:
        field = "#panel-assets input[type=text] >> nth=0"
        chosen = tab.page.evaluate(
            "async () => (await import('/static/store.js')).state.selected.id"
        )
        other.page.evaluate(
            "async id => (await import('/static/store.js')).select('asset', id)", chosen
        )
        other.page.fill(field, "theirs")
        tab.page.fill(field, "mine")
        other.page.get_by_role("button", name="Save changes").click()
        waited(lambda: "saved" in other.page.inner_text("#message"))
        warning = waited(lambda: tab.page.locator("#panel-assets .bad").all_inner_texts())
        assert "theirs" in warning[0]
        # what was typed here is still here, and is stored when that is wanted
        assert tab.page.input_value(field) == "mine"
        tab.page.get_by_role("button", name="Keep mine").click()
        waited(lambda: "saved" in tab.page.inner_text("#message"))
        names = assets(shown[0])
        assert "mine" in names
        # the edit of the other tab is in the history
        tab.key("Control+z")
        waited(lambda: "theirs" in assets(shown[0]))
        assert other.complaints == []
    finally:
        other.page.close()


def assets(site: Path) -> list[str]:
    with sqlite3.connect(site / "assets.gpkg") as file:
        return [row[0] for row in file.execute("SELECT name FROM asset_points")]


def test_a_locked_file_of_assets_is_told_and_nothing_is_lost(
    shown: tuple[Path, Served, Any], tab: Tab
) -> None:
    store_point(tab, "first", (300.0, 300.0))
    before = assets(shown[0])
    gis = sqlite3.connect(shown[0] / "assets.gpkg", isolation_level=None)
    try:
        # as QGIS does while it saves, for longer than is waited
        gis.execute("BEGIN EXCLUSIVE")
        tab.key("p")
        tab.click_photo(400.0, 300.0)
        tab.measured()
        tab.page.fill("#panel-measure input[type=text] >> nth=0", "second")
        tab.page.keyboard.press("Control+Enter")
        message = waited(lambda: "assets.gpkg" in tab.page.inner_text("#message") and
                         tab.page.inner_text("#message"), 30.0)  # fmt: skip
        assert "held by another program" in message
        # the click and the name wait for another try
        assert len(tab.draft()["vertices"]) == 1
        assert tab.page.input_value("#panel-measure input[type=text] >> nth=0") == "second"
    finally:
        gis.execute("ROLLBACK")
        gis.close()
    tab.page.keyboard.press("Control+Enter")
    waited(lambda: "second" in assets(shown[0]))
    assert [name for name in assets(shown[0]) if name != "second"] == before
    # refusals are noted by the browser's console
    tab.complaints.clear()


# -- control, tools, report ----------------------------------------------------------------------


def test_a_control_point_is_marked_by_a_click(shown: tuple[Path, Served, Any], tab: Tab) -> None:
    marks = shown[0] / "control" / "marks.csv"
    before = marks.read_text()
    pixels = true_pixels("P04")
    photo = sorted(pixels)[0]
    tab.key("4")
    tab.page.get_by_label("Choose P04", exact=True).click()
    tab.page.get_by_role("button", name="Mark in photos").click()
    tab.open_photo(photo)
    tab.click_photo(pixels[photo][0] + 1.0, pixels[photo][1])
    waited(lambda: "marked in" in tab.page.inner_text("#message"))
    changed = [line for line in marks.read_text().splitlines() if line not in before.splitlines()]
    assert len(changed) == 1
    name, named, u, v, _ = changed[0].split(",")
    assert (name, Path(named).stem) == ("P04", photo)
    # px: a quarter of one pixel of the screen at four to one
    assert abs(float(u) - pixels[photo][0] - 1.0) < 0.3
    assert abs(float(v) - pixels[photo][1]) < 0.3
    assert (marks.parent / "marks.csv.bak").read_text() == before


def test_a_tool_runs_from_its_form_and_tells_what_it_wrote(
    shown: tuple[Path, Served, Any], tab: Tab
) -> None:
    tab.key("5")
    tab.page.get_by_role("button", name="Where to click control points").click()
    tab.page.get_by_label("Photos per point, 0 = all").fill("1")
    tab.page.get_by_role("button", name="Run", exact=True).click()
    waited(lambda: "done" in tab.page.inner_text("#panel-tools h2 >> nth=0"), 60.0)
    assert "where_to_click.csv" in tab.page.inner_text(".log")
    rows = (shown[0] / "products" / "where_to_click.csv").read_text().splitlines()
    # a header, and the best photo of each of 12 points
    assert len(rows) == 13


def test_a_tool_can_be_cancelled(shown: tuple[Path, Served, Any], tab: Tab) -> None:
    tab.key("5")
    tab.page.get_by_role("button", name="Make the products").click()
    tab.page.get_by_label("Run steps that are up to date too").check()
    tab.page.get_by_role("button", name="Run", exact=True).click()
    waited(lambda: "%" in tab.page.inner_text("#panel-tools .note >> nth=0"), 60.0)
    # the page answers while a tool works
    tab.key("p")
    tab.open_photo("IMG_0004")
    tab.click_photo(600.0, 400.0)
    tab.measured()
    tab.key("5")
    tab.page.get_by_role("button", name="Cancel").click()
    waited(lambda: "cancelled" in tab.page.inner_text("#panel-tools h2 >> nth=0"), 60.0)
    with sqlite3.connect(shown[0] / "georef.gpkg") as file:
        last = file.execute("SELECT outcome FROM run ORDER BY fid DESC LIMIT 1").fetchone()
    # done: it may have been stopped between two tools
    assert last[0] in ("cancelled", "done")


def test_the_report_is_shown_and_runs_nothing(tab: Tab) -> None:
    tab.page.click("#report-button")
    frame = tab.page.locator("#report iframe").element_handle().content_frame()
    frame.wait_for_selector("text=The report")
    assert frame.title() == "r"
    # its script was blocked, and the browser says so
    assert all("script" in text.lower() for text in tab.complaints)
    tab.complaints.clear()


def test_help_lists_the_keys_that_work(tab: Tab) -> None:
    tab.key("?")
    text = tab.page.inner_text("#help")
    for key in ("Ctrl Enter", "Backspace", "Arrow keys"):
        assert key in text
    tab.page.keyboard.press("Escape")
    assert not tab.page.is_visible("#help")


# -- looks ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("size", [(1280, 720), (1920, 1080), (800, 720), (420, 860)])
def test_no_text_is_cut_off(
    shown: tuple[Path, Served, Any], tab: Tab, size: tuple[int, int]
) -> None:
    tab.page.set_viewport_size({"width": size[0], "height": size[1]})
    tab.key("o", "l")
    tab.open_photo("IMG_0004")
    tab.click_photo(400.0, 400.0)
    tab.click_photo(900.0, 500.0)
    tab.measured(vertices=2)
    for key in ("1", "2", "3", "4", "5"):
        tab.key(key)
        tab.page.wait_for_timeout(150)
        cut: list[str] = tab.page.evaluate(
            """() => [...document.querySelectorAll(
                "header *, #panel *, #photo-bar *, footer *")]
              .filter((one) => one.offsetParent && one.tagName !== "SELECT"
                && one.closest("[hidden]") === null
                && (one.getBoundingClientRect().right > document.body.clientWidth + 1
                  || getComputedStyle(one).overflowX !== "auto"
                  && one.scrollWidth > one.clientWidth + 1 && one.clientWidth > 0
                  || one.closest("#panel") && one.getBoundingClientRect().right
                    > document.getElementById("panel").getBoundingClientRect().right + 1))
              .map((one) => `${one.tagName}.${one.className}: ${one.textContent.slice(0, 60)}`)"""
        )
        assert cut == [], key
        wide = tab.page.evaluate("document.documentElement.scrollWidth")
        assert wide <= size[0], key


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_text_stands_out_from_its_ground(tab: Tab, scheme: str) -> None:
    """Contrast of 4.5 to 1, as WCAG 2.2 asks of text of this size."""
    tab.page.emulate_media(color_scheme=scheme)
    for key in ("1", "2", "3", "4", "5"):
        tab.key(key)
        tab.page.wait_for_timeout(200)
        poor: list[Any] = tab.page.evaluate(CONTRAST)
        assert poor == [], json.dumps(poor)[:500]


CONTRAST = """() => {
  const numbers = (text) => (text.match(/[\\d.]+/g) ?? []).map(Number);
  const light = ([r, g, b]) => {
    const [x, y, z] = [r, g, b].map((c) => c / 255)
      .map((c) => (c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4));
    return 0.2126 * x + 0.7152 * y + 0.0722 * z;
  };
  const ground = (one) => {
    for (let at = one; at; at = at.parentElement) {
      const colour = numbers(getComputedStyle(at).backgroundColor);
      if (colour.length === 3 || colour[3] > 0.8) return colour;
    }
    return [255, 255, 255];
  };
  return [...document.querySelectorAll("header *, #panel *, #photo-bar *, footer *")]
    .filter((one) => one.offsetParent && !one.disabled
      && [...one.childNodes].some((node) => node.nodeType === 3 && node.data.trim()))
    .map((one) => {
      const [a, b] = [light(numbers(getComputedStyle(one).color)), light(ground(one))];
      return [one.textContent.slice(0, 40), (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05)];
    })
    .filter(([, ratio]) => ratio < 4.5);
}"""


def test_every_control_has_a_name(tab: Tab) -> None:
    for key in ("1", "2", "3", "4", "5"):
        tab.key(key)
        tab.page.wait_for_timeout(200)
        nameless: list[str] = tab.page.evaluate(
            """() => [...document.querySelectorAll("button, select, input, textarea")]
              .filter((one) => one.offsetParent && !one.textContent.trim()
                && !one.getAttribute("aria-label") && !one.labels?.length)
              .map((one) => one.outerHTML.slice(0, 120))"""
        )
        assert nameless == [], key
