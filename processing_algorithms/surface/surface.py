"""Tool `surface`: the ground or the adjusted points as GeoTIFF and as LAS, with their sigma."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from georef_gis.toolbox import Algorithm, Context, Feedback, Output, Result, check_cancelled
from georef_gis.toolbox import parameters as p

if TYPE_CHECKING:
    from georef_gis.geodesy import MapFrame
    from georef_gis.measure.surface.field import HeightField
    from georef_gis.measure.surface.raster import HeightReference
    from georef_gis.model.grid import Grid
    from georef_gis.project import Project
    from processing_algorithms.surface.las_files import CellFile

RASTER, POINTS, CELLS = "surface.tif", "points.las", "surface.las"
# cells that a raster may have
MOST_CELLS = 4_000_000_000


class SurfaceParameters(p.Parameters):
    """Parameters of `surface`."""

    of: Literal["ground", "points"] = p.choice(
        "ground", title="Surface",
        help="ground: what the photos are laid on, smooth; points: the adjusted points, flat "
        "triangles between them, with what stands on the ground",
    )  # fmt: skip
    heights: Literal["orthometric", "ellipsoidal"] = p.choice(
        "orthometric",
        title="Heights",
        help="above the geoid and in the unit "
        "of the CRS's vertical part, without one above [gnss] geoid in m; or the ellipsoid, in m",
    )
    cell: p.Length | None = p.length(
        None, title="Side of a cell on the ground; by default half of what the surface holds", gt=0
    )
    las: Literal["points", "cells", "none"] = p.choice(
        "points", title="LAS of",
        help="points: the adjusted points, the cells where there are none; cells: those of the "
        "surface",
    )  # fmt: skip


class SurfaceTool(Algorithm[SurfaceParameters]):
    """The surface as GeoTIFF and LAS 1.4, heights with their sigma.

    The second band is one sigma of the height, the third one sigma against its surroundings, which
    is without what all heights share. It is no dense surface model: between adjusted points,
    metres apart, it is what joins them; trees and roofs are in it as far as points lie on them.
    """

    id, name, group = "surface", "Surface", "measure"
    needs = ("footprints",)
    wants = ("adjusted",)
    uses_quick = True
    outputs = (
        Output(name="surface", title="Height and sigma", type="RasterLayer"),
        Output(name="points", title="Adjusted points, or the surface's cells, as LAS"),
    )

    def run(self, context: Context, parameters: SurfaceParameters, feedback: Feedback) -> Result:
        """Write them."""
        from georef_gis.measure.surface.raster import HeightReference
        from processing_algorithms.site import load_site
        from processing_algorithms.surface.las_files import CellFile, write_points
        from processing_algorithms.surface.source import project_field

        project = context.require_project()
        site = load_site(project, quick=context.quick)
        field = project_field(project, parameters.of, quick=context.quick)
        reference = HeightReference.promised(
            parameters.heights, project.settings.gnss.geoid, site.frame.vertical
        )
        project.products.mkdir(parents=True, exist_ok=True)
        grid, cover = _grid(project, site.frame, field, parameters.cell)
        outputs = {"surface": project.products / RASTER}
        adjusted = (project.adjustment / "points.npz").exists()
        las = CellFile(grid, reference) if _of_cells(parameters.las, adjusted=adjusted) else None
        place = site.frame, reference, cover
        cells = _write(outputs["surface"], field, grid, place, (las, feedback))
        summary: dict[str, Any] = {
            "of": field.name,
            "heights": reference.told,
            "cell_m": round(grid.pixel * site.gsd_unit, 4),
            "cells": cells,
            "area_m2": round(cells * (grid.pixel * site.gsd_unit) ** 2, 1),
            "sigma_common_m": round(field.common.sigma, 4),
        }
        if math.isfinite(field.spacing):
            summary["point_spacing_m"] = round(field.spacing, 3)
        if parameters.las == "points" and adjusted:
            outputs["points"] = project.products / POINTS
            summary["points"] = write_points(outputs["points"], project, site, reference)
        elif las is not None:
            outputs["points"] = project.products / CELLS
            las.write(outputs["points"], site.frame.horizontal)
        products = [str(path) for path in outputs.values()]
        return Result(outputs=outputs, summary={"products": products, **summary})


def _of_cells(las: str, *, adjusted: bool) -> bool:
    """Whether a LAS of the surface's cells is to be written."""
    return las == "cells" or (las == "points" and not adjusted)


def _grid(
    project: Project, frame: MapFrame, field: HeightField, cell: float | None
) -> tuple[Grid, Any]:
    """Grid over the footprints, and their union, in units of the map.

    Raises
    ------
    InputError
        If so fine a cell makes too many.
    """
    import shapely

    from georef_gis.errors import InputError
    from georef_gis.geodesy import metres_per_unit
    from georef_gis.model.grid import Grid
    from processing_algorithms.site import load_footprints

    rings = [shapely.Polygon(f.ring_map) for f in load_footprints(project).values()]
    cover = shapely.union_all([shapely.make_valid(ring) for ring in rings])
    wanted = cell or _nice(max(field.detail, 0.01))
    unit = metres_per_unit(frame.horizontal)
    x0, y0, x1, y1 = shapely.bounds(cover)
    count = (x1 - x0) * (y1 - y0) * (unit / wanted) ** 2
    if count < 1.0:
        raise InputError(f"{wanted:g} m is longer than the site; give less", field="cell")
    if count > MOST_CELLS:
        raise InputError(f"{wanted:g} m makes {count:.1e} cells; give a longer one", field="cell")
    grid = Grid.over(
        (float(x0), float(y0), float(x1), float(y1)), pixel=wanted / unit,
        crs_wkt=frame.horizontal.to_wkt(),
    )  # fmt: skip
    return grid, cover


def _nice(length: float) -> float:
    """The largest of 1, 2, 5 times a power of ten that is not above a length."""
    power = 10.0 ** math.floor(math.log10(length))
    return max(k * power for k in (1.0, 2.0, 5.0) if k * power <= length * (1.0 + 1e-9))


def _write(
    path: Path, field: HeightField, grid: Grid, place: tuple[MapFrame, HeightReference, Any],
    out: tuple[CellFile | None, Feedback],
) -> int:  # fmt: skip
    """Write the raster, and hand its cells to a LAS; how many have a height."""
    from georef_gis.measure.surface.raster import surface_profile, surface_tiles
    from georef_gis.rasters.writer import TiledWriter

    frame, reference, cover = place
    las, feedback = out

    def tell(share: float) -> None:
        check_cancelled(feedback)
        feedback.progress(share, "surface")

    count = 0
    with TiledWriter(path, surface_profile(grid, frame, reference, field)) as writer:
        for row, col, values, known in surface_tiles(
            field, grid, frame, reference, cover, tell=tell
        ):
            writer.write_tile(row, col, values, known)
            if las is not None:
                las.add(row, col, values, known)
            count += int(known.sum())
    return count
