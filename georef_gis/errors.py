"""The error tree. Apps catch `GeorefError`; anything else is a bug.

::

    GeorefError                     everything a user can cause or cure
    |-- InputError                  a file or value cannot be used; has .source and .field
    |   |-- MissingMetadataError    e.g. no focal length in EXIF
    |   `-- CrsError                unknown, unfit or unequal CRS, datum or height kind
    |-- NavigationError             time outside the log, gap too long, no fix
    |-- GeometryError               ray misses, point behind camera, degenerate network
    |-- AdjustmentError             did not converge / not enough observations
    |-- ExportError                 target cannot be written or cannot hold the layer
    |-- PluginError                 tool or exporter cannot be loaded, or id taken
    `-- Cancelled                   the user stopped it

A message is one line: what, where, value with unit, what to do.
"""

from __future__ import annotations


class GeorefError(Exception):
    """Base of everything a user can cause or cure."""


class InputError(GeorefError):
    """A file or a value cannot be used.

    Parameters
    ----------
    message
        What is wrong, with value, unit and cure; without the source.
    source
        File, photo or table the value came from.
    field
        Name of the field in that source.
    """

    def __init__(self, message: str, *, source: str = "", field: str = "") -> None:
        self.source = source
        self.field = field
        where = ": ".join(part for part in (source, field) if part)
        super().__init__(f"{where}: {message}" if where else message)


class MissingMetadataError(InputError):
    """A photo or log lacks something that is needed."""


class CrsError(InputError):
    """A CRS, datum or height kind is unknown, unfit or unequal to another."""


class NavigationError(GeorefError):
    """No navigation at the time asked for."""


class GeometryError(GeorefError):
    """The geometry has no solution: a ray misses, a point lies behind the camera."""


class AdjustmentError(GeorefError):
    """An adjustment did not converge or has too few observations."""


class ExportError(GeorefError):
    """A target cannot be written, or cannot hold the layer."""


class PluginError(GeorefError):
    """A tool or exporter cannot be loaded, or its id is taken."""


class Cancelled(GeorefError):
    """The user stopped the run."""
