"""The flight of the report page: attitude of poses, exposures in gaps, delays, verdicts."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from report_cases import adjusted_facts, pose, project_facts

from georef_gis.frames import R_ned_from_body, covariance_theta_ned_from_rpy, exp_so3
from georef_gis.measure.report.facts import Facts
from georef_gis.measure.report.flight_facts import FixDifferences, Flown, flight_of_photos
from georef_gis.measure.report.flight_section import at_exposures, path_items
from georef_gis.measure.report.page import Lines, Picture, Table, Text, Verdict
from georef_gis.model.logs import TrajectoryLog
from georef_gis.model.plot_parts import png
from georef_gis.model.trajectory_plots import attitude_over_time, position_figure
from georef_gis.model.trajectory_values import places_apart, sigma_rpy_of
from processing_algorithms.measure.report_flight import _delay

Array = NDArray[np.float64]
START = 2200 * 604800.0


def trajectory(seconds: float = 60.0, *, gap: tuple[float, float] | None = None) -> TrajectoryLog:
    """A path to the east over the site of `project_facts` at 10 Hz, 20 m/s."""
    time = np.arange(0.0, seconds, 0.1)
    if gap is not None:
        time = time[(time <= gap[0]) | (time >= gap[1])]
    n = len(time)
    rpy = np.radians(np.stack([5 * np.sin(time), 2 * np.cos(time), np.full(n, 90.0)], axis=-1))
    covariance = np.zeros((n, 6, 6))
    covariance[:, range(3), range(3)] = 0.25
    sigma = np.tile(np.radians([0.1, 0.1, 0.3]), (n, 1))
    covariance[:, 3:, 3:] = covariance_theta_ned_from_rpy(rpy, sigma)
    return TrajectoryLog(
        time=START + time, source="test", lat=np.full(n, np.radians(40.0)),
        lon=np.radians(-83.0) + 20.0 * time / 4.9e6, height=np.full(n, 250.0),
        v_ned=np.tile([0.0, 20.0, 0.0], (n, 1)), rpy=rpy, covariance=covariance,
    )  # fmt: skip


def flown(**changes: Any) -> Flown:
    log = trajectory()
    exposures = START + np.array([10.0, 20.0, 30.0, 40.0])
    return replace(
        Flown(log=log, of_photos=False, exposures=exposures, series={"smoothed": log}), **changes
    )


def verdicts(facts: Facts, what: Flown) -> dict[str, Verdict]:
    """What is said of each picture and table, by its title; all are drawn."""
    found = [i for i in path_items(facts, what) if isinstance(i, Picture | Table)]
    return {item.title: item.verdict for item in found if item.verdict is not None}


# -- poses -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("turned", [0, 90, 180, 270])
def test_attitude_of_poses_is_that_of_the_aircraft_whatever_turned_the_pixels(turned: int) -> None:
    """Roll 6, pitch -3, heading 205 deg of a camera that looks straight down."""
    rpy = np.radians([6.0, -3.0, 205.0])
    # axes north, east, down -> east, north, up; image x to the right of the aircraft, y backwards
    swap = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])
    R_body_from_cam = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    R = swap @ R_ned_from_body(*rpy) @ R_body_from_cam
    # pixels turned clockwise: the new x axis is where the old -y was, after a quarter
    R = R @ exp_so3([0.0, 0.0, -np.radians(turned)])
    one = replace(pose(0.0, 0.0), R_enu_from_cam=R)
    facts = project_facts(1)
    facts = replace(
        facts, direct={"P000": one}, turned={"direct": {"P000": turned}, "adjusted": {}}
    )
    found = flight_of_photos(facts)
    assert found is not None
    # 1e-9 rad: rounding
    off = np.mod(found.log.rpy[0] - rpy + np.pi, 2 * np.pi) - np.pi
    assert off == pytest.approx(0.0, abs=1e-9)


def test_sigmas_of_poses_keep_their_axes() -> None:
    """1 m east, 2 m north, 3 m up; an error about east is pitch when the flight goes east-west."""
    C = np.diag([1.0, 4.0, 9.0, *np.radians([1.0, 2.0, 3.0]) ** 2])
    swap = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])
    # heading 0: the body's right is east, forward is north
    R = swap @ R_ned_from_body(0.0, 0.0, 0.0) @ np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    facts = project_facts(1)
    facts = replace(facts, direct={"P000": replace(pose(0, 0), R_enu_from_cam=R, covariance=C)})
    found = flight_of_photos(facts)
    assert found is not None
    assert np.sqrt(np.diag(found.log.covariance[0])[:3]) == pytest.approx([2.0, 1.0, 3.0])
    # roll is about forward = north: 2 deg; pitch about right = east: 1 deg
    assert np.degrees(sigma_rpy_of(found.log)[0]) == pytest.approx([2.0, 1.0, 3.0])


def test_photos_without_times_are_told_apart_by_their_number() -> None:
    facts = project_facts(3)
    rows = [{**row, "time_gps": None} for row in facts.photos]
    found = flight_of_photos(replace(facts, photos=rows))
    assert found is not None
    assert "s)" not in found.axis
    timed = flight_of_photos(facts)
    assert timed is not None
    assert timed.axis.endswith("(s)")
    # photos 2 s apart
    assert timed.log.time == pytest.approx([0.0, 2.0, 4.0])


def test_adjusted_poses_are_drawn_beside_the_direct_ones() -> None:
    found = flight_of_photos(adjusted_facts(4))
    assert found is not None
    assert set(found.series) == {"direct poses", "adjusted poses"}


def test_a_project_without_poses_says_so() -> None:
    facts = replace(project_facts(2), direct={})
    assert flight_of_photos(facts) is None
    (item,) = path_items(facts, None)
    assert isinstance(item, Text)
    assert "No photo has a pose" in item.lines[0]


# -- trajectory ------------------------------------------------------------------------------------


def test_a_sound_flight_is_fine_and_shows_all_pictures() -> None:
    found = verdicts(project_facts(4), flown())
    assert {title: one.level for title, one in found.items()} == {
        "Flight": "fine", "Flight from above": "fine", "Position over time": "told",
        "Attitude over time": "fine",
    }  # fmt: skip


def test_a_gap_is_told_and_nothing_is_known_inside_it() -> None:
    log = trajectory(gap=(15.0, 25.0))
    what = flown(log=log, series={"smoothed": log})
    ((begin, end),) = what.gaps
    assert (begin - START, end - START) == pytest.approx((15.0, 25.0), abs=0.11)
    known = np.isfinite(at_exposures(what, log.rpy)).all(axis=1)
    assert known.tolist() == [True, False, True, True]
    found = verdicts(project_facts(4), what)["Flight"]
    assert found.level == "look"
    assert "1 gap" in found.text
    assert "10.0 s" in found.text


def test_values_at_exposures_are_interpolated() -> None:
    what = flown()
    seconds = at_exposures(what, (what.log.time - START)[:, None])
    # rows every 0.1 s, on the exposures
    assert seconds[:, 0] == pytest.approx([10.0, 20.0, 30.0, 40.0], abs=1e-6)
    late = replace(what, exposures=START + np.array([-1.0, 61.0]))
    assert np.isnan(at_exposures(late, what.log.rpy)).all()


@pytest.mark.usefixtures("pictures_undrawn")
def test_photos_off_the_path_and_uneven_heights_ask_for_a_look() -> None:
    facts = project_facts(4)
    prints = {
        key: replace(f, height_above_ground=40.0 + 10.0 * i)
        for i, (key, f) in enumerate(facts.footprints.items())
    }
    found = verdicts(replace(facts, footprints=prints), flown(outside=("P003",)))
    assert found["Flight from above"].level == "look"
    assert found["Flight"].level == "look"
    assert "P003" in found["Flight"].text


@pytest.mark.usefixtures("pictures_undrawn")
def test_an_exposure_that_is_far_less_certain_is_counted() -> None:
    log = trajectory()
    covariance = log.covariance.copy()
    # ten times the sigma about 20 s
    covariance[190:211, 3:, 3:] *= 100.0
    what = flown(log=replace(log, covariance=covariance))
    found = verdicts(project_facts(4), what)["Attitude over time"]
    assert found.level == "look"
    assert "1 exposure beyond 3 times" in found.text


@pytest.mark.usefixtures("pictures_undrawn")
def test_notes_are_listed() -> None:
    items = path_items(project_facts(2), flown(notes=("the logs are too large",)))
    assert isinstance(items[-1], Lines)
    assert items[-1].lines == ("the logs are too large",)


# -- fixes -----------------------------------------------------------------------------------------


def differences(scale: float, *, wild: int = 0) -> FixDifferences:
    rng = np.random.default_rng(3)
    apart = scale * rng.normal(size=(400, 3))
    if wild:
        apart[:: 400 // wild] += 60.0
    return FixDifferences(
        time=START + 0.1 * np.arange(400.0), apart=apart, sigma=np.ones((400, 3)), delay=0.25
    )


@pytest.mark.usefixtures("pictures_undrawn")
@pytest.mark.parametrize(
    ("scale", "wild", "level"),
    # 1, 2.5 and 6 times what is stated: 95, 58 and 26 % within 2 sigmas; one fix in ten 60 m off
    [(1.0, 0, "fine"), (2.5, 0, "look"), (6.0, 0, "bad"), (0.5, 40, "look")],
)
def test_fixes_are_judged_by_the_sigmas_that_they_state(
    scale: float, wild: int, level: str
) -> None:
    fixes = differences(scale, wild=wild)
    found = verdicts(project_facts(2), flown(fixes=fixes))["GNSS fixes less smoothed path"]
    assert found.level == level
    assert "delay of the fixes of 250 ms" in found.text


@pytest.mark.usefixtures("pictures_undrawn")
def test_a_delay_of_the_fixes_is_found_and_noise_gives_none() -> None:
    rng = np.random.default_rng(5)
    t = np.arange(0.0, 120.0, 0.2)
    v = np.stack([15 * np.sin(0.1 * t), 15 * np.cos(0.1 * t), 0 * t], axis=-1)
    noise = rng.normal(0.0, 0.5, (len(t), 3))
    # a fix that is 0.2 s late shows where the aircraft was; 0.5 m of noise at 15 m/s: 33 ms a fix
    assert _delay(noise - 0.2 * v, v) == pytest.approx(0.2, abs=0.01)
    assert _delay(noise, v) == 0.0
    # at rest nothing tells
    assert _delay(noise, 0.01 * v) == 0.0


# -- drawing ---------------------------------------------------------------------------------------


def test_exposures_are_marked_and_the_band_is_two_sigmas() -> None:
    log = trajectory()
    figure = attitude_over_time(log, exposures=START + np.array([10.0, 20.0]))
    marks = figure.axes[0].lines[-1]
    assert marks.get_label() == "exposure"
    assert marks.get_xdata() == pytest.approx([10.0, 20.0])
    band = figure.axes[0].collections[0].get_paths()[0].vertices
    at = band[np.isclose(band[:, 0], 10.0, atol=0.01)][:, 1]
    # two sigmas of 0.1 deg on both sides
    assert np.ptp(at) == pytest.approx(0.4, abs=0.01)
    assert png(figure, dpi=40).startswith(b"\x89PNG")


def test_positions_without_a_closer_part_have_three_graphs() -> None:
    log = trajectory()
    assert len(position_figure({"smoothed": log}).axes) == 4
    assert len(position_figure({"smoothed": log}, closer=False).axes) == 3


def test_places_apart_are_metres_north_east_down() -> None:
    log = trajectory(1.0)
    moved = replace(
        log,
        lat=log.lat + 1.0 / 6_359_900.0,
        lon=log.lon + 1.0 / 4_893_000.0,
        height=log.height - 2.0,
    )
    # radii at 40 deg north to 1 km: 0.2 mm of a metre
    assert places_apart(moved, log)[0] == pytest.approx([1.0, 1.0, 2.0], abs=2e-3)
