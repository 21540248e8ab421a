"""The DEM as an ESRI ASCII grid in UTM with orthometric heights."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from georef_gis.simulate import ellipsoid, site
from georef_gis.simulate.flight import SimulatedFlight

Array = NDArray[np.float64]

CELL = 2.0  # m
HALF_SIZE = 200.0  # m from the origin to each side
UTM17_WKT = (
    'PROJCS["WGS_1984_UTM_Zone_17N",GEOGCS["GCS_WGS_1984",DATUM["D_WGS_1984",'
    'SPHEROID["WGS_1984",6378137.0,298.257223563]],PRIMEM["Greenwich",0.0],'
    'UNIT["Degree",0.0174532925199433]],PROJECTION["Transverse_Mercator"],'
    'PARAMETER["False_Easting",500000.0],PARAMETER["False_Northing",0.0],'
    'PARAMETER["Central_Meridian",-81.0],PARAMETER["Scale_Factor",0.9996],'
    'PARAMETER["Latitude_Of_Origin",0.0],UNIT["Meter",1.0]]'
)


def write_dem(flight: SimulatedFlight, folder: Path) -> list[Path]:
    """Write ``dem.asc`` (bare ground with the DEM's error, EGM96 heights, m) and ``dem.prj``."""
    corner, height = dem_cells()
    height = height + _smooth_error(height.shape, flight)
    rows, cols = height.shape
    head = (
        f"ncols {cols}\nnrows {rows}\nxllcorner {corner[0]:.1f}\nyllcorner {corner[1]:.1f}\n"
        f"cellsize {CELL:.1f}\nNODATA_value -9999\n"
    )
    body = "\n".join(" ".join(f"{z:.2f}" for z in row) for row in height)
    grid, projection = folder / "dem.asc", folder / "dem.prj"
    grid.write_text(head + body + "\n", encoding="ascii")
    projection.write_text(UTM17_WKT + "\n", encoding="ascii")
    return [grid, projection]


def dem_cells() -> tuple[Array, Array]:
    """Outer lower-left corner in UTM, shape (2,), and true heights at cell centres, top row first.

    Notes
    -----
    The inverse of the projection is a Newton iteration on the forward lines.
    """
    middle = ellipsoid.utm17_from_geodetic(np.asarray(site.ORIGIN_LAT), np.asarray(site.ORIGIN_LON))
    corner = np.floor((middle - HALF_SIZE) / CELL) * CELL
    count = round(2 * HALF_SIZE / CELL)
    x = corner[0] + CELL * (np.arange(count) + 0.5)
    y = corner[1] + CELL * (np.arange(count)[::-1] + 0.5)
    lat, lon = geodetic_from_utm17(np.stack(np.meshgrid(x, y), axis=-1))
    return corner, site.ground_height(lat, lon) - site.geoid_height(lat, lon)


def geodetic_from_utm17(p_map: Array) -> tuple[Array, Array]:
    """Latitude and longitude, rad, of UTM 17 N points near the site, shape (..., 2), m."""
    lat0, lon0 = np.asarray(site.ORIGIN_LAT), np.asarray(site.ORIGIN_LON)
    d = 1e-6
    base = ellipsoid.utm17_from_geodetic(lat0, lon0)
    slope = np.stack(
        [
            (ellipsoid.utm17_from_geodetic(lat0 + d, lon0) - base) / d,
            (ellipsoid.utm17_from_geodetic(lat0, lon0 + d) - base) / d,
        ],
        axis=-1,
    )
    inverse = np.linalg.inv(slope)
    place = np.broadcast_to(np.array([site.ORIGIN_LAT, site.ORIGIN_LON]), p_map.shape)
    for _ in range(6):
        miss = p_map - ellipsoid.utm17_from_geodetic(place[..., 0], place[..., 1])
        place = place + miss @ inverse.T
    return place[..., 0], place[..., 1]


def _smooth_error(shape: tuple[int, ...], flight: SimulatedFlight) -> Array:
    """Error of `dem_sigma` with a correlation length of a few cells."""
    rng = np.random.default_rng([flight.seed, 9])
    white = np.fft.rfft2(rng.normal(size=shape))
    f = np.hypot(np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1])[None, :])
    field = np.fft.irfft2(white * np.exp(-((f / 0.06) ** 2)), s=shape)
    return np.asarray(flight.settings.dem_sigma * field / field.std())
