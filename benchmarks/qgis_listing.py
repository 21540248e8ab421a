"""What the QGIS plug-in adds to the listing of all tools by `qgis_process`, s.

    python benchmarks/qgis_listing.py [TIMES]

A new user's profile with and without the plug-in, in turn; wall clock and CPU of `qgis_process
list`, medians, and the same after georef changed, when the plug-in asks it for its tools again.
"""

from __future__ import annotations

import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

QGIS_PROCESS = "/usr/bin/qgis_process.bin"
CACHE = ".local/share/QGIS/QGIS3/profiles/default/cache/georef_qgis/manifest.json"


def home(base: Path, name: str, *, plug_in: bool) -> Path:
    """Home of a new user, whose QGIS has started once."""
    folder = base / name
    (folder / "run").mkdir(mode=0o700, parents=True)
    if plug_in:
        words = [sys.executable, "-m", "georef_gis.app", "qgis", "install", "--profile", "default"]
        subprocess.run(
            words, check=True, capture_output=True, env={**os.environ, "HOME": str(folder)}
        )
    listing(folder)
    return folder


def listing(folder: Path) -> tuple[float, float, int]:
    """Wall clock and CPU in s of one listing, and how many of our tools it names."""
    env = {"HOME": str(folder), "XDG_RUNTIME_DIR": str(folder / "run"), "PATH": "/usr/bin:/bin",
           "QT_QPA_PLATFORM": "offscreen", "LANG": "C.UTF-8"}  # fmt: skip
    before, started = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    done = subprocess.run(
        [QGIS_PROCESS, "list"], env=env, capture_output=True, text=True, check=True
    )
    wall, after = time.perf_counter() - started, resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return wall, cpu, done.stdout.count("\tgeoref:")


def main() -> None:
    times = int(sys.argv[1]) if len(sys.argv) > 1 else 7
    with tempfile.TemporaryDirectory() as base:
        without = home(Path(base), "without", plug_in=False)
        with_it = home(Path(base), "with", plug_in=True)
        rows: dict[str, list[tuple[float, float, int]]] = {"without": [], "with": [], "changed": []}
        for _ in range(times):
            rows["without"].append(listing(without))
            rows["with"].append(listing(with_it))
            (with_it / CACHE).unlink()
            rows["changed"].append(listing(with_it))
        for name, row in rows.items():
            wall, cpu = (statistics.median(r[n] for r in row) for n in (0, 1))
            print(f"{name:<8} wall {wall:.2f} s  CPU {cpu:.2f} s  tools {row[0][2]}")
        for n, kind in enumerate(("wall", "CPU")):
            more = [a[n] - b[n] for a, b in zip(rows["with"], rows["without"], strict=True)]
            print(f"more with the plug-in, {kind}: {statistics.median(more):+.2f} s")


if __name__ == "__main__":
    main()
