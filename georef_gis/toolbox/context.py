"""What a tool is given besides its parameters: the context of a run, and the way to talk back."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from georef_gis.errors import Cancelled, InputError

if TYPE_CHECKING:
    from georef_gis.project import Project


@runtime_checkable
class Feedback(Protocol):
    """Progress, messages and the wish to stop; passed in, never global."""

    def progress(self, fraction: float, message: str = "") -> None:
        """Say how much of the work is done, 0 to 1."""

    def warn(self, message: str) -> None:
        """Tell the user of something doubtful; it is recorded with the run."""

    def info(self, message: str) -> None:
        """Tell the user something in one line."""

    def cancelled(self) -> bool:
        """Whether the user wants the work to stop."""


def check_cancelled(feedback: Feedback) -> None:
    """Stop here if the user wants to.

    Raises
    ------
    Cancelled
        Do not catch it with the errors of a single photo: it is a `GeorefError` too.
    """
    if feedback.cancelled():
        raise Cancelled("stopped by the user")


@dataclass(frozen=True, slots=True, kw_only=True)
class Context:
    """Surroundings of one run of a tool.

    Parameters
    ----------
    project
        None for a tool that needs none.
    workers
        Number of local processes or threads to use.
    seed
        Of every random choice.
    cache
        Folder for what may be deleted at any time; made by the runner.
    quick
        The user wants a first answer, from the poses alone.
    run_id
        Number of the run's record, for rows that name it; None without a project.
    """

    project: Project | None = None
    workers: int = 1
    seed: int = 0
    cache: Path = Path("cache")
    quick: bool = False
    run_id: int | None = None

    def require_project(self) -> Project:
        """Project of the run.

        Raises
        ------
        InputError
            If the tool was started without one.
        """
        if self.project is None:
            raise InputError("this tool works on a project; give one with --project FOLDER")
        return self.project


@dataclass(slots=True)
class CollectingFeedback:
    """Feedback that keeps everything, for tests and for calls from Python."""

    stop_at: float = 2.0
    fractions: list[float] = field(default_factory=list)
    messages: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    infos: list[str] = field(default_factory=list)

    def progress(self, fraction: float, message: str = "") -> None:
        """Keep the fraction and the message."""
        self.fractions.append(fraction)
        self.messages.append(message)

    def warn(self, message: str) -> None:
        """Keep the warning."""
        self.warnings.append(message)

    def info(self, message: str) -> None:
        """Keep the message."""
        self.infos.append(message)

    def cancelled(self) -> bool:
        """Whether progress came to `stop_at`."""
        return bool(self.fractions) and self.fractions[-1] >= self.stop_at
