"""The surface that a tool measures on: the adjusted points, the ground, or a given raster."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from georef_gis.errors import InputError
from georef_gis.geodesy import MapFrame
from georef_gis.measure.surface.common_errors import CommonErrors, common_errors
from georef_gis.measure.surface.field import GroundField, HeightField
from georef_gis.measure.surface.points import PointField
from georef_gis.model.terrain import DemTerrain
from georef_gis.model.tie_points import GroundPoints
from georef_gis.model.tin import TinTerrain
from georef_gis.project import Project
from processing_algorithms.site import Site, load_ground, load_site, mostly_adjusted

if TYPE_CHECKING:
    from georef_gis.frames import Array

Source = Literal["auto", "points", "ground"]


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
        points = load_adjusted_points(project)
        common = _common_errors(project, site, points.p_enu)
        return PointField.of(points, level=level, scale=_scale(project), common=common)
    terrain = load_ground(project, site.frame, adjusted=adjusted)
    what = {"tin": "ground as a TIN of adjusted points, smoothed", "plane": "ground as a plane"}
    if isinstance(terrain, TinTerrain):
        # the photos share the level that the points have among their own
        common = _common_errors(project, site, load_adjusted_points(project).p_enu)
        return GroundField.of(terrain, what[terrain.kind], level=level, common=common)
    name = "DEM of the project" if isinstance(terrain, DemTerrain) else "flat ground"
    return GroundField.of(terrain, name, level=level)


def _common_errors(project: Project, site: Site, p_enu: Array) -> CommonErrors | None:
    """What the heights of adjusted points err by together but for the level; None if not known."""
    from georef_gis.project.shared_errors import ADJUSTED
    from processing_algorithms.measure.session import scene_of

    scene = scene_of(project, site)
    photos = [source.photos for source in scene.errors.sources if source.kind == ADJUSTED]
    known = p_enu[np.isfinite(p_enu).all(axis=1)]
    return common_errors(scene, np.concatenate(photos), known) if photos and len(known) else None


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
    project: Project, frame: MapFrame, source: Source, raster: str | None, around: Any,
    *, sigma: float | None = None, quick: bool = False,
) -> HeightField:  # fmt: skip
    """Surface of the project, or of a raster about some shapes of the map.

    Parameters
    ----------
    raster
        File of heights.
    around
        Shape (shapely) in CRS units that a raster must cover.
    """
    import shapely

    if raster is None:
        return project_field(project, source, quick=quick)
    from processing_algorithms.surface.given import raster_field

    xy = shapely.get_coordinates(around)
    level = np.full((len(xy), 1), frame.origin.height_ellipsoidal)
    places = frame.enu_from_map(np.hstack([xy, level]))[:, :2]
    return raster_field(project, frame, Path(raster), around=places, sigma=sigma)


def on_plane(frame: MapFrame, shape: Any, field: HeightField) -> Any:
    """Shape of the map on the project's own plane, at the height of a surface; m in enu."""
    import shapely

    def moved(xy: Array) -> Array:
        level = np.nan_to_num(
            field.on_map(frame, xy).height, nan=float(frame.origin.height_ellipsoidal)
        )
        return frame.enu_from_map(np.column_stack([xy, level]))[:, :2]

    return shapely.transform(shape, moved)
