"""The zone as a WZDx work zone feed: GeoJSON that navigation services read.

Only what is measured comes from here: the positions of the first and the last device and those
between, and widths of lanes. All else a person states. How sure the positions are has no place in
the standard and goes to a file beside it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from datetime import UTC, date, datetime
from typing import Any

from georef_gis.errors import ExportError, InputError
from georef_gis.measure.workzone.verdicts import CERTAIN, Finding
from georef_gis.measure.workzone.wzdx_direction import direction_doubts
from georef_gis.measure.workzone.wzdx_rules import WzdxRules, check_feed
from georef_gis.measure.workzone.wzdx_settings import PLAIN, VERIFIED, DevicePlace, WzdxSettings
from georef_gis.units import INTERNATIONAL_FOOT as FOOT

# deg; 0.1 mm
DECIMALS = 9
_KPH_PER_MPH = 1.609344
# z of the one-sided probability from which a requirement counts as met
_Z_PASS = 1.6448536269514722


def suggested_impact(offset_to_left: float) -> str:
    """What a merging taper says of `vehicle_impact`: devices shift to the left of the traffic.

    Parameters
    ----------
    offset_to_left
        From the first to the last device, m.
    """
    return f"some-lanes-closed-merge-{'left' if offset_to_left > 0 else 'right'}"


def build_feed(
    settings: WzdxSettings,
    places: Sequence[DevicePlace],
    *,
    widths: Sequence[Finding] = (),
    now: datetime,
) -> dict[str, Any]:
    """Feed of one work zone, found valid.

    Parameters
    ----------
    places
        Devices from the first to the last that drivers meet.
    widths
        Widths of lanes to state as restrictions, each at its narrowest device.

    Raises
    ------
    InputError
        If there are fewer than two devices, or they run against the stated direction.
    ExportError
        If the feed breaks a rule of the standard, with all that it breaks.
    """
    if len(places) < 2:
        raise InputError(f"{len(places)} devices on the lines {', '.join(settings.lines)}; a zone "
                         "has a first and a last one", source=settings.source,
                         field="wzdx.devices")  # fmt: skip
    # what is doubtful is the caller's to tell
    direction_doubts(settings, places)
    values, rules = settings.values, settings.rules
    feed = {
        "feed_info": _feed_info(values, rules, now),
        "type": "FeatureCollection",
        "features": [
            {
                "id": str(values["id"]),
                "type": "Feature",
                "properties": _properties(values, widths),
                "geometry": _geometry(places),
            }
        ],
    }
    problems = check_feed(feed, rules.version)
    if problems:
        few = "; ".join(problems[:8]) + (f"; and {len(problems) - 8} more"
                                         if len(problems) > 8 else "")  # fmt: skip
        raise ExportError(f"WZDx {rules.version} would not take the feed: {few}; correct [wzdx]")
    return feed


def _feed_info(values: Mapping[str, Any], rules: WzdxRules, now: datetime) -> dict[str, Any]:
    contact = {
        key: values[key] for key in ("contact_name", "contact_email", "update_frequency")
        if values.get(key)
    }  # fmt: skip
    info: dict[str, Any] = {
        "publisher": values["publisher"],
        "version": rules.version,
        "update_date": _utc(now),
        "data_sources": [
            {
                "data_source_id": values["data_source_id"],
                "organization_name": values["organization_name"],
            }
        ],
        **contact,
    }
    return info | ({"license": rules.licence} if values.get("cc0_license") else {})


def _properties(values: Mapping[str, Any], widths: Sequence[Finding]) -> dict[str, Any]:
    core = {
        "data_source_id": values["data_source_id"],
        "event_type": "work-zone",
        "road_names": list(values["road_names"]),
        "direction": values["direction"],
        **{key: values[key] for key in ("name", "description") if values.get(key)},
    }
    if values.get("creation_date"):
        core["creation_date"] = _utc(values["creation_date"])
    out: dict[str, Any] = {
        "core_details": core,
        "start_date": _utc(values["start_date"]),
        "end_date": _utc(values["end_date"]),
        **{key: values.get(key, False) for key in VERIFIED},
        "location_method": values.get("location_method") or "channel-device-method",
        "vehicle_impact": values["vehicle_impact"],
        **{key: values[key] for key in PLAIN if values.get(key) not in (None, "")},
    }
    limit = values.get("reduced_speed_limit_mph")
    if limit:
        is_number = isinstance(limit, int | float)
        out["reduced_speed_limit_kph"] = round(limit * _KPH_PER_MPH, 2) if is_number else limit
    if values.get("types_of_work"):
        out["types_of_work"] = [{"type_name": one} for one in values["types_of_work"]]
    if values.get("lane"):
        out["lanes"] = sorted(values["lane"], key=lambda lane: str(lane.get("order")).zfill(3))
    # a width of nothing would close the lane to everyone
    if told := [width for width in widths if stated_width(width) > 0.0]:
        out["restrictions"] = [_restriction(width) for width in told]
    return out


def _restriction(width: Finding) -> dict[str, Any]:
    return {"type": "reduced-width", "value": stated_width(width), "unit": "feet"}


def stated_width(width: Finding) -> float:
    """Width to state, ft: one that the lane has with the probability of a pass, rounded down."""
    # Else 0.1 ft would be lost to the last digit of a float.
    return max(math.floor(certain_width(width) / FOOT * 10.0 + 1e-9) / 10.0, 0.0)


def certain_width(width: Finding) -> float:
    """Width, m, that a lane has at a device with the probability of a pass."""
    return width.value - _Z_PASS * width.sigma


def _geometry(places: Sequence[DevicePlace]) -> dict[str, Any]:
    coordinates = [[round(p.lon, DECIMALS), round(p.lat, DECIMALS)] for p in places]
    kind = "LineString" if len(coordinates) > 2 else "MultiPoint"
    return {"type": kind, "coordinates": coordinates}


def _utc(value: Any) -> Any:
    """UTC text of a time; what is none stays as it is and is found by the check."""
    if isinstance(value, datetime) and value.tzinfo is not None:
        told = value.astimezone(UTC).isoformat(timespec="seconds")
        return told.replace("+00:00", "Z")
    if isinstance(value, date):
        # TOML has times and dates without a zone; which one is meant is not ours to say
        return str(value)
    try:
        return _utc(datetime.fromisoformat(value)) if "T" in str(value).upper() else value
    except (TypeError, ValueError):
        return value


def accuracy_file(
    places: Sequence[DevicePlace],
    *,
    widths: Sequence[Finding],
    datum: tuple[str, float],
    assumption: str,
    settings: WzdxSettings,
) -> dict[str, Any]:
    """JSON-able account of how sure the feed's positions and widths are.

    Parameters
    ----------
    datum
        Its name, and what it may hide where it is unknown, m.
    assumption
        What the covariance rests on.
    """
    return {
        "about": "How sure the positions and widths of the WZDx feed beside this file are; one "
        "sigma in m, semi axes of the error ellipses for 95 %, azimuth in degrees clockwise from "
        "grid north. The standard has no place for it.",
        "id": settings.values["id"],
        "version": settings.rules.version,
        "datum": datum[0],
        "datum_sigma_m": datum[1],
        "covariance": assumption,
        "devices": [_device_json(place) for place in places],
        "lane_widths": [_width_json(width) for width in widths],
    }


def _device_json(place: DevicePlace) -> dict[str, Any]:
    return {
        "name": place.name,
        "asset_id": place.asset_id,
        "longitude": round(place.lon, DECIMALS),
        "latitude": round(place.lat, DECIMALS),
        "sigma_e_m": round(place.sigma_e, 4),
        "sigma_n_m": round(place.sigma_n, 4),
        "semi_major_95_m": round(place.semi_major, 4),
        "semi_minor_95_m": round(place.semi_minor, 4),
        "azimuth_deg": round(place.azimuth, 1),
    }


def _width_json(width: Finding) -> dict[str, Any]:
    return {
        "lane": width.subject,
        "width_m": round(width.value, 4),
        "sigma_m": round(width.sigma, 4),
        "stated_ft": stated_width(width),
        "stated": f"a width it has there with a probability of {CERTAIN:.0%}, rounded down",
    }
