"""The mosaic step against its floor and against two stitchers: CPU, memory, photos used, pictures.

    python benchmarks/mosaic_rivals.py PROJECTS... [--runs 3] [--stitch COMMAND] [--pictures FOLDER]

Each project is matched and adjusted already, its photos given by an absolute path; a copy is used.
Ours is `georef mosaic --force` with no cache and no seams, by one worker and by two, each in turn
with `floor_mosaic.py`; the stitchers take the photos as they are, which holds alignment too, so our
matches and adjustment are measured beside. OpenCV's Stitcher is that of this Python; `stitching`
(PyPI) pins an OpenCV of its own: give its `stitch` command of a venv of its own. A stitcher that
fails or takes more than ten minutes is tried again with photos of half the size, then a quarter.
"""

from __future__ import annotations

import argparse
import json
import re
import shutil
import sqlite3
import statistics
import sys
import tempfile
import tomllib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from process_cost import Cost, apart, cost_of

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

HERE = Path(__file__).parent
GEOREF = [sys.executable, "-m", "georef_gis.app"]
LIMIT = 600.0
# confidence and megapixels of the features: its own, and those of a user who misses photos
OPENCV = {"default": ("1", "0.6"), "tuned": ("0.5", "2")}
STITCHING: dict[str, tuple[str, ...]] = {
    "default": ("--affine",),
    "tuned": (
        "--affine", "--no-crop", "--detector", "sift", "--nfeatures", "3000",
        "--medium_megapix", "2", "--confidence_threshold", "0.5",
    ),
}  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class Attempt:
    """One run of a stitcher.

    Parameters
    ----------
    name
        Program and settings.
    size
        Share of the photos' width.
    used
        Photos in its picture.
    """

    name: str
    size: float
    cost: Cost
    used: int
    failure: str
    picture: Path


def photos_of(project: Path) -> list[Path]:
    """Photos of a project."""
    with (project / "project.toml").open("rb") as file:
        folder = Path(tomllib.load(file)["photos"]["folder"])
    if not folder.is_absolute():
        raise SystemExit(f"{project}: [photos] folder is relative; a copy would not find it")
    return sorted(p for p in folder.iterdir() if p.suffix.lower() in {".jpg", ".jpeg"})


def write_smaller(photos: Sequence[Path], size: float, folder: Path) -> None:
    """Photos as files of a share of their width."""
    import cv2

    for path in photos:
        image = cv2.imread(str(path))
        image = cv2.resize(image, None, fx=size, fy=size, interpolation=cv2.INTER_AREA)
        cv2.imwrite(str(folder / path.name), image, [cv2.IMWRITE_JPEG_QUALITY, 95])


def run_opencv(photos: Sequence[Path], target: Path, setting: str) -> tuple[Cost, int, str]:
    """OpenCV's Stitcher: cost, photos used, error."""
    command = [sys.executable, str(HERE / "stitch_opencv.py"), str(target), *OPENCV[setting]]
    cost = cost_of([*command, *map(str, photos)], limit=LIMIT)
    if cost.failure:
        return cost, 0, cost.failure
    told = json.loads(cost.output.strip().splitlines()[-1])
    return cost, told["used"], "" if told["used"] else told["status"]


def run_stitching(
    stitch: str, photos: Sequence[Path], target: Path, setting: str
) -> tuple[Cost, int, str]:
    """`stitching`: cost, photos used (the largest group of its graph of matches), error."""
    graph = target.with_suffix(".dot")
    options = [*STITCHING[setting], "--matches_graph_dot_file", str(graph)]
    # its list of photos would end up in an option of several values
    cost = cost_of([stitch, *map(str, photos), *options, "--output", str(target)], limit=LIMIT)
    used = largest_group(graph.read_text(encoding="utf-8")) if graph.exists() else 0
    return cost, used, cost.failure


def largest_group(graph: str) -> int:
    """Number of nodes of the largest connected part of a graph in the language of dot."""
    groups: list[set[str]] = []
    for a, b in re.findall(r'"([^"]+)"\s*--\s*"([^"]+)"', graph):
        touched = [g for g in groups if a in g or b in g]
        groups = [g for g in groups if not (a in g or b in g)]
        groups.append({a, b}.union(*touched))
    return max(map(len, groups), default=1)


def attempts(
    name: str,
    run: Callable[[Sequence[Path], Path], tuple[Cost, int, str]],
    photos: Sequence[Path],
    work: Path,
) -> list[Attempt]:
    """A stitcher at full size and, until it makes a picture, at half and a quarter."""
    done = []
    for size in (1.0, 0.5, 0.25):
        folder = work / f"{name} {size}"
        folder.mkdir()
        target = folder / "result.jpg"
        shown = [folder / path.name for path in photos] if size < 1 else list(photos)
        if size < 1:
            apart(write_smaller, list(photos), size, folder)
        cost, used, failure = run(shown, target)
        if not failure and not target.exists():
            failure = "no picture"
        done.append(
            Attempt(name=name, size=size, cost=cost, used=used, failure=failure, picture=target)
        )
        if not failure:
            break
    return done


def run_ours(project: Path, workers: int) -> Cost:
    """The mosaic step from nothing: no cache, no seams of an earlier run."""
    shutil.rmtree(project / "cache" / "mosaic", ignore_errors=True)
    (project / "seams.gpkg").unlink(missing_ok=True)
    return georef("mosaic", project, "--workers", str(workers))


def georef(tool: str, project: Path, *options: str) -> Cost:
    """A tool, forced."""
    cost = cost_of([*GEOREF, tool, "--force", "--project", str(project), *options])
    if cost.failure:
        raise SystemExit(f"georef {tool}: {cost.output[-2000:]}")
    return cost


def summary_of(project: Path) -> dict[str, object]:
    """Summary of the last mosaic."""
    with sqlite3.connect(project / "georef.gpkg") as db:
        rows = db.execute("SELECT summary FROM run WHERE tool LIKE '%mosaic' ORDER BY fid")
        return dict(json.loads(rows.fetchall()[-1][0]))


def ours_against_floor(project: Path, photos: Sequence[Path], runs: int) -> float:
    """Rows of floor, one worker and two, in turn; CPU s of the floor."""
    run_ours(project, 1)  # kernels, files in memory
    tiles = str(summary_of(project)["tiles"])
    floor = [sys.executable, str(HERE / "floor_mosaic.py"), str(photos[0].parent), tiles]
    costs: dict[str, list[Cost]] = {"floor": [], "ours, 1 worker": [], "ours, 2 workers": []}
    for _ in range(runs):
        costs["floor"].append(cost_of(floor))
        for workers, name in ((1, "ours, 1 worker"), (2, "ours, 2 workers")):
            costs[name].append(run_ours(project, workers))
    base = statistics.median(c.cpu for c in costs["floor"])
    for name, each in costs.items():
        print(cost_row(name, each, len(photos) if name != "floor" else None, base))
    return base


def cost_row(name: str, costs: Sequence[Cost], used: int | None, base: float) -> str:
    """Medians, range of the CPU, largest memory."""
    cpu = [c.cpu for c in costs]
    middle = statistics.median(cpu)
    return (
        f"| {name} | {middle:.1f} ({min(cpu):.1f}-{max(cpu):.1f}) | {middle / base:.2f} | "
        f"{statistics.median(c.wall for c in costs):.1f} ({min(c.wall for c in costs):.1f}) | "
        f"{max(c.peak for c in costs):.0f} | {used or ''} | load "
        f"{min(c.load for c in costs):.1f} to {max(c.load for c in costs):.1f} |"
    )


def attempt_row(attempt: Attempt, photos: int, base: float) -> str:
    """Line of a stitcher's attempt."""
    cost = attempt.cost
    return (
        f"| {attempt.name}, {attempt.size:.0%} size | {cost.cpu:.1f} | {cost.cpu / base:.2f} | "
        f"{cost.wall:.1f} | {cost.peak:.0f} | {attempt.used} of {photos} | "
        f"{attempt.failure or 'made a picture'} |"
    )


def ours_as_picture(mosaic: Path, height: int) -> NDArray[np.uint8]:
    """The mosaic, about twice as large as needed, black where it has nothing."""
    import cv2
    import numpy as np
    import rasterio

    with rasterio.open(mosaic) as data:
        factor = max(1, data.height // (2 * height))
        shape = (data.height // factor, data.width // factor)
        bands = data.read(indexes=[3, 2, 1], out_shape=(3, *shape))
        bands[:, data.read_masks(1, out_shape=shape) == 0] = 0
    return cv2.resize(np.ascontiguousarray(np.moveaxis(bands, 0, 2)), shape[::-1])


def fitted(image: NDArray[np.uint8], height: int, width: int) -> NDArray[np.uint8]:
    """Picture as large as fits a white cell."""
    import cv2

    scale = min((height - 8) / image.shape[0], (width - 8) / image.shape[1])
    image = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    below, right = height - image.shape[0], width - image.shape[1]
    white = (255, 255, 255)
    return cv2.copyMakeBorder(image, 0, below, 0, right, cv2.BORDER_CONSTANT, value=white)


def side_by_side(mosaic: Path, rivals: Sequence[Path], target: Path, side: int = 560) -> None:
    """Ours at the left, twice as large; the stitchers by two in rows at the right, as JPEG."""
    import cv2
    import numpy as np

    cells = [fitted(cv2.imread(str(path)), side, side) for path in rivals]
    blank = np.full((side, side, 3), 255, np.uint8)
    cells += [blank] * (4 - len(cells))
    right = np.vstack([np.hstack(cells[:2]), np.hstack(cells[2:4])])
    left = fitted(ours_as_picture(mosaic, 2 * side), 2 * side, 2 * side)
    target.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(target), np.hstack([left, right]), [cv2.IMWRITE_JPEG_QUALITY, 80])


def compare(source: Path, args: argparse.Namespace, work: Path) -> None:
    """Tables and picture of one project."""
    project = work / source.name
    shutil.copytree(source, project, ignore=shutil.ignore_patterns("orthos"))
    photos = photos_of(project)
    print(f"\n### {source.name}: {len(photos)} photos\n")
    print("| what | CPU s | / floor | wall s (least) | peak MB | photos used | |")
    print("|---|---|---|---|---|---|---|", flush=True)
    base = ours_against_floor(project, photos, args.runs)
    pictures = []
    for program in ("OpenCV", "stitching") if args.stitch else ("OpenCV",):
        for setting in OPENCV:

            def run(
                each: Sequence[Path], target: Path, program: str = program, setting: str = setting
            ) -> tuple[Cost, int, str]:
                if program == "OpenCV":
                    return run_opencv(each, target, setting)
                return run_stitching(args.stitch, each, target, setting)

            done = attempts(f"{program} {setting}", run, photos, work)
            for attempt in done:
                print(attempt_row(attempt, len(photos), base), flush=True)
            if not done[-1].failure:
                pictures.append(done[-1].picture)
    if args.pictures:
        target = args.pictures / f"mosaic_{source.name}.jpg"
        apart(side_by_side, project / "products" / "mosaic.tif", pictures, target)
    if args.keep:
        kept = args.keep / source.name
        shutil.copytree(work, kept, dirs_exist_ok=True)
    told = summary_of(project)
    for tool in ("match", "adjust"):
        print(cost_row(f"georef {tool}", [georef(tool, project)], None, base), flush=True)
    print(f"\n{told['size_px']} px, {told['tiles']} tiles, {told['decodes_per_photo']} decodes a "
          f"photo, colour step {json.dumps(told['colour_step'])}")  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("projects", type=Path, nargs="+")
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--stitch", help="command `stitch` of a venv that has stitching")
    parser.add_argument("--pictures", type=Path, help="folder for pictures side by side")
    parser.add_argument("--keep", type=Path, help="folder for all that was made, at full size")
    args = parser.parse_args()
    for source in args.projects:
        with tempfile.TemporaryDirectory() as temp:
            compare(source.resolve(), args, Path(temp))


if __name__ == "__main__":
    main()
