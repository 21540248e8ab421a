"""What goes into an adjustment: photos, observations, control, and what is known beforehand."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from georef_gis.errors import AdjustmentError
from georef_gis.frames import Array
from georef_gis.model.camera import Camera
from georef_gis.model.pose import Pose
from georef_gis.model.tie_points import TiePoints
from georef_gis.orient.adjustment.kernels import CAMERA_UNKNOWNS

# Unknowns of a camera, in order; f moves fx and fy alike, b1 moves the scale of u alone.
CAMERA_NAMES = ("f", "cx", "cy", "k1", "k2", "k3", "p1", "p2", "b1", "b2", "readout_s")
# Unknowns of a flight, in order.
FLIGHT_NAMES = (
    "lever_x", "lever_y", "lever_z", "boresight_x", "boresight_y", "boresight_z",
    "bias_e", "bias_n", "bias_u", "clock",
)  # fmt: skip
FLIGHT_UNKNOWNS = len(FLIGHT_NAMES)
# photos from which on a block is kept as a band, and joint covariances are asked for by parts
LARGE = 300
# independent heights for which a ground counts that nobody measured
INDEPENDENT = 10.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraPrior:
    """A camera and one sigma of each of its unknowns, after `CAMERA_NAMES`; 0 holds one fast."""

    camera: Camera
    sigma: Array

    def __post_init__(self) -> None:
        """Check the shape and the model."""
        if self.sigma.shape != (CAMERA_UNKNOWNS,) or np.any(self.sigma < 0):
            raise ValueError(f"camera {self.camera.id}: sigma must be 11 numbers >= 0")
        if self.camera.model != "brown":
            raise ValueError(f"camera {self.camera.id}: model {self.camera.model}, not brown")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FlightPrior:
    """What the navigation of a flight, or its tags, know of the poses: one joint prior.

    The pose error that the navigation leaves, ``(dp_enu, dtheta_enu)`` of each photo, is a joint
    normal of `covariance` plus the sum over what all photos of the flight share (`FLIGHT_NAMES`):
    lever arm (body, m), boresight (body, rad), bias (enu, m) and clock (s, how much later a photo
    was taken than its pose says).

    Parameters
    ----------
    id
        Flight.
    photos : shape (n,)
        Indices of the flight's photos in the block, each photo in one flight.
    covariance : shape (6 n, 6 n)
        Of the pose errors without what is shared; `white` included. None for a long flight,
        which has `joint` instead.
    white : shape (n, 6, 6)
        The part of it that is each photo's own; grows where a photo contradicts the others.
    R_enu_from_body : shape (n, 3, 3)
    velocity_enu, rate_enu : shape (n, 3), m/s and rad/s
        Zero where unknown, and then the clock cannot be estimated.
    shared_covariance : shape (10, 10)
        A zero on the diagonal holds an unknown fast.
    times : shape (n,), s
        Of the exposures, from any zero.
    joint
        Joint covariance of some of the photos, by their places in `photos`: (k,) -> (6 k, 6 k).
    """

    id: str
    photos: NDArray[np.int64]
    covariance: Array | None
    white: Array
    R_enu_from_body: Array
    velocity_enu: Array
    rate_enu: Array
    shared_covariance: Array
    times: Array | None = None
    joint: Callable[[NDArray[np.int64]], Array] | None = None

    def __post_init__(self) -> None:
        """Check shapes."""
        n = len(self.photos)
        if self.covariance is None and (self.joint is None or self.times is None):
            raise ValueError(f"flight {self.id}: covariance, or joint and times, must be given")
        whole = self.covariance is None or self.covariance.shape == (6 * n, 6 * n)
        if not whole or self.white.shape != (n, 6, 6):
            raise ValueError(f"flight {self.id}: covariance must be (6 n, 6 n), white (n, 6, 6)")
        if self.shared_covariance.shape != (FLIGHT_UNKNOWNS, FLIGHT_UNKNOWNS):
            raise ValueError(f"flight {self.id}: shared_covariance must be 10 x 10")

    def whole_covariance(self) -> Array:
        """Joint covariance of all photos, (6 n, 6 n), also of a long flight."""
        if self.covariance is not None:
            return self.covariance
        if self.joint is None:
            raise ValueError(f"flight {self.id}: has no covariance")
        return self.joint(np.arange(len(self.photos)))

    def sigmas(self) -> Array:
        """One sigma of each pose error without what is shared; (n, 6), m and rad."""
        n = len(self.photos)
        if self.covariance is not None:
            return np.asarray(np.sqrt(np.diag(self.covariance)).reshape(n, 6))
        if self.joint is None:
            raise ValueError(f"flight {self.id}: has no covariance")
        each = [np.diag(self.joint(np.array([i]))) for i in range(n)]
        return np.asarray(np.sqrt(np.array(each)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ControlInput:
    """Surveyed points and their pixels.

    Parameters
    ----------
    names
        Of the points.
    p_enu : shape (n, 3), m
    sigma : shape (n, 3), m
        Infinite where a coordinate is not known.
    used : shape (n,)
        Whether the surveyed place takes part; check points are intersected, no more.
    photo, point : shape (m,)
        Indices of the photo and the point of each mark.
    uv : shape (m, 2), px
    sigma_px : shape (m,)
    """

    names: tuple[str, ...]
    p_enu: Array
    sigma: Array
    used: NDArray[np.bool_]
    photo: NDArray[np.int64]
    point: NDArray[np.int64]
    uv: Array
    sigma_px: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GroundPrior:
    """Heights that the ground is expected at, for points that cameras see under small angles.

    Parameters
    ----------
    z_enu : shape (n,), m
        Expected up coordinate of each tie point; NaN where nothing is known.
    sigma : m
        Of one height, or of each, shape (n,); relief included.
    independent
        As how many independent heights all of them together count: relief is alike over a site.
    sigma_offset : m
        One sigma of what all the heights lie off by together, an unknown of its own; 0 without.
    surface
        A measured surface, from east, north (n, 2) m to its up coordinate (n,) m, NaN outside.
        Once points are found, their heights on it take the place of `z_enu` (`weigh_ground`).
    sigma_surface : m
        One sigma of the surface, over distances as long as the site.
    sigma_free, sigma_other : m
        One sigma of what the surface as a whole may lie off, and of points beside it or not on it.
    """

    z_enu: Array
    sigma: float | Array
    independent: float = INDEPENDENT
    sigma_offset: float = 0.0
    surface: Callable[[Array], Array] | None = None
    sigma_surface: float = 0.0
    sigma_free: float = 0.0
    sigma_other: float = 0.0

    def selected(self, keep: NDArray[np.bool_]) -> GroundPrior:
        """That of some of the points; `keep` (n,)."""
        sigma = self.sigma[keep] if isinstance(self.sigma, np.ndarray) else self.sigma
        return replace(self, z_enu=self.z_enu[keep], sigma=sigma)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Block:
    """All that an adjustment is made of.

    Parameters
    ----------
    photo_ids
        In the order that all indices count.
    poses
        Where the navigation or the tags put each photo.
    start
        Where the search begins; the same unless the pixels told better (headings).
    camera_of : shape (n,)
        Index of each photo's camera.
    sigma_level : m
        One sigma of the height that photos and ground share; only control sees it.
    """

    photo_ids: tuple[str, ...]
    poses: tuple[Pose, ...]
    camera_of: NDArray[np.int64]
    cameras: tuple[CameraPrior, ...]
    flights: tuple[FlightPrior, ...]
    ties: TiePoints
    start: tuple[Pose, ...] = ()
    control: ControlInput | None = None
    ground: GroundPrior | None = None
    sigma_level: float = 0.0
    # what was decided on the way, for people
    notes: tuple[str, ...] = field(default=())

    def __post_init__(self) -> None:
        """Check that every photo has one camera and one flight."""
        n = len(self.photo_ids)
        if len(self.poses) != n or self.camera_of.shape != (n,) or n == 0:
            raise AdjustmentError("an adjustment needs a pose and a camera for every photo")
        seen = np.concatenate([flight.photos for flight in self.flights] or [np.zeros(0, int)])
        if not np.array_equal(np.sort(seen), np.arange(n)):
            raise ValueError("every photo must belong to one flight")
        if self.ties.photo_ids != self.photo_ids:
            raise ValueError("the tie points count other photos")

    @property
    def n_shared(self) -> int:
        """Number of unknowns that several photos share."""
        return CAMERA_UNKNOWNS * len(self.cameras) + FLIGHT_UNKNOWNS * len(self.flights) + 2

    @property
    def sigma_shifts(self) -> tuple[float, float]:
        """One sigma of the surface's offset and of the level, m; 0 where it is held."""
        return (self.ground.sigma_offset if self.ground is not None else 0.0, self.sigma_level)

    def camera_at(self, index: int) -> int:
        """Where the unknowns of a camera begin among the shared ones."""
        return CAMERA_UNKNOWNS * index

    def flight_at(self, index: int) -> int:
        """Where the unknowns of a flight begin among the shared ones."""
        return CAMERA_UNKNOWNS * len(self.cameras) + FLIGHT_UNKNOWNS * index

    @property
    def shared_names(self) -> list[str]:
        """Names of the shared unknowns, such as "flight1 boresight_x"."""
        names = [f"{p.camera.id} {name}" for p in self.cameras for name in CAMERA_NAMES]
        names += [f"{flight.id} {name}" for flight in self.flights for name in FLIGHT_NAMES]
        return [*names, "surface_offset", "level"]


def camera_vector(camera: Camera) -> Array:
    """Parameters as the kernels take them: fx fy cx cy k1 k2 k3 p1 p2 b1 b2 readout_s; (12,)."""
    return np.append(camera.parameters, camera.readout_s)


def moved_camera_vector(vector: Array, step: Array) -> Array:
    """Camera vector after a step of the 11 unknowns; shape (12,)."""
    out = vector.copy()
    out[:2] += step[0]
    out[2:] += step[1:]
    return out


def joined_observations(
    ties: TiePoints, control: ControlInput | None
) -> tuple[TiePoints, NDArray[np.int64]]:
    """Tie points and, behind them, control points as further points.

    Returns
    -------
    observations
        Sorted by point, then by photo.
    mark_of : shape (m,)
        Index of the mark of each observation, -1 for a tie point.
    """
    photo, point = ties.photo.astype(np.int64), ties.point.astype(np.int64)
    uv, sigma = ties.uv, ties.sigma
    mark = np.full(len(photo), -1)
    if control is not None and len(control.photo):
        seen, number = np.unique(control.point, return_inverse=True)
        del seen
        photo = np.concatenate([photo, control.photo])
        point = np.concatenate([point, ties.n_points + number])
        uv = np.concatenate([uv, control.uv])
        sigma = np.concatenate([sigma, control.sigma_px])
        mark = np.concatenate([mark, np.arange(len(control.photo))])
    order = np.lexsort((photo, point))
    joined = TiePoints(
        photo_ids=ties.photo_ids,
        photo=photo[order].astype(np.int32),
        point=point[order].astype(np.int32),
        uv=np.ascontiguousarray(uv[order]),
        sigma=np.ascontiguousarray(sigma[order]),
    )
    return joined, mark[order]


def marked_points(control: ControlInput | None) -> Sequence[int]:
    """Indices of the control points that have marks, in the order of `joined_observations`."""
    if control is None or not len(control.photo):
        return []
    return [int(i) for i in np.unique(control.point)]
