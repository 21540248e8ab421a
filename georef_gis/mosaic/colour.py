"""Colour of a mosaic: exposure, white balance, vignetting and hot spot, solved from overlaps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from georef_gis.frames import Array
from georef_gis.mosaic.colour_basis import (
    TREND_POWERS,
    radial_basis,
    trend_basis,
)
from georef_gis.mosaic.colour_normals import Equations, Layout
from georef_gis.mosaic.hot_spot import Spot, Values
from georef_gis.mosaic.overlaps import Overlaps

Mode = Literal["full", "gain", "none"]

# relative to the typical grey value; the least noise that blocks are believed to have
LEAST_NOISE = 0.004
# residuals, in noise, from which a block counts less
ROBUST = 2.0
# iterations with weights of a convex problem, which has no wrong minimum to be caught in
CONVEX = 4
# sigma of gains at most where they are alone: lens and light then pull on them, and chains drift
SIGMA_ALONE = 0.03
# in place of a sigma of nothing, which would be a matrix that cannot be scaled
NOTHING = 1e-6
# largest change of a logarithm at which the iteration ends
CONVERGED = 5e-4


@dataclass(frozen=True, slots=True, kw_only=True)
class ColourSettings:
    """What to solve for, and how far from nothing it is expected; sigmas are one deviation.

    What the overlaps do not tell stays at nothing, as the sigmas are finite.

    Parameters
    ----------
    mode
        "full"; "gain": the photos' gains and offsets only; "none": grey values stay.
    sigma_gain
        Of the logarithm of a photo's gain. The larger, the longer a chain of photos may drift;
        the smaller, the less a lasting change of exposure is followed.
    sigma_offset
        Of a photo's offset, relative to the typical grey value. 0 = none, for linear radiometry.
    sigma_vignetting
        Of each coefficient of the logarithm, at the photo's corners.
    sigma_trend
        Of a coefficient of the first order of the logarithm, at the most oblique view; that of
        order n is an n-th of it.
    sigma_spot
        Of the logarithm of the hot spot's height; 0 = none is looked for.
    blocks_per_pair
        Independent blocks that a pair is worth at most.
    iterations
        At most.
    """

    mode: Mode = "full"
    sigma_gain: float = 0.5
    sigma_offset: float = 0.01
    sigma_vignetting: float = 0.3
    sigma_trend: float = 0.3
    sigma_spot: float = 0.1
    blocks_per_pair: float = 25.0
    iterations: int = 20


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ColourModel:
    """Corrections of grey values: corrected = value x factor + offset.

    Parameters
    ----------
    gain : shape (photos, bands)
        Natural logarithm.
    offsets : shape (photos, bands)
        Grey values.
    vignetting : shape (3, bands) per camera
        Coefficients of the logarithm, see `radial_basis`.
    trend : shape (15, bands) per flight
        Coefficients of the logarithm, see `trend_basis`.
    spots
        Where the hot spot is, for flights that have one: horizontal part (east, north) of the unit
        vector to the sun.
    camera_of, flight_of
        Of each photo.
    reach
        Most oblique view that took part, as the length of its horizontal part.
    """

    gain: Array
    offsets: Array
    vignetting: Mapping[str, Array]
    trend: Mapping[str, Array]
    spots: Mapping[str, Spot]
    camera_of: tuple[str, ...]
    flight_of: tuple[str, ...]
    reach: float = 1.0

    @property
    def bands(self) -> int:
        """Number of bands."""
        return int(self.gain.shape[1])

    def factor(self, photo: int, xy: Values, view: Values) -> Array:
        """Factors of a photo's grey values.

        Parameters
        ----------
        xy : shape (..., 2)
            Place in the photo, from the principal point, in half diagonals.
        view : shape (..., 2)
            Horizontal part (east, north) of the unit vector from the ground to the camera.

        Returns
        -------
        array : shape (..., bands)
        """
        flight = self.flight_of[photo]
        radial, trend = self.vignetting[self.camera_of[photo]], self.trend[flight]
        log = np.broadcast_to(self.gain[photo], (*np.shape(xy)[:-1], self.bands))
        if radial.any():
            log = log + radial_basis(xy) @ radial
        if trend.any():
            log = log + trend_basis(view, self.reach, self.spots.get(flight)) @ trend
        return np.asarray(np.exp(log))

    def offset(self, photo: int) -> Array:
        """What is added to a photo's grey values after the factor; (bands,)."""
        return np.asarray(self.offsets[photo])

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return {
            "gain": self.gain.tolist(),
            "offsets": self.offsets.tolist(),
            "vignetting": {k: v.tolist() for k, v in self.vignetting.items()},
            "trend": {k: v.tolist() for k, v in self.trend.items()},
            "spots": {k: list(v) for k, v in self.spots.items()},
            "camera_of": list(self.camera_of),
            "flight_of": list(self.flight_of),
            "reach": self.reach,
            "bands": self.bands,
        }

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> ColourModel:
        """Model of plain data."""

        def table(rows: Any) -> Array:
            return np.array(rows, dtype=np.float64).reshape(-1, data["bands"])

        return cls(
            gain=table(data["gain"]),
            offsets=table(data["offsets"]),
            vignetting={k: table(v) for k, v in data["vignetting"].items()},
            trend={k: table(v) for k, v in data["trend"].items()},
            spots={k: (float(v[0]), float(v[1])) for k, v in data["spots"].items()},
            camera_of=tuple(data["camera_of"]),
            flight_of=tuple(data["flight_of"]),
            reach=float(data["reach"]),
        )


def solve_colour(
    overlaps: Overlaps,
    n_photos: int,
    camera_of: Sequence[str],
    flight_of: Sequence[str],
    settings: ColourSettings,
) -> ColourModel:
    """Gains and offsets of all photos, vignetting of cameras, view trend of flights, jointly.

    Robust: what moves, shines or has a shadow that moves counts little. Vignetting and trend are
    nothing in the middle of a photo and at the nadir, and gains spread about nothing, so that the
    brightness of the whole stays.

    Parameters
    ----------
    camera_of, flight_of
        Names of each photo's camera and flight.
    """
    cameras, flights = sorted(set(camera_of)), sorted(set(flight_of))
    layout = Layout(
        camera=_numbers(camera_of, cameras),
        flight=_numbers(flight_of, flights),
        cameras=len(cameras),
        flights=len(flights),
    )
    scale, reach, x = 1.0, 1.0, np.zeros((layout.size, overlaps.bands))
    spots: dict[int, Spot] = {}
    if len(overlaps) and settings.mode != "none":
        scale, reach = _typical(overlaps), _reach(overlaps)
        x, spots = _solved_with_spots(overlaps, layout, (scale, reach), settings)
    if settings.mode == "gain":
        x[2 * n_photos :] = 0.0
    return ColourModel(
        gain=x[:n_photos],
        offsets=x[n_photos : 2 * n_photos] * scale,
        vignetting={c: x[layout.vignetting(i)] for i, c in enumerate(cameras)},
        trend={f: x[layout.trend(i)] for i, f in enumerate(flights)},
        spots={flights[i]: spot for i, spot in spots.items()},
        camera_of=tuple(camera_of),
        flight_of=tuple(flight_of),
        reach=reach,
    )


def _numbers(names: Sequence[str], known: Sequence[str]) -> NDArray[np.int64]:
    """Place of each name among those that are known; (n,)."""
    place = {name: i for i, name in enumerate(known)}
    return np.array([place[name] for name in names], dtype=np.int64)


def _typical(overlaps: Overlaps) -> float:
    """Grey value that all others are relative to: twice the median."""
    middle = np.median(overlaps.value_a), np.median(overlaps.value_b)
    return max(float(np.add(*middle)), 1e-30)


def _reach(overlaps: Overlaps) -> float:
    """Length of the horizontal part of the most oblique view."""
    views = (overlaps.view_a, overlaps.view_b)
    return max(max(float(np.hypot(*v.T).max()) for v in views), 1e-3)


def _solved_with_spots(
    overlaps: Overlaps, layout: Layout, units: tuple[float, float], settings: ColourSettings
) -> tuple[Array, dict[int, Spot]]:
    """Unknowns (size, bands) and hot spots, which show once the rest is known."""
    scale, reach = units
    equations = Equations(overlaps, layout, reach=reach, scale=scale, spots={})
    x = _solved(equations, layout, np.zeros((layout.size, overlaps.bands)), settings)
    if settings.mode == "gain" or not settings.sigma_spot:
        return x, {}
    residual, _ = equations.differences(x)
    weights = _robust(residual / _noise(residual), CONVEX)
    spots = equations.find_spots(x, equations.weights(settings.blocks_per_pair) * weights)
    if spots:
        # gone before its like is built: it is large
        del equations
        equations = Equations(overlaps, layout, reach=reach, scale=scale, spots=spots)
        x = _solved(equations, layout, x, settings, first=CONVEX - 1)
    return x, spots


def _noise(residual: Array) -> Array:
    """Deviation of residuals (k, bands) without the outliers; (bands,)."""
    return np.maximum(1.4826 * np.median(np.abs(residual), axis=0), LEAST_NOISE)


def _solved(
    equations: Equations, layout: Layout, x: Array, settings: ColourSettings, first: int = 0
) -> Array:
    """Unknowns (size, bands) by least squares from a start, reweighted until they stay.

    `first` is the number of the iteration that the start counts as.
    """
    from scipy.sparse import diags
    from scipy.sparse.linalg import splu

    prior = _precisions(layout, settings)
    base = equations.weights(settings.blocks_per_pair)
    for iteration in range(first, max(settings.iterations, CONVEX + 2)):
        residual, middle = equations.differences(x)
        noise = _noise(residual)
        weights = base * _robust(residual / noise, iteration)
        before, x = x, np.empty_like(x)
        for band, sigma in enumerate(noise):
            matrix, right = equations.normals(band, weights / sigma**2, middle[:, band])
            factor = splu(
                matrix + diags(prior, format="csc"),
                permc_spec="MMD_AT_PLUS_A",
                diag_pivot_thresh=0.0,
                options={"SymmetricMode": True},
            )
            x[:, band] = factor.solve(right)
        if iteration > CONVEX and np.abs(x - before).max() < CONVERGED:
            break
    return x


def _robust(t: Array, iteration: int) -> NDArray[np.float64] | float:
    """Weights from residuals (k, bands) in units of their noise; the same for all bands.

    Equal at first, as a photo of another exposure is no outlier; then as of Huber, at last with
    no weight left for what is far off.
    """
    if iteration == 0:
        return 1.0
    size = np.sqrt(np.mean(t**2, axis=1))
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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Steps:
    """Differences that are left between corrected photos, grey values.

    Parameters
    ----------
    median, p90 : shape (bands,)
        Of the sizes of the differences of all blocks.
    pairs : shape (pairs, 2)
        Photos.
    pair_median : shape (pairs, bands)
        Of the size over the blocks of a pair.
    """

    median: Array
    p90: Array
    pairs: NDArray[np.int64]
    pair_median: Array


def residual_steps(overlaps: Overlaps, model: ColourModel) -> Steps:
    """How far two photos still differ after the correction, block by block."""
    size = np.abs(_corrected(overlaps, model, "a") - _corrected(overlaps, model, "b"))
    if not len(overlaps):
        none = np.zeros(overlaps.bands)
        empty = np.zeros((0, overlaps.bands))
        return Steps(median=none, p90=none, pairs=np.zeros((0, 2), np.int64), pair_median=empty)
    both = np.stack([overlaps.a, overlaps.b], axis=1)
    starts = np.flatnonzero(np.concatenate([[True], (both[1:] != both[:-1]).any(axis=1)]))
    parts = np.split(size, starts[1:])
    return Steps(
        median=np.median(size, axis=0),
        p90=np.percentile(size, 90, axis=0),
        pairs=both[starts],
        pair_median=np.stack([np.median(part, axis=0) for part in parts]),
    )


def _corrected(overlaps: Overlaps, model: ColourModel, end: Literal["a", "b"]) -> Array:
    """Corrected grey values of one end of all blocks; (k, bands)."""
    photos: NDArray[np.int64] = getattr(overlaps, end)
    value, xy, view = (getattr(overlaps, f"{name}_{end}") for name in ("value", "xy", "view"))
    out = np.empty(value.shape)
    order = np.argsort(photos, kind="stable")
    for part in np.split(order, np.flatnonzero(np.diff(photos[order])) + 1):
        if part.size:
            photo = int(photos[part[0]])
            out[part] = value[part] * model.factor(photo, xy[part], view[part])
            out[part] += model.offset(photo)
    return out
