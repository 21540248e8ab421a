"""Which way a dialect's angles turn a camera: one table, `data/dialects.csv`, read here."""

from __future__ import annotations

import csv
import functools
import math
from dataclasses import dataclass
from importlib import resources

import numpy as np

from georef_gis.errors import InputError
from georef_gis.frames import (
    R_BODY_FROM_CAM_HORIZON,
    R_BODY_FROM_CAM_NADIR,
    R_PHOTO_FROM_CAM,
    Array,
    R_enu_from_ned,
    R_map_from_enu,
    R_map_from_photo,
    R_ned_from_body,
    exp_so3,
)
from georef_gis.geodesy import Origin
from georef_gis.model.photo import AttitudeTag
from georef_gis.model.pose import Mount

_NOMINAL = {
    "nadir": R_BODY_FROM_CAM_NADIR,
    "horizon": R_BODY_FROM_CAM_HORIZON,
    "photo": R_PHOTO_FROM_CAM,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Dialect:
    """One row of the table; sigmas are what to expect when the tags state none, rad."""

    name: str
    angles_of: str
    zero: str
    nominal: str
    yaw: str
    pitch: str
    roll: str
    sigma_roll_pitch: float
    sigma_yaw: float
    proved: str
    source: str

    @property
    def R_body_from_cam_nominal(self) -> Array:
        """Camera axes in the axes that the angles turn; shape (3, 3)."""
        return np.asarray(_NOMINAL[self.nominal])


@functools.cache
def dialects() -> dict[str, Dialect]:
    """All dialects of the table by name."""
    text = resources.files("georef_gis").joinpath("data/dialects.csv").read_text("utf-8")
    table = {}
    for row in csv.DictReader(text.splitlines()):
        table[row["dialect"]] = Dialect(
            name=row["dialect"],
            angles_of=row["angles_of"],
            zero=row["zero"],
            nominal=row["nominal"],
            yaw=row["yaw"],
            pitch=row["pitch"],
            roll=row["roll"],
            sigma_roll_pitch=math.radians(float(row["sigma_roll_pitch_deg"])),
            sigma_yaw=math.radians(float(row["sigma_yaw_deg"])),
            proved=row["proved_on_pixels"],
            source=row["source"],
        )
    return table


def dialect(name: str) -> Dialect:
    """Dialect by name.

    Raises
    ------
    InputError
        If it is not in the table.
    """
    try:
        return dialects()[name]
    except KeyError:
        known = ", ".join(dialects())
        raise InputError(
            f"'{name}' is not known; use one of {known}", field="attitude.dialect"
        ) from None


def R_enu_from_cam_of_tag(
    attitude: AttitudeTag,
    *,
    yaw: float,
    origin: Origin,
    vehicle_lat: float,
    vehicle_lon: float,
    mount: Mount,
    convergence: float = 0.0,
) -> Array:
    """Rotation of the camera that a tag states; shape (3, 3).

    Parameters
    ----------
    attitude
        Angles as the dialect means them.
    yaw
        Used in place of the tag's, rad: the tag may have none.
    origin, vehicle_lat, vehicle_lon
        Where enu is level and where the vehicle is, rad: their plumb lines differ.
    mount
        Its boresight turns the camera in body axes. Its nominal matrix is the dialect's own.
    convergence
        Meridian convergence at the vehicle, rad; for `opk`, whose axes are the map's.
    """
    entry = dialect(attitude.dialect)
    R_enu_ned = R_enu_from_ned(origin.lat, origin.lon, vehicle_lat, vehicle_lon)
    nominal = entry.R_body_from_cam_nominal
    if entry.nominal == "photo":
        R_map_cam = R_map_from_photo(attitude.roll, attitude.pitch, yaw) @ nominal
        # Map axes are level at the vehicle and turned by the convergence.
        R_enu_local = R_enu_ned @ R_enu_from_ned(0.0, 0.0, 0.0, 0.0).T
        return np.asarray(R_enu_local @ R_map_from_enu(convergence).T @ R_map_cam)
    R_ned_body = R_ned_from_body(attitude.roll, attitude.pitch, yaw)
    # The boresight is stated in axes whose camera looks down; a gimbal's axes look ahead at zero.
    boresight = exp_so3(mount.boresight_body)
    if entry.nominal == "horizon":
        to_nadir = nominal @ R_BODY_FROM_CAM_NADIR.T
        boresight = to_nadir @ boresight @ to_nadir.T
    return np.asarray(R_enu_ned @ R_ned_body @ boresight @ nominal)
