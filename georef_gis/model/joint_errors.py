"""What all measurements of a project share: the errors of poses, cameras and the level.

The unknowns, in this order: poses, 6 each, (dp_enu m, dtheta_enu rad); cameras, 11 each, after
`CAMERA_NAMES`; the level that photos and ground share, in its own sigmas. Errors are "true minus
stated".
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from georef_gis.frames import Array
from georef_gis.model.camera import Camera
from georef_gis.model.photo_stack import Ints, PhotoStack
from georef_gis.model.pixel_derivatives import CAMERA_UNKNOWNS, turned_camera_jacobian
from georef_gis.model.pose_errors import DenseErrors, LoneErrors, PoseErrors

# k1 k2 k3 p1 p2 of a lens nobody calibrated, and of one that is stated
SIGMA_LENS = (0.05, 0.05, 0.02, 1e-3, 1e-3)
SIGMA_LENS_STATED = (0.01, 0.01, 0.01, 3e-4, 3e-4)


def camera_sigmas(camera: Camera) -> Array:
    """One sigma of each of a camera's unknowns by what it says of itself; shape (11,).

    One without a sigma of focal length and principal point is taken as known exactly, lens and
    all. Readout, affinity and skew count as known.
    """
    out = np.zeros(CAMERA_UNKNOWNS)
    if camera.sigma_f == 0.0 and camera.sigma_c == 0.0:
        return out
    out[:3] = camera.sigma_f, camera.sigma_c, camera.sigma_c
    stated = any((camera.k1, camera.k2, camera.k3, camera.p1, camera.p2))
    lens = SIGMA_LENS_STATED if stated else SIGMA_LENS
    if camera.model == "fisheye_pix4d":
        # it has a polynomial of its own
        return out
    out[3:8] = lens
    if camera.model == "fisheye":
        out[6:8] = 0.0
    return out


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PoseSource:
    """Photos whose errors hang together, and how; those of other sources are independent.

    `photos` (n,) are indices in the stack, in the order in which `errors` counts.
    """

    photos: Ints
    errors: PoseErrors
    # in words, for people
    kind: str = ""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraErrors:
    """Joint errors of the sensors, and how the photos' cameras hang on them.

    Parameters
    ----------
    ids
        Of the C sensors.
    covariance : shape (11 C, 11 C)
    sensor_of : shape (K,)
        Sensor of each photo.
    turns : shape (K,)
        Quarter turns clockwise of each picture against its sensor.
    with_poses : shape (K, 6, 11 C)
        Covariance with the pose of each photo; None where they are independent.
    """

    ids: tuple[str, ...]
    covariance: Array
    sensor_of: Ints
    turns: Ints
    with_poses: Array | None = None

    @classmethod
    def stated(cls, stack: PhotoStack, sensors: Mapping[str, Camera] | None = None) -> CameraErrors:
        """By what the cameras say of themselves; `sensors`, by id, where pictures were turned."""
        known = dict(sensors or {})
        for photo in stack.photos:
            known.setdefault(photo.camera.id, photo.camera)
        ids = tuple(dict.fromkeys(photo.camera.id for photo in stack.photos))
        sigma = np.concatenate([camera_sigmas(known[key]) for key in ids] or [np.zeros(0)])
        turn = {c: quarters_of(c, known[c.id]) for c in stack.cameras}
        return cls(
            ids=ids,
            covariance=np.diag(sigma**2),
            sensor_of=np.array([ids.index(p.camera.id) for p in stack.photos], dtype=np.int64),
            turns=np.array([turn[p.camera] for p in stack.photos], dtype=np.int64),
        )


def quarters_of(camera: Camera, sensor: Camera) -> int:
    """Quarter turns clockwise that make a sensor's camera that of a picture; 0 if none does."""
    for quarters in (1, 2, 3):
        if camera != sensor and not (sensor.b2 and quarters % 2):
            turned = sensor.turned(90 * quarters)
            if np.allclose(turned.parameters, camera.parameters, rtol=0.0, atol=1e-9):
                return quarters
    return 0


class JointErrors:
    """Covariance of the unknowns that measurements share.

    Parameters
    ----------
    stack
        K photos.
    sources
        Each photo in at most one; one that is in none knows nothing of the others.
    cameras
        By default what the cameras say of themselves.
    """

    def __init__(
        self,
        stack: PhotoStack,
        sources: Sequence[PoseSource] = (),
        cameras: CameraErrors | None = None,
    ) -> None:
        self.stack = stack
        self.cameras = cameras or CameraErrors.stated(stack)
        n = len(stack)
        self._source, self._place = np.full(n, -1), np.zeros(n, dtype=np.int64)
        for i, source in enumerate(sources):
            self._source[source.photos] = i
            self._place[source.photos] = np.arange(len(source.photos))
        alone = np.flatnonzero(self._source < 0)
        rest = PoseSource(photos=alone, errors=LoneErrors(covariance=stack.covariance[alone]))
        self._source[alone], self._place[alone] = len(sources), np.arange(len(alone))
        self.sources = (*sources, rest) if len(alone) else tuple(sources)
        self._turn = np.array([turned_camera_jacobian(q) for q in range(4)])

    @classmethod
    def of_matrix(cls, stack: PhotoStack, covariance: Array) -> JointErrors:
        """Of a joint covariance (6 K, 6 K) of all poses, cameras by what they say."""
        source = PoseSource(photos=np.arange(len(stack)), errors=DenseErrors(matrix=covariance))
        return cls(stack, [source])

    @property
    def size(self) -> int:
        """Number of unknowns: 6 K + 11 C + 1."""
        return 6 * len(self.stack) + CAMERA_UNKNOWNS * len(self.cameras.ids) + 1

    @property
    def known_together(self) -> bool:
        """Whether it is known of every photo how its errors hang together with those of others."""
        return not any(isinstance(s.errors, LoneErrors) for s in self.sources)

    def camera_columns(self, photo: Ints) -> Ints:
        """First unknown of the camera of each photo; (m,) -> (m,)."""
        return np.asarray(
            6 * len(self.stack) + CAMERA_UNKNOWNS * self.cameras.sensor_of[np.asarray(photo)]
        )

    def by_sensor(self, photo: Ints, by_camera: Array) -> Array:
        """Derivatives by the sensor from those by the camera of the stored picture; (m, i, 11)."""
        return np.asarray(by_camera @ self._turn[self.cameras.turns[np.asarray(photo)]])

    def level_sigma(self, photo: Ints) -> Array:
        """One sigma of a shift of photo and ground together, m; (m,) -> (m,)."""
        shared = np.array([p.pose.sigma_height_shared for p in self.stack.photos])
        return np.asarray(shared[np.asarray(photo)])

    def pose_pairs(self, a: Ints, b: Ints) -> Array:
        """Cross covariances of the pose errors of pairs of photos; (m,) and (m,) -> (m, 6, 6)."""
        out = np.zeros((len(a), 6, 6))
        both = self._source[a]
        for i, source in enumerate(self.sources):
            at = np.flatnonzero((both == i) & (self._source[b] == i))
            if len(at):
                out[at] = source.errors.pairs(self._place[a[at]], self._place[b[at]])
        return out

    def blocks(self, photos: Ints) -> Array:
        """Joint covariances of the poses of r photos each and of all cameras.

        Parameters
        ----------
        photos : shape (n, r)

        Returns
        -------
        shape (n, 6 r + 11 C, 6 r + 11 C)
        """
        n, r = photos.shape
        size = 6 * r + len(self.cameras.covariance)
        out = np.empty((n, size, size))
        out[:, 6 * r :, 6 * r :] = self.cameras.covariance
        i, j = np.triu_indices(r)
        pairs = self.pose_pairs(photos[:, i].ravel(), photos[:, j].ravel())
        pairs = pairs.reshape(n, len(i), 6, 6)
        poses = np.empty((n, r, 6, r, 6))
        poses[:, j, :, i] = pairs.transpose(1, 0, 3, 2)
        poses[:, i, :, j] = pairs.transpose(1, 0, 2, 3)
        across = self._with_cameras(photos.ravel()).reshape(n, 6 * r, size - 6 * r)
        out[:, : 6 * r, : 6 * r] = poses.reshape(n, 6 * r, 6 * r)
        out[:, : 6 * r, 6 * r :] = across
        out[:, 6 * r :, : 6 * r] = np.swapaxes(across, 1, 2)
        return out

    def _with_cameras(self, photo: Ints) -> Array:
        kept = self.cameras.with_poses
        if kept is None:
            return np.zeros((len(photo), 6, len(self.cameras.covariance)))
        return np.asarray(kept[photo])

    def joint(self, photos: ArrayLike) -> Array:
        """Joint covariance of the poses of k photos, all cameras and the level (its square 1).

        Returns
        -------
        shape (6 k + 11 C + 1, 6 k + 11 C + 1)
        """
        k = np.asarray(photos, dtype=np.int64)
        a, b = (m.ravel() for m in np.meshgrid(k, k, indexing="ij"))
        n, c = 6 * len(k), len(self.cameras.covariance)
        out = np.zeros((n + c + 1, n + c + 1))
        pairs = self.pose_pairs(a, b).reshape(len(k), len(k), 6, 6)
        out[:n, :n] = np.swapaxes(pairs, 1, 2).reshape(n, n)
        out[:n, n : n + c] = self._with_cameras(k).reshape(n, c)
        out[n : n + c, :n] = out[:n, n : n + c].T
        out[n : n + c, n : n + c] = self.cameras.covariance
        out[-1, -1] = 1.0
        return out

    def columns(self, photos: ArrayLike) -> Ints:
        """Indices of the unknowns that `joint` of these photos speaks of, in its order."""
        k = np.asarray(photos, dtype=np.int64)
        poses = (6 * k[:, None] + np.arange(6)).ravel()
        return np.concatenate([poses, np.arange(6 * len(self.stack), self.size)])
