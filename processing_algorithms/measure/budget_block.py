"""What an adjustment knew before any pixel, as groups of observations with noise by source."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from georef_gis.frames import Array
from georef_gis.measure.budget.adjusted import Known, known_directly, position_and_angles

if TYPE_CHECKING:
    from georef_gis.orient.adjustment.block import Block
    from georef_gis.orient.adjustment.flight_model import FlightModel

# Of lever arm, boresight, bias and clock, in the order of the adjustment.
_SHARED_SOURCES = ("lever_arm",) * 3 + ("boresight",) * 3 + ("",) * 3 + ("time",)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FlightNoise:
    """Noise of a flight's poses, source -> (6 n, 6 n), and the source of what biases all of them.

    A bias is the datum's over a trajectory, whose own errors hold the receiver's, and the
    receiver's over tags.
    """

    poses: dict[str, Array]
    bias: str


def navigation_noise(flight: FlightModel) -> FlightNoise:
    """Noise of poses by a trajectory."""
    prior, n = flight.prior, len(flight.prior.photos)
    blocks = np.zeros((n, 6, n, 6))
    blocks[np.arange(n), :, np.arange(n), :] = prior.white
    own: Array = blocks.reshape(6 * n, 6 * n)
    noise = position_and_angles(prior.whole_covariance() - own)
    angle = np.tile(np.arange(6) >= 3, n)
    if not np.any(prior.shared_covariance[3:6, 3:6]):
        # a gimbal holds the camera: its angles are those of the tags
        of_tags = own * np.outer(angle, angle)
        noise["attitude"] = noise.get("attitude", 0.0) + of_tags
        own = own - of_tags
    noise["time"] = own
    return FlightNoise(poses=_with_extra(noise, flight), bias="datum")


def tag_noise(flight: FlightModel, *, datum_share: float = 0.0) -> FlightNoise:
    """Noise of poses by tags; `datum_share` of the variance of east and north is the datum's."""
    noise = position_and_angles(flight.prior.whole_covariance(), datum_share=datum_share)
    return FlightNoise(poses=_with_extra(noise, flight), bias="gnss")


def _with_extra(noise: dict[str, Array], flight: FlightModel) -> dict[str, Array]:
    """Noise with what was added to photos that contradict the others."""
    from georef_gis.orient.adjustment.flight_model import FLOOR

    extra = flight.extra + FLOOR**2
    place = np.arange(6) < 3
    for source, mine in (("gnss", place), ("attitude", ~place)):
        noise[source] = noise.get(source, 0.0) + np.diag((extra * mine).ravel())
    return noise


def known_of_block(
    block: Block, flights: Sequence[FlightModel], noises: Sequence[FlightNoise], covariance: Array
) -> list[Known]:
    """All that was known of a block beforehand, as groups.

    Parameters
    ----------
    covariance : shape (N, N)
        Of poses and shared unknowns, as adjusted.
    """
    first = 6 * len(block.photo_ids)
    out: list[Known] = []
    for k, (flight, noise) in enumerate(zip(flights, noises, strict=True)):
        out += _flight_groups(flight, first + block.flight_at(k), noise, covariance)
    return [*out, *_camera_groups(block, covariance), *_shift_groups(block, covariance)]


def _flight_groups(
    flight: FlightModel, first: int, noise: FlightNoise, covariance: Array
) -> list[Known]:
    """What a flight's navigation knew of its poses, and of what they share.

    Parameters
    ----------
    first
        Number of the first of the flight's shared unknowns.
    """
    from georef_gis.orient.adjustment.block import FLIGHT_UNKNOWNS

    prior, n = flight.prior, len(flight.prior.photos)
    shared = first + np.arange(FLIGHT_UNKNOWNS)
    poses = (6 * prior.photos[:, None] + np.arange(6)).ravel()
    _, B = flight.derivatives(np.zeros((n, 6)), np.zeros(3))
    # the weight times the design times C, without the design as a matrix
    moved = covariance[poses].reshape(n, 6, -1) - B @ covariance[shared]
    groups = [Known(gain=flight.times(moved).reshape(6 * n, -1), by_source=noise.poses)]
    free = np.flatnonzero(flight.free)
    if len(free):
        sources = [source or noise.bias for source in _SHARED_SOURCES]
        prior_covariance = prior.shared_covariance[np.ix_(free, free)]
        named = [sources[k] for k in free]
        groups.append(known_directly(covariance, shared[free], prior_covariance, named))
    return groups


def _camera_groups(block: Block, covariance: Array) -> list[Known]:
    """What was known of the cameras."""
    out = []
    for k, prior in enumerate(block.cameras):
        rows = 6 * len(block.photo_ids) + block.camera_at(k) + np.flatnonzero(prior.sigma > 0)
        if len(rows):
            variance = np.diag(prior.sigma[prior.sigma > 0] ** 2)
            out.append(known_directly(covariance, rows, variance, ["calibration"] * len(rows)))
    return out


def _shift_groups(block: Block, covariance: Array) -> list[Known]:
    """What was known of the ground's offset and of the level that control gives."""
    out = []
    for k, (sigma, source) in enumerate(zip(block.sigma_shifts, ("ground", "level"), strict=True)):
        if sigma > 0:
            row = np.array([len(covariance) - 2 + k])
            out.append(known_directly(covariance, row, np.array([[sigma**2]]), [source]))
    return out
