"""The KMZ of a site: pictures, photo views, flight, features and mosaic put together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from exports.kml import elements as k
from exports.kml.files import Counter, Spool, write_zip
from exports.kml.icons import (
    ARROW,
    CAMERA,
    ClassLook,
    arrow_icon,
    camera_icon,
    class_looks,
    encoded,
    icon,
    styles_by_class,
)
from exports.kml.legend import LEGEND, STATEMENT, entries_of, legend, statement
from exports.kml.options import CRS, HEIGHT_KIND, VECTORS, KmzOptions, listed, told_of
from exports.kml.overlay import (
    FOLDERS,
    SINGLE_SIDE,
    Pyramid,
    depth_within,
    levels,
    pyramid_folder,
    single_overlay,
)
from exports.kml.photos import photo_overlays, pinholes
from exports.kml.picture import LatLonGrid, MosaicPicture
from exports.kml.site_kml import (
    CONTROL,
    Shown,
    ellipse_style,
    signs_of,
    statement_of,
    write_document,
)
from exports.kml.thumbnails import Pair, add_thumbnails
from exports.kml.track import Flown, flight_placemarks, flights
from exports.kml.tree import MOST_AT_ONCE, FeatureTree
from exports.site.schemas import ASSETS
from georef_gis.errors import ExportError
from georef_gis.toolbox import ExportReport, Feedback, check_cancelled

if TYPE_CHECKING:
    from exports.site.columns import Layer
    from exports.site.site import SiteLayers
    from georef_gis.project import Project

# Ratio of the widths of pixels at the northern and southern side, beyond which it is told
NARROWING = 1.2


@dataclass(kw_only=True)
class Package:
    """A KMZ in the making.

    Parameters
    ----------
    layers
        What is shown of the site, feature by feature.
    spool
        Where its files wait.
    warnings
        What is to be said of it.
    """

    site: SiteLayers
    layers: Mapping[str, Layer]
    spool: Spool
    feedback: Feedback
    warnings: list[str] = field(default_factory=list)

    def looks(self) -> tuple[ClassLook, ...]:
        """Looks of the classes of assets; their icons and those of the site go to the spool."""
        looks = class_looks(self.layers)
        self.spool.add(CAMERA, camera_icon())
        if len(self.layers["control"]):
            self.spool.add(CONTROL, encoded(icon("triangle", (0, 255, 0))))
        for look in looks:
            if "asset_points" in look.geometries:
                self.spool.add(look.icon, look.picture())
        return looks

    def flights(self, project: Project | None, rate: float, most: int | None) -> list[k.Element]:
        """The flight in time, with its icon."""
        found: list[Flown]
        found, told = flights(project, self.site.layers["photos"])
        self.warnings += told
        flown = flight_placemarks(found, rate, most)
        if flown:
            self.spool.add(ARROW, arrow_icon())
        return flown

    def screens(self, looks: tuple[ClassLook, ...], *, flown: bool) -> list[k.Element]:
        """Legend and statement."""
        entries = entries_of(looks, signs_of(self.layers, flown))
        title = self.site.name or "Site"
        self.spool.add(LEGEND, legend(entries, title))
        self.spool.add(STATEMENT, statement("Accuracy", statement_of(self.site)))
        return [
            k.screen_overlay("Legend", LEGEND, corner=(0, 1)),
            k.screen_overlay("Accuracy statement", STATEMENT, corner=(0, 0)),
        ]

    def thumbnails(self, side: int, pairs: Mapping[str, Pair]) -> dict[str, str]:
        """Thumbnails of the photos that are shown; gives photo id -> path."""
        shown = (
            {str(v) for v in self.layers["photos"].columns["photo"].tolist()}
            if len(self.layers["photos"])
            else set()
        )
        photos = [s.photo for s in self.site.photos if s.photo.id in shown]

        def tick(done: int) -> None:
            check_cancelled(self.feedback)
            self.feedback.progress(0.4 * done / len(photos), f"thumbnail {done} of {len(photos)}")

        found = add_thumbnails(self.spool, photos, pairs, side, tick)
        missing = [photo.id for photo in photos if photo.id not in found]
        if missing:
            what = "photos without thumbnail and view, as they cannot be read"
            self.warnings.append(listed(what, missing))
        return found

    def trees(self, looks: tuple[ClassLook, ...]) -> dict[str, k.Element]:
        """Layers of too many features as files of their own."""
        styles = styles_by_class(looks)
        return {
            name: FeatureTree(
                layer=layer, sink=self.spool, styles=styles, looks=looks,
                more_styles=(ellipse_style(),),
            ).write()
            for name, layer in self.layers.items()
            if name in ASSETS and len(layer) > MOST_AT_ONCE
        }  # fmt: skip

    def report(self) -> ExportReport:
        """What was written; warnings are told."""
        if self.site.unplaced:
            what = "photos left out, as they have no position"
            self.warnings.append(listed(what, self.site.unplaced))
        for warning in self.warnings:
            self.feedback.warn(warning)
        return ExportReport(
            crs=CRS, height_kind=HEIGHT_KIND, warnings=tuple(self.warnings),
            features=sum(len(layer) for layer in self.layers.values()),
        )  # fmt: skip


def write_package(
    site: SiteLayers,
    target: Path,
    options: KmzOptions,
    feedback: Feedback,
    project: Project | None,
) -> ExportReport:
    """KMZ of a site; see `kml.write_kmz`."""
    layers, told = told_of({name: site.layers[name] for name in VECTORS})
    with Spool(target.parent) as spool:
        package = Package(site=site, layers=layers, spool=spool, feedback=feedback)
        package.warnings += [*site.warnings, *told]
        shown = _shown(package, options, project)
        rest = _rest(site, shown, spool, options)
        overlay = _overlay(package, rest, options)
        check_cancelled(feedback)
        whole = partial(write_document, site=site, shown=replace(shown, overlay=overlay))
        if not write_zip(target, whole, spool):
            package.warnings.append(
                "more than 65534 files or 2 GB: viewers that know no ZIP64 do not open such a KMZ, "
                "and Google Earth may be one; set max_mb or max_zoom"
            )
        feedback.progress(1.0, "zipped")
        return package.report()


def _shown(package: Package, options: KmzOptions, project: Project | None) -> Shown:
    site = package.site
    looks = package.looks()
    flown = package.flights(project, options.track_hz, None)
    pairs = pinholes(site)
    thumbnails = package.thumbnails(options.thumbnail_px, pairs) if options.thumbnails else {}
    views = photo_overlays(site, site.photos, pairs, thumbnails) if options.views else []
    return Shown(
        layers=package.layers, looks=looks, icons=True, flights=flown, thumbnails=thumbnails,
        views=views, screens=package.screens(looks, flown=bool(flown)), trees=package.trees(looks),
    )  # fmt: skip


def _rest(site: SiteLayers, shown: Shown, spool: Spool, options: KmzOptions) -> float | None:
    """Bytes that are left for the mosaic; None = as many as it likes.

    Raises
    ------
    ExportError
        If there are none.
    """
    if options.max_mb is None:
        return None
    size = spool.size + packed_size(site, shown)
    if size > options.max_mb * 1e6:
        raise ExportError(
            f"the KMZ has {size / 1e6:.1f} MB without the mosaic, more than max_mb = "
            f"{options.max_mb:g}; leave out the thumbnails or allow more"
        )
    return options.max_mb * 1e6 - size


def packed_size(site: SiteLayers, shown: Shown) -> int:
    """Bytes of the document in a ZIP."""
    counter = Counter()
    write_document(counter, site, shown)
    return counter.packed


# -- mosaic -------------------------------------------------------------------------------------


def _overlay(package: Package, budget: float | None, options: KmzOptions) -> k.Element | None:
    """Mosaic into the spool; gives the element of the document that shows it."""
    if package.site.mosaic is None or options.overlay == "none":
        return None
    picture = open_mosaic(package)
    if picture is None:
        return None
    with picture:
        side = max(picture.grid.width, picture.grid.height)
        if options.overlay == "single" or (options.overlay == "auto" and side <= SINGLE_SIDE):
            element = _single(picture, package.spool, budget, options)
        else:
            element = _pyramid(picture, package, budget, options)
    if element is None:
        package.warnings.append("the mosaic is left out: it is empty, or does not fit into max_mb")
    return element


def open_mosaic(package: Package) -> MosaicPicture | None:
    """The mosaic in longitude and latitude; None, and told, where KML cannot show it."""
    assert package.site.mosaic is not None
    try:
        picture = MosaicPicture(package.site.mosaic, package.site.frame)
    except ExportError as error:
        package.warnings.append(f"the mosaic is left out: {error}")
        return None
    if len(picture.grid.parted()) > 1:
        package.warnings.append("the site crosses the 180th meridian: the mosaic is written as two")
    if picture.narrowing > NARROWING:
        package.warnings.append(
            f"so near to a pole the mosaic's pixels are {picture.narrowing:.1f} times as wide on "
            "one side as on the other; use cog where that matters"
        )
    return picture


def _single(
    picture: MosaicPicture, spool: Spool, budget: float | None, options: KmzOptions
) -> k.Element | None:
    mark, side = spool.mark(), SINGLE_SIDE
    while side >= 128:
        element = single_overlay(picture, spool, side=side, quality=options.quality)
        if element is None or budget is None or spool.size - mark[1] <= budget:
            return element
        spool.rewind(mark)
        side //= 2
    return None


def _pyramid(
    picture: MosaicPicture, package: Package, budget: float | None, options: KmzOptions
) -> k.Element | None:
    """Pyramid of the mosaic, or two at the 180th meridian, coarser until they fit."""
    spool, grids = package.spool, picture.grid.parted()
    depth = max(map(levels, grids))
    if options.max_zoom is not None:
        depth = min(depth, options.max_zoom)
    if budget is not None:

        def quiet(fraction: float) -> None:
            del fraction
            check_cancelled(package.feedback)

        share = budget / len(grids)
        depth = min(
            depth_within(picture, grid, depth, options.quality, share, quiet) for grid in grids
        )
    mark = spool.mark()
    while depth >= 0:
        pyramids = _pyramids(picture, package, grids, depth, options.quality)
        if not pyramids:
            return None
        if budget is None or spool.size - mark[1] <= budget:
            return pyramid_folder(pyramids)
        spool.rewind(mark)
        depth -= 1
    return None


def _pyramids(
    picture: MosaicPicture,
    package: Package,
    grids: tuple[LatLonGrid, ...],
    depth: int,
    quality: int,
) -> list[Pyramid]:
    def tick(fraction: float) -> None:
        check_cancelled(package.feedback)
        package.feedback.progress(0.4 + 0.6 * min(fraction, 1.0), "mosaic tiles")

    made = [
        Pyramid(
            picture=picture, base=grid, sink=package.spool, depth=min(depth, levels(grid)),
            quality=quality, tick=tick, folder=folder,
        )
        for grid, folder in zip(grids, FOLDERS, strict=False)
    ]  # fmt: skip
    return [pyramid for pyramid in made if pyramid.write()]
