"""Layers that a GIS indexed, dropped or wrote anew: put right, with nothing lost."""

from __future__ import annotations

from pathlib import Path

import geopandas
import pytest
from asset_cases import QUALITY, E, N, cone, edge, sql, store_at

from georef_gis.errors import InputError
from georef_gis.measure.assets.file import ASSETS_FILE
from georef_gis.measure.assets.store import AssetStore, Change


@pytest.fixture
def store(tmp_path: Path) -> AssetStore:
    return store_at(tmp_path)


def write_anew(folder: Path, columns: list[str] | None = None) -> None:
    """Overwrite the layer of points as `ogr2ogr -overwrite` does, with a spatial index."""
    path = folder / ASSETS_FILE
    frame = geopandas.read_file(path, layer="asset_points")
    frame[columns or list(frame)].to_file(path, layer="asset_points", driver="GPKG")


def index_of(folder: Path) -> list[tuple[int, float, float]]:
    return sql(folder, "SELECT id, minx, maxy FROM rtree_asset_points_geom ORDER BY id")


def test_layer_with_a_spatial_index_takes_edits_and_keeps_its_index_true(
    store: AssetStore, tmp_path: Path
) -> None:
    asset = store.add(cone(name="C1", quality=QUALITY))
    write_anew(tmp_path)
    (found,) = store.assets()
    assert (found.id, found.quality) == (asset.id, QUALITY)
    store.change(asset.id, found.revision, Change(vertices=((E + 3.0, N + 4.0, 270.0),)))
    other = store.add(cone(10.0, 20.0))
    # the index holds bounds as 32-bit floats, rounded outwards
    near = pytest.approx
    assert index_of(tmp_path) == [
        (1, near(E + 3, abs=0.5), near(N + 4, abs=0.5)),
        (2, near(E + 10, abs=0.5), near(N + 20, abs=0.5)),
    ]
    store.delete(other.id, other.revision)
    assert [row[0] for row in index_of(tmp_path)] == [1]


def test_layer_written_anew_without_our_columns_can_be_taken_back(
    store: AssetStore, tmp_path: Path
) -> None:
    asset = store.add(cone(name="C1", quality=QUALITY))
    write_anew(tmp_path, ["class", "name", "geometry"])
    (found,) = store.assets()
    assert (found.kind, found.name, found.quality) == ("cone", "C1", None)
    store.undo()
    (back,) = store.assets()
    assert (back.id, back.quality) == (asset.id, QUALITY)
    # nothing more is found each time that somebody looks
    assert len(store.steps()) == len(store_at(tmp_path).steps())


@pytest.mark.parametrize("layer", ["asset_lines", "asset_ellipses"])
def test_dropped_layer_is_made_again_and_its_assets_come_back(tmp_path: Path, layer: str) -> None:
    first = store_at(tmp_path)
    line = first.add(edge((0, 0), (5, 5), name="E1", quality=QUALITY))
    point = first.add(cone(name="C1", quality=QUALITY))
    first.close()
    sql(tmp_path, f"DROP TABLE {layer}")
    store = store_at(tmp_path)
    if layer == "asset_lines":
        assert [asset.id for asset in store.assets()] == [point.id]
        store.undo()
    assert {asset.id for asset in store.assets()} == {line.id, point.id}
    store.change(point.id, store.get(point.id).revision, Change(name="C2"))
    assert len(sql(tmp_path, "SELECT 1 FROM asset_ellipses")) == 1
    again = geopandas.read_file(tmp_path / ASSETS_FILE, layer=layer)
    assert again.crs.to_epsg() == 32617


def test_column_put_back_is_empty_until_the_edit_is_undone(
    store: AssetStore, tmp_path: Path
) -> None:
    asset = store.add(cone(note="by the gate", quality=QUALITY))
    sql(tmp_path, "ALTER TABLE asset_points DROP COLUMN note")
    assert store.get(asset.id).note == ""
    store.undo()
    assert store.get(asset.id).note == "by the gate"


def test_layer_without_its_geometry_column_is_refused_with_the_cure(tmp_path: Path) -> None:
    store_at(tmp_path).add(cone())
    sql(tmp_path, "ALTER TABLE asset_points RENAME COLUMN geom TO shape")
    with pytest.raises(InputError, match="has no column geom: another program wrote it anew"):
        store_at(tmp_path).assets()


def test_history_that_another_program_spoilt_is_refused_and_the_layers_are_read(
    store: AssetStore, tmp_path: Path
) -> None:
    store.add(cone(name="C1"))
    sql(tmp_path, "UPDATE asset_history SET before = 'x', after = '[1]'")
    sql(tmp_path, "UPDATE asset_known SET content = 'x'")
    assert [asset.name for asset in store.assets()] == ["C1"]
    with pytest.raises(InputError, match="put a copy of the file in its place"):
        store.undo()


def test_editing_one_asset_does_not_read_all_ellipses(store: AssetStore, tmp_path: Path) -> None:
    # 10 000 assets took minutes
    store.add(cone())
    (plan,) = sql(
        tmp_path, "EXPLAIN QUERY PLAN DELETE FROM asset_ellipses WHERE asset_id = ?", "some"
    )
    assert "USING INDEX" in plan[-1]
