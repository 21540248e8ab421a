"""Georef GIS: from UAV photos to orthos, mosaics and measurements with their uncertainty.

The public names are loaded on first use, so that `import georef_gis` costs nothing.
"""

from __future__ import annotations

import importlib
import logging
from typing import Any

__version__ = "0.1.0"

logging.getLogger(__name__).addHandler(logging.NullHandler())

_PUBLIC = {
    "AttitudeTag": "model.photo",
    "Camera": "model.camera",
    "Cancelled": "errors",
    "CrsError": "errors",
    "Datum": "geodesy",
    "DemTerrain": "model.terrain",
    "ExportError": "errors",
    "FlatTerrain": "model.terrain",
    "Footprint": "model.layers",
    "Geotag": "model.photo",
    "GeometryError": "errors",
    "GeorefError": "errors",
    "Grid": "model.grid",
    "Height": "geodesy",
    "HeightKind": "geodesy",
    "InputError": "errors",
    "MapFrame": "geodesy",
    "MissingMetadataError": "errors",
    "Mount": "model.pose",
    "Origin": "geodesy",
    "OrientedPhoto": "model.photo",
    "Photo": "model.photo",
    "Plan": "model.plan",
    "Pose": "model.pose",
    "Project": "project",
    "locate": "model.ground_point",
}

__all__ = [*sorted(_PUBLIC), "__version__"]


def __getattr__(name: str) -> Any:
    """Load a public name from its module."""
    if name in _PUBLIC:
        return getattr(importlib.import_module(f"georef_gis.{_PUBLIC[name]}"), name)
    raise AttributeError(f"module 'georef_gis' has no attribute {name!r}")


def __dir__() -> list[str]:
    """Names for completion."""
    return sorted(__all__)
