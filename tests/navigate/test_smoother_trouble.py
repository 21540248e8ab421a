"""Logs as they come: outages, jumps, gaps, wrong units, waiting. A word or an honest sigma."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

import numpy as np
import pytest
from analytic_flights import multirotor, standing, straight, waiting_first
from navigation_flights import drawn, errors_at, logs_of, settings_of, smoothed

from georef_gis.errors import NavigationError
from georef_gis.frames import Array
from georef_gis.model.logs import AidLog, GnssLog, ImuLog, TimedLog, unknown
from georef_gis.navigate.gnss_noise import prepare_fixes
from georef_gis.navigate.inertial_solution import smooth_flight
from georef_gis.navigate.trajectory import InertialTrajectory
from georef_gis.navigate.tuning import tune
from georef_gis.simulate import SimulatedFlight

Log = TypeVar("Log", bound=TimedLog)
SURVEY = drawn(1, 4, gnss="white")
# s on the GPS scale at which trouble begins
WHEN = SURVEY.start_gps + 100.0


def chosen(log: Log, rows: Array) -> Log:
    """Some rows of a log."""
    columns = {
        f.name: getattr(log, f.name)[rows]
        for f in dataclasses.fields(log)
        if isinstance(getattr(log, f.name), np.ndarray)
    }
    return replace(log, **columns)


def ratios(
    flight: SimulatedFlight, trajectory: InertialTrajectory, times: Array
) -> tuple[Array, Array, Array]:
    """Errors, sigmas and their ratio at times, (n, 6) each; m and rad."""
    error = errors_at(flight, trajectory, times)
    sigma = np.sqrt(np.einsum("nii->ni", trajectory.at(times).covariance))
    return error, sigma, error / sigma


def spread(trajectory: InertialTrajectory, step: float = 1.7) -> Array:
    """Times over the whole trajectory at which there is a state, s."""
    times = np.arange(trajectory.span[0] + 1.0, trajectory.span[1] - 1.0, step)
    return times[[not trajectory.why_not(t) for t in times]]


def solved(imu: ImuLog, gnss: GnssLog) -> InertialTrajectory:
    return smooth_flight(imu, prepare_fixes(gnss), settings_of(SURVEY))


@pytest.fixture(scope="module")
def usual() -> InertialTrajectory:
    return solved(*logs_of(SURVEY))


@pytest.mark.parametrize("gnss", ["white", "coloured"])
def test_outage_of_a_minute_widens_the_sigma_that_covers_the_error(gnss: str) -> None:
    squares, wider = [], []
    for seed in range(3):
        flight = drawn(seed, 4, gnss=gnss)
        log, fixes = logs_of(flight)
        begin = flight.start_gps + 90.0
        fixes = chosen(fixes, (fixes.time < begin) | (fixes.time > begin + 60.0))
        trajectory = smooth_flight(log, prepare_fixes(fixes), settings_of(flight))
        inside = begin + np.arange(5.0, 60.0, 5.0)
        error, sigma, ratio = ratios(flight, trajectory, inside)
        assert np.abs(error[:, :3]).max() < 15.0  # m: half a minute of free inertial navigation
        squares.append(ratio**2)
        before = ratios(flight, trajectory, begin - np.array([20.0, 10.0]))[1]
        wider.append(sigma[:, :3].max() / before[:, :3].max())
    assert np.sqrt(np.max(squares)) < 4.5
    assert 0.6 < np.sqrt(np.mean(squares)) < 1.5
    assert min(wider) > (2.0 if gnss == "white" else 1.01)  # 2 m of slow error hide the growth


@pytest.mark.parametrize("count", [1, 5, 50, 150])
def test_jump_of_five_hundred_metres_does_not_move_the_path(
    count: int, usual: InertialTrajectory
) -> None:
    log, gnss = logs_of(SURVEY)
    lat = gnss.lat.copy()
    first = int(np.searchsorted(gnss.time, WHEN))
    lat[first : first + count] += 500.0 / 6.36e6
    trajectory = solved(log, replace(gnss, lat=lat))
    end = gnss.time[min(first + count, len(gnss) - 1)]
    times = np.arange(WHEN - 20.0, min(end + 20.0, trajectory.span[1] - 1.0), 1.3)
    error, _, ratio = ratios(SURVEY, trajectory, times)
    # half a minute of wrong fixes may be believed, but never at a sigma that denies them
    assert np.abs(ratio[:, :3]).max() < 5.0
    if count <= 50:
        assert np.abs(error[:, :3]).max() < 2.0  # m
        p, before = trajectory.at(times).p_geo, usual.at(times).p_geo
        assert np.abs((p - before) * [6.36e6, 5e6, 1.0]).max() < 0.5  # m: hardly felt at all
    if count >= 50:
        assert any("GNSS positions disagree" in doubt for doubt in trajectory.doubts)


def test_velocity_that_jumps_does_not_move_the_path() -> None:
    log, gnss = logs_of(SURVEY)
    v = gnss.v_ned.copy()
    first = int(np.searchsorted(gnss.time, WHEN))
    v[first : first + 10] += [30.0, -20.0, 5.0]
    trajectory = solved(log, replace(gnss, v_ned=v))
    _, _, ratio = ratios(SURVEY, trajectory, np.arange(WHEN - 10.0, WHEN + 20.0, 0.7))
    assert np.abs(ratio).max() < 5.0


def test_gap_of_the_imu_of_a_third_of_a_second_is_bridged() -> None:
    log, gnss = logs_of(SURVEY)
    trajectory = solved(chosen(log, (log.time < WHEN) | (log.time > WHEN + 0.3)), gnss)
    assert trajectory.why_not(WHEN + 0.15) == ""
    times = np.concatenate([np.arange(WHEN - 5.0, WHEN + 5.0, 0.31), [WHEN + 0.15]])
    assert np.abs(ratios(SURVEY, trajectory, times)[2]).max() < 4.5


def test_gap_of_the_imu_of_three_seconds_is_refused_and_spoils_nothing_beside_it() -> None:
    worst = []
    for begin in (WHEN, WHEN + 10.0, WHEN + 20.0, WHEN + 31.0):
        log, gnss = logs_of(SURVEY)
        trajectory = solved(chosen(log, (log.time < begin) | (log.time > begin + 3.0)), gnss)
        why = trajectory.why_not(begin + 1.5)
        assert "gap of 3.0 s" in why
        with pytest.raises(NavigationError, match=r"gap of 3\.0 s"):
            trajectory.at([begin - 5.0, begin + 1.5])
        with pytest.raises(NavigationError, match=r"gap of 3\.0 s"):
            trajectory.joint_covariance([begin + 1.5])
        beside = np.concatenate([begin - np.arange(0.1, 8.0, 0.6), begin + np.arange(3.1, 11, 0.6)])
        # through the gap is another matter: both sides stay correlated
        joint = trajectory.joint_covariance(np.sort(beside)[[0, -1]])
        assert np.linalg.eigvalsh(joint)[0] > 0.0
        worst.append(np.abs(ratios(SURVEY, trajectory, beside)[2]).max())
    assert max(worst) < 5.0


def test_fixes_logged_twice_change_nothing(usual: InertialTrajectory) -> None:
    log, gnss = logs_of(SURVEY)
    rows = np.sort(np.concatenate([np.arange(len(gnss)), np.arange(50, 150)]))
    trajectory = solved(log, chosen(gnss, rows))
    times = spread(usual, 7.0)
    a, b = usual.at(times), trajectory.at(times)
    assert np.abs((a.p_geo - b.p_geo) * [6.36e6, 5e6, 1.0]).max() < 0.05  # m
    np.testing.assert_allclose(
        np.einsum("nii->ni", a.covariance), np.einsum("nii->ni", b.covariance), rtol=0.1
    )


@pytest.mark.parametrize("gnss", ["white", "coloured"])
def test_positions_once_a_second_without_velocity_are_enough(gnss: str) -> None:
    squares = []
    for seed in range(3):
        flight = drawn(seed, 4, gnss=gnss)
        log, fixes = logs_of(flight)
        n = len(fixes)
        fixes = replace(fixes, v_ned=unknown(n, 3), covariance_v_ned=unknown(n, 3, 3))
        fixes = chosen(fixes, np.arange(n) % 5 == 0)
        trajectory = smooth_flight(log, prepare_fixes(fixes), settings_of(flight))
        assert trajectory.doubts == ()
        error, _, ratio = ratios(flight, trajectory, spread(trajectory))
        assert np.degrees(np.abs(error[:, 3:]).max()) < 3.0
        squares.append(np.mean(ratio**2, axis=0))
    found = np.sqrt(np.mean(squares, axis=0))
    assert np.sqrt(np.mean(found[:3] ** 2)) < 1.5
    assert np.sqrt(np.mean(found[3:] ** 2)) < 1.5


@pytest.mark.parametrize(("gnss_rate", "imu_rate"), [(20.0, 100.0), (10.0, 50.0), (1.0, 400.0)])
def test_other_rates_are_as_honest(gnss_rate: float, imu_rate: float) -> None:
    squares = []
    for seed in range(3):
        flight = drawn(seed, 2, gnss="white", gnss_rate=gnss_rate, imu_rate=imu_rate)
        trajectory = smoothed(flight)
        assert trajectory.doubts == ()
        squares.append(np.mean(ratios(flight, trajectory, spread(trajectory))[2] ** 2, axis=0))
    found = np.sqrt(np.mean(squares, axis=0))
    assert 0.5 < np.sqrt(np.mean(found[:3] ** 2)) < 1.5
    assert 0.3 < np.sqrt(np.mean(found[3:] ** 2)) < 1.6  # three flights: few values of the biases


def test_jittering_stamps_of_the_imu_are_taken_as_they_are() -> None:
    """Samples at uneven times, each the true rate at its own time."""
    log, gnss = logs_of(SURVEY)
    keep = np.random.default_rng(5).random(len(log)) > 0.2
    trajectory = solved(chosen(log, keep), gnss)
    assert len(trajectory.gaps) == 0
    assert np.abs(ratios(SURVEY, trajectory, spread(trajectory))[2]).max() < 5.0


def test_logs_that_do_not_overlap_are_named_with_both_spans() -> None:
    log, gnss = logs_of(SURVEY)
    late = replace(gnss, time=gnss.time + 604800.0)
    with pytest.raises(NavigationError) as caught:
        solved(log, late)
    word = str(caught.value)
    for time in (log.time[0], log.time[-1], late.time[0], late.time[-1]):
        assert f"{time:.1f}" in word
    assert "do not overlap" in word
    assert "\n" not in word


def test_photo_outside_of_the_log_is_refused_with_how_far(usual: InertialTrajectory) -> None:
    first, last = usual.span
    assert "12.0 s before" in usual.why_not(first - 12.0)
    assert "3.5 s after" in usual.why_not(last + 3.5)
    assert usual.why_not(math.nan) == "its time is not known"
    assert usual.why_not(first) == usual.why_not(last) == ""
    for time in (first - 12.0, last + 3.5, math.nan, math.inf):
        with pytest.raises(NavigationError):
            usual.at(time)
        with pytest.raises(NavigationError):
            usual.states(time)


def or_word(run: Callable[[], InertialTrajectory]) -> InertialTrajectory | str:
    """What a run gives, or the word with which it is refused."""
    try:
        return run()
    except NavigationError as error:
        return str(error)


Damage = Callable[[ImuLog], ImuLog]
WRONG: dict[str, Damage] = {
    "gyro in deg/s": lambda log: replace(log, gyro=np.degrees(log.gyro)),
    "force in g": lambda log: replace(log, accel=log.accel / 9.80665),
    "x and y swapped": lambda log: replace(
        log, gyro=log.gyro[:, [1, 0, 2]], accel=log.accel[:, [1, 0, 2]]
    ),
    "gyro z reversed": lambda log: replace(log, gyro=log.gyro * [1.0, 1.0, -1.0]),
    "gravity added": lambda log: replace(log, accel=log.accel + np.array([0.0, 0.0, 9.80665])),
    "gyro saturates": lambda log: replace(log, gyro=np.clip(log.gyro, -0.15, 0.15)),
    "clock 2 s off": lambda log: replace(log, time=log.time + 2.0),
    "force reversed": lambda log: replace(log, accel=-log.accel),
}


@pytest.mark.parametrize("what", list(WRONG))
def test_wrong_imu_is_refused_or_its_sigma_says_so(what: str) -> None:
    log, gnss = logs_of(SURVEY)
    trajectory = or_word(lambda: solved(WRONG[what](log), gnss))
    if isinstance(trajectory, str):
        assert "\n" not in trajectory
        return
    times = spread(trajectory)
    if what == "clock 2 s off":
        times = times[times > log.time[0] + 2.0]
    _, _, ratio = ratios(SURVEY, trajectory, times)
    assert trajectory.doubts
    assert np.sqrt(np.mean(ratio**2)) < 3.0


@pytest.mark.slow
@pytest.mark.parametrize("what", list(WRONG))
def test_wrong_imu_is_refused_or_its_sigma_says_so_when_tuned(what: str) -> None:
    log, gnss = logs_of(SURVEY)
    # its first minutes are enough: the search goes over them dozens of times
    log = chosen(log, log.time < WHEN)
    gnss = chosen(gnss, gnss.time < WHEN)
    damaged = WRONG[what](log)
    notes: list[str] = []

    def run() -> InertialTrajectory:
        found = tune(damaged, prepare_fixes(gnss), settings_of(SURVEY), noise=True, delay=True)
        notes.extend(found.notes)
        return smooth_flight(damaged, found.fixes, found.settings)

    trajectory = or_word(run)
    if isinstance(trajectory, str):
        assert "\n" not in trajectory
        return
    _, _, ratio = ratios(SURVEY, trajectory, spread(trajectory))
    if what != "clock 2 s off":  # a delay found is no doubt, a note says it
        assert trajectory.doubts or notes
    assert np.sqrt(np.mean(ratio**2)) < 3.0


def test_not_a_number_does_not_come_out_as_a_pose() -> None:
    """Readers clean logs; what slips through must not become a trajectory of NaN."""
    log, gnss = logs_of(SURVEY)
    gyro = log.gyro.copy()
    gyro[5000] = np.nan
    with pytest.raises(NavigationError):
        solved(replace(log, gyro=gyro), gnss)


@pytest.mark.parametrize("field", ["lat", "lon", "height"])
def test_fixes_that_are_no_numbers_are_left_out(field: str, usual: InertialTrajectory) -> None:
    log, gnss = logs_of(SURVEY)
    column = getattr(gnss, field).copy()
    column[200:205] = np.nan
    trajectory = solved(log, replace(gnss, **{field: column}))
    times = spread(usual, 9.0)
    moved = (trajectory.at(times).p_geo - usual.at(times).p_geo) * [6.36e6, 5e6, 1.0]
    assert np.abs(moved).max() < 0.5  # m


@pytest.mark.parametrize("seed", range(3))
def test_standing_log_has_no_heading_and_a_doubt(seed: int) -> None:
    flight = standing(seed, 120.0)
    trajectory = smoothed(flight)
    assert any("heading is not known" in doubt for doubt in trajectory.doubts)
    error, sigma, ratio = ratios(flight, trajectory, spread(trajectory, 10.0))
    assert np.degrees(sigma[:, 5].min()) > 45.0
    assert np.abs(ratio[:, 3:5]).max() < 4.0
    assert np.degrees(np.abs(error[:, 3:5]).max()) < 4.0
    assert np.abs(ratio[:, :3]).max() < 4.0


def test_straight_flight_has_an_honest_heading() -> None:
    squares = []
    for seed in range(6):
        flight = straight(seed, 120.0)
        trajectory = smoothed(flight)
        ratio = ratios(flight, trajectory, spread(trajectory, 15.0))[2]
        squares.append(np.mean(ratio**2, axis=0))
    # one value of heading a flight
    assert np.sqrt(np.mean(squares, axis=0)[5]) < 1.7
    assert np.sqrt(np.mean(squares, axis=0)[3:5]).max() < 1.7


def test_straight_flight_knows_its_heading_less_than_one_with_turns() -> None:
    line = smoothed(straight(1, 120.0))
    turns = smoothed(drawn(1, 2))
    sigma = [np.sqrt(t.at(spread(t, 15.0)).covariance[:, 5, 5]).max() for t in (line, turns)]
    assert sigma[0] > 2.0 * sigma[1]


def test_multirotor_flying_sideways_is_smoothed_to_its_nose() -> None:
    squares = []
    for seed in range(4):
        flight = multirotor(seed, 40.0 + 90.0 * seed)
        trajectory = smoothed(flight)
        error, _, ratio = ratios(flight, trajectory, spread(trajectory, 5.0))
        assert np.degrees(np.abs(error[:, 5]).max()) < 1.0
        squares.append(np.mean(ratio**2, axis=0))
    assert 0.5 < np.sqrt(np.mean(squares)) < 1.6


def test_flight_behind_a_long_wait_is_as_good_as_any() -> None:
    flight = waiting_first(2, 200.0, 3, gnss="white")
    trajectory = smoothed(flight)
    times = np.arange(flight.start_gps + 215.0, trajectory.span[1] - 1.0, 1.7)
    error, _, ratio = ratios(flight, trajectory, times)
    assert np.degrees(np.sqrt(np.mean(error[:, 3:] ** 2, axis=0))).max() < 0.4
    assert np.sqrt(np.mean(ratio**2)) < 1.6


def test_compass_that_is_a_right_angle_off_is_refused(usual: InertialTrajectory) -> None:
    log, gnss = logs_of(SURVEY)
    time = log.time[::10]
    yaw = SURVEY.path.rpy(time - SURVEY.start_gps)[:, 2]
    sigma = np.full(len(time), 0.02)
    times = spread(usual, 5.0)
    before = np.abs(errors_at(SURVEY, usual, times)[:, 5])
    wrong, right = (
        smooth_flight(
            log, prepare_fixes(gnss), settings_of(SURVEY),
            [AidLog(kind="heading", time=time, value=yaw + off, sigma=sigma)],
        )
        for off in (math.pi / 2.0, 0.0)
    )  # fmt: skip
    error, _, ratio = ratios(SURVEY, wrong, times)
    # as if there were none: 0.1 deg
    assert np.abs(np.abs(error[:, 5]) - before).max() < math.radians(0.1)
    assert np.sqrt(np.mean(ratio[:, :3] ** 2)) < 1.6
    # while one that is right is followed
    assert np.abs(errors_at(SURVEY, right, times)[:, 5]).max() < 0.5 * before.max()


def test_a_true_heading_helps_where_the_flight_shows_none() -> None:
    flight = straight(3, 120.0)
    log, gnss = logs_of(flight)
    time = log.time[::20]
    rpy = flight.path.rpy(time - flight.start_gps)
    sigma = math.radians(2.0)
    noise = sigma * np.random.default_rng(1).normal(size=len(time))
    compass = AidLog(
        kind="heading", time=time, value=rpy[:, 2] + noise, sigma=np.full(len(time), sigma)
    )
    trajectory = smooth_flight(log, prepare_fixes(gnss), settings_of(flight), [compass])
    error, got, ratio = ratios(flight, trajectory, spread(trajectory, 10.0))
    assert np.degrees(got[:, 5].max()) < 1.0
    assert np.abs(ratio[:, 5]).max() < 4.0
    assert np.degrees(np.abs(error[:, 5]).max()) < 1.0
