"""The STAC catalogue read by pystac: valid, linked, with poses that give the photos' pixels."""

from __future__ import annotations

import hashlib
import itertools
import json
import math
import threading
from collections.abc import Mapping
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
import pystac
import pytest
import rasterio
import shapely
import shapely.geometry
from format_cases import HOSTILE
from metadata_cases import across, fill, make_project, record, write_accuracy, write_metadata
from pystac.extensions.file import FileExtension
from pystac.extensions.projection import ProjectionExtension
from pystac.extensions.view import ViewExtension
from pystac.validation.stac_validator import JsonSchemaSTACValidator
from rasterio.warp import transform_geom
from scipy.spatial.transform import Rotation
from site_cases import NASTY, make_site

from exports.metadata.stac import Stac
from exports.metadata.stac_parts import slug, slugs
from georef_gis.errors import ExportError
from georef_gis.geodesy import CRS, Datum, MapFrame
from georef_gis.model.photo import OrientedPhoto
from georef_gis.project import Project
from georef_gis.toolbox import CollectingFeedback, Context
from georef_gis.toolbox.exporter import tool_of

EXTENSIONS = "https://stac-extensions.github.io/"
NUMBER = (int, float)
# What the extensions' published schemas allow: field -> type, and of an array its length and type.
RULES: Mapping[str, Mapping[str, Any]] = {
    "perspective-imagery/v1.0.0": {
        "pers:crs": (int, str, dict), "pers:vertical_crs": (int, str, dict),
        "pers:perspective_center": ((2, 3), NUMBER), "pers:rotation_matrix": ((9,), NUMBER),
        "pers:omega": NUMBER, "pers:phi": NUMBER, "pers:kappa": NUMBER,
        "pers:interior_orientation": {
            "camera_id": str, "camera_manufacturer": str, "camera_model": str,
            "sensor_array_dimensions": ((2,), int), "pixel_spacing": ((2,), NUMBER),
            "focal_length": NUMBER, "field_of_view": NUMBER,
            "principal_point_offset": ((2,), NUMBER), "radial_distortion": ((4,), NUMBER),
            "affine_distortion": ((6,), NUMBER), "calibration_date": str,
        },
    },
    "accuracy/v1.0.0-beta.1": {
        f"accuracy:{name}": NUMBER
        for name in ("geometric_x_bias", "geometric_y_bias", "geometric_x_stddev",
                     "geometric_y_stddev", "geometric_rmse", "measurement_relative",
                     "measurement_absolute")
    },
    "file/v2.1.0": {"file:size": int, "file:checksum": str},
    "projection/v2.0.0": {
        "proj:code": (str, type(None)), "proj:wkt2": str, "proj:shape": ((2,), int),
        "proj:transform": ((6, 9), NUMBER),
    },
    "view/v1.0.0": {"view:off_nadir": NUMBER, "view:azimuth": NUMBER},
}  # fmt: skip


def export(project: Project, **values: Any) -> tuple[pystac.Collection, CollectingFeedback]:
    """Run the exporter and open what it wrote."""
    tool, feedback = tool_of(Stac), CollectingFeedback()
    result = tool().run(Context(project=project), tool.Parameters(**values), feedback)
    folder = Path(result.outputs["target"])
    return pystac.Collection.from_file(str(folder / "collection.json")), feedback


def items_of(collection: pystac.Collection) -> dict[str, pystac.Item]:
    return {item.id: item for item in collection.get_items(recursive=True)}


def fits(value: Any, rule: Any) -> bool:
    """Whether a value is of the type that a schema asks for."""
    if isinstance(rule, dict):
        return all(name in rule and fits(one, rule[name]) for name, one in value.items())
    if isinstance(rule, tuple) and rule and isinstance(rule[0], tuple):
        lengths, kind = rule
        return len(value) in lengths and all(fits(one, kind) for one in value)
    return isinstance(value, rule) and not isinstance(value, bool)


def broken_rules(item: Mapping[str, Any]) -> list[str]:
    """Fields of an item that no schema knows, of the wrong type, or without their extension."""
    wrong: list[str] = []
    stated = {uri.removeprefix(EXTENSIONS).removesuffix("/schema.json")
              for uri in item["stac_extensions"]}  # fmt: skip
    allowed = {name: rule for one in stated for name, rule in RULES[one].items()}
    used = set()
    for fields in (item["properties"], *item["assets"].values()):
        for name, value in fields.items():
            prefix = name.partition(":")[0]
            if ":" not in name or prefix == "georef":
                continue
            used.add(prefix)
            if name not in allowed or not fits(value, allowed[name]):
                wrong.append(f"{name} = {value!r}")
    prefixes = {name.partition(":")[0] for name in allowed}
    return wrong + sorted(prefixes - used)


def check_valid(collection: pystac.Collection) -> None:
    """Core schemas of pystac, and the rules of the extensions."""
    core = JsonSchemaSTACValidator()
    root = collection.to_dict(transform_hrefs=False)
    core.validate_core(root, pystac.STACObjectType.COLLECTION, "1.1.0")
    for item in items_of(collection).values():
        document = json.loads(Path(item.get_self_href()).read_text(encoding="utf-8"))
        core.validate_core(document, pystac.STACObjectType.ITEM, "1.1.0")
        assert broken_rules(document) == []


@pytest.fixture
def project(tmp_path: Path) -> Any:
    """The site with its mosaic."""
    project = make_project(tmp_path / "site", metadata={"organisation": "DOT", "licence": "MIT"})
    yield project
    project.close()


# -- the catalogue -----------------------------------------------------------------------------


def test_catalogue_is_valid_and_all_links_resolve(project):
    write_accuracy(project)
    write_metadata(project)
    collection, _ = export(project)
    check_valid(collection)
    items = items_of(collection)
    assert set(items) == {"p1.jpg", NASTY, "missing.jpg", "mosaic"}
    for item in items.values():
        assert item.get_root() is collection
        assert item.get_parent() is collection
        assert item.get_collection() is collection
        for asset in item.get_assets().values():
            assert "\\" not in asset.href
            assert not asset.href.startswith("/")
            there = (Path(item.get_self_href()).parent / unquote(asset.href)).resolve()
            assert there.is_file() or there.name == "missing.jpg"
    roles = {key: asset.roles for key, asset in items["mosaic"].get_assets().items()}
    assert roles == {"mosaic": ["data", "visual"], "metadata": ["metadata"],
                     "thumbnail": ["thumbnail"]}  # fmt: skip
    assert collection.license == "MIT"
    assert [one.name for one in collection.providers] == ["DOT"]


def test_footprints_are_those_of_the_project_in_degrees(project):
    collection, _ = export(project)
    site = make_site(project.folder, crs="EPSG:6549")
    for f in site.footprints:
        item = items_of(collection)[f.photo_id]
        found = shapely.geometry.shape(item.geometry)
        assert found.is_valid
        assert item.bbox == pytest.approx(found.bounds, abs=1e-12)
        ring = {"type": "Polygon", "coordinates": [f.ring_map.tolist()]}
        wanted = shapely.geometry.shape(transform_geom("EPSG:6549", "EPSG:4326", ring))
        # GDAL takes NAD83 for WGS 84, as the project does here; 1e-8 deg is a millimetre
        assert found.symmetric_difference(wanted).area < 1e-3 * wanted.area


def test_times_are_utc_or_a_range_that_holds_them(tmp_path):
    folder = tmp_path / "site"
    plain = make_site(folder)
    one, two, three = plain.photos
    two = replace(two, photo=replace(two.photo, time_gps=None))
    three = replace(three, photo=replace(three.photo, time_gps=None, camera_clock=None))
    project = make_project(folder, site=replace(plain, photos=(one, two, three)))
    collection, feedback = export(project)
    check_valid(collection)
    items = items_of(collection)
    assert items["p1.jpg"].datetime == datetime(2026, 5, 1, 12, tzinfo=UTC)
    ranged = items[NASTY]
    assert ranged.datetime is None
    # the clock shows 8:00:02; it may stand in any zone from UTC-12 to UTC+14
    common = ranged.common_metadata
    assert common.start_datetime == datetime(2026, 4, 30, 18, 0, 2, tzinfo=UTC)
    assert common.end_datetime == datetime(2026, 5, 1, 20, 0, 2, tzinfo=UTC)
    assert items["missing.jpg"].properties["georef:time"].startswith("unknown")
    assert collection.extent.temporal.intervals == [[None, None]]
    assert "2 of 3 photos have no time in UTC: a range is written" in feedback.warnings
    project.close()


def test_mosaic_has_the_grid_that_gdal_reads(project):
    collection, _ = export(project)
    item = items_of(collection)["mosaic"]
    path = project.products / "mosaic.tif"
    asset = item.get_assets()["mosaic"]
    projection, file = ProjectionExtension.ext(asset), FileExtension.ext(asset)
    with rasterio.open(path) as raster:
        assert projection.shape == [raster.height, raster.width]
        assert projection.transform == pytest.approx(list(raster.transform)[:6], rel=1e-15)
        assert projection.code == "EPSG:6549"
        assert rasterio.CRS.from_wkt(projection.wkt2) == raster.crs
        bounds = shapely.box(*raster.bounds)
    found = shapely.geometry.shape(item.geometry)
    assert found.is_valid
    ring = transform_geom("EPSG:6549", "EPSG:4326", shapely.geometry.mapping(bounds))
    wanted = shapely.geometry.shape(ring)
    assert found.symmetric_difference(wanted).area < 1e-3 * wanted.area
    assert file.size == path.stat().st_size
    # 0x12 is SHA-256 and 0x20 its length in bytes
    assert file.checksum == "1220" + hashlib.sha256(path.read_bytes()).hexdigest()


def test_accuracy_is_the_tested_one_of_the_mosaic(project):
    write_accuracy(project)
    said = items_of(export(project)[0])["mosaic"].properties
    assert said["accuracy:geometric_rmse"] == 0.0419
    assert said["accuracy:geometric_x_bias"] == -0.0165
    assert said["accuracy:geometric_y_stddev"] == 0.0251
    assert said["georef:vertical_rmse_m"] == 0.0894


def test_expected_accuracy_is_not_called_tested(project):
    for item in items_of(export(project)[0]).values():
        assert item.properties["accuracy:geometric_x_stddev"] == 2.5
        assert item.properties["georef:accuracy"].endswith("not tested")
        assert "accuracy:geometric_rmse" not in item.properties


# -- poses -------------------------------------------------------------------------------------


def pixel_by_stac(said: Mapping[str, Any], p_ecef: np.ndarray) -> np.ndarray:
    """Pixel of a ground point, from the extension's fields alone (no distortion)."""
    center = np.array(said["pers:perspective_center"])
    M = np.array(said["pers:rotation_matrix"]).reshape(3, 3)
    inside = said["pers:interior_orientation"]
    # x right, y up, z backwards: the ground lies at negative z
    x, y, z = M @ (p_ecef - center)
    mm = -inside["focal_length"] * np.array([x, y]) / z + inside["principal_point_offset"]
    columns, rows = inside["sensor_array_dimensions"]
    across, down = inside["pixel_spacing"]
    return np.array([(columns - 1) / 2 + mm[0] / across, (rows - 1) / 2 - mm[1] / down])


def test_pose_and_camera_give_the_pixels_of_the_project(tmp_path):
    folder = tmp_path / "site"
    plain = make_site(folder)
    camera = replace(plain.cameras[0], fx=1990.0, fy=2010.0, cx=330.25, cy=228.5)
    tilted = Rotation.from_euler("zyx", [70.0, 8.0, -11.0], degrees=True).as_matrix()
    photos = tuple(
        replace(
            p,
            photo=replace(p.photo, make="DJI", model="FC6310", tags={"EXIF:FocalLength": 8.8}),
            pose=replace(p.pose, R_enu_from_cam=tilted @ p.pose.R_enu_from_cam),
        )
        for p in plain.photos
    )
    frame = MapFrame(plain.frame.origin, plain.frame.crs, gnss_datum=Datum(name="NAD83(2011)"))
    site = replace(plain, photos=photos, cameras=(camera,), frame=frame)
    project = make_project(folder, site=site)
    items = items_of(export(project)[0])
    for one in photos:
        said = items[one.photo.id].properties
        # NAD83(2011), geocentric
        assert said["pers:crs"] == 6317
        oriented = OrientedPhoto(photo=one.photo, camera=camera, pose=one.pose)
        for p_enu in ([3.0, -4.0, 0.0], [15.0, 5.0, 2.0]):
            wanted = oriented.project(np.array(p_enu))
            p_ecef = frame.origin.ecef_from_enu(np.array(p_enu))
            # 0.1 mm of the rounded place is 0.002 px here
            assert pixel_by_stac(said, p_ecef) == pytest.approx(wanted, abs=0.01)
    project.close()


def test_nadir_is_told_by_the_view_extension(project):
    item = items_of(export(project)[0])["p1.jpg"]
    assert ViewExtension.ext(item).off_nadir == pytest.approx(0.0, abs=1e-4)
    assert item.properties["georef:sigma_e_m"] == pytest.approx(1.0, abs=1e-6)


def test_geocentric_system_is_that_of_the_datum():
    from exports.metadata.stac_camera import geocentric

    assert geocentric(Datum()) == 4978
    for name in ("NAD83(2011)", "ITRF2020", "WGS 84 (G2139)"):
        crs = CRS.from_user_input(geocentric(Datum(name=name, epoch=2010.0)))
        assert crs.is_geocentric
        assert crs.datum == Datum(name=name).geographic_3d().datum


def test_photo_without_pose_or_place_is_there_without_geometry(tmp_path):
    folder = tmp_path / "site"
    plain = make_site(folder)
    photos = (*plain.photos[:2], replace(plain.photos[2], pose=None))
    prints = plain.footprints[:2]
    project = make_project(folder, site=replace(plain, photos=photos, footprints=prints))
    collection, feedback = export(project)
    check_valid(collection)
    item = items_of(collection)["missing.jpg"]
    assert item.geometry is None
    assert item.bbox is None
    assert item.properties["georef:pose"] == "none"
    assert "pers:crs" not in item.properties
    assert "1 of 3 photos have no place: geometry is null" in feedback.warnings
    project.close()


# -- bad input ---------------------------------------------------------------------------------


def test_site_across_the_antimeridian_is_cut_there(tmp_path):
    folder = tmp_path / "site"
    project = make_project(folder, site=across(folder))
    collection, _ = export(project)
    check_valid(collection)
    west, _, east, _ = collection.extent.spatial.bboxes[0]
    assert west > 179.99
    assert east < -179.99
    kinds = set()
    for item in items_of(collection).values():
        shape = shapely.geometry.shape(item.geometry)
        assert shape.is_valid
        kinds.add(shape.geom_type)
        # the whole globe round would be the wrong way
        assert shape.area < 1e-6
    assert kinds == {"Polygon", "MultiPolygon"}
    project.close()


def test_hostile_names_survive_and_make_no_hostile_files(tmp_path):
    folder = tmp_path / "site"
    names = [*HOSTILE, "nul\x00", "../../up", "CON", "photo", "PHOTO"]
    plain = make_site(folder)
    model = plain.photos[0]
    photos = tuple(
        replace(model, photo=replace(model.photo, id=name, doubts=(name,))) for name in names
    )
    site = replace(plain, photos=photos, footprints=())
    project = make_project(folder, name=HOSTILE[0], site=site)
    collection, _ = export(project, thumbnails=False)
    check_valid(collection)
    assert collection.title == HOSTILE[0]
    told = {item.properties["georef:doubts"][0] for item in items_of(collection).values()
            if item.id != "mosaic"}  # fmt: skip
    assert told == {name.replace("\x00", "�") for name in names}
    base = Path(collection.get_self_href()).parent
    files = {path.name for path in base.rglob("*.json")} - {".georef_export.json"}
    assert len({name.casefold() for name in files}) == len(names) + 2
    assert all(len(name) < 120 and name.isascii() for name in files)
    project.close()


def test_names_of_files_are_plain_where_ids_are():
    assert slug("DJI_0018") == "DJI_0018"
    assert slug("a b") != slug("a_b")
    assert slugs(["x", "y"]) == {"x": "x", "y": "y"}
    assert len({name.casefold() for name in slugs(["a", "A"]).values()}) == 2
    assert slug("aux.jpg") != "aux.jpg"


def test_catalogue_of_the_mosaic_alone_needs_one(project):
    collection, _ = export(project, items="mosaic")
    assert set(items_of(collection)) == {"mosaic"}
    (project.products / "mosaic.tif").unlink()
    with pytest.raises(ExportError, match=r"mosaic\.tif: is not there.*georef run"):
        export(project, items="mosaic")
    collection, _ = export(project)
    assert "mosaic" not in items_of(collection)


def test_half_broken_mosaic_costs_its_item_only(project):
    (project.products / "mosaic.tif").write_bytes(b"II*\x00 half")
    collection, _ = export(project)
    assert set(items_of(collection)) == {"p1.jpg", NASTY, "missing.jpg"}


def test_foreign_files_in_the_folder_are_not_lost(project):
    folder = project.products / "stac"
    folder.mkdir()
    (folder / "mine.txt").write_text("mine")
    with pytest.raises(ExportError, match=r"mine\.txt, which is not of an earlier export"):
        export(project)
    assert (folder / "mine.txt").read_text() == "mine"


def test_second_export_replaces_the_first(project):
    export(project)
    site = make_site(project.folder, crs="EPSG:6549")
    fill(project, replace(site, photos=site.photos[:1], footprints=site.footprints[:1]))
    record(project, "read_photos")
    collection, _ = export(project)
    assert set(items_of(collection)) == {"p1.jpg", "mosaic"}
    base = Path(collection.get_self_href()).parent
    assert len(list((base / "photos").iterdir())) == 1


def test_thumbnails_are_made_side_by_side_and_kept_apart(project, monkeypatch):
    both, calls = threading.Barrier(2, timeout=20.0), itertools.count()

    def thumbnail(photo, side):
        if next(calls) < 2:
            both.wait()
        return photo.id.encode()

    monkeypatch.setattr("exports.kml.thumbnails.thumbnail", thumbnail)
    collection, _ = export(project)
    base = Path(collection.get_self_href()).parent
    found = {path.read_bytes().decode(): path.parent.name for path in base.glob("photos/*/*.jpg")}
    assert len(found) == 3
    assert found["p1.jpg"] == "p1.jpg"


def test_documents_hold_finite_numbers_only(tmp_path):
    folder = tmp_path / "site"
    plain = make_site(folder)
    prints = tuple(replace(f, gsd=math.nan, sigma_horizontal=math.nan) for f in plain.footprints)
    project = make_project(folder, site=replace(plain, footprints=prints))
    collection, _ = export(project)
    check_valid(collection)
    assert items_of(collection)["p1.jpg"].properties["georef:accuracy"] == "unknown"
    project.close()
