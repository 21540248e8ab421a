"""One simulated flight in memory: the truth, what the instruments say, and an oracle projection."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta

import numpy as np
from numpy.typing import NDArray

from georef_gis.simulate import ellipsoid, optics, sensors, site
from georef_gis.simulate.sensors import GnssLog, ImuLog, Trigger
from georef_gis.simulate.settings import FlightSettings
from georef_gis.simulate.trajectory import TruePath, TruthStates, make_path
from georef_gis.units import GPS_WEEK, US_SURVEY_FOOT, gps_from_utc, utc_from_gps

Array = NDArray[np.float64]

# Sunday 2009-06-21 00:00:00 on the GPS scale: a new GPS week begins.
BOUNDARY_GPS = round(gps_from_utc(datetime(2009, 6, 20, tzinfo=UTC)) / GPS_WEEK + 0.5) * GPS_WEEK
LOCAL_FROM_UTC = timedelta(hours=-4)  # eastern daylight time, which the camera's clock shows
# Zero angles at a camera that looks down with its top forward (Pix4D Camera, senseFly).
NOMINAL_BODY_FROM_CAM = ((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))


@dataclass(frozen=True, slots=True, kw_only=True)
class Tags:
    """What the photos' metadata say; one row per photo.

    Parameters
    ----------
    lat_deg, lon_deg, height_orthometric
        Of the GNSS antenna; deg, deg, m (EGM96).
    yaw_deg, pitch_deg, roll_deg
        Body angles as the autopilot believes them, yaw from true north; NaN without a tag.
    camera_clock
        Naive local time, truncated to whole seconds.
    """

    lat_deg: Array
    lon_deg: Array
    height_orthometric: Array
    yaw_deg: Array
    pitch_deg: Array
    roll_deg: Array
    camera_clock: tuple[datetime, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class SurveyedPoint:
    """A target as surveyed, in US survey feet of the output CRS, beside its truth.

    Parameters
    ----------
    easting, northing, height_orthometric
        EPSG:6601 and EGM96 height, US survey feet, with the survey's error.
    p_ecef
        True position, shape (3,), m.
    """

    name: str
    role: str
    easting: float
    northing: float
    height_orthometric: float
    p_ecef: Array


@dataclass(frozen=True, slots=True, kw_only=True)
class Mark:
    """A target seen in a photo; `uv_true` without the marking error, px."""

    point: str
    photo: int
    uv: Array
    uv_true: Array


@dataclass(frozen=True, slots=True, kw_only=True)
class SimulatedFlight:
    """Truth and measurements of one flight; arrays have one row per photo unless said.

    Parameters
    ----------
    start_gps
        GPS seconds since 1980 at time 0 of the flight.
    exposures
        True times of exposure, s since `start_gps`.
    p_ecef
        Projection centres, shape (n, 3), m.
    R_ecef_from_cam, R_ned_from_cam
        Camera axes x right, y down, z into the scene, shape (n, 3, 3); NED at the camera.
    states
        States of the IMU at the exposures.
    lever_arm_camera, lever_arm_antenna
        True, from the IMU in body axes, m; `settings` holds what is believed.
    boresight
        Rotation vector in body axes, rad: ``R_body_from_cam = Exp(boresight) @ nominal``.
    clock_offset, clock_drift
        Camera clock minus local time at time 0, s, and its growth, s/s.
    """

    settings: FlightSettings
    seed: int
    path: TruePath
    start_gps: float
    names: tuple[str, ...]
    exposures: Array
    p_ecef: Array
    R_ecef_from_cam: Array
    R_ned_from_cam: Array
    states: TruthStates
    lever_arm_camera: Array
    lever_arm_antenna: Array
    boresight: Array
    clock_offset: float
    clock_drift: float
    gnss: GnssLog
    triggers: tuple[Trigger, ...]
    tags: Tags
    control: tuple[SurveyedPoint, ...]
    marks: tuple[Mark, ...]


def _stream(seed: int, source: int) -> np.random.Generator:
    """A generator of its own per error source, so that a switch moves no other draw."""
    return np.random.default_rng([seed, source])


def simulate_flight(settings: FlightSettings | None = None, seed: int = 0) -> SimulatedFlight:
    """Draw one flight; every error source anew from `seed`. Renders and writes nothing."""
    settings = FlightSettings() if settings is None else settings
    path = make_path(settings, _stream(seed, 0))
    start = _start_gps(path, settings)
    mount = _stream(seed, 1)
    slip = settings.lever_arm_sigma * mount.normal(size=(2, 3))
    arm_camera = np.array(settings.lever_arm_camera) + slip[0]
    arm_antenna = np.array(settings.lever_arm_antenna) + slip[1]
    boresight = math.radians(settings.boresight_sigma_deg) * mount.normal(size=3)
    states = path.states(path.exposures)
    p = states.p_ecef + states.R_ecef_from_body @ arm_camera
    R_ec = states.R_ecef_from_body @ rotation_of_vector(boresight) @ np.array(NOMINAL_BODY_FROM_CAM)
    lat, lon, _ = ellipsoid.geodetic_from_ecef(p)
    R_nc = np.swapaxes(ellipsoid.rotation_ecef_from_ned(lat, lon), -1, -2) @ R_ec
    fixes = _fix_times(path, start, settings)
    gnss = sensors.simulate_gnss(path, fixes, arm_antenna, settings, _stream(seed, 2))
    clock = _stream(seed, 3)
    offset = settings.clock_offset_sigma * clock.normal()
    drift = settings.clock_drift_sigma * clock.normal()
    tags = _tags(path, gnss, settings, _stream(seed, 4), (start, offset, drift))
    flight = SimulatedFlight(
        settings=settings, seed=seed, path=path, start_gps=start,
        names=tuple(f"IMG_{i + 1:04d}.JPG" for i in range(len(path.exposures))),
        exposures=path.exposures, p_ecef=p, R_ecef_from_cam=R_ec, R_ned_from_cam=R_nc,
        states=states, lever_arm_camera=arm_camera, lever_arm_antenna=arm_antenna,
        boresight=boresight, clock_offset=offset, clock_drift=drift, gnss=gnss,
        triggers=sensors.simulate_triggers(path.exposures, settings, _stream(seed, 5)),
        tags=tags, control=_control(settings, _stream(seed, 6)), marks=(),
    )  # fmt: skip
    return _with_marks(flight, _stream(seed, 7))


def project_truth(flight: SimulatedFlight, photo_index: int, points_ecef: Array) -> Array:
    """True pixels of ECEF points in a photo, shape (..., 2); NaN behind the camera."""
    d = np.asarray(points_ecef) - flight.p_ecef[photo_index]
    return optics.pixels_from_cam(d @ flight.R_ecef_from_cam[photo_index], flight.settings.camera)


def simulate_imu(flight: SimulatedFlight, *, errors: bool = True) -> ImuLog:
    """IMU log of the whole flight, with its errors or as truth."""
    settings = flight.settings
    count = math.floor(flight.path.duration * settings.imu_rate)
    states = flight.path.states(np.arange(count) / settings.imu_rate)
    return sensors.imu_of_states(states, settings, _stream(flight.seed, 8) if errors else None)


def rotation_of_vector(vector: Array) -> Array:
    """Rodrigues' matrix of a rotation vector, rad."""
    angle = float(np.linalg.norm(vector))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = vector / angle
    k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + math.sin(angle) * k + (1.0 - math.cos(angle)) * k @ k)


def _start_gps(path: TruePath, settings: FlightSettings) -> float:
    """Start such that the week turns between the two middle photos, on the IMU's grid."""
    half = len(path.exposures) // 2
    middle = float(np.mean(path.exposures[max(half - 1, 0) : half + 1]))
    return BOUNDARY_GPS - round(middle * settings.gnss_rate) / settings.gnss_rate


def _fix_times(path: TruePath, start: float, settings: FlightSettings) -> Array:
    first = math.ceil(start * settings.gnss_rate - 1e-6) / settings.gnss_rate - start
    count = math.floor((path.duration - first) * settings.gnss_rate)
    return np.asarray(first + np.arange(count) / settings.gnss_rate)


def _tags(
    path: TruePath,
    gnss: GnssLog,
    settings: FlightSettings,
    rng: np.random.Generator,
    clock: tuple[float, float, float],
) -> Tags:
    time = path.exposures
    age = np.searchsorted(gnss.time, time, side="right") - 1
    error = sensors.gauss_markov(rng, time, settings.attitude_tau, 1.0)
    rpy = np.degrees(path.states(time).rpy) + settings.attitude_sigma_deg * error
    course = np.arctan2(gnss.v_ned[age, 1], gnss.v_ned[age, 0])
    rpy[:, 2] = (np.degrees(course) + settings.attitude_sigma_deg * error[:, 2]) % 360.0
    if settings.attitude_tag == "none":
        rpy = np.full_like(rpy, np.nan)
    lat, lon, h = gnss.lat[age], gnss.lon[age], gnss.height_ellipsoidal[age]
    if settings.tag_position == "at_exposure":
        lat, lon, h = (np.interp(time, gnss.time, c) for c in _geodetic(gnss))
    start, offset, drift = clock
    shown = [start + t + offset + drift * t for t in time]
    return Tags(
        lat_deg=np.degrees(lat), lon_deg=np.degrees(lon),
        height_orthometric=h - site.geoid_height(lat, lon),
        yaw_deg=rpy[:, 2], pitch_deg=rpy[:, 1], roll_deg=rpy[:, 0],
        camera_clock=tuple(
            (utc_from_gps(s) + LOCAL_FROM_UTC).replace(tzinfo=None, microsecond=0) for s in shown
        ),
    )  # fmt: skip


def _geodetic(gnss: GnssLog) -> tuple[Array, Array, Array]:
    return gnss.lat, gnss.lon, gnss.height_ellipsoidal


def _control(settings: FlightSettings, rng: np.random.Generator) -> tuple[SurveyedPoint, ...]:
    out = []
    sigma = np.array([settings.control_sigma_h] * 2 + [settings.control_sigma_v])
    for point in site.control_points():
        p = site.ecef_from_enu(point.enu)
        measured = site.ecef_from_enu(point.enu + sigma * rng.normal(size=3))
        e, n, height = map_from_ecef(measured)
        out.append(
            SurveyedPoint(
                name=point.name, role=point.role, easting=e, northing=n,
                height_orthometric=height, p_ecef=p,
            )
        )  # fmt: skip
    return tuple(out)


def map_from_ecef(p_ecef: Array) -> tuple[float, float, float]:
    """Easting, northing (EPSG:6601) and EGM96 height of a point, all in US survey feet."""
    lat, lon, h = ellipsoid.geodetic_from_ecef(p_ecef)
    e, n = ellipsoid.state_plane_from_geodetic(lat, lon)
    height = (h - site.geoid_height(lat, lon)) / US_SURVEY_FOOT
    return float(e), float(n), float(height)


def _with_marks(flight: SimulatedFlight, rng: np.random.Generator) -> SimulatedFlight:
    camera = flight.settings.camera
    size = np.array([camera.width, camera.height])
    marks = []
    for i in range(len(flight.names)):
        for point in flight.control:
            uv = project_truth(flight, i, point.p_ecef)
            noise = flight.settings.mark_sigma * rng.normal(size=2)
            if np.all(uv > 15.0) and np.all(uv < size - 16.0):
                marks.append(Mark(point=point.name, photo=i, uv=uv + noise, uv_true=uv))
    return replace(flight, marks=tuple(marks))
