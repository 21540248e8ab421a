"""Tool `accuracy`: the accuracy statement of a project by its check points."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from georef_gis.toolbox import Algorithm, Context, Feedback, Result, check_cancelled
from georef_gis.toolbox import parameters as p
from processing_algorithms.measure.accuracy_adjusted import REPORT, distances, joint_covariance
from processing_algorithms.measure.accuracy_table import (
    OUTPUTS,
    account_of,
    targets_of,
    write_statement,
)
from processing_algorithms.measure.accuracy_table import assessment_of_table as of_table

if TYPE_CHECKING:
    from georef_gis.frames import Array
    from georef_gis.measure.accuracy.mosaic import MarkedPhoto, MosaicPlace, MosaicReader
    from georef_gis.measure.accuracy.product import Assessment, CheckResidual, Targets
    from georef_gis.measure.accuracy.report import SeamFinding, Survey
    from georef_gis.model.intersection import Intersection, JointCovariance
    from georef_gis.project import Project
    from processing_algorithms.site import Site

# Photos in which a point is looked for in the mosaic, those that see it nearest their middle.
MOST_READINGS = 4


class AccuracyParameters(p.Parameters):
    """Parameters of `accuracy`."""

    target_rmse_h: p.Length | None = p.length(
        None, title="Horizontal class (RMSE_H) declared before the test", unit="m", gt=0, le=1000
    )
    target_rmse_v: p.Length | None = p.length(
        None, title="Vertical class (RMSE_V) declared before the test", unit="m", gt=0, le=1000
    )
    table: p.File | None = p.file(
        None, title="CSV of residuals (name, dx, dy, dz in m) instead of those measured here"
    )
    search: p.Length | None = p.length(
        None, title="How far to look for a point in the mosaic; by default as far as the poses "
        "may err", unit="m", gt=0, le=200, advanced=True,
    )  # fmt: skip


class Accuracy(Algorithm[AccuracyParameters]):
    """Accuracy statement by check points, after the ASPRS standards (Edition 2, 2024).

    Horizontal from the mosaic, where the marked points are found again by their pixels; vertical
    from the surface; space intersections of the marks apart. Only points of the role check count.
    Declare the classes before the test, in project.toml: [tools.accuracy] target_rmse_h = "5cm".
    """

    id, name, group = "accuracy", "Accuracy statement", "measure"
    outputs = OUTPUTS
    needs, gives = ("mosaic", "control"), ("accuracy",)
    in_run = True
    uses_quick = True
    uses_settings = ("control", "ground", "products", "project")
    version = "2"

    def inputs(self, context: Context, parameters: AccuracyParameters) -> Sequence[Path]:
        """The mosaic, and what the adjustment says of itself."""
        project = context.require_project()
        files = [project.products / "mosaic.tif", project.adjustment / REPORT]
        return [path for path in files if path.is_file()]

    def run(self, context: Context, parameters: AccuracyParameters, feedback: Feedback) -> Result:
        """Measure, judge and write."""
        from georef_gis.measure.accuracy.metadata import statement_metadata
        from georef_gis.measure.accuracy.report import AccuracyReport
        from georef_gis.rasters.aux_metadata import write_aux_metadata
        from processing_algorithms.site import load_site

        project = context.require_project()
        site = load_site(project, quick=context.quick)
        points = _Points(project, site)
        targets = targets_of(parameters)
        untested: dict[str, str] = {}
        if parameters.table is not None:
            assessments = [of_table(parameters.table, targets)]
        else:
            assessments = _measured(
                project, site, points, targets, parameters.search, untested, feedback
            )
        report = AccuracyReport(
            title=project.settings.project.name or project.folder.name,
            assessments=tuple(assessments),
            survey=points.survey(project, site),
            untested=untested,
            notes=points.notes,
            distances=distances(project, site),
            seams=_seams(project),
        )
        feedback.progress(0.9, "measured")
        check_cancelled(feedback)
        outputs = write_statement(report, project.products)
        mosaic = project.products / "mosaic.tif"
        if mosaic.is_file():
            write_aux_metadata(mosaic, statement_metadata(report), family="ACCURACY_")
        return Result(outputs=outputs, summary=account_of(report, outputs))


# -- a project -----------------------------------------------------------------------------------


def _seams(project: Project) -> SeamFinding | None:
    """What the mosaic measured of its seams."""
    from georef_gis.measure.accuracy.report import SeamFinding

    found = (project.database.meta("mosaic") or {}).get("seam_mismatch") or {}
    if not found.get("accepted"):
        return None
    return SeamFinding(
        places=int(found["places"]), accepted=int(found["accepted"]),
        median=float(found["median_m"]), p90=float(found["p90_m"]),
    )  # fmt: skip


class _Points:
    """Surveyed points of a project: places on the map and in enu, marks, roles."""

    def __init__(self, project: Project, site: Site) -> None:
        import struct

        import numpy as np

        rows = [row for row in project.database.rows("control") if row["geom"] is not None]
        self.rows = {row["name"]: row for row in rows}
        self.p_map = {
            name: np.array(struct.unpack("<ddd", row["geom"][5:29]))
            for name, row in self.rows.items()
        }
        # Roles may have been changed after an adjustment that used the point.
        used = (project.database.meta("adjustment") or {}).get("control_points", [])
        self.control = [n for n, row in self.rows.items() if row["role"] == "control" or n in used]
        self.checks = [
            n for n, row in self.rows.items() if row["role"] == "check" and n not in used
        ]
        self.marks: dict[str, list[Mapping[str, Any]]] = {}
        for mark in project.database.rows("mark"):
            self.marks.setdefault(mark["name"], []).append(mark)
        self.notes = tuple(
            f"Point {n} has the role check but was control of the adjustment: not counted."
            for n, row in self.rows.items()
            if row["role"] == "check" and n in used
        )
        self.unit = site.gsd_unit

    def enu(self, site: Site, name: str) -> Array:
        """Place in enu, m; the height is NaN where it was not surveyed."""
        import numpy as np

        place = self.p_map[name]
        known = bool(np.isfinite(place[2]))
        # Without a height the ground's will do for east and north.
        level = place[2] if known else site.frame.origin.height_ellipsoidal
        p_enu = site.frame.enu_from_map(np.array([*place[:2], level]))
        return p_enu if known else np.array([*p_enu[:2], np.nan])

    def marked(self, site: Site, name: str) -> list[MarkedPhoto]:
        """Marks in photos that have a pose, the nearest to a photo's middle first."""
        import numpy as np

        from georef_gis.measure.accuracy.mosaic import MarkedPhoto

        marks = [
            MarkedPhoto(
                photo=site.photos[row["photo_id"]],
                uv=np.array([row["u"], row["v"]]),
                sigma_px=row["sigma_px"],
            )
            for row in self.marks.get(name, ())
            if row["photo_id"] in site.photos
        ]

        def off_middle(mark: MarkedPhoto) -> float:
            camera = mark.photo.camera
            return float(np.hypot(*(mark.uv - [camera.width / 2, camera.height / 2])))

        return sorted(marks, key=off_middle)

    def survey(self, project: Project, site: Site) -> Survey:
        """What is known of the survey and the site."""
        import numpy as np

        from georef_gis.measure.accuracy.report import Survey

        datums = sorted({self.rows[n]["datum"] or "unknown" for n in self.checks}) or ["unknown"]
        kinds = sorted({self.rows[n]["height_kind"] or "unknown" for n in self.checks})
        control = [self.p_map[n][:2] * self.unit for n in self.control]
        return Survey(
            datum=", ".join(datums),
            product_datum=str(site.frame.crs_datum),
            heights=f"surveyed {', '.join(kinds) or 'unknown'}, compared above the ellipsoid",
            crs=site.frame.crs.name,
            control_names=tuple(self.control),
            control_map=np.array(control).reshape(-1, 2),
            extent=_extent(project, self.unit),
        )


def _extent(project: Project, unit: float) -> tuple[float, float, float, float] | None:
    """Rectangle around the footprints, m on the map."""
    import numpy as np

    from georef_gis.project.records import footprint_of

    rings = [footprint_of(row).ring_map for row in project.database.rows("footprint")]
    if not rings:
        return None
    xy = np.vstack(rings) * unit
    (left, bottom), (right, top) = xy.min(axis=0), xy.max(axis=0)
    return float(left), float(bottom), float(right), float(top)


def _measured(
    project: Project,
    site: Site,
    points: _Points,
    targets: Targets,
    search: float | None,
    untested: dict[str, str],
    feedback: Feedback,
) -> list[Assessment]:
    """Assessments of the products and, apart, of the intersections."""
    from georef_gis.measure.accuracy.product import assess

    mosaic = project.products / "mosaic.tif"
    on = {"vertical": _surface(project)}
    places: dict[str, MosaicPlace] = {}
    if points.checks and project.settings.products.mosaic and mosaic.is_file():
        on = {"horizontal": mosaic.name, **on}
        places = _mosaic_places(mosaic, site, points, search, feedback)
    for name, place in places.items():
        if not place.readings:
            why = ", ".join(sorted(set(place.refused.values()))) or "no photo shows it"
            untested[name] = f"in the mosaic {why}"
    products = assess(
        _product_residuals(site, points, places), targets, kind="products", measured_on=on
    )
    crossed = _intersection_residuals(site, points, untested, joint_covariance(project, site))
    found = [products]
    if crossed:
        found.append(assess(crossed, targets, kind="intersections"))
    return found


def _surface(project: Project) -> str:
    """What the surface is, in words."""
    database = project.database
    facts = database.meta("ground_adjusted") or database.meta("ground") or {}
    if facts.get("path"):
        return Path(facts["path"]).name
    kinds = {"tin": "TIN of adjusted points", "plane": "plane through adjusted points"}
    if facts.get("kind") in kinds:
        return kinds[facts["kind"]]
    return f"level ground ({facts.get('source', 'of no known source')})"


def _mosaic_places(
    path: Path, site: Site, points: _Points, search: float | None, feedback: Feedback
) -> dict[str, MosaicPlace]:
    from georef_gis.measure.accuracy.mosaic import MosaicReader
    from georef_gis.rasters.warp import ImageCache
    from processing_algorithms.rasters import ground_of

    cache = ImageCache()
    reader: MosaicReader = MosaicReader(
        path, site.frame, lambda grid: ground_of(site, grid), read=cache.get, search=search
    )
    places = {}
    for i, name in enumerate(points.checks):
        check_cancelled(feedback)
        places[name] = reader.place(points.marked(site, name)[:MOST_READINGS])
        feedback.progress(0.8 * (i + 1) / len(points.checks), f"{name} read in the mosaic")
    return places


def _product_residuals(
    site: Site, points: _Points, places: Mapping[str, MosaicPlace]
) -> list[CheckResidual]:
    import numpy as np

    from georef_gis.measure.accuracy.product import CheckResidual
    from georef_gis.measure.accuracy.surface import surface_readings

    enu = np.array([points.enu(site, n) for n in points.checks]).reshape(-1, 3)
    surface = surface_readings(enu, site.terrain)
    out = []
    for name, height in zip(points.checks, surface, strict=True):
        place = places.get(name)
        off = [math.nan, math.nan]
        if place is not None:
            off = [float(v) for v in (place.xy_map - points.p_map[name][:2]) * points.unit]
        out.append(
            CheckResidual(
                name=name, dx=off[0], dy=off[1], dz=height.dz,
                read_h=place.sigma if place is not None else math.nan,
                notes=height.notes, **_surveyed(points, name),
            )
        )  # fmt: skip
    return out


def _surveyed(points: _Points, name: str) -> dict[str, Any]:
    row, place = points.rows[name], points.p_map[name]
    cover = (row["extra"] or {}).get("cover", "open")
    h, v = (math.nan if row[key] is None else row[key] for key in ("sigma_h_m", "sigma_v_m"))
    return {
        "sigma_h": h,
        "sigma_v": v,
        "x": float(place[0]) * points.unit,
        "y": float(place[1]) * points.unit,
        "cover": cover if cover == "vegetated" else "open",
    }


def _intersection_residuals(
    site: Site,
    points: _Points,
    untested: dict[str, str],
    joint: JointCovariance | None = None,
) -> list[CheckResidual]:
    """Points from all their marks; `untested` learns why one could not be told."""
    import numpy as np

    from georef_gis.errors import GeometryError
    from georef_gis.measure.accuracy.product import CheckResidual
    from georef_gis.model.intersection import intersect

    out = []
    for name in points.checks:
        marks = points.marked(site, name)
        if len(marks) < 2:
            continue
        try:
            found = intersect(
                [m.photo for m in marks],
                np.array([m.uv for m in marks]),
                np.array([m.sigma_px for m in marks]),
                joint=joint,
            )
        except GeometryError as error:
            told = untested.get(name)
            untested[name] = f"{told}, intersected {error}" if told else f"intersected {error}"
            continue
        off = (site.frame.map_from_enu(found.p_enu) - points.p_map[name]) * [
            points.unit, points.unit, 1.0,
        ]  # fmt: skip
        sigma = np.sqrt(np.diag(found.covariance))
        out.append(
            CheckResidual(
                name=name, dx=float(off[0]), dy=float(off[1]), dz=float(off[2]),
                read_h=float(np.hypot(sigma[0], sigma[1]) / math.sqrt(2.0)),
                read_v=float(sigma[2]),
                notes=_ray_notes(found, marks),
                **_surveyed(points, name),
            )
        )  # fmt: skip
    return out


def _ray_notes(found: Intersection, marks: Sequence[MarkedPhoto]) -> tuple[str, ...]:
    alone = ", poses taken as independent" if found.independent else ""
    out = [f"{found.rays} rays, sigma0 {found.sigma0:.2f}{alone}"]
    for value, mark in zip(found.normalised, marks, strict=True):
        if value > 4.0:
            out.append(f"mark in {mark.photo.id} does not fit (w = {value:.1f})")
    return tuple(out)
