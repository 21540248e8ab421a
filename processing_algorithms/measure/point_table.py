"""Tables of measured points, as CSV and JSON."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from georef_gis.frames import Array
    from georef_gis.measure.measured import MeasuredPoint, MeasuredPoints

COLUMNS = (
    "name", "method", "photo", "u", "v", "lat_deg", "lon_deg", "easting", "northing",
    "height_ellipsoidal_m", "sigma_e_m", "sigma_n_m", "sigma_u_m", "corr_en", "semi_major_m",
    "semi_minor_m", "azimuth_deg", "conf", "dof", "n_rays", "sigma0", "photos", "pixels",
    "sigma_px", "doubts",
)  # fmt: skip

# of a table to write; another name may be that of a photo, named by mistake
TABLE_SUFFIXES = (".csv", ".json")


def point_rows(points: MeasuredPoints, *, conf: float | None = None) -> list[dict[str, Any]]:
    """Table of measured points, one row each with the columns `COLUMNS`.

    Sigmas in m along grid east, grid north and up; the azimuth of the ellipse of confidence `conf`
    (39.3 % where it is None) clockwise from grid north; easting and northing in units of the map.
    """
    from georef_gis.measure.ellipses import STANDARD, on_map

    frame = points.scene.frame
    geo = frame.origin.geo_from_enu(points.p_enu)
    places = zip(
        points, geo, frame.map_from_geo(geo), on_map(frame, points.p_enu, points.each), strict=True
    )
    level = STANDARD if conf is None else conf
    return [
        {
            **_clicked(point),
            "lat_deg": round(math.degrees(lat), 9),
            "lon_deg": round(math.degrees(lon), 9),
            "easting": round(float(e), 4),
            "northing": round(float(n), 4),
            "height_ellipsoidal_m": round(float(h), 4),
            **_spread(C, level),
            "dof": point.dof,
            "n_rays": point.n_rays,
            "sigma0": None if math.isnan(point.sigma0) else round(point.sigma0, 3),
            "photos": ";".join(point.photo_ids),
            "pixels": ";".join(f"{u:.2f},{v:.2f}" for u, v in point.uv),
            "sigma_px": ";".join(f"{sigma:.3g}" for sigma in point.sigma_px),
            "doubts": "; ".join(point.doubts),
        }
        for point, (lat, lon, _), (e, n, h), C in places
    ]


def click_sigmas(points: MeasuredPoints) -> str:
    """One sigma of the clicks, px, as they were counted; from the least to the largest."""
    if not len(points.marks.sigma):
        return ""
    least, most = float(points.marks.sigma.min()), float(points.marks.sigma.max())
    return f"{least:.3g}" if least == most else f"{least:.3g} to {most:.3g}"


def _clicked(point: MeasuredPoint) -> dict[str, Any]:
    """Name and way of a point, and its pixel where it is one alone."""
    alone = len(point.photo_ids) == 1
    return {
        "name": point.name,
        "method": point.method,
        "photo": point.photo_ids[0] if alone else "",
        "u": float(point.uv[0, 0]) if alone else None,
        "v": float(point.uv[0, 1]) if alone else None,
    }


def _spread(C: Array, conf: float) -> dict[str, float]:
    """Sigmas and ellipse of a covariance along grid east, grid north and up, (3, 3) m^2."""
    from georef_gis.measure.ellipses import error_ellipse

    sigma = [math.sqrt(max(float(C[k, k]), 0.0)) for k in range(3)]
    ellipse = error_ellipse(C, conf=conf)
    both = sigma[0] * sigma[1]
    return {
        "sigma_e_m": round(sigma[0], 4),
        "sigma_n_m": round(sigma[1], 4),
        "sigma_u_m": round(sigma[2], 4),
        "corr_en": round(float(C[0, 1]) / both, 4) if both > 0.0 else 0.0,
        "semi_major_m": round(ellipse.semi_major, 4),
        "semi_minor_m": round(ellipse.semi_minor, 4),
        "azimuth_deg": round(math.degrees(ellipse.azimuth), 2) % 180.0,
        "conf": round(ellipse.conf, 4),
    }


def check_target(target: Path | None, source: Path | None) -> None:
    """Refuse to write a table over the one that is read.

    Raises
    ------
    InputError
        If the marks would be lost.
    """
    from georef_gis.errors import InputError

    if target is None or source is None:
        return
    if target.resolve() == source.resolve():
        why = "is the table of marks that is read, and would be lost; name another"
        raise InputError(why, source=str(target), field="target")


def write_rows(target: Path, rows: Sequence[dict[str, Any]], columns: Sequence[str]) -> None:
    """Write a table as CSV, or as JSON where the name ends so; whole or not at all.

    Raises
    ------
    ExportError
        If it cannot be written.
    """
    import csv
    import io
    import json

    from georef_gis.rasters.files import export_errors, resolve_target, whole_file

    if target.suffix.lower() == ".json":
        text = json.dumps(list(rows), indent=1, ensure_ascii=False) + "\n"
    else:
        stream = io.StringIO(newline="")
        writer = csv.DictWriter(
            stream, fieldnames=columns, lineterminator="\n", extrasaction="ignore"
        )  # fmt: skip
        writer.writeheader()
        writer.writerows(rows)
        text = stream.getvalue()
    content = text.encode()
    with export_errors(target, lambda: len(content)), whole_file(resolve_target(target)) as file:
        file.write(content)
