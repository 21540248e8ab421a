"""What an unchanged site costs in a batch, and in `georef run`.

    python benchmarks/batch_unchanged.py PROJECT [PROJECT ...] [--copies 20]

Every project must be up to date. The first is copied so that there are many sites; CPU and wall
time of `georef batch` over all of them is told per site, beside that of `georef run` on one.
"""

from __future__ import annotations

import argparse
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path


def timed(words: list[str]) -> tuple[float, float]:
    """CPU and wall seconds of a command."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    begun = time.perf_counter()
    done = subprocess.run([sys.executable, "-m", "georef_gis.app", *words], capture_output=True)
    wall = time.perf_counter() - begun
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode:
        sys.exit(done.stderr.decode())
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return cpu, wall


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("projects", nargs="+", type=Path)
    parser.add_argument("--copies", type=int, default=20)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        for project in given.projects:
            sites = Path(folder) / f"{project.name}_sites"
            for number in range(given.copies):
                shutil.copytree(project, sites / f"{number:03d}", copy_function=shutil.copy2)
            # the copies are checked once: their folders are new to them
            timed(["batch", str(sites)])
            cpu, wall = timed(["batch", str(sites)])
            one_cpu, one_wall = timed(["run", str(sites / "000")])
            print(
                f"{project.name}: {given.copies} unchanged sites, a site {cpu / given.copies:.3f} "
                f"CPU s, {wall / given.copies:.3f} s; `georef run` alone {one_cpu:.2f} CPU s, "
                f"{one_wall:.2f} s"
            )


if __name__ == "__main__":
    main()
