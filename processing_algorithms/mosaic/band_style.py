"""Colours of an index for QGIS, in a style file beside it."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as ET

from georef_gis.mosaic.band_math import Index
from georef_gis.rasters.files import export_errors, whole_file

# ColorBrewer BrBG, readable by the colour-blind, from its least to its largest value
_COLOURS = ("#8c510a", "#d8b365", "#f6e8c3", "#f5f5f5", "#c7eae5", "#5ab4ac", "#01665e")


def write_style(raster: Path, index: Index) -> Path:
    """Write the style that QGIS takes for a raster by itself.

    Raises
    ------
    ExportError
        If it cannot be written.
    """
    low, high = index.limits
    root = ET.Element("qgis", version="3.28", styleCategories="Symbology")
    pipe = ET.SubElement(root, "pipe")
    renderer = ET.SubElement(
        pipe, "rasterrenderer", type="singlebandpseudocolor", band="1", opacity="1",
        classificationMin=f"{low:g}", classificationMax=f"{high:g}",
    )  # fmt: skip
    shader = ET.SubElement(
        ET.SubElement(renderer, "rastershader"), "colorrampshader", colorRampType="INTERPOLATED",
        minimumValue=f"{low:g}", maximumValue=f"{high:g}", clip="0",
    )  # fmt: skip
    for i, colour in enumerate(_COLOURS):
        value = f"{low + (high - low) * i / (len(_COLOURS) - 1):.3g}"
        ET.SubElement(shader, "item", value=value, label=value, color=colour, alpha="255")
    target = raster.with_suffix(".qml")
    with export_errors(target, lambda: 0), whole_file(target) as stream:
        stream.write(ET.tostring(root, encoding="utf-8") + b"\n")
    return target
