"""What photos explain loses its confidence; what they do not explain keeps it."""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from change_cases import Image, Look, Thing, matches, render, truth_shapes
from numpy.typing import ArrayLike

from georef_gis.errors import CrsError
from georef_gis.frames import Array
from georef_gis.geodesy import CRS, MapFrame, Origin, map_crs
from georef_gis.measure.change.detect import Change, Comparison, compare
from georef_gis.measure.change.evidence import FEW, weigh
from georef_gis.measure.change.evidence import Look as PhotoLook
from georef_gis.measure.change.pair import MapPair, common_cells, open_pair
from georef_gis.model.camera import Camera
from georef_gis.model.photo import OrientedPhoto, Photo
from georef_gis.model.pose import Pose
from georef_gis.model.terrain import FlatTerrain, Terrain
from georef_gis.rasters.profile import Transform
from georef_gis.rasters.reading import Window
from georef_gis.rasters.resampled import UNMOVED, MapHeader
from georef_gis.units import US_SURVEY_FOOT
from processing_algorithms.change.photos import SitePhotos
from processing_algorithms.site import Site

# a roof that leans by 2 m from one mosaic to the other, and a car that came
HERE = Thing(9.0, 20.0, 3.0, 3.0, (0.75, 0.3, 0.2), rough=0.0)
THERE = replace(HERE, x=11.0)
CAR = Thing(20.0, 9.0, 4.2, 1.8, (0.85, 0.85, 0.9), turn=0.2)
CONE = Thing(12.0, 12.0, 0.5, 0.5, (0.9, 0.4, 0.1), disc=True)
Found = tuple[Comparison, MapPair, MapPair]


class _Maps:
    """Photos that show what maps of the same ground do, darker and by their own samples."""

    def __init__(self, pairs: list[MapPair]) -> None:
        self.pairs = pairs
        self.asked: list[Transform] = []

    def looks(self, _: MapHeader, window: Window, moved: Transform) -> Iterable[PhotoLook]:
        self.asked.append(moved)
        for pair in self.pairs:
            views = pair.seen(moved=moved).read(window)
            yield PhotoLook(samples=views.earlier * 150.0, valid=views.valid)


@pytest.fixture(scope="module")
def found(site: Image, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Found]:
    """A comparison, and pairs whose earlier map is a look from the side of the later, and not."""
    folder = tmp_path_factory.mktemp("looks")
    rng = np.random.default_rng(2)
    later = render(folder / "later.tif", site, Look(things=[HERE, CAR, CONE]), rng)
    earlier = render(folder / "earlier.tif", site, Look(things=[THERE]), rng)
    same_side = render(folder / "same_side.tif", site, Look(things=[HERE], noise=0.02), rng)
    cells = common_cells(later, earlier, 0.1)
    with (
        open_pair(later, earlier, cells, most=2.0) as pair,
        open_pair(later, same_side, cells, most=2.0) as side,
    ):
        yield compare(pair, most=2.0, least_area=0.1), pair, side


def _of(found: Comparison, thing: Thing) -> list[Change]:
    shapes = truth_shapes([thing], found.cells)
    return [one for one in found.changes if one.confidence > 0.0 and matches(one, shapes)]


def _sure(found: Comparison, *things: Thing) -> list[bool]:
    return [any(one.confidence >= 0.5 for one in _of(found, thing)) for thing in things]


def test_what_a_photo_of_the_other_date_shows_loses_its_confidence(found: Found) -> None:
    before, pair, side = found
    assert _sure(before, HERE, THERE, CAR) == [True, True, True]
    after = weigh(before, (None, _Maps([pair] * FEW + [side])))
    assert _sure(after, HERE, THERE, CAR) == [False, False, True]
    for thing in (HERE, THERE):
        said = {(one.judged.kind, one.evidence.said) for one in _of(after, thing) if one.evidence}
        assert ("leans?", "photos agree") in said


class _Hidden:
    """Photos in which a crown hides the ground all over."""

    def looks(self, _: MapHeader, window: Window, __: Transform) -> Iterable[PhotoLook]:
        shape = window[3], window[2]
        rng = np.random.default_rng(4)
        for _number in range(FEW):
            leaves = np.clip(rng.normal(120.0, 100.0, shape), 5.0, 250.0)
            samples = np.repeat(leaves[..., None], 3, axis=2)
            yield PhotoLook(samples=samples, valid=np.ones(shape, np.bool_))


def test_photo_that_a_crown_hides_the_place_from_explains_nothing(found: Found) -> None:
    before, _, _ = found
    after = weigh(before, (None, _Hidden()))
    assert _sure(after, HERE, THERE, CAR, CONE) == [True] * 4
    assert "leans?" not in {one.judged.kind for one in _of(after, CONE)}


def test_what_no_photo_explains_stays_as_sure_as_it_was(found: Found) -> None:
    before, pair, _ = found
    after = weigh(before, (None, _Maps([pair] * FEW)))
    assert [one.confidence for one in after.changes] == [one.confidence for one in before.changes]
    said = {one.evidence.said for one in _of(after, CAR) if one.evidence}
    assert said == {"photos differ"}


def test_few_photos_that_explain_nothing_lower_it_a_little(found: Found) -> None:
    before, pair, _ = found
    after = weigh(before, (None, _Maps([pair] * (FEW - 1))))
    one, other = (max(f.confidence for f in _of(x, CAR)) for x in (before, after))
    assert 0.5 * one < other < 0.7 * one
    assert {f.evidence.said for f in _of(after, CAR) if f.evidence} == {"few photos"}


class _Later(_Maps):
    """Photos of the later date that show what its map does."""

    def looks(self, _: MapHeader, window: Window, moved: Transform) -> Iterable[PhotoLook]:
        for pair in self.pairs:
            views = pair.seen(moved=moved).read(window)
            yield PhotoLook(samples=views.later * 150.0, valid=views.valid)


def test_many_photos_of_one_date_do_not_make_up_for_few_of_the_other(found: Found) -> None:
    before, pair, _ = found

    def said(later: int, earlier: int) -> set[str]:
        after = weigh(before, (_Later([pair] * later), _Maps([pair] * earlier)))
        return {one.evidence.said for one in _of(after, CAR) if one.evidence}

    assert said(2 * FEW, FEW - 1) == said(FEW - 1, 2 * FEW) == {"few photos"}
    assert said(FEW, FEW) == {"photos differ"}


def test_no_region_is_lost_and_none_becomes_surer(found: Found) -> None:
    before, _, side = found
    after = weigh(before, (None, _Maps([side])))
    sure = {one.judged.region.window: one.confidence for one in before.changes}
    assert len(after.changes) == len(before.changes)
    for one in after.changes:
        assert one.confidence <= sure[one.judged.region.window]
    ordered = [one.confidence for one in after.changes]
    assert ordered == sorted(ordered, reverse=True)


def test_photos_of_the_earlier_date_are_asked_where_its_map_shows_it(found: Found) -> None:
    before, _, side = found
    photos = _Maps([side])
    weigh(before, (photos, None))
    weigh(before, (None, photos))
    assert {photos.asked[0], photos.asked[-1]} == {UNMOVED, before.registration.moved}


# -- photos of a project -----------------------------------------------------------------------

ORIGIN = Origin(lat=np.radians(39.0975), lon=np.radians(-80.467), height_ellipsoidal=280.0)
CAMERA = Camera(id="plain", width=600, height=400, fx=500.0, fy=500.0, cx=299.5, cy=199.5)


def _photo(east: float, path: Path) -> OrientedPhoto:
    pose = Pose(
        origin_enu=np.array([east, 0.0, 50.0]), R_enu_from_cam=np.diag([1.0, -1.0, -1.0]),
        covariance=np.diag([1.0, 1.0, 4.0, 3e-4, 3e-4, 3e-3]),
    )  # fmt: skip
    photo = Photo(id=path.name, path=path, width=600, height=400)
    return OrientedPhoto(photo=photo, camera=CAMERA, pose=pose)


def _site_photos(tmp_path: Path, crs: str, terrain: Terrain | None = None) -> SitePhotos:
    """Two photos, 5 m and 20 m beside the origin, the first a ramp along its columns."""
    ramp = np.broadcast_to(np.linspace(0, 240, 600).round().astype(np.uint8), (400, 600))
    paths = [tmp_path / "near.png", tmp_path / "far.png"]
    for path in paths:
        cv2.imwrite(str(path), np.repeat(ramp[..., None], 3, axis=2))
    photos = {path.name: _photo(x, path) for path, x in zip(paths, (5.0, 20.0), strict=True)}
    frame = MapFrame(ORIGIN, map_crs(crs))
    terrain = terrain or FlatTerrain(origin=ORIGIN, height_ellipsoidal=280.0)
    kinds = dict.fromkeys(photos, "adjusted")
    return SitePhotos(
        Site(
            frame=frame, terrain=terrain, photos=photos, pose_kinds=kinds,
            doubts={key: [] for key in photos},
        )
    )  # fmt: skip


@pytest.fixture
def site_photos(tmp_path: Path) -> SitePhotos:
    return _site_photos(tmp_path, "EPSG:32617")


def _grid(crs: str, side: float = 0.2) -> MapHeader:
    """Cells of 0.2 m about the origin, 200 each way."""
    x, y, _ = MapFrame(ORIGIN, map_crs(crs)).map_from_enu(np.zeros(3))
    transform = (side, 0.0, x - 100.0 * side, 0.0, -side, y + 100.0 * side)
    return MapHeader(
        name="grid", width=200, height=200, transform=transform,
        crs_wkt=map_crs(crs).to_wkt(), epsg=None, dtype="uint8", bands=("",) * 3,
        scales=((1.0, 0.0),) * 3,
    )  # fmt: skip


@pytest.mark.parametrize("crs", ["EPSG:32617", "EPSG:26917", "EPSG:32616"])
def test_photo_is_laid_on_the_ground_that_it_shows(site_photos: SitePhotos, crs: str) -> None:
    header = _grid(crs)
    window = (90, 90, 20, 20)
    near, far = site_photos.looks(header, window, UNMOVED)
    for look, east in ((near, 5.0), (far, 20.0)):
        # the middle of the window is the origin of enu; 10 px a metre
        u = 299.5 + (0.0 - east) * 500.0 / 50.0
        # grey values; a pixel is 0.4 of one
        np.testing.assert_allclose(look.samples[9:11, 9:11].mean(), u * 240 / 599, atol=1.0)
        assert look.valid.all()


def test_realisations_of_nad83_without_a_grid_between_are_taken_as_one(tmp_path: Path) -> None:
    photos = _site_photos(tmp_path, "EPSG:26917")
    # NAD83(2011), four grids of NADCON 5 from NAD83
    header = _grid("EPSG:6549", side=0.2 / US_SURVEY_FOOT)
    assert "NAD83(2011)" in photos.meet(header.crs_wkt)
    near, _ = photos.looks(header, (90, 90, 20, 20), UNMOVED)
    # as above: 5 m to the east of the middle, 10 px a metre, 0.4 grey values a pixel
    u = 299.5 + (0.0 - 5.0) * 500.0 / 50.0
    np.testing.assert_allclose(near.samples[9:11, 9:11].mean(), u * 240 / 599, atol=1.0)


def test_datum_that_proj_knows_nothing_of_has_no_way(site_photos: SitePhotos) -> None:
    with pytest.raises(CrsError, match="no transformation"):
        site_photos.meet(CRS("+proj=utm +zone=17 +ellps=clrk66 +type=crs").to_wkt())


class _HalfTerrain(FlatTerrain):
    """Ground known to the west of the origin's meridian alone, as at the rim of a DEM."""

    def height_on_map(self, frame: MapFrame, xy_map: ArrayLike) -> Array:
        heights = super().height_on_map(frame, xy_map)
        rim = frame.map_from_enu(np.zeros(3))[0]
        return np.where(np.asarray(xy_map)[..., 0] < rim, heights, np.nan)


def test_photo_is_asked_where_a_window_reaches_beyond_the_ground(tmp_path: Path) -> None:
    ground = _HalfTerrain(origin=ORIGIN, height_ellipsoidal=280.0)
    header = _grid("EPSG:32617")
    whole, _ = _site_photos(tmp_path, "EPSG:32617").looks(header, (80, 80, 40, 40), UNMOVED)
    half, _ = _site_photos(tmp_path, "EPSG:32617", ground).looks(header, (80, 80, 40, 40), UNMOVED)
    # a mesh of four cells: within one of the rim nothing is known
    assert half.valid[:, :14].all()
    assert not half.valid[:, 22:].any()
    np.testing.assert_array_equal(half.samples[:, :14], whole.samples[:, :14])


def test_photo_is_laid_where_its_map_was_moved_to(site_photos: SitePhotos) -> None:
    header = _grid("EPSG:32617")
    plain = next(iter(site_photos.looks(header, (90, 90, 20, 20), UNMOVED)))
    moved = next(iter(site_photos.looks(header, (90, 90, 20, 20), (1.0, 0.0, 25.0, 0.0, 1.0, 0.0))))
    # 25 cells of 0.2 m are 50 px of the photo, 20 grey values; the map turns by 0.3 degrees
    rise = moved.samples.astype(float).mean() - plain.samples.astype(float).mean()
    np.testing.assert_allclose(rise, 20.0, atol=0.5)


def test_photo_that_is_gone_is_told_and_the_others_speak(
    site_photos: SitePhotos, tmp_path: Path
) -> None:
    (tmp_path / "near.png").unlink()
    looks = list(site_photos.looks(_grid("EPSG:32617"), (90, 90, 20, 20), UNMOVED))
    assert len(looks) == 1
    assert list(site_photos.lost) == ["near.png"]


def test_place_that_no_photo_shows_has_no_look(site_photos: SitePhotos) -> None:
    header = _grid("EPSG:32617")
    far = replace(
        header, transform=(0.2, 0.0, header.transform[2] + 300.0, 0.0, -0.2, header.transform[5])
    )
    assert list(site_photos.looks(far, (90, 90, 20, 20), UNMOVED)) == []
