"""How every command talks: its options, its feedback, and what its errors become."""

from __future__ import annotations

import contextlib
import logging
import sys
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, NoReturn

import click

from georef_gis.app.feedback import JsonFeedback, PlainFeedback, Stop, make_feedback
from georef_gis.errors import Cancelled, GeorefError

DONE, BUG, USER_ERROR, CANCELLED = 0, 1, 2, 130


@dataclass(frozen=True, slots=True, kw_only=True)
class Face:
    """How a command talks: the options every command has, and what its warnings are about."""

    as_json: bool
    verbose: int
    about: str = "photos"


def face_options(function: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options that every command has."""
    function = click.option("--json", "as_json", is_flag=True, help="Talk in lines of JSON.")(
        function
    )
    return click.option("-v", "--verbose", count=True, help="Say more; -vv for developers.")(
        function
    )


@contextlib.contextmanager
def facing(face: Face) -> Iterator[PlainFeedback]:
    """Give feedback to the work inside, and turn its errors into messages and exit codes."""
    _start_logging(face.verbose)
    stop = Stop()
    feedback = make_feedback(as_json=face.as_json, stop=stop, about=face.about)
    try:
        with stop.listening(), feedback:
            yield feedback
    except (click.exceptions.Exit, click.ClickException, click.Abort):
        raise
    except (Cancelled, KeyboardInterrupt):
        _say(feedback, "cancelled", CANCELLED)
    except GeorefError as error:
        _say(feedback, str(error), USER_ERROR)
    except BrokenPipeError:
        sys.exit(DONE)
    except Exception as error:
        if face.verbose:
            traceback.print_exc()
        hint = "" if face.verbose else "; run again with -v for the details and report it"
        _say(feedback, f"this is a bug in georef: {type(error).__name__}: {error}{hint}", BUG)


def _say(feedback: PlainFeedback, message: str, code: int) -> NoReturn:
    if isinstance(feedback, JsonFeedback):
        feedback.event("error", message=" ".join(message.split()), exit_code=code)
    fail(message, code)


def fail(message: str, code: int) -> NoReturn:
    """Say a line on standard error and end with a code."""
    click.echo(f"georef: {' '.join(message.split())}", err=True)
    sys.exit(code)


def _start_logging(verbose: int) -> None:
    level = (logging.WARNING, logging.INFO, logging.DEBUG)[min(verbose, 2)]
    logger = logging.getLogger("georef_gis")
    logger.setLevel(level)
    if not any(isinstance(handler, logging.StreamHandler) for handler in logger.handlers):
        handler = logging.StreamHandler()
        handler.setFormatter(logging.Formatter("%(levelname)s %(name)s: %(message)s"))
        logger.addHandler(handler)
