"""Flights over a heap of known volume: adjusted, its surface measured, and held against the truth.

Every source of error is redrawn for each flight, as in `coverage_cases`; the ground is the same for
two flights of one `site`, so that their surfaces can be compared.
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
import shapely
from numpy.typing import ArrayLike

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "orient"))

import flight_making
from adjustment_blocks import block_of, control_input, first_points
from adjustment_flights import SimFlight, gps_only, oriented_photos
from flight_truth import Relief

from georef_gis.frames import Array
from georef_gis.geodesy import MapFrame, Origin, utm_crs
from georef_gis.measure.scene import Scene
from georef_gis.measure.surface.common_errors import common_errors
from georef_gis.measure.surface.points import PointField
from georef_gis.model.ground_errors import GroundErrors
from georef_gis.model.joint_errors import CameraErrors, JointErrors, PoseSource
from georef_gis.model.photo_stack import PhotoStack
from georef_gis.model.pose_errors import DenseErrors
from georef_gis.model.terrain import FlatTerrain
from georef_gis.orient.adjustment.adjust import Adjusted, adjust
from georef_gis.orient.adjustment.distances import distance_sigmas

ORIGIN = Origin(lat=math.radians(39.0975), lon=math.radians(-80.467), height_ellipsoidal=277.6)
# m: a cone, and the area that is drawn about it
MIDDLE, RADIUS, HEIGHT = np.array([12.0, -9.0]), 18.0, 6.0
AREA = shapely.Point(*MIDDLE).buffer(23.0, quad_segs=64)
VOLUME = math.pi * RADIUS**2 * HEIGHT / 3.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Heaped(Relief):
    """Slope and waves with a cone on top; `share` of its height."""

    share: float = 1.0

    def z_at(self, xy: ArrayLike) -> Array:
        """Height of the ground, m in enu; (..., 2) -> (...)."""
        xy = np.asarray(xy, dtype=np.float64)
        off = np.hypot(*np.moveaxis(xy - MIDDLE, -1, 0))
        heap = self.share * HEIGHT * np.maximum(1.0 - off / RADIUS, 0.0)
        return np.asarray(xy @ self.slope + np.sin(xy @ self.waves.T + self.phases)
                          @ self.amplitudes + heap)  # fmt: skip


def flown(
    seed: int, *, site: int | None = None, share: float = 1.0, relief: float = 1.0,
    control: int = 0,
) -> SimFlight:  # fmt: skip
    """Flight of 15 photos over the ground of a site, by tags, perhaps with control points.

    Parameters
    ----------
    site
        Seed of the ground; without one that of the flight.
    """
    drawn = flight_making._relief
    ground_seed = seed if site is None else site

    def heaped(_: np.random.Generator, size: float) -> Relief:
        plain = drawn(np.random.default_rng([7, ground_seed]), size)
        values = {name: getattr(plain, name) for name in ("slope", "amplitudes", "waves", "phases")}
        return Heaped(**values, share=share)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(flight_making, "_relief", heaped)
        return gps_only(seed, 3, 5, relief=relief, obs_per_photo=1200.0, control=control)


def surface_of(flight: SimFlight) -> PointField:
    """Surface of the adjusted points, with what the adjustment says of the block."""
    changes = {}
    if len(flight.control.p):
        changes = {"control": control_input((flight.control, True)), "sigma_level": 1.0}
    block = block_of(flight, **changes)
    adjusted = adjust(block, first_points(flight, block))
    distances = distance_sigmas(adjusted.points, adjusted.covariances)
    longest = max(distances, key=lambda one: one.length_m)
    return PointField.of(
        adjusted.points, scale=longest.sigma_m / longest.length_m,
        common=common_errors(
            scene_of(flight, adjusted), np.arange(flight.n_photos), adjusted.points.p_enu
        ),
    )  # fmt: skip


def scene_of(flight: SimFlight, adjusted: Adjusted) -> Scene:
    """Photos as adjusted, with the joint covariance that the adjustment keeps."""
    photos = [
        replace(p, camera=adjusted.cameras[0], pose=pose)
        for p, pose in zip(oriented_photos(flight), adjusted.poses, strict=True)
    ]
    stack, n = PhotoStack.of(photos), len(photos)
    full = adjusted.covariances.inverse()
    # all heights rise with the level that control gives
    rise = np.zeros((len(full), len(full)))
    if len(flight.control.p):
        rise[2 : 6 * n : 6, -1] = 1.0
    full = (np.eye(len(full)) + rise) @ full @ (np.eye(len(full)) + rise).T
    cameras = CameraErrors(
        ids=("sim",), covariance=full[6 * n : 6 * n + 11, 6 * n : 6 * n + 11],
        sensor_of=np.zeros(n, dtype=np.int64), turns=np.zeros(n, dtype=np.int64),
        with_poses=full[: 6 * n, 6 * n : 6 * n + 11].reshape(n, 6, 11),
    )  # fmt: skip
    source = PoseSource(photos=np.arange(n), errors=DenseErrors(matrix=full[: 6 * n, : 6 * n]))
    flat = FlatTerrain(origin=ORIGIN, height_ellipsoidal=277.6)
    return Scene(
        frame=MapFrame(ORIGIN, utm_crs(ORIGIN.lat, ORIGIN.lon)), terrain=flat,
        errors=JointErrors(stack, [source], cameras), ground=GroundErrors.of(flat),
    )  # fmt: skip
