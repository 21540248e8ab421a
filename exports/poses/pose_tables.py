"""Exporters of poses as the tables that Metashape, PIX4Dmapper and PIX4Dmatic import.

Angles: yaw, pitch, roll are those of a body whose camera looks down, from true north, in any CRS;
omega, phi, kappa turn the photo's axes into those of the map, grid north. Agisoft's own script
`save_estimated_reference.py` takes the local frame of the geocentric CRS for the first and that of
the map for the second; Pix4D support 202558969 defines them alike.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from georef_gis.errors import ExportError
from georef_gis.toolbox import Exporter, ExportReport, Feedback, LayerSource
from georef_gis.toolbox import parameters as p

if TYPE_CHECKING:
    from exports.site.columns import Feature
    from exports.site.site import SiteLayers
    from georef_gis.geodesy import CRS

_YPR = ("yaw", "pitch", "roll")
_OPK = ("omega", "phi", "kappa")


def _crs_choice() -> Any:
    return p.choice(
        "geographic",
        title="Coordinates",
        help="geographic (longitude and latitude, EPSG:4326) or project (the project's CRS)",
        choices=("geographic", "project"),
    )


def _heights_choice() -> Any:
    return p.choice(
        "ellipsoidal",
        title="Heights",
        help="ellipsoidal, or orthometric (EGM96); say the same where the file is imported",
        choices=("ellipsoidal", "orthometric"),
    )


class TableOptions(p.Parameters):
    """Options of a table with either kind of angles."""

    angles: p.Choice = p.choice(
        "ypr",
        title="Angles",
        help="ypr (yaw, pitch, roll) or opk (omega, phi, kappa; coordinates of the project)",
        choices=("ypr", "opk"),
    )
    crs: p.Choice = _crs_choice()
    heights: p.Choice = _heights_choice()


class MaticOptions(p.Parameters):
    """Options of a table that holds yaw, pitch, roll alone."""

    crs: p.Choice = _crs_choice()
    heights: p.Choice = _heights_choice()


@dataclass(frozen=True, slots=True, kw_only=True)
class _Wish:
    """Options of a table, decided."""

    angles: tuple[str, ...]
    geographic: bool
    orthometric: bool


class MetashapeCsv(Exporter[TableOptions]):
    """Reference CSV for Metashape (Import Reference, comma), with accuracies.

    CRS and kind of the heights stand in the first lines. Take the same angles in the reference
    settings as here.
    """

    id = "metashape_csv"
    name = "Metashape reference CSV"
    suffix = ".csv"
    accepts = ("vector",)
    target = "metashape_reference.csv"
    needs = ("photos", "poses")

    def write(
        self, source: LayerSource, target: Path, options: TableOptions, feedback: Feedback
    ) -> ExportReport:
        """Write the poses to `target`."""
        wish = _wish(options.angles, options.crs, options.heights)
        return _write(source, target, feedback, wish, write_metashape)


class Pix4dMapperCsv(Exporter[TableOptions]):
    """Image geolocation for PIX4Dmapper: name, latitude, longitude, altitude, angles, accuracies.

    In the project's CRS: name, x, y, z. No header; a height is in the unit of its CRS.
    """

    id = "pix4dmapper_csv"
    name = "PIX4Dmapper geolocation CSV"
    suffix = ".csv"
    accepts = ("vector",)
    target = "pix4dmapper.csv"
    needs = ("photos", "poses")

    def write(
        self, source: LayerSource, target: Path, options: TableOptions, feedback: Feedback
    ) -> ExportReport:
        """Write the poses to `target`."""
        wish = _wish(options.angles, options.crs, options.heights)
        return _write(source, target, feedback, wish, write_pix4dmapper)


class Pix4dMaticCsv(Exporter[MaticOptions]):
    """Image geolocation and orientation for PIX4Dmatic: yaw, pitch, roll and accuracies.

    Coordinates stand in the order of the CRS's axes: latitude first, and north first where the
    project's CRS has it so. Heights and accuracies are in the unit of the CRS.
    """

    id = "pix4dmatic_csv"
    name = "PIX4Dmatic geolocation CSV"
    suffix = ".csv"
    accepts = ("vector",)
    target = "pix4dmatic.csv"
    needs = ("photos", "poses")

    def write(
        self, source: LayerSource, target: Path, options: MaticOptions, feedback: Feedback
    ) -> ExportReport:
        """Write the poses to `target`."""
        wish = _wish("ypr", options.crs, options.heights)
        return _write(source, target, feedback, wish, write_pix4dmatic)


_Writer = Callable[["SiteLayers", Path, _Wish], ExportReport]


def _wish(angles: str, crs: str, heights: str) -> _Wish:
    geographic = crs == "geographic"
    if geographic and angles == "opk":
        raise ExportError(
            "omega, phi, kappa turn into the axes of a map, which longitude and latitude are not; "
            "use crs=project, or angles=ypr"
        )
    return _Wish(
        angles=_OPK if angles == "opk" else _YPR,
        geographic=geographic,
        orthometric=heights == "orthometric",
    )


def _write(
    source: LayerSource, target: Path, feedback: Feedback, wish: _Wish, writer: _Writer
) -> ExportReport:
    from exports.poses.poses import site_with_poses

    report = writer(site_with_poses(source), target, wish)
    for warning in report.warnings:
        feedback.warn(warning)
    return report


# -- rows --------------------------------------------------------------------------------------


def _posed(site: SiteLayers) -> list[Feature]:
    features = [f for f in site.layers["photos"].features if f.values["pose_kind"] is not None]
    if not features:
        raise ExportError("no photo has a pose yet; run `georef run` first")
    return features


def _plain_names(features: Sequence[Feature], signs: str) -> tuple[list[Feature], tuple[str, ...]]:
    """Features whose names a format without quotes can hold, and a warning about the others."""

    def fits(feature: Feature) -> bool:
        name = str(feature.values["file"])
        return not name.startswith("#") and not any(sign in name for sign in signs)

    kept = [f for f in features if fits(f)]
    left = [str(f.values["file"]) for f in features if not fits(f)]
    if not kept:
        raise ExportError(f"the file cannot hold names such as {left[0]!r}; rename the photos")
    warning = f"{len(left)} photos left out: the file cannot hold names such as"
    return kept, (f"{warning} {left[0]!r}",) if left else ()


def _height(feature: Feature, wish: _Wish) -> float:
    """Height, m."""
    return float(feature.height_orthometric[0] if wish.orthometric else feature.geo[0, 2])


def _accuracy(feature: Feature) -> tuple[float, float]:
    """Horizontal (per axis, root mean square) and vertical sigma, m."""
    e, n, u = (float(feature.values[f"sigma_{axis}_m"] or 0.0) for axis in "enu")
    return math.sqrt((e * e + n * n) / 2.0), u


def _angles(feature: Feature, wish: _Wish) -> list[str]:
    return [f"{feature.values[f'{name}_deg']:.8f}" for name in wish.angles]


def _kind(wish: _Wish) -> str:
    return "orthometric (EGM96)" if wish.orthometric else "ellipsoidal"


def _crs_name(site: SiteLayers, wish: _Wish) -> str:
    return "EPSG:4326" if wish.geographic else site.crs_name


def _unit(site: SiteLayers, wish: _Wish) -> float:
    """Length of the unit of heights and accuracies in a Pix4D file, m."""
    from georef_gis.geodesy import metres_per_unit

    return 1.0 if wish.geographic else metres_per_unit(site.crs)


# -- Metashape ---------------------------------------------------------------------------------


def write_metashape(site: SiteLayers, target: Path, wish: _Wish) -> ExportReport:
    """Reference CSV of Metashape: `#` lines, the header with which it exports, one row a photo."""
    from georef_gis.geodesy import parse_crs

    features = _posed(site)
    crs = parse_crs("EPSG:4326") if wish.geographic else site.crs
    place = ("X/Longitude", "Y/Latitude") if wish.geographic else ("X/Easting", "Y/Northing")
    titles = [name.capitalize() for name in wish.angles]
    header = (
        "#Label", *place, "Z/Altitude", *titles, "Accuracy_X/Y_(m)", "Accuracy_Z_(m)",
        *(f"Accuracy_{title}_(deg)" for title in titles),
    )  # fmt: skip
    frame = "true north" if wish.angles == _YPR else "the map's axes (grid north)"
    with target.open("w", encoding="utf-8", newline="") as stream:
        stream.write(f"# CoordinateSystem: {crs.to_wkt('WKT1_GDAL')}\n")
        stream.write(f"# heights: {_kind(wish)}, m\n")
        stream.write(f"# angles: {', '.join(wish.angles)} in degrees, from {frame}\n")
        stream.write(",".join(header) + "\n")
        writer = csv.writer(stream, lineterminator="\n")
        for f in features:
            x, y = f.geo[0, :2] if wish.geographic else f.xy_map[0]
            decimals = 10 if wish.geographic else 4
            sigmas = (f.values[f"sigma_{name}_deg"] for name in wish.angles)
            writer.writerow(
                [
                    f.values["file"],
                    *(f"{v:.{decimals}f}" for v in (x, y)),
                    f"{_height(f, wish):.4f}",
                    *_angles(f, wish),
                    *(f"{v:.4f}" for v in _accuracy(f)),
                    *("" if v is None else f"{v:.6f}" for v in sigmas),
                ]
            )
    return ExportReport(crs=_crs_name(site, wish), height_kind=_kind(wish), features=len(features))


# -- Pix4D -------------------------------------------------------------------------------------


def _pix4d_rows(
    site: SiteLayers, features: Sequence[Feature], wish: _Wish, *, north_first: bool
) -> list[str]:
    unit = _unit(site, wish)
    rows = []
    for f in features:
        x, y = f.geo[0, :2] if wish.geographic else f.xy_map[0]
        decimals = 10 if wish.geographic else 4
        first, second = (y, x) if north_first else (x, y)
        cells = [
            str(f.values["file"]),
            *(f"{v:.{decimals}f}" for v in (first, second)),
            f"{_height(f, wish) / unit:.4f}",
            *_angles(f, wish),
            *(f"{v / unit:.4f}" for v in _accuracy(f)),
        ]
        rows.append(",".join(cells))
    return rows


def write_pix4dmapper(site: SiteLayers, target: Path, wish: _Wish) -> ExportReport:
    """Geolocation of PIX4Dmapper: latitude before longitude, but x (east) before y (north)."""
    features, warnings = _plain_names(_posed(site), ',;"\t\n')
    rows = _pix4d_rows(site, features, wish, north_first=wish.geographic)
    target.write_text("\n".join(rows) + "\n", encoding="utf-8", newline="\n")
    return ExportReport(
        crs=_crs_name(site, wish),
        height_kind=_kind(wish),
        features=len(features),
        warnings=warnings,
    )


def write_pix4dmatic(site: SiteLayers, target: Path, wish: _Wish) -> ExportReport:
    """Geolocation of PIX4Dmatic: coordinates in the order of the axes of their CRS.

    Notes
    -----
    Pix4D support 360056389172: seven or nine columns, no header but comments with #.
    """
    features, warnings = _plain_names(_posed(site), ',;"\t\n')
    north_first = wish.geographic or _is_north_first(site.crs)
    rows = _pix4d_rows(site, features, wish, north_first=north_first)
    unit = "metre" if wish.geographic else str(site.crs.axis_info[0].unit_name)
    # What PROJ calls a foot is the international one.
    unit = "international foot" if unit == "foot" else unit
    axes = "latitude, longitude" if wish.geographic else _axes(north_first)
    comments = [
        f"# crs: {_crs_name(site, wish)}",
        f"# heights: {_kind(wish)}",
        f"# height_unit: {unit}",
        f"# accuracy_unit: {unit}",
        f"#imagename,{axes.replace(', ', ',')},z,yaw,pitch,roll,accuracy_h,accuracy_v",
    ]
    target.write_text("\n".join([*comments, *rows]) + "\n", encoding="utf-8", newline="\n")
    return ExportReport(
        crs=_crs_name(site, wish),
        height_kind=_kind(wish),
        features=len(features),
        warnings=warnings,
    )


def _axes(north_first: bool) -> str:
    return "northing, easting" if north_first else "easting, northing"


def _is_north_first(crs: CRS) -> bool:
    """Whether the first axis of a projected CRS points north.

    Raises
    ------
    ExportError
        If its axes are not east and north.
    """
    axes = [axis.direction.lower() for axis in crs.axis_info[:2]]
    if sorted(axes) != ["east", "north"]:
        raise ExportError(
            f"the axes of '{crs.name}' run {' and '.join(axes)}, which cannot be told to "
            "PIX4Dmatic; use crs=geographic"
        )
    return axes[0] == "north"
