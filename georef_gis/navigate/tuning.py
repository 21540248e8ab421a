"""What the log itself says of its noise and of how late its fixes are stamped.

Both are found by the likelihood of the innovations of a filter over a stretch of the flight: of
all noises (or delays) the one under which the fixes are least surprising. Vibration and unmodelled
axes make the noise of an airframe ten to a hundred times that of a data sheet, and a filter that
does not know it locks good fixes out.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from georef_gis.errors import NavigationError
from georef_gis.frames import Array
from georef_gis.model.logs import ImuLog
from georef_gis.navigate.alignment import SIGMA_ANY, Alignment, align
from georef_gis.navigate.filter_pass import imu_table
from georef_gis.navigate.first_state import OPEN_GATE
from georef_gis.navigate.gnss_noise import Fixes
from georef_gis.navigate.inertial_solution import likelihood
from georef_gis.navigate.settings import NavigationSettings

# factors on the noise of gyro and accelerometer that are tried first, then neighbours
LADDER = ((1.0, 1.0), (3.0, 3.0), (3.0, 10.0), (10.0, 30.0), (30.0, 100.0), (100.0, 300.0))
STEP = math.sqrt(10.0)
# log-likelihood by which another noise must be better to be preferred
WORTH = 4.0
# factors on the noise of gyro and accelerometer that look like wrong axes
SUSPECT = (90.0, 250.0)
# and with which no covariance of a linear filter is true any more
ABSURD = (250.0, 25.0)
# s; how much of a flight is looked at
STRETCH = 600.0
# s; delays that are tried, and how finely the best is sought
DELAYS = (-0.1, -0.05, 0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5)
FINEST = 0.001
# s; a smaller delay is not worth a correction
LEAST_DELAY = 0.005
# sigmas from zero at which a delay is believed
SURE = 3.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Delay:
    """Delay of the GNSS stamps, s, with its sigma; how much likelier than none (log)."""

    seconds: float
    sigma: float
    gain: float

    @property
    def significant(self) -> bool:
        """Whether it is sure and large enough to be taken out."""
        return abs(self.seconds) > max(LEAST_DELAY, SURE * self.sigma) and self.gain > SURE**2 / 2


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tuned:
    """Settings and fixes as the log itself asks for, and what was found, in words."""

    settings: NavigationSettings
    fixes: Fixes
    delay: Delay | None
    noise_factors: tuple[float, float]
    notes: tuple[str, ...]
    doubts: tuple[str, ...] = ()


def tune(
    imu: ImuLog, fixes: Fixes, settings: NavigationSettings, *, noise: bool, delay: bool
) -> Tuned:
    """Find the noise of the IMU, the delay of the fixes, or both, and apply what is sure."""
    notes: list[str] = []
    found, factors, total = None, (1.0, 1.0), 0.0
    given = settings
    for _ in range(3):
        tuner = Tuner(imu, fixes)
        if tuner.blind:
            return Tuned(
                settings=given, fixes=fixes, delay=None, noise_factors=(1.0, 1.0),
                notes=("the log moves too little to tell its noise or delay",),
            )  # fmt: skip
        if noise:
            factors = tuner.noise(given)
            settings = _scaled(given, factors)
        if not delay:
            break
        step = tuner.delay(settings)
        found = replace(step, seconds=total + step.seconds)
        # a delay that is taken out is taken out to its last millisecond
        if not step.significant and total == 0.0:
            break
        total += step.seconds
        fixes = replace(fixes, time=fixes.time - step.seconds)
        if not step.significant:
            break
    if factors[0] >= ABSURD[0] and factors[1] >= ABSURD[1]:
        raise NavigationError(
            f"{imu.source or 'IMU log'}: agrees with the fixes only with {factors[0]:.0f} (gyro) "
            f"and {factors[1]:.0f} (accelerometer) times the noise that is stated; check its axes, "
            "units and signs, and its clock against that of the fixes"
        )
    if noise and factors != (1.0, 1.0):
        notes.append(f"noise of the IMU: gyro {factors[0]:.3g}, accelerometer {factors[1]:.3g} "
                     "times what is stated")  # fmt: skip
    if total != 0.0 and found is not None:
        found = replace(found, seconds=total)
        notes.append(f"GNSS fixes are stamped {1e3 * total:.0f} +- {1e3 * found.sigma:.0f} ms late")
    return Tuned(
        settings=settings, fixes=fixes, delay=found, noise_factors=factors, notes=tuple(notes),
        doubts=_doubts(factors),
    )  # fmt: skip


def _doubts(factors: tuple[float, float]) -> tuple[str, ...]:
    """What so much noise may be instead."""
    if factors[0] < SUSPECT[0] and factors[1] < SUSPECT[1]:
        return ()
    return (
        f"the IMU is {factors[0]:.3g} (gyro) and {factors[1]:.3g} (accelerometer) times as noisy "
        "as stated: strong vibration or aerobatics, or its axes, units or clock are wrong",
    )


def busiest_stretch(table: Array, fixes: Fixes, aligned: Alignment) -> tuple[float, float]:
    """First and last time of the stretch with the most change of velocity, s."""
    start, end = max(table[0, 0], fixes.time[0]), min(table[-1, 0], fixes.time[-1])
    if end - start <= STRETCH:
        return float(start), float(end)
    moving = np.isfinite(fixes.v).all(axis=1)
    if np.count_nonzero(moving) < 10:
        return aligned.time, min(aligned.time + STRETCH, end)
    t, v = fixes.time[moving], fixes.v[moving]
    change = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(v[:, :2], axis=0), axis=1))])
    starts = np.arange(start, end - STRETCH, STRETCH / 4)
    gained = np.interp(starts + STRETCH, t, change) - np.interp(starts, t, change)
    best = float(starts[int(np.argmax(gained))])
    return best, best + STRETCH


class Tuner:
    """Likelihood of settings over the busiest stretch of a flight."""

    def __init__(self, imu: ImuLog, fixes: Fixes) -> None:
        table = imu_table(imu)
        whole = align(table, fixes)
        self.stretch = busiest_stretch(table, fixes, whole)
        # a window of the stretch, with the attitude at its own start
        inside = (table[:, 0] >= self.stretch[0] - 1.0) & (table[:, 0] <= self.stretch[1] + 1.0)
        self.table = np.ascontiguousarray(table[inside])
        near = (fixes.time >= self.stretch[0]) & (fixes.time <= self.stretch[1])
        self.fixes = _part(fixes, near)
        self.aligned = align(self.table, self.fixes)

    @property
    def blind(self) -> bool:
        """Whether the stretch shows no heading, so that nothing can be learned from it."""
        return self.aligned.sigma_heading >= SIGMA_ANY or len(self.fixes) < 30

    def noise(self, given: NavigationSettings) -> tuple[float, float]:
        """Likeliest factors on the noise given of gyro and accelerometer."""
        given = replace(given, gate=OPEN_GATE)

        def value(factors: tuple[float, float]) -> float:
            settings = _scaled(given, factors)
            return likelihood(self.table, self.fixes, settings, self.aligned, self.stretch)

        return _climb(value, LADDER)

    def delay(self, settings: NavigationSettings) -> Delay:
        """Delay of the fixes against the IMU under settings."""
        settings = replace(settings, gate=OPEN_GATE)

        def value(seconds: float) -> float:
            late = replace(self.fixes, time=self.fixes.time - seconds)
            return likelihood(self.table, late, settings, self.aligned, self.stretch)

        tried = {d: value(d) for d in DELAYS}
        best = max(tried, key=lambda d: tried[d])
        width = 0.025
        while width > FINEST:
            for d in (best - width, best + width):
                tried[d] = value(d)
            best = max(tried, key=lambda d: tried[d])
            width /= 2.0
        return _parabola(tried, best)


def _part(fixes: Fixes, chosen: NDArray[np.bool_]) -> Fixes:
    return replace(
        fixes, time=fixes.time[chosen], p_geo=fixes.p_geo[chosen], R_p=fixes.R_p[chosen],
        v=fixes.v[chosen], R_v=fixes.R_v[chosen],
    )  # fmt: skip


def _scaled(settings: NavigationSettings, factors: tuple[float, float]) -> NavigationSettings:
    imu = settings.imu
    return replace(
        settings,
        imu=replace(
            imu, gyro_walk=imu.gyro_walk * factors[0], accel_walk=imu.accel_walk * factors[1]
        ),
    )


def _climb(
    value: Callable[[tuple[float, float]], float], start: tuple[tuple[float, float], ...]
) -> tuple[float, float]:
    """Best pair of factors: of the ladder, then of neighbours until none is better."""
    tried = {pair: value(pair) for pair in start}
    while True:
        best = max(tried, key=lambda pair: tried[pair])
        around = [
            (best[0] * a, best[1] * b)
            for a, b in ((STEP, 1), (1 / STEP, 1), (1, STEP), (1, 1 / STEP))
        ]
        new = [p for p in around if not any(_same(p, q) for q in tried)]
        new = [p for p in new if 0.2 < p[0] < 500.0 and 0.2 < p[1] < 2000.0]
        if not new:
            return _plainest(tried)
        tried |= {pair: value(pair) for pair in new}


def _plainest(tried: dict[tuple[float, float], float]) -> tuple[float, float]:
    """Of all that are nearly as likely as the best, the nearest to the noise that was stated."""
    top = max(tried.values())
    good = [pair for pair, value in tried.items() if value > top - WORTH]

    def far(factor: float) -> float:
        # of two that are as likely, the one that trusts the IMU less does less harm
        return abs(math.log(factor)) * (1.0 if factor >= 1.0 else 3.0)

    return min(good, key=lambda pair: far(pair[0]) + far(pair[1]))


def _same(a: tuple[float, float], b: tuple[float, float]) -> bool:
    return abs(math.log(a[0] / b[0])) < 0.3 and abs(math.log(a[1] / b[1])) < 0.3


def _parabola(tried: dict[float, float], best: float) -> Delay:
    """Top and width of the likelihood near its best value."""
    near = sorted(d for d in tried if abs(d - best) < 0.06 and math.isfinite(tried[d]))
    gain = tried[best] - tried[0.0]
    if len(near) < 4:
        return Delay(seconds=best, sigma=0.05, gain=gain)
    x = np.array(near)
    y = np.array([tried[d] for d in near])
    # the near ones count: the likelihood is a parabola at its top only
    weight = 1.0 / (0.003 + np.abs(x - best))
    a, b, _ = np.polyfit(x - best, y, 2, w=weight)
    if a >= 0.0:
        return Delay(seconds=best, sigma=0.05, gain=gain)
    top = best + float(np.clip(-b / (2.0 * a), -0.02, 0.02))
    return Delay(seconds=top, sigma=math.sqrt(-0.5 / a), gain=gain)
