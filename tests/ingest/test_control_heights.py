"""Words about heights of control that do not lie on the ground."""

from __future__ import annotations

import numpy as np

from georef_gis.geodesy import HeightKind
from georef_gis.ingest.control_heights import Heights, settle_heights

GROUND = np.full(3, 311.6)


def settled(height: float, ground: np.ndarray = GROUND) -> Heights:
    """Three heights stated as orthometric, m, where the geoid lies 33.4 m below the ellipsoid."""
    return settle_heights(
        np.full(3, height), np.full(3, -33.4), ground, sigma_ground=1.0,
        kind=HeightKind.ORTHOMETRIC, unit=1.0, source="control.csv",
    )  # fmt: skip


def test_a_height_off_the_ground_is_told_with_both_above_the_ellipsoid() -> None:
    """As written it equals the ground's ellipsoidal height, which is not the same place."""
    (line,) = settled(311.6).doubts
    assert "median height 311.6 (orthometric) is 278.2 m above the ellipsoid" in line
    assert "33 m below the ground at 311.6 m" in line
    (above,) = settled(378.4).doubts
    assert "33 m above the ground at 311.6 m" in above


def test_a_height_on_the_ground_or_without_ground_is_not_doubted() -> None:
    assert settled(345.0).doubts == ()
    assert settled(345.0, np.full(3, np.nan)).doubts == ()
