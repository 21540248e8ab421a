"""Which way traffic goes along rows of devices, and whether the signs before them agree with it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from georef_gis.errors import InputError
from georef_gis.frames import Array
from georef_gis.measure.workzone.screening import SignCheck
from georef_gis.measure.workzone.zone_settings import COMPASS, ZoneSettings
from processing_algorithms.assets.zone_found import ZoneAssets

# deg between `travel` and a row, above which the end that comes first hangs on little
_ASKEW = 60.0
# field of the errors that `travel` causes
TRAVEL = "zone.travel"
_MOST_SIGNS = 5


def faces(first: Array, last: Array, travel: float) -> bool:
    """Whether traffic towards `travel` (deg from north) meets the first of two places first."""
    towards = np.array([math.sin(math.radians(travel)), math.cos(math.radians(travel))])
    return bool((last - first) @ towards >= 0.0)


def travel_doubts(zone: ZoneSettings, found: ZoneAssets, lines: Sequence[str]) -> list[str]:
    """Rows that run so far from `travel` that it hardly tells their first device."""
    if zone.travel is None:
        return []
    out = []
    for line in dict.fromkeys(lines):
        devices = found.devices(line)
        bearing = _bearing(found, devices)
        off = abs((bearing - zone.travel + 180.0) % 360.0 - 180.0)
        if line not in found.by_order and len(devices) > 1 and off > _ASKEW:
            out.append(
                f"{TRAVEL}: {_written(zone)} lies {off:.0f} deg from line {line}, which runs "
                f"towards {bearing:.0f} deg or back: say it more closely, "
                f'"{_word(bearing)}" or "{_word((bearing + 180.0) % 360.0)}"'
            )
    return out


def sign_checks(zone: ZoneSettings, found: ZoneAssets) -> tuple[SignCheck, ...]:
    """Signs of each line from its taper outwards.

    A taper begins at its first device, or where the signs are nearest.

    Raises
    ------
    InputError
        If a sign is known to stand behind the beginning of its taper; with what is wrong instead,
        where that makes all signs fit.
    """
    return tuple(_sign_check(zone, found, line, taper) for line, taper in zone.signs)


def _sign_check(zone: ZoneSettings, found: ZoneAssets, line: str, taper: str) -> SignCheck:
    signs, devices, xy = _signs(found, line), found.devices(taper), found.measured.xy
    if taper in found.directed:
        start = devices[0]
        behind = _behind(found, line, devices)
        if behind:
            raise _refused(zone, found, (line, taper), behind)
    else:
        middle = xy[list(signs)].mean(axis=0)
        start = min((devices[0], devices[-1]), key=lambda i: float(np.linalg.norm(xy[i] - middle)))
    outwards = sorted(signs, key=lambda i: float(np.linalg.norm(xy[i] - xy[start])))
    return SignCheck(name=line, signs=tuple(outwards), start=start)


def _refused(
    zone: ZoneSettings, found: ZoneAssets, pair: tuple[str, str], behind: Sequence[str]
) -> InputError:
    line, taper = pair
    names = ", ".join(behind[:_MOST_SIGNS]) + (" ..." if len(behind) > _MOST_SIGNS else "")
    said = f"line {line} has signs behind the beginning of {taper} ({names})"
    turned = found.devices(taper)[::-1]
    if taper in found.by_order:
        if not _behind(found, line, turned):
            said += f"; all stand before its other end: number the `order` of {taper} from there"
    elif (fitting := _fitting_travel(zone, found, turned)) is not None:
        return InputError(
            f"{_written(zone)} is likely the wrong way: with it {said}; with "
            f'"{fitting}" all signs stand before their tapers: set travel = "{fitting}"',
            source=zone.source,
            field=TRAVEL,
        )
    else:
        said += f", as traffic goes by travel = {_written(zone)}"
    return InputError(
        f"{said}; it is for advance warning: give other signs another line, or none",
        source=zone.source,
    )


def _fitting_travel(zone: ZoneSettings, found: ZoneAssets, turned: tuple[int, ...]) -> str | None:
    """A `travel` with which no sign stands behind the beginning of its taper."""
    if zone.travel is None:
        return None
    # the opposite turns every row, a point of the compass is closer to this one
    for word in (_word(_bearing(found, turned)), _word((zone.travel + 180.0) % 360.0)):
        if all(
            not _behind(found, line, _devices_at(found, taper, COMPASS[word]))
            for line, taper in zone.signs
            if taper in found.directed
        ):
            return word
    return None


def _devices_at(found: ZoneAssets, line: str, travel: float) -> tuple[int, ...]:
    """Devices of a line as traffic towards `travel` meets them."""
    devices, xy = found.devices(line), found.measured.xy
    kept = line in found.by_order or faces(xy[devices[0]], xy[devices[-1]], travel)
    return devices if kept else devices[::-1]


def _signs(found: ZoneAssets, line: str) -> tuple[int, ...]:
    return tuple(found.places.indices[asset.id][0] for asset in found.signs[line])


def _behind(found: ZoneAssets, line: str, devices: tuple[int, ...]) -> list[str]:
    """Names of the signs of a line that traffic meets behind the first of the devices."""
    xy = found.measured.xy
    way = xy[devices[-1]] - xy[devices[0]]
    return [
        found.measured.names[i]
        for i in _signs(found, line)
        if float((xy[i] - xy[devices[0]]) @ way) > 0.0
    ]


def _bearing(found: ZoneAssets, devices: tuple[int, ...]) -> float:
    """Degrees from north, from the first to the last device."""
    east, north = found.measured.xy[devices[-1]] - found.measured.xy[devices[0]]
    return math.degrees(math.atan2(east, north)) % 360.0


def _word(bearing: float) -> str:
    """Nearest point of the compass."""
    return min(COMPASS, key=lambda word: abs((bearing - COMPASS[word] + 180.0) % 360.0 - 180.0))


def _written(zone: ZoneSettings) -> str:
    return f'"{zone.travel_written}"'
