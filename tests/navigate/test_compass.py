"""Headings of a simulated magnetometer against the attitude that it was simulated with."""

from __future__ import annotations

import builtins
import datetime
import math
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from navigation_flights import drawn, truth_at
from scipy.io import loadmat

from georef_gis.errors import InputError, NavigationError
from georef_gis.frames import Array, R_ned_from_body, rpy_from_R_ned_from_body
from georef_gis.model.logs import AidLog
from georef_gis.navigate.compass import (
    SIGMA_COMPASS,
    SIGMA_UNCALIBRATED,
    earth_field,
    headings_from_magnetometer,
)

BLACKSBURG = np.array([math.radians(37.2), math.radians(-80.4), 600.0])
DAY = datetime.date(2024, 6, 1)


def field_of(
    rpy: Array, *, iron: tuple[float, float, float] = (0.0, 0.0, 0.0), noise: float = 0.0,
    soft: Array | None = None, unit: float = 1e-5, place: Array = BLACKSBURG,
) -> AidLog:  # fmt: skip
    """Samples in gauss (nT times 1e-5) of a magnetometer, its own field as a share of the level."""
    earth = earth_field(place, DAY)
    ned = earth.level * np.array([
        math.cos(earth.declination), math.sin(earth.declination), math.tan(earth.dip)
    ])  # fmt: skip
    body = np.einsum("nji,j->ni", R_ned_from_body(*rpy.T), ned)
    if soft is not None:
        body = body @ soft.T
    body = body + earth.level * np.array(iron)
    body = body + earth.level * noise * np.random.default_rng(1).normal(size=body.shape)
    n = len(rpy)
    return AidLog(
        time=1e9 + 0.1 * np.arange(n), kind="magnetic_field", value=unit * body,
        sigma=np.full(n, np.nan), source="mag.csv",
    )  # fmt: skip


def survey_angles(seed: int = 3, rows: int = 4) -> Array:
    """Roll, pitch, yaw of a survey at 10 Hz."""
    flight = drawn(seed, rows=rows)
    t = flight.start_gps + np.arange(0.0, flight.path.duration, 0.1)
    return rpy_from_R_ned_from_body(truth_at(flight, t)[2])


def errors(found: AidLog, rpy: Array) -> Array:
    """Heading errors, rad."""
    d = found.value - rpy[:, 2]
    return np.asarray(np.arctan2(np.sin(d), np.cos(d)))


def test_declination_is_that_of_the_published_example() -> None:
    # pygeomag's documented value for the Space Needle, WMM 2025
    earth = earth_field([math.radians(47.6205), math.radians(-122.3493), 0.0], 2025.25)
    assert math.degrees(earth.declination) == pytest.approx(15.0656, abs=1e-3)


@pytest.mark.parametrize("unit", [1.0, 1e-5, 1e-3], ids=["nT", "gauss", "microtesla"])
def test_clean_field_gives_the_true_heading_in_any_unit(unit: float) -> None:
    rpy = survey_angles()
    found = headings_from_magnetometer(field_of(rpy, unit=unit), rpy[:, :2], BLACKSBURG, DAY)
    assert found.kind == "heading"
    assert found.doubts == ()
    assert np.abs(errors(found, rpy)).max() < math.radians(0.05)
    assert found.sigma == pytest.approx(SIGMA_COMPASS, rel=1e-3)


def test_own_field_of_the_vehicle_is_found_in_the_turns() -> None:
    rpy = survey_angles()
    log = field_of(rpy, iron=(0.6, -0.4, 0.5), noise=0.02)
    found = headings_from_magnetometer(log, lambda t: rpy[:, :2], BLACKSBURG, DAY)
    assert np.sqrt(np.mean(errors(found, rpy) ** 2)) < math.radians(2.0)
    raw = np.arctan2(-log.value[:, 1], log.value[:, 0]) - rpy[:, 2]
    # what there was to correct: 0.7 of the level field
    assert np.std(np.arctan2(np.sin(raw), np.cos(raw))) > math.radians(15.0)
    assert not any("not known" in doubt for doubt in found.doubts)


def test_errors_of_roll_and_pitch_and_soft_iron_stay_within_the_sigma() -> None:
    ratios = []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        rpy = survey_angles(seed, rows=2)
        soft = np.eye(3) + 0.08 * rng.normal(size=(3, 3))
        iron = tuple(0.3 * rng.normal(size=3))
        log = field_of(rpy, iron=iron, noise=0.05, soft=soft)
        bent = rpy[:, :2] + np.radians(2.0) * rng.normal(size=2)
        found = headings_from_magnetometer(log, bent, BLACKSBURG, DAY)
        ratios.append(np.mean((errors(found, rpy) / found.sigma) ** 2))
    # 8 % of soft iron, 2 deg of tilt: what a cheap compass is; not more than claimed
    assert 0.3 < math.sqrt(np.mean(ratios)) < 1.4, np.sqrt(ratios)


def test_straight_flight_is_not_calibrated_and_says_so() -> None:
    rng = np.random.default_rng(5)
    rpy = np.radians([2.0, 3.0, 4.0]) * rng.normal(size=(600, 3)) + [0.0, 0.0, 1.0]
    found = headings_from_magnetometer(
        field_of(rpy, noise=0.03, iron=(0.2, 0.2, 0.0)), rpy[:, :2], BLACKSBURG, DAY
    )
    assert any("not known" in doubt for doubt in found.doubts)
    assert found.sigma == pytest.approx(SIGMA_UNCALIBRATED)
    assert np.sqrt(np.mean(errors(found, rpy) ** 2)) < 1.4 * SIGMA_UNCALIBRATED


def test_there_and_back_without_turns_is_not_calibrated() -> None:
    rng = np.random.default_rng(6)
    rpy = np.radians([3.0, 3.0, 2.0]) * rng.normal(size=(800, 3))
    rpy[400:, 2] += math.pi
    found = headings_from_magnetometer(
        field_of(rpy, noise=0.02), rpy[:, :2], BLACKSBURG, DAY
    )  # fmt: skip
    assert any("sectors only" in doubt for doubt in found.doubts)


def test_noise_is_no_compass() -> None:
    rng = np.random.default_rng(7)
    rpy = survey_angles()
    log = field_of(rpy)
    noise = AidLog(
        time=log.time, kind="magnetic_field", value=rng.normal(size=log.value.shape),
        sigma=log.sigma, source="mag.csv",
    )  # fmt: skip
    found = headings_from_magnetometer(noise, rpy[:, :2], BLACKSBURG, DAY)
    assert found.sigma.min() >= SIGMA_UNCALIBRATED
    assert any("scatter" in doubt for doubt in found.doubts)


def test_wrong_axes_are_named_and_their_headings_worth_nothing() -> None:
    rpy = survey_angles()
    log = field_of(rpy, noise=0.03, iron=(0.3, 0.1, 0.2))
    turned = replace(log, value=log.value * [1.0, -1.0, -1.0])
    found = headings_from_magnetometer(turned, rpy[:, :2], BLACKSBURG, DAY)
    assert any("axes look like (x, -y, -z)" in doubt for doubt in found.doubts)
    assert found.sigma == pytest.approx(math.pi / math.sqrt(3.0))


def test_waiting_on_the_ground_does_not_outweigh_the_turns() -> None:
    rpy = survey_angles()
    waiting = np.tile([0.05, 0.2, 2.0], (20 * len(rpy), 1))
    log = field_of(np.concatenate([waiting, rpy]), noise=0.01)
    # what lies near it there: half of the level field
    log.value[: len(waiting)] += 0.5 * np.abs(log.value[0]).min()
    angles = np.concatenate([waiting, rpy])[:, :2]
    found = headings_from_magnetometer(log, angles, BLACKSBURG, DAY)
    assert np.sqrt(np.mean(errors(found, np.concatenate([waiting, rpy]))[-len(rpy) :] ** 2)) < 0.05


def test_real_fixed_wing_agrees_with_its_own_filter() -> None:
    """Thor, flight 75: hx, hy, hz are forward, left, up; the reference is the onboard filter."""
    folder = os.environ.get("GEOREF_DATA")
    if not folder:
        pytest.skip("GEOREF_DATA is not set: no real data")
    path = Path(folder) / "flight_logs" / "thor75" / "thor_flight75.mat"
    d = loadmat(path, squeeze_me=True, struct_as_record=False)["flight_data"]
    rows = np.flatnonzero(d.navValid == 0)[::5]
    field = np.stack([d.hx, d.hy, d.hz], axis=-1)[rows].astype(float)
    log = AidLog(time=d.time[rows], kind="magnetic_field", value=field,
                 sigma=np.full(len(rows), np.nan), source="thor")  # fmt: skip
    angles = np.stack([d.phi, d.theta], axis=-1)[rows].astype(float)
    place, day = [math.radians(44.73), math.radians(-93.07), 250.0], datetime.date(2012, 10, 10)
    logged = headings_from_magnetometer(log, angles, place, day)
    assert any("axes look like (x, -y, -z)" in doubt for doubt in logged.doubts)
    mapped = replace(log, value=field * [1.0, -1.0, -1.0])
    found = headings_from_magnetometer(mapped, angles, place, day)
    flying = np.hypot(d.navvn, d.navve)[rows] > 8.0
    ratio = errors(found, d.psi[rows, None].repeat(3, axis=1))[flying] / found.sigma[flying]
    # soft iron and motors of one vehicle; the default of 10 deg is meant for worse
    assert 0.3 < np.sqrt(np.mean(ratio**2)) < 1.4


@pytest.mark.parametrize("year", [2009.4, 2031.0])
def test_date_outside_of_the_models_is_one_clear_line(year: float) -> None:
    with pytest.raises(InputError, match=f"mag.csv: date: the year {year} lies outside") as error:
        earth_field(BLACKSBURG, year, "mag.csv")
    assert "\n" not in str(error.value)


def test_missing_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    known = builtins.__import__

    def without(name: str, *rest: object, **more: object) -> object:
        if name == "pygeomag":
            raise ImportError(name)
        return known(name, *rest, **more)  # type: ignore[arg-type]

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(InputError, match=r"needs pygeomag; pip install georef-gis\[logs\]"):
        earth_field(BLACKSBURG, DAY)


def test_near_the_magnetic_pole_there_is_no_heading() -> None:
    pole = np.array([math.radians(86.0), math.radians(140.0), 0.0])
    rpy = survey_angles(rows=2)
    with pytest.raises(NavigationError, match="too near to a magnetic pole"):
        headings_from_magnetometer(field_of(rpy, place=pole), rpy[:, :2], pole, DAY)


def test_samples_without_attitude_are_left_out_and_none_left_is_said() -> None:
    rpy = survey_angles(rows=2)
    angles = rpy[:, :2].copy()
    angles[::3] = np.nan
    log = field_of(rpy)
    found = headings_from_magnetometer(log, angles, BLACKSBURG, DAY)
    assert len(found) == np.count_nonzero(np.isfinite(angles[:, 0]))
    with pytest.raises(NavigationError, match="no sample of the magnetometer"):
        headings_from_magnetometer(log, np.full_like(angles, np.nan), BLACKSBURG, DAY)
