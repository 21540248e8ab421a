"""KML and KMZ: valid by schema, whole, and in place."""

from __future__ import annotations

import math
import posixpath
import zipfile
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pyogrio
import pytest
import rasterio
from kml_checks import K, documents, faults_of
from lxml import etree
from pyproj import Transformer
from site_cases import NASTY, dot_places, make_frame, make_site, write_mosaic, write_photos

from exports.kml import files
from exports.kml.kml import write_kml, write_kmz
from exports.kml.options import KmzOptions
from georef_gis.errors import Cancelled, ExportError
from georef_gis.geodesy import MapFrame, geoid_undulation
from georef_gis.toolbox import CollectingFeedback

SIZE = (1500, 1100)


@pytest.fixture(scope="module", params=["EPSG:32617", "EPSG:6549"])
def kmz(request, tmp_path_factory) -> tuple[Path, str]:
    folder = tmp_path_factory.mktemp("kmz")
    write_photos(folder)
    frame = make_frame(request.param)
    mosaic = write_mosaic(folder / "mosaic.tif", frame, width=SIZE[0], height=SIZE[1])
    site = make_site(folder, crs=request.param, mosaic=mosaic)
    report = write_kmz(
        site, folder / "site.kmz", KmzOptions(overlay="pyramid"), CollectingFeedback()
    )
    assert report.features == 7
    return folder / "site.kmz", request.param


def on_map(t: rasterio.Affine, col: np.ndarray, row: np.ndarray) -> tuple:
    return t.a * col + t.c, t.e * row + t.f


def box(element: etree._Element) -> dict[str, float]:
    return {side: float(element.findtext(K + side)) for side in ("north", "south", "east", "west")}


def deepest_tiles(path: Path) -> list[tuple[dict[str, float], np.ndarray]]:
    """Boxes and BGRA pixels of the tiles that have no children, from the files alone."""
    out = []
    with zipfile.ZipFile(path) as archive:
        for name, root in documents(path):
            overlay = root.find(f".//{K}GroundOverlay")
            if overlay is None or root.find(f".//{K}NetworkLink") is not None:
                continue
            href = posixpath.join(posixpath.dirname(name), overlay.findtext(f".//{K}href"))
            pixels = cv2.imdecode(np.frombuffer(archive.read(href), np.uint8), -1)
            if pixels.shape[2] == 3:
                pixels = np.dstack([pixels, np.full(pixels.shape[:2], 255, np.uint8)])
            out.append((box(overlay.find(K + "LatLonBox")), pixels))
    return out


def test_every_file_is_valid_whole_and_linked(kmz):
    assert faults_of(kmz[0]) == []


def test_googles_library_of_kml_opens_the_kmz_itself(kmz):
    """GDAL's LIBKML is that library: it reads no ZIP64."""
    found = pyogrio.read_dataframe(kmz[0], layer="Photos")
    assert found["Name"].tolist() == ["p1.jpg", NASTY, "missing.jpg"]
    with zipfile.ZipFile(kmz[0]) as archive:
        assert {member.extract_version for member in archive.infolist()} == {20}


def test_a_document_that_no_kmz_holds_is_refused(site, tmp_path, monkeypatch):
    monkeypatch.setattr(zipfile, "ZIP64_LIMIT", 5000)
    with pytest.raises(ExportError, match=r"^doc\.kml of the KMZ has 2 GB or more"):
        write_kmz(site, tmp_path / "s.kmz", KmzOptions(), CollectingFeedback())


def test_more_files_than_old_readers_of_zip_know_are_told(site, tmp_path, monkeypatch):
    monkeypatch.setattr(files, "MOST_FILES", 3)
    feedback = CollectingFeedback()
    write_kmz(site, tmp_path / "s.kmz", KmzOptions(), feedback)
    assert any("ZIP64" in warning and "max_zoom" in warning for warning in feedback.warnings)


def test_a_zip_is_called_plain_only_where_python_sets_no_mark_of_zip64(tmp_path, monkeypatch):
    """In small: 20 kB for 2 GB, 0.5 kB for the 16 MB that are left free."""
    assert zipfile.ZIP64_LIMIT + 1 - files.MOST_BYTES == 2**24
    monkeypatch.setattr(zipfile, "ZIP64_LIMIT", 20_000)
    monkeypatch.setattr(files, "MOST_BYTES", 19_500)
    noise = np.random.default_rng(1).bytes(12_000)
    found = []
    for size in (8000, 12_000):
        with files.Spool(tmp_path) as spool:
            spool.add("a.jpg", noise[:size])
            spool.add("b.jpg", noise[:1000])
            # the pictures alone are small enough
            plain = files.write_zip(tmp_path / "s.kmz", lambda s: s.write(noise[:9000]), spool)
        with zipfile.ZipFile(tmp_path / "s.kmz") as archive:
            marked = max(member.extract_version for member in archive.infolist()) == 45
        found.append((plain, marked))
    assert found == [(True, False), (False, True)]


def test_levels_of_detail_follow_the_pyramid(kmz):
    for name, root in documents(kmz[0]):
        if not name.startswith("mosaic/"):
            continue
        lod = root.find(f"{K}Document/{K}Region/{K}Lod")
        found = [int(lod.findtext(K + f"{m}LodPixels")) for m in ("min", "max")]
        parent = root.find(f".//{K}NetworkLink") is not None
        assert found == [1 if name == "mosaic/0/0/0.kml" else 128, 2048 if parent else -1]


def test_opaque_tiles_are_jpeg_and_empty_ones_are_left_out(kmz):
    with zipfile.ZipFile(kmz[0]) as archive:
        tiles = [n for n in archive.namelist() if n.startswith("mosaic/") and n[-3:] != "kml"]
        for name in tiles:
            pixels = cv2.imdecode(np.frombuffer(archive.read(name), np.uint8), -1)
            assert max(pixels.shape[:2]) <= 256
            if name.endswith("png"):
                assert 0 < pixels[..., 3].mean() < 255, name
    kinds = {name[-3:] for name in tiles}
    assert kinds == {"png", "jpg"}
    # A diamond leaves the corners free; a full pyramid of 8 x 8 has 85 tiles.
    assert len(tiles) < 50


def test_neighbouring_tiles_share_their_sides(kmz):
    boxes = [b for b, _ in deepest_tiles(kmz[0])]
    wests, easts = {b["west"] for b in boxes}, {b["east"] for b in boxes}
    assert len(wests | easts) <= len(wests) + 1


def test_overlay_lies_in_place_to_a_tenth_of_a_pixel(kmz):
    """Centroids of the mosaic's dots, by the boxes in the files, against the project's frame."""
    path, crs = kmz
    frame = make_frame(crs)
    with rasterio.open(path.parent / "mosaic.tif") as ds:
        transform = ds.transform
        valid = ds.dataset_mask() > 0
    errors = []
    tiles = deepest_tiles(path)
    for col, row in dot_places(*SIZE):
        if not valid[int(row) - 8 : int(row) + 8, int(col) - 8 : int(col) + 8].all():
            continue
        x, y = on_map(transform, col, row)
        lat, lon = np.degrees(frame.geo_from_map([x, y, 200.0])[:2])
        for sides, pixels in tiles:
            height, width = pixels.shape[:2]
            u = (lon - sides["west"]) * width / (sides["east"] - sides["west"])
            v = (sides["north"] - lat) * height / (sides["north"] - sides["south"])
            if 8 < u < width - 8 and 8 < v < height - 8:
                i, j = int(v) - 7, int(u) - 7
                patch = pixels[i : i + 15, j : j + 15, 0].astype(float) - 60.0
                weight = np.clip(patch - 20.0, 0.0, None)
                yy, xx = np.mgrid[i : i + 15, j : j + 15] + 0.5
                centroid = [(xx * weight).sum(), (yy * weight).sum()] / weight.sum()
                errors.append(centroid - [u, v])
    errors = np.array(errors)
    assert len(errors) > 50
    assert np.abs(errors.mean(axis=0)).max() < 0.05  # px: JPEG noise of one dot over many dots
    assert np.abs(errors).max() < 0.3  # px: JPEG noise of one dot


def test_gdal_reads_the_superoverlay_back_in_place(kmz):
    path, crs = kmz
    frame = make_frame(crs)
    with rasterio.open(path) as overlay, rasterio.open(path.parent / "mosaic.tif") as mosaic:
        assert overlay.driver == "KMLSUPEROVERLAY"
        assert overlay.crs.to_epsg() == 4326
        image = overlay.read()
        truth = mosaic.read()
        rng = np.random.default_rng(7)
        colrow = rng.uniform([550, 400], [950, 700], (500, 2))
        x, y = on_map(mosaic.transform, *colrow.T)
        geo = frame.geo_from_map(np.column_stack([x, y, np.full(500, 200.0)]))
        u, v = on_map(~overlay.transform, np.degrees(geo[:, 1]), np.degrees(geo[:, 0]))
    got = image[:3, v.astype(int), u.astype(int)].astype(int)
    wanted = truth[:, colrow[:, 1].astype(int), colrow[:, 0].astype(int)].astype(int)
    # Half a pixel of rounding each changes values at the dots' rims only.
    assert np.median(np.abs(got - wanted)) <= 2
    assert np.mean(np.abs(got - wanted) > 12) < 0.08
    assert (image[3, v.astype(int), u.astype(int)] == 255).all()


def test_gdal_reads_the_vectors(kmz, tmp_path):
    with zipfile.ZipFile(kmz[0]) as archive:
        archive.extract("doc.kml", tmp_path)
    layers = {str(name) for name, _ in pyogrio.list_layers(tmp_path / "doc.kml")}
    assert {"Photos", "Footprints", "Flight track"} <= layers
    frame = pyogrio.read_dataframe(tmp_path / "doc.kml", layer="Photos")
    point = frame.geometry.iloc[0]
    n = float(geoid_undulation(math.radians(40.0), math.radians(-83.0)))
    assert (point.x, point.y) == pytest.approx((-83.0, 40.0), abs=1e-9)
    assert point.z == pytest.approx(300.0 - n, abs=1e-3)
    assert frame["sigma_n_m"].iloc[0] == pytest.approx(2.0)
    assert frame["Name"].tolist() == ["p1.jpg", NASTY, "missing.jpg"]


def test_heights_and_modes(kmz):
    root = dict(documents(kmz[0]))["doc.kml"]
    modes = {
        parent: {e.text for e in root.findall(f".//{K}{parent}/{K}altitudeMode")}
        for parent in ("Point", "Polygon", "LineString")
    }
    assert modes == {
        "Point": {"absolute"}, "Polygon": {"clampToGround"}, "LineString": {"absolute"},
    }  # fmt: skip


def test_nasty_names_survive_in_text_and_table(kmz):
    root = dict(documents(kmz[0]))["doc.kml"]
    marks = root.findall(f".//{K}Placemark")
    nasty = next(m for m in marks if m.findtext(K + "name") == NASTY)
    html = nasty.findtext(K + "description")
    assert "<script" not in html
    cells = etree.HTML(html).xpath("//td/text()")
    assert "heading <differs> & more" in cells
    data = {e.get("name"): e.text for e in nasty.iter(K + "SimpleData")}
    assert data["file"] == NASTY


def test_control_characters_are_replaced_and_told(site, tmp_path):
    photo = replace(site.photos[0].photo, id="bell\x07.jpg", doubts=("zero\x00",))
    odd = replace(site, photos=(replace(site.photos[0], photo=photo),))
    report = write_kml(odd, tmp_path / "x.kml")
    assert faults_of(tmp_path / "x.kml") == []
    (told,) = report.warnings
    assert "control characters" in told
    assert r"bell\x07.jpg" in told
    names = [e.text for _, root in documents(tmp_path / "x.kml") for e in root.iter(K + "name")]
    assert "bell\ufffd.jpg" in names


def test_photo_that_cannot_be_read_is_told(site, tmp_path):
    feedback = CollectingFeedback()
    report = write_kmz(site, tmp_path / "s.kmz", KmzOptions(), feedback)
    assert feedback.warnings == list(report.warnings)
    assert "missing.jpg" in report.warnings[0]
    with zipfile.ZipFile(tmp_path / "s.kmz") as archive:
        thumbs = [n for n in archive.namelist() if n.startswith("thumbnails/")]
        image = cv2.imdecode(np.frombuffer(archive.read(thumbs[0]), np.uint8), -1)
    assert len(thumbs) == 2
    assert image.shape == (384, 512, 3)


def test_without_thumbnails_and_mosaic_it_is_small(site, tmp_path):
    options = KmzOptions(thumbnails=False, overlay="none")
    write_kmz(site, tmp_path / "s.kmz", options, CollectingFeedback())
    with zipfile.ZipFile(tmp_path / "s.kmz") as archive:
        names = archive.namelist()
    icons = ["camera", "arrow", "legend", "accuracy"]
    assert names == ["doc.kml", *(f"files/{name}.png" for name in icons)]


def test_small_mosaic_is_one_picture_in_place(tmp_path):
    write_photos(tmp_path)
    frame = make_frame("EPSG:32617")
    mosaic = write_mosaic(tmp_path / "m.tif", frame, width=300, height=240)
    site = make_site(tmp_path, mosaic=mosaic)
    write_kmz(site, tmp_path / "s.kmz", KmzOptions(), CollectingFeedback())
    assert faults_of(tmp_path / "s.kmz") == []
    root = dict(documents(tmp_path / "s.kmz"))["doc.kml"]
    overlays = root.findall(f".//{K}GroundOverlay")
    assert [o.findtext(f"{K}Icon/{K}href") for o in overlays] == ["mosaic.png"]
    sides = box(overlays[0].find(K + "LatLonBox"))
    with rasterio.open(mosaic) as ds:
        corner = np.degrees(frame.geo_from_map([ds.bounds.left, ds.bounds.top, 200.0])[:2])
    # The mosaic's top left corner is the northernmost west of the central meridian.
    assert sides["west"] == pytest.approx(corner[1], abs=1e-9)


@pytest.mark.parametrize("max_mb", [0.15, 0.4])
def test_size_is_kept_by_a_coarser_mosaic(kmz, tmp_path, max_mb):
    write_photos(tmp_path)
    site = make_site(tmp_path, crs=kmz[1], mosaic=kmz[0].parent / "mosaic.tif")
    options = KmzOptions(max_mb=max_mb, overlay="pyramid")
    write_kmz(site, tmp_path / "s.kmz", options, CollectingFeedback())
    size = (tmp_path / "s.kmz").stat().st_size
    assert size <= max_mb * 1e6
    assert any(name.startswith("mosaic/") for name, _ in documents(tmp_path / "s.kmz"))


def test_max_zoom_ends_the_pyramid(kmz, tmp_path):
    write_photos(tmp_path)
    site = make_site(tmp_path, crs=kmz[1], mosaic=kmz[0].parent / "mosaic.tif")
    options = KmzOptions(max_zoom=1, overlay="pyramid")
    write_kmz(site, tmp_path / "s.kmz", options, CollectingFeedback())
    levels = {name.split("/")[1] for name, _ in documents(tmp_path / "s.kmz") if "/" in name}
    assert levels == {"0", "1"}


def test_too_small_a_limit_is_refused_with_the_cure(site, tmp_path):
    with pytest.raises(ExportError, match=r"max_mb = 0.001; leave out the thumbnails"):
        write_kmz(site, tmp_path / "s.kmz", KmzOptions(max_mb=0.001), CollectingFeedback())
    assert not (tmp_path / "s.kmz").exists()


def test_it_can_be_stopped(site, tmp_path):
    with pytest.raises(Cancelled):
        write_kmz(site, tmp_path / "s.kmz", KmzOptions(), CollectingFeedback(stop_at=0.1))
    assert list(tmp_path.glob("*.kmz")) == []


def test_same_site_gives_the_same_file(site, tmp_path):
    for name in ("a.kmz", "b.kmz"):
        write_kmz(site, tmp_path / name, KmzOptions(), CollectingFeedback())
    assert (tmp_path / "a.kmz").read_bytes() == (tmp_path / "b.kmz").read_bytes()


def test_superoverlay_read_by_gdal_is_the_mosaic(tmp_path):
    """Within 0.1 px and 35 dB, patch by patch; the way between is GDAL's and pyproj's."""
    frame = make_frame("EPSG:32617")
    mosaic = textured_mosaic(tmp_path / "t.tif", frame)
    site = replace(make_site(tmp_path, mosaic=mosaic), photos=(), footprints=())
    options = KmzOptions(thumbnails=False, overlay="pyramid")
    write_kmz(site, tmp_path / "s.kmz", options, CollectingFeedback())
    to_map = Transformer.from_crs(4326, 32617, always_xy=True)
    shifts, squares = [], []
    with rasterio.open(tmp_path / "s.kmz") as overlay, rasterio.open(mosaic) as ds:
        assert overlay.driver == "KMLSUPEROVERLAY"
        image = ds.read().transpose(1, 2, 0).astype(np.float32)
        read = overlay.read()
        for row in range(0, overlay.height - 256, 256):
            for col in range(0, overlay.width - 256, 256):
                if read[3, row : row + 256, col : col + 256].min() < 255:
                    continue
                u, v = np.meshgrid(col + np.arange(256) + 0.5, row + np.arange(256) + 0.5)
                x, y = to_map.transform(*on_map(overlay.transform, u, v))
                maps = [(m - 0.5).astype(np.float32) for m in on_map(~ds.transform, x, y)]
                if min(m.min() for m in maps) < 2 or max(m.max() for m in maps) > 1090:
                    continue
                wanted = cv2.remap(image, *maps, cv2.INTER_CUBIC)
                got = read[:3, row : row + 256, col : col + 256].transpose(1, 2, 0)
                got = got.astype(np.float32)
                squares.append(np.mean((got - wanted) ** 2))
                taper = cv2.createHanningWindow((256, 256), cv2.CV_32F)
                pair = [np.ascontiguousarray(p[..., 1]) for p in (got, wanted)]
                shifts.append(np.hypot(*cv2.phaseCorrelate(*pair, taper)[0]))
    assert len(shifts) >= 6
    assert max(shifts) < 0.1  # px
    assert 10.0 * math.log10(255.0**2 / np.mean(squares)) > 35.0  # dB


def textured_mosaic(path: Path, frame: MapFrame) -> Path:
    """Texture of many sizes, as ground has it, 1100 px each way, opaque."""
    rng = np.random.default_rng(11)
    image = np.zeros((1100, 1100, 3), np.float32)
    for size in (3, 6, 12, 40, 150):
        part = rng.normal(0.0, 1.0, (1100 // size + 2, 1100 // size + 2, 3)).astype(np.float32)
        image += cv2.resize(part, (1100, 1100), interpolation=cv2.INTER_CUBIC) * size**0.5
    image = np.clip(120.0 + image * (35.0 / image.std()), 0, 255).astype(np.uint8)
    left, top = frame.map_from_enu([-20.0, 20.0, 0.0])[:2]
    profile = {
        "driver": "GTiff", "width": 1100, "height": 1100, "count": 3, "dtype": "uint8",
        "crs": frame.horizontal.to_wkt(), "tiled": True,
        "transform": rasterio.Affine(0.05, 0, left, 0, -0.05, top),
    }  # fmt: skip
    with rasterio.open(path, "w", **profile) as ds:
        ds.write(image.transpose(2, 0, 1))
    return path
