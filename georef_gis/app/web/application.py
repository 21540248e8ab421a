"""The page's server: files of the page, calls and pictures of services, runs of tools."""

from __future__ import annotations

import asyncio
import json
import threading
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any

from anyio import CapacityLimiter, to_thread
from fastapi import FastAPI
from pydantic import Field, ValidationError
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response, StreamingResponse

from georef_gis import __version__
from georef_gis.app.web.answers import answer, on_error
from georef_gis.app.web.bodies import TooLargeError
from georef_gis.app.web.files import page_files
from georef_gis.app.web.forms import check_order, tools_for_page
from georef_gis.app.web.guard import Access, Guard
from georef_gis.app.web.jobs import Job, Jobs
from georef_gis.errors import GeorefError, InputError
from georef_gis.project import Project
from georef_gis.toolbox.registry import Registry
from georef_gis.toolbox.services import Endpoint, Picture, Services
from georef_gis.toolbox.services import Request as ServiceRequest

# The report is a page of its own, with styles and pictures inside it and nothing that runs.
_REPORT_CSP = (
    "default-src 'none'; style-src 'unsafe-inline'; img-src data:; frame-ancestors 'self'; sandbox"
)
# A page asks for dozens of tiles at once; a click must not wait behind them.
_PICTURES_AT_ONCE = 4
_CALLS_AT_ONCE = 8
# s between two looks at a run
_PULSE = 0.15
_HOUR = "private, max-age=3600"


class JobOrder(ServiceRequest):
    """A tool to run; `run` stands for all steps of `georef run`."""

    tool: str = Field(max_length=200)
    values: dict[str, Any] = Field(default_factory=dict, max_length=200)


def make_app(project: Project, services: Services, registry: Registry, access: Access) -> Guard:
    """Application of one project, behind its guard."""
    server = _Server(project, services, registry)
    app = FastAPI(
        docs_url=None, redoc_url=None, openapi_url=None, lifespan=server.lifespan,
        title="georef", version=__version__,
    )  # fmt: skip
    app.add_api_route("/", server.file, methods=["GET"])
    app.add_api_route("/static/{rest:path}", server.file, methods=["GET"])
    app.add_api_route("/report", server.report, methods=["GET"])
    app.add_api_route("/api/state", server.state, methods=["GET"])
    app.add_api_route("/api/tools", server.tools, methods=["GET"])
    app.add_api_route("/api/jobs", server.start_job, methods=["POST"])
    app.add_api_route("/api/jobs/{number}/cancel", server.cancel_job, methods=["POST"])
    app.add_api_route("/api/jobs/{number}/events", server.job_events, methods=["GET"])
    app.add_api_route("/api/{service}/{name}", server.call, methods=["POST"])
    app.add_api_route("/pictures/{service}/{name}", server.picture, methods=["GET"])
    app.add_exception_handler(HTTPException, _not_found)
    for kind in (GeorefError, ValidationError, TooLargeError, Exception):
        app.add_exception_handler(kind, on_error)
    return Guard(app, access)


async def _not_found(request: Request, error: Exception) -> Response:
    status = getattr(error, "status_code", 500)
    words = {404: "there is nothing at this address", 405: "this address takes another method"}
    return answer({"error": words.get(status, str(error))}, status)


class _Server:
    """Handlers; blocking work is done in threads."""

    def __init__(self, project: Project, services: Services, registry: Registry) -> None:
        self._project = project
        self._services = services
        self._registry = registry
        self._files = page_files()
        self._jobs = Jobs(project)
        self._endpoints: dict[tuple[str, str], Endpoint] = {
            (name, endpoint.name): endpoint
            for name, service in services.found.items()
            for endpoint in service.endpoints().values()
        }
        self._pictures = CapacityLimiter(_PICTURES_AT_ONCE)
        self._calls = CapacityLimiter(_CALLS_AT_ONCE)

    @asynccontextmanager
    async def lifespan(self, app: FastAPI) -> AsyncIterator[None]:
        """Prepare the services beside the first requests; stop runs at the end."""
        threading.Thread(target=self._services.prepare, daemon=True).start()
        yield
        await to_thread.run_sync(self._jobs.close)
        self._services.close()

    async def file(self, request: Request) -> Response:
        """A file of the page itself."""
        found = self._files.get(request.url.path)
        if found is None:
            raise HTTPException(404)
        headers = {"etag": found.tag, "cache-control": "no-cache"}
        if request.headers.get("if-none-match") == found.tag:
            return Response(status_code=304, headers=headers)
        return Response(found.content, media_type=found.media_type, headers=headers)

    async def report(self) -> Response:
        """The project's report, which may run nothing."""
        made = await self._run(self._endpoint("view", "report", picture=True), {}, self._pictures)
        headers = {"content-security-policy": _REPORT_CSP}
        return Response(made.content, media_type=made.media_type, headers=headers)

    async def state(self) -> Response:
        """What changes when another tab, a tool or a GIS changes something."""
        revisions = await to_thread.run_sync(self._services.revisions, limiter=self._calls)
        running = self._jobs.running()
        content = {"revisions": revisions, "job": running.told() if running else None}
        return answer({**content, "version": __version__})

    # -- services --------------------------------------------------------------------------------

    async def call(self, service: str, name: str, request: Request) -> Response:
        """A call of a service: JSON in, JSON out."""
        endpoint = self._endpoint(service, name, picture=False)
        body = await _json_body(request)
        return answer(await self._run(endpoint, body, self._calls))

    async def picture(self, service: str, name: str, request: Request) -> Response:
        """A picture of a service."""
        endpoint = self._endpoint(service, name, picture=True)
        made: Picture = await self._run(endpoint, dict(request.query_params), self._pictures)
        cached = {"cache-control": _HOUR} if request.query_params.get("v") else {}
        return Response(made.content, media_type=made.media_type, headers=cached)

    def _endpoint(self, service: str, name: str, *, picture: bool) -> Endpoint:
        found = self._endpoints.get((service, name))
        if found is None or found.is_picture != picture:
            raise HTTPException(404)
        return found

    async def _run(self, endpoint: Endpoint, given: Any, limiter: CapacityLimiter) -> Any:
        read: Callable[[Any], ServiceRequest] = (
            endpoint.Request.model_validate_json
            if isinstance(given, bytes)
            else endpoint.Request.model_validate
        )
        return await to_thread.run_sync(lambda: endpoint.run(read(given)), limiter=limiter)

    # -- tools -----------------------------------------------------------------------------------

    async def tools(self) -> Response:
        """The manifest, with the runs of this page."""
        content = await to_thread.run_sync(tools_for_page, self._registry, self._project)
        return answer({**content, "jobs": self._jobs.told()})

    async def start_job(self, request: Request) -> Response:
        """Start a tool."""
        order = JobOrder.model_validate_json(await _json_body(request))

        def start() -> Job:
            tool = check_order(self._registry, self._project, order.tool, order.values)
            return self._jobs.start(tool, order.values)

        return answer((await to_thread.run_sync(start)).told())

    async def cancel_job(self, number: str) -> Response:
        """Ask a run to stop."""
        job = self._jobs.get(_number(number))
        job.cancel()
        return answer(job.told())

    async def job_events(self, number: str) -> Response:
        """Events of a run from its begin on, as they come."""
        job = self._jobs.get(_number(number))
        return StreamingResponse(_stream(job), media_type="text/event-stream")


async def _stream(job: Job) -> AsyncIterator[str]:
    sent = 0
    progress: dict[str, Any] = {}
    while True:
        state = job.state
        for event in job.events[sent:]:
            yield _event(event)
            sent += 1
        if job.progress != progress:
            progress = job.progress
            yield _event(progress)
        if state != "runs":
            yield _event({"event": "end", "state": state})
            return
        await asyncio.sleep(_PULSE)


def _event(content: dict[str, Any]) -> str:
    return f"data: {json.dumps(content)}\n\n"


async def _json_body(request: Request) -> bytes:
    kind = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    if kind != "application/json":
        raise InputError("the request must be JSON (content-type: application/json)")
    return await request.body() or b"{}"


def _number(text: str) -> int:
    if not (text.isascii() and text.isdigit() and len(text) < 10):
        raise InputError(f"{text[:20]!r} is no number of a run")
    return int(text)
