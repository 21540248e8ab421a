"""Tool `mosaic-sheets`: the mosaic of a road as sheets along its centre line."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from georef_gis.toolbox import Algorithm, Context, Feedback, Output, Result
from georef_gis.toolbox import parameters as p

if TYPE_CHECKING:
    from georef_gis.geodesy import CRS
    from georef_gis.mosaic.sheet_cut import Sheet
    from georef_gis.project import Project
    from georef_gis.rasters.resampled import MapHeader
    from processing_algorithms.mosaic.sheet_pixels import SheetCutter

# px; how finely it is known where the raster shows something
COVER_SIDE = 2048
# what may be written for no line
AUTO = "auto"


class MosaicSheetsParameters(p.Parameters):
    """Parameters of `mosaic-sheets`."""

    line: p.VectorLayer | None = p.vector_layer(
        None, title="Centre line",
        help="file with one line (GeoJSON, GeoPackage, Shapefile, KML; any CRS); without, or with "
        "auto: the middle of the flight, from the end where the first photo was taken",
    )  # fmt: skip
    layer: p.Text | None = p.text(None, title="Layer of that file, if several have lines")
    raster: p.RasterLayer | None = p.raster_layer(
        None, title="Raster to cut; by default products/mosaic.tif"
    )
    length: p.Length = p.length(500.0, title="Length of a sheet along the line", gt=0)
    width: p.Length | None = p.length(
        None, title="Width of the sheets; by default all that the raster shows", gt=0
    )
    overlap: p.Length = p.length(0.0, title="Length that a sheet shares with the next", ge=0)


class MosaicSheets(Algorithm[MosaicSheetsParameters]):
    """The mosaic as GeoTIFF sheets along a centre line, with their index.

    Each sheet is north-up, on the pixels of the mosaic, and shows the ground beside its part of
    the line; sheets that would show nothing are not written. The index `sheets.gpkg` holds the
    areas of the sheets with their chainage, and the line. Sheets of an earlier run are replaced.
    """

    id, name, group = "mosaic_sheets", "Sheets of the mosaic", "mosaic"
    outputs = (
        Output(name="sheets", title="Sheets", type="Folder"),
        Output(name="index", title="Index of the sheets", type="VectorLayer"),
    )
    needs = ("mosaic",)

    def run(
        self, context: Context, parameters: MosaicSheetsParameters, feedback: Feedback
    ) -> Result:
        """Cut them."""
        from georef_gis.rasters.resampled import open_bands
        from processing_algorithms.mosaic.sheet_files import INDEX_FILE
        from processing_algorithms.mosaic.sheet_pixels import SheetCutter

        project = context.require_project()
        place = _Place.of(project, parameters)
        with open_bands(place.raster) as bands:
            crs, metres = _map_of(bands.header)
            cut = _cut(project, place.raster, bands.header, crs, metres, parameters)
            workers = max(1, context.workers)
            cutter = SheetCutter(project, place.raster, bands, metres, workers=workers)
            index = place.folder / INDEX_FILE
            count = _write(cutter, cut, place, (index, crs, metres), feedback)
        summary = {
            "products": [str(index)],
            "sheets": count,
            "empty_sheets": len(cut.sheets) - count,
            "line_m": round(cut.line.length * metres, 2),
            "width_m": round(cut.width * metres, 2),
        }
        feedback.info(f"{count} sheets of {place.raster.name} in {place.folder}")
        return Result(outputs={"sheets": place.folder, "index": index}, summary=summary)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Place:
    """Where pixels come from and sheets go."""

    raster: Path
    folder: Path
    title: str

    @classmethod
    def of(cls, project: Project, parameters: MosaicSheetsParameters) -> _Place:
        from georef_gis.errors import InputError

        mosaic = project.products / "mosaic.tif"
        raster = Path(parameters.raster or mosaic)
        if not raster.is_file():
            cure = "give a GeoTIFF" if parameters.raster else "run `georef run`, or give --raster"
            raise InputError(f"there is no such file; {cure}", source=str(raster), field="raster")
        if raster.resolve() == mosaic.resolve():
            title = project.settings.project.name or "mosaic"
            folder = project.products / "sheets"
        else:
            title, folder = raster.stem, project.products / f"{raster.stem}_sheets"
        return cls(raster=raster, folder=folder, title=re.sub(r"[^\w.-]+", "_", title))

    def path(self, number: int, count: int) -> Path:
        """File of a sheet; names sort in the order of the line."""
        digits = max(3, len(str(count)))
        return self.folder / f"{self.title}_sheet_{number:0{digits}d}.tif"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Cut:
    """Line, width across, and sheets, all in units of the map."""

    line: Any
    width: float
    sheets: tuple[Sheet, ...]


def _map_of(header: MapHeader) -> tuple[CRS, float]:
    """CRS of a north-up raster in a map, and metres in its unit."""
    from georef_gis.errors import CrsError, InputError
    from georef_gis.geodesy import horizontal_crs, metres_per_unit, parse_crs

    a, b, _, d, e, _ = header.transform
    if b != 0.0 or d != 0.0 or a <= 0.0 or a != -e:
        raise InputError(
            "is not a north-up map of square pixels; give a GeoTIFF that is", source=header.name
        )
    crs = horizontal_crs(parse_crs(header.crs_wkt)) if header.crs_wkt else None
    if crs is None or not crs.is_projected:
        told = "has no CRS" if crs is None else f"is in degrees ('{crs.name}')"
        raise CrsError(f"{told}; give a raster in a projected CRS", source=header.name)
    return crs, metres_per_unit(crs)


def _cut(
    project: Project, raster: Path, header: MapHeader, crs: CRS, metres: float,
    parameters: MosaicSheetsParameters,
) -> _Cut:  # fmt: skip
    """Line, width and sheets, once it is known that the line meets the raster."""
    from georef_gis.errors import InputError
    from georef_gis.mosaic import sheet_cut
    from georef_gis.rasters.resampled import coarse_valid
    from processing_algorithms.drawn import layer_file
    from processing_algorithms.mosaic.sheet_line import flight_line, read_line

    given = parameters.line if parameters.line != AUTO else None
    if given is None:
        line = flight_line(project, crs)
    else:
        line = read_line(*layer_file(given, parameters.layer, field="line"), crs)
    shown = coarse_valid(raster, header, most=COVER_SIDE)
    rows, cols = shown.shape
    pixel, _, left, _, _, top = header.transform
    cover = sheet_cut.Cover(
        shown=shown, left=left, top=top,
        cell=(pixel * header.width / cols, pixel * header.height / rows),
    )  # fmt: skip
    width = parameters.width / metres if parameters.width else None
    gap = sheet_cut.gap_to(line, cover)
    if gap > (width / 2.0 + cover.size if width else 0.0):
        raise InputError(
            f"the line lies outside {raster.name}, {gap * metres:.0f} m off; check the line and "
            "its CRS, or give --width",
            source=given or "", field="line",
        )  # fmt: skip
    if given is None:
        line = sheet_cut.trimmed(line, cover)
    if width is None:
        width = sheet_cut.width_over(line, cover)
    lengths = (parameters.length / metres, parameters.overlap / metres)
    parts = sheet_cut.spans(line.length, *lengths)
    return _Cut(line=line, width=width, sheets=tuple(sheet_cut.cut_sheets(line, parts, width)))


def _write(
    cutter: SheetCutter, cut: _Cut, place: _Place, listed: tuple[Path, CRS, float],
    feedback: Feedback,
) -> int:  # fmt: skip
    """Write the sheets that show something, then their index; how many those are.

    `listed` is the index, the CRS, and metres in its unit. Files of others are not touched, and
    older sheets of ours go once the new ones are there.
    """
    from georef_gis.errors import GeometryError
    from processing_algorithms.mosaic import sheet_files

    index, crs, metres = listed
    paths = [place.path(sheet.number, len(cut.sheets)) for sheet in cut.sheets]
    old = sheet_files.own_sheets(place.folder)
    sheet_files.check_free(paths, old, index)
    with sheet_files.refusals(place.folder):
        place.folder.mkdir(parents=True, exist_ok=True)
        # it would be wrong as soon as the first sheet is another
        index.unlink(missing_ok=True)
    files = []
    for number, (sheet, path) in enumerate(zip(cut.sheets, paths, strict=True), start=1):
        if cutter.write(sheet, path, feedback):
            files.append(sheet_files.SheetFile(sheet=sheet, path=path))
        feedback.progress(number / len(paths), f"sheet {number} of {len(paths)}")
    if not files:
        raise GeometryError(
            f"no sheet shows anything of {place.raster.name}; check --line and --width"
        )
    sheet_files.write_index(index, files, cut.line, crs, metres=metres)
    with sheet_files.refusals(place.folder):
        for path in old - {file.path for file in files}:
            path.unlink(missing_ok=True)
    return len(files)
