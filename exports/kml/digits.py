"""Longitudes and latitudes as text, thousands at once by tables of digits.

Formatting number by number takes five times as long, and of a site with error ellipses it is what
takes most of the time.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from georef_gis.frames import Array

# Of a degree: 1e-9 is 0.1 mm on the ground
DECIMALS = 9
# Vertices at once: what is in work stays in the processor's cache
_BATCH = 4096
_MOST = 1000
_THOUSAND = np.uint32(1000)
_BREAK = np.frombuffer(b"\n", np.uint8)[0]


def _table(form: str) -> NDArray[np.uint32]:
    """Each number below 1000 as four bytes; NUL where nothing is written."""
    text = "".join((form % number).rjust(4) for number in range(_MOST))
    return np.frombuffer(text.replace(" ", "\0").replace("_", " ").encode("ascii"), np.uint32)


# Whole degrees, then those below zero; and the three groups of decimals
_WHOLE = np.concatenate([_table("%d"), _table("-%d")])
_FIRST, _SECOND, _THIRD = _table(".%03d"), _table("%03d"), (_table("%03d,"), _table("%03d_"))


def lonlat_texts(lonlat: Array, bounds: Sequence[int]) -> list[str]:
    """Vertices ``lon,lat`` of each feature, blank separated.

    Parameters
    ----------
    lonlat : shape (v, 2)
        deg, finite and less than 1000.
    bounds
        Vertices of feature i are ``bounds[i]:bounds[i + 1]``.
    """
    edges = np.asarray(bounds)
    filled = np.diff(edges) > 0
    ends = np.zeros(len(lonlat), bool)
    ends[edges[1:][filled] - 1] = True
    text = b"".join(
        _batch(lonlat[start : start + _BATCH], ends[start : start + _BATCH])
        for start in range(0, len(lonlat), _BATCH)
    )
    lines = iter(text.decode("ascii").split("\n"))
    return [next(lines) if some else "" for some in filled.tolist()]


def _batch(lonlat: Array, ends: NDArray[np.bool_]) -> bytes:
    """Some vertices, each with a blank behind it, or a line break where a feature ends."""
    size = np.abs(lonlat)
    whole = size.astype(np.uint32)
    rest = np.rint((size - whole) * 10.0**DECIMALS).astype(np.uint32)
    full = rest == 10**DECIMALS
    whole += full
    rest[full] = 0
    whole += np.signbit(lonlat) * np.uint32(_MOST)
    cells = np.empty((*lonlat.shape, 4), np.uint32)
    cells[..., 0] = _WHOLE[whole]
    thousands = rest // _THOUSAND
    last = rest - thousands * _THOUSAND
    for axis, table in enumerate(_THIRD):
        cells[:, axis, 3] = table[last[:, axis]]
    first = thousands // _THOUSAND
    cells[..., 2] = _SECOND[thousands - first * _THOUSAND]
    cells[..., 1] = _FIRST[first]
    cells.view(np.uint8)[ends, 1, -1] = _BREAK
    return cells.tobytes().translate(None, b"\0")
