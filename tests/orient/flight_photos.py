"""Photos as a reader would make them from a simulated flight's tags, and their direct poses."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from georef_gis.frames import log_so3
from georef_gis.geodesy import Height, HeightKind, MapFrame, Origin, map_crs
from georef_gis.model.camera import Camera
from georef_gis.model.photo import AttitudeTag, Geotag, OrientedPhoto, Photo
from georef_gis.model.pose import Mount
from georef_gis.model.terrain import FlatTerrain
from georef_gis.orient.direct import DirectPose, DirectSettings, direct_poses
from georef_gis.orient.heights import GroundSetting, solve_heights
from georef_gis.simulate import SimulatedFlight


def photos_of(flight: SimulatedFlight) -> list[Photo]:
    s, t = flight.settings, flight.tags
    out = []
    for i, name in enumerate(flight.names):
        angles = np.radians([t.roll_deg[i], t.pitch_deg[i], t.yaw_deg[i]])
        attitude = None
        if np.all(np.isfinite(angles)):
            roll, pitch, yaw = (float(a) for a in angles)
            attitude = AttitudeTag(dialect="pix4d-camera", roll=roll, pitch=pitch, yaw=yaw)
        height = Height(value=float(t.height_orthometric[i]), kind=HeightKind.ORTHOMETRIC)
        tag = Geotag(
            lat=math.radians(t.lat_deg[i]),
            lon=math.radians(t.lon_deg[i]),
            height=height,
            sigma_h=s.tag_sigma_h,
            sigma_v=s.tag_sigma_v,
            of="antenna",
        )
        size = {"width": s.camera.width, "height": s.camera.height}
        out.append(
            Photo(
                id=name,
                path=Path(name),
                geotag=tag,
                attitude=attitude,
                camera_clock=t.camera_clock[i],
                **size,
            )
        )
    return out


def camera_of(flight: SimulatedFlight) -> Camera:
    c = flight.settings.camera
    names = ("width", "height", "fx", "fy", "cx", "cy", "k1", "k2", "k3", "p1", "p2")
    return Camera(id="rebel", **{name: getattr(c, name) for name in names})


@dataclass(frozen=True, kw_only=True)
class DirectFlight:
    """One flight beside its direct poses."""

    flight: SimulatedFlight
    origin: Origin
    photos: list[Photo]
    poses: list[DirectPose]

    def oriented(self, i: int) -> OrientedPhoto:
        pose = self.poses[i].pose
        assert pose is not None
        return OrientedPhoto(photo=self.photos[i], camera=camera_of(self.flight), pose=pose)

    @property
    def errors(self) -> np.ndarray:
        """(dp_enu, dtheta_enu) of every photo; shape (n, 6), m and rad."""
        out = []
        for i, found in enumerate(self.poses):
            pose = found.pose
            assert pose is not None
            p = self.origin.enu_from_ecef(self.flight.p_ecef[i])
            R = self.origin.R_ecef_from_enu.T @ self.flight.R_ecef_from_cam[i]
            out.append(np.r_[p - pose.origin_enu, log_so3(R @ pose.R_enu_from_cam.T)])
        return np.array(out)

    @property
    def normalised(self) -> np.ndarray:
        """Errors over their sigmas; shape (n, 6)."""
        variances = [np.diag(p.pose.covariance) for p in self.poses if p.pose is not None]
        return np.asarray(self.errors / np.sqrt(variances))


def fly_direct(flight: SimulatedFlight, **settings: Any) -> DirectFlight:
    """Direct poses with the believed mount and the error sources' own sigmas."""
    s = flight.settings
    photos = photos_of(flight)
    tag = photos[0].geotag
    assert tag is not None
    origin = Origin(lat=tag.lat, lon=tag.lon, height_ellipsoidal=280.0)
    ground = GroundSetting(dem=FlatTerrain(origin=origin, height_ellipsoidal=277.6))
    mount = Mount(
        lever_arm_body_camera=np.array(s.lever_arm_camera),
        lever_arm_body_antenna=np.array(s.lever_arm_antenna),
        sigma_lever_arm=s.lever_arm_sigma,
        sigma_boresight=math.radians(s.boresight_sigma_deg),
    )
    poses = direct_poses(
        photos,
        origin,
        solve_heights(photos, origin, ground),
        mount,
        DirectSettings(**settings),
        convergence_at=MapFrame(origin, map_crs("EPSG:32617")).convergence_at,
    )
    return DirectFlight(flight=flight, origin=origin, photos=photos, poses=poses)
