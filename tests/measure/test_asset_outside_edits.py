"""What a GIS changes in the layers while nobody looks: found, kept, and undone like any edit."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

import geopandas
import pyogrio
import pytest
import shapely
from asset_cases import QUALITY, UTM, E, N, cone, edge, sql, store_at

from georef_gis.measure.assets.asset import StaleAssetError
from georef_gis.measure.assets.file import ASSETS_FILE
from georef_gis.measure.assets.ledger import OUTSIDE
from georef_gis.measure.assets.store import AssetStore, Change
from georef_gis.project.geometry import point_wkb, to_blob


@pytest.fixture
def store(tmp_path: Path) -> AssetStore:
    return store_at(tmp_path)


def test_changed_attribute_is_taken_into_the_history(store: AssetStore, tmp_path: Path) -> None:
    asset = store.add(cone(name="C1", quality=QUALITY))
    sql(tmp_path, "UPDATE asset_points SET name = 'by hand', note = 'in QGIS'")
    found = store.get(asset.id)
    assert (found.name, found.note, found.revision) == ("by hand", "in QGIS", 2)
    assert found.quality == QUALITY
    assert store.steps()[0].title == OUTSIDE
    store.undo()
    assert store.get(asset.id).name == "C1"
    store.redo()
    assert store.get(asset.id).name == "by hand"


def test_form_opened_before_the_gis_edit_is_stale(store: AssetStore, tmp_path: Path) -> None:
    asset = store.add(cone(name="C1"))
    sql(tmp_path, "UPDATE asset_points SET name = 'by hand'")
    with pytest.raises(StaleAssetError) as refused:
        store.change(asset.id, asset.revision, Change(name="from the page"))
    assert refused.value.current is not None
    assert refused.value.current.name == "by hand"
    # what was found outside is kept though the change was refused
    assert store.steps()[0].title == OUTSIDE
    assert store.get(asset.id).revision == refused.value.current.revision


def test_feature_drawn_by_ogr_becomes_an_asset(store: AssetStore, tmp_path: Path) -> None:
    store.add(cone())
    drawn = geopandas.GeoDataFrame(
        {"class": ["drum"], "name": ["drawn"]}, geometry=[shapely.Point(E + 7, N)], crs=UTM
    )
    pyogrio.write_dataframe(drawn, tmp_path / ASSETS_FILE, layer="asset_points", append=True)
    found = next(a for a in store.assets() if a.name == "drawn")
    assert found.kind == "drum"
    assert found.vertices[0][:2] == (E + 7, N)
    assert found.quality is None
    assert len(found.id) == 36
    assert found.created
    changed = store.change(found.id, found.revision, Change(note="seen"))
    assert changed.revision == found.revision + 1
    store.undo()
    store.undo()
    assert [a.name for a in store.assets()] == [""]


def test_moved_feature_loses_the_accuracy_of_where_it_was(
    store: AssetStore, tmp_path: Path
) -> None:
    asset = store.add(cone(quality=QUALITY))
    blob, _ = to_blob(point_wkb(E + 3, N, 270.0), 32617)
    sql(tmp_path, "UPDATE asset_points SET geom = ?", blob)
    found = store.get(asset.id)
    assert found.vertices[0][0] == E + 3
    assert found.quality is not None
    assert found.quality.method == "edited"
    assert found.quality.sigma_e is None
    assert sql(tmp_path, "SELECT count(*) FROM asset_ellipses") == [(0,)]
    store.undo()
    assert store.get(asset.id).quality == QUALITY
    assert sql(tmp_path, "SELECT count(*) FROM asset_ellipses") == [(1,)]


def test_geometry_written_anew_without_moving_keeps_its_accuracy(
    store: AssetStore, tmp_path: Path
) -> None:
    asset = store.add(cone(quality=QUALITY))
    blob, _ = to_blob(point_wkb(E, N), 32617)
    sql(tmp_path, "UPDATE asset_points SET geom = ?", blob)
    assert store.get(asset.id).quality == QUALITY


def test_deleted_feature_can_be_brought_back(store: AssetStore, tmp_path: Path) -> None:
    asset = store.add(cone(name="C1", quality=QUALITY))
    line = store.add(edge((0, 0), (9, 9), name="L1"))
    sql(tmp_path, "DELETE FROM asset_points")
    assert [a.name for a in store.assets()] == ["L1"]
    store.undo()
    assert store.get(asset.id).quality == QUALITY
    assert store.get(line.id).revision == 1


def test_copied_feature_becomes_an_asset_of_its_own(store: AssetStore, tmp_path: Path) -> None:
    asset = store.add(cone(name="C1", attributes={"line": "T1"}))
    names = [r[1] for r in sql(tmp_path, "PRAGMA table_info(asset_points)") if r[1] != "fid"]
    columns = ", ".join(f'"{name}"' for name in names)
    sql(tmp_path, f"INSERT INTO asset_points ({columns}) SELECT {columns} FROM asset_points")
    found = store.assets()
    assert len({a.id for a in found}) == 2
    assert [a.attributes for a in found] == [{"line": "T1"}] * 2
    assert store.get(asset.id).revision == 1


def test_layer_written_anew_with_other_fids_keeps_its_assets(
    store: AssetStore, tmp_path: Path
) -> None:
    asset = store.add(cone(name="C1"))
    sql(tmp_path, "UPDATE asset_points SET fid = fid + 100")
    assert store.get(asset.id).name == "C1"
    assert store.change(asset.id, store.get(asset.id).revision, Change(name="C2")).name == "C2"
    assert len(store.assets()) == 1


def test_what_does_not_fit_is_kept_and_told(store: AssetStore, tmp_path: Path) -> None:
    store.add(cone(name="C1", attributes={"line": "T1"}))
    sql(tmp_path, "UPDATE asset_points SET class = 'spaceship', attributes = 'T1 please', "
        "sigma_e = -1, pixels = '[1]', geom = NULL")  # fmt: skip
    (found,) = store.assets()
    assert len(found.problems) == 5
    assert all("\n" not in problem for problem in found.problems)
    assert found.vertices == ()
    assert sql(tmp_path, "SELECT attributes FROM asset_points") == [("T1 please",)]
    store.undo()
    assert store.assets()[0].problems == ()


def test_column_added_in_the_gis_is_kept_through_delete_and_undo(
    store: AssetStore, tmp_path: Path
) -> None:
    asset = store.add(cone())
    sql(tmp_path, 'ALTER TABLE asset_points ADD COLUMN "my ""own""" TEXT')
    sql(tmp_path, 'UPDATE asset_points SET "my ""own""" = \'kept\'')
    changed = store.change(asset.id, store.get(asset.id).revision, Change(note="x"))
    store.delete(asset.id, changed.revision)
    store.undo()
    assert sql(tmp_path, 'SELECT "my ""own""" FROM asset_points') == [("kept",)]


def test_column_removed_in_the_gis_does_not_end_the_work(store: AssetStore, tmp_path: Path) -> None:
    asset = store.add(cone(note="n"))
    sql(tmp_path, "ALTER TABLE asset_points DROP COLUMN note")
    revision = store.get(asset.id).revision
    assert store.change(asset.id, revision, Change(name="C1")).name == "C1"
    store.undo()
    assert store.get(asset.id).name == ""


def test_nothing_is_taken_in_when_only_this_store_wrote(store: AssetStore) -> None:
    asset = store.add(cone())
    for name in "abc":
        asset = store.change(asset.id, asset.revision, Change(name=name))
    assert [step.title for step in store.steps()] == ["change cone"] * 3 + ["add cone"]


def test_second_store_does_not_take_the_first_one_for_an_outsider(tmp_path: Path) -> None:
    first, second = store_at(tmp_path), store_at(tmp_path)
    for k in range(3):
        first.add(cone(k))
        second.add(cone(0, k + 1))
    assert len(first.assets()) == len(second.assets()) == 6
    assert {step.title for step in first.steps()} == {"add cone"}


def test_gis_that_keeps_the_file_in_wal_mode_does_not_mind(tmp_path: Path) -> None:
    # QGIS opens GeoPackages that way
    store_at(tmp_path).add(cone(name="C1"))
    with closing(sqlite3.connect(tmp_path / ASSETS_FILE)) as gis:
        gis.execute("PRAGMA journal_mode = WAL")
        assert gis.execute("SELECT name FROM asset_points").fetchall() == [("C1",)]
        store = store_at(tmp_path)
        asset = store.add(cone(1, name="C2"))
        assert len(gis.execute("SELECT name FROM asset_points").fetchall()) == 2
        with gis:
            gis.execute("UPDATE asset_points SET name = 'gis' WHERE name = 'C2'")
        assert store.get(asset.id).name == "gis"
        store.close()
    assert len(store_at(tmp_path).assets()) == 2
    assert not list(tmp_path.glob("*-wal"))
