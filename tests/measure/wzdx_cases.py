"""A work zone as somebody fills it in, and devices to export it with."""

from __future__ import annotations

import copy
from typing import Any

from georef_gis.measure.workzone.wzdx_settings import DevicePlace

FULL: dict[str, Any] = {
    "version": "4.2",
    "id": "0d2b7f0e-6a52-4a1c-9f2e-0c1f5d1f2a11",
    "publisher": "State DOT",
    "organization_name": "District 6",
    "data_source_id": "5b9b4b0a-8f0e-4a38-8a0f-0f5c3b2b6d11",
    "road_names": ["I-79", "Jennings Randolph Expressway"],
    "direction": "northbound",
    "start_date": "2026-03-31T06:00:00Z",
    "end_date": "2026-04-30T18:00:00Z",
    "vehicle_impact": "some-lanes-closed-merge-left",
    "location_method": "channel-device-method",
    "devices": ["T1"],
}
OPTIONAL: dict[str, Any] = {
    "name": "Bridge deck <b>",
    "description": 'Deck "repair" 🚧',
    "contact_name": "A. Person",
    "contact_email": "a.person@example.gov",
    "update_frequency": 300,
    "creation_date": "2026-03-01T12:00:00-05:00",
    "beginning_cross_street": "Exit 117",
    "ending_milepost": 118.4,
    "reduced_speed_limit_mph": 45,
    "types_of_work": ["surface-work", "painting"],
    "cc0_license": True,
    "is_start_position_verified": True,
    "lane_count": 2,
    "lane": [
        {"order": 2, "type": "general", "status": "closed"},
        {"order": 1, "type": "general", "status": "open",
         "restrictions": [{"type": "no-trucks"}]},
    ],
}  # fmt: skip


def table(**changes: Any) -> dict[str, Any]:
    """[wzdx] complete; None takes a key away."""
    out = copy.deepcopy(FULL) | changes
    return {key: value for key, value in out.items() if value is not None}


def places(n: int = 3) -> list[DevicePlace]:
    return [
        DevicePlace(name=f"C{k}", asset_id=f"id-{k}", lon=-80.46712345678 + 1e-4 * k,
                    lat=39.097123456789 + 1e-4 * k, sigma_e=0.02, sigma_n=0.03, semi_major=0.08,
                    semi_minor=0.05, azimuth=12.0)
        for k in range(n)
    ]  # fmt: skip
