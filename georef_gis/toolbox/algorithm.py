"""The contract of a tool: one class declares what it is, and every face is made from that."""

from __future__ import annotations

import inspect
import re
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Generic, TypeVar, get_args, get_origin

from georef_gis.errors import PluginError
from georef_gis.toolbox.context import Context, Feedback
from georef_gis.toolbox.parameters import Parameters

MANIFEST_VERSION = 1
# A word of a command, e.g. "sync-board".
WORD = re.compile(r"^[a-z][a-z0-9]*(-[a-z0-9]+)*$")
# The order of the groups is the order of the work.
GROUPS = ("project", "ingest", "navigate", "orient", "rectify", "mosaic", "measure", "export")

P = TypeVar("P", bound=Parameters)


@dataclass(frozen=True, slots=True, kw_only=True)
class Output:
    """Declaration of one output: a file or folder that `Result.outputs` names.

    Parameters
    ----------
    type
        ``File``, ``Folder``, ``RasterLayer`` or ``VectorLayer``.
    """

    name: str
    title: str
    type: str = "File"


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """What a run gives back.

    Parameters
    ----------
    outputs
        Files and folders written, by the names in `Algorithm.outputs`.
    summary
        JSON-able figures. Read by `georef run`: ``products`` (paths), ``gsd_m``, ``covered_m2``,
        ``doubts`` (lines of text). Other numbers and texts are shown for a single tool.
    warnings
        Besides those given through feedback.
    """

    outputs: Mapping[str, Path] = field(default_factory=dict)
    summary: Mapping[str, Any] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()


class Algorithm(ABC, Generic[P]):
    """Base of every tool. The docstring of the tool is its help.

    Write ``class Orthos(Algorithm[OrthosParameters])``. Import cv2, numpy, rasterio and the like
    inside `run`: listing the tools must stay fast.

    Attributes
    ----------
    id
        lower_case, unique within its distribution; ``_`` becomes ``-`` on the command line.
    group
        One of `GROUPS`, or a new one.
    command
        Words on the command line, e.g. ``("sync-board", "record")``, for tools that belong to one
        device; empty = the id.
    about
        What its messages of the form ``name: text`` are about, in the plural: faces count the
        names by it where several have one text.
    needs, gives
        Names of project tables and products, from which `georef run` finds the order.
    wants
        Names that it takes into account where they are there, and runs after.
    in_run
        Whether `georef run` includes the tool; then it also is skipped while unchanged.
    in_quick
        Whether `georef run --quick` includes it.
    uses_quick
        Whether its result depends on `Context.quick`.
    uses_settings
        Sections of project.toml it reads; None = all. A change in them makes it stale.
    refines
        Whether it betters, at some cost, what there is already.
    first_answer
        Whether it runs before the first step that refines, if it never ran, and again after it:
        then there is something to look at within seconds.
    needs_project
        Whether it works on a project.
    version
        To be raised when the same input gives another result.
    """

    id: ClassVar[str]
    name: ClassVar[str]
    group: ClassVar[str]
    command: ClassVar[tuple[str, ...]] = ()
    Parameters: ClassVar[type[Parameters]] = Parameters
    outputs: ClassVar[tuple[Output, ...]] = ()
    about: ClassVar[str] = "photos"
    needs: ClassVar[tuple[str, ...]] = ()
    wants: ClassVar[tuple[str, ...]] = ()
    gives: ClassVar[tuple[str, ...]] = ()
    in_run: ClassVar[bool] = False
    in_quick: ClassVar[bool] = True
    uses_quick: ClassVar[bool] = False
    uses_settings: ClassVar[tuple[str, ...] | None] = None
    refines: ClassVar[bool] = False
    first_answer: ClassVar[bool] = False
    needs_project: ClassVar[bool] = True
    version: ClassVar[str] = "1"

    def __init_subclass__(cls, **kwargs: Any) -> None:
        """Take the parameters from ``Algorithm[...]``."""
        super().__init_subclass__(**kwargs)
        for base in cls.__dict__.get("__orig_bases__", ()):
            arguments = get_args(base)
            if get_origin(base) is Algorithm and isinstance(arguments[0], type):
                cls.Parameters = arguments[0]
        if cls.command and not (len(cls.command) == 2 and all(map(WORD.match, cls.command))):
            raise PluginError(
                f"{cls.__name__}.command is {cls.command!r}; give two lower-case words, or none"
            )
        if "id" in cls.__dict__ and cls.Parameters is not Parameters:
            cls.Parameters.source_name = f"tool {cls.id}"

    @abstractmethod
    def run(self, context: Context, parameters: P, feedback: Feedback) -> Result:
        """Do the work."""

    def inputs(self, context: Context, parameters: P) -> Sequence[Path]:
        """Files, besides those among the parameters, whose change makes the step stale."""
        return ()

    @classmethod
    def makes_state(cls) -> bool:
        """Whether the project is made of its results; else it answers a question or exports."""
        return cls.in_run or bool(cls.gives)

    @classmethod
    def help(cls) -> str:
        """Docstring of the tool."""
        return inspect.cleandoc(cls.__doc__ or "")

    @classmethod
    def summary(cls) -> str:
        """First line of the help, without its full stop."""
        return cls.help().partition("\n")[0].rstrip(".")

    @classmethod
    def manifest(cls) -> dict[str, Any]:
        """JSON-able declaration of the tool."""
        specs = cls.Parameters.specs()
        return {
            "id": cls.id,
            "name": cls.name,
            "group": cls.group,
            "help": cls.help(),
            **({"command": list(cls.command)} if cls.command else {}),
            "version": cls.version,
            "needs_project": cls.needs_project,
            "in_run": cls.in_run,
            "about": cls.about,
            "needs": list(cls.needs),
            "gives": list(cls.gives),
            "parameters": [spec.manifest() for spec in specs],
            "outputs": [
                {"name": out.name, "title": out.title, "type": out.type} for out in cls.outputs
            ],
            "schema": {
                "$schema": "https://json-schema.org/draft/2020-12/schema",
                "title": cls.name,
                "type": "object",
                "properties": {spec.name: spec.schema() for spec in specs},
                "required": [spec.name for spec in specs if spec.required],
                "additionalProperties": False,
            },
        }


def manifest(algorithms: Iterable[tuple[str, type[Algorithm[Any]]]]) -> dict[str, Any]:
    """Manifest of tools, given as pairs of provider and class."""
    return {
        "manifest": MANIFEST_VERSION,
        "tools": [
            {"provider": provider, "full_id": f"{provider}:{tool.id}", **tool.manifest()}
            for provider, tool in algorithms
        ],
    }
