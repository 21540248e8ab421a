"""The page: what lies on the ground is said so, measured so, stored so and opened so again."""

from __future__ import annotations

from pathlib import Path

import pytest
from web_cases import Served, Tab, true_pixels, waited

from georef_gis.measure.assets.store import AssetStore
from georef_gis.project import Project

pytestmark = pytest.mark.slow
SAID = "Clicked on the ground"


def test_a_target_is_said_to_lie_on_the_ground(
    shown: tuple[Path, Served, object], tab: Tab
) -> None:
    pixels = sorted(true_pixels("P04").items())[:2]
    tab.key("p")
    for k, (photo, (u, v)) in enumerate(pixels):
        assert not tab.page.get_by_label(SAID).count()
        tab.open_photo(photo)
        tab.click_photo(u, v)
        free = tab.measured(rays=k + 1)
    assert free["method"] == "intersect"
    assert "0.5" in tab.page.locator(".result", has_text="Clicks").inner_text()
    tab.page.get_by_label(SAID).check()
    waited(lambda: "and the ground" in tab.page.inner_text("#panel-measure"))
    both = tab.measured(rays=2)
    assert both["method"] == "intersect_ground"
    for axis in ("sigma_e_m", "sigma_n_m", "sigma_u_m"):
        assert both[axis] <= free[axis]
    assert both["sigma_u_m"] < 0.95 * free["sigma_u_m"]
    tab.page.select_option("#panel-measure select.kind", "point")
    tab.page.keyboard.press("Control+Enter")
    waited(lambda: not tab.draft()["vertices"])
    with AssetStore.of_project(Project.open(shown[0])) as store:
        asset = store.assets()[-1]
    assert asset.quality is not None
    assert asset.quality.method == "intersect_ground"
    assert [(c.on_ground, c.sigma_px) for c in asset.quality.clicks] == [(True, 0.5)] * 2
    # the next thing lies on the ground too, until one says otherwise
    tab.click_photo(*pixels[1][1])
    tab.measured()
    # of one click alone nothing is asked: it is gone then
    tab.page.get_by_label(SAID).click()
    waited(lambda: not tab.page.get_by_label(SAID).count())
