"""Tool `ppk`: carrier-phase differential positions of a rover from raw GNSS files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from georef_gis.toolbox import Algorithm, Context, Feedback, Output, Result, check_cancelled
from georef_gis.toolbox import parameters as p

if TYPE_CHECKING:
    from georef_gis.navigate.ppk import BasePosition, PpkOptions, PpkSolution


class PpkParameters(p.Parameters):
    """Parameters of `ppk`."""

    rover: p.File = p.file(title="Raw file of the aircraft: RINEX observations or UBX")
    base: p.File = p.file(title="Raw file of the base: RINEX observations or UBX")
    nav: tuple[p.File, ...] = p.file(
        (),
        title="RINEX navigation file; give it once per file",
        help="not needed for a UBX file with RXM-SFRBX",
    )
    output: p.File = p.file(title=".pos or .csv to write", suffixes=(".pos", ".csv"), writes=True)
    events: p.File | None = p.file(
        None, title="CSV of the marks in the rover's RINEX file to write", suffixes=(".csv",),
        writes=True,
    )  # fmt: skip
    base_at: p.Text = p.text(
        "header",
        title="Place of the base",
        help="header: of its RINEX file; single: average of its single points (metres off); or "
        "lat,lon,height in degrees and metres",
    )
    base_geoid: p.Text = p.text(
        "",
        title="Geoid of the base's height",
        help="e.g. egm96 or geoid18; without it the height is ellipsoidal",
    )
    base_datum: p.Text = p.text(
        "unknown", title="Datum of the base's place", help="e.g. NAD83(2011)@2010.0"
    )
    base_of: Literal["marker", "antenna"] = p.choice(
        "marker", title="What of the base the place is of"
    )
    base_antenna_up: p.Length | None = p.length(
        None, title="Base antenna over its marker, instead of the header's", ge=-5, le=100
    )
    frequency: Literal["auto", "L1", "L1+L2"] = p.choice("auto", title="Frequencies")
    systems: p.Text = p.text("GPS,GLO,GAL,CMP,QZS", title="Satellite systems", advanced=True)
    mask: p.Angle = p.angle(15.0, title="Elevation mask", unit="deg", ge=0, lt=60)
    direction: Literal["forward", "backward", "combined"] = p.choice(
        "combined", title="Direction of the passes"
    )
    float_only: p.Flag = p.flag(False, title="Do not fix ambiguities", advanced=True)
    hold: p.Flag = p.flag(False, title="Hold a fix for later epochs", advanced=True)
    ratio: p.Number = p.number(3.0, title="Ratio for a fix", ge=1.2, le=100, advanced=True)
    dynamics: p.Flag = p.flag(False, title="Filter with constant acceleration", advanced=True)
    code_sigma: p.Length | None = p.length(
        None, title="One sigma of a code measurement at the zenith", gt=0, le=50, advanced=True
    )
    sigma_scale: p.Number | None = p.number(
        None, title="Factor on the sigmas", gt=0, le=100, advanced=True
    )
    float_sigma_scale: p.Number | None = p.number(
        None, title="Further factor on sigmas without a fix", gt=0, le=1000, advanced=True
    )
    timeout: p.Number = p.number(3600.0, title="Time limit", unit="s", gt=0, advanced=True)


class Ppk(Algorithm[PpkParameters]):
    """Positions of the aircraft's antenna by carrier phase against a base (PPK).

    RTKLIB solves; what is written is a `.pos` file (GPS time, ellipsoidal heights, full
    covariances) that the log reader reads: name it in project.toml as [logs] gnss. Positions are
    in the datum of the base.
    """

    id, name, group = "ppk", "PPK positions", "navigate"
    needs_project = False
    outputs = (
        Output(name="positions", title="Positions"),
        Output(name="events", title="Marks"),
    )

    def run(self, context: Context, parameters: PpkParameters, feedback: Feedback) -> Result:
        """Solve and write."""
        from georef_gis.errors import InputError
        from georef_gis.navigate.ppk import run_ppk, write_pos

        output = parameters.output
        if not output.parent.is_dir():
            raise InputError("its folder is not there; make it first", source=str(output))
        feedback.progress(0.0, "RTKLIB at work")
        solution = run_ppk(
            parameters.rover,
            parameters.base,
            parameters.nav,
            _options(parameters),
            check=lambda: check_cancelled(feedback),
        )
        if output.suffix.lower() == ".pos":
            inputs = (parameters.rover, parameters.base, *parameters.nav)
            write_pos(output, solution, inputs=inputs)
        else:
            _write_text(output, _csv(solution))
        outputs = {"positions": output}
        if parameters.events is not None and solution.events is not None:
            _write_text(parameters.events, _events_csv(solution))
            outputs["events"] = parameters.events
        for doubt in solution.log.doubts:
            feedback.warn(doubt)
        feedback.progress(1.0, "done")
        return Result(outputs=outputs, summary=_summary(solution, output))


def _options(parameters: PpkParameters) -> PpkOptions:
    from dataclasses import replace

    from georef_gis.navigate.ppk import PpkOptions

    options = PpkOptions(
        base=_base(parameters),
        base_antenna_up=parameters.base_antenna_up,
        frequency=parameters.frequency,
        systems=tuple(name.strip().upper() for name in parameters.systems.split(",")),
        elevation_mask=parameters.mask,
        direction=parameters.direction,
        fix=not parameters.float_only,
        hold=parameters.hold,
        ratio=parameters.ratio,
        dynamics=parameters.dynamics,
        timeout=parameters.timeout,
    )
    given = {
        name: getattr(parameters, name)
        for name in ("code_sigma", "sigma_scale", "float_sigma_scale")
        if getattr(parameters, name) is not None
    }
    return replace(options, **given)


def _base(parameters: PpkParameters) -> BasePosition | Literal["header", "single"]:
    import math

    from georef_gis.errors import InputError
    from georef_gis.geodesy import Datum, Height, HeightKind
    from georef_gis.navigate.ppk import BasePosition

    text = parameters.base_at.strip()
    if text == "header":
        return "header"
    if text == "single":
        return "single"
    try:
        lat, lon, height = (float(part) for part in text.split(","))
    except ValueError as error:
        raise InputError(
            f"{text!r} is no place; give lat,lon,height in degrees and metres, header or single",
            field="base_at",
        ) from error
    geoid = parameters.base_geoid.strip()
    kind = HeightKind.ORTHOMETRIC if geoid else HeightKind.ELLIPSOIDAL
    return BasePosition(
        lat=math.radians(lat),
        lon=math.radians(lon),
        height=Height(value=height, kind=kind, geoid=geoid or "egm96"),
        datum=Datum.parse(parameters.base_datum),
        of=parameters.base_of,
    )


def _summary(solution: PpkSolution, output: Path) -> dict[str, Any]:
    import numpy as np

    log = solution.log
    sigma = np.sqrt(np.median(np.diagonal(log.covariance_ned, axis1=1, axis2=2), axis=0))
    return {
        "products": [str(output)],
        "positions": len(log),
        "fixed_percent": round(100.0 * solution.fixed_share, 1),
        "sigma_north_m": round(float(sigma[0]), 4),
        "sigma_east_m": round(float(sigma[1]), 4),
        "sigma_down_m": round(float(sigma[2]), 4),
        "satellites": round(float(np.mean(log.satellites)), 1),
        "events": 0 if solution.events is None else len(solution.events),
        "program": solution.program,
        "doubts": list(log.doubts),
    }


def _csv(solution: PpkSolution) -> str:
    """Columns of the project's own GNSS log."""
    import numpy as np

    from georef_gis.units import week_from_gps

    log = solution.log
    lines = [
        "gps_week,tow_s,lat_deg,lon_deg,height_ellipsoidal_m,v_north,v_east,v_down,"
        "sigma_north_m,sigma_east_m,sigma_down_m,sigma_v_north,sigma_v_east,sigma_v_down,fix"
    ]
    spread = np.sqrt(np.diagonal(log.covariance_ned, axis1=1, axis2=2))
    spread_v = np.sqrt(np.diagonal(log.covariance_v_ned, axis1=1, axis2=2))
    for i in range(len(log)):
        week, tow = week_from_gps(round(float(log.time[i]), 6))
        place = f"{np.degrees(log.lat[i]):.10f},{np.degrees(log.lon[i]):.10f},{log.height[i]:.4f}"
        more = [*log.v_ned[i], *spread[i], *spread_v[i]]
        cells = ",".join("" if np.isnan(v) else f"{v:.4f}" for v in more)
        lines.append(f"{week},{tow:.6f},{place},{cells},{log.fix[i]}")
    return "\n".join(lines) + "\n"


def _events_csv(solution: PpkSolution) -> str:
    from georef_gis.units import week_from_gps

    events = solution.events
    times = [] if events is None else [float(t) for t in events.time]
    rows = [week_from_gps(time) for time in times]
    return "gps_week,tow_s\n" + "".join(f"{week},{tow:.7f}\n" for week, tow in rows)


def _write_text(file: Path, text: str) -> None:
    """Whole or not at all."""
    import os

    from georef_gis.errors import InputError

    part = file.with_name(f"{file.name}.part")
    try:
        part.write_text(text, encoding="utf-8")
        os.replace(part, file)
    except OSError as error:
        raise InputError(f"cannot be written: {error.strerror}", source=str(file)) from error
    finally:
        part.unlink(missing_ok=True)
