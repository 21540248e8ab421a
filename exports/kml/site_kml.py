"""The document of a site: its styles, and a folder for each kind of thing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from exports.kml import elements as k
from exports.kml.icons import ARROW, CAMERA, ELLIPSE, ClassLook, aabbggrr, styles_by_class
from exports.kml.placemarks import LayerText
from exports.kml.track import flight_schema
from exports.site.columns import Layer
from exports.site.schemas import ASSETS, ELLIPSES
from exports.site.site import SiteLayers

CONTROL = "files/control.png"
VIEWS_SAID = (
    "Each photo from where it was taken; a double click flies into it. The pictures are "
    "undistorted. Shown by Google Earth Pro only."
)


@dataclass(frozen=True, kw_only=True)
class Shown:
    """What the document of a site shows.

    Parameters
    ----------
    layers
        Written feature by feature.
    trees
        Folders that lead to files of their own, by the name of the layer they stand for.
    thumbnails
        Photo id -> path of its thumbnail within the KMZ.
    icons
        Whether the file has icons with it; else the viewer's own are coloured.
    views, flights
        Photos to look through; the flight in time.
    line
        Whether the line through the photos is drawn beside the flight in time, for viewers that
        know no such thing.
    overlay
        Folder of the mosaic.
    screens
        Legend and statement.
    fields, longest
        Fields that are written, by layer, and the length at which texts are cut.
    note
        Said at the end of the description.
    """

    layers: Mapping[str, Layer]
    looks: tuple[ClassLook, ...] = ()
    trees: Mapping[str, k.Element] = field(default_factory=dict)
    thumbnails: Mapping[str, str] = field(default_factory=dict)
    icons: bool = False
    views: Sequence[k.Element] = ()
    flights: Sequence[k.Element] = ()
    line: bool = False
    overlay: k.Element | None = None
    screens: Sequence[k.Element] = ()
    fields: Mapping[str, Sequence[str]] = field(default_factory=dict)
    longest: int | None = None
    note: str = ""


def write_document(stream: k.Stream, site: SiteLayers, shown: Shown) -> None:
    """Write the document of a site as UTF-8, feature by feature."""
    styles = styles_by_class(shown.looks)
    texts = {
        name: LayerText(
            layer=layer, styles=styles, thumbnails=shown.thumbnails,
            fields=shown.fields.get(name), longest=shown.longest,
        )
        for name, layer in shown.layers.items()
        if name not in shown.trees and (len(layer) or name not in ASSETS)
    }  # fmt: skip
    with k.open_document(stream) as document:
        document.write(k.element("name", text=site.name or "Site"))
        document.write(k.element("open", text="1"))
        document.write(k.element("description", text=f"{said_of(site)}{shown.note}"))
        for style in _styles(shown):
            document.write(style)
        for text in texts.values():
            document.write(text.attributes.schema)
        if shown.flights:
            document.write(flight_schema())
        for part in (shown.overlay, *shown.screens):
            if part is not None:
                document.write(part)
        _write_folders(document, shown, texts)


def _write_folders(
    document: k.DocumentWriter, shown: Shown, texts: Mapping[str, LayerText]
) -> None:
    for name, layer in shown.layers.items():
        if name in shown.trees:
            document.write(shown.trees[name])
        elif len(layer):
            # The flight in time is drawn as a line, too.
            visible = name != "track" or shown.line or not shown.flights
            parts = texts[name] if visible else (_hidden(text) for text in texts[name])
            document.write_folder(layer.title, parts, visible=visible)
        if name == "photos" and shown.views:
            document.write_folder("Photo views", shown.views, visible=False, said=VIEWS_SAID)
        if name == "track" and shown.flights:
            document.write_folder("Flight in time", shown.flights)


def _hidden(placemarks: k.Element) -> k.Element:
    return placemarks.replace(
        "</name><description>", "</name><visibility>0</visibility><description>"
    )


def _styles(shown: Shown) -> list[k.Element]:
    icons = shown.icons
    camera = CAMERA if icons else ""
    out = [
        k.point_style("photo", camera),
        k.point_style("photo-doubtful", camera, colour="ff00a5ff"),
        k.line_style("footprint", colour="ffffc04d", width=1.2),
        k.line_style("track", colour="ff00ffff", width=2.0),
        ellipse_style(),
    ]
    if shown.views:
        out.append(k.point_style("view", camera, scale=0.4))
    if shown.flights:
        arrow = ARROW if icons else ""
        out.append(k.line_style("flight", colour="ff00ffff", width=2.0, icon=arrow))
    if len(shown.layers.get("control", ())):
        control = (CONTROL, "ffffffff") if icons else ("", "ff00ff00")
        out.append(k.point_style("control", control[0], colour=control[1], scale=0.7))
    for look in shown.looks:
        out += look.styles("" if icons else None)
    return out


def ellipse_style() -> k.Element:
    """Style of error ellipses."""
    rgb = aabbggrr(ELLIPSE)
    return k.line_style("ellipse", colour=rgb, width=1.0, fill="26" + rgb[2:])


def said_of(site: SiteLayers) -> str:
    """What someone who has only the file needs to know."""
    facts = site.metadata()
    accuracy = accuracy_of(site)
    told = f" Accuracy: {' '.join(accuracy)}" if accuracy else ""
    return (
        f"{facts['photos']} photos, poses: {facts['poses']}. Positions: WGS 84 longitude and "
        f"latitude (datum of the positions: {facts['datum_of_positions']}). Heights of points and "
        "lines: metres above the EGM96 geoid; in tables as their names say. Sigmas: one standard "
        f"deviation. Project CRS: {facts['crs']}. Made by {facts['made_by']}.{told}"
    )


def accuracy_of(site: SiteLayers) -> list[str]:
    """Sentences of the accuracy statement; none without one."""
    return [text for name, text in site.accuracy.items() if "_STATEMENT_" in name]


def statement_of(site: SiteLayers) -> list[str]:
    """Paragraphs of the statement that stays on the screen."""
    facts = site.metadata()
    sentences = _tested(site.accuracy) or accuracy_of(site)[:1]
    sentences = sentences or [
        "Not tested against check points. Sigmas in the balloons are predicted from the "
        "measurements alone."
    ]
    gsd = facts.get("mosaic_gsd_m") or facts.get("gsd_m")
    pixel = f" Mosaic: {float(gsd):.3f} m a pixel." if gsd else ""
    return [
        *sentences,
        f"{facts['photos']} photos, poses: {facts['poses']}.{pixel}",
        "Heights above the EGM96 geoid. The viewer's own terrain and imagery may be off by "
        "metres: compare with this mosaic, not with them.",
    ]


def _tested(accuracy: Mapping[str, str]) -> list[str]:
    """Errors at check points in a few words; the whole statement is the file's description."""
    out = []
    for part in ("H", "V", "3D"):
        value = accuracy.get(f"ACCURACY_RMSE_{part}_CM")
        points = accuracy.get(f"ACCURACY_CHECK_POINTS_{part}")
        if value and points:
            out.append(f"RMSE {part} {value} cm at {points} check points")
    return [f"{'; '.join(out)}. The description of the file has the whole statement."] * bool(out)


def signs_of(layers: Mapping[str, Layer], flights: bool) -> list[tuple[str, str]]:
    """What the legend explains of a site, next to its classes of assets."""
    kinds = (
        ("photos", "camera", "Photo (orange: doubtful)"),
        ("footprints", "footprint", "Ground that a photo shows"),
        ("track", "track", "Flight track"),
        ("control", "control", "Surveyed point"),
        (ELLIPSES, "ellipse", "Error ellipse of an asset"),
    )
    return [
        (kind, text)
        for name, kind, text in kinds
        if (name in layers and len(layers[name])) or (name == "track" and flights)
    ]
