"""Tool `change`: areas that changed between two dates of a site."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from georef_gis.toolbox import Algorithm, Context, Feedback, Output, Result, check_cancelled
from georef_gis.toolbox import parameters as p

if TYPE_CHECKING:
    from georef_gis.measure.change.detect import Change, Comparison
    from georef_gis.project import Project
    from processing_algorithms.change.photos import SitePhotos
    from processing_algorithms.change.sides import Side

# cells are so many times as long as the coarser of the two ground sample distances
_CELL = 2.0
# megabytes of decoded blocks that are kept
_CACHE = 64


class ChangeParameters(p.Parameters):
    """Parameters of `change`."""

    earlier: p.RasterLayer | None = p.raster_layer(
        None, title="Earlier mosaic, a GeoTIFF of any CRS, GSD and extent", positional=True
    )
    earlier_project: p.Folder | None = p.folder(
        None, title="Or the project folder of the earlier date; its mosaic is read only"
    )
    earlier_date: p.Text | None = p.text(
        None, title="Date of the earlier mosaic; by default of its project's photos"
    )
    later: p.RasterLayer | None = p.raster_layer(
        None, title="Later mosaic, instead of the project's own", advanced=True
    )
    later_date: p.Text | None = p.text(
        None, title="Date of the later mosaic; by default of the project's photos", advanced=True
    )
    least_area: p.Number = p.number(0.1, title="Least area of a change", unit="m2", gt=0)
    least_confidence: p.Number = p.number(
        0.5, title="Least confidence of a change that is written", ge=0, le=1
    )
    cell: p.Length | None = p.length(
        None, title="Side of the cells that are compared; by default twice the coarser GSD", gt=0
    )
    max_shift: p.Length = p.length(
        10.0, title="Largest shift between the two that is believed", gt=0, le=500
    )
    photos: p.Flag = p.flag(
        True, title="Ask the photos of both dates whether what differs only leans another way"
    )
    geojson: p.Flag = p.flag(False, title="Write GeoJSON too")
    target: p.File | None = p.file(
        None, title="GeoPackage to write; by default products/changes.gpkg", suffixes=(".gpkg",),
        writes=True,
    )  # fmt: skip


class ChangeTool(Algorithm[ChangeParameters]):
    """Areas that changed between an earlier mosaic and the project's own, with a confidence.

    The two are registered on each other by many windows, made alike in brightness, and compared
    cell by cell; the shift is taken out of the comparison, not of the mosaics. Where the photos of
    a date are at hand, an area that one of them shows as the other date's mosaic does is one that
    leans: it loses its confidence. Experimental: the confidence is calibrated on simulated changes,
    and on a real site where nothing changed.
    """

    id, name, group = "change", "Change between two dates", "measure"
    wants = ("mosaic",)
    outputs = (
        Output(name="changes", title="Changed areas", type="VectorLayer"),
        Output(name="probability", title="Probability of change, %", type="RasterLayer"),
        Output(name="style", title="Style of the areas, for QGIS"),
        Output(name="geojson", title="Changed areas as GeoJSON"),
    )

    def run(self, context: Context, parameters: ChangeParameters, feedback: Feedback) -> Result:
        """Compare and write."""
        from georef_gis.measure.change.detect import compare
        from georef_gis.measure.change.evidence import weigh
        from georef_gis.measure.change.pair import common_cells, gsd_of, open_pair
        from georef_gis.rasters.gdal_cache import gdal_cache
        from processing_algorithms.change.files import write_all
        from processing_algorithms.change.told import doubts_of, figures_of, photo_doubts

        project = context.require_project()
        earlier, later = _sides(project, parameters)
        cell = parameters.cell or _CELL * max(gsd_of(one.raster) for one in (earlier, later))
        cells = common_cells(later.raster, earlier.raster, cell)

        def step(what: str, part: float) -> None:
            check_cancelled(feedback)
            feedback.progress(_STEPS[what][0] + part * _STEPS[what][1], what)

        photos, notes = _photos(later, earlier, cells.header.crs_wkt, asked=parameters.photos)
        most = parameters.max_shift
        project.prepare()
        with gdal_cache(_CACHE), open_pair(
            later.raster, earlier.raster, cells, most=most, work=project.cache,
            step=lambda part: step("reading", part),
        ) as pair:  # fmt: skip
            found = compare(pair, most=most, least_area=parameters.least_area, step=step)
            found = weigh(found, photos, step=lambda part: step("photos", part))
        kept = _kept(found, parameters)
        target = Path(parameters.target or project.products / "changes.gpkg")
        outputs = write_all(
            target, found, kept, (earlier.date, later.date), geojson=parameters.geojson
        )
        doubts = [*doubts_of(found, kept, earlier, later), *notes, *photo_doubts(found, photos)]
        for line in doubts:
            feedback.warn(line)
        summary: dict[str, Any] = {
            "products": [str(path) for path in outputs.values()],
            **figures_of(found, kept, earlier, later), "doubts": doubts,
        }  # fmt: skip
        return Result(outputs=outputs, summary=summary)


# start and length of a step
_STEPS = {
    "reading": (0.0, 0.3),
    "registration": (0.3, 0.2),
    "brightness": (0.5, 0.05),
    "scores": (0.55, 0.2),
    "regions": (0.75, 0.15),
    "photos": (0.9, 0.1),
}


def _sides(project: Project, parameters: ChangeParameters) -> tuple[Side, Side]:
    from georef_gis.errors import InputError
    from processing_algorithms.change.sides import Side, side_of_folder, side_of_project

    if (parameters.earlier is None) == (parameters.earlier_project is None):
        raise InputError(
            "give the earlier mosaic as a file, or its project with --earlier-project",
            field="earlier",
        )
    early, late = parameters.earlier_date or "", parameters.later_date or ""
    if parameters.earlier is not None:
        earlier = Side(raster=Path(parameters.earlier), date=early, sigma=None)
    else:
        earlier = side_of_folder(Path(str(parameters.earlier_project)), early)
    if parameters.later is not None:
        later = Side(raster=Path(parameters.later), date=late, sigma=None)
    else:
        later = side_of_project(project, late)
    if earlier.raster.resolve() == later.raster.resolve():
        raise InputError("is compared with itself; name the other date", source=str(later.raster))
    return earlier, later


def _photos(
    later: Side, earlier: Side, crs_wkt: str, *, asked: bool
) -> tuple[tuple[SitePhotos | None, SitePhotos | None], list[str]]:
    """Photos of both dates, and what a user has to know of them, a line each."""
    if not asked:
        return (None, None), []
    found = [side.photos(name, crs_wkt) for name, side in (("later", later), ("earlier", earlier))]
    return (found[0][0], found[1][0]), [doubt for _, doubt in found if doubt]


def _kept(found: Comparison, parameters: ChangeParameters) -> list[Change]:
    square = found.cells.metres**2
    return [
        one for one in found.changes
        if one.confidence >= parameters.least_confidence
        and one.judged.outline.area * square >= parameters.least_area
    ]  # fmt: skip
