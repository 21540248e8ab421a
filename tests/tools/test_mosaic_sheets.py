"""A diagonal corridor: what its mosaic costs, and its sheets along a centre line."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pyogrio
import pytest
import rasterio
import shapely
from mosaic_flights import EAST, LAT, LON, NORTH, Flight, copied, make
from tool_cases import Done, georef

from georef_gis.errors import Cancelled
from georef_gis.mosaic.coarse import BLOCK, SparseRaster
from georef_gis.mosaic.seamed import SeamMosaic
from georef_gis.project import Project
from georef_gis.project.geometry import from_blob
from georef_gis.toolbox import Feedback
from georef_gis.toolbox.registry import Registry
from georef_gis.toolbox.runner import run_tool

# px; photos of 30 x 20 m
SIZE = (150, 100)
# m east and north from one photo to the next
STEP = 7.0
SHORT, LONG = 16, 32
GSD = 0.05


class Cost:
    """Tiles rendered and blocks of coarse rasters made, while patched in."""

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        self.tiles, self._rasters = 0, list[SparseRaster]()
        render, init = SeamMosaic.render, SparseRaster.__init__

        def counted(mosaic: SeamMosaic, *given: Any) -> Any:
            self.tiles += 1
            return render(mosaic, *given)

        def noted(raster: SparseRaster, **given: Any) -> None:
            init(raster, **given)
            self._rasters.append(raster)

        patch.setattr(SeamMosaic, "render", counted)
        patch.setattr(SparseRaster, "__init__", noted)

    @property
    def blocks(self) -> int:
        return sum(len(list(raster)) for raster in self._rasters)

    @property
    def box(self) -> int:
        """Blocks of the same rasters over the whole bounding box."""
        return sum(-(-r.width // BLOCK) * -(-r.height // BLOCK) for r in self._rasters)


def corridor(folder: Path, photos: int) -> tuple[Flight, Cost]:
    """A mosaic of photos along 45 degrees, and what it cost."""
    flight = make(
        folder, places=[(STEP * k, STEP * k) for k in range(photos)],
        sizes=dict.fromkeys(range(photos), SIZE), products={"gsd_m": GSD},
    )  # fmt: skip
    with pytest.MonkeyPatch.context() as patch:
        cost = Cost(patch)
        flight.made()
    return flight, cost


@pytest.fixture(scope="module")
def short(tmp_path_factory: pytest.TempPathFactory) -> tuple[Flight, Cost]:
    return corridor(tmp_path_factory.mktemp("short") / "site", SHORT)


@pytest.fixture
def flight(short: tuple[Flight, Cost], tmp_path: Path) -> Flight:
    return copied(short[0], tmp_path / "site")


def test_a_diagonal_corridor_costs_its_length(short: tuple[Flight, Cost], tmp_path: Path) -> None:
    flight, cost = short
    longer, more = corridor(tmp_path / "site", LONG)
    sides = [np.array(f.summary()["size_px"]) for f in (flight, longer)]
    # else nothing would be shown
    assert (sides[1] > 1.7 * sides[0]).all()
    assert more.box > 2.5 * cost.box
    print(cost.tiles, more.tiles, cost.blocks, more.blocks, cost.box, more.box, sides)
    assert more.tiles == longer.summary()["tiles"]
    assert more.tiles <= 2 * cost.tiles
    assert more.blocks <= 2 * cost.blocks
