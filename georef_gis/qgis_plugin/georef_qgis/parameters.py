# SPDX-License-Identifier: GPL-2.0-or-later
# mypy: disable-error-code="import-not-found"
"""Parameters of tools as QGIS knows them, and what the user gave as texts for georef."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

from qgis.core import (
    QgsProcessingException,
    QgsProcessingParameterBoolean,
    QgsProcessingParameterCrs,
    QgsProcessingParameterDistance,
    QgsProcessingParameterEnum,
    QgsProcessingParameterExtent,
    QgsProcessingParameterFeatureSource,
    QgsProcessingParameterField,
    QgsProcessingParameterFile,
    QgsProcessingParameterFileDestination,
    QgsProcessingParameterFolderDestination,
    QgsProcessingParameterMultipleLayers,
    QgsProcessingParameterNumber,
    QgsProcessingParameterPoint,
    QgsProcessingParameterRasterLayer,
    QgsProcessingParameterString,
    QgsProcessingUtils,
    QgsProviderRegistry,
)

from . import compat
from .tools import Field, split_lines

# Formats that georef reads; a layer in another one is saved as the first.
VECTOR_FORMATS = ["gpkg", "geojson", "fgb", "shp"]


def make_parameters(field: Field) -> list[Any]:
    """Definitions of a parameter: one, and for a place a second one for its height."""
    made = [_MAKERS[field.widget](field)]
    if field.widget == "point":
        made.append(
            QgsProcessingParameterNumber(
                height_of(field), f"{field.title}: height [m]", compat.DOUBLE, None, True
            )
        )
    for definition in made:
        definition.setHelp(field.hint())
        if field.advanced or definition is not made[0]:
            definition.setFlags(definition.flags() | compat.ADVANCED)
    return made


def height_of(field: Field) -> str:
    """Name of the parameter for the height of a place."""
    return f"{field.name}_height"


def _number(field: Field) -> Any:
    limits: dict[str, Any] = {}
    if field.minimum is not None:
        limits["minValue"] = field.minimum
    if field.maximum is not None:
        limits["maxValue"] = field.maximum
    optional = field.may_be_empty
    if field.widget == "integer":
        made = QgsProcessingParameterNumber(
            field.name, field.label, compat.INTEGER, field.default, optional, **limits
        )
    elif field.kind == "Length" and field.unit in compat.DISTANCE_UNITS:
        made = QgsProcessingParameterDistance(
            field.name, field.title, field.default, "", optional, **limits
        )
        made.setDefaultUnit(compat.DISTANCE_UNITS[field.unit])
    else:
        made = QgsProcessingParameterNumber(
            field.name, field.label, compat.DOUBLE, field.default, optional, **limits
        )
    if field.widget != "integer":
        made.setMetadata({"widget_wrapper": {"decimals": 6}})
    return made


def _text(field: Field) -> Any:
    many = field.widget == "lines"
    default = "\n".join(map(str, field.default or ())) if many else field.default
    return QgsProcessingParameterString(field.name, field.label, default, many, field.may_be_empty)


def _file(field: Field) -> Any:
    behaviour = compat.FOLDER if field.widget == "folder" else compat.FILE
    made = QgsProcessingParameterFile(
        field.name, field.label, behaviour, "", field.default, field.may_be_empty
    )
    if field.suffixes and field.widget == "file":
        made.setFileFilter(_filter(field))
    return made


def _file_out(field: Field) -> Any:
    if field.suffixes and not any(field.suffixes):
        # a folder of files, such as web tiles
        return _folder_out(field)
    return QgsProcessingParameterFileDestination(
        field.name, field.label, _filter(field), field.default, field.may_be_empty, field.required
    )


def _folder_out(field: Field) -> Any:
    return QgsProcessingParameterFolderDestination(
        field.name, field.label, field.default, field.may_be_empty, field.required
    )


def _filter(field: Field) -> str:
    """Filter of a file dialog, in Qt's notation."""
    return ";;".join(f"{end[1:].upper()} (*{end})" for end in field.suffixes if end)


def _choice(field: Field) -> Any:
    return QgsProcessingParameterEnum(
        field.name, field.label, list(field.choices), False, field.default, field.may_be_empty, True
    )


_MAKERS: dict[str, Callable[[Field], Any]] = {
    "file": _file,
    "folder": _file,
    "file_out": _file_out,
    "folder_out": _folder_out,
    "files": lambda f: QgsProcessingParameterMultipleLayers(
        f.name, f.label, compat.FILES, None, f.may_be_empty
    ),
    "raster": lambda f: QgsProcessingParameterRasterLayer(
        f.name, f.label, f.default, f.may_be_empty
    ),
    # This one offers "selected features only".
    "vector": lambda f: QgsProcessingParameterFeatureSource(
        f.name, f.label, [compat.VECTORS], f.default, f.may_be_empty
    ),
    # A CRS with a default counts as not specified where it must be given.
    "crs": lambda f: QgsProcessingParameterCrs(
        f.name, f.label, None if f.default in ("", "auto") else f.default, True
    ),
    "extent": lambda f: QgsProcessingParameterExtent(f.name, f.label, f.default, f.may_be_empty),
    "point": lambda f: QgsProcessingParameterPoint(f.name, f.label, f.default, f.may_be_empty),
    "number": _number,
    "integer": _number,
    "string": _text,
    "lines": _text,
    "boolean": lambda f: QgsProcessingParameterBoolean(f.name, f.label, bool(f.default)),
    "choice": _choice,
    "field": lambda f: QgsProcessingParameterField(
        f.name, f.label, f.default, f.of, optional=f.may_be_empty
    ),
}


def is_given(parameters: Any, name: str) -> bool:
    """Whether a parameter has a value; for QGIS an empty text would be the number 0."""
    value = parameters.get(name)
    return not (value is None or (isinstance(value, str) and not value))


class Reader:
    """What the user gave to one run of an algorithm, as georef takes it."""

    def __init__(self, algorithm: Any, parameters: Any, context: Any, feedback: Any) -> None:
        self.algorithm = algorithm
        self.parameters = parameters
        self.context = context
        self.feedback = feedback

    def value(self, field: Field) -> Any:
        """Flag, text, number or list of them; None if nothing was given."""
        if not is_given(self.parameters, field.name) and not field.widget.endswith("_out"):
            return None
        raw = self.parameters.get(field.name)
        if field.widget == "lines":
            given = raw if isinstance(raw, (list, tuple)) else self._string(field)
            return split_lines(field, given)
        return getattr(self, f"_{field.widget}", self._string)(field)

    def _string(self, field: Field) -> str:
        return str(self.algorithm.parameterAsString(self.parameters, field.name, self.context))

    def _boolean(self, field: Field) -> bool:
        return bool(self.algorithm.parameterAsBool(self.parameters, field.name, self.context))

    def _integer(self, field: Field) -> int:
        return int(self.algorithm.parameterAsInt(self.parameters, field.name, self.context))

    def _number(self, field: Field) -> float:
        return float(self.algorithm.parameterAsDouble(self.parameters, field.name, self.context))

    def _choice(self, field: Field) -> str:
        return str(self.algorithm.parameterAsEnumString(self.parameters, field.name, self.context))

    def _file(self, field: Field) -> str:
        name = self.algorithm.parameterAsFile(self.parameters, field.name, self.context)
        # georef works in another folder than QGIS
        return os.path.abspath(name) if name else ""

    _folder = _file

    def _file_out(self, field: Field) -> str:
        name = self.algorithm.parameterAsFileOutput(self.parameters, field.name, self.context)
        return os.path.abspath(name) if name else ""

    def _folder_out(self, field: Field) -> str:
        return self._file_out(field)

    def _files(self, field: Field) -> list[str]:
        names = self.algorithm.parameterAsFileList(self.parameters, field.name, self.context)
        return [os.path.abspath(name) for name in names if name]

    def _crs(self, field: Field) -> str:
        crs = self.algorithm.parameterAsCrs(self.parameters, field.name, self.context)
        # What is left open in a dialog is an invalid CRS too, but no text.
        if not crs.isValid() and isinstance(self.parameters.get(field.name), str):
            raise QgsProcessingException(
                f"{field.title}: QGIS knows no CRS {self.parameters[field.name]}; give one such as "
                "EPSG:6549"
            )
        return _crs_text(crs)

    def _extent(self, field: Field) -> str:
        args = (self.parameters, field.name, self.context)
        box = self.algorithm.parameterAsExtent(*args)
        if box.isNull():
            return ""
        sides = (box.xMinimum(), box.yMinimum(), box.xMaximum(), box.yMaximum())
        return _with_crs(sides, self.algorithm.parameterAsExtentCrs(*args))

    def _point(self, field: Field) -> str:
        args = (self.parameters, field.name, self.context)
        place = self.algorithm.parameterAsPoint(*args)
        numbers = [place.x(), place.y()]
        if is_given(self.parameters, height_of(field)):
            height = (self.parameters, height_of(field), self.context)
            numbers.append(self.algorithm.parameterAsDouble(*height))
        return _with_crs(numbers, self.algorithm.parameterAsPointCrs(*args))

    def _raster(self, field: Field) -> str:
        layer = self.algorithm.parameterAsRasterLayer(self.parameters, field.name, self.context)
        if layer is None or not layer.isValid():
            raise QgsProcessingException(
                self.algorithm.invalidRasterError(self.parameters, field.name)
            )
        kind, source = layer.providerType(), str(layer.source())
        if kind != "gdal" or source.startswith("/vsimem/"):
            raise QgsProcessingException(
                f"{field.title}: layer {layer.name()} is no file ({kind}); save it as GeoTIFF and "
                "give that"
            )
        return source

    def _vector(self, field: Field) -> str:
        # Without feedback this crashes on layers of a GeoPackage.
        path, name = self.algorithm.parameterAsCompatibleSourceLayerPathAndLayerName(
            self.parameters, field.name, self.context, VECTOR_FORMATS, VECTOR_FORMATS[0],
            self.feedback,
        )  # fmt: skip
        if not path:
            raise QgsProcessingException(
                f"{field.title}: {self._string(field)} is no vector layer that can be read"
            )
        layer = self.algorithm.parameterAsVectorLayer(self.parameters, field.name, self.context)
        if layer is not None and not name:
            name = _name_by_number(path, layer.source())
        return f"{path}|layername={name}" if name else str(path)


def _name_by_number(path: str, source: str) -> str:
    """Name of a layer that is told by its number in its file; empty if it is not."""
    registry = QgsProviderRegistry.instance()
    number = registry.decodeUri("ogr", source).get("layerId")
    if number is None or not source.startswith(path):
        return ""
    parts = registry.querySublayers(path)
    return next((str(part.name()) for part in parts if part.layerNumber() == number), "")


def _with_crs(numbers: Any, crs: Any) -> str:
    text = ",".join(repr(float(number)) for number in numbers)
    return f"{text}@{_crs_text(crs)}" if crs.isValid() else text


def _crs_text(crs: Any) -> str:
    """Authority and code, or WKT of what no authority knows."""
    if not crs.isValid():
        return ""
    name = str(crs.authid())
    if name and not name.upper().startswith("USER:"):
        return name
    return str(crs.toWkt(compat.WKT))


def temporary(name: str) -> str:
    """Path of a temporary file that QGIS removes at its end."""
    return str(QgsProcessingUtils.generateTempFilename(name))
