"""The report as PDF, read back with pypdf: pages, heads, fonts, links, and what no font has."""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest
from pypdf import PdfReader
from report_cases import adjusted_facts

from georef_gis.measure.report.build import report_pdf, report_sections
from georef_gis.measure.report.page import (
    Gallery,
    Item,
    Letter,
    Lines,
    Picture,
    Section,
    Table,
    Text,
    Thumbnail,
    judged,
)
from georef_gis.measure.report.pdf import Pdf, render_pdf
from georef_gis.measure.report.pdf_fonts import BOX, Fonts, seen

A4 = (595.3, 841.9)


def picture(rows: int, cols: int, *, alpha: bool = False) -> bytes:
    noise = np.random.default_rng(2).integers(0, 255, (rows, cols, 4 if alpha else 3))
    done, raw = cv2.imencode(".png", noise.astype(np.uint8))
    assert done
    return raw.tobytes()


def made(items: Sequence[Item], title: str = "Site") -> Pdf:
    return render_pdf(
        title, [("Flown", "today")], [Section(id="s", title="Part", items=list(items))],
        program="georef_gis 0.1.0",
    )  # fmt: skip


def texts(pdf: Pdf) -> list[str]:
    return [page.extract_text() for page in PdfReader(io.BytesIO(pdf.content)).pages]


@pytest.fixture(scope="module")
def adjusted() -> Pdf:
    facts = adjusted_facts()
    return report_pdf(facts, report_sections(facts, None), made="2026", versions="georef 1, x")


def test_every_page_has_its_number_and_the_name_of_the_project(adjusted: Pdf) -> None:
    pages = texts(adjusted)
    assert len(pages) == adjusted.pages > 5
    for number, text in enumerate(pages, start=1):
        assert f"Page {number} of {len(pages)}" in text
        assert "A <site> & more: report" in text


def test_properties_contents_and_bookmarks_are_there(adjusted: Pdf) -> None:
    reader = PdfReader(io.BytesIO(adjusted.content))
    assert reader.metadata is not None
    assert reader.metadata.title == "A <site> & more: report"
    assert reader.metadata.creator == "georef 1"
    assert reader.metadata.creation_date is not None
    assert reader.trailer["/Root"]["/Lang"] == "en"
    top = [entry.title for entry in reader.outline if not isinstance(entry, list)]
    assert {"Flight", "Error budget", "Assets", "What was doubtful"} <= set(top)
    first = reader.pages[0].extract_text()
    # the title and the findings stand on the first page, the contents do not name themselves
    for name in top[3:]:
        # the page that the contents name holds the heading
        # dots and number are drawn before the name
        found = re.search(r"\. (\d+)\s*" + re.escape(name), first)
        assert found is not None, name
        assert name in reader.pages[int(found[1]) - 1].extract_text()


def test_findings_link_to_the_pages_of_their_figures() -> None:
    bad = Table(title="Odd one", columns=("A", "B"), rows=[("a", "1")],
                verdict=judged("no.", fine=False))  # fmt: skip
    far = Table(title="Long", columns=("A", "B"), rows=[("a", "1")] * 150)
    reader = PdfReader(io.BytesIO(made([far, bad]).content))
    notes = [note.get_object() for note in reader.pages[0]["/Annots"]]
    goals = {note["/Dest"].get_object()[0].idnum for note in notes}
    (last,) = [p for p in reader.pages if "Odd one" in p.extract_text() and p != reader.pages[0]]
    assert last.indirect_reference.idnum in goals


def test_all_fonts_are_embedded(adjusted: Pdf) -> None:
    fonts = set()
    for page in PdfReader(io.BytesIO(adjusted.content)).pages:
        for font in page["/Resources"]["/Font"].values():
            found = font.get_object()
            fonts.add(found["/BaseFont"])
            assert "/FontFile2" in found["/FontDescriptor"].get_object(), found["/BaseFont"]
    assert any("DejaVuSans" in name for name in fonts)


def test_a_table_over_pages_repeats_its_head() -> None:
    rows = [(f"row {i}", str(i)) for i in range(200)]
    pages = texts(made([Table(title="Long", columns=("Column of names", "N"), rows=rows)]))
    with_rows = [text for text in pages if "row " in text]
    assert len(with_rows) > 2
    assert all("Column of names" in text for text in with_rows)
    found = [line for text in pages for line in text.splitlines() if line.startswith("row ")]
    # no row is lost or shown twice
    assert [line.split()[1] for line in found] == [str(i) for i in range(200)]


def test_a_cell_longer_than_a_page_and_one_without_spaces_break() -> None:
    rows = [("x" * 5000, "1"), ("word " * 4000, "2"), ("last", "3")]
    pdf = made([Table(title="T", columns=("A", "B"), rows=rows, words=(0,))])
    assert "last" in "".join(texts(pdf))


def test_a_wide_table_stays_on_the_paper() -> None:
    columns = tuple(f"column {i}" for i in range(16))
    rows = [tuple(f"{1234567.891 + i:.3f}" for i in range(16))] * 3
    pdf = made([Table(title="T", columns=columns, rows=rows)])
    page = PdfReader(io.BytesIO(pdf.content)).pages[0]
    right = []
    page.extract_text(visitor_text=lambda text, cm, tm, font, size: right.append(tm[4] * cm[0]))
    assert max(right) < A4[0]
    assert "1234582.891" in "".join(texts(pdf))


@pytest.mark.parametrize("alpha", [False, True])
@pytest.mark.parametrize("shape", [(300, 900), (900, 300), (2000, 200), (40, 40)])
def test_pictures_are_drawn_once_and_whole(shape: tuple[int, int], alpha: bool) -> None:
    verdict = judged("ok.", fine=True)
    item = Picture(title="P", data=picture(*shape, alpha=alpha), alt="a", look="l", verdict=verdict)
    reader = PdfReader(io.BytesIO(made([item, item]).content))
    boxes = []

    def before(operator: bytes, operands: list[object], cm: list[float], tm: object) -> None:
        if operator == b"Do":
            boxes.append(list(cm))

    for page in reader.pages:
        page.extract_text(visitor_operand_before=before)
    assert len(boxes) == 2
    for a, _, _, d, x, y in boxes:
        assert a / d == pytest.approx(shape[1] / shape[0], rel=1e-3)
        assert x >= 0.0
        assert y >= 0.0
        assert x + a <= A4[0]
        assert y + d <= A4[1]


def test_markup_in_words_is_text() -> None:
    evil = '<b>x</b> <img src="file:///etc/passwd"/> &amp; <para>'
    pdf = made(
        [
            Text(title=evil, lines=(evil,), verdict=judged(evil, fine=False)),
            Lines(title="L", lines=(evil,)),
            Letter(title="M", text=evil),
            Table(title="T", columns=("A", evil), rows=[(evil, evil)], words=(0, 1)),
            Gallery(title="G", pictures=(Thumbnail(data=picture(9, 9), caption=evil),)),
        ],
        title=evil,
    )  # fmt: skip
    text = " ".join("".join(texts(pdf)).split())
    assert text.count("<b>x</b>") >= 7
    assert text.count("&amp;") >= 7


def test_accents_are_shown_and_what_no_font_has_is_told() -> None:
    pdf = made([Text(lines=("Čeřovský Straße Ω — ñ ✓", "tab\tbell\x07 joined\u200d half \ud800")),
                Table(title="T", columns=("A", "B"), rows=[("a", "\U0001f6a7")])])  # fmt: skip
    text = "".join(texts(pdf))
    assert "Čeřovský Straße Ω — ñ ✓" in text
    for character in pdf.missing:
        assert character not in "Čeřovský Straße Ω — ñ ✓"
    # a road-work sign: some systems have a font for it
    assert "\U0001f6a7" in pdf.missing or "\U0001f6a7" in text
    fonts = Fonts.registered()
    # U+10FFFD is for private use: no font has it
    assert fonts.plain("a\U0010fffdb") == f"a{BOX}b"
    assert fonts.missing == ["\U0010fffd"]


def test_a_character_of_another_font_here_is_set_in_that() -> None:
    fonts = Fonts.registered()
    # CIRCLED HANGUL, of none of the fonts; a stand-in for those of a system
    from matplotlib import get_data_path

    folder = Path(get_data_path()) / "fonts" / "ttf"
    fonts._left = [folder / "STIXGeneral.ttf"]
    fonts._deadline = float("inf")
    # U+2FF0 is in no font; U+22F2, an element of with long stroke, is in STIX
    lone = next(c for c in map(chr, range(0x2900, 0x2C00)) if not fonts.is_plain(c))
    marked = fonts.markup(f"a{lone}b")
    assert marked.startswith("a<font name=")
    assert lone in marked
    assert fonts.missing == []


def test_text_without_glyphs_of_its_own_is_dropped() -> None:
    assert seen("a\u202eb\x00c\ufe0fd\te\nf") == "abcd    e\nf"
    assert seen("e\u0301") == "é"
    assert seen("\udc80") == "\ufffd"
