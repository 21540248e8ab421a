"""Runs of tools that the page started: one at a time, each in a process of its own."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from georef_gis.errors import GeorefError, InputError
from georef_gis.project import Project

State = Literal["runs", "done", "failed", "cancelled"]
# of which the page can ask
_KEPT_JOBS = 20
# that are kept of one run, without progress, of which the last counts
_MOST_EVENTS = 5000
# s from the wish to stop to the end by force; a tool stops within one tile
_PATIENCE = 20.0


class BusyError(GeorefError):
    """Another run works on the project."""


@dataclass(slots=True)
class Job:
    """A run: its events so far, as `georef --json` writes them.

    Attributes
    ----------
    started
        Seconds since the epoch.
    events
        All but those of progress, of which `progress` is the last.
    """

    id: int
    tool: str
    started: float
    events: list[dict[str, Any]] = field(default_factory=list)
    progress: dict[str, Any] = field(default_factory=dict)
    state: State = "runs"
    _process: subprocess.Popen[str] | None = None

    def told(self) -> dict[str, Any]:
        """JSON-able summary."""
        return {
            "id": self.id,
            "tool": self.tool,
            "started": self.started,
            "state": self.state,
            "progress": self.progress,
        }

    def run(self, order: dict[str, Any], folder: Path) -> None:
        """Start the process in a folder and read what it says, in threads."""
        # -P: a file called json.py in a project must not be taken for a module.
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "georef_gis.app.web.worker"], cwd=folder,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
            text=True, encoding="utf-8", errors="replace",
        )  # fmt: skip
        self._write(json.dumps(order))
        threading.Thread(target=self._read, daemon=True).start()

    def cancel(self) -> None:
        """Ask it to stop; end it by force if it does not within some seconds."""
        process = self._process
        if process is None or self.state != "runs":
            return
        self._write("stop")

        def insist() -> None:
            try:
                process.wait(_PATIENCE)
            except subprocess.TimeoutExpired:
                process.kill()

        threading.Thread(target=insist, daemon=True).start()

    def _write(self, line: str) -> None:
        process = self._process
        assert process is not None
        assert process.stdin is not None
        try:
            process.stdin.write(line + "\n")
            process.stdin.flush()
        except OSError:
            # It ended meanwhile; what it said tells why.
            return

    def _read(self) -> None:
        process = self._process
        assert process is not None
        assert process.stdout is not None
        assert process.stderr is not None
        errors: list[str] = []
        last = threading.Thread(target=lambda: errors.extend(_tail(process.stderr)), daemon=True)
        last.start()
        for line in process.stdout:
            self._take(line)
        code = process.wait()
        last.join()
        for stream in (process.stdin, process.stdout, process.stderr):
            if stream is not None:
                stream.close()
        self._end(code, errors)

    def _take(self, line: str) -> None:
        try:
            event = json.loads(line)
        except ValueError:
            event = {"event": "info", "message": line.strip()[:500]}
        if event.get("event") == "progress":
            self.progress = event
        elif len(self.events) < _MOST_EVENTS or event.get("event") in ("result", "error"):
            self.events.append(event)

    def _end(self, code: int, errors: list[str]) -> None:
        told = any(event.get("event") == "error" for event in self.events)
        if code and not told:
            why = errors[-1] if errors else f"its process ended with code {code}"
            self._take(json.dumps({"event": "error", "message": why, "exit_code": code}))
        self.state = "done" if code == 0 else "cancelled" if code == 130 else "failed"


def _tail(stream: Any) -> list[str]:
    """The last lines of a stream, read to its end."""
    lines: list[str] = []
    for line in stream:
        if line.strip():
            lines = [*lines[-20:], line.strip()[:500]]
    return lines


class Jobs:
    """Runs of a project."""

    def __init__(self, project: Project) -> None:
        self._project = project
        self._jobs: dict[int, Job] = {}
        self._lock = threading.Lock()
        self._next = 1

    def start(self, tool: str, values: dict[str, Any]) -> Job:
        """Start a run.

        Raises
        ------
        BusyError
            If one is going on.
        """
        with self._lock:
            running = self.running()
            if running is not None:
                raise BusyError(
                    f"tool {running.tool} is running; wait for its end, or cancel it first"
                )
            job = Job(id=self._next, tool=tool, started=time.time())
            self._next += 1
            self._jobs[job.id] = job
            for old in list(self._jobs)[:-_KEPT_JOBS]:
                del self._jobs[old]
            folder = self._project.folder
            job.run({"project": str(folder), "tool": tool, "values": values}, folder)
        return job

    def get(self, number: int) -> Job:
        """Run of a number.

        Raises
        ------
        InputError
            If there is none.
        """
        job = self._jobs.get(number)
        if job is None:
            raise InputError(f"no run {number}; it was started before the page was")
        return job

    def running(self) -> Job | None:
        """The run that is going on."""
        return next((job for job in self._jobs.values() if job.state == "runs"), None)

    def told(self) -> list[dict[str, Any]]:
        """Summaries, the oldest first."""
        return [job.told() for job in self._jobs.values()]

    def close(self) -> None:
        """Stop what is going on and wait for its end."""
        job = self.running()
        if job is None:
            return
        job.cancel()
        until = time.monotonic() + _PATIENCE
        while job.state == "runs" and time.monotonic() < until:
            time.sleep(0.05)
