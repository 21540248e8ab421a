"""What `georef change` tells of simulated flights over one site, without and with their photos.

python benchmarks/change_flights.py FOLDER     four flights of one state, two of another
python benchmarks/change_flights.py ODD EVEN   two projects that are there, in which nothing changed

Each flight is simulated, matched and adjusted: 100 s of CPU; those in the folder are taken again.
Of the other state a truck, a pickup, two cones, two drums and a sign are gone, one car stands
elsewhere, and a truck, a car, a patch and a heap are new.
"""

from __future__ import annotations

import itertools
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from pyproj import CRS, Transformer

from georef_gis.measure.change.detect import Change, Comparison, compare
from georef_gis.measure.change.evidence import weigh
from georef_gis.measure.change.pair import common_cells, gsd_of, open_pair
from georef_gis.project import Project
from georef_gis.rasters.gdal_cache import gdal_cache
from georef_gis.simulate import FlightSettings, ecef_from_enu, simulate_flight, site, write_flight
from georef_gis.simulate.site import SiteObject
from processing_algorithms.change.photos import SitePhotos

SAMPLE = Path(__file__).parents[1] / "sample_project"
GONE = ("V2", "V3", "C05", "C07", "S2", "D04", "D09")
MOVED, MOVED_TO = "V5", 38.0
NEW = tuple(
    SiteObject(
        name=name, kind=kind, along=along, left=left, turn_deg=turn, length=x, width=y, height=z,
        colour=colour,
    )
    for name, kind, along, left, turn, x, y, z, colour in (
        ("N1", "truck", -40.0, 30.0, 30.0, 8.2, 2.5, 3.1, (70, 90, 150)),
        ("N2", "car", 45.0, -2.5, 3.0, 4.6, 1.8, 1.45, (200, 200, 205)),
        ("N3", "building", 20.0, -18.0, 0.0, 4.0, 3.0, 0.05, (45, 45, 48)),
        ("N4", "building", -25.0, -20.0, 20.0, 3.0, 3.0, 1.5, (150, 120, 85)),
    )
)  # fmt: skip
# flights of one state, and of the other
SAME, OTHER = {"n1": 21, "n2": 22, "n3": 23, "n4": 24}, {"c1": 31, "c2": 32}
# m; what stands up is seen beside its base
BESIDE = 0.6
BOUNDS = (0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 1.01)
OBJECTS: Callable[[], tuple[SiteObject, ...]] = site.objects


def other_state() -> tuple[SiteObject, ...]:
    """What stands on the site at the other date."""
    stay = [one for one in OBJECTS() if one.name not in GONE]
    return (*(replace(o, along=MOVED_TO) if o.name == MOVED else o for o in stay), *NEW)


def make(folder: Path, seed: int, *, changed: bool) -> None:
    """Simulate a flight and run the project, unless it is there."""
    if (folder / "products" / "mosaic.tif").is_file():
        return
    site.objects = other_state if changed else OBJECTS
    write_flight(simulate_flight(FlightSettings(), seed=seed), folder)
    text = (SAMPLE / "project.toml").read_text().replace("# orthos = true", "orthos = false")
    (folder / "project.toml").write_text(text)
    georef = shutil.which("georef", path=str(Path(sys.executable).parent)) or "georef"
    subprocess.run([georef, "run", "--workers", "1"], cwd=folder, check=True, capture_output=True)


def truth(crs_wkt: str) -> dict[str, Any]:
    """Bases of what came and went, on the map."""
    both = {one.name: one for one in OBJECTS()}
    gone = [both[name] for name in (*GONE, MOVED)]
    shapes = {}
    crs = CRS.from_wkt(crs_wkt)
    geographic = Transformer.from_crs("EPSG:4978", "EPSG:4979", always_xy=True)
    on_map = Transformer.from_crs(crs.geodetic_crs, crs, always_xy=True)
    unit = crs.axis_info[0].unit_conversion_factor
    for one in (*gone, replace(both[MOVED], name=f"{MOVED} there", along=MOVED_TO), *NEW):
        lon, lat, _ = geographic.transform(*ecef_from_enu(one.corners(0.0)).T)
        ring = np.column_stack(on_map.transform(lon, lat))
        shapes[one.name] = shapely.Polygon(ring).convex_hull.buffer(BESIDE / unit)
    return shapes


@dataclass
class Told:
    """Confidence and truth of areas, things found and sought, seconds of CPU, megabytes."""

    areas: list[tuple[float, bool]]
    found: int
    sought: int
    seconds: float


def told(found: Comparison, shapes: dict[str, Any], seconds: float) -> Told:
    """What a comparison says of areas of 0.1 m2 and more."""
    a, _, left, _, e, top = found.cells.header.transform
    square = found.cells.metres**2
    areas, names = [], set()
    for one in found.changes:
        if one.judged.outline.area * square < 0.1:
            continue
        hit = _hit(one, shapes, np.array([a, e]), np.array([left, top]))
        areas.append((one.confidence, bool(hit)))
        if one.confidence >= 0.5:
            names |= hit
    return Told(areas=areas, found=len(names), sought=len(shapes), seconds=seconds)


def _hit(change: Change, shapes: dict[str, Any], scale: Any, start: Any) -> set[str]:
    own = shapely.transform(change.judged.outline.shape, lambda xy: xy * scale + start)
    return {name for name, shape in shapes.items() if shape.intersects(own)}


def pair(later: Path, earlier: Path, *, changed: bool) -> tuple[Told, Told]:
    """Without and with the photos."""
    maps = later / "products" / "mosaic.tif", earlier / "products" / "mosaic.tif"
    start = time.process_time()
    cells = common_cells(*maps, 2.0 * max(gsd_of(one) for one in maps))
    shapes = truth(cells.header.crs_wkt) if changed else {}
    with gdal_cache(64), open_pair(*maps, cells, most=10.0) as both:
        plain = compare(both, most=10.0, least_area=0.1)
        first = time.process_time() - start
        opened = [Project.open(folder, read_only=True) for folder in (later, earlier)]
        seen = weigh(plain, (SitePhotos.of(opened[0]), SitePhotos.of(opened[1])))
    return told(plain, shapes, first), told(seen, shapes, time.process_time() - start)


def report(name: str, every: Sequence[Told]) -> None:
    """Print what several comparisons said."""
    rows = np.array([area for one in every for area in one.areas])
    false = [int(((rows[:, 0] >= least) & (rows[:, 1] == 0)).sum()) for least in (0.5, 0.6)]
    print(
        f"{name}: {len(every)} pairs, false areas of confidence >= 0.5: {false[0]}, >= 0.6: "
        f"{false[1]}; found {sum(o.found for o in every)} of {sum(o.sought for o in every)}; "
        f"{np.mean([o.seconds for o in every]):.1f} s of CPU each"
    )
    for low, high in itertools.pairwise(BOUNDS):
        some = rows[(rows[:, 0] >= low) & (rows[:, 0] < high)]
        if len(some):
            mean, real = some.mean(axis=0)
            print(f"  {low:.1f}-{high:.1f} {len(some):4d}  said {mean:.2f}  real {real:.2f}")


def main(folders: Sequence[str]) -> None:
    """Compare all pairs of a folder of flights, or two projects."""
    if len(folders) == 2:
        sets = {"nothing changed": [pair(Path(folders[0]), Path(folders[1]), changed=False)]}
    else:
        root = Path(folders[0])
        for name, seed in (SAME | OTHER).items():
            make(root / name, seed, changed=name in OTHER)
        same = itertools.combinations(SAME, 2)
        sets = {
            "nothing changed": [pair(root / a, root / b, changed=False) for a, b in same],
            "changed": [
                pair(root / a, root / b, changed=True) for a, b in itertools.product(OTHER, SAME)
            ],
        }
    for name, pairs in sets.items():
        report(f"{name}, mosaics alone", [one[0] for one in pairs])
        report(f"{name}, with photos", [one[1] for one in pairs])


if __name__ == "__main__":
    main(sys.argv[1:])
