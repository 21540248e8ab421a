"""Simulated flights through the steps of `navigate` and `orient_navigation`, against their truth.

The logs do not pass through files here, so that many flights take seconds; all else is what the
tools call. The errors are told in the simulator's own frames.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from navigation_flights import logs_of, settings_of
from numpy.typing import NDArray

from georef_gis.ellipsoid import Origin
from georef_gis.frames import Array, R_ned_from_body, log_so3
from georef_gis.model.logs import EventLog, unknown
from georef_gis.model.photo import Geotag, Photo
from georef_gis.model.pose import Mount
from georef_gis.navigate.exposure_poses import ExposurePoses, exposure_poses
from georef_gis.navigate.exposures import ExposureTimes
from georef_gis.navigate.gnss_noise import prepare_fixes
from georef_gis.navigate.inertial_solution import smooth_flight
from georef_gis.navigate.tuning import tune
from georef_gis.project.settings import Settings
from georef_gis.simulate import FlightSettings, SimulatedFlight, simulate_flight, site
from georef_gis.simulate.ellipsoid import (
    ecef_from_geodetic,
    geodetic_from_ecef,
    rotation_ecef_from_ned,
)
from georef_gis.simulate.flight import NOMINAL_BODY_FROM_CAM
from processing_algorithms.navigate.exposure_inputs import time_variance
from processing_algorithms.navigate.matching import Scene, match_flight

# m/s and rad: the IMU's sheet of benchmarks/navigation.py
SHEET = {"gyro_bias": math.radians(100.0) / 3600.0, "accel_bias": 0.03, "scale": 0.0,
         "misalignment": 0.0}  # fmt: skip
ENU_FROM_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


@dataclass(frozen=True, kw_only=True)
class FlightErrors:
    """What one flight came to; rows are photos in order of time.

    `error` and `sigma` (n, 6): east, north, up m and rotation about them rad, truth less estimate;
    `tag_error` alike of the pose that the tags tell; `matched` where a photo has an event; `nees`
    of all photos together per degree of freedom; `scatter` the variance that chance gives the sum
    of (error/sigma)^2, which is large where photos err alike; `wrong` counts photos matched to
    another's event with a confidence above 0.99.
    """

    error: Array
    sigma: Array
    tag_error: Array
    confidence: Array
    matched: NDArray[np.bool_]
    nees: float
    scatter: float
    wrong: int


def flown(settings: FlightSettings, seed: int, **imu: float) -> FlightErrors:
    """One flight with every error drawn anew; `imu` as of `settings_of`."""
    flight = simulate_flight(settings, seed)
    imu_log, gnss = logs_of(flight)
    tuned = tune(imu_log, prepare_fixes(gnss), settings_of(flight, **imu), noise=True, delay=True)
    trajectory = smooth_flight(imu_log, tuned.fixes, tuned.settings)
    lat, lon, h = geodetic_from_ecef(flight.p_ecef)
    origin = Origin(lat=float(lat[0]), lon=float(lon[0]), height_ellipsoidal=float(h[0]))
    photos = photos_of(flight)
    scene = Scene(
        settings=Settings().logs, frame=SimpleNamespace(origin=origin), trajectory=trajectory,
        epoch=float(int(trajectory.span[0])), events=events_of(flight),
    )  # fmt: skip
    found, _ = match_flight(scene, photos)
    inside = [i for i in np.argsort(found.time) if not trajectory.why_not(float(found.time[i]))]
    assert len(inside) == len(photos)
    poses = exposure_poses(
        trajectory, [photos[i].id for i in inside], found.time[inside],
        time_variance(found, inside), mount_of(flight), origin,
    )  # fmt: skip
    return _judged(flight, poses, inside, found)


def photos_of(flight: SimulatedFlight) -> list[Photo]:
    """Photos with the clock and the place of their tags, as `read_photos` leaves them."""
    tags, sigma = flight.tags, flight.settings.tag_sigma_h
    return [
        Photo(
            id=Path(name).stem, path=Path(name), width=1296, height=864, camera_clock=clock,
            geotag=Geotag(
                lat=math.radians(lat), lon=math.radians(lon), sigma_h=sigma, of="antenna"
            ),
        )
        for name, clock, lat, lon in zip(
            flight.names, tags.camera_clock, tags.lat_deg, tags.lon_deg, strict=True
        )
    ]  # fmt: skip


def events_of(flight: SimulatedFlight) -> EventLog:
    """What the sync board noted; one exposure is missed and one line has no photo."""
    noted = flight.triggers
    m = len(noted)
    return EventLog(
        time=np.array([t.time for t in noted]) + flight.start_gps, kind="sync_board",
        sequence=np.arange(1, m + 1),
        sigma=np.full(m, flight.settings.trigger_sigma), lat=unknown(m), lon=unknown(m),
        height=unknown(m), covariance_ned=unknown(m, 3, 3), rpy=unknown(m, 3), names=("",) * m,
        flags=np.full(m, 1), source="sync_board.log",
    )  # fmt: skip


def mount_of(flight: SimulatedFlight) -> Mount:
    """The mount as it is believed; the true one differs by draws of its sigmas."""
    settings = flight.settings
    return Mount(
        lever_arm_body_camera=np.array(settings.lever_arm_camera),
        lever_arm_body_antenna=np.array(settings.lever_arm_antenna),
        sigma_lever_arm=settings.lever_arm_sigma,
        sigma_boresight=math.radians(settings.boresight_sigma_deg),
    )


def enu_of(flight: SimulatedFlight) -> tuple[Array, Array]:
    """First camera's place in ECEF, m, and the rotation of its east, north, up into ECEF."""
    p = flight.p_ecef[0]
    lat, lon, _ = geodetic_from_ecef(p)
    return p, rotation_ecef_from_ned(lat, lon) @ ENU_FROM_NED.T


def _judged(
    flight: SimulatedFlight, poses: ExposurePoses, order: list[int], found: ExposureTimes
) -> FlightErrors:
    p0, R_ecef_enu = enu_of(flight)
    p = (flight.p_ecef[order] - p0) @ R_ecef_enu
    R = R_ecef_enu.T @ flight.R_ecef_from_cam[order]
    at = np.array([pose.origin_enu for pose in poses.poses])
    R_est = np.array([pose.R_enu_from_cam for pose in poses.poses])
    error = np.hstack([p - at, log_so3(R @ np.swapaxes(R_est, -1, -2))])
    sigma = np.sqrt([np.diag(pose.covariance) for pose in poses.poses])
    joint = poses.joint()
    flat = error.ravel()
    correlation = joint / np.outer(sigma.ravel(), sigma.ravel())
    wrong = [k >= 0 and flight.triggers[k].photo != i for i, k in enumerate(found.event)]
    return FlightErrors(
        error=error, sigma=sigma, tag_error=_tag_errors(flight, p0, R_ecef_enu)[order],
        confidence=found.confidence[order],
        matched=found.event[order] >= 0,
        nees=float(flat @ np.linalg.solve(joint, flat)) / len(flat),
        scatter=2.0 * float(np.sum(correlation**2)),
        wrong=int(np.sum(np.array(wrong) & (found.confidence > 0.99))),
    )  # fmt: skip


def _tag_errors(flight: SimulatedFlight, p0: Array, R_ecef_enu: Array) -> Array:
    """Errors of the poses that the EXIF tags tell: last fix, lever arms, autopilot's angles."""
    tags, settings = flight.tags, flight.settings
    lat, lon = np.radians(tags.lat_deg), np.radians(tags.lon_deg)
    antenna = ecef_from_geodetic(lat, lon, tags.height_orthometric + site.geoid_height(lat, lon))
    rpy = np.radians(np.stack([tags.roll_deg, tags.pitch_deg, tags.yaw_deg]))
    R_ecef_body = rotation_ecef_from_ned(lat, lon) @ R_ned_from_body(*rpy)
    arm = np.array(settings.lever_arm_camera) - np.array(settings.lever_arm_antenna)
    R_cam = R_ecef_body @ np.array(NOMINAL_BODY_FROM_CAM)
    off = (flight.p_ecef - (antenna + R_ecef_body @ arm)) @ R_ecef_enu
    turn = R_ecef_enu.T @ flight.R_ecef_from_cam @ np.swapaxes(R_cam, -1, -2) @ R_ecef_enu
    return np.hstack([off, log_so3(turn)])
