"""Coordinates as text, a batch of vertices at once and of one width, so that features are slices.

Text by text would take most of the time of an export: the digits are made by numpy instead.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from georef_gis.errors import ExportError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from exports.site.columns import Layer
    from georef_gis.frames import Array

# deg, and CRS units or m: 0.1 mm each
DEGREE_DECIMALS, LENGTH_DECIMALS = 9, 4
# Whole numbers of 64 bits end there
_MOST = 2.0**63
_ZERO, _BLANK, _MINUS, _POINT = b"0 -."


@dataclass(frozen=True, slots=True, kw_only=True)
class Rows:
    """Text of vertices, each `width` characters wide."""

    text: str
    width: int
    ending: int

    def between(self, start: int, stop: int) -> str:
        """Text of some vertices, without the ending of the last one."""
        return self.text[start * self.width : stop * self.width - self.ending]

    def __iter__(self) -> Iterator[str]:
        """Text of each vertex, with its ending."""
        text, width = self.text, self.width
        return (text[i : i + width] for i in range(0, len(text), width))


def rows_of(*parts: str | tuple[Array, int]) -> Rows:
    """Text of vertices from what stands in each: fixed words, and numbers with their decimals.

    The last part is a word, the ending. Numbers are finite; shorter ones have blanks in front.
    """
    count = next(len(part[0]) for part in parts if not isinstance(part, str))
    blocks = [
        np.frombuffer(part.encode("ascii"), np.uint8)[None].repeat(count, axis=0)
        if isinstance(part, str)
        else _digits(*part)
        for part in parts
    ]
    text = np.hstack(blocks)
    ending = parts[-1] if isinstance(parts[-1], str) else ""
    return Rows(text=text.tobytes().decode("ascii"), width=text.shape[1], ending=len(ending))


def numbers(values: Array, decimals: int) -> list[str]:
    """Texts of finite numbers with so many decimals; shape (n,)."""
    return [text.lstrip() for text in rows_of((values, decimals), "")] if len(values) else []


def check_places(values: Array) -> None:
    """Refuse coordinates that are no numbers.

    Raises
    ------
    ExportError
        If one is not finite: PROJ says so of places for which a CRS does not hold.
    """
    if not np.isfinite(values).all():
        raise ExportError(
            "a vertex has no longitude and latitude, as it lies where the project's CRS does not "
            "hold; move or delete it in a GIS"
        )


def _digits(values: Array, decimals: int) -> NDArray[np.uint8]:
    """Characters of numbers; shape (n, width)."""
    check_places(values)
    largest = float(np.abs(values).max(initial=0.0))
    if largest * 10.0**decimals >= _MOST:
        raise ExportError(
            f"a vertex has a coordinate or height of {largest:.3g}, which is none on Earth; "
            "correct or delete it in a GIS"
        )
    rest = np.rint(np.abs(values) * 10.0**decimals).astype(np.int64)
    whole = rest // 10**decimals
    most = len(str(int(whole.max(initial=0))))
    negative = (values < 0.0) & (rest > 0)
    lead = 1 + sum((whole >= 10**k).astype(np.int64) for k in range(1, most))
    signed = int(negative.any())
    out = np.empty((len(values), signed + most + 1 + decimals), np.uint8)
    for column in range(out.shape[1] - 1, signed - 1, -1):
        if column == signed + most:
            out[:, column] = _POINT
            continue
        quotient = rest // 10
        out[:, column] = rest - 10 * quotient + _ZERO
        rest = quotient
    first = signed + most - np.broadcast_to(lead, len(values))
    for column in range(int(first.max(initial=0))):
        out[first > column, column] = _BLANK
    out[np.flatnonzero(negative), first[negative] - 1] = _MINUS
    return out


def wkt_of(
    layer: Layer, start: int, stop: int, *, points: Array, decimals: int, solid: NDArray[np.bool_]
) -> list[str]:
    """WKT of features `start` to `stop` of a layer of lines or areas.

    Parameters
    ----------
    points : shape (v, 2) or (v, 3)
        Their vertices.
    decimals
        Of the first two coordinates.
    solid : shape (stop - start,)
        Which of them are written with their third coordinate.
    """
    bounds = layer.places.offsets[start : stop + 1]
    x, y = ((points[:, axis], decimals) for axis in (0, 1))
    flat = high = rows_of(x, " ", y, ", ")
    if solid.any():
        high = rows_of(x, " ", y, " ", (np.nan_to_num(points[:, 2]), LENGTH_DECIMALS), ", ")
    name = layer.geometry.upper()
    opening, closing = ("((", "))") if layer.geometry == "Polygon" else ("(", ")")
    ends = (bounds - bounds[0]).tolist()
    return [
        f"{name}{' Z' if up else ''} {opening}{(high if up else flat).between(a, b)}{closing}"
        for (a, b), up in zip(pairwise(ends), solid.tolist(), strict=True)
    ]
