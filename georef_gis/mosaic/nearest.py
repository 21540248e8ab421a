"""The photo whose nadir is nearest, everywhere."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from georef_gis.model.grid import Grid, Window
from georef_gis.mosaic.coarse import Proxy, SparseRaster

# px of a photo; every so many are enough to find how far it reaches
SAMPLE = 3


def reach_of(photo: Proxy) -> float:
    """How much farther than its nearest pixel a photo's pixels usually are from its nadir, m."""
    few = (slice(None, None, SAMPLE),) * 2
    distance = photo.distance[few][photo.valid[few]]
    return float(np.median(distance) - distance.min()) if distance.size else 0.0


class Nearest:
    """The photos that are nearest, and how much farther others may be.

    Parameters
    ----------
    lean, leeway
        See `SeamSettings`.

    Attributes
    ----------
    labels : int32
        Index of the nearest photo, -1 where there is none, until something else is written.
    """

    def __init__(self, coarse: Grid, *, lean: float, leeway: float) -> None:
        size = {"width": coarse.width, "height": coarse.height}
        self.labels = SparseRaster(**size, dtype=np.int32, fill=-1)
        self._distance = SparseRaster(**size, dtype=np.float32, fill=np.inf)
        self._lean, self._leeway = lean, leeway
        self._reaches: list[float] = []
        self._reach: float | None = None

    def add(self, index: int, photo: Proxy) -> None:
        """Take in a photo; of two as near the one that came first stays."""
        wins = photo.distance < self._distance.read(photo.window)
        self._distance.write(photo.window, photo.distance, wins)
        self.labels.write(photo.window, np.full(wins.shape, index, np.int32), wins)
        self._reaches.append(reach_of(photo))
        self._reach = None

    @property
    def reach(self) -> float:
        """Usual reach of all photos, m."""
        if self._reach is None:
            used = [reach for reach in self._reaches if reach > 0.0]
            self._reach = float(np.median(used)) if used else 1.0
        return self._reach

    def farthest(self, window: Window) -> NDArray[np.float32]:
        """How far from its nadir a photo may be that is shown in a window, m."""
        near = self._distance.read(window)
        leeway = np.float32(self._leeway * self.reach)
        return np.asarray(near + np.maximum(np.float32(self._lean) * near, leeway))
