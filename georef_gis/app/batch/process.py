"""One site of a batch: `georef run` in a process of its own, which cannot harm the others."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Literal

from georef_gis.app.batch.sites import Site
from georef_gis.app.facing import BUG, CANCELLED, DONE

State = Literal["done", "unchanged", "failed", "bug", "cancelled"]
# s that a process has to end after it was asked to
PATIENCE = 10.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What became of a site.

    Parameters
    ----------
    message
        Why it failed, one line; empty if it did not.
    """

    site: Site
    state: State
    duration_s: float
    message: str = ""


class SiteProcess:
    """A running `georef run`. Its events go to a log and tell how far it is."""

    def __init__(self, site: Site, arguments: Sequence[str], log: Path, limit_s: float) -> None:
        self.site = site
        self.fraction = 0.0
        self._log = log
        self._limit_s = limit_s
        self._begun = time.monotonic()
        self._error = ""
        self._late = False
        self._stopped = False
        log.parent.mkdir(parents=True, exist_ok=True)
        self._stream = log.open("w", encoding="utf-8")
        self._process = subprocess.Popen(
            [sys.executable, "-m", "georef_gis.app", "run", str(site.folder), "--json", *arguments],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=self._stream,
            text=True,
            encoding="utf-8",
            errors="replace",
            env={**os.environ, "PYTHONUTF8": "1", "PYTHONUNBUFFERED": "1"},
            **_own_group(),
        )
        assert self._process.stdout is not None
        self._reader = threading.Thread(target=self._read, args=(self._process.stdout,))
        self._reader.start()

    @property
    def pid(self) -> int:
        """Number of the process."""
        return self._process.pid

    def _read(self, lines: IO[str]) -> None:
        with lines:
            for line in lines:
                with contextlib.suppress(ValueError):
                    self._take(json.loads(line))
                self._stream.write(line)

    def _take(self, event: Mapping[str, Any]) -> None:
        if event.get("event") == "progress":
            self.fraction = float(event["fraction"])
        elif event.get("event") == "error":
            self._error = str(event["message"])

    def poll(self) -> Outcome | None:
        """What became of it; None while it runs. Ends it where it takes longer than allowed."""
        code = self._process.poll()
        if code is None:
            spent = time.monotonic() - self._begun
            if self._limit_s and spent > self._limit_s and not self._late:
                self._late = True
                self.stop()
            return None
        self._reader.join()
        self._stream.close()
        spent = time.monotonic() - self._begun
        state, message = self._verdict(code)
        return Outcome(site=self.site, state=state, duration_s=spent, message=message)

    def stop(self) -> None:
        """Ask it to end, and its own processes with it; make it end where it does not."""
        self._stopped = True
        _interrupt(self._process)
        threading.Thread(target=self._insist, daemon=True).start()

    def _insist(self) -> None:
        try:
            self._process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            _kill(self._process)

    def _verdict(self, code: int) -> tuple[State, str]:
        if code == DONE:
            return "done", ""
        if self._late:
            minutes = self._limit_s / 60.0
            return "failed", f"took longer than {minutes:g} min (--limit); it goes on from there"
        if code == CANCELLED or self._stopped:
            return "cancelled", "cancelled"
        if code < 0:
            name = signal.Signals(-code).name if -code in list(signal.Signals) else str(-code)
            hint = "; memory may be used up: try fewer --jobs" if name == "SIGKILL" else ""
            return "bug", f"its process was ended by {name}{hint}; see {self._log}"
        message = self._error or f"ended with code {code}; see {self._log}"
        return ("bug" if code == BUG else "failed"), message


def _own_group() -> dict[str, Any]:
    """A group of its own, so that a Ctrl-C reaches it by us alone, and its children with it."""
    if sys.platform == "win32":
        return {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}
    return {"start_new_session": True}


def _interrupt(process: subprocess.Popen[str]) -> None:
    with contextlib.suppress(OSError):
        if sys.platform == "win32":
            process.send_signal(signal.CTRL_BREAK_EVENT)
        else:
            process.send_signal(signal.SIGINT)


def _kill(process: subprocess.Popen[str]) -> None:
    with contextlib.suppress(OSError):
        if sys.platform == "win32":
            process.kill()
        else:
            os.killpg(process.pid, signal.SIGKILL)
