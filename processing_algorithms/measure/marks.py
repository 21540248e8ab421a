"""Marks that people give to the tools that measure: a table, or pixels on the command line."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from georef_gis.errors import InputError

if TYPE_CHECKING:
    from georef_gis.model.control import Mark
    from georef_gis.toolbox import Feedback
    from georef_gis.toolbox.values import PhotoPixel

# px, one sigma of a click where nothing is said
CLICK = 1.0


def read_mark_table(path: Path, feedback: Feedback, *, sigma_px: float | None = None) -> list[Mark]:
    """Marks of a CSV with name, photo, u, v and, if wanted, sigma_px.

    Pix4D's and Metashape's tables without a header are read too. Lines that cannot be used are
    told and left out.

    Parameters
    ----------
    sigma_px
        One sigma of every mark, instead of the table's.

    Raises
    ------
    InputError
        If the file or its columns cannot be used, or no line can.
    """
    from georef_gis.ingest.control_tables import marks_of
    from georef_gis.ingest.tables import read_lines

    marks, doubts = marks_of(read_lines(path), (), None)
    if not marks:
        raise InputError(
            doubts[0] if doubts else "has no marks", source="" if doubts else str(path)
        )
    for line in doubts:
        feedback.warn(line)
    return marks if sigma_px is None else [replace(mark, sigma_px=sigma_px) for mark in marks]


def marks_of_pixels(
    pixels: Sequence[PhotoPixel], photo: str | None, *, sigma_px: float | None = None
) -> list[Mark]:
    """Marks of pixels ``photo:u,v``; `photo` is that of pixels without one.

    Raises
    ------
    InputError
        If a pixel has no photo.
    """
    from georef_gis.model.control import Mark

    out = []
    for i, one in enumerate(pixels):
        name = one.photo or photo
        if not name:
            raise InputError(f"{one}: of which photo? write photo:u,v or give one", field="pixel")
        sigma = CLICK if sigma_px is None else sigma_px
        out.append(Mark(name=str(i + 1), photo=name, u=one.u, v=one.v, sigma_px=sigma))
    return out
