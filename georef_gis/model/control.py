"""Control and check points: as surveyed, as marked in photos, and as an adjustment takes them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from georef_gis.frames import Array
from georef_gis.geodesy import CRS, Datum, HeightKind
from georef_gis.model.tie_points import Indices

Role = Literal["control", "check", "off"]
ROLES: tuple[Role, ...] = ("control", "check", "off")
# m and px, one sigma where a file states none: a GNSS survey; a careful click
SIGMA_SURVEYED = 0.02
SIGMA_CLICKED = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class ControlPoint:
    """A surveyed point in its file's CRS: x east, y north; sigmas in m. No height is None."""

    name: str
    easting: float
    northing: float
    height: float | None
    sigma_h: float = SIGMA_SURVEYED
    sigma_v: float = SIGMA_SURVEYED
    role: Role = "control"
    # file and line, for messages
    source: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Mark:
    """Pixel of a point in a photo; (0, 0) is the centre of the first pixel.

    Parameters
    ----------
    photo
        Its name as the file writes it.
    sigma_px
        One sigma of u and of v that no other mark has, px.
    shared_px
        One sigma, px of this photo, of what all marks of the point that have one err by alike:
        they were matched from one click, which may have missed what it means.
    on_ground
        Whether the spot lies on the ground, so that the ground's height tells of it too.
    """

    name: str
    photo: str
    u: float
    v: float
    sigma_px: float = SIGMA_CLICKED
    source: str = ""
    shared_px: float = 0.0
    on_ground: bool = False

    @property
    def whole_px(self) -> float:
        """One sigma of the mark taken alone, px."""
        return math.hypot(self.sigma_px, self.shared_px)

    def kept_px(self, rays: int) -> float:
        """One sigma, px, for who takes the marks of the `rays` photos of a point as independent.

        Their mean is then as unsure in the plan as it is, and in the height less sure than it is:
        what is taken as independent falls with the root of their number.
        """
        return math.hypot(self.sigma_px, self.shared_px * math.sqrt(rays))


@dataclass(frozen=True, slots=True, kw_only=True)
class Control:
    """Points of one file with its CRS, datum and kind of height, and marks; heights in m.

    Parameters
    ----------
    height_unit
        Length of the unit of the heights as written, m, where it is stated: they are in m then.
        None = not stated: they are as written.
    order_open
        Whether the file does not say which coordinate comes first.
    doubts
        What was wrong in the file, one line each.
    """

    crs: CRS
    datum: Datum
    height_kind: HeightKind
    geoid: str
    points: tuple[ControlPoint, ...]
    marks: tuple[Mark, ...] = ()
    doubts: tuple[str, ...] = ()
    height_unit: float | None = 1.0
    order_open: bool = False
    format: str = "georef"

    def saying(self, *lines: str) -> Control:
        """Control with more doubts."""
        return replace(self, doubts=(*self.doubts, *lines))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ControlObservations:
    """Control and check points in enu and their marks in photos of the project.

    Parameters
    ----------
    names, role
        Of the n points.
    p_enu : shape (n, 3), m
        In the datum of the positions. Where there is no height, that of the ground stands here.
    sigma : shape (n, 3), m
        One standard deviation; inf upwards where there is no height.
    photo_ids, point : shape (m,)
        Photo of each mark, and index of its point.
    uv : shape (m, 2), px
        (0, 0) is the centre of the first pixel of the stored array.
    sigma_px : shape (m,), px
    source
        File and line of each mark, for messages.
    sigma_shared : shape (3,), m
        One standard deviation of a shift of all points together: a datum that is not stated.
    """

    names: tuple[str, ...]
    role: tuple[Role, ...]
    p_enu: Array
    sigma: Array
    photo_ids: tuple[str, ...]
    point: Indices
    uv: Array
    sigma_px: Array
    source: tuple[str, ...]
    sigma_shared: Array

    def __post_init__(self) -> None:
        """Check shapes and ranges."""
        n, m = len(self.names), len(self.photo_ids)
        if len(self.role) != n or self.p_enu.shape != (n, 3) or self.sigma.shape != (n, 3):
            raise ValueError("names, role, p_enu and sigma must tell of as many points")
        if self.point.shape != (m,) or self.uv.shape != (m, 2) or self.sigma_px.shape != (m,):
            raise ValueError("photo_ids, point, uv and sigma_px must tell of as many marks")
        if len(self.source) != m or self.sigma_shared.shape != (3,):
            raise ValueError("source must tell of as many marks, sigma_shared of three axes")
        if m and (self.point.min() < 0 or self.point.max() >= n):
            raise ValueError("point counts points that are not there")
        if not (np.all(np.isfinite(self.p_enu)) and np.all(np.isfinite(self.uv))):
            raise ValueError("p_enu and uv must be finite")
        if not (np.all(self.sigma > 0) and np.all(self.sigma_px > 0)):
            raise ValueError("sigmas must be positive")

    @property
    def has_height(self) -> NDArray[np.bool_]:
        """Whether each point has a height; shape (n,)."""
        return np.isfinite(self.sigma[:, 2])

    def with_marks(self, keep: NDArray[np.bool_]) -> ControlObservations:
        """All points, and those marks; keep has shape (m,)."""
        kept = np.flatnonzero(keep)
        return replace(
            self,
            photo_ids=tuple(self.photo_ids[k] for k in kept),
            point=self.point[kept],
            uv=self.uv[kept],
            sigma_px=self.sigma_px[kept],
            source=tuple(self.source[k] for k in kept),
        )

    def of_role(self, *roles: Role) -> ControlObservations:
        """Points of these roles, and their marks."""
        kept = [i for i, role in enumerate(self.role) if role in roles]
        number = np.full(len(self.names), -1, dtype=np.int32)
        number[kept] = np.arange(len(kept), dtype=np.int32)
        marks = self.with_marks(number[self.point] >= 0)
        return replace(
            marks,
            names=tuple(self.names[i] for i in kept),
            role=tuple(self.role[i] for i in kept),
            p_enu=self.p_enu[kept],
            sigma=self.sigma[kept],
            point=number[marks.point],
        )
