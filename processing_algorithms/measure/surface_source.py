"""The surface that a tool measures on: the adjusted points, the ground, or a raster of heights."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from georef_gis.errors import CrsError, InputError
from georef_gis.geodesy import (
    CRS,
    MapFrame,
    geoid_undulation,
    horizontal_crs,
    metres_per_unit,
    parse_crs,
)
from georef_gis.measure.surface_field import GroundField, HeightField
from georef_gis.measure.surface_points import PointField
from georef_gis.measure.surface_raster import SIGMA_BAND
from georef_gis.model.terrain import DemTerrain, dem_terrain
from georef_gis.model.tie_points import GroundPoints
from georef_gis.model.tin import TinTerrain
from georef_gis.project import Project
from georef_gis.rasters.reading import Window, read_grid, read_grid_header
from processing_algorithms.site import Site, load_ground, load_site, mostly_adjusted

if TYPE_CHECKING:
    from georef_gis.frames import Array

Source = Literal["auto", "points", "ground"]
# m, one sigma of a raster's heights where nothing is stated
RASTER_SIGMA = 1.0
# cells of a raster that are read at most
MOST_CELLS = 50_000_000
# EPSG code of a vertical CRS -> geoid
_GEOIDS = {5773: "egm96", 3855: "egm2008", 5703: "geoid18", 6360: "geoid18", 8228: "geoid18",
           6647: "cgvd2013"}  # fmt: skip


def project_field(project: Project, source: Source, *, quick: bool = False) -> HeightField:
    """Surface of a project.

    Parameters
    ----------
    source
        "points": the adjusted points, flat triangles between them; "ground": what the photos are
        laid on; "auto": the points where there are some, unless the ground is the user's DEM.

    Raises
    ------
    InputError
        If there are no adjusted points and they are asked for.
    """
    site = load_site(project, quick=quick)
    level = block_level(site)
    path = project.adjustment / "points.npz"
    adjusted = mostly_adjusted(site.pose_kinds.values())
    if source == "points" and not (adjusted and path.exists()):
        raise InputError(
            "the photos were not adjusted: there are no points; run `georef run`, or take the "
            "ground", field="of",
        )  # fmt: skip
    user_dem = project.settings.ground.dem is not None
    if source == "points" or (source == "auto" and adjusted and path.exists() and not user_dem):
        return PointField.of(load_adjusted_points(project), level=level, scale=_scale(project))
    terrain = load_ground(project, site.frame, adjusted=adjusted)
    what = {"tin": "ground as a TIN of adjusted points, smoothed", "plane": "ground as a plane"}
    if isinstance(terrain, TinTerrain):
        # the photos share the level that the points have among their own
        return GroundField.of(terrain, what[terrain.kind], level=level)
    name = "DEM of the project" if isinstance(terrain, DemTerrain) else "flat ground"
    return GroundField.of(terrain, name, level=level)


def load_adjusted_points(project: Project) -> GroundPoints:
    """Points that the adjustment left.

    Raises
    ------
    InputError
        If there are none, or their file is broken.
    """
    from georef_gis.orient.adjustment.keep import POINTS, load_points

    path = project.adjustment / POINTS
    if not path.exists():
        raise InputError("there are no adjusted points; run `georef run`", source=str(path))
    return load_points(path)


def block_level(site: Site) -> float:
    """One sigma of a shift of photos and ground together, m."""
    return max(photo.pose.sigma_height_shared for photo in site.photos.values())


def _scale(project: Project) -> float:
    """One sigma of the scale of the block as its longest judged distances have it, as a share."""
    path = project.adjustment / "report.json"
    try:
        distances = json.loads(path.read_text(encoding="utf-8"))["distances"]
    except (OSError, ValueError, KeyError):
        return 0.0
    if not distances:
        return 0.0
    longest = max(distances, key=lambda one: one["length_m"])
    return float(longest["sigma_m"]) / float(longest["length_m"])


def chosen_field(
    project: Project, frame: MapFrame, source: Source, raster: Path | None, around: Any,
    *, sigma: float | None = None, quick: bool = False,
) -> HeightField:  # fmt: skip
    """Surface of the project, or of a raster about some shapes of the map.

    Parameters
    ----------
    around
        Shape (shapely) in CRS units that a raster must cover.
    """
    import shapely

    if raster is None:
        return project_field(project, source, quick=quick)
    xy = shapely.get_coordinates(around)
    level = np.full((len(xy), 1), frame.origin.height_ellipsoidal)
    places = frame.enu_from_map(np.hstack([xy, level]))[:, :2]
    return raster_field(project, frame, raster, around=places, sigma=sigma)


def on_plane(frame: MapFrame, shape: Any, field: HeightField) -> Any:
    """Shape of the map on the project's own plane, at the height of a surface; m in enu."""
    import shapely

    def moved(xy: Array) -> Array:
        level = np.nan_to_num(
            field.height_on_map(frame, xy), nan=float(frame.origin.height_ellipsoidal)
        )
        return frame.enu_from_map(np.column_stack([xy, level]))[:, :2]

    return shapely.transform(shape, moved)


# -- rasters -----------------------------------------------------------------------------------


def raster_field(
    project: Project, frame: MapFrame, path: Path, *, around: Array, sigma: float | None
) -> HeightField:
    """Surface from a raster of heights of any CRS.

    Its kind of height, and their unit, are those of its CRS' vertical part; without one the kind is
    that of [ground] dem_height_kind. A second band is its sigma, if it is one of ours.

    Parameters
    ----------
    around : shape (n, 2), m
        Places in enu that must be covered.
    sigma : m
        One sigma of its heights where it has no band of them.

    Raises
    ------
    InputError
        If it cannot be read or does not lie there.
    """
    header = read_grid_header(path)
    if not header.crs_wkt:
        raise CrsError("has no CRS; add a .prj beside it", source=str(path), field="CRS")
    crs = parse_crs(header.crs_wkt)
    own = MapFrame(frame.origin, horizontal_crs(crs), gnss_datum=frame.gnss_datum)
    window = _window(own, header, around, path)
    raster = read_grid(path, window=window)
    a, b, left, d, e, top = raster.transform
    if b or d or a <= 0 or e >= 0:
        raise InputError("is not north-up; warp it to a north-up raster", source=str(path))
    heights = raster.values.astype(np.float64) * _unit(crs)
    heights += _undulation(project, own, crs, raster, path)
    cell = abs(a) * metres_per_unit(own.horizontal) if own.horizontal.is_projected else \
        math.radians(a) * 6.37e6 * math.cos(frame.origin.lat)  # fmt: skip
    own_sigma = _sigma_band(path, window)
    terrain = dem_terrain(
        own, heights, left=left, top=top, cell=(a, -e), metres_per_unit=cell / a,
        sigma=sigma if sigma is not None else own_sigma or RASTER_SIGMA,
    )  # fmt: skip
    return GroundField.of(terrain, f"raster {path.name}")


def _window(own: MapFrame, header: Any, around: Array, path: Path) -> Window:
    """Columns and rows of a raster about some places, with a margin of a third."""
    low, high = around.min(axis=0), around.max(axis=0)
    reach = 0.35 * float(np.max(high - low)) + 5.0
    corners = np.array([[x, y, 0.0] for x in (low[0] - reach, high[0] + reach)
                        for y in (low[1] - reach, high[1] + reach)])  # fmt: skip
    p = own.map_from_enu(corners)[:, :2]
    a, _, left, _, e, top = header.transform
    cols = np.clip(np.array([(p[:, 0] - left) / a]), 0, header.width)
    rows = np.clip(np.array([(p[:, 1] - top) / e]), 0, header.height)
    c0, r0 = int(np.floor(cols.min())), int(np.floor(rows.min()))
    width, height = int(np.ceil(cols.max())) - c0, int(np.ceil(rows.max())) - r0
    if width < 2 or height < 2:
        raise InputError("does not lie where the shape is; check its CRS", source=str(path))
    if width * height > MOST_CELLS:
        raise InputError(
            f"has {width * height / 1e6:.0f} million cells about the shape; take a coarser raster",
            source=str(path),
        )
    return (c0, r0, width, height)


def _undulation(project: Project, own: MapFrame, crs: CRS, raster: Any, path: Path) -> float:
    """What the raster's zero of height lies above the ellipsoid, m, at its middle."""
    geoid = _geoid_of(project, crs, path)
    if geoid is None:
        return 0.0
    a, _, left, _, e, top = raster.transform
    rows, cols = raster.values.shape
    middle = own.geo_from_map(np.array([left + a * cols / 2, top + e * rows / 2, 0.0]))
    return float(geoid_undulation(middle[0], middle[1], geoid=geoid))


def _unit(crs: CRS) -> float:
    """Metres per unit of the heights of a CRS."""
    up = crs.sub_crs_list[1].axis_info if crs.is_compound else crs.axis_info[2:]
    return float(up[0].unit_conversion_factor) if up else 1.0


def _geoid_of(project: Project, crs: CRS, path: Path) -> str | None:
    """Geoid of a raster's heights; None where they are above the ellipsoid."""
    settings = project.settings
    if crs.is_compound:
        code = crs.sub_crs_list[1].to_epsg()
        found = _GEOIDS.get(code or 0)
        if found is None:
            raise CrsError(
                f"heights of '{crs.sub_crs_list[1].name}' are of no geoid that is known",
                source=str(path),
            )
        return found
    told = _bands_told(path)
    if len(crs.axis_info) == 3 or (SIGMA_BAND in told[1:2] and "ellipsoid" in told[0]):
        return None
    if settings.ground.dem_height_kind == "ellipsoidal":
        return None
    return settings.gnss.geoid


def _bands_told(path: Path) -> tuple[str, ...]:
    """Names of a raster's bands."""
    from georef_gis.rasters.resampled import open_bands

    with open_bands(path) as bands:
        return tuple(bands.header.bands)


def _sigma_band(path: Path, window: Window) -> float | None:
    """Root mean square of the second band where a raster is one of ours; None elsewhere."""
    if SIGMA_BAND not in _bands_told(path)[1:2]:
        return None
    values = read_grid(path, window=window, band=2).values
    return float(np.sqrt(np.nanmean(values.astype(np.float64) ** 2)))
