"""Thousands of features as a tree of files, each loaded as one comes closer."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from io import BytesIO
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from exports.kml import elements as k
from exports.kml.icons import ClassLook
from exports.kml.placemarks import LayerText
from exports.kml.selection import taken
from exports.site.columns import Layer

# A layer with more features is written as a tree: a viewer shows so many without halting.
MOST_AT_ONCE = 2000
# Features of a file: seen together with those of the files above it
PER_FILE = 500
# px on the screen from which a file is loaded
SMALLEST = 192
# Splits of a place; features on one spot cannot be parted
DEEPEST = 18
# deg; a region needs an extent
LEAST_SIDE = 1e-4


class Sink(Protocol):
    """Where the files of a KMZ go."""

    def add(self, path: str, data: bytes) -> None:
        """Take one file."""


@dataclass(kw_only=True)
class FeatureTree:
    """Writes a layer as a tree: each file holds a sample of its area, its children the rest."""

    layer: Layer
    sink: Sink
    styles: Mapping[tuple[str, str], str]
    looks: tuple[ClassLook, ...]
    more_styles: tuple[k.Element, ...] = ()
    files: int = 0
    _lonlat: NDArray[np.float64] = field(init=False, repr=False)
    _sides: NDArray[np.float64] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Take the first vertex of every feature for its place, all of them for its extent."""
        places = self.layer.places
        self._lonlat = np.asarray(places.lonlat[places.firsts])
        self._sides = np.hstack(
            [side.reduceat(places.lonlat, places.firsts) for side in (np.minimum, np.maximum)]
        )

    def write(self) -> k.Element:
        """Write all files; gives the folder of the site's document that leads to them."""
        path, bounds = self._node(np.arange(len(self.layer)), 0)
        where = k.region(bounds, smallest=1, largest=-1)
        count = f"{len(self.layer)} features; more of them show as one comes closer"
        return k.folder(
            self.layer.title, [k.network_link(self.layer.title, path, where)], description=count
        )

    def _node(self, index: NDArray[np.intp], depth: int) -> tuple[str, dict[str, float]]:
        """Write a file and all below it; gives its path and the box of all that is in it."""
        own, rest = _sample(index) if depth < DEEPEST else (index, index[:0])
        here = _box(self._sides[index])
        children = [self._node(part, depth + 1) for part in self._quarters(rest)]
        name = f"{self.files}.kml"
        self.files += 1
        links = [
            k.network_link(
                path.rpartition("/")[2],
                path.rpartition("/")[2],
                k.region(box, smallest=SMALLEST, largest=-1),
            )
            for path, box in children
        ]
        where = k.region(here, smallest=SMALLEST if depth else 1, largest=-1)
        path = f"{self.layer.name}/{name}"
        self.sink.add(path, self._document(name, where, links, taken(self.layer, own)))
        return path, here

    def _quarters(self, index: NDArray[np.intp]) -> list[NDArray[np.intp]]:
        if not len(index):
            return []
        at = self._lonlat[index]
        middle = (at.min(axis=0) + at.max(axis=0)) / 2.0
        which = (at[:, 0] > middle[0]) + 2 * (at[:, 1] > middle[1])
        return [index[which == i] for i in range(4) if np.any(which == i)]

    def _document(self, name: str, where: k.Element, links: list[k.Element], part: Layer) -> bytes:
        used = {str(kind or "") for kind in part.columns["class"].tolist()}
        text = LayerText(layer=part, styles=self.styles, prefix=f"f{name[:-4]}-")
        out = BytesIO()
        with k.open_document(out) as document:
            document.write(k.element("name", text=f"{self.layer.title} {name[:-4]}"))
            for look in self.looks:
                if look.name in used:
                    for style in look.styles("../"):
                        document.write(style)
            for style in self.more_styles:
                document.write(style)
            document.write(where)
            document.write(text.attributes.schema)
            for link in links:
                document.write(link)
            for placemarks in text:
                document.write(placemarks)
        return out.getvalue()


def _sample(index: NDArray[np.intp]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Some features evenly over the order in which they were mapped, and the others."""
    if len(index) <= PER_FILE * 1.5:
        return index, index[:0]
    chosen = np.zeros(len(index), bool)
    chosen[np.linspace(0, len(index) - 1, PER_FILE).astype(int)] = True
    return index[chosen], index[~chosen]


def _box(sides: NDArray[np.float64]) -> dict[str, float]:
    (west, south), (east, north) = sides[:, :2].min(axis=0), sides[:, 2:].max(axis=0)
    x, y = (max(0.0, (LEAST_SIDE - side) / 2.0) for side in (east - west, north - south))
    return {
        "north": min(float(north + y), 90.0),
        "south": max(float(south - y), -90.0),
        "east": min(float(east + x), 180.0),
        "west": max(float(west - x), -180.0),
    }
