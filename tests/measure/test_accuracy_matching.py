"""Matching of neighbourhoods: textures whose place in the picture is known."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from georef_gis.measure.accuracy.matching import Grey, Match, find_patch

# texture pixels per pixel of the pictures
SCALE = 4.0
SIDE, PATCH = 161, 85


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(7)


@pytest.fixture(scope="module")
def texture() -> Grey:
    """Random ground of 900 x 900, blurred to the pictures' pixels."""
    rng = np.random.default_rng(7)
    out = np.zeros((900, 900), np.float32)
    for size, contrast in ((2, 20), (6, 25), (20, 30), (80, 30)):
        grains = rng.normal(size=out.shape).astype(np.float32)
        out += contrast * 3.5 * size * cv2.GaussianBlur(grains, (0, 0), size)
    return cv2.GaussianBlur(np.clip(128 + out, 0, 255), (0, 0), 0.45 * SCALE)


def picture(texture: Grey, centre: np.ndarray, side: int, *, turn: float = 0.0,
            scale: float = 1.0) -> Grey:  # fmt: skip
    """Picture whose middle pixel shows a place of the texture."""
    a = np.radians(turn)
    R = scale * SCALE * np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]])
    M = np.column_stack([R, centre - R @ [side // 2, side // 2]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return cv2.warpAffine(texture, M, (side, side), flags=flags, borderMode=cv2.BORDER_REFLECT)


def jpeg(image: Grey) -> Grey:
    _, data = cv2.imencode(".jpg", np.clip(image, 0, 255).astype(np.uint8),
                           [cv2.IMWRITE_JPEG_QUALITY, 85])  # fmt: skip
    return cv2.imdecode(data, cv2.IMREAD_GRAYSCALE).astype(np.float32)


def trial(rng: np.random.Generator, texture: Grey, noise: float, turn: float,
          scale: float = 1.0) -> tuple[Match | str, np.ndarray]:  # fmt: skip
    """Match of a patch, brighter and with noise of its own, and its true place, px."""
    centre = 450.0 + rng.uniform(-20, 20, 2)
    shift = rng.uniform(-12, 12, 2)
    whole = picture(texture, centre, SIDE)
    patch = picture(texture, centre + SCALE * shift, PATCH, turn=turn, scale=scale)
    whole = jpeg(whole + noise * rng.normal(size=whole.shape))
    patch = jpeg(0.9 * patch + 8.0 + noise * rng.normal(size=patch.shape))
    found = find_patch(patch, whole, np.ones(whole.shape, bool))
    return found, SIDE // 2 + shift


@pytest.mark.parametrize(
    ("noise", "turn", "scale"),
    [(12.0, 0.0, 1.0), (20.0, 0.0, 1.0), (20.0, 5.0, 1.02)],
    ids=["noise 12", "noise 20", "turned by 5 deg"],
)
def test_error_of_a_match_is_as_its_sigma_says(
    rng: np.random.Generator, texture: Grey, noise: float, turn: float, scale: float
) -> None:
    ratios = []
    for _ in range(50):
        found, true = trial(rng, texture, noise, turn, scale)
        assert isinstance(found, Match), found
        ratios.extend((found.xy - true) / found.sigma)
    assert 0.6 < np.sqrt(np.mean(np.square(ratios))) < 1.4


@pytest.mark.parametrize("turn", [-13.0, -8.0, 8.0, 13.0])
def test_a_patch_turned_by_a_wrong_heading_is_found(
    rng: np.random.Generator, texture: Grey, turn: float
) -> None:
    found, true = trial(rng, texture, 3.0, turn)
    assert isinstance(found, Match), found
    np.testing.assert_allclose(found.xy, true, atol=0.15)  # px


def test_what_is_not_there_is_not_found(rng: np.random.Generator, texture: Grey) -> None:
    whole = picture(texture, np.array([250.0, 250.0]), 101)
    patch = picture(texture, np.array([700.0, 700.0]), PATCH)
    found = find_patch(patch, whole, np.ones(whole.shape, bool))
    assert isinstance(found, str)
    assert "nothing like it" in found


def test_a_pattern_that_repeats_is_not_read() -> None:
    rows, cols = np.mgrid[:161, :161]
    waves = (128 + 60 * np.sin(rows / 2.5) * np.sin(cols / 2.5)).astype(np.float32)
    found = find_patch(waves[:85, :85], waves, np.ones(waves.shape, bool))
    assert isinstance(found, str)
    assert "several places" in found


def test_bland_ground_is_not_read() -> None:
    flat = np.full((161, 161), 90.0, np.float32)
    found = find_patch(flat[:85, :85], flat, np.ones(flat.shape, bool))
    assert found == "its neighbourhood is bland"


def test_places_without_a_picture_are_no_match(rng: np.random.Generator, texture: Grey) -> None:
    whole = picture(texture, np.array([450.0, 450.0]), SIDE)
    patch = picture(texture, np.array([450.0, 450.0]), PATCH)
    valid = np.ones(whole.shape, bool)
    valid[80, 80] = False
    found = find_patch(patch, np.where(valid, whole, 0.0).astype(np.float32), valid)
    assert isinstance(found, str)
