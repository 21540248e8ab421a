# SPDX-License-Identifier: GPL-2.0-or-later
"""Where georef is, and its manifest, kept on disk until georef or its plug-ins change."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from .child import CURE, clean_environment, start_options
from .tools import ManifestError

# Beside this file: the interpreter that `georef qgis install` ran with, and what to watch.
CONFIG = "georef.json"
CACHE = "manifest.json"
# s; the first start after an update compiles everything
TIMEOUT = 60.0


def read_config(folder: Path) -> dict[str, Any]:
    """What `georef qgis install` wrote into the folder of the plug-in; empty if there is none."""
    try:
        content = json.loads((folder / CONFIG).read_text("utf-8"))
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}


def find_command(config: Mapping[str, Any], chosen: str) -> list[str]:
    """First words of every command line.

    Parameters
    ----------
    chosen
        Program that the user named in the settings: georef, or the Python it is installed in.

    Raises
    ------
    ManifestError
        If there is no such program.
    """
    # Windows' "Copy as path" puts quotes round it.
    program = chosen.strip().strip('"') or str(config.get("python", ""))
    if not program:
        raise ManifestError(f"georef is not known to this plug-in; {CURE}")
    if not os.path.isfile(program):
        raise ManifestError(f"{program}: is not there (any more); {CURE}")
    if Path(program).name.lower().startswith("python"):
        # -P: a folder called georef_gis where QGIS works must not be taken for the package.
        return [program, "-P", "-m", "georef_gis.app"]
    return [program]


def load_manifest(command: list[str], config: Mapping[str, Any], cache: Path) -> dict[str, Any]:
    """Manifest of a georef, from the cache as long as nothing changed that it watches.

    Raises
    ------
    ManifestError
        If georef does not give one.
    """
    key = _key(command, config)
    try:
        kept = json.loads(cache.read_text("utf-8"))
        if kept["key"] == key:
            return dict(kept["manifest"])
    except (OSError, ValueError, KeyError, TypeError):
        pass
    manifest = _ask(command)
    _keep(cache, {"key": key, "manifest": manifest})
    return manifest


def _key(command: list[str], config: Mapping[str, Any]) -> dict[str, Any]:
    """What the manifest depends on: the program, and time and size of what may change it."""
    watched = [*map(str, config.get("watch", ())), *_packages(Path(command[0]))]
    stamps = {}
    for name in [command[0], *watched]:
        try:
            found = os.stat(name)
            stamps[name] = [found.st_mtime_ns, found.st_size]
        except OSError:
            stamps[name] = []
    return {"command": command, "stamps": stamps}


def _packages(program: Path) -> list[str]:
    """Folders of packages of the Python that a program belongs to; installing changes them."""
    root = program.parent.parent
    found = [*root.glob("lib*/python*/site-packages"), *root.glob("Lib/site-packages")]
    return sorted(str(path) for path in found)


def _ask(command: list[str]) -> dict[str, Any]:
    try:
        done = subprocess.run(
            [*command, "tools", "--json"],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=TIMEOUT,
            env=clean_environment(os.environ),
            check=False,
            **start_options(sys.platform),
        )
        content = json.loads(done.stdout.decode("utf-8")) if done.returncode == 0 else None
    except (OSError, ValueError, subprocess.TimeoutExpired) as error:
        raise ManifestError(f"{command[0]}: gives no list of tools ({error}); {CURE}") from error
    if not isinstance(content, dict):
        lines = done.stderr.decode("utf-8", "replace").split("\n")
        told = next((line.strip() for line in reversed(lines) if line.strip()), "no word why")
        raise ManifestError(f"{command[0]}: gives no list of tools ({told}); {CURE}")
    return content


def _keep(cache: Path, content: Mapping[str, Any]) -> None:
    """Write the cache as a whole; without permission georef is asked every time."""
    part = cache.with_name(f".{cache.name}.{os.getpid()}")
    try:
        cache.parent.mkdir(parents=True, exist_ok=True)
        part.write_text(json.dumps(content), encoding="utf-8")
        os.replace(part, cache)
    except OSError:
        try:
            part.unlink()
        except OSError:
            pass
