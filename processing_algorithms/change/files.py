"""Files of a comparison."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from georef_gis.measure.change.detect import Change, Comparison
from georef_gis.measure.change.layer import rows_of, write_geojson, write_geopackage, write_style
from georef_gis.rasters.files import resolve_target
from georef_gis.rasters.profile import RasterProfile
from georef_gis.rasters.writer import TiledWriter

# value of cells that are not compared
NODATA = 255.0


def write_all(
    target: Path, found: Comparison, kept: Sequence[Change], dates: tuple[str, str], *,
    geojson: bool,
) -> dict[str, Path]:  # fmt: skip
    """Write layer, style and raster; paths by output.

    Raises
    ------
    ExportError
        If one cannot be written.
    """
    target = resolve_target(target)
    header = found.cells.header
    rows = rows_of(kept, found.cells, dates)
    outputs = {
        "changes": target,
        "probability": target.with_name(f"{target.stem}_probability.tif"),
        "style": target.with_suffix(".qml"),
    }
    _write_raster(outputs["probability"], found)
    if geojson:
        outputs["geojson"] = target.with_suffix(".geojson")
        write_geojson(outputs["geojson"], rows, header.crs_wkt)
    write_style(outputs["style"])
    write_geopackage(target, rows, header.crs_wkt)
    return outputs


def _write_raster(path: Path, found: Comparison) -> None:
    """Confidence of the region that a cell lies in, %; 0 where nothing stands out."""
    import cv2

    header = found.cells.header
    profile = RasterProfile(
        width=header.width, height=header.height, transform=header.transform,
        crs_wkt=header.crs_wkt, epsg=header.epsg, bands=1, dtype="uint8", compression="deflate",
        nodata=NODATA, band_descriptions=("probability of change, %",),
        metadata={"SOFTWARE": "georef_gis", "TITLE": "Probability of change, %"},
    )  # fmt: skip
    rings = _rings(found)
    with TiledWriter(path, profile) as writer:
        size = profile.tile_size
        for row in range(writer.tile_rows):
            for col in range(writer.tile_cols):
                down, across = writer.tile_shape(row, col)
                tile = np.where(
                    found.shown.read((col * size, row * size, across, down)), 0, int(NODATA)
                ).astype(np.uint8)
                empty = tile == NODATA
                for bounds, points, value in rings:
                    if _meets(bounds, col * size, row * size, across, down):
                        local = [one - np.array([col * size, row * size]) for one in points]
                        cv2.fillPoly(tile, local, value)
                tile[empty] = NODATA
                writer.write_tile(row, col, tile)


def _rings(found: Comparison) -> list[tuple[tuple[float, ...], list[Any], int]]:
    """Bounds, rings in cells and value of all regions, the surest last."""
    rings = []
    for change in reversed(found.changes):
        shape = change.judged.outline.shape
        points = [
            np.round(np.asarray(ring.coords) - 0.5).astype(np.int32)
            for part in shape.geoms
            for ring in (part.exterior, *part.interiors)
        ]
        rings.append((shape.bounds, points, round(100.0 * change.confidence)))
    return rings


def _meets(bounds: tuple[float, ...], col: int, row: int, across: int, down: int) -> bool:
    x0, y0, x1, y1 = bounds
    return x0 - 1 < col + across and x1 + 1 > col and y0 - 1 < row + down and y1 + 1 > row
