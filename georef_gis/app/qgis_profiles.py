"""Where QGIS keeps its profiles, and the switch of a plug-in in their settings."""

from __future__ import annotations

import configparser
import os
import re
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from georef_gis.errors import InputError

PLUGIN = "georef_qgis"
VERSIONS = (3, 4)
DEFAULT_PROFILE = "default"
SECTION = b"[PythonPlugins]"


@dataclass(frozen=True, slots=True, kw_only=True)
class Profile:
    """A user profile of QGIS, or a bare folder of plug-ins.

    Parameters
    ----------
    version
        3 or 4; 0 for a bare folder.
    """

    version: int
    name: str
    folder: Path

    @property
    def plugins(self) -> Path:
        """Folder of the plug-ins."""
        return self.folder / "python" / "plugins" if self.version else self.folder

    @property
    def settings(self) -> Path | None:
        """File of the settings, whether it is there or not."""
        if not self.version:
            return None
        name = f"QGIS{self.version}.ini"
        # macOS names the folder after the domain.
        usual = "qgis.org" if sys.platform == "darwin" else "QGIS"
        places = [self.folder / part / name for part in (usual, "QGIS", "qgis.org")]
        return next((path for path in places if path.is_file()), places[0])

    @property
    def cache(self) -> Path | None:
        """Folder where the plug-in keeps what it can make again."""
        return self.folder / "cache" / PLUGIN if self.version else None

    def title(self) -> str:
        """Name for messages."""
        return f"QGIS {self.version}, profile {self.name}" if self.version else str(self.folder)


def roots(environ: Mapping[str, str], platform: str) -> list[tuple[int, Path]]:
    """Folders that hold ``profiles/``, with the version of QGIS, whether they are there or not."""
    own = environ.get("QGIS_CUSTOM_CONFIG_PATH")
    if own:
        newer = any(Path(own).glob("profiles/*/*/QGIS4.ini"))
        return [(4 if newer else 3, Path(own))]
    home = Path(environ.get("HOME") or Path.home())
    if platform == "win32":
        base = Path(environ.get("APPDATA") or home / "AppData" / "Roaming")
    elif platform == "darwin":
        base = home / "Library" / "Application Support"
    else:
        base = Path(environ.get("XDG_DATA_HOME") or home / ".local" / "share")
    return [(version, base / "QGIS" / f"QGIS{version}") for version in VERSIONS]


def find_profiles(
    name: str = "", *, every: bool = False, environ: Mapping[str, str] | None = None
) -> list[Profile]:
    """Profiles of a name, of each QGIS that has one.

    Parameters
    ----------
    name
        Empty for the one that QGIS starts with.
    every
        All profiles there are instead.

    Raises
    ------
    InputError
        If there is none.
    """
    places = roots(os.environ if environ is None else environ, sys.platform)
    there = [
        Profile(version=version, name=folder.name, folder=folder)
        for version, root in places
        for folder in sorted((root / "profiles").glob("*/"))
    ]
    if every:
        return there
    wanted = {root: name or _starts_with(root) for _, root in places}
    found = [p for p in there if p.name == wanted[p.folder.parent.parent]]
    if found:
        return found
    if name != Path(name).name or name in (".", ".."):
        raise InputError(f"{name!r} is no name of a profile; give one word", field="--profile")
    if name and not there:
        # QGIS never ran here: it takes a profile that is there when it starts.
        version, root = places[0]
        return [Profile(version=version, name=name, folder=root / "profiles" / name)]
    raise _no_profile(name or wanted[places[0][1]], there, places[0][1].parent)


def _no_profile(name: str, there: list[Profile], place: Path) -> InputError:
    if there:
        names = ", ".join(sorted({profile.name for profile in there}))
        return InputError(f"QGIS has no profile {name!r}; use one of {names}", field="--profile")
    return InputError(
        f"there is no profile of QGIS in {place}; start QGIS once, or let one be made with "
        "`georef qgis install --profile default`, or name a folder of plug-ins with --folder"
    )


def _starts_with(root: Path) -> str:
    """Profile that QGIS starts with."""
    reader = configparser.ConfigParser(strict=False, interpolation=None)
    try:
        reader.read(root / "profiles" / "profiles.ini", encoding="utf-8")
        default, last, policy = (
            _plain(reader.get("core", key, fallback=""))
            for key in ("defaultProfile", "lastProfile", "selectionPolicy")
        )
    except (configparser.Error, UnicodeDecodeError):
        return DEFAULT_PROFILE
    # Since 3.32: the one used last, unless the user wants one and the same (1) or is asked (2).
    if policy != "1" and last and (root / "profiles" / last).is_dir():
        return last
    return default or DEFAULT_PROFILE


def _plain(value: str) -> str:
    """Text of a value as Qt writes it: Qt 5 escapes what is no ASCII, both quote some."""
    return re.sub(r"\\x([0-9a-fA-F]{1,4})", lambda m: chr(int(m[1], 16)), value.strip('"'))


def is_enabled(settings: Path) -> bool:
    """Whether QGIS loads the plug-in at its start."""
    try:
        lines = settings.read_bytes().splitlines()
    except OSError:
        return False
    return any(_key(lines[number]) == b"true" for number in _entries(lines))


def enable(settings: Path) -> None:
    """Let QGIS load the plug-in at its start; nothing else in the file is touched.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    lines = settings.read_bytes().splitlines() if settings.is_file() else []
    entries, line = _entries(lines), PLUGIN.encode() + b"=true"
    for number in entries:
        lines[number] = line
    if not entries:
        if SECTION not in lines:
            lines += [*([b""] if lines else []), SECTION]
        lines.insert(lines.index(SECTION) + 1, line)
    _write(settings, lines)


def disable(settings: Path) -> None:
    """Take the plug-in out of the settings."""
    if not settings.is_file():
        return
    lines = settings.read_bytes().splitlines()
    entries = set(_entries(lines))
    if entries:
        _write(settings, [line for number, line in enumerate(lines) if number not in entries])


def _entries(lines: list[bytes]) -> list[int]:
    """Numbers of the lines that switch the plug-in."""
    section, found = b"", []
    for number, line in enumerate(lines):
        if line.startswith(b"["):
            section = line.strip()
        elif section == SECTION and line.partition(b"=")[0].strip() == PLUGIN.encode():
            found.append(number)
    return found


def _key(line: bytes) -> bytes:
    return line.partition(b"=")[2].strip().lower()


def _write(settings: Path, lines: list[bytes]) -> None:
    """Write as a whole, with the permissions it had."""
    settings.parent.mkdir(parents=True, exist_ok=True)
    real = settings.resolve()
    part = real.with_name(f".{real.name}.georef")
    try:
        end = os.linesep.encode()
        part.write_bytes(end.join(lines) + end)
        if real.exists():
            part.chmod(real.stat().st_mode & 0o777)
        os.replace(part, real)
    finally:
        part.unlink(missing_ok=True)
