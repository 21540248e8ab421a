"""STAC items: one per photo with pose, camera and footprint, and one of the mosaic."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from exports.metadata import stac_parts as parts
from exports.metadata.checksums import sha256
from exports.metadata.files import metadata_path
from exports.metadata.stac_camera import camera_properties, pose_properties
from exports.site.build import parts_of, place
from exports.site.columns import Layer
from georef_gis.units import utc_from_gps

if TYPE_CHECKING:
    from exports.metadata.facts import SiteFacts
    from exports.site.values import SitePhoto
    from georef_gis.model.photo import Photo

PHOTOS, MOSAIC = "photos", "mosaic.json"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Item:
    """An item, and the file in the catalogue's folder that is to hold it."""

    file: str
    document: dict[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Catalogue:
    """What all items of a catalogue share.

    Parameters
    ----------
    folder
        Of the catalogue, as it will be named; it need not be there yet.
    names
        Photo id -> name of its files.
    thumbnails
        Photo id or ``mosaic`` -> file in the folder.
    """

    facts: SiteFacts
    folder: Path
    collection: str
    names: Mapping[str, str]
    thumbnails: Mapping[str, str]

    def item(
        self, name: str, file: str, properties: Mapping[str, Any],
        assets: Mapping[str, Mapping[str, Any]], shape: Mapping[str, Any],
    ) -> Item:  # fmt: skip
        """Item with the links that all have."""
        up = "../" * file.count("/")
        document: dict[str, Any] = {
            "type": "Feature", "stac_version": parts.STAC_VERSION,
            "stac_extensions": parts.extensions_of(properties, *assets.values()),
            "id": parts.plain(name),
        }  # fmt: skip
        if shape.get("bbox") is not None:
            document["bbox"] = shape["bbox"]
        document |= {
            "geometry": shape.get("geometry"), "properties": dict(properties),
            "collection": self.collection, "assets": dict(assets),
            "links": [parts.link(rel, f"{up}collection.json")
                      for rel in ("root", "parent", "collection")],
        }  # fmt: skip
        return Item(file=file, document=document)

    def thumbnail(self, name: str, file: str) -> dict[str, Any]:
        """Asset of a thumbnail, by its key; empty without one."""
        made = self.thumbnails.get(name)
        if made is None:
            return {}
        up = "../" * file.count("/")
        return {"thumbnail": {
            "href": up + made, "type": "image/jpeg", "roles": ["thumbnail"], "title": "Thumbnail",
        }}  # fmt: skip

    def base(self, file: str) -> Path:
        """Folder of an item's file."""
        return (self.folder / file).parent


# -- photos ------------------------------------------------------------------------------------


def photo_items(catalogue: Catalogue) -> list[Item]:
    """Items of all photos, also of those without a place."""
    site = catalogue.facts.layers
    prints = site.layers["footprints"]
    outlines = dict(zip(prints.columns["photo"].tolist(), parts.shapes(prints), strict=True))
    sigma = {f.photo_id: f.sigma_horizontal for f in site.footprints}
    layer = site.layers["photos"]
    points = dict(zip(layer.columns["photo"].tolist(), parts.shapes(layer), strict=True))
    values = {str(f.values["photo"]): f.values for f in layer.features}
    return [
        _photo_item(
            catalogue, one, values.get(one.photo.id, {}),
            outlines.get(one.photo.id) or _flat(points.get(one.photo.id)),
            sigma.get(one.photo.id),
        )
        for one in site.photos
    ]  # fmt: skip


def _flat(shape: Mapping[str, Any] | None) -> dict[str, Any]:
    """A point without its height, with a box; nothing of nothing."""
    if shape is None:
        return {}
    lon, lat = shape["geometry"]["coordinates"][:2]
    return {"geometry": {"type": "Point", "coordinates": [lon, lat]}, "bbox": [lon, lat] * 2}


def _photo_item(
    catalogue: Catalogue, one: SitePhoto, values: Mapping[str, Any], shape: Mapping[str, Any],
    sigma: float | None,
) -> Item:  # fmt: skip
    site, photo = catalogue.facts.layers, one.photo
    name = catalogue.names[photo.id]
    file = f"{PHOTOS}/{name}/{name}.json"
    properties: dict[str, Any] = {
        "title": parts.plain(photo.path.name), **_photo_times(catalogue.facts, one)
    }  # fmt: skip
    if instrument := _instrument(photo):
        properties["instruments"] = [parts.plain(instrument)]
    if values.get("gsd_m"):
        properties["gsd"] = round(float(values["gsd_m"]), 6)
    properties |= pose_properties(site, one) | camera_properties(site, one)
    properties |= _angles(values, one)
    properties |= parts.accuracy_properties(None, _finite(sigma))
    if doubts := (*photo.doubts, *one.doubts):
        properties["georef:doubts"] = [parts.plain(doubt) for doubt in doubts]
    assets = _photo_assets(catalogue, one, file)
    return catalogue.item(photo.id, file, properties, assets, shape)


def _finite(value: float | None) -> float | None:
    """A number; None where it is not known, as a database has it too."""
    return value if value is not None and math.isfinite(value) else None


def _instrument(photo: Photo) -> str:
    """Make and model, which often begins with the make."""
    return photo.model if photo.model.startswith(photo.make) else f"{photo.make} {photo.model}"


def _photo_times(facts: SiteFacts, one: SitePhoto) -> dict[str, Any]:
    """Time of exposure, or the range in which it lies, and on what that rests."""
    photo = one.photo
    if photo.time_gps is not None:
        return parts.times(utc_from_gps(facts.layers.epoch_gps + photo.time_gps), None)
    if photo.camera_clock is None:
        return {**parts.times(None, None), "georef:time": "unknown: the range is a formality"}
    return {
        **parts.times(None, parts.span_of_clock(photo.camera_clock)),
        "georef:time": "by the camera's clock, whose time zone is not known: the range holds all",
        "georef:camera_clock": photo.camera_clock.isoformat(),
    }


def _angles(values: Mapping[str, Any], one: SitePhoto) -> dict[str, Any]:
    """Pose for people, and its sigmas."""
    if one.pose is None:
        return {"georef:pose": "none"}
    names = (
        "height_ellipsoidal_m", "height_orthometric_m", "height_above_ground_m", "height_kind",
        "yaw_deg", "pitch_deg", "roll_deg", "omega_deg", "phi_deg", "kappa_deg",
        "sigma_e_m", "sigma_n_m", "sigma_u_m", "sigma_yaw_deg", "sigma_pitch_deg",
        "sigma_roll_deg",
    )  # fmt: skip
    out: dict[str, Any] = {"georef:pose": one.pose.kind}
    tilt = values.get("tilt_deg")
    if isinstance(tilt, float) and 0.0 <= tilt <= 90.0:
        out["view:off_nadir"] = round(tilt, 6)
    for name in names:
        value = values.get(name)
        if value is not None:
            out[f"georef:{name}"] = round(value, 6) if isinstance(value, float) else value
    return out


def _photo_assets(catalogue: Catalogue, one: SitePhoto, file: str) -> dict[str, Any]:
    """The photo, its ortho and its thumbnail; what is not there is left out."""
    photo, base = one.photo, catalogue.base(file)
    found: dict[str, Any] = {"photo": {
        "href": parts.href(photo.path, base), "title": "Photo as taken", "roles": ["data"],
        "type": parts.MEDIA.get(photo.path.suffix.lower(), "application/octet-stream"),
    }}  # fmt: skip
    if photo.path.is_file():
        found["photo"] |= parts.file_facts(photo.path)
    else:
        found["photo"]["description"] = "was not there when this was written"
    ortho = catalogue.facts.project.products / "orthos" / f"{photo.path.stem}.tif"
    if ortho.is_file() and (grid := raster_fields(catalogue.facts, ortho)):
        found["ortho"] = {
            "href": parts.href(ortho, base), "title": "Ortho", "type": parts.COG,
            "roles": ["data", "visual"], **parts.file_facts(ortho), **grid,
        }  # fmt: skip
    return found | catalogue.thumbnail(photo.id, file)


# -- rasters -----------------------------------------------------------------------------------


def raster_fields(facts: SiteFacts, path: Path) -> dict[str, Any]:
    """Projection and bands of a GeoTIFF; empty if it cannot be read."""
    import rasterio
    from rasterio.errors import RasterioError

    try:
        with rasterio.open(path) as file:
            t, wkt = file.transform, file.crs.to_wkt() if file.crs else ""
            shape, names, kinds = [file.height, file.width], file.descriptions, file.dtypes
            nodata = file.nodata
    except RasterioError:
        return {}
    bands: list[dict[str, Any]] = [
        {"name": parts.plain(name or str(i)), "data_type": kind}
        for i, (name, kind) in enumerate(zip(names, kinds, strict=True), start=1)
    ]
    if nodata is not None and math.isfinite(nodata):
        bands = [{**band, "nodata": nodata} for band in bands]
    return {
        **_crs_fields(facts, wkt), "proj:shape": shape, "proj:transform": list(t)[:6],
        "bands": bands,
    }  # fmt: skip


def _crs_fields(facts: SiteFacts, wkt: str) -> dict[str, Any]:
    """CRS by its code and in full; of one without a code the code is null, as it should be."""
    from georef_gis.geodesy import CRS, same_crs

    ours = facts.layers.crs
    crs = ours if wkt and same_crs(wkt, ours.to_wkt()) else (CRS.from_wkt(wkt) if wkt else None)
    if crs is None:
        return {"proj:code": None}
    code = crs.to_authority(min_confidence=100)
    return {"proj:code": ":".join(code) if code else None, "proj:wkt2": crs.to_wkt()}


def mosaic_item(catalogue: Catalogue, path: Path, fields: Mapping[str, Any]) -> Item:
    """Item of the mosaic."""
    facts = catalogue.facts
    properties: dict[str, Any] = {
        "title": f"{parts.plain(facts.layers.name)}: mosaic", **parts.times(None, _span(facts)),
        "georef:photos": len(facts.layers.photos),
    }  # fmt: skip
    if facts.flown is None:
        properties["georef:time"] = "not known in UTC: the range is that of the photos' items"
    if gsd := facts.layers.facts.get("georef:mosaic_gsd_m"):
        properties["gsd"] = float(gsd)
    sigmas = [_finite(f.sigma_horizontal) for f in facts.layers.footprints]
    known = [sigma for sigma in sigmas if sigma is not None]
    expected = float(np.median(known)) if known else None
    properties |= parts.accuracy_properties(facts.accuracy, expected)
    base = catalogue.base(MOSAIC)
    assets: dict[str, Any] = {"mosaic": {
        "href": parts.href(path, base), "title": "Mosaic", "type": parts.COG,
        "roles": ["data", "visual"], **parts.file_facts(path, sha256(path)), **fields,
    }}  # fmt: skip
    for key, beside, media, title in (
        ("metadata", metadata_path(path), "application/xml", "ISO 19115 metadata"),
        ("accuracy", path.with_name("accuracy.txt"), "text/plain", "Accuracy statement"),
    ):
        if beside.is_file():
            assets[key] = {"href": parts.href(beside, base), "type": media, "title": title,
                           "roles": ["metadata"]}  # fmt: skip
    assets |= catalogue.thumbnail("mosaic", MOSAIC)
    return catalogue.item("mosaic", MOSAIC, properties, assets, _outline(facts, fields))


def _span(facts: SiteFacts) -> tuple[datetime, datetime] | None:
    """First and last exposure: in UTC, else the range that the cameras' clocks allow."""
    if facts.flown is not None:
        return facts.flown
    clocks = [p.photo.camera_clock for p in facts.layers.photos if p.photo.camera_clock]
    if not clocks:
        return None
    return parts.span_of_clock(min(clocks))[0], parts.span_of_clock(max(clocks))[1]


def _outline(facts: SiteFacts, fields: Mapping[str, Any]) -> dict[str, Any]:
    """Border of a raster in the project's CRS as a polygon, its sides bent as on the globe."""
    rows, columns = fields["proj:shape"]
    a, b, c, d, e, f = fields["proj:transform"]
    t = np.arange(8) / 8.0
    ones, zeros = np.ones(8), np.zeros(8)
    # counter-clockwise from the lower left
    u = np.concatenate([t, ones, 1.0 - t, zeros, [0.0]]) * columns
    v = np.concatenate([ones, 1.0 - t, zeros, t, [1.0]]) * rows
    xy = np.column_stack([a * u + b * v + c, d * u + e * v + f, np.zeros(len(u))])
    geo = facts.layers.frame.geo_from_map(xy)
    if not np.all(np.isfinite(geo)):
        return {}
    places = parts_of([place(facts.layers.frame, geo)])
    layer = Layer(name="outline", title="", geometry="Polygon", fields=(), places=places,
                  measured_heights=False)  # fmt: skip
    return parts.shapes(layer)[0]
