"""What an adjustment left beside its poses: ground points, and the pixels that see them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from georef_gis.errors import ExportError, InputError
from georef_gis.frames import Array
from georef_gis.model.camera import Camera
from georef_gis.model.tie_points import GroundPoints, TiePoints
from georef_gis.model.virtual_pinhole import virtual_rays
from georef_gis.project.columns_file import read_columns

if TYPE_CHECKING:
    from exports.site.values import SiteValues

POINTS, RESIDUALS = "points.npz", "residuals.npz"


def read_points(folder: Path) -> GroundPoints:
    """Ground points of an adjustment.

    Raises
    ------
    ExportError
        If they cannot be read.
    """
    try:
        read = read_columns(folder / POINTS, "ground points")
        return GroundPoints(
            p_enu=read["p_enu"],
            covariance=read["covariance"].astype(np.float64),
            rays=read["rays"].astype(np.int32),
            residual_px=read["residual_px"].astype(np.float64),
        )
    except (InputError, KeyError, ValueError) as error:
        raise _refusal(error, folder / POINTS) from error


def read_tracks(site: SiteValues, folder: Path) -> tuple[TiePoints, GroundPoints]:
    """Observations that the adjustment kept, in pixels of the stored photos, and their points.

    Raises
    ------
    ExportError
        If the files cannot be read or do not go together.
    """
    points = read_points(folder)
    path = folder / RESIDUALS
    try:
        read = read_columns(path, "residuals")
        # marks of control points are no tie points
        tie = np.flatnonzero(read["mark"] < 0)
        tie = tie[np.lexsort((read["photo"][tie], read["point"][tie]))]
        ties = TiePoints(
            photo_ids=tuple(str(name) for name in read["photo_ids"]),
            photo=read["photo"][tie].astype(np.int32),
            point=read["point"][tie].astype(np.int32),
            uv=_stored(site, read["photo_ids"], read["photo"][tie], read["uv"][tie]),
            sigma=read["sigma"][tie].astype(np.float64),
        )
    except (InputError, KeyError, ValueError) as error:
        raise _refusal(error, path) from error
    if ties.n_points != len(points):
        raise _refusal(f"of {ties.n_points} points, {POINTS} of {len(points)}", path)
    return ties, points


def _refusal(why: object, path: Path) -> ExportError:
    return ExportError(f"{path}: cannot be read ({why}); run `georef adjust --force`")


def _stored(site: SiteValues, ids: Array, photo: Array, uv: Array) -> Array:
    """Pixels of the stored photos from those that were adjusted; (m, 2)."""
    cameras = {camera.id: camera for camera in site.cameras}
    photos = {one.photo.id: one for one in site.photos}
    out = uv.astype(np.float64)
    for i in np.unique(photo):
        one = photos.get(str(ids[i]))
        camera = cameras.get(one.camera_id) if one is not None else None
        if one is None or camera is None:
            continue
        mine = photo == i
        if camera.model != "brown":
            out[mine] = camera.project(virtual_rays(out[mine]))
        out[mine] = turned_uv(out[mine], camera, one.turned_deg)
    return out


def turned_uv(uv: Array, camera: Camera, degrees: int) -> Array:
    """Pixels of a picture turned clockwise from those of the sensor's; (m, 2).

    `camera` is the sensor's. A quarter takes (u, v) to (height - 1 - v, u).
    """
    width, height = camera.width, camera.height
    for _ in range(degrees // 90 % 4):
        uv = np.stack([height - 1 - uv[:, 1], uv[:, 0]], axis=1)
        width, height = height, width
    return uv
