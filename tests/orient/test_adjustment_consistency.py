"""The adjustment's sigmas are true: errors over sigma on flights with every error redrawn."""

from __future__ import annotations

import os

import numpy as np
import pytest
from adjustment_blocks import block_of, control_input, judge, rms
from adjustment_flights import (
    calibration_flight,
    gps_only,
    rtk,
    strip,
    survey,
    two_photos,
)

# 5 flights in the daily tests; 40 when asked
FLIGHTS = int(os.environ.get("GEOREF_FLIGHTS", "5"))
# the errors of one flight hang together: the rms of 5 scatters by a third of itself
LOW, HIGH = (0.7, 1.4) if FLIGHTS >= 40 else (0.35, 2.1)

KINDS = {
    "smoothed navigation": lambda seed: survey(seed, 3, 6),
    "tags": lambda seed: gps_only(seed, 3, 6),
    "RTK": lambda seed: rtk(seed, 3, 6),
    "strip": strip,
    "two photos": two_photos,
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", list(KINDS))
def test_errors_agree_with_their_sigmas(kind: str) -> None:
    found = [judge(KINDS[kind](seed)) for seed in range(100, 100 + FLIGHTS)]
    poses = rms([j.poses for j in found])
    points = rms([j.points for j in found])
    shared = np.sqrt(np.nanmean(np.concatenate([j.shared for j in found]) ** 2))
    assert np.all((poses > LOW) & (poses < HIGH)), poses
    assert np.all((points > LOW) & (points < HIGH)), points
    assert LOW < shared < HIGH
    assert all(j.solution.converged for j in found)


@pytest.mark.slow
def test_calibration_flight_separates_boresight_clock_and_lever_arm() -> None:
    """Standard deviations of the reference block with independent errors of 5 cm, 0.1/0.1/0.2."""
    judged = judge(calibration_flight(7))
    sigma = np.sqrt(np.diag(judged.covariances.shared()))[11:21]
    assert np.degrees(sigma[3:6]) == pytest.approx([0.011, 0.011, 0.021], rel=0.2)
    assert sigma[9] == pytest.approx(1.6e-3, rel=0.2)
    assert np.nanmax(np.abs(judged.shared)) < 4.5


@pytest.mark.slow
def test_control_gives_the_level_and_takes_the_bias_off() -> None:
    flight = gps_only(5, 3, 6, control=5, check=30)
    block = block_of(flight, control=control_input((flight.control, True)), sigma_level=30.0)
    judged = judge(flight, block)
    # 1 cm of survey, half a pixel of 2 cm
    assert np.sqrt(np.mean(judged.errors[:, :3] ** 2)) < 0.1
    assert np.sqrt(np.mean(judged.poses**2)) < 1.75


@pytest.mark.slow
def test_one_landmark_shifts_the_block() -> None:
    flight = gps_only(6, 3, 6, control=1)
    block = block_of(flight, control=control_input((flight.control, True)))
    without, with_one = judge(flight), judge(flight, block)
    gain = np.abs(without.errors[:, :2]).mean() / np.abs(with_one.errors[:, :2]).mean()
    assert gain > 1.5
    assert np.sqrt(np.mean(with_one.poses**2)) < 2.0


def test_few_outliers_change_little() -> None:
    clean, dirty = strip(3), strip(3, outliers=0.05)
    shift = judge(clean).errors - judge(dirty).errors
    sigma = np.sqrt(np.einsum("nii->ni", judge(clean).covariances.poses()))
    # the two flights differ in their noise and in 5 % of wrong matches
    assert np.all(np.abs(shift) < 3.5 * sigma)
