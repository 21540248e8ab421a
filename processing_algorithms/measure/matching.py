"""Clicks matched into the photos of a project."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from georef_gis.measure.click_match.match import Matched
    from georef_gis.model.control import Mark
    from processing_algorithms.measure.session import MeasureSession


def match_marks(
    session: MeasureSession,
    marks: Sequence[Mark],
    *,
    photos: Sequence[str] | None = None,
    most: int = 8,
) -> Matched:
    """Find what marks of one object show in other photos, see `match_click`.

    Parameters
    ----------
    marks
        `Mark.photo` as people write it.
    photos
        Only into these, as people write them.

    Raises
    ------
    GeometryError
        If the marks show no place.
    InputError
        If a photo is not known or cannot be read.
    """
    from georef_gis.measure.click_match.match import match_click
    from georef_gis.rasters.warp import one_thread_each

    into = None if photos is None else [session.photo_id(key) for key in photos]
    with one_thread_each():
        return match_click(
            session.scene, session.marks(marks), session.image, photo_ids=into, most=most
        )
