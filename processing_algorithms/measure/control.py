"""Tool `control`: surveyed points into the project, and how the poses agree with them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from georef_gis.toolbox import Algorithm, Context, Feedback, Result
from georef_gis.toolbox import parameters as p

if TYPE_CHECKING:
    from georef_gis.frames import Array
    from georef_gis.geodesy import MapFrame
    from georef_gis.ingest.control import Control, Mark
    from georef_gis.project import Project
    from processing_algorithms.site import Site


class ControlPoints(Algorithm[p.Parameters]):
    """Read control and check points with their pixels, and compare the poses with them.

    Each marked pixel is laid on the ground by its photo's pose and compared with the surveyed
    place; beside the difference stands what the pose's sigma lets expect. Nothing is adjusted.
    """

    id, name, group = "control", "Control points", "measure"
    needs, gives = ("footprints",), ("control",)
    in_run = True
    uses_quick = True
    uses_settings = ("control", "ground")

    def inputs(self, context: Context, parameters: p.Parameters) -> Sequence[Path]:
        """Points and marks."""
        project = context.require_project()
        control = project.settings.control
        return [project.path(file) for file in (control.file, control.marks) if file is not None]

    def run(self, context: Context, parameters: p.Parameters, feedback: Feedback) -> Result:
        """Read and compare."""
        from georef_gis.ingest.control import read_control, read_marks
        from processing_algorithms.site import load_site

        project = context.require_project()
        settings = project.settings.control
        if settings.file is None:
            _save(project, [], [])
            return Result(summary={})
        crs = project.settings.project.crs
        control = read_control(
            project.path(settings.file),
            crs=crs if crs.upper().startswith("EPSG:") else None,
            datum=settings.datum,
        )
        marks: Sequence[Mark] = control.marks
        if settings.marks is not None:
            marks = read_marks(project.path(settings.marks), control=control)
        site = load_site(project, quick=context.quick)
        geo = _places(control, site.frame)
        _save(project, _point_rows(control, site.frame, geo), _mark_rows(site, marks))
        for doubt in control.doubts:
            feedback.warn(doubt)
        summary: dict[str, Any] = {
            "points": len(control.points),
            "marks": len(marks),
            "doubts": list(control.doubts),
        }
        return Result(summary=summary | _compared(site, control, marks, geo))


def _places(control: Control, frame: MapFrame) -> Array:
    """(lat, lon rad, ellipsoidal height m) of the points in the datum of the positions; (n, 3)."""
    import numpy as np

    from georef_gis.geodesy import Height, MapFrame

    own = MapFrame(frame.origin, control.crs, gnss_datum=frame.gnss_datum, crs_datum=control.datum)
    xy = np.array([[q.easting, q.northing, 0.0] for q in control.points])
    geo = own.geo_from_map(xy)
    for row, point in zip(geo, control.points, strict=True):
        if point.height is None:
            row[2] = np.nan
            continue
        height = Height(value=point.height, kind=control.height_kind, geoid=control.geoid)
        row[2] = height.ellipsoidal(row[0], row[1])
    return geo


def _point_rows(control: Control, frame: MapFrame, geo: Array) -> list[dict[str, Any]]:
    from georef_gis.project.geometry import point_wkb

    rows = []
    for point, place in zip(control.points, frame.map_from_geo(geo), strict=True):
        rows.append(
            {
                "name": point.name,
                "role": point.role,
                "easting": point.easting,
                "northing": point.northing,
                "height": point.height,
                "height_kind": str(control.height_kind),
                "sigma_h_m": point.sigma_h,
                "sigma_v_m": point.sigma_v,
                "crs": control.crs.to_string(),
                "datum": str(control.datum),
                "geom": point_wkb(*(float(v) for v in place)),
            }
        )
    return rows


def _mark_rows(site: Site, marks: Sequence[Mark]) -> list[dict[str, Any]]:
    ids = {photo.photo.path.name: key for key, photo in site.photos.items()}
    return [
        {
            "name": mark.name,
            "photo_id": ids.get(mark.photo, mark.photo),
            "u": mark.u,
            "v": mark.v,
            "sigma_px": mark.sigma_px,
        }
        for mark in marks
    ]


def _save(project: Project, points: list[dict[str, Any]], marks: list[dict[str, Any]]) -> None:
    with project.database.transaction():
        project.database.replace_rows("control", points)
        project.database.replace_rows("mark", marks)


def _compared(site: Site, control: Control, marks: Sequence[Mark], geo: Array) -> dict[str, Any]:
    """How far the marked pixels land from the surveyed places, and what was to be expected."""
    import numpy as np

    from georef_gis.model.ground_point import ground_point_covariance, locate

    places = site.frame.origin.enu_from_geo(np.where(np.isfinite(geo), geo, 0.0))
    used = {
        q.name: place for q, place in zip(control.points, places, strict=True) if q.role != "off"
    }
    photos = {photo.photo.path.name: photo for photo in site.photos.values()}
    off, expected = [], []
    for mark in marks:
        photo = photos.get(mark.photo)
        if photo is None or mark.name not in used:
            continue
        found = locate(photo, np.array([mark.u, mark.v]), site.terrain)
        if not np.all(np.isfinite(found)):
            continue
        off.append(found[:2] - used[mark.name][:2])
        cov = ground_point_covariance(photo, found, site.terrain, sigma_uv=mark.sigma_px)
        expected.append(np.diag(cov)[:2])
    if not off:
        return {}
    rms = np.sqrt(np.mean(np.square(off), axis=0))
    return {
        "compared": len(off),
        "rms_east_m": round(float(rms[0]), 3),
        "rms_north_m": round(float(rms[1]), 3),
        "expected_sigma_m": round(float(np.sqrt(np.mean(expected))), 3),
    }
