"""Coordinate reference systems, datum realisations, and the transformations between them."""

from __future__ import annotations

import functools
import math
import threading
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from pyproj import CRS, Transformer
from pyproj.exceptions import CRSError as _PyprojCrsError
from pyproj.transformer import TransformerGroup

from georef_gis.ellipsoid import WGS84_A
from georef_gis.errors import CrsError
from georef_gis.frames import Array

# m, one sigma; what is at stake when a position's datum realisation or epoch is unknown
UNKNOWN_DATUM_SIGMA = 2.0


def parse_crs(text: str) -> CRS:
    """CRS from 'EPSG:6602', 'EPSG:6527+6360', WKT or PROJ text.

    Raises
    ------
    CrsError
        If PROJ does not know it.
    """
    try:
        return CRS.from_user_input(text.strip())
    except _PyprojCrsError as error:
        raise CrsError(
            f"'{text[:60]}' is not a CRS that PROJ knows; give EPSG:code, "
            "EPSG:horizontal+vertical or WKT",
            field="crs",
        ) from error


def same_crs(first_wkt: str, second_wkt: str) -> bool:
    """Whether two CRSs differ in nothing but the order of axes, which rasters ignore."""
    first, second = CRS.from_wkt(first_wkt), CRS.from_wkt(second_wkt)
    return bool(first.equals(second, ignore_axis_order=True))


def map_crs(text: str) -> CRS:
    """Like `parse_crs`, for a projected CRS to draw a map in (compound allowed).

    Raises
    ------
    CrsError
        If the CRS is not projected: degrees are no unit for pixels.
    """
    crs = parse_crs(text)
    if not crs.is_projected:
        raise CrsError(
            f"'{crs.name}' is not a projected CRS; use 'auto' (UTM) or e.g. a State Plane code",
            field="crs",
        )
    return crs


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
        """Geographic 3D CRS of the realisation."""
        try:
            return CRS.from_user_input(self.name).to_3d()
        except _PyprojCrsError as error:
            raise CrsError(
                f"'{self.name}' is not a realisation that PROJ knows; write e.g. NAD83(2011), "
                "ITRF2020, WGS 84 (G2139) or unknown",
                field="datum",
            ) from error

    def __str__(self) -> str:
        """As it is written in project.toml."""
        return self.name if self.epoch is None else f"{self.name}@{self.epoch}"


def realisation_of(crs: CRS) -> Datum:
    """Datum that a CRS's own name states; unknown for an ensemble such as WGS 84."""
    base = crs.geodetic_crs
    if base is None or base.datum is None or "ensemble" in base.datum.type_name.lower():
        return Datum()
    try:
        CRS.from_user_input(base.name)
    except _PyprojCrsError:
        # A WKT with a datum of its own name: not a realisation that anything can be told of.
        return Datum()
    return Datum(name=base.name)


def is_nameless(geographic: CRS) -> bool:
    """Whether a WKT's datum is one of its own on the ellipsoid of WGS 84 or GRS 80.

    PROJ knows no way to it; it is taken as WGS 84, `UNKNOWN_DATUM_SIGMA` apart.
    """
    ellipsoid = geographic.ellipsoid
    if ellipsoid is None or abs(ellipsoid.semi_major_metre - WGS84_A) > 0.5:
        return False
    return not TransformerGroup(
        CRS.from_epsg(4979).to_2d(), geographic, always_xy=True, allow_ballpark=False
    ).transformers


class Transformation:
    """Best transformation between two CRSs, by a PROJ object of each thread's own.

    Those of a `TransformerGroup` keep one PROJ context, which two threads must not use at once.
    """

    def __init__(self, source: CRS, target: CRS) -> None:
        self._ends = (source, target)
        self._local = threading.local()
        self.accuracy = float(self.own.accuracy)

    def __reduce__(self) -> tuple[Any, ...]:
        """Only the two ends: another process has PROJ objects of its own."""
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


@functools.lru_cache(maxsize=32)
def transformer_between(source: CRS, target: CRS) -> Transformation:
    """Best transformation from one CRS to another, made once."""
    return Transformation(source, target)


def _best_transformer(source: CRS, target: CRS) -> Transformer:
    with warnings.catch_warnings():
        # "Best transformation is not available": its accuracy is kept and reported instead.
        warnings.simplefilter("ignore", UserWarning)
        group = TransformerGroup(source, target, always_xy=True, allow_ballpark=False)
    if not group.transformers:
        grids = [g.short_name for op in group.unavailable_operations for g in op.grids]
        need = f"; it needs the PROJ grid {', '.join(grids[:3])}" if grids else ""
        raise CrsError(
            f"no transformation from '{source.name}' to '{target.name}' is installed{need}",
            field="crs",
        )
    return group.transformers[0]
