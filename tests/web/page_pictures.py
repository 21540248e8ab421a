"""Take the docs' picture of a click that was found in other photos anew.

    python tests/web/page_pictures.py PROJECT

PROJECT is a finished copy of `sample_project`. What is clicked is what `docs/page.md` says under
the picture; `test_match_call.py` checks that it is found.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

from web_cases import Tab, browser, served

DOCS = Path(__file__).resolve().parents[2] / "docs"
PICTURE = DOCS / "pictures" / "page_found.jpg"
SIZE = {"width": 1280, "height": 760}
_QUALITY = 82


def told_click() -> tuple[str, float, float]:
    """Photo, u and v of the click that the docs tell."""
    found = re.search(r"in (IMG_\d+), at pixel (\d+), (\d+)", (DOCS / "page.md").read_text("utf-8"))
    assert found is not None, "docs/page.md names no click of its picture"
    return found[1], float(found[2]), float(found[3])


def take(project: Path, target: Path) -> None:
    """Click, find, open the best of the photos found, and keep what is seen."""
    photo, u, v = told_click()
    with served(project) as server, browser() as chrome:
        tab = Tab.open(chrome.new_context(viewport=SIZE), server.address)
        tab.open_photo(photo)
        tab.key("p")
        tab.click_photo(u, v)
        place = tab.measured()
        tab.key("g")
        tab.page.wait_for_selector(".proposal input", timeout=60_000)
        tab.page.locator(".proposal .name").first.click()
        tab.page.evaluate(
            """async ([x, y]) => {
                const map = (await import("/static/mapview.js")).getMap();
                map.getView().setCenter([x, y]);
                map.getView().setResolution(0.2);
            }""",
            [place["easting"], place["northing"]],
        )
        tab.page.wait_for_timeout(3000)
        # above the buttons that stay at the panel's foot
        tab.page.locator(".proposal .row button").first.evaluate(
            "button => button.scrollIntoView({ block: 'center' })"
        )
        tab.page.screenshot(path=target, type="jpeg", quality=_QUALITY)
        print(f"{target}: {photo} ({u:g}, {v:g}) px found in "
              f"{tab.page.locator('.proposal input').count()} photos")  # fmt: skip


if __name__ == "__main__":
    take(Path(sys.argv[1]), PICTURE)
