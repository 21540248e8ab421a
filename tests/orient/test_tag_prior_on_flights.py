"""The joint prior of tags against simulated flights: what a whole block inherits from them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from georef_gis.frames import R_BODY_FROM_CAM_NADIR, R_ned_from_body, log_so3
from georef_gis.model.camera import Camera
from georef_gis.model.photo import OrientedPhoto, Photo
from georef_gis.model.pose import Pose
from georef_gis.orient.adjustment.priors import tag_prior
from georef_gis.simulate import FlightSettings, SimulatedFlight, simulate_flight

Array = NDArray[np.float64]
FLIGHTS = 40
CAMERA = Camera(id="c", width=648, height=432, fx=525.0, fy=525.0, cx=323.5, cy=215.5)
ENU_FROM_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


def by_tags(flight: SimulatedFlight) -> list[OrientedPhoto]:
    """Photos with the angles of their tags, and the sigmas that the tags state."""
    tags, s = flight.tags, flight.settings
    R = R_ned_from_body(*np.radians([tags.roll_deg, tags.pitch_deg, tags.yaw_deg]))
    boresight = 1.0
    angle = np.radians([np.hypot(s.attitude_sigma_deg, boresight)] * 2 + [s.tag_sigma_yaw_deg])
    sigma = np.concatenate([[s.tag_sigma_h] * 2, [s.tag_sigma_v], angle])
    out = []
    for i, name in enumerate(flight.names):
        pose = Pose(
            origin_enu=np.array([20.0 * i, 0.0, 60.0]),
            R_enu_from_cam=ENU_FROM_NED @ R[i] @ R_BODY_FROM_CAM_NADIR,
            covariance=np.diag(sigma**2),
            kind="tags",
        )
        photo = Photo(
            id=name, path=Path(name), width=CAMERA.width, height=CAMERA.height, camera_id="c",
            time_gps=float(flight.start_gps + flight.exposures[i]),
        )  # fmt: skip
        out.append(OrientedPhoto(photo=photo, camera=CAMERA, pose=pose))
    return out


@pytest.mark.slow
def test_the_tilt_of_a_block_by_tags_is_as_sure_as_they_say() -> None:
    """The mean of all photos' tilts: what no match can tell, and a prior must not promise."""
    ratios = []
    for seed in range(FLIGHTS):
        flight = simulate_flight(FlightSettings(), seed=300 + seed)
        photos = by_tags(flight)
        n = len(photos)
        prior = tag_prior("flight", photos, np.arange(n))
        R_true = ENU_FROM_NED @ flight.R_ned_from_cam
        R_tag = np.array([p.pose.R_enu_from_cam for p in photos])
        off = log_so3(R_true @ np.swapaxes(R_tag, 1, 2))
        assert prior.covariance is not None
        P = prior.covariance.reshape(n, 6, n, 6)[:, 3:, :, 3:].copy()
        mount = prior.shared_covariance[3:6, 3:6]
        R = prior.R_enu_from_body
        P += np.einsum("aij,jk,blk->aibl", R, mount, R)
        mean = np.einsum("aibj->ij", P) / n**2
        ratios.append(off.mean(axis=0) / np.sqrt(np.diag(mean)))
    rms = np.sqrt(np.mean(np.square(ratios), axis=0))
    # the rms of 40 scatters by 11 % of itself
    assert np.all((rms[:2] > 0.7) & (rms[:2] < 1.4)), rms
    # yaw may err by crab, which a wind holds for a whole flight
    assert 0.4 < rms[2] < 1.4, rms
