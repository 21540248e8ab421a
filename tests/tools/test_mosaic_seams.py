"""The mosaic along seams against a scene that is known, and the layer of seams that users edit."""

from __future__ import annotations

import sqlite3
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from mosaic_flights import ROW, Flight, Values, copied, flat, make, scene, taken
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion, uniform_filter
from tool_cases import georef

from georef_gis.project import Project
from georef_gis.project.geometry import from_blob, to_blob
from georef_gis.rasters.reading import read_image
from georef_gis.rasters.warp import ImageCache, warp_window
from processing_algorithms.mosaic.inputs import gather, mosaic_sources
from processing_algorithms.rasters import ground_of
from processing_algorithms.site import load_footprints, load_site

pytestmark = pytest.mark.slow

GAINS = (1.0, 0.85, 1.15, 0.9)
LEVELS = (40, 90, 140, 190)
TOP = 65535.0


def uneven(k: int, east: Values, north: Values) -> Values:
    """The scene through a lens that darkens to its corners by a quarter, of varying exposure."""
    r2 = ((east - ROW[k][0]) ** 2 + (north - ROW[k][1]) ** 2) / 72.1**2
    return np.asarray(scene(k, east, north) * (GAINS[k] * (1.0 - 0.25 * r2))[..., None])


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Flight:
    """Photos of uneven colours; of 16 bits, so that rounding hides nothing."""
    return make(tmp_path_factory.mktemp("plain") / "site", uneven, dtypes="uint16")


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory) -> Flight:
    """Photos of one grey each: the mosaic shows which one it takes. Rendered once."""
    flight = make(tmp_path_factory.mktemp("shown") / "site", flat(LEVELS))
    flight.wish(seams="optimised", colour="none", blend="none")
    flight.made()
    return flight


def errors(flight: Flight) -> tuple[NDArray[Any], NDArray[np.bool_]]:
    """Logarithm of mosaic over scene less its mean, and where it counts; (rows, cols, bands).

    The overlaps do not tell how bright the whole is.
    """
    data, mask = flight.read()
    inner = binary_erosion(mask, iterations=6)
    out = np.log(np.maximum(data, 1.0) / (TOP * scene(0, *flight.places())))
    return out - out[inner].mean(axis=0), inner


def steps(error: NDArray[Any], inner: NDArray[np.bool_]) -> float:
    """Largest difference of two neighbouring pixels' errors."""
    across = np.abs(np.diff(error, axis=1))[inner[:, 1:] & inner[:, :-1]]
    down = np.abs(np.diff(error, axis=0))[inner[1:] & inner[:-1]]
    return float(max(across.max(), down.max()))


# -- colour --------------------------------------------------------------------------------------


def test_photos_of_uneven_colours_make_an_even_picture(plain: Flight, tmp_path: Path) -> None:
    flight = copied(plain, tmp_path / "site")
    flight.made()
    error, inner = errors(flight)
    # exposures differ by 30 %, corners by 25 %; of smooth trends, which overlaps hardly tell, a
    # little is left
    assert error[inner].std() < 0.01
    # a grey value of 8 bits in the middle of the range is 0.9 %
    assert steps(error, inner) < 0.001
    told = flight.summary()
    assert (told["seams"], told["colour"], told["blend"]) == ("optimised", "full", "multiband")
    assert told["colour_step"]["places"] > 100
    assert told["colour_step"]["between_photos"]["median"] < 0.1
    assert told["colour_step"]["in_the_result"]["median"] < 0.1


CHOICES: dict[str, tuple[dict[str, str], str, float]] = {
    # parameters, seams as told, steps of neighbouring pixels
    "nearest": ({"seams": "nearest"}, "nearest", 0.001),
    "feather": ({"seams": "optimised", "blend": "feather"}, "optimised", 0.001),
    "gain": ({"seams": "optimised", "colour": "gain"}, "optimised", 0.005),
    "no colour": ({"seams": "optimised", "colour": "none"}, "optimised", 0.01),
    "none": ({"seams": "none"}, "none", 0.02),
    # poses of tags alone
    "auto": ({"seams": "auto"}, "none", 0.02),
}


@pytest.mark.parametrize(("wishes", "told", "limit"), CHOICES.values(), ids=CHOICES)
def test_each_choice_keeps_steps_small(
    plain: Flight, tmp_path: Path, wishes: dict[str, str], told: str, limit: float
) -> None:
    flight = copied(plain, tmp_path / "site")
    flight.wish(**wishes)
    flight.made()
    assert flight.summary()["seams"] == told
    assert flight.seams.exists() == (told != "none")
    assert steps(*errors(flight)) < limit


def test_a_blend_hides_what_the_summary_tells_between_the_photos(
    plain: Flight, tmp_path: Path
) -> None:
    flight = copied(plain, tmp_path / "site")
    flight.wish(seams="optimised", colour="none")
    flight.made()
    told = flight.summary()["colour_step"]
    # 15 to 30 % of some 115 grey values
    assert 10.0 < told["between_photos"]["median"] < 40.0
    assert told["in_the_result"]["median"] < 0.2
    flight.wish(seams="optimised", colour="none", blend="none")
    flight.made()
    told = flight.summary()["colour_step"]
    assert told["in_the_result"] == told["between_photos"]
    assert steps(*errors(flight)) > 0.1


@pytest.mark.parametrize("dtype", ["uint8", "uint16"])
def test_without_colour_and_blend_grey_values_are_those_of_the_photos(
    tmp_path: Path, dtype: str
) -> None:
    """Each pixel is that of a photo on the same grid, to the bit: radiometry stays linear."""
    flight = make(tmp_path / "site", uneven, dtypes=dtype)
    flight.wish(seams="optimised", colour="none", blend="none")
    flight.made()
    data, mask = flight.read()
    site = load_site(project := Project.open(flight.folder, read_only=True))
    inputs = gather(site, load_footprints(project), 0.25, ImageCache())
    same = np.zeros(mask.shape, int)
    for source in mosaic_sources(inputs).values():
        image = read_image(source.photo.photo.path, reduce=source.reduce)
        for task in inputs.plan.tiles:
            w = task.window
            found = warp_window(
                source.photo, image, ground_of(site, inputs.grid), inputs.grid, w,
                step=source.step, reduce=source.reduce,
            )  # fmt: skip
            here = (slice(w.row, w.row + w.height), slice(w.col, w.col + w.width))
            if found is not None:
                inside = True if found[1] is None else found[1]
                same[here] += np.all(data[here] == found[0], axis=-1) & inside
    # at seams, a pixel wide, two photos are mixed
    mixed = mask & (same == 0)
    assert mixed.sum() < 0.006 * mask.sum()
    assert uniform_filter(mixed.astype(float), 9)[mask].max() < 0.5


BANDS: dict[str, tuple[Sequence[int], str, tuple[str, ...]]] = {
    "two bands": ((0, 2), "uint8", ()),
    "one band of 16 bits": ((1,), "uint16", ()),
    "NIR of 16 bits": ((0, 1, 2), "uint16", ("NIR", "green", "blue")),
    "five bands": ((0, 1, 2, 1, 0), "uint8", ()),
}


@pytest.mark.parametrize(("bands", "dtype", "names"), BANDS.values(), ids=BANDS)
def test_bands_and_types(
    tmp_path: Path, bands: Sequence[int], dtype: str, names: tuple[str, ...]
) -> None:
    def paint(k: int, east: Values, north: Values) -> Values:
        return uneven(k, east, north)[..., list(bands)]

    flight = make(tmp_path / "site", paint, dtypes=dtype, products={"band_names": list(names)})
    flight.made()
    data, mask = flight.read()
    assert (data.shape[2], str(data.dtype)) == (len(bands), dtype)
    inner = binary_erosion(mask, iterations=6)
    want = scene(0, *flight.places())[..., list(bands)]
    error = np.log(np.maximum(data, 1.0) / want)[inner]
    # 8 bits add 0.3 % and more in dark corners; see above
    np.testing.assert_array_less(error.std(axis=0), 0.012)


# -- the layer -----------------------------------------------------------------------------------


def cells(flight: Flight) -> dict[str, Any]:
    """Photo -> its area, as the file holds it."""
    with sqlite3.connect(flight.seams) as database:
        rows = database.execute("SELECT photo, geom FROM seams").fetchall()
    return {photo: shapely.from_wkb(from_blob(blob)) for photo, blob in rows}


def redraw(flight: Flight, photo: str, area: Any) -> None:
    """Save another area, its largest part, as a GIS does."""
    area = max(getattr(area, "geoms", [area]), key=lambda part: part.area)
    with sqlite3.connect(flight.seams) as database:
        srs = database.execute("SELECT srs_id FROM gpkg_geometry_columns").fetchone()[0]
        blob = to_blob(shapely.to_wkb(shapely.multipolygons([area]), byte_order=1), srs)[0]
        database.execute("UPDATE seams SET geom = ? WHERE photo = ?", (blob, photo))


def move_border(flight: Flight, by: float) -> None:
    """Move the border of the first two photos east, m: the first gains what the second loses."""
    areas = cells(flight)
    first, second = areas["P000"], areas["P001"]
    gained = shapely.intersection(shapely.affinity.translate(first, by), second)
    redraw(flight, "P000", shapely.union(first, gained))
    redraw(flight, "P001", shapely.difference(second, gained))


def test_an_unchanged_mosaic_is_skipped(shown: Flight, tmp_path: Path) -> None:
    flight = copied(shown, tmp_path / "site")
    assert "1 of 1 steps were unchanged" in flight.made().text


def test_the_layer_holds_one_area_for_each_photo(shown: Flight) -> None:
    areas = cells(shown)
    assert sorted(areas) == ["P000", "P001", "P002", "P003"]
    found = taken(shown, LEVELS)
    for k, area in enumerate(areas[name] for name in sorted(areas)):
        # borders are smoothed over a coarse pixel, 0.25 to 0.5 m of 80 m
        assert area.area == pytest.approx((found == k).sum() * 0.25**2, rel=0.02)


def test_a_border_moved_by_5_m_moves_in_the_mosaic(shown: Flight, tmp_path: Path) -> None:
    flight = copied(shown, tmp_path / "site")
    before = taken(flight, LEVELS)
    move_border(flight, 5.0)
    edited = flight.seams.read_bytes()
    done = flight.made()
    assert "seams as edited are used" in done.line("seams.gpkg")
    assert flight.summary()["seams"] == "edited"
    after = taken(flight, LEVELS)
    gained = (before == 1) & (after == 0)
    # 5 m of a border of 80 m, which is not straight
    assert gained.sum() * 0.25**2 == pytest.approx(400.0, rel=0.15)
    # a pixel at the new border is mixed and may look like any
    assert ((before != after) & ~gained).mean() < 0.003
    assert flight.seams.read_bytes() == edited
    assert "1 of 1 steps were unchanged" in flight.made().text


def test_a_deleted_layer_is_computed_anew(shown: Flight, tmp_path: Path) -> None:
    flight = copied(shown, tmp_path / "site")
    before, mosaic = cells(flight), flight.path.read_bytes()
    move_border(flight, 5.0)
    flight.made()
    assert flight.path.read_bytes() != mosaic
    flight.seams.unlink()
    done = flight.made()
    assert "edited" not in done.text
    assert flight.summary()["seams"] == "optimised"
    assert cells(flight) == before
    assert flight.path.read_bytes() == mosaic


def test_a_look_at_the_layer_changes_nothing(shown: Flight, tmp_path: Path) -> None:
    """A GIS that opens it writes to the file."""
    flight = copied(shown, tmp_path / "site")
    with sqlite3.connect(flight.seams) as database:
        database.execute("PRAGMA journal_mode = WAL")
        database.execute("UPDATE gpkg_contents SET last_change = '2030-01-01T00:00:00.000Z'")
    database.close()
    assert "1 of 1 steps were unchanged" in flight.made().text


def test_a_priority_decides_where_areas_overlap(shown: Flight, tmp_path: Path) -> None:
    flight = copied(shown, tmp_path / "site")
    areas = cells(flight)
    before = taken(flight, LEVELS)
    redraw(flight, "P002", areas["P002"].buffer(10.0))
    with sqlite3.connect(flight.seams) as database:
        database.execute("UPDATE seams SET priority = 1 WHERE photo = 'P002'")
    flight.made()
    after = taken(flight, LEVELS)
    assert ((after == 2) & (before == 1)).sum() * 0.25**2 == pytest.approx(800.0, rel=0.15)


SPOILT = {
    "unknown photo": ("UPDATE seams SET photo = 'P0O1' WHERE photo = 'P001'", "P0O1"),
    "no photo": ("UPDATE seams SET photo = NULL WHERE photo = 'P001'", "names no photo"),
    "no polygon": ("DELETE FROM seams", "has no polygon"),
    "no layer": ("DELETE FROM gpkg_geometry_columns", "has no layer 'seams'"),
    "priority": ("UPDATE seams SET priority = 'high' WHERE photo = 'P001'", "'high'"),
}


@pytest.mark.parametrize(("query", "words"), SPOILT.values(), ids=SPOILT)
def test_a_spoilt_layer_is_refused_in_one_line(
    shown: Flight, tmp_path: Path, query: str, words: str
) -> None:
    flight = copied(shown, tmp_path / "site")
    mosaic = flight.path.read_bytes()
    with sqlite3.connect(flight.seams) as database:
        database.execute(query)
    spoilt = flight.seams.read_bytes()
    done = flight.run()
    assert done.code == 2, done.text
    assert words in done.line("seams.gpkg")
    assert "Traceback" not in done.text
    # neither what a user drew nor the last mosaic is lost
    assert flight.seams.read_bytes() == spoilt
    assert flight.path.read_bytes() == mosaic


def test_a_layer_that_is_no_database_is_refused_in_one_line(shown: Flight, tmp_path: Path) -> None:
    flight = copied(shown, tmp_path / "site")
    flight.seams.write_bytes(b"no database" * 100)
    done = flight.run()
    assert done.code == 2, done.text
    assert "cannot be used" in done.line("seams.gpkg")


def test_deleted_areas_are_filled_as_they_were_computed(shown: Flight, tmp_path: Path) -> None:
    flight = copied(shown, tmp_path / "site")
    before = taken(flight, LEVELS)
    with sqlite3.connect(flight.seams) as database:
        database.execute("DELETE FROM seams WHERE photo <> 'P001'")
    done = flight.made()
    assert "filled as they were computed" in done.line("gaps")
    np.testing.assert_array_equal(taken(flight, LEVELS), before)


def test_edited_seams_stay_when_a_photo_goes(shown: Flight, tmp_path: Path) -> None:
    flight = copied(shown, tmp_path / "site")
    move_border(flight, 5.0)
    flight.made()
    flight.photo(3).unlink()
    done = georef("run", flight.folder, "--only", "read_photos,orient_direct,footprints,mosaic")
    assert done.code == 0, done.text
    assert "P003" in done.line("no longer in the mosaic")
    assert "seams.gpkg: seams.gpkg" not in done.text
    assert not (taken(flight, LEVELS) == 3).any()


def test_edited_seams_that_are_not_asked_for_stay(shown: Flight, tmp_path: Path) -> None:
    flight = copied(shown, tmp_path / "site")
    move_border(flight, 5.0)
    edited = flight.seams.read_bytes()
    flight.wish(seams="none")
    flight.made()
    assert flight.summary()["seams"] == "none"
    assert flight.seams.read_bytes() == edited
