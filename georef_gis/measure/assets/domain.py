"""Classes of assets with typed attributes: the package's, extended or overridden by a project."""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import date
from difflib import get_close_matches
from importlib import resources
from pathlib import Path
from typing import Any, Literal, get_args

from georef_gis.errors import InputError

CLASSES_FILE = "asset_classes.toml"
AttributeType = Literal["text", "integer", "number", "flag", "choice", "date"]
Shape = Literal["point", "line", "polygon"]
SHAPES: tuple[Shape, ...] = get_args(Shape)
TYPES: tuple[str, ...] = get_args(AttributeType)
# Characters; a longer text in a form is a mistake or an attack.
LONGEST_TEXT = 10_000
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,62}")
# Not text: they end strings in other programs, or have no UTF-8. Line breaks and tabs are.
_CONTROL = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f\ud800-\udfff]")
_FLAGS = {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}
_ATTRIBUTE_KEYS = {"title", "type", "unit", "min", "max", "choices", "suggestions", "help"}
_CLASS_KEYS = {"title", "geometry", "group", "attributes", "required", "help"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Attribute:
    """What an asset may say of itself.

    Parameters
    ----------
    choices
        Allowed values of a `choice`.
    suggestions
        Usual values of a text, which may be another.
    minimum, maximum
        Of a number, in `unit`.
    """

    name: str
    title: str
    type: AttributeType = "text"
    unit: str = ""
    minimum: float | None = None
    maximum: float | None = None
    choices: tuple[str, ...] = ()
    suggestions: tuple[str, ...] = ()
    help: str = ""

    def read(self, value: Any) -> Any:
        """Value in its type, also from a text as forms and tables give it.

        Raises
        ------
        ValueError
            If it is none, with the reason.
        """
        if self.type in ("integer", "number"):
            return self._number(value)
        if self.type == "flag":
            flag = value if isinstance(value, bool) else _FLAGS.get(str(value).strip().lower())
            if flag is None:
                raise ValueError(f"{_short(value)} is not yes or no")
            return flag
        text = checked_text(value)
        if self.type == "choice" and text not in self.choices:
            raise ValueError(f"{_short(text)} is no choice; use one of {', '.join(self.choices)}")
        if self.type == "date":
            try:
                return date.fromisoformat(text).isoformat()
            except ValueError as error:
                raise ValueError(f"{_short(text)} is no date; write 2026-03-31") from error
        return text

    def _number(self, value: Any) -> float | int:
        wanted = "whole number" if self.type == "integer" else "number"
        try:
            number = math.nan if isinstance(value, bool) else float(value)
        except (TypeError, ValueError):
            number = math.nan
        if not math.isfinite(number) or (self.type == "integer" and number != int(number)):
            raise ValueError(f"{_short(value)} is no {wanted}")
        unit = f" {self.unit}" if self.unit else ""
        if self.minimum is not None and number < self.minimum:
            raise ValueError(f"{number:g}{unit} is less than {self.minimum:g}{unit}")
        if self.maximum is not None and number > self.maximum:
            raise ValueError(f"{number:g}{unit} is more than {self.maximum:g}{unit}")
        return int(number) if self.type == "integer" else number


@dataclass(frozen=True, slots=True, kw_only=True)
class AssetClass:
    """A class of assets; `required` are those attributes that must not be empty."""

    name: str
    title: str
    geometry: Shape
    group: str = "other"
    attributes: tuple[Attribute, ...] = ()
    required: frozenset[str] = frozenset()
    help: str = ""

    def attribute(self, name: str) -> Attribute | None:
        """Attribute of a name, if it is one of the class."""
        return next((one for one in self.attributes if one.name == name), None)

    def read(self, values: Mapping[str, Any], *, complete: bool = True) -> dict[str, Any]:
        """Values in their types; empty ones are left out.

        Parameters
        ----------
        complete
            Whether required attributes must be there.

        Raises
        ------
        InputError
            On the first that does not fit.
        """
        given = {k: v for k, v in values.items() if v is not None and v != ""}
        out: dict[str, Any] = {}
        for name, value in given.items():
            attribute = self.attribute(name)
            if attribute is None:
                known = [one.name for one in self.attributes]
                raise InputError(f"{_nearest(name, known, 'attribute')}", source=self.name,
                                 field=_short(name))  # fmt: skip
            try:
                out[name] = attribute.read(value)
            except ValueError as error:
                raise InputError(str(error), source=self.name, field=name) from error
        missing = sorted(self.required - out.keys())
        if missing and complete:
            raise InputError("is missing; every asset of this class must have it",
                             source=self.name, field=", ".join(missing))  # fmt: skip
        return out


@dataclass(frozen=True, slots=True, kw_only=True)
class Domain:
    """Classes by name, in the order of their files."""

    classes: Mapping[str, AssetClass] = field(default_factory=dict)
    source: str = ""

    def find(self, name: str) -> AssetClass:
        """Class of a name.

        Raises
        ------
        InputError
            If there is none.
        """
        found = self.classes.get(name)
        if found is None:
            raise InputError(_nearest(name, list(self.classes), "class of assets"), field="class")
        return found

    def of_shape(self, shape: Shape) -> list[AssetClass]:
        """Classes whose geometry is of one kind."""
        return [one for one in self.classes.values() if one.geometry == shape]

    def in_group(self, group: str) -> frozenset[str]:
        """Names of the classes of a group."""
        return frozenset(c.name for c in self.classes.values() if c.group == group)

    def as_json(self) -> list[dict[str, Any]]:
        """JSON-able classes, from which a form can be made."""
        return [
            {
                "name": one.name,
                "title": one.title,
                "geometry": one.geometry,
                "group": one.group,
                "help": one.help,
                "attributes": [_attribute_json(a, one) for a in one.attributes],
            }
            for one in self.classes.values()
        ]


def load_domain(folder: Path | None = None) -> Domain:
    """Classes of the package, with those of a project folder's `asset_classes.toml`.

    Raises
    ------
    InputError
        Naming file, table, value and cure.
    """
    own = resources.files("georef_gis.data").joinpath(CLASSES_FILE).read_text("utf-8")
    tables = _parse(own, CLASSES_FILE)
    source = CLASSES_FILE
    path = None if folder is None else folder / CLASSES_FILE
    if path is not None and path.is_file():
        source = str(path)
        try:
            text = path.read_text("utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise InputError(f"cannot be read ({error}); save it as UTF-8 text",
                             source=source) from error  # fmt: skip
        tables = _merged(tables, _parse(text, source), source)
    return _domain(tables, source)


def checked_text(value: Any) -> str:
    """A text as it is, unless it cannot be stored as text.

    Raises
    ------
    ValueError
        If it is too long or holds control characters.
    """
    text = str(value)
    if len(text) > LONGEST_TEXT:
        raise ValueError(f"has {len(text)} characters, more than {LONGEST_TEXT}; shorten it")
    found = _CONTROL.search(text)
    if found:
        raise ValueError(f"holds the control character U+{ord(found[0]):04X}; remove it")
    return text


# -- reading the file ----------------------------------------------------------------------------

Tables = dict[str, dict[str, dict[str, Any]]]


def _parse(text: str, source: str) -> Tables:
    try:
        read = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"is not TOML ({error}); correct the line", source=source) from error
    strange = sorted(read.keys() - {"attributes", "classes"})
    if strange:
        raise InputError(f"[{strange[0]}] is no table; use [attributes.NAME] or [classes.NAME]",
                         source=source)  # fmt: skip
    out: Tables = {"attributes": {}, "classes": {}}
    for part, named in out.items():
        found = read.get(part, {})
        for name, table in found.items() if isinstance(found, dict) else [("", found)]:
            where = f"{part}.{name}"
            if not _NAME.fullmatch(name):
                raise InputError("a name is letters, digits and _, at most 63", source=source,
                                 field=where)  # fmt: skip
            if not isinstance(table, dict):
                raise InputError("is no table", source=source, field=where)
            known = (_ATTRIBUTE_KEYS if part == "attributes" else _CLASS_KEYS) | {"remove"}
            for key in table.keys() - known:
                raise InputError(_nearest(key, sorted(known), "key"), source=source, field=where)
            named[name] = table
    return out


def _merged(base: Tables, extra: Tables, source: str) -> Tables:
    """Tables of the project in place of those of the same name."""
    out = {part: dict(named) for part, named in base.items()}
    for part, named in extra.items():
        for name, table in named.items():
            if not table.get("remove"):
                out[part][name] = table
            elif out[part].pop(name, None) is None:
                raise InputError("cannot be removed: there is none of that name", source=source,
                                 field=f"{part}.{name}")  # fmt: skip
    return out


def _domain(tables: Tables, source: str) -> Domain:
    attributes = {
        name: _attribute(name, table, source) for name, table in tables["attributes"].items()
    }
    classes = {
        name: _class(name, table, attributes, source) for name, table in tables["classes"].items()
    }
    if not classes:
        raise InputError("leaves no class of assets", source=source)
    return Domain(classes=classes, source=source)


def _attribute(name: str, table: Mapping[str, Any], source: str) -> Attribute:
    where = f"attributes.{name}"
    kind = table.get("type", "text")
    if kind not in TYPES:
        raise InputError(f"type {_short(kind)} is none; use one of {', '.join(TYPES)}",
                         source=source, field=where)  # fmt: skip
    choices = _texts(table, "choices", source, where)
    if (kind == "choice") != bool(choices):
        raise InputError("choices go with type = \"choice\", and only with it", source=source,
                         field=where)  # fmt: skip
    limits = {key: table.get(key) for key in ("min", "max")}
    for key, limit in limits.items():
        if limit is not None and (isinstance(limit, bool) or not isinstance(limit, int | float)):
            raise InputError(f"{key} {_short(limit)} is no number", source=source, field=where)
    return Attribute(
        name=name,
        title=str(table.get("title", name)),
        type=kind,
        unit=str(table.get("unit", "")),
        minimum=limits["min"],
        maximum=limits["max"],
        choices=choices,
        suggestions=_texts(table, "suggestions", source, where),
        help=str(table.get("help", "")),
    )


def _class(
    name: str, table: Mapping[str, Any], attributes: Mapping[str, Attribute], source: str
) -> AssetClass:
    where = f"classes.{name}"
    shape = table.get("geometry")
    if shape not in SHAPES:
        raise InputError(f"geometry {_short(shape)} is none; use one of {', '.join(SHAPES)}",
                         source=source, field=where)  # fmt: skip
    named = _texts(table, "attributes", source, where)
    for one in named:
        if one not in attributes:
            raise InputError(_nearest(one, list(attributes), "attribute"), source=source,
                             field=where)  # fmt: skip
    required = frozenset(_texts(table, "required", source, where))
    if required - set(named):
        raise InputError(f"requires '{min(required - set(named))}', which is not one of its "
                         "attributes; add it there", source=source, field=where)  # fmt: skip
    return AssetClass(
        name=name,
        title=str(table.get("title", name)),
        geometry=shape,
        group=str(table.get("group", "other")),
        attributes=tuple(attributes[one] for one in named),
        required=required,
        help=str(table.get("help", "")),
    )


def _texts(table: Mapping[str, Any], key: str, source: str, where: str) -> tuple[str, ...]:
    found = table.get(key, [])
    if not isinstance(found, list) or not all(isinstance(one, str) for one in found):
        raise InputError(f'{key} must be a list of texts, such as ["a", "b"]', source=source,
                         field=where)  # fmt: skip
    return tuple(found)


def _attribute_json(one: Attribute, of: AssetClass) -> dict[str, Any]:
    told: dict[str, Any] = {"name": one.name, "title": one.title, "type": one.type,
                            "required": one.name in of.required}  # fmt: skip
    optional = {"unit": one.unit, "min": one.minimum, "max": one.maximum, "help": one.help,
                "choices": list(one.choices), "suggestions": list(one.suggestions)}  # fmt: skip
    return told | {key: value for key, value in optional.items() if value not in ("", None, [])}


def _short(value: Any) -> str:
    return repr(str(value)[:40])


def _nearest(word: str, words: list[str], what: str) -> str:
    close = get_close_matches(str(word)[:80].lower(), words, n=1, cutoff=0.5)
    few = ", ".join(words[:12]) + (" ..." if len(words) > 12 else "")
    cure = f"did you mean '{close[0]}'?" if close else f"use one of {few or 'none'}"
    return f"{_short(word)} is no {what}; {cure}"
