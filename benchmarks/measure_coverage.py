"""How often error ellipses and intervals of lengths hold the truth, over simulated flights.

    python benchmarks/measure_coverage.py [FLIGHTS] [FIRST_SEED]

For each way of measuring: shares inside of the 39.3 % and the 95 % ellipse (intervals for lengths),
each with one sigma by bootstrap over the flights, and the rms of error over sigma.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "measure"))

from coverage_cases import Measured, measure_flight, rms_ratio, shares, spread_of_shares


def main(flights: int = 300, first: int = 0) -> None:
    found: dict[str, list[Measured]] = {}
    begun = time.perf_counter()
    for seed in range(first, first + flights):
        for kind, one in measure_flight(seed).items():
            found.setdefault(kind, []).append(one)
    seconds = time.perf_counter() - begun
    print(f"{flights} flights, {seconds / flights:.2f} s each; per cent inside, +- one sigma")
    for kind, some in found.items():
        held, spread = 100 * shares(some), 100 * spread_of_shares(some)
        each = "   ".join(f"{h:5.1f} +- {s:3.1f}" for h, s in zip(held, spread, strict=True))
        ratio = " ".join(f"{r:.2f}" for r in rms_ratio(some))
        n = sum(len(one.inside) for one in some)
        print(f"{kind:44s} {each}   rms error/sigma {ratio}   n {n}")


if __name__ == "__main__":
    main(*(int(word) for word in sys.argv[1:]))
