"""LAS files of tool `surface`: of the adjusted points, or of the cells of a surface."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from georef_gis.errors import InputError
from georef_gis.measure.ellipses import on_map
from georef_gis.measure.surface.las import Extra, write_las
from georef_gis.measure.surface.raster import cell_centres
from georef_gis.rasters.files import export_errors, whole_file
from processing_algorithms.surface.source import block_level, load_adjusted_points

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from georef_gis.frames import Array
    from georef_gis.geodesy import CRS
    from georef_gis.measure.surface.raster import HeightReference
    from georef_gis.model.grid import Grid
    from georef_gis.project import Project
    from processing_algorithms.site import Site

# cells that are kept in memory for a LAS
MOST_POINTS = 20_000_000
# bytes of a point
_SIZE = 60


def write_points(path: Path, project: Project, site: Site, reference: HeightReference) -> int:
    """Write the adjusted points; how many there are."""
    points = load_adjusted_points(project)
    good = np.isfinite(points.p_enu).all(axis=1) & np.isfinite(points.covariance).all(axis=(1, 2))
    p_enu, covariance = points.p_enu[good], points.covariance[good]
    p_map = site.frame.map_from_enu(p_enu)
    # heights of products are above the ellipsoid of the positions
    above = site.frame.origin.geo_from_enu(p_enu)[:, 2]
    level = reference.from_ellipsoidal(site.frame, p_map[:, :2], above)
    p_map[:, 2] = level / reference.unit
    variance = np.einsum("kii->ki", on_map(site.frame, p_enu, covariance))
    variance[:, 2] += block_level(site) ** 2
    sigma = np.sqrt(np.maximum(variance, 0.0)).astype(np.float32)
    extras = [
        Extra(name="sigma_e", values=sigma[:, 0], told="one sigma, grid east, m"),
        Extra(name="sigma_n", values=sigma[:, 1], told="one sigma, grid north, m"),
        Extra(name="sigma_u", values=sigma[:, 2], told="one sigma of the height, m"),
        Extra(name="rays", values=points.rays[good].astype(np.uint16), told="photos that see it"),
        Extra(
            name="residual", values=points.residual_px[good].astype(np.float32),
            told="rms of its pixels, px",
        ),
    ]  # fmt: skip
    _write(path, p_map, extras, reference.point_wkt(site.frame.horizontal))
    return len(p_map)


class CellFile:
    """Cells of a surface as points, gathered tile by tile."""

    def __init__(self, grid: Grid, reference: HeightReference) -> None:
        self._grid, self._reference = grid, reference
        self._xy: list[Array] = []
        self._values: list[NDArray[np.float32]] = []
        self._count = 0

    def add(
        self, row: int, col: int, values: NDArray[np.float32], known: NDArray[np.bool_]
    ) -> None:
        """Take the cells of a tile that have a height; `values` as `surface_tiles` has them.

        Raises
        ------
        InputError
            If there are too many.
        """
        self._count += int(known.sum())
        if self._count > MOST_POINTS:
            raise InputError(
                f"the surface has more than {MOST_POINTS:.0e} cells, too many for LAS; give a "
                "longer --cell, or --las none",
                field="las",
            )
        self._xy.append(cell_centres(self._grid, row, col)[known])
        self._values.append(values[known])

    def write(self, path: Path, horizontal: CRS) -> None:
        """Write them in a map's CRS, with both sigmas, m."""
        none = np.zeros((0, 3), dtype=np.float32)
        values = np.concatenate([none, *self._values])
        xy = np.concatenate([np.zeros((0, 2)), *self._xy])
        sigmas = values[:, 1:] * np.float32(self._reference.unit)
        extras = [
            Extra(name="sigma_u", values=sigmas[:, 0], told="one sigma of the height, m"),
            Extra(name="sigma_local", values=sigmas[:, 1], told="against its surroundings, m"),
        ]
        wkt = self._reference.point_wkt(horizontal)
        _write(path, np.column_stack([xy, values[:, 0]]), extras, wkt)


def _write(path: Path, xyz: Array, extras: Sequence[Extra], crs_wkt: str) -> None:
    with export_errors(path, lambda: _SIZE * len(xyz)), whole_file(path) as stream:
        write_las(stream, xyz, crs_wkt=crs_wkt, extras=extras)
