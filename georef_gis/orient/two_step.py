"""Boresight and lever arm by the two-step procedure of the 2012 paper.

First an aerial triangulation or resection gives every photo's exterior orientation; then it is
compared with the navigation's pose of the same exposure, photo by photo, and averaged.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from georef_gis.errors import AdjustmentError, InputError
from georef_gis.frames import (
    R_PHOTO_FROM_CAM,
    Array,
    exp_so3,
    log_so3,
    opk_from_R_map_from_photo,
    skew,
)
from georef_gis.model.pose import Mount, Pose

# Body axes of the paper are right, forward, up.
R_PAPER_FROM_BODY: Array = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
# of 6 degrees of freedom, 99.9 %
CHI2_6 = 22.458
# photos from which an outlying one can be told from the others
FEWEST_TO_TEST = 5
_ROUNDS = 20


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NavigationPose:
    """The navigation's pose at one exposure.

    Parameters
    ----------
    p_enu : shape (3,), m
        Of the IMU.
    R_enu_from_body : shape (3, 3)
        Body is forward, right, down.
    covariance : shape (6, 6)
        Of (dp_enu m, dtheta_enu rad), ``R_true = Exp(dtheta_enu) R``.
    """

    photo_id: str
    p_enu: Array
    R_enu_from_body: Array
    covariance: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MountSample:
    """Lever arm and boresight that one photo gives.

    Parameters
    ----------
    lever_arm_body : shape (3,), m
        From the IMU to the projection centre, forward, right, down.
    R_body_from_cam : shape (3, 3)
    covariance : shape (6, 6)
        Of (lever arm m, dtheta_body rad), ``R_true = Exp(dtheta_body) R_body_from_cam``.
    by_navigation : shape (6, 6)
        Derivatives of these six by the navigation's (dp_enu, dtheta_enu).
    """

    photo_id: str
    lever_arm_body: Array
    R_body_from_cam: Array
    covariance: Array
    by_navigation: Array

    def residual(self, lever_arm_body: Array, R_body_from_cam: Array) -> Array:
        """This less a mount: lever arm, m, and rotation vector, rad, body axes; shape (6,)."""
        turn = log_so3(self.R_body_from_cam @ R_body_from_cam.T)
        return np.concatenate([self.lever_arm_body - lever_arm_body, turn])


@dataclass(frozen=True, slots=True, kw_only=True)
class MountRow:
    """Line of the paper's Table 4 or 5: `sd` is of one photo, `sd_mean` of the value."""

    quantity: str
    unit: str
    value: float
    sd: float
    sd_mean: float
    photos: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MountEstimate:
    """Lever arm and boresight of several photos together.

    Parameters
    ----------
    covariance : shape (6, 6)
        Of (lever arm m, dtheta_body rad): honest where joint covariances were given.
    covariance_independent : shape (6, 6)
        The same as if the photos' errors had nothing in common, as the weighted mean assumes.
    residuals : shape (n, 6)
        Photo minus mean: lever arm m, rotation vector rad, body axes.
    scatter : shape (6,)
        Standard deviation of one photo, m and rad, body axes; NaN for one photo.
    sigma0
        Of unit weight; the covariances are scaled by it where it is > 1 with more than 30
        degrees of freedom.
    left_out
        Reason by photo.
    """

    lever_arm_body_camera: Array
    R_body_from_cam: Array
    covariance: Array
    covariance_independent: Array
    samples: tuple[MountSample, ...]
    residuals: Array
    scatter: Array
    sigma0: float
    left_out: Mapping[str, str] = field(default_factory=dict)
    doubts: tuple[str, ...] = ()

    def mount(self, before: Mount) -> Mount:
        """Mount with the estimate put in; nominal rotation and antenna stay."""
        sd = np.sqrt(np.diag(self.covariance))
        turn = self.R_body_from_cam @ before.R_body_from_cam_nominal.T
        return replace(
            before,
            lever_arm_body_camera=self.lever_arm_body_camera,
            boresight_body=log_so3(turn),
            sigma_lever_arm=float(sd[:3].max()),
            sigma_boresight=float(sd[3:].max()),
        )

    def to_table(self) -> tuple[MountRow, ...]:
        """Rows in the form of Tables 4 and 5: axes right, forward, up; omega, phi, kappa in deg.

        Omega, phi and kappa are those of the boresight matrix from photo axes (x right, y up, z
        backwards) to the body, zero for a camera looking down with the image's top forward.
        """
        n = len(self.samples)
        arm = R_PAPER_FROM_BODY @ self.lever_arm_body_camera
        J = np.zeros((6, 6))
        J[:3, :3] = R_PAPER_FROM_BODY
        opk, J_opk = _paper_angles(self.R_body_from_cam)
        J[3:, 3:] = J_opk
        sd_mean = np.sqrt(np.diag(J @ self.covariance @ J.T))
        own = self.residuals @ J.T
        sd = np.sqrt(np.sum(own**2, axis=0) / (n - 1)) if n > 1 else np.full(6, math.nan)
        values = np.concatenate([arm, opk])
        names = ("X", "Y", "Z", "Omega", "Phi", "Kappa")
        rows = []
        for i, name in enumerate(names):
            factor, unit = (1.0, "m") if i < 3 else (math.degrees(1.0), "deg")
            rows.append(
                MountRow(
                    quantity=name,
                    unit=unit,
                    value=float(values[i] * factor),
                    sd=float(sd[i] * factor),
                    sd_mean=float(sd_mean[i] * factor),
                    photos=n,
                )
            )
        return tuple(rows)


def _paper_angles(R_body_from_cam: Array) -> tuple[Array, Array]:
    """Omega, phi, kappa, rad, and their derivatives by a left rotation error in body axes."""

    def angles(R: Array) -> Array:
        return opk_from_R_map_from_photo(R_PAPER_FROM_BODY @ R @ R_PHOTO_FROM_CAM.T)

    h = 1e-6
    steps = exp_so3(h * np.eye(3))
    columns = [
        np.angle(np.exp(1j * (angles(step @ R_body_from_cam) - angles(step.T @ R_body_from_cam))))
        / (2 * h)
        for step in steps
    ]
    return angles(R_body_from_cam), np.column_stack(columns)


def mount_sample(orientation: Pose, navigation: NavigationPose) -> MountSample:
    """Lever arm and boresight of one photo (equations 2 to 4 of the paper).

    Notes
    -----
    R_body_from_cam = R_enu_from_body^T R_enu_from_cam and a = R_enu_from_body^T (C - p). With
    left errors of both rotations, da = R^T (dC - dp) + R^T [C - p] dtheta_nav and
    dtheta_body = R^T (dtheta_cam - dtheta_nav).
    """
    R = navigation.R_enu_from_body
    arm = orientation.origin_enu - navigation.p_enu
    turn = np.kron(np.eye(2), R.T)
    by_navigation = np.asarray(-turn, dtype=np.float64)
    by_navigation[:3, 3:] = R.T @ skew(arm)
    C = turn @ orientation.covariance @ turn.T
    C = C + by_navigation @ navigation.covariance @ by_navigation.T
    return MountSample(
        photo_id=navigation.photo_id,
        lever_arm_body=R.T @ arm,
        R_body_from_cam=R.T @ orientation.R_enu_from_cam,
        covariance=C,
        by_navigation=by_navigation,
    )


def two_step(
    orientations: Mapping[str, Pose],
    navigation: Sequence[NavigationPose],
    *,
    joint_navigation: Array | None = None,
) -> MountEstimate:
    """Mean over photos, weighted by their covariances, outlying photos left out.

    Parameters
    ----------
    orientations
        Exterior orientation by photo, of an aerial triangulation or resections that did not use
        the navigation.
    navigation
        The navigation's poses; photos without an orientation are left out.
    joint_navigation : shape (6 n, 6 n)
        Joint covariance of the navigation's errors in the order of `navigation` (see
        `Trajectory.chain`). The mean is the same; its covariance then is honest: the photos of one
        flight share the slow errors of GNSS, which a mean over them does not take away.

    Raises
    ------
    AdjustmentError
        If no photo has both.
    InputError
        If a covariance is not positive definite.
    """
    places = [i for i, one in enumerate(navigation) if one.photo_id in orientations]
    if not places:
        raise AdjustmentError(
            "no photo has both an orientation and a pose of the navigation; check the photos' names"
        )
    samples = [mount_sample(orientations[navigation[i].photo_id], navigation[i]) for i in places]
    weights = [_weight(sample) for sample in samples]
    kept, left_out = _test(samples, weights)
    samples = [samples[i] for i in kept]
    weights = [weights[i] for i in kept]
    arm, R = _mean(samples, weights)
    joint = None
    if joint_navigation is not None:
        joint = _with_shared(
            samples, [navigation[places[i]] for i in kept], joint_navigation,
            [places[i] for i in kept],
        )  # fmt: skip
    gain = np.linalg.inv(np.sum(weights, axis=0)) @ np.hstack(weights)
    independent = np.linalg.inv(np.sum(weights, axis=0))
    covariance = independent if joint is None else gain @ joint @ gain.T
    residuals = np.array([sample.residual(arm, R) for sample in samples])
    return estimate_of(samples, residuals, (arm, R), covariance, independent, left_out)


def estimate_of(
    samples: Sequence[MountSample],
    residuals: Array,
    mean: tuple[Array, Array],
    covariance: Array,
    independent: Array,
    left_out: Mapping[str, str],
) -> MountEstimate:
    """Estimate with its sigma0, scatter and doubts; see `MountEstimate`."""
    n = len(samples)
    chi2 = sum(
        float(r @ np.linalg.solve(s.covariance, r)) for r, s in zip(residuals, samples, strict=True)
    )
    sigma0 = math.sqrt(chi2 / (6 * n - 6)) if n > 1 else math.nan
    scale = sigma0**2 if 6 * n - 6 > 30 and sigma0 > 1.0 else 1.0
    scatter = np.sqrt(np.sum(residuals**2, axis=0) / (n - 1)) if n > 1 else np.full(6, math.nan)
    doubts = [f"photo {photo}: {reason}" for photo, reason in left_out.items()]
    if scale > 1.5**2:
        doubts.append(
            f"the photos differ by {sigma0:.1f} times their sigmas; these are scaled up by it"
        )
    if 6 * n - 6 > 30 and sigma0 < 0.5:
        doubts.append(
            f"the photos agree {1 / sigma0:.1f} times better than their sigmas: these hold errors "
            "that the photos share, and which a mean does not take away"
        )
    if n < 3:
        doubts.append(f"{n} photos only: an outlying one cannot be told")
    return MountEstimate(
        lever_arm_body_camera=mean[0],
        R_body_from_cam=mean[1],
        covariance=scale * covariance,
        covariance_independent=scale * independent,
        samples=tuple(samples),
        residuals=residuals,
        scatter=scatter,
        sigma0=sigma0,
        left_out=dict(left_out),
        doubts=tuple(doubts),
    )


def _weight(sample: MountSample) -> Array:
    try:
        np.linalg.cholesky(sample.covariance)
    except np.linalg.LinAlgError as error:
        raise InputError(
            "the covariances of orientation and navigation are not positive definite; give sigmas "
            "> 0",
            source=f"photo {sample.photo_id}",
        ) from error
    return np.asarray(np.linalg.inv(sample.covariance))


def _mean(samples: Sequence[MountSample], weights: Sequence[Array]) -> tuple[Array, Array]:
    """Weighted mean; rotations by repeated means of the rotation vectors from the last one."""
    arm, R = samples[0].lever_arm_body, samples[0].R_body_from_cam
    total = np.sum(weights, axis=0)
    for _ in range(_ROUNDS):
        r = [sample.residual(arm, R) for sample in samples]
        step = np.linalg.solve(
            total, np.sum([w @ x for w, x in zip(weights, r, strict=True)], axis=0)
        )
        arm, R = arm + step[:3], exp_so3(step[3:]) @ R
        if np.linalg.norm(step) < 1e-13:
            break
    return np.asarray(arm), np.asarray(R)


def _test(
    samples: Sequence[MountSample], weights: Sequence[Array]
) -> tuple[list[int], dict[str, str]]:
    """Photos that agree with the others, and reasons against the rest.

    The spread of the photos is taken from the median of their distances, which wrong ones do not
    pull; the median of chi-square with 6 degrees of freedom is 5.348.
    """
    kept = list(range(len(samples)))
    left_out: dict[str, str] = {}
    while len(kept) >= FEWEST_TO_TEST:
        arm, R = _mean([samples[i] for i in kept], [weights[i] for i in kept])
        r = [samples[i].residual(arm, R) for i in kept]
        d2 = np.array([x @ weights[i] @ x for i, x in zip(kept, r, strict=True)])
        limit = CHI2_6 * max(1.0, float(np.median(d2)) / 5.348)
        worst = int(np.argmax(d2))
        if d2[worst] <= limit:
            break
        x = r[worst]
        left_out[samples[kept[worst]].photo_id] = (
            f"differs from the others by {np.linalg.norm(x[:3]):.2f} m and "
            f"{math.degrees(np.linalg.norm(x[3:])):.2f} deg; left out"
        )
        del kept[worst]
    return kept, left_out


def _with_shared(
    samples: Sequence[MountSample],
    navigation: Sequence[NavigationPose],
    joint: Array,
    places: Sequence[int],
) -> Array:
    """Joint covariance of the samples; shape (6 n, 6 n)."""
    n = len(samples)
    out = np.zeros((n, 6, n, 6))
    blocks = joint.reshape(len(joint) // 6, 6, len(joint) // 6, 6)
    for a in range(n):
        for b in range(n):
            A, B = samples[a].by_navigation, samples[b].by_navigation
            out[a, :, b, :] = A @ blocks[places[a], :, places[b], :] @ B.T
        # the orientation's own part of the sample
        A = samples[a].by_navigation
        out[a, :, a, :] += samples[a].covariance - A @ navigation[a].covariance @ A.T
    return out.reshape(6 * n, 6 * n)


def joint_of(navigation: Sequence[NavigationPose], times: Array, *, tau: float) -> Array:
    """Joint covariance of the navigation's errors that fade with exp(-dt / tau), tau in s.

    For logs without one of their own; a trajectory's `chain` gives a better one. Shape (6 n, 6 n).
    """
    roots = [np.linalg.cholesky(one.covariance) for one in navigation]
    n = len(navigation)
    fading = np.exp(-np.abs(np.asarray(times)[:, None] - np.asarray(times)) / tau)
    out = np.einsum("ab,aij,bkj->aibk", fading, roots, roots)
    return np.asarray(out.reshape(6 * n, 6 * n))
