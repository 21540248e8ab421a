"""Colour of a mosaic: exposure, white balance, vignetting and hot spot, solved from overlaps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from georef_gis.frames import Array
from georef_gis.mosaic.block_means import Samples
from georef_gis.mosaic.colour_basis import (
    SURFACE_TERMS,
    radial_basis,
    surface_basis,
    trend_basis,
)
from georef_gis.mosaic.colour_normals import Layout
from georef_gis.mosaic.colour_settings import ColourSettings, Mode
from georef_gis.mosaic.colour_solution import solve, surfaces_of
from georef_gis.mosaic.hot_spot import Spot, Values
from georef_gis.mosaic.overlaps import Overlaps
from georef_gis.mosaic.tone import toned

__all__ = ["ColourModel", "ColourSettings", "Mode", "solve_colour"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ColourModel:
    """Corrections of grey values: corrected = toned(value, factor, knee) + offset, see `tone.py`.

    Parameters
    ----------
    gain : shape (photos, bands)
        Natural logarithm.
    offsets : shape (photos, bands)
        Grey values.
    surface : shape (photos, 5, bands)
        Coefficients of the logarithm, see `surface_basis`.
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
    knee
        One over the grey value that factors leave as it is; 0 = none, a plain product.
    """

    gain: Array
    offsets: Array
    surface: Array
    vignetting: Mapping[str, Array]
    trend: Mapping[str, Array]
    spots: Mapping[str, Spot]
    camera_of: tuple[str, ...]
    flight_of: tuple[str, ...]
    reach: float = 1.0
    knee: float = 0.0

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
        if self.surface[photo].any():
            log = log + surface_basis(xy) @ self.surface[photo]
        return np.asarray(np.exp(log))

    def corrected(self, photo: int, value: Values, xy: Values, view: Values) -> Array:
        """Grey values of a photo as they ought to be; (..., bands), places as of `factor`."""
        return np.asarray(
            toned(value, self.factor(photo, xy, view), self.knee) + self.offset(photo)
        )

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
            "surface": self.surface.tolist(),
            "knee": self.knee,
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
            surface=np.array(data["surface"], dtype=np.float64).reshape(
                -1, SURFACE_TERMS, data["bands"]
            ),
            knee=float(data["knee"]),
        )


def solve_colour(
    overlaps: Overlaps,
    n_photos: int,
    camera_of: Sequence[str],
    flight_of: Sequence[str],
    settings: ColourSettings,
    samples: Samples | None = None,
) -> ColourModel:
    """Gains and offsets of all photos, vignetting of cameras, view trend of flights, jointly.

    Robust: what moves, shines or has a shadow that moves counts little. Vignetting and trend are
    nothing in the middle of a photo and at the nadir, gains spread about nothing, and surfaces have
    no level, so that the brightness of the whole stays.

    Parameters
    ----------
    camera_of, flight_of
        Names of each photo's camera and flight.
    samples
        Pixels of the photos. With them colours are held from tilting the mosaic as a whole.
    """
    cameras, flights = sorted(set(camera_of)), sorted(set(flight_of))
    layout = Layout.of(camera_of, flight_of)
    solution = solve(overlaps, layout, settings, samples)
    x = solution.x
    if settings.mode == "gain":
        x[2 * n_photos :] = 0.0
    return ColourModel(
        gain=x[:n_photos],
        offsets=x[n_photos : 2 * n_photos] * solution.scale,
        surface=surfaces_of(solution, settings),
        vignetting={c: x[layout.vignetting(i)] for i, c in enumerate(cameras)},
        trend={f: x[layout.trend(i)] for i, f in enumerate(flights)},
        spots={flights[i]: spot for i, spot in solution.spots.items()},
        camera_of=tuple(camera_of),
        flight_of=tuple(flight_of),
        reach=solution.reach,
        knee=settings.knee,
    )
