"""Which bands of one or two maps a formula means, and how two maps lie upon each other."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from georef_gis.errors import GeometryError, InputError
from georef_gis.mosaic.band_math import find_bands, plain_name
from georef_gis.mosaic.band_shift import BandShift, WindowShift, common_shift
from georef_gis.rasters.edge_shift import EdgeShift, edge_shift
from georef_gis.rasters.reading import Window
from georef_gis.rasters.resampled import Bands, MapHeader, coarse_valid
from georef_gis.toolbox import Feedback, check_cancelled

ROLES = ("nir", "red", "green", "blue")
_NIR = ("nir", "near_infrared", "near_infra_red", "nearinfrared", "infrared")
# px; at least four times the largest shift
_WINDOW, _SMALLEST_WINDOW = 256, 64
# windows with a shift that are enough, and those that are looked at for them
_ENOUGH, _MOST_TRIED = 48, 200
# part of a window that both maps show, as far as coarse masks tell
_SHOWN = 0.7
_LATTICE = 40


@dataclass(frozen=True, slots=True, kw_only=True)
class Picked:
    """A band of one of the maps.

    Parameters
    ----------
    source
        0 = the map, 1 = the other one.
    band
        Counted from 1.
    told
        Such as ``mosaic.tif band 1 (red)``.
    """

    source: int
    band: int
    told: str


def pick_bands(
    names: Sequence[str], roles: Mapping[str, str], headers: Sequence[MapHeader]
) -> dict[str, Picked]:
    """Band of every name of a formula.

    Parameters
    ----------
    names
        As the formula has them.
    roles
        Role -> number or name as given, ``other:`` before it for the other map.
    headers
        Of the map, and of the other one if there is one.

    Raises
    ------
    InputError
        If there is no such band.
    """
    known = _known(headers)
    for role, given in roles.items():
        known[role] = _given(role, given, known, headers)
    for name in names:
        if name in ROLES and name not in known:
            have = "; ".join(f"{h.name} has {_listed(h)}" for h in headers)
            raise InputError(f"{have}; say which it is, --{name} NUMBER", field=name)
    find_bands(names, known)
    return {name: known[name] for name in names}


def band_name(header: MapHeader, band: int) -> str:
    """Name of a band, counted from 1, or its number where the file gives none."""
    return header.bands[band - 1] or f"band {band}"


def _known(headers: Sequence[MapHeader]) -> dict[str, Picked]:
    known: dict[str, Picked] = {}
    for source, header in enumerate(headers):
        for band, description in enumerate(header.bands, start=1):
            told = f"{header.name} band {band}" + (f" ({description})" if description else "")
            picked = Picked(source=source, band=band, told=told)
            name = plain_name(description)
            own = [name] * bool(name) + ["nir"] * (name in _NIR)
            if source:
                known[f"other.b{band}"] = picked
                for one in own:
                    known.setdefault(f"other.{one}", picked)
            else:
                known[f"b{band}"] = picked
            for one in own:
                known.setdefault(one, picked)
    return known


def _given(
    role: str, given: str, known: Mapping[str, Picked], headers: Sequence[MapHeader]
) -> Picked:
    """Band of a number or a name, maybe with ``other:`` before it."""
    prefix, _, own = given.strip().rpartition(":")
    source = 1 if prefix.strip().lower() == "other" else 0
    if (prefix and not source) or source >= len(headers):
        cure = "give --other FILE" if source else "write NUMBER or other:NUMBER"
        raise InputError(f"{given!r} names no map; {cure}", field=role)
    own = own.strip()
    name = f"b{int(own)}" if own.isdecimal() else plain_name(own)
    picked = known.get(f"other.{name}" if source else name)
    if picked is None or picked.source != source:
        raise InputError(
            f"{given!r} is no band; {headers[source].name} has {_listed(headers[source])}",
            field=role,
        )
    return picked


def _listed(header: MapHeader) -> str:
    return ", ".join(f"{i} {name}".strip() for i, name in enumerate(header.bands, start=1))


def find_shift(
    first: Bands, second: Bands, paths: tuple[Path, Path], *, most: float, feedback: Feedback
) -> BandShift:
    """Shift between two maps that are read on one grid.

    Parameters
    ----------
    first, second
        The map, and the other one on its grid.
    paths
        Their files.
    most
        Largest shift that is believed, px.

    Raises
    ------
    GeometryError
        If they share too little ground, or windows disagree.
    """
    names = f"{first.header.name} and {second.header.name}"
    side = _window_side(first.header, most, names)
    found: list[WindowShift] = []
    tried = 0
    bands = [range(1, len(one.header.bands) + 1) for one in (first, second)]
    for window in _windows(first.header, paths, side, names):
        check_cancelled(feedback)
        pixels, valid = first.read(window, bands[0])
        others, seen = second.read(window, bands[1])
        tried += 1
        both = np.concatenate([valid, seen], axis=2).all(axis=2)
        shift = edge_shift(pixels, others, np.asarray(both), most=most)
        if shift is not None:
            found.append(_at_middle(window, shift))
        if len(found) == _ENOUGH or tried == _MOST_TRIED:
            break
    try:
        return common_shift(found, tried=tried, most=most)
    except GeometryError as error:
        raise GeometryError(
            f"{names}: {error}; check that they show the same ground, raise --max-shift above "
            f"{most:g} px, or take their places as they are with --align none"
        ) from error


def _at_middle(window: Window, shift: EdgeShift) -> WindowShift:
    col, row = window[0] + window[2] / 2.0, window[1] + window[3] / 2.0
    return WindowShift(col=col, row=row, d_col=shift.d_col, d_row=shift.d_row, score=shift.score)


def _window_side(header: MapHeader, most: float, names: str) -> int:
    side = _WINDOW
    while side < 4 * most:
        side *= 2
    while side > min(header.width, header.height):
        side //= 2
    if side < _SMALLEST_WINDOW:
        raise GeometryError(
            f"{names}: {header.width} x {header.height} px are too few to find their shift; "
            "take their places as they are with --align none"
        )
    return side


def _windows(
    header: MapHeader, paths: tuple[Path, Path], side: int, names: str
) -> Iterator[Window]:
    """Windows that both maps show, spread over what they share, in a random order."""
    both = coarse_valid(paths[0], header) & coarse_valid(paths[1], header)
    if not both.any():
        raise GeometryError(f"{names} show no common ground; check their CRS and their places")
    share = np.pad(both.cumsum(0).cumsum(1).astype(np.float64), ((1, 0), (1, 0)))
    places = []
    for size in (header.width, header.height):
        count = min(_LATTICE, 2 * (size // side))
        places.append(np.unique(np.linspace(0, size - side, max(count, 1)).astype(int)))
    scale = np.array(both.shape) / (header.height, header.width)
    candidates = []
    for row in places[1].tolist():
        for col in places[0].tolist():
            r0, c0 = np.floor(np.array([row, col]) * scale).astype(int)
            r1, c1 = np.ceil(np.array([row + side, col + side]) * scale).astype(int)
            r1, c1 = min(r1, both.shape[0]), min(c1, both.shape[1])
            seen = share[r1, c1] - share[r0, c1] - share[r1, c0] + share[r0, c0]
            if seen >= _SHOWN * (r1 - r0) * (c1 - c0):
                candidates.append((col, row, side, side))
    order = np.random.default_rng(0).permutation(len(candidates))
    return (candidates[i] for i in order.tolist())
