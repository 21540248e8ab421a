"""RTKLIB at arm's length: a child process with a time limit, whose end is told in one line."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from georef_gis.errors import InputError


def run_worker(
    job: dict[str, Any], folder: Path, source: Path, *, timeout: float, check: Callable[[], None]
) -> dict[str, Any]:
    """Run `ppk_worker.py` on a job in a folder; its report.

    Parameters
    ----------
    source
        File to name in errors.
    timeout : s
    check
        Called some times a second; what it raises ends the child.

    Raises
    ------
    InputError
        If the child crashes, fails or takes too long.
    """
    file, report, said = (folder / name for name in ("job.json", "report.json", "said.txt"))
    report.unlink(missing_ok=True)
    file.write_text(json.dumps(job | {"report": str(report)}), encoding="utf-8")
    worker = Path(__file__).with_name("ppk_worker.py")
    # The worker finds pyrtklib where this process would, and nothing that lies beside itself.
    paths = os.pathsep.join(path for path in sys.path if path)
    with said.open("wb") as stream:
        child = subprocess.Popen(
            [sys.executable, "-P", str(worker), str(file)],
            stdout=stream, stderr=stream, stdin=subprocess.DEVNULL, cwd=folder,
            env=os.environ | {"PYTHONPATH": paths},
        )  # fmt: skip
        try:
            _wait(child, source, timeout, check)
        finally:
            if child.poll() is None:
                child.kill()
                child.wait()
    if child.returncode != 0 or not report.exists():
        code = child.returncode
        ending = f"signal {-code}" if code < 0 else f"exit code {code}"
        raise InputError(
            f"RTKLIB's process broke off ({ending}): {_last_line(said)}; check the raw files",
            source=str(source),
        )
    done: dict[str, Any] = json.loads(report.read_text(encoding="utf-8"))
    return done


def _wait(
    child: subprocess.Popen[bytes], source: Path, timeout: float, check: Callable[[], None]
) -> None:
    end = time.monotonic() + timeout
    while True:
        try:
            child.wait(0.1)
            return
        except subprocess.TimeoutExpired:
            check()
        if time.monotonic() > end:
            raise InputError(
                f"RTKLIB is not done after {timeout:g} s; raise the timeout or cut the files to "
                "the flight",
                source=str(source),
            )


def _last_line(file: Path) -> str:
    lines = [line.strip() for line in file.read_text(errors="replace").splitlines() if line.strip()]
    return lines[-1][:160] if lines else "it said nothing"
