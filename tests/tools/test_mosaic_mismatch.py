"""How far photos lie apart at the seams: the truth, and the same whoever makes the tiles."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from mosaic_flights import ROW, Flight, Values, copied, make

from georef_gis.project import Project
from georef_gis.rasters.writer import TiledWriter

pytestmark = pytest.mark.slow

# m: of the mosaic's pixels, of the noise's cells, and by how much every other photo lies too far
# east
FINE, CELL, APART = 0.1, 0.25, 0.4
NOISE = cv2.GaussianBlur(np.random.default_rng(8).normal(0.0, 1.0, (600, 1200)), (0, 0), 1.5)
GRASS = (0.5 + 0.08 * NOISE / NOISE.std()).astype(np.float32)


def shifted(k: int, east: Values, north: Values) -> Values:
    """Grass, which every other photo shows elsewhere."""
    x = (east - APART * (k % 2) + 100.0) / CELL
    y = (north + 75.0) / CELL
    grey = cv2.remap(GRASS, x.astype(np.float32), y.astype(np.float32), cv2.INTER_CUBIC)
    return np.stack([grey, 0.9 * grey, 0.8 * grey], axis=-1).astype(np.float64)


@pytest.fixture(scope="module")
def fine(tmp_path_factory: pytest.TempPathFactory) -> Flight:
    """Four photos, 10 tiles; their proxies are there."""
    folder = tmp_path_factory.mktemp("fine") / "site"
    flight = make(folder, shifted, ROW, products={"gsd_m": FINE})
    flight.made("--workers", "1")
    return flight


@pytest.fixture
def flight(fine: Flight, tmp_path: Path) -> Iterator[Flight]:
    """The same, its mosaic still to be made."""
    flight = copied(fine, tmp_path / "site")
    flight.path.unlink()
    return flight


def told(flight: Flight) -> dict[str, Any]:
    """What the last run told; what is kept for the accuracy statement is the same."""
    found = flight.summary()["seam_mismatch"]
    project = Project.open(flight.folder, read_only=True)
    assert (project.database.meta("mosaic") or {})["seam_mismatch"] == found
    return dict(found)


def test_photos_lie_apart_at_the_seams_as_they_do(fine: Flight) -> None:
    found = told(fine)
    assert found["accepted"] > 0.7 * found["places"] > 30
    # half a pixel of the mosaic; it leans towards 0, as the ends of the squares differ
    assert found["median_m"] == pytest.approx(APART, abs=0.05)
    assert found["p90_m"] == pytest.approx(APART, abs=0.05)


def test_two_threads_tell_the_same(fine: Flight, flight: Flight) -> None:
    flight.made("--workers", "2")
    assert told(flight) == told(fine)


@pytest.mark.parametrize(("step", "count"), [("write_tile", 1), ("write_tile", 5),
                                             ("write_tile", 9), ("_finish_rest", 1)])  # fmt: skip
def test_a_run_that_goes_on_tells_the_same(
    fine: Flight, flight: Flight, monkeypatch: pytest.MonkeyPatch, step: str, count: int
) -> None:
    """After tiles of an earlier run, which it does not make again."""
    real, calls = getattr(TiledWriter, step), 0

    def stopping(*args: Any, **options: Any) -> None:
        nonlocal calls
        real(*args, **options)
        calls += 1
        if calls == count:
            raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(TiledWriter, step, stopping)
        assert flight.run("--workers", "1").code == 130
    done = flight.made()
    kept = count if step == "write_tile" else 10
    assert done.line("finished by an earlier run").split()[0] == str(kept)
    assert told(flight) == told(fine)


def test_a_cluster_tells_the_same(fine: Flight, flight: Flight) -> None:
    pytest.importorskip("distributed")
    flight.wish(seams="optimised", cluster="local:2")
    flight.made()
    assert told(flight) == told(fine)
    assert flight.path.read_bytes() == fine.path.read_bytes()
