"""How far a user's DEM lies off adjusted points, and the DEM without that."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from georef_gis.frames import Array
from georef_gis.model.terrain import DemTerrain
from georef_gis.model.tin import EnuPlane
from georef_gis.orient.alike_errors import by_blocks, mean_over_blocks, scatter
from georef_gis.orient.surface_points import Cloud

# points on the DEM below which its bias is not estimated
FEWEST = 5
# blocks along each side, and how many must be met, for a tilt
TILT_BLOCKS, FEWEST_FOR_TILT = 6, 12
# standard deviations from which an offset, and a tilt, are taken for real
OFFSET_COUNTS, TILT_COUNTS = 2.0, 4.0
# standard deviations beyond which a point does not count
CUT = 5.0
# sigmas of the block's own tilt that a DEM's must exceed
TILT_OF_BLOCK = 4.0


@dataclass(frozen=True, slots=True, kw_only=True)
class DemBias:
    """What is taken off a DEM's heights: offset + slope . (xy - centre), enu m.

    Parameters
    ----------
    offset, sigma_offset : m
        DEM minus points at the centre, as found; one sigma of it.
    slope_east, slope_north
        0 where no tilt is significant.
    used
        Whether it is significant; else the DEM stays as it is.
    spread : m
        Robust standard deviation of the points about the DEM once moved.
    sigma : m
        One sigma of the DEM as it is used.
    """

    offset: float
    sigma_offset: float
    slope_east: float
    slope_north: float
    centre_east: float
    centre_north: float
    points: int
    used: bool
    spread: float
    sigma: float

    @property
    def told(self) -> str:
        """For people."""
        where = "above" if self.offset > 0 else "below"
        what = f"the DEM lies {abs(self.offset):.2f} m {where} the points"
        about = f"(one sigma {self.sigma_offset:.2f} m, spread {self.spread:.2f} m)"
        tilt = np.hypot(self.slope_east, self.slope_north)
        tilted = f", tilted by {100.0 * tilt:.2f} %" if tilt else ""
        end = "taken off" if self.used else "not significant, left as it is"
        return f"{what}{tilted} {about}: {end}"

    def as_json(self) -> dict[str, Any]:
        """For the database."""
        return asdict(self)

    @classmethod
    def from_json(cls, content: Mapping[str, Any]) -> DemBias:
        """From what `as_json` gave."""
        return cls(**content)


def estimate_bias(
    cloud: Cloud, frame: EnuPlane, dem: DemTerrain, *, shared: float = 0.0,
    block_tilt: float = 0.0,
) -> DemBias | None:  # fmt: skip
    """Offset and tilt of a DEM against points; None where too few lie on it.

    Parameters
    ----------
    shared : m
        One sigma of what points and photos share. It is no reason against moving the DEM, which
        must fit the photos; it is in the sigma of the moved DEM.
    block_tilt : rad
        One sigma of the tilt that all points share: a DEM is not tilted to fit a tilted block.

    Notes
    -----
    Errors of a DEM, and of neighbouring points, are alike over tens of metres: n points are not n
    witnesses. The sigma of the offset is the largest that means over blocks of growing size give
    (Flyvbjerg & Petersen 1989, J. Chem. Phys. 91, 461).
    """
    p = frame.enu_from_map(np.column_stack([cloud.xy, cloud.h]))
    # The height itself: the DEM's plane differs from the points' one.
    on_dem = dem.frame.map_from_enu(p)
    r = dem.height_at_map(on_dem[:, :2]) - on_dem[:, 2]
    fits = np.isfinite(r)
    if np.count_nonzero(fits) < FEWEST:
        return None
    xy, r = p[fits, :2], r[fits]
    keep = np.abs(r - np.median(r)) <= CUT * max(scatter(r - np.median(r)), 0.02)
    xy, r = xy[keep], r[keep]
    centre = np.median(xy, axis=0)
    slope = _tilt(xy - centre, r)
    if np.linalg.norm(slope) <= TILT_OF_BLOCK * np.tan(block_tilt):
        slope = np.zeros(2)
    level = r - (xy - centre) @ slope
    offset, sigma_offset = mean_over_blocks(xy, level)
    spread = scatter(level - offset)
    used = bool(abs(offset) > OFFSET_COUNTS * sigma_offset or np.any(slope))
    # Ground that tie points show and a DEM does not, such as crops, is in the spread.
    sigma = float(np.hypot(spread, sigma_offset)) if used else max(dem.sigma, spread)
    return DemBias(
        offset=offset, sigma_offset=sigma_offset, slope_east=float(slope[0]),
        slope_north=float(slope[1]), centre_east=float(centre[0]), centre_north=float(centre[1]),
        points=len(r), used=used, spread=spread, sigma=float(np.hypot(sigma, shared)),
    )  # fmt: skip


def _tilt(xy: Array, r: Array) -> Array:
    """Slope of residuals, where blocks show one beyond doubt; else 0; shape (2,)."""
    places, middle, _ = by_blocks(xy, r, TILT_BLOCKS)
    if len(middle) < FEWEST_FOR_TILT:
        return np.zeros(2)
    X = np.column_stack([np.ones(len(places)), places])
    spread = places - places.mean(axis=0)
    values = np.linalg.svd(spread, compute_uv=False)
    # blocks on a line tell no tilt across it
    if values[1] < 0.2 * values[0]:
        return np.zeros(2)
    beta, *_ = np.linalg.lstsq(X, middle, rcond=None)
    left = middle - X @ beta
    covariance = np.linalg.inv(X.T @ X) * np.sum(left**2) / (len(middle) - 3)
    chi2 = beta[1:] @ np.linalg.solve(covariance[1:, 1:], beta[1:])
    return np.asarray(beta[1:] if chi2 > TILT_COUNTS**2 else np.zeros(2))


def unbiased(dem: DemTerrain, bias: DemBias) -> DemTerrain:
    """The DEM without its bias, with the sigma that it has then."""
    if not bias.used:
        return replace(dem, sigma=bias.sigma)
    rows, cols = dem.heights.shape
    x = dem.left + np.array([0.0, cols, 0.0]) * dem.cell[0]
    y = dem.top - np.array([0.0, 0.0, rows]) * dem.cell[1]
    level = np.full(3, float(np.nanmean(dem.heights)))
    corners = dem.frame.enu_from_map(np.column_stack([x, y, level]))[:, :2]
    # east and north are linear in column and row to 1e-4: of a tilt, micrometres
    col, row = (np.arange(cols) + 0.5) / cols, (np.arange(rows) + 0.5) / rows
    slope = np.array([bias.slope_east, bias.slope_north])
    first = (corners[0] - [bias.centre_east, bias.centre_north]) @ slope
    across, down = (corners[1] - corners[0]) @ slope, (corners[2] - corners[0]) @ slope
    plane = bias.offset + first + across * col[None, :] + down * row[:, None]
    return replace(dem, heights=dem.heights - plane, sigma=bias.sigma)
