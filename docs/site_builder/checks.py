"""What a finished site must hold: links that lead somewhere, and nothing from other hosts."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

# Attributes whose target a browser fetches by itself.
FETCHED = {
    "script": ("src",), "img": ("src", "srcset"), "link": ("href",), "iframe": ("src",),
    "source": ("src", "srcset"), "video": ("src", "poster"), "object": ("data",),
}  # fmt: skip
STYLE_URL = re.compile(r"""(?:url\(\s*|@import\s+)["']?([^"')\s;]+)""")


@dataclass(slots=True, kw_only=True)
class Page:
    """What one page names and holds."""

    ids: set[str] = field(default_factory=set)
    links: list[str] = field(default_factory=list)
    fetched: list[str] = field(default_factory=list)
    pictures_without_words: list[str] = field(default_factory=list)


class _Reader(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.page = Page()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {name: value or "" for name, value in attrs}
        if "id" in given:
            self.page.ids.add(given["id"])
        if tag == "a" and "href" in given:
            self.page.links.append(given["href"])
        for name in FETCHED.get(tag, ()):
            if given.get(name):
                self.page.fetched.append(given[name])
        if tag == "img" and not given.get("alt"):
            self.page.pictures_without_words.append(given.get("src", ""))
        self.page.fetched += STYLE_URL.findall(given.get("style", ""))


def read_site(folder: Path) -> dict[Path, Page]:
    """Pages of a site, by file."""
    pages = {}
    for path in sorted(folder.rglob("*.html")):
        reader = _Reader()
        reader.feed(path.read_text("utf-8"))
        pages[path] = reader.page
    return pages


def broken_links(folder: Path) -> list[str]:
    """Links, anchors and pictures of a site that lead nowhere, in words."""
    pages, broken = read_site(folder), []
    for path, page in pages.items():
        name = path.relative_to(folder)
        broken += [f"{name}: a picture without words: {src}" for src in page.pictures_without_words]
        for link in (*page.links, *page.fetched):
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            if not target.is_file():
                broken.append(f"{name}: {link} is not there")
            elif parts.fragment and target in pages:
                if unquote(parts.fragment) not in pages[target].ids:
                    broken.append(f"{name}: {link} has no such place")
    return broken


def outside_links(folder: Path) -> set[str]:
    """Links to other hosts, which a reader may follow."""
    return {
        link
        for page in read_site(folder).values()
        for link in page.links
        if urlsplit(link).scheme or urlsplit(link).netloc
    }


def fetched_from_outside(folder: Path) -> list[str]:
    """What a browser would fetch from other hosts by itself, with the file that says so."""
    found = []
    for path, page in read_site(folder).items():
        found += [(path, link) for link in page.fetched]
    for path in folder.rglob("*.css"):
        found += [(path, link) for link in STYLE_URL.findall(path.read_text("utf-8"))]
    return [
        f"{path.relative_to(folder)}: {link}"
        for path, link in found
        if urlsplit(link).scheme not in ("", "data") or urlsplit(link).netloc
    ]
