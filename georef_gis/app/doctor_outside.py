"""What other programs are there that georef works with: QGIS, a browser, PostGIS."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from georef_gis.app.findings import Finding, State

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
# Debian's wrapper `qgis_process` fails at every call; the program itself is beside it.
QGIS = ("qgis_process.bin", "qgis_process", "qgis_process-qgis", "qgis_process-qgis-ltr", "qgis")
# Where installers put programs without making them commands
QGIS_FOLDERS = {
    "win32": ("C:/Program Files/QGIS*/bin", "C:/OSGeo4W/bin"),
    "darwin": ("/Applications/QGIS*.app/Contents/MacOS/bin",),
}
BROWSER_FOLDERS = {
    "win32": (
        "C:/Program Files/Google/Chrome/Application",
        "C:/Program Files (x86)/Google/Chrome/Application",
    ),
}
DRIVER = "psycopg"
# Folders of a server's extensions, of Debian, Red Hat, Windows, and Homebrew
EXTENSIONS = (
    "/usr/share/postgresql/*/extension",
    "/usr/pgsql-*/share/extension",
    "C:/Program Files/PostgreSQL/*/share/extension",
    "/opt/homebrew/share/postgresql*/extension",
)
# s that a program may take to tell its version
PATIENCE = 30.0


def outside_findings() -> Iterator[Finding]:
    """Findings; what is not there is no fault of the installation, only less that can be done."""
    parts: tuple[Callable[[], Iterator[Finding]], ...] = (_qgis, _plug_in, _browser, _postgis)
    # Starting three programs one after the other would take seconds.
    with ThreadPoolExecutor(len(parts)) as pool:
        for found in pool.map(lambda part: list(part()), parts):
            yield from found


def _qgis() -> Iterator[Finding]:
    program = _command(QGIS, QGIS_FOLDERS.get(sys.platform, ()))
    yield _program("QGIS", program, "layers and styles open in any QGIS elsewhere")


def _program(subject: str, found: str | None, without: str) -> Finding:
    if found is None:
        return Finding(subject=subject, state="absent", message=f"not found on PATH; {without}")
    state, told = _tried(found)
    return Finding(subject=subject, state=state, message=told)


def _plug_in() -> Iterator[Finding]:
    from georef_gis.app.qgis import profile_states

    states = profile_states()
    for title, words, fine in states:
        state: State = "ok" if fine else "doubtful"
        yield Finding(subject="QGIS plug-in", state=state, message=f"{title}: {words}")
    if not states and _command(QGIS, QGIS_FOLDERS.get(sys.platform, ())):
        message = "in no profile; `georef qgis install` puts it there"
        yield Finding(subject="QGIS plug-in", state="absent", message=message)


def _browser() -> Iterator[Finding]:
    program = _command(BROWSERS, BROWSER_FOLDERS.get(sys.platform, ()))
    yield _program("Chromium", program, "any browser shows the page, only its tests need this one")


def _postgis() -> Iterator[Finding]:
    state: State = "ok"
    try:
        message = f"{DRIVER} {version(DRIVER)}, for `georef export-postgis`"
    except PackageNotFoundError:
        state, message = "absent", f'{DRIVER}; pip install "georef-gis[postgis]"'
    yield Finding(subject="PostGIS driver", state=state, message=message)
    state, message = _server([path for pattern in EXTENSIONS for path in _glob(pattern)])
    yield Finding(subject="PostGIS server", state=state, message=message)


def _server(folders: Sequence[Path]) -> tuple[State, str]:
    """What is installed on this machine, by folders of extensions; not whether it runs."""
    names = {_version(path): path for path in folders}
    fine = [name for name, path in names.items() if (path / "postgis.control").is_file()]
    if fine:
        told = ", ".join(f"PostgreSQL {name}" for name in fine)
        return "ok", f"{told} with PostGIS is installed here"
    if names:
        told = ", ".join(f"PostgreSQL {name}" for name in names)
        return "absent", f"{told} without PostGIS; install that too, or use a server elsewhere"
    return "absent", "none installed here; one elsewhere will do"


def _version(folder: Path) -> str:
    """Version of PostgreSQL by a folder of extensions: /usr/share/postgresql/15/extension."""
    numbers = (re.search(r"\d+(\.\d+)?", part) for part in reversed(folder.parts[:-1]))
    return next((number[0] for number in numbers if number), folder.parent.name)


def _command(names: Sequence[str], patterns: Sequence[str] = ()) -> str | None:
    """Path of the first program there is, as a command or in one of some folders."""
    for name in names:
        if found := shutil.which(name):
            return found
    for folder in (folder for pattern in patterns for folder in _glob(pattern)):
        for name in names:
            if found := shutil.which(name, path=str(folder)):
                return found
    return None


def _glob(pattern: str) -> list[Path]:
    """Folders of an absolute pattern, the newest version first."""
    root = Path(pattern).anchor
    return sorted(Path(root).glob(os.path.relpath(pattern, root)), reverse=True)


def _tried(program: str) -> tuple[State, str]:
    """Version and place of a program, or what happens when it is asked for its version."""
    if sys.platform == "win32":
        # There it would open a window.
        return "ok", program
    with tempfile.TemporaryDirectory(prefix="georef-doctor-") as home:
        try:
            done = subprocess.run(
                [program, "--version"],
                stdin=subprocess.DEVNULL,
                capture_output=True,
                env=_clean_environment(home),
                timeout=PATIENCE,
                check=False,
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            reason = getattr(error, "strerror", None) or f"no answer in {PATIENCE:g} s"
            return "doubtful", f"{program}: does not start ({reason}); install it again"
    found = re.search(rb"\d+(?:\.\d+)+", done.stdout)
    if done.returncode or found is None:
        told = f"code {done.returncode}" if done.returncode else "no version told"
        return "doubtful", f"{program}: does not start ({told}); install it again"
    return "ok", f"{found.group().decode()}, {program}"


def _clean_environment(home: str) -> dict[str, str]:
    """Environment for another program: QGIS makes a profile at once, and a venv makes it crash."""
    own = str(Path(sys.executable).parent)
    path = [part for part in os.get_exec_path() if os.path.abspath(part) != own]
    return {"HOME": home, "XDG_RUNTIME_DIR": home, "QT_QPA_PLATFORM": "offscreen",
            "PATH": os.pathsep.join([*path, "/usr/bin", "/bin"]), "LANG": "C.UTF-8"}  # fmt: skip
