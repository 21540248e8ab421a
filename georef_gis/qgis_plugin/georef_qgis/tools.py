# SPDX-License-Identifier: GPL-2.0-or-later
"""Tools as the manifest of georef tells them, and what each parameter becomes in QGIS."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

MANIFEST_VERSION = 1
OWN_PROVIDER = "georef"
# What a parameter becomes: type of the manifest -> kind of widget for (one, many).
WIDGETS = {
    "File": ("file", "files"),
    "Folder": ("folder", "lines"),
    "PhotoSet": ("lines", "lines"),
    "Crs": ("crs", "lines"),
    "Extent": ("extent", "lines"),
    "RasterLayer": ("raster", "lines"),
    "VectorLayer": ("vector", "lines"),
    "MapPoint": ("point", "lines"),
    "PhotoPixel": ("string", "lines"),
    "Length": ("number", "lines"),
    "Angle": ("number", "lines"),
    "Number": ("number", "lines"),
    "Integer": ("integer", "lines"),
    "Text": ("string", "lines"),
    "Flag": ("boolean", "lines"),
    "Choice": ("choice", "lines"),
    "TableField": ("field", "lines"),
}
HINTS = {
    "PhotoPixel": "photo:u,v such as IMG_0001.JPG:1200.5,800; (0, 0) is the middle of the first "
    "pixel",
    "MapPoint": "x,y[,height][@CRS] such as 604123.5,4330120.2@EPSG:32617",
    "PhotoSet": "names of photos, or patterns such as IMG_00*; empty = all",
}
# Ends of names that the words of a title tell, where the manifest names none.
WORDS = re.compile(r"\b(GeoJSON|JSON|CSV|KMZ|KML|PNG|PDF|TOML)\b")
MANY_PLACES = re.compile(r"\s*(.*?[-+.\d]\s*,\s*[-+.\deE]+(?:\s*@[^;\n]*)?)\s*(?:[;\n]|$)")


class ManifestError(Exception):
    """The manifest cannot be used; the text is one line with a cure."""


@dataclass(frozen=True)
class Field:
    """One parameter; `widget` is what it becomes in QGIS."""

    name: str
    kind: str
    widget: str
    title: str
    help: str
    required: bool
    default: Any
    unit: str = ""
    minimum: float | None = None
    maximum: float | None = None
    choices: tuple[str, ...] = ()
    suggestions: tuple[str, ...] = ()
    suffixes: tuple[str, ...] = ()
    of: str = ""
    multiple: bool = False
    advanced: bool = False
    positional: bool = False
    writes: bool = False
    # Whether the limits themselves are not allowed; a field of QGIS takes them, georef does not.
    above: bool = False
    below: bool = False

    @property
    def label(self) -> str:
        """Title with the unit."""
        return f"{self.title} [{self.unit}]" if self.unit else self.title

    @property
    def may_be_empty(self) -> bool:
        """Whether it can be left without a value; QGIS says so behind the title."""
        return not self.required and self.default in (None, "", [])

    def limits(self) -> str:
        """What may be given, in words; empty if anything may."""
        unit = f" {self.unit}" if self.unit else ""
        low, high = "above" if self.above else "at least", "below" if self.below else "at most"
        words = [f"{low} {self.minimum:g}{unit}"] if self.minimum is not None else []
        words += [f"{high} {self.maximum:g}{unit}"] if self.maximum is not None else []
        words += ["one of " + ", ".join(self.choices)] if self.choices else []
        return ", ".join(words)

    def hint(self) -> str:
        """Help of the parameter: what it is, and how it is written."""
        # QGIS has no list in which another text than those offered can be given.
        offered = ", ".join(text for text in self.suggestions if text not in self.help)
        texts = [self.help, f"such as {offered}" if offered else ""]
        if self.widget == "lines" or self.kind in ("PhotoPixel", "PhotoSet"):
            texts.append(HINTS.get(self.kind, ""))
        if self.widget == "lines":
            texts.append("one a line")
        return "; ".join(text.rstrip(". ") for text in texts if text)


@dataclass(frozen=True)
class Out:
    """One output: its name, title and type in the manifest."""

    name: str
    title: str
    type: str


@dataclass(frozen=True)
class Tool:
    """One tool of georef; `words` begin its command line."""

    name: str
    title: str
    group: str
    help: str
    words: tuple[str, ...]
    needs_project: bool
    in_run: bool
    fields: tuple[Field, ...]
    outputs: tuple[Out, ...]
    page: str = ""

    @property
    def is_run(self) -> bool:
        """Whether it is `georef run` itself."""
        return self.words == ("run",)

    def field(self, name: str) -> Field:
        """Parameter of a name."""
        return next(field for field in self.fields if field.name == name)


def read_tools(manifest: Mapping[str, Any]) -> list[Tool]:
    """All tools of a manifest, `georef run` first.

    Raises
    ------
    ManifestError
        If it is of another version than this plug-in reads.
    """
    version = manifest.get("manifest")
    if version != MANIFEST_VERSION:
        raise ManifestError(
            f"georef gives manifest {version}, this plug-in reads {MANIFEST_VERSION}; run "
            "`georef qgis install` of the georef in use"
        )
    return [read_tool(RUN)] + [read_tool(entry) for entry in manifest["tools"]]


def read_tool(entry: Mapping[str, Any]) -> Tool:
    """Tool of its entry in the manifest."""
    own = entry["provider"] == OWN_PROVIDER
    project = bool(entry["needs_project"])
    return Tool(
        # A third party's tool keeps the name of its provider: ids are unique within one only.
        name=entry["id"] if own else f"{entry['provider']}-{entry['id']}",
        title=entry["name"][:1].upper() + entry["name"][1:],
        group=entry["group"],
        help=entry["help"],
        words=tuple(entry.get("words", (entry["full_id"],))),
        needs_project=project,
        in_run=bool(entry["in_run"]),
        fields=tuple(read_field(item, project) for item in entry["parameters"]),
        outputs=tuple(Out(o["name"], o["title"], o["type"]) for o in entry["outputs"]),
        page=entry.get("help_url", ""),
    )


def read_field(item: Mapping[str, Any], project: bool) -> Field:
    """Parameter of its entry in the manifest; `project` tells whether its tool works on one."""
    multiple = bool(item.get("multiple"))
    default, required = item.get("default"), bool(item["required"])
    widget = WIDGETS.get(item["type"], ("string", "lines"))[multiple]
    if item.get("writes") and not multiple:
        widget = f"{widget}_out"
        # Beside a project georef knows a place; else it would be the folder QGIS was started in.
        if not project and default is not None:
            # A folder for a project lasts: none that QGIS throws away at its end.
            widget = "folder" if default == "." else widget
            default, required = None, True
    return Field(
        name=item["name"],
        kind=item["type"],
        widget=widget,
        title=item["title"],
        help=item.get("help", ""),
        required=required,
        default=default,
        unit=item.get("unit", ""),
        minimum=_either(item, "minimum", "above"),
        maximum=_either(item, "maximum", "below"),
        choices=tuple(item.get("choices", ())),
        suggestions=tuple(item.get("suggestions", ())),
        suffixes=_suffixes(item),
        of=item.get("of", ""),
        multiple=multiple or item["type"] == "PhotoSet",
        advanced=bool(item.get("advanced")),
        positional=bool(item.get("positional")),
        writes=bool(item.get("writes")),
        above="minimum" not in item and "above" in item,
        below="maximum" not in item and "below" in item,
    )


def _either(item: Mapping[str, Any], one: str, other: str) -> float | None:
    return item[one] if one in item else item.get(other)


def _suffixes(item: Mapping[str, Any]) -> tuple[str, ...]:
    """Ends of file names: those declared, that of the default, or those the title speaks of."""
    told = tuple(item.get("suffixes", ()))
    if told or not item.get("writes"):
        return told
    default = re.search(r"\.\w+$", str(item.get("default") or ""))
    if default:
        return (default.group(),)
    return tuple(f".{word.lower()}" for word in WORDS.findall(item["title"]))


def split_lines(field: Field, given: str | Iterable[Any]) -> list[str]:
    """Several values from a text: one a line; places and pixels also with ; between them."""
    if not isinstance(given, str):
        return [str(item).strip() for item in given if str(item).strip()]
    if field.kind in ("PhotoPixel", "MapPoint", "Extent"):
        found = [match.strip() for match in MANY_PLACES.findall(given)]
        if "".join(found).replace(" ", "") == re.sub(r"[;\n]|\s", "", given):
            return found
    return [line.strip() for line in given.splitlines() if line.strip()]


def is_default(field: Field, value: Any) -> bool:
    """Whether a value is what georef takes anyhow, so that project.toml has its say."""
    if value is None or value == "" or value == []:
        return True
    if field.multiple:
        return list(value) == list(field.default or ())
    if isinstance(value, bool) or field.default is None:
        return bool(value == field.default)
    try:
        return float(value) == float(field.default)
    except (TypeError, ValueError):
        return str(value) == str(field.default)


def arguments(
    tool: Tool, values: Mapping[str, Any], extra: Sequence[str] = (), project: str = ""
) -> list[str]:
    """Command line of a tool behind the name of the program.

    Parameters
    ----------
    values
        Parameter -> flag, text, number, or list of them; what is not given is left to georef.
    extra
        Further options, such as ``--force``.
    project
        Folder of the project, for a tool that works on one.
    """
    options: list[str] = []
    places = [project] if tool.is_run else []
    if project and not tool.is_run:
        options.append(f"--project={project}")
    for field in tool.fields:
        value = values.get(field.name)
        if field.positional and value not in (None, "", []):
            places += [str(item) for item in _items(value)]
        elif not is_default(field, value):
            options += _option(field, value)
    return [*tool.words, *options, *extra, "--json", *(["--", *places] if places else [])]


def _option(field: Field, value: Any) -> list[str]:
    name = f"--{field.name.replace('_', '-')}"
    if field.widget == "boolean":
        # `georef run` has plain flags, tools have pairs
        return [name if value else name.replace("--", "--no-", 1)]
    return [f"{name}={item}" for item in _items(value)]


def _items(value: Any) -> list[Any]:
    return list(value) if isinstance(value, (list, tuple)) else [value]


def _entry(name: str, kind: str, title: str, help: str = "", **more: Any) -> dict[str, Any]:
    return {"name": name, "type": kind, "title": title, "help": help, "required": False,
            "default": False if kind == "Flag" else "", **more}  # fmt: skip


# `georef run` is a command of the application, not a tool: told here in the manifest's words.
RUN: dict[str, Any] = {
    "provider": OWN_PROVIDER,
    "full_id": "run",
    "words": ["run"],
    "id": "run",
    "name": "Make the products of a project",
    "group": "project",
    "help": "Run all steps that are not up to date: georef run.\n\nReads the photos, orients them, "
    "matches and adjusts them, and makes footprints, orthos, mosaic, accuracy statement, report, "
    "KMZ and GeoPackage. A step whose inputs, settings and products did not change is skipped. "
    "Settings are those of project.toml in the folder of the project.",
    "needs_project": True,
    "in_run": False,
    "parameters": [
        _entry("quick", "Flag", "A first answer, from the poses alone"),
        _entry("only", "Text", "Only these steps", "ids with commas, such as footprints,mosaic",
               advanced=True),
        _entry("from", "Text", "From this step on", "id of a step, such as mosaic",
               advanced=True),
        _entry("set", "Text", "Parameters of steps", "such as mosaic.gsd=5cm; before those of "
               "project.toml", default=[], multiple=True, advanced=True),
        _entry("verify", "Flag", "Hash all of the inputs and products", advanced=True),
    ],
    "outputs": [
        {"name": "mosaic", "title": "Mosaic", "type": "RasterLayer"},
        {"name": "overlap", "title": "Number of photos of each place", "type": "RasterLayer"},
        {"name": "site", "title": "GeoPackage of the site", "type": "File"},
        {"name": "report", "title": "Report", "type": "File"},
    ],
}  # fmt: skip
