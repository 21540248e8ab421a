"""A mosaic over ground from adjusted points, against one over a DEM of the same ground."""

from __future__ import annotations

import cv2
import numpy as np
from mosaic_cases import ORIGIN, frame, photo_at

from georef_gis.model.mesh import Ground
from georef_gis.model.plan import plan_tiles
from georef_gis.model.terrain import Terrain, dem_terrain
from georef_gis.model.tin import EnuPlane, SquareCells, tin_terrain
from georef_gis.mosaic.nadir import NadirMosaic, mosaic_source
from georef_gis.rectify.footprints import footprint
from georef_gis.rectify.grids import plan_grid

FRAME = frame()
PHOTOS = [photo_at(e, n, f"{e}_{n}", turn_deg=e + n) for e in (-30, 30) for n in (-20, 20)]


def heights(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.asarray(200.0 + 3.0 * np.sin(x / 15.0) * np.cos(y / 20.0))


def tin(lift: float = 0.0) -> Terrain:
    k = (np.arange(600) + 0.5) * 0.5 - 150.0
    x, y = np.meshgrid(k, -k)
    return tin_terrain(
        EnuPlane(origin=ORIGIN, level=200.0), SquareCells(left=-150.0, top=150.0, cell=0.5),
        heights(x, y) + lift, np.full((2, 2), 0.1), kind="tin", sigma=0.1, sigma_shared=0.0,
    )  # fmt: skip


def dem() -> Terrain:
    left, top = (float(v) for v in FRAME.map_from_enu([-150.0, 150.0, 0.0])[:2])
    k = (np.arange(600) + 0.5) * 0.5
    x, y = np.meshgrid(left + k, top - k)
    # heights of the same places, through enu
    p = FRAME.enu_from_map(np.stack([x, y, np.full_like(x, 200.0)], axis=-1))
    return dem_terrain(
        FRAME, heights(p[..., 0], p[..., 1]), left=left, top=top, cell=(0.5, 0.5),
        metres_per_unit=1.0,
    )  # fmt: skip


def render(terrain: Terrain) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(5)
    smooth = {
        p.id: cv2.GaussianBlur(rng.uniform(0, 255, (400, 600, 1)).astype(np.float32), (0, 0), 6.0)
        for p in PHOTOS
    }
    images = {k: (v - v.min())[..., None] / np.ptp(v) * 255 for k, v in smooth.items()}
    prints = {p.id: footprint(p, terrain, FRAME) for p in PHOTOS}
    grid = plan_grid(list(prints.values()), FRAME, gsd=0.2)
    ground = Ground.of(FRAME, grid, terrain, (190.0, 210.0))
    sources = {
        p.id: mosaic_source(p, ground, grid, prints[p.id].ring_map, reduce=1, reach=72.1)
        for p in PHOTOS
    }
    broken: list[str] = []
    mosaic = NadirMosaic(
        sources, ground, grid, gsd=0.2, read=lambda path, reduce: images[path.stem], broken=broken
    )
    out = np.zeros((grid.height, grid.width))
    mask = np.zeros(out.shape, bool)
    for task in plan_tiles(grid, {k: f.ring_map for k, f in prints.items()}).tiles:
        tile = mosaic.tile(task)
        if tile is None:
            continue
        w = task.window
        here = (slice(w.row, w.row + w.height), slice(w.col, w.col + w.width))
        out[here] = tile[0][..., 0]
        mask[here] = True if tile[1] is None else tile[1]
    assert not broken
    return out, mask


def test_mosaic_over_a_tin_is_that_over_the_dem() -> None:
    (a, in_a), (b, in_b) = render(tin()), render(dem())
    rows, cols = min(a.shape[0], b.shape[0]), min(a.shape[1], b.shape[1])
    assert abs(a.shape[0] - b.shape[0]) <= 1
    assert abs(a.shape[1] - b.shape[1]) <= 1
    both = in_a[:rows, :cols] & in_b[:rows, :cols]
    assert both.sum() > 300_000
    assert np.count_nonzero(in_a[:rows, :cols] ^ in_b[:rows, :cols]) < 0.002 * both.sum()
    a, b = a[:rows, :cols], b[:rows, :cols]
    right = np.abs(np.diff(a, axis=1))[both[:, 1:] & both[:, :-1]]
    # 0.1 px along both axes, where the picture is as steep as it gets
    assert np.abs(a - b)[both].max() < 0.2 * np.quantile(right, 0.999)
