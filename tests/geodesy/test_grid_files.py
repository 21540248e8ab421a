"""Grids taken into the folder: only what PROJ can use, whole or not at all."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import tifffile
from grid_cases import AREA, plane, write_gtx, write_ntv2, write_tiff

from georef_gis.errors import InputError
from georef_gis.geodesy import geoid_undulation
from georef_gis.geodesy.grid_files import add_grid, examine_grid, installed_grids, remove_grid

WRITERS = [(write_gtx, "a.gtx", "heights"), (write_tiff, "a.tif", "heights"),
           (write_ntv2, "a.gsb", "places")]  # fmt: skip
Writer = Callable[[Path], Path]


@pytest.fixture
def stick(tmp_path: Path) -> Path:
    """Folder that files come from; its name is one that PROJ's texts cannot hold."""
    folder = tmp_path / 'my, "stick" + x=y'
    folder.mkdir()
    return folder


@pytest.mark.parametrize(("write", "name", "kind"), WRITERS)
def test_a_grid_is_taken_with_its_kind_and_area(
    grids: Path, stick: Path, write: Writer, name: str, kind: str
) -> None:
    found = add_grid(write(stick / name))
    assert found.path == grids / name
    assert (found.kind, found.path.read_bytes()) == (kind, (stick / name).read_bytes())
    assert found.area == pytest.approx(AREA, abs=1e-9)  # deg
    assert [path.name for path in grids.iterdir()] == [name]
    assert (grids / name) in list(installed_grids())
    # again, from where it lies: nothing to do
    assert add_grid(grids / name).size == (stick / name).stat().st_size


@pytest.mark.parametrize(("write", "name", "kind"), WRITERS)
def test_a_grid_that_is_cut_off_is_refused(
    grids: Path, stick: Path, write: Writer, name: str, kind: str
) -> None:
    whole = write(stick / name).read_bytes()
    for share in (0.0, 0.05, 0.5, 0.93):
        (stick / name).write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(InputError, match=r"cut off|damaged|no value"):
            add_grid(stick / name)
    assert list(grids.iterdir()) == []


@pytest.mark.parametrize("name", ["a.gtx", "a.tif", "a.gsb"])
def test_bytes_that_are_no_grid_are_refused(grids: Path, stick: Path, name: str) -> None:
    rng = np.random.default_rng(7)
    for content in (b"", b"<html>not found</html>", rng.bytes(5000), bytes(5000)):
        (stick / name).write_bytes(content)
        with pytest.raises(InputError, match=r"damaged|cut off|no value"):
            add_grid(stick / name)
    assert list(grids.iterdir()) == []


def test_a_grid_with_a_spoilt_block_is_refused(grids: Path, stick: Path) -> None:
    content = bytearray(write_tiff(stick / "a.tif").read_bytes())
    with tifffile.TiffFile(stick / "a.tif") as tiff:
        first = tiff.pages.first.dataoffsets[0]
    content[first + 8 : first + 40] = bytes(32)
    (stick / "a.tif").write_bytes(content)
    with pytest.raises(InputError, match=r"damaged|no value"):
        add_grid(stick / "a.tif")
    assert list(grids.iterdir()) == []


def test_a_picture_is_no_grid(grids: Path, stick: Path) -> None:
    tifffile.imwrite(stick / "photo.tif", np.zeros((20, 20), np.uint8))
    with pytest.raises(InputError, match="damaged"):
        add_grid(stick / "photo.tif")


@pytest.mark.parametrize("name", ["a.byn", "a.txt", "a"])
def test_what_proj_does_not_read_is_refused_by_its_name(
    grids: Path, stick: Path, name: str
) -> None:
    (stick / name).write_bytes(b"x")
    with pytest.raises(InputError, match=r"PROJ reads \.tif, \.gtx, \.gsb"):
        add_grid(stick / name)


def test_a_newer_grid_replaces_the_older_one_at_once(grids: Path, stick: Path) -> None:
    at = np.radians([40.1, -82.9])
    add_grid(write_gtx(stick / "county.gtx"))
    before = geoid_undulation(*at, geoid="county.gtx")
    add_grid(write_gtx(stick / "county.gtx", shift=1.0))
    # m, of float32
    assert geoid_undulation(*at, geoid="county.gtx") - before == pytest.approx(1.0, abs=1e-5)


def test_grids_are_removed_from_the_folder_only(grids: Path, stick: Path) -> None:
    add_grid(write_gtx(stick / "county.gtx"))
    remove_grid("county.gtx")
    assert list(grids.iterdir()) == []
    for name in ("county.gtx", "../my.gtx", str(stick / "county.gtx"), ""):
        with pytest.raises(InputError, match="no grid"):
            remove_grid(name)
    assert (stick / "county.gtx").is_file()


def test_a_folder_that_is_a_file_is_told(grids: Path, stick: Path) -> None:
    grids.rmdir()
    grids.write_text("not a folder")
    with pytest.raises(InputError, match="cannot be written"):
        add_grid(write_gtx(stick / "county.gtx"))


def test_an_ntv2_grid_shifts_places_in_proj_as_written(grids: Path, stick: Path) -> None:
    """The writer of the tests, by PROJ: so that the grids above are grids."""
    from pyproj import Transformer

    path = add_grid(write_ntv2(stick / "a.gsb")).path
    step = Transformer.from_pipeline(
        "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad +step +proj=hgridshift "
        f"+grids={path.name} +step +proj=unitconvert +xy_in=rad +xy_out=deg"
    )
    lon, lat = step.transform(-83.0, 40.0)
    # longitudes of NTv2 count to the west
    assert (lat - 40.0, lon + 83.0) == pytest.approx((0.5 / 3600, 0.25 / 3600), abs=1e-9)


def test_examining_leaves_no_file(grids: Path, stick: Path) -> None:
    write_tiff(stick / "a.tif")
    examine_grid(stick / "a.tif")
    assert [path.name for path in stick.iterdir()] == ["a.tif"]
    assert math.isfinite(float(plane(40.0, -83.0)))


def test_a_dem_in_degrees_is_no_geoid(grids: Path, stick: Path) -> None:
    """Under the name of one it would give heights that are wrong by those of the ground."""
    with pytest.raises(InputError, match=r"holds \d+ m, .* is it a DEM\?"):
        add_grid(write_tiff(stick / "us_noaa_g2018u0.tif", shift=300.0))
    assert list(grids.iterdir()) == []


@pytest.mark.parametrize("name", ["us_noaa_g2018u0 (1).tif", "county ä.gtx", "A.GTX", "a,b.gtx"])
def test_a_name_that_proj_cannot_be_told_is_refused(grids: Path, stick: Path, name: str) -> None:
    write = write_tiff if name.endswith(".tif") else write_gtx
    with pytest.raises(InputError, match="give the file its own again"):
        add_grid(write(stick / name))
    assert list(grids.iterdir()) == []
    with pytest.raises(InputError, match="is a folder; give the files in it"):
        add_grid(stick)
