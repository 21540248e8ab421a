"""What several tools share: a project's frame, ground and oriented photos as model values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from georef_gis.errors import CrsError, InputError
from georef_gis.frames import Array
from georef_gis.geodesy import (
    Height,
    HeightKind,
    MapFrame,
    geoid_undulation,
    horizontal_crs,
    metres_per_unit,
    parse_crs,
)
from georef_gis.model.layers import Footprint
from georef_gis.model.photo import Geotag, OrientedPhoto
from georef_gis.model.terrain import DemTerrain, FlatTerrain, Terrain, dem_terrain
from georef_gis.project import Project
from georef_gis.project.records import camera_of, footprint_of, load_frame, photo_of, pose_of
from georef_gis.rasters.reading import read_grid, read_grid_header
from georef_gis.units import INTERNATIONAL_FOOT, US_SURVEY_FOOT

# m; how far around the photos a DEM is read
DEM_MARGIN = 600.0
# m, one sigma of a DEM's height where the user states none
DEM_SIGMA = 1.0
# later kinds stand for better poses
POSE_KINDS = ("tags", "navigation", "adjusted")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Site:
    """Oriented photos over the ground of a project, in the order of the database."""

    frame: MapFrame
    terrain: Terrain
    photos: dict[str, OrientedPhoto]
    pose_kinds: dict[str, str]
    doubts: dict[str, list[str]]

    @property
    def gsd_unit(self) -> float:
        """Metres per unit of the map."""
        return metres_per_unit(self.frame.horizontal)


def load_site(project: Project, *, quick: bool = False) -> Site:
    """Site with the best pose of every photo; with `quick` the tags' own.

    Raises
    ------
    InputError
        If no photo has a pose.
    """
    database = project.database
    frame = load_frame(database)
    cameras = {row["camera_id"]: camera_of(row) for row in database.rows("camera")}
    poses: dict[str, Any] = {}
    for kind in POSE_KINDS[:1] if quick else POSE_KINDS:
        poses |= {row["photo_id"]: row for row in database.rows("pose", {"kind": kind})}
    photos, kinds, doubts = {}, {}, {}
    for row in database.rows("photo"):
        pose = poses.get(row["photo_id"])
        if pose is None:
            continue
        photo = photo_of(row)
        camera = cameras[photo.camera_id].turned((pose["extra"] or {}).get("turned_deg", 0))
        oriented = OrientedPhoto(photo=photo, camera=camera, pose=pose_of(pose))
        photos[photo.id] = oriented
        kinds[photo.id] = pose["kind"]
        doubts[photo.id] = [*(row["doubts"] or ()), *(pose["doubts"] or ())]
    if not photos:
        raise InputError("no photo has a pose; run `georef run`", source=str(database.path))
    terrain = load_ground(project, frame)
    return Site(frame=frame, terrain=terrain, photos=photos, pose_kinds=kinds, doubts=doubts)


def middle_of(tags: Sequence[Geotag]) -> tuple[float, float]:
    """Latitude and longitude, rad, amid positions: the median, across the 180th meridian too."""
    lat = float(np.median([tag.lat for tag in tags]))
    first = tags[0].lon
    turn = 2.0 * np.pi
    east = [(tag.lon - first + np.pi) % turn - np.pi for tag in tags]
    lon = (first + float(np.median(east)) + np.pi) % turn - np.pi
    return lat, float(lon)


def load_footprints(project: Project) -> dict[str, Footprint]:
    """Footprints of the project by photo.

    Raises
    ------
    InputError
        If there are none.
    """
    rows = project.database.rows("footprint")
    if not rows:
        raise InputError(
            "no footprints were made yet; run `georef run`", source=str(project.database.path)
        )
    return {row["photo_id"]: footprint_of(row) for row in rows}


# -- ground ------------------------------------------------------------------------------------


def ground_facts(terrain: Terrain, source: str, dem: Path | None) -> dict[str, Any]:
    """JSON-able description of the ground for the project database."""
    facts: dict[str, Any] = {"source": source, "sigma_m": terrain.sigma}
    if isinstance(terrain, FlatTerrain):
        return {**facts, "kind": "flat", "height_ellipsoidal_m": terrain.height_ellipsoidal}
    return {**facts, "kind": "dem", "path": str(dem)}


def load_ground(project: Project, frame: MapFrame) -> Terrain:
    """Ground that the orientation of the photos settled on.

    Raises
    ------
    InputError
        If the photos were not oriented yet.
    """
    facts = project.database.meta("ground")
    if facts is None:
        raise InputError(
            "the photos have no poses yet; run `georef run`", source=str(project.database.path)
        )
    if facts["kind"] == "flat":
        return FlatTerrain(
            origin=frame.origin,
            height_ellipsoidal=facts["height_ellipsoidal_m"],
            sigma=facts["sigma_m"],
        )
    positions = [
        [row["x_enu"], row["y_enu"], row["z_enu"]] for row in project.database.rows("pose")
    ]
    return read_dem(project, frame, np.array(positions))


def read_dem(project: Project, frame: MapFrame, positions_enu: Array) -> DemTerrain:
    """DEM of project.toml around the photos, as ellipsoidal heights.

    Parameters
    ----------
    positions_enu : shape (n, 3), m
        Of the cameras.

    Raises
    ------
    InputError
        If the DEM cannot be read, has no CRS or does not lie under the photos.
    """
    ground = project.settings.ground
    if ground.dem is None:
        raise ValueError("the project has no DEM")
    path = project.path(ground.dem)
    header = read_grid_header(path)
    if not header.crs_wkt:
        raise CrsError("has no CRS; add a .prj beside it", source=str(path), field="CRS")
    a, b, _, d, e, _ = header.transform
    if b or d or a <= 0 or e >= 0:
        raise InputError(
            "is not north-up; warp it to a north-up raster (e.g. gdalwarp)", source=str(path)
        )
    crs = parse_crs(header.crs_wkt)
    own = MapFrame(frame.origin, horizontal_crs(crs), gnss_datum=frame.gnss_datum, crs_datum=None)
    a, _, left, _, e, top = header.transform
    low, high = positions_enu.min(axis=0) - DEM_MARGIN, positions_enu.max(axis=0) + DEM_MARGIN
    corners = np.array([[x, y, 0.0] for x in (low[0], high[0]) for y in (low[1], high[1])])
    p = own.map_from_enu(corners)[:, :2]
    cols = np.clip((p[:, 0] - left) / a, 0, header.width)
    rows = np.clip((p[:, 1] - top) / e, 0, header.height)
    c0, r0 = int(np.floor(cols.min())), int(np.floor(rows.min()))
    width, height = int(np.ceil(cols.max())) - c0, int(np.ceil(rows.max())) - r0
    if width < 1 or height < 1:
        raise InputError(
            "does not lie under the photos; check its CRS and extent", source=str(path)
        )
    raster = read_grid(path, window=(c0, r0, width, height))
    _, _, left, _, _, top = raster.transform
    values = raster.values.astype(np.float64) * _unit(header.unit, path)
    # GDAL fills a band's unit from the vertical CRS: it counts once.
    heights = _ellipsoidal(
        values, raster.transform, own, crs, project, stated_unit=bool(header.unit)
    )
    return dem_terrain(
        own,
        heights,
        left=left,
        top=top,
        cell=(a, -e),
        metres_per_unit=_cell_scale(own, positions_enu.mean(axis=0)),
        sigma=ground.sigma_m or DEM_SIGMA,
    )


def _unit(name: str, path: Path) -> float:
    """Metres per unit of a band, by the name that GDAL gives; none means metres (or the CRS's)."""
    known = {
        "": 1.0, "m": 1.0, "metre": 1.0, "meter": 1.0, "metres": 1.0, "meters": 1.0,
        "ft": INTERNATIONAL_FOOT, "foot": INTERNATIONAL_FOOT, "feet": INTERNATIONAL_FOOT,
        "us survey foot": US_SURVEY_FOOT, "us-ft": US_SURVEY_FOOT, "ftus": US_SURVEY_FOOT,
    }  # fmt: skip
    try:
        return known[name.strip().lower()]
    except KeyError:
        raise InputError(
            f"unit '{name}' of the heights is not known; convert it to metres",
            source=str(path),
            field="band unit",
        ) from None


def _cell_scale(frame: MapFrame, p_enu: Array) -> float:
    """Metres per unit of a DEM's CRS at a place; degrees included."""
    here = frame.map_from_enu(p_enu)
    unit = 1e-4
    there = frame.enu_from_map(here + np.array([unit, 0.0, 0.0]))
    return float(np.linalg.norm(there - frame.enu_from_map(here)) / unit)


def _ellipsoidal(
    values: Array,
    transform: tuple[float, ...],
    frame: MapFrame,
    crs: Any,
    project: Project,
    *,
    stated_unit: bool,
) -> Array:
    """Ellipsoidal heights, m, from a DEM's own unit and kind; shape (rows, cols)."""
    kind = project.settings.ground.dem_height_kind
    vertical = crs.sub_crs_list[1] if crs.is_compound else None
    if vertical is not None and not stated_unit:
        values = values * vertical.axis_info[0].unit_conversion_factor
    if kind == "ellipsoidal" or (kind == "auto" and len(crs.axis_info) == 3 and vertical is None):
        return values
    rows, cols = values.shape
    a, _, left, _, e, top = transform
    # The geoid bends by centimetres per kilometre: a coarse grid, bilinear between.
    r, c = np.linspace(0, rows, 9), np.linspace(0, cols, 9)
    xy = np.stack(np.meshgrid(left + c * a, top + r * e), axis=-1)
    geo = frame.geo_from_map(np.concatenate([xy, np.zeros((9, 9, 1))], axis=-1))
    n = geoid_undulation(geo[..., 0], geo[..., 1], geoid=project.settings.gnss.geoid)
    i, j = (np.arange(rows) + 0.5) / rows * 8, (np.arange(cols) + 0.5) / cols * 8
    by_col = np.stack([np.interp(j, np.arange(9), row) for row in n])
    fraction = i - np.minimum(i.astype(int), 7)
    lower = np.minimum(i.astype(int), 7)
    grid = by_col[lower] * (1 - fraction)[:, None] + by_col[lower + 1] * fraction[:, None]
    return np.asarray(values + grid)


def stated_ground_height(project: Project) -> Height | None:
    """Height of the ground that project.toml states."""
    ground = project.settings.ground
    if ground.height_m is None:
        return None
    return Height(
        value=ground.height_m,
        kind=HeightKind(ground.height_kind),
        geoid=project.settings.gnss.geoid,
    )
