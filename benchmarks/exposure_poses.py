"""Camera poses of simulated flights by log, sync board and smoother, against truth and EXIF tags.

    python benchmarks/exposure_poses.py [--flights 40] [--sheet]

Prints a markdown table per kind of GNSS error. The flight is that of the sample project: 16 photos
in two crossing directions, 100 Hz IMU, 5 Hz fixes, one photo without event and one event without
photo, a boresight of 1 deg and lever arms of 1 cm (one sigma) that nobody knows. `--sheet` states
the IMU's errors as they are drawn; without it they are the defaults of project.toml.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from pathlib import Path

import numpy as np

# the flights are those of the tests
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "navigate"))

from exposure_flights import SHEET, FlightErrors, flown

from georef_gis.frames import Array
from georef_gis.simulate import FlightSettings

AXES = ("east m", "north m", "up m", "about east deg", "about north deg", "about up deg")
SURE = 0.99


def rms(rows: Array) -> Array:
    return np.asarray(np.sqrt(np.mean(np.square(rows), axis=0)))


def pooled(flights: list[FlightErrors]) -> tuple[float, float]:
    """Error/sigma of all components together (rms), and one sigma of it by chance."""
    square = np.concatenate([(f.error / f.sigma).ravel() ** 2 for f in flights])
    ratio = math.sqrt(float(np.mean(square)))
    return ratio, 0.5 * math.sqrt(sum(f.scatter for f in flights)) / len(square)


def table(gnss: str, flights: list[FlightErrors]) -> None:
    error = np.concatenate([f.error for f in flights])
    tags = np.concatenate([f.tag_error for f in flights])
    ratio = rms(error / np.concatenate([f.sigma for f in flights]))
    unit = np.array([1.0] * 3 + [180.0 / math.pi] * 3)
    print(f"\n### {gnss} GNSS error, {len(flights)} flights, {len(error)} photos\n")
    print("| | rms of camera poses | rms of EXIF tags | tags / poses | error/sigma |")
    print("|---|---|---|---|---|")
    for name, mine, theirs, r in zip(
        AXES, rms(error) * unit, rms(tags) * unit, ratio, strict=True
    ):  # fmt: skip
        print(f"| {name} | {mine:.3f} | {theirs:.3f} | {theirs / mine:.1f} | {r:.2f} |")
    for name, part, scale in (
        ("3-D position m", slice(0, 3), 1.0), ("rotation deg", slice(3, 6), 180.0 / math.pi),
    ):  # fmt: skip
        mine, theirs = (
            scale * math.sqrt(3) * float(rms(x[:, part].ravel())) for x in (error, tags)
        )
        print(f"| {name} | {mine:.3f} | {theirs:.3f} | {theirs / mine:.1f} | |")
    apart = np.concatenate([np.diff(f.error[:, :3], axis=0) for f in flights])
    confidence = np.concatenate([f.confidence for f in flights])
    together, chance = pooled(flights)
    nees = np.array([f.nees for f in flights])
    print(
        f"\nerror/sigma of all components {together:.2f} (1 +- {chance:.2f} by chance); joint "
        f"NEES per degree of freedom {nees.mean():.2f}, of single flights {nees.min():.2f} to "
        f"{nees.max():.2f}; neighbouring photos differ by {rms(apart[:, 0]):.2f}/"
        f"{rms(apart[:, 1]):.2f}/{rms(apart[:, 2]):.2f} m; confidence > {SURE} for "
        f"{np.mean(confidence > SURE):.1%} of the photos, of these wrong: "
        f"{sum(f.wrong for f in flights)}"
    )
    sys.stdout.flush()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--flights", type=int, default=40)
    parser.add_argument("--sheet", action="store_true")
    given = parser.parse_args()
    start = time.process_time()
    for gnss in ("white", "coloured"):
        settings = FlightSettings(gnss=gnss)
        imu = SHEET if given.sheet else {}
        table(gnss, [flown(settings, seed, **imu) for seed in range(given.flights)])
    print(f"\n{time.process_time() - start:.0f} CPU s")


if __name__ == "__main__":
    main()
