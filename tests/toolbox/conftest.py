"""Plug-ins that are really installed, and projects to run them on."""

import os
import subprocess
import sys
import tomllib
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

HERE = Path(__file__).parent
Georef = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture(scope="session")
def plugins(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder into which pip installed the toy, the broken and the clashing distribution."""
    target, wheels = tmp_path_factory.mktemp("plugins"), tmp_path_factory.mktemp("wheels")
    names = ("toy_plugin", "broken_plugin", "clashing_plugin")
    built = [build_wheel(HERE / name, wheels) for name in names]
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index"]
    pip += ["--disable-pip-version-check", "--no-compile", "--target", str(target)]
    subprocess.run([*pip, *map(str, built)], check=True)
    return target


def build_wheel(source: Path, folder: Path) -> Path:
    """Wheel of a distribution of pure Python.

    By hand, because building with setuptools needs what a test environment may not have.
    """
    project = tomllib.loads((source / "pyproject.toml").read_text())["project"]
    name, version = project["name"].replace("-", "_"), project["version"]
    info = f"{name}-{version}.dist-info"
    entries = [
        f"[{group}]\n" + "".join(f"{key} = {value}\n" for key, value in names.items())
        for group, names in project["entry-points"].items()
    ]
    files = {file.relative_to(source).as_posix(): file.read_text() for file in source.rglob("*.py")}
    files[f"{info}/METADATA"] = f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n"
    files[f"{info}/WHEEL"] = "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n"
    files[f"{info}/entry_points.txt"] = "\n".join(entries)
    files[f"{info}/RECORD"] = "".join(f"{file},,\n" for file in [*files, f"{info}/RECORD"])
    wheel = folder / f"{name}-{version}-py3-none-any.whl"
    with zipfile.ZipFile(wheel, "w") as archive:
        for file, content in files.items():
            archive.writestr(file, content)
    return wheel


@pytest.fixture(scope="session")
def georef(plugins: Path) -> Georef:
    """The command line in a process of its own, with the plug-ins installed."""

    def call(*words: str | Path, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "georef_gis.app", *map(str, words)]
        return subprocess.run(
            command, cwd=cwd, env=environment(plugins), text=True, capture_output=True, timeout=60
        )

    return call


def environment(plugins: Path) -> dict[str, str]:
    """Environment in which the plug-ins are installed."""
    return {**os.environ, "PYTHONPATH": str(plugins)}


@pytest.fixture
def site(tmp_path: Path) -> Path:
    """A project of three photos (of no content)."""
    (tmp_path / "photos").mkdir()
    for number in range(3):
        (tmp_path / "photos" / f"P{number}.JPG").write_bytes(b"photo %d" % number)
    (tmp_path / "project.toml").write_text('[project]\nname = "toy"\n')
    return tmp_path
