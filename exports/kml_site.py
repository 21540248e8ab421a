"""The KML of a site: photo points, footprints, flight track, surveyed points and assets."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import BinaryIO

import numpy as np

from exports import kml_elements as k
from exports.schemas import ASSETS, ELLIPSES, Feature, Layer, Value
from exports.site import SiteLayers

ASSET_STYLES = {"asset_points": "asset", ELLIPSES: "ellipse"}
ICON = "files/camera.png"
# What a person asks of a photo; the whole table stands in ExtendedData.
PHOTO_TABLE = (
    "time_utc", "camera_clock", "lat_deg", "lon_deg", "height_ellipsoidal_m",
    "height_orthometric_m", "height_above_ground_m", "height_kind", "roll_deg",
    "pitch_deg", "yaw_deg", "omega_deg", "phi_deg", "kappa_deg", "sigma_e_m", "sigma_n_m",
    "sigma_u_m", "sigma_above_ground_m", "sigma_yaw_deg", "pose_kind", "tie_points", "residual_px",
    "gsd_m", "tilt_deg", "camera", "flight", "doubts",
)  # fmt: skip


def write_document(
    stream: BinaryIO,
    site: SiteLayers,
    layers: Mapping[str, Layer],
    *,
    thumbnails: Mapping[str, str],
    icon: str = "",
    overlay: k.Element | None = None,
) -> None:
    """Write the document of a site, feature by feature.

    Parameters
    ----------
    stream
        Takes UTF-8 XML.
    layers
        Those of `site.layers` to write.
    thumbnails
        Photo id -> path of its thumbnail within the KMZ.
    icon
        Path of the photos' icon within the KMZ; empty = the viewer's own.
    overlay
        Folder of the mosaic.
    """
    head: list[k.Element | None] = [
        k.element("name", text=site.name or "Site"),
        k.element("open", text="1"),
        k.element("description", text=_statement(site)),
        k.point_style("photo", icon),
        k.point_style("photo-doubtful", icon, colour="ff00a5ff"),
        k.point_style("control", "", colour="ff00ff00"),
        k.point_style("asset", "", colour="ff00ffff"),
        k.line_style("asset-shape", colour="ff00ffff", width=3.0, fill="4000ffff"),
        k.line_style("ellipse", colour="ff00ffff", width=1.0, fill="2600ffff"),
        k.line_style("footprint", colour="ffffc04d", width=1.2, fill="1affc04d"),
        k.line_style("track", colour="ff00ffff", width=2.0),
        *(
            k.schema(layer)
            for layer in layers.values()
            if layer.features or layer.name not in ASSETS
        ),
        overlay,
    ]
    with k.open_document(stream) as document:
        for part in head:
            if part is not None:
                document.write(part)
        for layer in layers.values():
            if layer.features:
                document.write_folder(layer.title, _placemarks(layer, thumbnails))


def _placemarks(layer: Layer, thumbnails: Mapping[str, str]) -> Iterator[k.Element]:
    for number, feature in enumerate(layer.features, start=1):
        if layer.name == "footprints":
            kind, placemark = "footprint", _footprint(layer, feature)
        elif layer.name == "track":
            kind, placemark = "track", _track(layer, feature)
        elif layer.name == "control":
            kind, placemark = "control", _control(layer, feature)
        elif layer.name in ASSETS:
            kind, placemark = layer.name, _asset(layer, feature)
        else:
            image = thumbnails.get(str(feature.values["photo"]), "")
            kind, placemark = "photo", _photo(layer, feature, image)
        placemark.set("id", f"{kind}-{number}")
        yield placemark


def _statement(site: SiteLayers) -> str:
    facts = site.metadata()
    accuracy = [text for name, text in site.accuracy.items() if "_STATEMENT_" in name]
    told = f" Accuracy: {' '.join(accuracy)}" if accuracy else ""
    return (
        f"{facts['photos']} photos, poses: {facts['poses']}. Positions: WGS 84 longitude and "
        f"latitude (datum of the positions: {facts['datum_of_positions']}). Heights of points and "
        "lines: metres above the EGM96 geoid; in tables as their names say. Sigmas: one standard "
        f"deviation. Project CRS: {facts['crs']}. Made by {facts['made_by']}.{told}"
    )


def _photo(layer: Layer, feature: Feature, image: str) -> k.Element:
    style = "photo-doubtful" if feature.values["doubts"] else "photo"
    name = str(feature.values["photo"])
    balloon = k.balloon(layer, feature, PHOTO_TABLE, title=name, image=image)
    return _placemark(layer, feature, _point(feature), name=name, style=style, balloon=balloon)


def _control(layer: Layer, feature: Feature) -> k.Element:
    return _placemark(layer, feature, _point(feature), name=feature.values["name"], style="control")


def _asset(layer: Layer, feature: Feature) -> k.Element:
    """An asset on the viewer's own ground, which may lie above its height and would hide it."""
    name = str(feature.values["name"] or feature.values["class"] or "")
    style = ASSET_STYLES.get(layer.name, "asset-shape")
    shape = k.element(
        layer.geometry,
        None if layer.geometry == "Point" else k.element("tessellate", text="1"),
        k.element("altitudeMode", text="clampToGround"),
        _outline(feature) if layer.geometry == "Polygon" else k.coordinates(feature.geo),
    )
    if layer.name == ELLIPSES:
        name = f"ellipse of {name}"
    return _placemark(layer, feature, shape, name=name, style=style)


def _outline(feature: Feature) -> k.Element:
    return k.element("outerBoundaryIs", k.element("LinearRing", k.coordinates(feature.geo)))


def _footprint(layer: Layer, feature: Feature) -> k.Element:
    polygon = k.element(
        "Polygon",
        k.element("tessellate", text="1"),
        k.element("altitudeMode", text="clampToGround"),
        _outline(feature),
    )
    return _placemark(layer, feature, polygon, name=feature.values["photo"], style="footprint")


def _track(layer: Layer, feature: Feature) -> k.Element:
    line = k.element(
        "LineString",
        k.element("altitudeMode", text="absolute"),
        k.coordinates(feature.geo, feature.height_orthometric),
    )
    name = f"{feature.values['flight']} {feature.values['part']}"
    return _placemark(layer, feature, line, name=name, style="track")


def _point(feature: Feature) -> k.Element:
    """Point at its height, on the ground where that is not known."""
    height = feature.height_orthometric
    known = bool(np.all(np.isfinite(height)))
    return k.element(
        "Point",
        k.element("altitudeMode", text="absolute" if known else "clampToGround"),
        k.coordinates(feature.geo, height if known else None),
    )


def _placemark(
    layer: Layer,
    feature: Feature,
    shape: k.Element,
    *,
    name: Value,
    style: str,
    balloon: k.Element | None = None,
) -> k.Element:
    """Placemark of a feature; its balloon shows all fields unless another is given."""
    if balloon is None:
        balloon = k.balloon(layer, feature, [f.name for f in layer.fields], title=str(name))
    return k.element(
        "Placemark",
        k.element("name", text=str(name)),
        balloon,
        k.element("styleUrl", text=f"#{style}"),
        k.extended_data(layer, feature),
        shape,
    )
