"""Floor of a mosaic: decode every photo, one remap each, encode the mosaic's full-resolution tiles.

    python benchmarks/floor_mosaic.py PHOTO_FOLDER TILES

Nothing else is done: no tags, no geometry, no overviews, no mask, no file. The remap turns the
picture by a few degrees at its own size, with one map for all.
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np

TILE = 512


def main() -> None:
    folder, tiles = Path(sys.argv[1]), int(sys.argv[2])
    paths = sorted(p for p in folder.iterdir() if p.suffix.lower() in {".jpg", ".jpeg"})
    maps: np.ndarray | None = None
    encoded = 0
    for i, path in enumerate(paths):
        image = cv2.imdecode(np.fromfile(path, np.uint8), cv2.IMREAD_COLOR)
        rows, cols = image.shape[:2]
        if maps is None or maps.shape[:2] != (rows, cols):
            u, v = np.meshgrid(np.arange(cols, dtype=np.float32), np.arange(rows, dtype=np.float32))
            c, s = np.float32(np.cos(0.05)), np.float32(np.sin(0.05))
            maps = np.dstack([c * u - s * v + 50, s * u + c * v - 50])
        out = cv2.remap(image, maps, None, cv2.INTER_LINEAR)
        # The tiles of the mosaic, spread evenly over the photos.
        share = tiles * (i + 1) // len(paths) - tiles * i // len(paths)
        for k in range(share):
            r = k * TILE // (cols - TILE) * TILE % (rows - TILE)
            tile = out[r : r + TILE, k * TILE % (cols - TILE) :][:, :TILE]
            encoded += len(cv2.imencode(".jpg", tile, [cv2.IMWRITE_JPEG_QUALITY, 85])[1])
    print(f"{len(paths)} photos, {tiles} tiles, {encoded / 1e6:.1f} MB")


main()
