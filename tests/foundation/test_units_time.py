"""Time scales and units, against hand-counted leap seconds and known GPS weeks."""

from __future__ import annotations

import math
from datetime import UTC, datetime, timedelta, timezone

import pytest
from hypothesis import given
from hypothesis import strategies as st

from georef_gis.units import (
    GPS_WEEK,
    GPS_ZERO,
    INTERNATIONAL_FOOT,
    US_SURVEY_FOOT,
    gps_from_utc,
    gps_from_week,
    gps_minus_utc,
    radians_from_dms,
    utc_from_gps,
    week_from_gps,
    wrap_angle,
)

AFTER_1980 = st.datetimes(
    min_value=datetime(1980, 1, 6), max_value=datetime(2060, 1, 1), timezones=st.just(UTC)
)


@pytest.mark.parametrize(
    ("utc", "seconds"),
    [
        (datetime(1980, 1, 6, tzinfo=UTC), 0),
        (datetime(1981, 6, 30, 23, 59, 59, tzinfo=UTC), 0),
        (datetime(1981, 7, 1, tzinfo=UTC), 1),
        (datetime(2009, 6, 20, tzinfo=UTC), 15),
        (datetime(2016, 12, 31, 23, 59, 59, tzinfo=UTC), 17),
        (datetime(2017, 1, 1, tzinfo=UTC), 18),
        (datetime(2026, 1, 1, tzinfo=UTC), 18),
    ],
    ids=lambda v: str(v)[:19],
)
def test_leap_seconds_of_bulletin_c(utc: datetime, seconds: int) -> None:
    assert gps_minus_utc(utc) == seconds


def test_gps_week_1536_begins_15_s_before_midnight() -> None:
    # 1980-01-06 plus 1536 weeks is 2009-06-14; GPS ran 15 s ahead of UTC.
    assert utc_from_gps(gps_from_week(1536, 0.0)) == datetime(2009, 6, 13, 23, 59, 45, tzinfo=UTC)


def test_a_second_of_leap_is_two_seconds_of_gps() -> None:
    before = gps_from_utc(datetime(2016, 12, 31, 23, 59, 59, tzinfo=UTC))
    assert gps_from_utc(datetime(2017, 1, 1, tzinfo=UTC)) - before == 2.0


@pytest.mark.parametrize("into_s", [0.0, 0.25, 0.999])
def test_within_a_leap_second_utc_stays_in_the_second_before(into_s: float) -> None:
    leap = gps_from_utc(datetime(2016, 12, 31, 23, 59, 59, tzinfo=UTC)) + 1.0
    before = datetime(2016, 12, 31, 23, 59, 59, tzinfo=UTC)
    assert utc_from_gps(leap + into_s) == before + timedelta(seconds=into_s)


@given(AFTER_1980)
def test_utc_survives_the_round_trip(utc: datetime) -> None:
    # s: a double holds 2.4e9 s to 5e-7
    assert abs(utc_from_gps(gps_from_utc(utc)) - utc) < timedelta(microseconds=2)


@given(AFTER_1980, st.floats(0.0, 1e6))
def test_gps_time_never_runs_backwards(utc: datetime, later: float) -> None:
    assert gps_from_utc(utc + timedelta(seconds=later)) >= gps_from_utc(utc)


@given(st.floats(0.0, 3e9))
def test_week_and_time_of_week_join_again(seconds: float) -> None:
    week, tow = week_from_gps(seconds)
    assert 0.0 <= tow < GPS_WEEK
    assert gps_from_week(week, tow) == pytest.approx(seconds, abs=1e-6)  # s: rounding at 3e9


def test_the_week_rolls_over_at_saturday_midnight() -> None:
    end = gps_from_week(1536, GPS_WEEK - 0.01)
    assert week_from_gps(end)[0] == 1536
    assert week_from_gps(end + 0.02)[0] == 1537
    assert week_from_gps(end + 0.02)[1] == pytest.approx(0.01, abs=1e-6)


def test_another_time_zone_is_the_same_instant() -> None:
    eastern = datetime(2009, 6, 20, 8, tzinfo=timezone(timedelta(hours=-4)))
    assert gps_from_utc(eastern) == gps_from_utc(datetime(2009, 6, 20, 12, tzinfo=UTC))


def test_a_naive_instant_is_refused() -> None:
    with pytest.raises(ValueError, match="time zone"):
        gps_from_utc(datetime(2009, 6, 20))


def test_gps_zero_is_a_sunday() -> None:
    assert GPS_ZERO.weekday() == 6


def test_feet() -> None:
    assert pytest.approx(1.0, abs=1e-15) == 39.37 / 12 * US_SURVEY_FOOT
    # m: 1968500 US survey feet of a false easting are 600 km, in international feet 1.2 m less
    assert 1968500 * (US_SURVEY_FOOT - INTERNATIONAL_FOOT) == pytest.approx(1.2, abs=1e-3)


def test_degrees_minutes_seconds() -> None:
    assert radians_from_dms(39, 5, 51.0) == pytest.approx(math.radians(39.0975), abs=1e-15)


@given(st.floats(-100.0, 100.0))
def test_a_wrapped_angle_points_the_same_way(angle: float) -> None:
    wrapped = wrap_angle(angle)
    assert -math.pi <= wrapped <= math.pi
    assert math.cos(wrapped - angle) == pytest.approx(1.0, abs=1e-12)
