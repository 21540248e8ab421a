"""One sigma of linear functions of measured points, without laying out all their covariances.

Of a line of thousands of points the joint covariance would fill the memory; each leg depends on two
of them, and the whole line on what the poses, the ground and the clicks add up to.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import bsr_array, csr_array

from georef_gis.frames import Array
from georef_gis.measure.measured import MeasuredPoints, photos_in
from georef_gis.model.photo_stack import Ints

# functions that are looked at together; they depend on few photos and places
_PART = 64
# places whose heights are compared with those of all others at once
_MOST_PLACES = 512


def sigmas_of(points: MeasuredPoints, rows: csr_array) -> tuple[Array, Array]:
    """One sigma of linear functions of n points.

    Parameters
    ----------
    rows : shape (q, 3 n)
        Derivatives by the places in enu.

    Returns
    -------
    together, apart : shape (q,)
        By the joint covariance, and as if the points shared no error.
    """
    parts = [rows[i : i + _PART] for i in range(0, rows.shape[0], _PART)]
    none = np.zeros(0)
    together = np.concatenate([none, *(_variances(points, part) for part in parts)])
    apart = _by_point(points.each, rows)
    return np.sqrt(np.maximum(together, 0.0)), np.sqrt(np.maximum(apart, 0.0))


def _variances(points: MeasuredPoints, rows: csr_array) -> Array:
    return _by_photos(points, rows) + _by_ground(points, rows) + _by_point(points.own, rows)


def _by_photos(points: MeasuredPoints, rows: csr_array) -> Array:
    """Variances by the unknowns of the scene; (q,)."""
    errors = points.scene.errors
    by_unknown = csr_array(rows @ points.shared)
    photos = photos_in(by_unknown, len(points.scene.photos))
    J = by_unknown[:, errors.columns(photos)].toarray()
    return np.asarray(np.einsum("qi,qi->q", J @ errors.joint(photos), J))


def _by_ground(points: MeasuredPoints, rows: csr_array) -> Array:
    """Variances by the heights of the ground; (q,)."""
    n = len(points)
    at = np.arange(3 * n)
    heights = csr_array((points.by_height.ravel(), (at, at // 3)), shape=(3 * n, n))
    by_height = csr_array(rows @ heights).tocsc()
    used: Ints = np.flatnonzero(np.diff(by_height.indptr))
    J, xy = by_height[:, used].toarray(), points.p_enu[used, :2]
    out = np.zeros(rows.shape[0])
    for first in range(0, len(used), _MOST_PLACES):
        part = slice(first, first + _MOST_PLACES)
        K = points.scene.ground.between(xy[part], xy)
        out += np.einsum("qa,qa->q", J[:, part], J @ K.T)
    return out


def _by_point(blocks: Array, rows: csr_array) -> Array:
    """Variances by what points do not share, (n, 3, 3); (q,)."""
    n = len(blocks)
    each = bsr_array((blocks, np.arange(n), np.arange(n + 1)), shape=(3 * n, 3 * n))
    return np.asarray((csr_array(rows @ each) * rows).sum(axis=1)).ravel()
