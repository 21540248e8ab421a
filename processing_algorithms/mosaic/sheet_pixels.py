"""Pixels of sheets: copied from a raster, window by window."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from georef_gis.model.grid import Grid, Window
from georef_gis.toolbox import Feedback, check_cancelled

if TYPE_CHECKING:
    from georef_gis.mosaic.sheet_cut import Sheet
    from georef_gis.project import Project
    from georef_gis.rasters.profile import RasterProfile
    from georef_gis.rasters.resampled import Bands

# px of the raster; blocks of JPEG with halved colour, so that encoding again hardly changes them
ALIGN = 16


class SheetCutter:
    """Writes sheets of a raster; `metres` are in a unit of its map."""

    def __init__(
        self, project: Project, raster: Path, bands: Bands, metres: float, *, workers: int
    ) -> None:
        from georef_gis.rasters.parts import dataset_items

        self._project, self._bands, self._metres, self._workers = project, bands, metres, workers
        header = bands.header
        self._grid = Grid(
            crs_wkt=header.crs_wkt, left=header.transform[2], top=header.transform[5],
            pixel=header.transform[0], width=header.width, height=header.height,
        )  # fmt: skip
        self._items = dataset_items(raster)

    def write(self, sheet: Sheet, path: Path, feedback: Feedback) -> bool:
        """Write a sheet, whole or not at all; whether it shows something, else there is no file.

        Raises
        ------
        Cancelled
            If the user wants to stop.
        ExportError, InputError
            If it cannot be written, or the raster not be read.
        """
        from georef_gis.rasters.writer import TiledWriter

        part = self._window(sheet)
        if part is None:
            return False
        profile, shown = self._profile(sheet, path, part), False
        every = range(1, len(self._bands.header.bands) + 1)
        with TiledWriter(path, profile, workers=self._workers) as writer:
            for row, col, w in _grid_of(self._grid, part).tiles(profile.tile_size):
                check_cancelled(feedback)
                tile = Window(
                    col=part.col + w.col, row=part.row + w.row, width=w.width, height=w.height
                )
                inside = _inside(sheet.area, _grid_of(self._grid, tile))
                if inside is not None:
                    data, valid = self._bands.read((tile.col, tile.row, w.width, w.height), every)
                    inside &= valid.any(axis=2)
                if inside is None or not inside.any():
                    writer.skip_tile(row, col)
                    continue
                writer.write_tile(row, col, data, inside)
                shown = True
            if not shown:
                writer.abort()
        return shown

    def _window(self, sheet: Sheet) -> Window | None:
        """Part of the raster that holds a sheet; None if it lies outside."""
        import numpy as np

        left, bottom, right, top = sheet.area.bounds
        low, high = self._grid.grid_from_map([[left, top], [right, bottom]]) / ALIGN
        col, row = (max(int(value) * ALIGN, 0) for value in np.floor(low))
        end_col, end_row = (int(value) * ALIGN for value in np.ceil(high))
        width = min(end_col, self._grid.width) - col
        height = min(end_row, self._grid.height) - row
        if width <= 0 or height <= 0:
            return None
        return Window(col=col, row=row, width=width, height=height)

    def _profile(self, sheet: Sheet, path: Path, part: Window) -> RasterProfile:
        """As project.toml wants products; names and items are those of the raster."""
        from georef_gis.project.records import load_frame
        from processing_algorithms.mosaic.sheet_files import SOFTWARE
        from processing_algorithms.rasters import profile_for

        header, frame = self._bands.header, load_frame(self._project.database)
        profile = profile_for(
            self._project, frame, _grid_of(self._grid, part), bands=len(header.bands),
            dtype=header.dtype, title="",
        )  # fmt: skip
        start, end = sheet.start * self._metres, sheet.end * self._metres
        items = {
            "SOFTWARE": SOFTWARE,
            "SHEET": path.stem,
            "CHAINAGE": f"{start:.2f} to {end:.2f} m",
        }
        names = header.bands if any(header.bands) else ()
        return replace(
            profile, epsg=header.epsg, band_descriptions=names, metadata=self._items | items
        )


def _grid_of(whole: Grid, part: Window) -> Grid:
    """Grid of a part of a grid."""
    left, top = whole.map_from_grid([part.col, part.row])
    return replace(whole, left=float(left), top=float(top), width=part.width, height=part.height)


def _inside(area: Any, grid: Grid) -> Any:
    """Which pixels (rows, cols) of a grid have their middle in an area; None if none has."""
    import shapely

    from georef_gis.rasters.parts import pixels_inside

    if not shapely.intersects(area, shapely.box(*grid.bounds)):
        return None
    return pixels_inside(area, grid.transform, rows=grid.height, cols=grid.width)
