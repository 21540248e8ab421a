"""Rendering of the mosaic: who wins, how seams look, and what a broken photo does."""

import numpy as np
import pytest
from mosaic_cases import Scene, flat_image, photo_at

# grey levels per px that a seam may change, of a difference of 160
STEEPEST = 0.2 * 160


def strip(*, without: str = "") -> Scene:
    """Five photos of one strip, 40 m apart, alternately dark and light."""
    photos = [photo_at(40.0 * i, 3.0 * i, f"P{i}") for i in range(5)]
    images = {p.id: flat_image(40 if i % 2 else 200) for i, p in enumerate(photos)}
    images.pop(without, None)
    return Scene(photos, images)


def test_seams_are_soft() -> None:
    scene = strip()
    image, mask = scene.render()
    grey = image[..., 0].astype(float)
    # Away from the long rims of the strip, where the photos end together.
    amid = mask & (np.abs(scene.places()[..., 1] - 6.0) < 20.0)
    assert np.abs(np.diff(grey, axis=1))[amid[:, 1:] & amid[:, :-1]].max() < 8.0
    assert {40, 200} <= set(np.unique(image[mask]))


@pytest.mark.parametrize("turn", [0.0, 20.0])
def test_no_step_at_the_rim_of_a_photo_that_another_covers(turn: float) -> None:
    # The small overlap puts the rims where the nearest nadir would still win.
    photos = [photo_at(0.0, 0.0, "A"), photo_at(55.0, 47.0, "B", turn_deg=turn)]
    scene = Scene(photos, {"A": flat_image(40), "B": flat_image(200)})
    image, mask = scene.render()
    grey = image[..., 0].astype(float)
    for axis in (0, 1):
        both = np.take(mask, range(1, mask.shape[axis]), axis) & np.take(
            mask, range(mask.shape[axis] - 1), axis
        )
        step = np.abs(np.diff(grey, axis=axis))
        xy = scene.places()
        uv = photos[0].project(np.concatenate([xy, np.zeros((*xy.shape[:2], 1))], axis=-1))
        uv_b = photos[1].project(np.concatenate([xy, np.zeros((*xy.shape[:2], 1))], axis=-1))
        common = photos[0].contains(uv) & photos[1].contains(uv_b)
        # Where the covering photo ends too, three rims meet and a step cannot be helped.
        inner = common & far_inside(uv_b)
        inner = np.take(inner, range(step.shape[axis]), axis)
        assert step[both & inner].max() < STEEPEST


def far_inside(uv: np.ndarray) -> np.ndarray:  # type: ignore[type-arg]
    u, v = uv[..., 0], uv[..., 1]
    edge = np.minimum(np.minimum(u, 599 - u), np.minimum(v, 399 - v))
    return np.asarray(edge > 60.0)


def test_nearest_nadir_wins() -> None:
    photos = [photo_at(x, y, f"P{i}") for i, (x, y) in enumerate([(0, 0), (50, 5), (25, 30)])]
    scene = Scene(photos, {f"P{i}": flat_image(50 + 80 * i) for i in range(3)})
    image, mask = scene.render()
    xy = scene.places()
    d = np.stack([np.hypot(*(xy - p.pose.origin_enu[:2]).transpose(2, 0, 1)) for p in photos])
    near, lead = d.argmin(axis=0), np.diff(np.sort(d, axis=0)[:2], axis=0)[0]
    ground = np.concatenate([xy, np.zeros((*xy.shape[:2], 1))], axis=-1)
    inner = np.all([far_inside(p.project(ground)) for p in photos], axis=0)
    # Beyond the feather of 64 px = 12.8 m and a cell of its mesh the nearest is alone.
    clear = inner & mask & (lead > 26.0)
    assert clear.sum() > 1000
    np.testing.assert_array_equal(image[clear][:, 0], 50 + 80 * near[clear])


def test_any_order_of_tiles_gives_the_same_pixels(rng: np.random.Generator) -> None:
    scene = strip()
    count = len(scene.plan.tiles)
    assert count >= 3
    first, mask = scene.render()
    again, mask_again = scene.render(rng.permutation(count))  # type: ignore[arg-type]
    np.testing.assert_array_equal(first, again)
    np.testing.assert_array_equal(mask, mask_again)


def test_order_of_the_photos_does_not_matter() -> None:
    a = strip()
    b = Scene(a.photos[::-1], a.images)
    np.testing.assert_allclose(a.render()[0], b.render()[0].astype(float), atol=1)  # rounding


def test_tile_borders_are_not_seen(rng: np.random.Generator) -> None:
    """A gradient over the ground stays one over the borders of tiles and blocks."""
    photos = [photo_at(40.0 * i, 0.0, f"P{i}") for i in range(5)]
    u = np.arange(600)[None, :, None]
    images = {
        p.id: np.broadcast_to(1000.0 + 0.2 * (u - 299.5) + 40.0 * i, (400, 600, 1))
        .astype(np.float32).copy()
        for i, p in enumerate(photos)
    }  # fmt: skip
    scene = Scene(photos, images)
    image, mask = scene.render()
    expected = 1000.0 + scene.places()[..., 0]
    off = np.abs(image[..., 0] - expected)[mask]
    assert off.max() < 0.15  # m: rim of half a pixel and 1/32 px


def test_unreadable_photo_leaves_its_place_to_others_and_is_named() -> None:
    scene = strip(without="P2")
    image, mask = scene.render()
    assert set(scene.broken) == {"P2.jpg: is not an image or is damaged; leave it out"}
    whole = strip().render()[1]
    # 40 m apart and 120 m wide: its neighbours cover all but a corner of it.
    assert mask.sum() > 0.98 * whole.sum()
    assert image[mask].min() == 40


def test_all_unreadable_gives_nothing() -> None:
    scene = Scene([photo_at(0.0, 0.0, "A")], {"B": flat_image(1)})
    assert not scene.render()[1].any()


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float32"])
@pytest.mark.parametrize("bands", [1, 3, 5])
def test_bands_and_types_pass_through(dtype: str, bands: int) -> None:
    top = 200 if dtype == "uint8" else 40_000
    levels = [top - 7 * i for i in range(bands)]
    photos = [photo_at(0.0, 0.0, "A"), photo_at(40.0, 10.0, "B")]
    scene = Scene(photos, {k: flat_image(*levels, dtype=dtype) for k in "AB"})
    image, mask = scene.render()
    assert image.dtype == dtype
    # rounding of the weights in float32
    np.testing.assert_allclose(image[mask].astype(float), np.tile(levels, (mask.sum(), 1)), 1e-6)


@pytest.mark.parametrize("gsd", [0.2, 0.5, 2.0, 5.0])
def test_soft_seams_at_any_resolution(gsd: float) -> None:
    """Where the feather is wider than the photo it must not be cut off by the photo's rim."""
    photos = [photo_at(0.0, 0.0, "A"), photo_at(60.0, 0.0, "B")]
    scene = Scene(photos, {"A": flat_image(40), "B": flat_image(200)}, gsd=gsd)
    image, mask = scene.render()
    xy = scene.places()
    # Beyond 60 m of A's nadir only B shows the place and the other way round.
    own = mask & (xy[..., 0] < -20.0)
    assert image[own].max() <= 41
    at_a = mask & (np.hypot(xy[..., 0], xy[..., 1]) < 6.0 + gsd)
    assert image[at_a].max() < 60


def test_scene_without_overlap_has_both(rng: np.random.Generator) -> None:
    scene = Scene(
        [photo_at(0.0, 0.0, "A"), photo_at(300.0, 0.0, "B")],
        {"A": flat_image(40), "B": flat_image(200)},
    )
    image, mask = scene.render()
    assert set(np.unique(image[mask])) == {40, 200}
    assert mask.sum() == pytest.approx(2 * 600 * 400, rel=0.01)
