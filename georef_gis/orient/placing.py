"""Blocks of other programs on the Earth, by what they say or by the photos' tags."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from georef_gis.errors import CrsError, GeometryError, InputError
from georef_gis.frames import Array
from georef_gis.geodesy import HeightKind, Origin
from georef_gis.model.interchange.block import Block
from georef_gis.model.interchange.poses import by_photo
from georef_gis.model.photo import Geotag, Photo
from georef_gis.model.pose import Mount
from georef_gis.orient.dialects import R_enu_from_cam_of_tag, dialect
from georef_gis.orient.level import Level, mean_level
from georef_gis.orient.similarity import SimilarityFit, estimate_similarity

# m, one sigma of positions that state none: see `direct.SIGMA_GNSS`; heights are twice as bad
SIGMA_H = 2.2
SIGMA_V = 5.0
# rad, one sigma of the mean view axis as the vertical, where no attitude is known
SIGMA_LEVEL_ASSUMED = math.radians(10.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlacedBlock:
    """A block in enu, and how it was placed; `fit` is None where it had a place already."""

    block: Block
    fit: SimilarityFit | None = None
    doubts: tuple[str, ...] = ()


def place_block(block: Block, photos: Sequence[Photo]) -> PlacedBlock:
    """A block of another program on the Earth: as it says itself, else by the photos' tags.

    Parameters
    ----------
    block
        With `positions` of a file beside it these are used, else the photos' geotags.
    photos
        As they were read; their attitudes tell the level.

    Raises
    ------
    InputError
        If the positions do not tell where it lies.
    """
    if block.origin is not None:
        return PlacedBlock(block=block)
    tagged = by_photo([shot.name for shot in block.shots], [photo.path.name for photo in photos])
    of_shot = {name: photos[i] for name, i in tagged.items()}
    tags = {name: photo.geotag for name, photo in of_shot.items() if photo.geotag is not None}
    tags |= block.positions
    names = [shot.name for shot in block.shots]
    found = [tags.get(name) for name in names]
    known = [tag for tag in found if tag is not None]
    if len(known) < 3:
        raise InputError(
            f"has no place on the Earth, and {len(known)} of its {len(names)} shots have a GPS "
            "position; three are needed. Give geo.txt beside it, or photos with positions",
            source=block.source,
        )
    heights, kind = _heights(found)
    ground = float(np.nanmedian(heights)) if np.any(np.isfinite(heights)) else 0.0
    lon0 = known[0].lon
    middle = np.median([[t.lat, math.remainder(t.lon - lon0, 2 * math.pi)] for t in known], axis=0)
    origin = Origin(
        lat=float(middle[0]),
        lon=math.remainder(float(middle[1]) + lon0, 2 * math.pi),
        height_ellipsoidal=ground,
    )
    level, assumed = _level(block, of_shot, tags, origin)
    try:
        fit = estimate_similarity(
            block.centres,
            _positions(found, heights, origin),
            sigma_h=np.array([_sigma(tag, "sigma_h", SIGMA_H) for tag in found]),
            sigma_v=np.array([_sigma(tag, "sigma_v", SIGMA_V) for tag in found]),
            level=level,
        )
    except GeometryError as error:
        raise InputError(str(error), source=block.source) from error
    fit = _with_shared_error(fit, known)
    placed = block.placed(fit.similarity, origin, kind)
    doubts = [*assumed, *fit.doubts]
    left = len(known) - int(np.count_nonzero(fit.inliers))
    if left:
        doubts.append(f"{left} of {len(known)} positions are off and were not used")
    return PlacedBlock(block=placed, fit=fit, doubts=tuple(doubts))


def _sigma(tag: Geotag | None, name: str, default: float) -> float:
    return float((getattr(tag, name) if tag else None) or default)


def _with_shared_error(fit: SimilarityFit, tags: Sequence[Geotag]) -> SimilarityFit:
    """Fit with the error that all positions of a flight share, which does not average out."""
    h = float(np.median([_sigma(tag, "sigma_h", SIGMA_H) for tag in tags]))
    v = float(np.median([_sigma(tag, "sigma_v", SIGMA_V) for tag in tags]))
    covariance = fit.similarity.covariance.copy()
    covariance[4:, 4:] += np.diag([h * h, h * h, v * v])
    return replace(fit, similarity=replace(fit.similarity, covariance=covariance))


def _heights(tags: Sequence[Geotag | None]) -> tuple[Array, HeightKind]:
    """Heights of one kind, m, NaN where there is none: ellipsoidal if any can be told as such."""
    sure, plain = np.full(len(tags), np.nan), np.full(len(tags), np.nan)
    for i, tag in enumerate(tags):
        if tag is None or tag.height is None:
            continue
        try:
            sure[i] = tag.height.ellipsoidal(tag.lat, tag.lon)
        except CrsError:
            if tag.height.kind is HeightKind.UNKNOWN:
                plain[i] = tag.height.value
    if np.count_nonzero(np.isfinite(sure)) >= np.count_nonzero(np.isfinite(plain)):
        return sure, HeightKind.ELLIPSOIDAL
    return plain, HeightKind.UNKNOWN


def _positions(tags: Sequence[Geotag | None], heights: Array, origin: Origin) -> Array:
    out = np.full((len(tags), 3), np.nan)
    for i, tag in enumerate(tags):
        if tag is not None:
            known = bool(np.isfinite(heights[i]))
            h = heights[i] if known else origin.height_ellipsoidal
            out[i] = origin.enu_from_geo([tag.lat, tag.lon, h])
            if not known:
                out[i, 2] = np.nan
    return out


def _level(
    block: Block, of_shot: Mapping[str, Photo], tags: Mapping[str, Geotag], origin: Origin
) -> tuple[Level | None, tuple[str, ...]]:
    """The vertical by the attitudes; without any, the mean view axis taken as looking down."""
    up = np.full((len(block.shots), 3), np.nan)
    sigma = np.ones(len(block.shots))
    for i, shot in enumerate(block.shots):
        photo = of_shot.get(shot.name)
        if photo is None or photo.attitude is None:
            continue
        at = tags.get(shot.name)
        R_enu_cam = R_enu_from_cam_of_tag(
            photo.attitude,
            # The vertical in camera axes does not depend on the heading.
            yaw=photo.attitude.yaw or 0.0,
            origin=origin,
            vehicle_lat=at.lat if at else origin.lat,
            vehicle_lon=at.lon if at else origin.lon,
            mount=Mount(),
        )
        up[i] = shot.R_world_from_cam @ R_enu_cam[2]
        entry = dialect(photo.attitude.dialect)
        sigma[i] = photo.attitude.sigma_roll_pitch or entry.sigma_roll_pitch
    level = mean_level(up, sigma)
    if level is not None:
        return level, ()
    view = np.array([shot.R_world_from_cam[:, 2] for shot in block.shots])
    down = view.mean(axis=0)
    if np.linalg.norm(down) < 0.5:
        return None, ()
    up_from = -down / np.linalg.norm(down)
    doubt = "no photo has an attitude: the block is laid as if its photos looked down on the whole"
    return Level(up_from=up_from, sigma=SIGMA_LEVEL_ASSUMED), (doubt,)
