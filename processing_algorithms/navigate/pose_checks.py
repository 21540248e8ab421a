"""Whether poses of the trajectory agree with those of the tags, and which level they belong to."""

from __future__ import annotations

import math
from collections.abc import Mapping, Set
from dataclasses import replace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from georef_gis.model.pose import Pose
    from georef_gis.navigate.exposure_poses import ExposurePoses
    from georef_gis.project.sections import GroundSection

# m and sigmas; a trajectory that is farther from most of the tags is not that of the photos
ASTRAY, ASTRAY_SIGMAS = 30.0, 6.0
# deg; a camera that differs more from its tags is mounted otherwise than stated
MOUNT_DIFFERENCE = 25.0


def astray(result: ExposurePoses, tags: Mapping[str, Pose]) -> str:
    """Whether the trajectory is somewhere else than the photos, in words."""
    import numpy as np

    pairs = [
        (np.hypot(*(d := tags[name].origin_enu - pose.origin_enu)[:2]), d[:2], pose, name)
        for name, pose in zip(result.ids, result.poses, strict=True)
        if name in tags
    ]
    if not pairs:
        return ""
    far = [
        length > ASTRAY
        and math.sqrt(float(d @ np.linalg.solve((p.covariance + tags[n].covariance)[:2, :2], d)))
        > ASTRAY_SIGMAS
        for length, d, p, n in pairs
    ]
    if 2 * sum(far) <= len(far):
        return ""
    apart = float(np.median([length for length, *_ in pairs]))
    return (
        f"the trajectory lies {apart:.0f} m (median) from the tags of {len(pairs)} photos: the "
        "log is of another flight, or its clock is wrong; the poses of the tags are kept"
    )


def height_shift(
    result: ExposurePoses, tags: Mapping[str, Pose], ground: GroundSection
) -> tuple[float, str]:
    """What brings the trajectory's heights onto those the ground was derived from, m.

    A DEM or a stated height is absolute, and so are the logs. A ground that was derived from
    the tags' heights is not: the cameras must keep their height above it.
    """
    import numpy as np

    both = [
        (tags[name].origin_enu[2] - pose.origin_enu[2], pose.covariance[2, 2])
        for name, pose in zip(result.ids, result.poses, strict=True)
        if name in tags
    ]
    if not both:
        return 0.0, ""
    shift = float(np.median([d for d, _ in both]))
    sigma = math.sqrt(float(np.median([v for _, v in both])))
    if ground.dem is None and ground.height_m is None:
        return shift, ""
    limit = max(5.0 * sigma, 15.0)
    if abs(shift) <= limit:
        return 0.0, ""
    return 0.0, (
        f"the logs put the cameras {abs(shift):.0f} m {'below' if shift > 0 else 'above'} the "
        "tags: one of the two heights is of another kind; check [gnss] height_kind and the log"
    )


def mount_difference(
    poses: Mapping[str, Pose], tags: Mapping[str, Pose], said: Set[str]
) -> list[str]:
    """What differs between tags and trajectory in where the camera looks, in words.

    `said` holds the photos whose tags state angles at all.
    """
    import numpy as np

    from georef_gis.frames import rotation_angle

    both = [name for name in poses if name in tags and name in said]
    if len(both) < 3:
        return []
    apart = [
        math.degrees(rotation_angle(tags[n].R_enu_from_cam @ poses[n].R_enu_from_cam.T))
        for n in both
    ]
    middle = float(np.median(apart))
    if middle < MOUNT_DIFFERENCE:
        return []
    return [
        f"tags and trajectory differ by {middle:.0f} deg in where the camera looks: check "
        "[mount] image_top and looks, set gimbal = true for a gimbal, or the axes of the IMU"
    ]


def levelled(pose: Pose, shift: float, tag: Pose | None) -> Pose:
    """Pose whose height belongs to the ground: the log's, or shifted onto the tags' level."""
    import numpy as np

    if shift == 0.0 or tag is None:
        return replace(pose, height_kind="ellipsoidal (log)")
    # over a ground that hangs below the tags, the height over it is as good as theirs
    sigma, own = math.sqrt(tag.covariance[2, 2]), math.sqrt(pose.covariance[2, 2])
    scale = np.ones(6)
    scale[2] = min(1.0, sigma / own)
    return replace(
        pose,
        origin_enu=pose.origin_enu + np.array([0.0, 0.0, shift]),
        covariance=pose.covariance * np.outer(scale, scale),
        sigma_height_shared=tag.sigma_height_shared,
        height_kind=tag.height_kind,
    )
