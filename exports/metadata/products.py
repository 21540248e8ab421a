"""Products of a project as its run records tell of them: what metadata are written for."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from georef_gis.project import Project

Row = Mapping[str, Any]
# Ending -> name of the format and code of ISO 19115's spatial representation.
FORMATS: Mapping[str, tuple[str, str]] = {
    ".tif": ("GeoTIFF", "grid"),
    ".tiff": ("GeoTIFF", "grid"),
    ".mbtiles": ("MBTiles", "grid"),
    ".pmtiles": ("PMTiles", "grid"),
    ".gpkg": ("GeoPackage", "vector"),
    ".geojson": ("GeoJSON", "vector"),
    ".kml": ("KML", "vector"),
    ".kmz": ("KMZ", "vector"),
    ".shp": ("Shapefile", "vector"),
    ".gdb": ("File Geodatabase", "vector"),
    ".dxf": ("DXF", "vector"),
    ".parquet": ("GeoParquet", "vector"),
    ".fgb": ("FlatGeobuf", "vector"),
    ".las": ("LAS", "vector"),
    ".laz": ("LAZ", "vector"),
    ".csv": ("CSV", "textTable"),
}
# Folders without an ending, by the tool that writes them.
FOLDERS: Mapping[str, tuple[str, str]] = {
    "orthos": ("folder of GeoTIFF", "grid"),
    "mosaic_sheets": ("folder of GeoTIFF", "grid"),
    "export_xyz_tiles": ("XYZ tiles", "grid"),
    "export_tagged_photos": ("folder of JPEG", "grid"),
    "export_csv": ("folder of CSV", "textTable"),
    "export_shapefile": ("folder of Shapefiles", "vector"),
    "export_dxf": ("folder of a DXF and CSV", "vector"),
    "export_geoparquet": ("folder of GeoParquet", "vector"),
    "export_flatgeobuf": ("folder of FlatGeobuf", "vector"),
}
# Tools after which what was written before is of other poses.
POSE_TOOLS = ("read_photos", "orient_direct", "orient_navigation", "adjust")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Product:
    """A file or folder that a run wrote.

    Parameters
    ----------
    tool
        Id of the tool without its provider.
    run
        Record of the run.
    format, representation
        For people, and as ISO 19115's MD_SpatialRepresentationTypeCode.
    changed
        Whether it is no longer as the run left it.
    older_than
        Name of what was made anew since: ``poses``, ``mosaic`` or empty.
    """

    path: Path
    tool: str
    run: Row
    format: str
    representation: str
    changed: bool
    older_than: str

    @property
    def summary(self) -> Row:
        """Summary of the run."""
        summary = self.run["summary"]
        return summary if isinstance(summary, Mapping) else {}

    @property
    def made(self) -> datetime:
        """When its run ended, UTC."""
        seconds = self.run["duration_s"]
        return start_of(self.run) + timedelta(seconds=float(seconds or 0.0))


def start_of(run: Row) -> datetime:
    """When a run began, UTC."""
    return datetime.fromisoformat(str(run["started"])).astimezone(UTC)


def tool_id(run: Row) -> str:
    """Id of a run's tool without its provider."""
    return str(run["tool"]).rpartition(":")[2]


def read_products(project: Project) -> tuple[Product, ...]:
    """Products below products/ that are there, by path; the last run that wrote one counts."""
    runs = [run for run in project.database.rows("run") if run["outcome"] == "done"]
    last = {tool_id(run): int(run["fid"]) for run in runs}
    found: dict[Path, tuple[Row, str]] = {}
    for run in runs:
        outputs = run["outputs"] or {}
        folders = [name for name, print_ in outputs.items() if not print_]
        for name, print_ in outputs.items():
            if not any(name.startswith(f"{folder}/") for folder in folders):
                found[project.path(name)] = (run, print_)
    return tuple(
        product
        for path, (run, print_) in sorted(found.items())
        if path.is_relative_to(project.products)
        and path.exists()
        and (product := _product(path, run, print_, last)) is not None
    )


def _product(path: Path, run: Row, print_: str, last: Mapping[str, int]) -> Product | None:
    tool = tool_id(run)
    kind = FORMATS.get(path.suffix.lower())
    if kind is None and path.is_dir():
        kind = FOLDERS.get(tool)
    if kind is None:
        return None
    return Product(
        path=path, tool=tool, run=run, format=kind[0], representation=kind[1],
        changed=bool(print_) and not _unchanged(path, print_), older_than=_older(tool, run, last),
    )  # fmt: skip


def _older(tool: str, run: Row, last: Mapping[str, int]) -> str:
    """What a product is older than; empty if all that it shows is still so."""
    mine = int(run["fid"])
    if mine < max((last.get(name, -1) for name in POSE_TOOLS), default=-1):
        return "poses"
    # orthos and overlap of the same poses are made before the mosaic
    if tool.startswith("export_") and mine < last.get("mosaic", -1):
        return "mosaic"
    return ""


def _unchanged(path: Path, recorded: str) -> bool:
    """Whether a file has the size and the edges that were recorded; its time may differ."""
    from georef_gis.errors import InputError
    from georef_gis.project.fingerprint import fingerprint

    try:
        before, now = recorded.split("-"), fingerprint(path).split("-")
    except InputError:
        return False
    return [*before[:1], *before[2:3]] == [*now[:1], *now[2:3]]


def steps_before(runs: Sequence[Row], product: Product) -> tuple[Row, ...]:
    """Last run of every tool that made a part of the project, up to the product's own."""
    mine, own = int(product.run["fid"]), product.tool
    kept: dict[str, Row] = {}
    for run in runs:
        if run["outcome"] != "done" or int(run["fid"]) > mine:
            continue
        name = tool_id(run)
        if name == own or not name.startswith(("export_", "report")):
            kept.pop(name, None)
            kept[name] = run
    return tuple(kept.values())


def number_of(summary: Row, key: str) -> float | None:
    """A finite number of a summary; None if there is none."""
    value = summary.get(key)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return None
    return float(value)
