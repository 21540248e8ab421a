"""Runs one tool or the pipeline, skips what did not change, and records every run."""

from __future__ import annotations

import errno
import logging
import os
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from georef_gis.errors import Cancelled, ExportError, GeorefError, InputError
from georef_gis.project import Project
from georef_gis.project.fingerprint import Known
from georef_gis.project.lock import project_lock
from georef_gis.project.project import DATABASE_FILE
from georef_gis.toolbox.algorithm import Algorithm, Result
from georef_gis.toolbox.context import CollectingFeedback, Context, Feedback, check_cancelled
from georef_gis.toolbox.parameters import Parameters
from georef_gis.toolbox.pipeline import plan_steps, upstream_tools
from georef_gis.toolbox.records import recorded_result, recorded_summary
from georef_gis.toolbox.registry import Registry, Tool
from georef_gis.toolbox.specs import Spec
from georef_gis.toolbox.staleness import (
    CANCELLED,
    DONE,
    FAILED,
    REFUSED,
    dependencies,
    output_fingerprints,
    why_stale,
)
from georef_gis.toolbox.steps import RunOptions, StepFeedback, StepReport, default_workers

logger = logging.getLogger(__name__)

# A record keeps this many warnings; a batch of 10 000 photos may give as many.
MOST_WARNINGS = 1000
# Errors of the system that the user can cure.
CURABLE = (
    errno.ENOSPC, errno.EACCES, errno.EPERM, errno.EROFS, errno.EDQUOT, errno.EFBIG,
    errno.ENOENT, errno.ENOTDIR, errno.EISDIR, errno.EIO,
)  # fmt: skip


def run_tool(
    registry: Registry,
    name: str,
    values: Mapping[str, Any],
    feedback: Feedback,
    *,
    project: Project | None = None,
    options: RunOptions | None = None,
) -> StepReport:
    """Run one tool.

    Parameters
    ----------
    values
        Parameters as given: numbers in the declared unit, or texts. With a project, those of
        [tools.<id>] in project.toml hold where none is given.

    Raises
    ------
    GeorefError
        Whatever the user can cure; the record of the run says so too.
    """
    tool, options = registry.find(name), options or RunOptions()
    if project is None and tool.algorithm.needs_project:
        raise InputError(f"tool {tool.id} works on a project; give one with --project FOLDER")
    if not tool.algorithm.needs_project:
        return _run_alone(tool, values, feedback, options)
    assert project is not None
    parameters = _parameters(tool, project, values)
    with ExitStack() as stack:
        if tool.algorithm.makes_state():
            stack.enter_context(project_lock(project.folder))
        run = _Run(registry, project, feedback, options)
        return run.step(tool, parameters, forced=options.force or not tool.algorithm.in_run)


def run_pipeline(
    registry: Registry,
    project: Project,
    feedback: Feedback,
    *,
    values: Mapping[str, Mapping[str, Any]] | None = None,
    options: RunOptions | None = None,
) -> list[StepReport]:
    """Run the steps of `georef run` that are stale, in the order of what they need.

    Parameters
    ----------
    values
        Tool id -> parameter -> value, going before those of project.toml.
    """
    options = options or RunOptions()
    _warn_of_unknown_tools(registry, project, feedback)
    given = {registry.find(name).full_id: items for name, items in (values or {}).items()}
    steps = plan_steps(registry, options.only, options.start, quick=options.quick)
    # All parameters are read before the first step works for an hour.
    parameters = [_parameters(tool, project, given.get(tool.full_id, {})) for tool in steps]
    forced = registry.find(options.start).full_id if options.start else ""
    reports: list[StepReport] = []
    with project_lock(project.folder):
        run = _Run(registry, project, feedback, options)
        for number, (tool, own) in enumerate(zip(steps, parameters, strict=True)):
            if tool.algorithm.refines and not options.only:
                run.first_answer(steps[number:], parameters[number:])
            run.place(number, len(steps))
            force = options.force or tool.full_id == forced
            reports.append(run.step(tool, own, forced=force))
    feedback.progress(1.0, "done")
    return reports


def why_pending(
    registry: Registry,
    project: Project,
    *,
    values: Mapping[str, Mapping[str, Any]] | None = None,
    options: RunOptions | None = None,
) -> str:
    """Reason why `run_pipeline` would do something now; empty if every step still holds.

    Nothing is written, and no lock is needed: what another run does meanwhile is no step that
    holds.
    """
    options = options or RunOptions()
    given = {registry.find(name).full_id: items for name, items in (values or {}).items()}
    steps = plan_steps(registry, options.only, options.start, quick=options.quick)
    if options.force or options.start:
        return "it was asked for"
    if not (project.folder / DATABASE_FILE).is_file():
        return "it never ran"
    with project.reader() as reader:
        run = _Run(registry, reader, CollectingFeedback(), options)
        for tool in steps:
            parameters = _parameters(tool, reader, given.get(tool.full_id, {}))
            if reason := run.why_stale(tool, parameters):
                return f"{tool.id}: {reason}"
    return ""


def _warn_of_unknown_tools(registry: Registry, project: Project, feedback: Feedback) -> None:
    for name in project.settings.tools:
        try:
            registry.find(name)
        except InputError as error:
            feedback.warn(f"project.toml: [tools.{name}] is not used: {error}")


@contextmanager
def _curable(tool: Tool) -> Iterator[None]:
    """Turn what the user can cure, though no tool foresaw it, into a `GeorefError`."""
    try:
        yield
    except KeyboardInterrupt as error:
        raise Cancelled("stopped by the user") from error
    except MemoryError as error:
        raise GeorefError(f"tool {tool.id}: memory is used up; try fewer --workers") from error
    except OSError as error:
        if error.errno not in CURABLE:
            raise
        where = f"{error.filename}: " if error.filename else ""
        raise ExportError(
            f"tool {tool.id}: {where}{error.strerror}; check the path, free space and permission"
        ) from error


def _run_alone(
    tool: Tool, values: Mapping[str, Any], feedback: Feedback, options: RunOptions
) -> StepReport:
    """Run a tool that needs no project, without a record."""
    parameters = tool.algorithm.Parameters(**values)
    context = Context(
        workers=options.workers or default_workers(), seed=options.seed or 0, quick=options.quick
    )
    started = time.perf_counter()
    with _curable(tool):
        result = tool.algorithm().run(context, parameters, feedback)
    return StepReport(
        tool=tool, skipped=False, reason="", duration_s=time.perf_counter() - started, result=result
    )


def _parameters(tool: Tool, project: Project, given: Mapping[str, Any]) -> Parameters:
    """Parameters of a tool: those given, else those of project.toml, else the defaults."""
    tables = project.settings.tools
    stored: dict[str, Any] = {}
    for name in (tool.id, tool.full_id):
        stored |= tables.get(name, {})
    for spec in tool.algorithm.Parameters.specs():
        if spec.name in stored:
            value = stored[spec.name]
            many = isinstance(value, list)
            own = [_beside(project, spec, one) for one in (value if many else [value])]
            stored[spec.name] = own if many else own[0]
    return tool.algorithm.Parameters(**(stored | dict(given)))


def _beside(project: Project, spec: Spec, value: Any) -> Any:
    """Value of project.toml, to which the paths in it are relative."""
    if spec.kind in ("File", "Folder"):
        return project.path(value)
    # the name of a layer, or a word such as auto, has no suffix
    if spec.kind in ("RasterLayer", "VectorLayer") and isinstance(value, str):
        name, bar, rest = value.partition("|")
        return f"{project.path(name)}{bar}{rest}" if Path(name).suffix else value
    return value


class _Run:
    """A run of one or more steps on a project."""

    def __init__(
        self, registry: Registry, project: Project, feedback: Feedback, options: RunOptions
    ) -> None:
        self.registry = registry
        self.project = project
        self.options = options
        self.feedback = StepFeedback(feedback)
        seed = project.settings.project.seed if options.seed is None else options.seed
        self.context = Context(
            project=project,
            workers=options.workers or default_workers(),
            seed=seed,
            cache=project.cache,
            quick=options.quick,
        )
        self.known: Known = {}
        project.prepare()
        self.last = _last_runs(project)

    def place(self, number: int, count: int) -> None:
        """Say which part of the whole the next step is."""
        self.feedback = replace(self.feedback, first=number / count, share=1.0 / count, warnings=[])

    def first_answer(self, steps: Sequence[Tool], parameters: Sequence[Parameters]) -> None:
        """Run what gives a first answer and never came to its end, before it is made better."""
        waiting = [
            (tool, own)
            for tool, own in zip(steps, parameters, strict=True)
            if tool.algorithm.first_answer and not self._is_done(tool)
        ]
        for tool, own in waiting:
            report = self.step(tool, own, forced=False)
            for product in report.result.summary.get("products", ()):
                self.feedback.info(f"first answer: {product}")

    def step(self, tool: Tool, parameters: Parameters, *, forced: bool) -> StepReport:
        """Run a step, or find that its last run still holds."""
        check_cancelled(self.feedback)
        algorithm = tool.algorithm()
        now = self._dependencies(tool, algorithm, parameters)
        last = self.last.get(tool.full_id)
        stale = why_stale(last, now, self.project, verify=self.options.verify)
        if not stale and not forced and last is not None:
            logger.info("%s: unchanged", tool.id)
            result = recorded_result(last, self.project)
            return StepReport(tool=tool, skipped=True, reason="", duration_s=0.0, result=result)
        reason = stale or "it was asked for"
        logger.info("%s runs: %s", tool.id, reason)
        started = time.perf_counter()
        result = self._work(tool, algorithm, parameters, now)
        duration = time.perf_counter() - started
        return StepReport(
            tool=tool, skipped=False, reason=reason, duration_s=duration, result=result
        )

    def why_stale(self, tool: Tool, parameters: Parameters) -> str:
        """Reason why a step would run; empty if its last run still holds."""
        last = self.last.get(tool.full_id)
        if last is None:
            return why_stale(None, {}, self.project, verify=False)
        now = self._dependencies(tool, tool.algorithm(), parameters)
        return why_stale(last, now, self.project, verify=self.options.verify)

    def _is_done(self, tool: Tool) -> bool:
        return bool(self.last.get(tool.full_id, {}).get("outcome") == DONE)

    def _dependencies(
        self, tool: Tool, algorithm: Algorithm[Any], parameters: Parameters
    ) -> dict[str, Any]:
        return dependencies(
            tool, algorithm, self.context, parameters, self._upstream(tool),
            verify=self.options.verify, known=self.known,
        )  # fmt: skip

    def _upstream(self, tool: Tool) -> dict[str, int]:
        """Last runs of the steps whose results this one reads."""
        found: dict[str, int] = {}
        for need, givers in upstream_tools(self.registry, tool).items():
            done = {
                giver.full_id: int(self.last[giver.full_id]["fid"])
                for giver in givers
                if self._is_done(giver)
            }
            if givers and not done and need in tool.algorithm.needs:
                names = " or ".join(giver.id for giver in givers)
                raise InputError(
                    f"needs {need}, which {names} gives and which is not there yet; run "
                    "`georef run` first",
                    source=f"tool {tool.id}",
                )
            found |= done
        return found

    def _work(
        self, tool: Tool, algorithm: Algorithm[Any], parameters: Parameters, now: dict[str, Any]
    ) -> Result:
        database = self.project.database
        begun = {
            **now,
            "outcome": "started",
            "started": datetime.now(UTC).isoformat(" ", "milliseconds"),
            "process": os.getpid(),
        }
        fid = database.insert("run", begun)
        self.last[tool.full_id] = {**begun, "fid": fid}
        clock = time.perf_counter()
        try:
            context = replace(self.context, run_id=fid)
            with _curable(tool):
                result = algorithm.run(context, parameters, self.feedback)
            check_cancelled(self.feedback)
        except BaseException as error:
            outcome = _ending(tool, error)
            message = str(error) if isinstance(error, GeorefError) else repr(error)
            self._close(tool, fid, clock, outcome=outcome, message=message)
            raise
        outputs = output_fingerprints(
            result.outputs.values(), self.project, verify=self.options.verify
        )
        self._close(
            tool, fid, clock, outcome=DONE, summary=recorded_summary(result, self.project),
            outputs=outputs,
            warnings=[*self.feedback.warnings, *result.warnings][:MOST_WARNINGS],
        )  # fmt: skip
        return result

    def _close(self, tool: Tool, fid: int, clock: float, **columns: Any) -> None:
        columns["duration_s"] = round(time.perf_counter() - clock, 3)
        columns.setdefault("warnings", self.feedback.warnings[:MOST_WARNINGS])
        try:
            self.project.database.update("run", fid, **columns)
        except GeorefError:
            # A full disk must not hide the error that it caused; the record stays "started".
            if columns["outcome"] == DONE:
                raise
            logger.warning("the record of %s could not be written", tool.id)
        self.last[tool.full_id] = {**self.last[tool.full_id], **columns}


def _ending(tool: Tool, error: BaseException) -> str:
    """Outcome of a run that raised, as its record tells it.

    A tool that makes no part of the project and says what is wrong with what it was asked leaves
    the project as good as it was: that is no failure of the project.
    """
    if isinstance(error, Cancelled):
        return CANCELLED
    is_answer = isinstance(error, GeorefError) and not tool.algorithm.makes_state()
    return REFUSED if is_answer else FAILED


def _last_runs(project: Project) -> dict[str, dict[str, Any]]:
    """Last run of every tool, whatever became of it."""
    database = project.database
    return {row["tool"]: row for row in database.last_rows("run", "tool")}


def products_of(reports: Sequence[StepReport]) -> list[Path]:
    """Products of steps, in order, each once."""
    found = {
        str(path): None for report in reports for path in report.result.summary.get("products", ())
    }
    return [Path(path) for path in found]
