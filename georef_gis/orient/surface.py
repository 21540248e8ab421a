"""The ground from adjusted points: a TIN where they carry one, else a plane, or the user's DEM."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from georef_gis.errors import GeometryError
from georef_gis.frames import Array
from georef_gis.geodesy import Origin
from georef_gis.model.terrain import DemTerrain
from georef_gis.model.tie_points import GroundPoints
from georef_gis.model.tin import EnuPlane, TinTerrain
from georef_gis.orient.dem_bias import DemBias, estimate_bias, unbiased
from georef_gis.orient.surface_plane import few_points, fit_plane
from georef_gis.orient.surface_points import FLOOR, Cloud, Scattered, cloud_of, without_blunders
from georef_gis.orient.surface_tin import Trials, plane_terrain, tin_of, try_surfaces

# points below which no TIN is made
FEWEST_FOR_TIN = 12
# area of the points' hull as a share of its length squared: below, they lie on a line
THINNEST = 0.005
# a plane is taken when it is worse than the TIN by no more than this
PLANE_AS_GOOD = 1.05


@dataclass(frozen=True, slots=True, kw_only=True)
class SurfaceReport:
    """What was made of the points, lengths in m.

    Parameters
    ----------
    points, used, blunders
        Given; usable and fitting; standing off their surroundings.
    rms_held_out
        Of points held out against the chosen surface, NaN where too few; over a DEM that of the
        points about it.
    rms_plane, rms_tin
        The same of the plane and of the best TIN, for comparison.
    sigma, sigma_shared
        Of the terrain; see `TinTerrain`.
    smoothed_over
        Neighbours that a vertex of the TIN is smoothed over; 0 = not at all.
    """

    kind: Literal["tin", "plane", "dem"]
    points: int
    used: int
    blunders: int
    held_out: int
    rms_held_out: float
    rms_plane: float
    rms_tin: float
    sigma: float
    sigma_shared: float
    smoothed_over: int = 0
    bias: DemBias | None = None
    notes: tuple[str, ...] = ()

    def facts(self) -> dict[str, Any]:
        """JSON-able, lengths in m."""
        lengths = {
            f"{name}_m": None if np.isnan(value) else round(value, 4)
            for name in ("rms_held_out", "rms_plane", "rms_tin", "sigma", "sigma_shared")
            for value in [float(getattr(self, name))]
        }
        counts = {
            name: getattr(self, name)
            for name in ("points", "used", "blunders", "held_out", "smoothed_over")
        }
        return {**counts, **lengths, "notes": list(self.notes)}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Surface:
    """The ground to use, and why."""

    terrain: TinTerrain | DemTerrain
    report: SurfaceReport


def fit_surface(
    points: GroundPoints,
    origin: Origin,
    area_enu: Array,
    *,
    dem: DemTerrain | None = None,
    block_tilt: float = 0.0,
) -> Surface:
    """Ground from adjusted points.

    Parameters
    ----------
    points
        Their covariances may hold what the poses share: it is told apart by how neighbours
        scatter.
    area_enu : shape (n, 2), m
        Places that the ground must reach, such as the rims of the photos' footprints; may be empty.
    dem
        The user's; it is used, moved by its bias where that is significant.
    block_tilt : rad
        One sigma of the tilt that all points share.

    Raises
    ------
    GeometryError
        If no point is usable.
    """
    up = points.p_enu[np.isfinite(points.p_enu[:, 2]), 2]
    level = float(np.median(up)) if len(up) else 0.0
    frame = EnuPlane(origin=origin, level=origin.height_ellipsoidal + level)
    cloud = cloud_of(points, frame)
    if not len(cloud):
        raise GeometryError(
            f"none of {len(points)} adjusted points has a finite place and covariance: "
            "the ground of the direct result stays"
        )
    area_plane = _on_plane(frame, area_enu, level)
    if len(cloud) < FEWEST_FOR_TIN or _thin(cloud.xy):
        surface = _plane(few_points(cloud), None, frame, area_plane, len(points))
    else:
        surface = _best(without_blunders(cloud), frame, area_plane, len(points))
    return surface if dem is None else _with_dem(surface, cloud, frame, dem, block_tilt)


def _on_plane(frame: EnuPlane, area_enu: Array, level: float) -> Array:
    xy = np.asarray(area_enu, dtype=np.float64).reshape(-1, 2)
    p = np.column_stack([xy, np.full(len(xy), level)])
    return frame.map_from_enu(p[np.isfinite(p).all(axis=1)])[:, :2]


def _thin(xy: Array) -> bool:
    """Whether points lie on a line, as far as triangles are concerned."""
    try:
        hull = ConvexHull(xy)
    except QhullError:
        return True
    return bool(hull.volume < THINNEST * float(np.sum(np.ptp(xy, axis=0) ** 2)))


def _best(found: Scattered, frame: EnuPlane, area: Array, given: int) -> Surface:
    """The plane or the TIN, whichever held-out points favour."""
    cloud = found.cloud
    if len(cloud) < FEWEST_FOR_TIN or _thin(cloud.xy):
        return _plane(found, None, frame, area, given)
    trials = try_surfaces(cloud)
    if trials is None or trials.plane_rms <= PLANE_AS_GOOD * trials.best.rms + FLOOR:
        return _plane(found, trials, frame, area, given)
    terrain = tin_of(cloud, trials.best, frame, area, shared=found.shared)
    report = SurfaceReport(
        kind="tin", points=given, used=len(cloud), blunders=found.blunders,
        held_out=trials.held_out, rms_held_out=trials.best.rms, rms_plane=trials.plane_rms,
        rms_tin=trials.best.rms, sigma=terrain.sigma, sigma_shared=found.shared,
        smoothed_over=trials.best.neighbours, notes=_notes(found),
    )  # fmt: skip
    return Surface(terrain=terrain, report=report)


def _plane(
    found: Scattered, trials: Trials | None, frame: EnuPlane, area: Array, given: int
) -> Surface:
    plane = fit_plane(found.cloud)
    terrain = plane_terrain(plane, frame, found.cloud.xy, area, shared=found.shared)
    nan = float("nan")
    notes = _notes(found)
    if trials is None:
        notes += (f"{len(found.cloud)} points do not carry a TIN: the ground is a plane",)
    if plane.limited:
        notes += ("the points tilt the ground by more than 50 %: the plane is held at that",)
    rms_plane = trials.plane_rms if trials else nan
    report = SurfaceReport(
        kind="plane", points=given, used=int(plane.used.sum()),
        blunders=found.blunders + int((~plane.used).sum()),
        held_out=trials.held_out if trials else 0, rms_held_out=rms_plane, rms_plane=rms_plane,
        rms_tin=trials.best.rms if trials else nan, sigma=terrain.sigma,
        sigma_shared=found.shared, notes=notes,
    )  # fmt: skip
    return Surface(terrain=terrain, report=report)


def _notes(found: Scattered) -> tuple[str, ...]:
    total = found.blunders + len(found.cloud)
    if not found.blunders:
        return ()
    stand = "stands off its surroundings and is" if found.blunders == 1 else \
            "stand off their surroundings and are"  # fmt: skip
    return (f"{found.blunders} of {total} points {stand} left out",)


def _with_dem(
    surface: Surface, cloud: Cloud, frame: EnuPlane, dem: DemTerrain, block_tilt: float
) -> Surface:
    """The user's DEM, moved onto the points; without points on it, as it is."""
    bias = estimate_bias(
        cloud, frame, dem, shared=surface.report.sigma_shared, block_tilt=block_tilt
    )
    sigma = dem.sigma if bias is None else bias.sigma
    terrain = unbiased(dem, bias) if bias else dem
    notes = [*surface.report.notes]
    notes.append(bias.told if bias else "too few points lie on the DEM: its bias is not known")
    rms = bias.spread if bias else float("nan")
    report = replace(
        surface.report, kind="dem", sigma=sigma, rms_held_out=rms, bias=bias, notes=tuple(notes),
        smoothed_over=0,
    )  # fmt: skip
    return Surface(terrain=terrain, report=report)
