"""Photos whose position is nowhere near that of the others: another site, or a wrong GPS."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from georef_gis.frames import Array
    from georef_gis.model.photo import Photo

# m without any photo in between, beyond which photos are not of one site: a mosaic of both would be
# nearly all empty, and its export take minutes
SITE_REACH = 5_000.0
# m, beyond which it is said: neighbouring photos and neighbouring lines are nearer
DOUBTED_REACH = 2_000.0
# neither holds where photos usually are nearly as far apart: so many times that distance is allowed
STRAY_FACTOR = 10.0
# names in a line; of others their number
_MOST_NAMES = 3


def without_strays(photos: Sequence[Photo]) -> tuple[list[Photo], list[str]]:
    """Photos of the site that most of them show, and a line about each group of others.

    One position on another continent would stretch every map over both, and so would a second site
    in the folder. Groups beyond `SITE_REACH` are left out, nearer ones are told and kept.
    """
    import numpy as np

    from georef_gis.geodesy import ecef_from_geo

    placed = [(photo, photo.geotag) for photo in photos if photo.geotag is not None]
    if len(placed) < 2:
        return list(photos), []
    p = ecef_from_geo(np.array([[tag.lat, tag.lon, 0.0] for _, tag in placed]))
    usual = STRAY_FACTOR * _usual_distance(p)
    groups = _groups(p, max(DOUBTED_REACH, usual))
    site = groups.pop(max(range(len(groups)), key=lambda i: len(groups[i])))
    left_out: set[str] = set()
    lines = []
    while groups:
        gap, nearest = min((_gap(p[site], p[group]), i) for i, group in enumerate(groups))
        group = groups.pop(nearest)
        members = [placed[i][0] for i in group]
        kept = gap <= max(SITE_REACH, usual)
        lines.append(_line(members, gap, others=len(site), kept=kept))
        if kept:
            site = np.concatenate([site, group])
        else:
            left_out |= {photo.id for photo in members}
    return [photo for photo in photos if photo.id not in left_out], lines


def _chain(p: Array) -> tuple[NDArray[np.int64], Array]:
    """Places in the order in which each is the nearest to all before it, and these distances, m.

    Prim's algorithm: the distances are the edges of the shortest tree that joins all places.
    """
    import numpy as np

    near = np.linalg.norm(p - p[0], axis=1)
    near[0] = np.inf
    order, steps = [0], []
    for _ in range(len(p) - 1):
        at = int(np.argmin(near))
        order.append(at)
        steps.append(float(near[at]))
        taken = np.isinf(near)
        near = np.minimum(near, np.linalg.norm(p - p[at], axis=1))
        near[taken] = np.inf
        near[at] = np.inf
    return np.array(order, dtype=np.int64), np.array(steps)


def _usual_distance(p: Array) -> float:
    """Distance from a place to the next, m: the lower median; 0 of two places, which tell none."""
    import numpy as np

    steps = np.sort(_chain(p)[1])
    return float(steps[(len(steps) - 1) // 2]) if len(steps) > 1 else 0.0


def _groups(p: Array, limit: float) -> list[NDArray[np.int64]]:
    """Indices of places by group, each in order: from one to the next it is up to `limit`, m."""
    import numpy as np

    order, steps = _chain(p)
    parts = np.split(order, np.flatnonzero(steps > limit) + 1)
    return sorted((np.sort(part) for part in parts), key=lambda part: int(part[0]))


def _gap(a: Array, b: Array) -> float:
    """Least distance between two groups of places, m."""
    import numpy as np

    few, many = sorted((a, b), key=len)
    return min(float(np.linalg.norm(many - one, axis=1).min()) for one in few)


def _line(group: Sequence[Photo], gap: float, *, others: int, kept: bool) -> str:
    """Which photos lie how far from the site, and the cure."""
    names = ", ".join(photo.path.name for photo in group[:_MOST_NAMES])
    more = len(group) - _MOST_NAMES
    if more > 0:
        names += f" and {more} more"
    tag = group[0].geotag
    assert tag is not None
    place = f"{math.degrees(tag.lat):.4f}, {math.degrees(tag.lon):.4f} deg"
    rest = f"the other photo{'s' if others > 1 else ''}"
    lie = "lies" if len(group) == 1 else "lie"
    head = f"{names}: GPS: {place} {lie} {gap / 1000:.{0 if gap > 1e4 else 1}f} km from {rest}"
    if len(group) > 1:
        cure = "make a project of its own of another site, and [photos] exclude them here"
    else:
        cure = "check it for swapped latitude and longitude, give the position in a file ([poses] "
        cure += "file), or make a project of its own of another site"
    if kept:
        return f"{head}: kept, the maps span both; {cure}"
    return f"{head}: left out; {cure}"
