"""A site as a block of cameras, shots and points, as programs of photogrammetry take it."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from georef_gis.errors import ExportError, InputError
from georef_gis.frames import Array
from georef_gis.geodesy import HeightKind
from georef_gis.model.camera import Camera
from georef_gis.model.interchange.block import (
    TOLERANCE_PX,
    Block,
    BlockPoints,
    Shot,
    losses,
    own_facts,
)
from georef_gis.units import utc_from_gps

if TYPE_CHECKING:
    from exports.site.site import SiteLayers, SitePhoto
    from georef_gis.model.pose import Pose
    from georef_gis.model.tie_points import GroundPoints, TiePoints

# px; a skew that moves pixels by more is not left out but refused
MOST_SKEW = 2.0
# of the longer side of a photo; points further off their pixels do not belong to the poses
WORST_FIT = 0.01
# What a calibration holds beside its model and its size.
_VALUES = (
    "fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4", "p1", "p2", "b1", "b2", "readout_s",
)  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SiteBlock:
    """A site's block as one program can hold it, and what it cannot.

    Parameters
    ----------
    block
        Cameras without what the format lacks.
    facts
        Frame, covariances and the whole of the cameras, for JSON.
    warnings
        What was left out.
    """

    block: Block
    facts: Mapping[str, Any]
    warnings: tuple[str, ...]


def site_block(
    site: SiteLayers,
    program: str,
    *,
    ties: TiePoints | None = None,
    points: GroundPoints | None = None,
) -> SiteBlock:
    """A site's photos that have a pose, as a block in the project's enu.

    Parameters
    ----------
    program
        Name of the one that is written for.
    ties, points
        Of an adjustment, if there is one.

    Raises
    ------
    ExportError
        If no photo has a pose, or a photo's camera is not known.
    """
    posed = [one for one in site.photos if one.pose is not None]
    if not posed:
        raise ExportError("no photo has a pose yet; run `georef run` first")
    names = shot_names(posed)
    known = {camera.id: camera for camera in site.cameras}
    whole: dict[str, Camera] = {}
    shots = []
    for one, name in zip(posed, names, strict=True):
        camera = stored_camera(one, known)
        whole.setdefault(camera.id, camera)
        shots.append(_shot(site, one, name, camera.id))
    bases = {one.camera_id: known[one.camera_id] for one in posed}
    told = [line for camera in bases.values() for line in _left_out(camera, program)]
    block = Block(
        cameras={key: _without_small_skew(camera) for key, camera in whole.items()},
        shots=tuple(shots),
        origin=site.frame.origin,
        height_kind=HeightKind.ELLIPSOIDAL,
        datum=str(site.frame.gnss_datum),
        source=site.name,
    )
    if ties is not None and points is not None:
        # Poses from elsewhere were not adjusted with the points.
        by_id = {
            one.photo.id: name
            for one, name in zip(posed, names, strict=True)
            if _pose_of(one).kind == "adjusted"
        }
        block, more = _with_points(block, ties, points, by_id)
        told += more
    return SiteBlock(
        block=block,
        facts={**own_facts(block), "cameras": {k: _values(c) for k, c in whole.items()}},
        warnings=tuple(told),
    )


def shot_names(posed: Sequence[SitePhoto]) -> list[str]:
    """File names of photos; with their folders where two have the same."""
    paths = [one.photo.path for one in posed]
    names = [path.name for path in paths]
    if len({name.casefold() for name in names}) < len(names):
        base = os.path.commonpath([path.parent for path in paths])
        names = [path.relative_to(base).as_posix() for path in paths]
    return names


def _shot(site: SiteLayers, one: SitePhoto, name: str, camera_id: str) -> Shot:
    pose, time = _pose_of(one), one.photo.time_gps
    return Shot(
        name=name,
        camera_id=camera_id,
        origin=pose.origin_enu,
        R_world_from_cam=pose.R_enu_from_cam,
        covariance=_absolute(pose),
        time_unix=None if time is None else utc_from_gps(site.epoch_gps + time).timestamp(),
    )


def _pose_of(one: SitePhoto) -> Pose:
    if one.pose is None:
        raise ExportError(f"{one.photo.id}: has no pose")
    return one.pose


def _absolute(pose: Pose) -> Array:
    """Covariance with the height above the ellipsoid in place of that above the ground."""
    out = pose.covariance.copy()
    out[2, 2] += pose.sigma_height_shared**2
    return out


# -- cameras -----------------------------------------------------------------------------------


def stored_camera(one: SitePhoto, known: Mapping[str, Camera]) -> Camera:
    """Camera of the stored pixels, which are what other programs see.

    Raises
    ------
    ExportError
        If the camera is not known, or cannot be turned.
    """
    camera = known.get(one.camera_id)
    if camera is None:
        raise ExportError(f"{one.photo.id}: its camera {one.camera_id!r} is not known")
    if not one.turned_deg:
        return camera
    try:
        # a skew stands in the way of a quarter turn
        whole = _without_small_skew(camera) if one.turned_deg % 180 else camera
        return replace(whole.turned(one.turned_deg), id=f"{camera.id} turned {one.turned_deg}")
    except InputError as error:
        raise ExportError(str(error)) from error


def _skewed(camera: Camera) -> bool:
    return TOLERANCE_PX < _skew_px(camera) <= MOST_SKEW


def _skew_px(camera: Camera) -> float:
    """By how much the skew moves a pixel at most, px."""
    rows = np.array([-0.5 - camera.cy, camera.height - 0.5 - camera.cy]) / camera.fy
    return abs(camera.b2) * float(np.max(np.abs(rows)))


def _without_small_skew(camera: Camera) -> Camera:
    """Camera whose skew, if it is one that may be left out, is left out."""
    return replace(camera, b2=0.0) if _skewed(camera) else camera


def _left_out(camera: Camera, program: str) -> tuple[str, ...]:
    """What the program's file leaves out of a camera, in words."""
    more = f", up to {_skew_px(camera):.2f} px in the photo" if _skewed(camera) else ""
    return tuple(f"{line}{more if 'b2' in line else ''}" for line in losses(camera, program))


def _values(camera: Camera) -> dict[str, Any]:
    """The whole of a camera, for JSON."""
    size = {"width": camera.width, "height": camera.height}
    values = {name: getattr(camera, name) for name in _VALUES}
    return {"model": camera.model, **size, **values, "poly": list(camera.poly)}


# -- points ------------------------------------------------------------------------------------


def _with_points(
    block: Block, ties: TiePoints, points: GroundPoints, names: Mapping[str, str]
) -> tuple[Block, list[str]]:
    """Block with the adjusted points that its photos see, and what is to be said of them.

    Raises
    ------
    ExportError
        If ties and points do not tell of the same points.
    """
    if ties.n_points != len(points):
        raise ExportError(
            f"the tie points are of {ties.n_points} points and the adjustment of {len(points)}; "
            "adjust again"
        )
    inside = np.array([photo_id in names for photo_id in ties.photo_ids], dtype=np.bool_)
    seen = inside[ties.photo] if len(ties.photo) else np.zeros(0, dtype=np.bool_)
    kept = np.bincount(ties.point[seen], minlength=len(points)) >= 2
    renamed = replace(
        ties.selected(seen),
        photo_ids=tuple(names.get(photo_id, photo_id) for photo_id in ties.photo_ids),
    )
    p = points.p_enu[kept]
    if not len(p):
        return block, []
    error = _errors(block, renamed, p)
    worst = WORST_FIT * max(max(c.width, c.height) for c in block.cameras.values())
    if not float(np.median(error)) < worst:
        return block, [
            f"the tie points are left out: they lie {np.median(error):.0f} px off the poses, "
            "which are of another adjustment; run `georef adjust --force`"
        ]
    mean = np.bincount(renamed.point, weights=error) / np.bincount(renamed.point)
    return replace(block, points=BlockPoints(p=p, error_px=mean, ties=renamed)), []


def _errors(block: Block, ties: TiePoints, p: Array) -> Array:
    """Distances of the pixels from where the block as it is written shows the points, px; (m,)."""
    shots = {shot.name: shot for shot in block.shots}
    out = np.full(len(ties.photo), np.inf)
    for i in np.unique(ties.photo):
        mine = ties.photo == i
        shot = shots[ties.photo_ids[i]]
        p_cam = (p[ties.point[mine]] - shot.origin) @ shot.R_world_from_cam
        uv = block.cameras[shot.camera_id].project(p_cam)
        off = np.hypot(*(uv - ties.uv[mine]).T)
        out[mine] = np.where(np.isfinite(off), off, np.inf)
    return out
