# SPDX-License-Identifier: GPL-2.0-or-later
# mypy: disable-error-code="import-not-found"
"""Members of enumerations that QGIS 3.22 to 4 keep in different places."""

from __future__ import annotations

from typing import Any

from qgis import core


def first(*paths: str) -> Any:
    """First of the dotted names in qgis.core that is there; the newest one stands first."""
    for path in paths:
        value: Any = core
        try:
            for name in path.split("."):
                value = getattr(value, name)
        except AttributeError:
            continue
        return value
    raise AttributeError(f"this QGIS has none of {', '.join(paths)}")


ADVANCED = first(
    "Qgis.ProcessingParameterFlag.Advanced", "QgsProcessingParameterDefinition.Flag.FlagAdvanced"
)
DOUBLE = first(
    "Qgis.ProcessingNumberParameterType.Double", "QgsProcessingParameterNumber.Type.Double"
)
INTEGER = first(
    "Qgis.ProcessingNumberParameterType.Integer", "QgsProcessingParameterNumber.Type.Integer"
)
FILE = first(
    "Qgis.ProcessingFileParameterBehavior.File", "QgsProcessingParameterFile.Behavior.File"
)
FOLDER = first(
    "Qgis.ProcessingFileParameterBehavior.Folder", "QgsProcessingParameterFile.Behavior.Folder"
)
FILES = first("Qgis.ProcessingSourceType.File", "QgsProcessing.SourceType.TypeFile")
VECTORS = first("Qgis.ProcessingSourceType.Vector", "QgsProcessing.SourceType.TypeVector")
WKT = first("Qgis.CrsWktVariant.Wkt2_2019", "QgsCoordinateReferenceSystem.WktVariant.WKT2_2019")
WARNING = first("Qgis.MessageLevel.Warning")
VECTOR_HINT = first("QgsProcessingUtils.LayerHint.Vector")
RASTER_HINT = first("QgsProcessingUtils.LayerHint.Raster")
DISTANCE_UNITS = {
    unit: first(f"Qgis.DistanceUnit.{name}", f"QgsUnitTypes.DistanceUnit.Distance{name}")
    for unit, name in {
        "m": "Meters",
        "km": "Kilometers",
        "cm": "Centimeters",
        "mm": "Millimeters",
        "ft": "Feet",
        "mi": "Miles",
    }.items()
}
