# SPDX-License-Identifier: GPL-2.0-or-later
"""A page of help for a tool, made from its manifest: for the Help button, without a network."""

from __future__ import annotations

import html
from pathlib import Path

from .tools import Field, Tool

STYLE = (
    "body{font:15px/1.5 sans-serif;max-width:56em;margin:2em auto;padding:0 1em;color:#222}"
    "table{border-collapse:collapse;width:100%}td,th{border-bottom:1px solid #ccc;padding:.4em;"
    "text-align:left;vertical-align:top}code{background:#eee;padding:0 .2em}"
)


# Types of the manifest whose names are no words
KINDS = {"RasterLayer": "raster layer", "VectorLayer": "vector layer", "MapPoint": "place",
         "PhotoPixel": "pixel of a photo", "PhotoSet": "photos", "TableField": "field of a table",
         "Crs": "CRS", "Flag": "yes or no"}  # fmt: skip


def write_page(tool: Tool, folder: Path) -> str:
    """Address of a page that tells all of a tool; empty if it cannot be written."""
    path, text = folder / f"{tool.name}.html", page(tool)
    try:
        if not (path.is_file() and path.read_text("utf-8") == text):
            folder.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
    except OSError:
        return ""
    return path.absolute().as_uri()


def page(tool: Tool) -> str:
    """Help of a tool as HTML."""
    e = html.escape
    paragraphs = "".join(f"<p>{e(part)}</p>" for part in tool.help.split("\n\n"))
    rows = "".join(_row(field) for field in tool.fields)
    table = (
        f"<table><tr><th>Parameter<th>Type<th>Default<th>What</tr>{rows}</table>" if rows else ""
    )
    outs = "".join(
        f"<li><code>{e(o.name)}</code> {e(o.title)} ({e(_kind(o.type))})" for o in tool.outputs
    )
    outputs = f"<h2>Outputs</h2><ul>{outs}</ul>" if outs else ""
    project = " --project FOLDER" if tool.needs_project and not tool.is_run else ""
    line = f"georef {' '.join(tool.words)}{project}"
    return (
        f'<!DOCTYPE html><html lang="en"><meta charset="utf-8"><title>{e(tool.title)}</title>'
        f"<style>{STYLE}</style><h1>{e(tool.title)}</h1>{paragraphs}"
        f"<p>On the command line: <code>{e(line)}</code></p>{table}{outputs}</html>\n"
    )


def _kind(name: str) -> str:
    """Type of the manifest in words."""
    return KINDS.get(name, name.lower())


def _row(field: Field) -> str:
    default = "" if field.default in (None, "", []) else field.default
    if isinstance(default, bool):
        default = "yes" if default else "no"
    what = "; ".join(text for text in (field.title, field.hint(), field.limits()) if text)
    kind = _kind(field.kind) + (f" in {field.unit}" if field.unit else "")
    cells = [f"<code>{html.escape(field.name)}</code>{' *' if field.required else ''}"]
    cells += [html.escape(str(text)) for text in (kind, default, what)]
    return "<tr>" + "".join(f"<td>{cell}" for cell in cells) + "</tr>"
