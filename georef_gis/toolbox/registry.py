"""Tools and exporters of all installed distributions, found by entry point.

A distribution names a tuple of classes in the groups ``georef_gis.algorithms`` and
``georef_gis.exporters``; the name of the entry point is the provider. What cannot be loaded, or
takes an id that is taken, is refused with a reason, and the rest works.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from georef_gis.errors import InputError, PluginError
from georef_gis.toolbox.algorithm import GROUPS, Algorithm
from georef_gis.toolbox.exporter import Exporter, tool_of

ALGORITHM_GROUP = "georef_gis.algorithms"
EXPORTER_GROUP = "georef_gis.exporters"
OWN_PROVIDER = "georef"
OWN_DISTRIBUTION = "georef-gis"
ID = re.compile(r"^[a-z][a-z0-9]*(_[a-z0-9]+)*$")
PROVIDER = re.compile(r"^[a-z][a-z0-9_-]*$")
# Commands of the application, and options that every tool has.
RESERVED_IDS = (
    "run", "tools", "doctor", "batch", "serve", "qgis", "grids", "help", "version",
)  # fmt: skip
RESERVED_OPTIONS = ("project", "workers", "seed", "json", "verbose", "force", "verify", "help")


@dataclass(frozen=True, slots=True, kw_only=True)
class Tool:
    """A tool and where it comes from."""

    provider: str
    algorithm: type[Algorithm[Any]]
    distribution: str
    version: str

    @property
    def id(self) -> str:
        """Id within the provider."""
        return self.algorithm.id

    @property
    def full_id(self) -> str:
        """Id among all: ``provider:tool``."""
        return f"{self.provider}:{self.algorithm.id}"


@dataclass(slots=True)
class Registry:
    """Tools by full id, and what was refused."""

    tools: dict[str, Tool] = field(default_factory=dict)
    refused: list[PluginError] = field(default_factory=list)
    _providers: dict[str, str] = field(default_factory=dict)
    # how many tools have an id
    _ids: Counter[str] = field(default_factory=Counter)

    def __iter__(self) -> Iterator[Tool]:
        """Tools by group, in the order of the work; within it as declared."""
        order = {group: number for number, group in enumerate(GROUPS)}
        return iter(sorted(self.tools.values(), key=lambda t: order.get(t.algorithm.group, 99)))

    def find(self, name: str) -> Tool:
        """Tool of a full id, or of an id; dashes are as good as underscores.

        Ours goes before a third party's of the same id.

        Raises
        ------
        InputError
            If there is none, or several.
        """
        wanted = name.replace("-", "_") if ":" not in name else name
        if wanted in self.tools:
            return self.tools[wanted]
        found = [tool for tool in self.tools.values() if tool.id == wanted]
        own = [tool for tool in found if tool.provider == OWN_PROVIDER]
        if own or len(found) == 1:
            return (own or found)[0]
        if found:
            raise InputError(f"{name!r} is in {', '.join(t.full_id for t in found)}; name one")
        raise InputError(f"there is no tool {name!r}{self._near(wanted)}; see `georef tools`")

    def command(self, tool: Tool) -> str:
        """Name on the command line: short where that is clear."""
        short = tool.provider == OWN_PROVIDER or self._ids[tool.id] == 1
        return tool.id.replace("_", "-") if short else tool.full_id

    def add(self, provider: str, classes: Iterable[Any], distribution: str, version: str) -> None:
        """Take in the tools and exporters of one distribution, or refuse them one by one."""
        for plugin in classes:
            try:
                tool = Tool(
                    provider=provider,
                    algorithm=_checked(plugin),
                    distribution=distribution,
                    version=version,
                )
                if tool.full_id in self.tools:
                    by = self.tools[tool.full_id].distribution
                    raise PluginError(f"id {tool.full_id} is taken by {by}; rename the tool")
                self.tools[tool.full_id] = tool
                self._ids[tool.id] += 1
            except PluginError as error:
                self.refuse(distribution, str(error), error)

    def refuse(self, distribution: str, reason: str, cause: BaseException) -> None:
        """Note why something was not taken in."""
        error = PluginError(f"{distribution}: {reason}")
        error.__cause__ = cause
        self.refused.append(error)

    def load(self, entry: EntryPoint) -> None:
        """Take in what an entry point names."""
        distribution, version = _origin(entry)
        owner = self._providers.setdefault(entry.name, distribution)
        try:
            if not PROVIDER.match(entry.name):
                raise PluginError(f"provider {entry.name!r} is no lower-case name")
            if owner != distribution:
                raise PluginError(f"provider {entry.name!r} is taken by {owner}; rename it")
            classes = entry.load()
            if not isinstance(classes, tuple | list):
                raise PluginError(f"{entry.value} is no tuple of classes")
        except PluginError as error:
            self.refuse(distribution, str(error), error)
        except (Exception, SystemExit) as error:
            reason = f"{entry.value} cannot be imported ({type(error).__name__}: {error})"
            self.refuse(distribution, reason.replace("\n", " "), error)
        else:
            self.add(entry.name, classes, distribution, version)

    def _near(self, wanted: str) -> str:
        from difflib import get_close_matches

        close = get_close_matches(wanted, [tool.id for tool in self.tools.values()], n=1)
        return f"; did you mean {close[0].replace('_', '-')}?" if close else ""


@cache
def load_registry() -> Registry:
    """Registry of all installed distributions: ours first, then by name.

    A provider's name belongs to the distribution whose own name begins with it.
    """
    registry = Registry()
    # Asking for one group reads the files of all installed packages too.
    installed = entry_points()
    for group in (ALGORITHM_GROUP, EXPORTER_GROUP):
        # A distribution may be seen twice, through two folders on the path.
        found = {(entry.name, entry.value, _origin(entry)): entry
                 for entry in installed.select(group=group)}  # fmt: skip
        for entry in sorted(found.values(), key=_rank):
            registry.load(entry)
    return registry


def _rank(entry: EntryPoint) -> tuple[bool, bool, tuple[str, str], str]:
    origin = _origin(entry)
    return origin[0] != OWN_DISTRIBUTION, not origin[0].startswith(entry.name), origin, entry.name


def _origin(entry: EntryPoint) -> tuple[str, str]:
    """Name and version of the distribution of an entry point."""
    if entry.dist is None:
        return entry.value, "unknown"
    return entry.dist.name.replace("_", "-").lower(), entry.dist.version


def _checked(plugin: Any) -> type[Algorithm[Any]]:
    """Class of a tool, after looking at what it declares."""
    name = getattr(plugin, "__name__", repr(plugin))
    try:
        if isinstance(plugin, type) and issubclass(plugin, Exporter):
            plugin = tool_of(plugin)
        if not (isinstance(plugin, type) and issubclass(plugin, Algorithm)):
            raise PluginError(f"{name} is neither an Algorithm nor an Exporter")
        _check_declaration(plugin)
    except PluginError:
        raise
    except Exception as error:
        raise PluginError(f"{name} is badly declared ({type(error).__name__}: {error})") from error
    return plugin


def _check_declaration(tool: type[Algorithm[Any]]) -> None:
    if tool.__abstractmethods__:
        raise PluginError(f"{tool.__name__} lacks {', '.join(sorted(tool.__abstractmethods__))}")
    for attribute in ("id", "name", "group"):
        if not isinstance(getattr(tool, attribute, None), str):
            raise PluginError(f"{tool.__name__} lacks {attribute}")
    if not ID.match(tool.id) or tool.id in RESERVED_IDS:
        raise PluginError(f"id {tool.id!r} is reserved or not in lower_case")
    if not tool.__doc__:
        raise PluginError(f"{tool.id} has no docstring, which is its help")
    taken = [s.name for s in tool.Parameters.specs() if s.name in RESERVED_OPTIONS]
    if taken:
        raise PluginError(f"{tool.id}: parameter name {taken[0]!r} is an option of every tool")
