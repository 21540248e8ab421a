"""One HTML file without scripts and without anything from elsewhere.

Pictures are data URIs. Every picture says what to look for and what was found; the marks of the
verdicts are words and signs, not colours alone. HTML and `alt` as WCAG 2.2 asks: language, skip
link, headings in order, captions and scopes of tables, wide tables that the keyboard can scroll.
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape
from typing import Literal

from georef_gis.measure.report.style import STYLE

Level = Literal["fine", "look", "bad", "told"]
SIGN = {"fine": "✓ Fine", "look": "▲ Look here", "bad": "✗ Not good", "told": "For information"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """What was found in a figure: `level` and one sentence with its numbers.

    `again` is set where another figure of the page was judged by the same numbers: then it stands
    below its figure but is neither listed nor counted at the top. `first` heads the list there.
    """

    level: Level
    text: str
    again: bool = False
    first: bool = False


def judged(text: str, *, fine: bool, bad: bool = False) -> Verdict:
    """Verdict of two tests: fine, not good, or worth a look."""
    return Verdict(level="fine" if fine else "bad" if bad else "look", text=text)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Picture:
    """A picture with what to look for in it.

    Parameters
    ----------
    data
        Bytes of a PNG or JPEG file.
    alt
        What it shows, for those who do not see it.
    look
        One sentence: what to look for.
    """

    title: str
    data: bytes
    alt: str
    look: str
    verdict: Verdict
    narrow: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """A table of texts; the first column heads the rows.

    Parameters
    ----------
    words
        Columns, counted from 0, that hold words; the others are numbers and stand at the right.
    """

    title: str
    columns: tuple[str, ...]
    rows: Sequence[Sequence[str]]
    look: str = ""
    verdict: Verdict | None = None
    words: tuple[int, ...] = (0,)


@dataclass(frozen=True, slots=True, kw_only=True)
class Text:
    """Paragraphs; one that is judged has a title."""

    lines: tuple[str, ...]
    title: str = ""
    verdict: Verdict | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Lines:
    """A titled list of lines; beyond `most` they are counted only."""

    title: str
    lines: tuple[str, ...]
    most: int = 60


@dataclass(frozen=True, slots=True, kw_only=True)
class Letter:
    """A text whose lines stay as they are."""

    title: str
    text: str


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Thumbnail:
    """A small picture, a PNG or JPEG file, and the words below it."""

    data: bytes
    caption: str


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Gallery:
    """Small pictures side by side."""

    title: str
    pictures: tuple[Thumbnail, ...]
    look: str = ""


Item = Picture | Table | Text | Lines | Letter | Gallery


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Section:
    """A part of the page; `id` is its anchor."""

    id: str
    title: str
    items: list[Item] = field(default_factory=list)


def render(title: str, facts: Sequence[tuple[str, str]], sections: Sequence[Section]) -> str:
    """The whole page.

    Parameters
    ----------
    facts
        Names and values below the title.
    """
    body = [
        f"<h1>{escape(title)}</h1>",
        _facts(facts),
        _findings(sections),
        _contents(sections),
    ]
    for section in sections:
        body.append(f'<section id="{section.id}"><h2>{escape(section.title)}</h2>')
        body += [_item(f"{section.id}-{i}", item) for i, item in enumerate(section.items, 1)]
        body.append("</section>")
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n"
        '<a class="skip" href="#findings">Skip to the findings</a>\n<main>\n'
        + "\n".join(body)
        + "\n</main>\n</body>\n</html>\n"
    )


def verdict_of(item: Item) -> Verdict | None:
    """What was found in an item; None for those that are not judged."""
    return item.verdict if isinstance(item, Picture | Table | Text) else None


def count_verdicts(sections: Sequence[Section]) -> dict[str, int]:
    """Number of pictures and tables by what was found in them: fine, look, bad."""
    out = {"fine": 0, "look": 0, "bad": 0}
    for section in sections:
        for item in section.items:
            verdict = verdict_of(item)
            if verdict is not None and not verdict.again and verdict.level in out:
                out[verdict.level] += 1
    return out


def _facts(facts: Sequence[tuple[str, str]]) -> str:
    rows = "".join(f"<dt>{escape(k)}</dt><dd>{escape(v)}</dd>" for k, v in facts)
    return f'<dl class="facts">{rows}</dl>'


def _contents(sections: Sequence[Section]) -> str:
    links = "".join(f'<li><a href="#{s.id}">{escape(s.title)}</a></li>' for s in sections)
    return f'<nav aria-label="Contents"><h2>Contents</h2><ol>{links}</ol></nav>'


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """A figure or table that asks for a look; `key` is its anchor."""

    key: str
    title: str
    verdict: Verdict


def findings_of(sections: Sequence[Section]) -> tuple[str, list[Finding]]:
    """What was found, in a sentence, and what asks for a look: the first, then the worst."""
    weighed = [
        Finding(key=key, title=item.title, verdict=verdict)
        for key, item in numbered(sections)
        if (verdict := verdict_of(item)) is not None
        if verdict.level != "told" and not verdict.again
        if not isinstance(item, Letter | Lines | Gallery)
    ]
    fine = sum(one.verdict.level == "fine" for one in weighed)
    rank = {"bad": 1, "look": 2}
    asking = [one for one in weighed if one.verdict.level in rank]
    asking.sort(key=lambda one: 0 if one.verdict.first else rank[one.verdict.level])
    told = f"{fine} of {len(weighed)} figures and tables that were judged are fine."
    return told + (" These ask for a look:" if asking else ""), asking


def numbered(sections: Sequence[Section]) -> list[tuple[str, Item]]:
    """Items with their anchors."""
    return [(f"{s.id}-{i}", item) for s in sections for i, item in enumerate(s.items, 1)]


def _findings(sections: Sequence[Section]) -> str:
    """What the page found, with links."""
    told, asking = findings_of(sections)
    lines = [
        f'<li class="{one.verdict.level}"><span class="sign">{SIGN[one.verdict.level]}</span> '
        f'<a href="#{one.key}">{escape(one.title)}</a>: {escape(one.verdict.text)}</li>'
        for one in asking
    ]
    return (
        f'<section id="findings"><h2>Findings</h2><p>{told}</p>'
        f'<ul class="findings">{"".join(lines)}</ul></section>'
    )


def _item(key: str, item: Item) -> str:
    if isinstance(item, Picture):
        return _picture(key, item)
    if isinstance(item, Table):
        return _table(key, item)
    if isinstance(item, Text):
        return _text(key, item)
    if isinstance(item, Letter):
        return f"<h3>{escape(item.title)}</h3><pre>{escape(item.text)}</pre>"
    if isinstance(item, Gallery):
        return _gallery(key, item)
    shown = "".join(f"<li>{escape(line)}</li>" for line in item.lines[: item.most])
    more = len(item.lines) - item.most
    shown += f"<li>... and {more} more, in the table `run` of georef.gpkg</li>" if more > 0 else ""
    return f"<h3>{escape(item.title)}</h3><ul>{shown}</ul>"


def _text(key: str, item: Text) -> str:
    lines = "".join(f"<p>{escape(line)}</p>" for line in item.lines)
    if item.verdict is None:
        return lines
    told = _told("", item.verdict)
    return (
        f'<div id="{key}"><h3>{escape(item.title)}</h3>{lines}<p class="caption">{told}</p></div>'
    )


def _told(look: str, verdict: Verdict | None) -> str:
    told = f"{escape(look)} " if look else ""
    if verdict is None:
        return told
    sign = SIGN[verdict.level]
    return (
        f'{told}<span class="verdict {verdict.level}"><span class="sign">{sign}:</span> '
        f"{escape(verdict.text)}</span>"
    )


def _source(data: bytes) -> str:
    """A picture as the address of an `img`."""
    mime = "image/jpeg" if data.startswith(b"\xff\xd8") else "image/png"
    return f"data:{mime};base64,{base64.b64encode(data).decode('ascii')}"


def _gallery(key: str, item: Gallery) -> str:
    cells = "".join(
        f'<li><img src="{_source(one.data)}" alt="{escape("Photo of " + one.caption)}">'
        f"<span>{escape(one.caption)}</span></li>"
        for one in item.pictures
    )
    look = f'<p class="caption">{escape(item.look)}</p>' if item.look else ""
    return (
        f'<div id="{key}"><h3>{escape(item.title)}</h3><ul class="thumbs">{cells}</ul>{look}</div>'
    )


def _picture(key: str, item: Picture) -> str:
    kind = ' class="narrow"' if item.narrow else ""
    return (
        f'<figure id="{key}"{kind}><h3>{escape(item.title)}</h3>'
        f'<img src="{_source(item.data)}" alt="{escape(item.alt)}">'
        f"<figcaption>{_told(item.look, item.verdict)}</figcaption></figure>"
    )


def _table(key: str, item: Table) -> str:
    kinds = ["word" if i in item.words else "number" for i in range(len(item.columns))]
    head = "".join(
        f'<th scope="col" class="{kind}">{escape(name)}</th>'
        for kind, name in zip(kinds, item.columns, strict=True)
    )
    rows = []
    for row in item.rows:
        first, *rest = (escape(cell) for cell in row)
        cells = "".join(f'<td class="{k}">{c}</td>' for k, c in zip(kinds[1:], rest, strict=True))
        rows.append(f'<tr><th scope="row" class="{kinds[0]}">{first}</th>{cells}</tr>')
    told = _told(item.look, item.verdict)
    return (
        f'<div class="table" id="{key}"><h3>{escape(item.title)}</h3>'
        f'<div class="wide" tabindex="0" role="region" aria-label="{escape(item.title)}">'
        f'<table><caption class="hidden">{escape(item.title)}</caption>'
        f"<thead><tr>{head}</tr></thead><tbody>{''.join(rows)}</tbody></table></div>"
        + (f'<p class="caption">{told}</p>' if told else "")
        + "</div>"
    )
