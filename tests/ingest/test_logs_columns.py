"""Columns of text logs: units, names, the mapping, and what is refused."""

from __future__ import annotations

import math
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from georef_gis.errors import InputError
from georef_gis.ingest.logs.column_map import ColumnMap
from georef_gis.ingest.logs.column_names import SYNONYMS, TARGETS, compact, understand
from georef_gis.ingest.logs.column_resolve import resolve
from georef_gis.ingest.logs.column_units import _TABLE, unit_of, units_of
from georef_gis.ingest.logs.unit_telling import (
    tell_angle_unit,
    tell_force_unit,
    tell_place_unit,
    tell_rate_unit,
    tell_speed_unit,
)

# Size in SI by hand: NIST SP 811 and the definitions of the mile and the nautical mile.
SIZES = {
    ("deg/s", "rate"): math.pi / 180, ("rad/s", "rate"): 1.0, ("mrad/s", "rate"): 1e-3,
    ("deg/h", "rate"): math.pi / 648000,
    ("g", "acceleration"): 9.80665, ("mg", "acceleration"): 9.80665e-3,
    ("m/s2", "acceleration"): 1.0, ("ft", "length"): 0.3048, ("m", "length"): 1.0,
    ("km/h", "speed"): 1 / 3.6, ("kn", "speed"): 1852 / 3600, ("mph", "speed"): 0.44704,
    ("ft/s", "speed"): 0.3048, ("deg", "angle"): math.pi / 180, ("rad", "angle"): 1.0,
    ("deg*1e7", "angle"): math.pi / 180e7, ("ms", "time"): 1e-3, ("us", "time"): 1e-6,
    ("s", "time"): 1.0, ("ms", "speed"): 1.0,
}  # fmt: skip


@pytest.mark.parametrize(("unit", "size"), SIZES.items(), ids=lambda v: str(v))
def test_size_of_a_unit_is_that_of_its_definition(unit, size) -> None:
    found = unit_of(*unit)
    assert found is not None
    assert found.factor == pytest.approx(size, rel=1e-15)


@given(
    name=st.sampled_from(sorted({n for n, d in SIZES if d != "time"})),
    value=st.floats(-1e9, 1e9, allow_subnormal=False),
)
def test_value_survives_a_way_to_si_and_back(name: str, value: float) -> None:
    for unit in units_of(name):
        assert value * unit.factor / unit.factor == pytest.approx(value, rel=1e-14)


HEADERS = {
    "gyro_x_deg_s": ("gyro_x", "deg/s"), "gyro_x_rad_s": ("gyro_x", "rad/s"),
    "GyrX": ("gyro_x", None), "gz[dps]": ("gyro_z", "deg/s"), "omega_y": ("gyro_y", None),
    "angular_velocity.x": ("gyro_x", None), "ax[g]": ("accel_x", "g"),
    "accel_z_m_s2": ("accel_z", "m/s2"), "AccY (m/s^2)": ("accel_y", "m/s2"),
    "Lat (deg)": ("lat", "deg"), "latitude": ("lat", None), "LatE7": ("lat", "deg*1e7"),
    "lng": ("lon", None), "alt_ft": ("height", "ft"),
    "Altitude (MSL)": ("height_orthometric", None),
    "altitude_above_seaLevel(feet)": ("height_orthometric", "ft"),
    "height_ellipsoidal_m": ("height_ellipsoidal", "m"), "TimeUS": ("time", "us"),
    "time_s": ("time", "s"), "timestamp_ms": ("time", "ms"), "millis": ("boot_time", "ms"),
    "iTOW": ("tow", "ms"), "tow_s": ("tow", "s"), "gps_week": ("gps_week", None),
    "speed [km/h]": ("ground_speed", "km/h"), "GSpd": ("ground_speed", None),
    "v_north": ("v_north", None), "vel_n_m_s": ("v_north", "m/s"), "velD": ("v_down", None),
    "roll_deg": ("roll", "deg"), "sigma_v_north": ("sigma_v_north", None),
    "sigma_down_m": ("sigma_down", "m"), "numSV": ("satellites", None),
}  # fmt: skip


@pytest.mark.parametrize(("header", "meaning"), HEADERS.items(), ids=HEADERS)
def test_header_is_understood(header: str, meaning: tuple[str, str | None]) -> None:
    found = understand(header)
    assert found is not None
    assert (found.target, found.unit.name if found.unit else None) == meaning


@pytest.mark.parametrize("header", ["temperature", "voltage", "id", "a", "x", "rssi_dbm", "#"])
def test_header_of_something_else_is_left_alone(header: str) -> None:
    assert understand(header) is None


@pytest.mark.parametrize("target", sorted(TARGETS))
def test_every_quantity_is_known_by_its_own_name(target: str) -> None:
    assert SYNONYMS[compact(target)] == target


def _columns(headers: list[str], block: dict[str, object] | None = None):
    mapping = ColumnMap.from_mapping(block or {})
    return resolve(headers, [""] * len(headers), mapping, "log.csv")


def test_mapping_goes_before_the_names() -> None:
    found = _columns(["lat", "lon", "GyroX"], {"lat": "lon:deg", "lon": "lat:deg"}).columns
    assert (found["lat"].index, found["lon"].index) == (1, 0)


def test_sign_number_and_unit_of_a_mapping() -> None:
    found = _columns(["a", "b:c", "d"], {"accel_z": "-#3:g", "gyro_x": "b:c:deg/s"}).columns
    assert (found["accel_z"].index, found["accel_z"].sign) == (2, -1.0)
    assert found["accel_z"].unit == unit_of("g", "acceleration")
    assert (found["gyro_x"].index, found["gyro_x"].unit) == (1, unit_of("deg/s", "rate"))


def test_mapped_column_keeps_the_unit_of_its_header() -> None:
    found = _columns(["Wz [deg/s]"], {"gyro_x": "Wz"}).columns
    assert found["gyro_x"].unit == unit_of("deg/s", "rate")


def test_p_q_r_are_rates_only_together() -> None:
    assert {"gyro_x", "gyro_y", "gyro_z"} <= _columns(["p", "q", "r", "t"]).columns.keys()
    assert "gyro_x" not in _columns(["p", "t"]).columns


def test_two_columns_of_one_name_clash() -> None:
    found = _columns(["gps_lat", "latitude", "lon"])
    assert found.clashes["lat"] == ("gps_lat", "latitude")


def test_axes_turn_into_forward_right_down() -> None:
    R = ColumnMap.from_strings(["axes=forward-left-up"]).R_body_from_sensor()
    assert np.array_equal(R @ [1.0, 2.0, 3.0], [1.0, -2.0, -3.0])
    R = ColumnMap.from_strings(["axes=right-forward-up"]).R_body_from_sensor()
    assert np.array_equal(R @ [1.0, 2.0, 3.0], [2.0, 1.0, -3.0])


def test_mapping_of_the_command_line_goes_before_that_of_the_project(tmp_path) -> None:
    block = ColumnMap.from_mapping({"time": "t:s", "imu*.csv": {"time": "u:ms"}, "lat": "y:deg"})
    both = block.merged(ColumnMap.from_strings(["lat=Y:rad", "gnss.csv/time=v:us"]))
    assert both.for_file(tmp_path / "IMU_1.CSV").columns["time"].column == "u"
    assert both.for_file(tmp_path / "gnss.csv").columns["time"].column == "v"
    assert both.for_file(tmp_path / "other.csv").columns["time"].column == "t"
    assert both.columns["lat"].column == "Y"


@pytest.mark.parametrize(
    ("texts", "words"),
    [
        (["gyrox=a:deg/s"], "did you mean gyro_x"),
        (["gyro_x"], "is not QUANTITY=COLUMN"),
        (["gyro_x="], "is not QUANTITY=COLUMN"),
        (["axes=forward-right-up"], "left-handed"),
        (["axes=forward-forward-up"], "three directions"),
        (["axes=up"], "three directions"),
        (["date=yesterday"], "is no date"),
        (["delimiter=pipe"], "is none of comma"),
        (["decimal=x"], "is '.' or ','"),
        (["events=maybe"], "is none of feedback"),
    ],
    ids=lambda v: v if isinstance(v, str) else "",
)
def test_bad_mapping_is_refused(texts: list[str], words: str) -> None:
    with pytest.raises(InputError, match=words) as caught:
        ColumnMap.from_strings(texts)
    assert "\n" not in str(caught.value)


def test_unknown_unit_of_a_mapped_column_is_named() -> None:
    with pytest.raises(InputError, match=r"'furlong' is no unit of gyro_x; use one of deg/s"):
        _columns(["GyroX"], {"gyro_x": "GyroX:furlong"})


def test_unit_of_another_quantity_is_refused() -> None:
    with pytest.raises(
        InputError, match=r"'deg/s' is no unit of accel_x.*--map 'accel_x = ax:unit"
    ):
        _columns(["ax [deg/s]"])


@given(st.sampled_from(["m/s2", "g", "mg"]), st.integers(0, 2**32 - 1))
def test_unit_of_a_force_is_told_by_gravity(name: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    unit = unit_of(name, "acceleration")
    assert unit is not None
    force = rng.normal([0.0, 0.0, -9.81 * rng.uniform(1.0, 1.2)], 1.5, (50, 3))
    assert tell_force_unit(force / unit.factor) == unit


def test_unit_of_a_rate_is_not_guessed() -> None:
    assert tell_rate_unit(np.full((100, 3), 3.0)) is None
    assert tell_rate_unit(np.full((100, 3), 120.0)) == unit_of("deg/s", "rate")
    assert tell_rate_unit(np.full((100, 3), 32000.0)) is None


def test_unit_of_places_and_angles_is_told_by_size_only() -> None:
    there = np.full(5, 39.6), np.full(5, -80.0)
    assert tell_place_unit(*there) == unit_of("deg", "angle")
    assert tell_place_unit(there[0] * 1e7, there[1] * 1e7) == unit_of("deg*1e7", "angle")
    assert tell_place_unit(np.radians(there[0]), np.radians(there[1])) is None
    assert tell_angle_unit(np.linspace(0.0, 359.0, 50)) == unit_of("deg", "angle")
    assert tell_angle_unit(np.linspace(-3.1, 3.1, 50)) is None


@given(st.sampled_from(["m/s", "km/h", "kn", "mph", "ft/s"]), st.floats(0.0, 6.28))
def test_unit_of_a_speed_is_told_by_the_fixes(name: str, course: float) -> None:
    unit = unit_of(name, "speed")
    assert unit is not None
    t = np.arange(0.0, 60.0, 0.2)
    lat = 0.69 + 18.0 * t * math.cos(course) / 6371000.0
    lon = -1.4 + 18.0 * t * math.sin(course) / 6371000.0 / math.cos(0.69)
    assert tell_speed_unit(t, lat, lon, np.full(len(t), 18.0 / unit.factor)) == unit
    still = np.zeros(len(t))
    assert tell_speed_unit(t, still, still, np.full(len(t), 18.0)) is None


def test_docs_list_every_quantity_and_unit_and_their_mapping_is_read() -> None:
    text = (Path(__file__).parents[2] / "docs" / "logs.md").read_text("utf-8")
    words = set(re.findall(r"[a-z_0-9*/]+", text))
    assert TARGETS.keys() <= words
    assert {u for row in _TABLE.values() for u, _, _ in row} <= words
    (block,) = re.findall(r"```toml\n(.*?)```", text, re.DOTALL)
    mapping = ColumnMap.from_mapping(tomllib.loads(block)["logs"]["columns"])
    assert mapping.columns["accel_z"].sign == -1.0
    assert mapping.columns["utc"].format == "%d.%m.%Y %H:%M:%S.%f"
    assert mapping.for_file(Path("imu_3.csv")).columns["time"].unit == unit_of("us", "time")
