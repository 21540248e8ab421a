"""The store of assets: edits, their history, and the layers as other programs see them."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import pyogrio
import pytest
import shapely
from asset_cases import QUALITY, E, N, cone, edge, sql, store_at

from georef_gis.errors import InputError
from georef_gis.geodesy import CRS
from georef_gis.measure.assets.asset import Click, Draft, Quality, StaleAssetError
from georef_gis.measure.assets.domain import CLASSES_FILE
from georef_gis.measure.assets.file import ASSETS_FILE
from georef_gis.measure.assets.store import AssetStore, Change
from georef_gis.project import Srs
from georef_gis.project.geometry import from_blob

NAMES = [
    "<script>alert(1)</script>",
    "'; DROP TABLE asset_points; --",
    '"quoted" \\ back\\slash',
    "𝕌🚧👷🏽‍♀️ Ünï",
    "x" * 300,
    "line\nbreak\tand tab",
    "{{7*7}} %s ${x}",
]


@pytest.fixture
def store(tmp_path: Path) -> AssetStore:
    return store_at(tmp_path)


def test_asset_comes_back_as_it_was_stored(store: AssetStore) -> None:
    draft = cone(1.5, 2.5, name="C1", note="tilted", attributes={"line": "T1"}, quality=QUALITY)
    added = store.add(draft)
    assert added == store.get(added.id) == store.assets()[0]
    assert added.vertices == draft.vertices
    assert added.quality == QUALITY
    assert (added.name, added.note, added.attributes) == ("C1", "tilted", {"line": "T1"})
    assert added.revision == 1
    assert added.created == added.changed
    assert added.created.endswith("Z")
    assert added.problems == ()


def test_layers_open_in_ogr_with_the_promised_columns(store: AssetStore, tmp_path: Path) -> None:
    store.add(cone(quality=QUALITY, attributes={"line": "T1"}))
    store.add(edge((0, 0), (30, 4)))
    store.add(Draft(kind="work_area", vertices=((E, N), (E + 9, N), (E, N + 9), (E, N))))
    layers = dict(pyogrio.list_layers(tmp_path / ASSETS_FILE))
    assert layers["asset_points"] == "Point Z"
    assert layers["asset_lines"] == "LineString Z"
    assert layers["asset_polygons"] == "Polygon Z"
    assert layers["asset_ellipses"] == "Polygon"
    read = pyogrio.read_dataframe(tmp_path / ASSETS_FILE, layer="asset_points")
    assert read.crs.to_epsg() == 32617
    assert {
        "class", "attributes", "note", "sigma_e", "sigma_n", "sigma_u", "corr_en", "semi_major",
        "semi_minor", "azimuth", "conf", "dof", "n_rays", "method", "photo_ids", "pixels",
        "created", "changed",
    } <= set(read.columns)  # fmt: skip
    assert read.geometry[0].equals(shapely.Point(E, N))
    assert read.geometry[0].z == 270.0
    assert json.loads(read.photo_ids[0]) == ["flight/IMG_1", "IMG_2"]
    assert json.loads(read.pixels[0])[0][:3] == ["flight/IMG_1", 10.5, 20.25]
    area = pyogrio.read_dataframe(tmp_path / ASSETS_FILE, layer="asset_polygons")
    assert area.geometry[0].area == pytest.approx(40.5)


def test_geometries_are_iso_wkb_as_geopackage_asks(store: AssetStore, tmp_path: Path) -> None:
    # other readers take the flags of EWKB for an unknown type
    store.add(cone())
    store.add(edge((0, 0), (30, 4)))
    for layer, code in (("asset_points", 1001), ("asset_lines", 1002)):
        ((blob,),) = sql(tmp_path, f"SELECT geom FROM {layer}")
        assert struct.unpack("<I", from_blob(blob)[1:5]) == (code,)


def test_ellipse_is_drawn_with_its_axes_at_its_azimuth(tmp_path: Path) -> None:
    # in a CRS in feet: the axes stay m
    foot = 1200.0 / 3937.0
    crs = CRS.from_epsg(6549)
    srs = Srs(name=crs.name, wkt=crs.to_wkt("WKT1_GDAL"), code=6549)
    store = AssetStore(tmp_path / ASSETS_FILE, store_at(tmp_path).domain, srs, unit=foot)
    store.add(cone(quality=QUALITY))
    ring = pyogrio.read_dataframe(tmp_path / ASSETS_FILE, layer="asset_ellipses").geometry[0]
    d = (shapely.get_coordinates(ring) - [E, N]) * foot
    lengths = np.hypot(*d.T)
    # 64 corners lie on the axes
    assert lengths.max() == pytest.approx(QUALITY.semi_major, abs=1e-6)
    assert lengths.min() == pytest.approx(QUALITY.semi_minor, abs=1e-6)
    e, n = d[np.argmax(lengths)]
    assert np.degrees(np.arctan2(e, n)) % 180 == pytest.approx(30.0, abs=1e-3)


def test_ellipse_follows_its_asset(store: AssetStore, tmp_path: Path) -> None:
    asset = store.add(cone(quality=QUALITY))
    moved = store.change(asset.id, 1, Change(vertices=((E + 5, N, 270.0),), quality=QUALITY))
    ring = pyogrio.read_dataframe(tmp_path / ASSETS_FILE, layer="asset_ellipses").geometry
    assert len(ring) == 1
    assert ring[0].centroid.x == pytest.approx(E + 5, abs=1e-6)
    store.delete(moved.id, moved.revision)
    assert len(pyogrio.read_dataframe(tmp_path / ASSETS_FILE, layer="asset_ellipses")) == 0
    store.undo()
    assert len(pyogrio.read_dataframe(tmp_path / ASSETS_FILE, layer="asset_ellipses")) == 1


def test_classes_are_offered_to_a_gis_as_field_domains(store: AssetStore, tmp_path: Path) -> None:
    store.add(cone())
    found = sql(
        tmp_path,
        "SELECT value, description FROM gpkg_data_column_constraints "
        "WHERE constraint_name = 'asset_points_class' AND constraint_type = 'enum'",
    )
    assert ("drum", "Drum") in found
    assert "lane_edge" not in dict(found)
    (tmp_path / CLASSES_FILE).write_text('[classes.pole]\ntitle = "Pole"\ngeometry = "point"\n')
    store_at(tmp_path).assets()
    found = sql(tmp_path, "SELECT value FROM gpkg_data_column_constraints")
    assert ("pole",) in found


@pytest.mark.parametrize("name", NAMES, ids=range(len(NAMES)))
def test_any_text_survives_as_text(store: AssetStore, tmp_path: Path, name: str) -> None:
    asset = store.add(cone(name=name, note=name, attributes={"line": name}, quality=QUALITY))
    store.change(asset.id, 1, Change(name="other"))
    store.undo()
    back = store_at(tmp_path).get(asset.id)
    assert (back.name, back.note, back.attributes) == (name, name, {"line": name})
    read = pyogrio.read_dataframe(tmp_path / ASSETS_FILE, layer="asset_points")
    assert read.name[0] == name
    assert pyogrio.read_dataframe(tmp_path / ASSETS_FILE, layer="asset_ellipses").name[0] == name


@pytest.mark.parametrize("bad", ["a\0b", "\ud800", "x" * 20_000])
def test_what_is_no_text_is_refused(store: AssetStore, bad: str) -> None:
    for draft in (cone(name=bad), cone(note=bad), cone(attributes={"line": bad})):
        with pytest.raises(InputError):
            store.add(draft)
    assert store.assets() == []


@pytest.mark.parametrize(
    ("kind", "vertices", "words"),
    [
        ("cone", ((E, N), (E, N)), "2 vertices; a point has 1"),
        ("lane_edge", ((E, N),), "a line has 2 or more"),
        ("work_area", ((E, N), (E + 1, N), (E, N)), "a polygon has 3 or more"),
        ("cone", ((float("nan"), N),), "finite numbers"),
        ("cone", ((E, N, float("inf")),), "finite numbers"),
        ("cone", ((E,),), "finite numbers"),
        ("cone", "ab", "finite numbers"),
        ("nothing", ((E, N),), "is no class of assets"),
    ],
)
def test_unfit_asset_is_refused_and_nothing_written(
    store: AssetStore, kind: str, vertices: object, words: str
) -> None:
    with pytest.raises(InputError) as refused:
        store.add(Draft(kind=kind, vertices=vertices))  # type: ignore[arg-type]
    assert words in str(refused.value)
    assert store.assets() == []
    assert store.steps() == []


@pytest.mark.parametrize("wrong", [{"sigma_e": -0.1}, {"corr_en": 1.5}, {"conf": 95.0}])
def test_impossible_accuracy_is_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError):
        Quality(**wrong)  # type: ignore[arg-type]


def test_asset_without_height_stays_without(store: AssetStore) -> None:
    asset = store.add(Draft(kind="cone", vertices=((E, N),)))  # type: ignore[arg-type]
    assert np.isnan(store.get(asset.id).vertices[0][2])


# -- changes and revisions -----------------------------------------------------------------------


def test_change_raises_the_revision_and_keeps_the_rest(store: AssetStore) -> None:
    old = store.add(cone(name="C1", attributes={"line": "T1"}, quality=QUALITY))
    new = store.change(old.id, old.revision, Change(note="fallen"))
    assert (new.revision, new.note) == (2, "fallen")
    assert (new.name, new.attributes, new.quality) == (old.name, old.attributes, old.quality)


def test_stale_change_is_refused_with_the_newer_value(store: AssetStore, tmp_path: Path) -> None:
    mine = store.add(cone(name="C1"))
    other = store_at(tmp_path)
    theirs = other.change(mine.id, mine.revision, Change(name="theirs"))
    with pytest.raises(StaleAssetError, match="revision 2, yours 1") as refused:
        store.change(mine.id, mine.revision, Change(name="mine"))
    assert refused.value.current == theirs
    with pytest.raises(StaleAssetError):
        store.delete(mine.id, mine.revision)
    assert store.get(mine.id).name == "theirs"
    again = store.change(mine.id, theirs.revision, Change(name="mine"))
    assert other.get(mine.id) == again


def test_change_of_a_deleted_asset_is_refused(store: AssetStore, tmp_path: Path) -> None:
    mine = store.add(cone())
    store_at(tmp_path).delete(mine.id, mine.revision)
    with pytest.raises(StaleAssetError, match="was deleted meanwhile") as refused:
        store.change(mine.id, mine.revision, Change(name="mine"))
    assert refused.value.current is None


def test_revision_goes_on_after_undo_so_that_old_forms_are_noticed(store: AssetStore) -> None:
    asset = store.add(cone(name="a"))
    store.change(asset.id, 1, Change(name="b"))
    store.undo()
    assert store.get(asset.id).name == "a"
    with pytest.raises(StaleAssetError):
        store.change(asset.id, 1, Change(name="c"))


def test_moved_place_without_measurement_loses_its_accuracy(store: AssetStore) -> None:
    asset = store.add(cone(quality=QUALITY))
    same = store.change(asset.id, 1, Change(vertices=asset.vertices))
    assert same.quality == QUALITY
    moved = store.change(asset.id, 2, Change(vertices=((E + 1, N, 270.0),)))
    assert moved.quality == Quality(method="edited")
    store.undo()
    assert store.get(asset.id).quality == QUALITY


@pytest.mark.parametrize(
    ("kind", "places", "words"),
    [
        ("work_area", [(0, 0), (9, 9), (9, 0), (0, 9)], "crosses or touches itself"),
        ("work_area", [(0, 0), (4, 4), (9, 9)], "crosses or touches itself"),
        ("lane_edge", [(5, 5), (5, 5)], "at one place"),
        ("work_area", [(0, 0), (9, 0), (9, 9), (0, 9)], ""),
        ("lane_edge", [(0, 0), (9, 9), (9, 0), (0, 9)], ""),
    ],
)
def test_outline_without_an_area_is_kept_and_told(
    store: AssetStore, kind: str, places: list[tuple[float, float]], words: str
) -> None:
    vertices = tuple((E + e, N + n, 270.0) for e, n in places)
    asset = store.add(Draft(kind=kind, vertices=vertices))
    assert [words in problem for problem in asset.problems] == [True] * bool(words)
    assert asset.vertices == vertices


def test_click_that_closes_an_outline_is_no_vertex(store: AssetStore) -> None:
    places = ((E, N), (E + 9, N), (E + 9, N + 9), (E, N))
    clicks = tuple(Click(photo_id="IMG_1", u=k % 3, v=0.0, vertex=k) for k in range(4))
    quality = Quality(method="locate", clicks=clicks)
    vertices = tuple((e, n, 270.0) for e, n in places)
    asset = store.add(Draft(kind="work_area", vertices=vertices, quality=quality))
    assert len(asset.vertices) == 3
    assert asset.quality is not None
    # else it would count as not clicked, and never be measured again
    assert {click.vertex for click in asset.quality.clicks} == {0, 1, 2}


def test_asset_of_a_class_that_was_removed_can_be_moved_and_named(tmp_path: Path) -> None:
    asset = store_at(tmp_path).add(cone(attributes={"line": "T1"}))
    (tmp_path / "asset_classes.toml").write_text("[classes.cone]\nremove = true\n")
    store = store_at(tmp_path)
    moved = store.change(asset.id, 1, Change(vertices=((E + 1, N, 270.0),), name="C1"))
    assert (moved.kind, moved.name, moved.attributes) == ("cone", "C1", {"line": "T1"})
    assert moved.problems == ("class 'cone' is not known",)
    with pytest.raises(InputError, match="'cone' is no class of assets"):
        store.change(asset.id, moved.revision, Change(attributes={"line": "T2"}))


def test_class_may_change_within_its_geometry_only(store: AssetStore) -> None:
    asset = store.add(cone())
    assert store.change(asset.id, 1, Change(kind="drum")).kind == "drum"
    with pytest.raises(InputError, match="add a new one"):
        store.change(asset.id, 2, Change(kind="lane_edge"))


# -- history -------------------------------------------------------------------------------------


def content(store: AssetStore) -> dict[str, tuple[object, ...]]:
    return {
        a.id: (a.kind, a.name, a.vertices, a.quality, a.attributes, a.note, a.changed)
        for a in store.assets()
    }


def test_every_edit_is_undone_and_redone_across_sessions(tmp_path: Path) -> None:
    states = [{}]
    with store_at(tmp_path) as store:
        a = store.add(cone(name="a", quality=QUALITY))
        states.append(content(store))
        b = store.add(edge((0, 0), (5, 5), name="b"))
        states.append(content(store))
        store.change(a.id, 1, Change(name="A", vertices=((E + 3, N, 1.0),)))
        states.append(content(store))
        store.delete(b.id, 1)
        states.append(content(store))
    for expected in states[-2::-1]:
        with store_at(tmp_path) as store:
            assert store.undo() is not None
            assert content(store) == expected
    assert store_at(tmp_path).undo() is None
    for expected in states[1:]:
        with store_at(tmp_path) as store:
            assert store.redo() is not None
            assert content(store) == expected
    assert store_at(tmp_path).redo() is None


def test_step_is_undone_as_a_whole_and_happens_as_a_whole(store: AssetStore) -> None:
    with store.step("import"):
        for k in range(5):
            store.add(cone(k))
    assert len(store.assets()) == 5
    assert store.steps()[0].title == "import"
    assert len(store.steps()[0].asset_ids) == 5
    store.undo()
    assert store.assets() == []
    drafts = (cone(), Draft(kind="nothing", vertices=((E, N, 0.0),)))
    with pytest.raises(InputError), store.step("import"):
        [store.add(draft) for draft in drafts]
    assert store.assets() == []
    store.redo()
    assert len(store.assets()) == 5


def test_edits_of_one_asset_in_one_step_are_undone_in_reverse(store: AssetStore) -> None:
    old = store.add(cone(name="first"))
    with store.step("twice"):
        between = store.change(old.id, 1, Change(name="second"))
        store.change(old.id, between.revision, Change(name="third"))
        new = store.add(cone(name="new"))
        store.delete(new.id, new.revision)
    store.undo()
    assert [a.name for a in store.assets()] == ["first"]
    store.redo()
    assert [a.name for a in store.assets()] == ["third"]


def test_new_edit_ends_what_could_be_redone_and_keeps_it_written_down(store: AssetStore) -> None:
    store.add(cone(name="a"))
    store.undo()
    store.add(cone(name="b"))
    assert store.redo() is None
    assert [step.state for step in store.steps()] == ["done", "dropped"]
    assert [a.name for a in store.assets()] == ["b"]


def test_undo_gives_an_asset_its_fid_back(store: AssetStore, tmp_path: Path) -> None:
    # a GIS that has the layer open knows features by fid
    asset = store.add(cone())
    store.add(cone(1))
    before = sql(tmp_path, "SELECT fid, asset_id FROM asset_points ORDER BY fid")
    store.delete(asset.id, 1)
    store.undo()
    assert sql(tmp_path, "SELECT fid, asset_id FROM asset_points ORDER BY fid") == before


# -- odd files -----------------------------------------------------------------------------------


def test_project_in_another_crs_is_told(store: AssetStore, tmp_path: Path) -> None:
    store.add(cone())
    crs = CRS.from_epsg(32618)
    other = Srs(name=crs.name, wkt=crs.to_wkt("WKT1_GDAL"), code=32618)
    with pytest.raises(InputError, match="is in 'WGS 84 / UTM zone 17N', the project in"):
        store_at(tmp_path, srs=other).assets()


def test_crs_without_a_code_is_known_again(tmp_path: Path) -> None:
    crs = CRS.from_user_input("+proj=tmerc +lat_0=39 +lon_0=-80 +k=1.0001 +x_0=1000 +ellps=GRS80")
    srs = Srs(name="own", wkt=crs.to_wkt("WKT1_GDAL"))
    store_at(tmp_path, srs=srs).add(cone())
    assert len(store_at(tmp_path, srs=srs).assets()) == 1


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda p: p.write_bytes(b"no database at all" * 100), "put a copy in its place"),
        (lambda p: sql(p.parent, "CREATE TABLE t (a)"), "is no GeoPackage"),
        (lambda p: p.mkdir(), "unable to open"),
    ],
)
def test_file_that_is_no_store_is_refused_in_one_line(
    tmp_path: Path, make: object, words: str
) -> None:
    make(tmp_path / ASSETS_FILE)  # type: ignore[operator]
    with pytest.raises(InputError) as refused:
        store_at(tmp_path).add(cone())
    assert words in str(refused.value)
    assert "\n" not in str(refused.value)


def test_file_put_in_place_of_the_open_one_is_used(tmp_path: Path) -> None:
    # restoring a backup: edits must not go to the file that is gone
    store = store_at(tmp_path)
    store.add(cone(name="old"))
    backup = (tmp_path / ASSETS_FILE).read_bytes()
    store.add(cone(name="lost"))
    (tmp_path / "copy").write_bytes(backup)
    (tmp_path / "copy").replace(tmp_path / ASSETS_FILE)
    store.add(cone(name="new"))
    assert [a.name for a in store_at(tmp_path).assets()] == ["old", "new"]


def test_unknown_id_is_refused(store: AssetStore) -> None:
    with pytest.raises(InputError, match="no asset has the id 'x'"):
        store.get("x")
