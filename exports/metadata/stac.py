"""Exporter of a STAC catalogue: photos with their poses, and the mosaic, where they lie."""

from __future__ import annotations

from collections.abc import Generator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

from exports.poses.tagged_photos import final_folder
from georef_gis.errors import ExportError
from georef_gis.toolbox import Exporter, ExportReport, Feedback, LayerSource, check_cancelled
from georef_gis.toolbox import parameters as p

if TYPE_CHECKING:
    from exports.metadata.facts import SiteFacts
    from exports.metadata.stac_items import Item
    from georef_gis.model.photo import Photo

COLLECTION = "collection.json"
_SPDX = frozenset("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789-.+")


class StacOptions(p.Parameters):
    """Options of the STAC catalogue."""

    items: p.Choice = p.choice(
        "all",
        title="Items",
        help="all: one per photo and one of the mosaic; photos: only those; mosaic: only that.",
        choices=("all", "photos", "mosaic"),
    )
    thumbnails: p.Flag = p.flag(
        True, title="Thumbnails", help="Small pictures of photos and mosaic in the folder."
    )
    thumbnail_px: p.Integer = p.integer(
        256, title="Size of thumbnails", help="Longer side, px.", ge=32, le=2048
    )


class Stac(Exporter[StacOptions]):
    """A STAC 1.1 collection: photos with pose, camera and footprint, and the mosaic.

    Files stay where they are and are linked relative to the folder: move both together. Poses are
    in the perspective-imagery extension, accuracies in the accuracy extension, as far as those go.
    A photo without a time in UTC has the range in which its time lies.
    """

    id = "stac"
    name = "STAC catalogue (folder)"
    suffix = ""
    accepts = ("site",)
    target = "stac"
    wants = ("adjusted", "footprints", "orthos", "mosaic", "accuracy")

    def write(
        self, source: LayerSource, target: Path, options: StacOptions, feedback: Feedback
    ) -> ExportReport:
        """Write the catalogue into the folder `target`."""
        from exports.metadata.facts import SiteFacts
        from exports.site.site import SiteLayers

        site = SiteLayers.from_project(source.project)
        return write_stac(SiteFacts.of(source.project, site), target, options, feedback)


def write_stac(
    facts: SiteFacts, target: Path, options: StacOptions, feedback: Feedback
) -> ExportReport:
    """Catalogue of a site.

    Raises
    ------
    ExportError
        If there is nothing to write.
    """
    from exports.metadata.stac_items import (
        PHOTOS,
        Catalogue,
        mosaic_item,
        photo_items,
        raster_fields,
    )
    from exports.metadata.stac_parts import slug, slugs, write_json

    site = facts.layers
    mosaic = site.mosaic if options.items != "photos" else None
    fields = raster_fields(facts, mosaic) if mosaic is not None else {}
    if options.items == "mosaic" and not fields:
        raise ExportError(
            f"{facts.project.products / 'mosaic.tif'}: is not there or cannot be read; run "
            "`georef run` first"
        )
    target.mkdir(parents=True)
    with_photos = options.items != "mosaic"
    names = slugs([one.photo.id for one in site.photos])
    thumbnails = _photo_thumbnails(facts, target, options, feedback, names)
    if fields and mosaic is not None and options.thumbnails:
        thumbnails |= _mosaic_thumbnail(mosaic, target, options.thumbnail_px)
    catalogue = Catalogue(
        facts=facts, folder=final_folder(target).absolute(), collection=slug(site.name),
        names=names, thumbnails=thumbnails,
    )  # fmt: skip
    items: list[Item] = photo_items(catalogue) if with_photos else []
    if mosaic is not None and fields:
        items.append(mosaic_item(catalogue, mosaic, fields))
    for item in items:
        write_json(target / item.file, item.document)
    write_json(target / COLLECTION, collection(facts, catalogue.collection, items))
    for warning in (warnings := _warnings(facts, items, PHOTOS)):
        feedback.warn(warning)
    return ExportReport(
        crs="EPSG:4326", height_kind="ellipsoidal", features=len(items), warnings=warnings
    )


def collection(facts: SiteFacts, name: str, items: Sequence[Item]) -> dict[str, Any]:
    """Collection of a site; it is the root of the catalogue."""
    from exports.metadata.stac_parts import STAC_VERSION, link, plain, union

    site, who = facts.layers, facts.project.settings.metadata
    boxes = [item.document["bbox"] for item in items if "bbox" in item.document]
    said = plain(site.name)
    document: dict[str, Any] = {
        "type": "Collection", "stac_version": STAC_VERSION, "stac_extensions": [], "id": name,
        "title": said,
        "description": f"{said}: {len(site.photos)} aerial photos and what georef_gis made of them",
        "license": who.licence if who.licence and set(who.licence) <= _SPDX else "other",
        "extent": {
            "spatial": {"bbox": [union(boxes) or [-180.0, -90.0, 180.0, 90.0]]},
            "temporal": {"interval": [_interval(items)]},
        },
        "summaries": {"georef:heights": ["ellipsoidal, m"],
                      "georef:crs": [plain(site.crs_name)]},
    }  # fmt: skip
    if who.organisation.strip():
        document["providers"] = [{"name": plain(who.organisation), "roles": ["producer"]}]
    if who.licence and document["license"] == "other":
        document["georef:licence"] = plain(who.licence)
    document["links"] = [
        link("root", f"./{COLLECTION}", said),
        *(link("item", f"./{item.file}", item.document["properties"]["title"],
               "application/geo+json") for item in items),
    ]  # fmt: skip
    return document


def _interval(items: Sequence[Item]) -> list[str | None]:
    """From the first to the last time; open where a photo's is not known at all."""
    starts, ends = [], []
    for item in items:
        said: Mapping[str, Any] = item.document["properties"]
        if "georef:time" in said and str(said["georef:time"]).startswith("unknown"):
            return [None, None]
        starts.append(said["datetime"] or said["start_datetime"])
        ends.append(said["datetime"] or said["end_datetime"])
    return [min(starts), max(ends)] if starts else [None, None]


def _warnings(facts: SiteFacts, items: Sequence[Item], folder: str) -> tuple[str, ...]:
    """What is less than it might seem."""
    photos = [item for item in items if item.file.startswith(f"{folder}/")]
    out = list(facts.layers.warnings)
    loose = [item for item in photos if item.document["properties"]["datetime"] is None]
    if loose:
        out.append(f"{len(loose)} of {len(photos)} photos have no time in UTC: a range is written")
    nowhere = [item for item in photos if item.document["geometry"] is None]
    if nowhere:
        out.append(f"{len(nowhere)} of {len(photos)} photos have no place: geometry is null")
    return tuple(out)


def _photo_thumbnails(
    facts: SiteFacts,
    target: Path,
    options: StacOptions,
    feedback: Feedback,
    names: Mapping[str, str],
) -> dict[str, str]:
    """Write small pictures of the photos; photo id -> file in the folder."""
    if not options.thumbnails or options.items == "mosaic":
        return {}
    from exports.metadata.stac_items import PHOTOS

    made: dict[str, str] = {}
    photos = [one.photo for one in facts.layers.photos]
    with closing(_pictures(photos, options.thumbnail_px)) as pictures:
        for number, (photo, data) in enumerate(pictures):
            check_cancelled(feedback)
            feedback.progress(0.9 * number / len(photos), photo.path.name)
            if data is not None:
                name = names[photo.id]
                made[photo.id] = f"{PHOTOS}/{name}/{name}.jpg"
                (target / made[photo.id]).parent.mkdir(parents=True)
                (target / made[photo.id]).write_bytes(data)
    return made


def _pictures(
    photos: Sequence[Photo], side: int
) -> Generator[tuple[Photo, bytes | None], None, None]:
    """Photos in order with their thumbnails, made in threads: decoding leaves Python's lock."""
    from exports.kml.thumbnails import WORKERS, thumbnail

    pool = ThreadPoolExecutor(WORKERS)
    try:
        yield from zip(photos, pool.map(lambda photo: thumbnail(photo, side), photos), strict=True)
    finally:
        pool.shutdown(cancel_futures=True)


def _mosaic_thumbnail(path: Path, target: Path, side: int) -> dict[str, str]:
    """Write a JPEG of an 8-bit mosaic, white where it has no content; ``mosaic`` -> file."""
    import cv2
    import numpy as np
    import rasterio

    with rasterio.open(path) as file:
        if file.dtypes[0] != "uint8":
            return {}
        scale = side / max(file.width, file.height)
        size = max(1, round(file.height * scale)), max(1, round(file.width * scale))
        bands = (3, 2, 1) if file.count >= 3 else (1,)
        image = np.moveaxis(file.read(bands, out_shape=(len(bands), *size)), 0, -1)
        image[file.dataset_mask(out_shape=size) == 0] = 255
    done, jpeg = cv2.imencode(".jpg", np.ascontiguousarray(image))
    if not done:
        return {}
    (target / "mosaic.jpg").write_bytes(jpeg.tobytes())
    return {"mosaic": "mosaic.jpg"}
