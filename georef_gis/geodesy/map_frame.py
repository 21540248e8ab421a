"""Between the project's topocentric frame and the map."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike
from pyproj import CRS

from georef_gis.ellipsoid import Origin
from georef_gis.errors import CrsError, GeometryError
from georef_gis.frames import Array, R_ecef_from_enu
from georef_gis.geodesy.geoids import geoid_undulation
from georef_gis.geodesy.ground_systems import ground_factor
from georef_gis.geodesy.map_systems import check_area, outside_area
from georef_gis.geodesy.reference_systems import (
    UNKNOWN_DATUM_SIGMA,
    Datum,
    Site,
    Transformation,
    epoch_between,
    horizontal_crs,
    is_nameless,
    metres_per_unit,
    realisation_of,
    transformer_between,
)
from georef_gis.geodesy.vertical import VerticalPart, vertical_part

# m; what a transformation between stated realisations, and one to the map of an old datum, may
# lack for want of a grid. What is lacking below either is in the sigma of the datum.
_FINE, _COARSE = 0.25, 5.0
# of length; what a factor for a road of some relief may be off at one of its places
_GROUND_OFF = 5e-5


class MapFrame:
    """Between the project's enu and a projected CRS, datums and heights included.

    Parameters
    ----------
    origin
        Origin of the project's enu, in the datum of the GNSS positions.
    crs
        Projected CRS, or compound with a vertical part: that of `vertical`, which does not touch
        `p_map`, whose heights are ellipsoidal, m.
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
        self.crs_datum = crs_datum or realisation_of(self.horizontal)
        geographic = self.horizontal.geodetic_crs
        if geographic is None:
            raise CrsError(f"'{crs.name}' has no geographic base", field="crs")
        self._datum_step = self._make_datum_step()
        # With the datum step done (or void) only the projection is left; without it PROJ joins
        # the ensembles (a null step for NAD83 and WGS 84, a shift for e.g. NAD27 or OSGB36).
        source = geographic if self._datum_step else CRS.from_epsg(4979).to_2d()
        if not self._datum_step and is_nameless(geographic):
            source = geographic
        self._project = transformer_between(source, self.horizontal, self._site(_COARSE))

    def _make_datum_step(self) -> Transformation | None:
        a, b = self.gnss_datum, self.crs_datum
        if not (a.is_known and b.is_known):
            return None
        source, target = a.geographic_3d(), b.geographic_3d()
        try:
            step = transformer_between(source, target, self._site(_FINE))
        except CrsError as error:
            raise CrsError(
                f"{error}; or, if its coordinates are {a.name} under an older name, say so by "
                f'datum_output = "{a}" in [project], of control by datum in [control]'
            ) from error
        self._epoch = epoch_between(a, b)
        return step

    def _site(self, slack: float) -> Site:
        # Rounded, so that frames of one site share their transformations.
        lat, lon = (round(math.degrees(v), 1) for v in (self.origin.lat, self.origin.lon))
        return Site(lat=lat, lon=lon, slack=slack)

    @property
    def datum_sigma(self) -> float:
        """One sigma of what an unstated datum or a coarse transformation may hide, m."""
        if self._datum_step is not None:
            accuracy = self._datum_step.accuracy
            if accuracy < 0.0:
                return UNKNOWN_DATUM_SIGMA
            return accuracy if accuracy > _FINE else 0.0
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
            t = np.full_like(x, self._epoch)
            x, y, h, _ = self._datum_step.transform(x, y, h, t)
        e, n = self._project.transform(x, y)
        return np.stack([e, n, h], axis=-1)

    def geo_from_map(self, p_map: ArrayLike) -> Array:
        """(lat, lon rad, ellipsoidal height m) in the GNSS datum from map; shape (..., 3)."""
        p = np.asarray(p_map, dtype=np.float64)
        x, y = self._project.transform(p[..., 0], p[..., 1], direction="INVERSE")
        h = p[..., 2]
        if self._datum_step:
            t = np.full_like(h, self._epoch)
            x, y, h, _ = self._datum_step.transform(x, y, h, t, direction="INVERSE")
        # PROJ says inf where a place has no coordinates.
        geo = np.stack([np.radians(y), np.radians(x), h], axis=-1)
        return np.where(np.isfinite(geo), geo, np.nan)

    def enu_from_map(self, p_map: ArrayLike) -> Array:
        """Enu m from (easting, northing in CRS units, ellipsoidal height m); shape (..., 3)."""
        return self.origin.enu_from_geo(self.geo_from_map(p_map))

    @property
    def vertical(self) -> VerticalPart | None:
        """Heights that the CRS promises; None if it is a map alone."""
        return vertical_part(self.crs)

    def check_inside(self, p_enu: ArrayLike) -> None:
        """Refuse places where the CRS does not hold, or whose heights it cannot give.

        Raises
        ------
        CrsError
            If the CRS is made for another part of the Earth, the projection gives no finite
            coordinates or more than 1 % of scale, or the geoid of its heights is not installed.
        """
        p = self.map_from_enu(p_enu)
        first = np.asarray(p_enu, float).reshape(-1, 3)[0]
        lat, lon, _ = self.origin.geo_from_enu(first)
        check_area(self.crs, lat, lon)
        scale = self.scale_at(first)
        if not np.all(np.isfinite(p)) or abs(scale - 1.0) > 0.01:
            raise CrsError(
                f"'{self.crs.name}' does not fit the photos' place (scale {scale:.4f}); "
                'use crs = "auto" or the zone of the site',
                field="crs",
            )
        if self.vertical is not None:
            geoid_undulation(lat, lon, geoid=self.vertical.geoid)

    def doubts(self) -> list[str]:
        """What is odd about the map at the site, one line each."""
        name, o = self.crs.name, self.origin
        out = []
        away = outside_area(self.crs, o.lat, o.lon)
        if away > 0.0:
            out.append(
                f"crs: the photos lie {away * 111.0:.0f} km outside of the area that '{name}' is "
                "made for; is it the zone of the site?"
            )
        factor = ground_factor(self.horizontal)
        if factor is not None:
            off = self.scale_at(np.zeros(3)) - 1.0
            if abs(off) > _GROUND_OFF:
                out.append(
                    f"crs: lengths of '{name}' are {off * 1e6:+.0f} ppm off those on the ground "
                    f"at the site; a factor of {factor / (1.0 + off):.7f} would not be: is it "
                    "ground over grid, and for this site?"
                )
        geographic = self.horizontal.geodetic_crs
        known = self.crs_datum.is_known
        if not known and geographic is not None and is_nameless(geographic):
            out.append(
                f"crs: the datum '{geographic.name}' of '{name}' is not known to this PROJ: taken "
                f"as that of the positions, {self.datum_sigma:g} m apart (one sigma)"
            )
        return out

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
