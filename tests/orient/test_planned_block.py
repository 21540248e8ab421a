"""What a flight plan promises is what simulated flights of that plan come to."""

from __future__ import annotations

import math
import os

import adjustment_flights as sim
import numpy as np
import pytest
from adjustment_blocks import judge

from georef_gis.measure.budget.forecast import Sensors
from georef_gis.measure.preflight.layout import Layout, Plan, crossing, layout_of, plan_area
from georef_gis.model.camera import Camera
from processing_algorithms.plan.plan_block import PER_PHOTO, promise

# 5 flights in the daily tests; 40 when asked
FLIGHTS = int(os.environ.get("GEOREF_FLIGHTS", "5"))
# the errors of one flight hang together: the rms of 5 scatters by a third of itself
LOW, HIGH = (0.7, 1.4) if FLIGHTS >= 40 else (0.3, 2.1)
CAMERA = Camera(
    id="c", width=4000, height=3000, fx=2500.0, fy=2500.0, cx=1999.5, cy=1499.5, k1=-0.03,
    k2=0.01, k3=-0.002, p1=5e-4, p2=-3e-4, sigma_f=15.0, sigma_c=8.0,
)  # fmt: skip
AREA = np.array([[0.0, 0.0], [220.0, 0.0], [220.0, 200.0], [0.0, 200.0]])
TAGS = Sensors(
    gnss=2.2, gnss_up=3.0, roll_pitch=math.radians(1.5), yaw=math.radians(3.0),
    boresight=math.radians(1.0), lever_arm=0.05, time=0.01, focal=15.0, centre=8.0,
)  # fmt: skip
RTK = Sensors(
    gnss=0.02, gnss_up=0.03, roll_pitch=math.radians(0.3), yaw=math.radians(0.6),
    boresight=math.radians(1.0), lever_arm=0.02, time=0.002, focal=15.0, centre=8.0,
)  # fmt: skip


def plan_of(*, crossed: bool = False) -> Plan:
    layout = layout_of(CAMERA, 90.0, 15.0, overlap=0.75, sidelap=0.6)
    lines, layouts = plan_area(AREA, layout), [layout]
    if crossed:
        second = Layout(**{**_fields(layout), "height": 120.0})
        lines = (*lines, crossing(AREA, second, lines[0].headings[0], first=len(lines) + 1))
        layouts.append(second)
    return Plan(lines=lines, layouts=tuple(layouts))


def _fields(layout: Layout) -> dict[str, float]:
    return {name: getattr(layout, name) for name in Layout.__slots__}


def flown(plan: Plan, sensors: Sensors, seed: int) -> sim.SimFlight:
    """The plan flown, every error drawn by the shares that errors of tags have."""
    s, axes = sensors, np.ones(3)
    sigma = np.array([s.gnss, s.gnss, s.gnss_up, s.roll_pitch, s.roll_pitch, s.yaw])
    own = np.array([0.15, 0.15, 0.15, 0.05, 0.05, 0.1])
    slow = np.array([0.55, 0.55, 0.55, 0.65, 0.65, 0.7])
    navigation = sim.NavigationModel(
        white=np.sqrt(own) * sigma, slow=np.sqrt(slow) * sigma,
        tau=np.array([100.0] * 3 + [15.0, 15.0, 40.0]),
    )  # fmt: skip
    shared = sim.Shared(
        boresight=s.boresight * axes, lever=s.lever_arm * axes, bias=math.sqrt(0.3) * sigma[:3],
        clock=s.time,
    )  # fmt: skip
    middle = np.vstack([line.photos for line in plan.lines]).mean(axis=0)
    lines = []
    for line in plan.lines:
        step = float(np.hypot(*(line.photos[1] - line.photos[0])))
        start = line.photos[0] - middle
        lines.append(
            sim.Line(
                start=(float(start[0]), float(start[1])), course=float(line.headings[0]),
                height=line.height, speed=15.0, spacing=step, n=len(line.photos),
            )
        )  # fmt: skip
    conditions = sim.Conditions(
        principal_off=(0.0, 0.0), sigma_distortion=(0.01, 0.01, 0.01, 3e-4, 3e-4),
        sigma_affinity=2e-4 * CAMERA.fx, navigation=navigation, sigmas=shared, lever=(0, 0, 0),
        tilt_deg=2.0, rate_deg_s=1.0, relief=2.0, obs_per_photo=PER_PHOTO, found=0.8, noise_px=0.5,
    )  # fmt: skip
    return sim.fly(seed, lines, conditions)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sensors", "crossed"), [(TAGS, False), (RTK, False), (RTK, True)],
    ids=["tags", "RTK", "RTK, crossed at two heights"],
)  # fmt: skip
def test_adjusted_points_are_as_good_as_promised(sensors: Sensors, crossed: bool) -> None:
    plan = plan_of(crossed=crossed)
    found = promise(plan, CAMERA, sensors)
    assert found is not None
    ratios, astray = [], 0
    for seed in range(500, 500 + FLIGHTS):
        flight = flown(plan, sensors, seed)
        judged = judge(flight)
        if not judged.solution.converged:
            # by tags alone a search may run astray; the program begins it from matched headings
            astray += 1
            continue
        n = len(flight.points)
        sigma = np.sqrt(np.einsum("kii->ki", judged.covariances.points()[:n]))
        rays = np.bincount(flight.point, minlength=n)
        # the promise is the usual point's: those at the rim are worse
        size = np.linalg.norm(sigma, axis=1)
        usual = (rays >= 3) & (size <= 1.5 * np.nanmedian(size[rays >= 3]))
        off = (judged.points * sigma)[usual]
        ratios.append(np.sqrt(np.mean(off**2, axis=0)) / [found.east, found.north, found.up])
    rms = np.sqrt(np.mean(np.square(ratios), axis=0))
    assert astray <= 0.1 * FLIGHTS
    assert np.all((rms > LOW) & (rms < HIGH)), rms


@pytest.mark.slow
def test_a_second_height_tells_the_focal_length() -> None:
    """Level photos of one height and RTK: heights lie off by what the focal length does."""
    one, two = (promise(plan_of(crossed=cross), CAMERA, RTK, tilt=0.0) for cross in (False, True))
    assert one is not None
    assert two is not None
    assert two.up < 0.5 * one.up


@pytest.mark.slow
def test_control_brings_what_the_receiver_does_not() -> None:
    without, with_five = (promise(plan_of(), CAMERA, TAGS, control=n) for n in (0, 5))
    assert without is not None
    assert with_five is not None
    assert without.horizontal > 1.0
    assert with_five.horizontal < 0.1
    assert with_five.control == 5
