"""Boresight and lever arm from photos of known targets, taken while the vehicle stands still."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from georef_gis.errors import AdjustmentError, InputError
from georef_gis.frames import Array, exp_so3, rotation_angle
from georef_gis.model.pose import Pose
from georef_gis.orient.two_step import (
    MountEstimate,
    MountSample,
    NavigationPose,
    estimate_of,
    mount_sample,
    two_step,
)

# of the navigation's variance within a stand; the rest is its noise
SHARED = 0.98
# rad; a vehicle that turned by more did not stand
TURNED = math.radians(1.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StaticSettings:
    """What is known beside the photos.

    Parameters
    ----------
    stands
        Name of the stand of each photo by its id: the vehicle was not moved or turned during one,
        so its photos share the navigation's error. A photo without a name stands for itself.
    lever_arm_body_antenna : shape (3,), m
        From the IMU to the antenna; given, the positions are the antenna's. None: the IMU's.
    sigma_antenna : m, one sigma per axis
    sigma_common : shape (6,), m and rad, one sigma in body axes
        Errors that are the same at every stand, such as the tilt by the biases of the
        accelerometers: no photo shows them, they are added to the result.
    """

    stands: Mapping[str, str] = field(default_factory=dict)
    lever_arm_body_antenna: Array | None = None
    sigma_antenna: float = 0.0
    sigma_common: Array = field(default_factory=lambda: np.zeros(6))


def calibrate_static(
    orientations: Mapping[str, Pose],
    navigation: Sequence[NavigationPose],
    settings: StaticSettings | None = None,
) -> MountEstimate:
    """Boresight and lever arm by weighted least squares over all photos.

    Parameters
    ----------
    orientations
        Pose of each photo by resection (`resect`).
    navigation
        Attitude and position at each photo from the logs.
    settings
        Stands, antenna, errors in common.

    Raises
    ------
    AdjustmentError
        If no photo has both.
    InputError
        If a covariance is not positive definite.

    Notes
    -----
    As `two_step`, but with the full covariance: best linear unbiased estimate
    (X^T S^-1 X)^-1 X^T S^-1 y of y = the samples of all photos, X = stacked identities.
    """
    settings = settings or StaticSettings()
    first = two_step(orientations, navigation)
    by_id = {one.photo_id: one for one in navigation}
    samples = [mount_sample(orientations[s.photo_id], by_id[s.photo_id]) for s in first.samples]
    joint = _joint(samples, by_id, settings)
    try:
        inverse = np.linalg.inv(joint)
        np.linalg.cholesky(joint)
    except np.linalg.LinAlgError as error:
        raise InputError(
            "the covariances of the photos are not positive definite; give sigmas > 0",
            field="sigma",
        ) from error
    n = len(samples)
    X = np.tile(np.eye(6), (n, 1))
    Q = np.linalg.inv(X.T @ inverse @ X)
    gain = Q @ X.T @ inverse
    arm, R = first.lever_arm_body_camera, first.R_body_from_cam
    for _ in range(10):
        y = np.concatenate([sample.residual(arm, R) for sample in samples])
        step = gain @ y
        arm, R = arm + step[:3], exp_so3(step[3:]) @ R
        if np.linalg.norm(step) < 1e-13:
            break
    residuals = np.array([sample.residual(arm, R) for sample in samples])
    arm, Q = _from_antenna(arm, np.asarray(Q), settings)
    common = np.diag(np.asarray(settings.sigma_common, float) ** 2)
    independent = first.covariance_independent
    out = estimate_of(samples, residuals, (arm, R), Q + common, independent, first.left_out)
    return _with_doubts(out, by_id, settings)


def _joint(
    samples: Sequence[MountSample], navigation: Mapping[str, NavigationPose], s: StaticSettings
) -> Array:
    """Covariance of all samples, the navigation's error shared within a stand."""
    n = len(samples)
    stands = [s.stands.get(one.photo_id, f"only {one.photo_id}") for one in samples]
    out = np.zeros((n, 6, n, 6))
    for a in range(n):
        out[a, :, a, :] = samples[a].covariance
        for b in range(a + 1, n):
            if stands[a] != stands[b]:
                continue
            C_a = navigation[samples[a].photo_id].covariance
            C_b = navigation[samples[b].photo_id].covariance
            # The same error, so far as both state the same size of it.
            shared = 0.5 * SHARED * (C_a + C_b)
            block = samples[a].by_navigation @ shared @ samples[b].by_navigation.T
            out[a, :, b, :], out[b, :, a, :] = block, block.T
    return out.reshape(6 * n, 6 * n)


def _from_antenna(arm: Array, Q: Array, s: StaticSettings) -> tuple[Array, Array]:
    """Lever arm from the IMU where the positions were the antenna's."""
    if s.lever_arm_body_antenna is None:
        return arm, Q
    if np.shape(s.lever_arm_body_antenna) != (3,):
        raise AdjustmentError("the antenna's lever arm must be three numbers, m")
    added = np.zeros((6, 6))
    added[:3, :3] = s.sigma_antenna**2 * np.eye(3)
    return arm + s.lever_arm_body_antenna, Q + added


def _with_doubts(
    out: MountEstimate, navigation: Mapping[str, NavigationPose], s: StaticSettings
) -> MountEstimate:
    stands: dict[str, list[NavigationPose]] = {}
    for sample in out.samples:
        name = s.stands.get(sample.photo_id, sample.photo_id)
        stands.setdefault(name, []).append(navigation[sample.photo_id])
    doubts = list(out.doubts)
    for name, poses in stands.items():
        R = poses[0].R_enu_from_body
        turn = max(rotation_angle(pose.R_enu_from_body @ R.T) for pose in poses)
        if turn > TURNED:
            doubts.append(
                f"stand {name}: the vehicle turned by {math.degrees(turn):.1f} deg within it; give "
                "the photos after that another stand"
            )
    if len(stands) == 1 and len(out.samples) > 1:
        doubts.append(
            "all photos are of one stand: the navigation's error there goes wholly into the mount; "
            "turn the vehicle and repeat (four headings)"
        )
    if not np.any(s.sigma_common[3:5]):
        doubts.append(
            "no sigma is given for the tilt by the accelerometers' biases, which is the same at "
            "every stand and goes into the boresight"
        )
    return replace(out, doubts=tuple(doubts))
