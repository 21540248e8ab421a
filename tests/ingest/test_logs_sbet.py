"""SBET: a flight computed here, turned into Applanix's frame by its definition."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from georef_gis.errors import InputError
from georef_gis.frames import jacobian_theta_ned_from_rpy
from georef_gis.ingest.logs.sbet import looks_like_sbet, read_sbet
from georef_gis.units import GPS_WEEK

WEEK = 2374
START = GPS_WEEK - 5.0  # s; the flight crosses the end of the week


def flight(
    *, wander: float = 0.0, axes: str = "north-west-up", turned: bool = True, n: int = 2000
) -> np.ndarray:
    """Circle of 200 m at 20 m/s, 100 Hz, crab 5 deg; columns of an SBET."""
    t = np.arange(n) * 0.01
    phase = 20.0 / 200.0 * t
    north, east, down = -20 * np.sin(phase), 20 * np.cos(phase), 0.5 * np.cos(0.3 * t)
    radius_m, radius_n = 6_367_500.0, 6_386_700.0
    lat0, lon0, h0 = np.radians(40.1), np.radians(-82.5), 350.0
    # WGS 84 radii at 40.1 deg by hand to 100 m: 2e-5 of the speed
    lat = lat0 + np.concatenate([[0], np.cumsum((north[1:] + north[:-1]) / 2 * 0.01)]) / radius_m
    lon = lon0 + np.concatenate([[0], np.cumsum((east[1:] + east[:-1]) / 2 * 0.01)]) / (
        radius_n * np.cos(lat)
    )
    height = h0 - np.concatenate([[0], np.cumsum((down[1:] + down[:-1]) / 2 * 0.01)])
    yaw = np.arctan2(east, north) + np.radians(5.0)
    a = wander if turned else 0.0
    # x axis of the frame: a to the west of north
    x = north * np.cos(a) - east * np.sin(a)
    y = -north * np.sin(a) - east * np.cos(a)
    velocity = {
        "north-west-up": (x, y, -down),
        "north-east-down": (north, east, down),
        "east-north-up": (east, north, -down),
    }[axes]
    zero = np.zeros(n)
    return np.column_stack(
        [np.mod(START + t, GPS_WEEK), lat, lon, height, *velocity, 0.1 + zero, 0.05 + zero,
         np.mod(yaw + a, 2 * np.pi), wander + zero, *[zero] * 6]
    )  # fmt: skip


def truth(n: int = 2000) -> tuple[np.ndarray, np.ndarray]:
    t = np.arange(n) * 0.01
    phase = 20.0 / 200.0 * t
    v = np.column_stack([-20 * np.sin(phase), 20 * np.cos(phase), 0.5 * np.cos(0.3 * t)])
    return v, np.arctan2(v[:, 1], v[:, 0]) + np.radians(5.0)


@pytest.fixture
def write(tmp_path: Path):
    def put(data: np.ndarray | bytes, name: str = "sbet_mission.out", order: str = "<f8") -> Path:
        path = tmp_path / name
        path.write_bytes(data if isinstance(data, bytes) else data.astype(order).tobytes())
        return path

    return put


def same_direction(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.abs(np.angle(np.exp(1j * (a - b)))).max())


@pytest.mark.parametrize("wander_deg", [0.0, 30.0, -100.0])
def test_wander_angle_is_taken_out_of_headings_and_velocities(write, wander_deg: float) -> None:
    logs = read_sbet(write(flight(wander=np.radians(wander_deg))), week=WEEK)
    log = logs.trajectory
    assert log is not None
    v, yaw = truth()
    assert log.v_ned == pytest.approx(v, abs=1e-9)
    assert same_direction(log.rpy[:, 2], yaw) < 1e-9
    assert log.rpy[0, :2].tolist() == [0.1, 0.05]
    assert logs.doubts == ("has no smrmsg file beside it: its accuracy is not known",)


@pytest.mark.parametrize("axes", ["north-east-down", "east-north-up"])
def test_other_axes_are_found_from_the_positions_and_said(write, axes: str) -> None:
    records = flight(wander=np.radians(20.0), axes=axes, turned=False)
    logs = read_sbet(write(records), week=WEEK)
    log = logs.trajectory
    assert log is not None
    v, yaw = truth()
    assert log.v_ned == pytest.approx(v, abs=1e-9)
    assert same_direction(log.rpy[:, 2], yaw) < 1e-9
    assert any(axes in d and "not used" in d for d in logs.doubts)


def test_velocities_that_fit_no_reading_are_doubted(write) -> None:
    records = flight()
    records[:, 4:7] = records[:, [6, 5, 4]] * 3.0
    logs = read_sbet(write(records), week=WEEK)
    assert any("do not fit its positions" in d for d in logs.doubts)


def test_time_goes_on_over_the_end_of_the_week(write) -> None:
    log = read_sbet(write(flight()), week=WEEK).trajectory
    assert log is not None
    assert log.scale == "gps"
    assert log.time == pytest.approx(WEEK * GPS_WEEK + START + np.arange(2000) * 0.01, abs=1e-6)


def test_without_a_week_times_are_of_the_week_and_that_is_said(write) -> None:
    logs = read_sbet(write(flight()))
    assert logs.trajectory is not None
    assert logs.trajectory.scale == "boot"
    assert logs.trajectory.time[0] == START
    assert any("no GPS week" in d for d in logs.doubts)


def test_big_endian_doubles_are_read_and_said(write) -> None:
    logs = read_sbet(write(flight(), order=">f8"), week=WEEK)
    assert logs.trajectory is not None
    assert np.degrees(logs.trajectory.lat[0]) == pytest.approx(40.1)
    assert any("big-endian" in d for d in logs.doubts)


def test_degrees_for_radians_are_refused_with_the_cause(write) -> None:
    records = flight()
    records[:, 1:3] = np.degrees(records[:, 1:3])
    with pytest.raises(InputError, match=r"latitudes up to 40\.1.* are degrees"):
        read_sbet(write(records))


def test_cut_record_and_numbers_that_are_none_are_named(write) -> None:
    records = flight()
    records[100, 3] = np.nan
    records[200, 0] = np.inf
    logs = read_sbet(write(records.astype("<f8").tobytes() + bytes(57)), week=WEEK)
    assert logs.trajectory is not None
    assert len(logs.trajectory) == 1998
    assert any("last record is cut (57 of 136 bytes)" in d for d in logs.doubts)
    assert any("2 of 2000 records are not finite" in d for d in logs.doubts)


def test_accuracies_beside_it_become_covariances(write) -> None:
    path = write(flight())
    # 1 Hz, minutes of arc
    t = np.mod(START - 0.5 + np.arange(15.0), GPS_WEEK)
    sigmas = [0.02, 0.03, 0.05, 0.01, 0.01, 0.02, 0.6, 0.9, 3.0]
    write(np.column_stack([t, *[np.full(15, s) for s in sigmas]]), "smrmsg_mission.out")
    logs = read_sbet(path, week=WEEK)
    log = logs.trajectory
    assert log is not None
    i = 700
    assert np.sqrt(np.diag(log.covariance[i])[:3]) == pytest.approx([0.02, 0.03, 0.05])
    J = jacobian_theta_ned_from_rpy(*log.rpy[i])
    rpy = np.radians(np.array([0.6, 0.9, 3.0]) / 60.0)
    assert log.covariance[i, 3:, 3:] == pytest.approx(J @ np.diag(rpy**2) @ J.T, abs=1e-15)
    assert not np.any(log.covariance[i, :3, 3:])
    # the last accuracy is of 13.5 s, the flight lasts 20 s
    assert np.isnan(log.covariance[-1, 0, 0])
    assert any("does not span 649 of 2000" in d for d in logs.doubts)


def test_smrmsg_that_is_none_is_said(write) -> None:
    path = write(flight())
    write(b"no doubles at all, but text that is long enough to be one record of 80 bytes, and more",
          "smrmsg_mission.out")  # fmt: skip
    assert any("is no SMRMSG" in d for d in read_sbet(path, week=WEEK).doubts)


def test_long_flight_without_accuracies_takes_no_memory_for_them(write) -> None:
    log = read_sbet(write(flight()), week=WEEK).trajectory
    assert log is not None
    assert log.covariance.shape == (2000, 6, 6)
    assert log.covariance.strides == (0, 0, 0)


@pytest.mark.parametrize(
    "data",
    [b"", b"\0" * 1360, b"text " * 300, bytes(range(256)) * 20, b"\1" * 100,
     np.random.default_rng(1).bytes(13600)],
    ids=["empty", "zeros", "text", "binary", "short", "random"],
)  # fmt: skip
def test_useless_files_are_refused_by_name(write, data: bytes) -> None:
    with pytest.raises(InputError, match=r"sbet_mission\.out"):
        read_sbet(write(data))
    assert not looks_like_sbet(data, Path("sbet_mission.out"))


@pytest.mark.parametrize("order", ["<f8", ">f8"])
def test_head_of_a_trajectory_looks_like_one(order: str) -> None:
    head = flight(n=40).astype(order).tobytes()[:4096]
    assert looks_like_sbet(head, Path("any.out"))
    assert not looks_like_sbet(head[8:], Path("any.out"))


def test_smrmsg_itself_is_refused(write) -> None:
    t = np.arange(40.0) + 1000
    with pytest.raises(InputError, match="no records of an SBET"):
        read_sbet(write(np.column_stack([t, *[np.full(40, 0.02)] * 9])))
