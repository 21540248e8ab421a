# SPDX-License-Identifier: GPL-2.0-or-later
"""Which layers lie in a file that georef wrote, and in which order they are shown."""

from __future__ import annotations

import csv
import sqlite3
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePath
from typing import Any
from urllib.parse import quote

RASTERS = (".tif", ".tiff", ".vrt", ".mbtiles")
VECTORS = (".geojson", ".fgb", ".shp", ".kml", ".dxf")
# Of these only QGIS can tell which layers they hold.
PACKS = (".kml", ".dxf", ".gdb")
MAPS = (".tif", ".gpkg", ".html")
# Layers from below to above; those not named lie over the rasters.
ORDER = (
    "mosaic", "overlap", "surface", "index", "seams", "footprints", "track", "tie_points", "photos",
    "control", "ellipses", "polygons", "lines", "points",
)  # fmt: skip
# Layers that hide the others, to be switched on; tables of a GeoPackage that are none to look at.
HIDDEN = ("tie_points",)
NOT_SHOWN = ("seams_computed", "asset_known", "asset_history")


@dataclass(frozen=True)
class LayerFile:
    """A layer in a file.

    Parameters
    ----------
    source
        As QGIS takes it.
    style
        Name of its QML file, or empty.
    crs
        Authority and code or WKT, where the file does not tell it.
    """

    source: str
    title: str
    style: str
    rank: int
    raster: bool = False
    crs: str = ""


def layers_in(path: Path, project: Path | None = None) -> list[LayerFile]:
    """Layers of a file, from below to above; empty for what is no map.

    Parameters
    ----------
    project
        Folder of the project, whose CRS a table's eastings and northings are in.
    """
    suffix = path.suffix.lower()
    if path.is_dir() and suffix != ".gdb":
        parts = (part for part in sorted(path.iterdir()) if part.suffix.lower() in VECTORS)
        return [found for part in parts for found in layers_in(part)]
    if not path.exists():
        return []
    if suffix in RASTERS:
        return [_layer(str(path), path.stem, raster=True)]
    if suffix == ".gpkg":
        return sorted(_tables(path), key=lambda layer: layer.rank)
    if suffix == ".csv":
        return _places(path, project)
    if suffix in VECTORS or suffix in PACKS:
        return [replace(_layer(str(path), path.stem), crs=_crs_beside(path))]
    return []


def database_address(path: PurePath) -> str:
    """Address of a database to be read by sqlite, on drives and network shares of Windows too."""
    name = path.as_posix()
    # of what follows two slashes SQLite takes the first part for a host
    return f"file://{'' if name.startswith('/') else '/'}{quote(name, safe='/:')}?mode=ro"


def _layer(source: str, name: str, *, title: str = "", raster: bool = False) -> LayerFile:
    found = next((key for key in ORDER if key in name.lower()), "")
    rank = ORDER.index(found) if found else (0 if raster else ORDER.index("footprints"))
    return LayerFile(
        source=source, title=title or name, style=style_of(name, raster), rank=rank, raster=raster
    )


def style_of(name: str, raster: bool = False) -> str:
    """Name of the style of a layer by its own name; empty if there is none."""
    styles = ("overlap", "surface") if raster else (
        "asset_points", "asset_lines", "asset_polygons", "ellipses", "footprints", "photos",
        "seams", "places",
    )  # fmt: skip
    return next((style for style in styles if style in name.lower()), "")


def _tables(path: Path) -> list[LayerFile]:
    """Layers of a GeoPackage that have features; read-only, so that QGIS' locks do not matter."""
    address = database_address(path.absolute())
    query = "SELECT table_name, identifier FROM gpkg_contents WHERE data_type = 'features'"
    try:
        connection = sqlite3.connect(address, uri=True, timeout=5.0)
    except sqlite3.Error:
        return []
    try:
        found = []
        for name, title in connection.execute(query).fetchall():
            table = '"' + name.replace('"', '""') + '"'
            row = connection.execute(f"SELECT 1 FROM {table} LIMIT 1").fetchone()
            if row and name not in NOT_SHOWN:
                found.append(_layer(f"{path}|layername={name}", name, title=title))
        return found
    except sqlite3.Error:
        return []
    finally:
        connection.close()


def _places(path: Path, project: Path | None) -> list[LayerFile]:
    """Table of measured places as points, with their ellipses by the style."""
    try:
        with path.open(encoding="utf-8-sig", newline="") as stream:
            head = next(csv.reader(stream), [])
    except (OSError, ValueError):
        return []
    crs = project_crs(project) if project else ""
    if {"easting", "northing"} <= set(head) and crs:
        place = "xField=easting&yField=northing"
    elif {"lon_deg", "lat_deg"} <= set(head):
        place, crs = "xField=lon_deg&yField=lat_deg", "EPSG:4326"
    else:
        return []
    address = f"{path.absolute().as_uri()}?type=csv&detectTypes=yes&{place}"
    return [
        LayerFile(
            source=f"delimitedtext://{address}",
            title=path.stem,
            style="places" if "semi_major_m" in head else "",
            rank=ORDER.index("points"),
            crs=crs,
        )
    ]


def _crs_beside(path: Path) -> str:
    """CRS of a drawing: QGIS does not read it from the file beside it. Empty if there is none."""
    if path.suffix.lower() != ".dxf":
        return ""
    try:
        return f"WKT:{path.with_suffix('.prj').read_text('utf-8').strip()}"
    except (OSError, ValueError):
        return ""


def project_crs(project: Path) -> str:
    """CRS of a project as QGIS takes it: authority and code, or WKT; empty if it has none yet."""
    database = project / "georef.gpkg"
    query = (
        "SELECT organization, organization_coordsys_id, definition FROM gpkg_spatial_ref_sys "
        "WHERE srs_id = (SELECT srs_id FROM gpkg_geometry_columns WHERE table_name = 'footprint')"
    )
    if not database.is_file():
        return ""
    try:
        address = database_address(database.absolute())
        connection = sqlite3.connect(address, uri=True, timeout=5.0)
        try:
            row = connection.execute(query).fetchone()
        finally:
            connection.close()
    except sqlite3.Error:
        return ""
    if row is None:
        return ""
    organization, code, definition = row
    known = str(organization).upper() in ("EPSG", "ESRI")
    return f"{organization.upper()}:{code}" if known else f"WKT:{definition}"


def measured_places(results: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Places that a tool measured and told without writing a file."""
    told = [result.get("summary", {}).get("points") for result in results]
    return [
        dict(point)
        for points in told
        # elsewhere it is their number
        for point in (points if isinstance(points, list) else ())
        if isinstance(point, dict) and {"easting", "northing"} <= set(point)
    ]


def write_places(path: Path, places: Sequence[Mapping[str, Any]]) -> None:
    """Write measured places as a table."""
    with path.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.DictWriter(stream, fieldnames=list(places[0]), extrasaction="ignore")
        writer.writeheader()
        writer.writerows(places)


def all_products(results: Iterable[Mapping[str, Any]]) -> list[Path]:
    """Files that runs wrote, or had written before if they were up to date, each once."""
    names: dict[str, None] = {}
    for result in results:
        outputs = [str(path) for path in result.get("outputs", {}).values()]
        products = [str(path) for path in result.get("summary", {}).get("products", ()) or ()]
        names.update(dict.fromkeys([*outputs, *products]))
    return [Path(name) for name in names]


def without_copies(files: Sequence[Path]) -> list[Path]:
    """Files without the tables that say again what a GeoPackage beside them holds."""
    packed = any(path.suffix.lower() == ".gpkg" for path in files)
    return [path for path in files if not (packed and path.suffix.lower() == ".csv")]


def project_products(folder: Path) -> list[Path]:
    """Files of a project that show it on a map."""
    products = folder / "products"
    names = [products / "mosaic.tif", products / "site.gpkg"]
    if not names[-1].is_file():
        names.append(folder / "assets.gpkg")
    return [path for path in names if path.is_file()]


def outputs_by_name(
    names: Iterable[str], results: Sequence[Mapping[str, Any]], project: Path | None = None
) -> dict[str, str]:
    """Paths of declared outputs.

    A run that was up to date tells none: they are found by the names of its products, and maps
    by their own names in the folder of the project's products.
    """
    told: dict[str, str] = {}
    for result in results:
        told.update({name: str(path) for name, path in result.get("outputs", {}).items()})
    # Of site.kmz and site.gpkg the map is meant.
    files = sorted(all_products(results), key=lambda path: path.suffix.lower() in MAPS)
    by_stem = {path.stem: str(path) for path in files}
    if project is not None and any(result.get("skipped") for result in results):
        maps = (project / "products").glob("*.tif")
        by_stem = {**{path.stem: str(path) for path in maps}, **by_stem}
    found = {name: told.get(name) or by_stem.get(name) for name in names}
    return {name: path for name, path in found.items() if path}
