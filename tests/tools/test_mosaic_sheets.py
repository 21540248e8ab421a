"""A diagonal corridor: what its mosaic costs, and its sheets along a centre line."""

from __future__ import annotations

import json
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pyogrio
import pytest
import rasterio
import shapely
from mosaic_flights import EAST, LAT, LON, NORTH, Flight, copied, make
from tool_cases import Done, georef

from georef_gis.errors import Cancelled
from georef_gis.mosaic.coarse import BLOCK, SparseRaster
from georef_gis.mosaic.seamed import SeamMosaic
from georef_gis.project import Project
from georef_gis.project.geometry import from_blob
from georef_gis.toolbox.registry import load_registry
from georef_gis.toolbox.runner import run_tool

# px; photos of 30 x 20 m
SIZE = (150, 100)
# m east and north from one photo to the next
STEP = 7.0
SHORT, LONG = 16, 32
GSD = 0.1
TILE = 512


class Cost:
    """Tiles rendered and blocks of coarse rasters made, while patched in."""

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        self.tiles, self.rasters = 0, list[SparseRaster]()
        render, init = SeamMosaic.render, SparseRaster.__init__

        def counted(mosaic: SeamMosaic, *given: Any) -> Any:
            self.tiles += 1
            return render(mosaic, *given)

        def noted(raster: SparseRaster, **given: Any) -> None:
            init(raster, **given)
            self.rasters.append(raster)

        patch.setattr(SeamMosaic, "render", counted)
        patch.setattr(SparseRaster, "__init__", noted)


def corridor(folder: Path, photos: int) -> tuple[Flight, Cost]:
    """A mosaic of photos along 45 degrees, and what it cost."""
    flight = make(
        folder, places=[(STEP * k, STEP * k) for k in range(photos)],
        sizes=dict.fromkeys(range(photos), SIZE), products={"gsd_m": GSD},
    )  # fmt: skip
    with pytest.MonkeyPatch.context() as patch:
        cost = Cost(patch)
        flight.made()
    return flight, cost


@pytest.fixture(scope="module")
def short(tmp_path_factory: pytest.TempPathFactory) -> tuple[Flight, Cost]:
    return corridor(tmp_path_factory.mktemp("short") / "site", SHORT)


@pytest.fixture
def flight(short: tuple[Flight, Cost], tmp_path: Path) -> Flight:
    return copied(short[0], tmp_path / "site")


def test_a_diagonal_corridor_costs_its_length(short: tuple[Flight, Cost], tmp_path: Path) -> None:
    flight, cost = short
    longer, more = corridor(tmp_path / "site", LONG)
    sides = [np.array(f.summary()["size_px"]) for f in (flight, longer)]
    # else nothing would be shown
    assert (sides[1] > 1.7 * sides[0]).all()
    for made, spent, side in ((flight, cost, sides[0]), (longer, more, sides[1])):
        assert spent.tiles == made.summary()["tiles"]
        # photos of 30 x 20 m along 45 degrees are 50 m across, east to west: their band reaches
        # over 101 m in a row of tiles of 51 m, over 76 m in one of blocks of 26 m
        assert spent.tiles <= 3 * -(-side[1] // TILE)
        assert spent.rasters
        for raster in spent.rasters:
            assert len(list(raster)) <= 4 * -(-raster.height // BLOCK)
    # of the bounding box, which has 3 times as many
    assert more.tiles < 0.6 * np.prod(-(-sides[1] // TILE))


# -- sheets --------------------------------------------------------------------------------------


def sheets(flight: Flight, *words: object) -> Done:
    """Cut sheets, which must succeed."""
    done = cut(flight, *words)
    assert done.code == 0, done.text
    return done


def cut(flight: Flight, *words: object) -> Done:
    return georef("mosaic-sheets", "--project", flight.folder, *words)


def refused(flight: Flight, *words: object) -> str:
    """The one line that cutting ended with."""
    done = cut(flight, *words)
    assert done.code == 2, done.text
    assert "Traceback" not in done.text
    return done.line("georef: ")


def folder_of(flight: Flight) -> Path:
    return flight.folder / "products" / "sheets"


def files(flight: Flight) -> list[Path]:
    return sorted(folder_of(flight).glob("*.tif"))


def index(flight: Flight) -> list[tuple[str, float, float, str, Any]]:
    """Name, chainage, file and area of the sheets."""
    with closing(sqlite3.connect(folder_of(flight) / "sheets.gpkg")) as database:
        rows = database.execute("SELECT name, from_m, to_m, file, geom FROM sheets").fetchall()
    return [(*row[:4], shapely.from_wkb(from_blob(row[4]))) for row in rows]


def pixels(path: Path) -> tuple[np.ndarray, np.ndarray, tuple[int, int]]:
    """Pixels, mask, and column and row of the corner on the grid of multiples of the GSD."""
    with rasterio.open(path) as dataset:
        data, mask = dataset.read((1, 2, 3)), dataset.dataset_mask() > 0
        col, row = dataset.transform.c / GSD, -dataset.transform.f / GSD
        assert (col, row) == pytest.approx((round(col), round(row)), abs=1e-3)
    return data, mask, (round(col), round(row))


def line_file(path: Path, *ends: tuple[float, float]) -> Path:
    """GeoJSON of a line through places east and north, m."""
    places = [[LON + east / EAST, LAT + north / NORTH] for east, north in ends]
    path.write_text(json.dumps({"type": "LineString", "coordinates": places}))
    return path


def road(flight: Flight, *, away: float = 0.0) -> Path:
    """The line of the flight, from end to end of the photos' middles."""
    last = STEP * (SHORT - 1)
    return line_file(flight.folder / "road.geojson", (0.0, away), (last, last + away))


def test_sheets_along_the_flight_hold_the_whole_mosaic(flight: Flight) -> None:
    done = sheets(flight, "--length", 40)
    mosaic, shown, (left, top) = pixels(flight.path)
    found = np.zeros(shown.shape, int)
    for path, (name, _, _, file, area) in zip(files(flight), index(flight), strict=True):
        assert (path.stem, path.name) == (name, file)
        data, mask, (col, row) = pixels(path)
        here = np.s_[row - top : row - top + mask.shape[0], col - left : col - left + mask.shape[1]]
        np.testing.assert_array_equal(data[:, mask], mosaic[:, *here][:, mask])
        assert not mask[~shown[here]].any()
        # only where the mosaic does not reach is the area empty
        assert mask.sum() * GSD**2 <= area.area * 1.01
        found[here] += mask
        assert 0 < mask.sum() < 0.8 * mask.size
    np.testing.assert_array_equal(found > 0, shown)
    # one pixel wide at most, where two sheets meet
    assert (found > 1).sum() < 0.002 * shown.sum()
    ends = [row[1:3] for row in index(flight)]
    assert [end for _, end in ends[:-1]] == [start for start, _ in ends[1:]]
    # m; the diagonal of 15 steps, and what a photo reaches over at both ends
    assert ends[0][0] == 0.0
    assert ends[-1][1] == pytest.approx(15 * STEP * 2**0.5 + 35.0, abs=6.0)
    assert "5 sheets of mosaic.tif" in done.line("sheets of")


def test_a_sheet_is_a_whole_product(flight: Flight) -> None:
    sheets(flight, "--length", 80, "--overlap", 10)
    rows = index(flight)
    assert [round(row[1]) for row in rows[:2]] == [0, 70]
    assert rows[0][4].intersection(rows[1][4]).area == pytest.approx(
        10.0 * rows[0][4].area / 80.0, rel=0.01
    )
    with rasterio.open(files(flight)[0]) as dataset, rasterio.open(flight.path) as mosaic:
        assert dataset.crs == mosaic.crs
        assert dataset.descriptions == mosaic.descriptions
        assert dataset.tags()["CHAINAGE"] == "0.00 to 80.00 m"
        assert dataset.tags()["DATUM"] == mosaic.tags()["DATUM"]
        assert max(dataset.shape) > 512
        assert dataset.overviews(1)
    kinds = {
        str(name): kind for name, kind in pyogrio.list_layers(folder_of(flight) / "sheets.gpkg")
    }
    assert kinds == {"sheets": "MultiPolygon", "centre_line": "LineString"}


def test_the_kind_of_file_does_not_matter(flight: Flight) -> None:
    plain = road(flight)
    frame = pyogrio.read_dataframe(plain)
    seen = []
    for name in ("road.gpkg", "road.shp", "road.kml", "utm.gpkg"):
        path = flight.folder / name
        moved = frame.to_crs("EPSG:32617") if name == "utm.gpkg" else frame
        driver = "LIBKML" if path.suffix == ".kml" else None
        pyogrio.write_dataframe(moved[["geometry"]], path, driver=driver)
        sheets(flight, "--line", path, "--length", 60, "--width", 20)
        seen.append([(row[0], *row[4].bounds) for row in index(flight)])
        assert len(seen[-1]) == 3
    for other in seen[1:]:
        for one, two in zip(seen[0], other, strict=True):
            # m; KML holds 15 digits, degrees of 1e-9 are 0.1 mm
            assert one[1:] == pytest.approx(two[1:], abs=1e-3)


def test_sheets_that_show_nothing_are_not_written(flight: Flight) -> None:
    """Of a line from 340 m before the flight on."""
    line = line_file(flight.folder / "far.geojson", (-240.0, -240.0), (105.0, 105.0))
    done = sheets(flight, "--line", line, "--length", 100, "--json")
    names = [path.stem[-3:] for path in files(flight)]
    assert names == ["004", "005"]
    assert '"empty_sheets": 3' in done.text


def test_only_our_own_sheets_are_replaced(flight: Flight) -> None:
    sheets(flight, "--length", 20)
    before = files(flight)
    copy = before[-1].with_name("kept_sheet_001.tif")
    copy.write_bytes(before[-1].read_bytes())
    foreign = before[0].with_name("notes_sheet_002.tif")
    foreign.write_text("no raster")
    sheets(flight, "--length", 80)
    assert files(flight) == sorted([*before[: len(index(flight))], copy, foreign])
    assert len(index(flight)) < len(before)
    files(flight)[-2].unlink()
    taken = folder_of(flight) / before[0].name
    taken.write_text("no raster")
    kept = (folder_of(flight) / "sheets.gpkg").read_bytes()
    assert f"{taken.name}: is there and is no sheet of ours" in refused(flight)
    assert taken.read_text() == "no raster"
    assert (folder_of(flight) / "sheets.gpkg").read_bytes() == kept


class Impatient:
    """Feedback of a user who wants to stop after the first sheet."""

    stop = False

    def progress(self, fraction: float, message: str = "") -> None:
        self.stop = True

    def warn(self, message: str) -> None: ...

    def info(self, message: str) -> None: ...

    def cancelled(self) -> bool:
        return self.stop


def test_a_wish_to_stop_leaves_whole_sheets_and_no_index(flight: Flight) -> None:
    with pytest.raises(Cancelled):
        run_tool(load_registry(), "mosaic_sheets", {"length": 40}, Impatient(),
                 project=Project.open(flight.folder))  # fmt: skip
    left = list(folder_of(flight).iterdir())
    assert [path.name[-14:] for path in left] == ["_sheet_001.tif"]
    assert pixels(left[0])[1].any()
    sheets(flight, "--length", 80)
    assert len(files(flight)) == len(index(flight)) == 3


def test_jpeg_of_jpeg_changes_little(flight: Flight) -> None:
    flight.set("products", compression="jpeg")
    flight.made()
    sheets(flight, "--length", 60)
    mosaic, _, (left, top) = pixels(flight.path)
    for path in files(flight):
        data, mask, (col, row) = pixels(path)
        here = np.s_[:, row - top : row - top + mask.shape[0],
                     col - left : col - left + mask.shape[1]]  # fmt: skip
        away = np.abs(data.astype(int) - mosaic[here])[:, mask]
        # grey levels; on blocks of their own they would be 0.2, and 1 for one in twenty
        assert away.mean() < 0.05
        assert np.percentile(away, 95) == 0
        # blocks at the rim of a sheet are other blocks
        assert away.max() <= 8


def test_wrong_lines_are_refused_in_one_line(flight: Flight) -> None:
    here = flight.folder
    frame = pyogrio.read_dataframe(road(flight))
    two = here / "two.gpkg"
    for layer in ("left", "right"):
        pyogrio.write_dataframe(frame[["geometry"]], two, layer=layer, append=two.exists())
    told = refused(flight, "--line", two)
    assert "has lines in 2 layers (left, right); say which by --layer" in told
    sheets(flight, "--line", two, "--layer", "left")
    sheets(flight, "--line", f"{two}|layername=left")
    assert "no layer 'middle'; use left, right" in refused(
        flight, "--line", two, "--layer", "middle"
    )
    points = here / "points.geojson"
    points.write_text(json.dumps({"type": "Point", "coordinates": [LON, LAT]}))
    assert "points.geojson: holds no line" in refused(flight, "--line", points)
    (here / "text.geojson").write_text("no line")
    assert "text.geojson: cannot be read" in refused(flight, "--line", here / "text.geojson")
    assert "there is no such file" in refused(flight, "--line", here / "none.kml")
    nought = line_file(here / "nought.geojson", (0.0, 0.0), (0.0, 0.0))
    assert "nought.geojson: the line has no length" in refused(flight, "--line", nought)
    away = refused(flight, "--line", road(flight, away=500.0), "--width", 40)
    assert "road.geojson: line: the line lies outside mosaic.tif, 3" in away
    assert "no layer" not in away
    bare = here / "bare.shp"
    pyogrio.write_dataframe(frame[["geometry"]], bare)
    bare.with_suffix(".prj").unlink()
    assert "bare.shp: has no CRS" in refused(flight, "--line", bare)


def test_wrong_lengths_are_refused_in_one_line(flight: Flight) -> None:
    assert "sheets, more than 10000; give longer ones" in refused(flight, "--length", 0.01)
    assert "overlap: is not less than the length" in refused(flight, "--overlap", 500)
    flight.path.unlink()
    assert "mosaic.tif: raster: there is no such file; run `georef run`" in refused(flight)


def test_any_raster_on_a_map_can_be_cut(flight: Flight) -> None:
    with rasterio.open(flight.path) as mosaic:
        options = {**mosaic.profile, "count": 1, "dtype": "float32", "nodata": -9999.0}
        shape = mosaic.shape
    values = np.full(shape, -9999.0, np.float32)
    values[:, shape[1] // 2 :] = 3.5
    path = flight.folder / "heights.tif"
    with rasterio.open(path, "w", **options) as raster:
        raster.write(values, 1)
    sheets(flight, "--raster", path, "--length", "100ft")
    found = sorted((flight.folder / "products" / "heights_sheets").glob("heights_sheet_*.tif"))
    assert len(found) > 1
    for one in found:
        with rasterio.open(one) as sheet:
            assert set(sheet.read(1)[sheet.dataset_mask() > 0]) == {3.5}
    assert not folder_of(flight).exists()
    options |= {"crs": "EPSG:4326"}
    with rasterio.open(path, "w", **options) as raster:
        raster.write(values, 1)
    assert "heights.tif: is in degrees ('WGS 84')" in refused(flight, "--raster", path)
