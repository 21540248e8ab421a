"""The mosaic along seams of photos that are lost, large, alone, doubtful or lie oddly."""

from __future__ import annotations

import shutil
import sqlite3
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from mosaic_flights import PREPARED, ROW, Flight, flat, make, scene, taken
from tool_cases import georef

from georef_gis.mosaic import prepare
from georef_gis.rasters.reading import read_image
from processing_algorithms.mosaic import seamlines, tiles

pytestmark = pytest.mark.slow

LEVELS = (40, 90, 140, 190)
# m
FINE = 0.1


def shown(folder: Path, places: Sequence[tuple[float, float]] = ROW, **values: Any) -> Flight:
    """Photos of one grey each, whose mosaic shows which one it takes."""
    flight = make(folder, flat(LEVELS), places, **values)
    flight.wish(seams="optimised", colour="none", blend="none")
    return flight


def truncated(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:5000])


SPOIL: dict[str, Callable[[Path], None]] = {"gone": Path.unlink, "corrupt": truncated}


@pytest.mark.parametrize("spoil", SPOIL.values(), ids=SPOIL)
@pytest.mark.parametrize("workers", ["1", "2"])
def test_a_photo_lost_between_preparation_and_tiles_is_named_and_filled(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, spoil: Callable[[Path], None], workers: str
) -> None:
    flight = shown(tmp_path / "site")
    real = tiles.render_tiles

    def render(*args: Any) -> int:
        spoil(flight.photo(1))
        return real(*args)

    monkeypatch.setattr(tiles, "render_tiles", render)
    done = flight.made("--workers", workers)
    assert done.line("doubt", "P001.tif")
    assert sum("P001.tif" in line for line in done.text.splitlines()) == 1
    found = taken(flight, LEVELS)
    assert not (found == 1).any()
    # its neighbours show all its ground but a strip in the middle: 85 + 50 m of 120 m
    place = flight.places()[0]
    assert (found[:, np.abs(place[160] - 35.0) < 20.0][10:-10] >= 0).all()


@pytest.mark.parametrize("spoil", SPOIL.values(), ids=SPOIL)
def test_a_photo_lost_before_preparation_is_named_and_filled(
    tmp_path: Path, spoil: Callable[[Path], None]
) -> None:
    flight = shown(tmp_path / "site")
    spoil(flight.photo(1))
    done = flight.made()
    assert done.line("doubt", "P001.tif")
    found = taken(flight, LEVELS)
    assert set(np.unique(found)) >= {0, 2, 3}
    assert not (found == 1).any()


def test_a_mosaic_of_lost_photos_alone_is_refused_in_one_line(tmp_path: Path) -> None:
    flight = shown(tmp_path / "site")
    for k in range(4):
        truncated(flight.photo(k))
    done = flight.run()
    assert done.code == 2, done.text
    assert done.line(".tif", "check that the file is whole")
    assert len(done.text.splitlines()) == 1


@pytest.mark.parametrize("lost", [2, 4])
def test_a_share_that_goes_away_while_photos_are_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, lost: int
) -> None:
    """Each time that the photos are read one more is gone: none stays unsaid."""
    flight = shown(tmp_path / "site")
    real = prepare.make_proxies
    passes = 0

    def make_proxies(*args: Any, **options: Any) -> Any:
        nonlocal passes
        if passes < lost:
            truncated(flight.photo(passes))
            shutil.rmtree(flight.folder / "cache" / seamlines.PROXIES, ignore_errors=True)
        passes += 1
        return real(*args, **options)

    monkeypatch.setattr(prepare, "make_proxies", make_proxies)
    done = flight.run()
    assert "Traceback" not in done.text
    if lost == 4:
        assert done.code == 2
        assert done.line("P000.tif", "check that the file is whole")
        return
    assert done.code == 0, done.text
    assert done.line("doubt", "P000.tif")
    assert done.line("doubt", "P001.tif")
    assert {2, 3} <= set(np.unique(taken(flight, LEVELS))) <= {-1, 2, 3}


def test_edited_seams_of_a_lost_photo_alone(tmp_path: Path) -> None:
    """The photo that the user gave all ground to cannot be read: the others fill it."""
    flight = shown(tmp_path / "site")
    flight.made()
    with sqlite3.connect(flight.seams) as database:
        database.execute("DELETE FROM seams WHERE photo <> 'P001'")
    truncated(flight.photo(1))
    done = flight.made()
    assert done.line("doubt", "P001.tif")
    found = taken(flight, LEVELS)
    assert {0, 2, 3} <= set(np.unique(found))


def test_a_photo_far_larger_than_the_rest(tmp_path: Path) -> None:
    """24 times the pixels and the ground: it fills what the others leave, and they lie in it."""
    flight = shown(tmp_path / "site", sizes={2: (3000, 1960)})
    flight.made()
    found = taken(flight, LEVELS)
    assert set(np.unique(found)) == {-1, 0, 1, 2, 3}
    east, north = flight.places()
    assert (found[(np.abs(east - 70.0) < 250.0) & (np.abs(north) > 60.0) & (np.abs(north) < 180.0)]
            == 2).all()  # fmt: skip
    for k in (0, 1, 3):
        near = np.hypot(east - ROW[k][0], north) < 8.0
        assert (found[near] == k).mean() > 0.9, k


def test_depths_that_differ_are_named_and_left_out(tmp_path: Path) -> None:
    flight = shown(tmp_path / "site", dtypes={2: "uint16"})
    done = flight.made()
    assert "3 x uint16" in done.line("doubt", "P002.tif")
    data, _ = flight.read()
    assert data.dtype == np.uint8
    assert set(np.unique(taken(flight, LEVELS))) == {-1, 0, 1, 3}


def stored_anew(flight: Flight, store: Callable[[int, Path], None]) -> None:
    """Write the photos' files by their numbers in another way, and have them read again."""
    for k in range(len(ROW)):
        store(k, flight.photo(k))
    done = georef("run", flight.folder, "--only", PREPARED)
    assert done.code == 0, done.text


@pytest.mark.parametrize(
    ("types", "bands"), [(("int16", "uint16"), 1), (("uint32", "float32"), 3)], ids=str
)
def test_types_of_as_many_bits_are_kinds_of_their_own(
    tmp_path: Path, types: tuple[str, str], bands: int
) -> None:
    """The first photo is the stranger: what it holds must not decide."""
    flight = shown(tmp_path / "site")

    def store(k: int, path: Path) -> None:
        image = np.full((400, 600, bands), LEVELS[k], types[min(k, 1)])
        tifffile.imwrite(path, np.squeeze(image), photometric="minisblack" if bands == 1 else "rgb")

    stored_anew(flight, store)
    done = flight.made()
    line = done.line("doubt", "P000.tif")
    assert f"{bands} x {types[0]} where most photos have {bands} x {types[1]}" in line
    assert done.text.count("doubt") == 1
    assert str(flight.read()[0].dtype) == types[1]
    assert set(np.unique(taken(flight, LEVELS))) == {-1, 1, 2, 3}


def with_fourth(kind: str) -> Callable[[int, Path], None]:
    """Writes the photos as they are with a fourth sample."""

    def store(k: int, path: Path) -> None:
        image = np.dstack([read_image(path)[..., :3], np.full((400, 600), 200 + k, np.uint8)])
        tifffile.imwrite(path, image, photometric="rgb", extrasamples=[kind])

    return store


@pytest.mark.parametrize("seams", ["optimised", "none"])
@pytest.mark.parametrize("kind", ["unassalpha", "assocalpha"])
def test_an_alpha_channel_is_no_band_and_is_told_once(
    tmp_path: Path, seams: str, kind: str
) -> None:
    flight = make(tmp_path / "site")
    flight.wish(seams=seams)
    flight.made()
    want, mask = flight.read()
    stored_anew(flight, with_fourth(kind))
    done = flight.made()
    line = done.line("doubt", "alpha channel")
    assert "P000.tif" in line
    assert "3 more photos" in line
    assert done.text.count("alpha channel") == 1
    data, shown_at = flight.read()
    np.testing.assert_array_equal(data, want)
    np.testing.assert_array_equal(shown_at, mask)


def test_a_fourth_band_is_one_unless_it_is_stated_to_be_alpha(tmp_path: Path) -> None:
    flight = shown(tmp_path / "site")
    stored_anew(flight, with_fourth("unspecified"))
    done = flight.made()
    assert "doubt" not in done.text
    data, mask = flight.read()
    assert data.shape[2] == 4
    found = taken(flight, LEVELS)
    # at seams two photos are mixed
    same = data[..., 3] == 200 + found
    assert same[mask].mean() > 0.99


def test_photos_with_and_without_alpha_make_one_mosaic(tmp_path: Path) -> None:
    flight = shown(tmp_path / "site")
    add = with_fourth("unassalpha")
    stored_anew(flight, lambda k, path: add(k, path) if k == 2 else None)
    done = flight.made()
    assert "more photos" not in done.line("doubt", "P002.tif", "alpha channel")
    assert set(np.unique(taken(flight, LEVELS))) == {-1, 0, 1, 2, 3}


@pytest.mark.parametrize("shift", [0.0, 0.5, 1.0])
def test_tile_borders_on_photo_borders_leave_no_line(tmp_path: Path, shift: float) -> None:
    """The second photo starts at the second tile, or so many pixels on."""
    # UTM is 0.04 % smaller in its middle
    spacing = (512.0 + shift) * FINE / 0.9996
    places = tuple((spacing * k, 0.0) for k in range(3))
    flight = make(tmp_path / "site", places=places, dtypes="uint16", products={"gsd_m": FINE})
    flight.made()
    data, mask = flight.read()
    assert mask[40:-40, 40:-40].all()
    want = 65535.0 * scene(0, *flight.places())
    error = data / want - (data / want)[40:-40, 40:-40].mean()
    rim = error[40:-40, 500:1040]
    # of 65535; the scene itself changes by 1 % a pixel
    assert np.abs(np.diff(rim, axis=1)).max() < 0.001


def test_one_photo_alone(tmp_path: Path) -> None:
    flight = shown(tmp_path / "site", ROW[:1])
    flight.made()
    found = taken(flight, LEVELS)
    assert (found[10:-10, 10:-10] == 0).all()
    assert flight.summary()["colour_step"]["places"] == 0
    assert flight.summary()["colour_step"]["between_photos"]["median"] is None


def test_two_photos_without_overlap(tmp_path: Path) -> None:
    flight = make(tmp_path / "site", flat(LEVELS), ((0.0, 0.0), (200.0, 150.0)))
    flight.made()
    found = taken(flight, LEVELS)
    assert set(np.unique(found)) == {-1, 0, 1}
    east, north = flight.places()
    # 120 x 80 m of each, its grey as it is
    for k, (x, y) in enumerate(((0.0, 0.0), (200.0, 150.0))):
        assert (found[(np.abs(east - x) < 59.0) & (np.abs(north - y) < 39.0)] == k).all()
    data, mask = flight.read()
    assert set(np.unique(data[mask])) <= {*LEVELS[:2]}


def test_a_photo_within_another_shows_its_middle(tmp_path: Path) -> None:
    """Flown lower, above another place: round its nadir its own ground, else the other's."""
    flight = shown(tmp_path / "site", ((0.0, 0.0), (30.0, 10.0)), heights={1: 30.0})
    flight.made()
    found = taken(flight, LEVELS)
    assert set(np.unique(found[10:-10, 10:-10])) == {0, 1}
    east, north = flight.places()
    assert (found[np.hypot(east - 30.0, north - 10.0) < 5.0] == 1).all()


def test_a_doubtful_photo_gives_way(tmp_path: Path) -> None:
    flight = shown(tmp_path / "site")
    flight.execute("UPDATE photo SET doubts = '[]'")
    flight.execute("UPDATE pose SET doubts = '[]'")
    flight.made()
    before = taken(flight, LEVELS)
    flight.execute("UPDATE pose SET doubts = '[\"shaken\"]' WHERE photo_id = 'P001'")
    flight.made("--force")
    after = taken(flight, LEVELS)
    assert (before == 1).mean() > 0.15
    # of the ground that no other shows it keeps all, of the rest next to nothing
    assert (after == 1).mean() < 0.02
    assert ((after >= 0) == (before >= 0)).all()
