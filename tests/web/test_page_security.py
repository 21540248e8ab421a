"""Who may ask the page's server, and what: everything else is refused in one line of JSON."""

from __future__ import annotations

import contextlib
import json
import re
import socket
from collections.abc import Iterator
from importlib import resources
from typing import Any

import pytest

from georef_gis.app.web.bodies import MOST_BODY
from georef_gis.app.web.files import page_files
from georef_gis.app.web.guard import HEADERS

pytestmark = pytest.mark.slow
ADDRESSES = (
    "/", "/static/main.js", "/static/vendor/ol.js", "/report", "/api/state", "/api/tools",
    "/pictures/view/map_tile?name=mosaic&z=0&x=0&y=0", "/nothing",
)  # fmt: skip


@pytest.fixture
def client(page_of_site: tuple[Any, Any]) -> Any:
    return page_of_site[0]


@pytest.fixture
def stranger(page_of_site: tuple[Any, Any]) -> Iterator[Any]:
    """The same server, asked by somebody who was not told the token."""
    client, access = page_of_site
    cookies = dict(client.cookies)
    client.cookies.clear()
    yield client
    client.cookies.update(cookies)
    assert dict(client.cookies) == {access.cookie: access.token}


def refused(answer: Any, *statuses: int) -> str:
    """The one line that says why."""
    assert answer.status_code in statuses, answer.text
    assert answer.headers["content-type"] == "application/json"
    assert len(answer.content) < 1500
    assert answer.text.count("\n") == 1
    content = json.loads(answer.text)
    assert set(content) <= {"error", "current"}
    assert "Traceback" not in content["error"]
    return str(content["error"])


# -- token ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("address", ADDRESSES)
def test_without_the_token_nothing_is_told(stranger: Any, address: str) -> None:
    assert "token is missing" in refused(stranger.get(address), 403)


@pytest.mark.parametrize("value", ["", "x", "\u00e9", "a" * 4000])
def test_a_wrong_token_opens_nothing(
    stranger: Any, page_of_site: tuple[Any, Any], value: str
) -> None:
    cookie = f"{page_of_site[1].cookie}={value}".encode()
    assert refused(stranger.get("/api/state", headers={b"cookie": cookie}), 403)
    assert refused(stranger.get("/", params={"token": value}), 403)
    assert refused(stranger.post("/api/jobs", json={"tool": "run"}), 403)


def test_the_token_becomes_a_cookie_that_scripts_and_other_sites_do_not_get(
    stranger: Any, page_of_site: tuple[Any, Any]
) -> None:
    token = page_of_site[1].token
    # 256 bits, as text
    assert len(token) >= 43
    answer = stranger.get("/", params={"token": token})
    assert answer.status_code == 303
    assert answer.headers["location"] == "/"
    words = [word.strip().lower() for word in answer.headers["set-cookie"].split(";")]
    assert {"httponly", "samesite=strict", "path=/"} <= set(words)
    stranger.cookies.clear()


def test_two_pages_have_different_tokens() -> None:
    from georef_gis.app.web.guard import Access

    one, other = Access(port=8642), Access(port=8642)
    assert one.token != other.token
    assert one.token not in repr(one)


# -- host and origin -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    "host",
    ["evil.example", "evil.example:{port}", "127.0.0.1", "127.0.0.1:1", "", "0.0.0.0:{port}",
     "127.0.0.1:{port}.evil.example", "127.0.0.1:{port}@evil.example", "[::1]:{port}"],
)  # fmt: skip
def test_a_name_that_was_rebound_to_this_machine_is_not_served(
    client: Any, page_of_site: tuple[Any, Any], host: str
) -> None:
    named = host.format(port=page_of_site[1].port)
    assert "host" in refused(client.get("/api/state", headers={"host": named}), 421)


def raw(port: int, request: bytes) -> bytes:
    """What the server answers to bytes that no client would send."""
    with socket.create_connection(("127.0.0.1", port), timeout=10.0) as connection:
        connection.sendall(request)
        connection.shutdown(socket.SHUT_WR)
        answer = b""
        while part := connection.recv(65536):
            answer += part
    return answer


@pytest.mark.parametrize(
    "head",
    [b"Host: 127.0.0.1:%d\r\nHost: evil.example", b"Host: 127.0.0.1:%d\r\nX: " + b"a" * 100_000,
     b"Host: 127.0.0.1:%d\r\nContent-Length: 5\r\nContent-Length: 9",
     b"Host: 127.0.0.1:%d\r\nContent-Length: -1", b"Host: 127.0.0.1:%d\r\n\x00: 1"],
    ids=["two hosts", "long header", "two lengths", "negative length", "control character"],
)  # fmt: skip
def test_a_broken_head_is_refused(page_of_site: tuple[Any, Any], head: bytes) -> None:
    port = page_of_site[1].port
    answer = raw(
        port, b"GET /api/state HTTP/1.1\r\n" + head.replace(b"%d", b"%d" % port) + b"\r\n\r\n"
    )
    assert answer.startswith(b"HTTP/1.1 4"), answer[:200]
    assert b"revisions" not in answer


def test_a_socket_is_not_opened(page_of_site: tuple[Any, Any], client: Any) -> None:
    port, cookies = page_of_site[1].port, cookie(client)
    head = (
        f"GET /api/state HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nCookie: {cookies}\r\n"
        "Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n"
        "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n"
    )
    assert b" 101 " not in raw(port, head.encode())[:20]


def cookie(client: Any) -> str:
    return "; ".join(f"{name}={value}" for name, value in client.cookies.items())


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", "https://127.0.0.1:{port}", "http://127.0.0.1:1",
               "http://localhost:{port}"]
)  # fmt: skip
def test_another_pages_request_is_refused_though_it_has_the_cookie(
    client: Any, page_of_site: tuple[Any, Any], origin: str
) -> None:
    named = origin.format(port=page_of_site[1].port)
    for answer in (
        client.post("/api/measure/undo", json={}, headers={"origin": named}),
        client.get("/api/state", headers={"origin": named}),
    ):
        assert "another page" in refused(answer, 403)


def test_a_post_without_an_origin_is_refused(client: Any) -> None:
    kept = client.headers.pop("origin")
    try:
        assert "Origin" in refused(client.post("/api/measure/undo", json={}), 403)
    finally:
        client.headers["origin"] = kept


@pytest.mark.parametrize("site", ["cross-site", "same-site"])
def test_pictures_are_not_given_to_other_pages(client: Any, site: str) -> None:
    address = "/pictures/view/map_tile?name=mosaic&z=0&x=0&y=0"
    assert refused(client.get(address, headers={"sec-fetch-site": site}), 403)
    # a link to the page itself is followed
    assert client.get("/", headers={"sec-fetch-site": site}).status_code == 200


@pytest.mark.parametrize("method", ["PUT", "DELETE", "OPTIONS", "PATCH", "TRACE", "HEAD"])
def test_other_methods_are_refused(client: Any, method: str) -> None:
    assert client.request(method, "/api/state").status_code == 405


# -- what the page may load ----------------------------------------------------------------------


def test_the_page_runs_its_own_scripts_only(client: Any) -> None:
    for address in ("/", "/static/main.js", "/api/state", "/nothing"):
        answer = client.get(address)
        policy = answer.headers["content-security-policy"]
        assert "script-src 'self'" in policy
        assert "default-src 'none'" in policy
        assert "unsafe" not in policy
        for name in HEADERS:
            assert name in answer.headers, name


def test_the_report_may_run_nothing(client: Any) -> None:
    policy = client.get("/report").headers["content-security-policy"]
    assert "sandbox" in policy
    assert "script-src" not in policy
    assert "default-src 'none'" in policy


def test_nothing_of_the_page_is_inline_or_from_elsewhere() -> None:
    own = {name: file.content.decode() for name, file in page_files().items()
           if "/vendor/" not in name}  # fmt: skip
    assert len(own) > 15
    page = own["/"]
    assert not re.search(r"<script(?![^>]*\bsrc=)", page)
    assert not re.search(r"\son\w+\s*=|\sstyle\s*=|<style", page)
    for name, text in own.items():
        addresses = set(re.findall(r"(?:https?:)?//[\w.-]+\.\w+", text)) - {"//www.w3.org"}
        assert {a for a in addresses if not a.endswith("www.w3.org")} == set(), name


def test_text_is_never_read_as_html() -> None:
    for name, file in page_files().items():
        if name.endswith(".js") and "/vendor/" not in name:
            found = re.search(
                rb"innerHTML|outerHTML|insertAdjacentHTML|document\.write|\beval\(|new Function",
                file.content,
            )
            assert found is None, name


def test_the_vendored_library_comes_with_its_licence() -> None:
    folder = resources.files("georef_gis.app.web") / "static" / "vendor"
    assert "BSD 2-Clause" in (folder / "ol.LICENSE.md").read_text()


# -- paths ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "path",
    ["/static/../project.toml", "/static/%2e%2e/%2e%2e/project.toml", "/static/..%2fproject.toml",
     "/static/vendor/../../application.py", "/static//etc/passwd", "/static/%00", "/project.toml",
     "/products/mosaic.tif", "/static/..\\..\\application.py", "/static/index.html"],
)  # fmt: skip
def test_no_address_leads_out_of_the_pages_files(client: Any, path: str) -> None:
    assert "nothing at this address" in refused(client.get(path), 404)


@pytest.mark.parametrize(
    "photo", ["../photos/IMG_0001.JPG", "IMG_0001.JPG", "/etc/passwd", "project.toml", "", "%00"]
)
def test_photos_are_looked_up_never_opened_by_path(client: Any, photo: str) -> None:
    asked = {"photo": photo, "z": 0, "x": 0, "y": 0}
    assert "no photo" in refused(client.get("/pictures/view/photo_tile", params=asked), 400)
    assert "no photo" in refused(client.post("/api/view/photo", json={"photo": photo}), 400)


@pytest.mark.parametrize("name", ["../georef.gpkg", "mosaic.tif", "overlap", "/etc/passwd"])
def test_maps_and_layers_have_names_not_paths(client: Any, name: str) -> None:
    asked = {"name": name, "z": 0, "x": 0, "y": 0}
    assert "no map" in refused(client.get("/pictures/view/map_tile", params=asked), 400)
    assert "no layer" in refused(client.post("/api/view/layer", json={"name": name}), 400)


# -- size and form -------------------------------------------------------------------------------


def test_a_giant_request_is_refused_by_its_stated_length(client: Any) -> None:
    body = b" " * (MOST_BODY + 1)
    answer = client.post("/api/measure/figure", content=body, headers=JSON)
    assert "larger than 1 MB" in refused(answer, 413)


def test_a_giant_request_is_refused_though_it_states_no_length(client: Any) -> None:
    def parts() -> Iterator[bytes]:
        for _ in range(20):
            yield b" " * 100_000

    answer = client.post("/api/measure/figure", content=parts(), headers=JSON)
    assert "larger than 1 MB" in refused(answer, 413)


@pytest.mark.parametrize(
    ("address", "head", "status"),
    [("/api/measure/figure", "Content-Type: application/json", 413),
     ("/api/measure/figure", "Content-Type: text/plain", 413),
     ("/api/measure/nothing", "Content-Type: application/json", 413),
     ("/api/measure/figure", "Origin: http://evil.example", 403)],
)  # fmt: skip
def test_one_who_still_sends_gets_the_answer(
    page_of_site: tuple[Any, Any], client: Any, address: str, head: str, status: int
) -> None:
    # more than the buffers of two sockets hold: the answer is there long before the last byte
    giant = b" " * 12_000_000
    answer = raw(page_of_site[1].port, post_head(client, address, len(giant), head) + giant)
    assert answer.startswith(b"HTTP/1.1 %d " % status), answer[:200]
    assert answer.endswith(b"}\n")


def test_one_who_never_ends_is_cut_off(page_of_site: tuple[Any, Any], client: Any) -> None:
    port, sent = page_of_site[1].port, 0
    with (
        socket.create_connection(("127.0.0.1", port), timeout=20.0) as connection,
        contextlib.suppress(ConnectionError),
    ):
        connection.sendall(post_head(client, "/api/measure/figure", 10**12, "X: 1"))
        while sent < 100_000_000:
            connection.sendall(b" " * 1_000_000)
            sent += 1_000_000
    # 16 MB are heard; the buffers of two sockets hold the rest
    assert sent < 50_000_000


def post_head(client: Any, address: str, length: int, line: str) -> bytes:
    """Head of a POST with a body of so many bytes, and one more line."""
    origin = "" if line.startswith("Origin") else f"Origin: {client.headers['origin']}\r\n"
    return (
        f"POST {address} HTTP/1.1\r\nHost: {client.base_url.netloc.decode()}\r\n{origin}"
        f"Cookie: {cookie(client)}\r\nContent-Length: {length}\r\n{line}\r\n\r\n"
    ).encode()


JSON = {"content-type": "application/json"}
CLICK = {"photo": "IMG_0004", "u": 10.0, "v": 10.0}


@pytest.mark.parametrize(
    "body",
    [
        b"", b"{", b"[]", b"null", b'"x"', b"\xff\xfe", b"{}", b"[" * 200_000,
        b'{"photo": ' * 20_000, b'{"photo": "IMG_0004", "u": NaN, "v": 1}',
        b'{"photo": "IMG_0004", "u": 1e999, "v": 1}', b'{"photo": "IMG_0004", "u": 1}',
        b'{"photo": 4, "u": 1, "v": 1}', b'{"photo": "IMG_0004", "u": "x", "v": 1}',
        b'{"photo": "IMG_0004", "u": 1, "v": 1, "path": "/etc/passwd"}',
        b'{"photo": "IMG_0004", "u": 1, "v": 1, "sigma_px": 0}',
        b'{"photo": "' + b"A" * 600 + b'", "u": 1, "v": 1}',
    ],
)  # fmt: skip
def test_a_malformed_request_is_refused_in_one_line(client: Any, body: bytes) -> None:
    refused(client.post("/api/measure/place", content=body, headers=JSON), 422)


@pytest.mark.parametrize(
    "kind", ["text/plain", "multipart/form-data", "application/x-www-form-urlencoded"]
)
def test_forms_that_other_pages_could_send_are_refused(client: Any, kind: str) -> None:
    answer = client.post("/api/measure/undo", content=b"{}", headers={"content-type": kind})
    assert "JSON" in refused(answer, 400)


@pytest.mark.parametrize(
    "query", ["", "name=mosaic", "name=mosaic&z=-1&x=0&y=0", "name=mosaic&z=x&x=0&y=0",
              "name=mosaic&z=0&x=99999999999999999999&y=0", "name=mosaic&z=0&x=0&y=0&path=/etc"]
)  # fmt: skip
def test_a_malformed_picture_request_is_refused(client: Any, query: str) -> None:
    refused(client.get(f"/pictures/view/map_tile?{query}"), 422)


def test_more_vertices_than_anybody_clicks_are_refused(client: Any) -> None:
    vertex = {"clicks": [CLICK]}
    many = {"shape": "line", "vertices": [vertex] * 2001}
    assert "vertices" in refused(client.post("/api/measure/figure", json=many), 422)


@pytest.mark.parametrize("address", ["/api/measure/session", "/api/measure/__init__", "/api/x/y",
                                     "/api/view/map_tile", "/api/measure/close"])  # fmt: skip
def test_only_what_is_marked_as_a_call_can_be_called(client: Any, address: str) -> None:
    refused(client.post(address, json={}), 404)


def test_a_click_on_no_photo_or_outside_of_it_is_told_in_one_line(client: Any) -> None:
    gone = client.post("/api/measure/place", json={**CLICK, "photo": "<script>"})
    assert "<script>" in refused(gone, 400)
    outside = client.post("/api/measure/place", json={**CLICK, "u": 5000.0})
    assert "outside" in outside.json()["why_not"]


# -- tools ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("tool", "values", "word"),
    [
        ("no_such_tool", {}, "no tool"),
        ("where_to_click", {"target": "/tmp/x.csv"}, "inside the project"),
        ("where_to_click", {"target": "../x.csv"}, "inside the project"),
        ("where_to_click", {"target": "project.toml"}, "over products only"),
        ("where_to_click", {"target": "georef.gpkg"}, "over products only"),
        ("where_to_click", {"target": "products/../control/marks.csv"}, "over products only"),
        ("where_to_click", {"best": "many"}, "best"),
        ("where_to_click", {"no_such": 1}, "no such parameter"),
        ("run", {"only": "mosaic"}, "no such parameter"),
    ],
)
def test_a_tool_is_not_started_with_what_does_not_fit(
    client: Any, tool: str, values: dict[str, Any], word: str
) -> None:
    answer = client.post("/api/jobs", json={"tool": tool, "values": values})
    assert word in refused(answer, 400)
    assert client.get("/api/state").json()["job"] is None


@pytest.mark.parametrize("number", ["0", "999", "-1", "x", "1/../..", "9" * 50])
def test_runs_are_asked_for_by_number(client: Any, number: str) -> None:
    assert client.get(f"/api/jobs/{number}/events").status_code in (400, 404)
    assert client.post(f"/api/jobs/{number}/cancel", json={}).status_code in (400, 404)


def test_the_page_is_on_the_loopback_only() -> None:
    from georef_gis.app.web.server import LOOPBACK, _listen

    with _listen(0, True) as listening:
        assert listening.getsockname()[0] == LOOPBACK == "127.0.0.1"


def test_the_second_piece_of_an_answer_does_not_wait_for_a_receipt() -> None:
    """Asyncio turns Nagle's algorithm off only where it sees that a socket speaks TCP."""
    from georef_gis.app.web.server import _listen

    with _listen(0, True) as listening:
        assert listening.proto == socket.IPPROTO_TCP
