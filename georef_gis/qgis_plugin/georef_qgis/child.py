# SPDX-License-Identifier: GPL-2.0-or-later
"""Runs georef in a process of its own: JSON lines in, cancel out."""

from __future__ import annotations

import json
import os
import queue
import shlex
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import IO, Any

# Set by QGIS for its own Python, GDAL and Qt; georef has others.
FOREIGN = ("PYTHON", "GDAL_", "PROJ_", "QT_", "QGIS_", "LD_LIBRARY_PATH", "LD_PRELOAD", "DYLD_",
           "OSGEO4W", "GEOTIFF_CSV", "OGR_", "CPL_", "__PYVENV_LAUNCHER__")  # fmt: skip
# Of Windows' CreateProcess: a console program started by QGIS shows no window.
NO_WINDOW = 0x08000000
# s between two looks at the wish to stop
PAUSE = 0.05
# s that georef has to end in good order before it is killed, with all it started
GRACE = 0.5
# s that what georef wrote last may take to arrive after its end
LINGER = 1.0
CANCELLED = 130
# Lines of standard error that are kept for the message of a failure.
MOST_LINES = 20


@dataclass
class Outcome:
    """What became of a run; `error` is one line, empty if all is well."""

    cancelled: bool = False
    error: str = ""
    results: list[dict[str, Any]] = field(default_factory=list)


def clean_environment(given: Mapping[str, str]) -> dict[str, str]:
    """Environment without what QGIS set for itself."""
    kept = {k: v for k, v in given.items() if not k.upper().startswith(FOREIGN)}
    return {**kept, "PYTHONUTF8": "1"}


def start_options(platform: str) -> dict[str, Any]:
    """How a process is started: without a window, or as the head of a group to be ended."""
    return {"creationflags": NO_WINDOW} if platform == "win32" else {"start_new_session": True}


def typed(words: Sequence[str], platform: str = sys.platform) -> str:
    """Command as it is typed into a terminal."""
    return subprocess.list2cmdline(words) if platform == "win32" else shlex.join(words)


def run(
    command: Sequence[str],
    tell: Callable[[dict[str, Any]], None],
    cancelled: Callable[[], bool],
    folder: str | None = None,
) -> Outcome:
    """Run georef and hand on its events, until it ends or the user wants to stop.

    Parameters
    ----------
    tell
        Takes every event but results and errors: progress, warning, info, and lines that are
        no JSON as ``{"event": "text"}``.
    cancelled
        Asked twenty times a second.
    folder
        To work in.
    """
    try:
        child = _start(command, folder)
    except OSError as error:
        reason = error.strerror or str(error)
        return Outcome(error=f"{command[0]}: georef cannot be started ({reason}); {CURE}")
    outcome, lines = Outcome(), _Lines(child)
    try:
        while not lines.ended():
            if cancelled():
                outcome.cancelled = True
                return outcome
            _take(lines.next(PAUSE), outcome, tell)
    finally:
        _end(child)
    for event in lines.rest():
        _take(event, outcome, tell)
    _judge(child.returncode, outcome, lines.errors)
    return outcome


CURE = (
    "run `georef qgis install` again, or name the georef program under Settings > Options > "
    "Processing > Providers > georef"
)


def _start(command: Sequence[str], folder: str | None) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        list(command),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        cwd=folder,
        env=clean_environment(os.environ),
        **start_options(sys.platform),
    )


def read_event(text: str) -> dict[str, Any]:
    """Event of a line; a line that is none of georef's becomes a text."""
    plain = {"event": "text", "message": text}
    try:
        event = json.loads(text)
    except (ValueError, RecursionError):
        return plain
    if not (isinstance(event, dict) and isinstance(event.get("event"), str)):
        return plain
    types: dict[str, Any] = {"fraction": (int, float), "outputs": dict, "summary": dict,
                             "warnings": list}  # fmt: skip
    fits = (isinstance(event[name], kind) for name, kind in types.items() if name in event)
    return event if all(fits) else plain


class _Lines:
    """Lines of a process as they come, from both of its streams."""

    def __init__(self, child: subprocess.Popen[bytes]) -> None:
        self.child = child
        self.errors: list[str] = []
        self._waiting: queue.Queue[dict[str, Any]] = queue.Queue()
        self._threads = [
            threading.Thread(target=self._read, args=args, daemon=True)
            for args in ((child.stdout, self._event), (child.stderr, self._error))
        ]
        for thread in self._threads:
            thread.start()
        self._gone: float | None = None

    def ended(self) -> bool:
        """Whether the process is gone, and all that it wrote is here."""
        if self.child.poll() is None:
            return False
        self._gone = self._gone or time.monotonic()
        # A process that georef left behind keeps the streams open.
        late = time.monotonic() - self._gone > LINGER
        return late or not any(thread.is_alive() for thread in self._threads)

    def next(self, timeout: float) -> dict[str, Any] | None:
        """Next event, or None if there is none for a while."""
        try:
            return self._waiting.get(timeout=timeout)
        except queue.Empty:
            return None

    def rest(self) -> list[dict[str, Any]]:
        """Events that still wait."""
        found = []
        while not self._waiting.empty():
            found.append(self._waiting.get())
        return found

    def _read(self, stream: IO[bytes], take: Callable[[str], None]) -> None:
        with stream:
            for line in stream:
                text = line.decode("utf-8", "replace").rstrip()
                if text:
                    take(text)

    def _event(self, text: str) -> None:
        self._waiting.put(read_event(text))

    def _error(self, text: str) -> None:
        self.errors = [*self.errors, text][-MOST_LINES:]
        # The last line of a failure; it comes as an event too.
        if not text.startswith("georef: "):
            self._waiting.put({"event": "text", "message": text})


def _take(
    event: dict[str, Any] | None, outcome: Outcome, tell: Callable[[dict[str, Any]], None]
) -> None:
    if event is None:
        return
    if event["event"] == "result":
        outcome.results.append(event)
    elif event["event"] == "error":
        outcome.cancelled = event.get("exit_code") == CANCELLED
        outcome.error = " ".join(str(event.get("message", "")).split())
    else:
        tell(event)


def _judge(code: int, outcome: Outcome, errors: Sequence[str]) -> None:
    if code == 0 or outcome.cancelled or outcome.error:
        return
    if code < 0:
        outcome.error = f"georef was ended by signal {-code}; look whether memory was used up"
        return
    told = errors[-1] if errors else "it said nothing"
    if told.startswith("georef: "):
        told = told[len("georef: ") :]
    outcome.error = f"georef failed with code {code}: {told}"
    if "No module named" in told:
        outcome.error += f"; {CURE}"


def _end(child: subprocess.Popen[bytes]) -> None:
    """End the process and all that it started; in good order first."""
    if sys.platform == "win32":
        if child.poll() is None:
            tree = ["taskkill", "/F", "/T", "/PID", str(child.pid)]
            try:
                subprocess.run(tree, capture_output=True, check=False, creationflags=NO_WINDOW)
            except OSError:
                child.kill()
            child.wait()
        return
    if child.poll() is None:
        child.send_signal(signal.SIGINT)
        try:
            child.wait(GRACE)
        except subprocess.TimeoutExpired:
            pass
    try:
        # It leads a group of its own, which outlives it as long as it has children.
        os.killpg(child.pid, signal.SIGKILL)
    except (ProcessLookupError, PermissionError):
        pass
    child.wait()
