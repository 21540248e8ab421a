"""What a flight shares: bias, mount, clock and readout time, and who learns of them."""

from __future__ import annotations

from dataclasses import replace

import adjustment_flights as sim
import numpy as np
import pytest
from adjustment_blocks import block_of, control_input, rms
from adjustment_cases import adjusted, errors, sigmas

from georef_gis.orient.adjustment.adjust import adjust
from georef_gis.orient.adjustment.block import ControlInput


@pytest.mark.slow
def test_two_blocks_without_common_points_share_what_their_flight_learns() -> None:
    """Boresight and clock of a block are worth to the other what they are worth to its own."""
    whole = sim.survey(16, 4, 6, navigation=sim.TIGHT_SLOW)
    block = block_of(whole)
    first = block.ties.photo < 12
    rays = np.stack([
        np.bincount(block.ties.point[side], minlength=block.ties.n_points)
        for side in (first, ~first)
    ])  # fmt: skip
    inside = np.where(rays[0] >= rays[1], 0, 1)[block.ties.point] == np.where(first, 0, 1)
    parted = replace(block, ties=block.ties.selected(inside))
    side = block.ties.selected(inside & first)
    alone = replace(block, ties=side)
    both, one = (adjust(b, np.zeros((b.ties.n_points, 3))) for b in (parted, alone))
    assert np.all(both.rms_by_photo()[1] > 0)
    assert np.sqrt(np.mean((errors(whole, both) / sigmas(both)) ** 2)) < 1.8
    # the second block's photos in an adjustment of the first: better than nothing, and told
    assert np.all(one.rms_by_photo()[1][12:] == 0)
    direct = np.sqrt([np.diag(p.covariance) for p in block.poses])[12:]
    learned = sigmas(one)[12:]
    assert np.median(learned[:, 3] / direct[:, 3]) < 0.6
    assert np.sqrt(np.mean((errors(whole, one)[12:] / learned) ** 2)) < 1.8
    assert np.all(np.median(sigmas(both)[12:], axis=0) < np.median(learned, axis=0))


@pytest.mark.slow
def test_a_photo_without_ties_takes_the_bias_and_the_boresight_of_its_flight() -> None:
    """Control shows the bias: the lone photo's place and angles are corrected by it."""
    made = []
    for seed in range(17, 23):
        flight = sim.rtk(seed, 3, 5, control=5, sigmas=sim.shared_sigmas(3.0, 0.02, 3.0, 0.005))
        block = block_of(flight, control=control_input((flight.control, True)))
        ties = block.ties.selected(block.ties.photo != 7)
        control = without_marks(block.control, 7)
        answer = adjusted(flight, replace(block, ties=ties, control=control))
        assert answer.rms_by_photo()[1][7] == 0
        e, s = errors(flight, answer)[7], sigmas(answer)[7]
        before = np.sqrt(np.diag(block.poses[7].covariance))
        assert np.all(s[:3] < 0.1 * before[:3])
        assert np.all(s[3:] < 0.9 * before[3:])
        made.append((e / s)[None])
    assert np.all(rms(made) < 2.2)


def without_marks(control: ControlInput | None, photo: int) -> ControlInput:
    assert control is not None
    keep = control.photo != photo
    return replace(
        control, photo=control.photo[keep], point=control.point[keep], uv=control.uv[keep],
        sigma_px=control.sigma_px[keep],
    )  # fmt: skip


@pytest.mark.slow
def test_readout_time_is_found_where_speeds_differ() -> None:
    """20 ms, one sigma 5 ms; with and against the wind and across: within 3 of its sigmas."""
    flights = [
        sim.calibration_flight(seed, readout_s=0.02, obs_per_photo=60.0) for seed in (31, 32, 33)
    ]
    found = []
    for flight in flights:
        block = block_of(flight)
        # a lens that states none: the prior is at zero
        camera = block.cameras[0]
        blank = replace(camera, camera=replace(camera.camera, readout_s=0.0))
        blank.sigma[10] = 0.03
        answer = adjusted(flight, replace(block, cameras=(blank,)))
        sigma = np.sqrt(answer.covariances.shared()[10, 10])
        assert sigma < 0.004
        found.append((answer.cameras[0].readout_s - flight.camera_true.readout_s) / sigma)
    assert np.abs(found).max() < 3.5, found


@pytest.mark.slow
def test_boresight_lever_arm_and_clock_are_found_within_their_sigmas() -> None:
    made = []
    for seed in range(41, 45):
        flight = sim.calibration_flight(seed, obs_per_photo=60.0)
        answer = adjusted(flight)
        values, covariance = answer.flight(0)
        t, s = flight.shared_true, flight.shared
        true = np.concatenate(
            [t.lever - s.lever, t.boresight - s.boresight, s.bias - t.bias, [s.clock - t.clock]]
        )
        made.append(((true - values) / np.sqrt(np.diag(covariance)))[None])
        assert np.degrees(np.sqrt(np.diag(covariance))[3:6]).max() < 0.06
    assert np.all(rms(made) < 2.2), rms(made)
