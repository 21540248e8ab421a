"""Trajectories without an IMU against simulated flights, and against logs that are bad."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from navigation_flights import drawn, errors_at, logs_of
from scipy.io import loadmat

from georef_gis.ellipsoid import Origin
from georef_gis.errors import InputError, NavigationError
from georef_gis.frames import Array, R_ned_from_body, log_so3, rpy_from_R_ned_from_body
from georef_gis.geodesy import HeightKind
from georef_gis.model.logs import GnssLog, covariance_of_sigmas, unknown
from georef_gis.navigate.gnss_noise import Fixes, prepare_fixes
from georef_gis.navigate.kinematic import KinematicTrajectory
from georef_gis.navigate.kinematic_solution import smooth_fixes
from georef_gis.simulate import SimulatedFlight

CENTRED = {"lever_arm_antenna": (0.0, 0.0, 0.0), "lever_arm_sigma": 0.0}
NAMES = ("time", "lat", "lon", "height", "geoid_separation", "v_ned", "covariance_ned",
         "covariance_v_ned", "fix", "satellites")  # fmt: skip


def rows(gnss: GnssLog, chosen: Array | slice) -> GnssLog:
    """Some rows of a log."""
    return replace(gnss, **{name: getattr(gnss, name)[chosen] for name in NAMES})


def flown(seed: int, lines: int = 4, **settings: object) -> tuple[SimulatedFlight, GnssLog]:
    """A flight of some rows whose antenna is the place asked for."""
    flight = drawn(seed, rows=lines, **(CENTRED | settings))
    return flight, logs_of(flight)[1]


def ratios(
    flight: SimulatedFlight, found: KinematicTrajectory, spacing: float = 9.0
) -> tuple[Array, dict[float, Array]]:
    """Errors by their sigma (n, 6), and those of differences over 1, 5, 15 s."""
    first, last = found.span
    t = np.arange(first + 2.0, last - 2.0, spacing)
    e = errors_at(flight, found, t)
    single = e / np.sqrt(np.einsum("nii->ni", found.at(t).covariance))
    D = np.hstack([-np.eye(6), np.eye(6)])
    over = {}
    for lag in (1.0, 5.0, 15.0):
        start = t[t + lag < last]
        d = errors_at(flight, found, start + lag) - errors_at(flight, found, start)
        joint = [found.joint_covariance([s, s + lag]) for s in start]
        over[lag] = d / np.sqrt([(D @ J @ D.T).diagonal() for J in joint])
    return single, over


def rms(values: list[Array]) -> Array:
    """Root mean square of columns."""
    return np.asarray(np.sqrt(np.mean(np.concatenate(values) ** 2, axis=0)))


def fair(value: Array) -> bool:
    """Whether error by sigma is honest."""
    return bool(np.all((value > 0.7) & (value < 1.4)))


def same(gnss: GnssLog) -> GnssLog:
    return gnss


def once_a_second(gnss: GnssLog) -> GnssLog:
    return rows(gnss, slice(None, None, 5))


def without_velocity(gnss: GnssLog) -> GnssLog:
    return replace(gnss, v_ned=np.full_like(gnss.v_ned, np.nan))


@pytest.mark.slow
@pytest.mark.parametrize("noise", ["white", "coloured"])
def test_positions_and_differences_are_as_good_as_they_say_over_40_flights(noise: str) -> None:
    singles, over = [], {1.0: [], 5.0: [], 15.0: []}
    for seed in range(40):
        flight, gnss = flown(seed, 2, gnss=noise)
        single, differences = ratios(flight, smooth_fixes(prepare_fixes(gnss)), 17.0)
        singles.append(single[:, :3])
        for lag, values in differences.items():
            over[lag].append(values[:, :3])
    assert fair(rms(singles)), rms(singles)
    for lag, parts in over.items():
        assert fair(rms(parts)), (lag, rms(parts))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "cep", "least"),
    [
        (once_a_second, 2.5, 0.7),
        (without_velocity, 2.5, 0.7),
        # one noise for rows and turns: positions alone tell the rows' jerk from the turns' only
        # where both are below the noise of a fix
        (without_velocity, 0.03, 0.4),
        (same, 0.03, 0.7),
    ],
    ids=["1 Hz", "no velocity", "RTK without velocity", "RTK"],
)
def test_other_receivers_are_as_good_as_they_say(
    change: Callable[[GnssLog], GnssLog], cep: float, least: float
) -> None:
    singles = []
    for seed in range(8):
        flight, gnss = flown(seed, gnss="white", gnss_cep=cep)
        found = smooth_fixes(prepare_fixes(change(gnss), slow_sigma=0.0))
        first, last = found.span
        t = np.arange(first + 2.0, last - 2.0, 5.0)
        sigma = np.sqrt(np.einsum("nii->ni", found.at(t).covariance))
        singles.append((errors_at(flight, found, t) / sigma)[:, :3])
    found_rms = rms(singles)
    assert np.all((found_rms > least) & (found_rms < 1.4)), found_rms


def test_smoothing_removes_white_noise() -> None:
    flight, gnss = flown(1, gnss="white")
    found = smooth_fixes(prepare_fixes(gnss))
    t = gnss.time[10:-10]
    # 2.1 m per axis and fix; velocities of 0.1 m/s at 5 Hz let it average over some 20 s
    assert np.all(rms([errors_at(flight, found, t)[:, :3]]) < 0.3)


@pytest.mark.slow
@pytest.mark.parametrize("width", [5.0, 12.0, 25.0])
def test_gap_of_fixes_is_bridged_with_a_sigma_that_covers_it(width: float) -> None:
    z = []
    for seed in range(12):
        flight, gnss = flown(seed, gnss="white")
        start = gnss.time[0] + 40.0 + 5.0 * seed
        found = smooth_fixes(
            prepare_fixes(rows(gnss, (gnss.time < start) | (gnss.time > start + width)))
        )
        assert any("gaps of the GNSS log" in doubt for doubt in found.doubts)
        t = start + width * np.array([0.25, 0.5, 0.75])
        assert found.why_not(float(t[1])) == ""
        sigma = np.sqrt(np.einsum("nii->ni", found.at(t).covariance))[:, :3]
        z.append(errors_at(flight, found, t)[:, :3] / sigma)
        near = np.sqrt(found.at([start - 5.0]).covariance[0, 0, 0])
        assert sigma[1, 0] > (1.2 if width < 10.0 else 5.0) * near
    # wide, for a gap is one draw of rows or turns
    assert np.all(rms(z) < 1.5), rms(z)
    assert np.all(rms(z) > 0.2), rms(z)


def test_outage_of_a_minute_is_refused_within_and_honest_around() -> None:
    flight, gnss = flown(2, gnss="white")
    start = gnss.time[0] + 70.0
    found = smooth_fixes(prepare_fixes(rows(gnss, (gnss.time < start) | (gnss.time > start + 60))))
    assert "in a gap of 60." in found.why_not(start + 30.0)
    with pytest.raises(NavigationError, match=r"gap of 60\.\d s of the GNSS log \(2 such times\)"):
        found.at([start - 10.0, start + 1.0, start + 50.0])
    t = np.array([start - 1.0, start + 61.0])
    sigma = np.sqrt(np.einsum("nii->ni", found.at(t).covariance))
    assert np.all(np.abs(errors_at(flight, found, t)[:, :3]) < 3.5 * sigma[:, :3])
    # nothing but the slow error could link both sides, and there is none
    cross = found.chain(t).cross(0, 1)
    assert np.abs(cross[:3, :3]).max() < 0.05 * found.at(t).covariance[0, 0, 0]


@pytest.mark.parametrize(("first", "count"), [(300, 1), (300, 20), (0, 1)])
def test_jump_of_500_m_hardly_moves_the_path(first: int, count: int) -> None:
    flight, gnss = flown(3, gnss="white")
    lat, height = gnss.lat.copy(), gnss.height.copy()
    lat[first : first + count] += 500.0 / 6.36e6
    height[first : first + count] += 500.0
    found = smooth_fixes(prepare_fixes(replace(gnss, lat=lat, height=height)))
    t = gnss.time[max(first - 10, 0) : first + count + 10]
    error = np.abs(errors_at(flight, found, t)[:, :3])
    assert error.max() < 1.5, error.max()  # m
    if count > 3:
        doubt = next(doubt for doubt in found.doubts if "count less" in doubt)
        # one in a thousand good ones may be among them
        assert count <= int(doubt.split()[0]) <= count + 5


def test_order_of_the_fixes_does_not_matter_and_double_ones_count_once() -> None:
    _, gnss = flown(4)
    fixes = prepare_fixes(gnss)
    n = len(fixes)
    order = np.random.default_rng(0).permutation(np.concatenate([np.arange(n), np.arange(40, 60)]))
    mixed = Fixes(
        time=fixes.time[order], p_geo=fixes.p_geo[order], R_p=fixes.R_p[order], v=fixes.v[order],
        R_v=fixes.R_v[order], slow=fixes.slow,
    )  # fmt: skip
    one, other = smooth_fixes(fixes), smooth_fixes(mixed)
    np.testing.assert_array_equal(one.smoothed, other.smoothed)
    np.testing.assert_array_equal(one.covariance, other.covariance)


def test_order_of_the_times_does_not_matter() -> None:
    _, gnss = flown(4)
    found = smooth_fixes(prepare_fixes(gnss))
    t = np.random.default_rng(0).uniform(*found.span, 30)
    mixed, sorted_ = found.at(t), found.at(np.sort(t))
    order = np.argsort(t)
    np.testing.assert_array_equal(mixed.p_geo[order], sorted_.p_geo)
    np.testing.assert_allclose(found.chain(np.sort(t)).covariance[:, :6, :6], sorted_.covariance)
    with pytest.raises(ValueError, match="must not decrease"):
        found.chain(t)


def static(n: int, *, velocity: bool, rate: float = 5.0) -> GnssLog:
    """Fixes of a hovering vehicle."""
    rng = np.random.default_rng(9)
    v = 0.1 * rng.normal(size=(n, 3)) if velocity else np.full((n, 3), np.nan)
    return GnssLog(
        time=1e9 + np.arange(n) / rate, lat=0.7 + rng.normal(size=n) / 6.36e6,
        lon=-1.4 + rng.normal(size=n) / 6.38e6 / np.cos(0.7), height=300.0 + rng.normal(size=n),
        height_kind=HeightKind.ELLIPSOIDAL, geoid_separation=unknown(n), v_ned=v,
        covariance_ned=covariance_of_sigmas(np.ones((n, 3))),
        covariance_v_ned=covariance_of_sigmas(np.full((n, 3), 0.1)),
        fix=np.full(n, 3), satellites=np.full(n, -1), source="gnss.csv",
    )  # fmt: skip


@pytest.mark.parametrize("velocity", [True, False], ids=["velocity", "position only"])
def test_hovering_vehicle_has_a_place_but_no_heading(*, velocity: bool) -> None:
    found = smooth_fixes(prepare_fixes(static(600, velocity=velocity), slow_sigma=0.0))
    states = found.at(np.linspace(*found.span, 50))
    enu = Origin(lat=0.7, lon=-1.4, height_ellipsoidal=300.0).enu_from_geo(states.p_geo)
    sigma = np.sqrt(np.einsum("nii->ni", states.covariance))
    assert np.all(np.abs(enu) < 4.0 * sigma[:, [1, 0, 2]])
    assert sigma[:, 0].max() < 0.6  # m
    assert sigma[:, 5].min() > np.radians(90.0)
    assert np.abs(states.rate_body).max() < 1e-9


def test_one_fix_is_refused_and_two_are_a_trajectory_that_knows_little() -> None:
    log = static(2, velocity=False, rate=0.5)
    with pytest.raises(NavigationError, match="1 GNSS fixes; a trajectory needs two"):
        smooth_fixes(prepare_fixes(rows(log, slice(0, 1))))
    found = smooth_fixes(prepare_fixes(log, slow_sigma=0.0))
    P = found.at([log.time[0] + 1.0]).covariance[0]
    assert 0.5 < np.sqrt(P[0, 0]) < 3.0  # m: two fixes of 1 m and what may happen in a second
    double = replace(log, time=np.full(2, log.time[0]))
    with pytest.raises(NavigationError, match="at different times"):
        smooth_fixes(prepare_fixes(double, slow_sigma=0.0))


def test_times_outside_are_refused_in_words() -> None:
    found = smooth_fixes(prepare_fixes(static(100, velocity=True)))
    first, last = found.span
    assert found.why_not(first) == found.why_not(last) == ""
    assert "3.0 s before the first GNSS fix" in found.why_not(first - 3.0)
    assert "2.0 s after the last GNSS fix" in found.why_not(last + 2.0)
    assert "not known" in found.why_not(float("nan"))


def test_both_ends_of_a_flight_are_as_its_inside() -> None:
    _, gnss = flown(5)
    found = smooth_fixes(prepare_fixes(gnss))
    first, last = found.span
    for t, near in ((first, first + 1e-6), (last, last - 1e-6)):
        a, b = found.at([t]), found.at([near])
        np.testing.assert_allclose(a.p_geo, b.p_geo, atol=1e-8)
        np.testing.assert_allclose(a.covariance, b.covariance, rtol=1e-3, atol=1e-6)
    whole = found.joint_covariance([first, last - 0.1, last, last])
    np.testing.assert_allclose(whole[12:18, 12:18], whole[18:, 12:18], rtol=1e-6, atol=1e-9)


@pytest.mark.slow
def test_course_bank_and_path_are_as_good_as_they_say() -> None:
    """In the wind and the turbulence that the defaults speak of: 15 and 6 deg."""
    singles, over = [], {1.0: [], 5.0: [], 15.0: []}
    for seed in range(20):
        flight, gnss = flown(
            seed, 2, gnss="white", wind_sigma=20.0 * np.tan(np.radians(14.0)), roll_sigma_deg=6.0,
            pitch_sigma_deg=6.0, pitch_trim_deg=0.0,
        )  # fmt: skip
        single, differences = ratios(flight, smooth_fixes(prepare_fixes(gnss)), 13.0)
        singles.append(single[:, 3:])
        for lag, values in differences.items():
            over[lag].append(values[:, 3:])
    assert fair(rms(singles)), rms(singles)
    for lag, parts in over.items():
        assert fair(rms(parts)), (lag, rms(parts))


def test_turns_are_banked_and_their_rate_is_about_the_vertical() -> None:
    flight, gnss = flown(6, gnss="white", roll_sigma_deg=0.0, wind_sigma=0.0)
    found = smooth_fixes(prepare_fixes(gnss))
    t = gnss.time[25:-25]
    states = found.at(t)
    rpy = rpy_from_R_ned_from_body(states.R_ned_from_body)
    truth = np.degrees(flight.path.rpy(t - flight.start_gps))
    turning = np.abs(truth[:, 0]) > 20.0
    assert np.count_nonzero(turning) > 50
    # 25 deg of bank in the turns; the smoothed acceleration of 0.1 m/s velocities leaves a few
    assert np.sqrt(np.mean((np.degrees(rpy[:, 0]) - truth[:, 0]) ** 2)) < 3.0
    rate = np.einsum("nij,nj->ni", states.R_ned_from_body, states.rate_body)
    np.testing.assert_allclose(rate[:, :2], 0.0, atol=1e-12)
    true_rate = flight.path.rpy(t - flight.start_gps, 1)[:, 2]
    assert np.corrcoef(rate[:, 2], true_rate)[0, 1] > 0.9


def test_one_wind_turns_the_nose_to_opposite_sides_on_opposite_rows() -> None:
    _, gnss = flown(6, gnss="white")
    found = smooth_fixes(prepare_fixes(gnss))
    t = gnss.time[[65, 85]]
    yaw = rpy_from_R_ned_from_body(found.at(gnss.time[5:-5]).R_ned_from_body)[:, 2]
    back = gnss.time[5:-5][np.argmin(np.cos(yaw - yaw[60]))]
    J = found.joint_covariance(np.sort([t[0], t[1], back]))
    own = J[5, 5]
    assert J[5, 11] > 0.8 * own  # the course itself turns by some degrees
    assert J[5, 17] < -0.7 * own


def test_attitude_error_follows_the_jacobian_of_the_angles() -> None:
    """Covariances of (roll, pitch, yaw) sigmas against finite differences, steeply banked."""
    _, gnss = flown(6, gnss="white", wind_sigma=0.0)
    found = smooth_fixes(prepare_fixes(gnss))
    t = gnss.time[[200, 300, 420]]
    states = found.at(t)
    for R, P in zip(states.R_ned_from_body, states.covariance, strict=True):
        rpy = rpy_from_R_ned_from_body(R)
        J = np.empty((3, 3))
        for k in range(3):
            d = 1e-6 * np.eye(3)[k]
            D = (R_ned_from_body(*(rpy + d)) @ R.T - R_ned_from_body(*(rpy - d)) @ R.T) / 2e-6
            J[:, k] = D[2, 1], D[0, 2], D[1, 0]
        angles = np.linalg.inv(J) @ P[3:, 3:] @ np.linalg.inv(J).T
        np.testing.assert_allclose(
            np.degrees(np.sqrt(angles.diagonal())), [6.0, 6.0, 15.0], rtol=0.01
        )


def test_a_saved_trajectory_comes_back_and_others_are_refused(tmp_path: Path) -> None:
    _, gnss = flown(7)
    found = smooth_fixes(prepare_fixes(gnss))
    path = tmp_path / "trajectory.npz"
    found.save(path)
    again = KinematicTrajectory.load(path)
    t = np.sort(np.random.default_rng(0).uniform(*found.span, 20))
    np.testing.assert_array_equal(found.joint_covariance(t), again.joint_covariance(t))
    np.testing.assert_array_equal(found.at(t).p_geo, again.at(t).p_geo)
    assert (again.notes, again.doubts, again.span) == (found.notes, found.doubts, found.span)
    with np.load(path) as file:
        assert str(file["kind"]) == "kinematic"
    assert list(tmp_path.iterdir()) == [path]
    broken = tmp_path / "broken.npz"
    broken.write_bytes(path.read_bytes()[:5000])
    other = tmp_path / "other.npz"
    np.savez(other, format=np.array(1), kind=np.array("table"))
    for bad, word in ((broken, "holds no columns of ours"), (other, "holds 'table'"),
                      (tmp_path / "none.npz", "holds no columns of ours")):  # fmt: skip
        with pytest.raises(InputError, match=word):
            KinematicTrajectory.load(bad)


def test_long_flights_are_exact_far_from_their_middle() -> None:
    """80 km due east at 60 deg north: level axes turn by 1.2 deg of heading under way."""
    n = 2000
    t = np.arange(n) * 0.5
    lon = np.linspace(-0.7, 0.7, n) * np.pi / 180.0
    lat = np.full(n, np.radians(60.0))
    v_east = (lon[1] - lon[0]) / 0.5 * 6394.2e3 * np.cos(lat[0])
    log = static(n, velocity=True)
    log = replace(
        log, time=1e9 + t, lat=lat, lon=lon, height=np.full(n, 500.0),
        v_ned=np.tile([0.0, v_east, 0.0], (n, 1)),
    )  # fmt: skip
    found = smooth_fixes(prepare_fixes(log, slow_sigma=0.0))
    states = found.at(log.time[5:-5] + 0.2)
    assert np.abs(states.p_geo[:, 0] - lat[0]).max() * 6.36e6 < 0.1  # m
    assert np.abs(states.p_geo[:, 2] - 500.0).max() < 0.1  # m
    np.testing.assert_allclose(states.v_ned, log.v_ned[5:-5], atol=0.05)
    yaw = np.degrees(rpy_from_R_ned_from_body(states.R_ned_from_body)[:, 2])
    np.testing.assert_allclose(yaw, 90.0, atol=0.05)


def test_an_hour_of_5_hz_takes_less_than_2_s_of_cpu() -> None:
    log = static(18000, velocity=True)
    smooth_fixes(prepare_fixes(rows(log, slice(0, 100))))
    fixes = prepare_fixes(log)
    start = time.process_time()
    found = smooth_fixes(fixes)
    found.at(np.linspace(*found.span, 1000))
    assert time.process_time() - start < 2.0  # s; 0.5 s where it was written


def test_real_fixed_wing_without_its_imu_agrees_with_its_own_filter() -> None:
    """Thor, flight 75, 1 Hz fixes: attitude by the course against the onboard filter."""
    folder = os.environ.get("GEOREF_DATA")
    if not folder:
        pytest.skip("GEOREF_DATA is not set: no real data")
    path = Path(folder) / "flight_logs" / "thor75" / "thor_flight75.mat"
    d = loadmat(path, squeeze_me=True, struct_as_record=False)["flight_data"]
    # the first rows are placeholders at 45 deg
    i = np.flatnonzero((np.diff(d.GPS_TOW, prepend=d.GPS_TOW[0]) != 0) & (d.lat > 45.1))
    n = len(i)
    log = replace(
        static(n, velocity=True), time=d.time[i].astype(float), lat=np.radians(d.lat[i]),
        lon=np.radians(d.lon[i]), height=d.alt[i].astype(float), fix=np.full(n, 3),
        v_ned=np.stack([d.vn, d.ve, d.vd], axis=-1)[i].astype(float),
        covariance_ned=unknown(n, 3, 3), covariance_v_ned=unknown(n, 3, 3),
    )  # fmt: skip
    found = smooth_fixes(prepare_fixes(log))
    first, last = found.span
    k = np.flatnonzero((d.navValid == 0) & (d.time > first) & (d.time < last))[::25]
    k = k[np.hypot(d.navvn, d.navve)[k] > 8.0]
    states = found.at(d.time[k])
    R = R_ned_from_body(d.phi[k], d.theta[k], d.psi[k])
    theta = log_so3(R @ np.swapaxes(states.R_ned_from_body, -1, -2))
    sigma = np.sqrt(np.einsum("nii->ni", states.covariance))
    ratio = rms([theta / sigma[:, 3:]])
    assert np.all((ratio > 0.5) & (ratio < 1.5)), ratio
    level = np.stack([
        (d.navlat[k] - states.p_geo[:, 0]) * 6.3675e6,
        (d.navlon[k] - states.p_geo[:, 1]) * 6.3675e6 * np.cos(states.p_geo[0, 0]),
    ], axis=-1)  # fmt: skip
    assert np.all(rms([level / sigma[:, :2]]) < 1.5)
