"""What each exporter takes for a project with 100 000 assets, against GDAL writing one such table.

    python benchmarks/exporters.py SCRATCH [--assets 100000] [--only geojson,csv] [--service DSN]

SCRATCH gets a copy of the sample project with simulated assets: half of them points with their
error ellipses (65 vertices each), a quarter lines of 5, a quarter areas of 7 vertices, written as
the store writes them. Each exporter runs in a process of its own, start-up included; memory is that
process's peak. The floor is the same rows and geometries, as they lie in `assets.gpkg`, read and
written by pyogrio alone. PostGIS is measured where `--service` tells how to connect.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import sqlite3
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

SAMPLE = Path(__file__).parents[1] / "sample_project"
FORMATS = ("geopackage", "geojson", "kml", "kmz", "light_kmz", "shapefile", "filegdb", "dxf",
           "geoparquet", "flatgeobuf", "csv", "postgis")  # fmt: skip
# of 65 vertices, as the store draws them
RING = 64
# m around the middle of the site
SPREAD = 400.0
LIMIT_S, LIMIT_MB = 10.0, 500.0


# -- the project -------------------------------------------------------------------------------


def make_project(folder: Path, count: int) -> Path:
    """Copy of the sample project with photos, poses, footprints and simulated assets."""
    project = folder / f"assets_{count}"
    if (project / "assets.gpkg").exists():
        return project
    shutil.copytree(SAMPLE, project, ignore=shutil.ignore_patterns("products", "cache"))
    words = ["run", str(project), "--only", "read_photos,orient_direct,footprints"]
    subprocess.run([sys.executable, "-m", "georef_gis.app", *words], check=True)
    write_assets(project, count)
    return project


def write_assets(folder: Path, count: int) -> None:
    """Lay `assets.gpkg` out as the store does and fill it by plain SQL."""
    from georef_gis.measure.assets.layout import lay_out
    from georef_gis.project import Project
    from georef_gis.project.database import Srs
    from georef_gis.project.records import load_frame

    with Project.open(folder).reader() as project:
        frame = load_frame(project.database)
    crs = frame.horizontal
    middle = frame.map_from_enu(np.zeros(3))
    path = folder / "assets.part"
    connection = sqlite3.connect(path, isolation_level=None)
    lay_out(connection, Srs(name=crs.name, wkt=crs.to_wkt("WKT1_GDAL"), code=crs.to_epsg()))
    connection.execute("BEGIN")
    rng = np.random.default_rng(3)
    number = count // 4
    for layer, n, vertices in (("asset_points", count - 2 * number, 1), ("asset_lines", number, 5),
                               ("asset_polygons", number, 6)):  # fmt: skip
        fill(connection, layer, shapes_of(rng, middle, n, vertices), rng)
    connection.execute("COMMIT")
    connection.close()
    os.replace(path, folder / "assets.gpkg")


def shapes_of(rng: np.random.Generator, middle: Any, count: int, vertices: int) -> Any:
    """Points, lines or areas about places at random, with heights."""
    import shapely

    centre = middle + rng.uniform(-SPREAD, SPREAD, (count, 3)) * [1.0, 1.0, 0.02]
    if vertices == 1:
        return shapely.points(centre)
    angle = np.linspace(0.0, 2.0 * np.pi, vertices, endpoint=False)
    ring = 3.0 * np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle])
    points = centre[:, None, :] + ring
    return shapely.linestrings(points) if vertices == 5 else shapely.polygons(points)


def fill(connection: sqlite3.Connection, layer: str, shapes: Any, rng: Any) -> None:
    """Rows of a layer, what the store knows of them, and ellipses of points."""
    import shapely

    from georef_gis.measure.assets.tables import COLUMNS, content_of
    from georef_gis.measure.ellipses import Ellipse
    from georef_gis.project.geometry import to_blob

    srs_id = connection.execute("SELECT srs_id FROM gpkg_geometry_columns").fetchone()[0]
    names, points = list(COLUMNS), layer == "asset_points"
    slots = ", ".join("?" * (len(names) + 1))
    insert = f"INSERT INTO {layer} ({', '.join(names)}, geom) VALUES ({slots})"
    kind = {"asset_points": "cone", "asset_lines": "lane_edge"}.get(layer, "work_area")
    for i, (shape, sigma) in enumerate(
        zip(shapes, rng.uniform(0.02, 0.2, (len(shapes), 3)).tolist(), strict=True)
    ):
        row = row_of(f"{layer}-{i:06d}", kind, sigma, i)
        wkb = shapely.to_wkb(shape, flavor="iso")
        connection.execute(insert, [*(row[n] for n in names), to_blob(wkb, srs_id)[0]])
        connection.execute(
            "INSERT INTO asset_known (asset_id, revision, layer, fid_in_layer, content) "
            "VALUES (?, 1, ?, ?, ?)",
            (row["asset_id"], layer, i + 1, content_of(row | {"geom": wkb})),
        )
        if points:
            ellipse = Ellipse(semi_major=sigma[0], semi_minor=sigma[1], azimuth=0.3)
            ring = shapely.Polygon(ellipse.polygon([shape.x, shape.y], n=RING))
            values = [row[n] for n in ("asset_id", "class", "name", "semi_major", "semi_minor",
                                       "azimuth", "conf")]  # fmt: skip
            connection.execute(
                "INSERT INTO asset_ellipses (asset_id, class, name, semi_major, semi_minor, "
                "azimuth, conf, geom) VALUES (?, ?, ?, ?, ?, ?, ?, ?)",
                [*values, to_blob(shapely.to_wkb(ring), srs_id)[0]],
            )


def row_of(asset_id: str, kind: str, sigma: list[float], i: int) -> dict[str, Any]:
    """Row of an asset as the store has them."""
    e, n, u = sigma
    photos = [f"DJI_{i % 900:04d}.JPG", f"DJI_{(i + 1) % 900:04d}.JPG"]
    return {
        "asset_id": asset_id, "class": kind, "name": f"{kind} {i}", "attributes": "{}", "note": "",
        "sigma_e": e, "sigma_n": n, "sigma_u": u, "corr_en": 0.1, "semi_major": e, "semi_minor": n,
        "azimuth": 17.2, "conf": 0.95, "dof": 3, "n_rays": 2, "method": "intersect",
        "photo_ids": json.dumps(photos),
        "pixels": json.dumps([[p, 1234.25 + i % 100, 987.5, 0, 0.5] for p in photos]),
        "created": "2026-05-01T12:00:00Z", "changed": "2026-05-01T12:00:00Z",
    }  # fmt: skip


# -- children ----------------------------------------------------------------------------------


def export(name: str, project: str, target: str, service: str) -> int:
    """Write the assets by one exporter, as `georef export-<name>` does; gives the features."""
    from exports import EXPORTERS
    from georef_gis.project import Project
    from georef_gis.toolbox import CollectingFeedback, Context
    from georef_gis.toolbox.exporter import tool_of

    tool = tool_of(next(one for one in EXPORTERS if one.id == name))
    # packages of Google Earth hold the site as a whole, of which assets are nearly all
    layer = "site" if "kmz" in name else "assets"
    values: dict[str, Any] = {"layer": layer, "target": Path(target)}
    if name == "postgis":
        values = {"layer": "assets", "connection": service, "overwrite": True}
    context = Context(project=Project.open(Path(project)))
    result = tool().run(context, tool.Parameters(**values), CollectingFeedback())
    return int(result.summary["features"])


def floor(project: str, target: str) -> int:
    """The same rows and geometries by pyogrio alone."""
    import pyogrio

    path, count = Path(project) / "assets.gpkg", 0
    for layer in ("asset_points", "asset_lines", "asset_polygons", "asset_ellipses"):
        meta, _, geometry, fields = pyogrio.raw.read(path, layer=layer)
        pyogrio.raw.write(
            target, geometry=geometry, field_data=fields, fields=list(meta["fields"]),
            geometry_type=meta["geometry_type"], crs=meta["crs"], layer=layer, driver="GPKG",
            append=Path(target).exists(),
        )  # fmt: skip
        count += len(geometry)
    return count


def child(words: list[str]) -> None:
    """Run one of the above and tell what it took."""
    start = time.perf_counter()
    name, *rest = words
    features = floor(*rest[:2]) if name == "floor" else export(name, *rest)
    use = resource.getrusage(resource.RUSAGE_SELF)
    told = {"features": features, "wall": time.perf_counter() - start,
            "cpu": use.ru_utime + use.ru_stime, "mb": use.ru_maxrss / 1024}  # fmt: skip
    print(json.dumps(told))


# -- the table ---------------------------------------------------------------------------------


def main() -> None:
    """Make the project and time each exporter."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scratch", type=Path)
    parser.add_argument("--assets", type=int, default=100_000)
    parser.add_argument("--only", default="")
    parser.add_argument("--service", default="")
    given = parser.parse_args()
    given.scratch.mkdir(parents=True, exist_ok=True)
    project = make_project(given.scratch, given.assets)
    names = given.only.split(",") if given.only else FORMATS
    print("| what | features | wall s | CPU s | peak MB | MB written | within |")
    print("|---|---|---|---|---|---|---|")
    for name in ("floor", *names):
        if name != "postgis" or given.service:
            measure(name, project, given.scratch / f"out_{name}", given.service)


def measure(name: str, project: Path, folder: Path, service: str) -> None:
    """Run one child and print its line."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    suffixes = {"geopackage": ".gpkg", "geojson": ".geojson", "kml": ".kml", "dxf": ".dxf",
                "filegdb": ".gdb", "kmz": ".kmz", "light_kmz": ".kmz",
                "floor": ".gpkg"}  # fmt: skip
    target = folder / f"assets{suffixes.get(name, '')}"
    words = [sys.executable, __file__, "--child", name, str(project), str(target), service]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    if done.returncode:
        last = (done.stderr.strip().splitlines() or ["?"])[-1]
        print(f"| {name} | failed: {last} |")
        return
    told = json.loads(done.stdout.splitlines()[-1])
    size = sum(file.stat().st_size for file in folder.rglob("*") if file.is_file()) / 1e6
    within = "yes" if told["wall"] <= LIMIT_S and told["mb"] <= LIMIT_MB else "NO"
    print(f"| {name} | {told['features']} | {told['wall']:.1f} | {told['cpu']:.1f} | "
          f"{told['mb']:.0f} | {size:.0f} | {within} |", flush=True)  # fmt: skip
    shutil.rmtree(folder)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--child"]:
        child(sys.argv[2:])
    else:
        main()
