"""Tiles with what is to be known of them: whether they hold for a later run, what seams tell."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mosaic_cases import TERRAIN, Scene
from PIL import Image
from test_mosaic_job import scene_and_job

from georef_gis.errors import InputError
from georef_gis.model.grid import Window
from georef_gis.model.plan import plan_tiles
from georef_gis.mosaic.job import MosaicJob, PhotoRoot, read_photo
from georef_gis.mosaic.job_worker import OpenJob
from georef_gis.mosaic.seam_mismatch import MismatchProbe
from georef_gis.mosaic.seam_steps import SeamPlaces
from georef_gis.mosaic.tile_maker import TileMaker


@pytest.fixture
def row(tmp_path: Path, rng: np.random.Generator) -> tuple[Scene, MosaicJob]:
    """Three photos in a row, of which the outer ones have 40 m of 120 m in common; small tiles."""
    scene, job = scene_and_job(tmp_path / "photos", TERRAIN, rng)
    rings = {key: found.ring_map for key, found in scene.prints.items()}
    scene.plan = plan_tiles(scene.grid, rings, tile_size=128)
    return scene, job


def broken_file(path: Path) -> None:
    path.write_bytes(b"nothing")


def other_bands(path: Path) -> None:
    Image.fromarray(np.zeros((400, 600), np.uint8)).save(path)


def wholes(maker: TileMaker | OpenJob, scene: Scene) -> list[bool]:
    """Which tiles hold for a later run."""
    tasks = scene.plan.tiles
    if isinstance(maker, OpenJob):
        return [maker.tile(k, ()).whole for k in range(len(tasks))]
    return [maker.make(maker.sketch(task)).whole for task in tasks]


@pytest.mark.parametrize("worker", [False, True])
def test_tiles_that_an_unreadable_photo_touches_do_not_hold(
    row: tuple[Scene, MosaicJob], tmp_path: Path, worker: bool
) -> None:
    scene, job = row
    broken_file(tmp_path / "photos" / "2.png")
    broken: list[str] = []
    maker: TileMaker | OpenJob = TileMaker(job, read_photo, broken)
    if worker:
        maker = OpenJob(job, scene.plan.tiles, PhotoRoot(here=tmp_path / "photos"))
    # it is known to be lost once the first tile has asked for it
    wholes(maker, scene)
    touched = ["2" in task.photo_ids for task in scene.plan.tiles]
    assert 0 < sum(touched) < len(touched)
    assert wholes(maker, scene) == [not at for at in touched]


@pytest.mark.parametrize("spoil", [other_bands, lambda path: None], ids=["refused", "readable"])
def test_tiles_that_would_be_the_same_another_time_hold(
    row: tuple[Scene, MosaicJob], tmp_path: Path, spoil: Callable[[Path], None]
) -> None:
    """A photo of other bands is left out whenever it is read."""
    scene, job = row
    spoil(tmp_path / "photos" / "1.png")
    broken: list[str] = []
    assert all(wholes(TileMaker(job, read_photo, broken), scene))
    assert len(broken) == (spoil is other_bands)


def probed(job: MosaicJob) -> MosaicJob:
    """The job with a place between the first two photos and one between the last two."""
    places = SeamPlaces(
        a=np.array([0, 1]), b=np.array([1, 2]), col=np.array([24, 37]), row=np.array([12, 12])
    )
    return replace(job, probe=MismatchProbe(places, factor=16, gsd=0.2))


def shifts_of(maker: Any, scene: Scene, order: slice) -> dict[int, float | None]:
    found: dict[int, float | None] = {}
    for task in scene.plan.tiles[order]:
        tile = maker.make(maker.sketch(task))
        assert not found.keys() & dict(tile.shifts).keys()
        found |= dict(tile.shifts)
    return found


def test_every_place_is_measured_once_whatever_the_order(
    row: tuple[Scene, MosaicJob], tmp_path: Path
) -> None:
    scene, job = row
    # one picture of the ground, of which each photo shows its part
    large = np.random.default_rng(2).integers(0, 255, (400, 1000, 3), np.uint8)
    for k in range(3):
        part = large[:, 200 * k : 200 * k + 600]
        Image.fromarray(np.roll(part, 3 * (k == 2), axis=0)).save(tmp_path / f"photos/{k}.png")
    job = probed(job)
    first = shifts_of(TileMaker(job, read_photo, []), scene, slice(None))
    other = shifts_of(TileMaker(job, read_photo, []), scene, slice(None, None, -1))
    assert first == other
    # photos 200 px apart are 40 m apart on the map but for its scale of 0.9999: a fraction of a
    # pixel; the last photo's ground lies 3 px of 0.2 m aside
    assert first[0] == pytest.approx(0.0, abs=0.05)
    assert first[1] == pytest.approx(0.6, abs=0.05)


def test_a_lost_photo_tells_nothing_and_is_not_asked_for_again(
    row: tuple[Scene, MosaicJob],
) -> None:
    scene, job = row
    asked: list[str] = []

    def read(path: Path, reduce: int) -> Any:
        asked.append(path.stem)
        if path.stem == "1":
            raise InputError("cannot be read", source=path.name)
        return read_photo(path, reduce)

    found = shifts_of(TileMaker(probed(job), read, []), scene, slice(None))
    assert found == {0: None, 1: None}
    assert asked.count("1") == 1


def test_seams_are_measured_where_a_tile_has_pixels(row: tuple[Scene, MosaicJob]) -> None:
    """What shows nothing is made again by a run that goes on: it would be measured twice."""
    scene, job = row
    job = probed(job)
    maker = TileMaker(job, read_photo, [])
    task = replace(scene.plan.tiles[0], photo_ids=())
    assert job.probe is not None
    everything = Window(col=0, row=0, width=4096, height=4096)
    assert len(job.probe.measure(everything, lambda label, window: None)) == 2
    made = maker.make(maker.sketch(replace(task, window=everything)))
    assert made.pixels is None
    assert made.shifts == ()
