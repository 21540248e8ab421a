"""Options of web tiles."""

from __future__ import annotations

from typing import Literal

from georef_gis.toolbox import parameters as p

# Zoom; pixels of 2 mm
DEEPEST = 26


class TileOptions(p.Parameters):
    """Options of web tiles."""

    min_zoom: p.Integer | None = p.integer(
        None, title="Smallest zoom", help="Default: that at which the mosaic fills about a tile.",
        ge=0, le=DEEPEST,
    )  # fmt: skip
    max_zoom: p.Integer | None = p.integer(
        None, title="Largest zoom", help="Default: that whose pixels are nearest to the mosaic's; "
        "one more shows the last detail in four times the bytes.", ge=0, le=DEEPEST,
    )  # fmt: skip
    tile_size: Literal["256", "512"] = p.choice("256", title="Side of a tile in px")
    format: Literal["auto", "jpeg", "webp", "png"] = p.choice(
        "auto", title="Format of a tile", help="auto = JPEG inside the mosaic and WEBP along "
        "its rim, as a JPEG has no transparency: map programs tell them by their first bytes; "
        "jpeg = all JPEG, white beside the mosaic; webp and png = all of that kind, webp packed "
        "in twice the time, png without loss in six times the bytes.",
    )  # fmt: skip
    quality: p.Integer = p.integer(80, title="Quality of JPEG and WEBP", ge=1, le=100)
    attribution: p.Text = p.text("", title="Attribution", help="Shown in a corner of the map.")
