"""A planned flight as KML 2.2: lines to fly, places of the photos, the area."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, Final

import numpy as np
from lxml import etree

from georef_gis.ellipsoid import Origin
from georef_gis.frames import Array
from georef_gis.measure.preflight.layout import PlannedLine
from georef_gis.model.terrain import z_of_constant_height

KML: Final = "http://www.opengis.net/kml/2.2"
_NAMES: Final[Any] = {None: KML}
# deg; 1e-9 is 0.1 mm on the ground
_DECIMALS = 9
# aabbggrr: orange lines, white photos, a green rim
_STYLES = {"line": "ff009fe6", "photo": "ffffffff", "area": "ff739e00"}


def flight_kml(
    lines: Sequence[PlannedLine], origin: Origin, *, name: str, description: str, area: Array | None
) -> bytes:
    """KML of a plan.

    Parameters
    ----------
    origin
        Of the plane of the lines; their heights are over the ground.
    description
        Of the whole, plain text.
    area : shape (n, 2), m
        Rim of what is to be covered; none along a road.
    """
    document = _element(
        "Document", _element("name", text=name), _element("description", text=description),
        *_styles(),
    )  # fmt: skip
    if area is not None:
        document.append(_area(area, origin))
    document.append(_folder("Lines", (_line(line, origin) for line in lines)))
    document.append(_folder("Photos", _photos(lines, origin)))
    root = _element("kml", document)
    etree.cleanup_namespaces(root)
    out: bytes = etree.tostring(root, xml_declaration=True, encoding="UTF-8", pretty_print=True)
    return out


def geographic(xy: Array, origin: Origin) -> Array:
    """Longitude and latitude, deg, of places on the plane of an origin; (n, 2) m -> (n, 2)."""
    z = z_of_constant_height(origin, origin.height_ellipsoidal, xy)
    geo = origin.geo_from_enu(np.column_stack([xy, z]))
    return np.degrees(geo[:, [1, 0]])


def _element(tag: str, *children: Any, text: str | None = None, **attributes: str) -> Any:
    out = etree.Element(f"{{{KML}}}{tag}", attributes, _NAMES)
    if text is not None:
        out.text = "".join(c if c.isprintable() or c in "\n\t" else "\ufffd" for c in text)
    out.extend(children)
    return out


def _coordinates(xy: Array, origin: Origin, height: float) -> Any:
    places = geographic(xy, origin)
    text = " ".join(f"{x:.{_DECIMALS}f},{y:.{_DECIMALS}f},{height:.2f}" for x, y in places)
    return _element("coordinates", text=text)


def _styles() -> list[Any]:
    line = _element(
        "LineStyle", _element("color", text=_STYLES["line"]), _element("width", text="3")
    )
    rim = _element(
        "LineStyle", _element("color", text=_STYLES["area"]), _element("width", text="2")
    )
    icon = _element(
        "IconStyle", _element("color", text=_STYLES["photo"]), _element("scale", text="0.4")
    )
    label = _element("LabelStyle", _element("scale", text="0"))
    return [
        _element("Style", line, id="line"),
        _element("Style", icon, label, id="photo"),
        _element("Style", rim, _element("PolyStyle", _element("fill", text="0")), id="area"),
    ]


def _folder(name: str, children: Iterable[Any]) -> Any:
    return _element("Folder", _element("name", text=name), *children)


def _line(line: PlannedLine, origin: Origin) -> Any:
    heading = np.degrees(np.median(line.headings))
    told = (
        f"{len(line.photos)} photos, heading {heading:.0f} deg, {line.length:.0f} m, "
        f"{line.height:.0f} m above the ground"
    )
    return _element(
        "Placemark",
        _element("name", text=f"line {line.name}"),
        _element("description", text=told),
        _element("styleUrl", text="#line"),
        _element(
            "LineString",
            _element("altitudeMode", text="relativeToGround"),
            _coordinates(line.photos, origin, line.height),
        ),
    )


def _photos(lines: Sequence[PlannedLine], origin: Origin) -> Iterable[Any]:
    for line in lines:
        for k, place in enumerate(line.photos):
            yield _element(
                "Placemark",
                _element("name", text=f"{line.name}.{k + 1}"),
                _element("styleUrl", text="#photo"),
                _element(
                    "Point",
                    _element("altitudeMode", text="relativeToGround"),
                    _coordinates(place[None], origin, line.height),
                ),
            )


def _area(ring: Array, origin: Origin) -> Any:
    closed = np.vstack([ring, ring[:1]])
    return _element(
        "Placemark",
        _element("name", text="area"),
        _element("styleUrl", text="#area"),
        _element(
            "Polygon",
            _element("tessellate", text="1"),
            _element(
                "outerBoundaryIs",
                _element("LinearRing", _coordinates(closed, origin, 0.0)),
            ),
        ),
    )
