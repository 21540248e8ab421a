"""A PostgreSQL with PostGIS of our own: in a temporary folder, on a socket alone."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

_BINARIES = sorted(Path("/usr/lib/postgresql").glob("*/bin"))
_EXTENSION = sorted(Path("/usr/share/postgresql").glob("*/extension/postgis.control"))
# initdb refuses root; Debian's package makes this user
USER = "postgres"


@contextmanager
def server() -> Iterator[str]:
    """Connection string of a database with PostGIS; skips where there is none to start."""
    if not _BINARIES or not _EXTENSION:
        pytest.skip("postgresql and postgis are not installed (apt install postgis "
                    "postgresql-postgis)")  # fmt: skip
    # a socket's path has 107 characters at most
    folder = Path(tempfile.mkdtemp(prefix="pg", dir="/tmp"))
    try:
        if os.geteuid() == 0:
            shutil.chown(folder, USER)
        data = folder / "data"
        _run(["initdb", "-D", str(data), "-U", USER, "-A", "trust", "-E", "UTF8", "--no-sync"])
        options = f"-c listen_addresses='' -c unix_socket_directories={folder} -c fsync=off"
        _run(["pg_ctl", "-D", str(data), "-w", "-l", str(folder / "log"), "-o", options, "start"])
        try:
            connection = f"host={folder} user={USER} dbname=postgres"
            _run(["psql", "-q", connection, "-c", "CREATE EXTENSION postgis"])
            yield connection
        finally:
            _run(["pg_ctl", "-D", str(data), "-m", "immediate", "stop"])
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _run(words: list[str]) -> None:
    binary = str(_BINARIES[-1] / words[0])
    if not Path(binary).exists():
        binary = words[0]
    become = ["runuser", "-u", USER, "--"] if os.geteuid() == 0 else []
    environment = {"PATH": "/usr/bin:/bin:/usr/sbin:/sbin", "LC_ALL": "C.UTF-8"}
    done = subprocess.run(
        [*become, binary, *words[1:]], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
        text=True, env=environment, cwd="/tmp",
    )  # fmt: skip
    if done.returncode:
        raise RuntimeError(f"{words[0]}: {done.stderr}")
