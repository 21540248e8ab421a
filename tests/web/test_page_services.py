"""What the page is told: places, tiles, assets, marks and runs, asked for over HTTP."""

from __future__ import annotations

import io
import json
import shutil
import sqlite3
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from PIL import Image
from web_cases import SAMPLE, opened, true_objects, true_pixels

pytestmark = pytest.mark.slow
# m
FOOT = 1200.0 / 3937.0
NAME = "<script>alert(1)</script>"


def ask(client: Any, call: str, service: str = "measure", /, **content: Any) -> Any:
    answer = client.post(f"/api/{service}/{call}", json=content)
    assert answer.status_code == 200, answer.text
    return answer.json()


def clicks(name: str, count: int) -> list[dict[str, Any]]:
    """True pixels of a control point in some photos."""
    found = sorted(true_pixels(name).items())[:count]
    return [{"photo": photo, "u": u, "v": v} for photo, (u, v) in found]


def control_point(client: Any, name: str) -> dict[str, Any]:
    points = ask(client, "control")["points"]
    return next(point for point in points if point["name"] == name)


# -- what is shown -------------------------------------------------------------------------------


def test_facts_tell_the_crs_and_where_to_look(page_of_site: tuple[Any, Any]) -> None:
    client, _ = page_of_site
    facts = ask(client, "facts", "view")
    assert facts["crs"]["code"] == 6601
    assert facts["crs"]["unit"] == "ftUS"
    assert facts["crs"]["metres_per_unit"] == pytest.approx(FOOT, abs=1e-12)
    assert facts["poses"] == {"adjusted": 16}
    west, south, east, north = facts["map"]["extent"]
    for cone in true_objects("cone"):
        assert west < cone["x"] < east
        assert south < cone["y"] < north


def test_layers_lie_in_the_projects_crs(page_of_site: tuple[Any, Any]) -> None:
    client, _ = page_of_site
    counts = {"photos": 16, "footprints": 16, "control": 12}
    for name, count in counts.items():
        layer = ask(client, "layer", "view", name=name)
        assert len(layer["features"]) == count
        assert all(feature["id"] for feature in layer["features"])
    (track,) = ask(client, "layer", "view", name="trajectory")["features"]
    photos = ask(client, "layer", "view", name="photos")["features"]
    line = np.array(track["geometry"]["coordinates"])
    for photo in photos:
        away = np.hypot(*(line - photo["geometry"]["coordinates"]).T).min() * FOOT
        # m; 5 of position and as much between two points of the drawn line at 19 m/s
        assert away < 10.0, photo["id"]


def test_map_tiles_show_the_mosaic_in_its_place(
    page_of_site: tuple[Any, Any], module_site: Path
) -> None:
    client, _ = page_of_site
    facts = ask(client, "facts", "view")["map"]
    asked = {"name": "mosaic", "z": 0, "x": 0, "y": 0, "v": "1"}
    answer = client.get("/pictures/view/map_tile", params=asked)
    assert "max-age" in answer.headers["cache-control"]
    seen = np.asarray(Image.open(io.BytesIO(answer.content)).convert("RGBA"))
    size = facts["tile_size"]
    with rasterio.open(module_site / "products" / "mosaic.tif") as dataset:
        assert facts["origin"] == [dataset.transform.c, dataset.transform.f]
        assert facts["resolution"] == dataset.transform.a
        rows, cols = min(size, dataset.height), min(size, dataset.width)
        window = rasterio.windows.Window(0, 0, cols, rows)
        samples = np.moveaxis(dataset.read(window=window), 0, 2).astype(int)
        valid = dataset.dataset_mask(window=window) > 0
    assert ((seen[:rows, :cols, 3] > 0) == valid).all()
    # shades; WebP of quality 85
    assert np.abs(seen[:rows, :cols, :3].astype(int) - samples)[valid].mean() < 6.0


def test_photo_tiles_show_the_photos_own_pixels(page_of_site: tuple[Any, Any]) -> None:
    client, _ = page_of_site
    asked = {"photo": "IMG_0004", "z": 0, "x": 1, "y": 0}
    answer = client.get("/pictures/view/photo_tile", params=asked)
    seen = np.asarray(Image.open(io.BytesIO(answer.content)).convert("RGB")).astype(int)
    stored = np.asarray(Image.open(SAMPLE / "photos" / "IMG_0004.JPG").convert("RGB")).astype(int)
    # shades; a second JPEG
    assert np.abs(seen - stored[:512, 512:1024]).mean() < 4.0


def test_north_in_a_photo_is_where_the_map_says(page_of_site: tuple[Any, Any]) -> None:
    client, _ = page_of_site
    photo = ask(client, "photo", "view", photo="IMG_0004")
    middle = {"photo": "IMG_0004", "u": photo["width"] / 2, "v": photo["height"] / 2}
    place = ask(client, "place", **middle)
    # 5 m further north
    above = ask(client, "at", x=place["x"], y=place["y"] + 5.0 / FOOT, photo="IMG_0004")["seen"]
    du, dv = above["u"] - middle["u"], above["v"] - middle["v"]
    off = (np.degrees(np.arctan2(du, -dv)) - photo["north_deg"] + 180.0) % 360.0 - 180.0
    # deg; a tilt of 7 deg bends 5 m by less
    assert abs(off) < 1.0


def test_the_report_is_sent_as_it_is(page_of_site: tuple[Any, Any], module_site: Path) -> None:
    client, _ = page_of_site
    assert client.get("/report").content == (module_site / "products/report.html").read_bytes()


# -- measuring -----------------------------------------------------------------------------------


def test_one_click_finds_a_true_place_within_its_sigma(page_of_site: tuple[Any, Any]) -> None:
    client, _ = page_of_site
    for name in ("P02", "P04", "P08"):
        point = control_point(client, name)
        (click,) = clicks(name, 1)
        figure = ask(client, "figure", shape="point", vertices=[{"clicks": [click]}])
        found = figure["points"]["0"]
        off_e = (found["easting"] - point["x"]) * FOOT / found["sigma_e_m"]
        off_n = (found["northing"] - point["y"]) * FOOT / found["sigma_n_m"]
        # 3.3 sigma: one in a thousand lies farther off
        assert max(abs(off_e), abs(off_n)) < 3.3, name
        ring = np.array(found["ellipse"])
        reach = np.hypot(*((ring - [found["easting"], found["northing"]]).T)).max() * FOOT
        assert reach == pytest.approx(found["semi_major_m"], rel=0.02)


def test_several_clicks_of_one_object_are_better_than_one(page_of_site: tuple[Any, Any]) -> None:
    client, _ = page_of_site
    one = ask(client, "figure", shape="point", vertices=[{"clicks": clicks("P04", 1)}])
    more = ask(client, "figure", shape="point", vertices=[{"clicks": clicks("P04", 5)}])
    assert more["points"]["0"]["n_rays"] == 5
    assert more["points"]["0"]["sigma_u_m"] < one["points"]["0"]["sigma_u_m"]
    point = control_point(client, "P04")
    height = more["points"]["0"]["height_ellipsoidal_m"] - point["height_ellipsoidal_m"]
    assert abs(height) / more["points"]["0"]["sigma_u_m"] < 3.3


def test_an_area_has_the_size_of_its_true_corners(page_of_site: tuple[Any, Any]) -> None:
    client, _ = page_of_site
    names = ("P02", "P04", "P07", "P03")
    vertices = [{"clicks": clicks(name, 4)} for name in names]
    lengths = ask(client, "figure", shape="polygon", vertices=vertices)["lengths"]
    xy = np.array([[p["x"], p["y"]] for p in (control_point(client, n) for n in names)]) * FOOT
    x, y = (xy - xy.mean(axis=0)).T
    true = abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))) / 2.0
    assert abs(lengths["area_grid"]["value"] - true) / lengths["area_grid"]["sigma"] < 3.3
    assert len(lengths["legs"]) == 4
    assert lengths["told"]


def test_a_click_on_the_mosaic_is_one_in_the_photo_it_shows(page_of_site: tuple[Any, Any]) -> None:
    client, _ = page_of_site
    cone = true_objects("cone")[3]
    pick = ask(client, "pick", x=cone["x"], y=cone["y"])
    place = ask(client, "place", photo=pick["photo"], u=pick["u"], v=pick["v"])
    # m: back where it came from
    assert np.hypot(place["x"] - cone["x"], place["y"] - cone["y"]) * FOOT < 0.002


def test_photos_that_see_a_place_are_told_with_the_true_pixel(
    page_of_site: tuple[Any, Any],
) -> None:
    client, _ = page_of_site
    truth = true_pixels("P04")
    point = control_point(client, "P04")
    sights = ask(client, "control_sights", name="P04")["sights"]
    assert {sight["photo"] for sight in sights} >= set(truth)
    for sight in sights:
        if sight["photo"] in truth:
            u, v = truth[sight["photo"]]
            # px: 3.3 sigma of the longer axis
            off = np.hypot(sight["u"] - u, sight["v"] - v)
            assert off < 3.3 * sight["semi_major"] + 0.1, sight["photo"]
    ground = ask(client, "sights", x=point["x"], y=point["y"])["sights"]
    assert {sight["photo"] for sight in ground} >= set(truth)


def test_a_guide_line_runs_through_the_true_pixel(page_of_site: tuple[Any, Any]) -> None:
    client, _ = page_of_site
    first, second = clicks("P04", 2)
    (guide,) = ask(client, "guides", photo=second["photo"], clicks=[first])["guides"]
    line = np.array(guide["line"])
    a, b = line[:-1], line[1:]
    p = np.array([second["u"], second["v"]])
    share = np.clip(np.sum((p - a) * (b - a), axis=1) / np.sum((b - a) ** 2, axis=1), 0.0, 1.0)
    off = np.linalg.norm(a + share[:, None] * (b - a) - p, axis=1).min()
    # px
    assert off < 3.3 * max(guide["sigma_px"]) + 0.1


def test_a_place_beside_the_photos_is_told(page_of_site: tuple[Any, Any]) -> None:
    client, _ = page_of_site
    west, south, *_ = ask(client, "facts", "view")["extent"]
    answer = client.post("/api/measure/pick", json={"x": west - 5000.0, "y": south - 5000.0})
    assert answer.status_code == 400
    assert "not known there" in answer.text or "no photo shows" in answer.text


# -- assets --------------------------------------------------------------------------------------


def add(client: Any, name: str = "", **more: Any) -> dict[str, Any]:
    vertices = more.pop("vertices", [{"clicks": clicks("P04", 2)}])
    made: dict[str, Any] = ask(
        client, "add_asset", kind=more.pop("kind", "cone"), name=name, vertices=vertices, **more
    )
    return dict(made["asset"])


def test_an_asset_is_stored_with_its_place_accuracy_and_clicks(client: Any, site: Path) -> None:
    add(client, NAME)
    (asset,) = ask(client, "assets")["assets"]
    # a name is text: it comes back as it was written
    assert asset["name"] == NAME
    assert asset["quality"]["method"] == "intersect"
    assert [click["photo"] for click in asset["clicks"]] == [c["photo"] for c in clicks("P04", 2)]
    point = control_point(client, "P04")
    off = (asset["vertices"][0][0] - point["x"]) * FOOT
    assert abs(off) < 3.3 * asset["quality"]["sigma_e"]
    with sqlite3.connect(site / "assets.gpkg") as file:
        assert file.execute("SELECT name, method FROM asset_points").fetchall() == [
            (NAME, "intersect")
        ]


def test_a_change_from_an_older_state_is_refused_with_the_state_of_now(client: Any) -> None:
    asset = add(client, "first")
    ask(client, "change_asset", id=asset["id"], revision=asset["revision"], name="theirs")
    late = {"id": asset["id"], "revision": asset["revision"], "name": "mine"}
    answer = client.post("/api/measure/change_asset", json=late)
    assert answer.status_code == 409
    assert answer.json()["current"]["name"] == "theirs"
    assert "/" not in answer.json()["error"]
    answer = client.post("/api/measure/delete_asset", json={k: late[k] for k in ("id", "revision")})
    assert answer.status_code == 409
    assert [one["name"] for one in ask(client, "assets")["assets"]] == ["theirs"]


def test_edits_are_undone_and_done_again(client: Any) -> None:
    asset = add(client, "first")
    ask(client, "delete_asset", id=asset["id"], revision=asset["revision"])
    assert ask(client, "assets")["assets"] == []
    assert ask(client, "undo")["step"]["title"].startswith("delete")
    assert [one["name"] for one in ask(client, "assets")["assets"]] == ["first"]
    assert ask(client, "redo")["step"]["title"].startswith("delete")
    assert ask(client, "redo")["step"] is None
    ask(client, "undo")
    ask(client, "undo")
    assert ask(client, "undo")["step"] is None
    assert ask(client, "assets")["assets"] == []


def test_an_asset_is_measured_anew(client: Any) -> None:
    asset = add(client, vertices=[{"clicks": clicks("P04", 1)}])
    assert asset["quality"]["method"] == "locate"
    better = ask(client, "change_asset", id=asset["id"], revision=asset["revision"],
                 vertices=[{"clicks": clicks("P04", 4)}])["asset"]  # fmt: skip
    assert better["quality"]["n_rays"] == 4
    assert better["quality"]["semi_major"] < asset["quality"]["semi_major"]


def test_assets_of_a_locked_file_can_be_read_but_not_changed(client: Any, site: Path) -> None:
    asset = add(client, "kept")
    gis = sqlite3.connect(site / "assets.gpkg", isolation_level=None)
    gis.execute("BEGIN IMMEDIATE")
    try:
        change = {"id": asset["id"], "revision": asset["revision"], "name": "new"}
        answer = client.post("/api/measure/change_asset", json=change)
        assert answer.status_code == 400
        assert "held by another program" in answer.json()["error"]
        assert [one["name"] for one in ask(client, "assets")["assets"]] == ["kept"]
    finally:
        gis.execute("ROLLBACK")
        gis.close()
    assert ask(client, "change_asset", **change)["asset"]["name"] == "new"


@pytest.mark.parametrize(
    ("content", "status", "word"),
    [
        ({"kind": "dragon"}, 400, "class"),
        ({"kind": "cone", "attributes": {"condition": "fine"}}, 400, "condition"),
        ({"kind": "cone", "attributes": {"wings": 2}}, 400, "attribute"),
        ({"kind": "cone", "name": "a\x00b"}, 400, "control character"),
        ({"kind": "cone", "name": "a" * 10_001}, 422, "name"),
        ({"kind": "cone", "vertices": []}, 422, "vertices"),
        ({"kind": "lane_edge"}, 400, "vertices"),
    ],
)
def test_an_asset_that_does_not_fit_is_refused(
    page_of_site: tuple[Any, Any], content: dict[str, Any], status: int, word: str
) -> None:
    client, _ = page_of_site
    whole = {"vertices": [{"clicks": clicks("P04", 1)}], **content}
    answer = client.post("/api/measure/add_asset", json=whole)
    assert answer.status_code == status
    assert word in answer.json()["error"]
    assert ask(client, "assets")["assets"] == []


def test_what_a_photo_shows_is_predicted_at_its_pixel(client: Any) -> None:
    vertices = [{"clicks": clicks("P04", 4)}]
    asset = add(client, "on a control point", vertices=vertices)
    photo, (u, v) = sorted(true_pixels("P04").items())[5]
    found = ask(client, "in_photo", photo=photo)
    (shown,) = [one for one in found["assets"] if one["id"] == asset["id"]]
    off = np.hypot(shown["uv"][0][0] - u, shown["uv"][0][1] - v)
    assert off < 3.3 * shown["semi_major"] + 0.1
    control = next(one for one in found["control"] if one["name"] == "P04")
    assert np.hypot(control["u"] - u, control["v"] - v) < 3.3 * control["semi_major"] + 0.1
    assert control["marked"]["used"] is True


# -- marks of control ----------------------------------------------------------------------------


def test_a_mark_is_written_and_checked_and_taken_away(client: Any, site: Path) -> None:
    file = site / "control" / "marks.csv"
    before = file.read_text()
    photo, (u, v) = sorted(true_pixels("P04").items())[0]
    known = next(m["at"] for m in control_point(client, "P04")["marks"] if m["photo"] == photo)
    made = ask(client, "mark", name="P04", photo=photo, u=u, v=v, before=known)["mark"]
    assert made["at"] == pytest.approx([u, v], abs=0.001)
    assert made["used"]
    assert not made["suspect"]
    wrong = ask(client, "mark", name="P04", photo=photo, u=u + 40.0, v=v, before=made["at"])["mark"]
    assert wrong["suspect"] or not wrong["used"]
    ask(client, "unmark", name="P04", photo=photo, before=wrong["at"])
    assert all(m["photo"] != photo for m in control_point(client, "P04")["marks"])
    left = [line for line in before.splitlines() if not line.startswith(f"P04,{photo}.JPG")]
    assert file.read_text().splitlines() == left
    assert (site / "control" / "marks.csv.bak").read_text() == before


def test_a_mark_that_another_tab_set_is_not_overwritten(client: Any, site: Path) -> None:
    photo, (u, v) = sorted(true_pixels("P04").items())[0]
    file = site / "control" / "marks.csv"
    before = file.read_text()
    stale = {"name": "P04", "photo": photo, "u": u, "v": v, "before": None}
    answer = client.post("/api/measure/mark", json=stale)
    assert answer.status_code == 409
    assert answer.json()["current"]["at"]
    assert file.read_text() == before


@pytest.mark.parametrize(
    "content", [{"name": "P99"}, {"photo": "IMG_9999"}, {"u": 1e5}, {"name": "P04\n"}]
)
def test_a_mark_of_nothing_is_refused(
    page_of_site: tuple[Any, Any], module_site: Path, content: dict[str, Any]
) -> None:
    client, _ = page_of_site
    before = (module_site / "control" / "marks.csv").read_text()
    whole = {"name": "P04", "photo": "IMG_0001", "u": 5.0, "v": 5.0, **content}
    assert client.post("/api/measure/mark", json=whole).status_code == 400
    assert (module_site / "control" / "marks.csv").read_text() == before


def test_the_first_mark_of_a_project_makes_and_names_its_file(site: Path) -> None:
    settings = site / "project.toml"
    lines = settings.read_text().splitlines()
    named = next(line for line in lines if line.startswith("marks ="))
    settings.write_text("\n".join(lines).replace(named, "# marks =        # their pixels"))
    (site / "control" / "marks.csv").unlink()
    photo, (u, v) = sorted(true_pixels("P04").items())[0]
    with opened(site) as (client, _):
        assert control_point(client, "P04")["marks"] == []
        ask(client, "mark", name="P04", photo=photo, u=u, v=v)
        assert [m["photo"] for m in control_point(client, "P04")["marks"]] == [photo]
        assert 'marks = "control/marks.csv"' in settings.read_text()
        ask(client, "unmark", name="P04", photo=photo, before=[u, v])
        # a file without a mark keeps nobody from seeing the points
        assert control_point(client, "P04")["marks"] == []


# -- runs and changes ----------------------------------------------------------------------------


def events(client: Any, number: int) -> list[dict[str, Any]]:
    found = []
    with client.stream("GET", f"/api/jobs/{number}/events") as answer:
        assert answer.headers["content-type"].startswith("text/event-stream")
        for line in answer.iter_lines():
            if line.startswith("data: "):
                found.append(json.loads(line[6:]))
    return found


def test_a_tool_runs_and_tells_its_progress(client: Any, site: Path) -> None:
    order = {"tool": "where_to_click", "values": {"best": 1}}
    job = client.post("/api/jobs", json=order).json()
    # one at a time
    busy = client.post("/api/jobs", json=order)
    assert busy.status_code == 409
    told = events(client, job["id"])
    assert told[-1] == {"event": "end", "state": "done"}
    (result,) = [one for one in told if one["event"] == "result"]
    assert result["summary"]["points_seen"] == 12
    assert (site / "products" / "where_to_click.csv").is_file()
    # told from the begin on to one who comes late
    assert [one for one in events(client, job["id"]) if one["event"] == "result"] == [result]


def test_a_tool_that_fails_says_why_in_one_line(client: Any, site: Path) -> None:
    shutil.rmtree(site / "photos")
    job = client.post("/api/jobs", json={"tool": "run", "values": {"force": True}}).json()
    told = events(client, job["id"])
    assert told[-1] == {"event": "end", "state": "failed"}
    assert "no folder" in told[-2]["message"]


def test_a_tool_is_cancelled_and_its_lock_is_free(client: Any) -> None:
    job = client.post("/api/jobs", json={"tool": "run", "values": {"force": True}}).json()
    stop = threading.Timer(3.0, lambda: client.post(f"/api/jobs/{job['id']}/cancel", json={}))
    stop.start()
    began = time.monotonic()
    told = events(client, job["id"])
    stop.join()
    assert told[-1] == {"event": "end", "state": "cancelled"}
    # s; the whole run takes several times as long
    assert time.monotonic() - began < 25.0
    # the first step of the run, which takes the lock
    after = client.post("/api/jobs", json={"tool": "read_photos", "values": {}}).json()
    assert events(client, after["id"])[-1]["state"] == "done"


def test_others_changes_are_seen_by_their_revision(client: Any, site: Path) -> None:
    def now() -> dict[str, str]:
        return dict(client.get("/api/state").json()["revisions"])

    ask(client, "assets")
    first = now()
    add(client)
    second = now()
    assert {key for key in first if first[key] != second[key]} == {"assets"}
    with (site / "control" / "marks.csv").open("a") as stream:
        stream.write("P04,IMG_0016.JPG,10,10,0.5\n")
    assert {key for key in first if second[key] != now()[key]} == {"control"}


def test_after_a_run_its_poses_are_used(client: Any, site: Path) -> None:
    click = {"photo": "IMG_0004", "u": 600.0, "v": 400.0}
    adjusted = ask(client, "place", **click)
    with sqlite3.connect(site / "georef.gpkg") as file:
        file.execute("DELETE FROM pose WHERE kind = 'adjusted'")
        file.execute("INSERT INTO run (tool, outcome) VALUES ('georef:adjust', 'done')")
    file.close()
    navigated = ask(client, "place", **click)
    # poses of the logs are good to metres, adjusted ones to centimetres
    assert navigated["sigma_e_m"] > 3.0 * adjusted["sigma_e_m"]


def test_a_new_project_says_what_to_do_first(tmp_path: Path) -> None:
    shutil.copytree(SAMPLE / "photos", tmp_path / "photos")
    (tmp_path / "project.toml").write_text("")
    with opened(tmp_path) as (client, _):
        assert "run `georef run`" in ask(client, "facts", "view")["why_not"]
        assert client.get("/api/tools").status_code == 200
        for name in ("assets", "control", "classes"):
            answer = client.post(f"/api/measure/{name}", json={})
            assert answer.status_code in (200, 400)
            assert "Traceback" not in answer.text
