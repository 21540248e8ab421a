"""The centre line of sheets: from a file, or from the flight."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from georef_gis.errors import CrsError, InputError

if TYPE_CHECKING:
    from georef_gis.geodesy import CRS
    from georef_gis.model.photo import Photo
    from georef_gis.project import Project

# kinds of layers that hold no lines; others, such as those of mixed kinds, are looked into
_OTHER_KINDS = ("Point", "Polygon", "Surface", "TIN")
# deg; a side drawn between degrees is curved on a map, 2 cm in so much
_STRAIGHT_DEG = 0.005


def read_line(path: Path, layer: str | None, crs: CRS) -> Any:
    """Centre line of a vector file in a CRS.

    Raises
    ------
    InputError
        If the file has no line, or more than one.
    CrsError
        If its CRS is unknown, or the line lies where the other does not hold.
    """
    from pyogrio.errors import DataLayerError, DataSourceError, FeatureError

    if not path.is_file():
        raise InputError(
            "there is no such file; give one with a line, or auto", source=str(path), field="line"
        )
    try:
        lines, stated = _lines(path, layer)
    except (DataSourceError, DataLayerError, FeatureError, RuntimeError) as error:
        told = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(
            f"cannot be read ({told}); give GeoJSON, GeoPackage, Shapefile or KML",
            source=str(path),
        ) from error
    return _on_map(lines, stated, crs, path)


def _lines(path: Path, layer: str | None) -> tuple[list[Any], str | None]:
    """Lines of the one layer that has some, and its CRS."""
    import pyogrio

    kinds = {str(name): str(kind or "") for name, kind in pyogrio.list_layers(path)}
    if layer is not None and layer not in kinds:
        raise InputError(
            f"has no layer '{layer}'; use {', '.join(sorted(kinds)) or 'another file'}",
            source=str(path), field="layer",
        )  # fmt: skip
    tried = [name for name, kind in kinds.items() if not any(k in kind for k in _OTHER_KINDS)]
    read = {name: _layer_lines(path, name) for name in ([layer] if layer else tried)}
    found = {name: content for name, content in read.items() if content[0]}
    if not found:
        raise InputError("holds no line; draw the centre line in it", source=str(path))
    if len(found) > 1:
        raise InputError(
            f"has lines in {len(found)} layers ({', '.join(sorted(found))}); say which by --layer",
            source=str(path),
        )
    return next(iter(found.values()))


def _layer_lines(path: Path, layer: str) -> tuple[list[Any], str | None]:
    import pyogrio
    import shapely

    meta, _, blobs, _ = pyogrio.raw.read(path, layer=layer, columns=[], force_2d=True)
    if blobs is None:
        return [], None
    shapes = shapely.from_wkb([blob for blob in blobs if blob is not None], on_invalid="ignore")
    parts = shapely.get_parts(shapes[~shapely.is_missing(shapes)])
    kept = [part for part in parts if part.geom_type == "LineString" and not part.is_empty]
    return kept, meta["crs"]


def _on_map(lines: list[Any], stated: str | None, target: CRS, path: Path) -> Any:
    import numpy as np
    import shapely

    from georef_gis.geodesy import parse_crs
    from georef_gis.geodesy.reference_systems import horizontal_crs, transformer_between
    from georef_gis.mosaic.sheet_cut import join_lines

    if not stated:
        raise CrsError("has no CRS; state it (a .prj file, or Set Layer CRS in a GIS)",
                       source=str(path))  # fmt: skip
    source = horizontal_crs(parse_crs(stated))
    try:
        line = join_lines(lines)
    except InputError as error:
        raise InputError(str(error), source=str(path)) from error
    if not source.is_projected:
        line = shapely.segmentize(line, _STRAIGHT_DEG)
    if source.equals(target, ignore_axis_order=True):
        return line
    xy = shapely.get_coordinates(line)
    moved = np.column_stack(transformer_between(source, target).transform(xy[:, 0], xy[:, 1]))
    if not np.isfinite(moved).all():
        raise CrsError(
            f"the line does not lie where '{target.name}' holds; check the CRS of the file",
            source=str(path),
        )
    return shapely.linestrings(moved)


def flight_line(project: Project, crs: CRS) -> Any:
    """Middle of the flight in a CRS, from the end where the first photo was taken.

    Raises
    ------
    GeometryError
        If the photos have no main axis.
    InputError
        If they have no footprints.
    """
    import numpy as np

    from georef_gis.geodesy import metres_per_unit
    from georef_gis.geodesy.reference_systems import horizontal_crs, transformer_between
    from georef_gis.mosaic.sheet_cut import centre_line
    from processing_algorithms.rasters import reach_of
    from processing_algorithms.site import load_footprints, load_site

    site, footprints = load_site(project), load_footprints(project)
    keys = [key for key in site.photos if key in footprints]
    origins = np.array([site.photos[key].pose.origin_enu for key in keys])
    xy = np.atleast_2d(site.frame.map_from_enu(origins))[:, :2]
    own = horizontal_crs(site.frame.horizontal)
    if not own.equals(crs, ignore_axis_order=True):
        xy = np.column_stack(transformer_between(own, crs).transform(xy[:, 0], xy[:, 1]))
    reach = float(np.median([reach_of(footprints[key]) for key in keys])) / metres_per_unit(crs)
    return centre_line(xy, reach, _first([site.photos[key].photo for key in keys]))


def _first(photos: list[Photo]) -> int:
    """Number of the photo that was taken first; the first one where not all have a time."""
    everyone = range(len(photos))
    gps = [photo.time_gps for photo in photos]
    if None not in gps:
        return min(everyone, key=lambda k: gps[k] or 0.0)
    clocks = [photo.camera_clock for photo in photos]
    if None not in clocks:
        return min(everyone, key=lambda k: clocks[k] or datetime.max)
    return 0
