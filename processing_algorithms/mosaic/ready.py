"""Who makes the tiles of a mosaic: along seams once the photos are adjusted, else by nadirs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from georef_gis.toolbox import Context, Feedback

if TYPE_CHECKING:
    from georef_gis.model.plan import Plan
    from georef_gis.mosaic.job import MosaicJob
    from georef_gis.mosaic.nadir import MosaicSource
    from processing_algorithms.mosaic.inputs import Inputs
    from processing_algorithms.mosaic.parameters import MosaicParameters

Sources = Mapping[str, "MosaicSource"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ready:
    """All that tiles are made from, in which order, and what is told of it.

    Parameters
    ----------
    broken
        Messages of photos that could not be read.
    told
        For the run's summary.
    key
        Under which finished tiles are kept for a later run.
    """

    job: MosaicJob
    plan: Plan
    broken: tuple[str, ...]
    told: dict[str, Any]
    key: str


def made_ready(
    context: Context, parameters: MosaicParameters, inputs: Inputs, feedback: Feedback
) -> Ready:
    """Decide all that is decided before the first tile.

    Raises
    ------
    InputError
        If no photo can be read, or edited seams cannot be used.
    Cancelled
        If the user wants to stop.
    """
    from processing_algorithms.mosaic.inputs import mosaic_sources
    from processing_algorithms.site import mostly_adjusted

    sources = mosaic_sources(inputs)
    seams = parameters.seams
    if seams == "auto":
        adjusted = mostly_adjusted(inputs.site.pose_kinds[k] for k in sources)
        seams = "optimised" if adjusted and len(sources) > 1 else "none"
    if seams == "none":
        return _by_nadirs(context, inputs, sources, feedback)
    optimised = seams == "optimised"
    return _along_seams(context, parameters, inputs, sources, feedback, optimised=optimised)


def _by_nadirs(context: Context, inputs: Inputs, sources: Sources, feedback: Feedback) -> Ready:
    """Mosaic of the photos nearest to their nadir, their colours as they are."""
    from georef_gis.mosaic.job import MosaicJob
    from georef_gis.project.seam_layer import SEAMS_FILE, is_edited
    from processing_algorithms.mosaic.inputs import fingerprint_of
    from processing_algorithms.rasters import ground_of

    project = context.require_project()
    if is_edited(project.folder / SEAMS_FILE):
        feedback.warn(f"{SEAMS_FILE} was edited, but is not used: seams are none here")
    ground = ground_of(inputs.site, inputs.grid)
    job = MosaicJob(
        sources=tuple(sources.values()), ground=ground, grid=inputs.grid, gsd=inputs.gsd,
        kind=inputs.kind,
    )  # fmt: skip
    key = fingerprint_of(project, job.sources, inputs.grid, ground)
    return Ready(job=job, plan=inputs.plan, broken=(), told={"seams": "none"}, key=key)


def _along_seams(
    context: Context,
    parameters: MosaicParameters,
    inputs: Inputs,
    sources: Sources,
    feedback: Feedback,
    *,
    optimised: bool,
) -> Ready:
    """Mosaic along seams, colours and low frequencies made alike."""
    from georef_gis.mosaic.job import MosaicJob, checked_reader, read_photo
    from georef_gis.mosaic.seam_mismatch import MismatchProbe
    from processing_algorithms.mosaic.seamlines import SeamWishes, prepare, replanned

    wishes = SeamWishes(optimised=optimised, colour=parameters.colour, blend=parameters.blend)
    # pixels are not kept: each photo is reduced once
    found = prepare(
        context.require_project(), inputs, sources, wishes=wishes,
        read=checked_reader(read_photo, inputs.kind), workers=max(1, context.workers),
        feedback=feedback,
    )  # fmt: skip
    job = MosaicJob(
        sources=found.sources, ground=found.ground, grid=found.grid, gsd=inputs.gsd,
        kind=inputs.kind, seams=found.seams, field=found.field,
        probe=MismatchProbe(found.steps.places, factor=found.seams.factor, gsd=inputs.gsd),
    )  # fmt: skip
    plan = replanned(inputs.plan, found.seams, inputs.capacity)
    return Ready(job=job, plan=plan, broken=found.broken, told=found.told(inputs), key=found.key)
