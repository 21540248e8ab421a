"""`georef qgis`: profiles are found, the plug-in comes as a whole and goes without a trace."""

from __future__ import annotations

import configparser
import json
import os
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result
from qgis_cases import PLUGIN as SOURCE

from georef_gis.app import qgis_plugin_files
from georef_gis.app.cli import georef
from georef_gis.app.qgis_profiles import (
    PLUGIN,
    Profile,
    disable,
    enable,
    find_profiles,
    is_enabled,
    roots,
)
from georef_gis.errors import InputError

Run = Callable[..., Result]
PROFILE = ".local/share/QGIS/QGIS3/profiles/default"


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for name in ("XDG_DATA_HOME", "QGIS_CUSTOM_CONFIG_PATH", "APPDATA"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setattr(sys, "platform", "linux")
    # asking the installed plug-in for its tools takes two seconds; once is enough
    monkeypatch.setattr(qgis_plugin_files, "_count_tools", lambda *_: 7)
    return tmp_path


@pytest.fixture
def run(home: Path) -> Run:
    return lambda *words: CliRunner().invoke(georef, ["qgis", *map(str, words)])


def profile(home: Path, name: str = "default", version: int = 3, settings: str = "") -> Path:
    folder = home / f".local/share/QGIS/QGIS{version}/profiles" / name
    (folder / "QGIS").mkdir(parents=True)
    if settings:
        (folder / f"QGIS/QGIS{version}.ini").write_text(settings, encoding="utf-8")
    return folder


def tree(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def installed(folder: Path) -> Path:
    return folder / "python/plugins" / PLUGIN


def test_install_copies_all_files_and_switches_it_on(home: Path, run: Run) -> None:
    folder = profile(home, settings="[General]\na=1\n")
    done = run("install")
    assert done.exit_code == 0, done.output
    assert "QGIS 3, profile default: 7 tools" in done.output
    assert "switched on" in done.output
    there = tree(installed(folder))
    record = json.loads(there.pop("georef.json"))
    assert there == {k: v for k, v in tree(SOURCE).items() if "__pycache__" not in k}
    assert record["python"] == sys.executable
    assert any("mosaic" in name for name in record["watch"])
    assert is_enabled(folder / "QGIS/QGIS3.ini")
    # nothing of the making is left
    assert [path.name for path in (folder / "python/plugins").iterdir()] == [PLUGIN]


def test_install_serves_every_qgis_and_its_own_default_profile(home: Path, run: Run) -> None:
    old, new = profile(home, "work"), profile(home, version=4)
    other = profile(home, "other")
    ini = old.parent / "profiles.ini"
    ini.write_text("[core]\ndefaultProfile=work\n", encoding="utf-8")
    done = run("install")
    assert done.exit_code == 0, done.output
    assert installed(old).is_dir()
    assert installed(new).is_dir()
    assert not installed(other).exists()
    assert is_enabled(new / "QGIS/QGIS4.ini")
    status = run("status")
    assert "QGIS 3, profile other: not installed" in status.output
    assert "QGIS 4, profile default: georef 0.1.0, run by" in status.output


@pytest.mark.parametrize(
    ("ini", "name"),
    [
        # before 3.32: the default profile is the one used last
        ("defaultProfile=work\n", "work"),
        ("defaultProfile=default\nlastProfile=work\nselectionPolicy=0\n", "work"),
        ("defaultProfile=default\nlastProfile=work\nselectionPolicy=1\n", "default"),
        ("defaultProfile=default\nlastProfile=gone\n", "default"),
        # as Qt 5 writes it, and Qt 6
        ('lastProfile="B\\xfcro, 2"\n', "Büro, 2"),
        ('lastProfile="Büro, 2"\n', "Büro, 2"),
    ],
)
def test_install_takes_the_profile_that_qgis_starts_with(
    home: Path, run: Run, ini: str, name: str
) -> None:
    folders = {one: profile(home, one) for one in ("default", "work", "Büro, 2")}
    path = folders["default"].parent / "profiles.ini"
    path.write_text(f"[core]\n{ini}", encoding="utf-8")
    done = run("install")
    assert done.exit_code == 0, done.output
    assert [one for one, folder in folders.items() if installed(folder).exists()] == [name]
    others = ", ".join(sorted(set(folders) - {name}))
    assert f"Not in the other profiles: {others}; --profile NAME" in done.output


def test_remove_finds_the_profiles_that_have_it(home: Path, run: Run) -> None:
    for name in ("default", "work", "other"):
        profile(home, name)
    assert run("install", "--profile", "work").exit_code == 0
    assert run("install", "--profile", "other").exit_code == 0
    foreign = installed(home / PROFILE)
    foreign.mkdir(parents=True)
    done = run("remove")
    assert done.exit_code == 0, done.output
    assert done.output.count("removed from") == 2
    assert foreign.is_dir()


@pytest.mark.parametrize("name", ["../../x", "a/b", ".."])
def test_profile_is_no_path(home: Path, run: Run, name: str) -> None:
    done = run("install", "--profile", name)
    assert done.exit_code == 2
    assert "is no name of a profile" in done.output
    assert tree(home) == {}


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ((), "start QGIS once"),
        (("--profile", "x", "--folder", "y"), "not both"),
    ],
)
def test_install_without_a_profile_says_what_to_do(run: Run, words: Any, message: str) -> None:
    done = run("install", *words)
    assert done.exit_code == 2
    assert message in done.output
    assert done.output.count("\n") == 1


def test_unknown_profile_is_refused_with_those_there_are(home: Path, run: Run) -> None:
    profile(home, "work")
    done = run("install", "--profile", "wrok")
    assert done.exit_code == 2
    assert "'wrok'; use one of work" in done.output


def test_named_profile_is_made_where_qgis_never_ran(home: Path, run: Run) -> None:
    done = run("install", "--profile", "default")
    assert done.exit_code == 0, done.output
    assert is_enabled(home / PROFILE / "QGIS/QGIS3.ini")


def test_bare_folder_gets_the_plug_in_and_the_user_the_word_how_to_switch_it_on(
    home: Path, run: Run
) -> None:
    done = run("install", "--folder", home / "plugins")
    assert done.exit_code == 0, done.output
    assert "Manage and Install Plugins" in done.output
    assert "QGIS_PLUGINPATH" in done.output
    assert (home / "plugins" / PLUGIN / "metadata.txt").is_file()


@pytest.mark.parametrize("kind", ["folder", "file", "link", "other record"])
def test_foreign_folder_of_the_same_name_is_left_alone(home: Path, run: Run, kind: str) -> None:
    target = installed(profile(home))
    target.parent.mkdir(parents=True)
    if kind == "file":
        target.write_text("mine")
    elif kind == "link":
        (home / "mine").mkdir()
        target.symlink_to(home / "mine")
    else:
        target.mkdir()
        (target / "metadata.txt").write_text("mine")
        if kind == "other record":
            (target / "georef.json").write_text('{"owner": "someone"}')
    before = tree(home)
    for words in (("install",), ("install", "--force"), ("remove",)):
        done = run(*words)
        assert done.exit_code == 2
        assert "move it away first" in done.output
        assert tree(home) == before


def test_file_changed_by_hand_is_not_written_over(home: Path, run: Run) -> None:
    target = installed(profile(home))
    assert run("install").exit_code == 0
    (target / "styles/photos.qml").write_text("my own style")
    done = run("install")
    assert done.exit_code == 2
    assert "styles/photos.qml: was changed since it was installed" in done.output
    assert run("install", "--force").exit_code == 0
    assert (target / "styles/photos.qml").read_text("utf-8") != "my own style"


def test_update_takes_away_what_the_new_version_has_no_more(
    home: Path, run: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    target = installed(profile(home))
    older = tmp_path / "older"
    shutil.copytree(SOURCE, older)
    (older / "gone.py").write_text("")
    with monkeypatch.context() as patch:
        patch.setattr(qgis_plugin_files, "SOURCE", older)
        assert run("install").exit_code == 0
    assert (target / "gone.py").is_file()
    assert "brings it up to date" in run("status").output
    assert run("install").exit_code == 0
    assert not (target / "gone.py").exists()
    assert "brings it up to date" not in run("status").output


def test_install_that_fails_leaves_the_older_one(
    home: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    target = installed(profile(home))
    assert run("install").exit_code == 0
    before = tree(home)

    def fail(*_: Any) -> int:
        raise InputError("georef does not run by itself")

    monkeypatch.setattr(qgis_plugin_files, "_count_tools", fail)
    done = run("install")
    assert done.exit_code == 2
    assert tree(home) == before
    assert target.is_dir()

    def full(source: Any, target: Any) -> None:
        raise OSError(28, "No space left on device", str(target))

    monkeypatch.setattr(qgis_plugin_files, "_count_tools", lambda *_: 7)
    monkeypatch.setattr(qgis_plugin_files.os, "replace", full)
    done = run("install")
    assert done.exit_code == 2
    assert "No space left on device" in done.output
    assert tree(home) == before


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_folder_without_permission_is_named(home: Path, run: Run) -> None:
    folder = profile(home)
    folder.chmod(0o500)
    done = run("install")
    folder.chmod(0o700)
    assert done.exit_code == 2
    assert "check the permission" in done.output


def test_remove_takes_away_what_was_installed_and_nothing_else(home: Path, run: Run) -> None:
    folder = profile(home, settings="[General]\na=1\n\n[PythonPlugins]\nother=true\n")
    before = tree(home)
    assert run("install").exit_code == 0
    compiled = installed(folder) / "__pycache__"
    compiled.mkdir()
    (compiled / "tools.cpython-39.pyc").write_bytes(b"x")
    done = run("remove")
    assert done.exit_code == 0, done.output
    assert tree(home) == before
    assert not installed(folder).exists()
    again = run("remove")
    assert again.exit_code == 2
    assert "not installed" in again.output


def test_remove_keeps_and_names_what_users_put_there(home: Path, run: Run) -> None:
    target = installed(profile(home))
    assert run("install").exit_code == 0
    (target / "notes.txt").write_text("mine")
    (target / "styles/photos.qml").write_text("my own style")
    done = run("remove")
    assert done.exit_code == 0, done.output
    assert "kept notes.txt, styles/photos.qml" in done.output
    assert set(tree(target)) == {"notes.txt", "styles/photos.qml"}


def test_status_says_when_the_python_is_gone(home: Path, run: Run) -> None:
    target = installed(profile(home))
    assert run("install").exit_code == 0
    record = json.loads((target / "georef.json").read_text("utf-8"))
    record["python"] = "/gone/python"
    (target / "georef.json").write_text(json.dumps(record))
    assert "which is not there any more" in run("status").output
    (state,) = json.loads(run("status", "--json").output)
    assert (state["installed"], state["works"], state["enabled"]) == (True, False, True)


def test_without_a_word_more_the_help_is_shown(run: Run) -> None:
    done = run()
    assert done.exit_code == 0
    assert "install" in done.output.splitlines()[-3]


def test_status_of_a_machine_without_qgis_ends_well(run: Run) -> None:
    done = run("status")
    assert done.exit_code == 0
    assert "no profile of QGIS" in done.output


@pytest.mark.parametrize(
    ("platform", "environ", "first"),
    [
        ("linux", {"HOME": "/h"}, "/h/.local/share/QGIS/QGIS3"),
        ("linux", {"HOME": "/h", "XDG_DATA_HOME": "/x"}, "/x/QGIS/QGIS3"),
        ("win32", {"HOME": "/h", "APPDATA": "/a"}, "/a/QGIS/QGIS3"),
        ("darwin", {"HOME": "/h"}, "/h/Library/Application Support/QGIS/QGIS3"),
        ("linux", {"HOME": "/h", "QGIS_CUSTOM_CONFIG_PATH": "/own"}, "/own"),
    ],
)
def test_profiles_lie_where_each_system_has_them(
    platform: str, environ: dict[str, str], first: str
) -> None:
    found = roots(environ, platform)
    assert found[0] == (3, Path(first))
    assert len(found) == (1 if "QGIS_CUSTOM_CONFIG_PATH" in environ else 2)


def test_settings_of_macos_lie_under_the_domain(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "platform", "darwin")
    found = Profile(version=3, name="default", folder=tmp_path)
    assert found.settings == tmp_path / "qgis.org/QGIS3.ini"


@pytest.mark.parametrize(
    "before",
    [
        "",
        "[General]\nname=\\xe9\nlist=a, b\n",
        "[PythonPlugins]\nother=true\n\n[Z]\nk=v\n",
        "[PythonPlugins]\ngeoref_qgis=false\nother=true\n",
        "[A]\ngeoref_qgis=false\n",
        "[General]\r\na=1\r\n",
    ],
)
def test_switch_touches_one_line_of_the_settings(tmp_path: Path, before: str) -> None:
    path = tmp_path / "QGIS3.ini"
    if before:
        path.write_bytes(before.encode())
        path.chmod(0o640)
    enable(path)
    enable(path)
    assert is_enabled(path)
    reader = configparser.ConfigParser(interpolation=None)
    reader.read(path, encoding="utf-8")
    assert reader["PythonPlugins"]["georef_qgis"] == "true"
    left = set(before.split()) - {"georef_qgis=false", "[PythonPlugins]"}
    assert left <= {*path.read_text("utf-8").split()}
    if before:
        assert path.stat().st_mode & 0o777 == 0o640
    disable(path)
    assert not is_enabled(path)
    if "georef_qgis" not in before:
        assert set(before.split()) <= set(path.read_text("utf-8").split())


def test_profile_that_qgis_starts_with_survives_a_broken_list(home: Path) -> None:
    folder = profile(home)
    (folder.parent / "profiles.ini").write_bytes(b"\xff\xfe[[[")
    assert [found.folder for found in find_profiles()] == [folder]
