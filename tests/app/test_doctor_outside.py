"""What `georef doctor` says of QGIS, browsers and PostGIS, there or not."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from georef_gis.app import cli, doctor_outside
from georef_gis.app.doctor import _data
from georef_gis.app.doctor_outside import outside_findings


def findings() -> dict[str, str]:
    return {finding.subject: finding.message for finding in outside_findings()}


def states() -> dict[str, str]:
    return {finding.subject: finding.state for finding in outside_findings()}


@pytest.fixture
def bare(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A machine without any program, and a home without profiles."""
    programs = tmp_path / "programs"
    programs.mkdir()
    monkeypatch.setenv("PATH", str(programs))
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.delenv("XDG_DATA_HOME", raising=False)
    monkeypatch.delenv("QGIS_CUSTOM_CONFIG_PATH", raising=False)
    return programs


def program(
    folder: Path, name: str, text: str = "#!/bin/sh\necho Program 3.22.16 of all\n"
) -> Path:
    path = folder / name
    path.write_text(text)
    path.chmod(0o755)
    return path


def test_a_machine_without_them_is_told_so_and_is_fine(
    bare: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(doctor_outside, "DRIVER", "no-such-driver")
    monkeypatch.setattr(doctor_outside, "EXTENSIONS", (f"{bare}/*/extension",))
    found = findings()
    assert found["QGIS"].startswith("not found on PATH")
    assert found["Chromium"].startswith("not found on PATH")
    assert "QGIS plug-in" not in found
    assert set(states().values()) == {"absent"}
    lines = [finding.line() for finding in outside_findings()]
    assert all(line.startswith("--  ") for line in lines)


def test_programs_are_told_with_their_place(bare: Path) -> None:
    qgis, chromium = program(bare, "qgis_process"), program(bare, "google-chrome")
    found = findings()
    assert found["QGIS"] == f"3.22.16, {qgis}"
    assert found["Chromium"] == f"3.22.16, {chromium}"
    assert "georef qgis install" in found["QGIS plug-in"]
    assert states()["QGIS plug-in"] == "absent"


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("#!/bin/sh\necho 3.22.16\nexit 3\n", "does not start (code 3)"),
        ("#!/bin/sh\necho no number\n", "does not start (no version told)"),
        ("no program", "does not start (Exec format error)"),
        ("#!/no/such/shell\n", "does not start (No such file or directory)"),
    ],
)
def test_a_program_that_does_not_start_is_no_program(bare: Path, text: str, told: str) -> None:
    path = program(bare, "chromium", text)
    assert findings()["Chromium"] == f"{path}: {told}; install it again"
    assert states()["Chromium"] == "doubtful"


def test_looking_at_programs_leaves_the_home_alone(bare: Path, tmp_path: Path) -> None:
    program(bare, "qgis_process", '#!/bin/sh\nmkdir "$HOME/profile"\necho 3.22.16\n')
    assert states()["QGIS"] == "ok"
    assert not (tmp_path / "profile").exists()


def test_a_plug_in_whose_python_lost_georef_is_doubtful(bare: Path, tmp_path: Path) -> None:
    done = CliRunner().invoke(cli.georef, ["qgis", "install", "--profile", "default"])
    assert done.exit_code == 0, done.output
    (record,) = tmp_path.rglob("georef.json")
    bad = program(bare, "python", "#!/bin/sh\nexit 1\n")
    content = json.loads(record.read_text("utf-8")) | {"python": str(bad)}
    record.write_text(json.dumps(content), encoding="utf-8")
    assert "in which georef does not run: `georef qgis install` again" in findings()["QGIS plug-in"]
    assert states()["QGIS plug-in"] == "doubtful"


def test_a_server_without_postgis_is_not_taken_for_one(
    bare: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(doctor_outside, "EXTENSIONS", (f"{bare}/postgresql/*/extension",))
    folder = bare / "postgresql/15/extension"
    folder.mkdir(parents=True)
    assert findings()["PostGIS server"].startswith("PostgreSQL 15 without PostGIS")
    assert states()["PostGIS server"] == "absent"
    (folder / "postgis.control").touch()
    assert findings()["PostGIS server"] == "PostgreSQL 15 with PostGIS is installed here"
    assert states()["PostGIS server"] == "ok"


def test_a_library_that_cannot_be_loaded_keeps_work_from_being_done(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setitem(sys.modules, "rasterio", None)
    done = CliRunner().invoke(cli.georef, ["doctor", str(tmp_path)])
    assert done.exit_code == 2
    assert "BAD GDAL                     rasterio cannot be imported" in done.output


def test_no_grids_are_told_as_absent(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("georef_gis.project.grids.installed_grids", list)
    (found,) = [finding for finding in _data(tmp_path) if finding.subject == "grids"]
    assert found.state == "absent"
    assert found.message.startswith("none in ")
    assert "EGM96 is built in" in found.message


def test_a_plug_in_is_told_with_its_profile(bare: Path) -> None:
    done = CliRunner().invoke(cli.georef, ["qgis", "install", "--profile", "default"])
    assert done.exit_code == 0, done.output
    assert findings()["QGIS plug-in"].startswith("QGIS 3, profile default: georef ")


def test_a_driver_that_is_not_there_is_told_with_its_cure(
    bare: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(doctor_outside, "DRIVER", "no-such-driver")
    assert "georef-gis[postgis]" in findings()["PostGIS driver"]


@pytest.mark.parametrize(
    ("folder", "version"),
    [
        ("/usr/share/postgresql/15/extension", "15"),
        ("/usr/share/postgresql/9.6/extension", "9.6"),
        ("/usr/pgsql-15/share/extension", "15"),
        ("/opt/homebrew/share/postgresql@14/extension", "14"),
    ],
)
def test_the_version_of_a_server_is_read_from_its_folder(folder: str, version: str) -> None:
    assert doctor_outside._version(Path(folder)) == version
