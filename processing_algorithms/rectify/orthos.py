"""Tool `orthos`: one orthorectified GeoTIFF per photo."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
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
        every = load_footprints(project)
        footprints = _chosen(every, parameters.photos)
        files = _files(folder, list(every))
        gsd = parameters.gsd or project.settings.products.gsd_m
        jobs = [key for key in footprints if key in site.photos]
        _make(folder)

        def ortho(key: str, halt: threading.Event) -> Path:
            return _ortho(project, site, footprints[key], files[key], gsd, halt)

        done, refused = _each(jobs, ortho, max(1, context.workers), feedback)
        for message in refused:
            feedback.warn(message)
        if not done:
            raise GeorefError(refused[0] if refused else "there is no photo to rectify")
        kept = {path for key, path in files.items() if key not in jobs} | set(done.values())
        _remove_old(project, folder, kept)
        summary = {
            "products": [str(folder)],
            "orthos": len(done),
            "doubts": refused,
        }
        return Result(outputs={"folder": folder}, summary=summary)


def _make(folder: Path) -> None:
    from georef_gis.errors import ExportError

    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ExportError(
            f"{folder}: the folder of the orthos cannot be made ({error.strerror}); is a file "
            "in its place?"
        ) from error


def _each(
    jobs: Sequence[str],
    ortho: Callable[[str, threading.Event], Path],
    workers: int,
    feedback: Feedback,
) -> tuple[dict[str, Path], list[str]]:
    """Files of the orthos that could be made, by photo, and why the others could not."""
    from georef_gis.errors import ExportError, GeorefError
    from georef_gis.rasters.warp import one_thread_each

    done: dict[str, Path] = {}
    refused: list[str] = []
    halt = threading.Event()
    with one_thread_each(), ThreadPoolExecutor(max_workers=workers) as pool, _set_on_error(halt):
        running: dict[Future[Path], str] = {}
        waiting = iter(jobs)
        while True:
            # At most a few in flight: a photo of 50 MP takes 150 MB.
            for key in waiting:
                running[pool.submit(ortho, key, halt)] = key
                if len(running) >= workers:
                    break
            if not running:
                return done, refused
            for job in wait(running, return_when=FIRST_COMPLETED).done:
                key = running.pop(job)
                try:
                    done[key] = job.result()
                except ExportError:
                    # Not the photo's fault, but the disk's: the other orthos fare no better.
                    raise
                except GeorefError as error:
                    refused.append(f"{key}: {error}" if key not in str(error) else str(error))
            feedback.progress(len(done) / len(jobs), f"{len(done)} of {len(jobs)} orthos")
            check_cancelled(feedback)


@contextmanager
def _set_on_error(halt: threading.Event) -> Iterator[None]:
    """Tell the threads to stop when the work is broken off: the pool waits for them."""
    try:
        yield
    except BaseException:
        halt.set()
        raise


def _files(folder: Path, photo_ids: Sequence[str]) -> dict[str, Path]:
    """Target of each photo, no two the same.

    An id that is a path (where names repeat) loses its slashes and its ending, unless another
    photo's file would then have that name, as with IMG_1.JPG beside IMG_1.TIF.
    """
    from collections import Counter
    from pathlib import PurePath

    flat = {key: key.replace("/", "_").replace("\\", "_") for key in photo_ids}
    ending = {".jpg", ".jpeg", ".tif", ".tiff"}
    short = {k: PurePath(v).stem if PurePath(v).suffix.lower() in ending else v
             for k, v in flat.items()}  # fmt: skip
    counts = Counter(name.lower() for name in short.values())
    names = {k: v if counts[v.lower()] == 1 else flat[k] for k, v in short.items()}
    out: dict[str, Path] = {}
    taken: set[str] = set()
    for key, name in names.items():
        unique, number = name, 2
        while unique.lower() in taken:
            unique, number = f"{name}_{number}", number + 1
        taken.add(unique.lower())
        out[key] = folder / f"{unique}.tif"
    return out


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
    project: Project,
    site: Site,
    footprint: Footprint,
    target: Path,
    gsd: float | None,
    halt: threading.Event,
) -> Path:
    from georef_gis.rasters.reading import read_image
    from georef_gis.rasters.warp import reduction_for
    from georef_gis.rectify.grids import plan_grid
    from georef_gis.rectify.orthos import OrthoTarget, write_ortho
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
    goal = OrthoTarget(path=target, profile=profile, grid=grid, gsd=pixel)
    write_ortho(photo, image, footprint, ground_of(site, grid), goal, cancelled=halt.is_set)
    return target


def _remove_old(project: Project, folder: Path, kept: set[Path]) -> None:
    """Remove orthos of an earlier run whose photo is no longer there or could not be used."""
    names = sorted(path.name for path in kept if path.is_file())
    for name in set(project.database.meta("orthos", [])) - set(names):
        (folder / name).unlink(missing_ok=True)
    project.database.set_meta(orthos=names)
