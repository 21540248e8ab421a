"""Where the ground lies under the cameras, from what the tags and the user say."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from georef_gis.errors import CrsError, InputError
from georef_gis.frames import Array
from georef_gis.geodesy import Height, HeightKind, Origin
from georef_gis.model.photo import Photo
from georef_gis.model.terrain import FlatTerrain, Terrain

# m, one sigma: a barometric height above take-off, and the ground's distance from that level
SIGMA_RELATIVE_HEIGHT = 1.0
SIGMA_FLAT_GROUND = 1.5
# m, one sigma of a consumer receiver's height
SIGMA_GNSS_HEIGHT = 5.0
# m; a logged and a computed height above ground further apart than this are doubtful
HEIGHT_CONFLICT = 15.0


@dataclass(frozen=True, slots=True, kw_only=True)
class GroundSetting:
    """What the user says about the ground; at most one of the heights, m."""

    height: Height | None = None
    height_above_ground: float | None = None
    dem: Terrain | None = None
    sigma: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Heights:
    """Ellipsoidal height of each camera, m, with its sigma, and the ground beneath.

    `sigma_relative` is that of the camera above the ground, m: it scales every distance.
    """

    cameras: Mapping[str, float]
    sigma: Mapping[str, float]
    terrain: Terrain
    source: str
    doubts: tuple[str, ...] = ()
    photo_doubts: Mapping[str, str] = field(default_factory=dict)


def tag_height(photo: Photo, kind: HeightKind | None, geoid: str = "egm96") -> float | None:
    """Ellipsoidal height of a photo's tag, m, or None where its kind is not known.

    `kind` is the user's word and goes before the tag's.
    """
    tag = photo.geotag
    if tag is None or tag.height is None:
        return None
    # Tags never name their geoid: the project's holds for all.
    height = Height(value=tag.height.value, kind=kind or tag.height.kind, geoid=geoid)
    try:
        return height.ellipsoidal(tag.lat, tag.lon)
    except CrsError:
        return None


def solve_heights(
    photos: Sequence[Photo],
    origin: Origin,
    ground: GroundSetting,
    *,
    kind: HeightKind | None = None,
    geoid: str = "egm96",
) -> Heights:
    """Heights of the cameras above one ground.

    In this order: the user's height above ground; a DEM or ground height with the tags' own
    heights; a DEM or ground height with the heights above take-off; the heights above take-off
    alone, over flat ground at take-off level.

    Raises
    ------
    InputError
        If nothing tells how high the cameras flew.
    """
    absolute = {p.id: tag_height(p, kind, geoid) for p in photos}
    relative = {p.id: _relative(p, kind) for p in photos}
    if ground.height_above_ground is not None:
        return _from_user_height(photos, origin, ground, absolute)
    if ground.dem is not None or ground.height is not None:
        return _over_known_ground(photos, origin, ground, absolute, relative)
    if any(v is not None for v in relative.values()):
        return _over_take_off(photos, origin, absolute, relative)
    raise InputError(
        "the photos state no height above take-off or ground; set height_above_ground_m, "
        "height_m or dem",
        source="project.toml",
        field="[ground]",
    )


def _relative(photo: Photo, kind: HeightKind | None) -> float | None:
    height = photo.geotag.height if photo.geotag is not None else None
    if height is not None and (kind or height.kind) is HeightKind.ABOVE_GROUND:
        return height.value
    if photo.height_above_ground is not None:
        return photo.height_above_ground
    return photo.height_above_takeoff


def _from_user_height(
    photos: Sequence[Photo],
    origin: Origin,
    ground: GroundSetting,
    absolute: Mapping[str, float | None],
) -> Heights:
    agl = float(ground.height_above_ground or 0.0)
    known = [h for h in absolute.values() if h is not None]
    level = float(np.median(known)) if known else _raw_level(photos)
    h_ground = level - agl
    # The heights of one flight spread less than a GNSS height errs: keep the flight's own shape.
    cameras = {p.id: (h if (h := absolute[p.id]) is not None else level) for p in photos}
    sigma = ground.sigma if ground.sigma is not None else 0.05 * agl
    return Heights(
        cameras=cameras,
        sigma={p.id: SIGMA_RELATIVE_HEIGHT for p in photos},
        terrain=FlatTerrain(origin=origin, height_ellipsoidal=h_ground, sigma=sigma),
        source=f"height above ground {agl:.1f} m given by the user",
    )


def _raw_level(photos: Sequence[Photo]) -> float:
    values = [p.geotag.height.value for p in photos if p.geotag and p.geotag.height]
    return float(np.median(values)) if values else 0.0


def _over_known_ground(
    photos: Sequence[Photo],
    origin: Origin,
    ground: GroundSetting,
    absolute: Mapping[str, float | None],
    relative: Mapping[str, float | None],
) -> Heights:
    terrain = ground.dem or _flat_from_height(origin, ground)
    below = _ground_below(photos, origin, terrain)
    level = float(np.nanmedian(list(below.values()))) if below else float("nan")
    if not np.isfinite(level):
        raise InputError(
            "the DEM has no height under the photos; check its CRS and extent",
            source="project.toml",
            field="[ground] dem",
        )
    cameras, sigma, odd, doubts = {}, {}, {}, []
    for p in photos:
        h, rel = absolute[p.id], relative[p.id]
        if h is not None:
            cameras[p.id] = h
            sigma[p.id] = _tag_sigma(p)
            agl = h - below.get(p.id, level)
            if rel is not None and abs(agl - rel) > HEIGHT_CONFLICT:
                odd[p.id] = (
                    f"height above the ground is {agl:.0f} m by the tag's height and "
                    f"{rel:.0f} m by its height above take-off: check [gnss] height_kind"
                )
        elif rel is not None:
            cameras[p.id] = level + rel
            sigma[p.id] = float(np.hypot(SIGMA_RELATIVE_HEIGHT, SIGMA_FLAT_GROUND))
    if not cameras:
        raise InputError(
            "the kind of the photos' heights is not known; set height_kind to ellipsoidal or "
            "orthometric",
            source="project.toml",
            field="[gnss] height_kind",
        )
    if any(absolute[p.id] is None for p in photos):
        doubts.append("some heights come from the height above take-off: take-off at ground level")
    return Heights(
        cameras=cameras,
        sigma=sigma,
        terrain=terrain,
        source="heights of the tags above the given ground",
        doubts=tuple(doubts),
        photo_doubts=odd,
    )


def _flat_from_height(origin: Origin, ground: GroundSetting) -> FlatTerrain:
    if ground.height is None:
        raise ValueError("neither DEM nor height")
    h = ground.height.ellipsoidal(origin.lat, origin.lon)
    sigma = ground.sigma if ground.sigma is not None else SIGMA_FLAT_GROUND
    return FlatTerrain(origin=origin, height_ellipsoidal=h, sigma=sigma)


def _ground_below(photos: Sequence[Photo], origin: Origin, terrain: Terrain) -> dict[str, float]:
    """Ellipsoidal height of the ground under each photo, m."""
    tags = [(p.id, p.geotag) for p in photos if p.geotag is not None]
    geo = np.array([[t.lat, t.lon, origin.height_ellipsoidal] for _, t in tags])
    xy = origin.enu_from_geo(geo)[:, :2]
    h = origin.geo_from_enu(np.c_[xy, terrain.z_at(xy)])[:, 2]
    return {key: float(v) for (key, _), v in zip(tags, h, strict=True) if np.isfinite(v)}


def _over_take_off(
    photos: Sequence[Photo],
    origin: Origin,
    absolute: Mapping[str, float | None],
    relative: Mapping[str, float | None],
) -> Heights:
    pairs = [(h, r) for k in relative if (h := absolute[k]) is not None
             and (r := relative[k]) is not None]  # fmt: skip
    if pairs:
        take_off = float(np.median([h - r for h, r in pairs]))
        source = "heights above take-off; ground taken as flat at take-off level"
    else:
        raw = _raw_level(photos)
        take_off = raw - float(np.median([r for r in relative.values() if r is not None]))
        source = (
            "heights above take-off; ground taken as flat at take-off level, its own height of "
            "unknown kind"
        )
    cameras, sigma = {}, {}
    for p in photos:
        h, r = absolute[p.id], relative[p.id]
        if r is not None:
            # A barometer is smoother over a flight than a receiver's height.
            cameras[p.id], sigma[p.id] = take_off + r, SIGMA_RELATIVE_HEIGHT
        elif h is not None:
            cameras[p.id], sigma[p.id] = h, _tag_sigma(p)
    return Heights(
        cameras=cameras,
        sigma=sigma,
        terrain=FlatTerrain(origin=origin, height_ellipsoidal=take_off, sigma=SIGMA_FLAT_GROUND),
        source=source,
    )


def _tag_sigma(photo: Photo) -> float:
    tag = photo.geotag
    return tag.sigma_v if tag is not None and tag.sigma_v else SIGMA_GNSS_HEIGHT


def heights_above_ground(origins_enu: Array, terrain: Terrain) -> Array:
    """Height of projection centres above the ground beneath; shape (n, 3) m -> (n,) m."""
    return np.asarray(origins_enu[:, 2] - terrain.z_at(origins_enu[:, :2]))
