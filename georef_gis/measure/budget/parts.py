"""Errors that photos share, taken apart by source: of tags, of a trajectory, of an adjustment.

Like `JointErrors`, each kind of pose answers for pairs of photos, source by source.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from georef_gis.frames import Array, exp_so3, skew
from georef_gis.model.joint_errors import JointErrors
from georef_gis.model.photo import OrientedPhoto
from georef_gis.model.photo_stack import Ints
from georef_gis.model.pose import Mount
from georef_gis.model.trajectory import StateChain

# Of the errors of a trajectory, and of what all exposures share, as the navigation keeps them.
TRAJECTORY_SOURCES = ("gnss",) * 3 + ("attitude",) * 3
MOUNT_SOURCES = ("lever_arm",) * 3 + ("boresight",) * 3 + ("datum",) * 3
# of the sigmas; a remainder below it is rounding
_ROUNDING = 1e-9


class PairSplit(Protocol):
    """Sources of the pose errors of some photos of a stack."""

    def pairs(self, a: Ints, b: Ints) -> Mapping[str, Array]:
        """Source -> cross covariances (m, 6, 6) of pairs of photos, by their index in the stack."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FixedSplit:
    """Poses that know nothing of each other; `by_source` holds (n, 6, 6) of all photos."""

    by_source: Mapping[str, Array]

    def pairs(self, a: Ints, b: Ints) -> Mapping[str, Array]:
        """Source -> cross covariances of pairs, (m, 6, 6)."""
        same = (a == b)[:, None, None]
        return {s: np.where(same, part[a], 0.0) for s, part in self.by_source.items()}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TagSplit:
    """Poses by tags.

    What mount and datum give is known, and the same in all photos of a flight; what they leave
    of the angles is the attitude's, what is left of the place the receiver's, a camera's height
    over the ground included.

    Parameters
    ----------
    errors
        Joint errors of the photos: what is to be split.
    levers : shape (K, 3), m
        From what the tag's position is of to the camera, in enu.
    sigma_boresight, sigma_lever_arm, sigma_datum
        rad, m, m.
    """

    errors: JointErrors
    levers: Array
    sigma_boresight: float
    sigma_lever_arm: float
    sigma_datum: float

    @classmethod
    def of(
        cls, errors: JointErrors, mount: Mount, *, sigma_datum: float,
        turned_deg: Mapping[str, int] | None = None,
    ) -> TagSplit:  # fmt: skip
        """Split by a mount; `turned_deg` tells of pixels turned clockwise after the exposure."""
        turned = turned_deg or {}
        levers = [lever_enu(p, mount, turned.get(p.id, 0)) for p in errors.stack.photos]
        return cls(
            errors=errors, levers=np.array(levers).reshape(-1, 3),
            sigma_boresight=mount.sigma_boresight, sigma_lever_arm=mount.sigma_lever_arm,
            sigma_datum=sigma_datum,
        )  # fmt: skip

    def pairs(self, a: Ints, b: Ints) -> Mapping[str, Array]:
        """Source -> cross covariances of pairs, (m, 6, 6)."""
        total = self.errors.pose_pairs(a, b)
        # photos of another flight share nothing
        related = np.any(total, axis=(1, 2))[:, None, None]
        turn = np.broadcast_to(np.eye(3), (len(self.levers), 3, 3))
        G = np.concatenate([-skew(self.levers), turn], axis=1)
        left, right = G[a], np.swapaxes(G[b], 1, 2)
        angle = total[:, 3:, 3:]
        boresight = self._boresight()[a] * self._boresight()[b]
        boresight = np.where(related, boresight[:, None, None] * np.eye(3), 0.0)
        out = {
            "attitude": left @ (angle - boresight) @ right,
            "boresight": left @ boresight @ right,
        }
        known = self._place(related, a, b)
        out |= known
        out["gnss"] = total - np.asarray(sum(out.values()))
        return out

    def _boresight(self) -> Array:
        """One sigma of the boresight that each photo's angles have room for, rad; (K,)."""
        least = np.linalg.eigvalsh(self.errors.stack.covariance[:, 3:, 3:])[:, 0]
        return np.asarray(np.sqrt(np.clip(least, 0.0, self.sigma_boresight**2)))

    def _place(self, related: Array, a: Ints, b: Ints) -> dict[str, Array]:
        """Parts of lever arm and datum that each photo's place has room for."""
        place = np.einsum("kii->ki", self.errors.stack.covariance)[:, :3]
        wanted = np.array([self.sigma_datum**2] * 2 + [0.0]) + self.sigma_lever_arm**2
        room = np.clip(place / np.where(wanted > 0, wanted, 1.0), 0.0, 1.0)
        root = np.sqrt(room[a] * room[b])
        out = {}
        for source, variance in (
            ("lever_arm", [self.sigma_lever_arm**2] * 3),
            ("datum", [self.sigma_datum**2] * 2 + [0.0]),
        ):
            part = np.zeros((len(a), 6, 6))
            part[:, [0, 1, 2], [0, 1, 2]] = root * np.array(variance)
            out[source] = np.where(related, part, 0.0)
        return out


def lever_enu(photo: OrientedPhoto, mount: Mount, turned_deg: int) -> Array:
    """From what a tag's position is of to the camera, enu m; (3,)."""
    tag = photo.photo.geotag
    if tag is None or tag.of == "camera":
        return np.zeros(3)
    R_enu_cam = photo.pose.R_enu_from_cam @ exp_so3([0.0, 0.0, np.radians(turned_deg)])
    return np.asarray(R_enu_cam @ mount.R_body_from_cam.T @ mount.antenna_to_camera_body)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ChainSplit:
    """Poses by a trajectory, as `navigation/exposures.npz` keeps them.

    Parameters
    ----------
    place : shape (K,)
        Number of each photo of the stack among the n exposures, -1 for others.
    cross
        Joint covariance of the trajectory's errors (dp_ned, dtheta_ned), (n, 6, n, 6).
    to_pose, mount, mount_covariance, own
        (n, 6, 6), (n, 6, 9), (9, 9), (n, 6, 6).
    scale : shape (n, 6)
        What the errors were multiplied by as the poses were kept.
    """

    place: Ints
    cross: Array
    to_pose: Array
    mount: Array
    mount_covariance: Array
    own: Array
    scale: Array

    @classmethod
    def of(cls, exposures: Mapping[str, Array], errors: JointErrors) -> ChainSplit:
        """Split by the columns of the file."""
        ids = {str(key): i for i, key in enumerate(exposures["ids"])}
        place = np.array([ids.get(p.id, -1) for p in errors.stack.photos], dtype=np.int64)
        chain = StateChain(
            time=exposures["time"], covariance=exposures["covariance"], gain=exposures["gain"]
        )
        n = len(ids)
        out = cls(
            place=place, cross=chain.joint().reshape(n, 6, n, 6), to_pose=exposures["to_pose"],
            mount=exposures["mount"], mount_covariance=exposures["mount_covariance"],
            own=exposures["own"], scale=np.ones((n, 6)),
        )  # fmt: skip
        here = np.flatnonzero(place >= 0)
        stated = sum(out.pairs(here, here).values())
        up = np.einsum("kii->ki", np.asarray(stated))[:, 2]
        kept = errors.pose_pairs(here, here)[:, 2, 2]
        # heights may have been set onto the level of the tags
        out.scale[place[here], 2] = np.sqrt(np.where(up > 0, kept / np.where(up > 0, up, 1.0), 1.0))
        return out

    def pairs(self, a: Ints, b: Ints) -> Mapping[str, Array]:
        """Source -> cross covariances of pairs, (m, 6, 6)."""
        i, j = self.place[a], self.place[b]
        L, M = self.to_pose, self.mount
        parts = by_blocks(self.cross[i, :, j, :], TRAJECTORY_SOURCES, L[i], L[j])
        shared = np.broadcast_to(self.mount_covariance, (len(i), 9, 9))
        for source, part in by_blocks(shared, MOUNT_SOURCES, M[i], M[j]).items():
            parts[source] = parts.get(source, 0.0) + part
        own = np.where((i == j)[:, None, None], self.own[i], 0.0)
        # a gimbal, or surer tags, hold the angles: their errors are each photo's own
        held = ~np.any(M[i, 3:, 3:6], axis=(1, 2))
        angles = np.zeros_like(own)
        angles[held, 3:, 3:] = own[held, 3:, 3:]
        parts["attitude"] = parts["attitude"] + angles
        parts["time"] = own - angles
        scale = self.scale[i][:, :, None] * self.scale[j][:, None, :]
        return {source: part * scale for source, part in parts.items()}


def by_blocks(
    covariance: Array, sources: Sequence[str], left: Array | None = None, right: Array | None = None
) -> dict[str, Array]:
    """Covariance of J x by the sources of x, and the coupling between sources.

    Parameters
    ----------
    covariance : shape (..., n, n)
        Of x, or between an x and another.
    sources
        Source of each x.
    left, right : shape (..., m, n)
        J of the one and of the other; without them x itself.
    """
    names = np.array(sources)
    J = np.eye(len(names)) if left is None else left
    K = np.swapaxes(J if right is None else right, -1, -2)
    out, alone = {}, np.zeros_like(covariance)
    for source in dict.fromkeys(sources):
        part = covariance * np.outer(names == source, names == source)
        alone = alone + part
        out[source] = J @ part @ K
    apart = covariance - alone
    if np.any(np.abs(apart) > _ROUNDING * np.abs(covariance).max(initial=0.0)):
        out["coupling"] = J @ apart @ K
    return out


# -- all together ------------------------------------------------------------------------------


class JointSplit(Protocol):
    """Sources of the errors of photos and cameras that were adjusted together."""

    def parts(self, columns: Ints) -> Mapping[str, Array]:
        """Source -> joint covariance of some of a scene's unknowns, zero where not adjusted."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SourcedErrors:
    """Joint errors of a scene by source.

    Parameters
    ----------
    errors
        All together.
    kinds : shape (K,)
        Number of the split that each photo belongs to, -1 where none does.
    splits
        Of poses that were not adjusted.
    adjusted
        Of poses and cameras that were.
    """

    errors: JointErrors
    kinds: Ints
    splits: tuple[PairSplit, ...] = ()
    adjusted: JointSplit | None = None

    def parts(self, photos: Ints) -> Mapping[str, Array]:
        """Source -> joint covariance as `JointErrors.joint` of these photos lays it out.

        What no split explains is the receiver's, in an adjustment the matches'.
        """
        photos = np.asarray(photos, dtype=np.int64)
        total = self.errors.joint(photos)
        n = 6 * len(photos)
        out: dict[str, Array] = {}
        if self.adjusted is not None:
            out |= self.adjusted.parts(self.errors.columns(photos))
        for i, split in enumerate(self.splits):
            for source, part in _laid_out(split, photos, self.kinds[photos] == i).items():
                grown = np.zeros_like(total)
                grown[:n, :n] = part
                out[source] = out.get(source, 0.0) + grown
        level = np.zeros_like(total)
        level[-1, -1] = total[-1, -1]
        out["level"] = out.get("level", 0.0) + level
        return _completed(out, total, n, home=self._home(photos))

    def _home(self, photos: Ints) -> str:
        """Source that takes what no split explains."""
        if self.adjusted is not None:
            return "matching"
        return "gnss" if np.all(self.kinds[photos] >= 0) else "pose"


def _laid_out(split: PairSplit, photos: Ints, mine: Array) -> dict[str, Array]:
    """Source -> (6 k, 6 k) of the photos that are a split's own."""
    at = np.flatnonzero(mine)
    if not len(at):
        return {}
    a, b = (m.ravel() for m in np.meshgrid(at, at, indexing="ij"))
    k, out = len(photos), {}
    for source, pairs in split.pairs(photos[a], photos[b]).items():
        matrix = np.zeros((k, 6, k, 6))
        matrix[a, :, b, :] = pairs
        out[source] = matrix.reshape(6 * k, 6 * k)
    return out


def _completed(
    parts: dict[str, Array], total: Array, n_pose: int, *, home: str
) -> dict[str, Array]:
    """Parts with what they leave of the whole: of poses, of cameras, of both."""
    rest = total - np.asarray(sum(parts.values()))
    pose = np.arange(len(total)) < n_pose
    of_pose, of_camera = np.outer(pose, pose), np.outer(~pose, ~pose)
    homes = (
        (home, of_pose | ~of_camera),
        ("matching" if home == "matching" else "calibration", of_camera),
    )
    scale = np.sqrt(np.maximum(np.diag(total), 0.0))
    rest = np.where(np.abs(rest) > _ROUNDING * np.outer(scale, scale), rest, 0.0)
    for source, where in homes:
        if np.any(rest[where]):
            parts[source] = parts.get(source, 0.0) + rest * where
    return {source: part for source, part in parts.items() if np.any(part)}
