"""Marks of control points in the photos of the project: names of photos, and pixels outside."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import PurePosixPath

from georef_gis.model.control import Mark
from georef_gis.model.photo import OrientedPhoto


def marks_in_photos(
    marks: Sequence[Mark], photos: Mapping[str, OrientedPhoto]
) -> tuple[list[tuple[str, Mark]], list[str]]:
    """Marks by photo id, and those of photos that are not there or outside of the image."""
    ids = photo_finder(photos)
    out: list[tuple[str, Mark]] = []
    unknown: dict[str, list[Mark]] = {}
    doubts: list[str] = []
    for mark in marks:
        keys = ids(mark.photo)
        if not keys:
            unknown.setdefault(mark.photo, []).append(mark)
        elif len(keys) > 1:
            doubts.append(
                f"{mark.source}: photo: '{mark.photo}' may be {' or '.join(keys[:3])}; left out: "
                "write its folder too"
            )
        else:
            outside = _outside(mark, photos[keys[0]])
            doubts += [outside] if outside else []
            out += [] if outside else [(keys[0], mark)]
    if unknown:
        first = next(iter(unknown.values()))[0]
        count = sum(len(some) for some in unknown.values())
        doubts.append(
            f"{first.source}: photo: {count} marks are in {len(unknown)} photos that have no pose "
            f"in the project ({some_names(list(unknown))}); left out: add the photos or correct "
            "the names"
        )
    return _once(out, doubts), doubts


def _once(marks: list[tuple[str, Mark]], doubts: list[str]) -> list[tuple[str, Mark]]:
    """Marks, the same pixel only once; other pixels of one point in one photo are told."""
    seen: dict[tuple[str, str], list[Mark]] = {}
    out = []
    for key, mark in marks:
        before = seen.setdefault((key, mark.name), [])
        if any(abs(m.u - mark.u) < 0.05 and abs(m.v - mark.v) < 0.05 for m in before):
            continue
        if before:
            doubts.append(
                f"{mark.source}: point {mark.name} is marked in {mark.photo} twice, at "
                f"{before[0].u:g}, {before[0].v:g} px ({before[0].source.rpartition(', ')[2]}) and "
                f"at {mark.u:g}, {mark.v:g} px; remove the wrong one"
            )
        before.append(mark)
        out.append((key, mark))
    return out


def _outside(mark: Mark, photo: OrientedPhoto) -> str:
    if photo.contains([mark.u, mark.v]):
        return ""
    w, h = photo.camera.width, photo.camera.height
    cure = "correct the pixel"
    if photo.contains([mark.v, mark.u]):
        cure = "exchanged it lies inside: write u (right) before v (down)"
    elif mark.v < 0 and photo.contains([mark.u, -mark.v]):
        cure = "v counts downwards from the top: turn its sign"
    return (
        f"{mark.source}: u, v: mark of {mark.name} at {mark.u:g}, {mark.v:g} px lies outside of "
        f"{mark.photo} ({w} x {h} px); left out: {cure}"
    )


def photo_finder(photos: Mapping[str, OrientedPhoto]) -> Callable[[str], tuple[str, ...]]:
    """Function from a photo's name as people write it to the ids it may mean.

    Folders, case and ending may differ; the closest form of the name that any photo has counts.
    """
    forms: list[dict[str, list[str]]] = [{}, {}, {}, {}]
    for key, photo in photos.items():
        path = PurePosixPath(str(photo.photo.path).replace("\\", "/"))
        for table, form in zip(forms, (key, path.name, path.name.lower(), _stem(path.name)),
                               strict=True):  # fmt: skip
            table.setdefault(form, []).append(key)

    def find(written: str) -> tuple[str, ...]:
        path = PurePosixPath(written.replace("\\", "/"))
        for table, form in zip(forms, (written, path.name, path.name.lower(), _stem(path.name)),
                               strict=True):  # fmt: skip
            if form in table:
                keys = table[form]
                same = [k for k in keys if len(path.parts) > 1 and k.endswith(written)]
                return tuple(same or keys)
        return ()

    return find


def _stem(name: str) -> str:
    return re.sub(r"\.(jpe?g|tiff?|png|dng)$", "", name.lower())


def some_names(names: Sequence[str]) -> str:
    """The first three of some names."""
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
