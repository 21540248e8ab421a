"""Attributes of a layer as KML: typed by a schema, and as a plain table for people."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from exports.kml.elements import Element, element, escaped, escaped_all
from exports.site.columns import Layer
from exports.site.schemas import Field

_TYPES = {"text": "string", "real": "double", "integer": "int", "flag": "bool"}
_UNITS = ("_deg", "_m2", "_m", "_s", "_px")
# Field of assets that holds a JSON object with the attributes of the class
OWN = "attributes"
MORE = " ..."


def schema(layer: Layer, fields: Iterable[Field] | None = None) -> Element:
    """Declaration of the attributes of a layer, typed."""
    parts = [
        element(
            "SimpleField",
            element("displayName", text=label(f)),
            name=f.name,
            type=_TYPES[f.kind],
        )
        for f in (layer.fields if fields is None else fields)
    ]
    return element("Schema", *parts, name=layer.name, id=f"schema-{layer.name}")


def label(field: Field) -> str:
    """Name of a field for people, with its unit."""
    name = field.name
    for unit in _UNITS:
        if name.endswith(unit):
            name = name.removesuffix(unit)
            break
    return name.replace("_", " ") + (f" ({field.unit})" if field.unit not in ("", "1") else "")


@dataclass(frozen=True, kw_only=True)
class Attributes:
    """Texts of the attributes of a layer's features, column by column.

    Parameters
    ----------
    table
        Fields of the table that people see, in order.
    data
        Fields that are written typed; None = all.
    longest
        Longer texts are cut, None = none are.
    """

    layer: Layer
    table: Sequence[str]
    data: Sequence[str] | None = None
    longest: int | None = None
    _fields: dict[str, Field] = field(init=False, repr=False, default_factory=dict)

    def __post_init__(self) -> None:
        """Look up the fields by name."""
        self._fields.update({f.name: f for f in self.layer.fields})

    @cached_property
    def typed(self) -> tuple[Field, ...]:
        """Fields that are written typed."""
        names = None if self.data is None else set(self.data)
        return tuple(f for f in self.layer.fields if names is None or f.name in names)

    @property
    def schema(self) -> Element:
        """Declaration of the typed fields."""
        return schema(self.layer, self.typed)

    def rows(self, start: int, stop: int) -> tuple[list[Element], list[Element]]:
        """Rows of the table in HTML and `ExtendedData` of some features."""
        plain = {f.name: self._plain(f, start, stop) for f in self._used()}
        shown = [
            (f"<tr><td>{escaped(label(f))}</td><td>", self._shown(f, plain[f.name]), "</td></tr>")
            for f in (self._fields[name] for name in self.table if name != OWN)
        ]
        written = [
            (f'<SimpleData name="{escaped(f.name)}">', plain[f.name], "</SimpleData>")
            for f in self.typed
        ]
        rows, others = self._own(start, stop)
        head = f'<SchemaData schemaUrl="#schema-{self.layer.name}">'
        count = stop - start
        tables = [a + b for a, b in zip(_joined(shown, count), rows, strict=True)]
        data = [
            f"<ExtendedData>{other}{head}{cells}</SchemaData></ExtendedData>"
            for other, cells in zip(others, _joined(written, count), strict=True)
        ]
        return tables, data

    def _used(self) -> list[Field]:
        names = {*self.table, *(f.name for f in self.typed)}
        return [f for f in self.layer.fields if f.name in names]

    def _plain(self, field: Field, start: int, stop: int) -> _Cells:
        """Values as they are, escaped; None where missing."""
        values = self.layer.columns[field.name].tolist(start, stop)
        if field.kind == "text":
            return _Cells("%s", self._texts(values))
        if field.kind == "flag":
            return _Cells("%d", values)
        # No more figures of a real number than a degree needs for a hundredth of a millimetre.
        return _Cells("%.13g" if field.kind == "real" else "%d", values)

    def _texts(self, values: Sequence[Any]) -> list[str | None]:
        most = self.longest
        if most is not None:
            values = [v[:most] + MORE if v is not None and len(v) > most else v for v in values]
        known = [v for v in values if v is not None]
        safe = escaped_all(known)
        if len(known) == len(values):
            return list(safe)
        texts = iter(safe)
        return [None if v is None else next(texts) for v in values]

    def _shown(self, field: Field, plain: _Cells) -> _Cells:
        """Values as a person reads them: no more figures than they have meaning."""
        values = plain.values
        if field.kind == "flag":
            return _Cells("%s", [None if v is None else ("yes" if v else "no") for v in values])
        if field.kind != "real":
            return plain
        if field.name in ("lon_deg", "lat_deg"):
            return _Cells("%.8f", values)
        if field.unit == "deg":
            return _Cells("%.3f", values)
        small = [v is None or -1.0 < v < 1.0 for v in values]
        if all(small) or not any(small):
            return _Cells("%.4f" if small[0] else "%.2f", values)
        return _Cells(
            "%s",
            [None if v is None else ("%.4f" if s else "%.2f") % v
             for v, s in zip(values, small, strict=True)],
        )  # fmt: skip

    def _own(self, start: int, stop: int) -> tuple[list[Element], list[Element]]:
        """Attributes of each feature's class: rows of the table, and untyped data.

        Untyped, as each class has its own; and because simple viewers read no other.
        """
        if OWN not in self._fields or OWN not in self.table:
            return [""] * (stop - start), [""] * (stop - start)
        values = self.layer.columns[OWN].tolist(start, stop)
        # Many features say the same.
        told = {value: self._told(value) for value in set(values)}
        return [told[value][0] for value in values], [told[value][1] for value in values]

    def _told(self, value: Any) -> tuple[Element, Element]:
        """Attributes of a feature's class as rows of the table, and as untyped data."""
        pairs = self._pairs(value)
        return (
            "".join(f"<tr><td>{k}</td><td>{v}</td></tr>" for k, v in pairs),
            "".join(f'<Data name="{k}"><value>{v}</value></Data>' for k, v in pairs),
        )

    def _pairs(self, value: Any) -> list[tuple[str, str]]:
        """Names and values of a JSON object, escaped; the whole text where it is none."""
        if not value:
            return []
        try:
            found = json.loads(value)
        except ValueError:
            found = None
        if not isinstance(found, dict):
            found = {OWN: value}
        texts = self._texts([v if isinstance(v, str) else _json(v) for v in found.values()])
        return [(escaped(name), text or "") for name, text in zip(found, texts, strict=True)]


def _json(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int | float):
        return repr(value)
    return "" if value is None else json.dumps(value, ensure_ascii=False)


@dataclass(frozen=True, slots=True)
class _Cells:
    """Values of a field for some features.

    Parameters
    ----------
    form
        How one is written, by "%".
    values
        None where missing.
    """

    form: str
    values: Sequence[Any]


def _joined(columns: Iterable[tuple[str, _Cells, str]], count: int) -> list[str]:
    """Row by row what stands before, in and behind each cell; nothing where a value is missing.

    A row is filled in at once: cell by cell it takes twice as long.
    """
    form, filled = "", []
    for before, cells, after in columns:
        missing = cells.values.count(None)
        if missing == count:
            continue
        cell = f"{before.replace('%', '%%')}{cells.form}{after}"
        form += "%s" if missing else cell
        filled.append(
            ["" if v is None else cell % v for v in cells.values] if missing else cells.values
        )
    if not filled:
        return [""] * count
    return [form % row for row in zip(*filled, strict=True)]
