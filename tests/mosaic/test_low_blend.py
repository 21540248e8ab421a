"""Low frequencies over a seam: they meet, they fade, nothing else changes."""

from __future__ import annotations

import pickle
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from georef_gis.model.grid import Grid, Window
from georef_gis.mosaic import low_blend
from georef_gis.mosaic.coarse import BLOCK, Proxy, SparseRaster, part_of
from georef_gis.mosaic.low_blend import LowBlend, OwnLow, blend_low, low_of
from georef_gis.mosaic.low_levels import LEVELS

Values = NDArray[np.float32]
WIDTH, HEIGHT = 900, 500
COARSE = Grid(crs_wkt="", left=0.0, top=0.0, pixel=1.0, width=WIDTH, height=HEIGHT)


@dataclass
class Photos:
    """Photos given by a window and an image over the whole grid."""

    parts: list[tuple[Window, Values]]

    @property
    def ids(self) -> list[str]:
        return [f"p{i}" for i in range(len(self.parts))]

    @property
    def windows(self) -> list[Window]:
        return [window for window, _ in self.parts]

    def load(self, index: int) -> Proxy:
        window, image = self.parts[index]
        whole = Window(col=0, row=0, width=WIDTH, height=HEIGHT)
        data = image[part_of(whole, window)]
        shape = data.shape[:2]
        return Proxy(
            photo_id=self.ids[index], window=window, data=data, valid=np.ones(shape, np.bool_),
            distance=np.zeros(shape, np.float32),
        )  # fmt: skip


def flat(*levels: float) -> Values:
    return np.broadcast_to(np.float32(levels), (HEIGHT, WIDTH, len(levels)))


def halves(seam: int) -> SparseRaster:
    labels = SparseRaster(width=WIDTH, height=HEIGHT, dtype=np.int32, fill=-1)
    values = np.where(np.arange(WIDTH) < seam, 0, 1).astype(np.int32)
    whole = Window(col=0, row=0, width=WIDTH, height=HEIGHT)
    labels.write(whole, np.broadcast_to(values, (HEIGHT, WIDTH)))
    return labels


def corrections(photos: Photos, blend: LowBlend, index: int) -> Values:
    """On the half grid; (rows, cols, bands)."""
    proxy = photos.load(index)
    base, own = low_of(proxy.data, proxy.valid, proxy.window)
    half = Window(col=0, row=0, width=WIDTH // 2, height=HEIGHT // 2)
    return blend.correction(half, base, own)


def test_one_photo_alone_is_not_touched() -> None:
    rng = np.random.default_rng(0)
    image = rng.uniform(0, 255, (HEIGHT, WIDTH, 3)).astype(np.float32)
    photos = Photos([(Window(col=40, row=30, width=700, height=400), image)])
    labels = SparseRaster(width=WIDTH, height=HEIGHT, dtype=np.int32, fill=-1)
    window = photos.windows[0]
    labels.write(window, np.zeros((window.height, window.width), np.int32))
    found = corrections(photos, blend_low(photos, labels, COARSE, 3), 0)
    inside = found[20:210, 25:365]
    # rounding of float32 sums of seven levels
    assert np.abs(inside).max() < 0.01


def test_two_levels_meet_at_the_seam_and_fade_away_from_it() -> None:
    left = (Window(col=0, row=0, width=640, height=HEIGHT), flat(100.0, 50.0))
    right = (Window(col=260, row=0, width=640, height=HEIGHT), flat(110.0, 48.0))
    photos = Photos([left, right])
    blend = blend_low(photos, halves(450), COARSE, 2)
    a, b = (corrections(photos, blend, i)[125] for i in (0, 1))
    # on both sides of the seam, column 225 of the half grid, the sums are one
    assert 100.0 + a[225, 0] == pytest.approx(110.0 + b[225, 0], abs=0.05)
    assert 100.0 + a[225, 0] == pytest.approx(105.0, abs=1.0)
    assert 50.0 + a[225, 1] == pytest.approx(49.0, abs=0.3)
    # two pixels of the widest level away nothing is left
    far = 3 * (1 << LEVELS) // 2
    assert np.abs(a[225 - far, 0]) < 0.2
    assert np.abs(b[225 + far, 0]) < 0.2
    # and in between it changes by less than a grey level in 4 pixels
    row = np.concatenate([100.0 + a[:225, 0], 110.0 + b[225:, 0]])
    assert np.abs(np.diff(row[130:320])).max() < 0.3


def test_detail_of_one_photo_does_not_go_over_into_the_other() -> None:
    rng = np.random.default_rng(1)
    detail = 20.0 * rng.choice([-1.0, 1.0], (HEIGHT, WIDTH, 1))
    left = (Window(col=0, row=0, width=640, height=HEIGHT), (100.0 + detail).astype(np.float32))
    photos = Photos([left, (Window(col=260, row=0, width=640, height=HEIGHT), flat(100.0))])
    blend = blend_low(photos, halves(450), COARSE, 1)
    found = np.abs(corrections(photos, blend, 1)[:, 225:])
    # white noise of 20: what it has below half the coarse resolution, at the seam; then nothing
    assert found.max() < 8.0
    assert found[:, 8:].max() < 1.5
    assert found[:, 3 << LEVELS :].max() < 0.01


def test_blocks_leave_no_trace() -> None:
    """The low frequencies are those of one block, where the sparse raster has several."""
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(np.float32)
    image = (100.0 + 30.0 * np.sin(x / 40.0) + 20.0 * np.cos(y / 30.0))[..., None]
    photos = Photos([(Window(col=0, row=0, width=WIDTH, height=HEIGHT), image)])
    labels = halves(WIDTH)
    found = corrections(photos, blend_low(photos, labels, COARSE, 1), 0)
    border = BLOCK
    assert np.abs(found[10:-10, border - 3 : border + 3]).max() < 0.01


def test_a_rim_in_the_neighbourhood_of_a_seam_makes_no_band() -> None:
    """Photo 1 ends 20 px beyond the seam: outside it must not count as black."""
    left = (Window(col=0, row=0, width=470, height=HEIGHT), flat(100.0))
    photos = Photos([left, (Window(col=430, row=0, width=470, height=HEIGHT), flat(100.0))])
    blend = blend_low(photos, halves(450), COARSE, 1)
    for index in (0, 1):
        own = photos.windows[index]
        inside = corrections(photos, blend, index)[:, own.col // 2 : (own.col + own.width) // 2]
        assert np.abs(inside).max() < 0.01


def noisy(bands: int) -> Photos:
    """Two photos of noise that overlap, at odd places."""
    image = np.random.default_rng(5).uniform(0, 255, (HEIGHT, WIDTH, bands)).astype(np.float32)
    windows = (
        Window(col=13, row=7, width=601, height=455),
        Window(col=301, row=0, width=599, height=500),
    )
    return Photos([(window, image + 10.0 * k) for k, window in enumerate(windows)])


def test_every_band_is_blended_like_one_alone() -> None:
    """Six of them: OpenCV treats up to four in ways of its own."""
    photos, labels = noisy(6), halves(450)
    low = blend_low(photos, labels, COARSE, 6).low
    for band in (0, 5):
        alone = Photos(
            [(w, np.ascontiguousarray(i[..., band : band + 1])) for w, i in photos.parts]
        )
        one = blend_low(alone, labels, COARSE, 1).low
        # grey values, float32
        for block in one:
            np.testing.assert_allclose(
                low.read(block)[..., band], one.read(block)[..., 0], atol=1e-3
            )


def test_threads_make_the_same_blend() -> None:
    photos, labels = noisy(3), halves(450)
    one, two = (blend_low(photos, labels, COARSE, 3, workers=n).low for n in (1, 2))
    assert list(one) == list(two)
    for block in one:
        np.testing.assert_array_equal(one.read(block), two.read(block))


def test_low_frequencies_are_kept_within_bounds(monkeypatch: pytest.MonkeyPatch) -> None:
    photos = noisy(1)
    loads: list[int] = []
    load = photos.load
    monkeypatch.setattr(photos, "load", lambda index: loads.append(index) or load(index))
    proxy = load(0)
    values, window = low_of(proxy.data, proxy.valid, proxy.window)
    own = OwnLow(photos)
    for _ in range(2):
        found = own.of(0)
        np.testing.assert_array_equal(found[0], values)
        assert found[1] == window
    assert loads == [0]
    # room for one: the other goes
    monkeypatch.setattr(low_blend, "KEPT_BYTES", values.nbytes)
    for index in (1, 1, 0):
        own.of(index)
    assert loads == [0, 1, 0]


def test_another_process_starts_with_nothing_kept() -> None:
    photos = Photos([(Window(col=0, row=0, width=64, height=64), flat(7.0).copy())])
    own = OwnLow(photos)
    empty = len(pickle.dumps(own))
    own.of(0)
    sent = pickle.dumps(own)
    assert len(sent) == empty
    np.testing.assert_allclose(pickle.loads(sent).of(0)[0], 7.0, rtol=1e-6)
