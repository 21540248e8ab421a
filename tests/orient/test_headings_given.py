"""A heading that replaces the tag's must turn the picture to it, whatever the dialect."""

from __future__ import annotations

import math

import numpy as np
import pytest

from georef_gis.geodesy import Height, HeightKind, Origin
from georef_gis.model.photo import AttitudeTag, Geotag, Photo
from georef_gis.model.pose import Mount, Pose
from georef_gis.orient.dialects import R_enu_from_cam_of_tag, dialect, dialects
from georef_gis.orient.direct import with_heading
from georef_gis.orient.heights import GroundSetting, solve_heights

ORIGIN = Origin(lat=math.radians(39.0), lon=math.radians(-80.0), height_ellipsoidal=300.0)
CONVERGENCE = math.radians(-0.7)


def image_top(tag: AttitudeTag) -> float:
    R = R_enu_from_cam_of_tag(
        tag,
        yaw=tag.yaw or 0.0,
        origin=ORIGIN,
        vehicle_lat=ORIGIN.lat,
        vehicle_lon=ORIGIN.lon,
        mount=Mount(),
        convergence=CONVERGENCE,
    )
    pose = Pose(origin_enu=np.zeros(3), R_enu_from_cam=R, covariance=np.eye(6))
    return math.degrees(pose.image_up_azimuth) % 360.0


@pytest.mark.parametrize("name", sorted(dialects()))
@pytest.mark.parametrize("roll_deg", [0.0, 180.0])
def test_heading_is_where_the_top_of_a_nadir_picture_points(name: str, roll_deg: float) -> None:
    gimbal = dialect(name).nominal == "horizon"
    if roll_deg and not gimbal:
        # Only a gimbal is stored turned over; for the others it is an upside-down aircraft.
        roll_deg = 0.0
    pitch = -math.pi / 2 if gimbal else 0.0
    tag = AttitudeTag(dialect=name, roll=math.radians(roll_deg), pitch=pitch, yaw=1.0)
    turned = with_heading(tag, math.radians(30.0), CONVERGENCE)
    assert image_top(turned) == pytest.approx(30.0, abs=1e-6)  # deg


def photo(height: Height) -> Photo:
    tag = Geotag(lat=ORIGIN.lat, lon=ORIGIN.lon, height=height)
    from pathlib import Path

    return Photo(id="P", path=Path("P.JPG"), width=10, height=10, geotag=tag)


def test_heights_above_ground_in_the_tags_are_used() -> None:
    one = photo(Height(value=80.0, kind=HeightKind.UNKNOWN))
    found = solve_heights([one], ORIGIN, GroundSetting(), kind=HeightKind.ABOVE_GROUND)
    z = found.terrain.z_at(np.zeros(2)) + ORIGIN.height_ellipsoidal
    assert found.cameras["P"] - float(z) == pytest.approx(80.0, abs=1e-6)
