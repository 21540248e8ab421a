"""The two-step procedure of the 2012 paper beside the one step, for comparison."""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import Any

import numpy as np

from georef_gis.errors import GeorefError
from georef_gis.model.pose import Mount
from georef_gis.orient.adjustment.adjust import Adjusted, adjust
from georef_gis.orient.adjustment.block import Block, CameraPrior, FlightPrior
from georef_gis.orient.two_step import MountEstimate, NavigationPose, two_step
from processing_algorithms.orient.blocks import Prepared

# m and rad, one sigma of poses that an aerial triangulation knows nothing of
LOOSE_M, LOOSE_RAD = 300.0, 0.5
FEWEST_CONTROL = 3


def two_step_beside(prepared: Prepared, adjusted: Adjusted, mount: Mount) -> dict[str, Any]:
    """Tables 4 and 5 of the paper for each flight, beside what the one step found.

    The first step is an aerial triangulation on the control points alone, with the adjusted camera
    held; the second compares its poses with the navigation's.

    Returns
    -------
    dict
        By flight, or `why_not`.
    """
    control = adjusted.block.control
    used = set() if control is None else {int(i) for i in control.point if control.used[i]}
    if len(used) < FEWEST_CONTROL:
        return {
            "why_not": f"an aerial triangulation needs {FEWEST_CONTROL} marked control points, "
            f"there are {len(used)}"
        }
    try:
        triangulated = adjust(_loose(adjusted), _places(adjusted))
    except GeorefError as error:
        return {"why_not": str(error)}
    out: dict[str, Any] = {}
    for index, flight in enumerate(adjusted.block.flights):
        try:
            estimate = _estimate(prepared.block, flight, triangulated, mount)
        except GeorefError as error:
            out[flight.id] = {"why_not": str(error)}
            continue
        out[flight.id] = _told(estimate, adjusted, index, mount)
    return out


def _loose(adjusted: Adjusted) -> Block:
    """The same block without its navigation: only control and tie points hold it."""
    block = adjusted.block
    flights = tuple(_without_navigation(flight) for flight in block.flights)
    cameras = tuple(CameraPrior(camera=c, sigma=np.zeros(11)) for c in adjusted.cameras)
    return replace(
        block, flights=flights, cameras=cameras, start=adjusted.poses, ground=None, sigma_level=0.0
    )


def _without_navigation(flight: FlightPrior) -> FlightPrior:
    n = len(flight.photos)
    variance = np.tile([LOOSE_M**2] * 3 + [LOOSE_RAD**2] * 3, n)

    def joint(indices: Any) -> Any:
        return np.diag(variance[: 6 * len(indices)])

    return replace(
        flight,
        covariance=np.diag(variance),
        white=np.zeros((n, 6, 6)),
        shared_covariance=np.zeros((10, 10)),
        joint=joint,
        times=np.arange(n, dtype=np.float64),
    )


def _places(adjusted: Adjusted) -> Any:
    up = np.array([0.0, 0.0, adjusted.solution.state.level])
    return adjusted.solution.state.points + up


def _estimate(
    block: Block, flight: FlightPrior, triangulated: Adjusted, mount: Mount
) -> MountEstimate:
    """Mount from the differences of triangulated and navigated poses of a flight."""
    n = len(flight.photos)
    every = np.arange(n)
    whole = flight.whole_covariance()
    blocks = whole.reshape(n, 6, n, 6)[every, :, every, :]
    arm = mount.lever_arm_body_camera
    navigation = [
        NavigationPose(
            photo_id=block.photo_ids[int(i)],
            p_enu=block.poses[int(i)].origin_enu - R @ arm,
            R_enu_from_body=R,
            covariance=covariance + 1e-12 * np.eye(6),
        )
        for i, R, covariance in zip(flight.photos, flight.R_enu_from_body, blocks, strict=True)
    ]
    _, count = triangulated.rms_by_photo()
    orientations = {
        block.photo_ids[int(i)]: triangulated.poses[int(i)] for i in flight.photos if count[i]
    }
    return two_step(orientations, navigation, joint_navigation=whole)


def _told(estimate: MountEstimate, adjusted: Adjusted, index: int, mount: Mount) -> dict[str, Any]:
    """Rows of the tables, and the one step's values of the same quantities."""
    values, covariance = adjusted.flight(index)
    sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    found = estimate.mount(mount)
    spread = np.sqrt(np.diag(estimate.covariance))
    return {
        "table": [asdict(row) for row in estimate.to_table()],
        "photos": len(estimate.samples),
        "left_out": dict(estimate.left_out),
        "doubts": list(estimate.doubts),
        "lever_arm_m": {
            "two_step": found.lever_arm_body_camera.tolist(),
            "two_step_sigma": spread[:3].tolist(),
            "one_step": (mount.lever_arm_body_camera + values[:3]).tolist(),
            "one_step_sigma": sigma[:3].tolist(),
        },
        "boresight_rad": {
            "two_step": found.boresight_body.tolist(),
            "two_step_sigma": spread[3:].tolist(),
            "one_step": (mount.boresight_body + values[3:6]).tolist(),
            "one_step_sigma": sigma[3:6].tolist(),
        },
    }
