"""`georef band-index`: values, masks, two cameras, and what it refuses."""

import json
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from rasterio import Affine
from tool_cases import Done, georef

from georef_gis.rasters.profile import RasterProfile
from georef_gis.rasters.writer import TiledWriter

sys.path.insert(0, str(Path(__file__).parents[1] / "mosaic"))
from band_cases import ground

UTM = "EPSG:32617"
GSD = 0.05
CORNER = (500_000.0, 4_500_000.0)
NODATA = -9999.0
NAMES = ("red", "green", "blue", "nir")
Write = Callable[..., Path]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    def _write(
        name: str, data: np.ndarray, *, names: tuple[str, ...] = (), gsd: float = GSD,
        corner: tuple[float, float] = CORNER, mask: np.ndarray | None = None, tile_size: int = 512,
    ) -> Path:  # fmt: skip
        """A map as ours are, of shape (rows, cols, bands)."""
        rows, cols, bands = data.shape
        profile = RasterProfile(
            width=cols, height=rows, transform=(gsd, 0.0, corner[0], 0.0, -gsd, corner[1]),
            crs_wkt=rasterio.CRS.from_string(UTM).to_wkt(), bands=bands, dtype=str(data.dtype),
            compression="deflate", band_descriptions=names, tile_size=tile_size, validity="mask",
        )  # fmt: skip
        with TiledWriter(tmp_path / name, profile) as writer:
            for row in range(writer.tile_rows):
                for col in range(writer.tile_cols):
                    part = np.s_[
                        row * tile_size : (row + 1) * tile_size,
                        col * tile_size : (col + 1) * tile_size,
                    ]
                    writer.write_tile(row, col, data[part], None if mask is None else mask[part])
        return tmp_path / name

    return _write


def run(*words: Any) -> dict[str, Any]:
    """Summary of a run that went well."""
    done = georef("band-index", *words, "--json")
    assert done.code == 0, done.text
    events = [json.loads(line) for line in done.text.splitlines() if line.startswith("{")]
    return next(e for e in events if e["event"] == "result")["summary"]


def refused(*words: Any) -> str:
    """The one line a run ended with."""
    done: Done = georef("band-index", *words)
    assert done.code == 2, done.text
    return done.line("georef: ")


def values(path: Path, band: int = 1) -> np.ndarray:
    with rasterio.open(path) as file:
        return file.read(band)


def colours(dtype: str = "uint8") -> np.ndarray:
    """A pixel of each kind: vegetation, soil, black, overexposed."""
    largest = np.iinfo(dtype).max
    pixels = np.array([[40, 60, 20, 160], [90, 80, 70, 110], [0, 0, 0, 0], [90, 80, 70, 255]])
    return (pixels.repeat(8, axis=0).reshape(4, 8, 4) * (largest // 255)).astype(dtype)


@pytest.mark.parametrize("dtype", ["uint8", "uint16"])
@pytest.mark.parametrize(
    ("index", "soil"),
    [
        ("ndvi", 20 / 200), ("gndvi", 30 / 190), ("blue-ndvi", 40 / 180), ("ndwi", -30 / 190),
        ("savi", 1.5 * 20 / (200 + 0.5 * 255)), ("exg", 0.0),
    ],
)  # fmt: skip
def test_values_are_those_by_hand(write: Write, index: str, soil: float, dtype: str) -> None:
    path = write("map.tif", colours(dtype), names=NAMES)
    told = run(path, "--index", index)
    found = values(path.with_name(f"map_{index}.tif"))
    # the step of 2^-13 values are rounded to
    np.testing.assert_allclose(found[1], soil, atol=2.0**-14 + 1e-7)
    uses_nir = index != "exg"
    assert (found[3] == NODATA).all() == uses_nir
    assert (found[2] == (0.0 if index == "savi" else NODATA)).all()
    assert told["clipped_share"] == (0.25 if uses_nir else 0.0)
    assert told["undefined_share"] == (0.0 if index == "savi" else 0.25)


def test_file_tells_what_it_is(write: Write) -> None:
    path = write("map.tif", colours(), names=("red", "green", "blue", "Near infrared"))
    run(path)
    with rasterio.open(path.with_name("map_ndvi.tif")) as file:
        tags = file.tags()
        assert (file.dtypes, file.nodata, file.descriptions) == (("float32",), NODATA, ("ndvi",))
        assert file.crs.to_epsg() == 32617
    assert tags["FORMULA"] == "(nir - red) / (nir + red)"
    assert tags["BANDS"] == "nir = map.tif band 4 (Near infrared), red = map.tif band 1 (red)"
    assert "no reflectances unless" in tags["RADIOMETRY"]
    assert "Rouse" in tags["SOURCE"]
    assert "colorrampshader" in path.with_name("map_ndvi.qml").read_text()


def test_bands_by_number_and_own_formula(write: Write) -> None:
    path = write("map.tif", colours())
    run(path, "--nir", 4, "--red", 1, "--expression", "(nir - 0.5*red) / b2")
    found = values(path.with_name("map_index.tif"))
    # float32
    np.testing.assert_allclose(found[0], (160 - 20) / 60, rtol=1e-6)


def test_overexposed_pixels_are_kept_on_request(write: Write) -> None:
    path = write("map.tif", colours(), names=NAMES)
    run(path, "--clipped", "keep")
    np.testing.assert_allclose(
        values(path.with_name("map_ndvi.tif"))[3], 165 / 345, atol=2.0**-14 + 1e-7
    )
    told = run(path, "--clip-at", 160)
    assert told["clipped_share"] == 0.5


def test_noise_of_overexposed_areas_does_not_make_values(write: Write) -> None:
    data = colours()
    data[3, :, 3] = [255, 254, 253, 255, 252, 251, 253, 200]
    path = write("map.tif", data, names=NAMES)
    run(path)
    found = values(path.with_name("map_ndvi.tif"))
    assert (found[3] == NODATA).tolist() == [True, True, True, True, False, False, True, False]


def test_masked_pixels_have_no_value(write: Write) -> None:
    mask = np.ones((4, 8), np.uint8)
    mask[:, :3] = 0
    path = write("map.tif", colours(), names=NAMES, mask=mask)
    assert run(path)["pixels"] == 2 * 5
    found = values(path.with_name("map_ndvi.tif"))
    assert (found[:, :3] == NODATA).all()
    assert (found[:2, 3:] != NODATA).all()


@cache
def scene(shift: tuple[float, float], size: int = 700) -> np.ndarray:
    return ground(np.random.default_rng(11), size, shift)


def eight(image: np.ndarray) -> np.ndarray:
    return np.round(20 + 200 * image).astype(np.uint8)


@pytest.mark.parametrize("shift", [(0.3, -0.2), (5.7, -3.25)])
def test_two_cameras_are_registered(
    write: Write, tmp_path: Path, shift: tuple[float, float]
) -> None:
    """An 8-bit colour map and a 16-bit NIR map of inverted contrast."""
    plain, moved = scene((0.0, 0.0)), scene(shift)
    rgb = write("rgb.tif", eight(plain)[:, :, None].repeat(3, axis=2), names=NAMES[:3])
    nir_at = np.round(60_000 - 50_000 * moved).astype(np.uint16)[:, :, None]
    nir = write("nir.tif", nir_at, names=("nir",))
    stack = tmp_path / "stack.tif"
    told = run(rgb, "--other", nir, "--bands-out", stack)
    # px; what the task asks for
    np.testing.assert_allclose(told["shift_px"], shift, atol=0.1)
    assert told["shift_applied"]
    assert np.hypot(*told["shift_left_px"]) < 0.1
    assert 0.0 < told["shift_sigma_px"] < 0.05
    with rasterio.open(stack) as file:
        assert file.dtypes == ("uint16",) * 4
        assert file.descriptions == NAMES
        inner = np.s_[10:-10, 10:-10]
        red, found = file.read(1), file.read(4)
    np.testing.assert_array_equal(red[inner], eight(plain)[inner].astype(int) * 257)
    ideal = np.round(60_000 - 50_000 * plain)
    # less wrong than unmoved, though bilinear sampling blurs: 0.84 of it for the small shift
    off = np.abs(found[inner] - ideal[inner]).mean()
    assert off < 0.9 * np.abs(nir_at[:, :, 0][inner] - ideal[inner]).mean()


def test_uneven_shift_is_a_doubt(write: Write) -> None:
    """Two quarters of the other map are displaced by 2 px: no slope explains that."""
    plain, moved = scene((0.0, 0.0)), scene((2.0, 0.0))
    low = np.arange(700) < 350
    quarters = np.where(low[:, None] ^ low[None, :], plain, moved)
    rgb = write("rgb.tif", eight(plain)[:, :, None], names=("red",))
    nir = write("nir.tif", eight(1.0 - quarters)[:, :, None], names=("nir",))
    told = run(rgb, "--other", nir)
    assert any("from place to place" in doubt for doubt in told["doubts"])
    assert not run(rgb, "--other", rgb, "--nir", "other:1")["doubts"]


def test_no_shift_is_left_alone(write: Write) -> None:
    rng = np.random.default_rng(1)
    plain = scene((0.0, 0.0), 600)
    rgb = write("rgb.tif", eight(plain)[:, :, None].repeat(3, axis=2), names=NAMES[:3])
    noisy = (60_000 - 50_000 * plain + rng.normal(0, 500, plain.shape)).astype(np.uint16)
    nir = write("nir.tif", noisy[:, :, None], names=("nir",))
    told = run(rgb, "--other", nir)
    assert not told["shift_applied"]
    assert np.hypot(*told["shift_px"]) < 0.05
    found = values(rgb.with_name("rgb_ndvi.tif")).astype(float)
    low, high = eight(plain) / 255.0, noisy / 65535.0
    # not resampled at all
    np.testing.assert_allclose(found, (high - low) / (high + low), atol=2.0**-13)


def test_other_gsd_and_extent_are_brought_to_the_grid(write: Write) -> None:
    """The other map is coarser, larger, and shifted by 0.1 m to the east."""
    whole = scene((0.0, 0.0), 900)
    part = whole[100:700, 100:700]
    coarse = whole.reshape(450, 2, 450, 2).mean(axis=(1, 3))
    rgb = write("rgb.tif", eight(part)[:, :, None].repeat(3, axis=2), names=NAMES[:3])
    corner = (CORNER[0] - 100 * GSD + 0.1, CORNER[1] + 100 * GSD)
    nir = write("nir.tif", eight(1.0 - coarse)[:, :, None], gsd=2 * GSD, corner=corner)
    told = run(rgb, "--other", nir, "--nir", "other:1")
    np.testing.assert_allclose(told["shift_px"], (0.1 / GSD, 0.0), atol=0.1)


def test_places_hold_on_request(write: Write) -> None:
    rgb = write("rgb.tif", colours()[:, :, :3], names=NAMES[:3])
    nir = write("nir.tif", colours()[:, :, 3:], names=("nir",))
    told = run(rgb, "--other", nir, "--align", "none")
    assert not any(key.startswith("shift") for key in told)
    np.testing.assert_allclose(values(rgb.with_name("rgb_ndvi.tif"))[0], 120 / 200, atol=1e-4)
    assert "give --align none" not in refused(rgb, "--other", nir).replace("with --align none", "")


def test_pair_of_different_ground_is_refused_with_figures(write: Write) -> None:
    one = eight(ground(np.random.default_rng(1), 700))[:, :, None]
    two = eight(ground(np.random.default_rng(2), 700))[:, :, None]
    a, b = write("a.tif", one, names=("red",)), write("b.tif", two, names=("nir",))
    line = refused(a, "--other", b)
    assert "a.tif and b.tif: " in line
    assert "windows" in line
    assert "--align none" in line
    assert not a.with_name("a_ndvi.tif").exists()


def test_bland_pair_is_refused_with_figures(write: Write) -> None:
    rng = np.random.default_rng(1)
    bland = [rng.normal(100, 2, (600, 600, 1)).astype(np.uint8) for _ in range(2)]
    a, b = write("a.tif", bland[0], names=("red",)), write("b.tif", bland[1], names=("nir",))
    assert "windows show edges common to both, 4 are needed" in refused(a, "--other", b)


def test_disjoint_pair_is_refused(write: Write) -> None:
    one = eight(ground(np.random.default_rng(1), 300))[:, :, None]
    a = write("a.tif", one, names=("red",))
    b = write("b.tif", one, names=("nir",), corner=(CORNER[0] + 100.0, CORNER[1]))
    assert "show no common ground" in refused(a, "--other", b)
    assert "no pixel has a value" in refused(a, "--other", b, "--align", "none")


def test_tiles_of_the_maps_do_not_change_the_values(write: Write) -> None:
    plain, moved = scene((0.0, 0.0), 600), scene((2.6, 1.3), 600)
    found = []
    for tile_size in (512, 128):
        rgb = write("rgb.tif", eight(plain)[:, :, None], names=("red",), tile_size=tile_size)
        nir = write("nir.tif", eight(1 - moved)[:, :, None], names=("nir",), tile_size=tile_size)
        run(rgb, "--other", nir)
        found.append(values(rgb.with_name("rgb_ndvi.tif")))
    np.testing.assert_array_equal(*found)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--index", "ndvi"], "nir: map.tif has 1 red, 2 green, 3 blue; say which it is, --nir"),
        (["--nir", "7"], "nir: '7' is no band; map.tif has 1 red, 2 green, 3 blue"),
        (["--nir", "other:1"], "nir: 'other:1' names no map; give --other FILE"),
        (["--nir", "that:1"], "nir: 'that:1' names no map; write NUMBER or other:NUMBER"),
        (["--expression", "rde / 2"], "there is no band 'rde'; use red"),
        (["--expression", "red /"], "expression: 'red /': at character 6 stands the end"),
        (["--index", "exg", "--target", "{map}"], "is read or written already; name another"),
        (["--index", "exg", "--white", "0"], "white: "),
    ],
)
def test_wrong_wishes_are_refused_in_one_line(write: Write, words: list[str], told: str) -> None:
    path = write("map.tif", colours()[:, :, :3], names=NAMES[:3])
    assert told in refused(path, *(word.replace("{map}", str(path)) for word in words))


def test_rotated_map_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "turned.tif"
    turned = Affine.translation(*CORNER) @ Affine.rotation(10) @ Affine.scale(GSD, -GSD)
    with rasterio.open(
        path, "w", driver="GTiff", count=4, height=4, width=8, dtype="uint8", crs=UTM,
        transform=turned,
    ) as file:  # fmt: skip
        file.write(np.moveaxis(colours(), 2, 0))
    assert "turned.tif: is not a north-up map" in refused(path, "--index", "exg")
