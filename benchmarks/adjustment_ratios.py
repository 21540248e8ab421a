"""A simulated flight adjusted as the tool does it, and its errors against their sigmas."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np

# the flights are those of the tests
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "orient"))

import adjustment_flights as sim
from adjustment_blocks import block_of, first_points, true_shared
from numpy.typing import NDArray

from georef_gis.orient.adjustment.adjust import Adjusted, adjust
from georef_gis.orient.adjustment.block import Block

Array = NDArray[np.float64]


def run(flight: sim.SimFlight, block: Block | None = None) -> tuple[Adjusted, float]:
    """A flight adjusted as the tool does it, and the CPU seconds that took."""
    block = block or block_of(flight)
    first = first_points(flight, block)
    start = time.process_time()
    adjusted = adjust(block, first)
    adjusted.covariances.shared()
    return adjusted, time.process_time() - start


def pose_ratios(flight: sim.SimFlight, adjusted: Adjusted) -> tuple[Array, Array]:
    """Errors of the poses, (n, 6) m and rad, and those over sigma."""
    origin = np.array([p.origin_enu for p in adjusted.poses])
    R = np.array([p.R_enu_from_cam for p in adjusted.poses])
    turned = flight.truth.R_enu_from_cam @ np.swapaxes(R, 1, 2)
    errors = np.hstack([flight.truth.p_cam - origin, sim.rotvec(turned)])
    sigma = np.sqrt([np.diag(p.covariance) for p in adjusted.poses])
    return errors, errors / sigma


def shared_ratios(flight: sim.SimFlight, adjusted: Adjusted) -> Array:
    """Errors over sigma of camera, mount, bias and clock; NaN where one is held."""
    spread = np.sqrt(np.maximum(np.diag(adjusted.covariances.shared()), 0.0))
    off = true_shared(flight) - adjusted.shared
    return np.divide(off, spread, out=np.full_like(off, np.nan), where=spread > 0)


def point_ratios(flight: sim.SimFlight, adjusted: Adjusted) -> Array:
    """Errors over sigma of the tie points that were kept, (k, 3)."""
    name = {(int(i), *map(float, uv)): int(j)
            for i, uv, j in zip(flight.photo, flight.uv, flight.point, strict=True)}  # fmt: skip
    ties = adjusted.block.ties
    true = np.full((ties.n_points, 3), np.nan)
    for i, uv, j in zip(ties.photo, ties.uv, ties.point, strict=True):
        true[j] = flight.points[name[int(i), float(uv[0]), float(uv[1])]]
    sigma = np.sqrt(np.einsum("kii->ki", adjusted.points.covariance))
    return np.asarray((true - adjusted.points.p_enu) / sigma)


def slashed(values: Array, digits: int = 2) -> str:
    """Numbers with slashes between."""
    return "/".join(f"{v:.{digits}f}" for v in values)
