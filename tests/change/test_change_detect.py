"""What changed is found with its shape; what only looks different is not."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from change_cases import Image, Look, Thing, compared, matches, render, truth_shapes

from georef_gis.errors import CrsError, GeometryError, InputError
from georef_gis.measure.change.detect import Change, Comparison
from georef_gis.measure.change.pair import common_cells

CONE = Thing(9.0, 20.0, 0.5, 0.5, (0.9, 0.4, 0.1), disc=True)
CAR = Thing(15.0, 11.5, 4.2, 1.8, (0.85, 0.85, 0.9), turn=0.2)
HEAP = Thing(21.0, 21.0, 5.0, 5.0, (0.60, 0.48, 0.33), disc=True, rough=0.05)
PATCH = Thing(8.0, 10.5, 4.0, 2.5, (0.14, 0.14, 0.15))
SHADOW = Thing(18.0, 6.5, 4.0, 2.0, (0.42, 0.46, 0.56), shadow=True)
OTHER = Look(
    gsd=0.06, shift=(0.42, -0.27), gain=(0.8, 0.87, 0.93), shading=0.12, noise=0.018, blur=0.7,
    jpeg=75,
)  # fmt: skip
Compare = Callable[..., tuple[Comparison, list[Change]]]


@pytest.fixture
def run(site: Image, tmp_path: Path) -> Compare:
    def _run(
        later: list[Thing], earlier: list[Thing], **look: object
    ) -> tuple[Comparison, list[Change]]:
        """A comparison, and its changes of confidence 0.5 or more."""
        rng = np.random.default_rng(3)
        values = {**vars(OTHER), **look}
        paths = tmp_path / "later.tif", tmp_path / "earlier.tif"
        dtype = str(values["dtype"])
        render(paths[0], site, Look(things=later, dtype=dtype), rng)
        render(paths[1], site, Look(**{**values, "things": earlier}), rng)
        found = compared(*paths, 0.1)
        return found, [one for one in found.changes if one.confidence >= 0.5]

    return _run


def test_nothing_changed_gives_nothing(run: Compare) -> None:
    found, sure = run([], [])
    assert sure == []
    # m2; all of the 26 m square but a rim and the shift
    assert found.compared * 0.01 > 600.0


@pytest.mark.parametrize("look", [{}, {"grey": True}, {"dtype": "uint16"}])
def test_things_that_came_and_went_are_found(run: Compare, look: dict[str, object]) -> None:
    things = [CONE, CAR, HEAP, PATCH]
    found, sure = run([CONE, HEAP], [CAR, PATCH], **look)
    shapes = truth_shapes(things, found.cells)
    hits = [matches(one, shapes) for one in sure]
    assert set().union(*hits) == {0, 1, 2, 3}
    assert all(hits), "something that did not change is among the changes"


def test_area_is_that_of_the_thing_within_its_sigma(run: Compare) -> None:
    things = [CONE, CAR, HEAP, PATCH]
    found, sure = run([CONE, HEAP], [CAR, PATCH])
    shapes = truth_shapes(things, found.cells)
    for number, thing in enumerate(things):
        own = [one for one in sure if matches(one, shapes) == {number}]
        area = sum(one.judged.outline.area for one in own) * 0.01
        sigma = sum(one.judged.outline.sigma for one in own) * 0.01
        assert abs(area - thing.area) < 2.5 * sigma, thing
        # no wider than a cell's rim all round
        assert sigma < 0.1 * np.pi * (thing.width + thing.height), thing


def test_kind_says_which_way_it_changed(run: Compare) -> None:
    found, sure = run([CAR], [PATCH])
    shapes = truth_shapes([CAR, PATCH], found.cells)
    kinds = {min(matches(one, shapes)): one.judged.kind for one in sure}
    # the car is there now and bright; the dark patch is gone
    assert kinds == {0: "brighter", 1: "brighter"}


def test_shadow_of_another_sun_is_told_apart(run: Compare) -> None:
    found, sure = run([], [SHADOW])
    shapes = truth_shapes([SHADOW], found.cells)
    own = [one for one in found.changes if matches(one, shapes)]
    assert "shadow?" in {one.judged.kind for one in own}
    assert sure == []


def test_small_move_of_what_stands_up_is_no_change(run: Compare) -> None:
    here = Thing(15.0, 20.0, 2.0, 2.0, (0.2, 0.33, 0.14), disc=True, rough=0.0)
    there = Thing(15.35, 20.1, 2.0, 2.0, (0.2, 0.33, 0.14), disc=True, rough=0.0)
    _, sure = run([here], [there])
    assert sure == []


def test_same_file_twice_shows_no_change(site: Image, tmp_path: Path) -> None:
    path = render(tmp_path / "one.tif", site, Look(), np.random.default_rng(0))
    found = compared(path, path, 0.1)
    # cells
    np.testing.assert_allclose(found.registration.shift, (0.0, 0.0), atol=0.01)
    assert [one for one in found.changes if one.confidence >= 0.5] == []


def test_maps_apart_are_refused(site: Image, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    one = render(tmp_path / "one.tif", site, Look(), rng)
    far = render(tmp_path / "far.tif", site, Look(origin=(500.0, 0.0)), rng)
    with pytest.raises(GeometryError, match="no common ground"):
        common_cells(one, far, 0.1)


def test_empty_map_is_refused(site: Image, tmp_path: Path) -> None:
    import rasterio

    one = render(tmp_path / "one.tif", site, Look(), np.random.default_rng(0))
    empty = tmp_path / "empty.tif"
    with (
        rasterio.open(one) as source,
        rasterio.open(empty, "w", **{**source.profile, "nodata": 0}) as file,
    ):
        file.write(np.zeros((3, source.height, source.width), np.uint8))
    with pytest.raises(GeometryError, match="no common ground"):
        common_cells(one, empty, 0.1)


def test_bland_map_is_refused(site: Image, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    one = render(tmp_path / "one.tif", site, Look(), rng)
    flat = render(tmp_path / "flat.tif", np.full_like(site, 0.5), Look(noise=0.0), rng)
    with pytest.raises(GeometryError, match="windows"):
        compared(one, flat, 0.1)


def test_file_that_is_no_raster_is_refused(site: Image, tmp_path: Path) -> None:
    one = render(tmp_path / "one.tif", site, Look(), np.random.default_rng(0))
    text = tmp_path / "notes.tif"
    text.write_text("not a raster")
    with pytest.raises(InputError, match=r"notes\.tif"):
        common_cells(one, text, 0.1)


def test_cell_too_small_or_too_large_is_refused(site: Image, tmp_path: Path) -> None:
    one = render(tmp_path / "one.tif", site, Look(), np.random.default_rng(0))
    with pytest.raises(InputError, match="cells"):
        common_cells(one, one, 0.001)
    with pytest.raises(GeometryError, match="needed"):
        common_cells(one, one, 1.0)


def test_map_in_degrees_is_refused_as_the_later_one(site: Image, tmp_path: Path) -> None:
    import rasterio

    one = render(tmp_path / "one.tif", site, Look(), np.random.default_rng(0))
    path = tmp_path / "degrees.tif"
    transform = rasterio.Affine(1e-6, 0, -81.0, 0, -1e-6, 39.7)
    with (
        rasterio.open(one) as source,
        rasterio.open(
            path, "w", **{**source.profile, "crs": "EPSG:4326", "transform": transform}
        ) as file,
    ):
        file.write(source.read())
    with pytest.raises(CrsError, match="projected"):
        common_cells(path, one, 0.1)
