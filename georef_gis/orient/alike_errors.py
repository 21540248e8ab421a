"""Means of errors that are alike in the neighbourhood: n residuals are not n witnesses."""

from __future__ import annotations

import numpy as np

from georef_gis.frames import Array

# blocks along each side in which neighbouring errors count as one, from fine to coarse
BLOCKS = (32, 16, 8, 4, 2)
# blocks below which their spread tells nothing
FEWEST_BLOCKS = 4


def scatter(r: Array) -> float:
    """Robust standard deviation of residuals about 0, by their median."""
    return float(1.4826 * np.median(np.abs(r)))


def by_blocks(xy: Array, r: Array, n: int) -> tuple[Array, Array, Array]:
    """Mean place, median and number of points of n x n square blocks."""
    low, extent = xy.min(axis=0), max(float(np.ptp(xy, axis=0).max()), 1e-6)
    cell = np.minimum(((xy - low) / extent * n).astype(int), n - 1)
    _, which = np.unique(cell[:, 0] * n + cell[:, 1], return_inverse=True)
    order = np.argsort(which, kind="stable")
    parts = np.split(order, np.flatnonzero(np.diff(which[order])) + 1)
    places = np.array([xy[i].mean(axis=0) for i in parts])
    return places, np.array([np.median(r[i]) for i in parts]), np.array([len(i) for i in parts])


def mean_over_blocks(xy: Array, r: Array) -> tuple[float, float]:
    """Robust mean of residuals, m, and one sigma of it, m, their likeness counted in.

    Parameters
    ----------
    xy : shape (n, 2), m
    r : shape (n,), m

    Notes
    -----
    The sigma is the largest that means over blocks of growing size give (Flyvbjerg & Petersen
    1989, J. Chem. Phys. 91, 461).
    """
    mean = float(np.median(r))
    # a median's own sigma is pi / 2 larger in variance than a mean's
    sigma = 1.2533 * scatter(r - mean) / np.sqrt(len(r))
    for n in BLOCKS:
        _, middle, number = by_blocks(xy, r, n)
        if len(middle) < FEWEST_BLOCKS:
            break
        weight = number / number.sum()
        about = np.sum(weight * middle)
        # few blocks: their spread is itself uncertain, by Student's t of the same coverage
        few = np.sqrt((len(middle) - 1) / max(len(middle) - 3, 1))
        together = np.sum(weight**2 * (middle - about) ** 2) * few**2
        sigma = max(sigma, float(np.sqrt(together * len(middle) / (len(middle) - 1))))
    return mean, max(sigma, 1e-3)
