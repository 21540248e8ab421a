"""The navigation's poses at the exposures of a field or a flight, read from a CSV."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from georef_gis.frames import Array
    from georef_gis.ingest.tables import Row
    from georef_gis.orient.two_step import NavigationPose

COLUMNS = ("photo", "x", "y", "z", "roll_deg", "pitch_deg", "yaw_deg")
MORE_COLUMNS = (
    "stand", "time_s", "sigma_xy_m", "sigma_z_m", "sigma_roll_pitch_deg", "sigma_yaw_deg",
)  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseSigmas:
    """One sigma of a pose: east and north alike, and up, m; roll and pitch alike, and yaw, rad."""

    xy: float
    z: float
    roll_pitch: float
    yaw: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Exposures:
    """Poses of the navigation at the exposures.

    Parameters
    ----------
    stands
        Name of the stand by photo, where one is stated.
    times : shape (n,), s
        NaN where none is stated.
    """

    poses: Sequence[NavigationPose]
    stands: Mapping[str, str]
    times: Array


def read_exposures(path: Path, otherwise: PoseSigmas) -> Exposures:
    """Poses of the navigation from a table; `otherwise` where a row states no sigma.

    Raises
    ------
    InputError
        Naming file, line, column, value and cure.
    """
    import numpy as np

    from georef_gis.errors import InputError
    from processing_algorithms.orient.calibrate_camera import table_rows

    poses: dict[str, NavigationPose] = {}
    stands: dict[str, str] = {}
    times: list[float] = []
    for row in table_rows(path, COLUMNS, MORE_COLUMNS):
        photo = row.text("photo")
        if photo in poses:
            raise InputError(f"photo '{photo}' stands twice", source=row.source, field="photo")
        poses[photo] = _pose(row, otherwise)
        if row.text("stand"):
            stands[photo] = row.text("stand")
        time = row.number("time_s")
        times.append(math.nan if time is None else time)
    return Exposures(poses=tuple(poses.values()), stands=stands, times=np.array(times))


def _pose(row: Row, otherwise: PoseSigmas) -> NavigationPose:
    import numpy as np

    from georef_gis.frames import (
        R_ENU_FROM_NED_SAME_PLACE,
        R_ned_from_body,
        jacobian_theta_ned_from_rpy,
    )
    from georef_gis.orient.two_step import NavigationPose

    roll, pitch, yaw = (
        math.radians(row.required(name)) for name in ("roll_deg", "pitch_deg", "yaw_deg")
    )
    sigmas = _sigmas(row, otherwise)
    # At one place: the field is small, its plumb lines differ by 0.009 deg per km.
    J = R_ENU_FROM_NED_SAME_PLACE @ jacobian_theta_ned_from_rpy(roll, pitch, yaw)
    C = np.zeros((6, 6))
    C[:3, :3] = np.diag([sigmas.xy, sigmas.xy, sigmas.z]) ** 2
    C[3:, 3:] = J @ np.diag([sigmas.roll_pitch, sigmas.roll_pitch, sigmas.yaw]) ** 2 @ J.T
    return NavigationPose(
        photo_id=row.text("photo"),
        p_enu=np.array([row.required(axis) for axis in "xyz"]),
        R_enu_from_body=R_ENU_FROM_NED_SAME_PLACE @ R_ned_from_body(roll, pitch, yaw),
        covariance=C,
    )


def _sigmas(row: Row, otherwise: PoseSigmas) -> PoseSigmas:
    from georef_gis.errors import InputError

    level, heading = row.number("sigma_roll_pitch_deg"), row.number("sigma_yaw_deg")
    found = PoseSigmas(
        xy=row.number("sigma_xy_m") or otherwise.xy,
        z=row.number("sigma_z_m") or otherwise.z,
        roll_pitch=math.radians(level) if level else otherwise.roll_pitch,
        yaw=math.radians(heading) if heading else otherwise.yaw,
    )
    if min(found.xy, found.z, found.roll_pitch, found.yaw) <= 0:
        raise InputError("sigmas must be > 0", source=row.source)
    return found
