"""How a KMZ is made light: fewer features, fields and vertices, smaller pictures."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from exports.kml.files import Counter, Spool, write_zip
from exports.kml.options import VECTORS, listed, told_of
from exports.kml.overlay import sheets
from exports.kml.package import Package, open_mosaic
from exports.kml.photos import pinholes
from exports.kml.selection import slimmed, taken
from exports.kml.site_kml import Shown, write_document
from georef_gis.errors import ExportError
from georef_gis.toolbox import ExportReport, Feedback, check_cancelled

if TYPE_CHECKING:
    from exports.kml.options import LightKmzOptions
    from exports.site.columns import Layer
    from exports.site.site import SiteLayers
    from georef_gis.project import Project

# px; sides of the mosaic and of thumbnails that are tried, one after the other; rims of the first
# have all their colours, the others few
MOSAIC_SIDES = (4096, 4096, 3072, 2048, 1024, 512, 256)
THUMBNAIL_SIDES = (240, 128)
# px; small pictures, so that few of them are at the rim and not JPEG
SHEET = 512
QUALITY = 75
# Part of the size that thumbnails may take, and that is kept free for what is not counted
THUMBNAIL_SHARE, SPARE = 0.35, 0.02
# Vertices of a line or area, characters of a text
MOST_VERTICES, LONGEST = 200, 200
TRACK_HZ = 1.0
# What is told of a feature
FIELDS: Mapping[str, tuple[str, ...]] = {
    "photos": (
        "photo", "time_utc", "camera_clock", "height_orthometric_m", "height_above_ground_m",
        "yaw_deg", "sigma_e_m", "sigma_n_m", "sigma_u_m", "pose_kind", "gsd_m", "doubts",
    ),
    "footprints": ("photo", "gsd_m", "tilt_deg", "sigma_horizontal_m"),
    **dict.fromkeys(
        ("asset_points", "asset_lines", "asset_polygons"),
        (
            "asset_id", "class", "name", "note", "attributes", "height_orthometric_m", "sigma_e_m",
            "sigma_n_m", "sigma_u_m", "n_rays", "method", "changed",
        ),
    ),
}  # fmt: skip


def write_light(
    site: SiteLayers,
    target: Path,
    options: LightKmzOptions,
    feedback: Feedback,
    project: Project | None,
) -> ExportReport:
    """Light KMZ of a site; see `light_kmz.write_light_kmz`."""
    limit = options.max_mb * 1e6
    most = options.features
    whole, unfit = told_of({name: site.layers[name] for name in VECTORS})
    while most >= 1:
        check_cancelled(feedback)
        with Spool(target.parent) as spool:
            layers, told = fewer(whole, most)
            package = Package(site=site, layers=layers, spool=spool, feedback=feedback)
            package.warnings += [*site.warnings, *unfit, *told]
            work = _Light(package=package, limit=limit, most=most, project=project)
            if work.fits() and work.write(target):
                feedback.progress(1.0, "zipped")
                return package.report()
        most //= 4
    raise ExportError(
        f"not even one feature of each kind fits into a KMZ of max_mb = {options.max_mb:g}; "
        "allow more"
    )


@dataclass(kw_only=True)
class _Light:
    """One attempt at a light KMZ.

    Parameters
    ----------
    limit
        Bytes of the file, and of its document unpacked.
    most
        Features, and samples of the flight.
    """

    package: Package
    limit: float
    most: int
    project: Project | None
    shown: Shown = field(init=False)

    def fits(self) -> bool:
        """Take what is always shown, then thumbnails and mosaic as they fit."""
        package = self.package
        looks = package.looks()
        flown = package.flights(self.project, TRACK_HZ, self.most)
        self.shown = Shown(
            layers=package.layers, looks=looks, icons=True, flights=flown, line=True, fields=FIELDS,
            longest=LONGEST, screens=package.screens(looks, flown=bool(flown)),
        )  # fmt: skip
        if self._left() < 0:
            return False
        self._add_thumbnails()
        self._add_mosaic()
        return True

    def write(self, target: Path) -> bool:
        """Write the file; False if it is larger than was counted."""
        note = self._note()
        shown = replace(self.shown, note=note)
        whole = partial(write_document, site=self.package.site, shown=shown)
        write_zip(target, whole, self.package.spool)
        if target.stat().st_size <= self.limit:
            return True
        target.unlink()
        return False

    def _note(self) -> str:
        return " ".join(
            [" This is the light version of the site.", *(f"{w}." for w in self.package.warnings)]
        )

    def _left(self) -> float:
        """Bytes that are left; negative where the document is too large."""
        counter = Counter()
        write_document(counter, self.package.site, replace(self.shown, note=self._note()))
        if counter.plain > self.limit:
            return -1.0
        return self.limit * (1.0 - SPARE) - self.package.spool.size - counter.packed

    def _add_thumbnails(self) -> None:
        package = self.package
        if not len(package.layers["photos"]):
            return
        mark, told = package.spool.mark(), list(package.warnings)
        pairs = pinholes(package.site)
        for side in THUMBNAIL_SIDES:
            found = package.thumbnails(side, pairs)
            bytes_ = package.spool.size - mark[1]
            if bytes_ <= min(THUMBNAIL_SHARE * self.limit, self._left() + bytes_):
                self.shown = replace(self.shown, thumbnails=found)
                return
            package.spool.rewind(mark)
            package.warnings[:] = told
        package.warnings.append("thumbnails are left out, as they do not fit")

    def _add_mosaic(self) -> None:
        package = self.package
        if package.site.mosaic is None:
            return
        picture = open_mosaic(package)
        if picture is None:
            return
        left, mark = self._left(), package.spool.mark()
        with picture:
            widest = max(picture.grid.width, picture.grid.height)
            for number, side in enumerate(MOSAIC_SIDES):
                check_cancelled(package.feedback)
                package.feedback.progress(0.6, f"mosaic of {side} px")
                shown = sheets(
                    picture,
                    package.spool,
                    side=side,
                    sheet=SHEET,
                    quality=QUALITY,
                    small=number > 0,
                )
                if shown is None or package.spool.size - mark[1] + len(shown) <= left:
                    break
                package.spool.rewind(mark)
                shown = None
        if shown is None:
            package.warnings.append("the mosaic is left out: it is empty, or does not fit")
            return
        self.shown = replace(self.shown, overlay=shown)
        if side < widest:
            package.warnings.append(
                f"the mosaic's pixels are {math.ceil(widest / side)} times as large as they "
                "were; the large KMZ has them all"
            )


def fewer(layers: Mapping[str, Layer], most: int) -> tuple[dict[str, Layer], list[str]]:
    """Layers of at most `most` features in all, evenly taken, and what to say of it.

    Small layers stay whole; photos and footprints keep the same photos.
    """
    share = shares({name: len(layer) for name, layer in layers.items()}, most)
    out: dict[str, Layer] = {}
    left_out, coarser = [], []
    for name, layer in layers.items():
        count, kept = share[name], layer
        if count < len(layer):
            left_out.append(f"{layer.title.lower()} {count} of {len(layer)}")
            kept = taken(layer, np.linspace(0, len(layer) - 1, count).astype(int))
        out[name] = slimmed(kept, MOST_VERTICES)
        if out[name] is not kept:
            coarser.append(layer.title.lower())
    told = []
    if left_out:
        told.append(f"of many features some are left out: {', '.join(left_out)}")
    if coarser:
        told.append(listed("lines of many vertices are drawn with fewer", coarser))
    return out, told


def shares(sizes: Mapping[str, int], most: int) -> dict[str, int]:
    """How many features of each layer are kept: all of small ones, the rest shared evenly."""
    out: dict[str, int] = {}
    left = most
    for number, (name, size) in enumerate(sorted(sizes.items(), key=lambda x: (x[1], x[0]))):
        out[name] = min(size, left // (len(sizes) - number))
        left -= out[name]
    return out
