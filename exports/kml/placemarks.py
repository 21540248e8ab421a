"""Features of a layer as placemarks, many at a time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from exports.kml import elements as k
from exports.kml.attributes import Attributes
from exports.kml.shapes import shapes_of
from exports.site.columns import Layer
from exports.site.schemas import ASSETS, ELLIPSES

# Features whose texts are in memory at once
BATCH = 2000
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
    "height_orthometric_m", "height_map", "sigma_e_m", "sigma_n_m", "sigma_u_m", "semi_major_m",
    "semi_minor_m", "azimuth_deg", "conf", "n_rays", "method", "changed",
)  # fmt: skip
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
            return k.escaped_all([f"{flight} {part}" for flight, part in pairs])
        if self.layer.name not in ASSETS:
            key = "name" if "name" in get else "photo"
            return k.escaped_all([str(name) for name in get[key].tolist(start, stop)])
        before = "ellipse of " if self.layer.name == ELLIPSES else ""
        both = zip(get["name"].tolist(start, stop), get["class"].tolist(start, stop), strict=True)
        most = self.longest
        return k.escaped_all([(before + str(name or kind or ""))[:most] for name, kind in both])

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
