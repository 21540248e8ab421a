"""Photos of two places in one folder: one line, and no map that spans both."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path

import piexif
import pytest
from tool_cases import Site, georef, set_position

from georef_gis.ellipsoid import WGS84_A
from georef_gis.model.photo import Geotag, Photo
from processing_algorithms.ingest.outliers import without_strays

STEPS = ("--only", "read_photos,orient_direct,footprints,mosaic")
LAT, LON = math.radians(39.0), math.radians(-80.0)


def photos_at(*east_north_m: tuple[float, float]) -> list[Photo]:
    """Photos P0, P1, ... about one place."""
    out = []
    for i, (east, north) in enumerate(east_north_m):
        tag = Geotag(lat=LAT + north / WGS84_A, lon=LON + east / WGS84_A / math.cos(LAT))
        name = f"P{i}"
        out.append(Photo(id=name, path=Path(f"{name}.JPG"), width=4, height=3, geotag=tag))
    return out


def line_of(count: int, start: float = 0.0, spacing: float = 20.0) -> list[tuple[float, float]]:
    return [(start + spacing * i, 0.0) for i in range(count)]


def judged(places: list[tuple[float, float]]) -> tuple[list[str], list[str]]:
    kept, lines = without_strays(photos_at(*places))
    return [photo.id for photo in kept], lines


def test_one_site_says_nothing() -> None:
    kept, lines = judged(line_of(12))
    assert len(kept) == 12
    assert lines == []


@pytest.mark.parametrize("count", [1, 2, 7])
def test_a_photo_fifty_km_off_is_left_out_and_named(count: int) -> None:
    kept, (line,) = judged([*line_of(count), (50_000.0, 0.0)])
    assert kept == [f"P{i}" for i in range(count)]
    assert line.startswith(f"P{count}.JPG: GPS: 39.0000, -79.4")
    assert "lies 50 km from the other photo" in line
    assert "left out; check it for swapped latitude and longitude" in line


def test_the_smaller_of_two_sites_is_left_out_in_one_line() -> None:
    kept, (line,) = judged([*line_of(4, start=30_000.0), *line_of(5)])
    assert kept == [f"P{i}" for i in range(4, 9)]
    assert line.startswith("P0.JPG, P1.JPG, P2.JPG and 1 more: GPS: ")
    assert "lie 30 km from the other photos: left out" in line
    assert "project of its own" in line
    assert "[photos] exclude" in line


def test_of_two_sites_of_one_size_the_first_stays() -> None:
    kept, lines = judged([*line_of(3), *line_of(3, start=30_000.0)])
    assert kept == ["P0", "P1", "P2"]
    assert len(lines) == 1


def test_fields_a_few_km_apart_are_kept_and_told() -> None:
    kept, (line,) = judged([*line_of(5), *line_of(4, start=3_080.0)])
    assert len(kept) == 9
    assert "lie 3.0 km from the other photos: kept, the maps span both" in line


def test_a_chain_of_fields_is_one_site() -> None:
    """Each 4 km from the next, the last 12 km from the first."""
    kept, lines = judged([place for k in range(4) for place in line_of(3, start=4_000.0 * k)])
    assert len(kept) == 12
    assert len(lines) == 3


def test_a_long_corridor_is_one_site() -> None:
    kept, lines = judged(line_of(400, spacing=150.0))
    assert (len(kept), lines) == (400, [])


def test_photos_from_high_up_may_lie_far_apart() -> None:
    kept, lines = judged(line_of(6, spacing=8_000.0))
    assert (len(kept), lines) == (6, [])


def test_photos_without_a_position_stay() -> None:
    lost = Photo(id="lost", path=Path("lost.JPG"), width=4, height=3)
    kept, lines = without_strays([lost, *photos_at(*line_of(3), (40_000.0, 0.0))])
    assert [photo.id for photo in kept] == ["lost", "P0", "P1", "P2"]
    assert len(lines) == 1


# -- on photos -----------------------------------------------------------------------------------


def move(path: Path, km: float) -> None:
    """Take a photo's position to the north."""
    gps = piexif.load(str(path))["GPS"]
    lat, lon = (
        sum(n / d / 60**k for k, (n, d) in enumerate(gps[tag]))
        for tag in (piexif.GPSIFD.GPSLatitude, piexif.GPSIFD.GPSLongitude)
    )
    set_position(path, lat + km / 111.0, -lon)


@pytest.mark.slow
def test_a_second_site_neither_stops_a_run_nor_stretches_the_mosaic(
    make_site: Callable[..., Site],
) -> None:
    site = make_site(5)
    site.set("logs", imu=None, gnss=None, sync=None)
    for path in site.photos[3:]:
        move(path, 50.0)
    done = site.run(*STEPS)
    assert done.code == 0, done.text
    line = done.line("IMG_0004.JPG, IMG_0005.JPG", "50 km from the other photos", "left out")
    assert line.startswith("doubt")
    ((summary,),) = site.row("select summary from run where tool = 'georef:mosaic'")
    # px of 0.3 m: three photos of 55 m and their spacing
    assert max(json.loads(summary)["size_px"]) < 700


@pytest.mark.slow
def test_check_and_init_tell_of_a_second_site(make_site: Callable[..., Site]) -> None:
    site = make_site(5)
    move(site.photos[4], 50.0)
    into = site.folder / "new"
    for words in (
        ("check", site.folder / "photos", "--target", site.folder / "again.kml"),
        ("init", site.folder / "photos", "--into", into),
    ):
        done = georef(*words)
        assert done.code == 0, done.text
        assert done.text.count("km from the other photos") == 1, done.text
        done.line("IMG_0005.JPG", "50 km from the other photos", "project of its own")
    assert (into / "project.toml").is_file()
