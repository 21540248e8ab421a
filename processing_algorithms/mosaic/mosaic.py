"""Tool `mosaic`: one picture of the site."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

from georef_gis.toolbox import Algorithm, Context, Feedback, Output, Result, check_cancelled
from georef_gis.toolbox import parameters as p

if TYPE_CHECKING:
    from georef_gis.model.grid import Grid
    from georef_gis.model.layers import Footprint
    from georef_gis.model.photo import Photo
    from georef_gis.model.plan import Plan
    from georef_gis.mosaic.nadir import NadirMosaic, TileSketch
    from georef_gis.project import Project
    from georef_gis.rasters.profile import RasterProfile
    from georef_gis.rasters.warp import Image, ImageCache
    from georef_gis.rasters.writer import TiledWriter
    from processing_algorithms.site import Site


# tiles whose geometry is known before their photos are read
LOOKAHEAD = 256


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
    next; a doubtful photo gives way to any that is not. Works tile by tile: the memory does not
    grow with the number of photos.
    """

    id, name, group = "mosaic", "Mosaic", "mosaic"
    outputs = (Output(name="mosaic", title="Mosaic", type="RasterLayer"),)
    needs, gives = ("footprints",), ("mosaic",)
    in_run = True
    first_answer = True
    uses_quick = True
    uses_settings = ("products", "ground")

    def inputs(self, context: Context, parameters: MosaicParameters) -> Sequence[Path]:
        """The photos' pixels."""
        return context.require_project().photo_files()

    def run(self, context: Context, parameters: MosaicParameters, feedback: Feedback) -> Result:
        """Make it."""
        from georef_gis.errors import GeometryError
        from georef_gis.rasters.warp import ImageCache, one_thread_each
        from georef_gis.rasters.writer import TiledWriter
        from processing_algorithms.site import load_footprints, load_site

        project = context.require_project()
        if not project.settings.products.mosaic:
            feedback.info("the mosaic is switched off ([products] mosaic = false)")
            return Result(summary={})
        site = load_site(project, quick=context.quick)
        footprints = {k: f for k, f in load_footprints(project).items() if k in site.photos}
        cache = ImageCache()
        usable, refused = _same_kind(site, list(footprints))
        footprints = {k: footprints[k] for k in usable}
        gsd = parameters.gsd or project.settings.products.gsd_m
        capacity = cache.capacity(_largest_image(site, usable))
        grid, plan = _planned(site, footprints, gsd, capacity)
        kind = _kind(site, cache, usable)
        profile = _profile(project, site, grid, kind, feedback)
        target = project.products / "mosaic.tif"
        broken: list[str] = []
        mosaic = _renderer(site, footprints, grid, cache, broken, kind)
        # One thread a tile: OpenCV's own threads cost more than they gain on pieces this small.
        with one_thread_each(), TiledWriter(target, profile) as writer:
            valid = _render(mosaic, plan, cache, writer, max(1, context.workers), feedback)
            if not valid:
                raise GeometryError(broken[0] if broken else "no photo shows the ground")
        doubts = list(dict.fromkeys([*refused, *broken]))
        for message in doubts:
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
            "doubts": doubts,
        }
        project.database.set_meta(mosaic={"path": str(target), "gsd_m": pixel, "photos": usable})
        return Result(outputs={"mosaic": target}, summary=summary)


def _largest_image(site: Site, names: Sequence[str]) -> int:
    """Bytes of the largest photo, decoded to 8 bits."""
    photos = [site.photos[name].photo for name in names]
    return max(photo.width * photo.height * photo.bands for photo in photos)


def _same_kind(site: Site, names: list[str]) -> tuple[list[str], list[str]]:
    """Photos with the most common number and depth of bands; others cannot be in one picture."""
    from georef_gis.errors import GeometryError

    kinds = {k: _stated_kind(site.photos[k].photo) for k in names}
    if not kinds:
        raise GeometryError("no photo has a footprint")
    most = Counter(kinds.values()).most_common(1)[0][0]
    refused = [
        f"{site.photos[k].photo.path.name}: has bands x bits {own[0]} x {own[1]} where most photos "
        f"have {most[0]} x {most[1]}: not in the mosaic; make it a mosaic of its own"
        for k, own in kinds.items()
        if own != most
    ]
    return [k for k, own in kinds.items() if own == most], refused


def _stated_kind(photo: Photo) -> tuple[int, int]:
    """Number of bands and bits of each, as the tags say; a JPEG has 8."""
    from georef_gis.ingest.tags import numbers

    bits = numbers(photo.tags, "EXIF:BitsPerSample")
    tiff = photo.path.suffix.lower() in (".tif", ".tiff")
    return photo.bands, int(bits[0]) if tiff and bits else 8


def _kind(site: Site, cache: ImageCache, names: Sequence[str]) -> tuple[int, str]:
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


def _planned(
    site: Site, footprints: Mapping[str, Footprint], gsd: float | None, capacity: int
) -> tuple[Grid, Plan]:
    """Grid over the footprints, of `gsd` m, and its tiles for a cache of so many photos."""
    from georef_gis.model.plan import plan_tiles
    from georef_gis.rectify.grids import plan_grid

    grid = plan_grid(list(footprints.values()), site.frame, gsd=gsd)
    return grid, plan_tiles(grid, {k: f.ring_map for k, f in footprints.items()}, capacity=capacity)


def _profile(
    project: Project, site: Site, grid: Grid, kind: tuple[int, str], feedback: Feedback
) -> RasterProfile:
    """What file to write; names of bands that are not as many as these are warned of."""
    from processing_algorithms.rasters import profile_for

    bands, dtype = kind
    names = project.settings.products.band_names
    if names and len(names) != bands:
        feedback.warn(f"[products] band_names: {len(names)} names for {bands} bands, not used")
    return profile_for(
        project, site.frame, grid, bands=bands, dtype=dtype,
        title=project.settings.project.name or "mosaic",
    )  # fmt: skip


def _renderer(
    site: Site,
    footprints: Mapping[str, Footprint],
    grid: Grid,
    cache: ImageCache,
    broken: list[str],
    kind: tuple[int, str],
) -> NadirMosaic:
    from dataclasses import replace

    from georef_gis.mosaic.nadir import NadirMosaic, mosaic_source
    from georef_gis.rasters.warp import reduction_for
    from processing_algorithms.rasters import ground_of, reach_of

    ground = ground_of(site, grid)
    pixel = grid.pixel * site.gsd_unit
    sources = {}
    for key, f in footprints.items():
        reduce = reduction_for(pixel, f.gsd)
        source = mosaic_source(
            site.photos[key], ground, grid, f.ring_map, reduce=reduce, reach=reach_of(f)
        )
        sources[key] = replace(source, doubtful=bool(site.doubts[key]))
    return NadirMosaic(
        sources,
        ground,
        grid,
        gsd=pixel,
        read=_checked(cache, kind),
        broken=broken,
    )


def _checked(cache: ImageCache, kind: tuple[int, str]) -> Callable[[Path, int], Image]:
    """Reader of photos that refuses those whose bands are not the mosaic's."""
    from georef_gis.errors import InputError

    def read(path: Path, reduce: int) -> Image:
        image = cache.get(path, reduce)
        own = (int(image.shape[2]), str(image.dtype))
        if own != kind:
            raise InputError(
                f"has bands {own[0]} x {own[1]} where the mosaic has {kind[0]} x {kind[1]}: not in "
                "the mosaic; make it a mosaic of its own",
                source=path.name,
            )
        return image

    return read


def _render(
    mosaic: NadirMosaic,
    plan: Plan,
    cache: ImageCache,
    writer: TiledWriter,
    workers: int,
    feedback: Feedback,
) -> int:
    """Render the tiles, a few ahead of the writer; number of valid pixels.

    The geometry of `LOOKAHEAD` tiles is known before their photos are read, so that the cache can
    tell which photo is needed last.
    """
    valid = done = 0
    sketches: deque[tuple[int, TileSketch]] = deque()
    numbered = enumerate(plan.tiles)
    ahead: deque[tuple[int, TileSketch, Future[Any]]] = deque()
    with ThreadPoolExecutor(max_workers=workers) as pool:
        try:
            while True:
                for number, task in islice(numbered, LOOKAHEAD - len(sketches)):
                    sketch = mosaic.sketch(task)
                    cache.announce(number, sketch.keys)
                    sketches.append((number, sketch))
                while sketches and len(ahead) <= workers:
                    number, sketch = sketches.popleft()
                    ahead.append((number, sketch, pool.submit(mosaic.render, sketch)))
                if not ahead:
                    return valid
                number, sketch, job = ahead.popleft()
                tile = job.result()
                cache.finished(number, sketch.keys)
                if tile is not None:
                    data, mask = tile
                    writer.write_tile(sketch.task.row, sketch.task.col, data, mask)
                    valid += data.shape[0] * data.shape[1] if mask is None else int(mask.sum())
                done += 1
                feedback.progress(done / len(plan.tiles), f"tile {done} of {len(plan.tiles)}")
                check_cancelled(feedback)
        finally:
            for _, _, job in ahead:
                job.cancel()
