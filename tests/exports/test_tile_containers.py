"""MBTiles, PMTiles and the folder: the same tiles, found again by other programs."""

from __future__ import annotations

import json
import sqlite3
from types import SimpleNamespace

import numpy as np
import pytest
import rasterio
from pmtiles.reader import MemorySource, MmapSource, Reader, all_tiles
from pmtiles.tile import TileType, deserialize_directory
from rasterio.warp import transform
from web_tile_cases import (
    colrow_of,
    diamond,
    export,
    folder_tiles,
    make_project,
    misplacement,
    placed,
    wave_raster,
)

from exports.tiles.pmtiles import SpoolSink, directories
from georef_gis.toolbox.registry import load_registry

OWNER = "© DOT & <partners>"
ZOOMS = {"min_zoom": 18, "max_zoom": 22}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """All three containers of one mosaic, and the project."""
    project = make_project(tmp_path_factory.mktemp("containers"))
    mosaic = wave_raster(project.products / "mosaic.tif")
    paths = {
        name: export(project, name, **ZOOMS, attribution=OWNER)
        for name in ("xyz_tiles", "mbtiles", "pmtiles")
    }
    yield SimpleNamespace(
        project=project, mosaic=mosaic, tiles=folder_tiles(paths["xyz_tiles"]), **paths
    )
    project.close()


def bounds_of(path):
    """West, south, east, north of a raster by GDAL, deg; tiles round up to a pixel of 4e-7 deg."""
    with rasterio.open(path) as ds:
        from rasterio.warp import transform_bounds

        return transform_bounds(ds.crs, "EPSG:4326", *ds.bounds, densify_pts=41)


def test_names_under_products(made):
    names = [made.xyz_tiles.name, made.mbtiles.name, made.pmtiles.name]
    assert names == ["mosaic_tiles", "mosaic.mbtiles", "mosaic.pmtiles"]


def test_commands_exist():
    registry = load_registry()
    commands = {registry.command(tool) for tool in registry}
    assert {"export-xyz-tiles", "export-mbtiles", "export-pmtiles"} <= commands


def test_tilejson_of_the_folder(made):
    told = json.loads((made.xyz_tiles / "metadata.json").read_text("utf-8"))
    assert told["name"] == "Straße & <road>"
    assert told["attribution"] == OWNER
    assert told["bounds"] == pytest.approx(bounds_of(made.mosaic), abs=5e-7)
    assert {z for z, _, _ in made.tiles} == set(range(18, 23))


def test_mbtiles_holds_the_tiles_in_rows_from_the_south(made):
    with sqlite3.connect(made.mbtiles) as connection:
        rows = connection.execute("SELECT * FROM tiles").fetchall()
        told = dict(connection.execute("SELECT * FROM metadata"))
        (number,) = connection.execute("PRAGMA application_id").fetchone()
        (check,) = connection.execute("PRAGMA integrity_check").fetchone()
    connection.close()
    assert {(z, x, 2**z - 1 - y): data for z, x, y, data in rows} == made.tiles
    assert (number, check) == (0x4D504258, "ok")
    assert {
        "name",
        "format",
        "bounds",
        "center",
        "minzoom",
        "maxzoom",
        "attribution",
        "type",
    } <= set(told)
    assert (told["minzoom"], told["maxzoom"], told["type"]) == ("18", "22", "baselayer")
    bounds = [float(value) for value in told["bounds"].split(",")]
    assert bounds == pytest.approx(bounds_of(made.mosaic), abs=5e-7)
    lon, lat, zoom = map(float, told["center"].split(","))
    assert bounds[0] < lon < bounds[2]
    assert bounds[1] < lat < bounds[3]
    assert zoom == 18
    json.loads(told["json"])


def test_gdal_reads_the_mbtiles_in_place(made):
    """JPEG inside and WEBP along the rim, as one picture with transparency."""
    with rasterio.open(made.mbtiles, driver="MBTiles") as ds:
        assert ds.crs.to_epsg() == 3857
        assert ds.count == 4
        red_green_blue, alpha = ds.read([1, 2, 3]), ds.read(4)
        row, col = np.nonzero(alpha == 255)
        x = ds.transform.c + (col + 0.5) * ds.transform.a
        y = ds.transform.f + (row + 0.5) * ds.transform.e
    lon, lat = (np.array(value) for value in transform("EPSG:3857", "EPSG:4326", x, y))
    at = colrow_of(made.mosaic, lon, lat)
    inside = diamond(*at) > 10
    shift = misplacement(at[0][inside], at[1][inside], red_green_blue[:, row, col].T[inside])
    # px of the mosaic
    assert np.abs(shift).max() < 0.05
    assert inside.sum() > 50_000
    assert diamond(*at).min() > -2


def test_pmtiles_reader_finds_the_same_tiles(made):
    with made.pmtiles.open("rb") as stream:
        source = MmapSource(stream)
        reader = Reader(source)
        header, told = reader.header(), reader.metadata()
        assert {zxy: data for zxy, data in all_tiles(source)} == made.tiles
        z, x, y = max(made.tiles)
        assert reader.get(z, x, y) == made.tiles[z, x, y]
        assert reader.get(z, 0, 0) is None
    assert (header["version"], header["min_zoom"], header["max_zoom"]) == (3, 18, 22)
    assert header["tile_type"] is TileType.WEBP
    assert header["clustered"]
    assert header["addressed_tiles_count"] == len(made.tiles)
    assert header["tile_contents_count"] == len(set(made.tiles.values()))
    keys = ("min_lon_e7", "min_lat_e7", "max_lon_e7", "max_lat_e7")
    assert [header[key] / 1e7 for key in keys] == pytest.approx(bounds_of(made.mosaic), abs=5e-7)
    assert header["tile_data_offset"] + header["tile_data_length"] == made.pmtiles.stat().st_size
    assert told["attribution"] == OWNER


def test_export_again_gives_the_same_bytes(made):
    for name in ("mbtiles", "pmtiles"):
        target = made.project.products / f"again.{name}"
        again = export(made.project, name, **ZOOMS, attribution=OWNER, target=target)
        assert again.read_bytes() == getattr(made, name).read_bytes()
        again.unlink()


def test_equal_tiles_lie_in_pmtiles_once(tmp_path):
    project = make_project(tmp_path)
    placed(np.full((1, 1500, 1500), 90, np.uint8), None, project.products / "mosaic.tif")
    tiles = folder_tiles(export(project, "xyz_tiles"))
    path = export(project, "pmtiles")
    project.close()
    raw = path.read_bytes()
    source = MemorySource(raw)
    assert dict(all_tiles(source)) == tiles
    header = Reader(source).header()
    different = set(tiles.values())
    assert len(different) < 0.8 * len(tiles)
    assert header["tile_contents_count"] == len(different)
    assert header["tile_data_length"] == sum(map(len, different))
    assert header["tile_entries_count"] < header["addressed_tiles_count"]


def test_directories_of_many_tiles_are_read_back_and_the_root_fits_one_request():
    rng = np.random.default_rng(3)
    count = 60_000
    lengths = rng.integers(2000, 30_000, count)
    ids = 1_000_000 + np.cumsum(rng.integers(1, 4, count))
    offsets = np.cumsum(lengths) - lengths
    entries = np.stack([ids, offsets, lengths, np.ones(count, int)], axis=1).astype(np.uint64)
    root, leaves = directories(entries)
    assert len(root) <= 16384 - 127
    found = []
    for leaf in deserialize_directory(root):
        assert leaf.run_length == 0
        part = deserialize_directory(leaves[leaf.offset : leaf.offset + leaf.length])
        assert part[0].tile_id == leaf.tile_id
        found += [(e.tile_id, e.offset, e.length, e.run_length) for e in part]
    assert np.array_equal(np.array(found), entries.astype(int))


def test_tiles_come_in_any_order_and_lie_by_number(tmp_path):
    with (tmp_path / "spool").open("w+b") as stream:
        sink = SpoolSink(stream)
        for zoom, x, y, data in [(2, 3, 3, b"late"), (0, 0, 0, b"root"), (1, 0, 1, b"root"),
                                 (1, 0, 0, b"root")]:  # fmt: skip
            sink.put(zoom, x, y, data)
        index = sink.index()
    # Hilbert curve of zoom 1: (0, 0), (0, 1), ...: ids 1 and 2 after the root's 0
    assert index.ids.tolist()[:3] == [0, 1, 2]
    entries = index.entries().tolist()
    assert entries[0] == [0, 0, 4, 3]
    assert entries[1][1:] == [4, 4, 1]
