"""`georef run` with logs: the sample flight, other logs, other filters, other ground."""

from __future__ import annotations

import csv
import math
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from navigation_cases import (
    STEPS,
    errors,
    flight,
    navigation_site,
    only_poses,
    photo_times,
    rows,
    summary,
    truth,
    worst_ratio,
)
from scipy.stats import chi2
from tool_cases import SAMPLE, Site, georef

from georef_gis.simulate.ellipsoid import geodetic_from_ecef, rotation_ecef_from_ned
from georef_gis.units import GPS_WEEK

pytestmark = pytest.mark.slow

MISSED = "IMG_0002"
TAGS_ALONE = "read_photos,orient_direct,footprints,control"
TO_CONTROL = f"{STEPS},match,adjust,footprints,control"


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> Site:
    """The sample project with all its photos and the steps to its poses and control."""
    if not SAMPLE.is_dir():
        pytest.skip("sample_project is not there")
    site = navigation_site(tmp_path_factory.mktemp("navigation"))
    quick = site.run("--quick", "--only", TAGS_ALONE)
    assert quick.code == 0, quick.text
    (site.folder / "quick.txt").write_text(quick.text)
    done = site.run("--only", TO_CONTROL)
    assert done.code == 0, done.text
    (site.folder / "full.txt").write_text(done.text)
    return site


@pytest.fixture
def oriented(tmp_path: Path) -> Site:
    if not SAMPLE.is_dir():
        pytest.skip("sample_project is not there")
    return navigation_site(tmp_path)


def marks_off(text: str) -> float:
    found = re.search(r"lie off by ([\d.]+) (c?m) east, ([\d.]+) (c?m) north", text)
    assert found, text
    unit = {"m": 1.0, "cm": 0.01}
    return math.hypot(float(found[1]) * unit[found[2]], float(found[3]) * unit[found[4]])


# -- the sample as it is -----------------------------------------------------------------------


def test_every_photo_has_a_pose_of_the_trajectory(ran: Site) -> None:
    assert len(rows(ran, "pose", kind="navigation")) == 16
    assert len(rows(ran, "pose", kind="tags")) == 16
    told = summary(ran, "orient_navigation")
    assert told["oriented"] == 16
    assert told["left_to_tags"] == 0


def test_fifteen_photos_have_their_own_event(ran: Site) -> None:
    epoch = float(ran.row("SELECT value FROM meta WHERE key = 'epoch'")[0][0])
    times = photo_times(ran)
    for name, (time, sigma, source, confidence) in times.items():
        true = truth()[name]
        exposed = int(true["gps_week"]) * GPS_WEEK + float(true["tow_s"])
        if name == MISSED:
            assert source == "clock"
            assert abs(time + epoch - exposed) < 3.0 * sigma
            continue
        assert source == "event"
        assert confidence > 0.99
        # the board jitters by a millisecond
        assert abs(time + epoch - exposed) < 0.004, name


def test_poses_agree_with_the_truth_within_their_covariances(ran: Site) -> None:
    names, off, C = errors(ran)
    assert len(names) == 16
    each = np.einsum("ni,nij,nj->n", off, np.linalg.inv(C), off)
    # slow error, boresight and so on are shared: the mean has hardly more freedom than one photo
    low, high = chi2.ppf([0.0005, 0.9995], 6)
    assert low < each.mean() < high
    assert worst_ratio(ran) < 4.0


def test_poses_are_nearer_to_the_truth_than_the_tags(ran: Site) -> None:
    _, ours, _ = errors(ran)
    _, tags, _ = errors(ran, "tags")
    for part in (slice(0, 3), slice(3, 6)):
        assert np.sum(ours[:, part] ** 2) < 0.6 * np.sum(tags[:, part] ** 2)


def test_control_and_check_points_fit_better_than_with_the_tags(ran: Site) -> None:
    quick, full = (marks_off((ran.folder / f"{k}.txt").read_text()) for k in ("quick", "full"))
    assert full < 0.8 * quick


def test_unchanged_run_makes_nothing_again(ran: Site) -> None:
    before = (ran.folder / "navigation" / "trajectory.npz").stat().st_mtime_ns
    done = ran.run("--only", TO_CONTROL)
    assert done.code == 0
    done.line("steps were unchanged")
    assert (ran.folder / "navigation" / "trajectory.npz").stat().st_mtime_ns == before


def test_trajectory_agrees_with_the_simulated_flight(ran: Site, tmp_path: Path) -> None:
    write_table(tmp_path / "truth.csv")
    done = georef("compare-trajectory", ran.folder, tmp_path / "truth.csv", "--target",
                  tmp_path / "compared")  # fmt: skip
    assert done.code == 0, done.text
    assert len(list((tmp_path / "compared").glob("*.png"))) >= 3
    with (tmp_path / "compared" / "statistics.csv").open() as stream:
        told = list(csv.DictReader(stream))
    assert told


def test_tagged_copies_carry_the_poses_of_the_trajectory(ran: Site, tmp_path: Path) -> None:
    import piexif

    done = georef("export-tagged-photos", "--project", ran.folder, "--target", tmp_path / "tagged")
    assert done.code == 0, done.text
    copies = sorted((tmp_path / "tagged").rglob("*.JPG"))
    assert len(copies) == 16
    for path in copies:
        gps = piexif.load(str(path))["GPS"]
        (d, dn), (m, mn), (s, sn) = gps[piexif.GPSIFD.GPSLatitude]
        lat = d / dn + m / mn / 60 + s / sn / 3600
        true = float(truth()[path.stem]["lat_deg"])
        # 1.7 m of slow error per axis
        assert abs(lat - true) * 111_000 < 8.0
        heading = gps[piexif.GPSIFD.GPSImgDirection]
        turn = heading[0] / heading[1] - float(truth()[path.stem]["yaw_deg"])
        assert abs((turn + 180) % 360 - 180) < 8.0


def test_without_logs_the_tags_count_again(ran: Site, tmp_path: Path) -> None:
    shutil.copytree(ran.folder, tmp_path / "site")
    site = Site(tmp_path / "site")
    text = (site.folder / "project.toml").read_text()
    (site.folder / "project.toml").write_text(re.sub(r"(?m)^(imu|gnss|sync) = .*$", "", text))
    only_poses(site)
    assert rows(site, "pose", kind="navigation") == []
    assert set(photo_times(site).values()) == {(None, None, "", None)}
    assert not (site.folder / "navigation" / "trajectory.npz").exists()
    bare = navigation_site(tmp_path / "bare")
    bare.set("logs", imu=None, gnss=None, sync=None)
    only_poses(bare)
    mine, theirs = (
        {row["photo_id"]: row["rotation"] for row in rows(s, "pose", kind="tags")}
        for s in (site, bare)
    )
    assert mine == theirs


# -- other logs and filters --------------------------------------------------------------------


@pytest.mark.parametrize("name", ["gnss", "ekf9", "inertial"])
def test_every_filter_gives_honest_poses(oriented: Site, name: str) -> None:
    oriented.set("logs", filter=name)
    only_poses(oriented)
    assert len(rows(oriented, "pose", kind="navigation")) == 16
    assert worst_ratio(oriented) < 4.0


def true_states(rate: float) -> tuple[np.ndarray, ...]:  # type: ignore[type-arg]
    """GPS time s, (lat, lon, h), v_ned, rpy of the IMU; without error."""
    made = flight()
    t = np.arange(0.0, made.path.duration - 0.2, 1.0 / rate)
    states = made.path.states(t)
    lat, lon, h = geodetic_from_ecef(states.p_ecef)
    v = np.einsum("nji,nj->ni", rotation_ecef_from_ned(lat, lon), states.v_ecef)
    return made.start_gps + t, np.stack([lat, lon, h], axis=-1), v, states.rpy


def write_sbet(path: Path) -> None:
    """POSPac's record: time of week, place, velocity north-west-up, angles, wander angle 0."""
    t, geo, v, rpy = true_states(50.0)
    # POSPac counts on through the turn of the week of its first record
    record = np.zeros((len(t), 17))
    record[:, 0] = t - math.floor(t[0] / GPS_WEEK) * GPS_WEEK
    record[:, 1:4] = geo
    record[:, 4:7] = v * [1.0, -1.0, -1.0]
    record[:, 7:10] = rpy
    path.write_bytes(record.astype("<f8").tobytes())


def write_table(
    path: Path, place: str = "imu", arm: tuple[float, float, float] = (0, 0, 0)
) -> None:
    t, geo, v, rpy = true_states(20.0)
    if any(arm):
        from georef_gis.simulate.ellipsoid import ecef_from_geodetic

        states = flight().path.states(t - flight().start_gps)
        p = ecef_from_geodetic(*geo.T) + states.R_ecef_from_body @ np.array(arm, float)
        geo = np.stack(geodetic_from_ecef(p), axis=-1)
    with path.open("w") as stream:
        stream.write(f"# place: {place}\n")
        stream.write("gps_week,tow_s,lat_deg,lon_deg,height_ellipsoidal_m,v_north,v_east,v_down,"
                     "roll_deg,pitch_deg,yaw_deg,sigma_north_m,sigma_east_m,sigma_down_m,"
                     "sigma_roll_deg,sigma_pitch_deg,sigma_yaw_deg\n")  # fmt: skip
        for i, time in enumerate(t):
            week, tow = divmod(time, GPS_WEEK)
            numbers = [*np.degrees(geo[i, :2]), geo[i, 2], *v[i], *np.degrees(rpy[i])]
            cells = ",".join(f"{x:.9f}" for x in [tow, *numbers])
            stream.write(f"{week:.0f},{cells},0.05,0.05,0.05,0.02,0.02,0.05\n")


@pytest.mark.parametrize("form", ["sbet", "csv"])
def test_finished_trajectory_gives_the_poses(oriented: Site, form: str) -> None:
    path = oriented.folder / "logs" / f"finished.{form}"
    (write_sbet if form == "sbet" else write_table)(path)
    (oriented.folder / "logs" / "imu.csv").unlink()
    (oriented.folder / "logs" / "gnss.csv").unlink()
    oriented.set("logs", imu=None, gnss=None, trajectory=f"logs/finished.{form}")
    only_poses(oriented)
    names, off, _ = errors(oriented)
    assert len(names) == 16
    sure = np.array([name != MISSED for name in names])
    # lever arms of 1 cm, events of 1 ms at 20 m/s, and the interpolation
    assert np.abs(off[sure, :3]).max() < 0.15
    # the boresight, which is drawn with 1 deg and is 0.83 deg long about one axis here
    assert np.degrees(np.abs(off[sure, 3:])).max() < 2.0
    assert worst_ratio(oriented) < 4.0


@pytest.mark.parametrize(
    ("place", "key", "arm"),
    [("antenna", "lever_arm_antenna_m", (-8.0, 1.0, -3.0)),
     ("camera", "lever_arm_camera_m", (5.0, -2.0, 4.0))],
)  # fmt: skip
def test_trajectory_of_antenna_or_camera_is_carried_to_the_camera(
    oriented: Site, place: str, key: str, arm: tuple[float, float, float]
) -> None:
    """Long arms, so that a forgotten one stands out; the true camera stays where it is."""
    true_camera = np.array(flight().lever_arm_camera)
    path = oriented.folder / "logs" / "finished.csv"
    write_table(path, place, tuple(arm) if place == "antenna" else tuple(true_camera))
    values = {"lever_arm_camera_m": [round(float(x), 4) for x in true_camera]}
    if place == "antenna":
        values[key] = list(arm)
    oriented.set("mount", **values)
    oriented.set("logs", imu=None, gnss=None, trajectory="logs/finished.csv")
    only_poses(oriented)
    names, off, _ = errors(oriented)
    sure = np.array([name != MISSED for name in names])
    # a time 1 ms off is 2 cm, and interpolation over 50 ms
    assert np.abs(off[sure, :3]).max() < 0.1


def test_autopilots_attitude_serves_where_there_is_no_imu(oriented: Site) -> None:
    t, _, _, rpy = true_states(10.0)
    rng = np.random.default_rng(3)
    noisy = np.degrees(rpy) + [0.8, 0.8, 2.0] * rng.normal(size=3)
    with (oriented.folder / "logs" / "attitude.csv").open("w") as stream:
        stream.write("gps_week,tow_s,roll_deg,pitch_deg,yaw_deg\n")
        for time, (r, p, y) in zip(t, noisy, strict=True):
            week, tow = divmod(time, GPS_WEEK)
            stream.write(f"{week:.0f},{tow:.4f},{r:.5f},{p:.5f},{y % 360.0:.5f}\n")
    oriented.set("logs", imu=None, attitude="logs/attitude.csv")
    only_poses(oriented)
    assert len(rows(oriented, "pose", kind="navigation")) == 16
    assert worst_ratio(oriented) < 4.0


# -- exposures ---------------------------------------------------------------------------------


def test_without_sync_log_the_tagged_places_set_the_clock(oriented: Site) -> None:
    oriented.set("logs", sync=None)
    only_poses(oriented)
    assert len(rows(oriented, "pose", kind="navigation")) == 16
    assert worst_ratio(oriented) < 4.0
    row = rows(oriented, "flight")[0]
    # local time is 4 h and 13.17 s behind UTC, which is 15 s behind GPS
    assert abs(row["clock_offset_s"] + 4 * 3600 + 13.17) < 4.0 * row["clock_sigma_s"] + 0.5


def test_photos_without_a_clock_are_matched_in_their_order(oriented: Site) -> None:
    import piexif

    for path in oriented.photos:
        exif = piexif.load(str(path))
        for tag in (piexif.ExifIFD.DateTimeOriginal, piexif.ExifIFD.DateTimeDigitized):
            exif["Exif"].pop(tag, None)
        exif["0th"].pop(piexif.ImageIFD.DateTime, None)
        piexif.insert(piexif.dump(exif), str(path))
    done = only_poses(oriented)
    # as many events as photos, of which one is missing and one is another's: the order alone takes
    # 16 for 16, but the tagged places contradict it from the second photo to the eighth
    times = photo_times(oriented)
    sure = {name for name, row in times.items() if row[3] > 0.99}
    assert sure == {name for name in times if not "IMG_0002" <= name <= "IMG_0008"}
    assert {row["photo_id"] for row in rows(oriented, "pose", kind="navigation")} == sure
    done.line("7 of 16 photos keep the poses of their tags")
    assert worst_ratio(oriented) < 4.0


# -- mount and ground --------------------------------------------------------------------------


def test_image_top_that_the_tags_contradict_is_noticed(oriented: Site) -> None:
    oriented.set("mount", image_top="back")
    done = only_poses(oriented)
    line = done.line("image_top", "tags and trajectory differ by")
    found = re.search(r"differ by (\d+) deg", line)
    assert found
    # 180 deg but for the boresight and the crab angle that the tags miss
    assert 170 < int(found[1]) <= 180


def test_flat_ground_from_the_tags_keeps_the_height_above_it(oriented: Site) -> None:
    oriented.set("ground", dem=None, height_m=None, dem_height_kind=None, height_kind=None)
    oriented.set("ground", height_above_ground_m=66.0)
    only_poses(oriented)
    tags, ours = (
        {row["photo_id"]: row["height_above_ground_m"] for row in rows(oriented, "pose", kind=k)}
        for k in ("tags", "navigation")
    )
    assert set(tags) == set(ours)
    off = np.array([ours[k] - tags[k] for k in tags])
    # the ground hangs below the tags: their middle counts, single ones scatter by 2 m
    assert abs(np.median(off)) < 0.5
    assert np.abs(off).max() < 8.0


# -- the tools by themselves -------------------------------------------------------------------


def test_plots_are_written_on_request(oriented: Site) -> None:
    assert georef("read-photos", "--project", oriented.folder).code == 0
    done = georef("navigate", "--plots", "--project", oriented.folder)
    assert done.code == 0, done.text
    for name in ("attitude.png", "innovations.png", "position.png"):
        data = (oriented.folder / "navigation" / "plots" / name).read_bytes()
        assert data.startswith(b"\x89PNG")
        assert len(data) > 10_000
    # none of them outlives its trajectory
    before = data
    oriented.set("logs", filter="gnss")
    assert georef("navigate", "--project", oriented.folder).code == 0
    folder = oriented.folder / "navigation" / "plots"
    assert {path.name for path in folder.iterdir()} == {"attitude.png", "position.png"}
    assert (folder / "position.png").read_bytes() != before
    (oriented.folder / "navigation" / "plots" / "mine.txt").write_text("a note")
    (oriented.folder / "logs" / "imu.csv").write_bytes(b"")
    assert georef("navigate", "--plots", "--project", oriented.folder).code == 0
    left = (oriented.folder / "navigation").rglob("*.*")
    assert [path.name for path in left] == ["mine.txt"]


def test_project_without_a_trajectory_says_so_in_words(oriented: Site) -> None:
    (oriented.folder / "logs" / "imu.csv").write_bytes(b"")
    only_poses(oriented)
    done = georef("compare-trajectory", oriented.folder, oriented.folder / "logs" / "gnss.csv")
    assert done.code != 0
    done.line("has no trajectory", str(oriented.folder), "georef navigate --strict")
    assert "Errno" not in done.text


def test_map_names_columns_of_its_own(oriented: Site) -> None:
    path = oriented.folder / "logs" / "imu.csv"
    lines = path.read_text().splitlines()
    lines[0] = "week,sow,a,b,c,d,e,f"
    path.write_text("\n".join(lines) + "\n")
    assert georef("read-photos", "--project", oriented.folder).code == 0
    bare = georef("navigate", "--strict", "--project", oriented.folder)
    assert bare.code != 0
    assert "imu.csv" in bare.text
    maps = ["gps_week=week", "tow=sow:s", "gyro_x=a:rad/s", "gyro_y=b:rad/s", "gyro_z=c:rad/s",
            "accel_x=d:m/s2", "accel_y=e:m/s2", "accel_z=f:m/s2"]  # fmt: skip
    words = [word for text in maps for word in ("--map", f"imu.csv/{text}")]
    done = georef("navigate", "--strict", "--project", oriented.folder, *words)
    assert done.code == 0, done.text
    # the events are read again, by the same columns
    assert georef("orient-direct", "--project", oriented.folder).code == 0
    done = georef("orient-navigation", "--project", oriented.folder)
    assert done.code == 0, done.text
    assert len(rows(oriented, "pose", kind="navigation")) == 16
