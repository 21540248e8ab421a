"""Tool `mosaic`: one picture of the site."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any

from georef_gis.toolbox import Algorithm, Context, Feedback, Output, Result, check_cancelled
from georef_gis.toolbox import parameters as p

if TYPE_CHECKING:
    from georef_gis.model.plan import Plan
    from georef_gis.mosaic.nadir import NadirMosaic
    from georef_gis.rasters.warp import ImageCache
    from georef_gis.rasters.writer import TiledWriter
    from processing_algorithms.site import Site


class MosaicParameters(p.Parameters):
    """Parameters of `mosaic`."""

    gsd: p.Length | None = p.length(
        None,
        title="Ground sample distance; by default the photos' own",
        unit="m",
        ge=0.0005,
        le=100,
    )


class MosaicTool(Algorithm[MosaicParameters]):
    """One mosaic of all photos as a cloud-optimised GeoTIFF.

    Of the photos that show a place the one whose nadir is nearest wins, with a soft change to the
    next. Works tile by tile: the memory does not grow with the number of photos.
    """

    id, name, group = "mosaic", "Mosaic", "mosaic"
    outputs = (Output(name="mosaic", title="Mosaic", type="RasterLayer"),)
    needs, gives = ("footprints",), ("mosaic",)
    in_run = True
    uses_quick = True
    uses_settings = ("products", "ground")

    def inputs(self, context: Context, parameters: MosaicParameters) -> Sequence[Path]:
        """The photos' pixels."""
        return context.require_project().photo_files()

    def run(self, context: Context, parameters: MosaicParameters, feedback: Feedback) -> Result:
        """Make it."""
        from georef_gis.model.plan import plan_tiles
        from georef_gis.rasters.warp import ImageCache
        from georef_gis.rasters.writer import TiledWriter
        from georef_gis.rectify.grids import plan_grid
        from processing_algorithms.rasters import profile_for
        from processing_algorithms.site import load_footprints, load_site

        project = context.require_project()
        if not project.settings.products.mosaic:
            feedback.info("the mosaic is switched off ([products] mosaic = false)")
            return Result(summary={})
        site = load_site(project, quick=context.quick)
        footprints = {k: f for k, f in load_footprints(project).items() if k in site.photos}
        gsd = parameters.gsd or project.settings.products.gsd_m
        cache = ImageCache()
        usable, refused = _same_kind(site, list(footprints))
        footprints = {k: footprints[k] for k in usable}
        grid = plan_grid(list(footprints.values()), site.frame, gsd=gsd)
        plan = plan_tiles(grid, {k: f.ring_map for k, f in footprints.items()})
        bands, dtype = _bands(site, cache, usable)
        profile = profile_for(
            project, site.frame, grid, bands=bands, dtype=dtype,
            title=project.settings.project.name or "mosaic",
        )  # fmt: skip
        target = project.products / "mosaic.tif"
        broken: list[str] = []
        mosaic = _renderer(site, footprints, grid, cache, broken)
        with TiledWriter(target, profile) as writer:
            valid = _render(mosaic, plan, writer, context.workers, feedback)
        for message in dict.fromkeys([*refused, *broken]):
            feedback.warn(message)
        pixel = grid.pixel * site.gsd_unit
        summary = {
            "products": [str(target)],
            "gsd_m": pixel,
            "covered_m2": valid * pixel**2,
            "photos": len(usable),
            "size_px": [grid.width, grid.height],
            "tiles": len(plan.tiles),
            "decodes_per_photo": round(cache.decodes / max(len(usable), 1), 2),
            "doubts": list(dict.fromkeys([*refused, *broken])),
        }
        project.database.set_meta(mosaic={"path": str(target), "gsd_m": pixel, "photos": usable})
        return Result(outputs={"mosaic": target}, summary=summary)


def _same_kind(site: Site, names: list[str]) -> tuple[list[str], list[str]]:
    """Photos with the most common number of bands; the others cannot be in one picture."""
    from georef_gis.errors import GeometryError

    bands = Counter(site.photos[k].photo.bands for k in names)
    if not bands:
        raise GeometryError("no photo has a footprint")
    most = bands.most_common(1)[0][0]
    refused = [
        f"{k}: {site.photos[k].photo.bands} bands where the others have {most}: not in the mosaic"
        for k in names
        if site.photos[k].photo.bands != most
    ]
    return [k for k in names if site.photos[k].photo.bands == most], refused


def _bands(site: Site, cache: ImageCache, names: Sequence[str]) -> tuple[int, str]:
    """Number and type of the bands of the first photo that can be read."""
    from georef_gis.errors import InputError

    error: InputError | None = None
    for name in names:
        try:
            image = cache.get(site.photos[name].photo.path)
        except InputError as failure:
            error = failure
            continue
        return int(image.shape[2]), str(image.dtype)
    raise error or InputError("there is no photo to read")


def _renderer(
    site: Site,
    footprints: dict[str, Any],
    grid: Any,
    cache: ImageCache,
    broken: list[str],
) -> NadirMosaic:
    from georef_gis.mosaic.nadir import NadirMosaic, mosaic_source
    from georef_gis.rasters.warp import reduction_for
    from processing_algorithms.rasters import ground_of, reach_of

    ground = ground_of(site, grid)
    pixel = grid.pixel * site.gsd_unit
    sources = {
        key: mosaic_source(
            site.photos[key],
            ground,
            grid,
            f.ring_map,
            reduce=reduction_for(pixel, f.gsd),
            reach=reach_of(f),
        )
        for key, f in footprints.items()
    }
    return NadirMosaic(
        sources,
        ground,
        grid,
        gsd=pixel,
        read=lambda source: cache.get(source.photo.photo.path, source.reduce),
        broken=broken,
    )


def _render(
    mosaic: NadirMosaic, plan: Plan, writer: TiledWriter, workers: int, feedback: Feedback
) -> int:
    """Render the tiles, a few ahead of the writer; number of valid pixels."""
    valid = 0
    with ThreadPoolExecutor(max_workers=max(1, workers)) as pool:
        ahead: deque[tuple[Any, Future[Any]]] = deque()
        tasks = iter(plan.tiles)
        done = 0
        try:
            while True:
                while len(ahead) < 2 * max(1, workers):
                    task = next(tasks, None)
                    if task is None:
                        break
                    ahead.append((task, pool.submit(mosaic.tile, task)))
                if not ahead:
                    return valid
                task, job = ahead.popleft()
                tile = job.result()
                if tile is not None:
                    data, mask = tile
                    writer.write_tile(task.row, task.col, data, mask)
                    valid += data.shape[0] * data.shape[1] if mask is None else int(mask.sum())
                done += 1
                feedback.progress(done / len(plan.tiles), f"tile {done} of {len(plan.tiles)}")
                check_cancelled(feedback)
        finally:
            for _, job in ahead:
                job.cancel()
