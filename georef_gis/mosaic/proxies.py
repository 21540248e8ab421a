"""Photos on the coarse grid of a mosaic, made once and kept on disk."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from georef_gis.frames import Array
from georef_gis.model.grid import Grid, Window
from georef_gis.model.mesh import Ground, node_positions
from georef_gis.model.photo import OrientedPhoto
from georef_gis.mosaic.byte_cache import ByteCache
from georef_gis.mosaic.coarse import Mask, Proxy
from georef_gis.mosaic.nadir import DOUBT_PENALTY, RIM, RIM_PENALTY, edge_distance
from georef_gis.mosaic.tone import toned
from georef_gis.rasters.warp import Image, ground_mesh, sample, upsample

# coarse px at the rim of a photo that do not count: blurred by the reduction, and half covered
RIM_PIXELS = 1
# coarse px between the nodes through which photos are reduced, and at which distances are kept:
# they need be good to no more than a fraction of a coarse pixel, and relief between the nodes
# counts all the same
STEP = 8
# m; by a rise so small that it is a derivative, and large against what rounding leaves
RISE = 0.05
# bytes; what corrected proxies may take
CORRECTED_BYTES = 40_000_000
# end of a proxy's file: a power cut may have left less
WHOLE = b"whole\n"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ProxyPhoto:
    """What a proxy is made from; `reduce` is by how much the photo is decoded smaller.

    `reach` is half the longer diagonal of the ground the photo shows, m.
    """

    photo: OrientedPhoto
    window: Window
    reduce: int
    reach: float
    doubtful: bool = False


def proxy_window(coarse: Grid, ring_map: Array) -> Window:
    """Part of the coarse grid that a footprint meets."""
    p = coarse.grid_from_map(ring_map)
    low = np.clip(np.floor(p.min(axis=0)), 0, [coarse.width - 1, coarse.height - 1]).astype(int)
    high = np.clip(np.ceil(p.max(axis=0)), low + 1, [coarse.width, coarse.height]).astype(int)
    col, row = int(low[0]), int(low[1])
    return Window(col=col, row=row, width=int(high[0]) - col, height=int(high[1]) - row)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Made:
    """A proxy as it is kept: pixels in the photo's own type, distance at few places."""

    data: Image
    valid: Mask
    distance: NDArray[np.float32]


def _make(source: ProxyPhoto, image: Image, ground: Ground, coarse: Grid) -> _Made:
    window, camera = source.window, source.photo.camera
    mesh = ground_mesh(ground, coarse, window, STEP)
    uv, move = _pixels(source.photo, mesh.p_enu, relief=mesh.delta is not None)
    place = _positions((uv + 0.5) / source.reduce - 0.5, move / source.reduce, mesh.delta, window)
    # NaN is not in the range
    edge = (camera.width / source.reduce - 0.5, camera.height / source.reduce - 0.5)
    seen = np.asarray(cv2.inRange(place, (-0.5, -0.5), edge), dtype=np.uint8)
    data = sample(image, place)
    if data.dtype.kind == "f":
        # a nodata value of floats must not spread
        seen[~np.isfinite(data).all(axis=2)] = 0
    data = cv2.copyTo(data, seen, np.zeros_like(data)).reshape(data.shape)
    kernel = np.ones((2 * RIM_PIXELS + 1, 2 * RIM_PIXELS + 1), np.uint8)
    # what lies beyond the window is not seen either
    inner = cv2.erode(seen, kernel, borderType=cv2.BORDER_CONSTANT, borderValue=0)
    return _Made(data=data, valid=inner > 0, distance=_distance(source, mesh.p_enu, uv))


def _pixels(photo: OrientedPhoto, p_enu: Array, *, relief: bool) -> tuple[Array, Array]:
    """Pixels of ground points, and how far they move per metre of height; (..., 2) px, px/m."""
    if not relief:
        uv = photo.project(p_enu)
        return uv, np.zeros_like(uv)
    up = np.array([0.0, 0.0, RISE])
    uv, raised = photo.project(np.stack([p_enu, p_enu + up]))
    return uv, (raised - uv) / RISE


def _positions(
    nodes: Array, move: Array, delta: NDArray[np.float32] | None, window: Window
) -> NDArray[np.float32]:
    """Pixels at every place of a window from its nodes, moved by what the mesh leaves out."""
    shape = (window.height, window.width)
    out = upsample(nodes, STEP, shape)
    if delta is None:
        return out
    moved = cv2.multiply(upsample(move, STEP, shape), cv2.merge([delta, delta]))
    return np.asarray(cv2.add(out, moved), dtype=np.float32)


def _distance(source: ProxyPhoto, p_enu: Array, uv: Array) -> NDArray[np.float32]:
    """Distance from the nadir, m, of ground points at pixels, as the nadir mosaic counts it."""
    camera, origin = source.photo.camera, source.photo.pose.origin_enu
    d = np.hypot(p_enu[..., 0] - origin[0], p_enu[..., 1] - origin[1])
    rim = RIM * min(camera.width, camera.height)
    edge = edge_distance(uv, camera.width, camera.height)
    d = d + RIM_PENALTY * source.reach * np.clip(1.0 - edge / rim, 0.0, 2.0)
    if source.doubtful:
        d = d + DOUBT_PENALTY * source.reach
    return np.asarray(np.nan_to_num(d, nan=1e6, posinf=1e6), dtype=np.float32)


class ProxyStore:
    """Proxies of all photos of a mosaic in a folder; what is there already is not made again.

    Parameters
    ----------
    folder
        Of this mosaic's proxies: who asks for others takes another folder.
    """

    def __init__(self, folder: Path, photos: Sequence[ProxyPhoto], coarse: Grid) -> None:
        self._folder = folder
        self._photos = tuple(photos)
        self._coarse = coarse

    @property
    def ids(self) -> tuple[str, ...]:
        """Photos, in the order that labels count."""
        return tuple(source.photo.id for source in self._photos)

    @property
    def windows(self) -> tuple[Window, ...]:
        """Part of the coarse grid that each photo covers."""
        return tuple(source.window for source in self._photos)

    @property
    def name(self) -> str:
        """Name of the folder."""
        return self._folder.name

    @property
    def coarse(self) -> Grid:
        """The coarse grid."""
        return self._coarse

    def photo(self, index: int) -> OrientedPhoto:
        """A photo with its pose."""
        return self._photos[index].photo

    def _path(self, index: int) -> Path:
        return self._folder / f"{index:06d}.proxy"

    def has(self, index: int) -> bool:
        """Whether a photo's proxy is there, whole: a power cut may leave it empty."""
        try:
            with self._path(index).open("rb") as file:
                file.seek(-len(WHOLE), os.SEEK_END)
                return file.read() == WHOLE
        except OSError:
            return False

    def make(self, index: int, read: Callable[[Path, int], Image], ground: Ground) -> None:
        """Make one photo's proxy; it appears whole or not at all.

        Raises
        ------
        InputError
            If the photo cannot be read.
        """
        source = self._photos[index]
        image = read(source.photo.photo.path, source.reduce)
        made = _make(source, image, ground, self._coarse)
        self._folder.mkdir(parents=True, exist_ok=True)
        part = self._path(index).with_suffix(".part")
        about = {"dtype": made.data.dtype.str, "bands": made.data.shape[2]}
        with part.open("wb") as file:
            file.write(json.dumps(about).encode() + b"\n")
            for array in (made.data, np.packbits(made.valid), made.distance):
                file.write(np.ascontiguousarray(array).data)
            file.write(WHOLE)
        part.replace(self._path(index))

    def load(self, index: int) -> Proxy:
        """One photo, as it was made."""
        source = self._photos[index]
        window = source.window
        rows, cols = window.height, window.width
        raw = self._path(index).read_bytes()
        at = raw.index(b"\n") + 1
        about = json.loads(raw[:at])
        data = np.frombuffer(raw, about["dtype"], rows * cols * about["bands"], at)
        at += data.nbytes
        bits = np.frombuffer(raw, np.uint8, -(-rows * cols // 8), at)
        nodes = (-(-rows // STEP) + 2, -(-cols // STEP) + 2)
        near: Any = np.frombuffer(raw, np.float32, nodes[0] * nodes[1], at + bits.size)
        valid = np.unpackbits(bits, count=rows * cols).reshape(rows, cols).astype(np.bool_)
        distance = upsample(near.reshape(nodes), STEP, (rows, cols)).copy()
        distance[~valid] = np.inf
        return Proxy(
            photo_id=source.photo.id, window=window,
            data=data.astype(np.float32).reshape(rows, cols, about["bands"]), valid=valid,
            distance=distance,
        )  # fmt: skip

    def places(self, index: int, cols: Array, rows: Array, ground: Ground) -> tuple[Array, Array]:
        """Where places on the coarse grid lie in a photo, and how it sees them.

        `cols`, `rows` (k,) count from the outer corner.

        Returns
        -------
        xy : shape (k, 2)
            Offset from the principal point over the photo's half diagonal.
        view : shape (k, 2)
            East and north of the unit vector from the ground to the camera.
        """
        colrow = np.stack([np.asarray(cols), np.asarray(rows)], axis=-1).astype(np.float64)
        p_enu = ground.enu_at(self._coarse, colrow)
        return place_in_photo(self._photos[index].photo, p_enu)


def place_in_photo(photo: OrientedPhoto, p_enu: Array, uv: Any = None) -> tuple[Array, Array]:
    """Normalised place in the photo and view direction of ground points; (..., 3) -> (..., 2).

    `uv` are their pixels, if known.
    """
    camera = photo.camera
    if uv is None:
        uv = photo.project(p_enu)
    half = 0.5 * float(np.hypot(camera.width, camera.height))
    xy = (np.asarray(uv, dtype=np.float64) - [camera.cx, camera.cy]) / half
    to_camera = photo.pose.origin_enu - p_enu
    view = to_camera[..., :2] / np.linalg.norm(to_camera, axis=-1, keepdims=True)
    # beyond the photo, where a polynomial would run away
    return np.clip(np.nan_to_num(xy, nan=1.1), -1.1, 1.1), view


class PhotoColour(Protocol):
    """Colour corrections of the photos of a mosaic."""

    @property
    def knee(self) -> float:
        """One over the grey value that factors leave as it is, see `tone.py`; 0 = none."""
        ...

    def factor(self, photo: int, xy: Array, view: Array) -> Array:
        """What values are multiplied by at places of a photo; (..., 2) twice -> (..., bands)."""
        ...

    def offset(self, photo: int) -> Array:
        """What is added then; shape (bands,)."""
        ...


class CorrectedProxies:
    """Proxies with their colour corrected: a `ProxySource`; those used last are kept."""

    def __init__(self, store: ProxyStore, colour: PhotoColour, ground: Ground) -> None:
        self._store, self._colour, self._ground = store, colour, ground
        self._kept = ByteCache(self._made, budget=CORRECTED_BYTES)

    def __getstate__(self) -> tuple[ProxyStore, PhotoColour, Ground]:
        """What another process needs."""
        return self._store, self._colour, self._ground

    def __setstate__(self, state: tuple[ProxyStore, PhotoColour, Ground]) -> None:
        """Start anew with nothing kept."""
        CorrectedProxies.__init__(self, *state)

    @property
    def ids(self) -> tuple[str, ...]:
        """Photos, in the order that labels count."""
        return self._store.ids

    @property
    def windows(self) -> tuple[Window, ...]:
        """Part of the coarse grid that each photo covers."""
        return self._store.windows

    def load(self, index: int) -> Proxy:
        """One photo, its colour corrected; its values may exceed their type's range."""
        return self._kept(index)

    def _made(self, index: int) -> Proxy:
        proxy = self._store.load(index)
        photo, coarse = self._store.photo(index), self._store.coarse
        p_enu = self._ground.enu_at(coarse, node_positions(proxy.window, STEP))
        xy, view = place_in_photo(photo, p_enu)
        rows, cols, bands = proxy.data.shape
        nodes = self._colour.factor(index, xy, np.nan_to_num(view))
        factor = upsample(nodes, STEP, (rows, cols)).reshape(proxy.data.shape)
        knee = self._colour.knee
        if knee > 0.0:
            data = toned(proxy.data, factor, np.float32(knee))
        else:
            data = np.asarray(cv2.multiply(proxy.data, factor), dtype=np.float32)
        # long rows: numpy is slow at adding a few values again and again
        lines = data.reshape(rows, cols * bands)
        lines += np.tile(np.asarray(self._colour.offset(index), dtype=np.float32), cols)
        return replace(proxy, data=data.reshape(proxy.data.shape))
