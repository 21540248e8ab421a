"""Matching and adjustment against COLMAP's structure from motion: CPU, memory, misalignment.

    python benchmarks/alignment.py PHOTOS... [--size 1600] [--runs 2] [--misalign SCRIPT]

PHOTOS are folders of photos with positions in their tags. Ours (`georef run --only match,adjust`)
and COLMAP (`colmap_sfm.py`, two threads) run in turn as processes of their own on photos reduced to
`--size`; figures are user + system seconds and the peak of the whole process, start-up included.
The first of our runs finds no compiled kernels and is told apart. Each run begins without features.

Then orthos are made at native GSD, ours on the ground that the adjustment left, COLMAP's with its
camera on the plane of its points (its georeferencing is a robust similarity to the GPS), and
measured by `phase_check.py` and, if given, by a SCRIPT that matches the orthos of a folder.
Prints markdown. Without `--out` everything is made in a temporary folder and removed.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import shutil
import sqlite3
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
GEOREF = shutil.which("georef", path=str(Path(sys.executable).parent)) or "georef"


@dataclass(frozen=True, slots=True)
class Figures:
    """Of a finished process."""

    cpu_s: float
    wall_s: float
    peak_mb: float
    said: str


def measured(command: list[str], env: dict[str, str]) -> Figures:
    """Run a command and count it as the operating system does."""
    start = time.perf_counter()
    with tempfile.TemporaryFile("w+") as out, tempfile.TemporaryFile("w+") as err:
        process = subprocess.Popen(command, stdout=out, stderr=err, env=env)
        _, status, usage = os.wait4(process.pid, 0)
        wall = time.perf_counter() - start
        out.seek(0)
        err.seek(0)
        said, wrong = out.read(), err.read()
    if status:
        raise SystemExit(f"{command} failed:\n{said[-1500:]}\n{wrong[-1500:]}")
    cpu = usage.ru_utime + usage.ru_stime
    return Figures(cpu, wall, usage.ru_maxrss / 1024, said)


@dataclass(slots=True)
class Job:
    """One folder of photos."""

    photos: Path
    folder: Path
    size: int
    env: dict[str, str]
    misalign: Path | None
    rows: list[str] = field(default_factory=list)

    @property
    def project(self) -> Path:
        """Ours."""
        return self.folder / "ours"

    def georef(self, *words: str, project: Path | None = None) -> Figures:
        """Run a command of ours in the project."""
        where = str(project or self.project)
        return measured([GEOREF, words[0], where, *words[1:]], self.env)

    def begin(self) -> None:
        """Project with direct poses, the state that `match` finds in a run."""
        self.project.mkdir(parents=True)
        (self.project / "project.toml").write_text(
            f'[photos]\nfolder = "{self.photos.resolve().as_posix()}"\n'
            f"\n[tools.match]\nmax_side = {self.size}\n"
        )
        self.georef("run", "--only", "read-photos,orient-direct")

    def align(self) -> Figures:
        """Match and adjust, as if for the first time."""
        shutil.rmtree(self.project / "cache", ignore_errors=True)
        return self.georef("run", "--only", "match,adjust", "--force")

    def summary(self, tool: str) -> dict[str, Any]:
        """What the last run of a tool said."""
        with sqlite3.connect(self.project / "georef.gpkg") as db:
            found = db.execute(
                "SELECT summary FROM run WHERE tool LIKE ? AND outcome = 'done' ORDER BY fid",
                (f"%{tool}",),
            ).fetchall()
        return dict(json.loads(found[-1][0]))

    def rival(self) -> tuple[Figures, dict[str, Any]]:
        """COLMAP."""
        command = [
            sys.executable, str(HERE / "colmap_sfm.py"), str(self.photos),
            str(self.folder / "colmap"), "--size", str(self.size),
        ]  # fmt: skip
        figures = measured(command, self.env)
        return figures, json.loads(figures.said[figures.said.index("{") :])

    def rival_project(self) -> Path:
        """Project with COLMAP's poses and camera over the plane of its points."""
        poses = json.loads((self.folder / "colmap" / "poses.json").read_text())
        camera = poses["camera"]
        names = {"fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"}
        lines = [f"{name} = {camera[name]:.9g}" for name in sorted(names & set(camera))]
        frame = self.folder / "colmap" / "model" / "georef_frame.json"
        lat, lon, height = poses["origin"]
        origin = {"latitude": lat, "longitude": lon, "altitude": height}
        # the model stands in the enu frame of the similarity
        words = {"version": 1, "origin": origin, "height_kind": "ellipsoidal"}
        frame.write_text(json.dumps(words))
        ground = height + levelled(frame.parent)
        project = self.folder / "theirs"
        project.mkdir()
        (project / "project.toml").write_text(
            f'[photos]\nfolder = "{self.photos.resolve().as_posix()}"\n'
            f'\n[camera]\nmodel = "brown"\n' + "\n".join(lines) + "\n"
            f'\n[poses]\nfile = "{frame.parent.as_posix()}"\nformat = "colmap"\n'
            f'\n[ground]\nheight_m = {ground:.3f}\nheight_kind = "ellipsoidal"\n'
        )
        return project

    def judged(self, name: str, project: Path, quick: bool) -> None:
        """Orthos of a project and how far they disagree."""
        steps = "read-photos,orient-direct,footprints,orthos" if quick else "footprints,orthos"
        words = ["run", "--only", steps, *(["--quick"] if quick else [])]
        made = self.georef(*words, project=project)
        orthos = project / "products" / "orthos"
        command = [sys.executable, str(HERE / "phase_check.py"), str(orthos)]
        # the same nodes for all: those away from our tie points
        phase = json.loads(measured([*command, "--project", str(self.project)], self.env).said)
        (self.folder / f"phase_{project.name}.json").write_text(json.dumps(phase, indent=1))
        print(f"- {name}: orthos of {phase['gsd_m'] * 100:.2f} cm in {made.cpu_s:.0f} CPU s, "
              f"peak {made.peak_mb:.0f} MB; squares of {phase['square_m']} m, different ground "
              f"accepted {phase['wrong_accepted']:.2%}, error of known shifts "
              f"{phase['known_shift_error_px']} px")  # fmt: skip
        for key in ("away_from_ties", "square_without_ties", "at_ties"):
            self.rows.append(f"| {name}, {key.replace('_', ' ')} | {cells(phase[key])} |")
        if self.misalign:
            said = measured([sys.executable, str(self.misalign), str(orthos)], self.env).said
            print("\n".join("  " + line.strip() for line in said.splitlines()))
        sys.stdout.flush()


def levelled(model: Path) -> float:
    """Turn a COLMAP text model until the plane of its points is level; its height there, m.

    The ground of such a project is level, the plane of the points tilts with the similarity to the
    GPS. A turn of the whole leaves its misalignment as it is.
    """
    import numpy as np
    import pycolmap

    block = pycolmap.Reconstruction(model)
    p = np.array([point.xyz for point in block.points3D.values()])
    A = np.column_stack([p[:, :2], np.ones(len(p))])
    near = np.ones(len(p), dtype=bool)
    for _ in range(10):
        plane = np.linalg.lstsq(A[near], p[near, 2], rcond=None)[0]
        off = np.abs(p[:, 2] - A @ plane)
        near = off <= 3.0 * 1.48 * np.median(off)
    up = np.array([-plane[0], -plane[1], 1.0]) / np.hypot(np.hypot(*plane[:2]), 1.0)
    side = np.cross([0.0, 1.0, 0.0], up)
    side /= np.linalg.norm(side)
    R = np.array([side, np.cross(up, side), up])
    block.transform(pycolmap.Sim3d(1.0, pycolmap.Rotation3d(R), np.zeros(3)))
    block.write_text(model)
    return float(plane[2] * up[2])


def cells(tally: dict[str, Any]) -> str:
    """One row of the table of phase correlation."""
    values = [tally.get(key, "-") for key in ("median_gsd", "p90_gsd", "p99_gsd")]
    parts = (tally.get(f"{way}_the_base_gsd", ["-", "-"]) for way in ("along", "across"))
    values += [f"{part[0]}; {part[1]}" for part in parts]
    return " | ".join(map(str, [tally["tried"], f"{tally['acceptance']:.0%}", *values]))


def one(job: Job, runs: int, rival: bool) -> None:
    """All figures of one folder."""
    load = os.getloadavg()[0]
    job.begin()
    cold = job.align()
    warm = [job.align() for _ in range(runs)]
    match, adjusted = job.summary("match"), job.summary("adjust")
    cpu = statistics.median(f.cpu_s for f in warm)
    peak = max(f.peak_mb for f in warm)
    spread = f"{min(f.cpu_s for f in warm):.1f}-{max(f.cpu_s for f in warm):.1f}"
    print(f"\n### {job.photos.parent.name}, {job.size} px, load {load:.1f}\n")
    print("| what | CPU s | wall s | peak MB | photos placed | rms px | observations |")
    print("|---|---|---|---|---|---|---|")
    wall = statistics.median(f.wall_s for f in warm)
    print(f"| match + adjust | {cpu:.1f} ({spread}) | {wall:.0f} | {peak:.0f} | "
          f"{adjusted.get('photos')} of {match['photos']} | {adjusted.get('rms_px')} | "
          f"{adjusted.get('observations')} |")  # fmt: skip
    print(f"| match + adjust, kernels to be compiled | {cold.cpu_s:.1f} | {cold.wall_s:.0f} | "
          f"{cold.peak_mb:.0f} | | | |")  # fmt: skip
    sys.stdout.flush()
    told: dict[str, Any] = {}
    if rival:
        figures, told = job.rival()
        print(f"| COLMAP {told['pycolmap']} | {figures.cpu_s:.1f} | {figures.wall_s:.0f} | "
              f"{figures.peak_mb:.0f} | {told['placed']} of {told['photos']} | "
              f"{told['reprojection_px']} | {told['observations']} |")  # fmt: skip
        print(f"\nCPU {cpu / figures.cpu_s:.3f} of COLMAP's (1/{figures.cpu_s / cpu:.1f}), memory "
              f"{peak / figures.peak_mb:.2f}. Ours: sigma0 {adjusted.get('sigma0')}, focal "
              f"{adjusted.get('focal_px')} px, ground {adjusted.get('ground')}. COLMAP: focal "
              f"{told.get('focal_px')} px, tilt {told.get('tilt_of_mean_axis_deg')} deg, height "
              f"{told.get('height_above_ground_m')} m, GPS rms {told.get('gps_rms_m')} "
              "m.\n")  # fmt: skip
    sys.stdout.flush()
    job.judged("ours", job.project, quick=False)
    if told.get("georeferenced"):
        job.judged("COLMAP on a plane", job.rival_project(), quick=True)
    print("\n| squares on the 5 m grid | tried | accepted | median GSD | p90 GSD | p99 GSD | "
          "along the base: median; p90 | across it |")  # fmt: skip
    print("|---|---|---|---|---|---|---|---|")
    print("\n".join(job.rows))
    sys.stdout.flush()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("photos", type=Path, nargs="+")
    parser.add_argument("--size", type=int, default=1600, help="longer side for features, px")
    parser.add_argument("--runs", type=int, default=2)
    parser.add_argument("--misalign", type=Path, help="script that matches orthos of a folder")
    parser.add_argument("--out", type=Path, help="keep what is made here")
    parser.add_argument("--no-rival", action="store_true")
    args = parser.parse_args()
    threads = os.environ.get("OMP_NUM_THREADS", "-")
    print(f"{platform.processor() or platform.machine()}, {os.cpu_count()} cores, Python "
          f"{platform.python_version()}, OMP_NUM_THREADS {threads}")  # fmt: skip
    with tempfile.TemporaryDirectory() as temp:
        out = args.out or Path(temp)
        # kernels compiled here: the first run finds none
        env = {**os.environ, "NUMBA_CACHE_DIR": str(Path(temp) / "numba")}
        for photos in args.photos:
            folder = out / photos.parent.name
            job = Job(photos, folder, args.size, env, args.misalign)
            one(job, args.runs, not args.no_rival)


if __name__ == "__main__":
    main()
