"""What the tools that write rasters share: profile, band names, ground range, progress."""

from __future__ import annotations

import numpy as np

from georef_gis.geodesy import MapFrame
from georef_gis.model.grid import Grid
from georef_gis.model.layers import Footprint
from georef_gis.model.mesh import Ground
from georef_gis.model.terrain import DemTerrain, Terrain
from georef_gis.project import Project
from georef_gis.rasters.profile import RasterProfile
from processing_algorithms.site import POSE_KINDS, Site

_BANDS = {1: ("grey",), 3: ("red", "green", "blue"), 4: ("red", "green", "blue", "band 4")}


def band_names(project: Project, bands: int) -> tuple[str, ...]:
    """Names of the bands: those of project.toml if their number fits, else by the number."""
    names = project.settings.products.band_names
    if len(names) == bands:
        return names
    return _BANDS.get(bands, tuple(f"band {i + 1}" for i in range(bands)))


def profile_for(
    project: Project, frame: MapFrame, grid: Grid, *, bands: int, dtype: str, title: str
) -> RasterProfile:
    """Profile of a product as project.toml wants it.

    16-bit photos cannot be JPEG or WEBP: they become DEFLATE.
    """
    products = project.settings.products
    compression = products.compression
    if dtype != "uint8" or (compression in ("jpeg", "webp") and bands not in (1, 3)):
        compression = compression if compression in ("deflate", "zstd") else "deflate"
    return RasterProfile(
        width=grid.width,
        height=grid.height,
        transform=grid.transform,
        crs_wkt=grid.crs_wkt,
        epsg=frame.horizontal.to_epsg(),
        bands=bands,
        dtype=dtype,
        compression=compression,
        quality=products.quality,
        band_descriptions=band_names(project, bands),
        metadata={
            "TITLE": title,
            "SOFTWARE": "georef_gis",
            "DATUM": f"positions {frame.gnss_datum}, map {frame.crs_datum}",
            **_poses(project),
        },
    )


def _poses(project: Project) -> dict[str, str]:
    """Item that says which kinds of poses the footprints, and so the products, are made from."""
    count = {kind: project.database.count("footprint", {"pose_kind": kind}) for kind in POSE_KINDS}
    told = ", ".join(f"{kind} ({n} photos)" for kind, n in count.items() if n)
    return {"POSES": told} if told else {}


def ground_range(terrain: Terrain) -> tuple[float, float]:
    """Lowest and highest ellipsoidal height of the ground, m."""
    if isinstance(terrain, DemTerrain):
        return float(np.nanmin(terrain.heights)), float(np.nanmax(terrain.heights))
    height = float(getattr(terrain, "height_ellipsoidal", 0.0))
    return height, height


def ground_of(site: Site, grid: Grid) -> Ground:
    """The site's ground as a grid sees it."""
    return Ground.of(site.frame, grid, site.terrain, ground_range(site.terrain))


def reach_of(footprint: Footprint) -> float:
    """Largest distance, m, from the middle of a footprint to its rim."""
    xy = footprint.ring_enu[:-1, :2]
    return float(np.hypot(*(xy - xy.mean(axis=0)).T).max())
