"""Tool `mosaic`: one picture of the site."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from georef_gis.toolbox import Algorithm, Context, Feedback, Output, Result
from processing_algorithms.mosaic.parameters import MosaicParameters

if TYPE_CHECKING:
    from georef_gis.rasters.warp import ImageCache
    from processing_algorithms.mosaic.cluster import Cluster
    from processing_algorithms.mosaic.inputs import Inputs
    from processing_algorithms.mosaic.ready import Ready
    from processing_algorithms.mosaic.tiles import TileSink


class MosaicTool(Algorithm[MosaicParameters]):
    """One mosaic of all photos as a cloud-optimised GeoTIFF.

    Once the photos are adjusted, seams are laid where neighbouring photos differ least, exposure,
    vignetting and the hot spot of the sun are evened out, and brightness is blended. The seams are
    the layer `seams.gpkg` of the project folder: edited there, they are used at the next run.
    Before, the photo whose nadir is nearest wins, with a soft change to the next. A doubtful photo
    gives way to any that is not. Works tile by tile: the memory does not grow with the number of
    photos.
    """

    id, name, group = "mosaic", "Mosaic", "mosaic"
    outputs = (
        Output(name="mosaic", title="Mosaic", type="RasterLayer"),
        Output(name="seams", title="Seams, to be edited", type="VectorLayer"),
    )
    needs, gives = ("footprints",), ("mosaic",)
    in_run = True
    first_answer = True
    uses_quick = True
    uses_settings = ("products", "ground")

    def inputs(self, context: Context, parameters: MosaicParameters) -> Sequence[Path]:
        """The photos' pixels, and the seams where a user may have edited them."""
        from georef_gis.project.seam_layer import SEAMS_FILE, is_edited

        project = context.require_project()
        seams = project.folder / SEAMS_FILE
        # the tool's own seams are a product; edited ones are what it works from
        return [*project.photo_files(), *([seams] if is_edited(seams) else [])]

    def run(self, context: Context, parameters: MosaicParameters, feedback: Feedback) -> Result:
        """Make it."""
        from georef_gis.mosaic.job import read_photo
        from georef_gis.project.seam_layer import SEAMS_FILE
        from georef_gis.rasters.warp import ImageCache, one_thread_each
        from processing_algorithms.mosaic.inputs import gather
        from processing_algorithms.mosaic.ready import made_ready
        from processing_algorithms.site import load_footprints, load_site

        project = context.require_project()
        if not project.settings.products.mosaic:
            feedback.info("the mosaic is switched off ([products] mosaic = false)")
            return Result(summary={})
        site = load_site(project, quick=context.quick)
        footprints = {k: f for k, f in load_footprints(project).items() if k in site.photos}
        cache = ImageCache(read=read_photo)
        inputs = gather(site, footprints, parameters.gsd or project.settings.products.gsd_m, cache)
        target = project.products / "mosaic.tif"
        # One thread a tile: OpenCV's own threads cost more than they gain on pieces this small.
        with one_thread_each(), _cluster(context, parameters) as cluster:
            ready = made_ready(context, parameters, inputs, feedback)
            made = _written(context, inputs, ready, cache, cluster, target, feedback)
        for message in made.doubts:
            feedback.warn(message)
        facts = {"path": str(target), "gsd_m": inputs.gsd, "photos": list(inputs.footprints)}
        project.database.set_meta(mosaic=facts | made.told)
        summary = {
            "products": [str(target)],
            "gsd_m": inputs.gsd,
            "covered_m2": made.valid * inputs.gsd**2,
            "photos": len(inputs.footprints),
            "size_px": [inputs.grid.width, inputs.grid.height],
            "tiles": len(inputs.plan.tiles),
            "decodes_per_photo": round(cache.decodes / max(len(inputs.footprints), 1), 2),
            **ready.told,
            **made.told,
            "doubts": made.doubts,
        }
        outputs = {"mosaic": target}
        if ready.told["seams"] != "none":
            outputs["seams"] = project.folder / SEAMS_FILE
        return Result(outputs=outputs, summary=summary)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Written:
    """What became of a mosaic: valid pixels, what is to be said of its photos, how seams meet."""

    valid: int
    doubts: list[str]
    told: dict[str, Any]


def _written(
    context: Context,
    inputs: Inputs,
    ready: Ready,
    cache: ImageCache,
    cluster: Cluster | None,
    target: Path,
    feedback: Feedback,
) -> _Written:
    """Write the mosaic, or go on writing it.

    Raises
    ------
    GeometryError
        If no photo shows the ground.
    ExportError
        If there is no room; what is finished stays.
    """
    from georef_gis.errors import GeometryError
    from georef_gis.rasters.reading import count_valid
    from georef_gis.rasters.space import check_room
    from georef_gis.rasters.writer import TiledWriter
    from processing_algorithms.mosaic.inputs import mosaic_profile
    from processing_algorithms.mosaic.tiles import TileSink

    project, broken = context.require_project(), list(ready.broken)
    profile = mosaic_profile(project, inputs, feedback)
    work = project.cache / "mosaic" / "tiles"
    check_room(target, profile, len(ready.plan.tiles), work=work)
    with TiledWriter(target, profile, resume=ready.key, work=work) as writer:
        if writer.resumption.note:
            feedback.info(writer.resumption.note)
        kept, sink = int(writer.done.sum()), TileSink(writer)
        rest = replace(ready, plan=ready.plan.without(writer.done))
        broken += _rendered(rest, cache, cluster, sink, context.workers, feedback)
        if not sink.valid and not kept:
            raise GeometryError(broken[0] if broken else "no photo shows the ground")
    if kept:
        feedback.info(f"{kept} tiles had been finished by an earlier run")
    return _Written(
        valid=count_valid(target) if kept else sink.valid,
        doubts=list(dict.fromkeys([*inputs.doubts, *broken])),
        told=_mismatch(ready, sink),
    )


def _mismatch(ready: Ready, sink: TileSink) -> dict[str, Any]:
    """How far photos lie apart at the seams; nothing where no place tells."""
    if ready.job.probe is None:
        return {}
    found = ready.job.probe.result(sink.shifts)
    return {"seam_mismatch": found.as_json()} if found.accepted else {}


def _rendered(
    ready: Ready,
    cache: ImageCache,
    cluster: Cluster | None,
    sink: TileSink,
    workers: int,
    feedback: Feedback,
) -> list[str]:
    """Make the tiles of a plan; messages of photos that could not be read."""
    from georef_gis.mosaic.tile_maker import TileMaker
    from processing_algorithms.mosaic.cluster import render_on_cluster
    from processing_algorithms.mosaic.tiles import render_tiles

    broken: list[str] = []
    if cluster is None:
        maker = TileMaker(ready.job, cache.get, broken)
        render_tiles(maker, ready.plan, cache, sink, max(1, workers), feedback)
    else:
        render_on_cluster(cluster, ready.job, ready.plan, cache, sink, feedback, broken)
    return broken


@contextmanager
def _cluster(context: Context, parameters: MosaicParameters) -> Iterator[Cluster | None]:
    """Cluster that the user wants; None = threads of this process."""
    if not parameters.cluster:
        yield None
        return
    from georef_gis.mosaic.job import PhotoRoot
    from processing_algorithms.mosaic.cluster import reached

    project = context.require_project()
    here = project.path(project.settings.photos.folder)
    with reached(
        parameters.cluster, workers=max(1, context.workers), folder=project.cache / "mosaic",
        photos=PhotoRoot(here=here, there=parameters.photos_root),
    ) as cluster:  # fmt: skip
        yield cluster
