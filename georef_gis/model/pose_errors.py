"""How the errors of poses hang together: by an adjustment, by a trajectory, or by tags.

Each kind answers one question, the covariance of the pose errors (dp_enu m, dtheta_enu rad) of
pairs of photos, from which any joint covariance is laid out (`joint_errors`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from georef_gis.frames import R_BODY_FROM_CAM_NADIR, Array
from georef_gis.model.photo import Photo
from georef_gis.model.photo_stack import Ints, PhotoStack
from georef_gis.model.trajectory import StateChain

# How errors of tags hang together, as shares of their variance: the same over the flight, slow,
# and each photo's own. A consumer receiver's error is mostly slow (2012 paper: minutes); angles of
# an autopilot have a constant part, the mount, and crab is the same along a line.
POSITION_SHARES = (0.3, 0.55, 0.15)
TILT_SHARES = (0.3, 0.65, 0.05)
YAW_SHARES = (0.2, 0.7, 0.1)
SHARES = np.array([POSITION_SHARES] * 3 + [TILT_SHARES] * 2 + [YAW_SHARES])
# s, correlation times of the slow parts
TAU = np.array([100.0] * 3 + [15.0] * 2 + [40.0])
# s; between photos whose clocks tell nothing
USUAL_INTERVAL = 3.0
# heights above ground over which errors of adjusted poses stay alike: two blocks by tags have
# correlations of 0.96 at 1 to 1.5 heights and of 0.9 at 2.5 (position)
ALIKE_HEIGHTS = 25.0
# photos up to which the joint covariance of a trajectory is laid out once
_MOST_AT_ONCE = 700


class PoseErrors(Protocol):
    """Covariance of the pose errors of some photos, counted from 0."""

    def pairs(self, a: Ints, b: Ints) -> Array:
        """Cross covariances of pairs of photos; (m,) and (m,) -> (m, 6, 6), m and rad."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DenseErrors:
    """Joint covariance as a matrix, (6 n, 6 n)."""

    matrix: Array

    def pairs(self, a: Ints, b: Ints) -> Array:
        """Cross covariances of pairs of photos; (m,) and (m,) -> (m, 6, 6)."""
        n = len(self.matrix) // 6
        return np.asarray(self.matrix.reshape(n, 6, n, 6)[a, :, b, :])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LoneErrors:
    """Poses that know nothing of each other; `covariance` (n, 6, 6)."""

    covariance: Array

    def pairs(self, a: Ints, b: Ints) -> Array:
        """Cross covariances of pairs of photos; (m,) and (m,) -> (m, 6, 6)."""
        return np.asarray(np.where((a == b)[:, None, None], self.covariance[a], 0.0))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AlikeErrors:
    """Poses of a block of which only each one's own covariance was kept.

    Errors of photos stay alike over the distance `length`, m: a stated law, not a solution. It
    makes places as unsure as they are, and distances between photos less sure than they are.
    """

    roots: Array
    places: Array
    length: float

    @classmethod
    def of(cls, stack: PhotoStack, photos: Ints, *, length: float) -> AlikeErrors:
        """Of photos of a stack by their own covariances."""
        places = stack.origin_enu[photos, :2]
        return cls(roots=roots_of(stack.covariance[photos]), places=places, length=length)

    def pairs(self, a: Ints, b: Ints) -> Array:
        """Cross covariances of pairs of photos; (m,) and (m,) -> (m, 6, 6)."""
        apart = np.linalg.norm(self.places[a] - self.places[b], axis=1)
        alike = np.exp(-apart / self.length)
        together = self.roots[a] @ np.swapaxes(self.roots[b], 1, 2)
        return np.asarray(alike[:, None, None] * together)


class ChainErrors:
    """Poses of a trajectory: its own errors, the mount's and the datum's, and each photo's time.

    Parameters
    ----------
    chain
        Errors of the trajectory at the n exposures.
    to_pose : shape (n, 6, 6)
    mount : shape (n, 6, 9)
    mount_covariance : shape (9, 9)
    own : shape (n, 6, 6)
        As `navigate.exposure_poses` keeps them.
    """

    def __init__(
        self, chain: StateChain, to_pose: Array, mount: Array, mount_covariance: Array, own: Array
    ) -> None:
        self._chain, self._to_pose, self._mount = chain, to_pose, mount
        self._mount_covariance, self._own = mount_covariance, own
        n = len(own)
        self._whole = chain.joint().reshape(n, 6, n, 6) if n <= _MOST_AT_ONCE else None

    def pairs(self, a: Ints, b: Ints) -> Array:
        """Cross covariances of pairs of photos; (m,) and (m,) -> (m, 6, 6)."""
        L, M = self._to_pose, self._mount
        out = L[a] @ self._cross(a, b) @ np.swapaxes(L[b], 1, 2)
        out += M[a] @ self._mount_covariance @ np.swapaxes(M[b], 1, 2)
        same = a == b
        out[same] += self._own[a[same]]
        return np.asarray(out)

    def _cross(self, a: Ints, b: Ints) -> Array:
        if self._whole is not None:
            return np.asarray(self._whole[a, :, b, :])
        asked, where = np.unique(np.column_stack([a, b]), axis=0, return_inverse=True)
        found = np.array([self._chain.cross(int(i), int(j)) for i, j in asked]).reshape(-1, 6, 6)
        return np.asarray(found[where.reshape(-1)])


class TagErrors:
    """Poses of one flight by tags: a part that all share, a slow one, and each photo's own.

    The covariance of each pose alone stays what it is; the shares above say how errors of two
    hang together: of positions in enu, of angles about the camera's axes.

    Parameters
    ----------
    sigma_datum : m
        Of east and north, in every pose: the same for all.
    """

    def __init__(self, stack: PhotoStack, photos: Ints, *, sigma_datum: float = 0.0) -> None:
        n = len(photos)
        self._times = times_of([stack.photos[k].photo for k in photos])
        T = np.zeros((n, 6, 6))
        T[:, :3, :3] = np.eye(3)
        T[:, 3:, 3:] = stack.R_enu_from_cam[photos] @ R_BODY_FROM_CAM_NADIR.T
        local = np.swapaxes(T, 1, 2) @ stack.covariance[photos] @ T
        sigma = np.sqrt(np.einsum("aii->ai", local))
        safe = np.where(sigma > 0.0, sigma, 1.0)
        self.roots = T @ roots_of(local)
        # what all share is no larger than the best photo allows: some may have a fixed receiver
        typical = np.sqrt(np.min(sigma**2, axis=0) * SHARES[:, 0])
        typical[:2] = np.clip(max(typical[0], sigma_datum), 0.0, sigma[:, :2].min(axis=0))
        slow2 = np.maximum((1.0 - SHARES[:, 2]) * sigma**2 - typical**2, 0.0)
        self._shared, self._slow = typical / safe, np.sqrt(slow2) / safe
        # share of each unknown's sigma that flights have in common
        self.datum = np.zeros((n, 6))
        self.datum[:, :2] = np.minimum(sigma_datum, typical[:2]) / safe[:, :2]

    def pairs(self, a: Ints, b: Ints) -> Array:
        """Cross covariances of pairs of photos; (m,) and (m,) -> (m, 6, 6)."""
        lag = np.abs(self._times[a] - self._times[b])
        alike = self._shared[a] * self._shared[b]
        alike = alike + self._slow[a] * self._slow[b] * np.exp(-lag[:, None] / TAU)
        alike[a == b] = 1.0
        return np.asarray(self.roots[a] @ (alike[:, :, None] * np.swapaxes(self.roots[b], 1, 2)))


class TagFlights:
    """Poses by tags of several flights, which have their datum in common and nothing else.

    Photos are counted flight by flight.
    """

    def __init__(self, flights: Sequence[TagErrors]) -> None:
        self._flights = flights
        counts = [len(one.roots) for one in flights]
        self._flight = np.repeat(np.arange(len(flights)), counts)
        self._first = np.concatenate([[0], np.cumsum(counts)])
        roots = np.concatenate([one.roots for one in flights])
        self._by_datum = roots * np.concatenate([one.datum for one in flights])[:, None, :]

    def pairs(self, a: Ints, b: Ints) -> Array:
        """Cross covariances of pairs of photos; (m,) and (m,) -> (m, 6, 6)."""
        out = self._by_datum[a] @ np.swapaxes(self._by_datum[b], 1, 2)
        for i, one in enumerate(self._flights):
            at = np.flatnonzero((self._flight[a] == i) & (self._flight[b] == i))
            if len(at):
                out[at] = one.pairs(a[at] - self._first[i], b[at] - self._first[i])
        return np.asarray(out)


def roots_of(covariance: Array) -> Array:
    """Roots G, G G^T = C, of covariances: sigmas times the root of the correlations; (n, k, k).

    Of neighbours alike, so that G_a G_b^T is their covariance where they err alike.
    """
    sigma = np.sqrt(np.einsum("aii->ai", covariance))
    safe = np.where(sigma > 0.0, sigma, 1.0)
    values, vectors = np.linalg.eigh(covariance / safe[:, :, None] / safe[:, None, :])
    half = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    return np.asarray(safe[:, :, None] * (half @ np.swapaxes(vectors, 1, 2)))


def times_of(photos: Sequence[Photo]) -> Array:
    """When photos were taken, s from the first; by their order where clocks tell nothing."""
    if all(photo.time_gps is not None for photo in photos):
        t = np.array([photo.time_gps for photo in photos], dtype=np.float64)
    elif all(photo.camera_clock is not None for photo in photos):
        clocks = [photo.camera_clock for photo in photos if photo.camera_clock is not None]
        first = min(clocks)
        t = np.array([(clock - first).total_seconds() for clock in clocks])
    else:
        t = np.asarray(USUAL_INTERVAL * np.arange(len(photos)))
    return np.asarray(t - t.min()) if len(t) else t
