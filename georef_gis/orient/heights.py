"""Where the ground lies under the cameras, from what the tags and the user say."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from georef_gis.errors import CrsError, InputError
from georef_gis.frames import Array
from georef_gis.geodesy import Height, HeightKind, Origin, geoid_undulation
from georef_gis.model.photo import Photo
from georef_gis.model.terrain import FlatTerrain, Terrain

# m, one sigma: a barometric height above take-off, and the ground's distance from that level
SIGMA_RELATIVE_HEIGHT = 1.0
SIGMA_FLAT_GROUND = 1.5
# m, one sigma of a consumer receiver's height
SIGMA_GNSS_HEIGHT = 5.0
# m, one sigma where nothing tells how high the ground lies: any land
SIGMA_NO_LEVEL = 1000.0
# m, and share of it: one sigma of a usual height above ground that the user states
SIGMA_STATED, SHARE_STATED = 2.0, 0.05
# m; tags that give their height above take-off as the absolute one, too, are equal to this
SAME_HEIGHT = 0.06
# m; a logged and a computed height above ground further apart than this are doubtful
HEIGHT_CONFLICT = 15.0
# What a camera's height above the ellipsoid rests on where it is no tag's of stated kind.
OVER_GROUND = "height of the ground and height above take-off"
NO_LEVEL = "none: only the height above take-off or ground is known"
NO_LEVEL_DOUBT = (
    "nothing tells how high the ground lies: heights above sea level and the ellipsoid are not to "
    "be used: set [ground] height_m or dem"
)


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

    `sigma` is that of the camera above the ground, m: it scales every distance. `sigma_shared`,
    m, is that of a shift of cameras and ground together; 0 over ground of known height. `kinds`
    says in words what each camera's height above the ellipsoid rests on.
    """

    cameras: Mapping[str, float]
    sigma: Mapping[str, float]
    terrain: Terrain
    source: str
    sigma_shared: float = 0.0
    kinds: Mapping[str, str] = field(default_factory=dict)
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
    sigma_v: float | None = None,
) -> Heights:
    """Heights of the cameras above one ground.

    In this order: the user's usual height above ground, about which the tags tell how the photos
    differ; a DEM or ground height with the tags' own
    heights; a DEM or ground height with the heights above take-off; the heights above take-off
    alone, over flat ground at take-off level.

    Parameters
    ----------
    kind, sigma_v
        The user's word on the tags' heights, and their sigma, m; go before the tags' own.

    Raises
    ------
    InputError
        If nothing tells how high the cameras flew.
    """
    tags = _Tags(photos=photos, origin=origin, kind=kind, geoid=geoid, sigma_v=sigma_v)
    if ground.height_above_ground is not None:
        return _from_user_height(tags, ground, ground.height_above_ground)
    if ground.dem is not None or ground.height is not None:
        return _over_known_ground(tags, ground)
    if any(v is not None for v in tags.relative.values()):
        return _over_take_off(tags)
    raise InputError(
        "the photos state no height above take-off or ground; set height_above_ground_m, "
        "height_m or dem",
        source="project.toml",
        field="[ground]",
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Level:
    """An ellipsoidal height that cameras and ground share, m; what it rests on, in words."""

    height: float
    sigma: float
    kind: str
    doubts: tuple[str, ...] = ()


class _Tags:
    """What the tags say of heights: `absolute` above the ellipsoid, `relative` to the ground, m."""

    def __init__(
        self,
        *,
        photos: Sequence[Photo],
        origin: Origin,
        kind: HeightKind | None,
        geoid: str,
        sigma_v: float | None,
    ) -> None:
        self.photos, self.origin = photos, origin
        self.kind, self.geoid, self.sigma_v = kind, geoid, sigma_v
        self.absolute = {p.id: tag_height(p, kind, geoid) for p in photos}
        self.relative = {p.id: relative_height(p, kind) for p in photos}

    def kind_of(self, photo: Photo) -> HeightKind | None:
        """Kind of a tag's height; None where there is none."""
        height = photo.geotag.height if photo.geotag is not None else None
        return None if height is None else self.kind or height.kind

    def words(self, photo: Photo) -> str:
        """Kind of a tag's height for people."""
        kind = self.kind_of(photo)
        return f"orthometric ({self.geoid})" if kind is HeightKind.ORTHOMETRIC else str(kind)

    def sigma(self, photo: Photo) -> float:
        """One sigma of a tag's height, m."""
        tag = photo.geotag
        return self.sigma_v or (tag.sigma_v if tag is not None else None) or SIGMA_GNSS_HEIGHT

    def level(self, below: Mapping[str, float]) -> _Level:
        """Ellipsoidal height of the level that lies `below` (photo -> m) the cameras.

        A height of unknown kind is taken as EXIF defines GPSAltitude, above sea level; if it is
        ellipsoidal instead, all is the geoid's height off, half of which goes into the sigma.
        """
        known = [p for p in self.photos if self.absolute[p.id] is not None and p.id in below]
        if known:
            heights = [float(self.absolute[p.id] or 0.0) - below[p.id] for p in known]
            kinds = " and ".join(sorted({self.words(p) for p in known}))
            sigma = float(np.median([self.sigma(p) for p in known]))
            return _Level(height=float(np.median(heights)), sigma=sigma, kind=kinds)
        raw = self.of_unknown_kind()
        pairs = [h - below[key] for key, h in raw.items() if key in below]
        if not raw:
            return _Level(height=0.0, sigma=SIGMA_NO_LEVEL, kind=NO_LEVEL, doubts=(NO_LEVEL_DOUBT,))
        level = float(np.median(pairs)) if pairs else _median(raw) - _median(below)
        return self._unknown(level)

    def of_unknown_kind(self) -> dict[str, float]:
        """Heights of tags of unknown kind by photo, m; none where they repeat the relative ones."""
        raw = {p.id: h for p in self.photos if (h := self._raw(p)) is not None}
        return {} if self._repeats(raw) else raw

    def _raw(self, photo: Photo) -> float | None:
        """Height of a tag of unknown kind, m, that may be an absolute one."""
        if photo.geotag is None or photo.geotag.height is None:
            return None
        return photo.geotag.height.value if self.kind_of(photo) is HeightKind.UNKNOWN else None

    def _repeats(self, raw: Mapping[str, float]) -> bool:
        """Whether the heights are those above take-off once more, as some cameras write them."""
        both = [h - r for key, h in raw.items() if (r := self.relative[key]) is not None]
        return bool(both) and max(map(abs, both)) < SAME_HEIGHT

    def _unknown(self, level: float) -> _Level:
        n = float(geoid_undulation(self.origin.lat, self.origin.lon, geoid=self.geoid))
        sigma = float(np.hypot(np.median([self.sigma(p) for p in self.photos]), n / 2))
        doubt = (
            "the tags do not state the kind of their heights: taken as above sea level, as EXIF "
            f"means them, to {sigma:.0f} m (one sigma); heights above the ground are not touched "
            "by that: set [gnss] height_kind"
        )
        return _Level(height=level + n, sigma=sigma, kind=unknown_kind(self.geoid), doubts=(doubt,))


def unknown_kind(geoid: str) -> str:
    """How heights of no stated kind are taken, in words."""
    return f"unknown, taken as orthometric ({geoid})"


def _median(values: Mapping[str, float]) -> float:
    return float(np.median(list(values.values())))


def relative_height(photo: Photo, kind: HeightKind | None) -> float | None:
    """Height of a photo above the ground or take-off by its tags, m; `kind` as in `tag_height`."""
    height = photo.geotag.height if photo.geotag is not None else None
    if height is not None and (kind or height.kind) is HeightKind.ABOVE_GROUND:
        return height.value
    if photo.height_above_ground is not None:
        return photo.height_above_ground
    return photo.height_above_takeoff


def _from_user_height(tags: _Tags, ground: GroundSetting, agl: float) -> Heights:
    """Heights about the usual one that the user states: the tags tell how each photo differs.

    What the receiver's errors have in common cancels between the photos and the ground that is
    laid below them, and is in `sigma_shared`; the rest is in `sigma`, for each photo.
    """
    level = tags.level(dict.fromkeys((p.id for p in tags.photos), agl))
    stated = max(SIGMA_STATED, SHARE_STATED * agl)
    over = _About(tags=tags, usual=level.height + agl, sigma=stated)
    own = list(over.receiver.values())
    rest = level.sigma**2 - (float(np.median(own)) ** 2 if own else 0.0)
    doubts = level.doubts
    if ground.dem is not None:
        doubts = (*doubts, "[ground] dem is not used: height_above_ground_m goes before it")
    sigma = ground.sigma if ground.sigma is not None else stated
    return Heights(
        cameras=over.cameras,
        sigma=over.sigmas,
        terrain=FlatTerrain(origin=tags.origin, height_ellipsoidal=level.height, sigma=sigma),
        source=f"height above ground {agl:.1f} m given by the user, usual of the flight",
        sigma_shared=math.sqrt(max(rest, 0.0)),
        kinds=dict.fromkeys(over.cameras, level.kind),
        doubts=doubts,
        photo_doubts=over.odd(agl),
    )


class _About:
    """Cameras about one usual height, m above the ellipsoid; each with its sigma, m.

    A photo differs from the usual height as its height above take-off does from their median,
    else as its own height does; one that has neither flies at it. `receiver` holds the sigmas of
    those whose own height counts.
    """

    def __init__(self, *, tags: _Tags, usual: float, sigma: float) -> None:
        self.usual = usual
        self.cameras: dict[str, float] = {}
        self.sigmas: dict[str, float] = {}
        self.receiver: dict[str, float] = {}
        relative = {key: r for key, r in tags.relative.items() if r is not None}
        raw = tags.of_unknown_kind()
        own = {p.id for p in tags.photos if tags.absolute[p.id] is not None or p.id in raw}
        own -= set(relative)
        for p in tags.photos:
            h = tags.absolute[p.id]
            if p.id in relative:
                self.cameras[p.id] = usual + relative[p.id] - _median(relative)
                self.sigmas[p.id] = SIGMA_RELATIVE_HEIGHT
            elif p.id in own:
                self.cameras[p.id] = h if h is not None else usual + raw[p.id] - _median(raw)
                self.sigmas[p.id] = _about_mean(tags.sigma(p), len(own))
                self.receiver[p.id] = self.sigmas[p.id]
            else:
                self.cameras[p.id] = usual
                self.sigmas[p.id] = _about_mean(sigma, len(tags.photos))

    def odd(self, agl: float) -> dict[str, str]:
        """What is doubtful of photos far from the usual height above the ground."""
        most = max(HEIGHT_CONFLICT, agl / 2.0)
        return {
            key: f"height above the ground is {agl + h - self.usual:.0f} m by its tag, where "
            f"[ground] height_above_ground_m says {agl:.0f} m: check the tag"
            for key, h in self.cameras.items()
            if abs(h - self.usual) > most
        }


def _about_mean(sigma: float, n: int) -> float:
    """One sigma, m, of the difference of one of `n` heights from their mean; never nought."""
    return max(sigma * math.sqrt(1.0 - 1.0 / n), min(sigma, SIGMA_RELATIVE_HEIGHT))


def _over_known_ground(tags: _Tags, ground: GroundSetting) -> Heights:
    terrain = ground.dem or _flat_from_height(tags.origin, ground)
    below = _ground_below(tags.photos, tags.origin, terrain)
    level = float(np.nanmedian(list(below.values()))) if below else float("nan")
    if not np.isfinite(level):
        raise InputError(
            "the DEM has no height under the photos; check its CRS and extent",
            source="project.toml",
            field="[ground] dem",
        )
    cameras, sigma, kinds, odd, doubts = {}, {}, {}, {}, []
    for p in tags.photos:
        h, rel = tags.absolute[p.id], tags.relative[p.id]
        if h is not None:
            cameras[p.id], kinds[p.id] = h, tags.words(p)
            sigma[p.id] = tags.sigma(p)
            agl = h - below.get(p.id, level)
            if rel is not None and abs(agl - rel) > HEIGHT_CONFLICT:
                odd[p.id] = (
                    f"height above the ground is {agl:.0f} m by the tag's height and "
                    f"{rel:.0f} m by its height above take-off: check [gnss] height_kind"
                )
        elif rel is not None:
            cameras[p.id], kinds[p.id] = level + rel, OVER_GROUND
            sigma[p.id] = float(np.hypot(SIGMA_RELATIVE_HEIGHT, SIGMA_FLAT_GROUND))
    if not cameras:
        raise InputError(
            "the kind of the photos' heights is not known; set height_kind to ellipsoidal or "
            "orthometric",
            source="project.toml",
            field="[gnss] height_kind",
        )
    if any(h is None for h in tags.absolute.values()):
        doubts.append("some heights come from the height above take-off: take-off at ground level")
    if ground.dem is not None and ground.height is not None:
        doubts.append("[ground] height_m is not used: dem goes before it")
    return Heights(
        cameras=cameras,
        sigma=sigma,
        terrain=terrain,
        source="heights of the tags above the given ground",
        kinds=kinds,
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


def _over_take_off(tags: _Tags) -> Heights:
    above = {key: r for key, r in tags.relative.items() if r is not None}
    take_off = tags.level(above)
    cameras, sigma = {}, {}
    for p in tags.photos:
        h, r = tags.absolute[p.id], tags.relative[p.id]
        if r is not None:
            # A barometer is smoother over a flight than a receiver's height.
            cameras[p.id], sigma[p.id] = take_off.height + r, SIGMA_RELATIVE_HEIGHT
        elif h is not None:
            cameras[p.id], sigma[p.id] = h, tags.sigma(p)
    own = ", its own height of unknown kind" if take_off.doubts else ""
    return Heights(
        cameras=cameras,
        sigma=sigma,
        terrain=FlatTerrain(
            origin=tags.origin, height_ellipsoidal=take_off.height, sigma=SIGMA_FLAT_GROUND
        ),
        source=f"heights above take-off; ground taken as flat at take-off level{own}",
        sigma_shared=take_off.sigma,
        kinds=dict.fromkeys(cameras, take_off.kind),
        doubts=take_off.doubts,
    )


def heights_above_ground(origins_enu: Array, terrain: Terrain) -> Array:
    """Height of projection centres above the ground beneath; shape (n, 3) m -> (n,) m."""
    return np.asarray(origins_enu[:, 2] - terrain.z_at(origins_enu[:, :2]))
