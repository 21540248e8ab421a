"""Runs the page's server until the user stops it."""

from __future__ import annotations

import contextlib
import os
import socket
import threading
import webbrowser
from collections.abc import Callable

import uvicorn

from georef_gis.app.web.application import make_app
from georef_gis.app.web.guard import Access
from georef_gis.app.web.running import LOOPBACK, noted
from georef_gis.errors import InputError
from georef_gis.project import Project
from georef_gis.toolbox.registry import load_registry
from georef_gis.toolbox.services import load_services

# bytes of the head of a request; tiles of photos with long ids take 700
_MOST_HEAD = 16_384
_MOST_CONNECTIONS = 200
# s
_IDLE, _GRACE = 60, 1


def run_server(
    project: Project, port: int, *, tell: Callable[[str], None], fixed: bool, browser: bool
) -> None:
    """Serve a project's page until Ctrl-C.

    Parameters
    ----------
    tell
        Is given the address once it answers.
    fixed
        Whether it must be that port; else a free one where it is taken.

    Raises
    ------
    InputError
        If the port is taken, or a service cannot be loaded.
    """
    services = load_services(project)
    if services.refused:
        raise services.refused[0]
    with contextlib.closing(_listen(port, fixed)) as listening:
        access = Access(port=listening.getsockname()[1])
        app = make_app(project, services, load_registry(), access)
        server = uvicorn.Server(_config(app))
        threading.Thread(
            target=_open_when_ready, args=(server, access, tell, browser), daemon=True
        ).start()
        # uvicorn raises the signal once more after it has closed everything in order.
        with noted(project, access), contextlib.suppress(KeyboardInterrupt):
            server.run(sockets=[listening])


def _config(app: object) -> uvicorn.Config:
    return uvicorn.Config(
        app,  # type: ignore[arg-type]
        http="h11",
        ws="none",
        log_level="error",
        access_log=False,
        server_header=False,
        h11_max_incomplete_event_size=_MOST_HEAD,
        limit_concurrency=_MOST_CONNECTIONS,
        timeout_keep_alive=_IDLE,
        timeout_graceful_shutdown=_GRACE,
    )


def _listen(port: int, fixed: bool) -> socket.socket:
    for wanted in (port,) if fixed else (port, 0):
        # asyncio sends at once only where the protocol is named; else the second piece of every
        # answer waits 40 ms for the first one's receipt.
        found = socket.socket(socket.AF_INET, socket.SOCK_STREAM, socket.IPPROTO_TCP)
        if os.name == "posix":
            # Elsewhere it would let two programs have one port.
            found.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            found.bind((LOOPBACK, wanted))
        except OSError as error:
            found.close()
            reason = error.strerror
            continue
        found.listen(128)
        return found
    raise InputError(f"cannot be used ({reason}); name another", source=f"port {port}")


def _open_when_ready(
    server: uvicorn.Server, access: Access, tell: Callable[[str], None], browser: bool
) -> None:
    waiting = threading.Event()
    while not server.started:
        if server.should_exit or waiting.wait(0.02):
            return
    tell(access.address)
    if browser:
        webbrowser.open(access.address)
