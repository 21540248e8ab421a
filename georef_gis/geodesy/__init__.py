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
from georef_gis.geodesy.geoids import geoid_undulation
from georef_gis.geodesy.grids_folder import drop_foreign_databases, use_grids
from georef_gis.geodesy.heights import Height, HeightKind
from georef_gis.geodesy.map_frame import MapFrame
from georef_gis.geodesy.map_systems import differ_only_in_foot, map_crs, parse_crs
from georef_gis.geodesy.reference_systems import (
    UNKNOWN_DATUM_SIGMA,
    Datum,
    horizontal_crs,
    metres_per_unit,
    same_crs,
    utm_crs,
)
from georef_gis.geodesy.vertical import VerticalPart, height_unit, navd88_code, vertical_part

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
    "VerticalPart",
    "differ_only_in_foot",
    "ecef_from_geo",
    "geo_from_ecef",
    "geoid_undulation",
    "height_unit",
    "horizontal_crs",
    "map_crs",
    "meridian_radius",
    "metres_per_unit",
    "navd88_code",
    "parse_crs",
    "prime_vertical_radius",
    "same_crs",
    "use_grids",
    "utm_crs",
    "vertical_part",
]

# A silent download in the middle of a run would make results depend on the network.
set_network_enabled(False)
drop_foreign_databases()
use_grids()
