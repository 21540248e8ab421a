"""Legend and accuracy statement as small pictures that stay on the screen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO
from typing import Any

import cv2
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from exports.kml.icons import ELLIPSE, ClassLook, Colour, Picture, icon

LEGEND, STATEMENT = "files/legend.png", "files/accuracy.png"
# px
TEXT, TITLE, LINE, PAD, MARGIN = 15, 17, 24, 12, 8
WIDTH = 430
# More classes would fill the screen.
MOST_CLASSES = 24
# Longer words and names are cut, so that they do not leave the picture.
LONGEST = 44
_GROUND = (24, 24, 24, 205)
_WHITE = (255, 255, 255, 255)
_GREY = (205, 205, 205, 255)


@dataclass(frozen=True, slots=True, kw_only=True)
class Entry:
    """A line of the legend: what is drawn, and what it stands for.

    Parameters
    ----------
    sign
        BGRA of at most `LINE` px; None = text alone.
    """

    sign: Picture | None
    text: str


def legend(entries: Sequence[Entry], title: str) -> bytes:
    """PNG of a legend."""
    font, bold = _font(TEXT), _font(TITLE)
    texts = [_cut(entry.text) for entry in entries]
    wide = max([font.getlength(text) + LINE + 8 for text in texts] + [bold.getlength(_cut(title))])
    size = (int(wide) + 2 * PAD, 2 * PAD + LINE * (len(entries) + 1))
    image = Image.new("RGBA", size, _GROUND)
    draw = ImageDraw.Draw(image)
    draw.text((PAD, PAD), _cut(title), font=bold, fill=_WHITE)
    for i, (entry, text) in enumerate(zip(entries, texts, strict=True), start=1):
        y = PAD + i * LINE
        if entry.sign is not None:
            _paste(image, entry.sign, (PAD, y))
        draw.text((PAD + LINE + 8, y + 2), text, font=font, fill=_WHITE)
    return _png(image)


def statement(title: str, paragraphs: Sequence[str]) -> bytes:
    """PNG of some paragraphs of text."""
    font, bold = _font(TEXT), _font(TITLE)
    lines: list[str] = []
    for paragraph in paragraphs:
        lines += [*_wrapped(font, paragraph, WIDTH - 2 * PAD), ""]
    height = 2 * PAD + LINE + sum(TEXT + 5 if line else 7 for line in lines)
    image = Image.new("RGBA", (WIDTH, height), _GROUND)
    draw = ImageDraw.Draw(image)
    draw.text((PAD, PAD), _cut(title), font=bold, fill=_WHITE)
    y = PAD + LINE
    for line in lines:
        draw.text((PAD, y), line, font=font, fill=_GREY)
        y += TEXT + 5 if line else 7
    return _png(image)


def entries_of(looks: Sequence[ClassLook], signs: Sequence[tuple[str, str]]) -> list[Entry]:
    """Lines of the legend: parts of the site by the kind of their sign, then the classes.

    Parameters
    ----------
    signs
        Kind (camera, footprint, track, control, ellipse) and text.
    """
    out = [Entry(sign=_sign(kind), text=text) for kind, text in signs]
    for look in looks[:MOST_CLASSES]:
        out.append(Entry(sign=_sign_of(look), text=look.name.replace("_", " ") or "(no class)"))
    if len(looks) > MOST_CLASSES:
        out.append(Entry(sign=None, text=f"and {len(looks) - MOST_CLASSES} classes more"))
    return out


def _sign_of(look: ClassLook) -> Picture:
    if "asset_points" in look.geometries:
        return icon(look.form, look.colour)
    if "asset_lines" in look.geometries:
        return _line(look.colour)
    return _frame(look.colour, inside=70)


def _sign(kind: str) -> Picture | None:
    if kind == "camera":
        return icon("circle", (255, 255, 255))
    if kind == "control":
        return icon("triangle", (0, 255, 0))
    if kind == "footprint":
        return _frame((77, 192, 255), inside=0)
    if kind == "track":
        return _line((255, 255, 0))
    return _ellipse()


def _line(colour: Colour) -> Picture:
    out = np.zeros((LINE, LINE, 4), np.uint8)
    cv2.line(out, (2, LINE - 7), (LINE - 3, 6), (*reversed(colour), 255), 3, cv2.LINE_AA)
    return out


def _frame(colour: Colour, *, inside: int) -> Picture:
    """Outline of an area, filled with an opacity of `inside`."""
    out = np.zeros((LINE, LINE, 4), np.uint8)
    corners = (3, 6), (LINE - 4, LINE - 7)
    cv2.rectangle(out, *corners, (*reversed(colour), inside), -1)
    cv2.rectangle(out, *corners, (*reversed(colour), 255), 2)
    return out


def _ellipse() -> Picture:
    out = np.zeros((LINE, LINE, 4), np.uint8)
    bgr = tuple(reversed(ELLIPSE))
    centre, axes = (LINE // 2, LINE // 2), (9, 5)
    cv2.ellipse(out, centre, axes, 25, 0, 360, (*bgr, 70), -1)
    cv2.ellipse(out, centre, axes, 25, 0, 360, (*bgr, 255), 1, cv2.LINE_AA)
    return out


def _paste(image: Any, sign: Picture, at: tuple[int, int]) -> None:
    side = LINE - 4
    if sign.shape[0] > LINE:
        sign = np.asarray(cv2.resize(sign, (side, side), interpolation=cv2.INTER_AREA), np.uint8)
    picture = Image.fromarray(cv2.cvtColor(sign, cv2.COLOR_BGRA2RGBA))
    image.alpha_composite(picture, (at[0], at[1] + (LINE - sign.shape[0]) // 2))


def _font(size: int) -> Any:
    """The font that Pillow has with it: the same on every machine."""
    return ImageFont.load_default(size)


def _cut(text: str) -> str:
    flat = " ".join("".join(c if c.isprintable() else " " for c in text).split())
    return flat if len(flat) <= LONGEST else flat[: LONGEST - 3] + "..."


def _wrapped(font: Any, text: str, width: float) -> list[str]:
    lines: list[str] = []
    line = ""
    for word in text.split():
        longer = f"{line} {_cut(word)}".strip()
        if line and font.getlength(longer) > width:
            lines.append(line)
            longer = _cut(word)
        line = longer
    return [*lines, line] if line else lines


def _png(image: Any) -> bytes:
    out = BytesIO()
    # A free margin keeps the edge of the window and the viewer's own line of text free.
    framed = Image.new("RGBA", (image.width + 2 * MARGIN, image.height + 4 * MARGIN), (0, 0, 0, 0))
    framed.paste(image, (MARGIN, MARGIN))
    framed.save(out, "PNG", optimize=True)
    return out.getvalue()
