"""The layer of seams: what a GIS sees of it, and what a user may do to it."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pyogrio
import pytest
import shapely

from georef_gis.errors import CrsError, InputError
from georef_gis.geodesy import CRS
from georef_gis.project import Srs
from georef_gis.project.geometry import to_blob
from georef_gis.project.seam_layer import SEAMS_FILE, Seams, read_seams, write_seams

UTM = CRS.from_epsg(32617)
WKT = UTM.to_wkt("WKT1_GDAL")
SRS = Srs(name=UTM.name, wkt=WKT, code=32617)
X, Y = 500000.0, 4428000.0
PHOTOS = ("IMG_1", "IMG_2", "IMG_3")


def square(col: float, row: float, width: float = 10.0, height: float = 10.0) -> Any:
    return shapely.MultiPolygon([
        shapely.box(X + col, Y + row, X + col + width, Y + row + height)
    ])  # fmt: skip


# three squares of 10 m in a row
WRITTEN = [(name, square(10.0 * k, 0.0)) for k, name in enumerate(PHOTOS)]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    write_seams(tmp_path / SEAMS_FILE, WRITTEN, SRS)
    return tmp_path / SEAMS_FILE


def read(path: Path, photos: tuple[str, ...] = PHOTOS, wkt: str = WKT) -> Seams:
    return read_seams(path, photos=photos, crs_wkt=wkt)


def edit(path: Path, sql: str, *values: Any) -> None:
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute(sql, values)


def redraw(path: Path, photo: str, area: Any) -> None:
    edit(path, "UPDATE seams SET geom = ? WHERE photo = ?", blob(area), photo)


def blob(area: Any) -> bytes:
    return to_blob(shapely.to_wkb(area, byte_order=1), 32617)[0]


def areas(seams: Seams) -> dict[str, float]:
    assert shapely.coverage_is_valid([area for _, area in seams.cells])
    assert all(area.geom_type == "MultiPolygon" for _, area in seams.cells)
    return {name: area.area for name, area in seams.cells}


# What is written


def test_another_library_reads_the_layer(path: Path) -> None:
    frame = pyogrio.read_dataframe(path, layer="seams")
    assert frame["photo"].tolist() == list(PHOTOS)
    assert frame["priority"].tolist() == [0, 0, 0]
    assert frame.crs.to_epsg() == 32617
    assert all(a.equals(b) for a, (_, b) in zip(frame.geometry, WRITTEN, strict=True))
    info = pyogrio.read_info(path, layer="seams")
    assert info["geometry_type"] == "MultiPolygon"
    assert info["total_bounds"] == (X, Y, X + 30.0, Y + 10.0)


def test_what_was_written_is_read_back_to_the_last_bit(path: Path) -> None:
    seams = read(path)
    assert not seams.edited
    assert seams.notes == ()
    assert [name for name, _ in seams.cells] == list(PHOTOS)
    assert all(
        shapely.to_wkb(a) == shapely.to_wkb(b)
        for (_, a), (_, b) in zip(seams.cells, WRITTEN, strict=True)
    )


def test_writing_again_leaves_one_file(path: Path) -> None:
    write_seams(path, WRITTEN[:2], SRS)
    assert areas(read(path)) == {"IMG_1": 100.0, "IMG_2": 100.0}
    assert [p.name for p in path.parent.iterdir()] == [SEAMS_FILE]


def test_a_failure_in_writing_leaves_the_file_before(path: Path) -> None:
    with pytest.raises(TypeError):
        write_seams(path, [*WRITTEN, ("IMG_4", "no polygon")], SRS)
    assert len(read(path).cells) == 3
    assert [p.name for p in path.parent.iterdir()] == [SEAMS_FILE]


def test_a_folder_that_is_not_there_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"seams\.gpkg: cannot be used .*; check the permission"):
        write_seams(tmp_path / "none" / SEAMS_FILE, WRITTEN, SRS)


# What counts as an edit


@pytest.mark.parametrize(
    "sql",
    [
        "UPDATE seams SET photo = 'IMG_1' WHERE fid = 2",
        "UPDATE seams SET priority = 3 WHERE fid = 2",
        "DELETE FROM seams WHERE fid = 2",
    ],
)
def test_an_edit_is_noticed(path: Path, sql: str) -> None:
    edit(path, sql)
    assert read(path).edited


def test_a_moved_border_is_noticed_and_kept(path: Path) -> None:
    redraw(path, "IMG_1", square(0.0, 0.0, width=12.0))
    redraw(path, "IMG_2", square(12.0, 0.0, width=8.0))
    seams = read(path)
    assert seams.edited
    assert seams.notes == ()
    assert areas(seams) == pytest.approx({"IMG_1": 120.0, "IMG_2": 80.0, "IMG_3": 100.0})


def test_other_columns_and_a_file_saved_by_another_library_are_no_edit(path: Path) -> None:
    edit(path, "ALTER TABLE seams ADD COLUMN remark TEXT")
    edit(path, "UPDATE seams SET remark = 'looked at'")
    frame = pyogrio.read_dataframe(path, layer="seams")
    pyogrio.write_dataframe(frame, path, layer="seams", driver="GPKG")
    assert not read(path).edited


# What is mended


def test_of_two_that_overlap_the_later_drawn_has_the_ground(path: Path) -> None:
    redraw(path, "IMG_2", square(8.0, 0.0, width=14.0))
    seams = read(path)
    # 2 m of IMG_1 go to IMG_2, and IMG_3, which was drawn after it, keeps its own
    assert areas(seams) == pytest.approx({"IMG_1": 80.0, "IMG_2": 120.0, "IMG_3": 100.0})
    (note,) = seams.notes
    assert "2 overlaps, 40.00 m2" in note
    assert "'IMG_2' over 'IMG_1', 20.00 m2" in note or "'IMG_3' over 'IMG_2'" in note


def test_of_two_that_overlap_the_higher_priority_has_the_ground(path: Path) -> None:
    redraw(path, "IMG_2", square(8.0, 0.0, width=14.0))
    edit(path, "UPDATE seams SET priority = 1 WHERE photo = 'IMG_2'")
    assert areas(read(path)) == pytest.approx({"IMG_1": 80.0, "IMG_2": 140.0, "IMG_3": 80.0})


def test_a_polygon_drawn_over_others_takes_their_ground(path: Path) -> None:
    drawn = shapely.Point(X + 10.0, Y + 5.0).buffer(3.0)
    edit(path, "INSERT INTO seams (geom, photo) VALUES (?, 'IMG_3')", blob(drawn))
    found = areas(read(path))
    assert found["IMG_3"] == pytest.approx(100.0 + drawn.area, abs=1e-3)
    assert sum(found.values()) == pytest.approx(300.0, abs=1e-3)


def test_a_photo_covered_by_others_is_told(path: Path) -> None:
    edit(path, "INSERT INTO seams (geom, photo) VALUES (?, 'IMG_3')", blob(square(-1, -1, 11, 12)))
    seams = read(path)
    assert "IMG_1" not in areas(seams)
    assert any("'IMG_1' is covered by others" in note for note in seams.notes)


def test_gaps_are_filled_as_they_were_computed(path: Path) -> None:
    redraw(path, "IMG_1", square(0.0, 0.0, width=7.0))
    edit(path, "DELETE FROM seams WHERE photo = 'IMG_3'")
    seams = read(path)
    assert areas(seams) == pytest.approx(dict.fromkeys(PHOTOS, 100.0))
    (note,) = seams.notes
    assert "gaps of 130.00 m2 are filled as they were computed (from 'IMG_1', 'IMG_3')" in note


def test_gaps_of_photos_that_are_gone_stay(path: Path) -> None:
    edit(path, "DELETE FROM seams WHERE photo = 'IMG_3'")
    assert areas(read(path, PHOTOS[:2])) == {"IMG_1": 100.0, "IMG_2": 100.0}


def test_photos_that_are_gone_are_left_out_and_told(path: Path) -> None:
    seams = read(path, PHOTOS[:2])
    assert not seams.edited
    assert areas(seams) == {"IMG_1": 100.0, "IMG_2": 100.0}
    assert "photos no longer in the mosaic ('IMG_3')" in seams.notes[0]


def test_cracks_between_borders_drawn_by_hand_are_closed(path: Path) -> None:
    ring = [(X, Y), (X + 10, Y), (X + 9.9994, Y + 5), (X + 10, Y + 10), (X, Y + 10)]
    redraw(path, "IMG_1", shapely.MultiPolygon([shapely.Polygon(ring)]))
    seams = read(path)
    total = shapely.union_all([area for _, area in seams.cells])
    assert total.area == pytest.approx(300.0, abs=1e-6)
    assert seams.notes == ()
    areas(seams)


def test_a_border_that_crosses_itself_is_mended_and_told(path: Path) -> None:
    bow = [(X, Y), (X + 10, Y + 10), (X + 10, Y), (X, Y + 10)]
    redraw(path, "IMG_1", shapely.MultiPolygon([shapely.Polygon(bow)]))
    seams = read(path)
    assert areas(seams) == pytest.approx(dict.fromkeys(PHOTOS, 100.0))
    assert "feature 1 ('IMG_1') was no valid polygon (Self-intersection" in seams.notes[0]
    assert "gaps of 50.00 m2" in seams.notes[1]


def test_a_feature_without_a_polygon_is_left_out_and_told(path: Path) -> None:
    edit(path, "INSERT INTO seams (photo) VALUES ('IMG_1')")
    seams = read(path)
    assert len(seams.cells) == 3
    assert "feature 4 has no polygon and was left out" in seams.notes[0]


def test_areas_are_told_in_square_metres(tmp_path: Path) -> None:
    feet = CRS.from_epsg(6549)
    path = tmp_path / SEAMS_FILE
    write_seams(path, WRITTEN, Srs(name=feet.name, wkt=feet.to_wkt("WKT1_GDAL"), code=6549))
    edit(path, "DELETE FROM seams WHERE photo = 'IMG_3'")
    # 100 square US survey feet
    assert "gaps of 9.29 m2" in read(path, wkt=feet.to_wkt("WKT1_GDAL")).notes[0]


# CRS


def test_a_layer_in_another_crs_is_transformed(path: Path) -> None:
    frame = pyogrio.read_dataframe(path, layer="seams").to_crs(32616)
    path.unlink()
    pyogrio.write_dataframe(frame, path, layer="seams", driver="GPKG")
    seams = read(path)
    assert seams.edited
    assert "transformed from 'WGS 84 / UTM zone 16N' to 'WGS 84 / UTM zone 17N'" in seams.notes[0]
    for (_, area), (_, want) in zip(seams.cells, WRITTEN, strict=True):
        # m; what PROJ loses there and back
        assert shapely.hausdorff_distance(area, want) < 1e-4


def test_the_project_in_another_crs_is_no_edit(path: Path) -> None:
    seams = read(path, wkt=CRS.from_epsg(6549).to_wkt())
    assert not seams.edited
    x, _ = np.mean([area.centroid.coords[0] for _, area in seams.cells], axis=0)
    # US survey feet: not those of UTM
    assert x > 1e6


@pytest.mark.parametrize("text", ["EPSG:2193", "EPSG:6549", "+proj=tmerc +lon_0=-83 +units=us-ft"])
def test_a_crs_is_known_again(tmp_path: Path, text: str) -> None:
    crs = CRS.from_user_input(text)
    srs = Srs(name=crs.name, wkt=crs.to_wkt("WKT1_GDAL"), code=crs.to_epsg())
    write_seams(tmp_path / SEAMS_FILE, WRITTEN, srs)
    seams = read(tmp_path / SEAMS_FILE, wkt=crs.to_wkt())
    assert (seams.edited, seams.notes) == (False, ())


def test_a_layer_without_crs_is_refused(path: Path) -> None:
    edit(path, "UPDATE gpkg_geometry_columns SET srs_id = -1")
    with pytest.raises(CrsError, match="layer seams has no CRS; state it in the GIS"):
        read(path)


# What is refused


def refused(path: Path) -> str:
    with pytest.raises(InputError) as caught:
        read(path)
    text = str(caught.value)
    assert "\n" not in text
    assert str(path) in text
    return text


def make_text(path: Path) -> None:
    path.write_text("no database " * 100)


BAD: list[tuple[Callable[[Path], Any], str]] = [
    (Path.unlink, "there is no such file; run the mosaic"),
    (make_text, "cannot be used (file is not a database)"),
    (
        lambda p: edit(p, "UPDATE seams SET photo = 'IMG_22' WHERE fid = 2"),
        "feature 2: 'IMG_22' is no photo of the mosaic; did you mean IMG_2",
    ),
    (lambda p: edit(p, "UPDATE seams SET photo = 'zzz'"), "feature 1: 'zzz' is no photo"),
    (lambda p: edit(p, "UPDATE seams SET photo = NULL WHERE fid = 3"), "feature 3: names no photo"),
    (lambda p: edit(p, "UPDATE seams SET priority = 'top'"), "feature 1: priority 'top' is no num"),
    (lambda p: edit(p, "UPDATE seams SET geom = x'4750'"), "feature 1: its geometry cannot be r"),
    (lambda p: redraw(p, "IMG_2", shapely.Point(0, 0)), "feature 2: is a Point, not a polygon"),
    (lambda p: edit(p, "DELETE FROM seams"), "seams: has no polygon; draw some"),
    (
        lambda p: edit(p, "ALTER TABLE seams RENAME COLUMN photo TO picture"),
        "seams: has no column 'photo'; add it",
    ),
    (
        lambda p: edit(p, "UPDATE gpkg_geometry_columns SET table_name = 'lines'"),
        "has no layer 'seams' (layers: lines); name the layer so",
    ),
    (lambda p: edit(p, "DROP TABLE gpkg_geometry_columns"), "is no GeoPackage; delete the file"),
]


@pytest.mark.parametrize(("harm", "words"), BAD, ids=[words[:30] for _, words in BAD])
def test_what_cannot_be_used_is_one_line(
    path: Path, harm: Callable[[Path], Any], words: str
) -> None:
    harm(path)
    assert words in refused(path)


# Another program has it open


@pytest.fixture
def opened(path: Path) -> Iterator[sqlite3.Connection]:
    """Open the layer as QGIS does: in WAL mode."""
    with closing(sqlite3.connect(path, isolation_level=None)) as connection:
        assert connection.execute("PRAGMA journal_mode = WAL").fetchone() == ("wal",)
        connection.execute("SELECT count(*) FROM seams").fetchone()
        yield connection


def test_a_layer_open_in_a_gis_is_read_as_saved(path: Path, opened: sqlite3.Connection) -> None:
    opened.execute("UPDATE seams SET photo = 'IMG_1' WHERE fid = 2")
    opened.execute("BEGIN IMMEDIATE")
    opened.execute("UPDATE seams SET photo = 'IMG_3'")
    assert areas(read(path)) == {"IMG_1": 200.0, "IMG_3": 100.0}
    opened.execute("ROLLBACK")


def test_a_layer_open_in_a_gis_is_not_written_over(path: Path, opened: sqlite3.Connection) -> None:
    opened.execute("UPDATE seams SET priority = 5 WHERE fid = 2")
    with pytest.raises(InputError, match="it is open in another program, such as QGIS"):
        write_seams(path, WRITTEN[:1], SRS)
    opened.close()
    assert read(path).edited
    write_seams(path, WRITTEN[:1], SRS)
    assert len(read(path).cells) == 1
    assert [p.name for p in path.parent.iterdir()] == [SEAMS_FILE]


def test_a_locked_layer_is_one_line(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("georef_gis.project.seam_layer.BUSY_TIMEOUT", 0.01)
    with closing(sqlite3.connect(path, isolation_level=None)) as connection:
        connection.execute("BEGIN EXCLUSIVE")
        assert "save or close it there" in refused(path)
