"""Bad input: one line that names file, field, value and cure, and the rest of the batch goes on."""

from __future__ import annotations

import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from tool_cases import SAMPLE, Site, georef, georef_process, set_gps, set_position, set_xmp

# All of these run real steps on a few photos.
pytestmark = pytest.mark.slow

STEPS = ("--only", "read_photos,orient_direct,footprints,mosaic")
FIRST_STEPS = ("--only", "read_photos,orient_direct,footprints")


def names(site: Site) -> list[str]:
    return [path.stem for path in site.photos]


# -- one bad photo never stops the batch ---------------------------------------------------------


def no_gps(path: Path) -> None:
    set_gps(path)


def gps_zero(path: Path) -> None:
    set_position(path, 0.0, 0.0)


def swapped(path: Path) -> None:
    set_position(path, -80.467, 39.0975)


def elsewhere(path: Path) -> None:
    set_position(path, 40.5, -80.467)


def truncated(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def no_image(path: Path) -> None:
    path.write_bytes(np.random.default_rng(7).bytes(20_000))


def empty(path: Path) -> None:
    path.write_bytes(b"")


def header_only(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:300])


def horizontal(path: Path) -> None:
    set_xmp(path, {"Pitch": "85.0", "Roll": "0.0"})


def on_the_ground(path: Path) -> None:
    set_gps(path, GPSAltitude=(3110, 10))


def underground(path: Path) -> None:
    set_gps(path, GPSAltitude=(100, 1))


def folder_instead(path: Path) -> None:
    path.unlink()
    path.mkdir()


def dangling(path: Path) -> None:
    path.unlink()
    path.symlink_to("not_there.jpg")


LEFT_OUT = {
    "no GPS": (no_gps, ("GPS", "[poses] file")),
    "GPS (0, 0)": (gps_zero, ("GPS", "[poses] file")),
    "latitude and longitude swapped": (swapped, ("GPS", "km from the other", "swapped")),
    "150 km off": (elsewhere, ("GPS", "40.5000", "km from the other photos")),
    "truncated": (truncated, ("cut off", "copy it again")),
    "no image": (no_image, ("leave",)),
    "empty": (empty, ("empty",)),
    "header only": (header_only, ()),
    "horizontal": (horizontal, ("pitch", "straight down")),
    "on the ground": (on_the_ground, ("above the ground", "check the heights")),
    "below the ground": (underground, ("ground", "check the heights")),
    "dangling link": (dangling, ("cannot be read",)),
}


@pytest.mark.parametrize(("spoil", "words"), LEFT_OUT.values(), ids=LEFT_OUT)
def test_bad_photo_is_named_and_the_others_go_on(
    site: Site, spoil: Callable[[Path], None], words: tuple[str, ...]
) -> None:
    bad = site.photos[2]
    spoil(bad)
    # The grid of a mosaic shows whether a stray stretched the map.
    done = site.run(*(STEPS if spoil in (elsewhere, swapped) else FIRST_STEPS))
    assert done.code == 0, done.text
    line = done.line(bad.stem, *words)
    assert line.startswith("doubt  ")
    assert "Traceback" not in done.text
    left = {row[0] for row in site.row("select photo_id from footprint")}
    assert left == set(names(site)) - {bad.stem}
    # The others lie where they lay: the map is not stretched over a stray.
    (size,) = site.row("select max(height_above_ground_m) from pose")
    assert 30.0 < size[0] < 120.0


def test_folder_named_as_a_photo_is_no_bad_photo(site: Site) -> None:
    folder_instead(site.photos[2])
    done = site.run(*STEPS)
    assert done.code == 0, done.text


def test_altitude_zero_is_named(site: Site) -> None:
    set_gps(site.photos[2], GPSAltitude=(0, 1))
    done = site.run(*STEPS)
    assert done.code == 0, done.text
    assert "altitude" in done.line(site.photos[2].stem).lower()


def test_photo_of_another_camera_and_size(site: Site) -> None:
    bad = site.photos[2]
    small = cv2.resize(cv2.imread(str(bad)), (640, 480))
    import piexif

    exif = piexif.load(str(bad))
    exif["0th"][piexif.ImageIFD.Model] = b"NX-1"
    cv2.imwrite(str(bad), small)
    exif["Exif"].pop(piexif.ExifIFD.PixelXDimension, None)
    exif["Exif"].pop(piexif.ExifIFD.PixelYDimension, None)
    piexif.insert(piexif.dump(exif), str(bad))
    done = site.run(*STEPS)
    assert done.code == 0, done.text
    done.line(bad.name, "another camera", "exclude it")


def test_two_photos_with_one_name(site: Site) -> None:
    first, second = site.photos[:2]
    below = first.parent / "card2"
    below.mkdir()
    second.rename(below / first.name)
    site.set("photos", subfolders=True)
    done = site.run("--only", "read_photos,orient_direct,footprints,orthos")
    assert done.code == 0, done.text
    done.line("2 photos", first.name, "have this name")
    assert len(site.orthos()) == 5


def test_jpg_beside_tif_of_one_name(site: Site) -> None:
    first = site.photos[0]
    other = site.photos[1]
    other.rename(first.with_suffix(".JPEG"))
    done = site.run("--only", "read_photos,orient_direct,footprints,orthos")
    assert done.code == 0, done.text
    assert len(site.orthos()) == 5


def test_all_bad_is_exit_code_2(site: Site) -> None:
    for path in site.photos:
        set_gps(path)
    # with logs the photos could do without
    site.set("logs", imu=None, gnss=None, sync=None)
    done = site.run()
    assert done.code == 2
    assert done.stderr.splitlines()[-1].startswith("georef: ")
    done.line("no photo has a GPS position", "[poses] file")


def test_all_unreadable_is_exit_code_2(site: Site) -> None:
    for path in site.photos:
        no_image(path)
    done = site.run()
    assert done.code == 2
    done.line("none of 5 photos can be used", "IMG_0001")


def test_orthos_go_on_past_a_truncated_photo(site: Site) -> None:
    truncated(site.photos[2])
    done = site.run("--only", "read_photos,orient_direct,footprints,orthos")
    assert done.code == 0, done.text
    assert site.orthos() == set(names(site)) - {site.photos[2].stem}
    done.line("IMG_0003", "cut off")


# -- settings ----------------------------------------------------------------------------------

SETTINGS = {
    "geographic CRS": ("project", {"crs": "EPSG:4326"}, ("crs", "WGS 84", "not a projected")),
    "nonsense CRS": ("project", {"crs": "EPSG:99999999"}, ("crs", "99999999", "EPSG:code")),
    "zone of another continent": ("project", {"crs": "EPSG:32733"}, ("crs", "33S", "auto")),
    "unknown key": ("camera", {"focal_pxx": 1000.0}, ("camera.focal_pxx", "focal_px?")),
    "key of another section": ("project", {"dem": "dem.asc"}, ("project.dem", "ground.dem")),
    "negative length": ("products", {"gsd_m": -1.0}, ("products.gsd_m", "-1.0")),
    "text for a number": ("ground", {"sigma_m": "small"}, ("ground.sigma_m", "'small'")),
    "no such DEM": ("ground", {"dem": "nix.tif", "height_m": None}, ("nix.tif",)),
    "no such folder": ("photos", {"folder": "nix"}, ("photos.folder", "nix")),
    "unknown geoid": ("gnss", {"geoid": "egm2050"}, ("geoid", "egm2050", "egm96")),
    "unknown datum": ("gnss", {"datum": "ITRF1850@x"}, ("datum", "ITRF1850@x")),
    "unknown dialect": ("attitude", {"dialect": "yrp"}, ("yrp",)),
    "photo to turn is not there": (
        "attitude", {"rotate_photos": {"DJI_1.JPG": 180}}, ("rotate_photos", "DJI_1.JPG")),
    "turned by 45 deg": ("attitude", {"rotate_photos": {"IMG_0001.JPG": 45}}, ("45", "180")),
    "absurd GSD": ("products", {"gsd_m": 1e-7}, ("1e-07 m", "px", "coarser")),
    "no pose file": ("poses", {"file": "geo.txt"}, ("geo.txt",)),
}  # fmt: skip


@pytest.mark.parametrize(("section", "values", "words"), SETTINGS.values(), ids=SETTINGS)
def test_wrong_setting_is_one_line(
    site: Site, section: str, values: dict[str, object], words: tuple[str, ...]
) -> None:
    site.set(section, **values)
    done = site.run(*STEPS)
    assert done.code == 2, done.text
    last = done.stderr.splitlines()[-1]
    assert last.startswith("georef: ")
    assert all(word in last for word in words), last
    assert not site.litter()


def test_broken_toml_is_one_line(site: Site) -> None:
    (site.folder / "project.toml").write_text("[project\nname = 3")
    done = site.run()
    assert done.code == 2
    done.line("project.toml", "is not valid TOML")


def test_empty_folder(site: Site) -> None:
    for path in site.photos:
        path.unlink()
    for done in (site.run(), georef("check", site.folder / "photos")):
        assert done.code == 2
        assert "photos" in done.stderr.splitlines()[-1]
        assert done.stderr.count("\n") == 1


# -- DEM ---------------------------------------------------------------------------------------


def test_dem_without_crs(site: Site) -> None:
    site.use_dem()
    (site.folder / "dem.prj").unlink()
    done = site.run(*STEPS)
    assert done.code == 2
    done.line("dem.asc", "CRS", "add a .prj")


def test_dem_elsewhere(site: Site) -> None:
    site.use_dem()
    text = (site.folder / "dem.asc").read_text()
    (site.folder / "dem.asc").write_text(text.replace("xllcorner 545890.0", "xllcorner 645890.0"))
    done = site.run(*STEPS)
    assert done.code == 2
    line = done.line("dem.asc", "does not lie under the photos", "CRS")
    assert "[ground] dem" in line
    # the site, and a place 100 km east of it
    assert "39.09" in line.split("photos, at")[1]
    assert "-79.3" in line.split("photos, at")[0]


def dem_rows(site: Site) -> tuple[list[str], list[list[str]]]:
    site.use_dem()
    lines = (site.folder / "dem.asc").read_text().splitlines()
    return lines[:6], [line.split() for line in lines[6:]]


def test_dem_with_holes(site: Site) -> None:
    head, rows = dem_rows(site)
    for row in rows[95:105]:
        row[90:110] = ["-9999"] * 20
    (site.folder / "dem.asc").write_text("\n".join([*head, *map(" ".join, rows)]) + "\n")
    done = site.run("--only", "read_photos,orient_direct,footprints,orthos,mosaic")
    assert done.code == 0, done.text
    assert len(site.orthos()) >= 3


def test_dem_that_ends_under_the_flight(site: Site) -> None:
    head, rows = dem_rows(site)
    cut = [row[:96] for row in rows]
    head[0] = "ncols 96"
    (site.folder / "dem.asc").write_text("\n".join([*head, *map(" ".join, cut)]) + "\n")
    done = site.run("--only", "read_photos,orient_direct,footprints,orthos,mosaic")
    assert done.code == 0, done.text
    done.line("doubt", "DEM")


def test_dem_of_nothing(site: Site) -> None:
    head, rows = dem_rows(site)
    none = [["-9999"] * len(row) for row in rows]
    (site.folder / "dem.asc").write_text("\n".join([*head, *map(" ".join, none)]) + "\n")
    done = site.run(*STEPS)
    assert done.code == 2
    done.line("DEM", "no height")


# -- pose files --------------------------------------------------------------------------------


def pose_file(site: Site, line: Callable[[str, int], str]) -> None:
    rows = [line(path.name, i) for i, path in enumerate(site.photos)]
    (site.folder / "geo.txt").write_text("EPSG:4326\n" + "\n".join(rows) + "\n")
    site.set("poses", file="geo.txt")


POSES = {
    "swapped": (lambda n, i: f"{n} 39.0975 -80.467 {360 + i} 70 0 0", ("swapped", "geo.txt")),
    "position in radians": (
        lambda n, i: f"{n} -1.40441{i} 0.68238{i} 360 70 0 0", ("radians", "geo.txt")),
    "angles in radians": (
        lambda n, i: f"{n} -80.467 39.0975 360 1.22{i} 0.01{i} 0.02{i}", ("radians",)),
    "no number": (lambda n, i: f"{n} -80.467 north 360 70 0 0", ("geo.txt", "north")),
    "off the Earth": (lambda n, i: f"{n} -80.467 139.0 360 70 0 0", ("139",)),
}  # fmt: skip


@pytest.mark.parametrize(("line", "words"), POSES.values(), ids=POSES)
def test_wrong_pose_file_is_one_line(
    site: Site, line: Callable[[str, int], str], words: tuple[str, ...]
) -> None:
    for path in SAMPLE.glob("photos/IMG_00[01]*.JPG"):
        shutil.copy2(path, site.folder / "photos")
    pose_file(site, line)
    done = site.run("--only", "read_photos")
    assert done.code == 2, done.text
    last = done.stderr.splitlines()[-1]
    assert all(word in last for word in words), last


def test_pose_file_of_some_photos_says_so(site: Site) -> None:
    first = site.photos[0].name
    (site.folder / "geo.txt").write_text(
        f"EPSG:4326\n{first} -80.4673752 39.0972786 366.0 71 2.8 -3.1\nghost.jpg -80 39 300 0 0 0\n"
    )
    site.set("poses", file="geo.txt")
    done = site.run("--only", "read_photos")
    assert done.code == 0, done.text
    done.line("doubt", "geo.txt", "1 of 5 photos", "1 that are not there")


# -- targets -----------------------------------------------------------------------------------


def test_products_is_a_file(site: Site) -> None:
    site.products.write_text("in the way")
    done = site.run()
    assert done.code == 2
    done.line("site", "cannot be written", "File exists")


def test_mosaic_target_is_a_folder(site: Site) -> None:
    (site.products / "mosaic.tif").mkdir(parents=True)
    done = site.run(*STEPS)
    assert done.code == 2
    done.line("mosaic.tif", "is a folder")
    assert not site.litter()


def test_orthos_is_a_file(site: Site) -> None:
    site.products.mkdir()
    (site.products / "orthos").write_text("in the way")
    done = site.run("--only", "read_photos,orient_direct,footprints,orthos")
    assert done.code == 2, done.text
    done.line("orthos", "file")


def test_kml_target_is_a_folder(site: Site, tmp_path: Path) -> None:
    (tmp_path / "again.kml").mkdir()
    done = georef(
        "check", site.folder / "photos", "--height", 55, "--target", tmp_path / "again.kml"
    )
    assert done.code == 2, done.text
    done.line("again.kml", "folder")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["again.kml", "site"]


def limited(size: int) -> Callable[[], None]:
    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))

    return limit


@pytest.mark.usefixtures("pictures_undrawn")
def test_full_target_is_one_line_and_the_next_run_mends_it(
    make_site: Callable[..., Site],
) -> None:
    site = make_site(3, compression="deflate", gsd_m=0.15).by_tags_alone()
    done = georef_process("run", site.folder, preexec_fn=limited(400_000))
    assert done.returncode == 2, done.stdout + done.stderr
    assert "bug" not in done.stderr
    assert "Traceback" not in done.stderr
    assert done.stderr.splitlines()[-1].startswith("georef: ")
    assert not site.litter()
    again = site.run()
    assert again.code == 0, again.text
    assert len(site.orthos()) == 3
    assert (site.products / "mosaic.tif").is_file()


def test_two_runs_at_once_are_kept_apart(site: Site) -> None:
    from georef_gis.project.lock import project_lock

    with project_lock(site.folder):
        done = georef_process("run", site.folder)
    assert done.returncode == 2
    assert "another run works on this project" in done.stderr


# -- stop --------------------------------------------------------------------------------------


def started(site: Site, *words: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "georef_gis.app", "run", str(site.folder), *words],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


def wait_for(condition: Callable[[], bool], seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=["Ctrl-C", "terminate"])
def test_interrupted_run_ends_promptly_with_130(
    make_site: Callable[..., Site], number: signal.Signals
) -> None:
    site = make_site(5, gsd_m=0.04).by_tags_alone()
    process = started(site)
    wait_for(lambda: (site.products / "orthos").is_dir())
    process.send_signal(number)
    begun = time.monotonic()
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130, errors
    assert time.monotonic() - begun < 10.0  # s; on a busy machine
    assert errors.splitlines()[-1] == "georef: cancelled"
    assert not site.litter()


def content(site: Site) -> dict[str, object]:
    """Products: rasters byte for byte, packages by what they hold."""
    import zipfile

    import pyogrio

    out: dict[str, object] = {}
    for path in sorted(site.products.rglob("*.tif")):
        out[path.relative_to(site.products).as_posix()] = path.read_bytes()
    for name, _ in pyogrio.list_layers(site.products / "site.gpkg"):
        frame = pyogrio.read_dataframe(site.products / "site.gpkg", layer=name)
        # The time of writing is all that may differ.
        if name == "site_metadata":
            frame = frame[frame["key"] != "made_utc"]
        out[f"site.gpkg/{name}"] = frame.drop(columns="update_time", errors="ignore").to_csv()
    with zipfile.ZipFile(site.products / "site.kmz") as archive:
        for name in archive.namelist():
            out[f"site.kmz/{name}"] = archive.read(name)
    return out


def pixels(content: bytes) -> np.ndarray:  # type: ignore[type-arg]
    """Bands of a raster; it can be read to its end."""
    from rasterio.io import MemoryFile

    with MemoryFile(content) as memory, memory.open() as raster:
        return np.asarray(raster.read()).astype(int)


def same(got: object, expected: object) -> bool:
    """Whether two runs gave the same: sums of an adjustment differ in their last digits."""
    if isinstance(got, bytes) and isinstance(expected, bytes) and got[:2] == b"II":
        a, b = pixels(got), pixels(expected)
        return a.shape == b.shape and float(np.mean(np.abs(a - b) > 2)) < 1e-3
    if isinstance(got, bytes) and isinstance(expected, bytes):
        a = cv2.imdecode(np.frombuffer(got, np.uint8), cv2.IMREAD_UNCHANGED)
        b = cv2.imdecode(np.frombuffer(expected, np.uint8), cv2.IMREAD_UNCHANGED)
        if a is not None and b is not None:
            return a.shape == b.shape and float(np.mean(np.abs(a.astype(int) - b) > 4)) < 1e-2
        got, expected = got.decode("utf-8", "replace"), expected.decode("utf-8", "replace")
    return alike(str(got), str(expected))


def alike(got: str, expected: str) -> bool:
    """Whether two texts are the same but for the last digits of their numbers."""
    import re

    number = r"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?"
    if re.sub(number, "#", got) != re.sub(number, "#", expected):
        return False
    a, b = (np.array(re.findall(number, t), dtype=float) for t in (got, expected))
    return bool(np.allclose(a, b, rtol=1e-3, atol=1e-3))


@pytest.mark.usefixtures("pictures_undrawn")
def test_killed_run_leaves_nothing_half_and_the_next_gives_the_same(
    make_site: Callable[..., Site], tmp_path: Path
) -> None:
    site = make_site(3, gsd_m=0.2).by_tags_alone()
    begun = time.monotonic()
    assert georef_process("run", site.folder).returncode == 0
    whole = time.monotonic() - begun
    expected = content(site)
    rng = np.random.default_rng(7)
    for share in rng.permutation(np.linspace(0.1, 0.9, 4)):
        for path in (site.products, site.folder / "cache"):
            shutil.rmtree(path, ignore_errors=True)
        for path in site.folder.glob("georef.gpkg*"):
            path.unlink()
        process = started(site)
        time.sleep(share * whole)
        os.kill(process.pid, signal.SIGKILL)
        process.communicate()
        # What is there is whole: a reader never sees half a raster.
        for path in site.products.rglob("*.tif"):
            if not path.name.startswith("."):
                assert pixels(path.read_bytes()).any(), path
        again = site.run()
        assert again.code == 0, again.text
        got = content(site)
        assert got.keys() == expected.keys()
        assert [key for key in got if not same(got[key], expected[key])] == []
        assert site.litter() == []
