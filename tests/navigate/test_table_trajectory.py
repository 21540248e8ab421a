"""A finished trajectory as any other: interpolation, covariances, gaps, places, its file."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from georef_gis.errors import InputError, NavigationError
from georef_gis.frames import Array, R_ned_from_body, exp_so3, log_so3
from georef_gis.model.logs import TrajectoryLog, unknown
from georef_gis.navigate.table_trajectory import (
    SIGMA_HEADING,
    SIGMA_LEVEL,
    SIGMA_POSITION,
    TableTrajectory,
    of_imu,
)
from georef_gis.simulate.ellipsoid import ecef_from_geodetic, rotation_ecef_from_ned

LAT, LON = math.radians(40.0), math.radians(-100.0)


def angles(t: Array) -> Array:
    """Roll, pitch, yaw of a weaving vehicle whose yaw passes through 360 deg, rad."""
    yaw = np.remainder(2 * math.pi - 0.1 + 0.05 * t, 2 * math.pi)
    return np.stack([0.4 * np.sin(t), 0.1 * np.cos(0.7 * t), yaw], axis=-1)


def made(step: float = 0.1, end: float = 20.0) -> TrajectoryLog:
    t = np.arange(0.0, end + step / 2, step)
    return TrajectoryLog(
        time=1e9 + t, source="truth.csv", lat=LAT + 20.0 * t / 6.36e6, lon=LON + 0.0 * t,
        height=500.0 + 2.0 * np.sin(t), v_ned=np.stack([20 + 0 * t, 0 * t, -2 * np.cos(t)], -1),
        rpy=angles(t), covariance=np.tile(np.diag([0.1, 0.2, 0.3, 0.01, 0.02, 0.03]) ** 2,
                                          (len(t), 1, 1)),
    )  # fmt: skip


def test_states_between_rows_follow_the_vehicle() -> None:
    t = np.array([3.337, 1.951, 14.449])
    states = TableTrajectory(log=made()).at(1e9 + t)
    # Hermite over 0.1 s: micrometres; straight turns between attitudes: 0.4 * 0.1^2 / 8 rad
    assert states.p_geo[:, 2] == pytest.approx(500.0 + 2.0 * np.sin(t), abs=1e-4)
    true = R_ned_from_body(*angles(t).T)
    off = log_so3(true @ np.swapaxes(states.R_ned_from_body, -1, -2))
    assert np.abs(off).max() < 0.0006
    h = 1e-4
    rate = log_so3(
        np.swapaxes(R_ned_from_body(*angles(t - h).T), -1, -2) @ R_ned_from_body(*angles(t + h).T)
    ) / (2 * h)
    # 0.4 rad/s at most, differenced over 0.1 s
    assert states.rate_body == pytest.approx(rate, abs=0.03)


def test_stated_covariances_are_interpolated_and_missing_ones_replaced() -> None:
    log = made()
    given = TableTrajectory(log=log).at(1e9 + 5.03).covariance[0]
    assert given == pytest.approx(log.covariance[0])
    bare = TableTrajectory(log=replace(log, covariance=unknown(len(log), 6, 6)))
    sigma = [SIGMA_POSITION] * 3 + [SIGMA_LEVEL] * 2 + [SIGMA_HEADING]
    assert np.sqrt(np.diag(bare.at(1e9 + 5.03).covariance[0])) == pytest.approx(sigma)
    assert any("no accuracies in 201 of 201 rows" in doubt for doubt in bare.doubts)
    half = log.covariance.copy()
    half[:, 3:, :] = half[:, :, 3:] = np.nan
    mixed = TableTrajectory(log=replace(log, covariance=half)).at(1e9 + 5.03).covariance[0]
    assert np.sqrt(np.diag(mixed)) == pytest.approx([0.1, 0.2, 0.3, *sigma[3:]])


def test_joint_covariance_is_one_and_neighbours_err_alike() -> None:
    table = TableTrajectory(log=made())
    J = table.chain(1e9 + np.array([2.0, 3.0, 18.0])).joint()
    assert np.linalg.eigvalsh(J).min() > 0.0
    correlation = J[0, 6] / math.sqrt(J[0, 0] * J[6, 6])
    assert correlation == pytest.approx(math.exp(-1.0 / 30.0), rel=1e-3)
    assert J[0, 12] < J[0, 6]


def test_times_outside_and_in_gaps_are_refused() -> None:
    log = made()
    keep = (log.time < 1e9 + 8.0) | (log.time > 1e9 + 11.0)
    names = ("time", "lat", "lon", "height", "v_ned", "rpy", "covariance")
    table = TableTrajectory(log=replace(log, **{name: getattr(log, name)[keep] for name in names}))
    assert "before" in table.why_not(1e9 - 0.5)
    assert "after" in table.why_not(1e9 + 20.6)
    assert "gap of 3." in table.why_not(1e9 + 9.0)
    assert "not known" in table.why_not(math.nan)
    assert table.why_not(1e9 + 7.5) == ""
    for time in (-0.5, 9.0, 20.6):
        with pytest.raises(NavigationError):
            table.at(1e9 + time)
        with pytest.raises(NavigationError):
            table.chain([1e9 + time])


def test_log_without_attitude_or_rows_is_refused() -> None:
    log = made()
    with pytest.raises(NavigationError, match="no attitude"):
        TableTrajectory(log=replace(log, rpy=unknown(len(log), 3)))
    with pytest.raises(NavigationError, match="1 rows; two are needed"):
        TableTrajectory(log=made(step=1.0, end=0.0))


@pytest.mark.parametrize("place", ["antenna", "camera"])
def test_trajectory_of_another_place_is_carried_to_the_imu(place: str) -> None:
    """Lever arms of metres, on the ellipsoid of the simulator."""
    log = made()
    arms = {"antenna": np.array([-8.0, 1.0, -3.0]), "camera": np.array([0.5, -2.0, 4.0])}
    R_ecef_body = rotation_ecef_from_ned(log.lat, log.lon) @ R_ned_from_body(*log.rpy.T)
    imu = ecef_from_geodetic(log.lat, log.lon, log.height)
    there = imu + R_ecef_body @ arms[place]
    from georef_gis.simulate.ellipsoid import geodetic_from_ecef

    lat, lon, height = geodetic_from_ecef(there)
    moved = replace(log, lat=lat, lon=lon, height=height, position_of=place)
    back = of_imu(moved, arms["antenna"], arms["camera"])
    assert back.position_of == "imu"
    # 0.1 mm: eight metres turn the vertical by a microradian
    assert ecef_from_geodetic(back.lat, back.lon, back.height) == pytest.approx(imu, abs=1e-4)
    assert of_imu(log, arms["antenna"], arms["camera"]) is log


def test_file_gives_the_trajectory_back(tmp_path: Path) -> None:
    table = TableTrajectory(log=replace(made(), doubts=("its datum is not known",)))
    table.save(tmp_path / "trajectory.npz")
    again = TableTrajectory.load(tmp_path / "trajectory.npz")
    time = 1e9 + 3.3
    assert again.log.doubts == table.log.doubts
    assert again.log.source == "truth.csv"
    for name in ("p_geo", "v_ned", "R_ned_from_body", "covariance"):
        assert np.array_equal(getattr(again.at(time), name), getattr(table.at(time), name)), name
    (tmp_path / "trajectory.npz").write_bytes((tmp_path / "trajectory.npz").read_bytes()[:1000])
    with pytest.raises(InputError, match="holds no columns of ours"):
        TableTrajectory.load(tmp_path / "trajectory.npz")


def test_rows_without_attitude_amid_others_give_no_pose_or_a_finite_one() -> None:
    log = made()
    rpy = log.rpy.copy()
    rpy[50:80] = np.nan
    table = TableTrajectory(log=replace(log, rpy=rpy))
    inside = 1e9 + 6.5
    assert "attitude" in table.why_not(inside)
    with pytest.raises(NavigationError, match="attitude"):
        table.at(inside)
    turned = table.at(1e9 + 3.0).R_ned_from_body[0]
    assert turned @ exp_so3(-log_so3(turned)) == pytest.approx(np.eye(3), abs=1e-9)
