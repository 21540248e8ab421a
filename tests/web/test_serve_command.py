"""`georef serve` on the command line: what it says where it cannot start, and how it ends."""

from __future__ import annotations

import signal
import socket
import sys
from pathlib import Path

import httpx
import pytest
from click.testing import CliRunner, Result
from web_cases import served

from georef_gis.app import cli


def call(*words: object) -> Result:
    return CliRunner().invoke(cli.georef, [str(word) for word in words])


@pytest.fixture
def empty(tmp_path: Path) -> Path:
    (tmp_path / "photos").mkdir()
    (tmp_path / "project.toml").write_text("")
    return tmp_path


def test_a_folder_without_a_project_is_told(tmp_path: Path) -> None:
    done = call("serve", tmp_path, "--no-browser")
    assert done.exit_code == 2
    assert "has no project.toml" in done.stderr
    assert done.stderr.count("\n") == 1


def test_a_port_that_is_taken_is_told(empty: Path) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        done = call("serve", empty, "--no-browser", "--port", port)
    assert done.exit_code == 2
    assert f"port {port}: cannot be used" in done.stderr
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize("port", ["0", "80", "70000", "x"])
def test_a_port_that_is_none_is_refused(empty: Path, port: str) -> None:
    assert call("serve", empty, "--port", port).exit_code == 2


def test_without_its_libraries_it_says_what_to_install(
    empty: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in [name for name in sys.modules if name.startswith("georef_gis.app.web.")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "uvicorn", None)
    done = call("serve", empty, "--no-browser")
    assert done.exit_code == 2
    assert 'pip install "georef-gis[web]"' in done.stderr
    assert "uvicorn" in done.stderr


def test_the_doctor_names_what_the_page_needs(tmp_path: Path) -> None:
    lines = call("doctor", tmp_path).output.splitlines()
    assert any("page (georef serve)" in line and "fastapi" in line for line in lines)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_it_prints_its_address_and_ends_in_order(empty: Path) -> None:
    with served(empty) as running:
        # to an empty project, too, the page answers and tells what to do
        assert running.address.startswith("http://127.0.0.1:")
        with httpx.Client(trust_env=False, follow_redirects=True) as client:
            page = client.get(running.address)
        assert page.status_code == 200
        assert "token" not in str(page.url)
        running.process.send_signal(signal.SIGINT)
        assert running.process.wait(20) == 0
        assert running.process.stderr is not None
        told = running.process.stderr.read()
    assert "Traceback" not in told


@pytest.mark.slow
def test_a_second_page_finds_a_port_of_its_own(empty: Path) -> None:
    with served(empty) as first, served(empty) as second:
        assert first.port != second.port
        # ports of one machine share their cookies: the names differ
        with httpx.Client(trust_env=False) as client:
            client.get(first.address)
            client.get(second.address)
            for origin in (first.origin, second.origin):
                assert client.get(f"{origin}/api/state").status_code == 200
