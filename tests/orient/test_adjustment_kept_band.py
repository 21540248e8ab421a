"""What a large block keeps of its covariance, asked for later, against its own factor."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from adjustment_blocks import block_of, control_input, first_points
from adjustment_flights import strip

from georef_gis.errors import InputError
from georef_gis.orient.adjustment import keep
from georef_gis.orient.adjustment import problem as problem_module
from georef_gis.orient.adjustment.adjust import Adjusted, adjust
from georef_gis.orient.adjustment.keep import BAND, COVARIANCE, save_adjusted
from georef_gis.project.band_covariance import BandCovariance, load_band_covariance

PHOTOS = 40


@pytest.fixture(scope="module")
def large() -> Adjusted:
    """A strip, of which photos at both ends lie outside of the band, with control."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(problem_module, "LARGE", 5)
        flight = strip(5, PHOTOS, control=2, obs_per_photo=60.0)
        block = block_of(flight, control=control_input((flight.control, True)), sigma_level=10.0)
        return adjust(block, first_points(flight, block))


@pytest.fixture
def kept(large: Adjusted, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> BandCovariance:
    monkeypatch.setattr(keep, "MOST_KEPT", 10)
    files = save_adjusted(tmp_path, large)
    assert COVARIANCE not in files
    found = load_band_covariance(files[BAND])
    assert found is not None
    return found


def scaled(off: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    return off / sigma[:, None] / sigma


def test_any_two_photos_have_the_covariance_of_the_adjustment(
    large: Adjusted, kept: BandCovariance
) -> None:
    """Within the band and beyond it, level included; asked for all at once and pair by pair."""
    ids = list(reversed(large.block.photo_ids))
    errors = kept.pose_errors(ids)
    width = len(kept.errors.factor)
    assert width < 6 * PHOTOS - 6
    a, b = (m.ravel() for m in np.meshgrid(np.arange(PHOTOS), np.arange(PHOTOS), indexing="ij"))
    C = errors.pairs(a, b).reshape(PHOTOS, PHOTOS, 6, 6)
    matrix = np.swapaxes(C, 1, 2).reshape(6 * PHOTOS, 6 * PHOTOS)
    true = large.covariances.joint(photos=range(PHOTOS - 1, -1, -1))
    sigma = np.sqrt(np.diag(true))
    # of correlations: rounding of two ways through one factor
    np.testing.assert_allclose(scaled(matrix - true, sigma), 0.0, atol=1e-7)
    # of one photo with all: solved for the one
    every, one_photo = np.arange(PHOTOS), np.zeros(PHOTOS, dtype=np.int64)
    np.testing.assert_allclose(errors.pairs(one_photo, every), C[0], atol=1e-12)
    np.testing.assert_allclose(errors.pairs(every, one_photo), C[:, 0], atol=1e-12)
    for i, j in ((0, PHOTOS - 1), (PHOTOS - 1, 0), (3, 4), (7, 7)):
        one = errors.pairs(np.array([i]), np.array([j]))[0]
        np.testing.assert_allclose(one, C[i, j], atol=1e-12)


def test_photos_hang_together_with_cameras_as_in_the_adjustment(
    large: Adjusted, kept: BandCovariance
) -> None:
    ids = [large.block.photo_ids[k] for k in (0, 17, PHOTOS - 1)]
    owner, _, name = large.block.shared_names[0].rpartition(" ")
    rows = kept.shared_rows(owner, [name])
    assert rows is not None
    true = large.covariances.joint(photos=[0, 17, PHOTOS - 1], shared=rows.tolist())
    found = kept.with_shared(ids, rows).reshape(18, 1)
    sigma = np.sqrt(np.diag(true))
    np.testing.assert_allclose(found[:, 0] / sigma[:18] / sigma[18], true[:18, 18] / sigma[:18]
                               / sigma[18], atol=1e-7)  # fmt: skip
    np.testing.assert_allclose(kept.between(rows, rows), true[18:, 18:], rtol=1e-9)
    assert kept.shared_rows("nobody", [name]) is None


def test_a_band_too_large_is_not_kept_and_the_old_one_goes(
    large: Adjusted, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert load_band_covariance(tmp_path / BAND) is None
    monkeypatch.setattr(keep, "MOST_KEPT", 10)
    assert BAND in save_adjusted(tmp_path, large)
    monkeypatch.setattr(keep, "MOST_IN_BAND", 10)
    assert BAND not in save_adjusted(tmp_path, large)
    assert not (tmp_path / BAND).exists()
    monkeypatch.undo()
    # whole again
    assert COVARIANCE in save_adjusted(tmp_path, large)


def test_a_band_that_is_cut_off_names_its_cure(kept: BandCovariance, tmp_path: Path) -> None:
    path = tmp_path / BAND
    path.write_bytes(path.read_bytes()[:300])
    with pytest.raises(InputError, match=r"covariance_band.npz: .*run `georef run`"):
        load_band_covariance(path)
