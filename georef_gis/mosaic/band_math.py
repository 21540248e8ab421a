"""Indices of bands: expressions of band names, read without `eval`, and those in common use.

Values are fractions of the white level, 0 to 1. Ratios do not see the difference; SAVI and own
expressions with constants do.
"""

from __future__ import annotations

import operator
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from difflib import get_close_matches

import numpy as np
from numpy.typing import NDArray

from georef_gis.errors import InputError

Values = NDArray[np.float64]

_TOKEN = re.compile(
    r"\s*(?:(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)"
    r"|(?P<name>[A-Za-z_]\w*(?:\.[A-Za-z_]\w*)?)|(?P<sign>[-+*/()]))"
)
_OPERATIONS: dict[str, Callable[[Values, Values], Values]] = {
    "+": operator.add, "-": operator.sub, "*": operator.mul, "/": operator.truediv,
}  # fmt: skip
_STRENGTH = {"+": 1, "-": 1, "*": 2, "/": 2}
_LONGEST, _DEEPEST = 2000, 50

Node = Callable[[Mapping[str, Values]], Values]


@dataclass(frozen=True, slots=True, kw_only=True)
class Index:
    """An index in common use.

    Parameters
    ----------
    expression
        Of the roles nir, red, green and blue.
    limits
        Values that a picture of it shows.
    source
        Where it was published.
    """

    name: str
    expression: str
    limits: tuple[float, float]
    source: str


INDICES = {
    index.name: index
    for index in (
        Index(
            name="ndvi", expression="(nir - red) / (nir + red)", limits=(-1.0, 1.0),
            source="Rouse et al. 1974, NASA SP-351, 309-317",
        ),
        Index(
            name="gndvi", expression="(nir - green) / (nir + green)", limits=(-1.0, 1.0),
            source="Gitelson, Kaufman and Merzlyak 1996, Remote Sens. Environ. 58, 289-298",
        ),
        Index(
            name="blue-ndvi", expression="(nir - blue) / (nir + blue)", limits=(-1.0, 1.0),
            source="Wang et al. 2007, J. Plant Nutrition 30, 1 (BNDVI); cameras without red",
        ),
        Index(
            name="savi", expression="1.5 * (nir - red) / (nir + red + 0.5)", limits=(-1.0, 1.0),
            source="Huete 1988, Remote Sens. Environ. 25, 295-309, L = 0.5; asks for reflectance",
        ),
        Index(
            name="ndwi", expression="(green - nir) / (green + nir)", limits=(-1.0, 1.0),
            source="McFeeters 1996, Int. J. Remote Sensing 17, 1425-1432 (open water)",
        ),
        Index(
            name="exg", expression="(2 * green - red - blue) / (red + green + blue)",
            limits=(-1.0, 2.0),
            source="Woebbecke et al. 1995, Trans. ASAE 38, 259-269 (excess green, plain colour)",
        ),
    )
}  # fmt: skip


class Expression:
    """A formula of band names, numbers, ``+ - * /`` and parentheses.

    Names are letters, digits and ``_``, at most one dot, upper or lower case alike.

    Parameters
    ----------
    text
        Such as ``(nir - 0.8 * red) / (nir + red)``.

    Attributes
    ----------
    names
        Of the bands it asks for, in lower case, in the order of their first use.

    Raises
    ------
    InputError
        If the text is no such formula, or names no band.
    """

    def __init__(self, text: str) -> None:
        self.text = " ".join(text.split())
        if len(self.text) > _LONGEST:
            raise InputError(
                f"{len(self.text)} characters are too many, {_LONGEST} are allowed",
                field="expression",
            )
        self._tokens = _tokens(self.text)
        self._at = self._depth = 0
        self._found: dict[str, None] = {}
        self._node = self._sum(0)
        if self._peek()[0]:
            raise self._wrong("an operator")
        self.names = tuple(self._found)
        if not self.names:
            raise InputError(f"{self.text!r} names no band", field="expression")

    def evaluate(self, bands: Mapping[str, Values]) -> Values:
        """Values of the formula; NaN where it divides by zero or grows over all bounds.

        Parameters
        ----------
        bands
            Values by name, all of one shape.
        """
        with np.errstate(divide="ignore", invalid="ignore", over="ignore", under="ignore"):
            values = self._node(bands)
        return np.where(np.isfinite(values), values, np.nan)

    def _sum(self, strength: int) -> Node:
        """Operators that bind more than `strength`, from left to right."""
        self._depth += 1
        if self._depth > _DEEPEST:
            raise InputError(f"nests deeper than {_DEEPEST} levels", field="expression")
        left = self._operand()
        while _STRENGTH.get(self._peek()[0], 0) > strength:
            sign = self._next()
            left = _applied(_OPERATIONS[sign], left, self._sum(_STRENGTH[sign]))
        self._depth -= 1
        return left

    def _operand(self) -> Node:
        kind = self._peek()[1]
        if kind == "number":
            value = np.float64(self._next())
            return lambda bands: value  # type: ignore[return-value]
        if kind == "name":
            name = self._next().lower()
            self._found[name] = None
            return lambda bands: bands[name]
        sign = self._peek()[0]
        if sign in ("-", "+"):
            self._next()
            # binds more than * but takes one operand only, so the result is the usual one
            inner = self._sum(2)
            return inner if sign == "+" else lambda bands: -inner(bands)
        if sign == "(":
            self._next()
            inner = self._sum(0)
            if self._peek()[0] != ")":
                raise self._wrong("an operator or )")
            self._next()
            return inner
        raise self._wrong("a band, a number or (")

    def _peek(self) -> tuple[str, str, int]:
        """Text, kind and place of the next token; empty at the end."""
        if self._at < len(self._tokens):
            return self._tokens[self._at]
        return "", "end", len(self.text)

    def _next(self) -> str:
        self._at += 1
        return self._tokens[self._at - 1][0]

    def _wrong(self, expected: str) -> InputError:
        text, _, place = self._peek()
        found = f"{text!r}" if text else "the end"
        return InputError(
            f"{self.text!r}: at character {place + 1} stands {found}; give {expected}",
            field="expression",
        )


def find_bands(names: Iterable[str], known: Iterable[str]) -> None:
    """Check that every name is that of a known band.

    Raises
    ------
    InputError
        With the known names nearest to the first that is not.
    """
    offered = list(known)
    for name in names:
        if name not in offered:
            near = get_close_matches(name, offered, n=3, cutoff=0.5) or offered
            raise InputError(f"there is no band {name!r}; use {', '.join(near)}", field=name)


def plain_name(description: str) -> str:
    """Name of a band as an expression has it: ``Band 4`` becomes ``band_4``."""
    name = re.sub(r"\W+", "_", description.strip().lower()).strip("_")
    return f"_{name}" if name[:1].isdigit() else name


def _tokens(text: str) -> list[tuple[str, str, int]]:
    """Text, kind and place of every token."""
    tokens, at = [], 0
    while at < len(text):
        match = _TOKEN.match(text, at)
        if match is None:
            place = at + len(text[at:]) - len(text[at:].lstrip())
            raise InputError(
                f"{text!r}: at character {place + 1} stands {text[place]!r}; use band names, "
                "numbers, + - * / and ( )",
                field="expression",
            )
        kind = str(match.lastgroup)
        tokens.append((match[kind], kind, match.start(kind)))
        at = match.end()
    return tokens


def _applied(operation: Callable[[Values, Values], Values], left: Node, right: Node) -> Node:
    return lambda bands: operation(left(bands), right(bands))
