"""Seams of a project's mosaic: as the user edited them, or chosen and written for editing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from georef_gis.toolbox import Feedback

if TYPE_CHECKING:
    from georef_gis.geodesy import MapFrame
    from georef_gis.model.grid import Grid
    from georef_gis.mosaic.coarse import SparseRaster
    from georef_gis.mosaic.proxies import CorrectedProxies
    from georef_gis.mosaic.seam_raster import SeamIndex
    from georef_gis.project import Project


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FoundSeams:
    """Areas of the photos, the same on the coarse grid, and whether a user edited them."""

    index: SeamIndex
    labels: SparseRaster
    edited: bool


def project_seams(
    project: Project,
    source: CorrectedProxies,
    coarse: Grid,
    frame: MapFrame,
    *,
    optimised: bool,
    workers: int,
    feedback: Feedback,
    progress: Callable[[float], None],
) -> FoundSeams:
    """Edited seams where there are some, else new ones, which are written to `seams.gpkg`.

    Raises
    ------
    InputError
        If the edited layer cannot be used.
    """
    from georef_gis.mosaic.prepare import choose_seams
    from georef_gis.mosaic.seam_polygons import polygons_of
    from georef_gis.mosaic.seam_raster import SeamIndex
    from georef_gis.project import Srs
    from georef_gis.project.seam_layer import SEAMS_FILE, write_seams

    path = project.folder / SEAMS_FILE
    cells = _edited(project, frame, feedback)
    if cells is not None:
        number = {key: k for k, key in enumerate(source.ids)}
        known = [(number[key], area) for key, area in cells if key in number]
        index = SeamIndex.of(known)
        progress(1.0)
        return FoundSeams(index=index, labels=_labels(index, coarse, source), edited=True)
    labels = choose_seams(
        source, coarse, optimised=optimised, workers=workers, cancelled=feedback.cancelled,
        progress=progress,
    )  # fmt: skip
    found = polygons_of(labels, coarse, source.ids)
    crs = frame.horizontal
    write_seams(path, found, Srs(name=crs.name, wkt=crs.to_wkt("WKT1_GDAL"), code=crs.to_epsg()))
    number = {key: k for k, key in enumerate(source.ids)}
    index = SeamIndex.of([(number[key], area) for key, area in found])
    return FoundSeams(index=index, labels=labels, edited=False)


def _edited(project: Project, frame: MapFrame, feedback: Feedback) -> list[tuple[str, Any]] | None:
    """Areas that a user edited; None where nobody did."""
    from georef_gis.project.seam_layer import SEAMS_FILE, read_seams

    path = project.folder / SEAMS_FILE
    if not path.exists():
        return None
    photos = [row["photo_id"] for row in project.database.rows("photo")]
    read = read_seams(path, photos=photos, crs_wkt=frame.horizontal.to_wkt())
    if not read.edited:
        return None
    feedback.info(f"{SEAMS_FILE}: the seams as edited are used")
    for note in read.notes:
        feedback.warn(note)
    return list(read.cells)


def _labels(index: SeamIndex, coarse: Grid, source: CorrectedProxies) -> SparseRaster:
    """Labels of areas on the coarse grid, where photos are."""
    import numpy as np

    from georef_gis.mosaic.coarse import SparseRaster
    from georef_gis.mosaic.seam_raster import label_window

    labels = SparseRaster(width=coarse.width, height=coarse.height, dtype=np.int32, fill=-1)
    for window in source.windows:
        labels.write(window, label_window(index, coarse, window))
    return labels
