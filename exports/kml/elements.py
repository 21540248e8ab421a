"""KML as text, escaped in one place, elements in the order of the OGC 2.2 schema."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Final, Protocol

from georef_gis.frames import Array

KML: Final = "http://www.opengis.net/kml/2.2"
GX: Final = "http://www.google.com/kml/ext/2.2"
# deg; 1e-9 is 0.1 mm on the ground, far below a pixel
DEGREE_DECIMALS = 10
# What XML 1.0 cannot hold even when escaped.
_FORBIDDEN = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
# One look tells of most texts that nothing of them needs care.
_SPECIAL = re.compile("[^\t\n\r !#-%'-;=?-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
_HEAD = f'<?xml version="1.0" encoding="UTF-8"?>\n<kml xmlns="{KML}" xmlns:gx="{GX}">\n<Document>\n'
_TAIL = "</Document>\n</kml>\n"


class Stream(Protocol):
    """What takes bytes."""

    def write(self, data: bytes, /) -> object:
        """Take some bytes."""


# Text of an element with all that is in it.
Element = str


def clean(text: str) -> str:
    """Text that XML can hold: control characters become the replacement character."""
    return _FORBIDDEN.sub("�", text)


def fits(text: str) -> bool:
    """Whether XML can hold a text as it is."""
    return _FORBIDDEN.search(text) is None


def escaped(text: str) -> str:
    """Text for XML or HTML, in an element or in an attribute."""
    if _SPECIAL.search(text) is None:
        return text
    safe = _FORBIDDEN.sub("�", text).replace("&", "&amp;")
    # ">" too: "]]>" must not end a CDATA section early.
    return safe.replace("<", "&lt;").replace(">", "&gt;").replace('"', "&quot;")


def escaped_all(texts: Sequence[str]) -> list[str]:
    """The same of many texts, most of which need no care: as one."""
    together = escaped("\n".join(texts)).split("\n")
    return together if len(together) == len(texts) else [escaped(text) for text in texts]


def element(
    tag: str, *children: Element | None, text: str | None = None, **attributes: str
) -> Element:
    """Element with children in the given order; None among them is left out."""
    said = "".join(f' {name}="{escaped(value)}"' for name, value in attributes.items())
    inside = "" if text is None else escaped(text)
    inside += "".join(child for child in children if child is not None)
    return f"<{tag}{said}>{inside}</{tag}>" if inside else f"<{tag}{said}/>"


def cdata(tag: str, html: str) -> Element:
    """Element of HTML, whose values are `escaped`."""
    return f"<{tag}><![CDATA[{html}]]></{tag}>"


def document(*children: Element | None, name: str) -> bytes:
    """A whole KML file with one Document."""
    parts = (element("name", text=name), *children)
    return (_HEAD + "\n".join(part for part in parts if part) + "\n" + _TAIL).encode()


class DocumentWriter:
    """Writes the features of a Document one after the other, so that none need be kept."""

    def __init__(self, stream: Stream) -> None:
        self._stream = stream

    def write(self, part: Element) -> None:
        """Write one element."""
        self._stream.write(f"{part}\n".encode())

    def write_folder(
        self, name: str, parts: Iterable[Element], *, visible: bool = True, said: str = ""
    ) -> None:
        """Write a folder with its features."""
        head = [element("name", text=name)]
        if not visible:
            head.append(element("visibility", text="0"))
        if said:
            head.append(element("description", text=said))
        self.write("<Folder>" + "".join(head))
        for part in parts:
            self.write(part)
        self.write("</Folder>")


@contextmanager
def open_document(stream: Stream) -> Iterator[DocumentWriter]:
    """A KML file with one Document that is written bit by bit."""
    stream.write(_HEAD.encode())
    yield DocumentWriter(stream)
    stream.write(_TAIL.encode())


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
        parts = [f"{x:.10f},{y:.10f}" for x, y in geo[:, :2].tolist()]
    else:
        rows = zip(geo[:, :2].tolist(), heights.tolist(), strict=True)
        parts = [f"{x:.10f},{y:.10f},{z:.3f}" for (x, y), z in rows]
    return f"<coordinates>{' '.join(parts)}</coordinates>"


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


def screen_overlay(name: str, href: str, *, corner: tuple[int, int]) -> Element:
    """Picture that stays at a corner of the window, 0 or 1 from left and from below.

    In fractions alone: viewers differ in what they make of pixels from the edge.
    """
    x, y = (str(value) for value in corner)

    def place(tag: str, across: str, up: str, unit: str) -> Element:
        return element(tag, x=across, y=up, xunits=unit, yunits=unit)

    return element(
        "ScreenOverlay",
        element("name", text=name),
        element("Icon", element("href", text=href)),
        place("overlayXY", x, y, "fraction"),
        place("screenXY", x, y, "fraction"),
        place("size", "-1", "-1", "fraction"),
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
    return element("BalloonStyle", cdata("text", "$[description]"))


def point_style(
    style_id: str, icon: str, *, colour: str = "ffffffff", scale: float = 0.6
) -> Element:
    """Point by an icon of the KMZ; a name shows when pointed at. Without an icon: the viewer's."""
    picture = element("Icon", element("href", text=icon)) if icon else None
    return element(
        "Style",
        element(
            "IconStyle",
            element("color", text=colour),
            element("scale", text=str(scale)),
            picture,
        ),
        element("LabelStyle", element("scale", text="0")),
        balloon_style(),
        id=style_id,
    )


def line_style(
    style_id: str, *, colour: str, width: float, fill: str = "00ffffff", icon: str = ""
) -> Element:
    """Line, polygon with its outline, or track with its icon; colours are aabbggrr."""
    filled = "0" if fill.startswith("00") else "1"
    return element(
        "Style",
        element("IconStyle", element("Icon", element("href", text=icon))) if icon else None,
        element("LineStyle", element("color", text=colour), element("width", text=str(width))),
        # Without it a viewer fills areas in white.
        element("PolyStyle", element("color", text=fill), element("fill", text=filled)),
        balloon_style(),
        id=style_id,
    )
