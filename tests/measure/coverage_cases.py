"""Do error ellipses hold the truth as often as they say? Simulated flights, measured and compared.

Every source of error is redrawn for each flight: navigation (white and slow), boresight, lever
arm, bias, clock, camera, readout, ground, clicks. The flights share no geometry with the package.
What is stated is the law that the errors were drawn from, so that a share that does not come out
is a fault of what lies between: derivatives, correlations, ellipses.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "orient"))

from adjustment_blocks import block_of, camera_sigma, first_points
from adjustment_flights import SimFlight, gps_only, oriented_photos, pose_jacobian
from numpy.typing import NDArray
from scipy.stats import norm

from georef_gis.frames import Array
from georef_gis.geodesy import MapFrame, Origin, utm_crs
from georef_gis.measure.ellipses import error_ellipse, on_map
from georef_gis.measure.lengths import Quantity, measure_lines
from georef_gis.measure.measured import MeasuredPoints
from georef_gis.measure.points import Mark, intersect_points, locate_points
from georef_gis.measure.scene import Scene
from georef_gis.model.ground_errors import GroundErrors
from georef_gis.model.joint_errors import CameraErrors, JointErrors, PoseSource
from georef_gis.model.photo_stack import PhotoStack
from georef_gis.model.pose_errors import DenseErrors
from georef_gis.model.terrain import DemTerrain, FlatTerrain, Terrain
from georef_gis.model.tin import EnuPlane, SquareCells, tin_terrain
from georef_gis.orient.adjustment.adjust import adjust
from georef_gis.orient.surface import fit_surface

# of an ellipse, and of an interval of a length
CONFIDENCES = (0.3935, 0.95)
ORIGIN = Origin(lat=math.radians(39.0975), lon=math.radians(-80.467), height_ellipsoidal=277.6)
FRAME = MapFrame(ORIGIN, utm_crs(ORIGIN.lat, ORIGIN.lon))
# px, one sigma of a click
CLICK = 1.0
# m; size of the relief, see `flight_making`, and the cells of surfaces made of it
RELIEF, CELL = 2.0, 4.0
# m, one sigma of a level ground against the relief: its waves and slopes over the flown area
FLAT_SIGMA = 1.9
# m, one sigma of surfaces: shared and local
SHARED, LOCAL = 0.4, 0.5

Seen = Mapping[int, list[int]]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Measured:
    """What one flight gave: for each of `CONFIDENCES` which ellipses or intervals held the truth.

    `inside` (n, 2); `ratios` (n, k) are errors over sigma.
    """

    inside: NDArray[np.bool_]
    ratios: Array


# -- flights ----------------------------------------------------------------------------------


def flight_of(seed: int, **changes: object) -> SimFlight:
    """Eight photos by tags, with places to click."""
    conditions: dict[str, object] = {
        "check": 10, "mark_px": CLICK, "obs_per_photo": 10.0, "relief": RELIEF, "readout_s": 0.02,
        "sigma_readout_s": 0.003, "sigma_survey": (0.0, 0.0),
    }  # fmt: skip
    return gps_only(seed, 2, 4, **(conditions | changes))


def law_of_poses(flight: SimFlight) -> Array:
    """Covariance of all poses that their errors were drawn from; (6 n, 6 n), m and rad."""
    n, model, s = flight.n_photos, flight.navigation, flight.sigmas
    J = np.stack([pose_jacobian(flight, i) for i in range(n)])
    joint = np.zeros((n, 6, n, 6))
    for c, block in enumerate(model.covariance(flight.truth.times)):
        joint[:, c, :, c] = block
    out = np.einsum("aij,ajbk,blk->aibl", J[:, :, :6], joint, J[:, :, :6])
    shared = np.concatenate([s.boresight, s.lever, s.bias, [s.clock]]) ** 2
    out += np.einsum("aij,j,blj->aibl", J[:, :, 6:], shared, J[:, :, 6:])
    return np.asarray(out.reshape(6 * n, 6 * n))


def tagged_errors(flight: SimFlight) -> JointErrors:
    """Errors of poses and camera by the law that they were drawn from."""
    stack = PhotoStack.of(oriented_photos(flight))
    n = len(stack)
    source = PoseSource(photos=np.arange(n), errors=DenseErrors(matrix=law_of_poses(flight)))
    cameras = CameraErrors(
        ids=("sim",), covariance=np.diag(camera_sigma(flight) ** 2),
        sensor_of=np.zeros(n, dtype=np.int64), turns=np.zeros(n, dtype=np.int64),
    )  # fmt: skip
    return JointErrors(stack, [source], cameras)


# -- grounds ----------------------------------------------------------------------------------


def smooth_noise(rng: np.random.Generator, shape: tuple[int, int], length: float) -> Array:
    """Normal noise of sigma 1 on cells, alike over a length, in cells; Gaussian correlation."""
    n = int(4 * length) + 1
    t = np.arange(-n, n + 1)
    kernel = np.exp(-((t / length) ** 2))
    kernel /= np.sqrt(np.sum(kernel**2))
    z = rng.normal(size=(shape[0] + 2 * n, shape[1] + 2 * n))
    z = np.apply_along_axis(np.convolve, 0, z, kernel, "valid")
    return np.asarray(np.apply_along_axis(np.convolve, 1, z, kernel, "valid"))


def flat_ground(flight: SimFlight, rng: np.random.Generator) -> Terrain:
    """Level ground at z = 0, which the relief goes about."""
    return FlatTerrain(origin=ORIGIN, height_ellipsoidal=277.6, sigma=FLAT_SIGMA)


def _laid_out(flight: SimFlight, rng: np.random.Generator, length: float) -> tuple[Array, float]:
    """Heights above the ellipsoid on cells about the site, with their errors; half extent, m."""
    half = 400.0
    n = int(2 * half / CELL)
    x = -half + (np.arange(n) + 0.5) * CELL
    xy = np.stack(np.meshgrid(x, -x), axis=-1)
    z = flight.relief.z_at(xy)
    z += SHARED * rng.normal() + LOCAL * smooth_noise(rng, z.shape, length / CELL)
    frame = EnuPlane(origin=ORIGIN, level=277.6)
    return frame.map_from_enu(np.concatenate([xy, z[..., None]], axis=-1))[..., 2], half


def dem_ground(flight: SimFlight, rng: np.random.Generator) -> Terrain:
    """Raster of 4 m cells with a shared and a local error."""
    terrain = DemTerrain(
        frame=EnuPlane(origin=ORIGIN, level=277.6), heights=np.zeros((2, 2)), left=0.0, top=0.0,
        cell=(CELL, CELL), step=CELL / 2, sigma=math.hypot(SHARED, LOCAL),
    )  # fmt: skip
    heights, half = _laid_out(flight, rng, GroundErrors.of(terrain).length)
    return DemTerrain(
        frame=terrain.frame, heights=heights, left=-half, top=half, cell=terrain.cell,
        step=terrain.step, sigma=terrain.sigma,
    )  # fmt: skip


def tin_ground(flight: SimFlight, rng: np.random.Generator) -> Terrain:
    """Surface that knows its shared sigma from its local one."""
    heights, half = _laid_out(flight, rng, 3.0 * CELL)
    return tin_terrain(
        EnuPlane(origin=ORIGIN, level=277.6), SquareCells(left=-half, top=half, cell=CELL),
        heights, np.full((4, 4), LOCAL), kind="tin", sigma=math.hypot(SHARED, LOCAL),
        sigma_shared=SHARED,
    )  # fmt: skip


Ground = Callable[[SimFlight, np.random.Generator], Terrain]
GROUNDS: dict[str, Ground] = {"flat": flat_ground, "TIN": tin_ground, "DEM": dem_ground}


def scene_by_tags(flight: SimFlight, ground: Ground, rng: np.random.Generator) -> Scene:
    """Photos by their tags over a ground with errors of its own."""
    terrain = ground(flight, rng)
    return Scene(
        frame=FRAME, terrain=terrain, errors=tagged_errors(flight), ground=GroundErrors.of(terrain)
    )


def adjusted_scene(seed: int) -> tuple[SimFlight, Scene]:
    """Flight that was adjusted, over the ground of its own points, and what that kept."""
    # some 100 points a photo, as 15 photos see them
    flight = flight_of(seed, obs_per_photo=120.0, noise_px=0.5, sigma_readout_s=0.003)
    block = block_of(flight)
    answer = adjust(block, first_points(flight, block))
    photos = [
        type(p)(photo=p.photo, camera=answer.cameras[0], pose=pose)
        for p, pose in zip(oriented_photos(flight), answer.poses, strict=True)
    ]
    stack, n = PhotoStack.of(photos), len(photos)
    full = answer.covariances.inverse()
    cameras = CameraErrors(
        ids=("sim",), covariance=full[6 * n : 6 * n + 11, 6 * n : 6 * n + 11],
        sensor_of=np.zeros(n, dtype=np.int64), turns=np.zeros(n, dtype=np.int64),
        with_poses=full[: 6 * n, 6 * n : 6 * n + 11].reshape(n, 6, 11),
    )  # fmt: skip
    source = PoseSource(photos=np.arange(n), errors=DenseErrors(matrix=full[: 6 * n, : 6 * n]))
    middle = np.median(answer.points.p_enu[:, :2], axis=0)
    surface = fit_surface(answer.points, ORIGIN, middle + np.array([[-150.0, -150], [150, 150]]))
    return flight, Scene(
        frame=FRAME,
        terrain=surface.terrain,
        errors=JointErrors(stack, [source], cameras),
        ground=GroundErrors.of(surface.terrain, tied=True),
        ground_photos=np.arange(n),
    )


# -- what is clicked, and what comes of it ----------------------------------------------------


def seen_by(flight: SimFlight) -> Seen:
    """Photo -> places of `flight.check` that it shows, by the numbers of their marks."""
    out: dict[int, list[int]] = {}
    for k, photo in enumerate(flight.check.photo):
        out.setdefault(int(photo), []).append(k)
    return out


def mark_of(flight: SimFlight, k: int) -> Mark:
    """Click number k."""
    c = flight.check
    return Mark(
        name=f"P{c.point[k]}", photo=f"sim_{c.photo[k]:04d}", u=float(c.uv[k, 0]),
        v=float(c.uv[k, 1]), sigma_px=CLICK,
    )  # fmt: skip


def truth_of(flight: SimFlight, points: MeasuredPoints) -> Array:
    """True places of measured points; (n, 3), m."""
    return flight.check.p_true[[int(name[1:]) for name in points.names]]


def on_ellipses(points: MeasuredPoints, truth: Array) -> Measured:
    """Whether the ellipses on the map hold the true places."""
    R_errors = (truth - points.p_enu)[:, :, None]
    off_map = FRAME.map_from_enu(truth)[:, :2] - FRAME.map_from_enu(points.p_enu)[:, :2]
    C = on_map(FRAME, points.p_enu, points.each)
    inside = np.array([
        [bool(error_ellipse(C[i], conf=conf).holds(off_map[i])) for conf in CONFIDENCES]
        for i in range(len(points))
    ])  # fmt: skip
    up = R_errors[:, 2, 0] / np.sqrt(points.each[:, 2, 2])
    en = off_map / np.sqrt(np.einsum("nii->ni", C)[:, :2])
    return Measured(inside=inside, ratios=np.column_stack([en, up]))


def on_intervals(found: Sequence[Quantity], truth: Sequence[float]) -> Measured:
    """Whether intervals about values hold the true ones."""
    ratio = np.array([(t - q.value) / q.sigma for q, t in zip(found, truth, strict=True)])
    limits = norm.ppf(0.5 + np.array(CONFIDENCES) / 2)
    return Measured(inside=np.abs(ratio)[:, None] <= limits, ratios=ratio[:, None])


def located(scene: Scene, flight: SimFlight, rng: np.random.Generator, n: int = 6) -> Measured:
    """Places clicked in one photo each."""
    chosen = rng.choice(len(flight.check.photo), size=n, replace=False)
    points = locate_points(scene, [mark_of(flight, int(k)) for k in chosen])
    return on_ellipses(points, truth_of(flight, points))


def intersected(scene: Scene, flight: SimFlight, rng: np.random.Generator) -> MeasuredPoints:
    """Places clicked in two to five photos."""
    marks = []
    for i in range(len(flight.check.p_true)):
        rows = np.flatnonzero(flight.check.point == i)
        if len(rows) >= 2:
            chosen = rng.choice(rows, size=min(len(rows), 5), replace=False)
            marks += [mark_of(flight, int(k)) for k in chosen]
    return intersect_points(scene, marks)


def on_the_ground(
    scene: Scene, flight: SimFlight, rng: np.random.Generator, n: int = 6
) -> MeasuredPoints:
    """Places clicked in two photos each, which are said to stand on the ground."""
    marks = []
    for i in rng.permutation(len(flight.check.p_true))[:n]:
        rows = np.flatnonzero(flight.check.point == i)
        if len(rows) >= 2:
            chosen = rng.choice(rows, size=2, replace=False)
            marks += [replace(mark_of(flight, int(k)), on_ground=True) for k in chosen]
    return intersect_points(scene, marks)


def between_both_ways(
    points: MeasuredPoints, scene: Scene, flight: SimFlight, rng: np.random.Generator
) -> Measured:
    """Distances from each place that rays and ground give to one that a photo and the ground do.

    The ground errs alike in both: who forgot that would say these distances wrong.
    """
    ids = [int(name[1:]) for name in points.names]
    alone = []
    for k in rng.permutation(len(flight.check.photo)):
        if len(alone) < len(points) and flight.check.point[k] not in ids:
            alone.append(replace(mark_of(flight, int(k)), name=f"L{flight.check.point[k]}"))
            ids.append(int(flight.check.point[k]))
    both = MeasuredPoints.joined(points, locate_points(scene, alone))
    truth, found, true = truth_of(flight, both), [], []
    for i, j in zip(range(len(points)), range(len(points), len(both)), strict=False):
        found.append(measure_lines(both.subset([i, j])).legs[0].ground)
        true.append(ground_distance(truth[i], truth[j]))
    return on_intervals(found, true)


def ground_distance(a: Array, b: Array) -> float:
    """Horizontal distance in a plane, m: at 100 m it is off by the Earth's bend of 1 nm."""
    return float(np.hypot(*(b - a)[:2]))


def within_one_photo(
    scene: Scene, flight: SimFlight, rng: np.random.Generator, n: int = 4
) -> Measured:
    """Distances between two places clicked in one photo."""
    good = [rows for rows in seen_by(flight).values() if len(rows) >= 2]
    pairs = [rng.choice(good[i], size=2, replace=False) for i in rng.integers(0, len(good), n)]
    return _distances(scene, flight, pairs)


def between_photos(
    scene: Scene, flight: SimFlight, rng: np.random.Generator, n: int = 4
) -> Measured:
    """Distances between two places, each clicked in a photo of its own."""
    c, pairs = flight.check, []
    while len(pairs) < n:
        a, b = rng.integers(0, len(c.photo), 2)
        if c.photo[a] != c.photo[b] and c.point[a] != c.point[b]:
            pairs.append(np.array([a, b]))
    return _distances(scene, flight, pairs)


def _distances(scene: Scene, flight: SimFlight, pairs: Sequence[Array]) -> Measured:
    found, truth = [], []
    for pair in pairs:
        points = locate_points(scene, [mark_of(flight, int(k)) for k in pair])
        a, b = truth_of(flight, points)
        found.append(measure_lines(points).legs[0].ground)
        truth.append(ground_distance(a, b))
    return on_intervals(found, truth)


def between_intersected(points: MeasuredPoints, flight: SimFlight) -> Measured:
    """Distances from each intersected place to the next."""
    truth = truth_of(flight, points)
    lines = measure_lines(points)
    return on_intervals(
        [leg.ground for leg in lines.legs],
        [ground_distance(a, b) for a, b in pairwise(truth)],
    )


def area_of(points: MeasuredPoints, flight: SimFlight) -> Measured:
    """Area of the largest triangle of the true places.

    By tags it may still be no larger than its sigma: then a triangle that is turned over has an
    area too, and errs by both. So the sign of the measured one counts.
    """
    truth = truth_of(flight, points)
    chosen = max(combinations(range(len(points)), 3), key=lambda c: abs(turning_area(truth[[*c]])))
    three = points.subset(chosen)
    true, measured = (turning_area(xy) for xy in (truth[[*chosen]], three.p_enu))
    area = measure_lines(three, closed=True).area_ground
    assert area is not None
    return on_intervals([area], [math.copysign(1.0, measured) * true])


def turning_area(xy: Array) -> float:
    """Area of a triangle (3, 2 or more), positive where it turns left."""
    a, b, c = xy[:, :2]
    return float(0.5 * ((b - a)[0] * (c - a)[1] - (b - a)[1] * (c - a)[0]))


def measure_flight(seed: int, *, adjusted: bool = True) -> dict[str, Measured]:
    """All that is measured in one flight, by name."""
    flight, rng = flight_of(seed), np.random.default_rng(10_000 + seed)
    out: dict[str, Measured] = {}
    for name, ground in GROUNDS.items():
        scene = scene_by_tags(flight, ground, rng)
        out[f"locate, {name}, tags"] = located(scene, flight, rng)
        out[f"distance in one photo, {name}, tags"] = within_one_photo(scene, flight, rng)
        out[f"distance between photos, {name}, tags"] = between_photos(scene, flight, rng)
        out |= _with_ground(scene, flight, f"{name}, tags")
    points = intersected(scene, flight, rng)
    out["intersect, tags"] = on_ellipses(points, truth_of(flight, points))
    out["distance, intersected, tags"] = between_intersected(points, flight)
    out["area, intersected, tags"] = area_of(points, flight)
    if adjusted:
        flight, scene = adjusted_scene(seed)
        out["locate, own TIN, adjusted"] = located(scene, flight, rng)
        out["distance in one photo, own TIN, adjusted"] = within_one_photo(scene, flight, rng)
        out["distance between photos, own TIN, adjusted"] = between_photos(scene, flight, rng)
        points = intersected(scene, flight, rng)
        out["intersect, adjusted"] = on_ellipses(points, truth_of(flight, points))
        out["distance, intersected, adjusted"] = between_intersected(points, flight)
        out["area, intersected, adjusted"] = area_of(points, flight)
        out |= _with_ground(scene, flight, "own TIN, adjusted")
    return out


def _with_ground(scene: Scene, flight: SimFlight, of: str) -> dict[str, Measured]:
    """What rays and the ground give together; drawn apart, so that the rest stays as it was."""
    rng = np.random.default_rng(len(flight.check.photo))
    points = on_the_ground(scene, flight, rng)
    return {
        f"on the ground, {of}": on_ellipses(points, truth_of(flight, points)),
        f"distance, on the ground, {of}": between_intersected(points, flight),
        f"distance, both ways, {of}": between_both_ways(points, scene, flight, rng),
    }


def shares(flights: Sequence[Measured]) -> Array:
    """Share of the truths held, for each confidence; shape (2,)."""
    return np.asarray(np.concatenate([one.inside for one in flights]).mean(axis=0))


def spread_of_shares(flights: Sequence[Measured], n: int = 1000) -> Array:
    """One sigma of the shares, flights drawn with replacement: their points err together; (2,)."""
    rng = np.random.default_rng(1)
    held = np.array([one.inside.sum(axis=0) for one in flights])
    count = np.array([len(one.inside) for one in flights])
    draws = rng.integers(0, len(flights), (n, len(flights)))
    each = held[draws].sum(axis=1) / count[draws].sum(axis=1)[:, None]
    return np.asarray(each.std(axis=0))


def rms_ratio(flights: Sequence[Measured]) -> Array:
    """Root mean square of error over sigma, by component."""
    return np.asarray(np.sqrt(np.mean(np.concatenate([f.ratios for f in flights]) ** 2, axis=0)))
