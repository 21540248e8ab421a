"""A mosaic's job in a file: other processes make the same tiles from it."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import fsspec
import numpy as np
import pytest
import tifffile
from mosaic_cases import TERRAIN, Scene, photo_at
from PIL import Image
from test_tin_mosaic import dem, tin

from georef_gis.errors import InputError
from georef_gis.model.mesh import Ground
from georef_gis.model.terrain import Terrain
from georef_gis.mosaic.job import MosaicJob, PhotoRoot
from georef_gis.mosaic.job_worker import (
    OpenJob,
    _check_photos,
    open_job,
    read_job,
    tile_of,
    write_job,
)
from georef_gis.mosaic.nadir import mosaic_source
from georef_gis.rasters.reading import read_image

HERE = PhotoRoot(here=Path("photos"))


def photo_files(folder: Path, rng: np.random.Generator, count: int) -> dict[str, Path]:
    folder.mkdir()
    paths = {str(k): folder / f"{k}.png" for k in range(count)}
    for path in paths.values():
        Image.fromarray(rng.integers(0, 255, (400, 600, 3), np.uint8)).save(path)
    return paths


def scene_and_job(folder: Path, terrain: Terrain, rng: np.random.Generator) -> tuple[Scene, Any]:
    """Three photos in a row, and the job of their mosaic along the nearest nadirs."""
    paths = photo_files(folder, rng, 3)
    photos = [photo_at(40.0 * k, 0.0, str(k)) for k in range(3)]
    photos = [
        replace(p, photo=replace(p.photo, path=paths[p.id], tags={"a": "b" * 1000})) for p in photos
    ]
    scene = Scene(photos, {"0": np.zeros((1, 1, 3))})
    ground = Ground.of(scene.frame, scene.grid, terrain, (190.0, 210.0))
    sources = tuple(
        mosaic_source(p, ground, scene.grid, scene.prints[p.id].ring_map, reduce=1, reach=72.1)
        for p in photos
    )
    job = MosaicJob(
        sources=sources, ground=ground, grid=scene.grid, gsd=scene.gsd, kind=(3, "uint8")
    )
    return scene, job


TERRAINS = {"flat": lambda: TERRAIN, "TIN": tin, "DEM": dem}


@pytest.mark.parametrize("terrain", TERRAINS.values(), ids=TERRAINS)
def test_tiles_from_the_file_of_a_job_are_the_same(
    tmp_path: Path, rng: np.random.Generator, terrain: Any
) -> None:
    scene, job = scene_and_job(tmp_path / "photos", terrain(), rng)
    tiles = scene.plan.tiles[:2]
    path = tmp_path / "job"
    write_job(path, job, tiles, PhotoRoot(here=tmp_path / "photos"))
    read, _, _ = read_job(path)
    assert read.sources[0].photo.photo.tags == {}
    direct = job.open(lambda path, reduce: read_image(path, reduce=reduce), [])
    for number, task in enumerate(tiles):
        found = tile_of(path, number, ()).pixels
        expected = direct.tile(task)
        assert found is not None
        assert expected is not None
        assert found[0].tobytes() == expected[0].tobytes()
        assert (found[1] is None) == (expected[1] is None)
        if found[1] is not None and expected[1] is not None:
            assert found[1].tobytes() == expected[1].tobytes()
    assert open_job(path) is open_job(path)


def test_a_worker_decodes_each_photo_once_and_tells_what_it_cannot_read(
    tmp_path: Path, rng: np.random.Generator
) -> None:
    scene, job = scene_and_job(tmp_path / "photos", TERRAIN, rng)
    (tmp_path / "photos" / "1.png").write_bytes(b"nothing")
    numbers = range(len(scene.plan.tiles))
    opened = OpenJob(job, scene.plan.tiles, PhotoRoot(here=tmp_path / "photos"))
    done = [opened.tile(k, numbers[k + 1 :]) for k in numbers]
    assert done[-1].decodes == 2
    assert done[-1].broken == ("1.png: is not an image or is damaged; leave it out",)


def test_a_tile_does_not_depend_on_whether_a_broken_photo_was_found_before(
    tmp_path: Path, rng: np.random.Generator
) -> None:
    """The first tile lies within the broken photo, whose mesh is the finer, but needs no pixel."""
    scene, job = scene_and_job(tmp_path / "photos", TERRAIN, rng)
    fine = replace(job.sources[2], step=job.sources[2].step // 8)
    job = replace(job, sources=(*job.sources[:2], fine))
    (tmp_path / "photos" / "2.png").write_bytes(b"nothing")

    def pixels(order: Sequence[int]) -> dict[int, bytes]:
        opened = OpenJob(job, scene.plan.tiles, PhotoRoot(here=tmp_path / "photos"))
        found = {k: opened.tile(k, ()) for k in order}
        assert any(done.broken for done in found.values())
        return {k: done.pixels[0].tobytes() if done.pixels else b"" for k, done in found.items()}

    numbers = range(len(scene.plan.tiles))
    assert pixels(numbers) == pixels(numbers[::-1])


def test_a_job_of_another_version_is_refused(
    tmp_path: Path, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene, job = scene_and_job(tmp_path / "photos", TERRAIN, rng)
    write_job(tmp_path / "job", job, scene.plan.tiles, HERE)
    monkeypatch.setattr("georef_gis.__version__", "0.0.9")
    with pytest.raises(InputError, match=r"the worker has georef_gis 0\.0\.9, .*same versions"):
        read_job(tmp_path / "job")


def test_a_worker_that_does_not_see_the_folders_says_which(
    tmp_path: Path, rng: np.random.Generator
) -> None:
    with pytest.raises(InputError, match=r"does not see .*gone.*; put the project on a folder"):
        read_job(tmp_path / "gone")
    _, job = scene_and_job(tmp_path / "photos", TERRAIN, rng)
    elsewhere = PhotoRoot(here=tmp_path / "photos", there=str(tmp_path / "other"))
    with pytest.raises(InputError, match=r"does not see the photos' folder .*other; share"):
        _check_photos(job, elsewhere)


def jpeg(image: np.ndarray) -> bytes:
    file = io.BytesIO()
    Image.fromarray(image).save(file, "JPEG")
    return file.getvalue()


def tiff(image: np.ndarray) -> bytes:
    file = io.BytesIO()
    tifffile.imwrite(file, image, photometric="rgb")
    return file.getvalue()


def png(image: np.ndarray) -> bytes:
    file = io.BytesIO()
    Image.fromarray(image).save(file, "PNG")
    return file.getvalue()


@pytest.mark.parametrize("kind", [jpeg, tiff, png])
def test_photos_in_object_storage_are_those_of_the_disk(
    tmp_path: Path, rng: np.random.Generator, kind: Any
) -> None:
    raw = kind(rng.integers(0, 255, (40, 60, 3), np.uint8))
    path = tmp_path / "photos" / "east" / "a.img"
    path.parent.mkdir(parents=True)
    path.write_bytes(raw)
    with fsspec.open("memory://site/east/a.img", "wb") as file:
        file.write(raw)
    stored = PhotoRoot(here=tmp_path / "photos", there="memory://site/")
    for reduce in (1, 2):
        np.testing.assert_array_equal(stored.read(path, reduce), read_image(path, reduce=reduce))


def test_photos_elsewhere_are_found_or_named(tmp_path: Path) -> None:
    here = tmp_path / "photos"
    moved = PhotoRoot(here=here, there="/mnt/site/")
    assert moved.place(here / "east" / "a.jpg") == "/mnt/site/east/a.jpg"
    assert moved.place(tmp_path / "b.jpg") == str(tmp_path / "b.jpg")
    assert PhotoRoot(here=here).place(here / "a.jpg") == str(here / "a.jpg")
    with pytest.raises(InputError, match=r"^a\.jpg: cannot be read \(.*\); check photos_root$"):
        PhotoRoot(here=here, there="memory://site").read(here / "a.jpg", 1)
    with pytest.raises(InputError, match=r"^a\.jpg: .*nowhere.*check photos_root$"):
        PhotoRoot(here=here, there="nowhere://site").read(here / "a.jpg", 1)
