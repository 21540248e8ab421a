"""Photos of a project laid on the grid of a comparison, window by window."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from georef_gis.errors import InputError
from georef_gis.measure.change.evidence import Look
from processing_algorithms.change.map_way import Way, way_between

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
    def of(cls, project: Project) -> SitePhotos:
        """Photos of a project.

        Raises
        ------
        InputError
            If they have no poses, or their ground cannot be read.
        """
        from processing_algorithms.site import load_site

        if not (project.folder / "georef.gpkg").is_file():
            raise InputError(
                "has no photos yet; run `georef run` there", source=str(project.folder)
            )
        with project.reader() as reader:
            return cls(load_site(reader))

    def meet(self, crs_wkt: str) -> str:
        """Find the way from a map to the photos' own; a doubt where datums are taken as one.

        Raises
        ------
        CrsError
            If there is none.
        """
        return self._way(crs_wkt)[1]

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
        apart = np.linalg.norm(np.diff(p_enu, axis=1), axis=-1)
        apart = apart[np.isfinite(apart)]
        if not len(apart):
            return
        middle, cell = _middle(p_enu), float(np.median(apart)) / step
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
                if not valid.any():
                    continue
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
        xy = self._way(header.crs_wkt)[0](xy)
        height = self._site.terrain.height_on_map(frame, xy)
        return frame.enu_from_map(np.concatenate([xy, height[..., None]], axis=-1))

    def _way(self, crs_wkt: str) -> tuple[Way, str]:
        return way_between(crs_wkt, self._site.frame.horizontal)


def _nodes(window: Window, step: int) -> Array:
    """Cells of the mesh over a window, as `node_positions` has them."""
    from georef_gis.model.grid import Window as GridWindow
    from georef_gis.model.mesh import node_positions

    col, row, width, height = window
    return node_positions(GridWindow(col=col, row=row, width=width, height=height), step)


def _middle(p_enu: Array) -> Array:
    """Of the nodes whose ground is known the one that lies most amid all, shape (3,)."""
    rows, cols = np.nonzero(np.isfinite(p_enu).all(axis=-1))
    away = np.hypot(rows - p_enu.shape[0] // 2, cols - p_enu.shape[1] // 2)
    nearest = int(np.argmin(away))
    return np.asarray(p_enu[rows[nearest], cols[nearest]])


def _gsd(photo: OrientedPhoto, p_enu: Array) -> float:
    """Ground sample distance at a place, m."""
    around = p_enu + np.array([[0.0, 0.0, 0.0], [0.5, 0.0, 0.0], [0.0, 0.5, 0.0]])
    uv = photo.project(around)
    return 0.5 / float(np.linalg.norm(uv[1:] - uv[0], axis=1).mean())
