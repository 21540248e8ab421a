"""Points and tie points of an adjustment come back from their files."""

from __future__ import annotations

from pathlib import Path

import adjustment_flights as sim
import numpy as np
import pytest
from adjustment_cases import adjusted

from georef_gis.errors import InputError
from georef_gis.model.tie_points import TiePoints
from georef_gis.orient.adjustment.keep import (
    POINTS,
    load_points,
    load_ties,
    save_adjusted,
    save_ties,
)


def test_points_and_ties_come_back_as_they_were_kept(tmp_path: Path) -> None:
    answer = adjusted(sim.two_photos(23))
    files = save_adjusted(tmp_path, answer)
    assert set(files) == {path.name for path in tmp_path.iterdir()}
    points = load_points(files[POINTS])
    np.testing.assert_array_equal(points.p_enu, answer.points.p_enu)
    np.testing.assert_allclose(points.covariance, answer.points.covariance, rtol=1e-6, atol=1e-12)
    np.testing.assert_array_equal(points.rays, answer.points.rays)
    save_ties(tmp_path / "ties.npz", answer.block.ties)
    ties = load_ties(tmp_path / "ties.npz")
    assert ties.photo_ids == answer.block.ties.photo_ids
    for name in ("photo", "point", "uv", "sigma"):
        np.testing.assert_array_equal(getattr(ties, name), getattr(answer.block.ties, name))


def spoilt_ties(path: Path, ties: TiePoints, how: str) -> None:
    columns = {
        "photo_ids": list(ties.photo_ids), "photo": ties.photo, "point": ties.point,
        "uv": ties.uv, "sigma": ties.sigma,
    }  # fmt: skip
    from georef_gis.project.columns_file import write_columns

    if how == "without uv":
        del columns["uv"]
    elif how == "NaN":
        columns["uv"] = np.full_like(ties.uv, np.nan)
    elif how == "photo that is not there":
        columns["photo"] = ties.photo + 7
    write_columns(path, "tie points", columns)
    if how == "cut off":
        path.write_bytes(path.read_bytes()[:-200])
    elif how == "empty":
        path.write_bytes(b"")


@pytest.mark.parametrize(
    "how", ["without uv", "NaN", "photo that is not there", "cut off", "empty"]
)
def test_broken_tie_points_are_told_with_their_file(tmp_path: Path, how: str) -> None:
    path = tmp_path / "ties.npz"
    spoilt_ties(path, sim.ties(sim.two_photos(24)), how)
    with pytest.raises(InputError, match=r"ties\.npz"):
        load_ties(path)
