"""Which tiles a raster gives: zooms, place, number."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from exports.tiles.options import DEEPEST, TileOptions
from exports.tiles.web_mercator import WORLD, lonlat_from_mercator, pixel_size
from georef_gis.errors import ExportError

if TYPE_CHECKING:
    from exports.tiles.web_picture import WebPicture

# Two hundred square kilometres at 2 cm; more are days of work.
MOST_TILES = 10_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class TileSet:
    """What a container tells of its tiles.

    Parameters
    ----------
    bounds
        West, south, east, north, deg.
    min_zoom, max_zoom
        First and last zoom that are written.
    tile_size
        px
    format
        ``jpg``, ``png`` or ``webp``; of mixed tiles ``webp``, which tells readers of transparency.
    """

    name: str
    description: str
    attribution: str
    bounds: tuple[float, float, float, float]
    min_zoom: int
    max_zoom: int
    tile_size: int
    format: str

    @property
    def center(self) -> tuple[float, float, int]:
        """Longitude and latitude of the middle, deg, and the zoom that shows all."""
        west, south, east, north = self.bounds
        return (west + east) / 2.0, (south + north) / 2.0, self.min_zoom

    def tilejson(self) -> dict[str, Any]:
        """The same as TileJSON 3.0, without the address of the tiles."""
        return {
            "tilejson": "3.0.0",
            "name": self.name,
            "description": self.description,
            "attribution": self.attribution,
            "scheme": "xyz",
            "bounds": [round(value, 9) for value in self.bounds],
            "center": [*(round(value, 9) for value in self.center[:2]), self.min_zoom],
            "minzoom": self.min_zoom,
            "maxzoom": self.max_zoom,
            "format": self.format,
            "tileSize": self.tile_size,
        }


def plan_tiles(
    picture: WebPicture, name: str, options: TileOptions, title: str, description: str
) -> TileSet:
    """Zooms and texts of a tile set.

    Raises
    ------
    ExportError
        If the zooms are the wrong way round or make too many tiles.
    """
    size, place = int(options.tile_size), picture.place
    west, south, east, north = place.bounds
    nearest = round(math.log2(pixel_size(0, size) / place.native_pixel))
    largest = min(max(nearest, 0), DEEPEST) if options.max_zoom is None else options.max_zoom
    whole = max(0, math.floor(math.log2(WORLD / max(east - west, north - south))))
    smallest = min(whole, largest) if options.min_zoom is None else options.min_zoom
    if smallest > largest:
        raise ExportError(
            f"min_zoom {smallest} is larger than max_zoom {largest}; give min_zoom {largest} or "
            "less"
        )
    _check_count(picture, name, largest, size)
    kind = {"auto": "webp", "jpeg": "jpg"}.get(options.format, options.format)
    return TileSet(
        name=title, description=description, attribution=options.attribution,
        bounds=_whole_pixels(place.bounds, pixel_size(largest, size)), min_zoom=smallest,
        max_zoom=largest, tile_size=size, format=kind,
    )  # fmt: skip


def _whole_pixels(
    bounds: tuple[float, float, float, float], pixel: float
) -> tuple[float, float, float, float]:
    """Degrees of bounds, widened to the pixels of the largest zoom.

    GDAL places MBTiles by their bounds but cuts them out by whole pixels.
    """
    west, south = (math.floor(value / pixel) * pixel for value in bounds[:2])
    east, north = (math.ceil(value / pixel) * pixel for value in bounds[2:])
    corners = np.array([[west, south], [east, north]]).clip(-WORLD / 2.0, WORLD / 2.0)
    low, high = lonlat_from_mercator(corners).tolist()
    return low[0], low[1], high[0], high[1]


def _check_count(picture: WebPicture, name: str, zoom: int, size: int) -> None:
    west, south, east, north = picture.place.bounds
    side = pixel_size(zoom, size) * size
    count = 4.0 / 3.0 * (east - west) * (north - south) / side**2
    if count > MOST_TILES:
        # Only where it matters, as it reads from the whole raster.
        count *= picture.valid_share()
    if count <= MOST_TILES:
        return
    fewer = math.ceil(math.log(count / MOST_TILES, 4))
    raise ExportError(
        f"{name}: needs about {count:.1e} tiles down to zoom {zoom}, more than {MOST_TILES:.0e}; "
        f"give max_zoom {zoom - fewer} or less, or export a part of it"
    )
