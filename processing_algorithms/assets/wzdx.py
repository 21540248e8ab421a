"""Tool `wzdx`: the work zone as a feed of the Work Zone Data Exchange."""

from __future__ import annotations

import json
import math
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

from georef_gis.toolbox import Algorithm, Context, Feedback, Output, Result
from georef_gis.toolbox import parameters as p

if TYPE_CHECKING:
    from georef_gis.measure.workzone.verdicts import Finding
    from georef_gis.measure.workzone.wzdx_settings import DevicePlace, WzdxSettings
    from georef_gis.measure.workzone.zone_settings import ZoneSettings
    from processing_algorithms.assets.zone_found import ZoneAssets


class WzdxParameters(p.Parameters):
    """Parameters of `wzdx`."""

    zone: p.File | None = p.file(
        None, title="What the feed states; else work_zone.toml of the project",
        help="Where there is none, one to fill in is written.",
    )  # fmt: skip
    click: p.Number = p.number(0.5, title="One sigma of a click that states none, px", gt=0, le=100)
    target: p.File | None = p.file(
        None, title="GeoJSON to write; else products/work_zone.geojson", suffixes=(".geojson",),
        writes=True,
    )  # fmt: skip


class Wzdx(Algorithm[WzdxParameters]):
    """Work zone as a WZDx feed (GeoJSON), from the first to the last channelizing device.

    Dates, road names, direction and organisations are never made up: what is missing in
    work_zone.toml is told at once. The feed is checked against the published rules before it is
    written. How sure the places are stands in a file beside it, as the standard has no place for
    it.
    """

    id, name, group = "wzdx", "WZDx feed of a work zone", "measure"
    about = "assets"
    needs = ("poses",)
    outputs = (
        Output(name="feed", title="WZDx work zone feed", type="VectorLayer"),
        Output(name="accuracy", title="Accuracy of its positions"),
        Output(name="zone", title="File to fill in, where there was none"),
    )

    def run(self, context: Context, parameters: WzdxParameters, feedback: Feedback) -> Result:
        """Make the feed."""
        from georef_gis.measure.workzone.wzdx import accuracy_file, build_feed, stated_width
        from georef_gis.measure.workzone.wzdx_direction import direction_doubts
        from georef_gis.measure.workzone.wzdx_settings import wzdx_settings
        from georef_gis.measure.workzone.zone_settings import read_zone
        from processing_algorithms.assets.zone_file import write_zone_file, zone_path
        from processing_algorithms.assets.zone_input import zone_assets
        from processing_algorithms.assets.zone_travel import travel_doubts

        project = context.require_project()
        path = zone_path(project, parameters.zone)
        if not path.is_file():
            return write_zone_file(project, path, feedback)
        zone = read_zone(path)
        lines = _lines(zone)
        if not lines:
            # refused with all that is missing, before any device is looked for
            wzdx_settings(zone.wzdx, zone.source)
        found = zone_assets(project, zone, more=lines, sigma_px=parameters.click)
        settings = _settings(zone, found, lines)
        places, widths = _places(found, settings, zone), _widths(zone, found)
        doubts = (
            *found.places.doubts,
            *_gaps(found, settings.lines),
            *travel_doubts(zone, found, settings.lines),
            *_sign_doubts(zone, found),
            *_impact_doubts(zone, found, settings),
            *direction_doubts(settings, places),
        )
        for doubt in doubts:
            feedback.warn(doubt)
        unsure = [width for width in widths if stated_width(width) <= 0.0]
        for width in unsure:
            feedback.warn(
                f"{width.subject}: width {width.value:.2f} m, one sigma {width.sigma:.2f} m: not "
                "stated; measure it better"
            )
        feed = build_feed(settings, places, widths=widths, now=datetime.now(UTC))
        datum = str(found.frame.gnss_datum), found.frame.datum_sigma
        accuracy = accuracy_file(
            places, widths=widths, datum=datum, assumption=found.places.basis, settings=settings
        )
        target = parameters.target or project.products / "work_zone.geojson"
        outputs = {"feed": target, "accuracy": target.with_name(f"{target.stem}_accuracy.json")}
        _write(outputs["accuracy"], accuracy)
        _write(outputs["feed"], feed)
        summary = {"version": settings.rules.version, "devices": len(places),
                   "reduced_widths": len(widths) - len(unsure),
                   "products": [str(path) for path in outputs.values()]}  # fmt: skip
        return Result(outputs=outputs, summary=summary)


def _lines(zone: ZoneSettings) -> list[str]:
    """Lines of devices as far as they can be read; what is wrong is told with the rest."""
    given = zone.wzdx.get("devices")
    return [one for one in given if isinstance(one, str) and one] if isinstance(given, list) else []


def _settings(zone: ZoneSettings, found: ZoneAssets, lines: list[str]) -> WzdxSettings:
    from georef_gis.measure.workzone.wzdx import suggested_impact
    from georef_gis.measure.workzone.wzdx_settings import wzdx_settings
    from processing_algorithms.assets.zone_input import offset_to_left

    offset = offset_to_left(zone, found, lines)
    suggestion = "" if offset is None else suggested_impact(offset)
    return wzdx_settings(zone.wzdx, zone.source, suggestion=suggestion)


def _places(found: ZoneAssets, settings: WzdxSettings, zone: ZoneSettings) -> list[DevicePlace]:
    """Devices of the lines as drivers meet them."""
    from georef_gis.errors import InputError
    from georef_gis.measure.ellipses import error_ellipse, on_map
    from georef_gis.measure.workzone.wzdx_settings import DevicePlace
    from processing_algorithms.assets.asset_clicks import CONF

    unknown = [line for line in settings.lines if line not in found.directed]
    if unknown:
        raise InputError(
            f"which device of {', '.join(unknown)} drivers meet first is not known; give travel, "
            "or every device its order",
            source=zone.source,
            field="zone.travel",
        )
    out = []
    for line in settings.lines:
        for asset, i in zip(found.lines[line], found.devices(line), strict=True):
            p_enu = found.places.p_enu[i]
            own = found.places.covariance[3 * i : 3 * i + 3, 3 * i : 3 * i + 3]
            C = on_map(found.frame, p_enu[None], own[None])[0]
            ellipse = error_ellipse(C, conf=CONF)
            lat, lon, _ = found.frame.origin.geo_from_enu(p_enu)
            out.append(
                DevicePlace(
                    name=found.places.names[i],
                    asset_id=asset.id,
                    lon=math.degrees(lon),
                    lat=math.degrees(lat),
                    sigma_e=math.sqrt(C[0, 0]),
                    sigma_n=math.sqrt(C[1, 1]),
                    semi_major=ellipse.semi_major,
                    semi_minor=ellipse.semi_minor,
                    azimuth=math.degrees(ellipse.azimuth),
                )
            )
    return out


def _gaps(found: ZoneAssets, lines: list[str]) -> list[str]:
    """Lines that do not begin where the one before ends."""
    import numpy as np

    out = []
    xy = found.measured.xy
    for before, after in pairwise(lines):
        a, b = found.devices(before), found.devices(after)
        forward = np.linalg.norm(xy[b[0]] - xy[a[-1]])
        backward = np.linalg.norm(xy[b[-1]] - xy[a[0]])
        if forward > backward:
            out.append(f"line {after} does not begin where {before} ends; check the order of "
                       "wzdx.devices and zone.travel")  # fmt: skip
    return out


def _sign_doubts(zone: ZoneSettings, found: ZoneAssets) -> list[str]:
    """Signs that do not stand before their taper; refused if `travel` is the cause.

    Raises
    ------
    InputError
        If all signs fit another `travel`: the feed would run from its end to its beginning.
    """
    from georef_gis.errors import InputError
    from processing_algorithms.assets.zone_travel import TRAVEL, sign_checks

    try:
        sign_checks(zone, found)
    except InputError as error:
        if error.field == TRAVEL:
            raise
        return [str(error)]
    return []


def _impact_doubts(zone: ZoneSettings, found: ZoneAssets, settings: WzdxSettings) -> list[str]:
    """A stated side of merging that the taper does not have."""
    from georef_gis.measure.workzone.wzdx import suggested_impact
    from processing_algorithms.assets.zone_input import offset_to_left

    stated, offset = settings.values["vehicle_impact"], offset_to_left(zone, found, settings.lines)
    if offset is None or stated != suggested_impact(-offset):
        return []
    return [
        f"wzdx.vehicle_impact: '{stated}', but the devices of the taper lead to the "
        f"{'left' if offset > 0 else 'right'}: {suggested_impact(offset)}? correct it"
    ]


def _widths(zone: ZoneSettings, found: ZoneAssets) -> list[Finding]:
    """Of each lane whose width is to be stated, the narrowest device."""
    from georef_gis.measure.workzone.screening import ZoneChecks, screen
    from georef_gis.measure.workzone.wzdx import certain_width
    from processing_algorithms.assets.zone_input import lane_check, zone_rules

    rules = zone_rules(zone)
    out = []
    for lane in zone.lanes:
        if lane.reduced_width:
            checks = ZoneChecks(speed_mph=0.0, lanes=(lane_check(lane, found),))
            parts = [one for one in screen(checks, found.measured, rules) if one.part]
            out.append(min(parts, key=certain_width))
    return out


def _write(target: Path, content: dict[str, Any]) -> None:
    from georef_gis.rasters.files import export_errors, resolve_target, whole_file

    text = (json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode()
    target.parent.mkdir(parents=True, exist_ok=True)
    with export_errors(target, lambda: len(text)), whole_file(resolve_target(target)) as stream:
        stream.write(text)
