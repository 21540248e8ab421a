"""Solution of the colour equations: robust least squares with priors, and hot spots."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from georef_gis.frames import Array
from georef_gis.mosaic.block_means import Samples
from georef_gis.mosaic.coarse import Mask
from georef_gis.mosaic.colour_basis import SURFACE_TERMS, TREND_POWERS
from georef_gis.mosaic.colour_normals import Equations, Layout
from georef_gis.mosaic.colour_ramps import ramps_of
from georef_gis.mosaic.colour_settings import ColourSettings
from georef_gis.mosaic.colour_surfaces import solve_surfaces
from georef_gis.mosaic.hot_spot import Spot
from georef_gis.mosaic.overlaps import Overlaps

# relative to the typical grey value; the least noise that blocks are believed to have
LEAST_NOISE = 0.004
# residuals, in noise, from which a block counts less
ROBUST = 2.0
# iterations with weights of a convex problem, which has no wrong minimum to be caught in
CONVEX = 4
# sigma of gains at most where they are alone: lens and light then pull on them, and chains drift
SIGMA_ALONE = 0.03
# by how much bands differ among each other, in parts of the sigmas
ALIKE = 0.3
# in place of a sigma of nothing, which would be a matrix that cannot be scaled
NOTHING = 1e-6
# largest change of a logarithm at which the iteration ends
CONVERGED = 5e-4


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Solution:
    """Unknowns that fit best, in units of the typical grey value.

    Parameters
    ----------
    x : shape (size, bands)
        As `layout` has them.
    spots
        Hot spots by number of flight.
    scale
        Typical grey value.
    reach
        Most oblique view, as the length of its horizontal part.
    equations
        That it was solved from.
    """

    layout: Layout
    x: Array
    spots: dict[int, Spot]
    scale: float
    reach: float
    equations: Equations | None = None


def solve(
    overlaps: Overlaps, layout: Layout, settings: ColourSettings, samples: Samples | None
) -> Solution:
    """Gains, offsets, vignettings, trends and hot spots, which show once the rest is known."""
    zero = np.zeros((layout.size, overlaps.bands))
    if not len(overlaps) or settings.mode == "none":
        return Solution(layout=layout, x=zero, spots={}, scale=1.0, reach=1.0)
    scale, reach = _typical(overlaps), _reach(overlaps)
    units = {"scale": scale, "reach": reach, "knee": settings.knee * scale}

    def solved(equations: Equations, spots: dict[int, Spot], start: Array, first: int) -> Array:
        ramps = np.zeros((overlaps.bands, 0, layout.size))
        # gains alone cannot make up for a ramp
        if samples is not None and settings.mode == "full":
            ramps = ramps_of(layout, samples, spots, **units)
        return _solved(equations, ramps, start, settings, first)

    spots: dict[int, Spot] = {}
    equations = Equations(overlaps, layout, **units, spots=spots)
    x = solved(equations, spots, zero, 0)
    if settings.mode == "full" and settings.sigma_spot:
        spots = equations.find_spots(x, _weights(equations, x, settings))
    if spots:
        # gone before its like is built: it is large
        del equations
        equations = Equations(overlaps, layout, **units, spots=spots)
        x = solved(equations, spots, x, CONVEX - 1)
    return Solution(layout=layout, x=x, spots=spots, scale=scale, reach=reach, equations=equations)


def surfaces_of(solution: Solution, settings: ColourSettings) -> Array:
    """Surfaces of the photos in what a solution leaves; (photos, 5, bands)."""
    photos, equations = solution.layout.photos, solution.equations
    bands = solution.x.shape[1]
    if equations is None or settings.mode != "full" or not settings.sigma_surface:
        return np.zeros((photos, SURFACE_TERMS, bands))
    residual, slope = equations.differences(solution.x)
    base = equations.weights(settings.blocks_per_pair)
    known = base > 0.0
    noise = noise_of(residual, known)
    weights = base * robust_weights(residual / noise, known, settings.iterations)[:, None]
    surfaces = solve_surfaces(
        equations.overlaps, photos, residual, slope, weights / noise**2, settings.sigma_surface
    )
    # a band that is clipped everywhere stays as it is
    return np.asarray(surfaces[..., None] * equations.overlaps.known_bands)


def _typical(overlaps: Overlaps) -> float:
    """Grey value that all others are relative to: twice the median."""
    middle = np.median(overlaps.value_a), np.median(overlaps.value_b)
    return max(float(np.add(*middle)), 1e-30)


def _reach(overlaps: Overlaps) -> float:
    """Length of the horizontal part of the most oblique view."""
    views = (overlaps.view_a, overlaps.view_b)
    return max(max(float(np.hypot(*v.T).max()) for v in views), 1e-3)


def _solved(
    equations: Equations, ramps: Array, x: Array, settings: ColourSettings, first: int
) -> Array:
    """Unknowns (size, bands) by least squares from a start, reweighted until they stay.

    `ramps` (bands, m, size) are combinations of unknowns that are expected to be nothing, over
    their sigma. `first` is the number of the iteration that the start counts as.
    """
    prior = _precisions(equations.layout, settings)
    base = equations.weights(settings.blocks_per_pair)
    known = base > 0.0
    for iteration in range(first, max(settings.iterations, CONVEX + 2)):
        residual, slope = equations.differences(x)
        noise = noise_of(residual, known)
        robust = robust_weights(residual / noise, known, iteration)
        weights = base * robust[:, None] / noise**2
        del residual
        before, x = x, np.empty_like(x)
        for band in range(x.shape[1]):
            matrix, right = equations.normals(band, weights[:, band], slope[:, band], prior)
            x[:, band] = _solve_one(matrix, right, ramps[band])
        if iteration > CONVEX and np.abs(x - before).max() < CONVERGED:
            break
    likely = prior / ALIKE**2
    usual = x[:, known.any(axis=0)].mean(axis=1) if known.any() else np.zeros(len(x))
    for band in np.flatnonzero(known.any(axis=0)).tolist():
        away = x[:, band] - usual
        matrix, _ = equations.normals(band, weights[:, band], slope[:, band], prior + likely)
        x[:, band] -= _solve_one(matrix, likely * away, ramps[band])
    return x


def _solve_one(matrix: Any, right: Array, ramps: Array) -> Array:
    """Unknowns of a sparse matrix to which few dense rows are added (Woodbury's identity)."""
    from scipy.sparse.linalg import splu

    factor = splu(
        matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
    )
    x = factor.solve(right)
    if not len(ramps):
        return np.asarray(x)
    pulled = factor.solve(ramps.T)
    share = np.linalg.solve(np.eye(len(ramps)) + ramps @ pulled, ramps @ x)
    return np.asarray(x - pulled @ share)


def _weights(equations: Equations, x: Array, settings: ColourSettings) -> Array:
    """Weights of blocks once unknowns (size, bands) fit, not redescending; (k, bands)."""
    residual, _ = equations.differences(x)
    base = equations.weights(settings.blocks_per_pair)
    known = base > 0.0
    return base * robust_weights(residual / noise_of(residual, known), known, CONVEX)[:, None]


def noise_of(residual: Array, known: Mask) -> Array:
    """Deviation of residuals (k, bands) without the outliers; (bands,)."""
    size = np.abs(residual)
    if known.all():
        middle = np.median(size, axis=0)
    else:
        middle = np.array(
            [np.median(s[k]) if k.any() else 0.0 for s, k in zip(size.T, known.T, strict=True)]
        )
    return np.maximum(1.4826 * middle, LEAST_NOISE)


def robust_weights(t: Array, known: Mask, iteration: int) -> NDArray[np.float64]:
    """Weights (k,) from residuals (k, bands) in units of their noise; the same for all bands.

    Equal at first, as a photo of another exposure is no outlier; then as of Huber, at last with
    no weight left for what is far off.
    """
    if iteration == 0:
        return np.ones(len(t))
    squares = np.einsum("kb,kb->k", t * known, t)
    size = np.sqrt(squares / np.maximum(known.sum(axis=1), 1))
    if iteration <= CONVEX:
        return np.asarray(1.0 / np.maximum(size / ROBUST, 1.0))
    return np.asarray((1.0 + (size / ROBUST) ** 2 / 2.0) ** -2)


def _precisions(layout: Layout, settings: ColourSettings) -> Array:
    """One over the variances expected of the unknowns; (size,)."""
    n, alone = layout.photos, settings.mode == "gain"
    sigma = np.zeros(layout.size)
    sigma[:n] = min(settings.sigma_gain, SIGMA_ALONE) if alone else settings.sigma_gain
    sigma[n : 2 * n] = settings.sigma_offset
    if not alone:
        orders = np.array([i + j for i, j in TREND_POWERS])
        for camera in range(layout.cameras):
            sigma[layout.vignetting(camera)] = settings.sigma_vignetting
        for flight in range(layout.flights):
            trend = settings.sigma_trend / orders
            sigma[layout.trend(flight)] = np.append(trend, settings.sigma_spot)
    return np.asarray(np.maximum(sigma, NOTHING) ** -2)
