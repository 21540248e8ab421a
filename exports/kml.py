"""Exporters to Google Earth: KMZ with thumbnails and the mosaic, and plain KML."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, Literal, cast

from exports.schemas import ASSETS
from georef_gis.errors import ExportError
from georef_gis.toolbox import Exporter, ExportReport, Feedback, LayerSource, check_cancelled
from georef_gis.toolbox import parameters as p

if TYPE_CHECKING:
    from exports.kml_elements import Element
    from exports.kml_files import Spool
    from exports.kml_picture import MosaicPicture
    from exports.site import SiteLayers

VECTORS = ("photos", "footprints", "track", "control", *ASSETS)
CRS = "EPSG:4326"
HEIGHT_KIND = "orthometric (EGM96)"


class KmzOptions(p.Parameters):
    """Options of the KMZ."""

    thumbnails: p.Flag = p.flag(True, title="Thumbnails", help="A small picture in every balloon.")
    thumbnail_px: p.Integer = p.integer(
        320, title="Longer side of a thumbnail", unit="px", ge=64, le=2048, advanced=True
    )
    overlay: Literal["auto", "pyramid", "single", "none"] = p.choice(
        "auto",
        title="Mosaic",
        help="auto = one picture up to 2048 px, else a pyramid of tiles; a single picture is "
        "made smaller to 2048 px and is what phones and browsers show.",
    )
    max_mb: p.Number | None = p.number(
        None, title="Largest size", unit="MB", help="The mosaic is made coarser to fit.", gt=0
    )
    max_zoom: p.Integer | None = p.integer(
        None, title="Deepest level of the pyramid", help="0 is one tile of 256 px; each level "
        "halves the pixel.", ge=0, le=24, advanced=True,
    )  # fmt: skip
    quality: p.Integer = p.integer(
        80, title="JPEG quality of the mosaic", ge=1, le=100, advanced=True
    )


class KmlOptions(p.Parameters):
    """Options of the plain KML."""


class Kmz(Exporter[KmzOptions]):
    """Site for Google Earth: photos, footprints, track, control, assets and mosaic in one KMZ.

    Photo points and the track stand at their height above sea level (EGM96), footprints lie on
    the ground. The mosaic is a pyramid of tiles that load as one comes closer.
    """

    id = "kmz"
    name = "KMZ (Google Earth)"
    suffix = ".kmz"
    accepts = ("site",)
    target = "site.kmz"
    in_run = True
    needs = ("photos", "poses", "footprints", "mosaic")
    wants = ("adjusted", "control", "accuracy")

    def write(
        self, source: LayerSource, target: Path, options: KmzOptions, feedback: Feedback
    ) -> ExportReport:
        """Write the site to `target`."""
        from exports.site import SiteLayers

        return write_kmz(SiteLayers.from_project(source.project), target, options, feedback)


class Kml(Exporter[KmlOptions]):
    """Photos, footprints, flight track, control and assets as one plain KML, without pictures."""

    id = "kml"
    name = "KML (vectors)"
    suffix = ".kml"
    accepts = ("site", "vector")
    target = "site.kml"
    needs = ("photos", "poses", "footprints")

    def write(
        self, source: LayerSource, target: Path, options: KmlOptions, feedback: Feedback
    ) -> ExportReport:
        """Write the site, or one of its layers, to `target`."""
        from exports.site import SiteLayers

        site = SiteLayers.from_project(source.project)
        names = VECTORS if source.kind == "site" else site.names_of(source.layer)
        report = write_kml(site, target, names)
        for warning in report.warnings:
            feedback.warn(warning)
        return report


def write_kml(site: SiteLayers, target: Path, names: tuple[str, ...] = VECTORS) -> ExportReport:
    """Plain KML of layers of a site.

    Raises
    ------
    ExportError
        If a layer cannot be shown in KML.
    """
    from exports.kml_site import write_document

    layers = {layer.name: layer for layer in map(site.layer, names)}
    if "cameras" in layers:
        raise ExportError("KML cannot hold cameras, which have no place; use GeoPackage")
    if "tie_points" in layers:
        raise ExportError("tie points are too many for KML; use GeoPackage")
    if set(names) <= {"control", *ASSETS} and not any(x.features for x in layers.values()):
        raise ExportError(site.why_empty(names))
    with target.open("wb") as stream:
        write_document(stream, site, layers, thumbnails={})
    features = sum(len(layer.features) for layer in layers.values())
    return ExportReport(crs=CRS, height_kind=HEIGHT_KIND, features=features, warnings=site.warnings)


def write_kmz(
    site: SiteLayers, target: Path, options: KmzOptions, feedback: Feedback
) -> ExportReport:
    """KMZ of a site; memory is bounded, the parts wait on disk beside the target.

    Raises
    ------
    ExportError
        If even without mosaic it is larger than `max_mb`.
    """
    from exports.kml_files import Counter, Spool, camera_icon, write_zip
    from exports.kml_site import ICON, write_document

    warnings = list(site.warnings)
    layers = {name: site.layers[name] for name in VECTORS}
    with Spool(target.parent) as spool:
        spool.add(ICON, camera_icon())
        thumbnails = _thumbnails(site, spool, options, feedback, warnings)
        write = partial(write_document, site=site, layers=layers, thumbnails=thumbnails, icon=ICON)
        rest = 0
        if options.max_mb is not None:
            counter = Counter()
            write(cast(BinaryIO, counter))
            rest = counter.packed
            _check_size(spool.size + rest, options, target)
        overlay = _overlay(site, spool, rest, options, feedback, warnings)
        check_cancelled(feedback)
        write_zip(target, partial(write, overlay=overlay), spool)
    feedback.progress(1.0, "zipped")
    if site.unplaced:
        warnings.append(_list("photos left out, as they have no position", site.unplaced))
    for warning in warnings:
        feedback.warn(warning)
    features = sum(len(layer.features) for layer in layers.values())
    return ExportReport(
        crs=CRS, height_kind=HEIGHT_KIND, features=features, warnings=tuple(warnings)
    )


def _thumbnails(
    site: SiteLayers,
    spool: Spool,
    options: KmzOptions,
    feedback: Feedback,
    warnings: list[str],
) -> dict[str, str]:
    """Thumbnails into the spool; gives photo id -> path."""
    from exports.kml_files import add_thumbnails

    placed = {str(f.values["photo"]) for f in site.layers["photos"].features}
    photos = [s.photo for s in site.photos if s.photo.id in placed]
    if not options.thumbnails or not photos:
        return {}

    def tick(done: int) -> None:
        check_cancelled(feedback)
        feedback.progress(0.4 * done / len(photos), f"thumbnail {done} of {len(photos)}")

    thumbnails = add_thumbnails(spool, photos, options.thumbnail_px, tick)
    missing = [photo.id for photo in photos if photo.id not in thumbnails]
    if missing:
        warnings.append(_list("photos without thumbnail, as they cannot be read", missing))
    return thumbnails


def _list(what: str, names: list[str] | tuple[str, ...]) -> str:
    more = f" and {len(names) - 5} more" if len(names) > 5 else ""
    return f"{what}: {', '.join(names[:5])}{more}"


def _check_size(size: int, options: KmzOptions, target: Path) -> None:
    if options.max_mb is not None and size > options.max_mb * 1e6:
        raise ExportError(
            f"{target.name}: {size / 1e6:.1f} MB without the mosaic, more than max_mb = "
            f"{options.max_mb:g}; leave out the thumbnails or allow more"
        )


def _overlay(
    site: SiteLayers,
    spool: Spool,
    rest: int,
    options: KmzOptions,
    feedback: Feedback,
    warnings: list[str],
) -> Element | None:
    """Mosaic into the spool; gives the element of the document that shows it."""
    if site.mosaic is None or options.overlay == "none":
        return None
    from exports.kml_overlay import SINGLE_SIDE
    from exports.kml_picture import MosaicPicture

    budget = None if options.max_mb is None else options.max_mb * 1e6 - rest - spool.size
    with MosaicPicture(site.mosaic, site.frame) as picture:
        side = max(picture.grid.width, picture.grid.height)
        if options.overlay == "single" or (options.overlay == "auto" and side <= SINGLE_SIDE):
            element = _single(picture, spool, budget, options)
        else:
            element = _pyramid(picture, spool, budget, options, feedback)
    if element is None:
        warnings.append("the mosaic is left out: it is empty, or does not fit into max_mb")
    return element


def _single(
    picture: MosaicPicture, spool: Spool, budget: float | None, options: KmzOptions
) -> Element | None:
    from exports.kml_overlay import SINGLE_SIDE, single_overlay

    mark, side = spool.mark(), SINGLE_SIDE
    while side >= 128:
        element = single_overlay(picture, spool, side=side, quality=options.quality)
        if element is None or budget is None or spool.size - mark[1] <= budget:
            return element
        spool.rewind(mark)
        side //= 2
    return None


def _pyramid(
    picture: MosaicPicture,
    spool: Spool,
    budget: float | None,
    options: KmzOptions,
    feedback: Feedback,
) -> Element | None:
    from exports.kml_overlay import Pyramid, depth_within, levels, pyramid_link

    def tick(fraction: float) -> None:
        check_cancelled(feedback)
        feedback.progress(0.4 + 0.6 * min(fraction, 1.0), "mosaic tiles")

    def quiet(fraction: float) -> None:
        del fraction
        check_cancelled(feedback)

    depth = levels(picture.grid)
    if options.max_zoom is not None:
        depth = min(depth, options.max_zoom)
    if budget is not None:
        depth = depth_within(picture, depth, options.quality, budget, quiet)
    mark = spool.mark()
    while depth >= 0:
        pyramid = Pyramid(
            picture=picture, sink=spool, depth=depth, quality=options.quality, tick=tick
        )
        if not pyramid.write():
            return None
        if budget is None or spool.size - mark[1] <= budget:
            return pyramid_link(pyramid)
        spool.rewind(mark)
        depth -= 1
    return None
