"""What other programs are there that georef works with: QGIS, a browser, PostGIS."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Iterator, Sequence
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path

from georef_gis.app.findings import Finding, State

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
# Debian's wrapper `qgis_process` fails at every call; the program itself is beside it.
QGIS = ("qgis_process.bin", "qgis_process", "qgis_process-qgis", "qgis_process-qgis-ltr", "qgis")
# Where installers put QGIS without making it a command
QGIS_FOLDERS = {
    "win32": ("C:/Program Files/QGIS*/bin", "C:/OSGeo4W/bin"),
    "darwin": ("/Applications/QGIS*.app/Contents/MacOS/bin",),
}
DRIVER = "psycopg"


def outside_findings() -> Iterator[Finding]:
    """Findings; what is not there is no fault of the installation, only less that can be done."""
    yield from _qgis()
    yield from _browser()
    yield from _postgis()


def _qgis() -> Iterator[Finding]:
    program = _command(QGIS, QGIS_FOLDERS.get(sys.platform, ()))
    told = program or "not found; layers still open in any QGIS elsewhere"
    yield Finding(subject="QGIS", state="ok", message=told)
    from georef_gis.app.qgis import profile_states

    states = profile_states()
    for title, words, fine in states:
        state: State = "ok" if fine else "doubtful"
        yield Finding(subject="QGIS plug-in", state=state, message=f"{title}: {words}")
    if program and not states:
        message = "in no profile; `georef qgis install --profile default`"
        yield Finding(subject="QGIS plug-in", state="ok", message=message)


def _browser() -> Iterator[Finding]:
    program = _command(BROWSERS)
    message = program or "not found; any other browser shows the page"
    if find_spec("playwright") is not None and not program:
        message += ", but the tests cannot look at it"
    yield Finding(subject="Chromium", state="ok", message=message)


def _postgis() -> Iterator[Finding]:
    try:
        message = f"{DRIVER} {version(DRIVER)}, for `georef export-postgis`"
    except PackageNotFoundError:
        message = f'{DRIVER} is not installed; pip install "georef-gis[postgis]"'
    yield Finding(subject="PostGIS driver", state="ok", message=message)
    controls = sorted(Path("/usr/share/postgresql").glob("*/extension/postgis.control"))
    server = ", ".join(f"PostgreSQL {path.parents[1].name}" for path in controls)
    message = f"{server} with PostGIS" if server else "none on this machine; one elsewhere will do"
    yield Finding(subject="PostGIS server", state="ok", message=message)


def _command(names: Sequence[str], patterns: Sequence[str] = ()) -> str | None:
    """Path of the first program there is, as a command or in one of some folders."""
    for name in names:
        if found := shutil.which(name):
            return found
    for pattern in patterns:
        root = Path(pattern).anchor
        for folder in sorted(Path(root).glob(os.path.relpath(pattern, root)), reverse=True):
            for name in names:
                if found := shutil.which(name, path=str(folder)):
                    return found
    return None
