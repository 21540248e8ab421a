"""Ramps of brightness over a whole mosaic, which overlaps cannot tell.

If the gains of photos grow towards the east, and all photos are tilted by as much towards the
west, then each place has the same brightness in all photos that show it, only that the mosaic is
brighter in the east. What overlaps seem to tell about such a ramp comes from what the equations do
not know; believed, it changed one real mosaic by half of its brightness from end to end. So the
photos are trusted: on the whole, corrections have no ramp.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from georef_gis.frames import Array
from georef_gis.mosaic.block_means import Indices, Samples
from georef_gis.mosaic.colour_basis import radial_basis, trend_basis
from georef_gis.mosaic.colour_normals import DARKEST, Layout
from georef_gis.mosaic.hot_spot import Spot
from georef_gis.mosaic.tone import grown, tone_of

# expected of the mean product of logarithms and of a ramp over the site whose deviation is 1,
# times the root of the number of photos
SIGMA_RAMP = 0.05
# photos of a flight from which a ramp of their exposures is more than chance
FEWEST = 9


def ramps_of(
    layout: Layout,
    samples: Samples,
    spots: Mapping[int, Spot],
    *,
    reach: float,
    scale: float,
    knee: float,
) -> Array:
    """Combinations of unknowns that are expected to be nothing, over their sigma.

    Returns
    -------
    array : shape (bands, m, size)
        A ramp of grey values, so that bright ground counts more, as it does to the eye.

    Parameters
    ----------
    samples
        Pixels of the photos.
    spots, reach, scale, knee
        See `Equations`.
    """
    # how fast grey values grow with the logarithms
    growth = grown(tone_of(samples.value.astype(np.float64) / scale, DARKEST, knee), knee)
    shown = samples.nearest()
    flight_of = layout.flight[samples.photo]
    rows = [np.zeros((growth.shape[1], 0, layout.size))]
    for flight in range(layout.flights):
        own = np.flatnonzero(shown & (flight_of == flight))
        photos = np.unique(samples.photo[own]).size
        if photos >= FEWEST:
            trend = trend_basis(samples.view[own], reach, spots.get(flight))
            bands = [_means(layout, samples, own, trend, weights) for weights in growth[own].T]
            rows.append(np.stack(bands) * (np.sqrt(photos) / SIGMA_RAMP))
    return np.concatenate(rows, axis=1)


def _means(layout: Layout, samples: Samples, own: Indices, trend: Array, weights: Array) -> Array:
    """Mean products of logarithms and ramps over samples `own` of a flight; (2, size).

    `trend` (s, 15) and `weights` (s,) are of those samples.
    """
    photo = samples.photo[own]
    shares = _ramps(samples.place[own].astype(np.float64), weights / weights.sum())
    out = np.zeros((2, layout.size))
    np.add.at(out.T, photo, shares)
    out[:, layout.trend(int(layout.flight[photo[0]]))] = shares.T @ trend
    radial = radial_basis(samples.xy[own])
    for camera in np.unique(layout.camera[photo]):
        of_it = layout.camera[photo] == camera
        out[:, layout.vignetting(int(camera))] = shares[of_it].T @ radial[of_it]
    return out


def _ramps(place: Array, shares: Array) -> Array:
    """Distance from the middle along the longest and the other way, times shares; (s, 2).

    The first has a deviation of 1. A strip's narrow side is no ramp: in units of the long one it
    hardly counts.
    """
    away = place - shares @ place
    spread, axes = np.linalg.eigh((away * shares[:, None]).T @ away)
    along = away @ axes[:, ::-1] / max(float(np.sqrt(spread[-1])), 1e-12)
    return np.asarray(along * shares[:, None])
