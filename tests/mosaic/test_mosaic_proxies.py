"""Photos on the coarse grid: where they count, and what does not spread."""

from __future__ import annotations

from pathlib import Path

import mosaic_cases as cases
import numpy as np
from numpy.typing import NDArray

from georef_gis.model.mesh import Ground
from georef_gis.mosaic.coarse import coarse_grid
from georef_gis.mosaic.proxies import ProxyPhoto, ProxyStore, proxy_window


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
    path = next(tmp_path.glob("*.npz"))
    path.write_bytes(path.read_bytes()[:-100])
    assert not store.has(0)
