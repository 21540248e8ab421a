"""What the page gets back: JSON of one line, also where something went wrong."""

from __future__ import annotations

import json
import logging
from typing import Any

from pydantic import ValidationError
from starlette.requests import Request
from starlette.responses import Response

from georef_gis.app.feedback import plain
from georef_gis.app.web.bodies import MOST_BODY, TooLargeError
from georef_gis.app.web.jobs import BusyError
from georef_gis.errors import GeorefError
from georef_gis.toolbox.services import ConflictError

logger = logging.getLogger(__name__)

# characters of a message; what a user typed may stand in it
_LONGEST = 600


def answer(content: Any, status: int = 200) -> Response:
    """Content as JSON; a missing number is null, as NaN is no JSON."""
    try:
        text = json.dumps(content, allow_nan=False)
    except (TypeError, ValueError):
        text = json.dumps(plain(content), allow_nan=False)
    return Response(text + "\n", status_code=status, media_type="application/json")


def refusal(error: Exception) -> Response:
    """Answer to a request that raised."""
    if isinstance(error, ConflictError):
        return answer({"error": _line(error), "current": error.current}, 409)
    if isinstance(error, BusyError):
        return answer({"error": _line(error)}, 409)
    if isinstance(error, ValidationError):
        return answer({"error": _complaint(error)}, 422)
    if isinstance(error, TooLargeError):
        return answer({"error": f"the request is larger than {MOST_BODY / 1e6:g} MB"}, 413)
    if isinstance(error, GeorefError):
        return answer({"error": _line(error)}, 400)
    logger.error("a request failed", exc_info=error)
    return answer(
        {"error": f"this is a bug in georef: {type(error).__name__}: {_line(error)}"}, 500
    )


async def on_error(request: Request, error: Exception) -> Response:
    """Handler of an application for everything that is raised."""
    return refusal(error)


def _line(error: Exception) -> str:
    return " ".join(str(error).split())[:_LONGEST]


def _complaint(error: ValidationError) -> str:
    """One line on the first thing that does not fit."""
    problems = error.errors(include_url=False, include_input=False, include_context=False)
    first = problems[0]
    where = ".".join(str(part)[:40] for part in first["loc"][:6])
    more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
    text = " ".join(str(first["msg"]).split()).lower()
    return (f"{where}: " if where else "") + text[:_LONGEST] + more
