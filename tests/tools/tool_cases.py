"""Copies of the sample project for the tests of whole runs, and ways to spoil a photo."""

from __future__ import annotations

import re
import shutil
import sqlite3
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import piexif
import tomlkit
from click.testing import CliRunner

from georef_gis.app import cli

SAMPLE = Path(__file__).parents[2] / "sample_project"
# m; products are coarse where only their being there counts
GSD = 0.3
# what matching finds is not what most tests are about
COARSE_MATCH = {"max_side": 650, "observations": 150}


@dataclass
class Done:
    """What a command said, all of it in one text, and its exit code."""

    code: int
    text: str
    stderr: str

    def line(self, *parts: str) -> str:
        """The one line that holds all parts; fails if there is none."""
        lines = [line for line in self.text.splitlines() if all(p in line for p in parts)]
        assert lines, f"no line with {parts} in:\n{self.text}"
        return lines[0]


@dataclass
class Site:
    """A project folder."""

    folder: Path

    @property
    def photos(self) -> list[Path]:
        return sorted((self.folder / "photos").glob("*.JPG"))

    @property
    def products(self) -> Path:
        return self.folder / "products"

    def set(self, section: str, **values: object) -> None:
        """Set keys of project.toml; None removes one."""
        path = self.folder / "project.toml"
        content: dict[str, Any] = tomlkit.parse(path.read_text())
        table = content.setdefault(section, tomlkit.table())
        for key, value in values.items():
            table.pop(key, None)
            if value is not None:
                table[key] = value
        path.write_text(tomlkit.dumps(content))

    def use_dem(self) -> None:
        """Take the DEM for the ground."""
        self.set("ground", dem="dem.asc", height_m=None)

    def by_tags_alone(self) -> Site:
        """Leave logs and control out: half of a run's time, where products alone count."""
        self.set("logs", imu=None, gnss=None, sync=None)
        self.set("control", file=None, marks=None)
        return self

    def run(self, *words: object) -> Done:
        """`georef run` in this process."""
        return georef("run", self.folder, *words)

    def orthos(self) -> set[str]:
        return {path.stem for path in (self.products / "orthos").glob("*.tif")}

    def row(self, query: str) -> list[Any]:
        with sqlite3.connect(self.folder / "georef.gpkg") as database:
            return database.execute(query).fetchall()

    def litter(self) -> list[str]:
        """Temporary files in the products."""
        names = [p.relative_to(self.folder).as_posix() for p in self.products.rglob("*")]
        return [n for n in names if Path(n).name.startswith(".") or ".part" in n or "~" in n
                or n.endswith(("-journal", "-wal", "-shm", ".tmp"))]  # fmt: skip


def copy_site(folder: Path, photos: int = 5, **settings: object) -> Site:
    """Copy of the sample project with its first photos; over flat ground, which is fast."""
    (folder / "photos").mkdir(parents=True)
    for path in sorted((SAMPLE / "photos").glob("*.JPG"))[:photos]:
        shutil.copy2(path, folder / "photos")
    for name in ("control", "logs"):
        shutil.copytree(SAMPLE / name, folder / name)
    for name in ("dem.asc", "dem.prj", "project.toml"):
        shutil.copy(SAMPLE / name, folder)
    site = Site(folder)
    site.set("products", **{"gsd_m": GSD, **settings})
    site.set("tools", match=COARSE_MATCH)
    site.set("ground", dem=None, height_m=314.0, height_kind="orthometric")
    return site


def georef(*words: object) -> Done:
    """A command in this process, where warnings of libraries are errors."""
    done = CliRunner().invoke(cli.georef, [str(word) for word in words])
    return Done(done.exit_code, done.output, done.stderr)


def georef_process(*words: object, **options: Any) -> subprocess.CompletedProcess[str]:
    """A command in a process of its own."""
    command = [sys.executable, "-m", "georef_gis.app", *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, **options)


def set_gps(path: Path, **values: Any) -> None:
    """Set tags of the GPS directory by piexif's names; None removes one, no names remove all."""
    exif = piexif.load(str(path))
    for name, value in values.items():
        tag = getattr(piexif.GPSIFD, name)
        exif["GPS"].pop(tag, None)
        if value is not None:
            exif["GPS"][tag] = value
    if not values:
        exif["GPS"] = {}
    piexif.insert(piexif.dump(exif), str(path))


def set_position(path: Path, lat: float, lon: float) -> None:
    set_gps(
        path,
        GPSLatitude=dms(lat), GPSLatitudeRef="N" if lat >= 0 else "S",
        GPSLongitude=dms(lon), GPSLongitudeRef="E" if lon >= 0 else "W",
    )  # fmt: skip


def dms(value: float) -> tuple[tuple[int, int], ...]:
    return (round(abs(value) * 1e7), 10**7), (0, 1), (0, 1)


def set_xmp(path: Path, values: Mapping[str, str]) -> None:
    """Set fields of the `Camera` XMP in place; the packet keeps its length."""
    raw = path.read_bytes()
    for name, value in values.items():
        pattern = rf"(<Camera:{name}>)([^<]*)(</Camera:{name}>)".encode()
        found = re.search(pattern, raw)
        assert found, name
        room = len(found[2])
        assert len(value) <= room, f"{name}: {value} does not fit into {room} bytes"
        text = found[1] + value.encode() + found[3] + b" " * (room - len(value))
        raw = raw[: found.start()] + text + raw[found.end() :]
    path.write_bytes(raw)
