"""Fonts of the PDF: embedded ones that matplotlib brings, and others here for what they lack."""

from __future__ import annotations

import time
import unicodedata
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import Any

PLAIN, BOLD, MONO = "report", "report-bold", "report-mono"
_FILES = {PLAIN: "DejaVuSans.ttf", BOLD: "DejaVuSans-Bold.ttf", MONO: "DejaVuSansMono.ttf"}
# stands for a character that no font has
BOX = "□"
# s that are spent on looking through the fonts of the system
_LONGEST_SEARCH = 4.0
# fonts that draw a box for everything
_NO_FONTS = ("lastresort",)
# what has no glyph of its own: controls, marks of direction, joiners
_UNSEEN = {"Cc", "Cf"}
# stands for half a character, which file names may hold
_BROKEN = "\ufffd"


@dataclass(slots=True)
class Fonts:
    """Fonts that are registered with reportlab, and what none of them can show.

    Parameters
    ----------
    known
        Characters that each of the main fonts has, by its name.
    spare
        Character -> name of the font that is used for it; "" = none has it.
    """

    known: dict[str, frozenset[int]] = field(default_factory=dict)
    spare: dict[str, str] = field(default_factory=dict)
    _left: list[Path] | None = None
    _deadline: float = 0.0

    @classmethod
    def registered(cls) -> Fonts:
        """Fonts, made known to reportlab."""
        from matplotlib import get_data_path
        from reportlab.pdfbase import pdfmetrics

        out = cls()
        folder = Path(get_data_path()) / "fonts" / "ttf"
        for name, file in _FILES.items():
            font = _font(name, folder / file)
            pdfmetrics.registerFont(font)
            out.known[name] = frozenset(font.face.charToGlyph)
        pdfmetrics.registerFontFamily(PLAIN, normal=PLAIN, bold=BOLD, italic=PLAIN, boldItalic=BOLD)
        return out

    @property
    def missing(self) -> list[str]:
        """Characters that were asked for and that no font has, sorted."""
        return sorted(character for character, font in self.spare.items() if not font)

    def plain(self, text: str, font: str = PLAIN) -> str:
        """Text of which the font has every character; others are boxes."""
        return "".join(
            c if c == "\n" or self._font_of(c, font) == font else BOX for c in seen(text)
        )

    def markup(self, text: str, font: str = PLAIN) -> str:
        """Text as the markup of a paragraph: nothing in it is a tag, spare fonts are named."""
        out, run, now = [], "", font
        for c in seen(text):
            name = now if c == "\n" else self._font_of(c, font)
            if name != now and run:
                out.append(_tagged(run, now, font))
                run = ""
            run, now = run + (c if name else BOX), name or font
        out.append(_tagged(run, now, font))
        return "".join(out)

    def is_plain(self, text: str, font: str = PLAIN) -> bool:
        """Whether a font has all that a text shows."""
        return all(ord(c) in self.known[font] for c in text)

    def _font_of(self, character: str, font: str) -> str:
        """Font of a character: the one asked for, a spare one, "" if none has it."""
        if ord(character) in self.known[font]:
            return font
        if character not in self.spare:
            self.spare[character] = self._search(character)
        return self.spare[character]

    def _search(self, character: str) -> str:
        """Name of a font of the system that has a character, registered; "" if there is none."""
        for name, known in self.known.items():
            if name not in _FILES and ord(character) in known:
                return name
        if self._left is None:
            self._left = _system_fonts()
            self._deadline = time.monotonic() + _LONGEST_SEARCH
        while self._left and time.monotonic() < self._deadline:
            path = self._left.pop(0)
            name = f"spare-{len(self.known)}"
            known = _register(name, path)
            if known:
                self.known[name] = known
            if ord(character) in known:
                return name
        return ""


def seen(text: str) -> str:
    """Text without what has no glyph; line ends stay, combining marks are put together."""
    composed = unicodedata.normalize("NFC", text.replace("\t", "    "))
    kept = (c for c in composed if c == "\n" or not _is_unseen(c))
    return "".join(_BROKEN if "\ud800" <= c <= "\udfff" else c for c in kept)


def _is_unseen(character: str) -> bool:
    # variation selectors choose between looks of the character before them
    if "\ufe00" <= character <= "\ufe0f":
        return True
    return unicodedata.category(character) in _UNSEEN


def _tagged(run: str, font: str, usual: str) -> str:
    if not run:
        return ""
    text = escape(run).replace("\n", "<br/>")
    return text if font == usual else f'<font name="{font}">{text}</font>'


def _font(name: str, path: Path) -> Any:
    from reportlab.pdfbase.ttfonts import TTFont

    return TTFont(name, str(path))


def _register(name: str, path: Path) -> frozenset[int]:
    """Characters of a font, made known; none if it cannot be embedded (PostScript outlines)."""
    from reportlab.pdfbase import pdfmetrics

    try:
        font = _font(name, path)
        known = frozenset(font.face.charToGlyph)
        pdfmetrics.registerFont(font)
    # a broken font of the system is no reason to lose the report
    except Exception:
        return frozenset()
    return known


def _system_fonts() -> list[Path]:
    """TrueType fonts of the system and of matplotlib, plain ones first."""
    from matplotlib.font_manager import fontManager

    found = {
        Path(entry.fname): (entry.style != "normal", str(entry.weight) not in ("400", "normal"))
        for entry in fontManager.ttflist
        if entry.fname.lower().endswith((".ttf", ".ttc"))
        and not any(word in Path(entry.fname).name.lower() for word in _NO_FONTS)
    }
    return sorted(found, key=lambda path: (found[path], str(path)))
