"""`match` and `adjust` on rendered flights by their tags: better than direct, and never worse."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from tool_cases import SAMPLE, Done, Site, copy_site, set_position, set_xmp

from georef_gis.frames import log_so3
from georef_gis.project import Project
from georef_gis.project.columns_file import write_columns
from georef_gis.simulate import CameraTruth, FlightSettings, SimulatedFlight, simulate_flight
from georef_gis.simulate.settings import FlightLine
from georef_gis.simulate.write import write_flight
from processing_algorithms.orient import adjusted_rows
from processing_algorithms.site import load_site

# All of these run real steps on photos.
pytestmark = pytest.mark.slow

STEPS = "read_photos,orient_direct,match,adjust"
FULL = CameraTruth()
HALF = replace(
    FULL, width=648, height=432, fx=FULL.fx / 2, fy=FULL.fy / 2, cx=328.3, cy=211.9
)  # fmt: skip
# 47 m are seen along the strip: neighbours overlap by 60 %, every second one by 20 %, every third
# one not at all
LINES = (
    FlightLine(along=0.0, across=-8.0, heading_deg=0.0, height=56.0, photos=8, base=18.5),
    FlightLine(along=0.0, across=14.0, heading_deg=180.0, height=62.0, photos=3, base=20.0),
)


@cache
def flight() -> SimulatedFlight:
    return simulate_flight(FlightSettings(camera=HALF, lines=LINES), seed=5)


@pytest.fixture(scope="module")
def rendered(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Flight folder of eleven photos; positions and angles from the tags alone."""
    if not SAMPLE.is_dir():
        pytest.skip("sample_project is not there")
    folder = tmp_path_factory.mktemp("rendered") / "site"
    write_flight(flight(), folder)
    shutil.copy(SAMPLE / "project.toml", folder)
    site = Site(folder)
    site.set("logs", imu=None, gnss=None, sync=None)
    site.set("control", file=None, marks=None)
    site.set("products", gsd_m=0.3, orthos=False)
    site.set("tools", match={"observations": 300})
    return folder


def part(rendered: Path, folder: Path, photos: list[int]) -> Site:
    """Copy with some of the photos."""
    names = {flight().names[i] for i in photos}
    shutil.copytree(
        rendered, folder, ignore=lambda at, found: [
            n for n in found if Path(at).name == "photos" and n not in names
        ]
    )  # fmt: skip
    return Site(folder)


def adjust(site: Site, *words: object) -> Done:
    done = site.run("--only", STEPS, *words)
    assert done.code == 0, done.text
    return done


@dataclass(frozen=True)
class Judged:
    """Errors (n, 6), m and rad in enu, of the poses of a kind, their sigmas, and their photos."""

    error: np.ndarray
    sigma: np.ndarray
    photos: list[str]

    @property
    def place(self) -> float:
        return float(np.sqrt(np.mean(self.error[:, :3] ** 2)))

    @property
    def angle(self) -> float:
        return float(np.degrees(np.sqrt(np.mean(self.error[:, 3:] ** 2))))

    @property
    def ratio(self) -> np.ndarray:
        return self.error / self.sigma


def judged(site: Site, *, direct: bool = False) -> Judged:
    """Poses that a later tool would take, against the simulator's truth."""
    f = flight()
    project = Project.open(site.folder, read_only=True)
    found = load_site(project, direct=direct)
    origin = found.frame.origin
    errors, sigmas, names = [], [], []
    for key, photo in found.photos.items():
        i = next(k for k, name in enumerate(f.names) if Path(name).stem == key)
        pose = photo.pose
        tip = origin.enu_from_ecef(f.p_ecef[i] + f.R_ecef_from_cam[i].T)
        R = (np.asarray(tip) - origin.enu_from_ecef(f.p_ecef[i])).T
        dp = np.asarray(origin.enu_from_ecef(f.p_ecef[i])) - pose.origin_enu
        errors.append(np.r_[dp, log_so3(R @ pose.R_enu_from_cam.T)])
        sigma = np.sqrt(np.diag(pose.covariance))
        sigma[2] = pose.sigma_height
        sigmas.append(sigma)
        names.append(key)
    return Judged(np.array(errors), np.array(sigmas), names)


def marks_off(site: Site, *, direct: bool = False) -> float:
    """Root mean square distance of the true control points from their marks, px."""
    f = flight()
    found = load_site(Project.open(site.folder, read_only=True), direct=direct)
    p = {c.name: found.frame.origin.enu_from_ecef(c.p_ecef) for c in f.control}
    off = []
    for mark in f.marks:
        photo = found.photos.get(Path(f.names[mark.photo]).stem)
        if photo is not None:
            off.append(photo.project(p[mark.point]) - mark.uv)
    assert len(off) >= 2
    return float(np.sqrt(np.mean(np.square(off))))


def report(site: Site) -> dict:
    return json.loads((site.folder / "adjustment" / "report.json").read_text())


def kinds(site: Site) -> dict[str, int]:
    return dict(site.row("select kind, count(*) from pose group by kind"))


def adjusted_places(site: Site) -> np.ndarray:
    rows = site.row(
        "select x_enu, y_enu, z_enu from pose where kind = 'adjusted' order by photo_id"
    )  # fmt: skip
    return np.array(rows)


def assert_same(a: Site, b: Site) -> None:
    """To 2 mm of some metres of sigma: the search ends where a step gains next to nothing."""
    np.testing.assert_allclose(adjusted_places(a), adjusted_places(b), rtol=0, atol=5e-3)


# -- better than direct ------------------------------------------------------------------------


@pytest.fixture(scope="module")
def whole(rendered: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Site, Done]:
    """All eleven photos, adjusted once; copy it before changing it."""
    site = part(rendered, tmp_path_factory.mktemp("whole") / "site", list(range(11)))
    return site, adjust(site)


@pytest.fixture
def copied(whole: tuple[Site, Done], tmp_path: Path) -> Site:
    """Copy of the adjusted project."""
    shutil.copytree(whole[0].folder, tmp_path / "copy")
    return Site(tmp_path / "copy")


def test_adjusted_poses_are_nearer_to_the_truth_and_as_near_as_they_say(
    whole: tuple[Site, Done],
) -> None:
    site, done = whole
    assert kinds(site) == {"tags": 11, "adjusted": 11}
    before, after = judged(site, direct=True), judged(site)
    assert after.angle < 0.2 * before.angle
    assert after.place < before.place
    # one flight: its errors hang together
    assert 0.2 < np.sqrt(np.mean(after.ratio**2)) < 2.0, np.sqrt(np.mean(after.ratio**2, axis=0))
    assert np.abs(after.ratio).max() < 4.5
    assert marks_off(site) < 0.5 * marks_off(site, direct=True)
    said = report(site)
    assert said["converged"]
    # 432 x 648 px, JPEG: about half a pixel
    assert 0.1 < np.median([p["rms_px"] for p in said["photos"]]) < 1.0
    assert all(check["passed"] for check in said["checks"])
    assert "DOES NOT AGREE" not in done.text


def test_an_unchanged_run_skips_all_steps(copied: Site) -> None:
    adjust(copied)
    again = adjust(copied)
    assert "4 of 4 steps were unchanged" in again.text


def test_without_its_cache_a_project_comes_to_the_same(
    copied: Site, whole: tuple[Site, Done]
) -> None:
    shutil.rmtree(copied.folder / "cache", ignore_errors=True)
    assert "unchanged" in adjust(copied).text
    adjust(copied, "--force")
    assert_same(copied, whole[0])


def test_a_photo_removed_after_matching_is_gone_from_the_result(copied: Site) -> None:
    gone = copied.photos[3]
    gone.unlink()
    adjust(copied)
    assert kinds(copied) == {"tags": 10, "adjusted": 10}
    left = {row[0] for row in copied.row("select photo_id from pose")}
    assert gone.stem not in left
    assert marks_off(copied) < 0.5 * marks_off(copied, direct=True)


def test_a_calibrated_camera_that_is_held_stays_as_it_was(copied: Site) -> None:
    path = copied.folder / "project.toml"
    path.write_text(path.read_text() + "\n[tools.adjust]\ncalibrate = false\n")
    names = ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "p1", "p2")
    copied.set("camera", **{name: getattr(HALF, name) for name in names})
    adjust(copied)
    after = load_site(Project.open(copied.folder, read_only=True))
    for photo in after.photos.values():
        assert [getattr(photo.camera, name) for name in names] == [
            getattr(HALF, name) for name in names
        ]
    assert kinds(copied)["adjusted"] == 11
    assert judged(copied).angle < 0.2 * judged(copied, direct=True).angle
    assert np.abs(judged(copied).ratio).max() < 4.5


@pytest.mark.usefixtures("pictures_undrawn")
def test_quick_makes_no_adjustment(rendered: Path, tmp_path: Path) -> None:
    site = part(rendered, tmp_path / "quick", [0, 1])
    done = site.run("--quick")
    assert done.code == 0, done.text
    assert kinds(site) == {"tags": 2}
    assert not (site.folder / "adjustment" / "ties.npz").exists()
    assert (site.products / "mosaic.tif").exists()


# -- small and thin blocks -----------------------------------------------------------------------


THIN = {
    "two photos": [3, 4],
    "five photos": [1, 2, 3, 9, 10],
    "a strip of eight": list(range(8)),
    "a strip with 20 % of overlap": [0, 2, 4, 6],
}


@pytest.mark.parametrize("photos", THIN.values(), ids=THIN)
def test_thin_blocks_are_no_worse_than_direct(
    rendered: Path, tmp_path: Path, photos: list[int]
) -> None:
    site = part(rendered, tmp_path / "thin", photos)
    adjust(site)
    before, after = judged(site, direct=True), judged(site)
    # what two photos share is not told by their pixels: no gain is asked for, no harm allowed
    assert after.angle < 1.1 * before.angle
    assert after.place < 1.6 * before.place
    assert np.abs(after.ratio).max() < 4.0, after.ratio
    assert np.sqrt(np.mean(after.ratio**2)) < 2.0
    # places along the line take the tags' age on, which direct poses count in theirs
    smaller = np.median(after.sigma, axis=0) <= 1.01 * np.median(before.sigma, axis=0)
    assert np.all(smaller[2:])


def test_photos_without_overlap_keep_their_direct_poses_and_it_is_told(
    rendered: Path, tmp_path: Path
) -> None:
    site = part(rendered, tmp_path / "apart", [0, 3, 6])
    done = adjust(site)
    assert kinds(site) == {"tags": 3}
    line = done.line("no photo shares a point with another")
    assert line.startswith("doubt")
    assert "the direct result stays" in line
    np.testing.assert_array_equal(judged(site).error, judged(site, direct=True).error)


def test_one_photo_alone_is_no_error(rendered: Path, tmp_path: Path) -> None:
    site = part(rendered, tmp_path / "alone", [4])
    adjust(site)
    assert kinds(site) == {"tags": 1}


def test_photos_of_one_place_are_no_worse_than_direct(rendered: Path, tmp_path: Path) -> None:
    """One picture five times, as a hovering camera takes it: no depth is to be had."""
    site = part(rendered, tmp_path / "hover", [4])
    (only,) = site.photos
    for k in range(1, 5):
        shutil.copy(only, only.with_name(f"HOVER_{k}.JPG"))
    done = adjust(site)
    found = load_site(Project.open(site.folder, read_only=True))
    direct = load_site(Project.open(site.folder, read_only=True), direct=True)
    for key, photo in found.photos.items():
        old = direct.photos[key].pose
        off = (photo.pose.origin_enu - old.origin_enu) / np.sqrt(np.diag(old.covariance))[:3]
        assert np.abs(off).max() < 2.0, done.text
        assert (
            np.degrees(np.linalg.norm(log_so3(photo.pose.R_enu_from_cam @ old.R_enu_from_cam.T)))
            < 10
        )


def repainted(path: Path, seed: int) -> None:
    """Other pixels under the tags of a photo."""
    raw = path.read_bytes()
    at = 2
    while raw[at] == 0xFF and 0xE0 <= raw[at + 1] <= 0xEF:
        at += 2 + int.from_bytes(raw[at + 2 : at + 4], "big")
    rng = np.random.default_rng(seed)
    picture = sum(
        cv2.resize(rng.normal(0, 30, (432 // n, 648 // n, 3)).astype(np.float32), (648, 432))
        for n in (4, 12, 40)
    )
    ok, jpeg = cv2.imencode(".jpg", np.clip(picture + 128, 0, 255).astype(np.uint8))
    assert ok
    path.write_bytes(raw[:at] + jpeg.tobytes()[2:])


def test_a_photo_of_something_else_is_told_and_harms_none(rendered: Path, tmp_path: Path) -> None:
    site = part(rendered, tmp_path / "else", list(range(1, 7)))
    stray = site.photos[2]
    repainted(stray, 3)
    done = adjust(site)
    assert stray.stem in done.line("not connected")
    row = site.row(f"select doubts from pose where kind = 'adjusted' and photo_id = '{stray.stem}'")
    assert "no tie point connects it" in row[0][0]
    after = judged(site)
    others = [name != stray.stem for name in after.photos]
    assert np.abs(after.ratio[others]).max() < 4.5
    # its own tags still tell where it was
    assert np.abs(after.ratio[after.photos.index(stray.stem)]).max() < 4.5


def test_wrong_headings_are_told_from_turned_pixels(tmp_path: Path) -> None:
    """The principal point of the simulated camera lies off the middle: that tells the two apart."""
    site = copy_site(tmp_path / "headings", photos=16)
    site.set("logs", imu=None, gnss=None, sync=None)
    site.set("control", file=None, marks=None)
    wrong = [site.photos[i] for i in (2, 7, 11)]
    for path in wrong:
        yaw = float(re.search(rb"<Camera:Yaw>([^<]*)<", path.read_bytes())[1])  # type: ignore[index]
        set_xmp(path, {"Yaw": f"{(yaw + 180.0) % 360.0:.1f}"})
    done = adjust(site)
    assert "not the pixels are turned but the headings" in done.text
    project = Project.open(site.folder, read_only=True)
    found = [o.camera.fx for o in load_site(project).photos.values()]
    np.testing.assert_allclose(found, FULL.fx, rtol=0.005)
    told = {entry["photo"] for entry in report(site)["weighed_down"]}
    assert not told & {path.stem for path in wrong}


def test_photos_of_one_position_are_refused_in_one_line(copied: Site) -> None:
    for path in copied.photos:
        set_position(path, 39.0973, -80.467)
    done = adjust(copied)
    assert "have one position" in done.text
    assert kinds(copied) == {"tags": 11}


def test_a_focal_length_stated_20_percent_too_long_is_found_out(tmp_path: Path) -> None:
    """Not the tags but the camera is wrong: heights would be a fifth off with it held."""
    site = copy_site(tmp_path / "wrong_camera", photos=16)
    site.set("logs", imu=None, gnss=None, sync=None)
    site.set("control", file=None, marks=None)
    # four heights from 56 to 86 m, crossed
    site.set("camera", focal_px=round(1.2 * FULL.fx), sigma_focal_percent=None)
    done = adjust(site)
    assert "the photos are believed" in done.text
    assert "[camera] focal_px" in done.text
    project = Project.open(site.folder, read_only=True)
    found = [o.camera.fx for o in load_site(project).photos.values()]
    np.testing.assert_allclose(found, FULL.fx, rtol=0.02)


def test_a_tag_60_m_off_is_told_and_its_photo_put_right(rendered: Path, tmp_path: Path) -> None:
    site = part(rendered, tmp_path / "far", list(range(8)))
    i = 4
    lat, lon = flight().tags.lat_deg[i], flight().tags.lon_deg[i]
    set_position(site.photos[i], float(lat) + 60 / 111_000, float(lon))
    done = adjust(site)
    assert "weighed down" in done.line(site.photos[i].stem, "north")
    after = judged(site)
    k = after.photos.index(site.photos[i].stem)
    assert np.linalg.norm(after.error[k, :2]) < 10.0
    assert np.abs(after.ratio).max() < 4.5


# -- trouble -------------------------------------------------------------------------------------


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def other_columns(path: Path) -> None:
    write_columns(path, "tie points", {"photo": np.zeros(3)})


@pytest.mark.parametrize("spoil", [cut, other_columns])
def test_spoilt_tie_points_are_told_in_one_line_or_made_anew(
    copied: Site, spoil: Callable[[Path], None]
) -> None:
    path = copied.folder / "adjustment" / "ties.npz"
    spoil(path)
    done = copied.run("--only", STEPS)
    assert "Traceback" not in done.text
    assert "bug in georef" not in done.text
    if done.code:
        line = done.line("ties.npz")
        assert "georef" in line
        assert "run" in line
        # the cure that it names
        assert copied.run("--only", STEPS, "--force").code == 0
    assert kinds(copied)["adjusted"] == 11


def kill() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


# before and after all that is kept is written, piece by piece
STAGES = [("_write_rows", "after"), ("save_surface", "after")]


@pytest.mark.parametrize(("stage", "when"), STAGES)
def test_killed_in_the_middle_of_adjust_a_project_is_whole(
    copied: Site, whole: tuple[Site, Done], stage: str, when: str
) -> None:
    """Killed in a forked process: poses are all adjusted or none, a later tool can read them."""
    if stage == "save_surface":
        copied.set("ground", dem=None, height_m=306.0)
    pid = os.fork()
    if pid == 0:
        real = getattr(adjusted_rows, stage)

        def killed(*args: object, **options: object) -> object:
            if when == "after":
                real(*args, **options)
            kill()

        setattr(adjusted_rows, stage, killed)
        try:
            words = () if stage == "save_surface" else ("--force",)
            copied.run("--only", STEPS if not words else "adjust", *words)
        finally:
            os._exit(7)
    _, status = os.waitpid(pid, 0)
    assert os.WIFSIGNALED(status), f"{stage} was not reached"
    found = kinds(copied)
    assert found["tags"] == 11
    assert found.get("adjusted", 0) in (0, 11)
    site = load_site(Project.open(copied.folder, read_only=True))
    assert len(site.photos) == 11
    adjust(copied)
    assert kinds(copied)["adjusted"] == 11
    if stage != "save_surface":
        assert_same(copied, whole[0])


def test_a_result_that_is_not_believed_leaves_the_direct_one(
    copied: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    from georef_gis.orient.adjustment import checks

    monkeypatch.setattr(checks, "REFUSED", 1e-6)
    done = copied.run("--only", "adjust", "--force")
    assert done.code == 0, done.text
    assert "DOES NOT AGREE" in done.text
    assert "the direct result stays" in done.text
    assert kinds(copied) == {"tags": 11}
    assert not (copied.folder / "adjustment" / "report.json").exists()
    np.testing.assert_array_equal(judged(copied).error, judged(copied, direct=True).error)


# -- control -------------------------------------------------------------------------------------


@pytest.fixture
def surveyed(copied: Site) -> Site:
    """The adjusted project with its control points."""
    copied.set("control", file="control/control.csv", marks="control/marks.csv")
    return copied


def control_rows(site: Site) -> tuple[list[str], list[list[str]]]:
    lines = (site.folder / "control" / "control.csv").read_text().splitlines()
    at = next(i for i, line in enumerate(lines) if line.startswith("name"))
    return lines[: at + 1], [line.split(",") for line in lines[at + 1 :]]


def write_control(site: Site, head: list[str], rows: list[list[str]]) -> None:
    text = "\n".join([*head, *(",".join(row) for row in rows)]) + "\n"
    (site.folder / "control" / "control.csv").write_text(text)


def test_control_takes_off_what_the_tags_all_share(
    surveyed: Site, whole: tuple[Site, Done]
) -> None:
    adjust(surveyed)
    without, after = judged(whole[0]), judged(surveyed)
    assert after.place < 0.3 * without.place
    # marks of 0.3 px, control of 2 cm, over a strip that a lens may bend
    assert after.place < 0.4
    assert np.sqrt(np.mean(after.ratio**2)) < 2.0
    told = report(surveyed)["control"]
    assert len(told) >= 3
    assert any(entry["role"] == "control" for entry in told)


def exchanged(site: Site) -> None:
    head, rows = control_rows(site)
    write_control(site, head, [[r[0], r[2], r[1], *r[3:]] for r in rows])


def in_metres(site: Site) -> None:
    """Feet taken for metres: the header says so."""
    path = site.folder / "control" / "control.csv"
    text = path.read_text()
    assert "EPSG:6601" in text
    # the same zone in metres
    path.write_text(text.replace("# crs: EPSG:6601", "# crs: EPSG:6600"))


def wrong_photo(site: Site) -> None:
    """The first mark of a point under the name of a photo that shows another place."""
    path = site.folder / "control" / "marks.csv"
    lines = path.read_text().splitlines()
    at = next(i for i, line in enumerate(lines) if ",IMG_0002.JPG," in line)
    name = lines[at].split(",")[0]
    seen = {line.split(",")[1] for line in lines if line.startswith(name + ",")}
    other = next(n for n in flight().names if n not in seen)
    lines[at] = lines[at].replace("IMG_0002.JPG", other)
    path.write_text("\n".join(lines) + "\n")


BLUNDERS = {
    "columns exchanged": exchanged,
    "feet as metres": in_metres,
    "a mark in the wrong photo": wrong_photo,
}


@pytest.mark.parametrize("spoil", BLUNDERS.values(), ids=BLUNDERS)
def test_blunders_of_control_harm_no_pose(
    surveyed: Site, whole: tuple[Site, Done], spoil: Callable[[Site], None]
) -> None:
    spoil(surveyed)
    adjust(surveyed)
    after, without = judged(surveyed), judged(whole[0])
    assert after.place < 1.2 * without.place
    assert after.angle < 1.5 * without.angle
    assert np.abs(after.ratio).max() < 4.5
