"""CPU and memory of the mosaic and the orthos against the floor and, if given, orthority.

    python benchmarks/bench_mosaic.py PHOTO_FOLDER [--runs 5] [--orthority COMMAND] [--photos N]

Each contestant runs as a process of its own, in turn, after one warm-up; figures are user + system
seconds and peak memory of the whole process, start-up included, as the operating system counts
them. orthority (AGPL) is never imported: give its `oty` command from a venv of its own.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import shutil
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).parent


def measured(command: list[str]) -> tuple[float, float, float]:
    """CPU s, wall s and peak memory, MB, of a finished process."""
    import time

    start = time.perf_counter()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    _, status, usage = os.wait4(process.pid, 0)
    if status:
        raise SystemExit(f"{command} failed: {process.stderr.read().decode()[-2000:]}")
    wall = time.perf_counter() - start
    return usage.ru_utime + usage.ru_stime, wall, usage.ru_maxrss / 1024


def tiles_of(project: Path) -> int:
    """Tiles of the mosaic that hold something, from the run's own summary."""
    import sqlite3

    with sqlite3.connect(project / "georef.gpkg") as db:
        rows = db.execute(
            "SELECT summary FROM run WHERE tool LIKE '%mosaic' AND outcome = 'done'"
        ).fetchall()
    return int(json.loads(rows[-1][0])["tiles"])


def row(name: str, runs: list[tuple[float, float, float]], floor: float | None) -> str:
    cpu = [r[0] for r in runs]
    middle = statistics.median(cpu)
    ratio = f"{middle / floor:.2f}" if floor else "1"
    return (
        f"| {name} | {middle:.2f} ({min(cpu):.2f}-{max(cpu):.2f}) | "
        f"{statistics.median(r[1] for r in runs):.2f} | "
        f"{max(r[2] for r in runs):.0f} | {ratio} |"
    )


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--orthority", help="command `oty` of a venv that has orthority")
    args = parser.parse_args()
    georef = shutil.which("georef", path=Path(sys.executable).parent) or "georef"
    with tempfile.TemporaryDirectory() as temp:
        project = Path(temp)
        (project / "project.toml").write_text(
            f'[photos]\nfolder = "{args.folder.resolve().as_posix()}"\n'
        )
        subprocess.run([georef, "run", str(project)], check=True, capture_output=True)
        tiles = tiles_of(project)
        floor = [sys.executable, str(HERE / "floor_mosaic.py"), str(args.folder), str(tiles)]
        run = [georef, "run", str(project)]
        contestants = {
            "floor: decode + one remap each + encode tiles": floor,
            "georef run --only mosaic": [*run, "--only", "mosaic", "--force"],
            "georef run --only orthos": [*run, "--only", "orthos", "--force"],
        }
        results: dict[str, list[tuple[float, float, float]]] = {k: [] for k in contestants}
        for i in range(args.runs + 1):
            for name, command in contestants.items():
                figures = measured(command)
                if i:
                    results[name].append(figures)
        base = statistics.median(r[0] for r in results[next(iter(contestants))])
        print(f"{platform.processor() or platform.machine()}, {os.cpu_count()} cores, "
              f"Python {platform.python_version()}; {tiles} tiles\n")  # fmt: skip
        print("| what | CPU s, median (range) | wall s | peak MB | CPU / floor |")
        print("|---|---|---|---|---|")
        for name, runs in results.items():
            print(row(name, runs, base))
        if args.orthority:
            from orthority_job import orthority_command

            for interp, name in (("bilinear", "bilinear as ours"), ("", "its default, cubic")):
                command = orthority_command(args.orthority, project, interp)
                print(row(f"orthority, same orthos, {name}", [measured(command)], base))


main()
