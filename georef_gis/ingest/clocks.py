"""The camera's clock and the GPS time of a photo."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

from georef_gis.ingest.tags import TagValue, number, text
from georef_gis.units import gps_from_utc

Reading = Mapping[str, TagValue]

_STAMP = re.compile(
    r"(\d{4})[:\-/.](\d{2})[:\-/.](\d{2})[ T]+(\d{1,2}):(\d{2}):(\d{2})(?:[.,](\d{1,9}))?"
)
# Clocks that lost their battery count from 1970 or 1980.
_FIRST_YEAR = 1990
# s; the fix behind a GPS stamp is up to a second older than the exposure
_SIGMA_LAST_FIX = 0.6
# s; the autopilot stamps the exposure itself
_SIGMA_EVENT = 0.05
_SIGMA_DJI = 0.01
# s; Skydio's clock is set over the network
_SIGMA_SKYDIO = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class TimeReading:
    """Camera clock (naive) with its resolution, s, and seconds on the GPS scale since 1980."""

    camera_clock: datetime | None = None
    resolution_s: float = 1.0
    time_gps: float | None = None
    sigma: float | None = None
    source: str = ""


def read_time(tags: Reading) -> TimeReading:
    """Times of one photo's tags; placeholders such as 1970 count as none."""
    clock, resolution = _camera_clock(tags)
    for reader in (_dji, _sensefly, _skydio, _gps_stamp):
        found = reader(tags)
        if found is not None:
            utc, sigma, source = found
            return TimeReading(
                camera_clock=clock,
                resolution_s=resolution,
                time_gps=gps_from_utc(utc),
                sigma=sigma,
                source=source,
            )
    return TimeReading(camera_clock=clock, resolution_s=resolution)


def parse_stamp(value: str) -> tuple[datetime, float] | None:
    """Naive instant and resolution, s, of '2016:06:23 16:31:59.25' and its relatives."""
    match = _STAMP.search(value)
    if match is None:
        return None
    year, month, day, hour, minute, second = (int(part) for part in match.groups()[:6])
    digits = match.group(7) or ""
    try:
        # A leap second (60) is counted on from the second before it.
        at = datetime(year, month, day, hour, minute) + timedelta(seconds=second)
    except ValueError:
        return None
    if year < _FIRST_YEAR:
        return None
    return at + timedelta(seconds=_fraction(digits)), 10.0 ** -len(digits)


def _fraction(digits: str) -> float:
    return int(digits) / 10.0 ** len(digits) if digits else 0.0


def _camera_clock(tags: Reading) -> tuple[datetime | None, float]:
    for name, subsec in (
        ("EXIF:DateTimeOriginal", "EXIF:SubSecTimeOriginal"),
        ("EXIF:CreateDate", "EXIF:SubSecTimeDigitized"),
        ("EXIF:ModifyDate", "EXIF:SubSecTime"),
    ):
        found = parse_stamp(text(tags, name))
        if found is None:
            continue
        at, resolution = found
        digits = text(tags, subsec)
        if resolution == 1.0 and digits.isdigit():
            digits = digits[:6]
            return at + timedelta(seconds=_fraction(digits)), 10.0 ** -len(digits)
        return at, resolution
    return None, 1.0


def _utc(value: str) -> tuple[datetime, float] | None:
    found = parse_stamp(value)
    return None if found is None else (found[0].replace(tzinfo=UTC), found[1])


def _dji(tags: Reading) -> tuple[datetime, float, str] | None:
    found = _utc(text(tags, "XMP-drone-dji:UTCAtExposure"))
    if found is None:
        return None
    return found[0], max(_SIGMA_DJI, found[1] / math.sqrt(12.0)), "XMP-drone-dji:UTCAtExposure"


def _sensefly(tags: Reading) -> tuple[datetime, float, str] | None:
    found = _utc(text(tags, "XMP-sensefly:UTCTime"))
    if found is None:
        return None
    return found[0], max(_SIGMA_EVENT, found[1] / math.sqrt(12.0)), "XMP-sensefly:UTCTime"


def _skydio(tags: Reading) -> tuple[datetime, float, str] | None:
    """Unix microseconds of the take-off plus the microseconds of flight."""
    names = ("TakeoffUclock", "TakeoffUtime", "CaptureUtime")
    clock, takeoff, capture = (_whole(tags, f"XMP-drone-skydio:{name}") for name in names)
    if clock is None or takeoff is None or capture is None or not 0 <= capture - takeoff < 1e11:
        return None
    utc = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(microseconds=clock + capture - takeoff)
    if utc.year < _FIRST_YEAR:
        return None
    return utc, _SIGMA_SKYDIO, "XMP-drone-skydio:CaptureUtime"


def _whole(tags: Reading, name: str) -> int | None:
    value = tags.get(name)
    try:
        return None if value is None else int(value)
    except ValueError:
        return None


def _gps_stamp(tags: Reading) -> tuple[datetime, float, str] | None:
    day, time = text(tags, "GPS:GPSDateStamp"), text(tags, "GPS:GPSTimeStamp")
    found = _utc(f"{day} {time}") if day and time else None
    if found is None:
        return None
    by_autopilot = number(tags, "XMP-sensefly:CamId", "XMP-sensefly:CamID") is not None
    sigma = _SIGMA_EVENT if by_autopilot and found[1] < 0.1 else _SIGMA_LAST_FIX
    return found[0], sigma, "GPS:GPSTimeStamp"
