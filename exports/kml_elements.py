"""KML elements with lxml, in the order of the OGC 2.2 schema."""

from __future__ import annotations

import html
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, BinaryIO, Final

from lxml import etree

from exports.schemas import Feature, Field, Layer, Value
from georef_gis.frames import Array

KML: Final = "http://www.opengis.net/kml/2.2"
# deg; 1e-9 is 0.1 mm on the ground, far below a pixel
DEGREE_DECIMALS = 10
# What XML 1.0 cannot hold even when escaped.
_FORBIDDEN = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
_TYPES = {"text": "string", "real": "double", "integer": "int", "flag": "bool"}

Element = etree._Element
_NAMES: Final[Any] = {None: KML}


def clean(text: str) -> str:
    """Text that XML can hold: control characters become the replacement character."""
    return _FORBIDDEN.sub("�", text)


def element(
    tag: str, *children: Element | None, text: str | None = None, **attributes: str
) -> Element:
    """Element of KML with children in the given order; None among them is left out."""
    out = etree.Element(f"{{{KML}}}{tag}", attributes, _NAMES)
    if text is not None:
        out.text = clean(text)
    for child in children:
        if child is not None:
            out.append(child)
    return out


def document(*children: Element | None, name: str) -> bytes:
    """A whole KML file with one Document."""
    root = element("kml", element("Document", element("name", text=name), *children))
    etree.cleanup_namespaces(root)
    return etree.tostring(root, xml_declaration=True, encoding="UTF-8", pretty_print=True)


class DocumentWriter:
    """Writes the features of a Document one after the other, so that none need be kept."""

    def __init__(self, file: Any) -> None:
        self._file = file

    def write(self, part: Element) -> None:
        """Write one element."""
        self._file.write(part, pretty_print=True)

    def write_folder(self, name: str, parts: Iterable[Element]) -> None:
        """Write a folder with its features."""
        with self._file.element(f"{{{KML}}}Folder"):
            self.write(element("name", text=name))
            for part in parts:
                self.write(part)


@contextmanager
def open_document(stream: BinaryIO) -> Iterator[DocumentWriter]:
    """A KML file with one Document that is written bit by bit."""
    with etree.xmlfile(stream, encoding="UTF-8") as file:
        file.write_declaration()
        with file.element(f"{{{KML}}}kml", nsmap=_NAMES), file.element(f"{{{KML}}}Document"):
            yield DocumentWriter(file)


def folder(name: str, children: Iterable[Element], *, description: str = "") -> Element:
    """Folder of features."""
    said = element("description", text=description) if description else None
    return element("Folder", element("name", text=name), said, *children)


def degrees(value: float) -> str:
    """Number of degrees in plain decimals."""
    return f"{value:.{DEGREE_DECIMALS}f}"


def coordinates(geo: Array, heights: Array | None = None) -> Element:
    """Coordinates lon,lat[,height], blank separated; heights in m."""
    if heights is None:
        parts = [f"{degrees(x)},{degrees(y)}" for x, y in geo[:, :2]]
    else:
        parts = [
            f"{degrees(x)},{degrees(y)},{z:.3f}"
            for (x, y), z in zip(geo[:, :2], heights, strict=True)
        ]
    return element("coordinates", text=" ".join(parts))


# -- attributes ---------------------------------------------------------------------------------


def schema(layer: Layer) -> Element:
    """Declaration of the attributes of a layer, typed."""
    fields = [
        element(
            "SimpleField",
            element("displayName", text=_label(f)),
            name=f.name,
            type=_TYPES[f.kind],
        )
        for f in layer.fields
    ]
    return element("Schema", *fields, name=layer.name, id=f"schema-{layer.name}")


def extended_data(layer: Layer, feature: Feature) -> Element:
    """Attributes of a feature that are known, typed by the layer's schema."""
    data = [
        element("SimpleData", text=_plain(f, feature.values[f.name]), name=f.name)
        for f in layer.fields
        if feature.values.get(f.name) is not None
    ]
    return element("ExtendedData", element("SchemaData", *data, schemaUrl=f"#schema-{layer.name}"))


def _plain(field: Field, value: Value) -> str:
    if field.kind == "flag":
        return "1" if value else "0"
    return repr(value) if isinstance(value, float) else str(value)


def balloon(
    layer: Layer, feature: Feature, names: Iterable[str], *, title: str, image: str = ""
) -> Element:
    """Description: title, picture and table in plain HTML, which every viewer shows.

    Parameters
    ----------
    names
        Fields of the table, in order.
    image
        Path of a picture within the KMZ.
    """
    docs = {f.name: f for f in layer.fields}
    rows = "".join(
        f"<tr><td>{html.escape(_label(docs[name]))}</td>"
        f"<td>{html.escape(_short(docs[name], feature.values[name]))}</td></tr>"
        for name in names
        if feature.values.get(name) is not None
    )
    picture = f'<img src="{html.escape(image)}" alt=""/><br/>' if image else ""
    head = f"<h3>{html.escape(title)}</h3>"
    text = clean(f'{head}{picture}<table border="0" cellpadding="2">{rows}</table>')
    out = element("description")
    # html.escape leaves no ">" in a value, so "]]>" cannot end the section early.
    out.text = etree.CDATA(text)
    return out


def _label(field: Field) -> str:
    name = field.name
    for unit in ("_deg", "_m2", "_m", "_s", "_px"):
        if name.endswith(unit):
            name = name.removesuffix(unit)
            break
    return name.replace("_", " ") + (f" ({field.unit})" if field.unit not in ("", "1") else "")


def _short(field: Field, value: Value) -> str:
    """Value as a person reads it: no more figures than it has meaning."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if not isinstance(value, float):
        return str(value)
    if field.name in ("lon_deg", "lat_deg"):
        return f"{value:.8f}"
    if field.unit == "deg":
        return f"{value:.3f}"
    return f"{value:.4f}" if abs(value) < 1.0 else f"{value:.2f}"


# -- regions and links --------------------------------------------------------------------------


def region(bounds: Mapping[str, float], *, smallest: int, largest: int) -> Element:
    """Region shown while its side on the screen is `smallest` to `largest` px (-1 = any)."""
    return element(
        "Region",
        element("LatLonAltBox", *_sides(bounds)),
        element(
            "Lod",
            element("minLodPixels", text=str(smallest)),
            element("maxLodPixels", text=str(largest)),
        ),
    )


def ground_overlay(name: str, bounds: Mapping[str, float], href: str, order: int) -> Element:
    """Picture draped on the ground, aligned to lat and lon."""
    return element(
        "GroundOverlay",
        element("name", text=name),
        element("drawOrder", text=str(order)),
        element("Icon", element("href", text=href)),
        element("LatLonBox", *_sides(bounds)),
    )


def network_link(name: str, href: str, where: Element) -> Element:
    """Link to another file of the KMZ, followed when its region comes into view."""
    return element(
        "NetworkLink",
        element("name", text=name),
        where,
        element("Link", element("href", text=href), element("viewRefreshMode", text="onRegion")),
    )


def _sides(bounds: Mapping[str, float]) -> list[Element]:
    return [
        element(side, text=degrees(bounds[side])) for side in ("north", "south", "east", "west")
    ]


# -- styles -------------------------------------------------------------------------------------


def balloon_style() -> Element:
    """Balloon with the description and nothing else (no driving directions).

    Not with $[name]: a viewer would take what stands in a name for HTML.
    """
    style = element("BalloonStyle")
    text = element("text")
    text.text = etree.CDATA("$[description]")
    style.append(text)
    return style


def point_style(style_id: str, icon: str, *, colour: str = "ffffffff") -> Element:
    """Point by an icon of the KMZ; a name shows when pointed at. Without an icon: the viewer's."""
    picture = element("Icon", element("href", text=icon)) if icon else None
    return element(
        "Style",
        element(
            "IconStyle",
            element("color", text=colour),
            element("scale", text="0.6"),
            picture,
        ),
        element("LabelStyle", element("scale", text="0")),
        balloon_style(),
        id=style_id,
    )


def line_style(style_id: str, *, colour: str, width: float, fill: str = "") -> Element:
    """Line, and polygon with its outline; colours are aabbggrr."""
    area = (
        element("PolyStyle", element("color", text=fill), element("fill", text="1"))
        if fill
        else None
    )
    return element(
        "Style",
        element("LineStyle", element("color", text=colour), element("width", text=str(width))),
        area,
        balloon_style(),
        id=style_id,
    )
