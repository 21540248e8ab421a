"""Attitude of each maker's dialect: which tags, which angles; never a silent guess.

The angles are handed on in the dialect's own sense, rad; `georef_gis.orient` turns them into
rotations by the table of dialects. What a maker's convention leaves unclear stays absent, with a
doubt that says so.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from georef_gis.ingest.tags import TagValue, number, numbers, text
from georef_gis.model.photo import AttitudeTag
from georef_gis.units import wrap_angle

# Dialects whose angles are zero with the camera level (nadir at pitch -90 deg)
HORIZON_DIALECTS = frozenset({"drone-dji", "dji-makernote", "drone-parrot", "skydio"})
# rad; nothing but the assumption that a camera without angles looks down
_SIGMA_NO_TILT = math.radians(15.0)
_SIGMA_IMAGE_DIRECTION = math.radians(5.0)
# rad; a magnetic bearing whose declination is unknown
_SIGMA_MAGNETIC = math.radians(15.0)
# deg; a yaw that repeats GPSTrack to this is a course
_SAME_ANGLE = 0.05

Reading = Mapping[str, TagValue]


@dataclass(frozen=True, slots=True, kw_only=True)
class AttitudeReading:
    """Attitude, if the tags state one that is understood, and doubts about it."""

    attitude: AttitudeTag | None = None
    doubts: tuple[str, ...] = ()


def read_attitude(tags: Reading) -> AttitudeReading:
    """Attitude by the first dialect that the tags speak.

    Parameters
    ----------
    tags
        Normalised tags of one photo.
    """
    for reader in _READERS:
        found = reader(tags)
        if found is not None:
            return found
    return AttitudeReading()


def _tag(
    dialect: str,
    rpy_deg: tuple[float, float, float],
    *,
    vehicle_yaw_deg: float | None = None,
    yaw_is_course: bool = False,
) -> AttitudeTag:
    roll, pitch, yaw = (math.radians(v) for v in rpy_deg)
    return AttitudeTag(
        dialect=dialect,
        roll=roll,
        pitch=pitch,
        yaw=wrap_angle(yaw),
        vehicle_yaw=None if vehicle_yaw_deg is None else wrap_angle(math.radians(vehicle_yaw_deg)),
        yaw_is_course=yaw_is_course,
    )


def _rpy(tags: Reading, template: str) -> tuple[float, float, float] | None:
    """Roll, pitch, yaw in degrees under a template of names; None unless all three are there."""
    found = [number(tags, template.format(name)) for name in ("Roll", "Pitch", "Yaw")]
    values = [v for v in found if v is not None and abs(v) <= 720.0]
    return (values[0], values[1], values[2]) if len(values) == 3 else None


def _drone_dji(tags: Reading) -> AttitudeReading | None:
    rpy = _rpy(tags, "XMP-drone-dji:Gimbal{}Degree")
    if rpy is None:
        return None
    flight = _rpy(tags, "XMP-drone-dji:Flight{}Degree")
    return AttitudeReading(
        attitude=_tag("drone-dji", rpy, vehicle_yaw_deg=flight[2] if flight else None)
    )


def _dji_makernote(tags: Reading) -> AttitudeReading | None:
    rpy = _rpy(tags, "DJI:Camera{}")
    vehicle = number(tags, "DJI:Yaw")
    if rpy is None:
        # Newer firmware: "yaw,pitch,roll" in tenths of a degree.
        tenths = numbers(tags, "DJI:GimbalDegree")
        if len(tenths) != 3:
            return None
        rpy = (tenths[2] / 10.0, tenths[1] / 10.0, tenths[0] / 10.0)
        flight = numbers(tags, "DJI:FlightDegree")
        vehicle = flight[0] / 10.0 if len(flight) == 3 else None
    return AttitudeReading(attitude=_tag("dji-makernote", rpy, vehicle_yaw_deg=vehicle))


def _sensefly(tags: Reading) -> AttitudeReading | None:
    found = [
        number(tags, "XMP-sensefly:RollAngle", "XMP-sensefly:Roll"),
        number(tags, "XMP-sensefly:PitchAngle", "XMP-sensefly:Pitch"),
        number(tags, "XMP-sensefly:Heading", "XMP-sensefly:Yaw"),
    ]
    values = [v for v in found if v is not None]
    if len(values) < 3:
        return None
    track = number(tags, "GPS:GPSTrack")
    is_course = track is not None and _apart(track, values[2]) < _SAME_ANGLE
    attitude = _tag("sensefly", (values[0], values[1], values[2]), yaw_is_course=is_course)
    return AttitudeReading(attitude=attitude)


def _pix4d_camera(tags: Reading) -> AttitudeReading | None:
    rpy = _rpy(tags, "XMP-Camera:{}")
    if rpy is None:
        return None
    maker = text(tags, "EXIF:Make").upper()
    angles = "[XMP-Camera:Yaw, Pitch, Roll] " + ", ".join(f"{v:g}" for v in rpy[::-1]) + " deg"
    if rpy == (0.0, 0.0, 0.0):
        return AttitudeReading(
            doubts=(f"{angles} are placeholders, so the attitude is unknown; give [poses] file",)
        )
    model = text(tags, "EXIF:Model")
    if maker == "FLIR" or model.startswith(("Bebop", "Disco")):
        return AttitudeReading(
            doubts=(
                f"{angles} on a {model or maker} may be of the aircraft or of the camera: the "
                "convention is not known, so they are not used; give [poses] file",
            )
        )
    sigmas = [number(tags, f"XMP-Camera:IMU{name}Accuracy") for name in ("Roll", "Pitch", "Yaw")]
    roll_pitch = max((v for v in sigmas[:2] if v), default=None)
    attitude = replace(
        _tag("pix4d-camera", rpy),
        sigma_roll_pitch=None if roll_pitch is None else math.radians(roll_pitch),
        sigma_yaw=math.radians(sigmas[2]) if sigmas[2] else None,
    )
    return AttitudeReading(attitude=attitude)


def _drone_parrot(tags: Reading) -> AttitudeReading | None:
    rpy = _rpy(tags, "XMP-drone-parrot:Camera{}Degree")
    if rpy is None:
        return None
    vehicle = number(tags, "XMP-drone-parrot:DroneYawDegree")
    return AttitudeReading(attitude=_tag("drone-parrot", rpy, vehicle_yaw_deg=vehicle))


def _skydio(tags: Reading) -> AttitudeReading | None:
    rpy = _rpy(tags, "XMP-drone-skydio:CameraOrientationNED{}")
    if rpy is None:
        return None
    vehicle = number(tags, "XMP-drone-skydio:VehicleOrientationNEDYaw")
    return AttitudeReading(attitude=_tag("skydio", rpy, vehicle_yaw_deg=vehicle))


def _not_understood(tags: Reading) -> AttitudeReading | None:
    """Angles whose axes or zero no source states: named, and left alone."""
    kinds = (
        ("XMP-exif:Camera{}", "XMP-exif:CameraYaw, Pitch, Roll", "of a Teal/FLIR Hadron"),
        ("XMP-FLIR:MAV{}", "XMP-FLIR:MAVYaw, Pitch, Roll", "of the vehicle, not of the camera"),
        ("XMP-DLS:{}", "XMP-DLS:Yaw, Pitch, Roll", "of the light sensor, not of the camera"),
    )
    for template, names, what in kinds:
        rpy = _rpy(tags, template)
        if rpy is not None and any(rpy):
            values = ", ".join(f"{v:.6g}" for v in rpy[::-1])
            return AttitudeReading(
                doubts=(
                    f"[{names}] {values} are angles {what}: the convention is not known, so they "
                    "are not used; give [poses] file",
                )
            )
    return None


def _image_direction(tags: Reading) -> AttitudeReading | None:
    """A compass bearing alone: yaw of a camera that is assumed to look down."""
    bearing = number(tags, "GPS:GPSImgDirection")
    if bearing is None or not -360.0 <= bearing <= 360.0:
        return None
    magnetic = text(tags, "GPS:GPSImgDirectionRef").upper().startswith("M")
    kind = "magnetic, declination unknown" if magnetic else "true north"
    attitude = AttitudeTag(
        dialect="ypr",
        roll=0.0,
        pitch=0.0,
        yaw=wrap_angle(math.radians(bearing)),
        sigma_roll_pitch=_SIGMA_NO_TILT,
        sigma_yaw=_SIGMA_MAGNETIC if magnetic else _SIGMA_IMAGE_DIRECTION,
    )
    return AttitudeReading(
        attitude=attitude,
        doubts=(
            f"[GPS:GPSImgDirection] {bearing:.1f} deg ({kind}) is the only angle: the camera is "
            "taken as looking straight down; give [poses] file if it did not",
        ),
    )


_READERS: tuple[Callable[[Reading], AttitudeReading | None], ...] = (
    _drone_dji,
    _sensefly,
    _drone_parrot,
    _skydio,
    _pix4d_camera,
    _dji_makernote,
    _not_understood,
    _image_direction,
)


def _apart(a_deg: float, b_deg: float) -> float:
    """Angle between two directions, deg."""
    return abs((a_deg - b_deg + 180.0) % 360.0 - 180.0)
