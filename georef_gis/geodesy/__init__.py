"""Places on the Earth: heights, CRS, datums and the map (the only importer of pyproj)."""

from __future__ import annotations

from pyproj import CRS
from pyproj.network import set_network_enabled  # type: ignore[attr-defined]

from georef_gis.ellipsoid import (
    WGS84_A,
    WGS84_E2,
    WGS84_F,
    Origin,
    ecef_from_geo,
    geo_from_ecef,
    meridian_radius,
    prime_vertical_radius,
)
from georef_gis.geodesy.heights import Height, HeightKind, geoid_undulation
from georef_gis.geodesy.map_frame import MapFrame
from georef_gis.geodesy.reference_systems import (
    UNKNOWN_DATUM_SIGMA,
    Datum,
    horizontal_crs,
    map_crs,
    metres_per_unit,
    parse_crs,
    same_crs,
    utm_crs,
)

__all__ = [
    "CRS",
    "UNKNOWN_DATUM_SIGMA",
    "WGS84_A",
    "WGS84_E2",
    "WGS84_F",
    "Datum",
    "Height",
    "HeightKind",
    "MapFrame",
    "Origin",
    "ecef_from_geo",
    "geo_from_ecef",
    "geoid_undulation",
    "horizontal_crs",
    "map_crs",
    "meridian_radius",
    "metres_per_unit",
    "parse_crs",
    "prime_vertical_radius",
    "same_crs",
    "utm_crs",
]

# A silent download in the middle of a run would make results depend on the network.
set_network_enabled(False)
