"""Icons that need no network, and the styles that use them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from exports.kml import elements as k
from exports.site.columns import Layer
from exports.site.schemas import ASSETS, ELLIPSES

Picture = NDArray[np.uint8]
Colour = tuple[int, int, int]

SIDE = 32
# Pictures are drawn this many times as large and made smaller: smooth rims
_FINE = 8
# Red, green, blue that stand out from ground, footprints and each other (Okabe and Ito 2008,
# brightened; violet for their sky blue, which footprints have)
COLOURS: tuple[Colour, ...] = (
    (255, 176, 0), (190, 120, 255), (0, 214, 143), (255, 240, 70),
    (70, 130, 255), (255, 94, 20), (255, 130, 200), (225, 225, 225),
)  # fmt: skip
FORMS = ("circle", "square", "triangle", "diamond")
ELLIPSE: Colour = (0, 255, 255)
CAMERA, ARROW = "files/camera.png", "files/arrow.png"


@dataclass(frozen=True, slots=True, kw_only=True)
class ClassLook:
    """How assets of a class are drawn.

    Parameters
    ----------
    name
        Of the class; may be empty.
    number
        From 1, in the order of the names.
    geometries
        Layers in which it occurs.
    """

    name: str
    number: int
    geometries: tuple[str, ...]

    @property
    def colour(self) -> Colour:
        """Red, green, blue."""
        return COLOURS[(self.number - 1) % len(COLOURS)]

    @property
    def form(self) -> str:
        """Form of its icon: colours come again after some classes, and then with another."""
        return FORMS[(self.number - 1) // len(COLOURS) % len(FORMS)]

    @property
    def icon(self) -> str:
        """Path of its icon in the KMZ."""
        return f"files/class_{self.number}.png"

    def picture(self) -> bytes:
        """PNG of its icon."""
        return encoded(icon(self.form, self.colour))

    def style_id(self, layer: str) -> str:
        """Id of its style in a layer."""
        return f"class-{self.number}-{'point' if layer == 'asset_points' else 'shape'}"

    def styles(self, folder: str | None = "") -> list[k.Element]:
        """Its styles; the icon's path goes by way of `folder`, None = without icons."""
        out, rgb = [], aabbggrr(self.colour)
        if "asset_points" in self.geometries:
            name = self.style_id("asset_points")
            if folder is None:
                out.append(k.point_style(name, "", colour=rgb))
            else:
                out.append(k.point_style(name, folder + self.icon, scale=0.7))
        if {"asset_lines", "asset_polygons"} & set(self.geometries):
            name = self.style_id("asset_lines")
            out.append(k.line_style(name, colour=rgb, width=3.0, fill="40" + rgb[2:]))
        return out


def class_looks(layers: Mapping[str, Layer]) -> tuple[ClassLook, ...]:
    """Looks of all classes of the assets, by their names."""
    found: dict[str, list[str]] = {}
    for layer in (layers[name] for name in ASSETS if name in layers and name != ELLIPSES):
        if not len(layer):
            continue
        for name in {str(value or "") for value in layer.columns["class"].tolist()}:
            found.setdefault(name, []).append(layer.name)
    return tuple(
        ClassLook(name=name, number=i, geometries=tuple(found[name]))
        for i, name in enumerate(sorted(found), start=1)
    )


def styles_by_class(looks: Iterable[ClassLook]) -> dict[tuple[str, str], str]:
    """Layer and class -> id of the style."""
    return {(layer, look.name): look.style_id(layer) for look in looks for layer in look.geometries}


def aabbggrr(colour: Colour) -> str:
    """Colour as KML writes it, opaque."""
    red, green, blue = colour
    return f"ff{blue:02x}{green:02x}{red:02x}"


# -- pictures -----------------------------------------------------------------------------------


def icon(form: str, colour: Colour) -> Picture:
    """Filled form with a dark rim, readable on any ground; BGRA."""
    big = np.zeros((SIDE * _FINE, SIDE * _FINE, 4), dtype=np.uint8)
    bgra = (*reversed(colour), 255)
    _draw(big, form, 14.0, (40, 40, 40, 255))
    _draw(big, form, 11.0, bgra)
    _draw(big, "circle", 2.5, (40, 40, 40, 255))
    return _small(big)


def camera_icon() -> bytes:
    """PNG of the icon for photos: a white ring with a point."""
    big = np.zeros((SIDE * _FINE, SIDE * _FINE, 4), dtype=np.uint8)
    dark, white = (60, 60, 60, 255), (255, 255, 255, 255)
    for radius, colour in ((13.0, dark), (11.0, white), (6.0, dark), (4.0, white)):
        _draw(big, "circle", radius, colour)
    return encoded(_small(big))


def arrow_icon() -> bytes:
    """PNG of the icon of a track: it points up, and is turned by the viewer."""
    big = np.zeros((SIDE * _FINE, SIDE * _FINE, 4), dtype=np.uint8)
    for part, colour in ((1.0, (40, 40, 40, 255)), (0.72, (0, 255, 255, 255))):
        points = np.array([[0, -14], [10, 13], [0, 7], [-10, 13]], float) * part
        _fill(big, points, colour)
    return encoded(_small(big))


def encoded(picture: Picture) -> bytes:
    """Bytes of a PNG."""
    return bytes(cv2.imencode(".png", picture)[1].tobytes())


def _draw(big: Picture, form: str, size: float, colour: Sequence[int]) -> None:
    if form == "circle":
        centre = (SIDE * _FINE // 2, SIDE * _FINE // 2)
        cv2.circle(big, centre, round(size * _FINE), [int(c) for c in colour], -1)
        return
    s = size
    outlines = {
        "square": [[-s, -s], [s, -s], [s, s], [-s, s]],
        "triangle": [[0, -s * 1.1], [s * 1.1, s * 0.9], [-s * 1.1, s * 0.9]],
        "diamond": [[0, -s * 1.1], [s * 1.1, 0], [0, s * 1.1], [-s * 1.1, 0]],
    }
    _fill(big, np.array(outlines[form], float), colour)


def _fill(big: Picture, points: NDArray[np.float64], colour: Sequence[int]) -> None:
    place = np.rint((points + SIDE / 2) * _FINE).astype(np.int32)
    cv2.fillPoly(big, [place], [int(c) for c in colour])


def _small(big: Picture) -> Picture:
    return np.asarray(cv2.resize(big, (SIDE, SIDE), interpolation=cv2.INTER_AREA), np.uint8)
