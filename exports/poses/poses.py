"""Exporters of poses to other programs: ODM's geo.txt, reference CSV (Metashape and others)."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

from georef_gis.errors import ExportError
from georef_gis.toolbox import Exporter, ExportReport, Feedback, LayerSource
from georef_gis.toolbox import parameters as p

if TYPE_CHECKING:
    from exports.site.columns import Feature
    from exports.site.site import SiteLayers

CSV_HEADER = (
    "label", "x", "y", "z", "yaw", "pitch", "roll", "omega", "phi", "kappa",
    "accuracy_xy", "accuracy_z", "sigma_yaw", "sigma_pitch", "sigma_roll", "height_orthometric",
    "longitude", "latitude", "time_utc",
)  # fmt: skip


class PosesOptions(p.Parameters):
    """Options of pose files."""


class OdmGeo(Exporter[PosesOptions]):
    """Poses as OpenDroneMap's geo.txt, longitude and latitude (EPSG:4326).

    Angles are yaw, pitch, roll, zero at nadir, as the program takes them whatever its manual
    calls them. Heights are above the ellipsoid.
    """

    id = "odm_geo"
    name = "ODM geo.txt"
    suffix = ".txt"
    accepts = ("vector",)
    target = "geo.txt"
    needs = ("photos", "poses")

    def write(
        self, source: LayerSource, target: Path, options: PosesOptions, feedback: Feedback
    ) -> ExportReport:
        """Write the poses to `target`."""
        return _write(source, target, feedback, write_geo_txt)


class ReferenceCsv(Exporter[PosesOptions]):
    """Poses as CSV with yaw, pitch, roll and omega, phi, kappa, in the project CRS.

    For Metashape (Import Reference, comma) and other programs. Yaw, pitch, roll are zero at nadir;
    omega, phi, kappa turn the photo's axes into those of the map. Heights `z` are above the
    ellipsoid, m; the CRS stands in the first line.
    """

    id = "poses_csv"
    name = "poses CSV"
    suffix = ".csv"
    accepts = ("vector",)
    target = "poses.csv"
    needs = ("photos", "poses")

    def write(
        self, source: LayerSource, target: Path, options: PosesOptions, feedback: Feedback
    ) -> ExportReport:
        """Write the poses to `target`."""
        return _write(source, target, feedback, write_reference_csv)


def _write(
    source: LayerSource,
    target: Path,
    feedback: Feedback,
    writer: Callable[[SiteLayers, Path], ExportReport],
) -> ExportReport:
    report = writer(site_with_poses(source), target)
    for warning in report.warnings:
        feedback.warn(warning)
    return report


def site_with_poses(source: LayerSource) -> SiteLayers:
    """Site with the best poses, which are to be written.

    Raises
    ------
    ExportError
        If another layer was chosen.
    """
    from exports.site.site import SiteLayers

    if source.layer not in ("photos", "poses"):
        raise ExportError(f"layer {source.layer} has no poses; use poses")
    return SiteLayers.from_project(source.project, best=True)


def _posed(site: SiteLayers) -> list[Feature]:
    features = [f for f in site.layers["photos"].features if f.values["pose_kind"] is not None]
    if not features:
        raise ExportError("no photo has a pose yet; run `georef run` first")
    return features


def _accuracy(feature: Feature) -> tuple[float, float]:
    """Horizontal (per axis, root mean square) and vertical sigma, m."""
    e, n, u = (float(feature.values[f"sigma_{axis}_m"] or 0.0) for axis in "enu")
    return math.sqrt((e * e + n * n) / 2.0), u


def write_geo_txt(site: SiteLayers, target: Path) -> ExportReport:
    """ODM's geo.txt: name lon lat h yaw pitch roll, then accuracies, blank separated.

    Notes
    -----
    OpenDroneMap `opendm/geo.py` reads angles 5 to 7 as "omega, phi, kappa" and hands them on as
    yaw, pitch, roll of `opendm/photo.py`, which are zero at nadir.
    """
    lines, unfit = ["EPSG:4326"], []
    for f in _posed(site):
        v, (lon, lat, h) = f.values, f.geo[0]
        name = str(v["file"])
        if any(letter.isspace() for letter in name) or name.startswith("#"):
            unfit.append(name)
            continue
        angles = " ".join(f"{v[a]:.6f}" for a in ("yaw_deg", "pitch_deg", "roll_deg"))
        sigma_h, sigma_v = _accuracy(f)
        lines.append(f"{name} {lon:.10f} {lat:.10f} {h:.4f} {angles} {sigma_h:.4f} {sigma_v:.4f}")
    if len(lines) == 1:
        raise ExportError(f"geo.txt cannot hold names with blanks such as {unfit[0]!r}; use CSV")
    target.write_text("\n".join(lines) + "\n", encoding="utf-8")
    warnings = (
        (f"{len(unfit)} photos left out: geo.txt cannot hold names with blanks ({unfit[0]!r})",)
        if unfit
        else ()
    )
    return ExportReport(
        crs="EPSG:4326", height_kind="ellipsoidal", features=len(lines) - 1, warnings=warnings
    )


def write_reference_csv(site: SiteLayers, target: Path) -> ExportReport:
    """Reference CSV: `#` lines with the CRS and the meaning, a header, one row per photo."""
    features = _posed(site)
    with target.open("w", encoding="utf-8", newline="") as stream:
        _csv_rows(site, features, stream)
    return ExportReport(crs=site.crs_name, height_kind="ellipsoidal", features=len(features))


def _csv_rows(site: SiteLayers, features: list[Feature], stream: TextIO) -> None:
    unit = site.metadata()["crs_unit"]
    stream.write(
        f"# CRS {site.crs_name} ({site.crs.name}); x east, y north in {unit}; z ellipsoidal "
        "height in m; yaw pitch roll (0 at nadir) and omega phi kappa in deg; sigmas in m and deg\n"
    )
    writer = csv.writer(stream)
    writer.writerow(CSV_HEADER)
    for f in features:
        v, (x, y), h = f.values, f.xy_map[0], f.geo[0, 2]
        angles = ("yaw", "pitch", "roll", "omega", "phi", "kappa")
        sigmas = (v[f"sigma_{angle}_deg"] for angle in angles[:3])
        writer.writerow(
            [
                v["file"],
                *(f"{value:.4f}" for value in (x, y, h)),
                *(f"{v[f'{angle}_deg']:.6f}" for angle in angles),
                *(f"{value:.4f}" for value in _accuracy(f)),
                *("" if value is None else f"{value:.5f}" for value in sigmas),
                f"{v['height_orthometric_m']:.4f}",
                *(f"{v[name]:.10f}" for name in ("lon_deg", "lat_deg")),
                v["time_utc"] or "",
            ]
        )
