"""Grids from the network: a store of PROJ on this machine, an honest one and a broken one."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest
from grid_cases import AREA, write_tiff

NAME = "us_noaa_g2018u0.tif"


class Quiet(SimpleHTTPRequestHandler):
    def log_message(self, format: str, *args: object) -> None:
        pass


class Store:
    """Folder that is served as PROJ's store, and its list."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        folder.mkdir()
        self.grid = write_tiff(folder / NAME)
        self.address = ""
        self.list()

    def list(self, **changes: object) -> None:
        content = self.grid.read_bytes()
        told = {
            "name": NAME, "type": "VERTICAL_OFFSET", "source_id": "us_noaa", "url": "elsewhere",
            "area_of_use": "United States (USA)", "file_size": len(content),
            "sha256sum": hashlib.sha256(content).hexdigest(), **changes,
        }  # fmt: skip
        west, south, east, north = AREA
        ring = [[west, south], [east, south], [east, north], [west, north], [west, south]]
        feature = {"type": "Feature", "properties": told,
                   "geometry": {"type": "Polygon", "coordinates": [ring]}}  # fmt: skip
        text = json.dumps({"type": "FeatureCollection", "features": [feature]})
        (self.folder / "files.geojson").write_text(text)


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Store]:
    made = Store(tmp_path / "store")
    handler = partial(Quiet, directory=str(made.folder))
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        made.address = f"http://127.0.0.1:{server.server_port}"
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        yield made
        server.shutdown()
        thread.join()


def georef(grids: Path, address: str, *words: str) -> subprocess.CompletedProcess[str]:
    """`georef grids` in a process whose PROJ has another store."""
    environment = {**os.environ, "GEOREF_GRIDS": str(grids), "PROJ_NETWORK_ENDPOINT": address,
                   "no_proxy": "127.0.0.1"}  # fmt: skip
    command = [sys.executable, "-m", "georef_gis.app", "grids", *words]
    return subprocess.run(command, capture_output=True, text=True, env=environment, timeout=120)


def left(grids: Path) -> list[str]:
    """Files in the folder without pyproj's copy of the list."""
    return sorted(p.name for p in grids.glob("*") if p.name != "files.geojson") + sorted(
        p.name for p in grids.glob(".*")
    )


def test_a_grid_is_listed_with_its_size_and_downloaded_whole(tmp_path: Path, store: Store) -> None:
    grids = tmp_path / "grids"
    listed = georef(grids, store.address, "list", "--all", "--json")
    (offered,) = json.loads(listed.stdout)["available"]
    assert offered["name"] == NAME
    assert offered["size"] == store.grid.stat().st_size
    assert offered["is_there"] is False
    done = georef(grids, store.address, "download", NAME)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(f"downloaded {NAME}: heights, lat 38 to 42, lon -85 to -81 deg")
    assert (grids / NAME).read_bytes() == store.grid.read_bytes()
    assert left(grids) == [NAME]
    # over what is there: the same
    assert georef(grids, store.address, "download", NAME).returncode == 0


def test_what_is_not_as_the_list_says_is_refused_and_nothing_is_left(
    tmp_path: Path, store: Store
) -> None:
    store.list(sha256sum="0" * 64)
    done = georef(tmp_path / "grids", store.address, "download", NAME)
    assert done.returncode == 2
    assert "sha256" in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert left(tmp_path / "grids") == []


def test_a_grid_that_proj_cannot_use_is_refused_and_nothing_is_left(
    tmp_path: Path, store: Store
) -> None:
    store.grid.write_bytes(b"a page of words")
    store.list()
    done = georef(tmp_path / "grids", store.address, "download", NAME)
    assert (done.returncode, len(done.stderr.splitlines())) == (2, 1)
    assert "damaged" in done.stderr
    assert left(tmp_path / "grids") == []


def test_an_unknown_or_lost_grid_is_one_line(tmp_path: Path, store: Store) -> None:
    done = georef(tmp_path / "grids", store.address, "download", "no_such.tif")
    assert done.returncode == 2
    assert "no grid 'no_such.tif' is offered" in done.stderr
    store.grid.unlink()
    done = georef(tmp_path / "grids", store.address, "download", NAME)
    assert done.returncode == 2
    assert "answers 404" in done.stderr
    assert left(tmp_path / "grids") == []


@pytest.mark.parametrize("words", [("download", NAME), ("list", "--all")])
def test_without_a_network_it_is_one_line_with_the_way_round(
    tmp_path: Path, words: tuple[str, ...]
) -> None:
    done = georef(tmp_path / "grids", "http://127.0.0.1:9", *words)
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert "cannot be had from the network" in line
    assert "georef grids add FILE" in line
    assert left(tmp_path / "grids") == []
