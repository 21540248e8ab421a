"""The attitude that the filter starts from, refined on the first stretch of the flight."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from georef_gis.frames import Array, exp_so3
from georef_gis.navigate.alignment import (
    BY_FORCE,
    FARTHEST_BACK,
    Alignment,
    carried_back,
)
from georef_gis.navigate.dense import unpack
from georef_gis.navigate.filter_pass import (
    Layout,
    filter_pass,
    plan_nodes,
    prior_state,
)
from georef_gis.navigate.gnss_noise import Fixes
from georef_gis.navigate.settings import NavigationSettings
from georef_gis.navigate.smoother import run_smoother

# Attitude, gyro bias, its sigma and that of the heading at the start of a stretch
_First = tuple[Array, Array, float, float]
# share of its prior sigma that a heading must come down to, to be more than the prior again
WEAK_HEADING = 0.3
# s; how much of the log the first attitude is refined on
FIRST_STRETCH = 60.0
# rad, one sigma at which a heading that nothing tells is held, see `smooth_flight`
HELD_HEADING = math.radians(2.0)
# rad, one sigma of a first heading: wide enough to count the first stretch only once
START_HEADING = math.radians(5.0)
# s of waiting before the aligned moment that need no bias of their own
SHORT_WAIT = 5.0
# sigmas of a bias found on the first stretch that make its prior: that counts the stretch once
BIAS_WIDTH = 3.0
LEAST_BIAS = math.radians(20.0) / 3600.0
# times the first stretch is smoothed at most
ROUNDS = 3
# rad, one sigma of a level that a first stretch has found
START_LEVEL = math.radians(1.5)
# a probability that refuses only what is absurd, until the filter has settled
OPEN_GATE = 1e-12


def refined_start(
    table: Array, fixes: Fixes, layout: Layout, settings: NavigationSettings, aligned: Alignment
) -> Alignment:
    """Attitude at the start of the navigated part, as good as the first stretch allows.

    The stretch behind the alignment is smoothed, what it tells is carried back to the start by the
    gyro, and the stretch from there is smoothed until its first heading stays: minutes of waiting
    on the ground and the blow of a launch would else start the filter tens of degrees off.
    """
    settings = replace(settings, gate=OPEN_GATE)
    begin = max(float(table[0, 0]), float(fixes.time[0]), aligned.time - FARTHEST_BACK)
    end = aligned.time + FIRST_STRETCH
    held = aligned.sigma_heading <= HELD_HEADING and aligned.method != BY_FORCE
    wide = aligned.sigma_heading if held else max(aligned.sigma_heading, START_HEADING)
    start = max(aligned.time, float(fixes.time[0]))
    found = _first_state(table, fixes, layout, settings, aligned, (start, end))
    if found is None:
        return aligned
    if found[3] > WEAK_HEADING * wide:
        # what little the stretch says of the heading would be counted twice
        turn = _heading_between(found[0], aligned.R_ned_from_body)
        found = (np.asarray(exp_so3([0.0, 0.0, turn]) @ found[0]), *found[1:])
    # a narrow level: while it settles, a wide one would make a heading be seen that is not
    better = replace(
        aligned, time=start, R_ned_from_body=found[0], sigma_heading=wide,
        sigma_level=START_LEVEL,
    )  # fmt: skip
    if begin >= start - SHORT_WAIT:
        return better
    better = _with_bias(better, found, carried_back(table, better, found[1], begin), begin)
    for _ in range(ROUNDS):
        found = _first_state(table, fixes, layout, settings, better, (begin, end))
        if found is None:
            break
        turn = _heading_between(better.R_ned_from_body, found[0])
        better = _with_bias(better, found, found[0], begin)
        if abs(turn) < START_HEADING / 3.0:
            break
    return better


def _with_bias(aligned: Alignment, found: _First, R: Array, time: float) -> Alignment:
    """Alignment at another time with the gyro's bias as found, its sigma wide.

    Over minutes of waiting the sigma of an unknown bias would make the heading anything, and the
    first fixes of the flight would be linearised about a heading that is none.
    """
    return replace(
        aligned, time=time, R_ned_from_body=R, gyro_bias=found[1],
        sigma_gyro_bias=max(BIAS_WIDTH * found[2], LEAST_BIAS),
    )  # fmt: skip


def _first_state(
    table: Array, fixes: Fixes, layout: Layout, settings: NavigationSettings,
    aligned: Alignment, stretch: tuple[float, float],
) -> _First | None:  # fmt: skip
    """Smoothed state at the start of a stretch; None where it is too short."""
    nodes, fix = plan_nodes(table, fixes, stretch[0], settings.node_gap)
    keep = nodes <= stretch[1]
    m, size = int(np.count_nonzero(keep)), len(layout.prior) - 9
    if m < 3:
        return None
    prior = prior_state(layout, fixes, stretch[0], aligned, aligned.R_ned_from_body)
    passed, _, jump, _ = filter_pass(
        table, fixes, layout, settings, prior, (nodes[keep], fix[keep]), ()
    )
    nav, x, packed = np.empty((m, 15)), np.empty((m, size)), np.empty_like(passed[4])
    run_smoother(nodes[keep], jump, np.stack([layout.density, layout.tau]), passed, nav, x, packed)
    P = unpack(packed[0], 9 + size)
    sigma = math.sqrt(float(np.max(np.diag(P)[9:12])))
    return nav[0, 6:].reshape(3, 3).copy(), x[0, :3].copy(), sigma, math.sqrt(float(P[8, 8]))


def _heading_between(R_one: Array, R_other: Array) -> float:
    D = R_other @ R_one.T
    return math.atan2(D[1, 0], D[0, 0])
