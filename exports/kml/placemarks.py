"""Features of a layer as placemarks, many at a time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from exports.kml import elements as k
from exports.kml.attributes import Attributes
from exports.site.columns import Column, Layer, Places
from exports.site.schemas import ASSETS, ELLIPSES

# Features whose texts are in memory at once
BATCH = 2000
# m; no height that is measured, and no number that a viewer can place
FARTHEST = 1e7
# What a person asks of a photo; the whole table stands in ExtendedData.
PHOTO_TABLE = (
    "time_utc", "camera_clock", "lat_deg", "lon_deg", "height_ellipsoidal_m",
    "height_orthometric_m", "height_above_ground_m", "height_kind", "roll_deg",
    "pitch_deg", "yaw_deg", "omega_deg", "phi_deg", "kappa_deg", "sigma_e_m", "sigma_n_m",
    "sigma_u_m", "sigma_above_ground_m", "sigma_yaw_deg", "pose_kind", "tie_points", "residual_px",
    "gsd_m", "tilt_deg", "camera", "flight", "doubts",
)  # fmt: skip
ASSET_TABLE = (
    "class", "name", "note", "attributes", "lat_deg", "lon_deg", "height_ellipsoidal_m",
    "height_orthometric_m", "sigma_e_m", "sigma_n_m", "sigma_u_m", "semi_major_m", "semi_minor_m",
    "azimuth_deg", "conf", "n_rays", "method", "changed",
)  # fmt: skip
# Layers whose heights are shown; all others lie on the viewer's ground, which may be above theirs
STANDING = ("photos", "track", "control")
# Layers that are drawn on top of each other are told apart by the start of their ids.
_IDS = {"photos": "photo", "footprints": "footprint"}


@dataclass(frozen=True, kw_only=True)
class LayerText:
    """Placemarks of a layer.

    Parameters
    ----------
    styles
        Style of each class of assets, by layer and class.
    thumbnails
        Photo id -> path of its thumbnail, from where the text will stand.
    fields
        Those that are written typed and shown; None = all.
    longest
        Longer texts are cut; None = none are.
    prefix
        Start of the ids.
    """

    layer: Layer
    styles: Mapping[tuple[str, str], str] = field(default_factory=dict)
    thumbnails: Mapping[str, str] = field(default_factory=dict)
    fields: Sequence[str] | None = None
    longest: int | None = None
    prefix: str = ""

    @property
    def attributes(self) -> Attributes:
        """Texts of the layer's attributes."""
        own = [f.name for f in self.layer.fields]
        table: Sequence[str] = PHOTO_TABLE if self.layer.name == "photos" else own
        if self.layer.name in ASSETS:
            table = [name for name in ASSET_TABLE if name in own]
        if self.fields is not None:
            table = [name for name in table if name in self.fields]
        return Attributes(
            layer=self.layer, table=table, data=self.fields, longest=self.longest
        )  # fmt: skip

    def __iter__(self) -> Iterator[k.Element]:
        """Texts of many placemarks each."""
        attributes = self.attributes
        for start in range(0, len(self.layer), BATCH):
            stop = min(start + BATCH, len(self.layer))
            yield "\n".join(self._batch(attributes, start, stop))

    def _batch(self, attributes: Attributes, start: int, stop: int) -> Iterator[k.Element]:
        tables, data = attributes.rows(start, stop)
        names = self._names(start, stop)
        styles = self._styles(start, stop)
        images = self._images(start, stop)
        shapes = shapes_of(self.layer, start, stop)
        kind = f"{self.prefix}{_IDS.get(self.layer.name, self.layer.name)}"
        rows = zip(names, images, tables, styles, data, shapes, strict=True)
        for number, (name, image, table, style, extended, shape) in enumerate(rows, start + 1):
            yield (
                f'<Placemark id="{kind}-{number}"><name>{name}</name><description><![CDATA['
                f'<h3>{name}</h3>{image}<table border="0" cellpadding="2">{table}</table>'
                f"]]></description><styleUrl>#{style}</styleUrl>{extended}{shape}</Placemark>"
            )

    def _names(self, start: int, stop: int) -> list[str]:
        """Escaped names of the features."""
        get = self.layer.columns
        if self.layer.name == "track":
            pairs = zip(get["flight"].tolist(start, stop), get["part"].tolist(start, stop),
                        strict=True)  # fmt: skip
            return [k.escaped(f"{flight} {part}") for flight, part in pairs]
        if self.layer.name not in ASSETS:
            key = "name" if "name" in get else "photo"
            return [k.escaped(str(name)) for name in get[key].tolist(start, stop)]
        before = "ellipse of " if self.layer.name == ELLIPSES else ""
        both = zip(get["name"].tolist(start, stop), get["class"].tolist(start, stop), strict=True)
        most = self.longest
        return [k.escaped((before + str(name or kind or ""))[:most]) for name, kind in both]

    def _styles(self, start: int, stop: int) -> list[str]:
        name = self.layer.name
        if name == "photos":
            doubts = self.layer.columns["doubts"].tolist(start, stop)
            return ["photo-doubtful" if doubt else "photo" for doubt in doubts]
        if name in ASSETS:
            kinds = self.layer.columns["class"].tolist(start, stop)
            return [self.styles.get((name, str(kind or "")), "ellipse") for kind in kinds]
        return [_IDS.get(name, name)] * (stop - start)

    def _images(self, start: int, stop: int) -> list[str]:
        if self.layer.name != "photos" or not self.thumbnails:
            return [""] * (stop - start)
        paths = [self.thumbnails.get(str(v), "") for v in
                 self.layer.columns["photo"].tolist(start, stop)]  # fmt: skip
        return [f'<img src="{k.escaped(path)}" alt=""/><br/>' if path else "" for path in paths]


def shapes_of(layer: Layer, start: int, stop: int) -> list[k.Element]:
    """Geometry of some features."""
    at = layer.places
    first, last = int(at.offsets[start]), int(at.offsets[stop])
    lonlat, heights = at.lonlat[first:last], at.height_orthometric[first:last]
    stands = layer.name in STANDING
    high = np.isfinite(heights) & (np.abs(heights) < FARTHEST) & stands
    bounds = (at.offsets[start : stop + 1] - first).tolist()
    flat = lonlat.ravel().tolist()
    tall = np.nan_to_num(heights).tolist() if stands else []
    before, after = _around(layer.geometry)
    out = []
    for a, b in pairwise(bounds):
        known = stands and bool(high[a:b].all())
        if known:
            mode = "absolute"
            rows = zip(flat[2 * a : 2 * b : 2], flat[2 * a + 1 : 2 * b : 2], tall[a:b], strict=True)
            texts = " ".join(f"{x:.9f},{y:.9f},{z:.3f}" for x, y, z in rows)
        else:
            mode, texts = "clampToGround", _form(b - a) % tuple(flat[2 * a : 2 * b])
        lies = "" if known or layer.geometry == "Point" else "<tessellate>1</tessellate>"
        out.append(
            f"<{layer.geometry}>{lies}<altitudeMode>{mode}</altitudeMode>{before}"
            f"<coordinates>{texts}</coordinates>{after}</{layer.geometry}>"
        )
    return out


@lru_cache(maxsize=64)
def _form(count: int) -> str:
    """Form of so many vertices: filled at once it takes half the time of one by one."""
    return " ".join(["%.9f,%.9f"] * count)


def _around(geometry: str) -> tuple[str, str]:
    if geometry != "Polygon":
        return "", ""
    return "<outerBoundaryIs><LinearRing>", "</LinearRing></outerBoundaryIs>"


def taken(layer: Layer, index: NDArray[np.intp]) -> Layer:
    """Some features of a layer, in the order of `index`."""
    at = layer.places
    counts = np.diff(at.offsets)[index]
    offsets = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    # every vertex: the first of its feature, and how many it comes after that
    within = np.arange(int(offsets[-1])) - np.repeat(offsets[:-1], counts)
    rows = np.repeat(at.offsets[:-1][index], counts) + within
    lonlat, heights = at.lonlat[rows], at.height_orthometric[rows]
    return Layer(
        name=layer.name, title=layer.title, geometry=layer.geometry, fields=layer.fields,
        columns={name: Column(values=one.values[index], missing=one.missing[index])
                 for name, one in layer.columns.items()},
        places=Places(offsets, at.xy[rows], at.height[rows], lambda: (lonlat, heights)),
    )  # fmt: skip


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
                key = next(n for n in ("name", "photo", "flight", f.name) if n in layer.columns)
                names = layer.columns[key].tolist()
                found |= dict.fromkeys(repr(str(names[i]))[1:-1][:80] for i in bad)
    return list(found)


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
    lonlat, heights = at.lonlat[rows], at.height_orthometric[rows]
    places = Places(offsets, at.xy[rows], at.height[rows], lambda: (lonlat, heights))
    return replace(layer, places=places)
