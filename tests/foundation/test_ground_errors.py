"""How errors of the ground's height hang together."""

from __future__ import annotations

import geometry_cases as cases
import numpy as np
import pytest

from georef_gis.model.ground_errors import GroundErrors
from georef_gis.model.terrain import FlatTerrain
from georef_gis.model.tin import EnuPlane, SquareCells, TinTerrain, tin_terrain

FLAT = FlatTerrain(origin=cases.SITE, height_ellipsoidal=277.6, sigma=1.0)


def tin() -> TinTerrain:
    sigmas = np.full((10, 10), 0.3)
    sigmas[:, 5:] = 0.6
    return tin_terrain(
        EnuPlane(origin=cases.SITE, level=277.6), SquareCells(left=-50.0, top=50.0, cell=10.0),
        np.full((10, 10), 277.6), sigmas, kind="tin", sigma=0.6, sigma_shared=0.4,
    )  # fmt: skip


@pytest.mark.parametrize("terrain", [FLAT, cases.kinked_dem(), tin()], ids=["flat", "DEM", "TIN"])
def test_covariances_are_those_of_one_law(terrain: FlatTerrain) -> None:
    law = GroundErrors.of(terrain)
    xy = np.random.default_rng(1).uniform(-40, 40, (30, 2))
    C = law.between(xy, xy)
    np.testing.assert_allclose(np.diag(C), law.variance(xy))
    assert np.linalg.eigvalsh(C).min() > -1e-9
    np.testing.assert_allclose(law.between(xy[:3], xy[5:9]), C[:3, 5:9])


def test_near_places_err_alike_and_far_ones_share_the_level() -> None:
    law = GroundErrors.of(FLAT)
    (near, far) = law.between([[0.0, 0.0]], [[1.0, 0.0], [5000.0, 0.0]])[0]
    assert near == pytest.approx(1.0, rel=1e-3)
    assert far == pytest.approx(0.5)


def test_a_tin_tells_its_shared_sigma_from_the_local_one() -> None:
    law = GroundErrors.of(tin())
    assert law.shared == pytest.approx(0.4)
    assert law.local([[-35.0, 0.0], [35.0, 0.0]]) == pytest.approx([0.3, 0.6])
    # the photos that it was made from tell the shared one
    tied = GroundErrors.of(tin(), tied=True)
    assert tied.shared == 0.0
    assert tied.local([[-35.0, 0.0]]) == pytest.approx([0.3])
