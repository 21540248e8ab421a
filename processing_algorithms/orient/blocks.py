"""A project's photos, tie points and control as a block, and an adjustment's answer as rows."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from georef_gis.errors import AdjustmentError, InputError
from georef_gis.frames import exp_so3
from georef_gis.model.camera import Camera
from georef_gis.model.control import ControlObservations
from georef_gis.model.photo import OrientedPhoto
from georef_gis.model.pose import Pose
from georef_gis.model.terrain import DemTerrain, Terrain
from georef_gis.model.tie_points import TiePoints
from georef_gis.model.tin import TinTerrain
from georef_gis.orient.adjustment.block import (
    CAMERA_NAMES,
    INDEPENDENT,
    Block,
    CameraPrior,
    ControlInput,
    GroundPrior,
)
from georef_gis.orient.adjustment.build import (
    R_turned_from_sensor,
    SensorViews,
    first_places,
    sensor_views,
)
from georef_gis.orient.adjustment.keep import load_ties
from georef_gis.orient.adjustment.priors import camera_prior
from georef_gis.project import Project
from georef_gis.project.records import camera_of
from processing_algorithms.orient.flight_priors import flight_priors
from processing_algorithms.orient.match import MATCHES, TIES
from processing_algorithms.site import Site

# of the height above ground: how far tie points may stand off a flat ground that nobody measured
RELIEF_SHARE = 0.08
LEAST_RELIEF = 2.0
# m, one sigma: no photo shares less of its height with the ground than a control point's
LEAST_LEVEL = 0.5
# of the height above ground; photos all within it were not flown, or their positions are none
ONE_PLACE = 0.02
# What matching says of headings, by photo.
Turns = Mapping[str, Mapping[str, Any]]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Prepared:
    """A block, first places of its points, and what leads back to the stored photos."""

    block: Block
    first: NDArray[np.float64]
    views: SensorViews
    turned: Mapping[str, int]
    control: ControlObservations | None
    # deg clockwise, by photo: pixels that matching found turned and that are taken so
    found_turned: Mapping[str, int]


def load_matches(project: Project) -> tuple[TiePoints, dict[str, Any]]:
    """Tie points and what else `match` left.

    Raises
    ------
    InputError
        If the files are missing or broken.
    """
    path = project.adjustment / MATCHES
    ties = load_ties(project.adjustment / TIES)
    try:
        return ties, json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(
            f"cannot be read ({error}); run `georef match --force`", source=str(path)
        ) from error


def prepare(
    project: Project,
    site: Site,
    *,
    calibrate: bool,
    control: ControlObservations | None = None,
    focal_share: float | None = None,
    wrong_headings: bool = False,
) -> Prepared:
    """Block of all photos of a site that have a pose.

    Parameters
    ----------
    focal_share
        One sigma of focal lengths that are free, as a share of them, in place of what is stated.
    wrong_headings
        Photos that matching found turned have wrong headings in their tags; else their pixels were
        turned after the exposure.

    Raises
    ------
    AdjustmentError
        If all photos have one position.
    """
    ties, matches = load_matches(project)
    ties = _of_photos(ties, tuple(site.photos))
    turns = matches.get("turns") or {}
    before = _turned_before(project, site)
    _check_places(site)
    pixels = _pixel_turns(project, site, turns, wrong_headings=wrong_headings)
    turned = {key: (before[key] + pixels[key]) % 360 for key in site.photos}
    views = _sensor_views(project, site, turns, pixels, turned)
    flights = flight_priors(project, site, views)
    moving = any(np.any(flight.velocity_enu) for flight in flights)
    block = Block(
        photo_ids=tuple(site.photos),
        poses=tuple(view.pose for view in views.photos),
        start=_start_poses(views, turns),
        camera_of=views.camera_of,
        cameras=tuple(
            _with_focal(_camera_prior(c, views, calibrate, moving), focal_share)
            for c in views.cameras
        ),
        flights=flights,
        ties=views.observations(ties),
        control=_control_input(control, views, tuple(site.photos)),
        sigma_level=_sigma_level(control, views),
    )
    first = first_places(block, site.terrain)
    return Prepared(
        block=replace(block, ground=_ground_prior(site.terrain, block, views, first)),
        first=first, views=views, turned=turned, control=control,
        found_turned={key: (turned[key] - before[key]) % 360 for key in turned},
    )  # fmt: skip


def _quarter_of(turns: Turns, key: str) -> int:
    """By how much matching found a photo turned against its pose, deg clockwise."""
    return int(turns.get(key, {}).get("quarter_deg") or 0)


def _pixel_turns(
    project: Project, site: Site, turns: Turns, *, wrong_headings: bool
) -> dict[str, int]:
    """How much of what matching found turned is taken for turned pixels, deg; by photo."""
    stated = set() if not wrong_headings else set(site.photos)
    # who says how pixels are turned leaves the heading to be wrong
    stated |= {Path(name).stem for name in project.settings.attitude.rotate_photos}
    return {key: 0 if key in stated else _quarter_of(turns, key) for key in site.photos}


def _sensor_views(
    project: Project,
    site: Site,
    turns: Turns,
    pixels: Mapping[str, int],
    turned: Mapping[str, int],
) -> SensorViews:
    """Photos as the sensors saw them, with what matching found turned put right."""
    cameras = {row["camera_id"]: camera_of(row) for row in project.database.rows("camera")}
    photos = [
        _turned_photo(oriented, _quarter_of(turns, key), pixels[key], cameras)
        for key, oriented in site.photos.items()
    ]
    return sensor_views(photos, cameras, turned)


def _start_poses(views: SensorViews, turns: Turns) -> tuple[Pose, ...]:
    """Poses to begin with: headings as matching found them where it is sure."""
    start = []
    for view in views.photos:
        turn = turns.get(view.id, {})
        R = view.pose.R_enu_from_cam
        if turn.get("correct"):
            # yaw is clockwise seen from above, a rotation vector counter-clockwise
            R = exp_so3([0.0, 0.0, -float(turn["yaw"])]) @ R
        start.append(replace(view.pose, R_enu_from_cam=R))
    return tuple(start)


def _sigma_level(control: ControlObservations | None, views: SensorViews) -> float:
    """One sigma, m, of what control may add to all heights; 0 without control."""
    if control is None or "control" not in control.role:
        return 0.0
    shared = max((p.pose.sigma_height_shared for p in views.photos), default=0.0)
    return max(shared, LEAST_LEVEL)


def _ground_prior(
    terrain: Terrain, block: Block, views: SensorViews, first: NDArray[np.float64]
) -> GroundPrior:
    """What is known of the heights of tie points; `first` are first places of all points, enu."""
    relief = _relief(views, first)
    sigma = math.hypot(terrain.sigma, relief)
    measured = isinstance(terrain, DemTerrain) and not isinstance(terrain, TinTerrain)
    return GroundPrior(
        z_enu=first[: block.ties.n_points, 2],
        # relief is alike in few places, the level of a ground that nobody measured in all
        sigma=sigma if measured else relief,
        sigma_offset=0.0 if measured else terrain.sigma,
        surface=terrain.z_at if measured else None,
        sigma_surface=terrain.sigma,
        # a height datum may be taken for another: heights of flight hold it as without the surface
        sigma_free=sigma / math.sqrt(INDEPENDENT),
        sigma_other=sigma,
    )


def _camera_prior(camera: Camera, views: SensorViews, calibrate: bool, moving: bool) -> CameraPrior:
    """Prior of a camera; a skew cannot be told in pictures that lie on their side."""
    prior = camera_prior(camera, calibrate=calibrate, moving=moving)
    if camera.id in views.held:
        return replace(prior, sigma=np.zeros_like(prior.sigma))
    if any(degrees % 180 for degrees in views.turned_deg):
        prior = replace(prior, sigma=np.where(np.array(CAMERA_NAMES) == "b2", 0.0, prior.sigma))
    return prior


def _with_focal(prior: CameraPrior, share: float | None) -> CameraPrior:
    if share is None or prior.sigma[0] == 0.0:
        return prior
    return replace(prior, sigma=np.append(share * prior.camera.fx, prior.sigma[1:]))


def _of_photos(ties: TiePoints, ids: tuple[str, ...]) -> TiePoints:
    """Tie points counted by other photos; those of photos that are gone fall away."""
    if ties.photo_ids == ids:
        return ties
    number = {key: i for i, key in enumerate(ids)}
    new = np.array([number.get(key, -1) for key in ties.photo_ids], dtype=np.int32)
    kept = ties.selected(new[ties.photo] >= 0)
    return replace(kept, photo_ids=ids, photo=new[kept.photo])


def _turned_before(project: Project, site: Site) -> dict[str, int]:
    """By how much the direct pose takes the pixels of each photo as turned, deg clockwise."""
    out = dict.fromkeys(site.photos, 0)
    for row in project.database.rows("pose"):
        key = row["photo_id"]
        if key in out and row["kind"] == site.pose_kinds[key]:
            out[key] = int((row["extra"] or {}).get("turned_deg", 0))
    return out


def _check_places(site: Site) -> None:
    """Refuse photos of one position: nothing would tell how large the block is."""
    p = np.array([photo.pose.origin_enu for photo in site.photos.values()])
    if len(p) < 3:
        return
    spread = float(np.ptp(p[:, :2], axis=0).max())
    up = float(np.median(p[:, 2] - np.nan_to_num(site.terrain.z_at(p[:, :2]))))
    if spread < ONE_PLACE * up:
        raise AdjustmentError(
            f"all {len(p)} photos have one position (within {spread:.1f} m), so nothing tells how "
            "far apart they were taken; check the positions in the tags, or give a pose file"
        )


def _turned_photo(
    oriented: OrientedPhoto, degrees: int, pixels: int, cameras: Mapping[str, Camera]
) -> OrientedPhoto:
    """Photo that turns out to be turned by `degrees`, its pixels by `pixels` of them."""
    if degrees % 360 == 0:
        return oriented
    R = oriented.pose.R_enu_from_cam @ R_turned_from_sensor(degrees).T
    if pixels % 360 == 0:
        # the heading is wrong, and roll and pitch are right in the vehicle's axes
        world = R @ oriented.pose.R_enu_from_cam.T
        yaw = math.atan2(world[1, 0] - world[0, 1], world[0, 0] + world[1, 1])
        R = exp_so3([0.0, 0.0, yaw]) @ oriented.pose.R_enu_from_cam
    pose = replace(oriented.pose, R_enu_from_cam=R)
    return OrientedPhoto(
        photo=oriented.photo, camera=oriented.camera.turned(pixels % 360), pose=pose
    )


def _relief(views: SensorViews, first: NDArray[np.float64]) -> float:
    if not len(first):
        return LEAST_RELIEF
    up = np.median([v.pose.origin_enu[2] for v in views.photos]) - np.median(first[:, 2])
    return float(max(LEAST_RELIEF, RELIEF_SHARE * up))


def _control_input(
    control: ControlObservations | None, views: SensorViews, ids: Sequence[str]
) -> ControlInput | None:
    """Control with its marks in the sensors' pixels; points that are off fall away."""
    if control is None or not len(control.photo_ids):
        return None
    number = {key: i for i, key in enumerate(ids)}
    keep = [
        k
        for k, (key, j) in enumerate(zip(control.photo_ids, control.point, strict=True))
        if key in number and control.role[j] != "off"
    ]
    if not keep:
        return None
    photo = np.array([number[control.photo_ids[k]] for k in keep])
    marks = [(int(i), control.uv[[k]]) for i, k in zip(photo, keep, strict=True)]
    uv = np.vstack([views.uv(i, mark) for i, mark in marks])
    scale = np.concatenate([views.scale(i, mark) for i, mark in marks])
    seen = np.isfinite(uv[:, 0]) & np.isfinite(scale) & (scale > 0)
    photo, uv, scale = photo[seen], uv[seen], scale[seen]
    keep = [k for k, good in zip(keep, seen, strict=True) if good]
    if not keep:
        return None
    return ControlInput(
        names=control.names,
        p_enu=control.p_enu,
        sigma=control.sigma,
        used=np.array([role == "control" for role in control.role]),
        photo=photo,
        point=control.point[keep].astype(np.int64),
        uv=uv,
        sigma_px=control.sigma_px[keep] * scale,
    )
