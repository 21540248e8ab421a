"""What the 9-state filter starts from: its tuning, usable samples and fixes, the first state."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from georef_gis.ellipsoid import meridian_radius, prime_vertical_radius
from georef_gis.errors import InputError, NavigationError
from georef_gis.frames import Array
from georef_gis.model.logs import FIX_2D, GnssLog, ImuLog, IntArray
from georef_gis.navigate.resample import ellipsoidal_heights


@dataclass(frozen=True, slots=True, kw_only=True)
class Ekf9Settings:
    """Tuning of the filter; the defaults are the best of those tried on simulated surveys.

    Parameters
    ----------
    noise
        "states": Q is diagonal on the states, as (29) has it. "sensors": the white noise of the
        gyros is mapped to the Euler angles at every step.
    attitude_noise, velocity_noise, position_noise
        rad, m/s and m per sqrt(s). For "sensors": angular and velocity random walk.
    position_sigma, velocity_sigma
        North, east, down, m and m/s, of fixes that state no covariance.
    start_sigma_rpy
        rad, of the first attitude; that of yaw covers the crab angle.
    gravity
        m/s2; None: normal gravity at the first fix.
    min_speed
        m/s from which the course is taken as first heading.
    max_gap
        s without IMU samples that the filter still bridges.
    smooth
        Whether to run the Rauch-Tung-Striebel smoother, at nodes `node_step` s apart.
    """

    noise: Literal["states", "sensors"] = "states"
    attitude_noise: float = math.radians(0.1)
    velocity_noise: float = 0.03
    position_noise: float = 0.0
    position_sigma: tuple[float, float, float] = (2.5, 2.5, 4.0)
    velocity_sigma: tuple[float, float, float] = (0.2, 0.2, 0.3)
    start_sigma_rpy: tuple[float, float, float] = (
        math.radians(5.0),
        math.radians(5.0),
        math.radians(15.0),
    )
    gravity: float | None = None
    min_speed: float = 5.0
    max_gap: float = 0.5
    smooth: bool = True
    node_step: float = 0.1


class Plane(NamedTuple):
    """The level plane of the filter: straight lines of latitude and longitude around a fix.

    Unlike a tangent plane, its down stays the local one, in which receivers state velocities.
    """

    lat: float
    lon: float
    height: float
    # m per rad
    north: float
    east: float

    @classmethod
    def at(cls, lat: float, lon: float, height: float) -> Plane:
        """Plane around a place, rad and m."""
        north = float(meridian_radius(lat)) + height
        east = (float(prime_vertical_radius(lat)) + height) * math.cos(lat)
        return cls(lat, lon, height, north, east)

    def ned(self, lat: Array, lon: Array, height: Array) -> Array:
        """North, east, down m; shape (n, 3)."""
        around = np.mod(lon - self.lon + np.pi, 2.0 * np.pi) - np.pi
        return np.stack(
            [(lat - self.lat) * self.north, around * self.east, self.height - height], axis=-1
        )

    def geo(self, ned: Array) -> tuple[Array, Array, Array]:
        """Lat, lon rad and ellipsoidal height m of north, east, down m; shape (n, 3)."""
        lon = self.lon + ned[:, 1] / self.east
        lon = np.mod(lon + np.pi, 2.0 * np.pi) - np.pi
        return self.lat + ned[:, 0] / self.north, lon, self.height - ned[:, 2]


class Fixes(NamedTuple):
    """Fixes in use: s, rad, rad, ellipsoidal m, and v_ned (n, 3) m/s or NaN."""

    time: Array
    lat: Array
    lon: Array
    height: Array
    v_ned: Array
    # (n, 6, 6), and the number of values that are there
    R: Array
    dof: IntArray

    def since(self, first: int) -> Fixes:
        """Those from an index on."""
        return Fixes(
            self.time[first:], self.lat[first:], self.lon[first:], self.height[first:],
            self.v_ned[first:], self.R[first:], self.dof[first:],
        )  # fmt: skip


def usable_samples(imu: ImuLog, doubts: list[str]) -> tuple[Array, Array]:
    """Times and inputs (n, 6) that can be used, in order."""
    u = np.hstack([imu.accel, imu.gyro])
    keep = np.isfinite(imu.time) & np.all(np.isfinite(u), axis=1)
    ahead = np.maximum.accumulate(np.where(keep, imu.time, -np.inf))
    keep[1:] &= imu.time[1:] > ahead[:-1]
    if keep.sum() < 2:
        raise InputError(
            f"holds {keep.sum()} usable samples of {len(imu)}; give a log of a flight",
            source=imu.source, field="imu",
        )  # fmt: skip
    if not np.all(keep):
        doubts.append(
            f"{np.sum(~keep)} of {len(imu)} IMU samples are left out: not finite or out of order"
        )
    time, u = imu.time[keep], np.ascontiguousarray(u[keep])
    force = np.median(u[:, :3], axis=0)
    size = float(np.median(np.linalg.norm(u[:, :3], axis=1)))
    cure = ""
    if 0.7 < size < 1.4:
        cure = "it looks like g: multiply by 9.80665"
    elif not 5.0 < size < 20.0:
        cure = "at rest it is 9.8; check the unit"
    elif force[2] > 0.5 * size:
        cure = "z points up: turn the axes to forward, right, down"
    elif np.median(np.linalg.norm(u[:, 3:], axis=1)) > math.tau:
        raise InputError("median rate exceeds 360 deg/s; give rad/s", source=imu.source,
                         field="gyro")  # fmt: skip
    if cure:
        raise InputError(
            f"median specific force is {size:.2f} m/s2 with z {force[2]:+.2f} m/s2; {cure}",
            source=imu.source, field="accel",
        )  # fmt: skip
    return time, u


def usable_fixes(
    gnss: GnssLog, settings: Ekf9Settings, span: tuple[float, float], doubts: list[str]
) -> Fixes:
    """Fixes within the IMU log that can be used."""
    height = ellipsoidal_heights(gnss)
    place = np.stack([gnss.lat, gnss.lon, height], axis=-1)
    good = np.all(np.isfinite(place), axis=1) & (gnss.fix > FIX_2D) & np.isfinite(gnss.time)
    ahead = np.maximum.accumulate(np.where(good, gnss.time, -np.inf))
    good[1:] &= gnss.time[1:] > ahead[:-1]
    inside = good & (gnss.time >= span[0]) & (gnss.time <= span[1])
    if not np.any(good):
        raise NavigationError(f"{gnss.source or 'gnss'}: holds no fix with a height")
    if not np.any(inside):
        found = gnss.time[good]
        raise NavigationError(
            f"{gnss.source or 'gnss'}: fixes from {found[0]:.1f} to {found[-1]:.1f} s do not "
            f"overlap the IMU log from {span[0]:.1f} to {span[1]:.1f} s; give logs of one flight"
        )
    if not np.all(inside):
        doubts.append(f"{np.sum(~inside)} of {len(gnss)} fixes are left out")
    v = gnss.v_ned[inside]
    moving = np.all(np.isfinite(v), axis=1)
    R = np.zeros((len(v), 6, 6))
    R[:, :3, :3] = _or_default(gnss.covariance_ned[inside], settings.position_sigma)
    R[:, 3:, 3:] = _or_default(gnss.covariance_v_ned[inside], settings.velocity_sigma)
    dof = np.where(moving, 6, 3).astype(np.int64)
    p = place[inside]
    return Fixes(gnss.time[inside], p[:, 0], p[:, 1], p[:, 2], v, R, dof)


def _or_default(covariance: Array, sigma: tuple[float, float, float]) -> Array:
    known = np.all(np.isfinite(covariance), axis=(1, 2))
    known &= np.all(np.diagonal(covariance, axis1=1, axis2=2) > 0.0, axis=1)
    return np.where(known[:, None, None], covariance, np.diag(np.square(sigma)))


def first_moving(fixes: Fixes, settings: Ekf9Settings, source: str) -> int:
    """Index of the first fix whose course can be taken as heading."""
    speed = np.hypot(fixes.v_ned[:, 0], fixes.v_ned[:, 1])
    fast = np.flatnonzero(speed > settings.min_speed)
    if len(fast):
        return int(fast[0])
    if not np.any(fixes.dof == 6):
        reason = "no fix states a velocity, which the 9-state filter needs"
    else:
        reason = f"never faster than {settings.min_speed:g} m/s (largest {np.nanmax(speed):.1f})"
    raise NavigationError(f"{source or 'gnss'}: {reason}; use the 15-state filter")


def first_state(
    time: Array, u: Array, fixes: Fixes, given: tuple[Ekf9Settings, float]
) -> tuple[Array, Array]:
    """First state (position and velocity left zero) and covariance.

    Roll and pitch turn the measured specific force into the one that the fixes' acceleration asks
    for; both are averaged over 2 s, and the course is the heading.
    """
    settings, gravity = given
    t = fixes.time[0]
    near = (fixes.time <= t + 2.0) & (fixes.dof == 6)
    course = math.atan2(fixes.v_ned[0, 1], fixes.v_ned[0, 0])
    slope = np.zeros(3)
    if near.sum() >= 2:
        centred = fixes.time[near] - fixes.time[near].mean()
        slope = centred @ fixes.v_ned[near] / (centred @ centred)
    until = fixes.time[near][-1] if near.sum() >= 2 else t + 0.2
    window = (time >= t) & (time <= until)
    if not np.any(window):
        window = np.arange(len(time)) == np.argmin(np.abs(time - t))
    f = u[window, :3].mean(axis=0)
    wanted = slope - np.array([0.0, 0.0, gravity])
    c, s = math.cos(course), math.sin(course)
    ahead, right, down = c * wanted[0] + s * wanted[1], c * wanted[1] - s * wanted[0], wanted[2]
    side = math.hypot(f[1], f[2])
    roll = math.asin(max(-1.0, min(1.0, right / side))) - math.atan2(f[1], -f[2])
    f_z = f[1] * math.sin(roll) + f[2] * math.cos(roll)
    pitch = math.atan2(f_z * ahead - f[0] * down, f[0] * ahead + f_z * down)
    P = np.zeros((9, 9))
    P[:6, :6] = fixes.R[0]
    P[range(6, 9), range(6, 9)] = np.square(settings.start_sigma_rpy)
    return np.array([0.0] * 6 + [roll, pitch, course]), P
