"""The file of a layer that is one raster."""

from __future__ import annotations

from typing import TYPE_CHECKING

from georef_gis.errors import ExportError

if TYPE_CHECKING:
    from pathlib import Path

    from georef_gis.toolbox import LayerSource


def raster_of(source: LayerSource) -> Path:
    """Path of a layer's file.

    Raises
    ------
    ExportError
        If the layer is not one raster, or was not made yet.
    """
    path = source.path
    if path is None or path.is_dir():
        raise ExportError(
            f"layer {source.layer} is not one raster; use mosaic or the file of one ortho"
        )
    if not path.is_file():
        raise ExportError(f"{path}: is not there; run `georef run` first")
    return path
