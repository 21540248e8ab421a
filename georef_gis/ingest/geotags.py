"""Position, height with its kind, speed and course of each maker's dialect."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from georef_gis.geodesy import Height, HeightKind
from georef_gis.ingest.tags import TagValue, number, numbers, text
from georef_gis.model.photo import Geotag, PositionOf
from georef_gis.units import wrap_angle

Reading = Mapping[str, TagValue]

# RtkFlag: 50 fixed, 32-49 float, 16 single point, 0 none (DJI P4 RTK user guide)
_RTK_FLOAT = 32.0
# deg; EXIF seconds to 4 decimals are 3 mm: below this the longer number is the better one
_ROUNDING = 3e-7
# m; heights two tags give for one thing
_SAME_HEIGHT = 0.06
# m/s by the unit in GPSSpeedRef
_SPEED_UNITS = {"K": 1.0 / 3.6, "M": 0.44704, "N": 1852.0 / 3600.0}
# m/s; slower than this, speeds give no course
_SLOWEST_COURSE = 1.0
# m; below the deepest dry land and any geoid
_LOWEST, _HIGHEST = -550.0, 20000.0


@dataclass(frozen=True, slots=True, kw_only=True)
class PlaceReading:
    """Where the tags put the camera, how it moved, and doubts about that."""

    geotag: Geotag | None = None
    height_above_takeoff: float | None = None
    height_above_ground: float | None = None
    course: float | None = None
    ground_speed: float | None = None
    doubts: tuple[str, ...] = ()


def read_place(tags: Reading) -> PlaceReading:
    """Position, heights, course and speed of one photo's tags."""
    doubts: list[str] = []
    above_takeoff = _first_nonzero(
        tags,
        "XMP-drone-dji:RelativeAltitude",
        "XMP-sensefly:Height",
        "XMP-FLIR:MAVRelativeAltitude",
    )
    above_ground = _first_nonzero(tags, "XMP-Camera:AboveGroundAltitude")
    course, speed = _motion(tags)
    geotag = _geotag(tags, doubts)
    if number(tags, "XMP-drone-dji:RelativeAltitude") == 0.0:
        doubts.append(
            "[XMP-drone-dji:RelativeAltitude] is 0 m: the photo was taken on the ground, or the "
            "value is missing; give [ground] height_above_ground_m or exclude the photo"
        )
    return PlaceReading(
        geotag=geotag,
        height_above_takeoff=above_takeoff,
        height_above_ground=above_ground,
        course=course,
        ground_speed=speed,
        doubts=tuple(doubts),
    )


def _first_nonzero(tags: Reading, *names: str) -> float | None:
    value = number(tags, *names)
    return value if value else None


def _geotag(tags: Reading, doubts: list[str]) -> Geotag | None:
    found = _position(tags, doubts)
    if found is None:
        return None
    lat, lon, source = found
    sigma_h, sigma_v = _sigmas(tags)
    flag = number(tags, "XMP-drone-dji:RtkFlag")
    # DJI moves an RTK position from the antenna to the camera before it writes the tags.
    of: PositionOf = "camera" if flag is not None and flag >= _RTK_FLOAT else "unknown"
    return Geotag(
        lat=math.radians(lat),
        lon=math.radians(lon),
        height=_height(tags, doubts),
        sigma_h=sigma_h,
        sigma_v=sigma_v,
        of=of,
        source=source,
    )


def _position(tags: Reading, doubts: list[str]) -> tuple[float, float, str] | None:
    """Latitude, longitude in deg and the tag they come from."""
    exif = _exif_position(tags)
    xmp, group = _xmp_position(tags)
    at = exif or xmp
    if at is None:
        doubts.append(
            "[GPS:GPSLatitude] is missing: the photo has no position; give [poses] file "
            "or leave the photo out"
        )
        return None
    source = "EXIF GPS" if exif else f"XMP {group}"
    if exif and xmp:
        apart = max(abs(exif[0] - xmp[0]), abs(exif[1] - xmp[1]))
        if apart <= _ROUNDING:
            at, source = xmp, f"XMP {group}"
        elif apart > 2e-6:
            metres = math.hypot(exif[0] - xmp[0], (exif[1] - xmp[1])) * 111_200.0
            doubts.append(
                f"[GPS:GPSLatitude] and [XMP-{group}] differ by about {metres:.1f} m; "
                "the EXIF position is used; give [poses] file if it is the wrong one"
            )
    if not (abs(at[0]) <= 90.0 and abs(at[1]) <= 180.0):
        doubts.append(
            f"[{source}] position {at[0]:g}, {at[1]:g} deg is not on the Earth; give [poses] file"
        )
        return None
    if at == (0.0, 0.0):
        doubts.append(
            f"[{source}] position is 0, 0, which a receiver without a fix writes; the photo has no "
            "position; give [poses] file or leave the photo out"
        )
        return None
    return at[0], at[1], source


def _exif_position(tags: Reading) -> tuple[float, float] | None:
    lat, lon = number(tags, "GPS:GPSLatitude"), number(tags, "GPS:GPSLongitude")
    if lat is None or lon is None:
        return None
    south = text(tags, "GPS:GPSLatitudeRef").upper().startswith("S")
    west = text(tags, "GPS:GPSLongitudeRef").upper().startswith("W")
    return (-abs(lat) if south else lat), (-abs(lon) if west else lon)


def _xmp_position(tags: Reading) -> tuple[tuple[float, float] | None, str]:
    for group, lat_name, lon_names in (
        ("drone-dji", "GPSLatitude", ("GPSLongitude", "GPSLongtitude")),
        ("sensefly", "Latitude", ("Longitude",)),
        ("drone-skydio", "Latitude", ("Longitude",)),
    ):
        lat = number(tags, f"XMP-{group}:{lat_name}")
        lon = number(tags, *(f"XMP-{group}:{name}" for name in lon_names))
        if lat is not None and lon is not None and (lat or lon):
            return (lat, lon), group
    return None, ""


def _height(tags: Reading, doubts: list[str]) -> Height | None:
    value, kind = _exif_height(tags)
    absolute = number(tags, "XMP-drone-dji:AbsoluteAltitude", "XMP-drone-skydio:AbsoluteAltitude")
    value = absolute if value is None else value
    wgs84 = number(tags, "XMP-sensefly:AltitudeWGS84")
    if wgs84 is not None and (value is None or abs(value - wgs84) < _SAME_HEIGHT):
        return Height(value=wgs84, kind=HeightKind.ELLIPSOIDAL)
    if value is None or value == 0.0:
        amsl = number(tags, "XMP-sensefly:AltitudeAMSL")
        if amsl:
            return Height(value=amsl, kind=HeightKind.ORTHOMETRIC)
        what = "is missing" if value is None else "is 0 m, which stands for none"
        doubts.append(
            f"[GPS:GPSAltitude] {what}; the height of the camera is not known; "
            "give [ground] height_above_ground_m or [poses] file"
        )
        return None
    if not _LOWEST < value < _HIGHEST:
        doubts.append(f"[GPS:GPSAltitude] {value:.1f} m is no height on Earth; it was ignored")
        return None
    if value < -120.0:
        doubts.append(
            f"[GPS:GPSAltitude] {value:.1f} m lies below sea level by [GPS:GPSAltitudeRef]; "
            "check it against the terrain"
        )
    return Height(value=value, kind=_dji_kind(tags, value, kind, doubts))


def _exif_height(tags: Reading) -> tuple[float | None, HeightKind]:
    value = number(tags, "GPS:GPSAltitude")
    ref = number(tags, "GPS:GPSAltitudeRef")
    # EXIF 3.0: 2 and 3 are ellipsoidal, above and below; 0 and 1 "sea level", which few obey.
    kind = HeightKind.ELLIPSOIDAL if ref in (2.0, 3.0) else HeightKind.UNKNOWN
    if value is not None and ref in (1.0, 3.0):
        value = -abs(value)
    return value, kind


def _dji_kind(tags: Reading, value: float, kind: HeightKind, doubts: list[str]) -> HeightKind:
    flag = number(tags, "XMP-drone-dji:RtkFlag") or 0.0
    if text(tags, "XMP-drone-dji:AltitudeType") == "RtkAlt" or flag >= _RTK_FLOAT:
        return HeightKind.ELLIPSOIDAL
    relative = number(tags, "XMP-drone-dji:RelativeAltitude")
    if relative is not None and abs(relative - value) < _SAME_HEIGHT:
        doubts.append(
            f"[XMP-drone-dji:AbsoluteAltitude] {value:.2f} m repeats RelativeAltitude: it is above "
            "the take-off point, not above sea level"
        )
    return kind


def _sigmas(tags: Reading) -> tuple[float | None, float | None]:
    """One sigma in each of east and north, and of the height, m; None where not stated."""
    lon, lat = (number(tags, f"XMP-drone-dji:RtkStd{axis}") for axis in ("Lon", "Lat"))
    up = number(tags, "XMP-drone-dji:RtkStdHgt")
    if lon and lat:
        return math.hypot(lon, lat) / math.sqrt(2.0), up or None
    h = number(tags, "XMP-Camera:GPSXYAccuracy", "XMP-sensefly:GPSXYAccuracy")
    v = number(tags, "XMP-Camera:GPSZAccuracy", "XMP-sensefly:GPSZAccuracy")
    h = h or number(tags, "GPS:GPSHPositioningError", "XMP-exifEX:GPSHPositioningError")
    return (h if h and h > 0 else None), (v if v and v > 0 else None)


def _motion(tags: Reading) -> tuple[float | None, float | None]:
    """Course over ground, rad from true north, and speed, m/s."""
    speed = _speed(tags)
    course_deg = number(tags, "XMP-sensefly:Course") or None
    if course_deg is None and not text(tags, "GPS:GPSTrackRef").upper().startswith("M"):
        course_deg = number(tags, "GPS:GPSTrack")
    north, east = _velocity(tags)
    if north is not None and east is not None:
        v = math.hypot(north, east)
        speed = v if speed is None else speed
        if course_deg is None and v >= _SLOWEST_COURSE:
            course_deg = math.degrees(math.atan2(east, north))
    if course_deg is None or (speed is not None and speed < _SLOWEST_COURSE):
        return None, speed
    return wrap_angle(math.radians(course_deg)), speed


def _speed(tags: Reading) -> float | None:
    value = number(tags, "GPS:GPSSpeed")
    unit = text(tags, "GPS:GPSSpeedRef").upper()[:1] or "K"
    if value is not None and unit in _SPEED_UNITS:
        return value * _SPEED_UNITS[unit]
    value = number(tags, "XMP-sensefly:GroundSpeed")
    if value is not None:
        return value
    linear = numbers(tags, "XMP-Camera:IMULinearVelocity")
    return math.hypot(linear[0], linear[1]) if len(linear) == 3 else None


def _velocity(tags: Reading) -> tuple[float | None, float | None]:
    """North and east, m/s.

    Notes
    -----
    DJI's X and Y are north and east, not the vehicle's axes: on a line flown at -134 deg with the
    nose forward (Phantom 3) both are negative.
    """
    tenths = numbers(tags, "DJI:FlightSpeed")
    if len(tenths) == 3 and "XMP-drone-dji:FlightXSpeed" not in tags:
        return tenths[0] / 10.0, tenths[1] / 10.0
    return (
        number(
            tags, "XMP-drone-dji:FlightXSpeed", "DJI:SpeedX", "XMP-drone-skydio:VehicleSpeedNEDX"
        ),
        number(
            tags, "XMP-drone-dji:FlightYSpeed", "DJI:SpeedY", "XMP-drone-skydio:VehicleSpeedNEDY"
        ),
    )
