"""What a process costs, as the operating system counts it: for benchmarks that run commands."""

from __future__ import annotations

import multiprocessing
import os
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any


@dataclass(frozen=True, slots=True, kw_only=True)
class Cost:
    """Of one finished process, start-up and its children included.

    Parameters
    ----------
    cpu, wall : s
        User + system time; time on the clock.
    peak : MB
        Largest memory of the process.
    load
        Load average of the machine at the start, over one minute.
    failure
        Why it did not end well, empty if it did.
    """

    cpu: float
    wall: float
    peak: float
    load: float
    failure: str
    output: str


def cost_of(
    command: Sequence[str],
    *,
    limit: float = 3600.0,
    environment: Mapping[str, str] | None = None,
    folder: Path | None = None,
) -> Cost:
    """Run a command to its end, or kill it after `limit` seconds."""
    load, start = os.getloadavg()[0], time.perf_counter()
    with tempfile.TemporaryFile() as told:
        process = subprocess.Popen(
            command, stdout=told, stderr=subprocess.STDOUT, cwd=folder,
            env={**os.environ, **(environment or {})},
        )  # fmt: skip
        timer = threading.Timer(limit, process.kill)
        timer.start()
        _, status, usage = os.wait4(process.pid, 0)
        timer.cancel()
        wall = time.perf_counter() - start
        told.seek(0)
        output = told.read().decode(errors="replace")
    failure = ""
    if status:
        last = (output.strip().splitlines() or ["no message"])[-1]
        failure = f"stopped after {limit:.0f} s" if wall >= limit else last[:300]
    return Cost(
        cpu=usage.ru_utime + usage.ru_stime, wall=wall, peak=usage.ru_maxrss / 1024, load=load,
        failure=failure, output=output,
    )  # fmt: skip


def apart(function: Callable[..., None], *args: Any) -> None:
    """Call a function in a process of its own.

    The system counts the peak of the process that starts a command as the command's own, so
    whoever measures commands must never hold much itself.
    """
    process = multiprocessing.get_context("spawn").Process(target=function, args=args)
    process.start()
    process.join()
    if process.exitcode:
        raise SystemExit(f"{function.__name__} failed")
