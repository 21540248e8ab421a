"""Volumes and surfaces of simulated flights: do their sigmas tell how far they are off?

Every source of error is redrawn for each flight: navigation, mount, clock, camera, matches and
control.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pytest
from surface_flights import AREA, MIDDLE, ORIGIN, VOLUME, flown, surface_of

from georef_gis.frames import Array
from georef_gis.measure.surface.base import GivenHeight, LowestLevel, OtherSurface, RimPlane
from georef_gis.measure.surface.field import GroundField, sigma_at
from georef_gis.measure.surface.integral import cells_of
from georef_gis.measure.surface.points import PointField
from georef_gis.measure.surface.volume import volume

pytestmark = pytest.mark.slow
# 4 flights in the daily tests; 40 when asked
FLIGHTS = int(os.environ.get("GEOREF_FLIGHTS", "4"))
# one volume a flight: the rms of 4 scatters by a third of itself
LOW, HIGH = (0.7, 1.4) if FLIGHTS >= 40 else (0.3, 2.2)
# m above the ellipsoid: below all of the ground
LEVEL = GivenHeight(origin=ORIGIN, height_ellipsoidal=270.0)
# m: grass and stones, which no surface of a formula has
ROUGH = 0.1


@dataclass(frozen=True)
class Truth:
    """The ground of a flight as a surface."""

    relief: object
    name: str = "truth"
    detail: float = 0.5

    def z_at(self, xy: Array) -> Array:
        return np.asarray(self.relief.z_at(xy))  # type: ignore[attr-defined]


def off_bases(surface: PointField, truth: Truth) -> dict[str, float]:
    """Error over sigma of the volumes over each base."""
    cells = cells_of(AREA, detail=0.5)
    whole = float(truth.z_at(cells.xy) @ cells.area)
    lowest = LowestLevel.of(truth, AREA).z * AREA.area  # type: ignore[arg-type]
    level = float(LEVEL.z_at(cells.xy) @ cells.area)
    out = {}
    for name, true, make in (
        ("rim", VOLUME, lambda one: RimPlane.of(one, AREA)),
        ("lowest", whole - lowest, lambda one: LowestLevel.of(one, AREA)),
        ("height", whole - level, lambda one: LEVEL),
    ):
        found = volume(surface, AREA, make)
        out[name] = (found.net - true) / found.sigma_net
    return out


def off_surface(surface: PointField, truth: Truth, seed: int) -> dict[str, float]:
    """Error over sigma of heights, and of height differences of places 10 m apart and more."""
    rng = np.random.default_rng(seed)
    at = MIDDLE + rng.uniform(-60.0, 60.0, (400, 2))
    off = surface.z_at(at) - truth.z_at(at) - ROUGH * rng.standard_normal(len(at))
    some, others = np.arange(200), np.arange(200, 400)
    far = np.hypot(*(at[some] - at[others]).T) > 10.0
    local = surface.local(at) ** 2
    common = np.array([
        surface.common.sigma_of_rise(at[i : i + 1], at[j])[0]
        for i, j in zip(some, others, strict=True)
    ])  # fmt: skip
    rise = (off[some] - off[others]) / np.sqrt(local[some] + local[others] + common**2)
    return {
        "place": float(np.sqrt(np.nanmean((off / sigma_at(surface, at)) ** 2))),
        "rise": float(np.sqrt(np.nanmean(rise[far] ** 2))),
    }


def rms(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


@pytest.mark.parametrize("control", [0, 5], ids=["tags alone", "five control points"])
def test_errors_of_volumes_and_surfaces_agree_with_their_sigmas(control: int) -> None:
    found: list[dict[str, float]] = []
    for seed in range(FLIGHTS):
        flight = flown(seed, control=control)
        surface, truth = surface_of(flight), Truth(flight.relief)
        found.append(off_bases(surface, truth) | off_surface(surface, truth, seed))
    ratios = {name: rms([one[name] for one in found]) for name in found[0]}
    assert all(LOW < ratio < HIGH for ratio in ratios.values()), ratios


def test_cut_between_two_dates_agrees_with_its_sigma() -> None:
    """Half of the heap is taken away; each date has a flight and control points of its own."""
    ratios = []
    for seed in range(FLIGHTS):
        before, after = (
            surface_of(flown(1000 * k + seed, site=seed, share=share, control=5))
            for k, share in ((0, 1.0), (1, 0.5))
        )
        found = volume(after, AREA, lambda one, before=before: OtherSurface(field=before))
        ratios.append((found.net + VOLUME / 2.0) / found.sigma_net)
        # grass and errors make some of both where nothing changed
        assert found.above < 4.0 * found.sigma_above
    assert LOW < rms(ratios) < HIGH, ratios


def test_a_tilt_of_the_block_is_in_the_sigma_of_a_level_and_in_none_of_a_plane() -> None:
    """By tags the ends of a block are metres off each other, and the lowest rim with them."""
    surface = surface_of(flown(0))
    tilt = surface.common.sigma_of_rise(MIDDLE[None] + [0.0, 23.0], MIDDLE - [0.0, 23.0])
    assert 0.1 < float(tilt[0]) < 2.0
    level = volume(surface, AREA, lambda one: LowestLevel.of(one, AREA)).parts["block"]
    plane = volume(surface, AREA, lambda one: RimPlane.of(one, AREA)).parts["block"]
    # m3: of half of that over 1 660 m2, more or less
    assert 0.2 * float(tilt[0]) * AREA.area < level < 1.5 * float(tilt[0]) * AREA.area
    assert plane < 0.01 * level


def test_a_ground_without_a_block_is_shifted_as_a_whole() -> None:
    from georef_gis.model.terrain import FlatTerrain

    flat = FlatTerrain(origin=ORIGIN, height_ellipsoidal=277.6, sigma=2.0)
    field = GroundField.of(flat, "flat", level=1.0)
    # half of the variance of a ground that nobody measured is shared
    assert field.common.sigma == pytest.approx(np.sqrt(2.0 + 1.0))
    assert field.common.sigma_of_rise(np.array([[50.0, 0.0]]), np.zeros(2)) == pytest.approx([0.0])
