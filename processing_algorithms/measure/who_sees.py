"""Tool `who_sees`: the photos that show a place, best first."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from georef_gis.toolbox import Algorithm, Context, Feedback, Output, Result
from georef_gis.toolbox import parameters as p
from processing_algorithms.measure.point_table import TABLE_SUFFIXES

if TYPE_CHECKING:
    from georef_gis.geodesy import MapFrame
    from georef_gis.measure.who_sees import Sighting
    from georef_gis.toolbox.values import MapPoint


class WhoSeesParameters(p.Parameters):
    """Parameters of `who_sees`."""

    place: p.MapPoint = p.map_point(
        title="Place x,y[,height][@CRS]; height in m above the ellipsoid, else that of the ground"
    )
    surveyed: p.Flag = p.flag(
        False, title="The place was surveyed, not read off this project's own products"
    )
    sigma_h: p.Length = p.length(0.0, title="One sigma of a surveyed place", unit="m", ge=0, le=1e4)
    sigma_v: p.Length = p.length(
        0.0, title="One sigma of a surveyed height", unit="m", ge=0, le=1e4
    )
    best: p.Integer = p.integer(0, title="At most so many photos, 0 = all", ge=0, le=100_000)
    target: p.File | None = p.file(
        None, title="CSV or JSON to write", suffixes=TABLE_SUFFIXES, writes=True
    )


class WhoSees(Algorithm[WhoSeesParameters]):
    """Photos that show a place: the predicted pixel in each and its ellipse, best first.

    A place read off the mosaic errs as the photos do: its pixels are sharp. A surveyed one does
    not: then the ellipses say how far off the poses may be.
    """

    id, name, group = "who_sees", "Which photos show a place", "measure"
    needs = ("poses",)
    outputs = (Output(name="photos", title="Photos as CSV or JSON"),)

    def run(self, context: Context, parameters: WhoSeesParameters, feedback: Feedback) -> Result:
        """Look."""
        from georef_gis.errors import InputError
        from processing_algorithms.measure.point_table import write_rows
        from processing_algorithms.measure.session import MeasureSession

        session = MeasureSession.open(context.require_project(), quick=context.quick)
        x, y, height = on_map(parameters.place, session.frame)
        if parameters.sigma_v > 0.0 and height is None:
            why = f"{parameters.sigma_v:g} m is of no height; give it, as in x,y,height"
            raise InputError(why, field="sigma_v")
        found = session.who_sees(
            x,
            y,
            height,
            surveyed=parameters.surveyed or height is not None or parameters.sigma_h > 0.0,
            sigma_h=parameters.sigma_h,
            sigma_v=parameters.sigma_v,
            best=parameters.best or None,
        )
        rows = [sighting_row(one, i + 1) for i, one in enumerate(found)]
        if not rows:
            feedback.warn(f"no photo shows {parameters.place}; the footprints say what they cover")
        outputs: dict[str, Path] = {}
        if parameters.target is not None:
            write_rows(parameters.target, rows, SIGHTING_COLUMNS)
            outputs["photos"] = parameters.target
        return Result(outputs=outputs, summary={"photos": len(rows), "sightings": rows})


SIGHTING_COLUMNS = (
    "rank", "photo", "u", "v", "sigma_major_px", "sigma_minor_px", "ellipse_azimuth_deg",
    "from_middle", "gsd_m",
)  # fmt: skip


def sighting_row(one: Sighting, rank: int) -> dict[str, Any]:
    """Row of a table; the azimuth is clockwise from the top of the image."""
    return {
        "rank": rank,
        "photo": one.photo_id,
        "u": round(float(one.uv[0]), 1),
        "v": round(float(one.uv[1]), 1),
        "sigma_major_px": round(one.semi_major, 1),
        "sigma_minor_px": round(one.semi_minor, 1),
        "ellipse_azimuth_deg": round(math.degrees(one.azimuth), 0),
        "from_middle": round(one.from_middle, 3),
        "gsd_m": round(one.gsd, 4),
    }


def on_map(place: MapPoint, frame: MapFrame) -> tuple[float, float, float | None]:
    """Place in units of the project's map; its height as it is.

    Raises
    ------
    InputError
        If its CRS is not known or has no such place.
    """
    import numpy as np

    from georef_gis.errors import InputError
    from georef_gis.geodesy import horizontal_crs, parse_crs
    from georef_gis.geodesy.reference_systems import transformer_between

    if place.crs is None:
        return place.x, place.y, place.height
    given = horizontal_crs(parse_crs(place.crs))
    at = np.array([place.x]), np.array([place.y])
    x, y = (float(v[0]) for v in transformer_between(given, frame.horizontal).transform(*at))
    if not (math.isfinite(x) and math.isfinite(y)):
        raise InputError(f"{place}: no such place in '{frame.crs.name}'", field="place")
    return x, y, place.height
