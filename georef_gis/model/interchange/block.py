"""A block as other programs hold it: cameras, shots and points in one world frame."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from georef_gis.errors import InputError
from georef_gis.frames import Array
from georef_gis.geodesy import HeightKind, Origin
from georef_gis.model.camera import Camera
from georef_gis.model.photo import Geotag
from georef_gis.model.tie_points import TiePoints

# px; what a format cannot hold may move no pixel of the image by more
TOLERANCE_PX = 0.01
# Key and version of our own facts in the files of others, which their programs pass over.
OWN_KEY = "georef_gis"
_OWN_VERSION = 1
_UPPER = np.triu_indices(6)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Shot:
    """A photo with its pose in the block's world.

    Parameters
    ----------
    name
        As the other program calls it: a file name, perhaps with folders before it.
    origin, R_world_from_cam : shape (3,) and (3, 3)
        Projection centre in units of the world, and rotation; camera axes are right, down, ahead.
    covariance : shape (6, 6)
        Of `(dp, dtheta)` in world axes as in `Pose`; None where the file tells none.
    time_unix : s
        Time of exposure, UTC, since 1970.
    """

    name: str
    camera_id: str
    origin: Array
    R_world_from_cam: Array
    covariance: Array | None = None
    time_unix: float | None = None

    def __post_init__(self) -> None:
        """Check shapes and that the rotation is one."""
        R = self.R_world_from_cam
        if self.origin.shape != (3,) or not np.all(np.isfinite(self.origin)):
            raise InputError("the position is not three finite numbers", source=self.name)
        if R.shape != (3, 3) or not np.allclose(R @ R.T, np.eye(3), atol=1e-6):
            raise InputError("the rotation is none", source=self.name)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BlockPoints:
    """Ground points in the block's world, and what sees them.

    Parameters
    ----------
    p : shape (n, 3)
    rgb : shape (n, 3), 0 to 255; None = not known
    error_px : shape (n,), px
        Reprojection error; None = not known.
    ties
        Observations; `photo_ids` are the names of the shots and `point` counts `p`.
    """

    p: Array
    rgb: NDArray[np.uint8] | None = None
    error_px: Array | None = None
    ties: TiePoints | None = None

    def __post_init__(self) -> None:
        """Check shapes."""
        n = len(self.p)
        if self.p.shape != (n, 3) or (self.rgb is not None and self.rgb.shape != (n, 3)):
            raise ValueError("p and rgb must be (n, 3)")
        if self.error_px is not None and self.error_px.shape != (n,):
            raise ValueError("error_px must tell of as many points")
        if self.ties is not None and self.ties.n_points != n:
            raise ValueError(f"ties tell of {self.ties.n_points} points, p of {n}")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Similarity:
    """`p_to = scale * R_to_from @ p_from + shift`, with its covariance.

    `covariance` (7, 7) is that of `(ds / s, dtheta, dp)`: the true scale is `s (1 + ds / s)`, the
    true rotation `Exp(dtheta) R_to_from`, and dp (m) the error of where `pivot` (3,), a place in
    the frame it comes from, is put.
    """

    scale: float
    R_to_from: Array
    shift: Array
    pivot: Array = field(default_factory=lambda: np.zeros(3))
    covariance: Array = field(default_factory=lambda: np.zeros((7, 7)))

    def apply(self, p: ArrayLike) -> Array:
        """Places in the frame it leads to; shape (..., 3)."""
        return np.asarray(self.scale * np.asarray(p, float) @ self.R_to_from.T + self.shift)

    def covariance_at(self, p: ArrayLike) -> Array:
        """Covariance of a place and of directions there, `(dp, dtheta)`, by it alone; (6, 6)."""
        arm = self.scale * self.R_to_from @ (np.asarray(p, float) - self.pivot)
        x, y, z = arm
        J = np.zeros((6, 7))
        J[:3, 0] = arm
        J[:3, 1:4] = [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]
        J[:3, 4:] = np.eye(3)
        J[3:, 1:4] = np.eye(3)
        return np.asarray(J @ self.covariance @ J.T)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Block:
    """Cameras, shots and points in one world.

    Parameters
    ----------
    cameras
        By the id that the shots name.
    origin
        The world is the topocentric frame (enu, m) of this place; None = a frame of its own, of
        unknown scale.
    height_kind
        What the height of `origin` is measured from.
    datum
        Realisation of `origin`, or ``unknown``.
    positions
        Where shots are on the Earth by a file beside a block that has no origin, by name.
    """

    cameras: Mapping[str, Camera]
    shots: tuple[Shot, ...]
    origin: Origin | None = None
    height_kind: HeightKind = HeightKind.UNKNOWN
    datum: str = "unknown"
    points: BlockPoints | None = None
    positions: Mapping[str, Geotag] = field(default_factory=dict)
    source: str = ""

    @property
    def centres(self) -> Array:
        """Projection centres; shape (n, 3)."""
        return np.array([shot.origin for shot in self.shots]).reshape(-1, 3)

    def placed(self, how: Similarity, origin: Origin, height_kind: HeightKind) -> Block:
        """The block moved into the topocentric frame of a place."""
        turn = np.kron(np.eye(2), how.R_to_from)
        turn[:3] *= how.scale

        def covariance(shot: Shot) -> Array:
            own = np.zeros((6, 6)) if shot.covariance is None else shot.covariance
            return np.asarray(turn @ own @ turn.T + how.covariance_at(shot.origin))

        shots = tuple(
            replace(
                shot,
                origin=how.apply(shot.origin),
                R_world_from_cam=how.R_to_from @ shot.R_world_from_cam,
                covariance=covariance(shot),
            )
            for shot in self.shots
        )
        points = None if self.points is None else replace(self.points, p=how.apply(self.points.p))
        return replace(
            self, shots=shots, points=points, origin=origin, height_kind=height_kind, positions={}
        )


# -- what no format of others holds ---------------------------------------------------------------


def own_facts(block: Block) -> dict[str, Any]:
    """Frame, heights and covariances of a block, for JSON.

    Raises
    ------
    InputError
        If the block has no origin.
    """
    if block.origin is None:
        raise InputError("the block has no place on the Earth", source=block.source)
    covariances = {
        shot.name: shot.covariance[_UPPER].tolist()
        for shot in block.shots
        if shot.covariance is not None
    }
    return {
        "version": _OWN_VERSION,
        "frame": "east, north, up in m, topocentric at the origin",
        "origin": lla_of(block.origin),
        "crs_of_origin": "EPSG:4979",
        "height_kind": str(block.height_kind),
        "datum": block.datum,
        "covariance_terms": "21 of the upper triangle by rows of (dp_enu m, dtheta_enu rad), "
        "R_true = Exp(dtheta) R",
        "covariances": covariances,
    }


def with_own_facts(block: Block, facts: Any, source: str) -> Block:
    """Block with what `own_facts` wrote of it.

    Raises
    ------
    InputError
        If it cannot be read.
    """
    try:
        if facts["version"] != _OWN_VERSION:
            raise InputError(f"version {facts['version']} is not known", source=source)
        given = facts.get("covariances", {})
        shots = tuple(
            replace(shot, covariance=_symmetric(given[shot.name])) if shot.name in given else shot
            for shot in block.shots
        )
        return replace(
            block,
            shots=shots,
            origin=origin_of(facts["origin"], source),
            height_kind=HeightKind(facts["height_kind"]),
            datum=str(facts.get("datum", "unknown")),
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(
            f"the frame cannot be read ({error}); export the block again or remove the file",
            source=source,
        ) from error


def _symmetric(terms: Sequence[float]) -> Array:
    out = np.zeros((6, 6))
    out[_UPPER] = np.array(terms, dtype=np.float64)
    return np.asarray(out + np.triu(out, 1).T)


def lla_of(origin: Origin) -> dict[str, float]:
    """Latitude, longitude (-180 to 180) in deg and altitude in m of an origin."""
    return {
        "latitude": math.degrees(origin.lat),
        "longitude": math.degrees(math.remainder(origin.lon, 2.0 * math.pi)),
        "altitude": origin.height_ellipsoidal,
    }


def origin_of(lla: Any, source: str) -> Origin:
    """Origin of what `lla_of` or OpenSfM's `reference_lla` tells.

    Raises
    ------
    InputError
        If a number is missing or impossible.
    """
    try:
        lat, lon, h = (float(lla[key]) for key in ("latitude", "longitude", "altitude"))
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            "needs latitude, longitude and altitude as numbers", source=source, field="origin"
        ) from error
    if not (abs(lat) <= 90.0 and abs(lon) <= 360.0 and math.isfinite(h)):
        raise InputError(
            f"latitude {lat:g}, longitude {lon:g}, height {h:g} m is not on the Earth; "
            "latitude and longitude are in degrees",
            source=source,
            field="origin",
        )
    return Origin(lat=math.radians(lat), lon=math.radians(lon), height_ellipsoidal=h)


# -- what formats can hold --------------------------------------------------------------------


def without_skew(camera: Camera, program: str) -> Camera:
    """Camera without the skew `b2`, with `b1` in `fx`: for formats that have neither.

    Raises
    ------
    InputError
        If the skew moves a pixel by more than `TOLERANCE_PX`.
    """
    rows = np.array([-0.5 - camera.cy, camera.height - 0.5 - camera.cy]) / camera.fy
    effect = abs(camera.b2) * float(np.max(np.abs(rows)))
    if effect > TOLERANCE_PX:
        raise InputError(
            f"the skew b2 = {camera.b2:g} px moves pixels by up to {effect:.2f} px and {program} "
            "has no skew; adjust the camera without b2, or export poses as a table",
            source=f"camera {camera.id}",
            field="b2",
        )
    return replace(camera, fx=camera.fx + camera.b1, b1=0.0, b2=0.0)


def losses(camera: Camera, program: str) -> tuple[str, ...]:
    """What a program's file leaves out of a camera, in words."""
    out = []
    if camera.b2 != 0.0:
        out.append(f"camera {camera.id}: {program} has no skew; b2 = {camera.b2:g} px is left out")
    if camera.readout_s != 0.0:
        out.append(
            f"camera {camera.id}: {program} has no rolling shutter; the readout of "
            f"{camera.readout_s * 1e3:.1f} ms is left out"
        )
    return tuple(out)


def refuse_model(camera: Camera, program: str, known: Sequence[str]) -> InputError:
    """Error for a camera whose model a program does not have."""
    return InputError(
        f"{program} has no model like '{camera.model}'; calibrate as {' or '.join(known)}, or "
        "export poses as a table",
        source=f"camera {camera.id}",
        field="model",
    )
