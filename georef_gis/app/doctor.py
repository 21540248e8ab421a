"""`georef doctor`: what is installed, what was refused, and whether there is room to work."""

from __future__ import annotations

import os
import platform
import re
import shutil
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, requires, version
from importlib.util import find_spec
from pathlib import Path
from typing import Literal

from georef_gis import __version__
from georef_gis.toolbox.health import geodesy_findings, raster_findings
from georef_gis.toolbox.registry import Registry
from georef_gis.toolbox.steps import default_workers

State = Literal["ok", "doubtful", "bad"]
# bytes below which a site of a few hundred photos will not fit
LEAST_DISK = 5_000_000_000
# bytes, what the products are made within
LEAST_MEMORY = 1_000_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """One line of the examination."""

    subject: str
    state: State
    message: str

    def line(self) -> str:
        """Text for a terminal."""
        sign = {"ok": "ok  ", "doubtful": "??  ", "bad": "BAD "}[self.state]
        return f"{sign}{self.subject:<24} {self.message}"

    def content(self) -> dict[str, str]:
        """JSON-able content."""
        return {"subject": self.subject, "state": self.state, "message": self.message}


def examine(registry: Registry, folder: Path) -> list[Finding]:
    """Look at everything."""
    return [*_versions(), *_data(), *_plugins(registry), *_page(), *_machine(folder)]


def _versions() -> Iterator[Finding]:
    yield Finding(subject="georef_gis", state="ok", message=__version__)
    yield Finding(
        subject="python", state="ok", message=f"{platform.python_version()} ({sys.platform})"
    )
    for name in _required():
        try:
            yield Finding(subject=name, state="ok", message=version(name))
        except PackageNotFoundError:
            yield Finding(
                subject=name, state="bad", message=f"is not installed; pip install {name}"
            )


def _required() -> list[str]:
    """Libraries that this distribution asks for, without its extras."""
    names = []
    for requirement in requires("georef-gis") or ():
        name = re.match(r"[\w.-]+", requirement)
        if name and "extra ==" not in requirement:
            names.append(name.group())
    return names


def _data() -> Iterator[Finding]:
    for subject, fine, message in (*raster_findings(), *geodesy_findings()):
        yield Finding(subject=subject, state="ok" if fine else "doubtful", message=message)


def _plugins(registry: Registry) -> Iterator[Finding]:
    counts: dict[tuple[str, str], int] = {}
    for tool in registry:
        key = (tool.provider, f"{tool.distribution} {tool.version}")
        counts[key] = counts.get(key, 0) + 1
    for (provider, distribution), count in counts.items():
        message = f"{count} tools from {distribution}"
        yield Finding(subject=f"plug-in {provider}", state="ok", message=message)
    for error in registry.refused:
        yield Finding(subject="plug-in refused", state="doubtful", message=str(error))


def _page() -> Iterator[Finding]:
    """What `georef serve` needs, and the browser that its tests look at it with."""
    try:
        message = ", ".join(f"{name} {version(name)}" for name in ("fastapi", "uvicorn"))
    except PackageNotFoundError as error:
        message = f'{error.name} is not installed; pip install "georef-gis[web]"'
    yield Finding(subject="page (georef serve)", state="ok", message=message)
    if find_spec("playwright") is not None:
        found = shutil.which("chromium") or shutil.which("google-chrome")
        message = found or "not there: the page is not tested in a browser"
        yield Finding(subject="chromium", state="ok", message=message)


def _machine(folder: Path) -> Iterator[Finding]:
    there = folder if folder.is_dir() else Path(".")
    try:
        with tempfile.NamedTemporaryFile(dir=there, prefix=".georef-"):
            pass
        yield Finding(subject="write permission", state="ok", message=str(there.absolute()))
    except OSError as error:
        message = f"{there.absolute()}: {error.strerror}; work in another folder"
        yield Finding(subject="write permission", state="bad", message=message)
    free = shutil.disk_usage(there).free
    state: State = "ok" if free >= LEAST_DISK else "doubtful"
    yield Finding(subject="free disk", state=state, message=f"{free / 1e9:.1f} GB")
    yield Finding(subject="processors", state="ok", message=str(default_workers()))
    memory = memory_bytes()
    if memory is not None:
        state = "ok" if memory >= LEAST_MEMORY else "doubtful"
        yield Finding(subject="memory", state=state, message=f"{memory / 1e9:.1f} GB")


def memory_bytes() -> int | None:
    """Memory of this machine; None where it cannot be told."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return None
