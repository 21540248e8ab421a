"""Smooth surfaces of single photos, from what the colours that photos share leave over.

Clouds, haze and slopes brighten a part of a photo, which neither its gain nor anything that it
shares with others can say. Gains stay as they were, and a surface has no level: so brightness
cannot creep from photo to photo, as it would if surfaces and gains were solved together, whose
sum may follow any smooth course over the ground without a step anywhere.
"""

from __future__ import annotations

import numpy as np

from georef_gis.frames import Array
from georef_gis.mosaic.block_means import Indices
from georef_gis.mosaic.colour_basis import SURFACE_TERMS, surface_basis
from georef_gis.mosaic.overlaps import Overlaps
from georef_gis.mosaic.symmetric import SparseSymmetric

# blocks whose products are in memory at once
CHUNK = 20_000
# iterations of the conjugate gradients at most, and the part of the residual at which they end
ITERATIONS, PRECISE = 60, 1e-3


def solve_surfaces(
    overlaps: Overlaps,
    photos: int,
    residual: Array,
    slope: Array,
    weights: Array,
    sigma: float,
) -> Array:
    """Coefficients (photos, 5) of the logarithms' surfaces, the same for all bands.

    Parameters
    ----------
    overlaps
        Sorted by pair.
    residual, slope : shape (k, bands)
        What is left of the differences, and how fast it grows with a logarithm.
    weights : shape (k, bands)
        One over the variance; all bands together count as one.
    sigma
        Expected of the coefficients.
    """
    strength = np.asarray((weights * slope**2).mean(axis=1))
    pull = np.asarray((weights * slope * residual).mean(axis=1))
    new = np.diff(overlaps.a, prepend=-1) | np.diff(overlaps.b, prepend=-1)
    starts = np.flatnonzero(new)
    normal = np.empty((starts.size, 2 * SURFACE_TERMS, 2 * SURFACE_TERMS))
    right = np.empty((starts.size, 2 * SURFACE_TERMS))
    ends = np.append(starts[1:], len(overlaps))
    first = 0
    while first < starts.size:
        last = max(int(np.searchsorted(ends, starts[first] + CHUNK)), first + 1)
        at, pairs = slice(int(starts[first]), int(ends[last - 1])), slice(first, last)
        shapes = surface_basis(overlaps.xy_a[at]), -surface_basis(overlaps.xy_b[at])
        design = np.concatenate(shapes, axis=1)
        own = starts[pairs] - at.start
        products = (design * strength[at, None])[:, :, None] * design[:, None, :]
        normal[pairs] = np.add.reduceat(products, own)
        right[pairs] = np.add.reduceat(design * pull[at, None], own)
        first = last
    both = np.stack([overlaps.a[starts], overlaps.b[starts]])
    return _solved(both, photos, normal, -right, sigma)


def _solved(pairs: Indices, photos: int, normal: Array, right: Array, sigma: float) -> Array:
    """Surfaces from the normal equations of pairs, by conjugate gradients; (photos, 5).

    The prior keeps the matrix well conditioned, so that some ten iterations do for any number of
    photos, where a factor would fill.
    """
    from scipy.sparse.linalg import LinearOperator, cg

    terms = np.arange(SURFACE_TERMS)
    ends = slice(None, SURFACE_TERMS), slice(SURFACE_TERMS, None)
    own = np.zeros((photos, SURFACE_TERMS, SURFACE_TERMS))
    pull = np.zeros((photos, SURFACE_TERMS))
    for photo, end in zip(pairs, ends, strict=True):
        np.add.at(own, photo, normal[:, end, end])
        np.add.at(pull, photo, right[:, end])
    own += np.eye(SURFACE_TERMS) / sigma**2
    first = SURFACE_TERMS * np.arange(photos)[:, None] + terms
    low = np.tril_indices(SURFACE_TERMS)
    across = [np.broadcast_to(first[pairs[0], :, None], normal[:, ends[0], ends[1]].shape)]
    across.append(np.broadcast_to(first[pairs[1], None, :], across[0].shape))
    blocks = [(first[:, low[0]], first[:, low[1]]), (across[0], across[1])]
    pattern = SparseSymmetric(first.size, [(r.ravel(), c.ravel()) for r, c in blocks])
    matrix = pattern.filled([own[:, low[0], low[1]], normal[:, ends[0], ends[1]]])
    inverse = np.linalg.inv(own)

    def conditioned(x: Array) -> Array:
        return np.asarray(np.einsum("nij,nj->ni", inverse, x.reshape(pull.shape)).ravel())

    operator = LinearOperator(matrix.shape, matvec=conditioned, dtype=np.float64)
    x, _ = cg(matrix, pull.ravel(), rtol=PRECISE, maxiter=ITERATIONS, M=operator)
    return np.asarray(x.reshape(pull.shape))
