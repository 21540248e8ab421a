"""The KML of a site: photo points, footprints, flight track and surveyed points."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import BinaryIO

import numpy as np

from exports import kml_elements as k
from exports.schemas import Feature, Layer
from exports.site import SiteLayers

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
        k.line_style("footprint", colour="ffffc04d", width=1.2, fill="1affc04d"),
        k.line_style("track", colour="ff00ffff", width=2.0),
        *(k.schema(layer) for layer in layers.values()),
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
    for i, feature in enumerate(layer.features):
        if layer.name == "footprints":
            yield _footprint(layer, i, feature)
        elif layer.name == "track":
            yield _track(layer, i, feature)
        elif layer.name == "control":
            yield _control(layer, i, feature)
        else:
            yield _photo(layer, i, feature, thumbnails.get(str(feature.values["photo"]), ""))


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


def _photo(layer: Layer, index: int, feature: Feature, image: str) -> k.Element:
    style = "photo-doubtful" if feature.values["doubts"] else "photo"
    height = feature.height_orthometric
    known = bool(np.all(np.isfinite(height)))
    return k.element(
        "Placemark",
        k.element("name", text=str(feature.values["photo"])),
        k.balloon(layer, feature, PHOTO_TABLE, image),
        k.element("styleUrl", text=f"#{style}"),
        k.extended_data(layer, feature),
        k.element(
            "Point",
            k.element("altitudeMode", text="absolute" if known else "clampToGround"),
            k.coordinates(feature.geo, height if known else None),
        ),
        id=f"photo-{index + 1}",
    )


def _control(layer: Layer, index: int, feature: Feature) -> k.Element:
    height = feature.height_orthometric
    known = bool(np.all(np.isfinite(height)))
    return k.element(
        "Placemark",
        k.element("name", text=str(feature.values["name"])),
        k.balloon(layer, feature, [f.name for f in layer.fields]),
        k.element("styleUrl", text="#control"),
        k.extended_data(layer, feature),
        k.element(
            "Point",
            k.element("altitudeMode", text="absolute" if known else "clampToGround"),
            k.coordinates(feature.geo, height if known else None),
        ),
        id=f"control-{index + 1}",
    )


def _footprint(layer: Layer, index: int, feature: Feature) -> k.Element:
    ring = k.element("LinearRing", k.coordinates(feature.geo))
    return k.element(
        "Placemark",
        k.element("name", text=str(feature.values["photo"])),
        k.balloon(layer, feature, [f.name for f in layer.fields]),
        k.element("styleUrl", text="#footprint"),
        k.extended_data(layer, feature),
        k.element(
            "Polygon",
            k.element("tessellate", text="1"),
            k.element("altitudeMode", text="clampToGround"),
            k.element("outerBoundaryIs", ring),
        ),
        id=f"footprint-{index + 1}",
    )


def _track(layer: Layer, index: int, feature: Feature) -> k.Element:
    return k.element(
        "Placemark",
        k.element("name", text=f"{feature.values['flight']} {feature.values['part']}"),
        k.balloon(layer, feature, [f.name for f in layer.fields]),
        k.element("styleUrl", text="#track"),
        k.extended_data(layer, feature),
        k.element(
            "LineString",
            k.element("altitudeMode", text="absolute"),
            k.coordinates(feature.geo, feature.height_orthometric),
        ),
        id=f"track-{index + 1}",
    )
