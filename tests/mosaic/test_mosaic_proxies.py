"""Photos on the coarse grid: where they count, and what does not spread."""

from __future__ import annotations

from pathlib import Path

import mosaic_cases as cases
import numpy as np
import pytest
from numpy.typing import NDArray

from georef_gis.frames import Array
from georef_gis.model.mesh import Ground, node_positions
from georef_gis.model.terrain import dem_terrain
from georef_gis.mosaic.coarse import coarse_grid
from georef_gis.mosaic.proxies import CorrectedProxies, ProxyPhoto, ProxyStore, proxy_window
from georef_gis.rasters.warp import warp_window


def made(image: NDArray[np.floating], folder: Path) -> ProxyStore:
    photo = cases.photo_at(0.0, 0.0, "a")
    scene = cases.Scene([photo], {})
    ground = Ground.of(scene.frame, scene.grid, cases.TERRAIN, (200.0, 200.0))
    coarse = coarse_grid(scene.grid, 2)
    window = proxy_window(coarse, scene.prints["a"].ring_map)
    source = ProxyPhoto(photo=photo, window=window, reduce=1, reach=72.1)
    store = ProxyStore(folder, [source], coarse)
    assert not store.has(0)
    store.make(0, lambda path, reduce: image, ground)
    assert store.has(0)
    return store


def test_a_proxy_shows_the_photo_within_its_rim(tmp_path: Path) -> None:
    proxy = made(cases.flat_image(40, 50, 60), tmp_path).load(0)
    assert proxy.valid.mean() > 0.9
    np.testing.assert_allclose(proxy.data[proxy.valid], np.broadcast_to([40, 50, 60], (
        np.count_nonzero(proxy.valid), 3)))  # fmt: skip
    assert np.all(np.isinf(proxy.distance[~proxy.valid]))
    assert not proxy.valid[0].any()


def test_nodata_of_floats_is_not_valid_and_does_not_spread(tmp_path: Path) -> None:
    image = np.full((400, 600, 2), 0.25, np.float32)
    image[200, 300] = np.nan
    proxy = made(image, tmp_path).load(0)
    assert np.all(np.isfinite(proxy.data))
    np.testing.assert_allclose(proxy.data[proxy.valid], 0.25, rtol=1e-6)
    # a pixel, what bilinear sampling and the rim make of it
    hole = ~proxy.valid[60:-60, 60:-60]
    assert 1 <= np.count_nonzero(hole) <= 40


def test_a_proxy_cut_short_is_none(tmp_path: Path) -> None:
    store = made(cases.flat_image(1, 2, 3), tmp_path)
    path = next(tmp_path.glob("*.proxy"))
    path.write_bytes(path.read_bytes()[:-100])
    assert not store.has(0)


@pytest.mark.parametrize("turn_deg", [0.0, 33.0])
@pytest.mark.parametrize("reduce", [1, 2])
def test_a_proxy_over_rough_ground_is_the_warped_photo(
    turn_deg: float, reduce: int, tmp_path: Path
) -> None:
    photo = cases.photo_at(0.0, 0.0, "a", turn_deg=turn_deg)
    scene = cases.Scene([photo], {})
    left, top = (float(v) for v in scene.frame.map_from_enu([-120.0, 120.0, 0.0])[:2])
    # steps of a metre between cells of 2 m
    heights = 199.0 + np.random.default_rng(0).normal(size=(120, 120))
    terrain = dem_terrain(
        scene.frame, heights, left=left, top=top, cell=(2.0, 2.0), metres_per_unit=1.0
    )
    ground = Ground.of(scene.frame, scene.grid, terrain, (194.0, 204.0))
    coarse = coarse_grid(scene.grid, 2)
    window = proxy_window(coarse, scene.prints["a"].ring_map)
    v, u = np.mgrid[: 400 // reduce, : 600 // reduce]
    image = (np.stack([u, v], axis=-1) * 80).astype(np.uint16)
    source = ProxyPhoto(photo=photo, window=window, reduce=reduce, reach=72.1)
    store = ProxyStore(tmp_path, [source], coarse)
    store.make(0, lambda path, reduce: image, ground)
    found = store.load(0)
    warped = warp_window(photo, image, ground, coarse, window, step=8, reduce=reduce)
    assert warped is not None
    data, mask = warped
    assert mask is not None
    # but for the rim of one pixel
    assert not (found.valid & ~mask).any()
    assert found.valid.sum() > 0.95 * mask.sum()
    # px of the image: OpenCV samples at its 32nds
    error = np.abs(found.data - data)[found.valid] / 80.0
    assert error.max() < 0.05


class Shade:
    """Grows with the place in the photo, by another amount in each band."""

    def __init__(self, bands: int) -> None:
        self.bands = np.arange(1.0, bands + 1.0)

    knee = 0.0

    def factor(self, photo: int, xy: Array, view: Array) -> Array:
        return 1.0 + 0.1 * xy[..., :1] * self.bands

    def offset(self, photo: int) -> Array:
        return 10.0 * self.bands


@pytest.mark.parametrize("bands", [1, 3, 6])
def test_corrected_is_value_by_factor_plus_offset(bands: int, tmp_path: Path) -> None:
    store = made(cases.flat_image(*range(50, 50 + bands)), tmp_path)
    plain = store.load(0)
    scene = cases.Scene([cases.photo_at(0.0, 0.0, "a")], {})
    ground = Ground.of(scene.frame, scene.grid, cases.TERRAIN, (200.0, 200.0))
    found = CorrectedProxies(store, Shade(bands), ground).load(0)
    assert found.data.shape == plain.data.shape
    places = node_positions(plain.window, 1)[1:-1, 1:-1]
    xy, view = store.places(0, places[..., 0].ravel(), places[..., 1].ravel(), ground)
    factor = Shade(bands).factor(0, xy, view).reshape(plain.data.shape)
    expected = plain.data * factor + Shade(bands).offset(0)
    # grey values; the factor is bilinear between nodes 8 px apart, and held to the photo's rim
    np.testing.assert_allclose(found.data[plain.valid], expected[plain.valid], atol=0.01)
