"""Where the mosaic shows a point that was marked in photos: matched by the photo's own pixels.

The ray of a mark says where its photo puts the point, not where the mosaic does, which may show
the place from another photo. So the neighbourhood of the mark is laid on the ground and looked for
in the mosaic.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from georef_gis.errors import CrsError, InputError
from georef_gis.frames import Array
from georef_gis.geodesy import MapFrame, metres_per_unit, same_crs
from georef_gis.measure.accuracy.matching import Grey, find_patch
from georef_gis.model.grid import Grid, Window
from georef_gis.model.ground_point import ground_point_covariance, ground_point_jacobians, locate
from georef_gis.model.mesh import Ground
from georef_gis.model.photo import OrientedPhoto
from georef_gis.rasters.reading import GridHeader, read_grid, read_grid_header
from georef_gis.rasters.warp import Image, reduction_for, warp_window

# px of the mosaic: half sides of the neighbourhood, the first that the photo holds whole is taken
RADII = (28, 20, 14)
# sigmas of the place within which is searched, and limits of that, px
_SEARCH_SIGMAS, _SEARCH_MIN, _SEARCH_MAX = 4.0, 24.0, 1500.0
# px of the mesh through which the neighbourhood is laid on the ground
_STEP = 4


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MarkedPhoto:
    """A photo with the pixel of a point in it, px."""

    photo: OrientedPhoto
    uv: Array
    sigma_px: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Reading:
    """Where one photo's mark lies in the mosaic.

    `xy_map` (2,) CRS units; `sigma` m per axis, of match and mark; `shift` (2,) m from where the
    photo's own pose puts the point, east and north; `score` is the normalised cross-correlation.
    """

    photo_id: str
    xy_map: Array
    sigma: float
    shift: Array
    score: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MosaicPlace:
    """Where a point lies in the mosaic, by all photos it is marked in; `sigma` m per axis.

    `refused` says for each photo that gave no reading, why not. `xy_map` is NaN without any.
    """

    xy_map: Array
    sigma: float
    readings: tuple[Reading, ...]
    refused: dict[str, str]


class MosaicReader:
    """Finds marked points in a mosaic.

    Parameters
    ----------
    path
        The mosaic, north-up with square pixels, in the CRS of `frame`.
    ground_of
        Ground under a grid.
    read
        `read(path, reduce) -> (rows, cols, bands)`: pixels of a photo.
    search
        m around the expected place; by default 4 sigmas of two photos' places.

    Raises
    ------
    InputError
        If the mosaic cannot be read, is turned or of another CRS.
    """

    def __init__(
        self,
        path: Path,
        frame: MapFrame,
        ground_of: Callable[[Grid], Ground],
        *,
        read: Callable[[Path, int], Image],
        search: float | None = None,
    ) -> None:
        header = read_grid_header(path)
        self.path, self.frame = path, frame
        self.grid = _grid_of(header, path, frame)
        self.pixel = self.grid.pixel * metres_per_unit(frame.horizontal)
        self._ground, self._read, self._search = ground_of(self.grid), read, search
        self._band = _grey_band(path)

    def place(self, marks: Sequence[MarkedPhoto]) -> MosaicPlace:
        """Place of one point from its marks."""
        readings, refused = [], {}
        for mark in marks:
            found = self.read_mark(mark)
            if isinstance(found, str):
                refused[mark.photo.id] = found
            else:
                readings.append(found)
        kept, xy, sigma = _joined(readings, metres_per_unit(self.frame.horizontal))
        ids = {one.photo_id for one in kept}
        refused |= {
            one.photo_id: "disagrees with the other photos"
            for one in readings
            if one.photo_id not in ids
        }
        return MosaicPlace(xy_map=xy, sigma=sigma, readings=tuple(kept), refused=refused)

    def read_mark(self, mark: MarkedPhoto) -> Reading | str:
        """Place of one mark in the mosaic, or why there is none."""
        photo, terrain = mark.photo, self._ground.terrain
        p = locate(photo, mark.uv, terrain)
        if not np.all(np.isfinite(p)):
            return "its ray does not meet the ground"
        xy = self.frame.map_from_enu(p)[:2]
        at = self.grid.grid_from_map(xy)
        if not (0 <= at[0] <= self.grid.width and 0 <= at[1] <= self.grid.height):
            return "lies off the mosaic"
        patch = self._patch(photo, xy, p)
        if patch is None:
            return "lies at the edge of the photo"
        spread = ground_point_covariance(photo, p, terrain, sigma_uv=mark.sigma_px)
        crop, valid, first = self._crop(at, patch.shape[0] // 3, spread)
        found = find_patch(patch, crop, valid)
        if isinstance(found, str):
            return found
        place = self.grid.map_from_grid(first + found.xy + 0.5)
        J_uv = ground_point_jacobians(photo, p, terrain)[2][:2]
        click = math.sqrt(float(np.sum(J_uv**2)) / 2.0) * mark.sigma_px
        return Reading(
            photo_id=photo.id,
            xy_map=place,
            sigma=math.hypot(found.sigma * self.pixel, click),
            shift=(place - xy) * metres_per_unit(self.frame.horizontal),
            score=found.score,
        )

    def _patch(self, photo: OrientedPhoto, xy_map: Array, p_enu: Array) -> Grey | None:
        """Neighbourhood of a place on the ground as the photo shows it, the place in its middle.

        Its side is three radii, so that it can be turned.
        """
        gsd = self._gsd(photo, p_enu)
        reduce = reduction_for(self.pixel, gsd)
        image = self._read(photo.photo.path, reduce)
        for radius in RADII:
            half = 3 * radius // 2
            side = 2 * half + 1
            edge = (half + 0.5) * self.grid.pixel
            grid = Grid(
                crs_wkt=self.grid.crs_wkt,
                left=float(xy_map[0]) - edge,
                top=float(xy_map[1]) + edge,
                pixel=self.grid.pixel,
                width=side,
                height=side,
            )
            window = Window(col=0, row=0, width=side, height=side)
            warped = warp_window(
                photo, image, self._ground, grid, window, step=_STEP, reduce=reduce
            )
            if warped is not None and warped[1] is None:
                return np.asarray(warped[0][..., self._band - 1], dtype=np.float32)
        return None

    def _gsd(self, photo: OrientedPhoto, p_enu: Array) -> float:
        J_uv = ground_point_jacobians(photo, p_enu, self._ground.terrain)[2]
        return float(np.linalg.norm(J_uv, axis=0).min())

    def _crop(self, at: Array, radius: int, spread: Array) -> tuple[Grey, NDArray[np.bool_], Array]:
        """Mosaic around a place in grey, where it holds a picture, and its first (col, row)."""
        sigma = math.sqrt(float(spread[0, 0] + spread[1, 1]) / 2.0)
        reach = self._search or _SEARCH_SIGMAS * math.sqrt(2.0) * sigma
        reach = float(np.clip(reach / self.pixel, _SEARCH_MIN, _SEARCH_MAX)) + radius + 2
        size = [self.grid.width, self.grid.height]
        low = np.clip(np.floor(at - reach), 0, size).astype(int)
        high = np.clip(np.ceil(at + reach), 0, size).astype(int)
        window = (int(low[0]), int(low[1]), int(high[0] - low[0]), int(high[1] - low[1]))
        grey = read_grid(self.path, window=window, band=self._band).values
        valid = np.isfinite(grey)
        return np.where(valid, grey, 0.0).astype(np.float32), valid, low.astype(float)


def _joined(readings: Sequence[Reading], unit: float) -> tuple[list[Reading], Array, float]:
    """Readings that agree, their weighted mean (2,) CRS units, and its sigma, m."""
    kept = list(readings)
    if len(kept) > 2:
        middle = np.median([one.xy_map for one in kept], axis=0)
        off = [float(np.linalg.norm(one.xy_map - middle)) * unit for one in kept]
        limit = max(3.0 * float(np.median(off)), 4.0 * float(np.median([r.sigma for r in kept])))
        kept = [one for one, away in zip(kept, off, strict=True) if away <= limit]
    if not kept:
        return [], np.full(2, np.nan), math.nan
    weight = np.array([1.0 / one.sigma**2 for one in kept])
    xy = np.array([one.xy_map for one in kept])
    mean = weight @ xy / weight.sum()
    sigma = 1.0 / math.sqrt(float(weight.sum()))
    if len(kept) > 1:
        # Photos that disagree by more than their sigmas: the mosaic is no better than that.
        chi2 = float(weight @ np.sum(((xy - mean) * unit) ** 2, axis=1)) / (2 * (len(kept) - 1))
        sigma *= math.sqrt(max(1.0, chi2))
    return kept, mean, sigma


def _grid_of(header: GridHeader, path: Path, frame: MapFrame) -> Grid:
    a, b, left, d, e, top = header.transform
    if b or d or a <= 0 or abs(a + e) > 1e-9 * a:
        raise InputError("is not north-up with square pixels; warp it first", source=path.name)
    wkt = frame.horizontal.to_wkt()
    if not header.crs_wkt or not same_crs(header.crs_wkt, wkt):
        raise CrsError(f"is not in '{frame.horizontal.name}'", source=path.name, field="crs")
    return Grid(crs_wkt=wkt, left=left, top=top, pixel=a, width=header.width, height=header.height)


def _grey_band(path: Path) -> int:
    """Band that stands for all: green of three or more, else the first."""
    try:
        read_grid_header(path, band=3)
    except InputError:
        return 1
    return 2
