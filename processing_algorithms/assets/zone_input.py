"""A work zone's assets as its settings name them: rows of devices, edges and signs with places."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

from georef_gis.errors import InputError
from georef_gis.measure.assets.asset import Asset
from georef_gis.measure.assets.domain import Domain
from georef_gis.measure.workzone.geometry import Measured, along_and_offset, order_along
from georef_gis.measure.workzone.rules import Rules, load_rules
from georef_gis.measure.workzone.screening import (
    LaneCheck,
    TangentCheck,
    TaperCheck,
    ZoneChecks,
)
from georef_gis.measure.workzone.zone_settings import LaneSettings, TaperSettings, ZoneSettings
from georef_gis.units import INTERNATIONAL_FOOT as FOOT
from processing_algorithms.assets.asset_places import JointPlaces, joint_places
from processing_algorithms.assets.zone_found import ZoneAssets
from processing_algorithms.assets.zone_travel import faces, sign_checks

if TYPE_CHECKING:
    from georef_gis.project import Project

DEVICES, SIGNS = "channelizing device", "sign"
_INCH = FOOT / 12.0


def zone_assets(
    project: Project, zone: ZoneSettings, *, more: Sequence[str] = (), sigma_px: float
) -> ZoneAssets:
    """Assets that a zone's settings name, measured together.

    Parameters
    ----------
    more
        Lines besides those of the checks.
    sigma_px
        One sigma of a click that states none, px.

    Raises
    ------
    InputError
        Naming what is not there, or has no accuracy.
    """
    from georef_gis.measure.assets.store import AssetStore
    from georef_gis.project.records import load_frame

    with AssetStore.of_project(project) as store:
        assets, domain = store.assets(), store.domain
    names = [*(t.line for t in zone.tapers), *zone.tangents, *(lane.line for lane in zone.lanes),
             *(taper for _, taper in zone.signs), *more]  # fmt: skip
    edge_names = [*(t.edge for t in zone.tapers), *(lane.edge for lane in zone.lanes)]
    rows = {name: _of_line(assets, domain, name, DEVICES, zone.source)
            for name in dict.fromkeys(names)}  # fmt: skip
    signs = {name: _of_line(assets, domain, name, SIGNS, zone.source) for name, _ in zone.signs}
    edges = {name: _edge(assets, name, zone.source) for name in dict.fromkeys(edge_names) if name}
    used = {a.id: a for row in (*rows.values(), *signs.values()) for a in row}
    used |= {asset.id: asset for asset in edges.values()}
    if not used:
        raise InputError("names no line of devices; give one", source=zone.source)
    frame = load_frame(project.database)
    places = joint_places(project, frame, list(used.values()), sigma_px=sigma_px)
    measured = Measured.of(places.names, places.p_enu, places.covariance)
    by_order = frozenset(name for name, row in rows.items() if _orders(row) is not None)
    lines = {name: _ordered(row, places, zone.travel) for name, row in rows.items()}
    return ZoneAssets(
        frame=frame,
        places=places,
        measured=measured,
        lines=lines,
        directed=by_order if zone.travel is None else frozenset(lines),
        by_order=by_order,
        signs=signs,
        edges=edges,
    )


def line_of(asset: Asset) -> str:
    """Line that an asset belongs to; '' for none."""
    return str(asset.attributes.get("line") or "")


def _of_line(
    assets: Sequence[Asset], domain: Domain, name: str, group: str, source: str
) -> tuple[Asset, ...]:
    kinds = domain.in_group(group)
    found = tuple(
        a for a in assets if a.kind in kinds and a.shape == "point" and line_of(a) == name
    )  # fmt: skip
    if not found:
        there = sorted({line_of(a) for a in assets if a.kind in kinds and line_of(a)})
        raise InputError(
            f"no {group} belongs to line '{name[:40]}'; "
            f"there are {', '.join(there[:10]) or 'none'}",
            source=source,
        )
    return found


def _edge(assets: Sequence[Asset], name: str, source: str) -> Asset:
    found = [a for a in assets if a.shape == "line" and a.name == name]
    if not found:
        there = sorted({a.name for a in assets if a.shape == "line" and a.name})
        raise InputError(f"no line asset is called '{name[:40]}'; "
                         f"there are {', '.join(there[:10]) or 'none'}", source=source,
                         field="edge")  # fmt: skip
    if len(found) > 1:
        raise InputError(f"{len(found)} line assets are called '{name[:40]}'; the edge must be one",
                         source=source, field="edge")  # fmt: skip
    return found[0]


def _orders(row: tuple[Asset, ...]) -> list[int] | None:
    """Attribute `order` of the devices, if all have one of their own."""
    orders = [asset.attributes.get("order") for asset in row]
    numbers = [order for order in orders if isinstance(order, int)]
    return numbers if len(set(numbers)) == len(row) else None


def _ordered(
    row: tuple[Asset, ...], places: JointPlaces, travel: float | None
) -> tuple[Asset, ...]:
    """Devices in their order, from the first that drivers meet if that is known."""
    if (orders := _orders(row)) is not None:
        by_order = sorted(zip(orders, range(len(row)), strict=True))
        return tuple(row[k] for _, k in by_order)
    xy = places.p_enu[[places.indices[asset.id][0] for asset in row], :2]
    way = order_along(xy)
    if travel is not None and not faces(xy[way[0]], xy[way[-1]], travel):
        way.reverse()
    return tuple(row[k] for k in way)


def zone_rules(zone: ZoneSettings) -> Rules:
    """Figures that a zone is screened against.

    Raises
    ------
    InputError
        If there are none of that name, with the file of the settings.
    """
    try:
        return load_rules(zone.rules, folder=Path(zone.source).parent)
    except InputError as error:
        raise InputError(str(error), source=zone.source) from error


# -- what is to be screened ----------------------------------------------------------------------


def zone_checks(zone: ZoneSettings, found: ZoneAssets) -> ZoneChecks:
    """What a zone's settings ask to be screened, by indices of the measured places."""
    return ZoneChecks(
        speed_mph=zone.speed_mph or 0.0,
        road_type=zone.road_type,
        tapers=tuple(_taper(one, found) for one in zone.tapers),
        tangents=tuple(TangentCheck(name=n, devices=found.devices(n)) for n in zone.tangents),
        lanes=tuple(lane_check(one, found) for one in zone.lanes),
        signs=sign_checks(zone, found),
    )


def _taper(one: TaperSettings, found: ZoneAssets) -> TaperCheck:
    return TaperCheck(
        name=one.line,
        kind=one.kind,
        devices=found.devices(one.line),
        offset=one.offset,
        edge=found.edge(one.edge),
    )


def lane_check(one: LaneSettings, found: ZoneAssets) -> LaneCheck:
    """Lane between a row and an edge, with half the widths of the devices."""
    half = []
    for asset in found.lines[one.line]:
        width = asset.attributes.get("width_in")
        half.append(width * _INCH / 2.0 if isinstance(width, int | float) else math.nan)
    return LaneCheck(
        name=one.name,
        devices=found.devices(one.line),
        edge=found.edge(one.edge),
        half_widths=tuple(half),
        least=one.least,
    )


def offset_to_left(zone: ZoneSettings, found: ZoneAssets, lines: Sequence[str]) -> float | None:
    """Shift of a merging taper to the left of the traffic, m; None where it cannot be told.

    The direction of the road is that of the row which follows the taper.
    """
    merging = {one.line for one in zone.tapers if one.kind == "merging"}
    xy = found.measured.xy
    for line, following in pairwise(lines):
        if line not in merging or not {line, following} <= found.directed:
            continue
        taper, row = found.devices(line), found.devices(following)
        if len(taper) > 1 and len(row) > 1:
            road = xy[row[-1]] - xy[row[0]]
            return along_and_offset(xy[taper[0]], xy[taper[-1]], road)[1]
    return None
