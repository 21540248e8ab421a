"""The light KMZ in CesiumJS: a viewer that is not ours shows it, and in its place."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import rasterio
from cesium_cases import globe, seen
from kmz_assets import asset_tables
from site_cases import dot_places, make_frame, make_site, write_mosaic, write_photos

from exports.kml.light_kmz import write_light_kmz
from exports.kml.options import LightKmzOptions
from georef_gis.toolbox import CollectingFeedback

# As the page of `cesium_cases` has it
GROUND_BGR = (0x3A, 0x40, 0x33)


def test_cesium_shows_mosaic_photos_flight_and_assets_in_place(tmp_path):
    write_photos(tmp_path)
    frame = make_frame("EPSG:32617")
    mosaic = write_mosaic(tmp_path / "m.tif", frame, width=1000, height=900)
    base = make_site(tmp_path, mosaic=mosaic)
    site = replace(base, assets=asset_tables(frame, 12, ellipses=True))
    folder = tmp_path / "page"
    folder.mkdir()
    feedback = CollectingFeedback()
    write_light_kmz(site, folder / "light.kmz", LightKmzOptions(), feedback)
    with globe(folder) as (page, asked):
        found = page.evaluate("window.load('light.kmz')")
        assert found["tracks"] == 1
        assert found["points"] == 3 + 12
        assert found["polygons"] == 3 + 1 + 12
        assert found["screens"] == 2
        west, south, east, north = _around(found["boxes"])
        page.evaluate("window.onlyOverlays(true)")
        page.evaluate(f"window.look({west}, {south}, {east}, {north})")
        shot = cv2.imdecode(np.frombuffer(seen(page), np.uint8), 1)
        at = page.evaluate("window.placeAt('2026-05-01T12:00:02Z')")
        off = _dots_off(page, shot, mosaic, frame)
        lines = [_line_seen(page, view) for view in _views(west, south, east, north)]
    assert asked == []
    # px; no line of the ground below where pictures of the mosaic meet
    assert max(lines) < 30
    # px of the screen, 2 px of the mosaic each: dots of 3 px
    assert len(off) > 25
    assert np.abs(np.median(off, axis=0)).max() < 0.35
    lon, lat, big_h = _second_photo(site)
    assert at == pytest.approx([lon, lat, big_h], abs=2e-3)
    assert at[:2] == pytest.approx([lon, lat], abs=1e-8)


def _around(boxes: list[list[float]]) -> list[float]:
    west, south = np.min([b[:2] for b in boxes], axis=0)
    east, north = np.max([b[2:] for b in boxes], axis=0)
    return [float(x) for x in (west, south, east, north)]


def _views(west: float, south: float, east: float, north: float) -> list[list[float]]:
    """Views around the middle, nearer and farther: a line shows in some of them only."""
    rng = np.random.default_rng(1)
    views = []
    for _ in range(6):
        x = west + (east - west) * rng.uniform(0.4, 0.6)
        y = south + (north - south) * rng.uniform(0.4, 0.6)
        half = rng.uniform(0.04, 0.5)
        dx, dy = half * (east - west), half * (north - south)
        views.append([float(v) for v in (x - dx, y - dy, x + dx, y + dy)])
    return views


def _line_seen(page: object, view: list[float]) -> int:
    """Pixels of the longest upright or level line that is thin and of the ground's colour."""
    page.evaluate("window.look({}, {}, {}, {})".format(*view))
    for _ in range(3):
        page.evaluate("viewer.scene.render()")
    shot = cv2.imdecode(np.frombuffer(page.screenshot(), np.uint8), 1)
    ground = np.abs(shot.astype(int) - GROUND_BGR).max(axis=2) < 8
    upright = ground[:, 2:-2] & ~ground[:, :-4] & ~ground[:, 4:]
    level = ground[2:-2] & ~ground[:-4] & ~ground[4:]
    return int(max(upright.sum(axis=0).max(), level.sum(axis=1).max()))


def _dots_off(page: object, shot: np.ndarray, mosaic: Path, frame: object) -> np.ndarray:
    """Where the mosaic's dots are seen, less where Cesium puts their longitude and latitude."""
    with rasterio.open(mosaic) as ds:
        t, valid = ds.transform, ds.dataset_mask() > 0
    off = []
    for col, row in dot_places(1000, 900):
        if not valid[int(row) - 12 : int(row) + 12, int(col) - 12 : int(col) + 12].all():
            continue
        p_map = [t.a * col + t.c, t.e * row + t.f, 200.0]
        lat, lon = np.degrees(frame.geo_from_map(p_map)[:2])
        u, v = page.evaluate(f"window.pixel({lon:.12f}, {lat:.12f})")
        i, j = int(v), int(u)
        if not (8 < i < shot.shape[0] - 8 and 8 < j < shot.shape[1] - 8):
            continue
        patch = shot[i - 6 : i + 7, j - 6 : j + 7, 2].astype(float)
        weight = np.clip(patch - np.median(patch) - 30.0, 0.0, None)
        if weight.sum() < 100.0:
            off.append([9.0, 9.0])
            continue
        yy, xx = np.mgrid[i - 6 : i + 7, j - 6 : j + 7] + 0.5
        off.append([(xx * weight).sum() / weight.sum() - u, (yy * weight).sum() / weight.sum() - v])
    return np.array(off)


def _second_photo(site: object) -> tuple[float, float, float]:
    layer = site.layers["photos"]
    lon, lat = layer.places.lonlat[1]
    return float(lon), float(lat), float(layer.places.height_orthometric[1])
