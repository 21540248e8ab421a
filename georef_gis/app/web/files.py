"""Files of the page itself: read once, found by their address; nothing else can be asked for."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import resources
from importlib.resources.abc import Traversable

_TYPES = {
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".svg": "image/svg+xml",
    ".md": "text/plain; charset=utf-8",
}
START = "index.html"


@dataclass(frozen=True, slots=True, kw_only=True)
class PageFile:
    """A file as it is sent."""

    content: bytes
    media_type: str
    tag: str


def page_files() -> dict[str, PageFile]:
    """Address -> file."""
    found = dict(_walk(resources.files("georef_gis.app.web") / "static", "/static"))
    return {"/": found.pop(f"/static/{START}"), **found}


def _walk(folder: Traversable, address: str) -> Iterator[tuple[str, PageFile]]:
    for entry in folder.iterdir():
        name = f"{address}/{entry.name}"
        if entry.is_dir():
            yield from _walk(entry, name)
            continue
        kind = _TYPES.get(entry.name[entry.name.rfind(".") :])
        if kind is not None:
            content = entry.read_bytes()
            tag = hashlib.blake2b(content, digest_size=12).hexdigest()
            yield name, PageFile(content=content, media_type=kind, tag=f'"{tag}"')
