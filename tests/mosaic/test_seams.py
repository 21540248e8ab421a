"""Seams: they go round what differs, keep to photos that are near, and never get worse."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from seam_cases import (
    ALL,
    GRID,
    LEFT,
    MIDDLE,
    RIGHT,
    SIZE,
    Flight,
    meadow,
    painted,
    photo,
)

from georef_gis.errors import Cancelled
from georef_gis.model.grid import Grid, Window
from georef_gis.mosaic import seam_costs, seams
from georef_gis.mosaic.coarse import Proxy, nearest_labels
from georef_gis.mosaic.label_regions import touching
from georef_gis.mosaic.nearest import reach_of
from georef_gis.mosaic.seam_costs import ONE, PairCosts
from georef_gis.mosaic.seams import SeamSettings, optimise_seams

Labels = NDArray[np.int32]


def decided(photos: list[Proxy], settings: SeamSettings | None = None) -> tuple[Labels, Labels]:
    """Labels before and after, over the whole grid."""
    flight = Flight(photos)
    start = nearest_labels(flight, GRID)
    final = optimise_seams(flight, GRID, settings or SeamSettings())
    return start.read(ALL), final.read(ALL)


def parts(mask: NDArray[np.bool_]) -> int:
    """Number of connected parts."""
    return int(cv2.connectedComponents(mask.astype(np.uint8), connectivity=4)[0]) - 1


def cut_columns(labels: Labels) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """(row, column left of) where neighbours along a row show different photos."""
    rows, cols = np.nonzero(
        (labels[:, 1:] != labels[:, :-1]) & (labels[:, 1:] >= 0) & (labels[:, :-1] >= 0)
    )
    return rows, cols


# -- what differs between photos ------------------------------------------------------------------


@pytest.mark.parametrize("grey", [10.0, 250.0])
def test_a_car_that_one_photo_shows_is_whole_or_absent(grey: float) -> None:
    ground = meadow()
    car = (slice(99, 111), slice(MIDDLE - 9, MIDDLE + 11))
    with_car = painted(ground, 100, MIDDLE - 8, 10, 18, grey)
    start, final = decided([photo(with_car, LEFT, noise=1), photo(ground, RIGHT, noise=2)])
    assert len(np.unique(start[car])) == 2
    # a ring of one pixel, the soft rim of the car, included
    assert len(np.unique(final[car])) == 1


def test_a_car_that_moved_is_whole_or_absent_at_both_places() -> None:
    ground = meadow()
    first = painted(ground, 60, MIDDLE - 14, 10, 20, 240.0)
    second = painted(ground, 85, MIDDLE - 5, 10, 20, 240.0)
    start, final = decided([photo(first, LEFT, noise=1), photo(second, RIGHT, noise=2)])
    for row, col in ((60, MIDDLE - 14), (85, MIDDLE - 5)):
        place = (slice(row, row + 10), slice(col, col + 20))
        assert len(np.unique(start[place])) == 2
        assert len(np.unique(final[place])) == 1


def test_a_car_as_grey_as_the_road_inside_its_outline_is_not_cut() -> None:
    ground = meadow()
    # only the outline differs, 2 px wide
    outline = painted(ground, 100, MIDDLE - 8, 12, 18, 250.0)
    outline[102:110, MIDDLE - 6 : MIDDLE + 8] = ground[102:110, MIDDLE - 6 : MIDDLE + 8]
    _, final = decided([photo(outline, LEFT, noise=1), photo(ground, RIGHT, noise=2)])
    assert len(np.unique(final[100:112, MIDDLE - 8 : MIDDLE + 10])) == 1


def test_a_leaning_building_comes_from_one_photo() -> None:
    left, right = meadow(), meadow()
    # with things on it; where a roof is plain both photos agree, and it may be cut
    roof = 3.0 * meadow(3)[:24, :24] - 150.0
    # it leans 4 px away from either nadir
    left[90:114, MIDDLE - 8 : MIDDLE + 16] = roof
    right[90:114, MIDDLE - 16 : MIDDLE + 8] = roof
    start, final = decided([photo(left, LEFT, noise=1), photo(right, RIGHT, noise=2)])
    place = (slice(90, 114), slice(MIDDLE - 16, MIDDLE + 16))
    assert len(np.unique(start[place])) == 2
    assert len(np.unique(final[place])) == 1


def test_a_seam_does_not_run_between_two_places_of_a_moving_shadow() -> None:
    ground = meadow()
    early, late = ground.copy(), ground.copy()
    early[:, MIDDLE - 4 :] *= 0.4
    late[:, MIDDLE + 5 :] *= 0.4
    _, final = decided([photo(early, LEFT, noise=1), photo(late, RIGHT, noise=2)])
    _, cols = cut_columns(final)
    assert not np.any((cols >= MIDDLE - 4) & (cols < MIDDLE + 4))


def test_a_flat_difference_leaves_the_seam_half_way() -> None:
    ground = meadow()
    _, final = decided([photo(ground, LEFT), photo(ground + np.float32(7.0), RIGHT)])
    rows, cols = cut_columns(final)
    assert rows.tolist() == list(range(10, 210))
    # 2 px: within that neither photo is the nearer by more than a rounded cost
    assert np.abs(cols + 1 - MIDDLE).max() <= 2


# -- how photos lie ------------------------------------------------------------------------------


def test_three_photos_meet_beside_a_car_that_stands_where_they_met() -> None:
    ground = meadow()
    below = Window(col=70, row=80, width=260, height=180)
    upper = (
        Window(col=10, row=0, width=260, height=180),
        Window(col=130, row=0, width=260, height=180),
    )
    nadirs = [(140.0, 80.0), (260.0, 80.0), (200.0, 180.0)]
    # as far from all three
    row, col = 112, MIDDLE
    with_car = painted(ground, row - 6, col - 8, 12, 16, 245.0)
    photos = [
        photo(g, w, nadir=n, noise=k)
        for k, (g, w, n) in enumerate(
            zip([ground, with_car, ground], [*upper, below], nadirs, strict=True)
        )
    ]
    start, final = decided(photos)
    place = (slice(row - 6, row + 6), slice(col - 8, col + 8))
    assert len(np.unique(start[place])) == 3
    # whole from the one photo that shows it, or from others
    assert (final[place] == 1).all() or not (final[place] == 1).any()
    assert [parts(final == k) for k in range(3)] == [1, 1, 1]


def test_a_photo_inside_another_stays_in_one_part_within_its_bounds() -> None:
    ground = meadow()
    small = Window(col=170, row=80, width=60, height=50)
    whole = Window(col=10, row=10, width=380, height=240)
    photos = [photo(ground, whole, nadir=(60.0, 60.0), noise=1), photo(ground, small, noise=2)]
    start, final = decided(photos)
    assert (start == 1).sum() == 3000
    assert parts(final == 1) == 1
    assert not (final == 1)[:80].any()
    np.testing.assert_array_equal(final >= 0, start >= 0)


def test_a_hole_of_one_photo_shows_the_other() -> None:
    ground = meadow()
    left, right = photo(ground, LEFT, noise=1), photo(ground, RIGHT, noise=2)
    # at columns 150 to 189, nearer to the left photo
    left.valid[80:120, 140:180] = False
    left.distance[80:120, 140:180] = np.inf
    left.data[80:120, 140:180] = np.nan
    start, final = decided([left, right])
    assert (final[90:130, 150:190] == 1).all()
    np.testing.assert_array_equal(final >= 0, start >= 0)


def test_every_pixel_shows_a_photo_that_is_valid_and_near_enough() -> None:
    ground = meadow()
    # differs everywhere but at the far right, to where the seam would like to go
    other = meadow(2)
    other[:, MIDDLE + 60 :] = ground[:, MIDDLE + 60 :]
    photos = [photo(ground, LEFT, noise=1), photo(other, RIGHT, noise=2)]
    _, final = decided(photos, SeamSettings(distance_cost=0.0, length_cost=0.0))
    distance = np.full((2, SIZE[1], SIZE[0]), np.inf)
    for k, p in enumerate(photos):
        w = p.window
        distance[k, w.row : w.row + w.height, w.col : w.col + w.width] = p.distance
    shown = final >= 0
    own = np.where(final == 0, distance[0], distance[1])[shown]
    near = distance.min(axis=0)[shown]
    reach = np.median([reach_of(p) for p in photos])
    # a thousandth: the bound is kept in 16 bits
    assert (own <= 1.001 * (near + np.maximum(0.6 * near, 0.5 * reach))).all()
    assert (own > near).any()


def test_a_doubtful_photo_shows_only_what_no_other_does() -> None:
    ground = meadow()
    with_car = painted(ground, 100, 125, 10, 10, 250.0)
    photos = [photo(with_car, LEFT, noise=1), photo(ground, RIGHT, noise=2, further=480.0)]
    start, final = decided(photos)
    assert (start[10:210, 130:270] == 0).all()
    np.testing.assert_array_equal(start, final)


# -- the method ----------------------------------------------------------------------------------


def cost_of_distance(labels: Labels, photos: list[Proxy], settings: SeamSettings) -> int:
    """Cost of the distances of what is shown."""
    price = np.float32(settings.distance_cost * ONE / np.median([reach_of(p) for p in photos]))
    total = 0
    for k, p in enumerate(photos):
        w = p.window
        own = labels[w.row : w.row + w.height, w.col : w.col + w.width] == k
        total += int(np.rint(p.distance[own] * price).astype(np.int64).sum())
    return total


def seam_cost(labels: Labels, photos: list[Proxy], settings: SeamSettings) -> int:
    """Cost of the seams, edge by edge."""
    total = 0
    costs = PairCosts(Flight(photos))
    for dr, dc in ((0, 1), (1, 0)):
        for r in range(labels.shape[0] - dr):
            for c in range(labels.shape[1] - dc):
                a, b = int(labels[r, c]), int(labels[r + dr, c + dc])
                if a == b or min(a, b) < 0:
                    continue
                at = costs.between(a, b).at(np.array([r, r + dr]), np.array([c, c + dc]))
                total += int(at.sum()) // 2 + round(settings.length_cost * ONE)
    return total


def four_photos() -> list[Proxy]:
    """Two by two photos, each with a vehicle of its own amid all."""
    photos = []
    for k in range(4):
        window = Window(col=10 + 120 * (k % 2), row=5 + 60 * (k // 2), width=260, height=180)
        own = painted(meadow(), 100 + 9 * k, MIDDLE - 20 + 11 * k, 9, 14, 240.0)
        photos.append(photo(own, window, noise=k))
    return photos


@pytest.mark.parametrize("distance_cost", [0.0, 0.05])
def test_the_cost_falls_on_larger_pixels_and_with_every_refinement(distance_cost: float) -> None:
    photos = four_photos()
    parted, whole = [], []
    for rounds, refinements in ((0, 0), (1, 0), (1, 1), (1, 2)):
        # without specks: to dissolve one may cost a little
        settings = SeamSettings(
            rounds=rounds, refinements=refinements, speck_px=0, distance_cost=distance_cost
        )
        _, final = decided(photos, settings)
        parted.append(seam_cost(final, photos, settings))
        whole.append(parted[-1] + cost_of_distance(final, photos, settings))
    assert whole[0] > whole[1] > whole[2] >= whole[3]
    assert parted[2] < 0.8 * parted[0]


def test_larger_pixels_cost_hardly_anything_in_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    photos, whole = four_photos(), []
    for factor in (3, 1):
        monkeypatch.setattr(seams, "FACTOR", factor)
        monkeypatch.setattr(seams, "LEAST_SIDE", 50)
        settings = SeamSettings(rounds=2, speck_px=0)
        _, final = decided(photos, settings)
        near = nearest_labels(Flight(photos), GRID).read(ALL)
        more = cost_of_distance(final, photos, settings) - cost_of_distance(near, photos, settings)
        whole.append(seam_cost(final, photos, settings) + more)
    # a seam that goes round a vehicle on its other side may well cost 1 % more
    assert whole[0] < 1.02 * whole[1]


def test_no_pixel_of_a_seam_would_cost_less_with_its_neighbours_photo() -> None:
    photos, settings = four_photos(), SeamSettings(rounds=2, refinements=8, speck_px=0)
    _, labels = decided(photos, settings)
    costs = PairCosts(Flight(photos))
    reach = np.median([reach_of(p) for p in photos])
    price = settings.distance_cost * ONE / reach
    distance = np.full((4, SIZE[1], SIZE[0]), np.inf, np.float32)
    for k, p in enumerate(photos):
        w = p.window
        distance[k, w.row : w.row + w.height, w.col : w.col + w.width] = p.distance
    near = distance.min(axis=0)
    # a little less than the bound, which is kept in 16 bits
    allowed = distance <= near + 0.99 * np.maximum(0.6 * near, 0.5 * reach)

    def cost(own: int, r: int, c: int) -> float:
        total = float(np.rint(distance[own, r, c] * np.float32(price)))
        for q in ((r - 1, c), (r + 1, c), (r, c - 1), (r, c + 1)):
            other = int(labels[q])
            if other not in (own, -1):
                at = costs.between(own, other).at(np.array([r, q[0]]), np.array([c, q[1]]))
                total += int(at.sum()) // 2 + round(settings.length_cost * ONE)
        return total

    tried = 0
    for r in range(1, SIZE[1] - 1):
        for c in range(1, SIZE[0] - 1):
            own = int(labels[r, c])
            around = {int(labels[q]) for q in ((r - 1, c), (r + 1, c), (r, c - 1), (r, c + 1))}
            for other in around - {own, -1}:
                if own >= 0 and allowed[own, r, c] and allowed[other, r, c]:
                    tried += 1
                    assert cost(own, r, c) <= cost(other, r, c)
    assert tried > 300


@pytest.mark.parametrize(
    # a power of 2 changes no digit; another factor may round a cost up and so move a seam by a
    # pixel here and there
    ("factor", "moved_px"),
    [(256.0, 0), (257.0, 20)],
)
def test_the_range_of_the_values_does_not_matter(factor: float, moved_px: int) -> None:
    photos = four_photos()
    _, plain = decided(photos)
    for p in photos:
        p.data[...] *= np.float32(factor)
    _, scaled = decided(photos)
    assert (plain != scaled).sum() <= moved_px


def test_the_same_photos_give_the_same_seams_with_any_number_of_threads() -> None:
    flight = Flight(four_photos())
    before = nearest_labels(flight, GRID).read(ALL)
    found = [
        optimise_seams(flight, GRID, SeamSettings(), workers=workers).read(ALL)
        for workers in (1, 1, 2, 5)
    ]
    assert (found[0] != before).any()
    for other in found[1:]:
        np.testing.assert_array_equal(found[0], other)


@pytest.mark.parametrize("bands", [1, 5])
def test_any_number_of_bands_will_do(bands: int) -> None:
    ground = meadow(bands=bands)
    # a band without any signal among them
    ground[..., -1] = ground[..., -1] if bands == 1 else 0.0
    with_car = ground.copy()
    with_car[100:110, MIDDLE - 8 : MIDDLE + 10, 0] = 250.0
    _, final = decided([photo(with_car, LEFT), photo(ground, RIGHT)])
    assert len(np.unique(final[100:110, MIDDLE - 8 : MIDDLE + 10])) == 1


def strip(count: int) -> tuple[Flight, Grid]:
    """Tiny photos one after the other, each sharing two thirds with the next."""
    ground = meadow()
    one = photo(ground, Window(col=0, row=0, width=32, height=24))
    grid = Grid(crs_wkt="", left=0.0, top=24.0, pixel=1.0, width=10 * count + 22, height=24)
    rng = np.random.default_rng(5)
    photos = [
        Proxy(
            photo_id=f"p{k}", window=Window(col=10 * k, row=0, width=32, height=24),
            data=one.data + rng.normal(0, 9, one.data.shape).astype(np.float32),
            valid=one.valid, distance=one.distance,
        )
        for k in range(count)
    ]  # fmt: skip
    return Flight(photos), grid


@pytest.fixture
def kept(monkeypatch: pytest.MonkeyPatch) -> int:
    """Photos of 32 x 24 px that fit in memory at once."""
    count = 16
    # three bands, the distance and the mask
    monkeypatch.setattr(seam_costs, "PHOTO_BYTES", count * 32 * 24 * (3 * 4 + 4 + 1))
    return count


def test_the_work_grows_with_the_number_of_photos_and_few_are_held(kept: int) -> None:
    loads = []
    for count in (150, 600):
        flight, grid = strip(count)
        labels = optimise_seams(flight, grid, SeamSettings(speck_px=0))
        loads.append(flight.loads)
        assert len(touching(labels)) < 3 * count
        # the one that is being loaded besides those kept
        assert flight.most_held <= kept + 1
    # once to find the nearest, once to choose, once to refine
    assert loads[1] <= 3 * 600
    assert loads[1] <= 4.05 * loads[0]


@pytest.mark.usefixtures("kept")
def test_photos_of_many_lines_are_loaded_little_more_than_once_a_pass() -> None:
    lines, each = 6, 30
    ground = meadow()
    one = photo(ground, Window(col=0, row=0, width=32, height=24))
    grid = Grid(
        crs_wkt="", left=0.0, top=0.0, pixel=1.0, width=13 * each + 20, height=15 * lines + 20
    )
    photos = [
        Proxy(
            photo_id=f"p{line}-{k}", window=Window(col=13 * k, row=14 * line, width=32, height=24),
            data=one.data + np.float32((7 * line + 3 * k) % 5), valid=one.valid,
            distance=one.distance,
        )
        for line in range(lines)
        for k in range(each)
    ]  # fmt: skip
    flight = Flight(photos)
    optimise_seams(flight, grid, SeamSettings(speck_px=0))
    # 3 passes; in the order of the photos it would be 6.3
    assert flight.loads < 4.5 * len(photos)


def test_it_can_be_stopped_and_tells_how_far_it_is() -> None:
    flight = Flight(four_photos())
    told: list[float] = []
    optimise_seams(flight, GRID, SeamSettings(), progress=told.append)
    assert told == sorted(told)
    assert told[-1] == 1.0
    for after in (1, len(told) // 2):
        told.clear()
        with pytest.raises(Cancelled):
            optimise_seams(
                flight, GRID, SeamSettings(), workers=2, progress=told.append,
                cancelled=lambda after=after: len(told) >= after,
            )  # fmt: skip
        assert len(told) == after
