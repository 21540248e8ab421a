"""What a face needs to know of one parameter, read from a pydantic field."""

from __future__ import annotations

import types
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from georef_gis.errors import ExportError
from georef_gis.toolbox.values import unit_factor

KINDS = (
    "File", "Folder", "PhotoSet", "Crs", "Extent", "RasterLayer", "VectorLayer", "MapPoint",
    "PhotoPixel", "Length", "Angle", "Number", "Integer", "Text", "Flag", "Choice", "TableField",
)  # fmt: skip
SCHEMA_TYPES = {"Number": "number", "Integer": "integer", "Flag": "boolean"}
PLAIN_TYPES = {bool: "Flag", int: "Integer", float: "Number", str: "Text", Path: "File"}
DEFAULT_UNITS = {"Length": "m", "Angle": "rad"}


@dataclass(frozen=True, slots=True)
class Kind:
    """Marks a type of Python as a parameter type of the manifest."""

    name: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Spec:
    """Declaration of one parameter; `default` and limits are in `unit`.

    Other values than the `suggestions` are allowed, other ones than the `choices` are not. Of a
    file to write all `suffixes` are named, or "" for any name; of one to read they are those to
    offer. `or_folder` marks a file to read in whose place a folder may be given.
    """

    name: str
    kind: str
    title: str
    help: str
    required: bool
    optional: bool
    multiple: bool
    default: Any
    unit: str = ""
    ge: float | None = None
    le: float | None = None
    gt: float | None = None
    lt: float | None = None
    choices: tuple[str, ...] = ()
    suggestions: tuple[str, ...] = ()
    suffixes: tuple[str, ...] = ()
    of: str = ""
    advanced: bool = False
    positional: bool = False
    writes: bool = False
    or_folder: bool = False

    @property
    def option(self) -> str:
        """Name on the command line, without the dashes in front."""
        return self.name.replace("_", "-")

    def declared(self, value: Any) -> Any:
        """JSON-able form of an attribute's value, in the declared unit."""
        if isinstance(value, tuple | list):
            return [self.declared(item) for item in value]
        if self.kind in ("Length", "Angle") and isinstance(value, int | float):
            return _tidy(value / unit_factor(self.kind, self.unit))
        return value if isinstance(value, bool | int | float | str | None) else str(value)

    def limits(self) -> str:
        """Allowed range in words, empty if there is none."""
        unit = f" {self.unit}" if self.unit else ""
        low, high = (
            (self.ge if self.gt is None else self.gt),
            (self.le if self.lt is None else self.lt),
        )
        if low is not None and high is not None:
            return f"{low:g} to {high:g}{unit}"
        if low is not None:
            return f"{'at least' if self.gt is None else 'above'} {low:g}{unit}"
        if high is not None:
            return f"{'at most' if self.lt is None else 'below'} {high:g}{unit}"
        return ""

    def check_range(self, value: float) -> None:
        """Raise `ValueError` if a value in the declared unit is not allowed."""
        fits = (
            (self.ge is None or value >= self.ge)
            and (self.le is None or value <= self.le)
            and (self.gt is None or value > self.gt)
            and (self.lt is None or value < self.lt)
        )
        if not fits:
            unit = f" {self.unit}" if self.unit else ""
            raise ValueError(f"{value:g}{unit} is not allowed; give {self.limits()}")

    def check_target(self, given: Any) -> None:
        """Refuse a file to write with the name of another kind of file.

        A table must not be written over a photo that was named by mistake.

        Raises
        ------
        ValueError
            If its suffix is none of those declared.
        ExportError
            If it is a folder.
        """
        if not self.writes or not self.suffixes or "" in self.suffixes:
            return
        target = Path(str(given))
        # of the root of the disk the tool says more
        if target.suffix.lower() in self.suffixes or str(target) == target.anchor:
            return
        ends = " or ".join(self.suffixes)
        if target.is_dir():
            raise ExportError(f"{given}: is a folder; give the name of a {ends} in it")
        raise ValueError(f"{given} has the name of another kind of file; end it in {ends}")

    def expects(self) -> str:
        """What to give, in words, for an error message."""
        if self.choices:
            return f"one of {', '.join(self.choices)}"
        unit = f" in {self.unit}" if self.unit else ""
        article = "an" if self.kind[0] in "AEI" else "a"
        limits = f", {self.limits()}" if self.limits() else ""
        return f"{article} {self.kind}{unit}{limits}"

    def manifest(self) -> dict[str, Any]:
        """JSON-able entry of the manifest."""
        entry: dict[str, Any] = {"name": self.name, "type": self.kind, "title": self.title}
        if self.help:
            entry["help"] = self.help
        entry |= {"required": self.required, "default": self.default}
        rest = {
            "unit": self.unit,
            "minimum": self.ge,
            "maximum": self.le,
            "above": self.gt,
            "below": self.lt,
            "choices": list(self.choices),
            "suggestions": list(self.suggestions),
            "suffixes": list(self.suffixes),
            "of": self.of,
            "multiple": self.multiple,
            "advanced": self.advanced,
            "positional": self.positional,
            "writes": self.writes,
            "or_folder": self.or_folder,
        }
        empty: tuple[Any, ...] = (None, "", [])
        return entry | {k: v for k, v in rest.items() if v is not False and v not in empty}

    def schema(self) -> dict[str, Any]:
        """JSON Schema of the value as given, in the declared unit."""
        one: dict[str, Any] = {"type": SCHEMA_TYPES.get(self.kind, "string")}
        if self.kind in ("Length", "Angle"):
            one = {"type": ["number", "string"]}
        limits = {
            "minimum": self.ge, "maximum": self.le,
            "exclusiveMinimum": self.gt, "exclusiveMaximum": self.lt,
        }  # fmt: skip
        one |= {key: value for key, value in limits.items() if value is not None}
        if self.choices:
            one["enum"] = list(self.choices)
        if self.suggestions:
            one["examples"] = list(self.suggestions)
        schema = (
            {"type": "array", "items": one} if self.multiple or self.kind == "PhotoSet" else one
        )
        if self.optional:
            schema = {"anyOf": [schema, {"type": "null"}]}
        schema |= {"title": self.title, "x-type": self.kind}
        if self.unit:
            schema["x-unit"] = self.unit
        return schema if self.required else schema | {"default": self.default}


@cache
def specs_of(model: type[BaseModel]) -> tuple[Spec, ...]:
    """Declarations of a model's fields, in order."""
    return tuple(_spec(name, field) for name, field in model.model_fields.items())


def _spec(name: str, field: FieldInfo) -> Spec:
    extra: Any = field.json_schema_extra
    told: dict[str, Any] = dict(extra["georef"]) if extra and "georef" in extra else {}
    kind, choices = _kind(field)
    if told and told.pop("kind") != kind:
        raise TypeError(f"parameter {name}: its helper is not the one of its type {kind}")
    told["choices"] = tuple(told.get("choices", ())) or choices
    told.setdefault("unit", DEFAULT_UNITS.get(kind, ""))
    required = field.is_required()
    spec = Spec(
        name=name,
        kind=kind,
        title=field.title or name.replace("_", " ").capitalize(),
        help=field.description or "",
        required=required,
        optional=any(part is type(None) for part in _parts(field.annotation)),
        multiple=kind != "PhotoSet" and _is_multiple(field.annotation),
        default=None,
        **told,
    )
    if required:
        return spec
    return replace(spec, default=spec.declared(field.get_default(call_default_factory=True)))


def _parts(annotation: Any) -> Iterator[Any]:
    """All types an annotation is made of, outermost first."""
    yield annotation
    if get_origin(annotation) is Annotated:
        yield from annotation.__metadata__
        yield from _parts(annotation.__origin__)
    elif get_origin(annotation) in (Union, types.UnionType, tuple, list):
        for part in get_args(annotation):
            yield from _parts(part)


def _kind(field: FieldInfo) -> tuple[str, tuple[str, ...]]:
    parts = [*field.metadata, *_parts(field.annotation)]
    for part in parts:
        if isinstance(part, Kind):
            return part.name, ()
        if get_origin(part) is Literal:
            return "Choice", tuple(str(member) for member in get_args(part))
    for part in parts:
        if isinstance(part, type) and part in PLAIN_TYPES:
            return PLAIN_TYPES[part], ()
    raise TypeError(f"{field.annotation} is no parameter type; use one of {', '.join(KINDS)}")


def _is_multiple(annotation: Any) -> bool:
    return any(get_origin(part) in (tuple, list) for part in _parts(annotation))


def _tidy(value: float) -> float:
    """Drop what unit conversion leaves in the last digits: 30.000000000000004 is 30."""
    return float(f"{value:.14g}")
