"""What the page says in time: no class by itself, things stored already, a report that is older."""

from __future__ import annotations

import sqlite3
import time
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from web_cases import Served, Tab, served, true_pixels, waited

from georef_gis.app import cli

pytestmark = pytest.mark.slow


def names(site: Path, layer: str) -> list[str]:
    file = site / "assets.gpkg"
    if not file.is_file():
        return []
    with sqlite3.connect(file) as database:
        return [row[0] for row in database.execute(f"SELECT name FROM asset_{layer}")]


def store_cone(tab: Tab, photo: str, at: tuple[float, float], name: str) -> None:
    tab.open_photo(photo)
    tab.key("p")
    tab.click_photo(*at)
    tab.measured()
    tab.page.select_option("#panel-measure select.kind", "cone")
    tab.page.fill("#panel-measure input[type=text] >> nth=0", name)
    tab.page.keyboard.press("Control+Enter")
    waited(lambda: "Cone stored" in tab.page.inner_text("#message"))


def test_no_class_is_stored_that_nobody_chose(shown: tuple[Path, Served, Any], tab: Tab) -> None:
    tab.open_photo("IMG_0004")
    tab.key("l")
    tab.click_photo(500.0, 400.0)
    tab.click_photo(700.0, 420.0)
    tab.measured(vertices=2)
    assert tab.page.input_value("#panel-measure select.kind") == ""
    tab.key("Control+Enter")
    # the form asks for it
    waited(lambda: tab.page.evaluate("document.activeElement.classList.contains('kind')"))
    assert names(shown[0], "lines") == []
    tab.page.select_option("#panel-measure select.kind", "lane_edge")
    tab.page.keyboard.press("Control+Enter")
    waited(lambda: len(names(shown[0], "lines")) == 1)
    # the last one of a shape is proposed for the next, and for no other shape
    tab.key("l")
    tab.click_photo(500.0, 450.0)
    waited(lambda: tab.page.input_value("#panel-measure select.kind") == "lane_edge")
    tab.key("a")
    tab.click_photo(500.0, 450.0)
    waited(lambda: tab.page.input_value("#panel-measure select.kind") == "")


def test_what_is_clicked_while_an_asset_is_stored_is_of_the_next_one(
    shown: tuple[Path, Served, Any], tab: Tab
) -> None:
    stored = len(names(shown[0], "lines"))

    def slow(route: Any) -> None:
        time.sleep(1.0)
        route.continue_()

    tab.page.route("**/add_asset", slow)
    tab.open_photo("IMG_0004")
    tab.key("l")
    tab.click_photo(500.0, 300.0)
    tab.click_photo(700.0, 320.0)
    tab.measured(vertices=2)
    tab.page.select_option("#panel-measure select.kind", "lane_edge")
    tab.page.keyboard.press("Control+Enter")
    tab.key("a")
    tab.click_photo(500.0, 350.0)
    waited(lambda: len(names(shown[0], "lines")) == stored + 1)
    # an area that begins with this click, of no class yet
    tab.measured(vertices=1)
    assert tab.page.input_value("#panel-measure select.kind") == ""


def hint(tab: Tab) -> str:
    return " ".join(tab.page.locator("#panel-measure .alike").all_inner_texts())


def test_what_is_stored_already_is_said_and_can_be_stored_all_the_same(
    shown: tuple[Path, Served, Any], tab: Tab
) -> None:
    pixels = true_pixels("P04")
    first, second = sorted(pixels)[:2]
    u, v = pixels[first]
    store_cone(tab, first, (u, v), "there")
    tab.key("p")
    # 3 px beside it in the same photo
    tab.click_photo(u + 3.0, v)
    tab.measured()
    assert waited(lambda: "“there”" in hint(tab))
    assert "is stored here already" in tab.page.inner_text("#message")
    # of another class it is another thing
    tab.page.select_option("#panel-measure select.kind", "drum")
    waited(lambda: hint(tab) == "")
    # 25 px beside it the photo shows another thing, whatever the sigmas
    tab.page.select_option("#panel-measure select.kind", "cone")
    tab.key("n")
    tab.click_photo(u + 25.0, v)
    tab.measured()
    tab.page.wait_for_timeout(200)
    assert hint(tab) == ""
    # in another photo the places are compared
    tab.key("n")
    tab.open_photo(second)
    tab.click_photo(*pixels[second])
    tab.measured()
    waited(lambda: "“there”" in hint(tab))
    tab.page.fill("#panel-measure input[type=text] >> nth=0", "twice")
    tab.page.keyboard.press("Control+Enter")
    waited(lambda: {"there", "twice"} <= set(names(shown[0], "points")))


@pytest.mark.parametrize(
    ("resolution", "words"),
    [(0.0125, "1 m"), (0.00625, "50 cm"), (1.0, "100 m"), (20.0, "2 km"), (0.0001, "1 cm")],
)
def test_the_scale_bar_says_metres_as_people_do(tab: Tab, resolution: float, words: str) -> None:
    told = tab.page.evaluate(
        """async resolution => {
            const map = (await import("/static/mapview.js")).getMap();
            const { state } = await import("/static/store.js");
            map.getView().setMinResolution?.(1e-9);
            const view = new ol.View({ projection: map.getView().getProjection(),
                center: map.getView().getCenter(), minResolution: 1e-9, maxResolution: 1e9,
                resolution: resolution / state.facts.crs.metres_per_unit });
            map.setView(view);
            map.renderSync();
            const bar = document.querySelector(".ol-scale-line-inner");
            return [bar.textContent, bar.getBoundingClientRect().width];
        }""",
        resolution,
    )
    assert told[0] == words
    # px: one round step is at most 2.5 times the one before
    assert 79.0 <= told[1] <= 202.0


def test_a_small_window_leaves_room_for_the_work(shown: tuple[Path, Served, Any], tab: Tab) -> None:
    tab.page.set_viewport_size({"width": 1024, "height": 600})
    store_cone(tab, "IMG_0004", (300.0, 500.0), "a name " * 5)
    tab.key("t")

    def height(selector: str) -> float:
        found: float = tab.page.locator(selector).first.bounding_box()["height"]
        return found

    # px: one row of buttons, of cells
    assert height("header") < 55.0
    assert height("#photo-bar") < 45.0
    assert height("#tableside tbody tr") < 30.0
    tab.key("t", "p")
    # what is asked for is seen, not hidden behind the buttons
    tab.key("l")
    tab.click_photo(500.0, 400.0)
    tab.click_photo(700.0, 420.0)
    tab.measured(vertices=2)
    # what comes late would push the form down
    tab.page.wait_for_selector("#panel-measure .sights button")
    tab.page.evaluate("document.querySelector('#panel-measure select.kind').value = ''")
    tab.key("Control+Enter")
    tab.page.wait_for_timeout(300)
    box = tab.page.locator("#panel-measure select.kind").bounding_box()
    actions = tab.page.locator("#panel-measure .actions").bounding_box()
    assert box["y"] + box["height"] < actions["y"]


def choose_export(tab: Tab) -> None:
    tab.key("5")
    tab.page.fill("input[type=search]", "geojson")
    tab.page.get_by_role("button", name="Export GeoJSON").click()


def test_layers_to_export_are_a_list_in_which_one_can_type_another(
    shown: tuple[Path, Served, Any], tab: Tab
) -> None:
    choose_export(tab)
    layer = tab.page.get_by_label("Layer", exact=True)
    offered = layer.locator("option").all_inner_texts()
    assert {"photos", "footprints", "assets"} <= set(offered)
    assert offered[0] == "as set: photos"
    layer.select_option("footprints")
    tab.page.get_by_label("File to write").fill("products/prints.geojson")
    tab.page.get_by_role("button", name="Run", exact=True).click()
    waited(lambda: "done" in tab.page.inner_text("#message"), 60.0)
    assert '"Polygon"' in (shown[0] / "products" / "prints.geojson").read_text()
    layer.select_option("another …")
    other = tab.page.get_by_label("Layer: another")
    other.fill("no-such-layer")
    tab.page.get_by_role("button", name="Run", exact=True).click()
    waited(lambda: "failed" in tab.page.inner_text("#message"), 60.0)
    assert "no-such-layer" in tab.page.inner_text("#panel-tools .log")


@pytest.mark.usefixtures("pictures_undrawn")
def test_a_report_that_is_older_than_the_assets_says_so_and_is_made_again(
    site: Path, chrome: Any
) -> None:
    # by the tool, as the report of the other tests is a stand-in
    done = CliRunner().invoke(cli.georef, ["report", "--project", str(site)])
    assert done.exit_code == 0, done.output
    with served(site) as running:
        look_at_the_report(chrome, running)


def look_at_the_report(chrome: Any, running: Served) -> None:
    context = chrome.new_context(viewport={"width": 1024, "height": 600})
    tab = Tab.open(context, running.address)
    button = tab.page.locator("#report-button")
    classes = "document.querySelector('#report-button').className"
    assert "older" not in tab.page.evaluate(classes)
    store_cone(tab, "IMG_0004", (600.0, 400.0), "new")
    waited(lambda: "older" in tab.page.evaluate(classes))
    button.click()
    assert "older than your last edits of assets" in tab.page.inner_text("#report .hintbar")
    tab.page.get_by_role("button", name="Make it again").click()
    waited(lambda: "older" not in tab.page.evaluate(classes), 90.0)
    waited(lambda: not tab.page.locator("#report .hintbar").is_visible())
    frame = tab.page.frame_locator("#report iframe")
    waited(lambda: frame.get_by_text("Assets by class").first.is_visible())
    assert tab.complaints == []
    context.close()
