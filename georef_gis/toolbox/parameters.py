"""Parameter types of the tool manifest, as fields of a pydantic model.

A tool declares its parameters once; the command line, dialogs, web forms and docs pages are made
from that declaration::

    from georef_gis.toolbox import parameters as p

    class OrthoParameters(p.Parameters):
        gsd: p.Length | None = p.length(None, title="Ground sample distance", ge=0.001, le=100)
        tilt: p.Angle = p.angle(30.0, title="Largest tilt", unit="deg", ge=0, le=80)

Values, defaults and limits are *given* in the declared unit (a text may carry another one:
``"2.5cm"``); a read attribute is SI: metre or radian.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, cast

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from georef_gis.errors import InputError
from georef_gis.toolbox.specs import KINDS, Kind, Spec, specs_of
from georef_gis.toolbox.values import Extent as ExtentValue
from georef_gis.toolbox.values import MapPoint as MapPointValue
from georef_gis.toolbox.values import PhotoPixel as PhotoPixelValue
from georef_gis.toolbox.values import read_quantity, unit_factor

File = Annotated[Path, Kind("File")]
Folder = Annotated[Path, Kind("Folder")]
# Names, ids or patterns of photos; none = all of the project.
PhotoSet = Annotated[tuple[str, ...], Kind("PhotoSet")]
# "auto", "EPSG:6549", WKT or a file with WKT; read by geodesy.
Crs = Annotated[str, Kind("Crs")]
Extent = Annotated[ExtentValue, Kind("Extent")]
# A file, or the name of a layer of the project; see `LayerFile` for one layer of a file.
RasterLayer = Annotated[str, Kind("RasterLayer")]
VectorLayer = Annotated[str, Kind("VectorLayer")]
MapPoint = Annotated[MapPointValue, Kind("MapPoint")]
PhotoPixel = Annotated[PhotoPixelValue, Kind("PhotoPixel")]
# m inside
Length = Annotated[float, Kind("Length")]
# rad inside
Angle = Annotated[float, Kind("Angle")]
Number = Annotated[float, Kind("Number")]
Integer = Annotated[int, Kind("Integer")]
Text = Annotated[str, Kind("Text")]
Flag = Annotated[bool, Kind("Flag")]
# Or a Literal[...], whose members are the choices.
Choice = Annotated[str, Kind("Choice")]
TableField = Annotated[str, Kind("TableField")]

PARSERS: dict[str, Callable[[str], Any]] = {
    "Extent": ExtentValue.parse,
    "MapPoint": MapPointValue.parse,
    "PhotoPixel": PhotoPixelValue.parse,
}


class Parameters(BaseModel):
    """Base of the parameters of every tool; an unfit value raises `InputError`."""

    model_config = ConfigDict(extra="forbid", frozen=True, defer_build=True, allow_inf_nan=False)
    source_name: ClassVar[str] = ""

    @classmethod
    def specs(cls) -> tuple[Spec, ...]:
        """Declarations of the parameters, in order."""
        return specs_of(cls)

    @model_validator(mode="wrap")
    @classmethod
    def _read(cls, data: Any, handler: Any) -> Any:
        if not isinstance(data, Mapping):
            return handler(data)
        specs = {spec.name: spec for spec in cls.specs()}
        values = {
            name: _read_value(specs[name], given, cls.source_name) if name in specs else given
            for name, given in data.items()
        }
        try:
            return handler(values)
        except ValidationError as error:
            raise _input_error(error, specs, cls.source_name) from error

    def declared(self) -> dict[str, Any]:
        """JSON-able values in the declared units: what gives these parameters again."""
        return {spec.name: spec.declared(getattr(self, spec.name)) for spec in self.specs()}


def _read_value(spec: Spec, given: Any, source: str) -> Any:
    if given is None:
        return None
    if spec.multiple and isinstance(given, list | tuple):
        return tuple(_read_one(spec, item, source) for item in given)
    if spec.multiple:
        return (_read_one(spec, given, source),)
    if spec.kind == "PhotoSet":
        return (given,) if isinstance(given, str) else given
    return _read_one(spec, given, source)


def _read_one(spec: Spec, given: Any, source: str) -> Any:
    try:
        if spec.kind in PARSERS:
            return PARSERS[spec.kind](given) if isinstance(given, str) else given
        if spec.kind in ("Length", "Angle"):
            value = read_quantity(given, spec.kind, spec.unit)
            spec.check_range(value)
            return value * unit_factor(spec.kind, spec.unit)
        if spec.kind in ("Number", "Integer") and _is_number(given):
            spec.check_range(float(given))
        if spec.kind in ("RasterLayer", "VectorLayer") and isinstance(given, Path):
            return str(given)
        if spec.kind == "File":
            spec.check_target(given)
        if spec.choices and str(given) not in spec.choices:
            raise ValueError(f"{given!r} is no choice; use one of {', '.join(spec.choices)}")
    except (ValueError, TypeError) as error:
        raise InputError(str(error), source=source, field=spec.name) from error
    return given


def _is_number(given: Any) -> bool:
    try:
        return not isinstance(given, bool) and math.isfinite(float(given))
    except (ValueError, TypeError):
        return False


def _input_error(error: ValidationError, specs: Mapping[str, Spec], source: str) -> InputError:
    """One line on the first of the model's complaints."""
    problems = error.errors(include_url=False)
    first = problems[0]
    field = str(first["loc"][0]) if first["loc"] else ""
    spec = specs.get(field)
    if first["type"] == "extra_forbidden":
        message = f"no such parameter; use {_nearest(field, list(specs))}"
    elif first["type"] == "missing":
        message = f"is missing; give {spec.expects() if spec else 'a value'}"
    else:
        wanted = f"; give {spec.expects()}" if spec else ""
        message = f"{first['input']!r}: {first['msg'].lower()}{wanted}"
    if len(problems) > 1:
        message += f" (and {len(problems) - 1} more)"
    return InputError(message, source=source, field=field)


def _nearest(word: str, words: list[str]) -> str:
    from difflib import get_close_matches

    close = get_close_matches(word, words, n=1, cutoff=0.5)
    return close[0] if close else f"one of {', '.join(words)}"


def _field(kind: str, default: Any, title: str, help: str = "", **extra: Any) -> Any:
    unit = extra.get("unit", "")
    factor = unit_factor(kind, unit) if kind in ("Length", "Angle") else 1.0
    if factor != 1.0 and isinstance(default, int | float):
        default = default * factor
    elif factor != 1.0 and isinstance(default, tuple):
        default = tuple(value * factor for value in default)
    known = {key: value for key, value in extra.items() if value is not None and value is not False}
    # A wrong helper for a type would only be seen in a dialog: the spec compares the two.
    declaration = cast(dict[str, Any], {"georef": {"kind": kind, **known}})
    return Field(default, title=title, description=help or None, json_schema_extra=declaration)


def length(
    default: Any = ..., *, title: str, help: str = "", unit: str = "m",
    ge: float | None = None, le: float | None = None, gt: float | None = None,
    lt: float | None = None, advanced: bool = False, positional: bool = False,
) -> Any:  # fmt: skip
    """Field of a `Length`; default and limits are in `unit`."""
    return _field("Length", default, title, help, unit=unit, ge=ge, le=le, gt=gt, lt=lt,
                  advanced=advanced, positional=positional)  # fmt: skip


def angle(
    default: Any = ..., *, title: str, help: str = "", unit: str = "deg",
    ge: float | None = None, le: float | None = None, gt: float | None = None,
    lt: float | None = None, advanced: bool = False, positional: bool = False,
) -> Any:  # fmt: skip
    """Field of an `Angle`; default and limits are in `unit`."""
    return _field("Angle", default, title, help, unit=unit, ge=ge, le=le, gt=gt, lt=lt,
                  advanced=advanced, positional=positional)  # fmt: skip


def number(
    default: Any = ..., *, title: str, help: str = "", unit: str = "",
    ge: float | None = None, le: float | None = None, gt: float | None = None,
    lt: float | None = None, advanced: bool = False, positional: bool = False,
) -> Any:  # fmt: skip
    """Field of a `Number`; `unit` is only shown."""
    return _field("Number", default, title, help, unit=unit, ge=ge, le=le, gt=gt, lt=lt,
                  advanced=advanced, positional=positional)  # fmt: skip


def integer(
    default: Any = ..., *, title: str, help: str = "", unit: str = "",
    ge: int | None = None, le: int | None = None, advanced: bool = False,
    positional: bool = False,
) -> Any:  # fmt: skip
    """Field of an `Integer`."""
    return _field("Integer", default, title, help, unit=unit, ge=ge, le=le,
                  advanced=advanced, positional=positional)  # fmt: skip


def text(
    default: Any = ..., *, title: str, help: str = "", suggestions: tuple[str, ...] = (),
    advanced: bool = False, positional: bool = False,
) -> Any:  # fmt: skip
    """Field of a `Text`; `suggestions` are offered as a list, other texts are allowed too."""
    return _field("Text", default, title, help, suggestions=suggestions, advanced=advanced,
                  positional=positional)  # fmt: skip


def flag(default: Any = False, *, title: str, help: str = "", advanced: bool = False) -> Any:
    """Field of a `Flag`."""
    return _field("Flag", default, title, help, advanced=advanced)


def choice(
    default: Any = ..., *, title: str, help: str = "", choices: tuple[str, ...] = (),
    advanced: bool = False, positional: bool = False,
) -> Any:  # fmt: skip
    """Field of a `Choice`, or of a ``Literal`` type whose members are the choices."""
    return _field("Choice", default, title, help, choices=choices, advanced=advanced,
                  positional=positional)  # fmt: skip


def file(
    default: Any = ..., *, title: str, help: str = "", suffixes: tuple[str, ...] = (),
    writes: bool = False, or_folder: bool = False, advanced: bool = False,
    positional: bool = False,
) -> Any:  # fmt: skip
    """Field of a `File`; `writes` marks a target. Files to read decide if a step is stale.

    A target of another suffix than `suffixes` is refused; `or_folder` tells that a folder may be
    read in the place of the file.
    """
    return _field("File", default, title, help, suffixes=suffixes, writes=writes,
                  or_folder=or_folder, advanced=advanced, positional=positional)  # fmt: skip


def folder(
    default: Any = ..., *, title: str, help: str = "", writes: bool = False,
    advanced: bool = False, positional: bool = False,
) -> Any:  # fmt: skip
    """Field of a `Folder`; `writes` marks a target."""
    return _field("Folder", default, title, help, writes=writes, advanced=advanced,
                  positional=positional)  # fmt: skip


def table_field(
    default: Any = ..., *, title: str, of: str, help: str = "", advanced: bool = False
) -> Any:
    """Field of a `TableField`: a column of the layer that parameter `of` names."""
    return _field("TableField", default, title, help, of=of, advanced=advanced)


PlainKind = Literal[
    "PhotoSet", "Crs", "Extent", "RasterLayer", "VectorLayer", "MapPoint", "PhotoPixel"
]


def plain(
    kind: PlainKind, default: Any = ..., *, title: str, help: str = "",
    advanced: bool = False, positional: bool = False,
) -> Any:  # fmt: skip
    """Field of a type that has no options of its own."""
    if kind not in KINDS:
        raise ValueError(f"no parameter type {kind!r}")
    return _field(kind, default, title, help, advanced=advanced, positional=positional)


def photo_set(default: Any = (), *, title: str = "Photos", help: str = "", **more: bool) -> Any:
    """Field of a `PhotoSet`; none given = all photos of the project."""
    return plain("PhotoSet", default, title=title, help=help, **more)


def crs(default: Any = ..., *, title: str, help: str = "", **more: bool) -> Any:
    """Field of a `Crs`."""
    return plain("Crs", default, title=title, help=help, **more)


def extent(default: Any = None, *, title: str = "Extent", help: str = "", **more: bool) -> Any:
    """Field of an `Extent`."""
    return plain("Extent", default, title=title, help=help, **more)


def raster_layer(default: Any = ..., *, title: str, help: str = "", **more: bool) -> Any:
    """Field of a `RasterLayer`."""
    return plain("RasterLayer", default, title=title, help=help, **more)


def vector_layer(default: Any = ..., *, title: str, help: str = "", **more: bool) -> Any:
    """Field of a `VectorLayer`."""
    return plain("VectorLayer", default, title=title, help=help, **more)


def map_point(default: Any = ..., *, title: str, help: str = "", **more: bool) -> Any:
    """Field of a `MapPoint`."""
    return plain("MapPoint", default, title=title, help=help, **more)


def photo_pixel(default: Any = ..., *, title: str, help: str = "", **more: bool) -> Any:
    """Field of a `PhotoPixel`."""
    return plain("PhotoPixel", default, title=title, help=help, **more)
