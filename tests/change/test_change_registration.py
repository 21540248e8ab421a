"""How two maps lie upon each other is found, with a sigma that holds, or refused."""

import os
from pathlib import Path

import cv2
import numpy as np
import pytest
from change_cases import CUT, FINE, Image, Look, Thing, ground, registered, render, write

from georef_gis.errors import GeometryError
from georef_gis.measure.change.pair import common_cells
from georef_gis.measure.change.registration import MODELS, WindowShift, fit_registration


def _windows(
    rng: np.random.Generator, slope: np.ndarray, *, count: int = 40, wrong: int = 8
) -> list[WindowShift]:
    """Windows of a shift (3, -2) with a slope, deviation 0.1 by score 0.7, and wrong ones."""
    found = []
    for number in range(count + wrong):
        place = rng.uniform(0, 1000, 2)
        shift = np.array([3.0, -2.0]) + slope @ (place - 500.0) + rng.normal(0, 0.1, 2)
        if number >= count:
            shift = rng.uniform(-20, 20, 2)
        found.append(
            WindowShift(col=place[0], row=place[1], d_col=shift[0], d_row=shift[1], score=0.7)
        )
    return found


@pytest.mark.parametrize(
    ("name", "slope"),
    [
        ("shift", np.zeros((2, 2))),
        ("similarity", np.array([[1e-3, -5e-4], [5e-4, 1e-3]])),
        ("affine", np.array([[1e-3, 2e-3], [0.0, -1e-3]])),
    ],
)
def test_model_is_the_simplest_that_the_windows_ask_for(name: str, slope: np.ndarray) -> None:
    chosen = [
        fit_registration(_windows(np.random.default_rng(seed), slope), tried=60, most=30).model
        for seed in range(20)
    ]
    # the criterion takes a richer model by chance in a few of a hundred
    assert chosen.count(name) >= 17


@pytest.mark.parametrize("name", ["shift", "affine"])
def test_sigma_of_the_shift_holds_over_draws(name: str) -> None:
    slope = np.zeros((2, 2)) if name == "shift" else np.array([[1e-3, 2e-3], [0.0, -1e-3]])
    ratios = []
    for seed in range(60):
        rng = np.random.default_rng(100 + seed)
        found = fit_registration(_windows(rng, slope), tried=60, most=30)
        truth = np.array([3.0, -2.0]) + slope @ (np.array(found.middle) - 500.0)
        ratios.append((np.array(found.shift) - truth) / np.sqrt(np.diag(found.covariance)))
    # 120 values: their own deviation is 6 %
    assert 0.8 < np.sqrt(np.mean(np.square(ratios))) < 1.25


def test_parts_of_the_site_that_move_do_not_pull_the_shift() -> None:
    rng = np.random.default_rng(3)
    found = fit_registration(_windows(rng, np.zeros((2, 2)), wrong=40), tried=90, most=30)
    # cells; the windows scatter by 0.1, forty of them agree
    np.testing.assert_allclose(found.shift, (3.0, -2.0), atol=0.06)
    assert found.agreeing <= 44


def test_windows_that_disagree_are_refused() -> None:
    rng = np.random.default_rng(4)
    windows = _windows(rng, np.zeros((2, 2)), count=0, wrong=40)
    with pytest.raises(GeometryError, match="agree"):
        fit_registration(windows, tried=40, most=30)


def test_misfit_shared_by_neighbours_widens_the_covariance() -> None:
    def sigma(alike: bool) -> float:
        rng = np.random.default_rng(6)
        windows = []
        for row in range(10):
            for col in range(10):
                bend = 0.3 * np.array([np.sin(col / 1.5), np.cos(row / 1.5)])
                left = bend if alike else rng.normal(0, 0.2, 2)
                windows.append(
                    WindowShift(
                        col=100.0 * col, row=100.0 * row, d_col=left[0], d_row=left[1], score=0.7
                    )
                )
        return fit_registration(windows, tried=100, most=10).sigma

    assert sigma(True) > 2.0 * sigma(False)


def test_every_model_has_its_number_of_parameters() -> None:
    assert MODELS == {"shift": 2, "similarity": 4, "affine": 6}


@pytest.fixture(scope="module")
def errors(site: Image, tmp_path_factory: pytest.TempPathFactory) -> np.ndarray:
    """Error and sigma of the shift of maps that differ in much, m: shape (n, 2, 2)."""
    folder = tmp_path_factory.mktemp("shifts")
    rng = np.random.default_rng(1)
    later = render(folder / "later.tif", site, Look(), rng)
    found = []
    for number in range(12):
        shift = rng.uniform(-1.5, 1.5, 2)
        look = Look(
            gsd=0.06, shift=tuple(shift), gain=(0.8, 0.85, 0.9), shading=0.1, noise=0.02, blur=0.9,
            jpeg=75, grey=number % 3 == 0,
            things=[Thing(*rng.uniform(6, 24, 2), 4.0, 2.0, (0.8, 0.1, 0.1))],
        )  # fmt: skip
        earlier = render(folder / "earlier.tif", site, look, rng)
        one = registered(later, earlier, 0.1)
        sigma = np.sqrt(np.diag(one.covariance))
        found.append((np.array(one.shift) * 0.1 - shift, sigma * 0.1))
    return np.array(found)


def test_shift_of_two_maps_is_found_to_a_twentieth_of_a_cell(errors: np.ndarray) -> None:
    # m; cells are 0.1 m
    assert np.abs(errors[:, 0]).max() < 0.005


def test_sigma_of_the_shift_of_two_maps_holds(errors: np.ndarray) -> None:
    # 24 values: their own deviation is 14 %
    assert 0.6 < np.sqrt(np.mean((errors[:, 0] / errors[:, 1]) ** 2)) < 1.5


def test_scale_and_turn_are_found(site: Image, tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    later = render(tmp_path / "later.tif", site, Look(), rng)
    look = Look(scale=1.004, turn=0.003, shift=(0.5, -0.3))
    earlier = render(tmp_path / "earlier.tif", site, look, rng)
    found = registered(later, earlier, 0.1)
    a, b, _, d, e, _ = found.moved
    assert found.model == "similarity"
    # the earlier map shows the ground smaller and turned back; 26 m at 0.1 cells is 4e-4
    size = np.sqrt(a * e - b * d)
    np.testing.assert_allclose(size, 1 / 1.004, atol=4e-4)
    np.testing.assert_allclose(np.arctan2(d, a), -0.003, atol=4e-4)


def test_another_place_is_refused(site: Image, tmp_path: Path) -> None:
    rng = np.random.default_rng(8)
    later = render(tmp_path / "later.tif", site, Look(), rng)
    other = np.ascontiguousarray(ground(np.random.default_rng(77), 30.0)[::-1].swapaxes(0, 1))
    earlier = render(tmp_path / "earlier.tif", other, Look(), rng)
    with pytest.raises(GeometryError, match="same place"):
        registered(later, earlier, 0.1)


@pytest.mark.parametrize(("number", "other"), [(3, 4), (9, 12)])
def test_photos_of_two_real_places_are_refused(number: int, other: int, tmp_path: Path) -> None:
    folder = os.environ.get("GEOREF_DATA")
    if not folder:
        pytest.skip("GEOREF_DATA is not set: no real photos")
    paths = []
    for name, which in (("brighton_beach", number), ("seneca16", other)):
        photo = sorted((Path(folder) / name / "photos").iterdir())[which]
        seen = cv2.imread(str(photo), cv2.IMREAD_REDUCED_COLOR_2)
        paths.append(tmp_path / f"{name}.tif")
        write(paths[-1], seen[:1100, :1600, ::-1] / 255.0, Look(jpeg=None))
    with pytest.raises(GeometryError, match="same place"):
        registered(*paths, 0.1)


def test_shift_beyond_what_is_believed_is_refused(site: Image, tmp_path: Path) -> None:
    rng = np.random.default_rng(9)
    later = render(tmp_path / "later.tif", site, Look(), rng)
    earlier = render(tmp_path / "earlier.tif", site, Look(shift=(3.0, 0.0)), rng)
    with pytest.raises(GeometryError, match="max-shift"):
        registered(later, earlier, 0.1, most=1.0)


def test_grid_is_in_the_ground_that_both_show(site: Image, tmp_path: Path) -> None:
    rng = np.random.default_rng(10)
    later = render(tmp_path / "later.tif", site, Look(), rng)
    earlier = render(tmp_path / "earlier.tif", site, Look(origin=(10.0, 0.0)), rng)
    cells = common_cells(later, earlier, 0.1)
    side = site.shape[0] * FINE - 2 * CUT
    # cells; the masks are coarse by one cell of 512 across
    np.testing.assert_allclose(cells.header.width * 0.1, side - 10.0, atol=0.3)
    np.testing.assert_allclose(cells.header.height * 0.1, side, atol=0.3)
