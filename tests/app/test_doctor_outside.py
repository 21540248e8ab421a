"""What `georef doctor` says of QGIS, browsers and PostGIS, there or not."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

from georef_gis.app import cli, doctor_outside
from georef_gis.app.doctor_outside import outside_findings


def findings() -> dict[str, str]:
    return {finding.subject: finding.message for finding in outside_findings()}


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


def program(folder: Path, name: str) -> Path:
    path = folder / name
    path.write_text("#!/bin/sh\n")
    path.chmod(0o755)
    return path


def test_a_machine_without_them_is_told_so_and_is_fine(bare: Path) -> None:
    found = findings()
    assert found["QGIS"].startswith("not found")
    assert found["Chromium"].startswith("not found")
    assert "QGIS plug-in" not in found
    assert {finding.state for finding in outside_findings()} == {"ok"}


def test_programs_are_told_with_their_place(bare: Path) -> None:
    qgis, chromium = program(bare, "qgis_process"), program(bare, "google-chrome")
    found = findings()
    assert found["QGIS"] == str(qgis)
    assert found["Chromium"] == str(chromium)
    assert "georef qgis install" in found["QGIS plug-in"]


def test_a_plug_in_is_told_with_its_profile(bare: Path) -> None:
    done = CliRunner().invoke(cli.georef, ["qgis", "install", "--profile", "default"])
    assert done.exit_code == 0, done.output
    assert findings()["QGIS plug-in"].startswith("QGIS 3, profile default: georef ")


def test_a_driver_that_is_not_there_is_told_with_its_cure(
    bare: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(doctor_outside, "DRIVER", "no-such-driver")
    assert "georef-gis[postgis]" in findings()["PostGIS driver"]
