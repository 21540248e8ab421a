"""An adjusted block taken apart by what went into it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest

from georef_gis.frames import Array, skew
from georef_gis.measure.budget.adjusted import split
from georef_gis.measure.budget.forecast import Sensors
from georef_gis.measure.preflight.layout import Plan, layout_of, plan_area
from georef_gis.model.camera import Camera
from georef_gis.orient.adjustment.adjust import Adjusted, adjust
from georef_gis.orient.adjustment.problem import Problem
from processing_algorithms.measure.budget_block import known_of_block, tag_noise
from processing_algorithms.plan.plan_block import planned_block, planned_photos

pytestmark = pytest.mark.slow
CAMERA = Camera(
    id="c", width=4000, height=3000, fx=3000.0, fy=3000.0, cx=1999.5, cy=1499.5, k1=-0.02,
    sigma_f=15.0, sigma_c=8.0,
)  # fmt: skip
SENSORS = Sensors(
    gnss=1.5, gnss_up=2.5, roll_pitch=math.radians(1.0), yaw=math.radians(2.0),
    boresight=math.radians(0.5), lever_arm=0.1, time=0.01, focal=15.0, centre=8.0, ground=1.0,
    click=1.0,
)  # fmt: skip


@dataclass(frozen=True)
class Case:
    adjusted: Adjusted
    covariance: Array
    parts: dict[str, Array]


def case(control: int) -> Case:
    layout = layout_of(CAMERA, 90.0, 12.0, overlap=0.75, sidelap=0.5)
    plan = Plan(
        lines=plan_area([[0, 0], [160, 0], [160, 150], [0, 150]], layout), layouts=(layout,)
    )
    photos = planned_photos(plan.lines, CAMERA, SENSORS, speed=12.0)
    block, first = planned_block(photos, CAMERA, SENSORS, tie_px=0.5, control=control)
    adjusted = adjust(block, first)
    covariance = adjusted.covariances.inverse()
    flights = Problem(block, first).flights
    known = known_of_block(block, flights, [tag_noise(f) for f in flights], covariance)
    parts = split(covariance, known, n_photos=len(photos), with_level=False)
    return Case(adjusted=adjusted, covariance=covariance, parts=parts)


@pytest.fixture(scope="module", params=[0, 5], ids=["no control", "five points"])
def block(request: pytest.FixtureRequest) -> Case:
    return case(request.param)


def test_what_is_left_to_the_matches_is_what_they_give_by_themselves(block: Case) -> None:
    """By subtraction, and by the normal matrix of the pixels alone."""
    problem, state = block.adjusted.problem, block.adjusted.solution.state
    reduced = problem.reduced(state, block.adjusted.solution.loss.signed, 0.0)
    full, _ = problem.dense_normal(state, reduced)
    without = np.zeros_like(full)
    n = 6 * len(state.origin)
    border, corner, _, turned = problem._with_priors(state, reduced)
    without[:n, :n] = problem.flights[0].pose_normal(turned[0])
    without[:n, n:], without[n:, n:] = (
        border - reduced.border.reshape(n, -1),
        corner - reduced.corner,
    )
    without[n:, :n] = without[:n, n:].T
    held = np.concatenate([np.zeros(n, bool), ~problem.free])
    H = full - without
    H[held], H[:, held] = 0.0, 0.0
    C = block.covariance
    scale = np.sqrt(np.diag(C)) + 1e-12
    off = (block.parts["matching"] - C @ H @ C) / np.outer(scale, scale)
    # of a sigma times a sigma: the priors are taken at their own angles, not the adjusted ones
    assert np.abs(off).max() < 2e-3


def test_parts_are_covariances_and_add_up(block: Case) -> None:
    assert sum(block.parts.values()) == pytest.approx(block.covariance, abs=1e-12)
    scale = np.sqrt(np.diag(block.covariance)) + 1e-12
    for source, part in block.parts.items():
        if source != "coupling":
            smallest = np.linalg.eigvalsh(part / np.outer(scale, scale))[0]
            assert smallest > -5e-3, source


def test_control_takes_the_receivers_share() -> None:
    """Without control a block lies where the receiver says, with it where the survey says."""
    free, held = case(0), case(5)
    middle = len(free.adjusted.poses) // 2
    rows = 6 * middle + np.arange(6)
    ray = np.array([0.0, 0.0, -90.0])
    # the place below the camera
    J = np.hstack([np.eye(3), -skew(ray)])[:2]
    level = [np.trace(J @ one.parts["gnss"][np.ix_(rows, rows)] @ J.T) for one in (free, held)]
    whole = np.trace(J @ free.covariance[np.ix_(rows, rows)] @ J.T)
    assert level[0] > 0.6 * whole
    # of the variance; five points of 2 cm against a receiver of 1.5 m
    assert level[1] < 0.01 * level[0]
