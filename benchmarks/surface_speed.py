"""CPU and peak memory of surfaces, volumes, profiles and error budgets.

    python benchmarks/surface_speed.py [PART ...]

Each in a process of its own. Made up: 60 000 adjusted points over 250 x 250 m with a heap amid
them, a TIN of 0.25 m cells over the same, and a flight of 60 photos by tags. Peak is that of the
process, imports included (told as "nothing").

2026-11-22, x86_64 (AMD EPYC, 2 cores, shared), Python 3.11.7, numpy 2.4.6:

    nothing                                                    102 MB
    surface of points, 25 megapixels         12.2 s of CPU     212 MB
    surface of a TIN, 25 megapixels           8.2 s            187 MB
    volume over points, 640 000 cells         4.9 s            320 MB
    volume over a TIN, 1 000 000 cells        6.0 s            365 MB
    profile over points, 10 000 stations      1.4 s            173 MB
    profile over a TIN, 10 000 stations       0.05 s           151 MB
    budget of 1 000 points                    0.2 s            110 MB
    budget of 60 photos                       0.3 s            106 MB

A tile's maps are polynomials, its geoid and shared sigma lattices; before that the surfaces took 41
and 49 s, with a band less. Of a volume over points most is the triangles of 16 halves.
"""

from __future__ import annotations

import multiprocessing
import resource
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import shapely

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "orient"))

from adjustment_flights import many, oriented_photos

from georef_gis.frames import Array
from georef_gis.geodesy import MapFrame, Origin, utm_crs
from georef_gis.measure.budget.parts import SourcedErrors
from georef_gis.measure.budget.shares import photo_budgets, point_budgets
from georef_gis.measure.points import Mark, locate_points
from georef_gis.measure.scene import Scene
from georef_gis.measure.surface.base import RimPlane
from georef_gis.measure.surface.field import GroundField, HeightField
from georef_gis.measure.surface.integral import cells_of
from georef_gis.measure.surface.points import PointField
from georef_gis.measure.surface.profile import profile_along
from georef_gis.measure.surface.raster import HeightReference, surface_profile, surface_tiles
from georef_gis.measure.surface.volume import volume
from georef_gis.model.grid import Grid
from georef_gis.model.terrain import FlatTerrain
from georef_gis.model.tie_points import GroundPoints
from georef_gis.model.tin import EnuPlane, SquareCells, tin_terrain
from georef_gis.rasters.writer import TiledWriter

ORIGIN = Origin(lat=0.68, lon=-1.4, height_ellipsoidal=250.0)
FRAME = MapFrame(ORIGIN, utm_crs(ORIGIN.lat, ORIGIN.lon))
REFERENCE = HeightReference(kind="orthometric")
# m
SIZE, HEAP = 250.0, 100.0
POINTS, SIDE = 60_000, 5000
Made = Callable[[], Callable[[], None]]


def heights(xy: Array) -> Array:
    return np.asarray(0.02 * xy[..., 0] + 8.0 * np.exp(-0.5 * np.sum(xy**2, -1) / 30.0**2))


def points() -> PointField:
    rng = np.random.default_rng(0)
    xy = rng.uniform(-SIZE / 2, SIZE / 2, (POINTS, 2))
    p = np.column_stack([xy, heights(xy) + 0.03 * rng.standard_normal(POINTS)])
    covariance = np.tile(0.03**2 * np.eye(3), (POINTS, 1, 1))
    return PointField.of(
        GroundPoints(
            p_enu=p, covariance=covariance, rays=np.full(POINTS, 4, np.int32),
            residual_px=np.full(POINTS, 0.3),
        )
    )  # fmt: skip


def tin() -> GroundField:
    cells = SquareCells(left=-SIZE / 2, top=SIZE / 2, cell=0.25)
    n = int(SIZE / cells.cell)
    x = cells.left + (np.arange(n) + 0.5) * cells.cell
    z = heights(np.stack(np.meshgrid(x, -x), axis=-1))
    plane = EnuPlane(origin=ORIGIN, level=250.0)
    return GroundField.of(
        tin_terrain(
            plane, cells, z, np.full((8, 8), 0.1), kind="tin", sigma=0.1, sigma_shared=0.02
        ),
        "TIN",
    )


def box(half: float) -> shapely.Polygon:
    corners = half * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    return shapely.Polygon(FRAME.map_from_enu(corners)[:, :2])


def raster(field: HeightField) -> None:
    cover = box(SIZE / 2 - 1.0)
    x0, y0, x1, _ = shapely.bounds(cover)
    pixel = (x1 - x0) / SIDE
    grid = Grid.over((x0, y0, x1, y0 + SIDE * pixel), pixel=pixel,
                     crs_wkt=FRAME.horizontal.to_wkt())  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "surface.tif"
        with TiledWriter(path, surface_profile(grid, FRAME, REFERENCE, field)) as writer:
            for row, col, values, known in surface_tiles(field, grid, FRAME, REFERENCE, cover):
                writer.write_tile(row, col, values, known)


def heap(field: HeightField) -> None:
    area = shapely.Point(0, 0).buffer(HEAP, quad_segs=64)
    found = volume(field, area, lambda one: RimPlane.of(one, area))
    count = len(cells_of(area, detail=field.detail).xy)
    print(f"    {count} cells, {found.net:.1f} +- {found.sigma_net:.1f} m3")


def line(field: HeightField) -> None:
    ends = np.array([[-SIZE / 2 + 1, -40.0, 0.0], [SIZE / 2 - 1, 60.0, 0.0]])
    across = shapely.LineString(FRAME.map_from_enu(ends)[:, :2])
    profile_along(field, FRAME, across, REFERENCE, step=np.hypot(SIZE - 2, 100.0) / 10_000)


def budget(kind: str) -> Callable[[], None]:
    photos = oriented_photos(many(1, 60, 120.0))
    terrain = FlatTerrain(origin=ORIGIN, height_ellipsoidal=250.0, sigma=1.0)
    scene = Scene.of(FRAME, terrain, photos)
    errors = SourcedErrors(errors=scene.errors, kinds=np.full(len(photos), -1))
    if kind == "photos":
        return lambda: print("   ", len(photo_budgets(scene, [p.id for p in photos], errors)[0]))
    rng = np.random.default_rng(0)
    size = photos[0].camera.width, photos[0].camera.height
    marks = [
        Mark(name=f"p{k}", photo=photos[k % len(photos)].id, u=float(rng.uniform(0, size[0])),
             v=float(rng.uniform(0, size[1])))
        for k in range(1000)
    ]  # fmt: skip
    return lambda: print("   ", len(point_budgets(locate_points(scene, marks), errors)))


def over(make: Callable[[], HeightField], job: Callable[[HeightField], None]) -> Made:
    """Part that has its surface made before it is timed."""

    def made() -> Callable[[], None]:
        field = make()
        return lambda: job(field)

    return made


PARTS: dict[str, Made] = {
    "nothing": lambda: lambda: None,
    "surface of points, 25 megapixels": over(points, raster),
    "surface of a TIN, 25 megapixels": over(tin, raster),
    "volume over points": over(points, heap),
    "volume over a TIN": over(tin, heap),
    "profile over points, 10 000 stations": over(points, line),
    "profile over a TIN, 10 000 stations": over(tin, line),
    "budget of 1 000 points": lambda: budget("points"),
    "budget of 60 photos": lambda: budget("photos"),
}


def run(name: str) -> None:
    """Time a part, and tell the peak of this process."""
    job = PARTS[name]()
    wall, cpu = time.perf_counter(), time.process_time()
    job()
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    print(f"{name:40s} {cpu:8.2f} s of CPU {wall:8.2f} s {peak:7.0f} MB", flush=True)


def main(*chosen: str) -> None:
    """Run each part in a process of its own."""
    context = multiprocessing.get_context("spawn")
    for name in PARTS:
        if chosen and not any(word in name for word in chosen):
            continue
        process = context.Process(target=run, args=(name,))
        process.start()
        process.join()


if __name__ == "__main__":
    main(*sys.argv[1:])
