"""A DEM in the adjustment: it levels the block, its offset stays free, its sigmas stay true."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace

import adjustment_flights as sim
import numpy as np
import pytest
from adjustment_blocks import block_of, first_points, rms
from adjustment_flights import rotvec
from numpy.typing import NDArray
from scipy.interpolate import LinearNDInterpolator

from georef_gis.orient.adjustment.adjust import Adjusted, adjust
from georef_gis.orient.adjustment.block import GroundPrior
from georef_gis.orient.adjustment.ground_weight import MOST_INDEPENDENT, weigh_ground

Array = NDArray[np.float64]
FLIGHTS = int(os.environ.get("GEOREF_FLIGHTS", "5"))
LOW, HIGH = (0.7, 1.4) if FLIGHTS >= 40 else (0.35, 2.1)
# m, one sigma: of a DEM's own waves, and of its offset
WAVES, OFFSET = 0.3, 4.0


def surface_of(flight: sim.SimFlight, seed: int, offset: float) -> Callable[[Array], Array]:
    """Heights by the true points, with waves as long as the site and an offset; NaN outside."""
    rng = np.random.default_rng(seed)
    xy = flight.points[:, :2]
    true = LinearNDInterpolator(xy, flight.points[:, 2])
    size = float(np.ptp(xy, axis=0).max())
    k = 2.0 * np.pi / (size * rng.uniform(0.7, 2.0, 12)) * np.exp(2j * np.pi * rng.random(12))
    phase = rng.uniform(0.0, 2.0 * np.pi, 12)

    def heights(at: Array) -> Array:
        turn = np.outer(at[:, 0], k.real) + np.outer(at[:, 1], k.imag) + phase
        waves = WAVES * np.sqrt(2.0 / 12.0) * np.sin(turn).sum(axis=1)
        return np.asarray(true(at) + offset + waves)

    return heights


def ground_of(flight: sim.SimFlight, seed: int, first: Array) -> GroundPrior:
    offset = OFFSET * np.random.default_rng(seed).normal()
    return GroundPrior(
        z_enu=first[:, 2], sigma=8.0, surface=surface_of(flight, seed, offset),
        sigma_surface=WAVES, sigma_free=OFFSET, sigma_other=8.0,
    )  # fmt: skip


def errors(flight: sim.SimFlight, found: Adjusted) -> tuple[Array, Array]:
    """Errors of the poses, (n, 6) m and rad, and by their sigmas."""
    truth = flight.truth
    p = np.array([pose.origin_enu for pose in found.poses])
    R = np.array([pose.R_enu_from_cam for pose in found.poses])
    turned = truth.R_enu_from_cam @ np.swapaxes(R, 1, 2)
    off = np.hstack([truth.p_cam - p, rotvec(turned)])
    sigma = np.sqrt([np.diag(pose.covariance) for pose in found.poses])
    return off, off / sigma


@pytest.mark.slow
def test_a_surface_levels_a_block_of_tags_and_the_sigmas_stay_true() -> None:
    with_it: list[Array] = []
    ratios: list[Array] = []
    without: list[Array] = []
    for seed in range(40, 40 + FLIGHTS):
        # a strip says least of its own roll
        flight = sim.gps_only(seed, 1, 8)
        block = block_of(flight)
        first = first_points(flight, block)
        plain, _ = errors(flight, adjust(block, first))
        known = block_of(flight, ground=ground_of(flight, seed, first))
        off, ratio = errors(flight, adjust(known, first))
        without.append(plain)
        with_it.append(off)
        ratios.append(ratio)
    tilt = [rms([e[:, 3:5] for e in kind]).mean() for kind in (without, with_it)]
    assert tilt[1] < 0.6 * tilt[0], np.degrees(tilt)
    assert np.all((rms(ratios) > LOW) & (rms(ratios) < HIGH)), rms(ratios)


def test_the_offset_is_an_unknown_of_its_own() -> None:
    """A surface in another height datum, 30 m off, moves no camera by more than its sigma."""
    flight = sim.rtk(3, 2, 6)
    block = block_of(flight)
    first = first_points(flight, block)
    ground = GroundPrior(
        z_enu=first[:, 2], sigma=8.0, surface=surface_of(flight, 3, 30.0), sigma_surface=WAVES,
        sigma_free=20.0, sigma_other=8.0,
    )  # fmt: skip
    alone, found = adjust(block, first), adjust(block_of(flight, ground=ground), first)
    names = block.shared_names
    at = names.index("surface_offset")
    assert found.shared[at] == pytest.approx(30.0, abs=4.0 * WAVES)
    assert alone.shared[at] == 0.0
    for before, after in zip(alone.poses, found.poses, strict=True):
        sigma = np.sqrt(np.diag(before.covariance))
        assert np.all(np.abs(after.origin_enu - before.origin_enu) < 1.5 * sigma[:3])


def test_trees_are_no_ground_and_alike_errors_count_as_few() -> None:
    rng = np.random.default_rng(1)
    xy = rng.uniform(-100.0, 100.0, (900, 2))
    # 0.1 m of noise; a third of the points stand on trees of 6 to 12 m in one corner
    tree = (xy[:, 0] > 10.0) & (xy[:, 1] > -40.0)
    z = 0.1 * rng.normal(size=900) + np.where(tree, rng.uniform(6.0, 12.0, 900), 0.0)
    # the block is tilted by 2 degrees
    z += np.tan(np.radians(2.0)) * xy[:, 0]
    ground = GroundPrior(
        z_enu=np.zeros(900), sigma=5.0, surface=lambda at: np.full(len(at), 50.0),
        sigma_surface=0.1, sigma_free=3.0, sigma_other=5.0,
    )  # fmt: skip
    found = weigh_ground(ground, np.column_stack([xy, z]))
    used = found.sigma < 5.0
    assert np.count_nonzero(used & tree) < 0.02 * np.count_nonzero(tree)
    assert np.count_nonzero(used & ~tree) > 0.95 * np.count_nonzero(~tree)
    # hypot of noise and of the surface's own sigma
    assert found.sigma[used] == pytest.approx(0.14, abs=0.02)
    assert found.independent == MOST_INDEPENDENT
    # waves of a quarter of the site are four by four witnesses at most
    waved = z[~tree] + 1.0 * np.sin(xy[~tree, 0] / 16.0)
    fewer = ground.selected(~tree)
    alike = weigh_ground(fewer, np.column_stack([xy[~tree], waved]))
    assert alike.independent < MOST_INDEPENDENT


def test_points_beside_the_surface_leave_the_first_knowledge() -> None:
    ground = GroundPrior(
        z_enu=np.zeros(40), sigma=5.0, surface=lambda at: np.full(len(at), np.nan),
        sigma_surface=0.1, sigma_free=3.0, sigma_other=5.0,
    )  # fmt: skip
    assert weigh_ground(ground, np.zeros((40, 3))) is ground


def tilted(surface: Callable[[Array], Array], slope: float) -> Callable[[Array], Array]:
    return lambda at: np.asarray(surface(at) + slope * at[:, 0])


def test_a_tilted_surface_that_claims_to_be_good_does_not_tilt_the_block() -> None:
    """10 % over a block by tags: 5.7 deg where the tags are sure of the level to 1 deg."""
    flight = sim.gps_only(44, 3, 6)
    block = block_of(flight)
    first = first_points(flight, block)
    ground = ground_of(flight, 44, first)
    assert ground.surface is not None
    wrong = replace(ground, surface=tilted(ground.surface, 0.1))
    plain, _ = errors(flight, adjust(block, first))
    found = adjust(block_of(flight, ground=wrong), first)
    off, ratio = errors(flight, found)
    assert any("disagree on the level" in note for note in found.notes)
    # as without a surface, up to the heights that are expected of any ground
    assert np.abs(off[:, 3:5] - plain[:, 3:5]).max() < np.radians(0.4)
    assert np.abs(ratio[:, 3:5]).max() < 3.0
    right = adjust(block_of(flight, ground=ground), first)
    assert not right.notes


@pytest.mark.parametrize("with_surface", [True, False])
def test_a_ground_in_another_datum_does_not_lift_the_photos(with_surface: bool) -> None:
    """33 m, as between the ellipsoid and the sea, over a ground stated to 0.3 m."""
    flight = sim.rtk(9, 2, 6)
    block = block_of(flight)
    true = first_points(flight, block)
    first = true + np.array([0.0, 0.0, 33.0])
    ground = GroundPrior(
        z_enu=first[:, 2], sigma=2.0, surface=surface_of(flight, 9, 33.0) if with_surface else None,
        sigma_surface=WAVES, sigma_free=0.6, sigma_other=2.0,
    )  # fmt: skip
    _, ratio = errors(flight, adjust(block_of(flight, ground=ground), first))
    assert np.abs(ratio).max() < 4.0
