"""Whether a page of a project is served already: a note beside the project, and who answers there.

The note may be of a server that crashed, or of another machine that shares the folder: what it says
counts only if its port answers to its token, which nobody else's does.
"""

from __future__ import annotations

import contextlib
import http.client
import json
import os
from collections.abc import Iterator
from pathlib import Path

from georef_gis.app.web.guard import Access
from georef_gis.project import Project

NOTE_FILE = ".georef.page"
LOOPBACK = "127.0.0.1"
# s; a page answers within some ms, also while a tool runs
_PATIENCE = 2.0
_LONGEST = 2000


def running_page(project: Project) -> Access | None:
    """Access to the page of a project that is served on this machine by this user, if one is."""
    try:
        note = json.loads((project.folder / NOTE_FILE).read_text("utf-8")[:_LONGEST])
        access = Access(port=int(note["port"]), token=str(note["token"]))
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return access if _answers(access) else None


def _answers(access: Access) -> bool:
    """Whether a page answers at its port and knows the token."""
    connection = http.client.HTTPConnection(LOOPBACK, access.port, timeout=_PATIENCE)
    try:
        headers = {"Cookie": f"{access.cookie}={access.token}"}
        connection.request("GET", "/api/state", headers=headers)
        answer = connection.getresponse()
        return answer.status == http.client.OK and "revisions" in json.loads(answer.read())
    except (OSError, ValueError, TypeError, http.client.HTTPException):
        return False
    finally:
        connection.close()


@contextlib.contextmanager
def noted(project: Project, access: Access) -> Iterator[None]:
    """Say beside the project where its page is, as long as it is served; only the user may read it.

    A folder that cannot be written costs the note, not the page.
    """
    path = project.folder / NOTE_FILE
    text = json.dumps({"port": access.port, "token": access.token, "process": os.getpid()})
    with contextlib.suppress(OSError):
        _write(path, text)
    try:
        yield
    finally:
        with contextlib.suppress(OSError):
            # Another page may have been started beside this one.
            if path.read_text("utf-8") == text:
                path.unlink()


def _write(path: Path, text: str) -> None:
    """Put a note in the place of an older one, never readable by others."""
    part = path.with_name(f"{path.name}.{os.getpid()}")
    part.unlink(missing_ok=True)
    stream = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with open(stream, "w", encoding="utf-8") as file:
        file.write(text)
    os.replace(part, path)
