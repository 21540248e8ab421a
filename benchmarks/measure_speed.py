"""How fast measuring is: intersections in bulk, places of clicks, who sees a place.

    python benchmarks/measure_speed.py [PHOTOS] [PROJECT]

A simulated flight of 167 photos (or PHOTOS) with a joint covariance of all poses; 10 000 points
with 4 rays each, from marks to covariances. With PROJECT, an adjusted one, the answers to single
clicks in it as the page asks for them: median and 95th percentile of 200.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "orient"))

from adjustment_flights import many, oriented_photos

from georef_gis.geodesy import MapFrame, Origin, utm_crs
from georef_gis.measure.points import Mark, intersect_points, locate_points
from georef_gis.measure.scene import Scene
from georef_gis.measure.who_sees import who_sees
from georef_gis.model.terrain import FlatTerrain
from processing_algorithms.measure.point_table import point_rows

POINTS, RAYS = 10_000, 4


def timed(what: str, run: Callable[[], object]) -> None:
    run()
    wall, cpu = time.perf_counter(), time.process_time()
    run()
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    print(f"{what:52s} {1000 * wall:9.1f} ms   {1000 * cpu:9.1f} ms of CPU")


def scene_of(photos: int) -> tuple[Scene, list[Mark]]:
    """Scene of a flight, and marks of the points."""
    flight = many(1, photos, 300.0)
    origin = Origin(lat=0.682, lon=-1.404, height_ellipsoidal=280.0)
    stack = oriented_photos(flight)
    root = 1e-2 * np.random.default_rng(0).normal(size=(6 * photos, 200))
    covariance = root @ root.T
    for k, photo in enumerate(stack):
        at = slice(6 * k, 6 * k + 6)
        covariance[at, at] += photo.pose.covariance
    scene = Scene.of(
        MapFrame(origin, utm_crs(origin.lat, origin.lon)),
        FlatTerrain(origin=origin, height_ellipsoidal=280.0, sigma=1.0),
        stack,
        covariance=covariance,
    )
    counts = np.bincount(flight.point)
    good = np.flatnonzero(counts >= RAYS)
    order = np.argsort(flight.point, kind="stable")
    first = np.searchsorted(flight.point[order], good)
    marks = []
    for i in range(POINTS):
        rows = order[first[i % len(good)] + np.arange(RAYS)]
        marks += [
            Mark(name=f"P{i}", photo=stack[flight.photo[k]].id, u=float(flight.uv[k, 0]),
                 v=float(flight.uv[k, 1]))
            for k in rows
        ]  # fmt: skip
    return scene, marks


def clicks(project: Path) -> None:
    """Answers to single clicks in a project."""
    from georef_gis.project import Project
    from processing_algorithms.measure.session import MeasureSession

    begun = time.perf_counter()
    session = MeasureSession.open(Project.open(project, read_only=True))
    print(f"project of {len(session.site.photos)} photos opened in "
          f"{1000 * (time.perf_counter() - begun):.0f} ms")  # fmt: skip
    rng, photos = np.random.default_rng(1), list(session.site.photos.values())
    jobs: dict[str, Callable[[Mark], object]] = {
        "click -> place, covariance, table": lambda m: session.rows(session.locate([m])),
        "click -> guide lines in all other photos": session.guide,
        "click -> who sees it": lambda m: session.who_sees(
            *(float(x) for x in session.frame.map_from_enu(session.locate([m]).p_enu[0])[:2])
        ),
    }
    for what, job in jobs.items():
        took = []
        for _ in range(200):
            photo = photos[rng.integers(len(photos))]
            size = np.array([photo.camera.width, photo.camera.height])
            u, v = (float(x) for x in rng.uniform(0.1, 0.9, 2) * size)
            begun = time.perf_counter()
            job(Mark(name="", photo=photo.id, u=u, v=v))
            took.append(1000 * (time.perf_counter() - begun))
        print(f"{what:52s} {np.median(took):9.1f} ms   95th {np.percentile(took, 95):6.1f} ms")


def main(photos: int = 167, project: str = "") -> None:
    scene, marks = scene_of(photos)
    timed(f"intersect {POINTS} points with {RAYS} rays", lambda: intersect_points(scene, marks))
    on = [replace(mark, on_ground=True) for mark in marks]
    timed("the same, said to lie on the ground", lambda: intersect_points(scene, on))
    points = intersect_points(scene, marks)
    timed(f"table of {POINTS} points", lambda: point_rows(points))
    timed("joint covariance of 300 of them", lambda: points.covariance(np.arange(300)))
    timed("locate 10 000 clicks", lambda: locate_points(scene, marks[::RAYS], on_fail="skip"))
    p, C = np.array([1.0, 2.0, 0.0]), np.eye(3) * 0.01
    timed(f"who sees a place, {photos} photos", lambda: who_sees(scene, p, C))
    if project:
        clicks(Path(project))


if __name__ == "__main__":
    main(*(int(word) if word.isdigit() else word for word in sys.argv[1:]))  # type: ignore[arg-type]
