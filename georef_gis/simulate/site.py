"""The work zone: origin, terrain, road coordinates, control points and what stands there."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from georef_gis.simulate import ellipsoid

Array = NDArray[np.float64]
AnyFloat = NDArray[np.floating[Any]]

# Near Jackson's Mill, West Virginia, where the report's aircraft flew.
ORIGIN_LAT = math.radians(39.0975)
ORIGIN_LON = math.radians(-80.467)
# m; EGM96 (15' posts, bilinear) at the origin, and its slope per rad: a plane over the site
GEOID_HEIGHT = -33.3854
GEOID_SLOPE_LAT = math.degrees(-1.4128)
GEOID_SLOPE_LON = math.degrees(2.0632)
ORIGIN_HEIGHT = 311.0 + GEOID_HEIGHT  # m, ellipsoidal
ROAD_AZIMUTH = math.radians(68.0)  # from true north, clockwise
ROAD_RADIUS = 1600.0  # m; the road bends left
LANE = 3.6  # m
HALF_PAVED = 4.9  # m; lane and paved shoulder

OUTPUT_CRS = "EPSG:6601"  # NAD83(2011) / West Virginia North (ftUS)
DEM_CRS = "EPSG:32617"
DATUM = "NAD83(2011)@2010.0"


def ecef_from_enu(p_enu: Array) -> Array:
    """ECEF of points in the site's topocentric frame, shape (..., 3), m."""
    origin = ellipsoid.ecef_from_geodetic(
        np.asarray(ORIGIN_LAT), np.asarray(ORIGIN_LON), np.asarray(ORIGIN_HEIGHT)
    )
    return np.asarray(origin + p_enu @ rotation_ecef_from_site_enu().T)


def enu_from_ecef(p_ecef: Array) -> Array:
    """Points in the site's topocentric frame from ECEF, shape (..., 3), m."""
    origin = ecef_from_enu(np.zeros(3))
    return np.asarray((p_ecef - origin) @ rotation_ecef_from_site_enu())


def rotation_ecef_from_site_enu() -> Array:
    """Columns east, north, up of the site's origin in ECEF."""
    return ellipsoid.rotation_ecef_from_enu(np.asarray(ORIGIN_LAT), np.asarray(ORIGIN_LON))


def geoid_height(lat: Array, lon: Array) -> Array:
    """EGM96 geoid height over the site, m; lat, lon in rad."""
    return np.asarray(
        GEOID_HEIGHT + GEOID_SLOPE_LAT * (lat - ORIGIN_LAT) + GEOID_SLOPE_LON * (lon - ORIGIN_LON)
    )


def road_from_enu(e: AnyFloat, n: AnyFloat) -> tuple[Array, Array]:
    """Metres along the road and left of it, of east and north (first order in the bend)."""
    sa, ca = math.sin(ROAD_AZIMUTH), math.cos(ROAD_AZIMUTH)
    along = e * sa + n * ca
    left = -e * ca + n * sa
    return np.asarray(along), np.asarray(left - along**2 / (2.0 * ROAD_RADIUS))


def enu_from_road(along: Array, left: Array) -> Array:
    """East, north and the terrain's up of road coordinates, shape (..., 3), m."""
    sa, ca = math.sin(ROAD_AZIMUTH), math.cos(ROAD_AZIMUTH)
    along, left = np.broadcast_arrays(np.asarray(along, float), np.asarray(left, float))
    straight = left + along**2 / (2.0 * ROAD_RADIUS)
    e, n = along * sa - straight * ca, along * ca + straight * sa
    return np.stack([e, n, terrain_up(e, n)], axis=-1)


def terrain_up(e: AnyFloat, n: AnyFloat) -> Array:
    """Bare ground over the origin's tangent plane, m, of east and north, m."""
    along, left = road_from_enu(e, n)
    grade = 0.018 * along + 0.9 * np.sin(along / 75.0)
    side = np.clip((np.abs(left) - 7.0) / 38.0, 0.0, 1.0)
    blend = side * side * (3.0 - 2.0 * side)
    hills = (
        1.6 * np.sin(e / 47.0 + 0.7) * np.cos(n / 61.0 - 0.4)
        + 1.1 * np.sin((e + n) / 33.0)
        + 0.030 * left
        + 0.25 * np.sin(e / 9.0) * np.sin(n / 11.0)
    )
    crown = -0.02 * np.minimum(np.abs(left), HALF_PAVED)
    ditch = -0.45 * np.exp(-(((np.abs(left) - 8.5) / 1.6) ** 2))
    return np.asarray(grade + crown + ditch + blend * hills)


def ground_height(lat: Array, lon: Array) -> Array:
    """Ellipsoidal height of bare ground, m, of latitude and longitude, rad."""
    h = np.full(np.shape(lat), ORIGIN_HEIGHT)
    for _ in range(4):
        p = enu_from_ecef(ellipsoid.ecef_from_geodetic(lat, lon, h))
        h = h + terrain_up(p[..., 0], p[..., 1]) - p[..., 2]
    return h


def intersect_ground(origin_enu: Array, d_enu: Array) -> Array:
    """First meeting of downward rays with the ground, shape (..., 3), m.

    Notes
    -----
    Newton on the height over ground with the slope along the ray by a difference quotient; the
    ground's slopes are far below the rays'.
    """
    t = (origin_enu[2]) / -d_enu[..., 2]
    for _ in range(12):
        p = origin_enu + t[..., None] * d_enu
        gap = p[..., 2] - terrain_up(p[..., 0], p[..., 1])
        q = p + 0.05 * d_enu
        rate = (q[..., 2] - terrain_up(q[..., 0], q[..., 1]) - gap) / 0.05
        t = t - gap / rate
    return np.asarray(origin_enu + t[..., None] * d_enu)


@dataclass(frozen=True, slots=True, kw_only=True)
class ControlPoint:
    """A painted target on the ground, in road coordinates, m."""

    name: str
    along: float
    left: float
    role: str

    @property
    def enu(self) -> Array:
        """Position in the site's frame, shape (3,), m."""
        return enu_from_road(np.asarray(self.along), np.asarray(self.left))


@dataclass(frozen=True, slots=True, kw_only=True)
class SiteObject:
    """A thing that stands on the ground, in road coordinates.

    Parameters
    ----------
    kind, name
        Class and number.
    along, left
        Middle of its base, m.
    turn_deg
        Counter-clockwise from the road's direction.
    length, width, height
        m.
    """

    name: str
    kind: str
    along: float
    left: float
    turn_deg: float
    length: float
    width: float
    height: float
    colour: tuple[int, int, int] = (128, 128, 128)

    @property
    def enu(self) -> Array:
        """Middle of the base in the site's frame, shape (3,), m."""
        return enu_from_road(np.asarray(self.along), np.asarray(self.left))

    def corners(self, height: float, shrink: float = 1.0, shift: float = 0.0) -> Array:
        """Four corners at a height over the base, counter-clockwise, shape (4, 3), m.

        `shrink` scales the outline, `shift` moves it along the object's own length, m.
        """
        turn = math.radians(self.turn_deg) + math.pi / 2 - ROAD_AZIMUTH
        turn += self.along / ROAD_RADIUS
        x = np.array([1.0, 1.0, -1.0, -1.0]) * self.length / 2 * shrink + shift
        y = np.array([-1.0, 1.0, 1.0, -1.0]) * self.width / 2 * shrink
        c, s = math.cos(turn), math.sin(turn)
        offset = np.stack([x * c - y * s, x * s + y * c, np.full(4, height)], axis=-1)
        return np.asarray(self.enu + offset)


def control_points() -> tuple[ControlPoint, ...]:
    """Twelve targets, every second one a check point."""
    places = (
        (-44, 24), (-40, -29), (-22, 6.4), (-8, -6.2), (-16, 38), (2, -33), (16, 13.5), (23, -17),
        (31, 34), (44, -6.3), (48, -30), (50, 17),
    )  # fmt: skip
    return tuple(
        ControlPoint(name=f"P{i:02d}", along=a, left=b, role="check" if i % 2 == 0 else "control")
        for i, (a, b) in enumerate(places, start=1)
    )


ORANGE, WHITE, YELLOW, RED = (228, 98, 32), (232, 232, 226), (222, 176, 40), (150, 36, 34)


def _channelizers() -> list[SiteObject]:
    cones = [
        ("cone", f"C{i + 1:02d}", -52.0 + 3.0 * i, -4.3 + 4.05 * i / 12, 0.36, 0.71)
        for i in range(13)
    ]
    drums = [("drum", f"D{i + 1:02d}", -10.0 + 6.0 * i, -0.28, 0.58, 0.95) for i in range(11)]
    return [
        SiteObject(
            name=name, kind=kind, along=a, left=b, turn_deg=0, length=d, width=d, height=h,
            colour=ORANGE,
        )
        for kind, name, a, b, d, h in cones + drums
    ]  # fmt: skip


def _vehicles() -> list[SiteObject]:
    rows = (
        ("V1", "roller", 12.5, -2.3, 4.0, 4.6, 1.7, 2.4, YELLOW),
        ("V2", "truck", 33.0, -2.2, 2.0, 8.2, 2.5, 3.1, (196, 84, 34)),
        ("V3", "pickup", -3.5, -2.4, -3.0, 5.6, 1.95, 1.75, WHITE),
        ("V4", "car", -30.0, 1.9, 180.0, 4.6, 1.8, 1.45, (46, 68, 120)),
        ("V5", "car", 22.0, 1.8, 180.0, 4.7, 1.8, 1.5, RED),
        ("V6", "car", 58.0, 1.7, 180.0, 4.4, 1.75, 1.5, (168, 172, 176)),
        ("V7", "car", -18.0, 19.5, 96.0, 4.5, 1.8, 1.5, (40, 42, 46)),
        ("V8", "car", -68.0, -1.9, 0.0, 4.7, 1.8, 1.5, (210, 208, 200)),
    )
    return [
        SiteObject(
            name=name, kind=kind, along=a, left=b, turn_deg=turn, length=x, width=y, height=z,
            colour=colour,
        )
        for name, kind, a, b, turn, x, y, z, colour in rows
    ]  # fmt: skip


def objects() -> tuple[SiteObject, ...]:
    """Everything that stands on the site."""
    still = [
        ("S1", "sign", -75.0, -6.6, 0.15, 1.2, 2.7, ORANGE),
        ("S2", "sign", -58.0, -6.5, 0.15, 1.2, 2.7, ORANGE),
        ("S3", "arrow_board", -8.5, -2.6, 0.6, 2.4, 3.4, (60, 58, 52)),
        ("S4", "sign", 66.0, 6.6, 0.15, 1.2, 2.7, ORANGE),
        ("B1", "building", -5.0, 27.0, 16.0, 10.0, 4.6, (176, 160, 140)),
        ("B2", "building", 12.5, 32.5, 6.0, 5.0, 2.8, (150, 152, 156)),
    ]
    return (
        *_channelizers(),
        *_vehicles(),
        *(
            SiteObject(
                name=name, kind=kind, along=a, left=b, turn_deg=8.0 if kind == "building" else 0.0,
                length=x, width=y, height=z, colour=colour,
            )
            for name, kind, a, b, x, y, z, colour in still
        ),
        *_trees(),
    )  # fmt: skip


def _trees() -> list[SiteObject]:
    rng = np.random.default_rng(20090620)
    out: list[SiteObject] = []
    for i in range(26):
        side = 1.0 if i % 2 else -1.0
        along, left = rng.uniform(-130, 130), side * rng.uniform(48, 95)
        width = rng.uniform(4.0, 9.0)
        shade = int(rng.integers(-12, 12))
        out.append(
            SiteObject(
                name=f"T{i + 1:02d}", kind="tree", along=along, left=left, turn_deg=0.0,
                length=width, width=width, height=width * rng.uniform(0.9, 1.3),
                colour=(62 + shade, 84 + shade, 44 + shade // 2),
            )
        )  # fmt: skip
    return out
