"""What a solution does not hang on, and what it leaves where it is."""

from __future__ import annotations

from dataclasses import replace

import adjustment_flights as sim
import numpy as np
from adjustment_blocks import block_of, first_points, judge

from georef_gis.orient.adjustment.adjust import adjust
from georef_gis.orient.adjustment.block import Block


def test_a_block_of_photos_without_any_tie_point_stays_where_it_is() -> None:
    flight = sim.strip(18, 3)
    block = block_of(flight)
    nothing = block.ties.selected(np.zeros(len(block.ties.photo), bool))
    answer = adjust(replace(block, ties=nothing), np.zeros((0, 3)))
    for old, new in zip(block.poses, answer.poses, strict=True):
        np.testing.assert_allclose(new.origin_enu, old.origin_enu, atol=1e-9)
        # floor of the prior: 0.1 mm and 1e-6 rad
        np.testing.assert_allclose(new.covariance, old.covariance, rtol=2e-2, atol=1e-4)


def test_solution_does_not_hang_on_who_counts_first() -> None:
    """The same photos in another order give the same poses, to a hundredth of a sigma."""
    flight = sim.strip(26, 4)
    block = block_of(flight)
    order = np.array([2, 0, 3, 1])
    back = np.argsort(order)
    t = block.ties
    mixed = Block(
        photo_ids=tuple(block.photo_ids[i] for i in order),
        poses=tuple(block.poses[i] for i in order),
        camera_of=block.camera_of[order],
        cameras=block.cameras,
        flights=(replace(block.flights[0], photos=back),),
        ties=replace(
            t, photo=back[t.photo].astype(np.int32),
            photo_ids=tuple(block.photo_ids[i] for i in order),
        ),
    )  # fmt: skip
    first = first_points(flight, block)
    a, b = adjust(block, first), adjust(mixed, first)
    for i in range(4):
        off = a.poses[i].origin_enu - b.poses[back[i]].origin_enu
        assert np.abs(off / np.sqrt(np.diag(a.poses[i].covariance))[:3]).max() < 0.02


def test_the_judge_of_these_tests_sees_an_error() -> None:
    """A flight judged against another's truth is far off."""
    flight = sim.two_photos(27)
    moved_truth = replace(flight.truth, p_cam=flight.truth.p_cam + np.array([0.0, 3.0, 0.0]))
    assert np.abs(judge(replace(flight, truth=moved_truth), block_of(flight)).poses).max() > 5.0
