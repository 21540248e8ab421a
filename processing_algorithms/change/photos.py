"""Photos of a project laid on the grid of a comparison, window by window."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import numpy as np

from georef_gis.errors import InputError
from georef_gis.measure.change.evidence import Look

if TYPE_CHECKING:
    from georef_gis.frames import Array
    from georef_gis.model.photo import OrientedPhoto
    from georef_gis.project import Project
    from georef_gis.rasters.profile import Transform
    from georef_gis.rasters.reading import Window
    from georef_gis.rasters.resampled import MapHeader
    from processing_algorithms.site import Site

# photos of a place that are looked at, those most from above; tangent of the steepest look
MOST_PHOTOS, _STEEPEST = 8, 1.5
# cells between the nodes of the mesh: of small windows, and of large ones beyond so many cells
_STEP, _STEP_LARGE, _LARGE = 4, 16, 250_000
# bytes of decoded photos that are kept
_CACHE = 120_000_000
# cells finer than a photo, reduced, by as much are taken for equal
_SLACK = 1.25


class SitePhotos:
    """Photos of a project over its ground; see `georef_gis.measure.change.evidence.Photos`.

    Attributes
    ----------
    lost
        Why photos could not be read, by name.
    """

    def __init__(self, site: Site) -> None:
        from georef_gis.rasters.warp import ImageCache

        self._site = site
        self._photos = list(site.photos.values())
        self._origins = np.array([photo.pose.origin_enu for photo in self._photos])
        self._cache = ImageCache(budget=_CACHE)
        self.lost: dict[str, str] = {}

    @classmethod
    def of(cls, project: Project) -> SitePhotos | None:
        """Photos of a project; None if they have no poses."""
        from processing_algorithms.site import load_site

        if not (project.folder / "georef.gpkg").is_file():
            return None
        try:
            with project.reader() as reader:
                return cls(load_site(reader))
        except InputError:
            return None

    def looks(self, header: MapHeader, window: Window, moved: Transform) -> Iterator[Look]:
        """A window as the photos see it that do so most from above."""
        from georef_gis.rasters.warp import (
            inside_image,
            one_thread_each,
            reduction_for,
            sample,
            upsample,
        )

        step = _STEP if window[2] * window[3] <= _LARGE else _STEP_LARGE
        p_enu = self._ground(header, _nodes(window, step), moved)
        if not np.isfinite(p_enu).all():
            return
        middle = p_enu[p_enu.shape[0] // 2, p_enu.shape[1] // 2]
        cell = float(np.linalg.norm(p_enu[1, 1] - p_enu[1, 2])) / step
        for photo in self._near(middle, p_enu):
            reduce = reduction_for(_SLACK * cell, _gsd(photo, middle))
            try:
                image = self._cache.get(photo.photo.path, reduce)
            except InputError as error:
                self.lost[photo.photo.path.name] = str(error)
                continue
            with one_thread_each():
                uv = upsample(photo.project(p_enu), step, (window[3], window[2]))
                valid = inside_image(uv, photo.camera.width, photo.camera.height)
                yield Look(samples=sample(image, uv, reduce=reduce), valid=valid)

    def _near(self, middle: Array, p_enu: Array) -> Iterator[OrientedPhoto]:
        """Photos that show the middle of a window, those most from above first."""
        up = self._origins[:, 2] - middle[2]
        away = np.hypot(*(self._origins[:, :2] - middle[:2]).T)
        steep = np.where(up > 0.0, away / np.maximum(up, 1e-3), np.inf)
        count = 0
        for number in np.argsort(steep):
            photo = self._photos[number]
            if steep[number] > _STEEPEST or count == MOST_PHOTOS:
                return
            if bool(photo.contains(photo.project(middle))):
                count += 1
                yield photo

    def _ground(self, header: MapHeader, nodes: Array, moved: Transform) -> Array:
        """Ground under cells of the grid, shape (..., 2) -> (..., 3) m in enu."""
        a, b, c, d, e, f = moved
        left, top = header.transform[2], header.transform[5]
        x, y = nodes[..., 0], nodes[..., 1]
        xy = np.stack(
            [
                left + header.transform[0] * (a * x + b * y + c),
                top + header.transform[4] * (d * x + e * y + f),
            ],
            axis=-1,
        )
        frame = self._site.frame
        xy = self._to_own_map(header.crs_wkt)(xy)
        height = self._site.terrain.height_on_map(frame, xy)
        return frame.enu_from_map(np.concatenate([xy, height[..., None]], axis=-1))

    def _to_own_map(self, crs_wkt: str) -> Callable[[Array], Array]:
        from georef_gis.geodesy import CRS
        from georef_gis.geodesy.reference_systems import horizontal_crs, transformer_between

        own, theirs = self._site.frame.horizontal, horizontal_crs(CRS.from_wkt(crs_wkt))
        if own == theirs:
            return lambda xy: xy
        there = transformer_between(theirs, own)
        return lambda xy: np.stack(there.transform(xy[..., 0], xy[..., 1])[:2], axis=-1)


def _nodes(window: Window, step: int) -> Array:
    """Cells of the mesh over a window, as `node_positions` has them."""
    from georef_gis.model.grid import Window as GridWindow
    from georef_gis.model.mesh import node_positions

    col, row, width, height = window
    return node_positions(GridWindow(col=col, row=row, width=width, height=height), step)


def _gsd(photo: OrientedPhoto, p_enu: Array) -> float:
    """Ground sample distance at a place, m."""
    around = p_enu + np.array([[0.0, 0.0, 0.0], [0.5, 0.0, 0.0], [0.0, 0.5, 0.0]])
    uv = photo.project(around)
    return 0.5 / float(np.linalg.norm(uv[1:] - uv[0], axis=1).mean())
