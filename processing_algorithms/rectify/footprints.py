"""Tool `footprints`: what each photo shows, and how often each place is seen."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from georef_gis.toolbox import Algorithm, Context, Feedback, Output, Result, check_cancelled
from georef_gis.toolbox import parameters as p

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from georef_gis.model.grid import Grid
    from georef_gis.model.layers import Footprint
    from georef_gis.project.database import Row
    from processing_algorithms.site import Site


class Footprints(Algorithm[p.Parameters]):
    """Footprints, GSD and an overlap map.

    The ground that each photo shows as a polygon with its GSD, tilt and expected position error,
    and `overlap.tif`: the number of photos that show each place.
    """

    id, name, group = "footprints", "Footprints and overlap", "rectify"
    outputs = (Output(name="overlap", title="Overlap map", type="RasterLayer"),)
    needs, wants, gives = ("poses",), ("adjusted",), ("footprints",)
    first_answer = True
    in_run = True
    # holes
    version = "2"
    uses_quick = True
    uses_settings = ("ground",)

    def run(self, context: Context, parameters: p.Parameters, feedback: Feedback) -> Result:
        """Make them."""
        import numpy as np

        from georef_gis.geodesy import metres_per_unit
        from georef_gis.rectify.coverage import covered_area, footprint_side, holes, overlap_map
        from processing_algorithms.site import load_site

        project = context.require_project()
        site = load_site(project, quick=context.quick)
        made, rows, doubts = _footprints(site, feedback)
        for doubt in doubts:
            feedback.warn(doubt)
        grid, counts = overlap_map(made, site.frame)
        target = project.products / "overlap.tif"
        _write_overlap(target, grid, counts, site.frame.horizontal.to_epsg())
        project.database.replace_rows("footprint", rows)
        gaps = holes(grid, counts, footprint_cells=footprint_side(made, grid, site.frame))
        cell = grid.pixel * metres_per_unit(site.frame.horizontal)
        if gaps:
            doubts.append(f"{len(gaps)} places inside the flown area are in no photo")
            feedback.warn(doubts[-1])
        summary = {
            "gsd_m": float(np.median([f.gsd for f in made])),
            "covered_m2": covered_area(grid, counts, site.frame),
            "largest_overlap": int(counts.max()),
            "holes": len(gaps),
            "cell_m": round(cell, 3),
            "sigma_horizontal_m": float(np.median([f.sigma_horizontal for f in made])),
            "tilt_deg_max": math.degrees(max(f.tilt for f in made)),
            "doubts": doubts,
        }
        return Result(outputs={"overlap": target}, summary=summary)


def _footprints(site: Site, feedback: Feedback) -> tuple[list[Footprint], list[Row], list[str]]:
    """Footprints of a site's photos, their rows, and what is doubtful of them.

    Raises
    ------
    GeometryError
        If no photo has one.
    """
    from georef_gis.errors import GeometryError
    from georef_gis.project.records import footprint_row
    from georef_gis.rectify.footprints import footprint

    made: list[Footprint] = []
    rows: list[Row] = []
    doubts: list[str] = []
    for i, (key, photo) in enumerate(site.photos.items()):
        check_cancelled(feedback)
        feedback.progress(0.9 * i / len(site.photos), key)
        try:
            one = footprint(photo, site.terrain, site.frame)
        except GeometryError as error:
            doubts.append(str(error))
            continue
        made.append(one)
        own = list(site.doubts[key])
        if one.clipped:
            own.append("part of it looks past the ground within reach: left out")
            doubts.append(f"{key}: {own[-1]}")
        rows.append(footprint_row(one, pose_kind=site.pose_kinds[key], doubts=own))
    if not made:
        raise GeometryError(doubts[0] if doubts else "no photo has a footprint")
    return made, rows, doubts


def _write_overlap(target: Path, grid: Grid, counts: NDArray[Any], epsg: int | None) -> None:
    """Write the number of photos that show each cell of a grid; (rows, cols)."""
    import numpy as np

    from georef_gis.rasters.profile import RasterProfile
    from georef_gis.rasters.writer import TiledWriter

    profile = RasterProfile(
        width=grid.width,
        height=grid.height,
        transform=grid.transform,
        crs_wkt=grid.crs_wkt,
        epsg=epsg,
        bands=1,
        dtype="uint16",
        compression="deflate",
        band_descriptions=("photos",),
        nodata=0,
    )
    with TiledWriter(target, profile) as writer:
        for row, col, window in grid.tiles(profile.tile_size):
            part = counts[window.row :, window.col :][: window.height, : window.width]
            if part.any():
                writer.write_tile(row, col, np.ascontiguousarray(part[..., None]))
