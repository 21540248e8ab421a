"""Ground that was made of the photos' own points errs with them."""

from __future__ import annotations

from dataclasses import replace

import measure_scenes as scenes
import numpy as np
import pytest

from georef_gis.measure.points import Mark, intersect_points, locate_points
from georef_gis.measure.scene import Scene
from georef_gis.model.ground_errors import GroundErrors
from georef_gis.model.tin import EnuPlane, SquareCells, TinTerrain, tin_terrain

PLACE = np.array([1.0, 2.0, 0.0])
LOCAL, SHARED = 0.05, 0.8


def tin() -> TinTerrain:
    return tin_terrain(
        EnuPlane(origin=scenes.ORIGIN, level=277.6), SquareCells(left=-100.0, top=100.0, cell=4.0),
        np.full((50, 50), 277.6), np.full((5, 5), LOCAL), kind="tin",
        sigma=float(np.hypot(LOCAL, SHARED)), sigma_shared=SHARED,
    )  # fmt: skip


def tied(made: np.ndarray | None = None) -> Scene:
    scene = scenes.scene()
    terrain = tin()
    return replace(
        scene, terrain=terrain, ground=GroundErrors.of(terrain, tied=True),
        ground_photos=np.arange(3) if made is None else made,
    )  # fmt: skip


def click(scene: Scene, photo: str = "A") -> list[Mark]:
    u, v = scene.photo(photo).project(PLACE)
    return [Mark(name="P", photo=photo, u=float(u), v=float(v), sigma_px=scenes.CLICK)]


def test_a_shift_of_all_photos_shifts_a_located_place_by_as_much() -> None:
    """Cameras and ground move together: east, north and up."""
    point = locate_points(tied(), click(tied()))[0]
    moved = np.sum(
        [J[:, :3] for (kind, _), J in point.sensitivity.items() if kind == "pose"], axis=0
    )
    np.testing.assert_allclose(moved, np.eye(3), atol=1e-6)
    assert len(point.sensitivity) == 4  # three photos and the camera


def test_ground_measured_otherwise_stays_where_it_is() -> None:
    scene = replace(tied(), ground_photos=np.zeros(0, dtype=np.int64))
    point = locate_points(scene, click(scene))[0]
    ((_, J), *_) = point.sensitivity.items()
    np.testing.assert_allclose(J[2, :3], 0.0, atol=1e-6)
    assert {key for kind, key in point.sensitivity if kind == "pose"} == {"A"}


def test_a_shift_of_all_photos_shifts_an_intersected_place_by_as_much() -> None:
    scene = scenes.scene()
    marks = [m for key in "ABC" for m in click(scene, key)]
    point = intersect_points(scene, marks)[0]
    moved = np.sum(
        [J[:, :3] for (kind, _), J in point.sensitivity.items() if kind == "pose"], axis=0
    )
    np.testing.assert_allclose(moved, np.eye(3), atol=1e-6)


def test_located_on_their_own_ground_places_are_as_good_as_intersected_ones() -> None:
    """The joint error of both is that of the photos, but for clicks and the ground's detail."""
    scene = tied()
    located = locate_points(scene, click(scene))
    crossed = intersect_points(scene, [m for key in "ABC" for m in click(scene, key)])
    a, b = (np.sqrt(np.diag(one.covariance_of(0))) for one in (located, crossed))
    np.testing.assert_allclose(a, b, rtol=0.35)
    loose = replace(
        scene, ground=GroundErrors.of(scene.terrain), ground_photos=np.zeros(0, dtype=np.int64)
    )
    up = np.sqrt(locate_points(loose, click(loose)).covariance_of(0)[2, 2])
    assert up == pytest.approx(np.hypot(LOCAL, SHARED), rel=0.01)
    assert a[2] < 0.7 * up


def test_where_one_photo_alone_looks_the_surfaces_own_sigma_stands() -> None:
    """One photo tells no height: what the surface says of itself is all that is known."""
    scene = tied(np.array([0]))
    point = locate_points(scene, click(scene))[0]
    assert {key for kind, key in point.sensitivity if kind == "pose"} == {"A"}
    assert np.sqrt(point.covariance[2, 2]) == pytest.approx(np.hypot(LOCAL, SHARED), rel=0.01)
