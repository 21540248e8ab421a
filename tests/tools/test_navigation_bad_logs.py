"""Logs as they should not be: a clear line and the tags' poses, or sigmas that cover the harm."""

from __future__ import annotations

import csv
import math
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from navigation_cases import (
    errors,
    navigation_site,
    only_poses,
    photo_times,
    rows,
    summary,
    worst_ratio,
)
from tool_cases import SAMPLE, Site, georef

pytestmark = pytest.mark.slow

NOT_USED = "the logs are not used, poses come from the tags"


@pytest.fixture
def site(tmp_path: Path) -> Site:
    if not SAMPLE.is_dir():
        pytest.skip("sample_project is not there")
    return navigation_site(tmp_path)


class Table:
    """A CSV log to be spoilt: a header and rows of numbers."""

    def __init__(self, path: Path) -> None:
        self.path = path
        with path.open() as stream:
            self.header, *body = list(csv.reader(stream))
        self.values = np.array(body, dtype=float)
        self.text = [list(row) for row in body]

    def column(self, name: str) -> int:
        return self.header.index(name)

    @property
    def second(self) -> np.ndarray:  # type: ignore[type-arg]
        """Seconds since the first row, across the turn of the week."""
        week, tow = (self.values[:, self.column(k)] for k in ("gps_week", "tow_s"))
        time = week * 604800.0 + tow
        return np.asarray(time - time[0])

    def write(self, keep: object = None) -> None:
        kept = np.ones(len(self.text), bool) if keep is None else np.asarray(keep)
        with self.path.open("w", newline="") as stream:
            out = csv.writer(stream)
            out.writerow(self.header)
            out.writerows(row for row, k in zip(self.text, kept, strict=True) if k)

    def scale(self, names: str, factor: float) -> None:
        """Scale the columns whose names begin so."""
        for k, name in enumerate(self.header):
            if name.startswith(names):
                for i, row in enumerate(self.text):
                    row[k] = f"{self.values[i, k] * factor:.8f}"

    def rename(self, old: str, new: str) -> None:
        self.header = [name.replace(old, new) for name in self.header]


def imu(site: Site) -> Table:
    return Table(site.folder / "logs" / "imu.csv")


def gnss(site: Site) -> Table:
    return Table(site.folder / "logs" / "gnss.csv")


# -- logs of which nothing can be used ---------------------------------------------------------


def empty(site: Site) -> None:
    imu(site).path.write_bytes(b"")


def header_only(site: Site) -> None:
    table = imu(site)
    table.write(np.zeros(len(table.text), bool))


def garbage(site: Site) -> None:
    gnss(site).path.write_bytes(np.random.default_rng(1).bytes(20_000))


def missing(site: Site) -> None:
    imu(site).path.unlink()


def photo_for_log(site: Site) -> None:
    shutil.copy(site.photos[0], site.folder / "logs" / "gnss.csv")


def two_imus(site: Site) -> None:
    shutil.copy(site.folder / "logs" / "imu.csv", site.folder / "logs" / "imu_2.csv")
    site.set("logs", imu=None, files=["logs/imu.csv", "logs/imu_2.csv"])


def all_nan(site: Site) -> None:
    table = imu(site)
    for row in table.text:
        row[2:] = ["nan"] * 6
    table.write()


def no_position(site: Site) -> None:
    table = gnss(site)
    for row in table.text:
        row[table.column("lat_deg")] = row[table.column("lon_deg")] = ""
    table.write()


def other_day_imu(site: Site) -> None:
    """IMU and GNSS of different days have nothing in common."""
    table = imu(site)
    for row in table.text:
        row[0] = str(int(row[0]) + 3)
    table.write()


def swapped_axes(site: Site) -> None:
    """y where z should be: gravity shows it."""
    table = imu(site)
    for row in table.text:
        row[3], row[4] = row[4], row[3]
        row[6], row[7] = row[7], row[6]
    table.write()


def g_for_m_s2(site: Site) -> None:
    table = imu(site)
    table.scale("accel", 1.0 / 9.80665)
    table.write()


def degrees_for_radians(site: Site) -> None:
    table = imu(site)
    table.scale("gyro", math.degrees(1.0))
    table.write()


REFUSED: list[tuple[Callable[[Site], None], tuple[str, ...]]] = [
    (empty, ("imu.csv", "is empty")),
    (header_only, ("imu.csv",)),
    (garbage, ("gnss.csv", "no known format")),
    (missing, ("imu.csv",)),
    (photo_for_log, ("gnss.csv", "no known format")),
    (two_imus, ("imu.csv", "imu_2.csv", "only one")),
    (all_nan, ("imu.csv",)),
    (no_position, ("gnss.csv",)),
    (other_day_imu, ("imu.csv", "no time in common")),
    (swapped_axes, ("imu.csv", "axes")),
    (g_for_m_s2, ("imu.csv", "g")),
    (degrees_for_radians, ("imu.csv", "deg")),
]


@pytest.mark.parametrize(("spoil", "words"), REFUSED, ids=[f.__name__ for f, _ in REFUSED])
def test_log_that_cannot_be_used_is_named_and_the_tags_serve(
    site: Site, spoil: Callable[[Site], None], words: tuple[str, ...]
) -> None:
    spoil(site)
    done = only_poses(site)
    line = done.line(NOT_USED)
    for word in words:
        assert word in line, line
    assert len(rows(site, "pose", kind="tags")) == 16
    assert rows(site, "pose", kind="navigation") == []
    strict = georef("navigate", "--strict", "--project", site.folder)
    assert strict.code != 0
    assert "Traceback" not in strict.text
    # one line: what, where, cure
    told = [row for row in strict.stderr.splitlines() if row.startswith("georef: ")]
    assert len(told) == 1, strict.text


@pytest.mark.usefixtures("pictures_undrawn")
def test_products_are_finished_without_usable_logs(tmp_path: Path) -> None:
    site = navigation_site(tmp_path, photos=4)
    empty(site)
    done = site.run()
    assert done.code == 0, done.text
    done.line("doubt", NOT_USED)
    assert (site.products / "mosaic.tif").is_file()
    assert len(site.orthos()) == 4


def test_mended_log_is_taken_by_the_next_run(site: Site) -> None:
    good = (site.folder / "logs" / "imu.csv").read_bytes()
    empty(site)
    only_poses(site)
    assert rows(site, "pose", kind="navigation") == []
    (site.folder / "logs" / "imu.csv").write_bytes(good)
    done = only_poses(site)
    assert NOT_USED not in done.text
    assert len(rows(site, "pose", kind="navigation")) == 16


def test_log_that_goes_bad_takes_its_poses_with_it(site: Site) -> None:
    only_poses(site)
    assert len(rows(site, "pose", kind="navigation")) == 16
    empty(site)
    only_poses(site).line(NOT_USED)
    assert rows(site, "pose", kind="navigation") == []
    assert {row[0] for row in photo_times(site).values()} == {None}


# -- logs that are of use in spite of all ------------------------------------------------------


def truncated(site: Site) -> None:
    """The file ends in the middle of a row, after the last photo."""
    path = imu(site).path
    path.write_bytes(path.read_bytes()[:-37])


def nan_cells(site: Site) -> None:
    rng = np.random.default_rng(2)
    for table in (imu(site), gnss(site)):
        for i in rng.choice(len(table.text), 12, replace=False):
            table.text[i][int(rng.integers(2, 6))] = str(rng.choice(["nan", "inf", "", "-inf"]))
        table.write()


def outage(site: Site) -> None:
    table = gnss(site)
    t = table.second
    table.write((t < 20.0) | (t > 80.0))


def jump(site: Site) -> None:
    table = gnss(site)
    k = table.column("lat_deg")
    for i in np.flatnonzero((table.second > 30.0) & (table.second < 40.0)):
        table.text[i][k] = f"{table.values[i, k] + 500.0 / 111_000.0:.9f}"
    table.write()


def saturated(site: Site) -> None:
    table = imu(site)
    for row in table.text:
        for k in (2, 3, 4):
            row[k] = repr(min(0.25, max(-0.25, float(row[k]))))
    table.write()


def repeated_and_late(site: Site) -> None:
    table = imu(site)
    table.text[500] = list(table.text[499])
    table.text[700], table.text[701] = table.text[701], table.text[700]
    table.write()


USEFUL = [truncated, nan_cells, outage, jump, saturated, repeated_and_late]


@pytest.mark.parametrize("spoil", USEFUL, ids=[f.__name__ for f in USEFUL])
def test_poses_of_a_damaged_log_are_within_their_sigmas(
    site: Site, spoil: Callable[[Site], None]
) -> None:
    spoil(site)
    done = only_poses(site)
    assert "Traceback" not in done.text
    names, _, _ = errors(site)
    if not names:
        done.line(NOT_USED)
        return
    assert len(names) == 16
    assert worst_ratio(site) < 4.0


@pytest.mark.parametrize(
    ("spoil", "words"),
    [(jump, ("disagree with the IMU",)), (saturated, ("noisy as stated",))],
    ids=["jump", "saturated"],
)  # fmt: skip
def test_what_is_wrong_with_a_useful_log_is_said(
    site: Site, spoil: Callable[[Site], None], words: tuple[str, ...]
) -> None:
    spoil(site)
    done = only_poses(site)
    assert all(word in done.text for word in words), done.text


@pytest.mark.parametrize(
    "content", [b"", b"\x00\xff\x17" * 900, None], ids=["empty", "garbage", "gone"]
)
def test_sync_log_that_cannot_be_read_leaves_the_clock(site: Site, content: bytes | None) -> None:
    path = site.folder / "logs" / "sync_board.log"
    path.unlink()
    if content is not None:
        path.write_bytes(content)
    done = only_poses(site)
    done.line("doubt", "the exposure events are not used", "sync_board.log")
    assert len(rows(site, "pose", kind="navigation")) == 16
    assert {row[2] for row in photo_times(site).values()} == {"clock"}
    assert worst_ratio(site) < 4.0
    assert georef("navigate", "--strict", "--project", site.folder).code != 0


def test_outage_shows_in_the_sigmas(site: Site) -> None:
    only_poses(site)
    before = {row["photo_id"]: row["sigma_h_m"] for row in rows(site, "pose", kind="navigation")}
    outage(site)
    only_poses(site)
    after = {row["photo_id"]: row["sigma_h_m"] for row in rows(site, "pose", kind="navigation")}
    # photos 6 to 8 are amid the 60 s without fixes: the slow error of 2 m is common to both runs
    for name in ("IMG_0006", "IMG_0007", "IMG_0008"):
        assert after[name] ** 2 - before[name] ** 2 > 0.4**2


def test_log_of_half_of_the_photos_leaves_the_others_to_their_tags(site: Site) -> None:
    for table in (imu(site), gnss(site)):
        table.write(table.second < 50.0)
    done = only_poses(site)
    told = summary(site, "orient_navigation")
    assert told["oriented"] == 8
    assert told["left_to_tags"] == 8
    done.line("8 of 16 photos keep the poses of their tags")
    assert worst_ratio(site) < 4.0


def move_to_another_day(site: Site) -> None:
    for table in (imu(site), gnss(site)):
        for row in table.text:
            row[0] = str(int(row[0]) + 3)
        table.write()


def test_log_of_another_day_leaves_all_to_their_tags(site: Site) -> None:
    move_to_another_day(site)
    done = only_poses(site)
    done.line("doubt", "before the navigated part of the log")
    done.line("16 of 16 photos keep the poses of their tags")
    assert rows(site, "pose", kind="navigation") == []


def test_log_of_another_day_over_the_same_ground_is_doubted(site: Site) -> None:
    """Without events the tagged places tell the clock, and a repeated flight fits them."""
    move_to_another_day(site)
    site.set("logs", sync=None)
    line = only_poses(site).line("doubt", "the camera's clock is 21.2 days behind the logs")
    assert "another flight over the same ground" in line
    # three weeks beside the four hours of the time zone and 13 s of the sample
    off = rows(site, "flight")[0]["clock_offset_s"] + 3 * 7 * 86400.0 + 4 * 3600 + 13.17
    assert abs(off) < 1.0  # s


def test_stationary_log_says_so_or_has_sigmas_to_match(site: Site) -> None:
    """The recorder ran on the bench: fixes scatter round one place, the IMU feels gravity only."""
    rng = np.random.default_rng(4)
    for table in (imu(site), gnss(site)):
        for row in table.text:
            if "accel_x_m_s2" in table.header:
                values = [*(0.002 * rng.normal(size=3)), *(0.02 * rng.normal(size=3))]
                values[5] -= 9.81
                row[2:8] = [f"{v:.6f}" for v in values]
            else:
                place = table.values[0, 2:5] + [1e-5, 1e-5, 1.0] * rng.normal(size=3)
                row[2:8] = [f"{v:.9f}" for v in (*place, *(0.1 * rng.normal(size=3)))]
        table.write()
    done = only_poses(site)
    done.line("doubt", "the heading is not known")
    done.line("doubt", "the trajectory lies", "the poses of the tags are kept")
    assert rows(site, "pose", kind="navigation") == []
