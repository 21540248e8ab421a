"""Surveyed points marked in one photo: what a resection is given."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from georef_gis.errors import InputError
from georef_gis.frames import Array

# marks without which a pose needs a prior: 3 leave up to four poses, and nothing to test them by
FEWEST = 4
# marks from which a wrong one can be told from the others
FEWEST_TO_TEST = 6


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ControlMarks:
    """Known points and their pixels in one photo.

    Parameters
    ----------
    p_enu : shape (n, 3), m
    uv : shape (n, 2), px
    sigma_px : px, one sigma per axis; shape (n,) or one number
    sigma_enu : m, one sigma per axis of the points; shape (n, 3), (3,) or one number
    names : of the points, for messages
    """

    p_enu: Array
    uv: Array
    sigma_px: ArrayLike = 0.5
    sigma_enu: ArrayLike = 0.0
    names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Check shapes, finiteness and signs."""
        n = len(self.p_enu)
        if self.p_enu.shape != (n, 3) or self.uv.shape != (n, 2):
            raise ValueError("p_enu must have shape (n, 3) and uv (n, 2)")
        if not (np.all(np.isfinite(self.p_enu)) and np.all(np.isfinite(self.uv))):
            raise InputError("a coordinate of a mark is not a finite number", field="marks")
        if np.any(np.asarray(self.sigma_px) <= 0) or np.any(np.asarray(self.sigma_enu) < 0):
            raise InputError("sigmas of marks must be > 0 px, of points >= 0 m", field="marks")

    def __len__(self) -> int:
        """Number of marks."""
        return len(self.p_enu)

    def name(self, i: int) -> str:
        """Name of a mark's point."""
        return self.names[i] if i < len(self.names) else f"mark {i + 1}"

    def only(self, chosen: ArrayLike) -> ControlMarks:
        """Some of the marks."""
        k = np.flatnonzero(np.asarray(chosen, dtype=bool))
        n = len(self)
        return ControlMarks(
            p_enu=self.p_enu[k],
            uv=self.uv[k],
            sigma_px=np.broadcast_to(self.sigma_px, (n,))[k],
            sigma_enu=np.broadcast_to(self.sigma_enu, (n, 3))[k],
            names=tuple(self.name(int(i)) for i in k),
        )
