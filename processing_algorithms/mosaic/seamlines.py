"""Colour and seams of a project's mosaic: prepared once, then rendered tile by tile."""

from __future__ import annotations

import hashlib
import math
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from georef_gis.toolbox import Feedback, check_cancelled

if TYPE_CHECKING:
    from georef_gis.model.grid import Grid, Window
    from georef_gis.model.mesh import Ground
    from georef_gis.model.plan import Plan
    from georef_gis.mosaic.coarse import SparseRaster
    from georef_gis.mosaic.low_blend import LowBlend
    from georef_gis.mosaic.nadir import MosaicSource
    from georef_gis.mosaic.prepare import Balanced
    from georef_gis.mosaic.proxies import CorrectedProxies, ProxyStore
    from georef_gis.mosaic.seam_raster import SeamIndex
    from georef_gis.mosaic.seam_steps import SeamSteps
    from georef_gis.mosaic.seamed import ColourField
    from georef_gis.project import Project
    from georef_gis.rasters.warp import Image
    from processing_algorithms.mosaic.inputs import Inputs

# px of the mosaic; a photo goes over into the next within so much of a seam: little where low
# frequencies are blended already
REACH = {"multiband": 4.0, "feather": 32.0, "none": 0.5}
# folder of the cache
PROXIES = Path("mosaic") / "proxies"
# mosaics whose proxies are kept: the last, and one of another GSD or other poses
KEPT_FOLDERS = 2
# photos whose largest grey value is looked for
LOOKED_AT = 40
# of the way tiles are made: what an older one finished does not fit beside new tiles
VERSION = 1
ColourChoice = Literal["full", "gain", "none"]
BlendChoice = Literal["multiband", "feather", "none"]


@dataclass(frozen=True, slots=True, kw_only=True)
class SeamWishes:
    """How a mosaic's photos are joined; names as of the tool's parameters."""

    optimised: bool
    colour: ColourChoice
    blend: BlendChoice


class PolygonSeams:
    """Seams as polygons; what a tile needs is told by the labels on the coarse grid."""

    def __init__(
        self, index: SeamIndex, grid: Grid, labels: SparseRaster, *, factor: int, reach: float
    ) -> None:
        self.index, self.grid, self.labels = index, grid, labels
        self.factor, self.reach = factor, reach

    def labels_in(self, window: Window) -> list[int]:
        """Labels that may have some weight in a window of the fine grid."""
        import numpy as np

        from georef_gis.model.grid import Window

        # borders are smoothed by less than two coarse pixels
        grown = math.ceil(self.reach / self.factor) + 2
        col, row = window.col // self.factor - grown, window.row // self.factor - grown
        right = (window.col + window.width) // self.factor + grown + 1
        bottom = (window.row + window.height) // self.factor + grown + 1
        part = Window(col=col, row=row, width=right - col, height=bottom - row)
        return [int(k) for k in np.unique(self.labels.read(part)) if k >= 0]

    def weights(self, window: Window) -> Mapping[int, Any]:
        """Weight of each label at each pixel."""
        from georef_gis.mosaic.seam_raster import seam_weights

        return seam_weights(self.index, self.grid, window, self.reach)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Prepared:
    """All that tiles are made from, and what was measured on the way."""

    sources: tuple[MosaicSource, ...]
    ground: Ground
    grid: Grid
    seams: PolygonSeams
    field: ColourField | None
    balanced: Balanced | None
    steps: SeamSteps
    broken: tuple[str, ...]
    edited: bool
    wishes: SeamWishes
    # of the photos, their poses and the ground
    fingerprint: str
    # grey value found in the photos
    largest: float

    @property
    def key(self) -> str:
        """Name of all that the tiles follow from: they can be kept under it."""
        digest = hashlib.blake2b(digest_size=12)
        digest.update(repr((self.fingerprint, self.wishes, VERSION)).encode())
        digest.update(self.seams.index.edges.tobytes())
        digest.update(self.seams.index.labels.tobytes())
        return digest.hexdigest()

    def told(self, inputs: Inputs) -> dict[str, Any]:
        """For the run's summary: what was done, and how well photos meet."""
        ends = inputs.value_range(self.largest)
        scale = self.largest if ends is None else ends[1]
        how = "edited" if self.edited else "optimised" if self.wishes.optimised else "nearest"
        return {
            "seams": how,
            "colour": self.wishes.colour,
            "blend": self.wishes.blend,
            "colour_step": self.steps.as_json(scale),
        }


def prepare(
    project: Project,
    inputs: Inputs,
    sources: Mapping[str, MosaicSource],
    *,
    wishes: SeamWishes,
    read: Callable[[Path, int], Image],
    workers: int,
    feedback: Feedback,
) -> Prepared:
    """Decide colour, seams and low frequencies of a mosaic.

    Raises
    ------
    Cancelled
        If the user wants to stop; the photos' proxies that are finished stay.
    """
    from georef_gis.mosaic.coarse import coarse_grid
    from georef_gis.mosaic.prepare import make_proxies
    from georef_gis.mosaic.proxies import CorrectedProxies
    from georef_gis.mosaic.seamed import ColourField
    from processing_algorithms.mosaic.seam_file import project_seams
    from processing_algorithms.rasters import ground_of

    grid, ground = inputs.grid, ground_of(inputs.site, inputs.grid)
    check = partial(check_cancelled, feedback)
    factor = _factor(sources, inputs.gsd)
    coarse = coarse_grid(grid, factor)
    make = partial(
        make_proxies, ground=ground, read=read, workers=workers,
        progress=_told(feedback, 0.0, 0.15),
    )  # fmt: skip
    store, sources, broken = _proxies(project, inputs, coarse, sources, ground, make)
    largest = _largest(store)
    balanced = _balanced(store, ground, inputs, sources, wishes, largest, check)
    corrected = CorrectedProxies(store, balanced.model, ground)
    found = project_seams(
        project, corrected, coarse, inputs.site.frame, optimised=wishes.optimised,
        workers=workers, feedback=feedback, progress=_told(feedback, 0.15, 0.1),
    )  # fmt: skip
    blend, steps = _blended(
        corrected, found.labels, coarse, wishes, bands=inputs.kind[0], workers=workers, check=check
    )
    _told(feedback, 0.25, 0.05)(1.0)
    field = None
    if wishes.colour != "none" or blend is not None:
        field = ColourField(colour=balanced.model, blend=blend, proxies=corrected, factor=factor)
    seams = PolygonSeams(found.index, grid, found.labels, factor=factor, reach=REACH[wishes.blend])
    return Prepared(
        sources=tuple(sources.values()), ground=ground, grid=grid, seams=seams, field=field,
        balanced=balanced, steps=steps, broken=tuple(broken), edited=found.edited, wishes=wishes,
        fingerprint=store.name, largest=largest,
    )  # fmt: skip


def _told(feedback: Feedback, first: float, share: float) -> Callable[[float], None]:
    """Progress of a part of the preparation, at which the user may stop."""

    def progress(fraction: float) -> None:
        check_cancelled(feedback)
        feedback.progress(first + share * fraction, "colour and seams")

    return progress


def replanned(plan: Plan, seams: PolygonSeams, capacity: int) -> Plan:
    """Plan in the order that suits the photos that tiles really need."""
    from georef_gis.model.tile_order import best_order

    cells = [(task.row, task.col) for task in plan.tiles]
    needed = [[str(k) for k in seams.labels_in(task.window)] for task in plan.tiles]
    order = best_order(cells, needed, capacity=capacity)
    return replace(plan, tiles=tuple(plan.tiles[k] for k in order))


def _factor(sources: Mapping[str, MosaicSource], gsd: float) -> int:
    """Fine pixels in a coarse one, by the photos' median length on the mosaic."""
    import numpy as np

    from georef_gis.mosaic.coarse import coarse_factor

    # a reach is half a diagonal, the longer side some 0.8 of it for frames of 4:3
    return coarse_factor(float(np.median([1.6 * s.reach / gsd for s in sources.values()])))


def _proxies(
    project: Project,
    inputs: Inputs,
    coarse: Grid,
    sources: Mapping[str, MosaicSource],
    ground: Ground,
    make: Callable[[ProxyStore], dict[int, str]],
) -> tuple[ProxyStore, dict[str, MosaicSource], list[str]]:
    """Proxies of all photos that can be read; the others are left out."""
    from georef_gis.errors import InputError
    from georef_gis.mosaic.proxies import ProxyPhoto, ProxyStore, proxy_window
    from georef_gis.rasters.warp import reduction_for
    from processing_algorithms.mosaic.inputs import fingerprint_of

    pixel = coarse.pixel * inputs.site.gsd_unit

    def store_of(keys: Sequence[str]) -> ProxyStore:
        photos = [
            ProxyPhoto(
                photo=sources[key].photo,
                window=proxy_window(coarse, inputs.footprints[key].ring_map),
                reduce=reduction_for(pixel, inputs.footprints[key].gsd),
                reach=sources[key].reach,
                doubtful=sources[key].doubtful,
            )
            for key in keys
        ]
        used = [sources[key] for key in keys]
        folder = project.cache / PROXIES / fingerprint_of(project, used, coarse, ground)
        return ProxyStore(folder, photos, coarse)

    keys, messages = list(sources), list[str]()
    # a share that goes away may take more photos while the others are read again
    while True:
        store = store_of(keys)
        broken = make(store)
        _tidy(project.cache / PROXIES, keep=KEPT_FOLDERS)
        if not broken:
            return store, {key: sources[key] for key in keys}, messages
        messages += broken.values()
        keys = [key for k, key in enumerate(keys) if k not in broken]
        if not keys:
            raise InputError(messages[0])


def _largest(store: ProxyStore) -> float:
    """Largest grey value of the photos, of some of many."""
    import numpy as np

    step = max(1, len(store.ids) // LOOKED_AT)
    found = [np.max(np.abs(store.load(k).data)) for k in range(0, len(store.ids), step)]
    return max(float(np.max(found)), 1e-6)


def _tidy(folder: Path, *, keep: int) -> None:
    """Drop the proxies of mosaics that were made long ago: each takes 0.4 MB a photo."""
    if not folder.is_dir():
        return
    found = sorted(folder.iterdir(), key=lambda path: path.stat().st_mtime, reverse=True)
    for path in found[keep:]:
        shutil.rmtree(path, ignore_errors=True)


def _blended(
    corrected: CorrectedProxies,
    labels: SparseRaster,
    coarse: Grid,
    wishes: SeamWishes,
    *,
    bands: int,
    workers: int,
    check: Callable[[], None],
) -> tuple[LowBlend | None, SeamSteps]:
    """Low frequencies, if they are to be blended, and the steps that are left at the seams."""
    from georef_gis.mosaic.low_blend import blend_low
    from georef_gis.mosaic.seam_steps import measure_steps

    blend = None
    if wishes.blend == "multiband":
        blend = blend_low(corrected, labels, coarse, bands, check, workers)
    return blend, measure_steps(corrected, labels, blend, bands, check)


def _balanced(
    store: ProxyStore,
    ground: Ground,
    inputs: Inputs,
    sources: Mapping[str, MosaicSource],
    wishes: SeamWishes,
    largest: float,
    check: Callable[[], None],
) -> Balanced:
    from georef_gis.mosaic.prepare import balance

    photos = [inputs.site.photos[key].photo for key in sources]
    return balance(
        store, ground,
        cameras=[photo.camera_id for photo in photos],
        flights=[photo.flight_id for photo in photos],
        mode=wishes.colour, value_range=inputs.value_range(largest), check=check,
        # three bands of 8 bits are a picture with a camera's curve; "gain" keeps linear ones so
        bent=wishes.colour == "full" and inputs.kind == (3, "uint8"),
    )  # fmt: skip
