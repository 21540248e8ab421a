"""Tool `orthos`: one orthorectified GeoTIFF per photo."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from pathlib import Path
from typing import TYPE_CHECKING

from georef_gis.toolbox import Algorithm, Context, Feedback, Output, Result, check_cancelled
from georef_gis.toolbox import parameters as p

if TYPE_CHECKING:
    from georef_gis.model.layers import Footprint
    from georef_gis.project import Project
    from processing_algorithms.site import Site


class OrthosParameters(p.Parameters):
    """Parameters of `orthos`."""

    gsd: p.Length | None = p.length(
        None,
        title="Ground sample distance; by default the photos' own",
        unit="m",
        ge=0.0005,
        le=100,
    )
    photos: p.PhotoSet = p.photo_set()


class Orthos(Algorithm[OrthosParameters]):
    """Orthorectified GeoTIFF of every photo.

    Each photo is laid on the ground (flat or DEM) in the project's CRS: exact to a tenth of a pixel
    against a projection of every single pixel. Cloud-optimised, with overviews and a mask.
    """

    id, name, group = "orthos", "Orthos", "rectify"
    outputs = (Output(name="folder", title="Orthos", type="Folder"),)
    needs, gives = ("footprints",), ("orthos",)
    in_run = True
    uses_quick = True
    uses_settings = ("products", "ground")

    def inputs(self, context: Context, parameters: OrthosParameters) -> Sequence[Path]:
        """The photos' pixels."""
        return context.require_project().photo_files()

    def run(self, context: Context, parameters: OrthosParameters, feedback: Feedback) -> Result:
        """Make them, some at a time."""
        from georef_gis.errors import GeorefError
        from processing_algorithms.site import load_footprints, load_site

        project = context.require_project()
        folder = project.products / "orthos"
        if not project.settings.products.orthos:
            feedback.info("orthos are switched off ([products] orthos = false)")
            return Result(summary={"orthos": 0})
        site = load_site(project, quick=context.quick)
        footprints = _chosen(load_footprints(project), parameters.photos)
        gsd = parameters.gsd or project.settings.products.gsd_m
        jobs = [key for key in footprints if key in site.photos]
        folder.mkdir(parents=True, exist_ok=True)
        done: dict[str, Path] = {}
        refused: list[str] = []
        # At most a few in flight: a photo of 50 MP takes 150 MB.
        with ThreadPoolExecutor(max_workers=max(1, context.workers)) as pool:
            running: dict[Future[Path], str] = {}
            waiting = iter(jobs)
            while True:
                for key in waiting:
                    job = pool.submit(
                        _ortho, project, site, footprints[key], _file(folder, key), gsd
                    )
                    running[job] = key
                    if len(running) >= max(1, context.workers):
                        break
                if not running:
                    break
                for job in wait(running, return_when=FIRST_COMPLETED).done:
                    key = running.pop(job)
                    try:
                        done[key] = job.result()
                    except GeorefError as error:
                        refused.append(f"{key}: {error}" if key not in str(error) else str(error))
                feedback.progress(len(done) / len(jobs), f"{len(done)} of {len(jobs)} orthos")
                check_cancelled(feedback)
        for message in refused:
            feedback.warn(message)
        if not done:
            raise GeorefError(refused[0] if refused else "there is no photo to rectify")
        _remove_old(project, folder, done)
        summary = {
            "products": [str(folder)],
            "orthos": len(done),
            "doubts": refused,
        }
        return Result(outputs={"folder": folder}, summary=summary)


def _file(folder: Path, photo_id: str) -> Path:
    """Target of a photo; ids of photos in subfolders hold slashes."""
    return folder / (photo_id.replace("/", "_").replace("\\", "_").rsplit(".", 1)[0] + ".tif")


def _chosen(footprints: dict[str, Footprint], names: Sequence[str]) -> dict[str, Footprint]:
    from fnmatch import fnmatchcase

    from georef_gis.errors import InputError

    if not names:
        return footprints
    chosen = {
        key: value
        for key, value in footprints.items()
        if any(fnmatchcase(key.lower(), n.lower()) or fnmatchcase(
            key.rsplit(".", 1)[0].lower(), n.lower()) for n in names)
    }  # fmt: skip
    if not chosen:
        raise InputError(f"no photo is called {', '.join(names)}", field="photos")
    return chosen


def _ortho(
    project: Project, site: Site, footprint: Footprint, target: Path, gsd: float | None
) -> Path:
    from georef_gis.rasters.reading import read_image
    from georef_gis.rasters.warp import reduction_for
    from georef_gis.rectify.grids import plan_grid
    from georef_gis.rectify.orthos import write_ortho
    from processing_algorithms.rasters import ground_of, profile_for

    photo = site.photos[footprint.photo_id]
    grid = plan_grid([footprint], site.frame, gsd=gsd)
    pixel = grid.pixel * site.gsd_unit
    image = read_image(photo.photo.path, reduce=reduction_for(pixel, footprint.gsd))
    profile = profile_for(
        project,
        site.frame,
        grid,
        bands=image.shape[2],
        dtype=str(image.dtype),
        title=f"{photo.id} ({site.pose_kinds[photo.id]})",
    )
    write_ortho(photo, image, footprint, ground_of(site, grid), profile, grid, target, gsd=pixel)
    return target


def _remove_old(project: Project, folder: Path, done: dict[str, Path]) -> None:
    """Remove orthos of an earlier run whose photo is no longer there."""
    names = sorted(path.name for path in done.values())
    for name in set(project.database.meta("orthos", [])) - set(names):
        (folder / name).unlink(missing_ok=True)
    project.database.set_meta(orthos=names)
