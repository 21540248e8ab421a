"""`georef doctor`: what is installed, what was refused, and whether there is room to work."""

from __future__ import annotations

import os
import platform
import re
import shutil
import sys
import tempfile
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path

from georef_gis import __version__
from georef_gis.app.doctor_outside import outside_findings
from georef_gis.app.findings import Finding, State
from georef_gis.toolbox.health import geodesy_findings, raster_findings
from georef_gis.toolbox.registry import Registry
from georef_gis.toolbox.steps import default_workers

# bytes below which a site of a few hundred photos will not fit
LEAST_DISK = 5_000_000_000
# Without these nothing is read or written; one that is there may still fail when it is loaded.
LIBRARIES = ("GDAL", "PROJ")
# bytes, what the products are made within
LEAST_MEMORY = 1_000_000_000


def examine(registry: Registry, folder: Path) -> list[Finding]:
    """Look at everything."""
    return [
        *_versions(),
        *_data(folder),
        *_plugins(registry),
        *_page(),
        *outside_findings(),
        *_machine(folder),
    ]


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


def _data(folder: Path) -> Iterator[Finding]:
    for subject, fine, message in (*raster_findings(), *geodesy_findings(folder)):
        state: State = "ok" if fine else "bad" if subject in LIBRARIES else "doubtful"
        if fine is None:
            state = "absent"
        yield Finding(subject=subject, state=state, message=message)


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
    """What `georef serve` needs."""
    state: State = "ok"
    try:
        message = ", ".join(f"{name} {version(name)}" for name in ("fastapi", "uvicorn"))
    except PackageNotFoundError as error:
        state = "absent"
        message = f'{error.name} is not installed; pip install "georef-gis[web]"'
    yield Finding(subject="page (georef serve)", state=state, message=message)


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
