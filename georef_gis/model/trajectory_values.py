"""What is read off the rows of a trajectory: sigmas of angles, places in metres."""

from __future__ import annotations

import numpy as np

from georef_gis.ellipsoid import meridian_radius, prime_vertical_radius
from georef_gis.frames import Array, sigma_rpy_from_covariance_theta_ned
from georef_gis.model.logs import TrajectoryLog


def sigma_rpy_of(log: TrajectoryLog) -> Array:
    """Sigmas of roll, pitch and yaw, rad; shape (n, 3), NaN where unknown or pitch is vertical."""
    return sigma_rpy_from_covariance_theta_ned(log.rpy, log.covariance[:, 3:, 3:])


def sigma_position_of(log: TrajectoryLog) -> Array:
    """Sigmas of the place north, east, down, m; shape (n, 3), NaN where unknown."""
    return np.asarray(np.sqrt(np.diagonal(log.covariance, axis1=1, axis2=2)[:, :3]))


def metres_per_radian(lat: Array, height: Array) -> tuple[Array, Array]:
    """Length of a radian of latitude and of longitude at a place, m."""
    north = meridian_radius(lat) + height
    return north, np.asarray((prime_vertical_radius(lat) + height) * np.cos(lat))


def local_places(log: TrajectoryLog, base: TrajectoryLog) -> tuple[Array, Array, Array]:
    """North, east from the first known place of `base`, and ellipsoidal height, m."""
    known = np.flatnonzero(np.isfinite(base.lat))
    if not len(known):
        return log.lat, log.lon, log.height
    lat, lon = base.lat[known[0]], base.lon[known[0]]
    north, east = metres_per_radian(base.lat[known[:1]], base.height[known[:1]])
    around = np.mod(log.lon - lon + np.pi, 2.0 * np.pi) - np.pi
    return (log.lat - lat) * north, around * east, log.height


def places_apart(log: TrajectoryLog, other: TrajectoryLog) -> Array:
    """Place of a log less that of another at the same rows, north, east, down, m; shape (n, 3)."""
    north, east = metres_per_radian(other.lat, other.height)
    around = np.mod(log.lon - other.lon + np.pi, 2.0 * np.pi) - np.pi
    return np.stack(
        [(log.lat - other.lat) * north, around * east, other.height - log.height], axis=-1
    )
