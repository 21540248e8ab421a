"""Feedback of the command line: a progress bar, plain lines, or lines of JSON."""

from __future__ import annotations

import json
import math
import signal
import sys
import threading
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

from georef_gis.app.grouping import grouped

# s between two messages of progress
PAUSE = 0.1


class Stop:
    """Whether the user wants to stop. The first signal also interrupts what is going on."""

    def __init__(self) -> None:
        self.wanted = False

    def __call__(self, number: int, frame: FrameType | None) -> None:
        """Take a signal."""
        self.wanted = True
        raise KeyboardInterrupt

    @contextmanager
    def listening(self) -> Iterator[Stop]:
        """Listen to SIGINT and SIGTERM, in the main thread."""
        if threading.current_thread() is not threading.main_thread():
            yield self
            return
        before = {number: signal.signal(number, self) for number in (signal.SIGINT, signal.SIGTERM)}
        try:
            yield self
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)


class PlainFeedback:
    """Warnings and messages on standard error; progress is not shown.

    Warnings are kept until the end, where those about many photos, or whatever else they are
    `about`, become one line, and what the report of the run says too is not said twice.
    """

    def __init__(self, stop: Stop, about: str = "photos") -> None:
        self.stop = stop
        self.about = about
        self._warnings: list[str] = []

    def __enter__(self) -> PlainFeedback:
        """Begin."""
        return self

    def __exit__(self, *error: object) -> None:
        """End: say what was kept."""
        self.say_warnings()

    def say_warnings(self, told: Iterable[str] = ()) -> None:
        """Write the warnings kept, but for those that are told elsewhere."""
        kept, self._warnings = self._warnings, []
        left = dict.fromkeys(kept)
        for message in told:
            left.pop(message, None)
        for line in grouped(list(left), self.about):
            self._line(f"warning: {line}")

    def progress(self, fraction: float, message: str = "") -> None:
        """Show nothing: lines would fill a log."""

    def warn(self, message: str) -> None:
        """Keep it for the end."""
        self._warnings.append(message)

    def info(self, message: str) -> None:
        """Write a line."""
        self._line(message)

    def cancelled(self) -> bool:
        """Whether a signal came."""
        return self.stop.wanted

    def _line(self, text: str) -> None:
        print(text, file=sys.stderr, flush=True)


class BarFeedback(PlainFeedback):
    """A progress bar in a terminal, with the lines above it."""

    def __init__(self, stop: Stop, about: str = "photos") -> None:
        super().__init__(stop, about)
        self._bar: Any = None
        self._task: Any = None

    def progress(self, fraction: float, message: str = "") -> None:
        """Move the bar, which appears with the first progress."""
        if self._bar is None:
            self._start()
        self._bar.update(self._task, completed=fraction, description=message[:40])

    def _start(self) -> None:
        # Not at the head of the module: rich takes as long to import as all the rest.
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn
        from rich.progress import TimeRemainingColumn as Remaining

        columns = (TextColumn("{task.description:<40}", markup=False), BarColumn(),
                   TaskProgressColumn(), Remaining())  # fmt: skip
        self._bar = Progress(*columns, console=Console(stderr=True), transient=True)
        self._task = self._bar.add_task("", total=1.0)
        self._bar.start()

    def __exit__(self, *error: object) -> None:
        """Take the bar away, then say what was kept."""
        if self._bar is not None:
            self._bar.stop()
            self._bar = None
        self.say_warnings()

    def _line(self, text: str) -> None:
        if self._bar is None:
            super()._line(text)
        else:
            self._bar.console.print(text, markup=False, highlight=False, soft_wrap=True)


class JsonFeedback(PlainFeedback):
    """One JSON object a line on standard output, for another program."""

    def __init__(self, stop: Stop) -> None:
        super().__init__(stop)
        self._next = 0.0

    def progress(self, fraction: float, message: str = "") -> None:
        """Write an event, at most ten a second and the last one."""
        now = time.monotonic()
        if now >= self._next or fraction >= 1.0:
            self._next = now + PAUSE
            self.event("progress", fraction=round(fraction, 4), message=message)

    def warn(self, message: str) -> None:
        """Write an event."""
        self.event("warning", message=message)

    def info(self, message: str) -> None:
        """Write an event."""
        self.event("info", message=message)

    def event(self, event: str, **content: Any) -> None:
        """Write an event of any kind."""
        print(json.dumps(plain({"event": event, **content})), flush=True)


def plain(value: Any) -> Any:
    """What JSON can hold: a missing number is null, as NaN is no JSON."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, bool | int | str):
        return value
    return plain(value.item()) if hasattr(value, "item") else str(value)


def make_feedback(*, as_json: bool, stop: Stop, about: str = "photos") -> PlainFeedback:
    """Feedback that fits where the output goes; `about` as of a tool."""
    if as_json:
        return JsonFeedback(stop)
    return BarFeedback(stop, about) if sys.stderr.isatty() else PlainFeedback(stop, about)
