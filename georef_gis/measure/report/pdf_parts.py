"""Parts of the report as reportlab lays them out: headings, pictures, tables, texts."""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from functools import cached_property
from typing import Any

from georef_gis.measure.report.page import (
    SIGN,
    Finding,
    Gallery,
    Item,
    Letter,
    Lines,
    Picture,
    Section,
    Table,
    Text,
    Verdict,
    numbered,
)
from georef_gis.measure.report.pdf_fonts import BOLD, MONO, PLAIN, Fonts

# points per mm
mm = 72.0 / 25.4
BLUE, GREY, HEAD, RULE = "#0b4f7d", "#666666", "#f3f5f7", "#cccccc"
COLOURS = {"fine": "#00664b", "look": "#8a4b00", "bad": "#b3261e", "told": "#444444"}
_SIZES = {"title": 19.0, "section": 14.0, "item": 10.5}
# points; of tables the smallest that is tried before words are broken
_TABLE, _LEAST = 7.5, 5.6
# characters of a cell; the page shows the rest
_CELL = 900
# em; a longer word of a cell may be broken
_LONGEST_WORD = 12.0
# points beside the words of a cell, left and right together
_GAP = 6.0
# pictures of a gallery beside each other
_ACROSS = 6
# what lines of a cell may end at; not at spaces that must not be broken
_WORDS = re.compile(r"[ \n]+")
# style of every grid: its own font would be one that is not embedded
_GRID: tuple[tuple[Any, ...], ...] = (
    ("FONT", (0, 0), (-1, -1), PLAIN, _TABLE),
    ("VALIGN", (0, 0), (-1, -1), "TOP"),
)
# rows of a table that is kept on one page
_SHORT = 30


class Parts:
    """Makes flowables of one report.

    Parameters
    ----------
    width, height
        Of the text area, points.
    """

    def __init__(self, *, fonts: Fonts, width: float, height: float) -> None:
        self.fonts, self.width, self.height = fonts, width, height

    # -- words -------------------------------------------------------------------------------

    @cached_property
    def _styles(self) -> dict[str, Any]:
        from reportlab.lib.styles import ParagraphStyle

        base = ParagraphStyle(
            "base", fontName=PLAIN, bulletFontName=PLAIN, fontSize=8.8, leading=12, spaceAfter=3,
            splitLongWords=1,
        )  # fmt: skip
        out = {"base": base}
        for rank, size in _SIZES.items():
            out[rank] = ParagraphStyle(
                rank, base, fontName=BOLD, fontSize=size, leading=1.25 * size, keepWithNext=1,
                spaceBefore=0 if rank == "title" else 0.9 * size, spaceAfter=0.35 * size,
                textColor=BLUE if rank == "section" else "#1b1b1b",
            )  # fmt: skip
        out["line"] = ParagraphStyle("line", base, leftIndent=8, bulletIndent=0, fontSize=8.2)
        out["cell"] = ParagraphStyle("cell", base, fontSize=_TABLE, leading=9, spaceAfter=0)
        out["thumb"] = ParagraphStyle("thumb", base, fontSize=6.2, leading=7.4, spaceAfter=0)
        out["mono"] = ParagraphStyle(
            "mono", base, fontName=MONO, fontSize=6.6, leading=8.6, backColor="#f7f7f7",
        )  # fmt: skip
        return out

    def heading(self, words: str, rank: str, anchor: str) -> Any:
        """Title, heading of a section or of an item; bookmarked where it has an anchor."""
        from reportlab.platypus import Paragraph

        made = Paragraph(self.fonts.markup(words, BOLD), self._styles[rank])
        made.words, made.rank, made.anchor = self.fonts.plain(words), rank, anchor
        made.contents = self.fonts.markup(words)
        return made

    def text(self, words: str, style: str = "base") -> Any:
        """A paragraph."""
        return self._marked(self.fonts.markup(words), style)

    def _marked(self, markup: str, style: str = "base") -> Any:
        from reportlab.platypus import Paragraph

        return Paragraph(markup, self._styles[style])

    def finding(self, one: Finding) -> Any:
        """What asks for a look, with a link and a bar in the colour of its verdict."""
        from reportlab.platypus import Table as Grid

        sign = self._sign(one.verdict, "")
        link = f'<a href="#{one.key}" color="{BLUE}">{self.fonts.markup(one.title)}</a>'
        told = self._marked(f"{sign} {link}: {self.fonts.markup(one.verdict.text)}")
        colour = COLOURS[one.verdict.level]
        style = [
            *_GRID,
            ("LINEBEFORE", (0, 0), (0, -1), 2.5, colour),
            ("BOTTOMPADDING", (0, 0), (-1, -1), 1),
        ]
        return Grid([[told]], colWidths=[self.width], style=style, spaceAfter=3)

    def _sign(self, verdict: Verdict, after: str) -> str:
        colour = COLOURS[verdict.level]
        words = self.fonts.markup(SIGN[verdict.level] + after, BOLD)
        return f'<font name="{BOLD}" color="{colour}">{words}</font>'

    def _told(self, look: str, verdict: Verdict | None) -> list[Any]:
        """What to look for, and what was found; nothing where neither is said."""
        parts = [self.fonts.markup(look)] if look else []
        if verdict is not None:
            parts.append(f"{self._sign(verdict, ':')} {self.fonts.markup(verdict.text)}")
        return [self._marked(" ".join(parts))] if parts else []

    def pairs(self, facts: Sequence[tuple[str, str]]) -> Any:
        """Names and values."""
        from reportlab.platypus import Table as Grid

        rows = [
            [self._marked(f"<b>{self.fonts.markup(k, BOLD)}</b>"), self.text(v)] for k, v in facts
        ]
        wide = 38 * mm
        bare = [(f"{side}PADDING", (0, 0), (-1, -1), 0) for side in ("LEFT", "TOP", "BOTTOM")]
        style = [*_GRID, *bare]
        return Grid(rows, colWidths=[wide, self.width - wide], style=style, hAlign="LEFT")

    def contents(self) -> Any:
        """Sections with their pages."""
        from reportlab.platypus.tableofcontents import TableOfContents

        bare = [(f"{side}PADDING", (0, 0), (-1, -1), 0) for side in ("LEFT", "RIGHT", "TOP")]
        return TableOfContents(
            levelStyles=[self._styles["base"]], dotsMinLevel=0, tableStyle=[*_GRID, *bare]
        )

    # -- sections ----------------------------------------------------------------------------

    def section(self, section: Section) -> list[Any]:
        """Heading and items."""
        head = self.heading(section.title, "section", section.id)
        out: list[Any] = []
        for key, item in numbered([section]):
            made = self._item(key, item)
            out += self._together([head, *made] if not out else made, item)
        return out or [head]

    def _together(self, made: list[Any], item: Item) -> list[Any]:
        """Keep what belongs to one item on one page, unless it may be longer than that."""
        from reportlab.platypus import KeepTogether

        short = isinstance(item, Picture) or (isinstance(item, Table) and len(item.rows) <= _SHORT)
        return [KeepTogether(made)] if short else made

    def _item(self, key: str, item: Item) -> list[Any]:
        if isinstance(item, Picture):
            return self._picture(key, item)
        if isinstance(item, Table):
            return self._table(key, item)
        if isinstance(item, Gallery):
            return self._gallery(key, item)
        if isinstance(item, Letter):
            return self._letter(key, item)
        if isinstance(item, Lines):
            return self._lines(key, item)
        return self._text(key, item)

    def _text(self, key: str, item: Text) -> list[Any]:
        head = [self.heading(item.title, "item", key)] if item.verdict is not None else []
        return [*head, *(self.text(line) for line in item.lines), *self._told("", item.verdict)]

    def _lines(self, key: str, item: Lines) -> list[Any]:
        more = len(item.lines) - item.most
        lines = [*item.lines[: item.most]]
        lines += [f"... and {more} more, in the table `run` of georef.gpkg"] if more > 0 else []
        return [
            self.heading(item.title, "item", key),
            *(self._marked(f"<bullet>•</bullet>{self.fonts.markup(x)}", "line") for x in lines),
        ]

    def _letter(self, key: str, item: Letter) -> list[Any]:
        from reportlab.platypus import Preformatted

        style = self._styles["mono"]
        # 0.602 em: the width of every character of this font
        most = int(self.width / (0.603 * style.fontSize))
        text = self.fonts.plain(item.text, MONO)
        return [
            self.heading(item.title, "item", key),
            Preformatted(text, style, maxLineLength=most, newLineChars=""),
        ]

    # -- pictures ----------------------------------------------------------------------------

    def _picture(self, key: str, item: Picture) -> list[Any]:
        share = 0.66 if item.narrow else 1.0
        told = self._told(item.look, item.verdict)
        image = self._image(item.data, share * self.width, 0.6 * self.height)
        return [self.heading(item.title, "item", key), image, *told]

    def _image(self, data: bytes, width: float, height: float) -> Any:
        """A picture as large as fits; PNGs lose the opacity that doubles their size."""
        from PIL import Image as Pixels

        with Pixels.open(io.BytesIO(data)) as picture:
            columns, rows = picture.size
            if picture.mode not in ("RGB", "L"):
                stream = io.BytesIO()
                picture.convert("RGB").save(stream, format="PNG", compress_level=1)
                data = stream.getvalue()
        scale = min(width / columns, height / rows)
        return _figure(data, columns * scale, rows * scale)

    def _gallery(self, key: str, item: Gallery) -> list[Any]:
        from reportlab.platypus import Table as Grid

        wide = self.width / _ACROSS
        cells = [
            [self._image(one.data, wide - 6, wide - 6), self.text(one.caption, "thumb")]
            for one in item.pictures
        ]
        cells += [[]] * (-len(cells) % _ACROSS)
        rows = [cells[i : i + _ACROSS] for i in range(0, len(cells), _ACROSS)]
        style = [*_GRID, ("LEFTPADDING", (0, 0), (-1, -1), 0)]
        return [
            self.heading(item.title, "item", key),
            Grid(rows, colWidths=[wide] * _ACROSS, style=style, hAlign="LEFT"),
            *self._told(item.look, None),
        ]

    # -- tables ------------------------------------------------------------------------------

    def _table(self, key: str, item: Table) -> list[Any]:
        head = self.heading(item.title, "item", key)
        if not item.rows:
            return [head, *self._told(item.look, item.verdict)]
        return [head, self._grid(item), *self._told(item.look, item.verdict)]

    def _grid(self, item: Table) -> Any:
        from reportlab.platypus import LongTable

        widths, size = self._widths(item)
        cells = [
            [
                self._cell(name, size, wrap=True, head="left" if i in item.words else "right")
                for i, name in enumerate(item.columns)
            ]
        ]
        for row in item.rows:
            cells.append(
                [self._cell(text, size, wrap=i in item.words) for i, text in enumerate(row)]
            )
        style = [
            ("FONT", (0, 0), (-1, -1), PLAIN, size, 1.2 * size),
            ("VALIGN", (0, 0), (-1, -1), "TOP"), ("VALIGN", (0, 0), (-1, 0), "BOTTOM"),
            ("BACKGROUND", (0, 0), (-1, 0), HEAD), ("LINEBELOW", (0, 0), (-1, 0), 1.0, GREY),
            ("LINEBELOW", (0, 1), (-1, -1), 0.3, RULE),
            ("LEFTPADDING", (0, 0), (-1, -1), 2.5), ("RIGHTPADDING", (0, 0), (-1, -1), 2.5),
            ("TOPPADDING", (0, 0), (-1, -1), 1.2), ("BOTTOMPADDING", (0, 0), (-1, -1), 1.8),
        ]  # fmt: skip
        style += [
            ("ALIGN", (i, 1), (i, -1), "RIGHT")
            for i in range(len(item.columns)) if i not in item.words
        ]  # fmt: skip
        return LongTable(
            cells, colWidths=widths, repeatRows=1, style=style, hAlign="LEFT", splitInRow=1,
            spaceAfter=4,
        )  # fmt: skip

    def _cell(self, text: str, size: float, *, wrap: bool, head: str = "") -> Any:
        """A number as it is; words as a paragraph that breaks; a `head` stands left or right."""
        if not wrap and self.fonts.is_plain(text):
            return text
        from reportlab.lib.styles import ParagraphStyle
        from reportlab.platypus import Paragraph

        short = text if len(text) <= _CELL else f"{text[:_CELL]} ..."
        font = BOLD if head else PLAIN
        style = ParagraphStyle(
            "cell", self._styles["cell"], fontName=font, fontSize=size, leading=1.2 * size,
            alignment=2 if head == "right" else 0,
        )  # fmt: skip
        return Paragraph(self.fonts.markup(short, font), style)

    def _widths(self, item: Table) -> tuple[list[float], float]:
        """Widths of the columns, points, and the size of the letters at which they fit."""
        columns = range(len(item.columns))
        least, whole = [], []
        for i in columns:
            cells = [self._wide(row[i]) for row in item.rows]
            words = [self._wide(word) for row in item.rows for word in _WORDS.split(row[i])]
            head = [self._wide(word, BOLD) for word in _WORDS.split(item.columns[i])]
            own = min(max(words, default=0.0), _LONGEST_WORD) if i in item.words else max(cells)
            least.append(max(own, *head, 1.0))
            whole.append(max(least[i], *cells, self._wide(item.columns[i], BOLD)))
        gaps = _GAP * len(least)
        size = min(_TABLE, max(_LEAST, (self.width - gaps) / sum(least)))
        # what is left goes to those that would need more, each by what it lacks
        room = self.width - gaps - size * sum(least)
        lack = [size * (w - n) for w, n in zip(whole, least, strict=True)]
        share = min(1.0, max(room, 0.0) / max(sum(lack), 1e-9))
        widths = [size * n + share * more + _GAP for n, more in zip(least, lack, strict=True)]
        return [w * min(1.0, self.width / sum(widths)) for w in widths], size

    def _wide(self, text: str, font: str = PLAIN) -> float:
        """Width of a text in em."""
        from reportlab.pdfbase.pdfmetrics import stringWidth

        return float(stringWidth(self.fonts.plain(text, font), font, 1.0))


def _figure(data: bytes, width: float, height: float) -> Any:
    """A picture that is drawn in the last pass only: the others need no more than its size."""
    from reportlab.platypus import Image

    class Figure(Image):  # type: ignore[misc]
        """A picture of a report."""

        def draw(self) -> None:
            """Draw it once the pages are counted."""
            if self.canv._doctemplate.pages:
                super().draw()

    return Figure(io.BytesIO(data), width, height, hAlign="LEFT")
