"""Tool `assets` on the sample project: clicks in, layers, table and pictures out."""

from __future__ import annotations

import csv
import json
import math
import re
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pyogrio
import pytest
from tool_cases import SAMPLE, Site, georef
from work_zone_cases import clicks_csv, copied, ecef, posed_site, true_places

from georef_gis.errors import InputError
from georef_gis.measure.assets.domain import load_domain
from georef_gis.measure.assets.store import AssetStore, Change
from georef_gis.project import Project
from processing_algorithms.assets.asset_clicks import read_clicks

TRUTH = SAMPLE / "truth"


@pytest.fixture(scope="module")
def posed(tmp_path_factory: pytest.TempPathFactory) -> Site:
    return posed_site(tmp_path_factory.mktemp("assets") / "site")


@pytest.fixture
def ready(posed: Site, tmp_path: Path) -> Site:
    """Five photos with the poses of their tags."""
    return copied(posed, tmp_path / "site")


def photos(site: Site) -> list[str]:
    return [path.name for path in site.photos]


def put_clicks(site: Site, text: str) -> Path:
    path = site.folder / "clicks.csv"
    path.write_text(text, encoding="utf-8")
    return path


def table(site: Site) -> list[dict[str, str]]:
    with (site.products / "assets.csv").open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def run(site: Site, *words: object) -> Any:
    return georef("assets", "--project", site.folder, *words)


def test_clicks_become_assets_whose_places_hold_the_truth(ready: Site) -> None:
    path = put_clicks(ready, clicks_csv(TRUTH, photos=photos(ready)))
    done = run(ready, "--clicks", path, "--thumbnails")
    assert done.code == 0, done.text
    layer = pyogrio.read_dataframe(ready.folder / "assets.gpkg", layer="asset_points")
    assert len(layer) == len(table(ready)) > 10
    truth = true_places(TRUTH)
    places = layer.set_geometry(layer.geometry.force_2d()).to_crs(4326)
    for k, row in layer.iterrows():
        point = places.geometry[k]
        offset = ecef(point.y, point.x, layer.geometry[k].z) - truth[row["name"]]
        # 4 sigma of the place; the poses of tags are some metres off, and say so
        sigma = math.hypot(row.sigma_e, row.sigma_n, row.sigma_u)
        assert np.linalg.norm(offset) < 4 * sigma, row["name"]
        assert 0.1 < row.semi_major < 100
        assert row.conf == 0.95
        assert row.n_rays == len(json.loads(row.photo_ids))
        assert row.method == ("intersect" if row.n_rays > 1 else "locate")
        assert (ready.products / "assets" / f"{row.asset_id}.jpg").stat().st_size > 1000
    ellipses = pyogrio.read_dataframe(ready.folder / "assets.gpkg", layer="asset_ellipses")
    assert len(ellipses) == len(layer)


def test_import_is_one_step_and_the_same_table_again_adds_nothing(ready: Site) -> None:
    path = put_clicks(ready, clicks_csv(TRUTH, ["C01", "C02", "C03"], photos=photos(ready)))
    assert run(ready, "--clicks", path).code == 0
    first = table(ready)
    assert run(ready, "--clicks", path).code == 0
    assert [row["asset_id"] for row in table(ready)] == [row["asset_id"] for row in first]
    assert {row["revision"] for row in table(ready)} == {"2"}
    assert "(3 assets" in run(ready, "--undo", 2).line("undo: clicks of clicks.csv")
    assert table(ready) == []
    done = run(ready, "--redo", 5)
    assert "only 2 steps to redo" in done.text
    assert len(table(ready)) == 3


def test_lines_are_measured_by_their_vertices(ready: Site) -> None:
    name = photos(ready)[0]
    path = put_clicks(
        ready,
        "asset,class,photo,u,v,side\n"
        f"edge,lane_edge,{name},300,300,right\nedge,lane_edge,{name},600,400,\n"
        f"edge,lane_edge,{name},900,500,\n",
    )
    assert run(ready, "--clicks", path).code == 0
    (row,) = table(ready)
    assert (row["vertices"], row["method"]) == ("3", "locate")
    assert json.loads(row["attributes"]) == {"side": "right"}
    layer = pyogrio.read_dataframe(ready.folder / "assets.gpkg", layer="asset_lines")
    assert layer.geometry[0].length > 10


def test_clicks_that_show_no_ground_are_told_and_the_rest_is_stored(ready: Site) -> None:
    name = photos(ready)[0]
    path = put_clicks(
        ready,
        f"asset,class,photo,u,v\ngood,cone,{name},600,400\nbad,cone,{name},99999,400\n",
    )
    done = run(ready, "--clicks", path)
    assert done.code == 0
    assert "cone bad is not measured" in done.text
    assert [row["name"] for row in table(ready)] == ["good"]
    put_clicks(ready, f"asset,class,photo,u,v\nbad,cone,{name},99999,400\n")
    done = run(ready, "--clicks", path)
    assert done.code != 0
    assert "none of its 1 assets has a place" in done.text


def test_places_are_measured_again_with_other_poses(ready: Site) -> None:
    path = put_clicks(ready, clicks_csv(TRUTH, ["C01"], photos=photos(ready)))
    run(ready, "--clicks", path)
    with AssetStore.of_project(Project.open(ready.folder)) as store:
        (asset,) = store.assets()
        e, n, h = asset.vertices[0]
        change = Change(vertices=((e + 9.0, n, h),), quality=asset.quality)
        store.change(asset.id, asset.revision, change)
    done = run(ready, "--remeasure")
    assert done.code == 0, done.text
    assert float(table(ready)[0]["easting"]) == pytest.approx(e, abs=1e-3)


def test_odd_rows_of_a_gis_are_told_and_listed(ready: Site) -> None:
    path = put_clicks(ready, clicks_csv(TRUTH, ["C01", "C02"], photos=photos(ready)))
    run(ready, "--clicks", path)
    with closing(sqlite3.connect(ready.folder / "assets.gpkg")) as gis, gis:
        gis.execute("UPDATE asset_points SET class = 'ufo', name = '<b>' WHERE name = 'C01'")
    done = run(ready)
    assert "class 'ufo' is not known" in done.text
    assert {row["name"] for row in table(ready)} == {"<b>", "C02"}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("class,photo,u\ncone,a,1\n", "has no column v"),
        ("class,photo,u,v\n", "holds no clicks"),
        ("class,photo,u,v\ncones,a,1,2\n", "line 2: class: 'cones' is no class of assets"),
        ("class,photo,u,v\ncone,a,x,2\n", "line 2: u: 'x' is not a number"),
        ("class,photo,u,v\ncone,a,,2\n", "the value is missing"),
        ("class,photo,u,v,vertex\nlane_edge,a,1,2,0\n", "0 is no vertex; they count from 1"),
        ("asset,class,photo,u,v,vertex\ne,lane_edge,a,1,2,1\ne,lane_edge,a,1,2,3\n",
         "leave some out"),
        ("asset,class,photo,u,v\ne,cone,a,1,2\ne,drum,a,1,2\n", "is of 2 classes"),
        ("class,photo,u,v,order\ncone,a,1,2,first\n", "order: 'first' is no whole number"),
        ("class,photo,u,v,colour\ncone,a,1,2,red\n", "is no attribute"),
        ("class,photo,u,v\nsign,a,1,2\n", "mutcd_code: is missing"),
        ("class,photo,u,v\nCONE,a,1,2\n", "did you mean 'cone'?"),
        ("class,photo,u,v,line,line\ncone,a,1,2,T1,T2\n", "has two columns 'line'"),
        ("asset,class,photo,u,v\nE1,lane_edge,a,1,2\n", "line 2: lane_edge 'E1' has 1 vertices"),
        ("asset,class,photo,u,v\nA\x01,cone,a,1,2\n", "line 2: holds the control character"),
    ],
)  # fmt: skip
def test_table_that_cannot_be_read_is_refused_in_one_line(
    tmp_path: Path, text: str, words: str
) -> None:
    path = tmp_path / "clicks.csv"
    path.write_text(text)
    with pytest.raises(InputError) as refused:
        read_clicks(path, load_domain())
    assert re.search(re.escape(words), str(refused.value)), refused.value
    assert "\n" not in str(refused.value)


def test_columns_may_be_written_in_capitals_and_semicolons_part_them(tmp_path: Path) -> None:
    path = tmp_path / "clicks.csv"
    path.write_text("\ufeffAsset;Class;Photo;U;V;line\nC1;cone;a;1;2;T1\n", encoding="utf-8")
    (found,) = read_clicks(path, load_domain())
    assert (found.name, found.kind, found.attributes) == ("C1", "cone", {"line": "T1"})


def test_asset_clicked_twice_in_one_photo_is_refused_by_name(ready: Site) -> None:
    photo = photos(ready)[0]
    path = put_clicks(ready, f"asset,class,photo,u,v\nC1,cone,{photo},600,400\n"
                             f"C1,cone,{Path(photo).stem},700,500\n")  # fmt: skip
    done = run(ready, "--clicks", path)
    assert done.code == 2
    assert f"line 2: photo {Path(photo).stem} shows cone 'C1' twice" in done.text


def test_names_that_a_spreadsheet_would_run_are_text_in_the_table(ready: Site) -> None:
    names = ["=cmd|' /C calc'!A0", "+1", "@SUM(A1)", "-2", "plain", "<b>&\"'", "x" * 300, "🚧"]
    path = ready.folder / "clicks.csv"
    with path.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(["asset", "class", "photo", "u", "v"])
        writer.writerows([n, "cone", photos(ready)[0], 400 + 20 * k, 400]
                         for k, n in enumerate(names))  # fmt: skip
    done = run(ready, "--clicks", path)
    assert done.code == 0, done.text
    assert [row["name"] for row in table(ready)] == [f"'{n}" for n in names[:4]] + names[4:]
    assert run(ready, "--target", ready.folder / "assets.json").code == 0
    told = json.loads((ready.folder / "assets.json").read_text(encoding="utf-8"))
    assert [row["name"] for row in told] == names
    with AssetStore.of_project(Project.open(ready.folder)) as store:
        assert [asset.name for asset in store.assets()] == names


def test_problem_of_many_assets_is_told_once_and_calls_them_assets(ready: Site) -> None:
    (ready.folder / "asset_classes.toml").write_text("[classes.cone]\nremove = true\n")
    path = put_clicks(ready, clicks_csv(TRUTH, photos=photos(ready)))
    assert run(ready, "--clicks", path).code == 2
    (ready.folder / "asset_classes.toml").unlink()
    assert run(ready, "--clicks", path).code == 0
    (ready.folder / "asset_classes.toml").write_text("[classes.cone]\nremove = true\n")
    done = run(ready)
    assert done.text.count("class 'cone' is not known") == 1
    assert "photos" not in done.text
    assert re.search(r"\[cone C01, .* and \d+ more\]", done.text)


def test_unknown_photo_is_refused_with_its_line(ready: Site) -> None:
    path = put_clicks(ready, "class,photo,u,v\ncone,NONE.JPG,1,2\n")
    done = run(ready, "--clicks", path)
    assert done.code != 0
    assert "line 2" in done.text
    assert "NONE.JPG" in done.text
