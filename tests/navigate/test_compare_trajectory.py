"""Two trajectories compared: differences, clocks, mounts, sigmas, the table, pictures, the tool."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from georef_gis.ellipsoid import Origin
from georef_gis.errors import Cancelled, ExportError, GeorefError, InputError
from georef_gis.frames import (
    R_ned_from_body,
    covariance_theta_ned_from_rpy,
    exp_so3,
    jacobian_theta_ned_from_rpy,
    rpy_from_R_ned_from_body,
    sigma_rpy_from_covariance_theta_ned,
)
from georef_gis.geodesy import HeightKind
from georef_gis.ingest.logs.trajectory_table import (
    is_trajectory_table,
    read_trajectory_table,
    write_trajectory_table,
)
from georef_gis.model.logs import (
    FIX_FIXED,
    FIX_NONE,
    AttitudeLog,
    FlightLogs,
    GnssLog,
    TrajectoryLog,
    unknown,
)
from georef_gis.model.plot_parts import png
from georef_gis.model.trajectory_plots import position_figure
from georef_gis.navigate.compare import (
    CompareSettings,
    compare_trajectories,
    statistics,
    summary,
    text_table,
)
from georef_gis.navigate.plots import (
    attitude_figure,
    comparison_pictures,
    innovation_figure,
    position_error_figure,
)
from georef_gis.navigate.resample import (
    at_times,
    trajectory_of_attitude,
    trajectory_of_gnss,
)
from georef_gis.toolbox.context import CollectingFeedback, Context
from processing_algorithms.navigate.compare_trajectory import (
    CompareTrajectory,
    CompareTrajectoryParameters,
    trajectory_of_logs,
    write_folder,
)

Array = NDArray[np.float64]
START = 2200 * 604800.0 + 604700.0
ORIGIN = Origin(lat=math.radians(39.6), lon=math.radians(-79.9), height_ellipsoidal=300.0)


def path(time: Array, *, lon: float = 0.0) -> TrajectoryLog:
    """A swaying flight with half-turns: geodetic rates are those of its ned velocity.

    Written in latitude and longitude themselves, so that nothing of the code under test is in it.
    """
    t = np.asarray(time) - START
    a, e2 = 6378137.0, 0.00669437999014
    lat = math.radians(39.6) + 4e-5 * np.sin(0.05 * t) + 1e-6 * t
    dlat = 2e-6 * np.cos(0.05 * t) + 1e-6
    east = math.radians(-79.9) + lon + 5e-5 * np.cos(0.07 * t)
    deast = -3.5e-6 * np.sin(0.07 * t)
    h, dh = 400.0 + 20.0 * np.sin(0.1 * t), 2.0 * np.cos(0.1 * t)
    w = np.sqrt(1 - e2 * np.sin(lat) ** 2)
    v = np.stack(
        [dlat * (a * (1 - e2) / w**3 + h), deast * (a / w + h) * np.cos(lat), -dh], axis=-1
    )
    rpy = np.stack([0.4 * np.sin(0.3 * t), 0.1 * np.cos(0.4 * t), 3.0 + 0.05 * t], axis=-1)
    rpy[:, 2] = np.mod(rpy[:, 2] + np.pi, 2 * np.pi) - np.pi
    return TrajectoryLog(
        time=np.asarray(time), source="path", lat=lat,
        lon=np.mod(east + np.pi, 2 * np.pi) - np.pi, height=h, v_ned=v, rpy=rpy,
        covariance=unknown(len(t), 6, 6),
    )  # fmt: skip


def times(rate: float, span: float = 120.0, first: float = 0.0) -> Array:
    return START + first + np.arange(round(span * rate)) / rate


def moved(log: TrajectoryLog, ned: Array) -> TrajectoryLog:
    """A trajectory whose places lie off by ned m, through ecef."""
    out = []
    for i in range(len(log)):
        here = Origin(lat=log.lat[i], lon=log.lon[i], height_ellipsoidal=log.height[i])
        n, e, d = np.broadcast_to(ned, (len(log), 3))[i]
        out.append(here.geo_from_enu([e, n, -d]))
    geo = np.array(out)
    return replace(log, lat=geo[:, 0], lon=geo[:, 1], height=geo[:, 2])


def turned(log: TrajectoryLog, vectors: Array, *, in_body: bool = False) -> TrajectoryLog:
    R, turn = R_ned_from_body(*log.rpy.T), exp_so3(vectors)
    return replace(log, rpy=rpy_from_R_ned_from_body(R @ turn if in_body else turn @ R))


def test_trajectory_against_itself_differs_by_nothing() -> None:
    log = path(times(10.0))
    found = compare_trajectories(log, log)
    assert np.all(found.position == 0.0)
    assert np.all(found.rpy == 0.0)


def test_offsets_are_estimate_minus_reference_in_metres() -> None:
    reference = path(times(10.0))
    found = compare_trajectories(moved(reference, np.array([3.0, -4.0, 5.0])), reference)
    # 1e-5 of an offset: curvature over 5 m
    np.testing.assert_allclose(found.position, [[3.0, -4.0, 5.0]] * len(found.time), atol=1e-3)


@pytest.mark.parametrize("reference_rate", [1.0, 5.0, 100.0])
def test_interpolation_keeps_millimetres_whichever_is_denser(reference_rate: float) -> None:
    estimate, reference = path(times(10.0, first=0.037)), path(times(reference_rate))
    found = compare_trajectories(estimate, reference)
    assert len(found.time) == pytest.approx(120 * min(10.0, reference_rate), abs=2)
    # h^4/384 x^(4) at 1 Hz is 0.01 mm; the shortest turn bends off by h^2/8 x 0.04 rad/s2 at 10 Hz
    assert np.nanmax(np.abs(found.position)) < 2e-3
    assert np.nanmax(np.abs(found.rpy)) < math.radians(0.01)


def test_positions_without_velocity_are_still_bent() -> None:
    sparse = replace(path(times(1.0)), v_ned=unknown(120, 3))
    found = at_times(sparse, times(10.0, span=100.0, first=5.0))
    truth = path(times(10.0, span=100.0, first=5.0))
    off = np.hypot((found.lat - truth.lat) * 6.36e6, found.height - truth.height)
    # A straight line would be off by h^2/8 x 0.2 m/s2 = 25 mm.
    assert off.max() < 5e-3


def test_course_over_the_180th_meridian_makes_no_leap() -> None:
    shift = math.radians(79.9 - 180.0)
    found = compare_trajectories(
        path(times(10.0, first=0.05), lon=shift), path(times(10.0), lon=shift)
    )
    assert np.ptp(found.reference.lon) > 6.0
    assert np.nanmax(np.abs(found.position)) < 2e-3


def test_yaw_differences_are_wrapped() -> None:
    reference = path(times(10.0))
    yaw = reference.rpy + np.array([0.0, 0.0, 0.02])
    yaw[:, 2] = np.mod(yaw[:, 2], 2 * np.pi)
    found = compare_trajectories(replace(reference, rpy=yaw), reference)
    np.testing.assert_allclose(found.rpy[:, 2], 0.02, atol=1e-12)


def test_nothing_is_interpolated_over_a_gap() -> None:
    dense = times(10.0)
    reference = path(dense[(dense < START + 40.0) | (dense > START + 60.0)])
    found = compare_trajectories(path(times(5.0)), reference)
    # The last row before the gap lies at 39.9 s, the first behind it at 60.1 s.
    hidden = (found.time > START + 39.95) & (found.time < START + 60.05)
    assert np.all(np.isnan(found.position[hidden]))
    assert np.all(np.isfinite(found.position[~hidden & (found.time < START + 119.0)]))


@pytest.mark.parametrize("quantity", ["velocity", "position", "turn rate"])
def test_time_shift_is_found_and_named(quantity: str) -> None:
    rng = np.random.default_rng(7)
    # The estimate's clock is late: what it notes at t was at t + 0.237.
    true = path(times(20.0, first=3.0))
    estimate = replace(true, time=true.time - 0.237)
    reference = path(times(10.0, span=126.0))
    noise = rng.normal(0.0, 0.02, (len(estimate), 3))
    estimate = replace(estimate, v_ned=estimate.v_ned + noise)
    if quantity != "velocity":
        estimate = replace(estimate, v_ned=unknown(len(estimate), 3))
    if quantity == "turn rate":
        n = len(estimate)
        estimate = replace(estimate, lat=unknown(n), lon=unknown(n), height=unknown(n))
        estimate = turned(estimate, np.array([0.3, 0.2, -0.4]), in_body=True)
    found = compare_trajectories(estimate, reference, time_shift=None)
    assert found.time_shift_from == quantity
    assert found.time_shift == pytest.approx(0.237, abs=5e-3)
    assert found.sigma_time_shift < 0.01


def test_sigma_of_the_time_shift_holds() -> None:
    rng = np.random.default_rng(8)
    reference = path(times(10.0, span=126.0))
    true = path(times(10.0, first=3.0))
    ratio = []
    for _ in range(40):
        noisy = replace(
            true, time=true.time - 0.1, v_ned=true.v_ned + rng.normal(0, 0.1, (1200, 3))
        )
        found = compare_trajectories(noisy, reference, time_shift=None)
        ratio.append((found.time_shift - 0.1) / found.sigma_time_shift)
    # 40 draws of sigmas from 12 parts: rms of a t distribution, with its own scatter of 12 %
    assert 0.7 < float(np.sqrt(np.mean(np.square(ratio)))) < 1.4


def test_given_time_shift_is_applied_and_no_movement_finds_none() -> None:
    true = path(times(10.0))
    late = replace(true, time=true.time - 0.5)
    found = compare_trajectories(late, true, time_shift=0.5)
    assert np.nanmax(np.abs(found.position)) < 2e-3
    still = replace(true, v_ned=np.zeros((1200, 3)))
    with pytest.raises(GeorefError, match="nothing moves"):
        compare_trajectories(still, still, time_shift=None)


def test_lever_arm_moves_the_estimate_to_the_reference() -> None:
    arm = np.array([1.5, -0.5, 2.0])
    estimate = path(times(20.0))
    R = R_ned_from_body(*estimate.rpy.T)
    reference = moved(estimate, R @ arm)
    swing = np.gradient(R @ arm, estimate.time, axis=0)
    reference = replace(reference, v_ned=estimate.v_ned + swing)
    settings = CompareSettings(lever_arm=(1.5, -0.5, 2.0))
    found = compare_trajectories(estimate, reference, settings=settings)
    assert np.max(np.abs(found.position)) < 1e-4
    assert np.max(np.abs(found.velocity)) < 1e-9
    plain = compare_trajectories(estimate, reference)
    assert np.sqrt(np.mean(np.sum(plain.position**2, axis=1))) == pytest.approx(6.5**0.5, rel=1e-3)


def test_constant_rotation_and_offset_are_taken_off_and_told() -> None:
    reference = path(times(10.0))
    mount, offset = np.array([0.02, -0.03, 0.05]), np.array([1.0, 2.0, -3.0])
    # R_reference = R_estimate Exp(mount)
    estimate = moved(turned(reference, -mount, in_body=True), offset)
    settings = CompareSettings(remove_rotation=True, remove_offset=True)
    found = compare_trajectories(estimate, reference, settings=settings)
    np.testing.assert_allclose(found.rotation, mount, atol=1e-9)
    np.testing.assert_allclose(found.offset, offset, atol=1e-3)
    assert np.max(np.abs(found.rpy)) < 1e-9
    assert np.max(np.abs(found.position)) < 1e-3
    kept = compare_trajectories(estimate, reference)
    assert np.all(kept.rotation == 0.0)
    assert np.max(np.abs(kept.rpy)) > 0.02


def test_errors_drawn_from_the_covariance_have_unit_nees_and_ratio() -> None:
    rng = np.random.default_rng(9)
    reference = path(times(20.0, span=200.0))
    root = rng.normal(size=(6, 6)) * np.repeat([0.3, 0.005], 3)[:, None]
    covariance = root @ root.T
    error = rng.normal(size=(4000, 6)) @ root.T
    # p_true = p_est + dp and R_true = Exp(dtheta) R_est
    estimate = turned(moved(reference, -error[:, :3]), -error[:, 3:])
    estimate = replace(estimate, covariance=np.tile(covariance, (4000, 1, 1)))
    found = compare_trajectories(estimate, reference)
    # 4000 draws of 3 values: 1.3 % of scatter
    assert np.mean(found.nees_position) / 3 == pytest.approx(1.0, abs=0.06)
    assert np.mean(found.nees_attitude) / 3 == pytest.approx(1.0, abs=0.06)
    for row in statistics(found):
        if row.part == "all" and row.quantity in ("north", "east", "down", "roll", "pitch", "yaw"):
            assert row.ratio == pytest.approx(1.0, abs=0.06), row


def test_sigmas_of_many_attitudes_are_those_of_each() -> None:
    rng = np.random.default_rng(10)
    rpy, sigma = rng.uniform(-1.4, 1.4, (20, 3)), rng.uniform(0.01, 0.1, (20, 3))
    covariance = covariance_theta_ned_from_rpy(rpy, sigma)
    for angles, s, C in zip(rpy, sigma, covariance, strict=True):
        J = jacobian_theta_ned_from_rpy(*angles)
        np.testing.assert_allclose(C, J @ np.diag(s**2) @ J.T, atol=1e-15)
    np.testing.assert_allclose(sigma_rpy_from_covariance_theta_ned(rpy, covariance), sigma)
    rpy[3, 1], covariance[5] = math.pi / 2.0, np.nan
    back = sigma_rpy_from_covariance_theta_ned(rpy, covariance)
    assert np.isnan(back[[3, 5]]).all()
    np.testing.assert_allclose(np.delete(back, [3, 5], axis=0), np.delete(sigma, [3, 5], axis=0))


def test_turns_and_straights_are_told_apart() -> None:
    t = START + np.arange(0.0, 100.0, 0.1)
    course = np.where(t < START + 50.0, 0.3, 0.3 + 0.2 * (t - START - 50.0))
    v = 20.0 * np.stack([np.cos(course), np.sin(course), 0 * course], axis=-1)
    p = np.cumsum(v * 0.1, axis=0)
    geo = ORIGIN.geo_from_enu(p[:, [1, 0, 2]])
    reference = TrajectoryLog(
        time=t, lat=geo[:, 0], lon=geo[:, 1], height=geo[:, 2], v_ned=v,
        rpy=np.stack([0 * t, 0 * t, course], axis=-1), covariance=unknown(len(t), 6, 6),
    )  # fmt: skip
    for hidden in ((), ("v_ned",), ("v_ned", "lat", "lon", "height")):
        bare = replace(
            reference, **{n: np.full_like(getattr(reference, n), np.nan) for n in hidden}
        )
        found = compare_trajectories(bare, bare)
        sure = np.abs(t - START - 50.0) > 2.0
        np.testing.assert_array_equal(found.turning[sure], (t > START + 50.0)[sure])
    error = np.where(t < START + 50.0, 1.0, 3.0)[:, None] * [1.0, 0.0, 0.0]
    found = compare_trajectories(moved(reference, error), reference)
    rms = {row.part: row.rms for row in statistics(found) if row.quantity == "north"}
    assert rms["straight"] == pytest.approx(1.0, abs=0.1)
    assert rms["turns"] == pytest.approx(3.0, abs=0.1)
    assert rms["all"] == pytest.approx(math.sqrt(5.0), abs=0.01)


def test_table_gives_rms_mean_sd_and_largest() -> None:
    reference = path(times(10.0))
    error = np.linspace(-1.0, 2.0, 1200)[:, None] * [0.0, 0.0, 1.0]
    found = compare_trajectories(moved(reference, error), reference)
    row = next(r for r in statistics(found) if r.quantity == "down" and r.part == "all")
    assert row.rms == pytest.approx(1.0, abs=1e-3)
    assert row.mean == pytest.approx(0.5, abs=1e-3)
    assert row.sd == pytest.approx(math.sqrt(0.75), abs=2e-3)
    assert row.largest == pytest.approx(2.0, abs=1e-3)
    assert math.isnan(row.ratio)
    lines = text_table(statistics(found))
    assert len({len(line) for line in lines}) == 1
    json.dumps(summary(found), allow_nan=False)


def test_positions_only_and_attitudes_only_are_compared_by_what_they_have() -> None:
    reference = path(times(10.0))
    n = len(reference)
    gnss = GnssLog(
        time=reference.time, lat=reference.lat, lon=reference.lon, height=reference.height,
        height_kind=HeightKind.ELLIPSOIDAL, geoid_separation=unknown(n), v_ned=unknown(n, 3),
        covariance_ned=np.tile(np.eye(3), (n, 1, 1)), covariance_v_ned=unknown(n, 3, 3),
        fix=np.where(np.arange(n) < 5, FIX_NONE, FIX_FIXED), satellites=np.full(n, 9),
    )  # fmt: skip
    attitude = AttitudeLog(time=reference.time, rpy=reference.rpy, sigma_rpy=np.full((n, 3), 0.01))
    places = compare_trajectories(trajectory_of_gnss(gnss), reference)
    assert len(places.time) == n - 5
    assert {row.unit for row in statistics(places)} == {"m"}
    angles = compare_trajectories(trajectory_of_attitude(attitude), reference)
    assert {row.unit for row in statistics(angles)} == {"deg"}
    np.testing.assert_allclose(angles.sigma_rpy, 0.01, rtol=1e-9)
    both = trajectory_of_logs(FlightLogs(gnss=gnss, attitude=attitude))
    assert {row.unit for row in statistics(compare_trajectories(both, reference))} == {"m", "deg"}
    with pytest.raises(GeorefError, match="neither positions nor attitudes in common"):
        compare_trajectories(trajectory_of_gnss(gnss), trajectory_of_attitude(attitude))
    with pytest.raises(InputError, match="holds neither"):
        trajectory_of_logs(FlightLogs(source="x"))


def test_what_cannot_be_compared_is_refused() -> None:
    log = path(times(10.0))
    cases: list[tuple[Callable[[], object], str]] = [
        (lambda: compare_trajectories(replace(log, scale="boot"), log), "boot scale"),
        (lambda: compare_trajectories(replace(log, time=log.time + 1e4), log), "no span in common"),
        (lambda: compare_trajectories(path(log.time[:1]), log), "1 of 1 rows"),
        (
            lambda: compare_trajectories(
                trajectory_of_attitude(
                    AttitudeLog(time=log.time, rpy=np.full((1200, 3), np.nan),
                                sigma_rpy=unknown(1200, 3))
                ), log),
            "0 of 1200 rows",
        ),
    ]  # fmt: skip
    for call, words in cases:
        with pytest.raises(GeorefError, match=words):
            call()


# ---------------------------------------------------------------------------------------------
# The table of a trajectory
# ---------------------------------------------------------------------------------------------


def as_csv(log: TrajectoryLog) -> bytes:
    stream = io.BytesIO()
    write_trajectory_table(stream, log)
    return stream.getvalue()


def test_table_gives_back_what_was_written_over_a_week_boundary(tmp_path: Path) -> None:
    log = path(START + 80.0 + np.arange(600) / 13.0)
    covariance = np.zeros((600, 6, 6))
    covariance[:, :3, :3] = np.diag([0.01, 0.04, 0.09])
    sigma = np.tile([0.01, 0.02, 0.03], (600, 1))
    covariance[:, 3:, 3:] = covariance_theta_ned_from_rpy(log.rpy, sigma)
    log = replace(log, covariance=covariance, position_of="antenna")
    file = tmp_path / "path.csv"
    file.write_bytes(as_csv(log))
    assert is_trajectory_table(file.read_bytes()[:500])
    back = read_trajectory_table(file)
    assert np.ptp(np.floor(back.time / 604800.0)) == 1
    # s, rad (0.1 mm), m, m/s, rad: half of the last digit, and 0.1 us of a float of 1e9 s
    for name, atol in (("time", 2e-7), ("lat", 1e-12), ("lon", 1e-12), ("height", 1e-4),
                       ("v_ned", 1e-4), ("rpy", 1e-9), ("covariance", 1e-6)):  # fmt: skip
        np.testing.assert_allclose(getattr(back, name), getattr(log, name), rtol=0, atol=atol)
    assert back.position_of == "antenna"


def test_missing_cells_are_missing_values(tmp_path: Path) -> None:
    log = path(times(10.0, span=2.0))
    log.rpy[3] = np.nan
    file = tmp_path / "path.csv"
    file.write_bytes(as_csv(replace(log, lat=np.where(np.arange(20) == 7, np.nan, log.lat))))
    back = read_trajectory_table(file)
    assert np.isnan(back.lat).sum() == 1
    assert np.all(np.isnan(back.rpy[3]))
    assert np.all(np.isnan(back.covariance))


def test_shuffled_and_repeated_rows_are_sorted_and_named(tmp_path: Path) -> None:
    lines = as_csv(path(times(10.0, span=2.0))).decode().splitlines()
    file = tmp_path / "path.csv"
    file.write_text("\n".join([*lines[:2], *lines[12:], *lines[2:12], lines[5]]))
    back = read_trajectory_table(file)
    assert len(back) == 20
    assert np.all(np.diff(back.time) > 0.0)
    assert back.doubts == ("rows were out of order or repeated: sorted, 1 repeated left out",)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("lat_deg", "breite", "lacks the column lat_deg"),
        ("v_north", "v_east", "column v_east stands there twice"),
        ("# place: imu", "# place: moon", "'moon' is not one of"),
        ("2200,604701.", "2200,x", "is not a number"),
        ("2200,604701.", "2200,9604701.", "lies outside 0 to 604800"),
        (",39.6", ",99.6", "lies outside -90 to 90"),
    ],
)
def test_faults_of_a_table_are_named_with_their_place(
    tmp_path: Path, old: str, new: str, words: str
) -> None:
    text = as_csv(path(times(10.0, span=2.0))).decode()
    assert old in text
    file = tmp_path / "path.csv"
    file.write_text(text.replace(old, new))
    with pytest.raises(InputError, match=words) as caught:
        read_trajectory_table(file)
    assert str(file) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "no header"),
        (b"gps_week,tow_s,lat_deg,lon_deg,height_ellipsoidal_m\n", "no rows"),
        (b"gps_week,tow_s,lat_deg,lon_deg,height_ellipsoidal_m\n2200,1,39\n", "3 cells"),
        (bytes(range(256)) * 20, "not a text file|lacks the column"),
    ],
)
def test_bad_files_are_refused(tmp_path: Path, content: bytes, words: str) -> None:
    file = tmp_path / "path.csv"
    file.write_bytes(content)
    with pytest.raises(InputError, match=words):
        read_trajectory_table(file)


def test_times_of_an_unknown_clock_are_not_written_as_gps() -> None:
    with pytest.raises(InputError, match="boot scale"):
        as_csv(replace(path(times(10.0, span=2.0)), scale="boot"))


# ---------------------------------------------------------------------------------------------
# Pictures and the tool
# ---------------------------------------------------------------------------------------------


def noisy_pair() -> tuple[TrajectoryLog, TrajectoryLog]:
    reference = path(times(10.0))
    rng = np.random.default_rng(11)
    error = rng.normal(0.0, 0.2, (len(reference), 3))
    covariance = np.tile(np.diag([0.04] * 3 + [1e-4] * 3), (len(reference), 1, 1))
    return replace(moved(reference, error), covariance=covariance), reference


@pytest.mark.slow
def test_pictures_are_drawn_of_what_there_is() -> None:
    estimate, reference = noisy_pair()
    both = comparison_pictures(compare_trajectories(estimate, reference), raw=estimate)
    assert set(both) == {
        "plan.png", "position.png", "position_error.png", "attitude.png", "attitude_error.png",
    }  # fmt: skip
    assert all(content.startswith(b"\x89PNG") for content in both.values())
    flat = replace(estimate, rpy=unknown(len(estimate), 3))
    alone = comparison_pictures(compare_trajectories(flat, reference))
    assert set(alone) == {"plan.png", "position.png", "position_error.png"}


def test_pictures_have_units_bands_and_a_legend_outside() -> None:
    found = compare_trajectories(*noisy_pair())
    figure = position_error_figure(found)
    png(figure, dpi=50)
    assert [axis.get_ylabel() for axis in figure.axes] == ["North (m)", "East (m)", "Down (m)"]
    assert figure.axes[-1].get_xlabel() == "Time since start (s)"
    words = [text.get_text() for text in figure.legends[0].get_texts()]
    assert words == ["±2 sigma", "±1 sigma", "difference"]
    legend = figure.legends[0].get_window_extent()
    assert all(not axis.get_window_extent().overlaps(legend) for axis in figure.axes)
    band = figure.axes[0].collections[0].get_paths()[0].vertices
    assert np.abs(band[:, 1]).max() == pytest.approx(2 * 0.2, rel=1e-6)


def test_no_spike_is_lost_when_rows_are_thinned() -> None:
    log = path(times(500.0))
    lifted = replace(log, height=log.height + np.where(np.arange(len(log)) == 12345, 7.0, 0.0))
    figure = position_error_figure(compare_trajectories(lifted, log))
    drawn = figure.axes[2].lines[0].get_ydata()
    assert len(drawn) < len(log) / 2
    assert np.min(drawn) == pytest.approx(-7.0, abs=1e-6)


def test_yaw_is_not_drawn_across_the_picture_where_it_wraps() -> None:
    log = path(times(10.0))
    for line in attitude_figure(compare_trajectories(log, log)).axes[2].lines:
        assert np.nanmax(np.abs(np.diff(line.get_ydata()))) < 180.0


def test_height_is_shown_closer_within_the_chosen_span() -> None:
    log = path(times(10.0))
    figure = position_figure({"raw fixes": log, "filter": log, "smoother": log}, zoom=(30.0, 34.0))
    assert figure.axes[3].get_xlim() == (30.0, 34.0)
    assert figure.axes[0].lines[0].get_linestyle() == "None"
    assert [t.get_text() for t in figure.legends[0].get_texts()] == [
        "raw fixes", "filter", "smoother",
    ]  # fmt: skip


def test_innovations_are_drawn_with_their_bands() -> None:
    rng = np.random.default_rng(12)
    v = rng.normal(size=(200, 3))
    v[::7, 2] = np.nan
    figure = innovation_figure(
        np.arange(200.0), v, np.ones((200, 3)), rng.chisquare(3, 200),
        names=["North (m)", "East (m)", "Down (m)"], dof=3,
    )  # fmt: skip
    assert png(figure, dpi=50).startswith(b"\x89PNG")
    assert figure.axes[3].get_ylabel() == "NIS/dof (-)"


def test_tool_tells_its_statistics_once(files: tuple[Path, Path]) -> None:
    """As a table: a face tells the figures of a summary one by one, here some 300."""
    feedback = CollectingFeedback()
    parameters = CompareTrajectoryParameters(estimate=files[0], reference=files[1])
    told = CompareTrajectory().run(Context(), parameters, feedback).summary
    assert sum(line.split()[:2] == ["all", "north"] for line in feedback.infos) == 1
    assert "statistics" not in told
    assert told["rows"] > 100


def run_tool(feedback: CollectingFeedback, **given: object) -> dict[str, Path]:
    parameters = CompareTrajectoryParameters(**given)
    return dict(CompareTrajectory().run(Context(), parameters, feedback).outputs)


@pytest.fixture
def files(tmp_path: Path) -> tuple[Path, Path]:
    estimate, reference = noisy_pair()
    (tmp_path / "estimate.csv").write_bytes(as_csv(estimate))
    (tmp_path / "reference.csv").write_bytes(as_csv(reference))
    return tmp_path / "estimate.csv", tmp_path / "reference.csv"


@pytest.mark.slow
def test_tool_tells_the_table_and_writes_the_folder(
    files: tuple[Path, Path], tmp_path: Path
) -> None:
    feedback, target = CollectingFeedback(), tmp_path / "new" / "out"
    outputs = run_tool(feedback, estimate=files[0], reference=files[1], target=target, raw=files[0])
    assert sorted(file.name for file in target.iterdir()) == [
        "attitude.png", "attitude_error.png", "comparison.json", "plan.png", "position.png",
        "position_error.png", "statistics.csv",
    ]  # fmt: skip
    told = json.loads(outputs["summary"].read_text())
    assert told["nees_position_over_3"] == pytest.approx(1.0, abs=0.15)
    assert {row["part"] for row in told["statistics"]} == {"all", "straight", "turns"}
    with outputs["table"].open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    north = next(row for row in rows if row["quantity"] == "north" and row["part"] == "all")
    assert float(north["rms"]) == pytest.approx(0.2, abs=0.02)
    assert any(line.startswith("all") and "north" in line for line in feedback.infos)
    assert list(target.parent.iterdir()) == [target]
    # Again, in place of its own older folder.
    (target / "stale.png").write_bytes(b"old")
    run_tool(feedback, estimate=files[0], reference=files[1], target=target)
    assert not (target / "stale.png").exists()


def test_tool_writes_nothing_where_it_must_not(files: tuple[Path, Path], tmp_path: Path) -> None:
    foreign = tmp_path / "photos"
    foreign.mkdir()
    (foreign / "P1.JPG").write_bytes(b"photo")
    with pytest.raises(ExportError, match="holds other files"):
        run_tool(CollectingFeedback(), estimate=files[0], reference=files[1], target=foreign)
    assert [file.name for file in foreign.iterdir()] == ["P1.JPG"]
    with pytest.raises(Cancelled):
        run_tool(CollectingFeedback(stop_at=0.5), estimate=files[0], reference=files[1],
                 target=tmp_path / "out")  # fmt: skip
    with pytest.raises(ExportError, match="is a file"):
        run_tool(CollectingFeedback(), estimate=files[0], reference=files[1], target=files[0])
    assert not (tmp_path / "out").exists()


def test_folder_is_left_as_it_was_when_writing_fails(tmp_path: Path) -> None:
    target = tmp_path / "out"
    write_folder(target, {"comparison.json": b"{}", "a.png": b"1"})
    with pytest.raises(ExportError):
        write_folder(target, {"comparison.json": b"{}", "no/such/folder.png": b"2"})
    assert sorted(file.name for file in target.iterdir()) == ["a.png", "comparison.json"]
    assert list(tmp_path.iterdir()) == [target]


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"lever_arm": "1,2"}, "three numbers"),
        ({"lever_arm": "1,2,nan"}, "within 1000 m"),
        ({"time_shift": 1.0, "find_time_shift": True}, "leave one out"),
        ({"estimate": "missing.csv"}, "cannot be read"),
        ({"estimate": "project"}, "project"),
    ],
)
def test_tool_refuses_what_makes_no_sense(
    files: tuple[Path, Path], given: dict[str, object], words: str
) -> None:
    parameters = {"estimate": files[0], "reference": files[1], **given}
    with pytest.raises(InputError, match=words):
        run_tool(CollectingFeedback(), **parameters)


def test_tool_finds_the_time_shift(files: tuple[Path, Path]) -> None:
    feedback = CollectingFeedback()
    run_tool(feedback, estimate=files[0], reference=files[1], find_time_shift=True)
    assert any(line.startswith("time shift found by velocity: +0.000") or
               line.startswith("time shift found by velocity: -0.000")
               for line in feedback.infos), feedback.infos  # fmt: skip
