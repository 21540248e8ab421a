"""The source of the site: chapters, pictures and generated pages, put together in one folder."""

from __future__ import annotations

import shutil
from pathlib import Path

from site_builder.chapters import BORROWED, MADE, PARTS, written
from site_builder.command_lines import command_lines
from site_builder.settings_page import settings_page
from site_builder.texts import toctree
from site_builder.tool_pages import tool_pages


def stage(root: Path, target: Path) -> list[str]:
    """Fill a folder with the source of the site.

    Parameters
    ----------
    root
        Folder of the repository.
    target
        Folder to write; it must not be there.

    Returns
    -------
    left_out
        Chapters that the order names and that are not written.
    """
    chapters = written(root)
    target.mkdir(parents=True)
    shutil.copytree(root / "docs/pictures", target / "pictures")
    texts = {name: path.read_text("utf-8") for name, path in chapters.items()}
    for name, text in texts.items():
        if name in BORROWED:
            # written for a reader of the folder it lies in
            text = text.replace("](../docs/", "](")
        if name == "index":
            text = f"{text.rstrip()}\n\n{_navigation(set(chapters))}\n"
        (target / f"{name}.md").write_text(text, encoding="utf-8")
    pages = tool_pages({name: command_lines(text) for name, text in texts.items()})
    pages["settings.md"] = settings_page()
    for path, text in pages.items():
        (target / path).parent.mkdir(exist_ok=True)
        (target / path).write_text(text, encoding="utf-8")
    return [page for part in PARTS for page in part.pages if page not in {*chapters, *MADE}]


def _navigation(there: set[str]) -> str:
    """Trees of all parts; a page without a place in the order comes last."""
    placed = {"index", *(page for part in PARTS for page in part.pages)}
    trees = [(part.title, [p for p in part.pages if p in there | {*MADE}]) for part in PARTS]
    trees.append(("More", sorted(there - placed)))
    return "\n\n".join(toctree(pages, title) for title, pages in trees if pages)
