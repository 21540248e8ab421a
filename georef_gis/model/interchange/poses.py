"""From the shots of a placed block to what pose files tell, and photos by name."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from pathlib import PurePosixPath

import numpy as np

from georef_gis.errors import InputError
from georef_gis.frames import (
    R_BODY_FROM_CAM_NADIR,
    Array,
    R_enu_from_ned,
    jacobian_theta_ned_from_rpy,
    rpy_from_R_ned_from_body,
)
from georef_gis.geodesy import Height
from georef_gis.model.interchange.block import Block
from georef_gis.model.photo import AttitudeTag, Geotag


def by_photo(names: Sequence[str], photos: Sequence[str]) -> dict[str, int]:
    """Which photo each name means: equal in either case, with or without folder and ending.

    Parameters
    ----------
    names
        As another program writes them.
    photos
        File names; one that occurs twice is matched by none.
    """
    full: dict[str, list[int]] = {}
    stems: dict[str, list[int]] = {}
    for i, photo in enumerate(photos):
        base = _base(photo)
        full.setdefault(base, []).append(i)
        stems.setdefault(_stem(base), []).append(i)
    out = {}
    for name in names:
        base = _base(name)
        found = full.get(base) or stems.get(_stem(base)) or []
        if len(found) == 1:
            out[name] = found[0]
    return out


def _base(name: str) -> str:
    return PurePosixPath(name.replace("\\", "/")).name.lower()


def _stem(name: str) -> str:
    return re.sub(r"\.(jpe?g|tiff?|png|dng)$", "", name)


def poses_of_block(block: Block, source: str) -> dict[str, tuple[Geotag, AttitudeTag]]:
    """Position and angles (dialect `ypr`, zero at nadir) of each shot, by its name.

    Raises
    ------
    InputError
        If the block has no place on the Earth.
    """
    origin = block.origin
    if origin is None:
        raise InputError("has no place on the Earth", source=block.source)
    out = {}
    for shot in block.shots:
        lat, lon, h = (float(v) for v in origin.geo_from_enu(shot.origin))
        R_enu_ned = R_enu_from_ned(origin.lat, origin.lon, lat, lon)
        R_ned_body = R_enu_ned.T @ shot.R_world_from_cam @ R_BODY_FROM_CAM_NADIR.T
        rpy = rpy_from_R_ned_from_body(R_ned_body)
        sigma_h, sigma_v, sigma_rp, sigma_yaw = _sigmas(shot.covariance, R_enu_ned, rpy)
        geotag = Geotag(
            lat=lat,
            lon=lon,
            height=Height(value=h, kind=block.height_kind),
            sigma_h=sigma_h,
            sigma_v=sigma_v,
            of="camera",
            datum=block.datum,
            source=source,
        )
        roll, pitch, yaw = (float(v) for v in rpy)
        attitude = AttitudeTag(
            dialect="ypr",
            roll=roll,
            pitch=pitch,
            yaw=math.remainder(yaw, 2.0 * math.pi),
            sigma_roll_pitch=sigma_rp,
            sigma_yaw=sigma_yaw,
        )
        out[shot.name] = geotag, attitude
    return out


def _sigmas(
    covariance: Array | None, R_enu_ned: Array, rpy: Array
) -> tuple[float | None, float | None, float | None, float | None]:
    """Sigmas of position (per horizontal axis, m), height, roll and pitch, yaw (rad)."""
    if covariance is None:
        return None, None, None, None
    c = R_enu_ned.T @ covariance[:3, :3] @ R_enu_ned
    J = jacobian_theta_ned_from_rpy(*(float(v) for v in rpy))
    sigma_h = math.sqrt((c[0, 0] + c[1, 1]) / 2.0) or None
    sigma_v = math.sqrt(c[2, 2]) or None
    if abs(float(np.linalg.det(J))) < 1e-6:
        # At pitch +-90 deg roll and yaw are one angle.
        sigma = math.sqrt(float(np.trace(covariance[3:, 3:])) / 3.0)
        return sigma_h, sigma_v, sigma or None, sigma or None
    K = np.linalg.solve(J, R_enu_ned.T)
    d = np.diag(K @ covariance[3:, 3:] @ K.T)
    rp, yaw = math.sqrt((d[0] + d[1]) / 2.0), math.sqrt(d[2])
    return sigma_h, sigma_v, rp or None, yaw or None
