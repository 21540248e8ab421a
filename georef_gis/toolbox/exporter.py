"""The contract of an exporter, and the tool that the toolbox makes of it."""

from __future__ import annotations

import glob
import inspect
import os
import time
from abc import ABC, abstractmethod
from contextlib import nullcontext, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Generic, TypeVar, get_args, get_origin

from pydantic import create_model

from georef_gis.errors import ExportError, InputError
from georef_gis.project.geopackage import journals_aside
from georef_gis.toolbox import parameters as p
from georef_gis.toolbox.algorithm import Algorithm, Output, Result
from georef_gis.toolbox.context import Context, Feedback
from georef_gis.toolbox.export_folder import check_folder, remove, replace_folder

if TYPE_CHECKING:
    from georef_gis.project import Project

# Kind of every layer a project has: tables of the database, products, and the site as a whole.
LAYER_KINDS: dict[str, str] = {
    "site": "site",
    "photos": "vector",
    "poses": "vector",
    "footprints": "vector",
    "control": "vector",
    "tie_points": "vector",
    # points, lines, areas and error ellipses of what was mapped
    "assets": "vector",
    # The first of a kind is the default of an exporter that accepts it.
    "mosaic": "raster",
    "orthos": "raster",
}
RASTER_SUFFIXES = (".tif", ".tiff", ".vrt")
# s; no export takes that long
_ABANDONED = 86_400.0
# Files that SQLite writes
_DATABASES = (".gpkg", ".mbtiles")
VECTOR_SUFFIXES = (".gpkg", ".geojson", ".fgb", ".shp")

O = TypeVar("O", bound=p.Parameters)  # noqa: E741


@dataclass(frozen=True, slots=True, kw_only=True)
class LayerSource:
    """What an exporter reads from.

    Parameters
    ----------
    project
        Opened read-only: an exporter cannot change the layer.
    layer
        Name of a layer of the project (see `LAYER_KINDS`), or a file.
    kind
        ``vector``, ``raster`` or ``site`` (all that the project has).
    """

    project: Project
    layer: str
    kind: str

    @property
    def path(self) -> Path | None:
        """File of the layer, if it is one: a product, or a file of its own."""
        if self.layer == "mosaic":
            return self.project.products / "mosaic.tif"
        if self.layer == "orthos":
            return self.project.products / "orthos"
        return None if self.layer in LAYER_KINDS else Path(self.layer)


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportReport:
    """What was written.

    Parameters
    ----------
    crs
        Name or code of the CRS of the target, such as ``EPSG:32617``.
    height_kind
        ``ellipsoidal``, ``orthometric (EGM96)``, ``above ground``, ``unknown`` or ``none`` (2D).
    features
        Number of features or pictures.
    place
        Where to, if to no file; without passwords, as it is recorded.
    """

    crs: str
    height_kind: str
    features: int | None = None
    warnings: tuple[str, ...] = ()
    place: str = ""


class Exporter(ABC, Generic[O]):
    """Base of every exporter; the toolbox turns it into the tool ``export_<id>``.

    Write ``class Kmz(Exporter[KmzOptions])`` with ``class KmzOptions(p.Parameters)``. The
    docstring is the help.

    Attributes
    ----------
    suffix
        Of the target, with the dot; "" = any name, mostly of a folder.
    further_suffixes
        Other names of the same format, such as ``.tiff``, in small letters.
    accepts
        Kinds of layers: ``vector``, ``raster``, ``site``. The first layer of the first kind is
        the default of the tool.
    target
        File name under products/ if the user gives none; default ``<layer><suffix>``.
    in_run, needs
        As of a tool; an exporter in the run writes ``site`` or its first layer.
    """

    id: ClassVar[str]
    name: ClassVar[str]
    suffix: ClassVar[str]
    further_suffixes: ClassVar[tuple[str, ...]] = ()
    accepts: ClassVar[tuple[str, ...]]
    Options: ClassVar[type[p.Parameters]] = p.Parameters
    target: ClassVar[str] = ""
    in_run: ClassVar[bool] = False
    needs: ClassVar[tuple[str, ...]] = ("photos",)
    wants: ClassVar[tuple[str, ...]] = ("adjusted",)
    version: ClassVar[str] = "1"

    def __init_subclass__(cls, **kwargs: Any) -> None:
        """Take the parameters from ``Exporter[...]``."""
        super().__init_subclass__(**kwargs)
        for base in cls.__dict__.get("__orig_bases__", ()):
            arguments = get_args(base)
            origin = get_origin(base)
            is_exporter = isinstance(origin, type) and issubclass(origin, Exporter)
            if is_exporter and isinstance(arguments[0], type):
                cls.Options = arguments[0]

    @abstractmethod
    def write(
        self, source: LayerSource, target: Path, options: O, feedback: Feedback
    ) -> ExportReport:
        """Write the layer to `target`.

        `target` is a temporary neighbour with the right suffix, renamed by the toolbox when this
        returns and removed if it raises. `ExportError` if the format cannot hold the layer.
        """


class Sender(Exporter[O]):
    """Base of exporters to what is no file, such as a database: their tool asks for no target.

    Options are recorded with the run: none of them may be a secret.
    """

    suffix: ClassVar[str] = ""

    @abstractmethod
    def send(self, source: LayerSource, options: O, feedback: Feedback) -> ExportReport:
        """Bring the layer to its place, whole or not at all."""

    def write(
        self, source: LayerSource, target: Path, options: O, feedback: Feedback
    ) -> ExportReport:
        """Refuse, as there is no file."""
        raise ExportError(f"export_{self.id}: writes no file; leave out the target")


def layer_kind(layer: str) -> str:
    """Kind of a layer of the project or of a file.

    Raises
    ------
    InputError
        If it is neither.
    """
    if layer in LAYER_KINDS:
        return LAYER_KINDS[layer]
    suffix = Path(layer.partition("|")[0]).suffix.lower()
    if suffix in RASTER_SUFFIXES:
        return "raster"
    if suffix in VECTOR_SUFFIXES:
        return "vector"
    raise InputError(
        f"{layer!r} is no layer; use one of {', '.join(LAYER_KINDS)} or a file", field="layer"
    )


def layers_of(exporter: type[Exporter[Any]]) -> tuple[str, ...]:
    """Layers of a project that an exporter accepts, its favourite first."""
    return tuple(
        layer for kind in exporter.accepts for layer, its in LAYER_KINDS.items() if its == kind
    )


class ExportTool(Algorithm[p.Parameters]):
    """Base of the tools made from exporters."""

    exporter: ClassVar[type[Exporter[Any]]]

    def run(self, context: Context, parameters: p.Parameters, feedback: Feedback) -> Result:
        """Write one layer to a temporary neighbour of the target and rename it."""
        project = context.require_project()
        values = parameters.declared()
        layer, given = str(values.pop("layer")), values.pop("target", None)
        kind = layer_kind(layer)
        if kind not in self.exporter.accepts:
            accepted = ", ".join(layers_of(self.exporter))
            raise ExportError(f"{self.id}: cannot hold the {kind} layer {layer}; use {accepted}")
        exporter, options = self.exporter(), self.exporter.Options(**values)
        with project.reader() as reader:
            source = LayerSource(project=reader, layer=layer, kind=kind)
            if isinstance(exporter, Sender):
                return _result(exporter.send(source, options, feedback))
            target = _named(given) if given else project.products / self._default_target(layer)
            report = _write_safely(exporter, source, target, options, feedback)
        return _result(report, target)

    def inputs(self, context: Context, parameters: p.Parameters) -> list[Path]:
        """Assets, which are edited outside of any run."""
        from georef_gis.project.asset_layers import ASSETS_FILE

        has_features = {"site", "vector"} & set(self.exporter.accepts)
        return [context.require_project().folder / ASSETS_FILE] if has_features else []

    def _default_target(self, layer: str) -> str:
        own, first = self.exporter.target, layers_of(self.exporter)[0]
        if own and layer == first:
            return own
        # folders of several formats would have one name without what follows the layer's
        ending = own.removeprefix(first) if own.startswith(f"{first}_") else self.exporter.suffix
        return Path(layer).stem + ending


def _result(report: ExportReport, target: Path | None = None) -> Result:
    """What the tool gives back; no outputs where there is no file."""
    summary: dict[str, Any] = {
        "crs": report.crs,
        "height_kind": report.height_kind,
        "features": report.features,
    }
    if target is None:
        return Result(summary=summary | {"place": report.place}, warnings=tuple(report.warnings))
    summary["products"] = [str(target)]
    return Result(outputs={"target": target}, summary=summary, warnings=tuple(report.warnings))


def _write_safely(
    exporter: Exporter[Any],
    source: LayerSource,
    target: Path,
    options: p.Parameters,
    feedback: Feedback,
) -> ExportReport:
    # Two projects may write one place at once.
    part = target.with_name(f".{target.stem}.{os.getpid()}.part{target.suffix}")
    try:
        if target.is_dir() and target.suffix.lower() not in _suffixes(exporter):
            raise ExportError(f"{target}: is a folder; give the name of a {exporter.suffix} in it")
        check_folder(target, exporter.id)
        target.parent.mkdir(parents=True, exist_ok=True)
        _remove_abandoned(target)
        remove(part)
        report = exporter.write(source, part, options, feedback)
        if part.is_dir():
            replace_folder(part, target, exporter.id)
        elif target.is_dir():
            raise ExportError(f"{target}: is a folder; give the name of a file in it")
        else:
            is_database = target.suffix.lower() in _DATABASES
            with journals_aside(target) if is_database else nullcontext():
                os.replace(part, target)
    except OSError as error:
        reason = error.strerror or str(error)
        raise ExportError(
            f"{target}: cannot be written ({reason}); check free space and permission, and that "
            "no other program has it open"
        ) from error
    finally:
        pattern = f"{glob.escape(part.name)}*"
        for left in target.parent.glob(pattern) if target.parent.is_dir() else ():
            remove(left)
    return report


def _suffixes(exporter: Exporter[Any] | type[Exporter[Any]]) -> tuple[str, ...]:
    """All that the target may have, that of the default first."""
    return (exporter.suffix, *exporter.further_suffixes)


def _remove_abandoned(target: Path) -> None:
    """Remove what exports to a place left that were killed long ago."""
    for left in target.parent.glob(f".{glob.escape(target.stem)}.*.part*"):
        with suppress(FileNotFoundError):
            if time.time() - left.stat().st_mtime > _ABANDONED:
                remove(left)


def _named(given: Path | str) -> Path:
    """Target with a name of its own, which `.` and `..` have not.

    Raises
    ------
    ExportError
        If it is the root of the disk.
    """
    target = Path(given)
    if target.name in ("", ".."):
        target = Path(os.path.abspath(target))
    if not target.name:
        raise ExportError(f"{target}: is no place for an export; give the name of a file in it")
    return target


def tool_of(exporter: type[Exporter[Any]]) -> type[Algorithm[Any]]:
    """Tool ``export_<id>`` of an exporter."""
    layers = layers_of(exporter)
    shared: dict[str, Any] = {
        "layer": (
            p.Text,
            p.text(
                layers[0],
                title="Layer",
                help=f"One of {', '.join(layers)}, or a file.",
                suggestions=layers,
            ),
        ),
    }
    sends = issubclass(exporter, Sender)
    if not sends:
        shared["target"] = (
            p.File | None,
            p.file(None, title="File to write", writes=True, suffixes=_suffixes(exporter)),
        )
    model = create_model(f"Export{exporter.__name__}", __base__=exporter.Options, **shared)
    return type(
        f"Export{exporter.__name__}",
        (ExportTool,),
        {
            "__doc__": inspect.cleandoc(exporter.__doc__ or exporter.name),
            "__module__": exporter.__module__,
            "id": f"export_{exporter.id}",
            "name": f"Export {exporter.name}",
            "group": "export",
            "Parameters": model,
            "exporter": exporter,
            "outputs": () if sends else (Output(name="target", title=exporter.name),),
            "needs": exporter.needs,
            "wants": exporter.wants,
            "in_run": exporter.in_run,
            "version": exporter.version,
        },
    )
