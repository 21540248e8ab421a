"""The report as a PDF: the same sections as the page, on A4, with page numbers and bookmarks.

The parts of the page are laid out anew from what they are (pictures, tables, texts) rather than
from their HTML: that needs one library of plain Python, and heads of tables are repeated, pictures
are never cut and every glyph is embedded.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from georef_gis.measure.report.page import Section, findings_of
from georef_gis.measure.report.pdf_fonts import PLAIN, Fonts
from georef_gis.measure.report.pdf_parts import GREY, Parts, mm

MARGIN, TOP = 16 * mm, 20 * mm
# characters of the title that a header holds
_HEADER = 70


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Pdf:
    """A PDF file.

    Parameters
    ----------
    missing
        Characters that no font here has; a box stands for each.
    """

    content: bytes
    pages: int
    missing: tuple[str, ...]


def render_pdf(
    title: str, facts: Sequence[tuple[str, str]], sections: Sequence[Section], *, program: str
) -> Pdf:
    """The whole report.

    Parameters
    ----------
    facts
        Names and values below the title.
    program
        What made it, for the properties of the file.
    """
    from reportlab.lib.pagesizes import A4

    fonts = Fonts.registered()
    parts = Parts(fonts=fonts, width=A4[0] - 2 * MARGIN, height=A4[1] - TOP - MARGIN - 4 * mm)
    story = [
        parts.heading(title, "title", "top"),
        parts.pairs(facts),
        *_findings(parts, sections),
        parts.heading("Contents", "section", ""),
        parts.contents(),
    ]
    for section in sections:
        story += parts.section(section)
    stream = io.BytesIO()
    template = _template(stream, fonts.plain(title), program)
    with _compact():
        template.multiBuild(story)
    return Pdf(content=stream.getvalue(), pages=template.page, missing=tuple(fonts.missing))


@contextmanager
def _compact() -> Iterator[None]:
    """Streams as bytes: as letters, reportlab's default, they are a quarter larger."""
    from reportlab import rl_config

    before, rl_config.useA85 = rl_config.useA85, 0
    try:
        yield
    finally:
        rl_config.useA85 = before


def _findings(parts: Parts, sections: Sequence[Section]) -> list[Any]:
    told, asking = findings_of(sections)
    out = [parts.heading("Findings", "section", "findings"), parts.text(told)]
    return out + [parts.finding(one) for one in asking]


def _template(stream: io.BytesIO, title: str, program: str) -> Any:
    """Pages with their header and footer, and the bookmarks of the headings."""
    from reportlab.lib.pagesizes import A4
    from reportlab.platypus import Frame, PageTemplate

    def decorate(canvas: Any, document: Any) -> None:
        _decorate(canvas, document.page, document.pages, title, program)

    template = _document_class()(
        stream, pagesize=A4, title=title, author=program, subject="Report of a photogrammetric "
        "project", creator=program, producer=program, keywords="georeferencing, accuracy, report",
        lang="en", initialFontName=PLAIN, pageCompression=1,
    )  # fmt: skip
    frame = Frame(
        MARGIN, MARGIN, A4[0] - 2 * MARGIN, A4[1] - TOP - MARGIN, leftPadding=0, rightPadding=0,
        topPadding=0, bottomPadding=0,
    )  # fmt: skip
    template.addPageTemplates([PageTemplate(id="page", frames=[frame], onPage=decorate)])
    return template


def _document_class() -> Any:
    from reportlab.platypus import BaseDocTemplate

    class Document(BaseDocTemplate):  # type: ignore[misc]
        """Notes where the headings stand, and how many pages the pass before had."""

        # read by the figures: the first pass only finds out where everything stands
        pages = 0
        last = 0

        def beforeDocument(self) -> None:
            """Begin a pass."""
            self.pages = self.last

        def afterPage(self) -> None:
            """Count."""
            self.last = self.page

        def afterFlowable(self, flowable: Any) -> None:
            """Bookmark a heading, and put those of sections into the contents."""
            key = getattr(flowable, "anchor", "")
            if not key:
                return
            self.canv.bookmarkHorizontal(key, 0, self.frame._y + flowable.height)
            level = 1 if flowable.rank == "item" else 0
            self.canv.addOutlineEntry(flowable.words, key, level, level > 0)
            if flowable.rank == "section":
                self.notify("TOCEntry", (0, flowable.contents, self.page, key))

    return Document


def _decorate(canvas: Any, page: int, of: int, title: str, program: str) -> None:
    """Header and footer of a page."""
    from reportlab.lib.pagesizes import A4

    width, height = A4
    canvas.saveState()
    canvas.setFillColor(GREY)
    canvas.setStrokeColor(GREY)
    canvas.setLineWidth(0.4)
    canvas.setFont(PLAIN, 7.5)
    short = title if len(title) <= _HEADER else f"{title[: _HEADER - 3]}..."
    canvas.drawString(MARGIN, height - 12 * mm, short)
    canvas.drawRightString(width - MARGIN, height - 12 * mm, program)
    canvas.line(MARGIN, height - 14 * mm, width - MARGIN, height - 14 * mm)
    canvas.drawCentredString(width / 2, 9 * mm, f"Page {page}" + (f" of {of}" if of else ""))
    canvas.restoreState()
