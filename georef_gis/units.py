"""Units and time scales; nothing else in the code converts between them.

Inside: metre, second, radian, pixel. Time is float seconds on the GPS scale.
"""

from __future__ import annotations

import math
from datetime import UTC, datetime, timedelta

# m; exact by definition (NIST SP 811)
INTERNATIONAL_FOOT = 0.3048
# m; exact by definition (US Mendenhall order, 39.37 inches to the metre)
US_SURVEY_FOOT = 1200.0 / 3937.0
# s; length of a GPS week
GPS_WEEK = 604800.0
# Start of the GPS scale, which had no offset to UTC then.
GPS_ZERO = datetime(1980, 1, 6, tzinfo=UTC)
# UTC instants from which GPS - UTC is 1, 2, 3 ... s (IERS Bulletin C; none after 2017).
LEAP_SECONDS: tuple[datetime, ...] = tuple(
    datetime(year, month, 1, tzinfo=UTC)
    for year, month in (
        (1981, 7), (1982, 7), (1983, 7), (1985, 7), (1988, 1), (1990, 1), (1991, 1),
        (1992, 7), (1993, 7), (1994, 7), (1996, 1), (1997, 7), (1999, 1), (2006, 1),
        (2009, 1), (2012, 7), (2015, 7), (2017, 1),
    )
)  # fmt: skip


def gps_minus_utc(utc: datetime) -> int:
    """Leap seconds between the GPS scale and UTC at an instant, s."""
    return sum(utc >= step for step in LEAP_SECONDS)


def gps_from_utc(utc: datetime) -> float:
    """Seconds on the GPS scale since 1980-01-06 from an aware UTC instant.

    Raises
    ------
    ValueError
        If `utc` has no time zone.
    """
    if utc.tzinfo is None:
        raise ValueError("a UTC instant needs a time zone")
    return (utc - GPS_ZERO).total_seconds() + gps_minus_utc(utc)


def utc_from_gps(seconds_gps: float) -> datetime:
    """UTC instant of seconds on the GPS scale since 1980-01-06.

    Within an inserted leap second the instant is that of the second before it.
    """
    # The inserted second i + 1 lies at step + i of the GPS scale.
    starts = ((step - GPS_ZERO).total_seconds() + i for i, step in enumerate(LEAP_SECONDS))
    return GPS_ZERO + timedelta(seconds=seconds_gps - sum(seconds_gps >= s for s in starts))


def gps_from_week(week: int, tow_s: float) -> float:
    """Seconds on the GPS scale since 1980-01-06 from week number and time of week."""
    return week * GPS_WEEK + tow_s


def week_from_gps(seconds_gps: float) -> tuple[int, float]:
    """Week number and time of week, s, of seconds on the GPS scale."""
    week = math.floor(seconds_gps / GPS_WEEK)
    return week, seconds_gps - week * GPS_WEEK


def radians_from_dms(degrees: float, minutes: float = 0.0, seconds: float = 0.0) -> float:
    """Angle in rad from degrees, minutes and seconds of one sign."""
    return math.radians(degrees + minutes / 60.0 + seconds / 3600.0)


def wrap_angle(angle: float) -> float:
    """Same direction within [-pi, pi), rad."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi
