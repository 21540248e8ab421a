"""Places on the Earth: ellipsoid, geoid, CRS, the project's origin (only importer of pyproj)."""

from __future__ import annotations

import functools
import lzma
import math
import threading
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from importlib import resources
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pyproj import CRS, Transformer
from pyproj.exceptions import CRSError as _PyprojCrsError
from pyproj.exceptions import ProjError
from pyproj.network import set_network_enabled  # type: ignore[attr-defined]
from pyproj.transformer import TransformerGroup

from georef_gis.ellipsoid import (
    WGS84_A,
    WGS84_E2,
    WGS84_F,
    Origin,
    ecef_from_geo,
    geo_from_ecef,
    meridian_radius,
    prime_vertical_radius,
)
from georef_gis.errors import CrsError, GeometryError
from georef_gis.frames import Array, R_ecef_from_enu

__all__ = [
    "CRS",
    "WGS84_A",
    "WGS84_E2",
    "WGS84_F",
    "Height",
    "HeightKind",
    "MapFrame",
    "Origin",
    "ecef_from_geo",
    "geo_from_ecef",
    "meridian_radius",
    "prime_vertical_radius",
]

# A silent download in the middle of a run would make results depend on the network.
set_network_enabled(False)

# m, one sigma; what is at stake when a position's datum realisation or epoch is unknown
UNKNOWN_DATUM_SIGMA = 2.0


class HeightKind(StrEnum):
    """What a height is measured from."""

    ELLIPSOIDAL = "ellipsoidal"
    ORTHOMETRIC = "orthometric"
    ABOVE_GROUND = "above_ground"
    UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True, kw_only=True)
class Height:
    """A height and what it is measured from, m."""

    value: float
    kind: HeightKind
    geoid: str = "egm96"

    def ellipsoidal(self, lat: float, lon: float) -> float:
        """Height above the WGS 84 ellipsoid at a place (rad), m.

        Raises
        ------
        CrsError
            If the kind cannot be turned into an ellipsoidal height.
        """
        if self.kind is HeightKind.ELLIPSOIDAL:
            return self.value
        if self.kind is HeightKind.ORTHOMETRIC:
            return self.value + float(geoid_undulation(lat, lon, geoid=self.geoid))
        raise CrsError(
            f"a height of {self.value:.2f} m of kind '{self.kind}' has no ellipsoidal value; "
            "state its kind (ellipsoidal or orthometric)",
            field="height",
        )


# ---------------------------------------------------------------------------------------------
# Geoid
# ---------------------------------------------------------------------------------------------


@functools.cache
def _egm96_cm() -> Array:
    """EGM96 undulation on its 15' grid from (-90, -180), cm; shape (721, 1441)."""
    raw = resources.files("georef_gis").joinpath("data/egm96_15.xz").read_bytes()
    d = np.frombuffer(lzma.decompress(raw), dtype="<i2").reshape(721, 1440).astype(np.int32)
    grid = np.cumsum(np.cumsum(d, axis=0), axis=1)
    return np.concatenate([grid, grid[:, :1]], axis=1).astype(np.float64)


def _egm96(lat: Array, lon: Array) -> Array:
    row = np.clip((np.degrees(lat) + 90.0) * 4.0, 0.0, 720.0)
    col = ((np.degrees(lon) + 180.0) % 360.0) * 4.0
    i = np.minimum(row.astype(int), 719)
    j = np.minimum(col.astype(int), 1439)
    v, u = row - i, col - j
    g = _egm96_cm()
    top = g[i, j] * (1 - u) + g[i, j + 1] * u
    bottom = g[i + 1, j] * (1 - u) + g[i + 1, j + 1] * u
    return np.asarray((top * (1 - v) + bottom * v) / 100.0)


# name -> (vertical CRS, its geographic 3D CRS); grids come with proj-data or `georef grids`
_PROJ_GEOIDS = {
    "geoid18": ("EPSG:5703", "EPSG:6319"),
    "egm2008": ("EPSG:3855", "EPSG:4979"),
    "cgvd2013": ("EPSG:6647", "EPSG:4955"),
}


def geoid_undulation(lat: ArrayLike, lon: ArrayLike, *, geoid: str = "egm96") -> Array:
    """Height of the geoid above the ellipsoid, m, at lat, lon in rad; shapes (...).

    Raises
    ------
    CrsError
        If the geoid is unknown or its grid is not installed: never a silent zero.
    """
    lat, lon = np.broadcast_arrays(np.asarray(lat, float), np.asarray(lon, float))
    if geoid == "egm96":
        return _egm96(lat, lon)
    if geoid not in _PROJ_GEOIDS:
        known = ", ".join(["egm96", *_PROJ_GEOIDS])
        raise CrsError(f"'{geoid}' is not known; use one of {known}", field="geoid")
    vertical, geographic = _PROJ_GEOIDS[geoid]
    horizontal = CRS(geographic).to_2d().to_authority()
    compound = f"{':'.join(horizontal or ())}+{vertical.split(':')[1]}"
    try:
        # allow_ballpark=False: otherwise PROJ hands the height back unchanged.
        t = Transformer.from_crs(compound, geographic, always_xy=True, allow_ballpark=False)
        h = t.transform(np.degrees(lon), np.degrees(lat), np.zeros_like(lat), errcheck=True)[2]
    except ProjError as error:
        raise CrsError(
            f"the grid of geoid '{geoid}' is not installed; add it (PROJ's proj-data) "
            'or use geoid = "egm96"',
            field="geoid",
        ) from error
    if not np.all(np.isfinite(h)):
        raise CrsError(f"'{geoid}' does not cover the place", field="geoid")
    return np.asarray(h, dtype=np.float64)


# ---------------------------------------------------------------------------------------------
# CRS and datum
# ---------------------------------------------------------------------------------------------


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


def _realisation_of(crs: CRS) -> Datum:
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


def _is_nameless(geographic: CRS) -> bool:
    """Whether a WKT's datum is one of its own on the ellipsoid of WGS 84 or GRS 80.

    PROJ knows no way to it; it is taken as WGS 84, `UNKNOWN_DATUM_SIGMA` apart.
    """
    ellipsoid = geographic.ellipsoid
    if ellipsoid is None or abs(ellipsoid.semi_major_metre - WGS84_A) > 0.5:
        return False
    return not TransformerGroup(
        CRS.from_epsg(4979).to_2d(), geographic, always_xy=True, allow_ballpark=False
    ).transformers


class _Transformation:
    """Best transformation between two CRSs, by a PROJ object of each thread's own.

    Those of a `TransformerGroup` keep one PROJ context, which two threads must not use at once.
    """

    def __init__(self, source: CRS, target: CRS) -> None:
        self._ends = (source, target)
        self._local = threading.local()
        self.accuracy = float(self.own.accuracy)

    def __reduce__(self) -> tuple[Any, ...]:
        """Only the two ends: another process has PROJ objects of its own."""
        return _transformer, self._ends

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
def _transformer(source: CRS, target: CRS) -> _Transformation:
    return _Transformation(source, target)


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


class MapFrame:
    """Between the project's enu and a projected CRS, datums and heights included.

    Parameters
    ----------
    origin
        Origin of the project's enu, in the datum of the GNSS positions.
    crs
        Projected CRS, or compound with a vertical part (which only labels: heights in `p_map` are
        ellipsoidal, m).
    gnss_datum, crs_datum
        Realisations. Where both are known and unequal, the positions are transformed with the
        epoch; where one is unknown the two are taken as one, `datum_sigma` apart.

    Raises
    ------
    CrsError
        If known realisations cannot be transformed into each other.
    """

    def __init__(
        self,
        origin: Origin,
        crs: CRS,
        *,
        gnss_datum: Datum | None = None,
        crs_datum: Datum | None = None,
    ) -> None:
        self.origin = origin
        self.crs = crs
        self.horizontal = horizontal_crs(crs)
        self.gnss_datum = gnss_datum or Datum()
        self.crs_datum = crs_datum or _realisation_of(self.horizontal)
        geographic = self.horizontal.geodetic_crs
        if geographic is None:
            raise CrsError(f"'{crs.name}' has no geographic base", field="crs")
        self._datum_step = self._make_datum_step()
        # With the datum step done (or void) only the projection is left; without it PROJ joins
        # the ensembles (a null step for NAD83 and WGS 84, a shift for e.g. NAD27 or OSGB36).
        source = geographic if self._datum_step else CRS.from_epsg(4979).to_2d()
        if not self._datum_step and _is_nameless(geographic):
            source = geographic
        self._project = _transformer(source, self.horizontal)

    def _make_datum_step(self) -> _Transformation | None:
        a, b = self.gnss_datum, self.crs_datum
        if not (a.is_known and b.is_known):
            return None
        source, target = a.geographic_3d(), b.geographic_3d()
        step = _transformer(source, target)
        if a.name != b.name and a.epoch is None:
            raise CrsError(
                f"'{a}' and '{b}' move against each other: state the epoch of the positions, "
                f"e.g. {a.name}@2026.4",
                field="gnss.datum",
            )
        return step

    @property
    def datum_sigma(self) -> float:
        """One sigma of what an unstated datum or a coarse transformation may hide, m."""
        if self.gnss_datum.is_known and self.crs_datum.is_known:
            return 0.0
        # PROJ gives -1 where the accuracy is not known.
        return max(UNKNOWN_DATUM_SIGMA, float(self._project.accuracy))

    def map_from_enu(self, p_enu: ArrayLike) -> Array:
        """(easting, northing in CRS units, ellipsoidal height m) of enu m; shape (..., 3)."""
        return self.map_from_geo(self.origin.geo_from_enu(p_enu))

    def map_from_geo(self, p_geo: ArrayLike) -> Array:
        """Like `map_from_enu`, from (lat, lon rad, ellipsoidal height m); shape (..., 3)."""
        geo = np.asarray(p_geo, dtype=np.float64)
        x, y, h = np.degrees(geo[..., 1]), np.degrees(geo[..., 0]), geo[..., 2]
        if self._datum_step:
            t = np.full_like(x, self.gnss_datum.epoch or self.crs_datum.epoch or 2010.0)
            x, y, h, _ = self._datum_step.transform(x, y, h, t)
        e, n = self._project.transform(x, y)
        return np.stack([e, n, h], axis=-1)

    def geo_from_map(self, p_map: ArrayLike) -> Array:
        """(lat, lon rad, ellipsoidal height m) in the GNSS datum from map; shape (..., 3)."""
        p = np.asarray(p_map, dtype=np.float64)
        x, y = self._project.transform(p[..., 0], p[..., 1], direction="INVERSE")
        h = p[..., 2]
        if self._datum_step:
            t = np.full_like(h, self.gnss_datum.epoch or self.crs_datum.epoch or 2010.0)
            x, y, h, _ = self._datum_step.transform(x, y, h, t, direction="INVERSE")
        # PROJ says inf where a place has no coordinates.
        geo = np.stack([np.radians(y), np.radians(x), h], axis=-1)
        return np.where(np.isfinite(geo), geo, np.nan)

    def enu_from_map(self, p_map: ArrayLike) -> Array:
        """Enu m from (easting, northing in CRS units, ellipsoidal height m); shape (..., 3)."""
        return self.origin.enu_from_geo(self.geo_from_map(p_map))

    def check_inside(self, p_enu: ArrayLike) -> None:
        """Refuse places where the CRS does not hold.

        Raises
        ------
        CrsError
            If the projection gives no finite coordinates or more than 1 % of scale.
        """
        p = self.map_from_enu(p_enu)
        scale = self.scale_at(np.asarray(p_enu, float).reshape(-1, 3)[0])
        if not np.all(np.isfinite(p)) or abs(scale - 1.0) > 0.01:
            raise CrsError(
                f"'{self.crs.name}' does not fit the photos' place (scale {scale:.4f}); "
                'use crs = "auto" or the zone of the site',
                field="crs",
            )

    def scale_at(self, p_enu: ArrayLike) -> float:
        """Map metres per metre at a place of enu (3,): 0.9996 on UTM's central meridian."""
        j = self._jacobian(np.asarray(p_enu, float))
        return float(math.sqrt(abs(np.linalg.det(j))) * metres_per_unit(self.horizontal))

    def convergence_at(self, p_enu: ArrayLike) -> float:
        """Meridian convergence at a place of enu (3,), rad: grid north east of true north > 0.

        From the axes that are level at the place itself; enu's own turn against them by
        the difference in longitude times the sine of the latitude.
        """
        j = self._jacobian(np.asarray(p_enu, float))
        return float(-math.atan2(j[0, 1], j[1, 1]))

    def _jacobian(self, p_enu: Array) -> Array:
        """Map units per m of east and north at the place itself; shape (2, 2)."""
        step = 10.0
        lat, lon, _ = self.origin.geo_from_enu(p_enu)
        R_enu_local = self.origin.R_ecef_from_enu.T @ R_ecef_from_enu(lat, lon)
        d = np.array([[step, 0, 0], [-step, 0, 0], [0, step, 0], [0, -step, 0]]) @ R_enu_local.T
        m = self.map_from_enu(p_enu + d)[:, :2]
        if not np.all(np.isfinite(m)):
            raise GeometryError(f"'{self.crs.name}' has no coordinates at the site")
        return np.stack([(m[0] - m[1]), (m[2] - m[3])], axis=1) / (2 * step)
