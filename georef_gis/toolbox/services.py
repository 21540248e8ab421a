"""Services: what a page asks of an open project, found by entry point as tools are.

A distribution names one class for each service in the group ``georef_gis.services``; the name of
the entry point is the service's::

    class Heights(Service):
        @call(HeightRequest)
        def height(self, request: HeightRequest) -> dict[str, float]: ...

        @picture(TileRequest)
        def tile(self, request: TileRequest) -> Picture: ...

A call takes and gives JSON, a picture gives bytes. Both may be asked for by several threads at
once. What the user can cure is raised as `GeorefError`.
"""

from __future__ import annotations

import contextlib
import logging
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib.metadata import entry_points
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from pydantic import BaseModel, ConfigDict

from georef_gis.errors import GeorefError, InputError, PluginError

if TYPE_CHECKING:
    from georef_gis.project import Project

SERVICE_GROUP = "georef_gis.services"
_MARK = "_georef_endpoint"

logger = logging.getLogger(__name__)

F = TypeVar("F", bound=Callable[..., Any])
T = TypeVar("T")


class Request(BaseModel):
    """What is asked, as the page sends it; unknown names and NaN are refused."""

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        allow_inf_nan=False,
        defer_build=True,
        hide_input_in_errors=True,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Picture:
    """Bytes with their media type, e.g. ``image/jpeg``."""

    content: bytes
    media_type: str


class ConflictError(GeorefError):
    """A change was made from a state that is no longer there.

    Parameters
    ----------
    current
        JSON-able: the state now; None if there is nothing left.
    """

    def __init__(self, message: str, *, current: Any) -> None:
        super().__init__(message)
        self.current = current


@dataclass(frozen=True, slots=True, kw_only=True)
class Endpoint:
    """A call or picture of a service: `run` takes a `Request` and gives JSON, or a `Picture`."""

    name: str
    Request: type[Request]
    run: Callable[[Any], Any]
    is_picture: bool


def call(request: type[Request]) -> Callable[[F], F]:
    """Mark a method as a call: it takes one request and gives what JSON can hold."""
    return _marking(request, is_picture=False)


def picture(request: type[Request]) -> Callable[[F], F]:
    """Mark a method as one that gives a `Picture`."""
    return _marking(request, is_picture=True)


def _marking(request: type[Request], *, is_picture: bool) -> Callable[[F], F]:
    def mark(method: F) -> F:
        setattr(method, _MARK, (request, is_picture))
        return method

    return mark


class Service:
    """Base of every service; made once per project and asked until it is closed.

    Making one reads nothing yet: what cannot be read is told by the call that needs it.
    """

    def __init__(self, project: Project) -> None:
        self.project = project

    def endpoints(self) -> dict[str, Endpoint]:
        """Calls and pictures by name."""
        found = {}
        for name in dir(type(self)):
            mark = getattr(getattr(type(self), name), _MARK, None)
            if mark is not None:
                found[name] = Endpoint(
                    name=name, Request=mark[0], run=getattr(self, name), is_picture=mark[1]
                )
        return found

    def revisions(self) -> Mapping[str, str]:
        """Name of each thing that is shown -> text that changes when it does; asked for often."""
        return {}

    def prepare(self) -> None:
        """Read what the first questions will need; called in a thread while the page opens."""

    def close(self) -> None:
        """Give up what is open."""


class Renewed(Generic[T]):
    """Something read from the project, anew whenever the project has another state.

    A run replaces what is read tool by tool, and may be stopped between two of them: poses and
    cameras then do not go together. What was read before serves until the next state.

    Parameters
    ----------
    read
        Reads it; asked by one thread at a time.
    """

    def __init__(self, read: Callable[[], T]) -> None:
        self._read = read
        self._lock = threading.Lock()
        self._held: tuple[str, T] | None = None

    def get(self, state: str) -> T:
        """What was read of a state, or of the last one that could be read.

        Raises
        ------
        GeorefError
            If it could never be read.
        """
        with self._lock:
            if self._held is None:
                self._held = state, self._first()
            elif self._held[0] != state:
                self._held = state, self._next(self._held[1])
            return self._held[1]

    def _first(self) -> T:
        try:
            return self._read()
        except LookupError as error:
            raise InputError(
                f"the project's parts do not go together ({error} is missing), as after a run that "
                "was stopped; run `georef run` to its end"
            ) from error

    def _next(self, before: T) -> T:
        try:
            return self._read()
        except (GeorefError, LookupError) as error:
            logger.info("what was read before serves on: %s", error)
            return before


@dataclass(frozen=True, slots=True)
class Services:
    """Services of an open project by name, and what was refused."""

    found: Mapping[str, Service]
    refused: list[PluginError] = field(default_factory=list)

    def revisions(self) -> dict[str, str]:
        """Revisions of all services."""
        out: dict[str, str] = {}
        for service in self.found.values():
            out |= service.revisions()
        return out

    def prepare(self) -> None:
        """Prepare all of them; what cannot be read is told by the call that needs it."""
        for service in self.found.values():
            with contextlib.suppress(GeorefError):
                service.prepare()

    def close(self) -> None:
        """Close all of them."""
        for service in self.found.values():
            service.close()


def load_services(project: Project) -> Services:
    """Services of all installed distributions for a project; the first of a name counts."""
    found: dict[str, Service] = {}
    refused: list[PluginError] = []
    for entry in sorted(entry_points(group=SERVICE_GROUP), key=lambda one: (one.name, one.value)):
        if entry.name in found:
            continue
        try:
            made = entry.load()(project)
            if not isinstance(made, Service):
                raise PluginError(f"{entry.value} is no Service")
        except Exception as error:
            text = " ".join(f"{type(error).__name__}: {error}".split())
            refused.append(
                PluginError(f"service {entry.name}: {entry.value} cannot be used ({text})")
            )
        else:
            found[entry.name] = made
    return Services(found=found, refused=refused)
