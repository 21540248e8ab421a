"""What is said of points, as few lines: by their names, not as if these were photos."""

from __future__ import annotations

from collections.abc import Iterable

from georef_gis.toolbox.ranges import with_ranges, without_figures


def points_told(lines: Iterable[tuple[str, str]]) -> list[str]:
    """Lines, those of several points that differ in their figures only as one.

    Parameters
    ----------
    lines
        (name of the point, what is said of it).
    """
    from georef_gis.ingest.control_photos import some_names

    groups: dict[str, list[tuple[str, str]]] = {}
    for name, text in lines:
        groups.setdefault(without_figures(text), []).append((name, text))
    out = []
    for members in groups.values():
        names = list(dict.fromkeys(name for name, _ in members))
        head = names[0] if len(names) == 1 else f"{len(names)} points ({some_names(names)})"
        out.append(f"{head}: {with_ranges([text for _, text in members])}")
    return out
