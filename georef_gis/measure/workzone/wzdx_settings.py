"""What a person states of a zone's feed, and the places of its devices."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from georef_gis.errors import InputError
from georef_gis.measure.workzone.wzdx_rules import WzdxRules, wzdx_rules

VERIFIED = ("is_start_date_verified", "is_end_date_verified", "is_start_position_verified",
             "is_end_position_verified")  # fmt: skip
_MUST = ("publisher", "organization_name", "data_source_id", "road_names", "direction",
         "start_date", "end_date", "vehicle_impact", "devices", "id")  # fmt: skip
_OPTIONAL = ("version", "location_method", "name", "description", "contact_name", "contact_email",
             "update_frequency", "creation_date", "beginning_cross_street", "ending_cross_street",
             "beginning_milepost", "ending_milepost", "reduced_speed_limit_mph", "types_of_work",
             "cc0_license", "lane_count", "lane", "direction_as_signed", *VERIFIED)  # fmt: skip
_LISTS = {"road_names": '["I-79"]', "devices": '["T1", "G1"]', "types_of_work": '["painting"]'}
PLAIN = ("beginning_cross_street", "ending_cross_street", "beginning_milepost",
          "ending_milepost")  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class DevicePlace:
    """Place of a device: degrees of WGS 84, and semi axes (m) of its ellipse for 95 %."""

    name: str
    asset_id: str
    lon: float
    lat: float
    sigma_e: float
    sigma_n: float
    semi_major: float
    semi_minor: float
    azimuth: float


@dataclass(frozen=True, slots=True, kw_only=True)
class WzdxSettings:
    """Table [wzdx] of ``work_zone.toml``, its `source`, complete and with known keys only."""

    values: Mapping[str, Any]
    rules: WzdxRules
    source: str = ""

    @property
    def lines(self) -> list[str]:
        """Lines of devices, as drivers meet them."""
        return list(self.values["devices"])


def wzdx_settings(table: Mapping[str, Any], source: str, *, suggestion: str = "") -> WzdxSettings:
    """Settings of the feed.

    Parameters
    ----------
    suggestion
        What the devices say of `vehicle_impact`, for the user to confirm.

    Raises
    ------
    InputError
        Naming all that is missing at once, or a key that is none.
    """
    known = {*_MUST, *_OPTIONAL}
    for key in table.keys() - known:
        raise InputError(f"is no key; use {', '.join(sorted(known))}", source=source,
                         field=f"wzdx.{key}")  # fmt: skip
    try:
        rules = wzdx_rules(str(table.get("version") or "4.2"))
    except InputError as error:
        raise InputError(str(error), source=source) from error
    missing = [f"wzdx.{key}" for key in _MUST if table.get(key) in (None, "", [])]
    hints = {
        "wzdx.direction": f" ({', '.join(rules.words['direction'])})",
        "wzdx.vehicle_impact": f" (the devices suggest {suggestion}: confirm it)"
        if suggestion
        else "",
    }
    if missing:
        told = ", ".join(name + hints.get(name, "") for name in missing)
        raise InputError(f"fill in what is missing, it is not made up: {told}", source=source)
    for key, such in _LISTS.items():
        if key in table and not _is_texts(table[key]):
            raise InputError(f"must be a list of texts, such as {such}", source=source,
                             field=f"wzdx.{key}")  # fmt: skip
    for line, times in Counter(table["devices"]).items():
        if times > 1:
            raise InputError(f"names line {line} {times} times; the feed would run along it as "
                             "often: name each once", source=source,
                             field="wzdx.devices")  # fmt: skip
    if not isinstance(table.get("direction_as_signed", False), bool):
        raise InputError(f"{table['direction_as_signed']!r} is not true or false", source=source,
                         field="wzdx.direction_as_signed")  # fmt: skip
    _check_lanes(table, source)
    return WzdxSettings(values=dict(table), rules=rules, source=source)


def _is_texts(value: Any) -> bool:
    return isinstance(value, list) and all(isinstance(one, str) and one for one in value)


def _check_lanes(table: Mapping[str, Any], source: str) -> None:
    lanes = table.get("lane", [])
    if not isinstance(lanes, list) or not all(isinstance(lane, dict) for lane in lanes):
        raise InputError("must stand as [[wzdx.lane]]", source=source, field="wzdx.lane")
    count = table.get("lane_count", 0)
    if lanes and count != len(lanes):
        raise InputError(
            f"{len(lanes)} lanes are listed, lane_count says {count}; list all lanes of the "
            "road, or none",
            source=source,
            field="wzdx.lane",
        )
