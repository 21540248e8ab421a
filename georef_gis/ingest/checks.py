"""Tags that contradict each other, or that a photo editor may have made untrue."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping

import numpy as np

from georef_gis.frames import R_BODY_FROM_CAM_HORIZON, R_BODY_FROM_CAM_NADIR, R_ned_from_body
from georef_gis.ingest.dialects import HORIZON_DIALECTS
from georef_gis.ingest.tags import TagValue, number, text
from georef_gis.model.photo import AttitudeTag
from georef_gis.units import wrap_angle

# rad; a camera within this of straight down is a nadir camera
_NADIR = math.radians(15.0)
_OBLIQUE = math.radians(45.0)
# rad; the sky comes into the picture
_HORIZONTAL = math.radians(70.0)
_YAWS_DIFFER = math.radians(30.0)
# m; lower, the aircraft stands on the ground
_ON_THE_GROUND = 5.0
_EDITORS = re.compile(
    r"photo viewer|microsoft (?:windows )?photo|gimp|photoshop|lightroom|adobe|picasa|irfanview"
    r"|xnview|faststone|paint\.?net|paint shop|acdsee|photoscape|affinity|capture one|dxo|darktable"
    r"|rawtherapee|imagemagick|photo gallery|apple photos|snapseed|\bpreview\b|zoner"
    r"|luminar|shotwell|digikam",
    re.IGNORECASE,
)


def attitude_doubts(tags: Mapping[str, TagValue], attitude: AttitudeTag | None) -> list[str]:
    """Doubts about the angles: horizon in view, gimbal against flight yaw, odd roll."""
    if attitude is None or attitude.dialect not in HORIZON_DIALECTS | {"sensefly", "pix4d-camera"}:
        return []
    out: list[str] = []
    tilt, azimuth = view_of(attitude)
    name = _field(attitude.dialect)
    roll_deg = math.degrees(attitude.roll)
    if tilt > _HORIZONTAL:
        out.append(
            f"[{name}Pitch] the camera looks {math.degrees(tilt):.0f} deg away from straight down, "
            "towards the horizon or above; exclude the photo from the mosaic"
        )
    elif tilt > _OBLIQUE:
        out.append(f"[{name}Pitch] oblique photo, {math.degrees(tilt):.0f} deg off straight down")
    if abs(wrap_angle(attitude.roll)) > math.radians(45.0) and attitude.dialect in HORIZON_DIALECTS:
        out.append(_roll_doubt(name, roll_deg, attitude, tilt, azimuth))
    if (
        attitude.vehicle_yaw is not None
        and tilt < _NADIR
        and abs(wrap_angle(azimuth - attitude.vehicle_yaw)) > _YAWS_DIFFER
    ):
        flight = math.degrees(attitude.vehicle_yaw)
        out.append(
            f"[{name}Yaw] camera heading {math.degrees(azimuth):.1f} deg and flight yaw "
            f"{flight:.1f} deg differ by "
            f"{math.degrees(abs(wrap_angle(azimuth - attitude.vehicle_yaw))):.0f} deg; "
            'the camera\'s is used; set [attitude] yaw_source = "flight" if the photos come out '
            "turned"
        )
    return out


def _roll_doubt(
    name: str, roll_deg: float, attitude: AttitudeTag, tilt: float, azimuth: float
) -> str:
    what = f"[{name}Roll] {roll_deg:.0f} deg"
    if tilt < _NADIR and abs(abs(roll_deg) - 180.0) > 30.0:
        return (
            f"{what} is no tilt: looking straight down, roll and yaw are one angle (gimbal lock), "
            f"together heading {math.degrees(azimuth):.1f} deg"
        )
    if abs(abs(roll_deg) - 180.0) <= 30.0:
        return (
            f"{what}: the gimbal passed over the vertical and reports itself upside down; the "
            "picture may be turned by half a turn; compare it with its neighbours, and set "
            "[attitude] rotate_photos"
        )
    return f"{what} is more than a gimbal turns; the angles may be wrong; check the footprint"


def view_of(attitude: AttitudeTag) -> tuple[float, float]:
    """Angle off straight down and azimuth of the top of the picture, rad."""
    nominal = (
        R_BODY_FROM_CAM_HORIZON if attitude.dialect in HORIZON_DIALECTS else R_BODY_FROM_CAM_NADIR
    )
    R_ned_from_cam = R_ned_from_body(attitude.roll, attitude.pitch, attitude.yaw or 0.0) @ nominal
    tilt = math.acos(float(np.clip(R_ned_from_cam[2, 2], -1.0, 1.0)))
    up = -R_ned_from_cam[:, 1] if tilt < _OBLIQUE else R_ned_from_cam[:, 2]
    return tilt, math.atan2(float(up[1]), float(up[0]))


def pixel_doubts(
    tags: Mapping[str, TagValue], attitude: AttitudeTag | None, name: str
) -> list[str]:
    """Doubts whether the pixels still lie as the camera wrote them."""
    out: list[str] = []
    editor = _editor(tags)
    if editor:
        field, program = editor
        out.append(
            f"[{field}] photo viewer or editor '{program}' may have turned or cropped the picture; "
            "compare it with its neighbours, and if it is turned set [attitude] "
            f'rotate_photos = {{"{name}" = 180}}'
        )
    orientation = number(tags, "EXIF:Orientation")
    if orientation is not None and 2.0 <= orientation <= 8.0:
        beside = " beside stated angles" if attitude is not None else ""
        out.append(
            f"[EXIF:Orientation] {orientation:.0f}{beside}: the picture is stored turned; the "
            "stored pixels are used as they are; set [attitude] rotate_photos if it lands turned"
        )
    zoom = number(tags, "EXIF:DigitalZoomRatio")
    if zoom is not None and zoom > 1.0:
        out.append(
            f"[EXIF:DigitalZoomRatio] {zoom:g}: a digital zoom changes the focal length in pixels; "
            "give [camera] focal_px"
        )
    return out


def _editor(tags: Mapping[str, TagValue]) -> tuple[str, str] | None:
    fields = (
        "EXIF:Software", "EXIF:ProcessingSoftware", "XMP-xmp:CreatorTool", "File:Comment",
        "XMP-xmpMM:HistorySoftwareAgent",
    )  # fmt: skip
    for field in fields:
        value = text(tags, field)
        if value and _EDITORS.search(value):
            return field, value.split(",")[0][:60]
    return None


def ground_doubts(
    height_above_takeoff: float | None, height_above_ground: float | None
) -> list[str]:
    """Doubts whether the aircraft was in the air."""
    out = []
    for value, what in ((height_above_takeoff, "take-off"), (height_above_ground, "ground")):
        if value is not None and value < _ON_THE_GROUND:
            out.append(
                f"[height above {what}] {value:.1f} m: taken on or near the ground; "
                "exclude the photo"
            )
    return out


def _field(dialect: str) -> str:
    return {
        "drone-dji": "XMP-drone-dji:Gimbal",
        "dji-makernote": "DJI:Camera",
        "drone-parrot": "XMP-drone-parrot:Camera",
        "skydio": "XMP-drone-skydio:CameraOrientationNED",
        "sensefly": "XMP-sensefly:",
        "pix4d-camera": "XMP-Camera:",
    }[dialect]
