"""Shifts of many windows of two maps, coarse cells first, and the registration they make."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from georef_gis.errors import GeometryError
from georef_gis.measure.change.pair import MapPair, coarser, matrix_of
from georef_gis.measure.change.registration import (
    Registration,
    WindowShift,
    fit_registration,
)
from georef_gis.rasters.edge_shift import edge_shift
from georef_gis.rasters.resampled import UNMOVED, MapHeader

# cells of a window; cells it may be shorter on small sites
_SIDE, _LEAST_SIDE = 128, 48
# windows across a small site
_ACROSS = 4
# cells of shift that are looked for at the coarse level and at the fine one
_COARSE_MOST, _FINE_MOST = 24, 8
# windows that are looked at, those with a shift that are enough, and those of a block of the warped
# maps that follow each other: at the coarse level, where each takes much of the maps, then twice
_COARSE_TRIED, _FIRST_TRIED, _FINE_TRIED = (80, 30, 16), (400, 40, 5), (400, 90, 5)
# cells of a block that a map is warped by
_BLOCK = 512
Step = Callable[[float], None]


def register(
    pair: MapPair, *, most: float, step: Step = lambda _: None
) -> tuple[Registration, MapPair]:
    """Registration of the earlier map on the later one, and the pair with it so placed.

    Parameters
    ----------
    most
        Largest shift that is believed, m.
    step
        Called with the part done; may raise to cancel.

    Raises
    ------
    GeometryError
        If too few windows agree.
    """
    cells = pair.cells
    reach = most / cells.metres
    factor = 1
    while reach / factor > _COARSE_MOST and _side(coarser(cells.header, factor * 2)):
        factor *= 2
    try:
        coarse = _level(
            pair.seen(moved=UNMOVED, factor=factor), most=max(reach / factor, 2.0),
            tries=_COARSE_TRIED, step=step,
        )  # fmt: skip
        found = coarse.scaled(factor)
        # the last look starts from where the first one led, and is not disturbed by a far shift
        for tries in (_FIRST_TRIED, _FINE_TRIED) if factor > 1 else (_FINE_TRIED,):
            pair = pair.seen(moved=found.moved)
            pair = pair if tries is _FIRST_TRIED else pair.placed_anew()
            found = _after(found, _level(pair, most=_FINE_MOST, tries=tries, step=step))
    except GeometryError as error:
        raise GeometryError(
            f"{pair.names}: {error} ({cells.metres:g} m each); check that they "
            f"show the same place, or raise --max-shift above {most:g} m"
        ) from error
    if math.hypot(*found.shift) > reach:
        raise GeometryError(
            f"{pair.names}: their shift is "
            f"{math.hypot(*found.shift) * cells.metres:.2f} m; raise --max-shift above {most:g} m"
        )
    return found, pair.seen(moved=found.moved).placed_anew()


def _after(first: Registration, second: Registration) -> Registration:
    """Both, one after the other; what is known is known from the second."""
    from dataclasses import replace

    one, two = (matrix_of(r.moved) for r in (first, second))
    a, b, c, d, e, f = (one @ two)[:2].ravel().tolist()
    x, y = second.middle
    shift = (a * x + b * y + c - x, d * x + e * y + f - y)
    plain = [r.model for r in (first, second)]
    order = ["shift", "similarity", "affine"]
    model = order[max(order.index(name) for name in plain)]
    return replace(second, moved=(a, b, c, d, e, f), shift=shift, model=model)


def _side(header: MapHeader) -> int:
    """Side of the windows of a grid; 0 if it is too small for any."""
    least = min(header.width, header.height)
    return min(_SIDE, max(least // _ACROSS, _LEAST_SIDE)) if least >= 2 * _LEAST_SIDE else 0


def _level(pair: MapPair, *, most: float, tries: tuple[int, int, int], step: Step) -> Registration:
    header = pair.header
    side = _side(header)
    while side and side < 4 * most and 4 * side <= min(header.width, header.height):
        side *= 2
    if not side:
        raise GeometryError(f"{header.width} x {header.height} cells are too few for a shift")
    found: list[WindowShift] = []
    tried = 0
    for col, row in _places(header, side, tries[2]):
        tried += 1
        shift = _window(pair, col, row, side, most=min(most, side / 2.5))
        if shift is not None:
            found.append(shift)
        step(tried / tries[0])
        if len(found) == tries[1] or tried == tries[0]:
            break
    return fit_registration(found, tried=tried, most=most)


def _window(pair: MapPair, col: int, row: int, side: int, *, most: float) -> WindowShift | None:
    views = pair.read((col, row, side, side))
    shift = edge_shift(views.later, views.earlier, views.valid, most=most)
    if shift is None:
        return None
    return WindowShift(
        col=col + side / 2.0, row=row + side / 2.0, d_col=shift.d_col, d_row=shift.d_row,
        score=shift.score,
    )  # fmt: skip


def _places(header: MapHeader, side: int, at_once: int) -> list[tuple[int, int]]:
    """Upper left cells of windows beside each other, in a random order.

    A few of a block follow each other, for a map is warped by blocks.
    """
    axes: list[NDArray[np.int64]] = []
    for size in (header.width, header.height):
        count = max(1, size // side)
        # small sites have too few windows beside each other; there they overlap by half
        count = count if count >= _ACROSS else max(1, 2 * (size // side) - 1)
        axes.append(np.linspace(0, size - side, count).astype(np.int64))
    places = [(int(col), int(row)) for row in axes[1] for col in axes[0]]
    rng = np.random.default_rng(0)
    blocks: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for place in (places[i] for i in rng.permutation(len(places))):
        blocks.setdefault((place[0] // _BLOCK, place[1] // _BLOCK), []).append(place)
    shuffled = [list(blocks.values())[i] for i in rng.permutation(len(blocks))]
    most = max(len(block) for block in shuffled)
    return [
        place
        for start in range(0, most, at_once)
        for block in shuffled
        for place in block[start : start + at_once]
    ]
