"""The QGIS plug-in on disk: copied into a profile as a whole, taken away again, looked at."""

from __future__ import annotations

import hashlib
import inspect
import json
import os
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import georef_gis
from georef_gis.app.qgis_profiles import PLUGIN, Profile
from georef_gis.errors import ExportError, InputError
from georef_gis.toolbox.registry import Registry

SOURCE = Path(georef_gis.__file__).parent / "qgis_plugin" / PLUGIN
# The plug-in reads it; it is also by what it is known as ours.
RECORD = "georef.json"
OWNER = "georef qgis install"
# s; the first start after an update compiles everything
TIMEOUT = 180.0
LIST_TOOLS = """\
import sys
sys.path.insert(0, sys.argv[1])
from pathlib import Path
from georef_qgis import manifest, tools
config = manifest.read_config(Path(sys.argv[1]) / "georef_qgis")
command = manifest.find_command(config, "")
print(len(tools.read_tools(manifest.load_manifest(command, config, Path(sys.argv[2])))))
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Installed:
    """A plug-in that was found.

    Parameters
    ----------
    python
        Interpreter that it runs georef with.
    changed, extra
        Installed files that were changed by hand or are gone; files that were not installed.
    """

    folder: Path
    version: str
    python: str
    changed: tuple[str, ...]
    extra: tuple[str, ...]
    files: Mapping[str, str]

    def why_not(self) -> str:
        """Why it would not run georef, in words; empty if it would."""
        if self.python == sys.executable:
            return ""
        if not Path(self.python).is_file():
            return "which is not there any more"
        # What another Python or a shell set is not for this one.
        env = {key: v for key, v in os.environ.items() if not key.startswith("PYTHON")}
        try:
            command = [self.python, "-P", "-m", "georef_gis.app", "--version"]
            done = subprocess.run(
                command, capture_output=True, timeout=TIMEOUT, check=False, env=env
            )
        except (OSError, subprocess.TimeoutExpired):
            return "which does not start"
        return "in which georef does not run" if done.returncode else ""


def find_installed(profile: Profile) -> Installed | None:
    """Our plug-in in a profile; None if there is none.

    Raises
    ------
    InputError
        If a folder of its name is there that is not ours.
    """
    folder = profile.plugins / PLUGIN
    if not (folder.exists() or folder.is_symlink()):
        return None
    if folder.is_symlink() or not folder.is_dir():
        raise InputError(f"{folder}: is no folder that georef installed; move it away first")
    try:
        record = json.loads((folder / RECORD).read_text("utf-8"))
        files = {str(name): str(digest) for name, digest in record["files"].items()}
        ours = record["owner"] == OWNER
        version, python = str(record["version"]), str(record["python"])
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        ours = False
    if not ours:
        raise InputError(f"{folder}: was not installed by georef; move it away first")
    there = _digests(folder)
    there.pop(RECORD, None)
    return Installed(
        folder=folder, version=version, python=python, files=files,
        changed=tuple(name for name, digest in files.items() if there.get(name) != digest),
        extra=tuple(name for name in there if name not in files),
    )  # fmt: skip


def install(profile: Profile, registry: Registry, *, force: bool = False) -> int:
    """Copy the plug-in into a profile, whole or not at all.

    Returns
    -------
    tools
        Number of algorithms it makes.

    Raises
    ------
    InputError
        If a folder of its name is not ours, or was changed by hand; or if georef does not run.
    ExportError
        If it cannot be written.
    """
    check_replaceable(profile, force=force)
    with _written(profile.plugins):
        profile.plugins.mkdir(parents=True, exist_ok=True)
        staging = Path(tempfile.mkdtemp(prefix=f".{PLUGIN}.", dir=profile.plugins))
        try:
            fresh = staging / PLUGIN
            shutil.copytree(SOURCE, fresh, ignore=shutil.ignore_patterns("__pycache__"))
            record = {
                "owner": OWNER, "version": georef_gis.__version__, "python": sys.executable,
                "watch": _watched(registry), "files": _digests(fresh),
            }  # fmt: skip
            (fresh / RECORD).write_text(json.dumps(record, indent=1), encoding="utf-8")
            cache = profile.cache or staging
            count = _count_tools(staging, cache / "manifest.json")
            _exchange(fresh, profile.plugins / PLUGIN, staging / "old")
        finally:
            shutil.rmtree(staging, ignore_errors=True)
    return count


def check_replaceable(profile: Profile, *, force: bool) -> None:
    """Refuse to write over what is not ours, or what was changed by hand.

    Raises
    ------
    InputError
        With the name of the first such file.
    """
    found = find_installed(profile)
    if found is None or force:
        return
    hand_made = [*found.changed, *found.extra]
    if hand_made:
        raise InputError(
            f"{found.folder / hand_made[0]}: was changed since it was installed; copy it "
            "elsewhere, then give --force"
        )


def remove(profile: Profile) -> list[str]:
    """Take away what was installed; give the names of files that are left, as they are others'.

    Raises
    ------
    InputError
        If there is none, or one that is not ours.
    """
    found = find_installed(profile)
    if found is None:
        raise InputError(f"{profile.title()}: the plug-in is not installed there")
    with _written(found.folder):
        for name in found.files:
            if name not in found.changed:
                (found.folder / name).unlink(missing_ok=True)
        for folder in [*found.folder.rglob("__pycache__")]:
            shutil.rmtree(folder)
        # The record goes last: what was interrupted can be done again.
        (found.folder / RECORD).unlink()
        if profile.cache is not None:
            shutil.rmtree(profile.cache, ignore_errors=True)
        for folder in sorted(found.folder.rglob("*/"), reverse=True):
            if not any(folder.iterdir()):
                folder.rmdir()
        left = sorted(_digests(found.folder))
        if not left:
            found.folder.rmdir()
    return left


def is_current(found: Installed) -> bool:
    """Whether an installed plug-in is that of this georef."""
    return dict(found.files) == _digests(SOURCE) and not found.changed


def _digests(folder: Path) -> dict[str, str]:
    """SHA-256 of every file below a folder, but for what Python compiled."""
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and "__pycache__" not in path.parts
    }


def _watched(registry: Registry) -> list[str]:
    """Files and folders whose change may mean other tools: modules of tools, packages."""
    modules = {inspect.getfile(sys.modules[tool.algorithm.__module__]) for tool in registry}
    folders = {sysconfig.get_path("purelib"), sysconfig.get_path("platlib")}
    return sorted({*modules, *folders, georef_gis.__file__})


def _count_tools(plugins: Path, cache: Path) -> int:
    """Number of algorithms, asked as the plug-in will: from elsewhere, by the same interpreter."""
    command = [sys.executable, "-B", "-P", "-c", LIST_TOOLS, str(plugins), str(cache)]
    done = subprocess.run(
        command, capture_output=True, encoding="utf-8", errors="replace", timeout=TIMEOUT,
        check=False, cwd=plugins,
    )  # fmt: skip
    if done.returncode:
        lines = done.stderr.strip().splitlines() or ["it says nothing"]
        raise InputError(f"georef does not run by itself: {lines[-1]}; install it with pip first")
    return int(done.stdout)


def _exchange(fresh: Path, target: Path, old: Path) -> None:
    """Put a folder in the place of another, or leave that where it was."""
    if target.exists():
        os.replace(target, old)
    try:
        os.replace(fresh, target)
    except OSError:
        if old.exists():
            os.replace(old, target)
        raise


@contextmanager
def _written(place: Path) -> Iterator[None]:
    """Turn errors of the system into one line."""
    try:
        yield
    except OSError as error:
        where = error.filename or place
        raise ExportError(
            f"{where}: {error.strerror or error}; check the permission, and that QGIS is closed"
        ) from error


def content(profile: Profile, found: Installed | None) -> dict[str, Any]:
    """JSON-able state of a profile."""
    state: dict[str, Any] = {"qgis": profile.version or None, "profile": profile.name,
                             "folder": str(profile.plugins / PLUGIN),
                             "installed": found is not None}  # fmt: skip
    if found is not None:
        why_not = found.why_not()
        state |= {"version": found.version, "python": found.python, "works": not why_not,
                  "why_not": why_not, "current": is_current(found),
                  "changed": list(found.changed)}  # fmt: skip
    return state
