"""Tool `assets`: what is said to lie on the ground is measured so, stored so, measured again so."""

from __future__ import annotations

import csv
from collections import Counter
from pathlib import Path

import pytest
from tool_cases import SAMPLE, Site, georef
from work_zone_cases import clicks_csv, copied, posed_site

from georef_gis.measure.assets.asset import Asset
from georef_gis.measure.assets.store import AssetStore
from georef_gis.project import Project


@pytest.fixture(scope="module")
def ready(tmp_path_factory: pytest.TempPathFactory) -> Site:
    folder = tmp_path_factory.mktemp("ground")
    return copied(posed_site(folder / "posed"), folder / "site")


def stored(site: Site) -> Asset:
    with AssetStore.of_project(Project.open(site.folder)) as store:
        (asset,) = store.assets()
    return asset


def test_a_cone_on_the_ground_stays_there_when_it_is_measured_again(ready: Site) -> None:
    text = clicks_csv(SAMPLE / "truth", photos=[path.name for path in ready.photos])
    head, *rows = text.splitlines()
    counts = Counter(row.split(",")[0] for row in rows if ",cone," in row)
    name = next(name for name, count in counts.items() if count == 2)
    lines = [head, *(row for row in rows if row.startswith(f"{name},"))]
    found = []
    for word in ("", "on"):
        path = ready.folder / "clicks.csv"
        path.write_text("\n".join([f"{lines[0]},ground", *(f"{k},{word}" for k in lines[1:])]))
        done = georef("assets", "--project", ready.folder, "--clicks", path, "--click", 0.7)
        assert done.code == 0, done.text
        found.append(stored(ready))
    free, on = (one.quality for one in found)
    assert free is not None
    assert on is not None
    assert (free.method, on.method) == ("intersect", "intersect_ground")
    assert on.semi_major is not None
    assert free.semi_major is not None
    assert on.semi_major <= free.semi_major
    assert {(click.on_ground, click.sigma_px) for click in on.clicks} == {(True, 0.7)}
    # --click says nothing of clicks that know how good they are
    assert georef("assets", "--project", ready.folder, "--remeasure").code == 0
    again = stored(ready).quality
    assert again is not None
    assert again.method == on.method
    assert again.clicks == on.clicks
    assert again.semi_major == pytest.approx(on.semi_major, rel=1e-9)
    (row,) = table(ready.products / "assets.csv")
    assert (row["method"], row["sigma_px"]) == ("intersect_ground", "0.7;0.7")


def table(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))
