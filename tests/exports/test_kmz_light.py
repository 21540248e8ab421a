"""The light KMZ: under its limit whatever the site, without links, and saying what it lacks."""

from __future__ import annotations

import shutil
import zipfile
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from kml_checks import GX, K, documents, faults_of
from kmz_assets import asset_tables
from site_cases import make_frame, make_site, write_mosaic, write_photos

from exports.kml.light import fewer, shares
from exports.kml.light_kmz import write_light_kmz
from exports.kml.options import LightKmzOptions
from exports.kml.overlay import SHARED
from exports.site.site import SiteLayers
from georef_gis.errors import ExportError
from georef_gis.toolbox import CollectingFeedback


def export(site: SiteLayers, folder: Path, **options: object) -> tuple[Path, list[str]]:
    feedback = CollectingFeedback()
    target = folder / "light.kmz"
    write_light_kmz(site, target, LightKmzOptions(**options), feedback)  # type: ignore[arg-type]
    assert faults_of(target) == []
    return target, feedback.warnings


def noise_mosaic(folder: Path, side: int) -> Path:
    """A mosaic that packs badly: every pixel is another."""
    import rasterio

    path = write_mosaic(folder / "m.tif", make_frame("EPSG:32617"), width=side, height=side)
    with rasterio.open(path) as ds:
        profile, mask = ds.profile, ds.dataset_mask()
    rng = np.random.default_rng(1)
    data = rng.integers(0, 255, (3, side, side), np.uint8)
    profile.update(driver="GTiff", compress="none")
    with (
        rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True),
        rasterio.open(folder / "n.tif", "w", **profile) as ds,
    ):
        ds.write(data)
        ds.write_mask(mask)
    return folder / "n.tif"


def test_one_photo_and_a_mosaic_fit_without_losing_anything(tmp_path):
    write_photos(tmp_path)
    mosaic = write_mosaic(tmp_path / "m.tif", make_frame("EPSG:32617"), width=1500, height=1100)
    base = make_site(tmp_path, mosaic=mosaic)
    site = replace(base, photos=base.photos[:1], footprints=base.footprints[:1])
    path, warnings = export(site, tmp_path)
    assert warnings == []
    roots = dict(documents(path))
    assert list(roots) == ["doc.kml"]
    assert list(roots["doc.kml"].iter(K + "NetworkLink")) == []
    assert list(roots["doc.kml"].iter(K + "GroundOverlay")) != []
    assert list(roots["doc.kml"].iter(K + "PhotoOverlay")) == []


def test_pictures_side_by_side_show_the_same_where_they_meet(tmp_path):
    mosaic = write_mosaic(tmp_path / "m.tif", make_frame("EPSG:32617"), width=1000, height=900)
    path, _ = export(make_site(tmp_path, mosaic=mosaic), tmp_path)
    pictures = []
    with zipfile.ZipFile(path) as archive:
        for overlay in dict(documents(path))["doc.kml"].iter(K + "GroundOverlay"):
            data = np.frombuffer(archive.read(overlay.findtext(f".//{K}href")), np.uint8)
            box = overlay.find(K + "LatLonBox")
            sides = [float(box.findtext(K + s)) for s in ("west", "south", "east", "north")]
            pictures.append((cv2.imdecode(data, cv2.IMREAD_UNCHANGED), *sides))
    left, right, below, _ = pictures
    assert left[0].shape[:2] == (514, 514)
    across, up = (left[3] - left[1]) / 514, (left[4] - left[2]) / 514
    # px; where they lie by their boxes of ten decimals
    assert (left[3] - right[1]) / across == pytest.approx(SHARED, abs=1e-3)
    assert (below[4] - left[2]) / up == pytest.approx(SHARED, abs=1e-3)
    # PNG with all its colours: the very same pixels
    assert np.array_equal(left[0][:, -SHARED:], right[0][:, :SHARED])
    assert np.array_equal(left[0][-SHARED:], below[0][:SHARED])


@pytest.mark.parametrize("max_mb", [10.0, 1.0, 0.25])
def test_a_thousand_photos_many_assets_and_noise_stay_under_the_limit(tmp_path, max_mb):
    write_photos(tmp_path)
    base = make_site(tmp_path, mosaic=noise_mosaic(tmp_path, 2500))
    rng = np.random.default_rng(4)
    noise = rng.integers(0, 255, (480, 640, 3), np.uint8)
    cv2.imwrite(str(tmp_path / "p1.jpg"), noise)
    one, ring = base.photos[0], base.footprints[0]
    photos = tuple(replace(one, photo=replace(one.photo, id=f"p{i}", time_gps=2.0 * i))
                   for i in range(1000))  # fmt: skip
    prints = tuple(replace(ring, photo_id=f"p{i}") for i in range(1000))
    tables = asset_tables(base.frame, 5000, ellipses=True, names=["x" * 300] * 5000)
    site = replace(base, photos=photos, footprints=prints, assets=tables)
    path, warnings = export(site, tmp_path, max_mb=max_mb)
    assert path.stat().st_size <= max_mb * 1e6
    with zipfile.ZipFile(path) as archive:
        assert archive.getinfo("doc.kml").file_size <= max_mb * 1e6
    root = dict(documents(path))["doc.kml"]
    assert len(list(root.iter(K + "Placemark"))) <= 1001  # and the flight
    told = root.findtext(f"{K}Document/{K}description")
    assert "left out" in told
    assert any("photos" in w and "of 1000" in w for w in warnings)
    assert list(root.iter(K + "GroundOverlay")) or any("mosaic" in w for w in warnings)


def test_small_layers_stay_whole_and_the_rest_share():
    assert shares({"a": 5, "b": 1000, "c": 1000}, 105) == {"a": 5, "b": 50, "c": 50}
    assert shares({"a": 5, "b": 7}, 1000) == {"a": 5, "b": 7}


def test_photos_and_footprints_that_stay_are_the_same(tmp_path):
    base = make_site(tmp_path)
    one, ring = base.photos[0], base.footprints[0]
    photos = tuple(replace(one, photo=replace(one.photo, id=f"p{i}")) for i in range(300))
    prints = tuple(replace(ring, photo_id=f"p{i}") for i in range(300))
    site = replace(base, photos=photos, footprints=prints)
    names = ("photos", "footprints")
    layers, (told,) = fewer({name: site.layers[name] for name in names}, 100)
    kept = [layers[name].columns["photo"].tolist() for name in names]
    assert kept[0] == kept[1]
    assert len(kept[0]) == 50
    assert told == "of many features some are left out: photos 50 of 300, footprints 50 of 300"


def test_lines_of_many_vertices_keep_their_ends(tmp_path):
    base = make_site(tmp_path)
    ring = base.footprints[0]
    angle = np.linspace(0.0, 2.0 * np.pi, 5001)
    enu = np.column_stack([20 * np.cos(angle), 20 * np.sin(angle), 0 * angle])
    enu[-1] = enu[0]
    print_ = replace(ring, ring_enu=enu, ring_map=base.frame.map_from_enu(enu)[:, :2])
    path, warnings = export(replace(base, footprints=(print_,)), tmp_path)
    root = dict(documents(path))["doc.kml"]
    points = root.findtext(f".//{K}Polygon//{K}coordinates").split()
    assert len(points) == 200
    assert any("fewer" in warning for warning in warnings)


def test_a_limit_that_nothing_fits_is_refused_with_the_cure(site, tmp_path):
    with pytest.raises(ExportError, match=r"max_mb = 0.001; allow more"):
        write_light_kmz(
            site, tmp_path / "l.kmz", LightKmzOptions(max_mb=0.001), CollectingFeedback()
        )
    assert not (tmp_path / "l.kmz").exists()


def test_photos_that_are_gone_are_told(tmp_path):
    site = make_site(tmp_path)
    shutil.rmtree(tmp_path / "photos", ignore_errors=True)
    _, warnings = export(site, tmp_path)
    assert any("cannot be read" in warning for warning in warnings)


def test_the_flight_is_a_plain_line_too_for_viewers_that_know_no_tracks(tmp_path):
    path, _ = export(make_site(tmp_path), tmp_path)
    root = dict(documents(path))["doc.kml"]
    (line,) = [m for m in root.iter(K + "Placemark") if m.find(K + "LineString") is not None]
    assert line.find(K + "visibility") is None
    assert root.find(f".//{GX}Track") is not None
