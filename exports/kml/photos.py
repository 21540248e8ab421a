"""Photos as they were seen: `PhotoOverlay` from the true pose, with undistorted thumbnails."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from exports.kml import elements as k
from exports.site.values import SitePhoto, SiteValues
from georef_gis.errors import InputError
from georef_gis.frames import R_PHOTO_FROM_CAM, Array, R_ecef_from_enu
from georef_gis.geodesy import MapFrame, geoid_undulation
from georef_gis.model.camera import Camera
from georef_gis.rasters.undistort import pinhole_of

# rad off the vertical; below, heading and roll are one angle and the heading takes it all
NADIR = 2e-5
# The picture hangs at this part of the way to the ground, so that it does not sink into it ...
SHARE = 0.5
# ... and this far away where the height above the ground is not known, m.
NEAR_UNKNOWN = 10.0
SHAPE = "rectangle"


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraView:
    """Where a camera of KML stands and looks.

    Its axes are x right, y up, z backwards. Turned from looking down with the top to the north:
    first by `roll` about z, then by `tilt` about x, then by `heading` about the vertical; roll
    and tilt right-handed, heading clockwise from north.

    Parameters
    ----------
    lon, lat : deg
    altitude : m above EGM96
    heading, tilt, roll : deg
        0 to 360, 0 (down) to 180 (up), -180 to 180.
    """

    lon: float
    lat: float
    altitude: float
    heading: float
    tilt: float
    roll: float

    @property
    def element(self) -> k.Element:
        """As `Camera`."""
        return k.element(
            "Camera",
            k.element("longitude", text=k.degrees(self.lon)),
            k.element("latitude", text=k.degrees(self.lat)),
            k.element("altitude", text=f"{self.altitude:.3f}"),
            k.element("heading", text=f"{self.heading:.6f}"),
            k.element("tilt", text=f"{self.tilt:.6f}"),
            k.element("roll", text=f"{self.roll:.6f}"),
            k.element("altitudeMode", text="absolute"),
        )


def camera_view(frame: MapFrame, origin_enu: Array, R_enu_from_cam: Array) -> CameraView:
    """Camera of KML at a pose in the project's enu."""
    lat, lon, height = (float(x) for x in frame.origin.geo_from_enu(origin_enu))
    R_local_from_enu = R_ecef_from_enu(lat, lon).T @ frame.origin.R_ecef_from_enu
    heading, tilt, roll = view_angles(R_local_from_enu @ R_enu_from_cam @ R_PHOTO_FROM_CAM.T)
    return CameraView(
        lon=math.degrees(lon),
        lat=math.degrees(lat),
        altitude=height - float(geoid_undulation(lat, lon)),
        heading=math.degrees(heading) % 360.0,
        tilt=math.degrees(tilt),
        roll=math.degrees(roll),
    )


def view_angles(R: Array) -> tuple[float, float, float]:
    """Heading, tilt, roll, rad, of a rotation from photo axes to east, north, up at the camera.

    Notes
    -----
    ``R = Rz(-heading) Rx(tilt) Rz(roll)``; "Cameras", developers.google.com/kml, says the order.
    """
    sine = math.hypot(R[0, 2], R[1, 2])
    tilt = math.atan2(sine, R[2, 2])
    if sine < NADIR:
        turn = math.atan2(R[0, 1], R[0, 0])
        # looking up, x turns the other way
        return turn, tilt, 0.0
    return math.atan2(-R[0, 2], -R[1, 2]), tilt, math.atan2(R[2, 0], R[2, 1])


def view_volume(pinhole: Camera, near: float) -> k.Element:
    """Field of view of an undistorted photo, from its principal point to its four sides."""
    left, top, right, bottom = sides(pinhole)
    angles = (("leftFov", left), ("rightFov", right), ("bottomFov", -bottom), ("topFov", -top))
    return k.element(
        "ViewVolume",
        *(k.element(name, text=f"{math.degrees(math.atan(t)):.6f}") for name, t in angles),
        k.element("near", text=f"{near:.3f}"),
    )


def sides(pinhole: Camera) -> tuple[float, float, float, float]:
    """Left, top, right, bottom of an undistorted photo on the plane z = 1, camera axes."""
    (left, top), (right, bottom) = (
        ((u - pinhole.cx) / pinhole.fx, (v - pinhole.cy) / pinhole.fy)
        for u, v in ((-0.5, -0.5), (pinhole.width - 0.5, pinhole.height - 0.5))
    )
    return left, top, right, bottom


def near_of(R_enu_from_cam: Array, pinhole: Camera, height: float | None) -> float:
    """Distance at which the picture hangs, m: all of it above the ground."""
    if height is None or not math.isfinite(height) or height <= 0.0:
        return NEAR_UNKNOWN
    left, top, right, bottom = sides(pinhole)
    corners = np.array([[x, y, 1.0] for x in (left, right) for y in (top, bottom)])
    deepest = float(np.max(-(corners @ R_enu_from_cam.T)[:, 2]))
    return SHARE * height / max(deepest, 0.2)


def pinholes(site: SiteValues) -> dict[str, tuple[Camera, Camera]]:
    """Photo id -> camera of its stored pixels and that of its undistorted thumbnail."""
    known = {camera.id: camera for camera in site.cameras}
    made: dict[tuple[str, int], tuple[Camera, Camera] | None] = {}
    out = {}
    for one in site.photos:
        camera = known.get(one.camera_id)
        if one.pose is None or camera is None:
            continue
        key = (camera.id, one.turned_deg)
        if key not in made:
            try:
                stored = camera.turned(one.turned_deg)
                made[key] = (stored, pinhole_of(stored))
            except InputError:
                made[key] = None
        pair = made[key]
        # Pixels of another size than the camera's cannot be undistorted by it.
        if pair is not None and (one.photo.width, one.photo.height) == (
            pair[0].width, pair[0].height,
        ):  # fmt: skip
            out[one.photo.id] = pair
    return out


def photo_overlays(
    site: SiteValues,
    photos: Sequence[SitePhoto],
    pairs: Mapping[str, tuple[Camera, Camera]],
    thumbnails: Mapping[str, str],
) -> list[k.Element]:
    """Photos that can be looked through, those that have a pose, a camera and a thumbnail."""
    out: list[k.Element] = []
    for one in photos:
        pair, href = pairs.get(one.photo.id), thumbnails.get(one.photo.id, "")
        if one.pose is None or pair is None or not href:
            continue
        out.append(_overlay(site.frame, one, pair[1], href, len(out) + 1))
    return out


def _overlay(frame: MapFrame, one: SitePhoto, pinhole: Camera, href: str, number: int) -> k.Element:
    assert one.pose is not None
    view = camera_view(frame, one.pose.origin_enu, one.pose.R_enu_from_cam)
    near = near_of(one.pose.R_enu_from_cam, pinhole, one.height_above_ground)
    place = f"{k.degrees(view.lon)},{k.degrees(view.lat)},{view.altitude:.3f}"
    return k.element(
        "PhotoOverlay",
        k.element("name", text=one.photo.id),
        # Seen from inside one at a time; all at once they would hide the site.
        k.element("visibility", text="0"),
        view.element,
        k.element("styleUrl", text="#view"),
        k.element("Icon", k.element("href", text=href)),
        view_volume(pinhole, near),
        k.element(
            "Point",
            k.element("altitudeMode", text="absolute"),
            k.element("coordinates", text=place),
        ),
        k.element("shape", text=SHAPE),
        id=f"view-{number}",
    )
