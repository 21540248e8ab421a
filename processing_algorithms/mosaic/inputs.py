"""What a mosaic is made of: photos of one kind, grid, tiles, file profile, renderers' sources."""

from __future__ import annotations

import hashlib
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from georef_gis.toolbox import Feedback

if TYPE_CHECKING:
    from georef_gis.model.grid import Grid
    from georef_gis.model.layers import Footprint
    from georef_gis.model.mesh import Ground
    from georef_gis.model.plan import Plan
    from georef_gis.mosaic.nadir import MosaicSource
    from georef_gis.project import Project
    from georef_gis.rasters.profile import RasterProfile
    from georef_gis.rasters.warp import ImageCache
    from processing_algorithms.site import Site

# of the way photos are read: what was made from pixels read otherwise does not fit beside new ones
READING = 2


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Inputs:
    """What a mosaic is made of.

    Parameters
    ----------
    kind
        Number and type of the bands.
    doubts
        Messages of photos that are of another kind, and of alpha channels.
    capacity
        Photos that the cache of pixels holds.
    """

    site: Site
    footprints: Mapping[str, Footprint]
    grid: Grid
    plan: Plan
    kind: tuple[int, str]
    doubts: tuple[str, ...]
    capacity: int

    @property
    def gsd(self) -> float:
        """Pixel size on the ground, m."""
        return self.grid.pixel * self.site.gsd_unit

    def value_range(self, largest: float) -> tuple[float, float] | None:
        """Least and largest grey value of a sensor; None for floats, which have no end.

        Parameters
        ----------
        largest
            Value found in the photos: 16 bits hold sensors of 10, 12, 14 bits.
        """
        if self.kind[1] == "uint8":
            return 0.0, 255.0
        if self.kind[1] != "uint16":
            return None
        bits = min(max(math.ceil(math.log2(largest + 1.0)), 8), 16)
        return 0.0, 2.0**bits - 1.0


def gather(
    site: Site, footprints: Mapping[str, Footprint], gsd: float | None, cache: ImageCache
) -> Inputs:
    """Photos of one kind, grid of `gsd` m, tiles.

    Raises
    ------
    GeometryError
        If no photo has a footprint.
    InputError
        If no photo can be read, or the grid would be absurdly large.
    """
    from georef_gis.errors import InputError
    from georef_gis.rasters.profile import DTYPES

    usable, refused = _same_kind(site, list(footprints))
    kept = {key: footprints[key] for key in usable}
    capacity = cache.capacity(_largest_image(site, usable))
    grid, plan = _planned(site, kept, gsd, capacity)
    kind = _kind_of(site, cache, usable)
    if kind[1] not in DTYPES:
        raise InputError(
            f"the photos have values of type {kind[1]}; a mosaic holds {', '.join(DTYPES)}; "
            "convert them"
        )
    return Inputs(
        site=site, footprints=kept, grid=grid, plan=plan, kind=kind,
        doubts=(*refused, *_alpha_doubts(site, usable)), capacity=capacity,
    )  # fmt: skip


def _largest_image(site: Site, names: Sequence[str]) -> int:
    """Bytes of the largest photo, decoded to 8 bits."""
    photos = [site.photos[name].photo for name in names]
    return max(photo.width * photo.height * photo.bands for photo in photos)


def _same_kind(site: Site, names: list[str]) -> tuple[list[str], list[str]]:
    """Photos with the most common number and type of bands; others cannot be in one picture."""
    from georef_gis.errors import GeometryError
    from georef_gis.ingest.bands import band_type

    photos = {k: site.photos[k].photo for k in names}
    kinds = {k: f"{photo.bands} x {band_type(photo.tags)}" for k, photo in photos.items()}
    if not kinds:
        raise GeometryError("no photo has a footprint")
    most = Counter(kinds.values()).most_common(1)[0][0]
    refused = [
        f"{photos[k].path.name}: has bands {own} where most photos have {most}: not in the mosaic; "
        "make it a mosaic of its own"
        for k, own in kinds.items()
        if own != most
    ]
    return [k for k, own in kinds.items() if own == most], refused


def _alpha_doubts(site: Site, names: Sequence[str]) -> list[str]:
    """One line on photos with an alpha channel, if there are any."""
    from georef_gis.ingest.bands import alpha_count

    photos = [site.photos[name].photo for name in names]
    found = [photo.path.name for photo in photos if alpha_count(photo.tags)]
    if not found:
        return []
    more = f", as have {len(found) - 1} more photos" if len(found) > 1 else ""
    return [
        f"{found[0]}: has an alpha channel{more}: it is left out, and what it hides is shown; crop "
        "that off, or if it is a band, write it as one (gdal_translate -co ALPHA=NO)"
    ]


def _kind_of(site: Site, cache: ImageCache, names: Sequence[str]) -> tuple[int, str]:
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


def mosaic_profile(project: Project, inputs: Inputs, feedback: Feedback) -> RasterProfile:
    """What file to write; names of bands that are not as many as these are warned of."""
    from processing_algorithms.rasters import profile_for

    bands, dtype = inputs.kind
    names = project.settings.products.band_names
    if names and len(names) != bands:
        feedback.warn(f"[products] band_names: {len(names)} names for {bands} bands, not used")
    return profile_for(
        project, inputs.site.frame, inputs.grid, bands=bands, dtype=dtype,
        title=project.settings.project.name or "mosaic",
    )  # fmt: skip


def mosaic_sources(inputs: Inputs) -> dict[str, MosaicSource]:
    """Photos of a mosaic with how they are sampled, in the order of the footprints."""
    from dataclasses import replace

    from georef_gis.mosaic.nadir import mosaic_source
    from georef_gis.rasters.warp import reduction_for
    from processing_algorithms.rasters import ground_of, reach_of

    site, grid = inputs.site, inputs.grid
    ground = ground_of(site, grid)
    out = {}
    for key, f in inputs.footprints.items():
        source = mosaic_source(
            site.photos[key], ground, grid, f.ring_map, reduce=reduction_for(inputs.gsd, f.gsd),
            reach=reach_of(f),
        )  # fmt: skip
        out[key] = replace(source, doubtful=bool(site.doubts[key]))
    return out


def fingerprint_of(
    project: Project, sources: Sequence[MosaicSource], grid: Grid, ground: Ground
) -> str:
    """Name of what photos, their poses and cameras, the ground and a grid determine."""
    import cv2
    import numpy as np

    import georef_gis

    known = {row["photo_id"]: row["fingerprint"] for row in project.database.rows("photo")}
    digest = hashlib.blake2b(digest_size=12)
    # what one version finished does not fit beside what another makes
    versions = (georef_gis.__version__, np.__version__, cv2.__version__, READING)
    digest.update(repr(versions).encode())
    digest.update(repr((grid.transform, grid.width, grid.height, grid.crs_wkt)).encode())
    terrain = ground.terrain
    heights = getattr(terrain, "heights", None)
    where = [getattr(terrain, name, None) for name in ("height_ellipsoidal", "left", "top", "cell")]
    digest.update(repr(where).encode())
    if heights is not None:
        digest.update(np.ascontiguousarray(heights).data)
    for source in sources:
        pose, camera = source.photo.pose, source.photo.camera
        photo = source.photo.photo
        kept = (known.get(photo.id), photo.flight_id, source.reduce, source.reach, camera)
        digest.update(repr(source.doubtful).encode())
        digest.update(repr(kept).encode())
        motion = [v for v in (pose.velocity_enu, pose.rate_enu) if v is not None]
        digest.update(
            np.concatenate([pose.origin_enu, pose.R_enu_from_cam.ravel(), *motion]).tobytes()
        )
    return digest.hexdigest()
