"""Options of the exporters to KML, and what all of them say alike."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from exports.site.schemas import ASSETS
from georef_gis.toolbox import parameters as p

if TYPE_CHECKING:
    from collections.abc import Mapping

    from exports.site.columns import Layer

VECTORS = ("photos", "footprints", "track", "control", *ASSETS)
CRS = "EPSG:4326"
HEIGHT_KIND = "orthometric (EGM96)"


class KmzOptions(p.Parameters):
    """Options of the KMZ."""

    thumbnails: p.Flag = p.flag(
        True, title="Thumbnails", help="A small undistorted picture of every photo, in its balloon."
    )
    thumbnail_px: p.Integer = p.integer(
        512, title="Longer side of a thumbnail", unit="px", ge=64, le=2048, advanced=True
    )
    views: p.Flag = p.flag(
        True, title="Photo views", help="Photos to look through from where they were taken "
        "(PhotoOverlay, Google Earth Pro); they show the thumbnails.",
    )  # fmt: skip
    track_hz: p.Number = p.number(
        2.0, title="Samples of the flight a second", unit="Hz", gt=0, le=10, advanced=True
    )
    overlay: Literal["auto", "pyramid", "single", "none"] = p.choice(
        "auto",
        title="Mosaic",
        help="auto = one picture up to 2048 px, else a pyramid of tiles; a single picture is "
        "made smaller to 2048 px and is what phones and browsers show.",
    )
    max_mb: p.Number | None = p.number(
        None, title="Largest size", unit="MB", help="The mosaic is made coarser to fit.", gt=0
    )
    max_zoom: p.Integer | None = p.integer(
        None, title="Deepest level of the pyramid", help="0 is one tile of 256 px; each level "
        "halves the pixel.", ge=0, le=24, advanced=True,
    )  # fmt: skip
    quality: p.Integer = p.integer(
        85, title="JPEG quality of the mosaic", ge=1, le=100, advanced=True
    )


class KmlOptions(p.Parameters):
    """Options of the plain KML."""


class LightKmzOptions(p.Parameters):
    """Options of the light KMZ."""

    max_mb: p.Number = p.number(
        10.0, title="Largest size", unit="MB", help="Of the file, and of its KML unpacked.",
        gt=0,
    )  # fmt: skip
    features: p.Integer = p.integer(
        1000, title="Most features", help="Of layers with more, some are left out, evenly.",
        ge=1, le=100_000,
    )  # fmt: skip


def told_of(layers: Mapping[str, Layer]) -> tuple[dict[str, Layer], list[str]]:
    """What of layers KML can show, and what is to be said of what it cannot hold as it is."""
    from exports.kml.selection import placed, unfit_names

    shown, lost = placed(layers)
    told = []
    if lost:
        what = "left out, as the project's CRS gives their place no longitude and latitude"
        told.append(listed(what, lost))
    unfit = unfit_names(shown)
    if unfit:
        what = "control characters, which KML cannot hold, are written as \ufffd in"
        told.append(listed(what, unfit))
    return shown, told


def listed(what: str, names: list[str] | tuple[str, ...]) -> str:
    """The first names of a list, and how many more there are."""
    more = f" and {len(names) - 5} more" if len(names) > 5 else ""
    return f"{what}: {', '.join(names[:5])}{more}"
