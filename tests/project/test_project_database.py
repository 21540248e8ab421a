"""The project database as other programs see it, and as we write and read it."""

import sqlite3
from pathlib import Path

import geopandas
import numpy as np
import pyogrio
import pyproj
import pytest
import shapely

from georef_gis.errors import InputError
from georef_gis.project import Database, Srs
from georef_gis.project.geometry import from_blob, point_wkb, polygon_wkb, to_blob
from georef_gis.project.schema import TABLES

UTM = Srs(name="WGS 84 / UTM zone 17N", code=32617, wkt=pyproj.CRS(32617).to_wkt("WKT1_GDAL"))
OWN_WKT = pyproj.CRS("+proj=tmerc +lat_0=40 +lon_0=-82.9 +k=1.00004 +x_0=1e5 +ellps=GRS80").to_wkt()
PLACES = ((500_000.25, 4_400_000.5, 231.0), (500_100.0, 4_400_050.0, 233.5))


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "georef.gpkg"


def fill(path: Path, srs: Srs = UTM) -> None:
    with Database(path) as database:
        database.set_crs(srs)
        database.replace_rows(
            "photo",
            [
                {"photo_id": f"P{n}", "name": f"P{n}.JPG", "status": "ok", "doubts": ["dark"],
                 "geom": point_wkb(*place)}
                for n, place in enumerate(PLACES)
            ]
            + [{"photo_id": "P9", "name": "P9.JPG", "status": "refused"}],
        )  # fmt: skip
        ring = [(x, y) for x, y, _ in PLACES] + [(500_000.0, 4_400_100.0)]
        database.replace_rows(
            "footprint", [{"photo_id": "P0", "gsd_m": 0.02, "geom": polygon_wkb(ring)}]
        )


@pytest.mark.parametrize(
    ("srs", "code"), [(UTM, 32617), (Srs(name="Low distortion", wkt=OWN_WKT), None)]
)
def test_layers_open_in_gdal_with_place_and_crs(path: Path, srs: Srs, code: int | None) -> None:
    fill(path, srs)
    photos = geopandas.read_file(path, layer="photo")
    known = photos[photos.geometry.notna()]
    assert known.crs.to_epsg() == code
    assert known.crs == pyproj.CRS(srs.wkt)
    assert np.array_equal(shapely.get_coordinates(known.geometry, include_z=True), PLACES)
    assert list(photos["status"]) == ["ok", "ok", "refused"]
    footprint = geopandas.read_file(path, layer="footprint").geometry[0]
    assert footprint.is_valid
    assert footprint.area > 0


def test_all_tables_are_layers_of_a_geopackage_1_3(path: Path) -> None:
    fill(path)
    assert {name for name, _ in pyogrio.list_layers(path)} == set(TABLES)
    assert pyogrio.read_info(path, layer="photo")["total_bounds"] == pytest.approx(
        (500_000.25, 4_400_000.5, 500_100.0, 4_400_050.0), abs=0
    )
    with sqlite3.connect(path) as connection:
        assert connection.execute("PRAGMA application_id").fetchone()[0] == 0x47504B47
        assert connection.execute("PRAGMA user_version").fetchone()[0] == 10300
        assert connection.execute("PRAGMA journal_mode").fetchone()[0] == "delete"
        assert connection.execute("PRAGMA integrity_check").fetchone()[0] == "ok"
        assert connection.execute("PRAGMA foreign_key_check").fetchall() == []
    connection.close()


def test_rows_come_back_as_written(path: Path) -> None:
    fill(path)
    row = {
        "photo_id": "P0", "kind": "tags", "run_id": 4, "x_enu": 1 / 3, "sigma_h_m": np.float64(0.7),
        "rotation": np.eye(3).ravel().tolist(), "covariance": [1e-7 / 3] * 21,
        "geom": shapely.to_wkb(shapely.Point(1, 2, 3)), "yaw_deg": float("nan"),
    }  # fmt: skip
    with Database(path) as database:
        database.add_rows("pose", [row])
        (back,) = database.rows("pose", {"photo_id": "P0"})
    assert back["x_enu"] == 1 / 3
    assert back["covariance"] == row["covariance"]
    assert shapely.from_wkb(back["geom"]) == shapely.Point(1, 2, 3)
    assert back["sigma_h_m"] == 0.7
    assert back["yaw_deg"] is None
    assert back["pitch_deg"] is None


def test_same_key_takes_the_place_and_others_stay(path: Path) -> None:
    with Database(path) as database:
        poses = [{"photo_id": "P0", "kind": kind, "x_enu": 1.0} for kind in ("tags", "adjusted")]
        database.replace_rows("pose", [{**pose, "y_enu": 5.0} for pose in poses])
        database.replace_rows("pose", poses[1:], where={"kind": "adjusted"})
        database.add_rows("pose", [{**poses[0], "x_enu": 2.0}])
        rows = database.rows("pose", order="kind")
    assert [(row["kind"], row["x_enu"], row["y_enu"]) for row in rows] == [
        ("adjusted", 1.0, None),
        ("tags", 2.0, None),
    ]


def test_transaction_is_all_or_nothing(path: Path) -> None:
    fill(path)
    with Database(path) as database:
        rows = ({"photo_id": f"Q{n}", "width": 1 // (2 - n)} for n in range(5))
        with pytest.raises(ZeroDivisionError):
            database.replace_rows("photo", rows)
        assert database.count("photo") == 3
        with pytest.raises(ZeroDivisionError):
            _delete_and_fail(database)
        assert database.count("photo") == 3
        assert database.meta("epoch") is None


def _delete_and_fail(database: Database) -> None:
    with database.transaction():
        database.delete_rows("photo")
        database.set_meta(epoch=1 / database.count("photo"))


def test_another_crs_empties_the_feature_layers(path: Path) -> None:
    fill(path)
    with Database(path) as database:
        database.set_meta(origin=[40.0, -82.9, 230.5])
        assert database.set_crs(UTM) == 32617
        assert database.count("photo") == 3
        own = Srs(name="Low distortion", wkt=OWN_WKT)
        assert database.set_crs(own) == 300_000
        assert database.set_crs(own) == 300_000
        assert database.count("photo") == 0
        assert database.meta("origin") == [40.0, -82.9, 230.5]
        assert database.meta("crs_wkt") == OWN_WKT


def test_unknown_column_or_geometry_is_our_bug(path: Path) -> None:
    with Database(path) as database:
        with pytest.raises(ValueError, match="no column 'nmae'"):
            database.add_rows("photo", [{"photo_id": "P0", "nmae": ""}])
        with pytest.raises(ValueError, match="holds POLYGON, not POINT"):
            database.add_rows("footprint", [{"photo_id": "P0", "geom": point_wkb(1, 2)}])
        with pytest.raises(ValueError, match="no table 'photos'"):
            database.rows("photos")


def test_newer_foreign_or_damaged_file_is_refused(path: Path, tmp_path: Path) -> None:
    with Database(path) as database:
        database.set_meta(schema=99)
    with pytest.raises(InputError, match=r"georef\.gpkg: schema 99 is newer than 1"):
        Database(path)
    geopandas.GeoDataFrame(geometry=[shapely.Point(1, 2)], crs=32617).to_file(
        tmp_path / "other.gpkg"
    )
    with pytest.raises(InputError, match="is no georef project database"):
        Database(tmp_path / "other.gpkg")
    (tmp_path / "bad.gpkg").write_bytes(b"no database at all" * 100)
    with pytest.raises(InputError, match="cannot be used"):
        Database(tmp_path / "bad.gpkg")
    with pytest.raises(InputError, match="no project database yet"):
        Database(tmp_path / "none.gpkg", read_only=True)


def test_database_left_in_wal_mode_becomes_one_file_again(path: Path) -> None:
    fill(path)
    with sqlite3.connect(path) as connection:
        connection.execute("PRAGMA journal_mode = WAL")
        with Database(path) as database:  # in use: it stays, and works
            database.set_meta(epoch=1.0)
    connection.close()
    with Database(path) as database:
        assert database.meta("epoch") == 1.0
    assert [file.name for file in path.parent.iterdir()] == ["georef.gpkg"]


def test_read_only_database_cannot_be_changed(path: Path) -> None:
    fill(path)
    with Database(path, read_only=True) as database:
        with pytest.raises(InputError, match="readonly"):
            database.delete_rows("photo")
        assert database.count("photo") == 3


@pytest.mark.parametrize(
    "shape",
    [
        shapely.Point(1, 2),
        shapely.LineString([(0, 0, 5), (3, -4, 6)]),
        shapely.Point(0, 0).buffer(5).difference(shapely.Point(0, 0).buffer(1)),
        shapely.MultiPolygon([shapely.box(0, 0, 1, 2), shapely.box(5, 5, 6, 8)]),
        shapely.GeometryCollection([shapely.Point(1, 1), shapely.LineString([(0, 9), (3, 3)])]),
        shapely.Polygon(),
        shapely.Point(),
    ],
    ids=lambda shape: f"{shape.geom_type}{'-empty' * shape.is_empty}",
)
@pytest.mark.parametrize("flavor", ["iso", "extended"])
def test_blob_has_the_bounds_of_its_geometry(shape: shapely.Geometry, flavor: str) -> None:
    wkb = shapely.to_wkb(shape, flavor=flavor)
    blob, bounds = to_blob(wkb, 32617)
    assert from_blob(blob) == wkb
    assert bounds == (None if shape.is_empty else shape.bounds)
