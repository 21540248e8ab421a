"""What is mended in seams that were edited by hand: broken rings, overlaps, gaps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from shapely import MultiPolygon, Polygon

    # Photo and the ground that the mosaic takes from it
    Seam = tuple[str, MultiPolygon]
else:
    Seam = tuple

# m2; less is rounding
TRACE = 0.01
# m; narrower gaps between neighbours are closed without a word
SLIVER = 0.001


@dataclass(frozen=True, slots=True, kw_only=True)
class Cell:
    """A feature of the layer; of two that overlap the higher priority wins, then fid."""

    fid: int
    photo: str
    priority: float
    area: Polygon | MultiPolygon


def mend(
    cells: Sequence[Cell], computed: Sequence[Cell], *, metres: float
) -> tuple[list[Seam], list[str]]:
    """Coverage of one area per photo, and what was done about it, a line each.

    Parameters
    ----------
    computed
        Seams as they were before the edit: gaps within them are filled from them.
    metres
        Length of the unit of the map, m.
    """
    import shapely

    notes: list[str] = []
    cells = [_valid(cell, notes) for cell in cells]
    cells.sort(key=lambda cell: (-cell.priority, -cell.fid))
    notes += _overlaps(cells, metres)
    # The first of two that overlap keeps the ground.
    areas = _clean([cell.area for cell in cells], metres)
    names = [cell.photo for cell in cells]
    if computed:
        fill_names, fill = _gaps(areas, computed, metres, notes)
        if fill:
            names += fill_names
            areas = _clean([*areas, *fill], metres)
    by_photo: dict[str, list[Any]] = {}
    for name, area in sorted(zip(names, areas, strict=True), key=lambda pair: pair[0]):
        if not area.is_empty:
            by_photo.setdefault(name, []).append(area)
    gone = [cell.photo for cell in cells if cell.photo not in by_photo]
    notes += [f"photo '{name}' is covered by others and left out" for name in dict.fromkeys(gone)]
    merged = {name: polygonal(shapely.union_all(parts)) for name, parts in by_photo.items()}
    return list(merged.items()), notes


def polygonal(geometry: Any) -> MultiPolygon:
    """Polygons of a geometry; lines and points are dropped."""
    import shapely

    parts = shapely.get_parts(shapely.get_parts(geometry))
    return shapely.MultiPolygon([part for part in parts if part.geom_type == "Polygon"])


def _valid(cell: Cell, notes: list[str]) -> Cell:
    import shapely

    if cell.area.is_valid:
        return cell
    reason = shapely.is_valid_reason(cell.area)
    notes.append(f"feature {cell.fid} ('{cell.photo}') was no valid polygon ({reason}) and was "
                 "mended; look whether it is as you meant it")  # fmt: skip
    return replace(cell, area=polygonal(shapely.make_valid(cell.area)))


def _clean(areas: Sequence[Any], metres: float) -> list[Any]:
    """Coverage of areas: borders shared vertex by vertex, overlaps left to the first."""
    import shapely

    if shapely.coverage_is_valid(areas, gap_width=SLIVER / metres):
        return list(areas)
    return list(
        shapely.coverage_clean(areas, gap_width=SLIVER / metres, merge_strategy="min_index")
    )


def _overlaps(cells: Sequence[Cell], metres: float) -> list[str]:
    """A line on the overlaps of different photos."""
    import numpy as np
    import shapely

    areas = np.array([cell.area for cell in cells], dtype=object)
    winner, loser = shapely.STRtree(areas).query(areas, predicate="intersects")
    once = winner < loser
    winner, loser = winner[once], loser[once]
    shared = shapely.area(shapely.intersection(areas[winner], areas[loser])) * metres**2
    told = [
        (float(size), cells[i].photo, cells[j].photo)
        for size, i, j in zip(shared, winner.tolist(), loser.tolist(), strict=True)
        if size > TRACE and cells[i].photo != cells[j].photo
    ]
    if not told:
        return []
    size, over, under = max(told)
    total = sum(size for size, _, _ in told)
    return [f"{len(told)} overlaps, {total:.2f} m2: the higher priority has the ground, else the "
            f"polygon drawn later (largest: '{over}' over '{under}', {size:.2f} m2)"]  # fmt: skip


def _gaps(
    areas: Sequence[Any], computed: Sequence[Cell], metres: float, notes: list[str]
) -> tuple[list[str], list[Any]]:
    """Parts of the computed seams that nobody covers any more, and their photos."""
    import numpy as np
    import shapely

    kept = np.array(areas, dtype=object)
    before = np.array([cell.area for cell in computed], dtype=object)
    hit, by = shapely.STRtree(kept).query(before, predicate="intersects")
    order = np.argsort(hit, kind="stable")
    cuts = np.searchsorted(hit[order], np.arange(len(before) + 1))
    names, pieces, total = [], [], 0.0
    for k, cell in enumerate(computed):
        taken = shapely.union_all(kept[by[order[cuts[k] : cuts[k + 1]]]])
        left = polygonal(shapely.difference(before[k], taken))
        size = left.area * metres**2
        if size > TRACE:
            names.append(cell.photo)
            pieces.append(left)
            total += size
    if pieces:
        few = ", ".join(f"'{name}'" for name in names[:3]) + (" ..." if len(names) > 3 else "")
        notes.append(f"gaps of {total:.2f} m2 are filled as they were computed (from {few})")
    return names, pieces
