"""Coordinate reference systems, datum realisations, and the transformations between them."""

from __future__ import annotations

import functools
import math
import threading
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from pyproj import CRS, Transformer
from pyproj.aoi import AreaOfInterest
from pyproj.exceptions import CRSError as _PyprojCrsError
from pyproj.transformer import TransformerGroup

from georef_gis.ellipsoid import WGS84_A, WGS84_F
from georef_gis.errors import CrsError
from georef_gis.frames import Array
from georef_gis.geodesy.grids_folder import how_to_get, made_with_grids

# m, one sigma; what is at stake when a position's datum realisation or epoch is unknown
UNKNOWN_DATUM_SIGMA = 2.0
# years within which plates move by 1 cm or so
_AT_ONCE = 0.5
# m, of the semi-major axis of a county's own ellipsoid: above it lies no road
_MOST_GROWN = 6000.0
# Frames of the orbits that PPP and OPUS work with: those of the ITRF to some mm, and PROJ, which
# has their names, knows no way from them.
_ITRF_OF = {
    "igs20": "ITRF2020", "igb20": "ITRF2020", "igs14": "ITRF2014", "igb14": "ITRF2014",
    "igs08": "ITRF2008", "igb08": "ITRF2008", "igs05": "ITRF2005", "igs00": "ITRF2000",
    "igb00": "ITRF2000",
}  # fmt: skip


def same_crs(first_wkt: str, second_wkt: str) -> bool:
    """Whether two CRSs differ in nothing but the order of axes, which rasters ignore."""
    first, second = CRS.from_wkt(first_wkt), CRS.from_wkt(second_wkt)
    return bool(first.equals(second, ignore_axis_order=True))


def utm_crs(lat: float, lon: float) -> CRS:
    """WGS 84 / UTM zone of a place (rad), Norway and Svalbard exceptions included."""
    lat_deg, lon_deg = math.degrees(lat), (math.degrees(lon) + 180.0) % 360.0 - 180.0
    zone = min(int((lon_deg + 180.0) // 6.0) + 1, 60)
    if 56.0 <= lat_deg < 64.0 and 3.0 <= lon_deg < 12.0:
        zone = 32
    elif 72.0 <= lat_deg < 84.0 and 0.0 <= lon_deg < 42.0:
        zone = 31 + 2 * int((lon_deg + 3.0) // 12.0)
    return CRS.from_epsg((32600 if lat_deg >= 0 else 32700) + zone)


def metres_per_unit(crs: CRS) -> float:
    """Length of the unit of a projected CRS, m (0.3048006... for the US survey foot)."""
    return float(crs.axis_info[0].unit_conversion_factor)


def horizontal_crs(crs: CRS) -> CRS:
    """The horizontal part of a compound CRS; any other CRS as it is."""
    return crs.sub_crs_list[0] if crs.is_compound else crs


@dataclass(frozen=True, slots=True, kw_only=True)
class Datum:
    """A datum realisation at an epoch, or unknown. Written `NAD83(2011)@2010.0`."""

    name: str = "unknown"
    # decimal year; None = not stated
    epoch: float | None = None

    @classmethod
    def parse(cls, text: str) -> Datum:
        """Datum from text such as `ITRF2020@2026.4`, `NAD83(2011)@2010.0` or `unknown`."""
        name, _, year = text.strip().partition("@")
        if name.lower() in {"", "unknown"}:
            return cls()
        try:
            epoch = float(year) if year else None
        except ValueError as error:
            raise CrsError(
                f"epoch '{year}' of '{text}' is not a decimal year; write e.g. ITRF2020@2026.4",
                field="datum",
            ) from error
        datum = cls(name=name, epoch=epoch)
        datum.geographic_3d()
        return datum

    @property
    def is_known(self) -> bool:
        """Whether the realisation is stated."""
        return self.name != "unknown"

    def geographic_3d(self) -> CRS:
        """Geographic 3D CRS of the realisation; of the IGS that of its ITRF."""
        try:
            found = _realisation(self.name)
        except _PyprojCrsError as error:
            raise self._no_realisation("is not a realisation that PROJ knows") from error
        if not found.is_geographic:
            # A map's easting would go on as a longitude.
            raise self._no_realisation(f"is '{found.name}', no datum of positions")
        return found

    def _no_realisation(self, what: str) -> CrsError:
        return CrsError(
            f"'{self.name}' {what}; write e.g. NAD83(2011), ITRF2020, WGS 84 (G2139) or unknown",
            field="datum",
        )

    @property
    def moves(self) -> bool:
        """Whether coordinates of fixed places change by cm a year, so that an epoch is needed."""
        frame = self.geographic_3d().datum
        return frame is not None and "dynamic" in frame.type_name.lower()

    def __str__(self) -> str:
        """As it is written in project.toml."""
        return self.name if self.epoch is None else f"{self.name}@{self.epoch}"


@functools.lru_cache(maxsize=32)
def _realisation(name: str) -> CRS:
    """Geographic 3D CRS of a name; PROJ takes 20 ms to find one."""
    return CRS.from_user_input(_ITRF_OF.get(name.lower(), name)).to_3d()


def epoch_between(first: Datum, second: Datum) -> float:
    """Decimal year at which coordinates of one known realisation become those of the other.

    It is that of the one that moves, whichever end it stands at: coordinates of NAD83(2011) hold
    for a plate, and 2010.0 is the epoch of its definition.

    Raises
    ------
    CrsError
        If that epoch is not stated, or both move and lie years apart.
    """
    moving = [datum for datum in (first, second) if datum.moves]
    epochs = [datum.epoch for datum in moving if datum.epoch is not None]
    if moving and not epochs and first.name != second.name:
        name = moving[0].name
        raise CrsError(
            f"'{first}' and '{second}' move against each other: state the epoch of {name}, "
            f"e.g. {name}@2026.4",
            field="datum",
        )
    if len(epochs) == 2 and abs(epochs[0] - epochs[1]) > _AT_ONCE:
        raise CrsError(
            f"between '{first}' and '{second}' a place moves by cm a year, and by how much is not "
            "known here: bring both to one epoch, or to NAD83(2011)",
            field="datum",
        )
    return epochs[0] if epochs else first.epoch or second.epoch or 2010.0


def realisation_of(crs: CRS) -> Datum:
    """Datum that a CRS's own name states; unknown for an ensemble such as WGS 84."""
    base = crs.geodetic_crs
    if base is None or base.datum is None or "ensemble" in base.datum.type_name.lower():
        return Datum()
    try:
        _realisation(base.name)
    except _PyprojCrsError:
        # A WKT with a datum of its own name: not a realisation that anything can be told of.
        return Datum()
    return Datum() if is_nameless(base) else Datum(name=base.name)


def is_nameless(geographic: CRS) -> bool:
    """Whether a datum is one of its own name on an ellipsoid of the shape of WGS 84 and GRS 80.

    PROJ knows no way to it; its latitudes and longitudes are taken as those of WGS 84,
    `UNKNOWN_DATUM_SIGMA` apart. County systems of Minnesota have such: NAD83, its ellipsoid grown
    to the level of the county, on which the same latitude and longitude are projected.
    """
    ellipsoid = geographic.ellipsoid
    if ellipsoid is None or geographic.to_json_dict().get("id", {}).get("authority") == "EPSG":
        return False
    grown = abs(ellipsoid.semi_major_metre - WGS84_A)
    shape = abs((ellipsoid.inverse_flattening or 0.0) - 1.0 / WGS84_F)
    if grown > _MOST_GROWN or shape > 1e-4:
        return False
    return not TransformerGroup(
        CRS.from_epsg(4979).to_2d(), geographic, always_xy=True, allow_ballpark=False
    ).transformers


class Transformation:
    """Best transformation between two CRSs, by a PROJ object of each thread's own.

    Those of a `TransformerGroup` keep one PROJ context, which two threads must not use at once.
    """

    def __init__(self, source: CRS, target: CRS, site: Site | None) -> None:
        self._ends = (source, target, site)
        self._local = threading.local()
        self.accuracy = float(self.own.accuracy)

    def __reduce__(self) -> tuple[Any, ...]:
        """Only the ends: another process has PROJ objects of its own."""
        return transformer_between, self._ends

    @property
    def own(self) -> Transformer:
        """PROJ object of this thread."""
        found: Transformer | None = getattr(self._local, "transformer", None)
        if found is None:
            found = self._local.transformer = _best_transformer(*self._ends)
        return found

    def transform(self, *coordinates: Array, direction: str = "FORWARD") -> Any:
        """Transformed coordinates; a place that has none is inf."""
        transform: Callable[..., Any] = self.own.transform
        return transform(*coordinates, direction=direction)


@dataclass(frozen=True, slots=True, kw_only=True)
class Site:
    """Where a transformation is for, deg, and how much accuracy may lack for want of a grid, m."""

    lat: float
    lon: float
    slack: float

    @property
    def area(self) -> AreaOfInterest:
        """Its surroundings."""
        lon = (self.lon + 180.0) % 360.0 - 180.0
        return AreaOfInterest(lon - 0.05, self.lat - 0.05, lon + 0.05, self.lat + 0.05)


@functools.lru_cache(maxsize=32)
def transformer_between(source: CRS, target: CRS, site: Site | None = None) -> Transformation:
    """Best transformation from one CRS to another, made once.

    Parameters
    ----------
    site
        Of what is in use around it the best is taken, and a grid that would better it by more
        than the slack is missed. Without it, the best of any place that is installed.

    Raises
    ------
    CrsError
        If a grid is missing; with its name.
    """
    return Transformation(source, target, site)


made_with_grids(transformer_between.cache_clear)


def _best_transformer(source: CRS, target: CRS, site: Site | None) -> Transformer:
    group = _group(source, target, site)
    if site is not None and not (group.transformers or group.unavailable_operations):
        # The site lies outside of what either system is made for.
        group, site = _group(source, target, None), None
    if not group.transformers:
        lacking = [grids for op in group.unavailable_operations if (grids := _missing(op))]
        raise _not_installed(source, target, lacking[0] if lacking else ())
    if site is None:
        # in PROJ's own order: by the area
        return group.transformers[0]
    best = min(group.transformers, key=lambda t: t.accuracy if t.accuracy >= 0.0 else math.inf)
    grids = _better(group, site.slack)
    if grids:
        raise _not_installed(source, target, grids, best.accuracy)
    return best


def lacking_grids(source: CRS, target: CRS, site: Site) -> tuple[str, ...]:
    """Grids that would better what is installed from one CRS to another by more than the slack."""
    return _better(_group(source, target, site), site.slack)


def _better(group: TransformerGroup, slack: float) -> tuple[str, ...]:
    """Grids of an operation that lacks some and would better all others by more than the slack.

    Of several that of the smallest area: Canada's box holds half of the United States.
    """
    reach = min((t.accuracy for t in group.transformers if t.accuracy >= 0.0), default=math.inf)
    better = [op for op in group.unavailable_operations if 0.0 <= op.accuracy < reach - slack]
    chosen = min(filter(_missing, better), key=_extent, default=None)
    return () if chosen is None else _missing(chosen)


def _extent(operation: Any) -> float:
    """Size of the box that an operation is for, square degrees."""
    area = operation.area_of_use
    if area is None:
        return math.inf
    return float((area.north - area.south) * ((area.east - area.west) % 360.0))


def _group(source: CRS, target: CRS, site: Site | None) -> TransformerGroup:
    with warnings.catch_warnings():
        # "Best transformation is not available": it is looked after here.
        warnings.simplefilter("ignore", UserWarning)
        try:
            return TransformerGroup(
                source, target, always_xy=True, allow_ballpark=False,
                area_of_interest=None if site is None else site.area,  # type: ignore[arg-type]
            )  # fmt: skip
        except IndexError as error:
            # pyproj's word for none at all between two frames that move.
            raise _not_installed(source, target, ()) from error


def _missing(operation: Any) -> tuple[str, ...]:
    """Names of the grids that an operation needs and that are not there."""
    return tuple(grid.short_name for grid in operation.grids if not grid.available)


def _not_installed(
    source: CRS, target: CRS, grids: Sequence[str], accuracy: float | None = None
) -> CrsError:
    ends = f"from '{source.name}' to '{target.name}'"
    if not grids:
        return CrsError(f"no transformation {ends} is known to PROJ", field="crs")
    if accuracy is None:
        what = f"no transformation {ends} is installed"
    else:
        known = f"{accuracy:g} m" if accuracy >= 0.0 else "an unknown accuracy"
        what = f"the transformation {ends} that is installed is good to {known} only"
    need = f"the PROJ grid {grids[0]}" if len(grids) == 1 else f"{len(grids)} PROJ grids"
    return CrsError(f"{what}; it needs {need}: {how_to_get(*grids)}", field="crs")
