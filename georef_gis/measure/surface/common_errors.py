"""What all heights of a surface err by together: level, tilt and bend of the block it came from."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from georef_gis.frames import Array
from georef_gis.measure.scene import Scene
from georef_gis.measure.tied_ground import tied_heights
from georef_gis.model.photo_stack import Ints

# terms of the common error: level, two tilts, three bends
TERMS = 6
# places along each side of a site at which its heights are asked for their joint covariance
_PLACES = 6
# reaches beyond which a bend is not carried on
_BEYOND = 1.5
# of the longer reach; a strip is not asked how it bends across
_NARROW = 0.1
# m, of a reach
_LEAST = 1.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CommonErrors:
    """A smooth error of height over a site: quadratic in its own axes, its terms correlated.

    Parameters
    ----------
    middle : shape (2,), m
    axes : shape (2, 2), 1/m
        From east and north to the site's longer and shorter axis, -1 to 1 over it.
    covariance : shape (6, 6), m^2
        Of level, tilts and bends.
    """

    middle: Array
    axes: Array
    covariance: Array

    @classmethod
    def level(cls, sigma: float) -> CommonErrors:
        """The same shift everywhere, of one sigma, m."""
        covariance = np.zeros((TERMS, TERMS))
        covariance[0, 0] = sigma**2
        return cls(middle=np.zeros(2), axes=np.zeros((2, 2)), covariance=covariance)

    @classmethod
    def through(cls, xy: Array, covariance: Array) -> CommonErrors:
        """Terms of errors at k places, (k, 2) m, whose joint covariance, (k, k) m^2, is known."""
        middle = xy.mean(axis=0)
        _, _, ways = np.linalg.svd(xy - middle, full_matrices=False)
        reach = np.maximum(np.abs((xy - middle) @ ways.T).max(axis=0), _LEAST)
        narrow = reach < _NARROW * reach.max()
        axes = ways / reach[:, None]
        axes[narrow] = 0.0
        terms = np.linalg.pinv(_terms((xy - middle) @ axes.T), rcond=1e-6)
        return cls(middle=middle, axes=axes, covariance=terms @ covariance @ terms.T)

    def raised(self, sigma: float) -> CommonErrors:
        """The same with a further shift of everything, of one sigma, m."""
        covariance = self.covariance.copy()
        covariance[0, 0] += sigma**2
        return CommonErrors(middle=self.middle, axes=self.axes, covariance=covariance)

    @property
    def sigma(self) -> float:
        """One sigma amid the site, m."""
        return float(np.sqrt(max(self.covariance[0, 0], 0.0)))

    def sigma_at(self, xy_enu: ArrayLike) -> Array:
        """One sigma of heights by it, m; (..., 2) m -> (...)."""
        xy = np.asarray(xy_enu, dtype=np.float64)
        B = self._terms_at(xy.reshape(-1, 2))
        return np.sqrt(_squares(B, self.covariance)).reshape(xy.shape[:-1])

    def sigma_of_rise(self, xy_enu: Array, start: Array) -> Array:
        """One sigma by it of height differences to a place (2,), m; (n, 2) -> (n,)."""
        B = self._terms_at(xy_enu) - self._terms_at(np.reshape(start, (1, 2)))
        return np.sqrt(_squares(B, self.covariance))

    def sigma_of_sum(self, xy_enu: Array, weights: Array) -> float:
        """One sigma by it of a weighted sum of heights, m times the unit of weights (n,)."""
        b = weights @ self._terms_at(xy_enu)
        return float(np.sqrt(_squares(b[None], self.covariance)[0]))

    def _terms_at(self, xy: Array) -> Array:
        return _terms(np.clip((xy - self.middle) @ self.axes.T, -_BEYOND, _BEYOND))


def _squares(B: Array, covariance: Array) -> Array:
    return np.asarray(np.maximum(np.sum((B @ covariance) * B, axis=-1), 0.0))


def _terms(t: Array) -> Array:
    x, y = t.T
    return np.column_stack([np.ones(len(t)), x, y, x * x, x * y, y * y])


def common_errors(scene: Scene, photos: Ints, p_enu: Array) -> CommonErrors | None:
    """Common error of a surface that was made of points of some photos.

    Parameters
    ----------
    scene
        With the joint errors of the poses.
    photos : shape (g,)
        From whose points it was made.
    p_enu : shape (n, 3), m
        Its points.

    Returns
    -------
    None where too few of its places are seen from two sides.
    """
    p = _spread(p_enu)
    up = np.tile([0.0, 0.0, 1.0], (len(p), 1))
    tied = tied_heights(replace(scene, ground_photos=photos), p, up)
    places = np.flatnonzero(tied.tied)
    if len(places) < TERMS:
        return None
    used = np.unique(tied.photo)
    columns = scene.errors.columns(used)
    at = np.searchsorted(used, tied.photo)
    J = np.zeros((len(p), len(columns)))
    np.add.at(J, (tied.place[:, None], 6 * at[:, None] + np.arange(6)), tied.by_pose)
    camera = np.searchsorted(columns, scene.errors.camera_columns(tied.photo))
    np.add.at(J, (tied.place[:, None], camera[:, None] + np.arange(11)), tied.by_camera)
    J = J[places]
    return CommonErrors.through(p[places, :2], J @ scene.errors.joint(used) @ J.T)


def _spread(p: Array) -> Array:
    """Of points those next to the nodes of a lattice over them, each once; (k, 3)."""
    from scipy.spatial import cKDTree

    low, high = np.quantile(p[:, :2], [0.03, 0.97], axis=0)
    t = (np.arange(_PLACES) + 0.5) / _PLACES
    nodes = low + np.stack(np.meshgrid(t, t), axis=-1).reshape(-1, 2) * (high - low)
    _, nearest = cKDTree(p[:, :2]).query(nodes)
    return np.asarray(p[np.unique(nearest)])
