"""The mosaic as a file: bands, types, strangers among the photos, memory."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import rasterio
import tifffile
from click.testing import CliRunner, Result
from rasterio.enums import ColorInterp
from rio_cogeo.cogeo import cog_validate

from georef_gis.app import cli

pytestmark = pytest.mark.slow

STEPS = "read_photos,orient_direct,footprints,mosaic"
SETTINGS = """
[camera]
focal_px = {focal}
[gnss]
height_kind = "ellipsoidal"
[ground]
height_m = 200.0
height_kind = "ellipsoidal"
[poses]
file = "geo.txt"
[products]
gsd_m = {gsd}
band_names = {names}
"""


def ground(count: int, index: int, *, size: tuple[int, int], dtype: str, bands: int) -> Any:
    """Picture of smooth ground with a grain."""
    rng = np.random.default_rng(index)
    top = np.iinfo(dtype).max
    base = np.linspace(0.3, 0.6, size[0])[None, :, None] + 0.05 * index / count
    grain = 0.05 * rng.random((size[1], size[0], bands))
    return ((base + grain) * top).astype(dtype)


def make(
    folder: Path, count: int, *, size: tuple[int, int] = (600, 400), dtype: str = "uint8",
    bands: int = 3, gsd: float = 0.25, names: tuple[str, ...] = (), ending: str = ".jpg",
) -> Path:  # fmt: skip
    """Project of photos in rows of ten, 100 m over flat ground, 35 m by 30 m apart."""
    (folder / "photos").mkdir(parents=True)
    lines = ["EPSG:4326"]
    for i in range(count):
        name = f"P{i:03d}{ending}"
        if i < 10:
            image = ground(count, i, size=size, dtype=dtype, bands=bands)
            write(folder / "photos" / name, image)
        else:
            shutil.copy(folder / "photos" / f"P{i % 10:03d}{ending}", folder / "photos" / name)
        lon = -83.0 + (i % 10) * 35.0 / 85_000.0
        lat = 40.0 + (i // 10) * 30.0 / 111_000.0
        lines.append(f"{name} {lon:.8f} {lat:.8f} 300.0 0 0 0")
    (folder / "geo.txt").write_text("\n".join(lines) + "\n")
    text = SETTINGS.format(focal=size[0] / 1.2, gsd=gsd, names=json.dumps(list(names)))
    (folder / "project.toml").write_text(text)
    return folder


def write(path: Path, image: Any) -> None:
    if path.suffix == ".jpg":
        cv2.imwrite(str(path), image)
    else:
        photometric = "rgb" if image.shape[2] == 3 else "minisblack"
        data = image[..., 0] if image.shape[2] == 1 else image
        tifffile.imwrite(path, data, photometric=photometric, planarconfig="contig")


def run(folder: Path, *words: str) -> Result:
    return CliRunner().invoke(cli.georef, ["run", str(folder), "--only", STEPS, *words])


@pytest.fixture
def flight(tmp_path: Path) -> Callable[..., Path]:
    return lambda count=4, **values: make(tmp_path / "site", count, **values)


def checked(folder: Path) -> Any:
    path = folder / "products" / "mosaic.tif"
    valid, errors, _ = cog_validate(path, strict=True)
    assert valid, errors
    return rasterio.open(path)


def test_colour_photos(flight: Callable[..., Path]) -> None:
    folder = flight()
    done = run(folder)
    assert done.exit_code == 0, done.output
    with checked(folder) as dataset:
        assert (dataset.count, dataset.dtypes[0]) == (3, "uint8")
        assert dataset.descriptions == ("red", "green", "blue")
        assert dataset.overviews(1)[0] == 2
        assert 0.5 < (dataset.dataset_mask() > 0).mean() <= 1.0


CASES = {
    "16 bits": ({"dtype": "uint16", "ending": ".tif"}, 3, "uint16"),
    "one band": ({"bands": 1, "ending": ".tif"}, 1, "uint8"),
    "one band of 16 bits": ({"bands": 1, "dtype": "uint16", "ending": ".tif"}, 1, "uint16"),
    "five bands": ({"bands": 5, "ending": ".tif"}, 5, "uint8"),
}


@pytest.mark.parametrize(("values", "bands", "dtype"), CASES.values(), ids=CASES)
def test_bands_and_types(
    flight: Callable[..., Path], values: dict[str, Any], bands: int, dtype: str
) -> None:
    folder = flight(**values)
    done = run(folder)
    assert done.exit_code == 0, done.output
    with checked(folder) as dataset:
        # What cannot be JPEG with a mask has an alpha band.
        own = [i for i in dataset.colorinterp if i is not ColorInterp.alpha]
        assert (len(own), dataset.dtypes[0]) == (bands, dtype)
        data, mask = dataset.read(1), dataset.dataset_mask() > 0
    top = np.iinfo(dtype).max
    assert 0.28 * top < data[mask].min() < data[mask].max() < 0.75 * top


def test_band_names_of_nir(flight: Callable[..., Path]) -> None:
    folder = flight(names=("NIR", "green", "blue"))
    assert run(folder).exit_code == 0
    with checked(folder) as dataset:
        assert dataset.descriptions == ("NIR", "green", "blue")


@pytest.mark.parametrize("stranger", [0, 2], ids=["first", "amid"])
def test_photo_with_other_bands_is_named_and_left_out(
    flight: Callable[..., Path], stranger: int
) -> None:
    folder = flight(5, ending=".tif")
    name = f"P{stranger:03d}.tif"
    write(folder / "photos" / name, ground(5, 0, size=(600, 400), dtype="uint8", bands=1))
    done = run(folder)
    assert done.exit_code == 0, done.output
    assert [x for x in done.output.splitlines() if x.startswith("doubt") and name in x]
    with checked(folder) as dataset:
        assert dataset.count == 3


@pytest.mark.parametrize("stranger", [0, 2], ids=["first", "amid"])
def test_photo_of_other_depth_is_named_and_left_out(
    flight: Callable[..., Path], stranger: int
) -> None:
    folder = flight(5, ending=".tif")
    name = f"P{stranger:03d}.tif"
    write(folder / "photos" / name, ground(5, 0, size=(600, 400), dtype="uint16", bands=3))
    done = run(folder)
    assert done.exit_code == 0, done.output
    assert [x for x in done.output.splitlines() if x.startswith("doubt") and name in x]
    with checked(folder) as dataset:
        assert dataset.dtypes[0] == "uint8"


def test_photo_that_breaks_after_reading_its_tags(flight: Callable[..., Path]) -> None:
    """Its tags are whole, its pixels are not: its neighbours fill its place."""
    folder = flight(6)
    assert run(folder).exit_code == 0
    with checked(folder) as dataset:
        whole = (dataset.dataset_mask() > 0).sum()
    path = folder / "photos" / "P002.jpg"
    image = bytearray(path.read_bytes())
    at = image.index(b"\xff\xda")
    path.write_bytes(bytes(image[: at + 40]))
    done = CliRunner().invoke(cli.georef, ["run", str(folder), "--only", "mosaic"])
    assert done.exit_code == 0, done.output
    assert len([x for x in done.output.splitlines() if x.startswith("doubt  P002.jpg")]) == 1
    assert "warning" not in done.output
    with checked(folder) as dataset:
        assert (dataset.dataset_mask() > 0).sum() > 0.9 * whole


def test_mosaic_is_the_same_with_any_number_of_workers(flight: Callable[..., Path]) -> None:
    folder = flight(6)
    assert run(folder, "--workers", "1").exit_code == 0
    path = folder / "products" / "mosaic.tif"
    before = path.read_bytes()
    assert run(folder, "--force", "--workers", "3").exit_code == 0
    assert path.read_bytes() == before


def test_each_photo_is_decoded_about_once(flight: Callable[..., Path]) -> None:
    folder = flight(12)
    done = run(folder, "--json")
    summary = json.loads(done.stdout.splitlines()[-1])["summary"]
    assert summary["decodes_per_photo"] <= 1.1


def test_memory_does_not_grow_with_the_flight(tmp_path: Path) -> None:
    """60 photos of 6 MP are 1.1 GB of pixels; the process stays below 750 MB."""
    folder = make(tmp_path / "site", 60, size=(3000, 2000), gsd=0.06)
    first = ["run", str(folder), "--only", STEPS.removesuffix(",mosaic")]
    assert CliRunner().invoke(cli.georef, first).exit_code == 0
    status = Path("/proc/self/status")
    if not status.is_file():
        pytest.skip("the peak of a process is read from /proc")
    # Not getrusage: a child inherits the peak of the process that starts it.
    code = (
        "import sys\n"
        "from georef_gis.app.cli import georef\n"
        "try:\n    georef(sys.argv[1:])\n"
        "finally:\n    print('peak', open('/proc/self/status').read().split('VmHWM:')[1])\n"
    )
    words = ["run", str(folder), "--only", "mosaic", "--workers", "2"]
    done = subprocess.run(
        [sys.executable, "-c", code, *words], capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    assert int(done.stdout.split("peak")[1].split()[0]) * 1024 < 750e6
