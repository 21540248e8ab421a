"""Runs the sites of a batch, several at once; none stops the others."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from georef_gis.app.batch.process import Outcome, SiteProcess
from georef_gis.app.batch.sites import Site
from georef_gis.toolbox.context import Feedback

# s between two looks at the processes
PAUSE = 0.05


@dataclass(frozen=True, slots=True, kw_only=True)
class Wishes:
    """How the sites are run.

    Parameters
    ----------
    jobs
        Sites at once.
    arguments
        Of `georef run`, alike for all.
    logs
        Folder of a file per site with all that was said.
    limit_s
        Of a single site; 0 = none.
    """

    jobs: int
    arguments: tuple[str, ...]
    logs: Path
    limit_s: float = 0.0

    def log_of(self, site: Site) -> Path:
        """File with what was said of a site."""
        return self.logs / f"{site.name.replace('/', '__')}.jsonl"


def run_sites(
    sites: Sequence[Site],
    wishes: Wishes,
    feedback: Feedback,
    *,
    unchanged: Callable[[Site], Outcome | None],
    finished: Callable[[Outcome], None],
) -> list[Outcome]:
    """Run the sites; what became of each, in order of `sites`.

    Parameters
    ----------
    unchanged
        The outcome of a site that needs no process: nothing to do, or nothing that can be done.
    finished
        Told of every outcome at once, so that a table is there after a crash too.
    """
    waiting, running = list(sites), list[SiteProcess]()
    outcomes: dict[Site, Outcome] = {}

    def end(outcome: Outcome) -> None:
        outcomes[outcome.site] = outcome
        finished(outcome)

    try:
        while waiting or running:
            while waiting and len(running) < wishes.jobs:
                site = waiting.pop(0)
                if settled := unchanged(site):
                    end(settled)
                else:
                    running.append(
                        SiteProcess(site, wishes.arguments, wishes.log_of(site), wishes.limit_s)
                    )
            running = _look(running, end)
            share = len(outcomes) + sum(process.fraction for process in running)
            names = ", ".join(process.site.name for process in running[:3])
            feedback.progress(share / len(sites), names)
            if running:
                time.sleep(PAUSE)
    except KeyboardInterrupt:
        _stop(running, end)
    for site in waiting:
        end(Outcome(site=site, state="cancelled", duration_s=0.0, message="cancelled before it"))
    return [outcomes[site] for site in sites if site in outcomes]


def _look(running: Sequence[SiteProcess], end: Callable[[Outcome], None]) -> list[SiteProcess]:
    """Processes that still run; the others are reported."""
    left = []
    for process in running:
        outcome = process.poll()
        if outcome is None:
            left.append(process)
        else:
            end(outcome)
    return left


def _stop(running: Sequence[SiteProcess], end: Callable[[Outcome], None]) -> None:
    for process in running:
        process.stop()
    left = list(running)
    while left:
        left = _look(left, end)
        time.sleep(PAUSE)
