"""Extension of Sphinx: names of chapters and of commands in the text lead to their pages."""

from __future__ import annotations

import re
from typing import Any

import click
from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.transforms import SphinxTransform

from georef_gis.errors import GeorefError
from georef_gis.project.settings import Settings
from site_builder.chapters import BORROWED
from site_builder.command_lines import PROGRAM, command_of
from site_builder.tool_pages import page_name

SETTINGS = "settings"
# Headings that are not the name of their section.
ANCHORS = {"cameras": "cameras-model", "tools": "tools-tool"}


def chapter_of(text: str) -> str:
    """Page that ``measure.md`` or ``benchmarks/README.md`` names; empty if no text."""
    for page, path in BORROWED.items():
        if text == path:
            return page
    name = text.removeprefix("docs/")
    return name.removesuffix(".md") if name.endswith(".md") else ""


class LinkNames(SphinxTransform):
    """Make links of ``measure.md``, ``georef locate ...`` and ``[gnss] geoid``.

    They stand as code in the text, so that the chapters read well as plain files too.
    """

    default_priority = 400

    def apply(self, **kwargs: Any) -> None:
        """Look at every span of code outside titles and links."""
        for literal in list(self.document.findall(nodes.literal)):
            if isinstance(literal.parent, nodes.reference | nodes.title | addnodes.pending_xref):
                continue
            text = literal.astext()
            if chapter := self._chapter(text):
                literal.replace_self(self._titled(chapter))
            elif (page := self._command(text) or self._section(text)) and not self._here(page):
                up = "../" * self.env.docname.count("/")
                link = nodes.reference("", "", literal.deepcopy(), internal=True, refuri=up + page)
                literal.replace_self(link)

    def _here(self, page: str) -> bool:
        return page.partition("#")[0] == f"{self.env.docname}.html"

    def _chapter(self, text: str) -> str:
        page = chapter_of(text)
        return page if page in self.env.found_docs else ""

    def _command(self, text: str) -> str:
        if not text.startswith(f"{PROGRAM} "):
            return ""
        try:
            _, path, _ = command_of(text.split()[1:])
        except (click.UsageError, GeorefError):
            return ""
        page = f"tools/{page_name(path)}"
        return f"{page}.html" if path and page in self.env.found_docs else ""

    def _section(self, text: str) -> str:
        """Place of the section of project.toml that ``[gnss] geoid`` names."""
        if text == "project.toml":
            return f"{SETTINGS}.html"
        found = re.match(r"^\[([a-z]+)(?:\.[^\]]*)?\](?: \w+)?$", text)
        if not found or found[1] not in Settings.model_fields:
            return ""
        return f"{SETTINGS}.html#{ANCHORS.get(found[1], found[1])}"

    def _titled(self, chapter: str) -> addnodes.pending_xref:
        """Link that shows the title of a chapter."""
        return addnodes.pending_xref(
            "",
            nodes.inline("", ""),
            refdomain="std",
            reftype="doc",
            reftarget=f"/{chapter}",
            refdoc=self.env.docname,
            refexplicit=False,
            refwarn=True,
        )


def setup(app: Sphinx) -> dict[str, Any]:
    """Add the transform."""
    app.add_transform(LinkNames)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
