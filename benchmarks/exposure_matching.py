"""Matching of photos and events on simulated flights: how sure, how often wrong, how fast.

    python benchmarks/exposure_matching.py [--flights 1000] [--seed 0]

The flights are those of `tests/navigate/exposure_cases.py`: 16 to 200 photos, 5 % missed and 2 %
spurious triggers, test shots in a third, readings cut to 1, 0.1 or 0.01 s, unknown time zone.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / "tests" / "navigate"))

import exposure_cases as cases

from georef_gis.navigate.exposures import match_exposures

BINS = (0.0, 0.5, 0.8, 0.9, 0.95, 0.99, 0.999, 0.9999, 1.0001)


@dataclass
class Tally:
    confidence: list = field(default_factory=list)
    right: list = field(default_factory=list)
    clock: list = field(default_factory=list)
    by_event: list = field(default_factory=list)
    by_clock: list = field(default_factory=list)
    shifted: int = 0
    named: int = 0
    wrong_flights: int = 0
    cpu: float = 0.0

    def add(self, one: cases.Flight) -> None:
        begin = time.process_time()
        found = match_exposures(one.photos, one.events)
        self.cpu += time.process_time() - begin
        right = found.event == one.event
        sure = found.confidence >= 0.99
        self.confidence.append(found.confidence)
        self.right.append(right)
        both = (found.event >= 0) & (one.event >= 0)
        # more than half of the pairs off, surely: the whole sequence is shifted
        self.shifted += int(2 * np.sum(both & sure & ~right) > max(1, np.sum(both)))
        self.named += bool(found.alternatives)
        self.wrong_flights += int(np.mean(right) < 0.5)
        error, good = (found.time - one.time) / found.sigma, right & sure
        self.by_event.append(error[good & (found.event >= 0)])
        self.by_clock.append(error[good & (found.event < 0)])
        if np.mean(right) > 0.5:
            fit = found.clock
            truth = one.offset + one.drift * (fit.epoch - cases.START)
            sigma = np.sqrt(np.diag(fit.covariance))
            self.clock.append(np.array([fit.offset - truth, fit.drift - one.drift]) / sigma)

    def figures(self, name: str, flights: int) -> None:
        confidence, right = np.concatenate(self.confidence), np.concatenate(self.right)
        sure = confidence >= 0.99
        print(f"\n{name}: {flights} flights, {len(right)} photos")
        print(f"  claim >= 99 %              {100 * sure.mean():.2f} %")
        print(
            f"  of these wrong             {100 * np.mean(~right[sure]) if sure.any() else 0:.3f} %"
        )
        print(f"  whole shifts above 99 %    {self.shifted} flights")
        print(f"  whole flights wrong        {self.wrong_flights}, ambiguity named in {self.named}")
        if self.clock:
            offset, drift = np.sqrt(np.mean(np.square(self.clock), axis=0))
            print(f"  error/sigma, rms           offset {offset:.2f}, drift {drift:.2f}")
        for label, parts in (("events", self.by_event), ("clock", self.by_clock)):
            z = np.concatenate(parts)
            if len(z):
                print(f"  times by {label:6s}            {np.sqrt(np.mean(z**2)):.2f} ({len(z)})")
        print(f"  CPU                        {1000 * self.cpu / flights:.0f} ms a flight")
        print("  claimed          photos   mean claim   right")
        for low, high in pairwise(BINS):
            k = (confidence >= low) & (confidence < high)
            if k.any():
                print(
                    f"  {low:6.4f}-{min(high, 1):6.4f} {k.sum():8d}   {confidence[k].mean():.5f}"
                    f"      {right[k].mean():.5f}"
                )


def run(name: str, flights: int, seed: int, **more) -> None:
    tally = Tally()
    for k in range(flights):
        tally.add(cases.flight(np.random.default_rng(seed + k), **more))
    tally.figures(name, flights)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--flights", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    # compiles
    match_exposures(*(lambda f: (f.photos, f.events))(cases.flight(np.random.default_rng(0))))
    run("surveys", given.flights, given.seed)
    tenth = max(10, given.flights // 5)
    for interval in (1.0, 3.0):
        run(
            f"intervalometer {interval:.3f} s", tenth, given.seed,
            triggers=lambda g, n, interval=interval: cases.regular_triggers(g, n, interval),
        )  # fmt: skip
    for resolution in (1.0, 0.01):
        one = cases.flight(np.random.default_rng(given.seed), count=1000, resolution=resolution)
        begin = time.process_time()
        match_exposures(one.photos, one.events)
        cpu = time.process_time() - begin
        print(
            f"\n{len(one.photos)} photos x {len(one.events)} events, cut to {resolution} s: "
            f"{cpu:.2f} CPU s"
        )


if __name__ == "__main__":
    main()
