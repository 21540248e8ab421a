"""Marks that people give to the tools that measure: a table, or pixels on the command line."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from georef_gis.errors import InputError

if TYPE_CHECKING:
    from georef_gis.ingest.tables import Lines
    from georef_gis.model.control import Mark
    from georef_gis.toolbox import Feedback
    from georef_gis.toolbox.values import PhotoPixel

# px, one sigma of a click where nothing is said, on the command line and in the page alike: that
# of `model.control`, whose libraries no form should wait for
CLICK = 0.5
CLICK_TITLE = f"One sigma of every click, px; else the table's or {CLICK}"
GROUND = ("on", "free")
# columns of a table without a header: photo, name, u, v, sigma
_UNHEADED = 5


def read_mark_table(path: Path, feedback: Feedback, *, sigma_px: float | None = None) -> list[Mark]:
    """Marks of a CSV with name, photo, u, v and, if wanted, sigma_px, shared_px and ground.

    Pix4D's and Metashape's tables without a header are read too. Lines that cannot be used are
    told and left out.

    Parameters
    ----------
    sigma_px
        One sigma of every click, instead of the table's.

    Raises
    ------
    InputError
        If the file or its columns cannot be used, or no line can.
    """
    from georef_gis.ingest.control_tables import marks_of
    from georef_gis.ingest.tables import read_lines

    lines, broken = _without_broken(read_lines(path))
    try:
        marks, doubts = marks_of(lines, (), None)
    except InputError as error:
        # of what is left nothing is a mark
        raise (InputError(broken[0]) if broken else error) from error
    doubts = [*broken, *doubts]
    if not marks:
        raise InputError(
            doubts[0] if doubts else "has no marks", source="" if doubts else str(path)
        )
    for line in doubts:
        feedback.warn(line)
    return marks if sigma_px is None else [_clicked_to(mark, sigma_px) for mark in marks]


def _clicked_to(mark: Mark, sigma_px: float) -> Mark:
    """A mark whose click is so sure; of a matched one the click is what it shares with others."""
    if mark.shared_px > 0.0:
        return replace(mark, shared_px=sigma_px)
    return replace(mark, sigma_px=sigma_px)


def on_ground(marks: Sequence[Mark], ground: str | None) -> list[Mark]:
    """Marks that lie on the ground or not, as is said for all; None leaves it as they say."""
    if ground is None:
        return list(marks)
    return [replace(mark, on_ground=ground == "on") for mark in marks]


def _without_broken(lines: Lines) -> tuple[Lines, list[str]]:
    """Lines without those of more cells than the table has columns, and what is wrong with these.

    A comma as decimal sign in a table of commas makes two numbers of each, which would be taken.
    """
    from georef_gis.ingest.control_tables import MARK_COLUMNS, columns_of
    from georef_gis.ingest.tables import separator_of, split

    if not lines.data:
        return lines, []
    first = lines.data[0][1]
    separator = separator_of(first)
    headed = "photo" in columns_of(first, MARK_COLUMNS, separator)
    most = len(split(first, separator)) if headed else _UNHEADED
    kept, doubts = [], []
    for n, line in lines.lines:
        cells = [] if line.startswith("#") else split(line, separator)
        extra = [cell for cell in cells[most:] if cell]
        if separator and extra:
            doubts.append(
                f"{lines.path}, line {n}: '{extra[0][:40]}' stands in column {most + 1} of {most}; "
                "write decimals with a point; left out"
            )
        else:
            kept.append((n, line))
    return replace(lines, lines=tuple(kept)), doubts


def marks_given(
    pixels: Sequence[PhotoPixel],
    photo: str | None,
    table: Path | None,
    feedback: Feedback,
    *,
    sigma_px: float | None,
) -> list[Mark]:
    """Marks of pixels on the command line, which are numbered, and of a table.

    Raises
    ------
    InputError
        If a pixel has no photo, the table cannot be used, or a point of it is called as a pixel.
    """
    marks = marks_of_pixels(pixels, photo, sigma_px=sigma_px)
    if table is None:
        return marks
    numbers = {mark.name for mark in marks}
    read = read_mark_table(table, feedback, sigma_px=sigma_px)
    for mark in read:
        if mark.name in numbers:
            raise InputError(
                f"'{mark.name}' is the name of pixel number {mark.name} too; rename it, or give "
                "the pixels in the table",
                source=mark.source,
                field="name",
            )
    return marks + read


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
