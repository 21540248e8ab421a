"""What project.toml says of clocks, turns and delays reaches the poses once, and the right way."""

from __future__ import annotations

import csv
import json
import math
from functools import reduce
from operator import xor
from pathlib import Path

import numpy as np
import pytest
from navigation_cases import (
    STEPS,
    errors,
    navigation_site,
    only_poses,
    photo_times,
    rows,
    truth,
    worst_ratio,
)
from tool_cases import SAMPLE, Site, georef

from georef_gis.ingest.logs import open_log
from georef_gis.units import GPS_WEEK

pytestmark = pytest.mark.slow

# The camera's clock against UTC, s, and the one photo that the board missed; both of the sample.
CLOCK, MISSED = -(4 * 3600 + 13.17), "IMG_0002"


@pytest.fixture
def site(tmp_path: Path) -> Site:
    if not SAMPLE.is_dir():
        pytest.skip("sample_project is not there")
    return navigation_site(tmp_path)


def time_errors(site: Site) -> dict[str, tuple[float, float]]:
    """Error of every photo's time and its sigma, s."""
    epoch = float(site.row("SELECT value FROM meta WHERE key = 'epoch'")[0][0])
    return {
        name: (row[0] + epoch - int(true["gps_week"]) * GPS_WEEK - float(true["tow_s"]), row[1])
        for name, row in photo_times(site).items()
        for true in [truth()[name]]
    }


def rotations(site: Site, kind: str) -> dict[str, np.ndarray]:  # type: ignore[type-arg]
    """R_enu_from_cam by photo."""
    return {
        row["photo_id"]: np.array(json.loads(row["rotation"])).reshape(3, 3)
        for row in rows(site, "pose", kind=kind)
    }


def test_stated_clock_offset_counts_from_utc(site: Site) -> None:
    """Taken as from GPS time, all would be 15 s early: 300 m along the track."""
    site.set("logs", sync=None, camera_clock_offset_s=CLOCK, sigma_camera_clock_s=0.3)
    done = only_poses(site)
    off = time_errors(site)
    assert len(off) == 16
    # the clock shows whole seconds, and the tagged places draw the times nearer
    assert max(abs(e) for e, _ in off.values()) < 1.0
    assert max(abs(e) / sigma for e, sigma in off.values()) < 4.0
    done.line("camera clock less UTC")
    assert worst_ratio(site) < 4.0


@pytest.mark.parametrize("held", [True, False], ids=["tags", "trajectory"])
def test_photo_that_was_turned_after_exposure_is_turned_once(site: Site, held: bool) -> None:
    """Angles from the tags have the turn already, those of the trajectory not."""
    name = "IMG_0005"
    site.set("mount", gimbal=held)
    only_poses(site)
    before = rotations(site, "navigation")
    site.set("attitude", rotate_photos={f"{name}.JPG": 180})
    only_poses(site)
    after = rotations(site, "navigation")
    assert set(after) == set(before)
    half = np.diag([-1.0, -1.0, 1.0])
    for photo, R in after.items():
        turn = half if photo == name else np.eye(3)
        np.testing.assert_allclose(R, before[photo] @ turn, atol=1e-6)
    if held:
        tags = rotations(site, "tags")
        np.testing.assert_allclose(after[name], tags[name], atol=1e-6)


@pytest.mark.parametrize("lag", [100.0, -15.0, math.nan])
def test_shutter_lag_that_no_camera_has_is_refused(site: Site, lag: float) -> None:
    site.set("logs", shutter_lag_s=lag)
    done = site.run("--only", STEPS)
    assert done.code != 0
    done.line("shutter_lag_s", "project.toml")
    assert "Traceback" not in done.text


def test_shutter_lag_moves_the_exposures_behind_their_events(site: Site) -> None:
    site.set("logs", shutter_lag_s=0.1)
    only_poses(site)
    off = time_errors(site)
    # s; 0.1 that are not so, and a board that jitters by a millisecond
    assert all(abs(off[name][0] - 0.1) < 0.004 for name in off if name != MISSED)


def test_wrong_shutter_lag_is_contradicted_by_the_tagged_places(site: Site) -> None:
    """1.5 s are 30 m along the track, and about half of the way to the next event."""
    site.set("logs", shutter_lag_s=1.5)
    done = only_poses(site)
    done.line("matched with a confidence of", "keeps the pose of its tags")
    assert len(rows(site, "pose", kind="navigation")) < 16


def without_gps_time(path: Path) -> None:
    """The board never saw a satellite: its times count from power-up, and it says so."""
    lines, start = [], None
    for line in path.read_text().split():
        _, seq, _, tow, pulse, _ = line.partition("*")[0].split(",")
        start = float(tow) - 20.0 if start is None else start
        passed = (float(tow) - start) % GPS_WEEK
        body = f"TSB,{seq},0,{passed:.6f},{pulse},0"
        lines.append(f"${body}*{reduce(xor, body.encode(), 0):02X}")
    path.write_text("\r\n".join(lines) + "\r\n")


def test_events_that_count_from_power_up_are_not_laid_on_gps_time(site: Site) -> None:
    without_gps_time(site.folder / "logs" / "sync_board.log")
    done = only_poses(site)
    done.line("doubt", "no GPS time")
    assert {row[2] for row in photo_times(site).values()} == {"clock"}
    assert len(rows(site, "pose", kind="navigation")) == 16
    assert worst_ratio(site) < 4.0


def test_logs_are_read_once_in_a_run(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    read: list[int] = []
    right = open_log.read_logs

    def counted(*args: object, **options: object) -> object:
        read.append(1)
        return right(*args, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(open_log, "read_logs", counted)
    only_poses(site)
    assert len(read) == 1
    assert sum(row[2] == "event" for row in photo_times(site).values()) == 15
    # a tool by itself reads the log as it is now
    path = site.folder / "logs" / "sync_board.log"
    path.write_bytes(b"".join(path.read_bytes().splitlines(keepends=True)[:-3]))
    assert georef("orient-navigation", "--project", site.folder).code == 0
    assert len(read) == 2
    assert sum(row[2] == "event" for row in photo_times(site).values()) == 12


def delayed(site: Site, late: float) -> None:
    """Stamp every fix late, s."""
    path = site.folder / "logs" / "gnss.csv"
    with path.open() as stream:
        header, *body = list(csv.reader(stream))
    with path.open("w", newline="") as stream:
        out = csv.writer(stream)
        out.writerow(header)
        for row in body:
            week, tow = divmod(float(row[0]) * GPS_WEEK + float(row[1]) + late, GPS_WEEK)
            out.writerow([f"{week:.0f}", f"{tow:.4f}", *row[2:]])


@pytest.mark.parametrize("name", ["ekf9", "gnss", "inertial"])
def test_stated_delay_of_the_fixes_is_taken_out_by_every_filter(site: Site, name: str) -> None:
    """Half a second left in is 10 m along the track."""
    site.set("logs", filter=name)
    site.set("gnss", latency_s=0.0)
    only_poses(site)
    photos, before, _ = errors(site)
    delayed(site, 0.5)
    site.set("gnss", latency_s=0.5)
    only_poses(site)
    again, after, _ = errors(site)
    assert again == photos
    # a photo by the clock alone moves a little with what the tags tell of the track
    sure = np.array([photo != MISSED for photo in photos])
    # m; stamps are written to 0.1 ms, which is 2 mm
    assert np.abs(after[sure, :3] - before[sure, :3]).max() < 0.05
    assert math.degrees(np.abs(after[sure, 3:] - before[sure, 3:]).max()) < 0.05
