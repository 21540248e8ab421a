"""The main job: photos become products in their place; what holds is not made again."""

from __future__ import annotations

import csv
import math
import os
import shutil
import xml.etree.ElementTree as ET
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

import cv2
import numpy as np
import pyogrio
import pytest
import rasterio
import shapely
from pyproj import CRS, Transformer
from rasterio.warp import transform_bounds
from rio_cogeo.cogeo import cog_validate
from tool_cases import COARSE_MATCH, SAMPLE, Site, copy_site, georef, set_position, set_xmp

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def ran(
    tmp_path_factory: pytest.TempPathFactory, undrawn: Callable[[], AbstractContextManager[None]]
) -> Site:
    """The sample project, all photos, all steps, without its project.toml: as init writes it."""
    site = copy_site(tmp_path_factory.mktemp("main") / "site", 16)
    (site.folder / "project.toml").unlink()
    made = georef("init", site.folder / "photos", "--into", site.folder, "--crs", "EPSG:6601")
    assert made.code == 0, made.text
    site.set("products", gsd_m=0.25)
    site.set("tools", match=COARSE_MATCH)
    with undrawn():
        done = site.run()
    assert done.code == 0, done.text
    done.line("wrote", "mosaic.tif")
    done.line("GSD", "25.00 cm")
    return site


def test_init_finds_what_lies_beside_the_photos(ran: Site) -> None:
    text = (ran.folder / "project.toml").read_text()
    for found in (
        'dem = "dem.asc"', 'file = "control/control.csv"', 'marks = "control/marks.csv"',
        'imu = "logs/imu.csv"', 'gnss = "logs/gnss.csv"', 'sync = "logs/sync_board.log"',
        'folder = "photos"', "Found: 16 photos",
    ):  # fmt: skip
        assert found in text, found


def test_init_does_not_overwrite(ran: Site) -> None:
    done = georef("init", ran.folder / "photos", "--into", ran.folder)
    assert done.code == 2
    done.line("project.toml", "is there already")


def true_positions() -> np.ndarray:  # type: ignore[type-arg]
    """Easting and northing (EPSG:6601) of the cameras."""
    with (SAMPLE / "truth" / "poses.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    to_map = Transformer.from_crs(6319, 6601, always_xy=True)
    return np.array([to_map.transform(float(r["lon_deg"]), float(r["lat_deg"])) for r in rows])


def test_mosaic_lies_in_its_place(ran: Site) -> None:
    with rasterio.open(ran.products / "mosaic.tif") as dataset:
        assert CRS.from_wkt(dataset.crs.to_wkt()).equals(CRS(6601), ignore_axis_order=True)
        assert dataset.count == 3
        assert dataset.descriptions == ("red", "green", "blue")
        rows, cols = np.nonzero(dataset.dataset_mask())
        t = dataset.transform
    centre = np.array([t.c + t.a * cols.mean(), t.f + t.e * rows.mean()])
    off = (centre - true_positions().mean(axis=0)) * 1200 / 3937
    # 16 tags of 2.7 m that share the receiver's slow error, and 7 deg of tilt at 55 to 90 m.
    assert np.hypot(*off) < 12.0


def test_mosaic_and_orthos_are_cogs(ran: Site) -> None:
    for path in [ran.products / "mosaic.tif", *(ran.products / "orthos").glob("*1.tif")]:
        valid, errors, _ = cog_validate(path)
        assert valid, (path.name, errors)


def test_every_product_overlaps_the_mosaic(ran: Site) -> None:
    with rasterio.open(ran.products / "mosaic.tif") as dataset:
        site = shapely.box(*dataset.bounds)
        wkt = dataset.crs
    assert len(ran.orthos()) == 16
    for path in (ran.products / "orthos").glob("*.tif"):
        with rasterio.open(path) as dataset:
            assert site.buffer(5).contains(shapely.box(*dataset.bounds)), path.name
    with rasterio.open(ran.products / "overlap.tif") as dataset:
        assert dataset.dtypes == ("uint16",)
        assert dataset.read(1).max() >= 8
        bounds = transform_bounds(dataset.crs, wkt, *dataset.bounds)
    assert site.buffer(5).contains(shapely.box(*bounds))


def test_database_opens_as_layers_of_a_gis(ran: Site) -> None:
    frame = pyogrio.read_dataframe(ran.folder / "georef.gpkg", layer="footprint")
    assert len(frame) == 16
    assert frame.crs.equals(CRS(6601), ignore_axis_order=True)
    assert frame.geometry.is_valid.all()
    site_layers = {name for name, _ in pyogrio.list_layers(ran.products / "site.gpkg")}
    assert {"photos", "footprints"} <= site_layers


def test_positions_are_true_within_their_sigmas(ran: Site) -> None:
    poses = pyogrio.read_dataframe(ran.folder / "georef.gpkg", layer="pose")
    true = dict(zip((f"IMG_{i:04d}" for i in range(1, 17)), true_positions(), strict=True))
    off = np.array([
        np.hypot(p.x - true[k][0], p.y - true[k][1]) * 1200 / 3937
        for k, p in zip(poses.photo_id, poses.geometry, strict=True)
    ])  # fmt: skip
    assert np.sqrt(np.mean(off**2)) < 3.0 * math.sqrt(2.0) * 2.7


def test_second_run_skips_everything_and_touches_nothing(ran: Site) -> None:
    before = {p: p.stat().st_mtime_ns for p in ran.products.rglob("*")}
    done = ran.run()
    assert done.code == 0
    count, _, of = done.line("steps were unchanged").split()[:3]
    assert count == of
    assert {p: p.stat().st_mtime_ns for p in ran.products.rglob("*")} == before
    assert ran.litter() == []


def steps_run(text: str) -> list[str]:
    return [line.split()[0] for line in text.splitlines() if " s  (" in line]


def test_only_the_mosaic(ran: Site) -> None:
    done = ran.run("--only", "mosaic", "--force")
    assert done.code == 0
    assert steps_run(done.text) == ["mosaic"]


@pytest.mark.usefixtures("pictures_undrawn")
def test_changed_setting_reruns_what_depends_on_it(make_site: Callable[..., Site]) -> None:
    site = make_site(3).by_tags_alone()
    assert site.run().code == 0
    site.set("products", quality=60)
    done = site.run()
    ran = steps_run(done.text)
    assert {"orthos", "mosaic"} <= set(ran)
    assert not {"read_photos", "orient_direct", "footprints"} & set(ran)
    site.set("ground", sigma_m=0.2)
    assert steps_run(site.run("--only", "orient_direct").text) == ["orient_direct"]


def test_removed_photo_takes_its_ortho_along(make_site: Callable[..., Site]) -> None:
    site = make_site(4)
    steps = ("--only", "read_photos,orient_direct,footprints,orthos")
    assert site.run(*steps).code == 0
    site.photos[0].unlink()
    assert site.run(*steps).code == 0
    assert site.orthos() == {"IMG_0002", "IMG_0003", "IMG_0004"}


def test_orthos_of_some_photos_leave_the_others(make_site: Callable[..., Site]) -> None:
    site = make_site(3)
    steps = ("--only", "read_photos,orient_direct,footprints,orthos")
    assert site.run(*steps).code == 0
    others = site.products / "orthos" / "IMG_0003.tif"
    before = others.stat().st_mtime_ns
    done = georef("orthos", "--project", site.folder, "--photos", "IMG_0001*")
    assert done.code == 0, done.text
    assert site.orthos() == {"IMG_0001", "IMG_0002", "IMG_0003"}
    assert others.stat().st_mtime_ns == before


def test_band_names_of_a_nir_camera(make_site: Callable[..., Site]) -> None:
    site = make_site(3, band_names=["NIR", "green", "blue"])
    assert site.run("--only", "read_photos,orient_direct,footprints,mosaic").code == 0
    with rasterio.open(site.products / "mosaic.tif") as dataset:
        assert dataset.descriptions == ("NIR", "green", "blue")


def test_doubt_is_told_once(site: Site) -> None:
    first = site.photos[0]
    first.write_bytes(first.read_bytes()[:60_000])
    done = site.run("--only", "read_photos,orient_direct")
    assert done.text.count(first.stem) == 1


# -- check -------------------------------------------------------------------------------------

KML = "{http://www.opengis.net/kml/2.2}"


def checked(site: Site, target: Path) -> tuple[str, list[str]]:
    done = georef("check", site.folder / "photos", "--height", 60, "--target", target)
    assert done.code == 0, done.text
    root = ET.parse(target).getroot()
    assert root.tag == f"{KML}kml"
    for text in root.iter(f"{KML}coordinates"):
        ring = np.array([[float(c) for c in p.split(",")] for p in (text.text or "").split()])
        assert shapely.Polygon(ring[:, :2]).is_valid
        np.testing.assert_allclose(ring.mean(axis=0)[:2], [-80.467, 39.0975], atol=0.002)  # deg
    return done.text, [n.text or "" for n in root.iter(f"{KML}name")]


def test_check_of_a_good_flight_has_nothing_to_fly_again(
    make_site: Callable[..., Site], tmp_path: Path
) -> None:
    text, names = checked(make_site(16), tmp_path / "again.kml")
    assert "nothing to fly again" in text
    assert names == ["Fly again"]


@pytest.mark.parametrize("size", [(7, 1), (1, 15), (5, 5)], ids=["7 px", "15 px", "focus"])
def test_check_finds_a_blurred_photo(
    make_site: Callable[..., Site], tmp_path: Path, size: tuple[int, int]
) -> None:
    site = make_site(8)
    blur(site.photos[3], size)
    text, names = checked(site, tmp_path / "again.kml")
    assert "IMG_0004: blurred" in text
    assert "IMG_0004 (blurred)" in names


def blur(path: Path, size: tuple[int, int]) -> None:
    """Smear a photo and keep its segments of tags."""
    raw = path.read_bytes()
    image = cv2.imdecode(np.frombuffer(raw, np.uint8), cv2.IMREAD_COLOR)
    smeared = cv2.blur(image, size)
    body = cv2.imencode(".jpg", smeared, [cv2.IMWRITE_JPEG_QUALITY, 90])[1].tobytes()
    at, tags = 2, b""
    while raw[at] == 0xFF and 0xE0 <= raw[at + 1] <= 0xEF:
        size = 2 + int.from_bytes(raw[at + 2 : at + 4], "big")
        tags += raw[at : at + size] if raw[at + 1] == 0xE1 else b""
        at += size
    path.write_bytes(raw[:2] + tags + body[2:])


def test_check_finds_a_hole_where_photos_are_missing(
    make_site: Callable[..., Site], tmp_path: Path
) -> None:
    """A block of 5 x 5 copies of one photo, 40 m apart, whose middle nine are missing."""
    site = make_site(1)
    (first,) = site.photos
    set_xmp(first, {"Yaw": "0", "Pitch": "0", "Roll": "0"})
    raw = first.read_bytes()
    first.unlink()
    for i in range(5):
        for j in range(5):
            if 1 <= i <= 3 and 1 <= j <= 3:
                continue
            path = first.with_name(f"IMG_{5 * i + j:04d}.JPG")
            path.write_bytes(raw)
            # 1e-4 deg are 11.1 m north and 8.6 m east.
            set_position(path, 39.0967 + 3.2e-4 * i, -80.4679 + 4.7e-4 * j)
    text, names = checked(site, tmp_path / "again.kml")
    assert "holes                        1" in text
    assert "hole 1" in names
    assert "fly again what the KML shows" in text


# -- real flights ------------------------------------------------------------------------------


@pytest.fixture
def real() -> Path:
    folder = os.environ.get("GEOREF_DATA")
    if not folder:
        pytest.skip("no real photos: set GEOREF_DATA")
    return Path(folder)


def made(real: Path, name: str, into: Path, *sets: str) -> tuple[Site, str]:
    """Project on a copy of real photos, whose products are coarse."""
    photos = into / "photos"
    photos.mkdir(parents=True)
    for path in (real / name / "photos").iterdir():
        os.link(path, photos / path.name) if same_disk(path, photos) else shutil.copy2(path, photos)
    first = georef("init", photos, "--into", into)
    assert first.code == 0, first.text
    done = georef("run", into, *(word for one in sets for word in ("--set", one)))
    assert done.code == 0, done.text
    return Site(into), done.text


def same_disk(a: Path, b: Path) -> bool:
    return a.stat().st_dev == b.stat().st_dev


COARSE = ("mosaic.gsd=0.3", "orthos.gsd=0.5")


def test_brighton_beach_untouched(real: Path, tmp_path: Path) -> None:
    site, text = made(real, "brighton_beach", tmp_path / "site", *COARSE)
    assert len(site.orthos()) == 18
    line = next(x for x in text.splitlines() if "DJI_0024.JPG ... DJI_0029.JPG" in x)
    assert line.startswith("doubt  6 photos")
    assert "rotate_photos" in line
    with rasterio.open(site.products / "mosaic.tif") as dataset:
        assert dataset.crs.to_epsg() == 32615
        west, south, east, north = transform_bounds(dataset.crs, 4326, *dataset.bounds)
    # Brighton Beach, Duluth
    assert -92.0 < west < east < -91.9
    assert 46.8 < south < north < 46.9


@pytest.mark.usefixtures("pictures_undrawn")
def test_seneca_untouched(real: Path, tmp_path: Path) -> None:
    matches = [f"match.{name}={value}" for name, value in COARSE_MATCH.items()]
    site, _ = made(real, "seneca16", tmp_path / "site", *COARSE, *matches)
    assert len(site.orthos()) >= 14
    with rasterio.open(site.products / "mosaic.tif") as dataset:
        assert dataset.crs.is_projected
        assert cog_validate(site.products / "mosaic.tif")[0]
        assert (dataset.dataset_mask() > 0).mean() > 0.3
