"""Take the docs' pictures of the page anew.

    python tests/web/page_pictures.py PROJECT

PROJECT is a finished copy of `sample_project`. What is clicked for `page_found.jpg` is what
`docs/page.md` says under the picture; `test_match_call.py` checks that it is found.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from web_cases import Tab, browser, served, true_pixels

DOCS = Path(__file__).resolve().parents[2] / "docs"
FOLDER = DOCS / "pictures"
SIZE = {"width": 1280, "height": 760}
_QUALITY = 82
_LOOK = """async ([module, getter, x, y, resolution]) => {
    const view = (await import(`/static/${module}`))[getter]().getView();
    view.setCenter([x, y]);
    view.setResolution(resolution);
}"""


def told_click() -> tuple[str, float, float]:
    """Photo, u and v of the click that the docs tell."""
    found = re.search(r"in (IMG_\d+), at pixel (\d+), (\d+)", (DOCS / "page.md").read_text("utf-8"))
    assert found is not None, "docs/page.md names no click of its picture"
    return found[1], float(found[2]), float(found[3])


def take_found(tab: Tab) -> None:
    """Click, find, open the best of the photos found."""
    photo, u, v = told_click()
    tab.open_photo(photo)
    tab.key("p")
    tab.click_photo(u, v)
    place = tab.measured()
    tab.key("g")
    tab.page.wait_for_selector(".proposal input", timeout=60_000)
    tab.page.locator(".proposal .name").first.click()
    look_at_map(tab, place, 0.2)
    tab.page.wait_for_timeout(1000)
    # above the buttons that stay at the panel's foot
    tab.page.locator(".proposal .row button").first.evaluate(
        "button => button.scrollIntoView({ block: 'center' })"
    )


def take_point(tab: Tab) -> None:
    """Click a target in three photos, and open a fourth where it is predicted."""
    pixels = true_pixels("P04")
    tab.key("p")
    for number, photo in enumerate(("IMG_0002", "IMG_0003", "IMG_0006")):
        tab.open_photo(photo)
        tab.click_photo(*pixels[photo])
        place = tab.measured(rays=number + 1)
    tab.open_photo("IMG_0007")
    look_at_map(tab, place, 0.35)
    u, v = pixels["IMG_0007"]
    tab.page.evaluate(_LOOK, ["photoview.js", "getViewer", u, -v, 0.4])


def take_line(tab: Tab) -> None:
    """Click both edges of the road in one photo."""
    tab.open_photo("IMG_0004")
    tab.key("l")
    tab.click_photo(266.0, 600.0)
    tab.click_photo(454.0, 600.0)
    place = tab.measured(vertices=2)
    look_at_map(tab, place, 0.2)
    tab.page.evaluate(_LOOK, ["photoview.js", "getViewer", 330.0, -560.0, 0.6])


def look_at_map(tab: Tab, place: dict[str, Any], resolution: float) -> None:
    """Show a place in the middle of the map; a resolution in its unit per pixel."""
    centre = [place["easting"], place["northing"]]
    tab.page.evaluate(_LOOK, ["mapview.js", "getMap", *centre, resolution])


PICTURES: dict[str, Callable[[Tab], None]] = {
    "page_point.jpg": take_point, "page_found.jpg": take_found, "page_line.jpg": take_line,
}  # fmt: skip


def take(project: Path, folder: Path) -> None:
    """Take all pictures of a project's page."""
    with served(project) as server, browser() as chrome:
        for name, act in PICTURES.items():
            # drafts of one must not be seen in the next
            tab = Tab.open(chrome.new_context(viewport=SIZE), server.address)
            act(tab)
            # tiles are fetched
            tab.page.wait_for_timeout(3000)
            assert tab.complaints == [], tab.complaints
            tab.page.screenshot(path=folder / name, type="jpeg", quality=_QUALITY)
            tab.page.close()
            print(folder / name)


if __name__ == "__main__":
    take(Path(sys.argv[1]), FOLDER)
