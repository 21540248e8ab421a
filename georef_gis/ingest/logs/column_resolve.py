"""Which column of a text log holds what: as its mapping says, else by the names of the columns."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from georef_gis.errors import InputError
from georef_gis.ingest.logs.column_map import ColumnMap, ColumnSpec
from georef_gis.ingest.logs.column_names import (
    TARGETS,
    TRIPLETS,
    WEAK_TRIPLETS,
    Heading,
    base_name,
    compact,
    understand,
)
from georef_gis.ingest.logs.column_units import Unit, names_of, unit_of

_CURE = "map it in [logs.columns] or by --map, such as --map '{0} = {1}'"


@dataclass(frozen=True, slots=True, kw_only=True)
class Column:
    """A quantity found in a table: which column, in which unit (None where nothing states it)."""

    target: str
    index: int
    header: str
    unit: Unit | None = None
    sign: float = 1.0
    format: str = ""
    mapped: bool = False
    # the header is the documented name itself, which means SI where no unit is stated
    documented: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Resolved:
    """Columns by quantity, what clashes, and what the mapping names in vain."""

    columns: Mapping[str, Column]
    # quantity -> headers that all claim it
    clashes: Mapping[str, tuple[str, ...]]
    # quantity -> column that the mapping names but the file has not
    absent: Mapping[str, str]


def resolve(
    headers: Sequence[str], units: Sequence[str], columns: ColumnMap, source: str
) -> Resolved:
    """Columns of a table by quantity: mapped ones first, then by their names.

    Parameters
    ----------
    headers
        One per column; "" where the file has no header.
    units
        Of a line of units below the headers; "" where there is none.
    columns
        Mapping of this file.
    source
        File, for messages.

    Raises
    ------
    InputError
        A mapped column that is ambiguous, or a unit that does not fit.
    """
    found: dict[str, Column] = {}
    absent: dict[str, str] = {}
    for target, spec in columns.columns.items():
        at = _index_of(spec, headers, target, source)
        if at is None:
            absent[target] = spec.column
        else:
            found[target] = _mapped(target, spec, at, (headers[at], units[at]), source)
    clashes = _by_name(headers, units, found, source)
    return Resolved(columns=found, clashes=clashes, absent=absent)


def _by_name(
    headers: Sequence[str],
    units: Sequence[str],
    found: dict[str, Column],
    source: str,
) -> dict[str, tuple[str, ...]]:
    """Add to `found` what the headers say; the clashes that are left."""
    taken = {c.index for c in found.values()}
    mapped = set(found)
    named: dict[str, list[tuple[int, Heading]]] = {}
    weak = _weak(headers)
    for i, header in enumerate(headers):
        heading = weak.get(i) or (understand(header, units[i]) if header.strip() else None)
        if i not in taken and heading is not None and heading.target not in mapped:
            named.setdefault(heading.target, []).append((i, heading))
    clashes: dict[str, tuple[str, ...]] = {}
    for target, claims in named.items():
        exact = [c for c in claims if compact(base_name(c[1].text)) == compact(target)]
        chosen = claims if len(claims) == 1 else exact
        if len(chosen) != 1:
            clashes[target] = tuple(c[1].text for c in claims)
            continue
        i, heading = chosen[0]
        _check_fit(heading, source)
        found[target] = Column(
            target=target,
            index=i,
            header=heading.text,
            unit=heading.unit,
            documented=compact(heading.text) == compact(target),
        )
    return clashes


def _index_of(spec: ColumnSpec, headers: Sequence[str], target: str, source: str) -> int | None:
    """Column of a specification: by number, then by its whole name, then without its unit."""
    if re.fullmatch(r"#\d+", spec.column):
        number = int(spec.column[1:])
        return number - 1 if 1 <= number <= len(headers) else None
    wanted = spec.column.strip()
    ways = (str.strip, lambda t: t.strip().lower(), lambda t: base_name(t).strip().lower())
    for way in ways:
        hits = [i for i, h in enumerate(headers) if h and way(h) == way(wanted)]
        if len(hits) > 1:
            raise InputError(
                f"{len(hits)} columns are called '{wanted}'; name it by its number, such as "
                f"#{hits[0] + 1}",
                source=source,
                field=target,
            )
        if hits:
            return hits[0]
    name, colon, unit_text = wanted.rpartition(":")
    if colon and any(base_name(h).strip().lower() == name.lower() for h in headers):
        raise InputError(
            f"'{unit_text}' is no unit of {target}; use one of {names_of(TARGETS[target])}",
            source=source,
            field=target,
        )
    return None


def _mapped(target: str, spec: ColumnSpec, at: int, header: tuple[str, str], source: str) -> Column:
    """Column of a specification; the header's own unit counts where the user states none."""
    unit = spec.unit
    if unit is None:
        own = understand(f"{target} [{_unit_text(header)}]") if _unit_text(header) else None
        unit = own.unit if own else None
    return Column(
        target=target,
        index=at,
        header=header[0] or f"#{at + 1}",
        unit=unit,
        sign=spec.sign,
        format=spec.format,
        mapped=True,
    )


def _unit_text(header: tuple[str, str]) -> str:
    """Unit that a header or the line of units below it states, as text."""
    name, below = header
    inside = re.search(r"[\[({<]\s*([^\])}>]*?)\s*[\])}>]\s*$", name)
    if inside:
        return inside[1]
    heading = understand(name)
    return heading.unit.name if heading and heading.unit and not below else below


def _weak(headers: Sequence[str]) -> dict[int, Heading]:
    """Single letters that mean rates only where all three stand together."""
    out: dict[int, Heading] = {}
    names = [base_name(h).strip().lower() for h in headers]
    for letters, quantity in WEAK_TRIPLETS.items():
        if quantity and all(names.count(letter) == 1 for letter in letters):
            for letter, axis in zip(letters, "xyz", strict=True):
                i = names.index(letter)
                unit = unit_of(_unit_text((headers[i], "")), TARGETS[f"{quantity}_{axis}"])
                out[i] = Heading(text=headers[i], target=f"{quantity}_{axis}", unit=unit)
    return out


def _check_fit(heading: Heading, source: str) -> None:
    if heading.unfit:
        dimension = TARGETS[heading.target]
        raise InputError(
            f"'{heading.unfit}' is no unit of {heading.target} ({names_of(dimension)}); "
            + _CURE.format(heading.target, f"{base_name(heading.text)}:unit"),
            source=source,
            field=heading.text,
        )


def has_triplet(columns: Mapping[str, Column], quantity: str) -> bool:
    """Whether x, y and z of a quantity are all there."""
    if quantity not in TRIPLETS:
        raise ValueError(f"{quantity} has no x, y and z")
    return all(f"{quantity}_{a}" in columns for a in "xyz")
