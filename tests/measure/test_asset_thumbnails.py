"""Pictures of assets: the right place, the right scale, safe names."""

from __future__ import annotations

import math
import uuid
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from georef_gis.measure.assets.thumbnails import (
    SIZE,
    SPAN,
    Sight,
    best_sight,
    remove_others,
    thumbnail,
    thumbnail_name,
    write_thumbnails,
)

BLACK, WHITE = (0, 0, 0), (255, 255, 255)


def photo(rows: int = 600, cols: int = 900, bands: int = 3) -> NDArray[Any]:
    return np.full((rows, cols, bands), 90, np.uint8)


def spot(image: NDArray[Any], u: int, v: int, radius: int = 3) -> NDArray[Any]:
    cv2.circle(image, (u, v), radius, WHITE, -1)
    return image


def sight(*uv: tuple[float, float], gsd: float = math.nan, closed: bool = False) -> Sight:
    return Sight(photo_id="p", path=Path("p"), uv=np.array(uv, float), gsd=gsd, closed=closed)


def middle_of_white(picture: NDArray[Any]) -> NDArray[Any]:
    rows, cols = np.nonzero(np.all(picture > 200, axis=2))
    return np.array([cols.mean(), rows.mean()])


@pytest.mark.parametrize("gsd", [0.005, 0.02, 0.06, 0.3, math.nan])
@pytest.mark.parametrize("at", [(450, 300), (5, 4), (897, 595)])
def test_asset_is_in_the_middle_of_its_picture(gsd: float, at: tuple[int, int]) -> None:
    radius = 12 if gsd == 0.005 else 3
    picture = thumbnail(spot(photo(), *at, radius=radius), sight(at, gsd=gsd))
    assert picture.shape == (SIZE, SIZE, 3)
    # the spot lies inside the cross, which leaves the middle free; half a pixel of the photo
    scale = SIZE / max(SPAN / gsd if gsd == gsd else 256.0, 64.0)
    if radius * scale < 60:
        inner = picture[130:190, 130:190]
        assert middle_of_white(inner) + 130 == pytest.approx(
            [(SIZE - 1) / 2] * 2, abs=max(0.5 * scale, 2.5)
        )


@pytest.mark.parametrize("u", [450.0, 450.25, 450.5, 451.0])
@pytest.mark.parametrize(("size", "grey"), [(64, 1.0), (1024, 0.6)])
def test_middle_of_the_picture_is_the_pixel_that_was_clicked(
    u: float, size: int, grey: float
) -> None:
    # a photo whose grey tells the column, reduced to a quarter or enlarged four times
    image = photo()
    image[...] = np.clip(128 + 3 * (np.arange(900) - 450), 0, 255)[None, :, None]
    picture = thumbnail(image, sight((u, 300.0)), size=size)
    middle = picture[size // 2 - 2 : size // 2 + 2, size // 2 - 2 : size // 2 + 2]
    # greys are whole numbers, those of reduced photos rounded twice: a third of a pixel
    assert middle.mean() == pytest.approx(128 + 3 * (u - 450), abs=grey)


@pytest.mark.parametrize(("gsd", "length"), [(0.02, 1.0), (0.2, 2.0), (0.003, 1.0)])
def test_bar_is_as_long_as_it_says(gsd: float, length: float) -> None:
    picture = thumbnail(photo(), sight((450.0, 300.0), gsd=gsd))
    yellow = np.all(picture == (255, 235, 0), axis=2)
    cols = np.flatnonzero(yellow[SIZE - 14])
    metres_per_pixel = max(SPAN / gsd, 64.0) * gsd / SIZE
    # ends are strokes of 2 px
    assert np.ptp(cols) * metres_per_pixel == pytest.approx(length, abs=3 * metres_per_pixel)


def test_line_is_shown_whole() -> None:
    picture = thumbnail(photo(), sight((100.0, 100.0), (800.0, 500.0), gsd=0.02))
    rows, cols = np.nonzero(np.all(picture == (255, 235, 0), axis=2))
    line = rows < SIZE - 40
    assert 0.7 * SIZE < np.ptp(cols[line]) < SIZE - 20


@pytest.mark.parametrize("bands", [1, 2, 3, 4, 5])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_any_photo_gives_a_picture(bands: int, dtype: type) -> None:
    rng = np.random.default_rng(0)
    image = (rng.random((200, 300, bands)) * 250).astype(dtype)
    picture = thumbnail(image, sight((150.0, 100.0), gsd=0.05))
    assert picture.dtype == np.uint8
    assert np.ptp(picture[:200].astype(int)) > 100


def test_place_outside_the_photo_is_dark() -> None:
    picture = thumbnail(photo(), sight((-5000.0, 300.0)))
    assert np.median(picture) == 20


@pytest.mark.parametrize("closed", [False, True])
def test_outline_of_an_area_is_closed(closed: bool) -> None:
    corners = ((300.0, 200.0), (600.0, 200.0), (600.0, 500.0), (300.0, 500.0))
    picture = thumbnail(photo(), sight(*corners, closed=closed))
    # the side from the last corner to the first; 1.3 times the area fills the picture
    left = picture[SIZE // 2, round(SIZE * (0.5 - 0.5 / 1.3)) - 2 :][:4]
    assert bool(np.any(np.all(left == (255, 235, 0), axis=1))) == closed


def test_best_sight_shows_most_and_is_sharpest() -> None:
    def seen(name: str, n: int, gsd: float) -> Sight:
        return Sight(photo_id=name, path=Path(name), uv=np.zeros((n, 2)), gsd=gsd)

    sights = [
        seen("a", 1, 0.01),
        seen("b", 2, 0.05),
        seen("c", 2, 0.03),
        seen("d", 2, math.nan),
    ]
    assert best_sight(sights).photo_id == "c"


def test_every_photo_is_read_once_and_a_broken_one_is_told(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "a.jpg"), photo())
    (tmp_path / "b.jpg").write_bytes(b"no photo")
    read: list[str] = []

    def counting(path: Path) -> NDArray[Any]:
        from georef_gis.rasters.reading import read_image

        read.append(path.name)
        return read_image(path)

    sights = {
        f"id-{k}": Sight(photo_id=name, path=tmp_path / name, uv=np.array([[40.0, 30.0]]))
        for k, name in enumerate(["a.jpg", "b.jpg", "a.jpg"])
    }
    files, notes = write_thumbnails(sights, tmp_path / "out", read=counting)
    assert read == ["a.jpg", "b.jpg"]
    assert sorted(path.name for path in files.values()) == ["id-0.jpg", "id-2.jpg"]
    assert cv2.imread(str(files["id-0"])).shape == (SIZE, SIZE, 3)
    assert len(notes) == 1
    assert "b.jpg" in notes[0]


@pytest.mark.parametrize("name", ["../../etc/passwd", "a/b", "", "x" * 300, "\ud800", "a\0b", "é"])
def test_id_that_a_gis_user_wrote_is_no_path(name: str) -> None:
    found = thumbnail_name(name)
    assert Path(found).name == found
    assert len(found) == 36
    assert found.isascii()


def test_pictures_of_assets_that_are_no_more_are_removed_and_nothing_else(tmp_path: Path) -> None:
    ids = [str(uuid.UUID(int=k)) for k in range(3)]
    names = [thumbnail_name(one) for one in (*ids, "written by ../hand")]
    for name in (*names, "mine.jpg", f"{ids[0]}.txt"):
        (tmp_path / name).touch()
    remove_others(tmp_path, ids[:2])
    left = {path.name for path in tmp_path.iterdir()}
    assert left == {*names[:2], "mine.jpg", f"{ids[0]}.txt"}
