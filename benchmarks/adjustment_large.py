"""Part (d) of `adjustment_quality.py`: what large blocks take, each in a process of its own.

    python benchmarks/adjustment_large.py PHOTOS OBSERVATIONS

adjusts one flight of so many photos with so many observations each, and prints JSON.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
from adjustment_ratios import Array, pose_ratios, run, slashed

# the flights are those of the tests
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "orient"))

import adjustment_flights as sim
from adjustment_blocks import block_of, camera_sigma, rms
from numpy.typing import NDArray

from georef_gis.orient.adjustment.block import Block, CameraPrior, FlightPrior


def by_parts(flight: sim.SimFlight) -> FlightPrior:
    """The joint prior of a long flight, asked for by parts as the tool does."""
    photos = sim.oriented_photos(flight)
    n, model, times = len(photos), flight.navigation, flight.truth.times
    L = np.stack([sim.pose_jacobian(flight, i)[:, :6] for i in range(n)])

    def joint(indices: NDArray[np.int64]) -> Array:
        k = len(indices)
        out = np.zeros((k, 6, k, 6))
        for c, block in enumerate(model.covariance(times[indices])):
            out[:, c, :, c] = block
        out = np.einsum("aij,ajbk,blk->aibl", L[indices], out, L[indices])
        return np.asarray(out.reshape(6 * k, 6 * k))

    s = flight.sigmas
    shared = np.concatenate([s.lever, s.boresight, s.bias, [s.clock]])
    return FlightPrior(
        id="flight",
        photos=np.arange(n),
        covariance=None,
        white=np.einsum("aij,j,akj->aik", L, model.white**2, L),
        R_enu_from_body=flight.R_nav,
        velocity_enu=np.array([p.pose.velocity_enu for p in photos]),
        rate_enu=np.array([p.pose.rate_enu for p in photos]),
        shared_covariance=np.diag(shared**2),
        times=times,
        joint=joint,
    )


def large_block(flight: sim.SimFlight) -> Block:
    """Block of a flight of more photos than are kept whole."""
    photos = sim.oriented_photos(flight)
    return Block(
        photo_ids=sim.photo_ids(flight),
        poses=tuple(p.pose for p in photos),
        camera_of=np.zeros(len(photos), dtype=np.int64),
        cameras=(CameraPrior(camera=photos[0].camera, sigma=camera_sigma(flight)),),
        flights=(by_parts(flight),),
        ties=sim.ties(flight),
    )


def peak_mb() -> float:
    """Peak of this process so far; what getrusage says holds that of the parent too."""
    for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
        if line.startswith("VmHWM"):
            return int(line.split()[1]) / 1024
    raise SystemExit("/proc/self/status has no VmHWM: the memory is read on Linux only")


def one_size(photos: int, observations: float) -> None:
    """Adjust one large flight and say what it took, as JSON; for a process of its own."""
    run(sim.strip(1, 3))
    if photos > 300:
        # the band has kernels of its own
        small = sim.many(1, 310, 60.0)
        run(small, large_block(small))
    flight = sim.many(5, photos, observations)
    block = large_block(flight) if photos > 300 else block_of(flight)
    before = peak_mb()
    adjusted, cpu = run(flight, block)
    errors, ratio = pose_ratios(flight, adjusted)
    print(json.dumps({
        "photos": photos, "observations": len(flight.uv), "points": len(flight.points),
        "cpu_s": round(cpu, 1), "before_mb": round(before),
        "peak_mb": round(peak_mb()), "converged": adjusted.solution.converged,
        "sigma0": round(adjusted.sigma0, 3),
        "error_over_sigma": [round(float(v), 2) for v in rms([ratio])],
        "rms_m": [round(float(v), 3) for v in rms([errors])[:3]],
    }))  # fmt: skip


def sizes() -> None:
    """Part (d): large blocks, each in a process of its own."""
    print("\n### (d) large blocks, navigation by tags\n")
    print("| photos | observations | points | CPU s | peak MB (flight and interpreter before) | "
          "converged | sigma0 | error/sigma of poses (one flight) |")  # fmt: skip
    print("|---|---|---|---|---|---|---|---|")
    for photos, observations in ((167, 3000), (1000, 200)):
        command = [sys.executable, __file__, str(photos), str(observations)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            print(f"| {photos} | failed: {done.stderr.strip().splitlines()[-1]} |")
            continue
        f = json.loads(done.stdout)
        print(f"| {f['photos']} | {f['observations']} | {f['points']} | {f['cpu_s']} | "
              f"{f['peak_mb']} ({f['before_mb']}) | {f['converged']} | "
              f"{f['sigma0']} | {slashed(np.array(f['error_over_sigma']))} |")  # fmt: skip
        sys.stdout.flush()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("photos", type=int)
    parser.add_argument("observations", type=float, help="of each photo")
    args = parser.parse_args()
    one_size(args.photos, args.observations)


if __name__ == "__main__":
    main()
