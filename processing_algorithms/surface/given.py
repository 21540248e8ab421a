"""A surface from a raster of heights that a user gives: of any CRS, unit and kind of height."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from georef_gis.ellipsoid import WGS84_A
from georef_gis.errors import CrsError, InputError
from georef_gis.frames import Array
from georef_gis.geodesy import (
    CRS,
    MapFrame,
    height_unit,
    horizontal_crs,
    metres_per_unit,
    parse_crs,
    vertical_part,
)
from georef_gis.measure.surface.common_errors import CommonErrors
from georef_gis.measure.surface.field import GroundField, HeightField
from georef_gis.measure.surface.raster import (
    LOCAL_BAND,
    SIGMA_BAND,
    HeightReference,
    undulation_over,
)
from georef_gis.model.ground_errors import GroundErrors
from georef_gis.model.terrain import DemTerrain, dem_terrain
from georef_gis.project import Project
from georef_gis.rasters.reading import GridHeader, Window, read_grid, read_grid_header
from georef_gis.units import INTERNATIONAL_FOOT, US_SURVEY_FOOT
from processing_algorithms.dem import frame_of_dem

# m, one sigma of a raster's heights where nothing is stated
RASTER_SIGMA = 1.0
# cells of a raster that are read at most
MOST_CELLS = 50_000_000
# m; heights beyond are a number for "none" that the file does not declare
_LOWEST, _HIGHEST = -1000.0, 10_000.0
# metres per unit, as project.toml names it
_METRES = {"m": 1.0, "ft": INTERNATIONAL_FOOT, "us-ft": US_SURVEY_FOOT}
# of the names of bands of ours, before the unit
_SIGMA, _LOCAL = SIGMA_BAND.removesuffix("m"), LOCAL_BAND.removesuffix("m")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Given:
    """A raster of heights: what its file says of it."""

    project: Project
    path: Path
    header: GridHeader
    crs: CRS
    bands: tuple[str, ...]

    @property
    def cell(self) -> tuple[float, float]:
        """Width and height of a cell, CRS units."""
        return self.header.transform[0], -self.header.transform[4]

    @property
    def ours(self) -> bool:
        """Whether `georef surface` wrote it."""
        return self.bands[1:2] != () and self.bands[1].startswith(_SIGMA)


def raster_field(
    project: Project, frame: MapFrame, path: Path, *, around: Array, sigma: float | None
) -> HeightField:
    """Surface from a raster of heights of any CRS.

    Its kind of height, and their unit, are those of its CRS' vertical part; without one those of
    [ground] dem_height_kind and dem_unit.

    Parameters
    ----------
    around : shape (n, 2), m
        Places in enu that must be covered.
    sigma : m
        One sigma of its heights where it has no band of them.

    Raises
    ------
    InputError
        If it cannot be read or does not lie there.
    """
    given = _given(project, path)
    own, doubt = frame_of_dem(frame, horizontal_crs(given.crs), path)
    window = _window(own, given.header, around, path)
    heights, (left, top) = _heights(given, own, window)
    metres = _cell_scale(own, frame, around.mean(axis=0))
    terrain = dem_terrain(
        own, heights, left=left, top=top, cell=given.cell, metres_per_unit=metres,
        sigma=sigma or RASTER_SIGMA,
    )  # fmt: skip
    if sigma is None and given.ours:
        return _with_bands(terrain, given, window)
    return GroundField.of(terrain, f"{_name(given)}{f' ({doubt})' if doubt else ''}")


def _given(project: Project, path: Path) -> _Given:
    """What a file says of its heights; refused without a CRS, and if it is not north-up."""
    header = read_grid_header(path)
    if not header.crs_wkt:
        raise CrsError("has no CRS; add a .prj beside it", source=str(path), field="CRS")
    a, b, _, d, e, _ = header.transform
    if b or d or a <= 0 or e >= 0:
        raise InputError("is not north-up; warp it to a north-up raster", source=str(path))
    crs = parse_crs(header.crs_wkt)
    return _Given(project=project, path=path, header=header, crs=crs, bands=_bands_told(path))


def _window(own: MapFrame, header: GridHeader, around: Array, path: Path) -> Window:
    """Columns and rows of a raster about some places, with a margin of a third."""
    low, high = around.min(axis=0), around.max(axis=0)
    reach = 0.35 * float(np.max(high - low)) + 5.0
    corners = np.array([[x, y, 0.0] for x in (low[0] - reach, high[0] + reach)
                        for y in (low[1] - reach, high[1] + reach)])  # fmt: skip
    p = own.map_from_enu(corners)[:, :2]
    a, _, left, _, e, top = header.transform
    cols = np.clip((p[:, 0] - left) / a, 0, header.width)
    rows = np.clip((p[:, 1] - top) / e, 0, header.height)
    if not np.all(np.isfinite([cols, rows])):
        raise InputError("does not lie where the shape is; check its CRS", source=str(path))
    c0, r0 = int(np.floor(cols.min())), int(np.floor(rows.min()))
    width, height = int(np.ceil(cols.max())) - c0, int(np.ceil(rows.max())) - r0
    if width < 2 or height < 2:
        raise InputError("does not lie where the shape is; check its CRS", source=str(path))
    if width * height > MOST_CELLS:
        raise InputError(
            f"has {width * height / 1e6:.0f} million cells about the shape; take a coarser raster",
            source=str(path),
        )
    return (c0, r0, width, height)


def _cell_scale(own: MapFrame, frame: MapFrame, xy: Array) -> float:
    """Metres per unit of a raster's CRS at a place (2,), m; of degrees those to the east."""
    if own.horizontal.is_projected:
        return metres_per_unit(own.horizontal)
    lat = float(frame.origin.geo_from_enu(np.append(xy, 0.0))[0])
    return math.radians(WGS84_A) * math.cos(lat)


def _bands_told(path: Path) -> tuple[str, ...]:
    """Names of a raster's bands."""
    from georef_gis.rasters.resampled import open_bands

    with open_bands(path) as bands:
        return tuple(bands.header.bands)


# -- heights -----------------------------------------------------------------------------------


def _heights(given: _Given, own: MapFrame, window: Window) -> tuple[Array, tuple[float, float]]:
    """Heights above the ellipsoid in a window, m, NaN for none, and its outer corner.

    Raises
    ------
    InputError
        If no cell has one.
    """
    raster = read_grid(given.path, window=window)
    heights = raster.values.astype(np.float64) * _unit(given)
    with np.errstate(invalid="ignore"):
        heights[~((heights > _LOWEST) & (heights < _HIGHEST))] = np.nan
    if not np.any(np.isfinite(heights)):
        raise InputError("has no height about the shape", source=str(given.path))
    a, _, left, _, e, top = raster.transform
    geoid = _geoid_of(given)
    if geoid is not None:
        rows, cols = heights.shape
        x, y = left + a * (np.arange(cols) + 0.5), top + e * (np.arange(rows) + 0.5)
        reference = HeightReference(kind="orthometric", geoid=geoid)
        heights += undulation_over(own, reference, np.stack(np.meshgrid(x, y), axis=-1))
    return heights, (left, top)


def _unit(given: _Given) -> float:
    """Metres per unit of the heights: by the band, the CRS's vertical part, project.toml.

    Raises
    ------
    InputError
        If none of them says, and the CRS does not count in metres.
    """
    crs = given.crs
    band = given.bands[1].removeprefix(_SIGMA) if given.ours else given.header.unit.strip()
    if band:
        unit = height_unit(band)
        if unit is None:
            raise InputError(
                f"unit '{band}' of the heights is not known; use m, ft or us-ft",
                source=str(given.path), field="band unit",
            )  # fmt: skip
        return unit
    up = crs.sub_crs_list[1].axis_info if crs.is_compound else crs.axis_info[2:]
    if up:
        return float(up[0].unit_conversion_factor)
    stated = given.project.settings.ground.dem_unit
    if stated != "auto":
        return _METRES[stated]
    if crs.is_projected and abs(metres_per_unit(crs) - 1.0) > 1e-9:
        raise InputError(
            f"does not say whether its heights are m or {crs.axis_info[0].unit_name}; set "
            "[ground] dem_unit in project.toml", source=str(given.path), field="band unit",
        )  # fmt: skip
    return 1.0


def _geoid_of(given: _Given) -> str | None:
    """Geoid of a raster's heights; None where they are above the ellipsoid."""
    settings, crs = given.project.settings, given.crs
    if crs.is_compound:
        try:
            part = vertical_part(crs)
        except CrsError as error:
            raise CrsError(str(error), source=str(given.path)) from error
        return None if part is None else part.geoid
    if len(crs.axis_info) == 3 or (given.ours and "ellipsoid" in given.bands[0]):
        return None
    return None if settings.ground.dem_height_kind == "ellipsoidal" else settings.gnss.geoid


# -- sigmas ------------------------------------------------------------------------------------


def _with_bands(terrain: DemTerrain, given: _Given, window: Window) -> GroundField:
    """Field with the sigmas that its file holds: their root mean square about the shape."""
    whole = _mean_square(given, window, 2)
    # files of before had no band of the local part
    has_local = given.bands[2:3] != () and given.bands[2].startswith(_LOCAL)
    local = _mean_square(given, window, 3) if has_local else whole / 2.0
    shared = math.sqrt(max(whole - local, 0.0))
    told = replace(terrain, sigma=math.sqrt(shared**2 + local))
    return GroundField(
        terrain=told, errors=replace(GroundErrors.of(told), shared=shared),
        name=_name(given), common=CommonErrors.level(shared),
    )  # fmt: skip


def _name(given: _Given) -> str:
    return f"raster {given.path.name}"


def _mean_square(given: _Given, window: Window, band: int) -> float:
    values = read_grid(given.path, window=window, band=band).values.astype(np.float64)
    values *= _unit(given)
    known = values[np.isfinite(values)]
    return float(np.mean(known**2)) if len(known) else RASTER_SIGMA**2
