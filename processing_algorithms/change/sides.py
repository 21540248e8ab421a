"""The two sides of a comparison: their mosaics, dates and stated accuracies."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from georef_gis.project import Project
    from processing_algorithms.change.photos import SitePhotos

MOSAIC = "mosaic.tif"


@dataclass(frozen=True, slots=True, kw_only=True)
class Side:
    """One date of a site.

    Parameters
    ----------
    raster
        The mosaic.
    date
        Of the photos, ISO 8601, the first and the last if they differ; empty if unknown.
    sigma
        One sigma of a place, per axis, m; None if nobody says.
    project
        Whose photos the mosaic is made of; None if they are not known.
    """

    raster: Path
    date: str
    sigma: float | None
    project: Project | None = None

    def photos(self, name: str, crs_wkt: str) -> tuple[SitePhotos | None, str]:
        """The photos that the mosaic is made of, and what a user has to know of them.

        Parameters
        ----------
        name
            Of the side, `earlier` or `later`.
        crs_wkt
            Of the map that places are given on.

        Returns
        -------
        photos
            None if there are none to be had.
        doubt
            One line; empty if there is none.
        """
        from georef_gis.errors import GeorefError
        from processing_algorithms.change.photos import SitePhotos

        if self.project is None:
            return None, ""
        try:
            photos = SitePhotos.of(self.project)
            doubt = photos.meet(crs_wkt)
        except GeorefError as error:
            return None, f"the photos of the {name} date are not asked: {error}"
        return photos, doubt and f"the photos of the {name} date: {doubt}"


def side_of_project(project: Project, given_date: str) -> Side:
    """A project's mosaic.

    Raises
    ------
    InputError
        If it has none.
    """
    from georef_gis.errors import InputError

    raster = project.products / MOSAIC
    if not raster.is_file():
        raise InputError("there is no mosaic yet; run `georef run` there", source=str(raster))
    date, sigma = "", None
    if (project.folder / "georef.gpkg").is_file():
        with project.reader() as reader:
            date, sigma = _date(reader), _sigma(reader)
    return Side(raster=raster, date=given_date or date, sigma=sigma, project=project)


def side_of_folder(folder: Path, given_date: str) -> Side:
    """The mosaic of the project in a folder; it is only read.

    Raises
    ------
    InputError
        If there is no project, or no mosaic.
    """
    from georef_gis.project import Project

    return side_of_project(Project.open(folder, read_only=True), given_date)


def _date(project: Project) -> str:
    clocks = sorted(
        str(row["camera_clock"])[:10]
        for row in project.database.rows("photo")
        if row["camera_clock"]
    )
    if not clocks:
        return ""
    return clocks[0] if clocks[0] == clocks[-1] else f"{clocks[0]}/{clocks[-1]}"


def _sigma(project: Project) -> float | None:
    """Tested accuracy per axis where there is one, else the expected one."""
    import math

    from georef_gis.project.summary import summarise

    told = summarise(project)
    if told.rmse_h_m is not None and told.check_points_h:
        return told.rmse_h_m / math.sqrt(2.0)
    return told.sigma_horizontal_m
