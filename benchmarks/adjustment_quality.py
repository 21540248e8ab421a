"""The adjustment on simulated flights with truth: are its sigmas true, is it fast, against Ceres.

    python benchmarks/adjustment_quality.py [--flights 40] [--check-flights 10] [--only a,b,c,d,e]

(a) error/sigma of poses, points and shared unknowns over flights of five kinds; (b) the flight of
the reference "One-step adjustment with Ceres", and Ceres itself; (c) check points with RTK-grade
navigation, and with tags and 5 control points; (d) 167 photos x 3 000 and 1 000 x 200 observations,
each in a process of its own; (e) the same flights with their joint prior and with priors that take
the errors of neighbouring photos as independent. All goes the whole way of the tool, wrong matches
and weighing down included (`adjust`), unless a row says otherwise. Prints markdown; CPU is user +
system seconds with kernels compiled before. Ceres needs pycolmap and pyceres.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from adjustment_large import sizes
from adjustment_ratios import Array, point_ratios, pose_ratios, run, shared_ratios, slashed

# the flights are those of the tests
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "orient"))

import adjustment_flights as sim
from adjustment_blocks import block_of, control_input, rms

from georef_gis.orient.adjustment.adjust import Adjusted
from georef_gis.orient.adjustment.block import CAMERA_NAMES, Block

Make = Callable[[int], sim.SimFlight]

FIRST_SEED = 1000
KINDS: dict[str, Make] = {
    "smoothed navigation, 18 photos": lambda seed: sim.survey(seed, 3, 6),
    "the same, 5 % wrong matches": lambda seed: sim.survey(seed, 3, 6, outliers=0.05),
    "tags (2.5 m GPS), 18 photos": lambda seed: sim.gps_only(seed, 3, 6),
    "RTK, 18 photos": lambda seed: sim.rtk(seed, 3, 6),
    "slow errors, 18 photos": lambda seed: sim.survey(seed, 3, 6, navigation=sim.TIGHT_SLOW),
    "strip of 8": lambda seed: sim.strip(seed),
    "two photos": lambda seed: sim.two_photos(seed),
}
# of the reference, with those of its table; deg, s, share of the focal length, m
REFERENCE = {
    "boresight x, deg": 0.011,
    "boresight y, deg": 0.011,
    "boresight z, deg": 0.021,
    "clock, ms": 1.6,
    "focal, %": 0.03,
    "lever x, m": 0.03,
    "lever y, m": 0.01,
    "lever z, m": 0.08,
}


# -- a -----------------------------------------------------------------------------------------


def consistency(flights: int) -> None:
    """Error/sigma over flights, every error redrawn."""
    print(f"\n### (a) error/sigma, {flights} flights a kind\n")
    print("| kind | position E/N/U | angles about E/N/U | points E/N/U | camera | mount, bias, "
          "clock | rms position m | converged | weighed down | CPU s a flight |")  # fmt: skip
    print("|---|---|---|---|---|---|---|---|---|---|")
    for number, (name, make) in enumerate(KINDS.items()):
        poses, points, shared, errors, used = [], [], [], [], []
        converged = doubted = 0
        first = FIRST_SEED * (1 + number)
        for seed in range(first, first + flights):
            flight = make(seed)
            adjusted, cpu = run(flight)
            error, ratio = pose_ratios(flight, adjusted)
            poses.append(ratio)
            errors.append(error)
            points.append(point_ratios(flight, adjusted))
            shared.append(shared_ratios(flight, adjusted))
            used.append(cpu)
            converged += adjusted.solution.converged
            doubted += len(adjusted.doubted)
        p, q, every = rms(poses), rms(points), np.array(shared)
        k = len(CAMERA_NAMES)
        camera, mount = (np.sqrt(np.nanmean(s**2)) for s in (every[:, :k], every[:, k : k + 10]))
        size = rms([e[:, :3] for e in errors])
        print(f"| {name} | {slashed(p[:3])} | {slashed(p[3:])} | {slashed(q)} | {camera:.2f} | "
              f"{mount:.2f} | {slashed(size, 3)} | {converged} of {flights} | {doubted} | "
              f"{np.median(used):.2f} |")  # fmt: skip
        told = np.isfinite(every).any(axis=0)
        each = np.where(told, rms([np.where(told, every, 0.0)]), np.nan)
        names = adjusted.block.shared_names
        off = {
            names[i].split()[-1]: round(float(each[i]), 2)
            for i in np.flatnonzero(np.isfinite(each) & ((each < 0.7) | (each > 1.4)))
        }
        if off:
            print(f"|   shared beyond 0.7-1.4: {off} |")
        sys.stdout.flush()


# -- b -----------------------------------------------------------------------------------------


def sigmas_of(adjusted: Adjusted, focal: float) -> list[float]:
    """In the order and the units of `REFERENCE`."""
    s = np.sqrt(np.diag(adjusted.covariances.shared()))
    return [*np.degrees(s[14:17]), 1e3 * s[20], 100 * s[0] / focal, *s[11:14]]


def calibration(runs: int = 5) -> None:
    """Standard deviations and CPU on the flight of the reference."""
    print("\n### (b) calibration flight: two heights, crossed lines, wind, 5 cm navigation\n")
    flight = sim.calibration_flight(7)
    block = block_of(flight)
    found = [run(flight, block) for _ in range(runs)]
    mine = sigmas_of(found[0][0], flight.camera.values[0])
    print(f"{flight.n_photos} photos, {len(flight.points)} points, {len(flight.uv)} observations\n")
    theirs, said = ceres(flight)
    print("| sigma | asked | ours | ours / asked | Ceres |")
    print("|---|---|---|---|---|")
    for (name, asked), ours, ref in zip(REFERENCE.items(), mine, theirs, strict=True):
        print(f"| {name} | {asked} | {ours:.4f} | {ours / asked:.2f} | {ref:.4f} |")
    cpu = [c for _, c in found]
    print(
        f"\nCPU of ours, covariances included: {np.median(cpu):.2f} s ({min(cpu):.2f} to "
        f"{max(cpu):.2f}). {said}"
    )
    sys.stdout.flush()


def ceres(flight: sim.SimFlight) -> tuple[list[float], str]:
    """Sigmas of Ceres, and its CPU seconds in words; those within Python's priors told apart."""
    try:
        import ceres_oracle as oracle
    except ImportError as error:
        return [float("nan")] * len(REFERENCE), f"Ceres was not run: {error}."
    inside = [0.0]

    def timed(function: Callable[..., bool]) -> Callable[..., bool]:
        def evaluate(*args: Any) -> bool:
            start = time.perf_counter()
            done = function(*args)
            inside[0] += time.perf_counter() - start
            return done

        return evaluate

    for kind in (oracle._Numeric, oracle._Linear):
        kind.Evaluate = timed(kind.Evaluate)
    start = time.process_time()
    found = oracle.solve_with_ceres(flight)
    cpu = time.process_time() - start
    sigmas = [*found.sigma_boresight_deg, 1e3 * found.sigma_clock,
              100 * found.sigma_focal / flight.camera.values[0], *found.sigma_lever]  # fmt: skip
    return sigmas, (
        f"Ceres: {cpu:.1f} CPU s, {found.solve_s:.1f} s wall to solve ({found.iterations} steps; "
        f"{inside[0]:.1f} s of it in priors written in Python) and {found.covariance_s:.1f} s for "
        "the covariances of poses and shared unknowns, without those of the points."
    )


# -- c -----------------------------------------------------------------------------------------


def check_points(flights: int) -> None:
    """RMSE of check points as the photos intersect them."""
    print(f"\n### (c) check points against truth, {flights} flights of 18 and of 32 photos\n")
    print("| flight | GSD cm | check points | RMSE E/N/U cm | in GSD | RMSE_H, GSD | worst flight "
          "H; V, GSD | error/sigma E/N/U |")  # fmt: skip
    print("|---|---|---|---|---|---|---|---|")
    kinds: dict[str, Make] = {
        "RTK, no control, 18 photos": lambda s: sim.rtk(s, 3, 6, check=60),
        "RTK, no control, 32 photos": lambda s: sim.rtk(s, check=60),
        "tags, 5 control points, 18 photos": lambda s: sim.gps_only(s, 3, 6, control=5, check=60),
        "tags, 5 control points, 32 photos": lambda s: sim.gps_only(s, control=5, check=60),
        "tags, no control, 32 photos": lambda s: sim.gps_only(s, check=60),
    }
    for name, make in kinds.items():
        off, ratio, worst, few = [], [], [], 10**9
        for seed in range(FIRST_SEED, FIRST_SEED + flights):
            flight = make(seed)
            error, z = checked(flight)
            few = min(few, len(error))
            off.append(error)
            ratio.append(z)
            each = np.sqrt(np.mean(error**2, axis=0))
            worst.append((np.hypot(*each[:2]), each[2]))
        height = float(np.median(flight.truth.p_cam[:, 2]))
        gsd = height / flight.camera.values[0]
        e = rms(off)
        top = np.max(worst, axis=0) / gsd
        print(f"| {name} | {100 * gsd:.2f} | {few} or more | {slashed(100 * e)} | "
              f"{slashed(e / gsd)} | {np.hypot(*e[:2]) / gsd:.2f} | {top[0]:.2f}; {top[1]:.2f} | "
              f"{slashed(rms(ratio))} |")  # fmt: skip
        sys.stdout.flush()


def checked(flight: sim.SimFlight) -> tuple[Array, Array]:
    """Errors of check points with two rays or more, m, and over their sigma; (k, 3)."""
    groups = [(flight.check, False)]
    if len(flight.control.p):
        groups.insert(0, (flight.control, True))
    n = len(flight.control.p)
    control = control_input(*groups)
    given = {"sigma_level": 30.0} if n else {}
    adjusted, _ = run(flight, block_of(flight, control=control, **given))
    rays = np.bincount(control.point, minlength=len(control.p_enu))
    row = {index: k for k, index in enumerate(adjusted.problem.marked)}
    chosen = [j for j in range(len(flight.check.p)) if rays[n + j] >= 2]
    rows = [row[n + j] for j in chosen]
    error = flight.check.p_true[chosen] - adjusted.control_places[rows]
    sigma = np.sqrt(np.einsum("kii->ki", adjusted.control_covariance[rows]))
    return error, error / sigma


# -- e -----------------------------------------------------------------------------------------


def independent(block: Block) -> Block:
    """The same block with the errors of one photo taken to say nothing of its neighbours'."""
    prior = block.flights[0]
    if prior.covariance is None:
        raise ValueError("only for flights whose covariance is kept whole")
    n = len(prior.photos)
    each = prior.covariance.reshape(n, 6, n, 6)[np.arange(n), :, np.arange(n), :]
    whole = np.zeros((n, 6, n, 6))
    whole[np.arange(n), :, np.arange(n), :] = each
    flight = replace(prior, covariance=whole.reshape(6 * n, 6 * n), white=each)
    return replace(block, flights=(flight,))


def over_confidence(flights: int) -> None:
    """What independent priors claim, and how wrong they are, on flights with slow errors."""
    print(f"\n### (e) slow errors, joint and independent priors, {flights} flights\n")
    print("| flight | prior | error/sigma position E/N/U | angles | points | mount, bias, clock | "
          "rms position m | sigma position, joint / independent |")  # fmt: skip
    print("|---|---|---|---|---|---|---|---|")
    kinds: dict[str, Make] = {
        "96 photos, two heights, slow 5 cm": lambda s: sim.calibration_flight(
            s, slow=True, obs_per_photo=100.0
        ),
        "18 photos, slow 5 cm": lambda s: sim.survey(s, 3, 6, navigation=sim.TIGHT_SLOW),
        "32 photos by tags": lambda s: sim.gps_only(s),
    }
    for name, make in kinds.items():
        found: dict[str, tuple[list[Array], ...]] = {
            k: ([], [], [], [], []) for k in ("joint", "independent")
        }
        for seed in range(FIRST_SEED, FIRST_SEED + flights):
            flight = make(seed)
            block = block_of(flight)
            for kind, chosen in (("joint", block), ("independent", independent(block))):
                adjusted, _ = run(flight, chosen)
                errors, ratio = pose_ratios(flight, adjusted)
                lists = found[kind]
                lists[0].append(ratio)
                lists[1].append(point_ratios(flight, adjusted))
                lists[2].append(shared_ratios(flight, adjusted)[None, 11:21])
                lists[3].append(errors[:, :3])
                lists[4].append(np.abs(errors / ratio)[:, :3])
        spread = rms(found["joint"][4]) / rms(found["independent"][4])
        for kind, lists in found.items():
            p, q, s = rms(lists[0]), rms(lists[1]), np.sqrt(np.nanmean(rms(lists[2]) ** 2))
            print(f"| {name} | {kind} | {slashed(p[:3])} | {slashed(p[3:])} | {slashed(q)} | "
                  f"{s:.2f} | {slashed(rms(lists[3]), 3)} | "
                  f"{slashed(spread) if kind == 'independent' else ''} |")  # fmt: skip
        sys.stdout.flush()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--flights", type=int, default=40)
    parser.add_argument("--check-flights", type=int, default=10)
    parser.add_argument("--only", default="a,b,c,d,e", help="parts, as a,b")
    args = parser.parse_args()
    parts = args.only.split(",")
    print(
        f"load {os.getloadavg()[0]:.1f}, OMP_NUM_THREADS {os.environ.get('OMP_NUM_THREADS', '-')}"
    )
    run(sim.strip(1, 3))
    if "a" in parts:
        consistency(args.flights)
    if "b" in parts:
        calibration()
    if "c" in parts:
        check_points(args.check_flights)
    if "d" in parts:
        sizes()
    if "e" in parts:
        over_confidence(args.check_flights)
    print(f"\nload {os.getloadavg()[0]:.1f} at the end")


if __name__ == "__main__":
    main()
