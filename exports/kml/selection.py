"""Which features and vertices of layers are shown, and what is to be said of those that are not."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from exports.kml import elements as k
from exports.site.columns import Column, Layer, Places

# Letters of a name in a warning
_LONGEST = 80


def taken(layer: Layer, index: NDArray[np.intp]) -> Layer:
    """Some features of a layer, in the order of `index`."""
    at = layer.places
    counts = np.diff(at.offsets)[index]
    offsets = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    # every vertex: the first of its feature, and how many it comes after that
    within = np.arange(int(offsets[-1])) - np.repeat(offsets[:-1], counts)
    rows = np.repeat(at.offsets[:-1][index], counts) + within
    columns = {
        name: Column(values=one.values[index], missing=one.missing[index])
        for name, one in layer.columns.items()
    }
    return replace(layer, columns=columns, places=_places(at, offsets, rows))


def slimmed(layer: Layer, most: int) -> Layer:
    """The same with at most about `most` vertices a feature, evenly taken; ends stay."""
    at = layer.places
    counts = np.diff(at.offsets)
    if layer.geometry == "Point" or not len(counts) or counts.max() <= most:
        return layer
    parts = [
        a + np.unique(np.linspace(0, n - 1, min(n, most)).astype(int))
        for a, n in zip(at.firsts.tolist(), counts.tolist(), strict=True)
    ]
    rows = np.concatenate(parts)
    offsets = np.concatenate([[0], np.cumsum([len(part) for part in parts])]).astype(np.int64)
    return replace(layer, places=_places(at, offsets, rows))


def _places(at: Places, offsets: NDArray[np.int64], rows: NDArray[np.int64]) -> Places:
    """Some vertices, with the coordinates that KML has; those on the map are left unknown."""
    lonlat, heights = at.lonlat[rows], at.height_orthometric[rows]
    unknown = np.broadcast_to(np.nan, (len(rows), 2))
    return Places(offsets, unknown, unknown[:, 0], lambda: (lonlat, heights))


def placed(layers: Mapping[str, Layer]) -> tuple[dict[str, Layer], list[str]]:
    """Layers without the features that no longitude and latitude is known of, and their names.

    PROJ says so of places for which the CRS does not hold; a GIS user may have put one there.
    """
    out: dict[str, Layer] = {}
    lost: dict[str, None] = {}
    for name, layer in layers.items():
        out[name], at = layer, layer.places
        bad = ~np.isfinite(at.lonlat).all(axis=1)
        if bad.any():
            before = np.concatenate([[0], np.cumsum(bad)])
            away = before[at.offsets[1:]] > before[at.offsets[:-1]]
            lost |= dict.fromkeys(_names(layer, np.flatnonzero(away)))
            out[name] = taken(layer, np.flatnonzero(~away))
    return out, list(lost)


def unfit_names(layers: Mapping[str, Layer]) -> list[str]:
    """Names of features with a text that XML cannot hold as it is."""
    found: dict[str, None] = {}
    for layer in layers.values():
        for f in layer.fields:
            if f.kind != "text" or f.name not in layer.columns:
                continue
            texts = layer.columns[f.name].tolist()
            if k.fits("\n".join(str(text) for text in texts if text)):
                continue
            bad = [i for i, text in enumerate(texts) if text and not k.fits(str(text))]
            if bad:
                found |= dict.fromkeys(_names(layer, bad))
    return list(found)


def _names(layer: Layer, rows: Iterable[int]) -> list[str]:
    """Names of some features, in one line each."""
    key = next(n for n in ("name", "photo", "flight", layer.fields[0].name) if n in layer.columns)
    names = layer.columns[key].tolist()
    return [repr(str(names[i]))[1:-1][:_LONGEST] for i in rows]
