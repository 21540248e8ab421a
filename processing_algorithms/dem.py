"""The ground from a raster of project.toml: heights of any unit and kind, as ellipsoidal metres."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from georef_gis.errors import CrsError, InputError
from georef_gis.frames import Array
from georef_gis.geodesy import (
    CRS,
    Datum,
    HeightKind,
    MapFrame,
    VerticalPart,
    geoid_undulation,
    height_unit,
    horizontal_crs,
    metres_per_unit,
    parse_crs,
    vertical_part,
)
from georef_gis.model.terrain import DemTerrain, dem_terrain
from georef_gis.project import Project
from georef_gis.rasters.reading import GridHeader, Window, read_grid, read_grid_header
from georef_gis.units import INTERNATIONAL_FOOT, US_SURVEY_FOOT

if TYPE_CHECKING:
    from georef_gis.model.photo import Photo

# m; how far around the photos a DEM is read
DEM_MARGIN = 600.0
# m, one sigma of a DEM's height where the user states none
DEM_SIGMA = 1.0
# m; how far the ground may lie from take-off level, and tags be off, in telling a DEM's unit
UNIT_SLACK = 15.0
_METRES = {"m": 1.0, "ft": INTERNATIONAL_FOOT, "us-ft": US_SURVEY_FOOT}
_NAD83 = Datum(name="NAD83(2011)", epoch=2010.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Dem:
    """A DEM around the photos as it is stored.

    `values` (rows, cols) in the file's own unit, NaN where there is none; `transform` from the
    outer corner of the first cell to the map of `frame`; `unit` in m, None if nothing states it;
    `doubt` of its datum and geoid.
    """

    project: Project
    path: Path
    frame: MapFrame
    crs: CRS
    values: Array
    transform: tuple[float, ...]
    unit: float | None
    # m per unit of the CRS at the photos; degrees included
    cell_unit: float
    doubt: str = ""

    def terrain(self, unit: float) -> DemTerrain:
        """Ground as ellipsoidal heights, where the values count in `unit`, m."""
        a, _, left, _, e, top = self.transform
        return dem_terrain(
            self.frame,
            self._ellipsoidal(self.values * unit),
            left=left,
            top=top,
            cell=(a, -e),
            metres_per_unit=self.cell_unit,
            sigma=self.project.settings.ground.sigma_m or DEM_SIGMA,
        )

    def _ellipsoidal(self, values: Array) -> Array:
        """Ellipsoidal heights, m, from those of the DEM's own kind; shape (rows, cols)."""
        kind = self.project.settings.ground.dem_height_kind
        spatial = len(self.crs.axis_info) == 3 and not self.crs.is_compound
        if kind == "ellipsoidal" or (kind == "auto" and spatial):
            return values
        rows, cols = values.shape
        a, _, left, _, e, top = self.transform
        # The geoid bends by centimetres per kilometre: a coarse grid, bilinear between.
        r, c = np.linspace(0, rows, 9), np.linspace(0, cols, 9)
        xy = np.stack(np.meshgrid(left + c * a, top + r * e), axis=-1)
        geo = self.frame.geo_from_map(np.concatenate([xy, np.zeros((9, 9, 1))], axis=-1))
        n = self._undulation(geo)
        i, j = (np.arange(rows) + 0.5) / rows * 8, (np.arange(cols) + 0.5) / cols * 8
        by_col = np.stack([np.interp(j, np.arange(9), row) for row in n])
        lower = np.minimum(i.astype(int), 7)
        fraction = (i - lower)[:, None]
        return np.asarray(values + by_col[lower] * (1 - fraction) + by_col[lower + 1] * fraction)

    def _undulation(self, geo: Array) -> Array:
        """Height of the geoid that the user states, else of that of the CRS, m; shape (...)."""
        said = self.project.settings.gnss
        part = self._vertical()
        stated = part is None or "geoid" in said.model_fields_set
        geoid = said.geoid if stated or part is None else part.geoid
        try:
            return geoid_undulation(
                geo[..., 0], geo[..., 1], geoid=geoid, datum=self.frame.gnss_datum
            )
        except CrsError as error:
            if stated:
                raise
            raise InputError(
                f"its heights are above {geoid}: {error}; or take EGM96 in its place, which is "
                'off by up to 1 m or so, by [gnss] geoid = "egm96"',
                source=self.path.name,
            ) from error

    def _vertical(self) -> VerticalPart | None:
        """Vertical part of the CRS; None for one of no known geoid whose kind the user states."""
        try:
            return vertical_part(self.crs)
        except CrsError as error:
            up = self.crs.sub_crs_list[-1]
            if up.axis_info[0].direction != "up":
                raise
            if self.project.settings.ground.dem_height_kind != "auto":
                return None
            raise CrsError(
                f"heights of '{up.name}' are of no geoid that is known; say "
                'what they are above by [ground] dem_height_kind = "orthometric" and [gnss] geoid, '
                "and their unit by dem_unit",
                source=str(self.path),
            ) from error


def read_dem(project: Project, frame: MapFrame, positions_enu: Array) -> Dem:
    """DEM of project.toml around the photos.

    Parameters
    ----------
    positions_enu : shape (n, 3), m
        Of the cameras.

    Raises
    ------
    InputError
        If the DEM cannot be read, has no CRS or does not lie under the photos.
    """
    if project.settings.ground.dem is None:
        raise ValueError("the project has no DEM")
    path = project.path(project.settings.ground.dem)
    header = read_grid_header(path)
    if not header.crs_wkt:
        raise CrsError("has no CRS; add a .prj beside it", source=str(path), field="CRS")
    a, b, _, d, e, _ = header.transform
    if b or d or a <= 0 or e >= 0:
        raise InputError(
            "is not north-up; warp it to a north-up raster (e.g. gdalwarp)", source=str(path)
        )
    crs = parse_crs(header.crs_wkt)
    own, doubt = frame_of_dem(frame, horizontal_crs(crs), path)
    window = _window(own, header, positions_enu)
    if window[2] < 1 or window[3] < 1:
        raise _elsewhere(path, own, header, positions_enu.mean(axis=0))
    raster = read_grid(path, window=window)
    doubts = [line for line in (doubt, _geoid_doubt(project, frame, crs, path)) if line]
    return Dem(
        project=project,
        path=path,
        frame=own,
        crs=crs,
        values=raster.values.astype(np.float64),
        transform=raster.transform,
        unit=_stated_unit(project, header.unit, crs, path),
        cell_unit=_cell_scale(own, positions_enu.mean(axis=0)),
        doubt="; ".join(doubts),
    )


def _window(own: MapFrame, header: GridHeader, positions_enu: Array) -> Window:
    """Columns and rows of a DEM around the photos; none where it does not lie under them."""
    a, _, left, _, e, top = header.transform
    low, high = positions_enu.min(axis=0) - DEM_MARGIN, positions_enu.max(axis=0) + DEM_MARGIN
    corners = np.array([[x, y, 0.0] for x in (low[0], high[0]) for y in (low[1], high[1])])
    p = own.map_from_enu(corners)[:, :2]
    cols = np.clip((p[:, 0] - left) / a, 0, header.width)
    rows = np.clip((p[:, 1] - top) / e, 0, header.height)
    c0, r0 = int(np.floor(cols.min())), int(np.floor(rows.min()))
    return c0, r0, int(np.ceil(cols.max())) - c0, int(np.ceil(rows.max())) - r0


def _geoid_doubt(project: Project, frame: MapFrame, crs: CRS, path: Path) -> str:
    """That a DEM without a height system is laid above another geoid than the project promises."""
    part, gnss = frame.vertical, project.settings.gnss
    if part is None or part.geoid == gnss.geoid or "geoid" in gnss.model_fields_set:
        return ""
    told = crs.is_compound or len(crs.axis_info) == 3
    if told or project.settings.ground.dem_height_kind == "ellipsoidal":
        return ""
    return (
        f"{path.name} does not say what its heights are above: taken as {gnss.geoid}, while the "
        f"project's CRS promises {part.name}, up to 1 m apart: state [gnss] geoid, such as "
        f'"{part.geoid}"'
    )


def frame_of_dem(frame: MapFrame, crs: CRS, path: Path) -> tuple[MapFrame, str]:
    """Frame of a DEM's map, and a doubt where its datum is taken for another.

    Most DEMs of the United States say NAD83 and no realisation; a metre is less than a cell, and
    not worth the four grids of NADCON 5 that part it from NAD83(2011).
    """
    try:
        return MapFrame(frame.origin, crs, gnss_datum=frame.gnss_datum), ""
    except CrsError as error:
        base = crs.geodetic_crs
        if base is None or not base.name.startswith("NAD83"):
            raise CrsError(str(error), source=path.name) from error
    taken = MapFrame(frame.origin, crs, gnss_datum=frame.gnss_datum, crs_datum=_NAD83)
    return taken, (
        f"{path.name}: its datum {base.name} is taken as {_NAD83.name}, within a metre or so east "
        "and north, as the grids that part them are not installed (`georef grids`)"
    )


def _elsewhere(path: Path, own: MapFrame, header: GridHeader, p_enu: Array) -> InputError:
    """That a DEM does not lie under the photos; where both lie. `p_enu` (3,) m is amid them."""
    a, _, left, _, e, top = header.transform
    middle = np.array([left + a * header.width / 2.0, top + e * header.height / 2.0, 0.0])
    dem, photos = own.geo_from_map(middle), own.origin.geo_from_enu(p_enu)
    return InputError(
        f"{path} lies at {_lat_lon(dem)} and does not lie under the photos, at "
        f"{_lat_lon(photos)}; check its CRS and extent",
        source="project.toml",
        field="[ground] dem",
    )


def _lat_lon(geo: Array) -> str:
    """Latitude and longitude of rad in degrees; a map of another zone may have none."""
    if not np.all(np.isfinite(geo[:2])):
        return "no latitude and longitude"
    lat, lon = np.degrees(geo[:2])
    return f"{lat:.4f}, {lon:.4f} deg"


def _cell_scale(frame: MapFrame, p_enu: Array) -> float:
    """Metres per unit of a DEM's CRS at a place; degrees included."""
    here = frame.map_from_enu(p_enu)
    unit = 1e-4
    there = frame.enu_from_map(here + np.array([unit, 0.0, 0.0]))
    return float(np.linalg.norm(there - frame.enu_from_map(here)) / unit)


# -- unit of the heights -----------------------------------------------------------------------


def _stated_unit(project: Project, band: str, crs: CRS, path: Path) -> float | None:
    """Metres per unit by the user, the band, the CRS's vertical part; None if none of them says.

    GDAL fills a band's unit from the vertical CRS: it counts once. A CRS without a vertical part
    says nothing of the heights.
    """
    said = project.settings.ground.dem_unit
    if said != "auto":
        return _METRES[said]
    if band.strip():
        return _unit(band, path)
    if crs.is_compound:
        return float(crs.sub_crs_list[1].axis_info[0].unit_conversion_factor)
    if len(crs.axis_info) == 3:
        return float(crs.axis_info[2].unit_conversion_factor)
    return None


def _unit(name: str, path: Path) -> float:
    """Metres per unit of a band, by the name that its file gives."""
    unit = height_unit(name)
    if unit is None:
        raise InputError(
            f"unit '{name}' of the heights is not known; set [ground] dem_unit",
            source=str(path),
            field="band unit",
        )
    return unit


@dataclass(frozen=True, slots=True, kw_only=True)
class UnitChoice:
    """Unit of a DEM's heights, m, and how it was told; a doubt if the tags do not tell it."""

    unit: float
    told: str = ""
    doubt: str = ""


def choose_unit(dem: Dem, photos: Sequence[Photo]) -> UnitChoice:
    """Unit of a DEM's heights: as stated, else the one that the heights in the tags fit.

    Where they fit both, the unit of the CRS, as other programs have it; with a doubt if that is
    feet. Doubts of the DEM itself come with it.
    """
    choice = UnitChoice(unit=dem.unit) if dem.unit is not None else _found_unit(dem, photos)
    doubts = [doubt for doubt in (dem.doubt, choice.doubt) if doubt]
    return replace(choice, doubt="; ".join(doubts))


def _found_unit(dem: Dem, photos: Sequence[Photo]) -> UnitChoice:
    """Unit of heights that no one states."""
    across = dem.frame.horizontal
    feet = across.is_projected and abs(metres_per_unit(across) - 1.0) > 1e-9
    own = metres_per_unit(across) if feet else US_SURVEY_FOOT
    name = str(across.axis_info[0].unit_name) if feet else "US survey foot"
    what = f"{dem.path.name} states no unit of its heights"
    flown = _Flown(dem, photos)
    as_metres, as_own = flown.above(1.0), flown.above(own)
    fits = [flown.fits(as_metres, as_own), flown.fits(as_own, as_metres)]
    if not feet:
        if not fits[1]:
            return UnitChoice(unit=1.0)
        return UnitChoice(
            unit=own,
            doubt=f"{what}: taken as feet, by which the photos are {as_own:.0f} m above the "
            f"ground ({as_metres:.0f} m if they are metres): state them in [ground] dem_unit",
        )
    what += f", and its CRS counts in {name}"
    if any(fits):
        unit, text, above = (1.0, "metres", as_metres) if fits[0] else (own, name, as_own)
        told = f"{what}: taken as {text}, by which the photos are {above:.0f} m above the ground"
        return UnitChoice(unit=unit, told=told)
    put = ""
    if np.isfinite(as_own):
        put = f", {as_own:.0f} m below the photos ({as_metres:.0f} m if they are metres)"
    return UnitChoice(
        unit=own, doubt=f"{what}: taken as {name}{put}: state them in [ground] dem_unit"
    )


class _Flown:
    """Heights of the photos, to lay beside those of a DEM."""

    def __init__(self, dem: Dem, photos: Sequence[Photo]) -> None:
        from georef_gis.orient.heights import SAME_HEIGHT, relative_height, tag_height

        gnss = dem.project.settings.gnss
        kind = None if gnss.height_kind == "auto" else HeightKind(gnss.height_kind)
        self.dem, self.unsure = dem, 0.0
        self.places, self.heights, self.relative = [], [], []
        for photo in photos:
            tag, rel = photo.geotag, relative_height(photo, kind)
            if tag is None or tag.height is None:
                continue
            h = tag_height(photo, kind, gnss.geoid)
            its = kind or tag.height.kind
            # A height above take-off, or one that repeats it, does not tell where the ground lies.
            above = rel is not None and abs(tag.height.value - rel) < SAME_HEIGHT
            if h is None and (its is not HeightKind.UNKNOWN or above):
                continue
            if h is None:
                h = tag_height(photo, HeightKind.ORTHOMETRIC, gnss.geoid)
                n = float(geoid_undulation(tag.lat, tag.lon, geoid=gnss.geoid))
                self.unsure = max(self.unsure, abs(n))
            self.places.append([tag.lat, tag.lon, 0.0])
            self.heights.append(h)
            if rel is not None:
                self.relative.append(rel)

    def above(self, unit: float) -> float:
        """Median height of the photos above the DEM, m, if it counts in `unit`; else NaN."""
        if not self.places:
            return float("nan")
        xy = self.dem.frame.map_from_geo(np.array(self.places))[:, :2]
        ground = self.dem.terrain(unit).height_at_map(xy)
        above = (np.array(self.heights, dtype=float) - ground)[np.isfinite(ground)]
        return float(np.median(above)) if above.size else float("nan")

    def fits(self, above: float, other: float) -> bool:
        """Whether a height above the ground fits what the tags say, and the other clearly not."""
        slack = UNIT_SLACK + self.unsure
        if not np.isfinite(above):
            return False
        if not self.relative:
            return above > 0.0 and other < -slack
        said = float(np.median(self.relative))
        return abs(above - said) < slack and abs(other - said) > abs(above - said) + 2.0 * slack
