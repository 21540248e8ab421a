"""Heights of fixes: which geoid counts, and what is done where their kind is not stated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from navigation_flights import drawn, logs_of

from georef_gis.errors import CrsError
from georef_gis.geodesy import HeightKind, geoid_undulation
from georef_gis.model.logs import GnssLog
from georef_gis.navigate.gnss_noise import prepare_fixes
from georef_gis.navigate.resample import trajectory_of_gnss


@pytest.fixture(scope="module")
def log() -> GnssLog:
    return logs_of(drawn(1, 1))[1]


def test_orthometric_fixes_are_lifted_by_the_receivers_own_geoid_else_by_the_model(
    log: GnssLog,
) -> None:
    own = np.where(np.arange(len(log)) % 2 == 0, -31.0, np.nan)
    given = replace(log, height_kind=HeightKind.ORTHOMETRIC, geoid_separation=own)
    model = geoid_undulation(log.lat, log.lon)
    wanted = log.height + np.where(np.isfinite(own), own, model)
    np.testing.assert_allclose(prepare_fixes(given).p_geo[:, 2], wanted, atol=1e-9)
    np.testing.assert_allclose(trajectory_of_gnss(given).height, wanted, atol=1e-9)
    assert np.abs(model + 31.0).min() > 0.1  # m: the two do differ here


def test_heights_of_no_stated_kind_are_taken_from_the_sea_but_compared_with_nothing(
    log: GnssLog,
) -> None:
    given = replace(log, height_kind=HeightKind.UNKNOWN)
    model = geoid_undulation(log.lat, log.lon)
    np.testing.assert_allclose(prepare_fixes(given).p_geo[:, 2], log.height + model, atol=1e-9)
    with pytest.raises(CrsError, match="'unknown' have no ellipsoidal value"):
        trajectory_of_gnss(given)


def test_heights_above_ground_are_no_heights_of_fixes(log: GnssLog) -> None:
    given = replace(log, height_kind=HeightKind.ABOVE_GROUND)
    for use in (prepare_fixes, trajectory_of_gnss):
        with pytest.raises(CrsError, match="above_ground"):
            use(given)
