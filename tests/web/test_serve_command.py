"""`georef serve` on the command line: what it says where it cannot start, and how it ends."""

from __future__ import annotations

import json
import shutil
import signal
import socket
import sys
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import httpx
import pytest
from click.testing import CliRunner, Result
from web_cases import served

from georef_gis.app import cli
from georef_gis.app.web.running import NOTE_FILE, running_page
from georef_gis.project import Project


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


def note(folder: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((folder / NOTE_FILE).read_text())
    return found


@pytest.mark.slow
def test_a_second_server_of_a_project_says_where_the_first_one_is(empty: Path) -> None:
    with served(empty) as first:
        assert note(empty)["port"] == first.port
        if sys.platform != "win32":
            # it holds the token
            assert (empty / NOTE_FILE).stat().st_mode & 0o077 == 0
        done = call("serve", empty, "--no-browser")
        assert done.exit_code == 0
        assert f"at port {first.port} already: {first.address}" in done.stdout
        same = call("serve", empty, "--no-browser", "--port", first.port)
        assert first.address in same.stdout
        other = call("serve", empty, "--no-browser", "--port", 60_000 + first.port % 5000)
        assert other.exit_code == 2
        assert f"at port {first.port} already: {first.address}" in other.stderr
        assert other.stderr.count("\n") == 1
        # who asks has not opened a page for others
        assert httpx.get(f"{first.origin}/api/state", trust_env=False).status_code in (401, 403)
    assert not (empty / NOTE_FILE).exists()


@pytest.mark.slow
def test_pages_of_two_projects_have_ports_and_cookies_of_their_own(
    empty: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    other = tmp_path_factory.mktemp("other")
    shutil.copytree(empty, other, dirs_exist_ok=True)
    with served(empty) as first, served(other) as second:
        assert first.port != second.port
        # ports of one machine share their cookies: the names differ
        with httpx.Client(trust_env=False) as client:
            client.get(first.address)
            client.get(second.address)
            for origin in (first.origin, second.origin):
                assert client.get(f"{origin}/api/state").status_code == 200


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_the_note_of_a_server_that_was_killed_keeps_nobody_out(empty: Path) -> None:
    with served(empty) as first:
        first.process.kill()
        first.process.wait(20)
        assert note(empty)["port"] == first.port
        with served(empty) as second:
            assert note(empty)["port"] == second.port
            assert second.address != first.address


def test_a_note_whose_port_is_now_another_programs_is_not_believed(empty: Path) -> None:
    class Stranger(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.end_headers()
            self.wfile.write(b"[]")

        def log_message(self, *_: object) -> None: ...

    with ThreadingHTTPServer(("127.0.0.1", 0), Stranger) as other:
        threading.Thread(target=other.serve_forever, daemon=True).start()
        content = {"port": other.server_port, "token": "t" * 40}
        (empty / NOTE_FILE).write_text(json.dumps(content))
        assert running_page(Project.open(empty)) is None
        other.shutdown()


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"port": "x", "token": 1}', "\0", '{"port": 1}'])
def test_a_note_that_is_none_is_not_believed(empty: Path, text: str) -> None:
    (empty / NOTE_FILE).write_text(text)
    assert running_page(Project.open(empty)) is None
