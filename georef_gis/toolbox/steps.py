"""What is asked of a run, and what a run says of its steps."""

from __future__ import annotations

import os
from dataclasses import dataclass, field

from georef_gis.toolbox.algorithm import Result
from georef_gis.toolbox.context import Feedback
from georef_gis.toolbox.registry import Tool


@dataclass(frozen=True, slots=True, kw_only=True)
class StepReport:
    """What became of one step.

    Parameters
    ----------
    skipped
        The last run still holds; `result` is what that gave.
    reason
        Why it ran.
    """

    tool: Tool
    skipped: bool
    reason: str
    duration_s: float
    result: Result


@dataclass(frozen=True, slots=True, kw_only=True)
class RunOptions:
    """Wishes for a run.

    Parameters
    ----------
    only
        Ids of the steps to look at; empty = all.
    start
        Id of the step to begin with: it runs whether or not it is stale.
    force
        Run what is not stale too.
    verify
        Hash inputs and outputs as a whole.
    """

    only: tuple[str, ...] = ()
    start: str = ""
    quick: bool = False
    force: bool = False
    verify: bool = False
    workers: int = 0
    seed: int | None = None


@dataclass(slots=True)
class StepFeedback:
    """Feedback of one step: maps its progress into that of the run, and keeps its warnings."""

    inner: Feedback
    first: float = 0.0
    share: float = 1.0
    warnings: list[str] = field(default_factory=list)

    def progress(self, fraction: float, message: str = "") -> None:
        """Pass on, as a fraction of the whole run."""
        self.inner.progress(self.first + self.share * min(max(fraction, 0.0), 1.0), message)

    def warn(self, message: str) -> None:
        """Pass on and keep."""
        self.warnings.append(message)
        self.inner.warn(message)

    def info(self, message: str) -> None:
        """Pass on."""
        self.inner.info(message)

    def cancelled(self) -> bool:
        """Whether the user wants to stop."""
        return self.inner.cancelled()


def default_workers() -> int:
    """Number of processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
